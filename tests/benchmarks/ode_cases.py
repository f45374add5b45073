"""Branches of small ODEs that benchmarks follow: a model, an orbit or a Hopf point to start from, and where to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin import OdeModel, find_equilibrium, find_orbit


@dataclass(frozen=True)
class OdeCase:
    """A branch of orbits.

    Attributes:
        name: of the model.
        start: gives what is followed: an orbit, or a Hopf point.
        parameter, to: and how far.
        aim: units a point.
        longest: step of AUTO.
    """

    name: str
    model: Callable[[], OdeModel]
    start: Callable[[OdeModel], Any]
    parameter: str
    to: float
    aim: float
    longest: float = 0.5


def symbols(names: str) -> list[ca.SX]:
    return [ca.SX.sym(name) for name in names.split()]


def model(name: str, states: list[ca.SX], rhs: list[Any], parameter: ca.SX) -> OdeModel:
    return OdeModel(name, ca.vertcat(*states), ca.vertcat(*rhs), parameter)


def hopf_of(model: OdeModel, guess: list[float], start: float, to: float, which: int = 0, **others: float) -> Any:
    """A Hopf point on the branch of equilibria in the first parameter."""
    name = model.parameter_names[0]
    branch = find_equilibrium(model, guess, parameters={name: start, **others}).follow(name, to)
    return [point for point in branch.special_points if point.kind == "hopf"][which]


def van_der_pol() -> OdeModel:
    x, y, mu = symbols("x y mu")
    return model("van der Pol", [x, y], [y, mu * (1 - x**2) * y - x], mu)


def fitzhugh_nagumo() -> OdeModel:
    v, w, current = symbols("v w I")
    return model("FitzHugh-Nagumo", [v, w], [v - v**3 / 3 - w + current, 0.08 * (v + 0.7 - 0.8 * w)], current)


def canard() -> OdeModel:
    """FitzHugh and Nagumo's equations with eps = 0.01, whose orbits explode in a canard."""
    x, y, a = symbols("x y a")
    return model("canard", [x, y], [(y - x**3 / 3 + x) / 0.01, a - x], a)


def lure() -> OdeModel:
    x, y, z, alpha = symbols("x y z alpha")
    return model("Lur'e", [x, y, z], [y, z, -alpha * z - y - x + x**2], alpha)


def langford() -> OdeModel:
    x, y, z, rho = symbols("x1 x2 x3 rho")
    rhs = [(z - 0.7) * x - 3.5 * y, 3.5 * x + (z - 0.7) * y, 0.6 + z - z**3 / 3 - (x**2 + y**2) * (1 + rho * z)]
    return model("Langford", [x, y, z], rhs, rho)


def lorenz() -> OdeModel:
    x, y, z, r = symbols("x y z r")
    return model("Lorenz", [x, y, z], [10 * (y - x), r * x - y - x * z, x * y - 8 / 3 * z], r)


def hodgkin_huxley() -> OdeModel:
    """In the units of 1952, the potential from rest."""
    v, m, h, n, current = symbols("v m h n I")

    def gate(name: ca.SX, opens: ca.SX, closes: ca.SX) -> ca.SX:
        return opens * (1 - name) - closes * name

    membrane = current - 120 * m**3 * h * (v - 115) - 36 * n**4 * (v + 12) - 0.3 * (v - 10.599)
    m_opens = 0.1 * (25 - v) / (ca.exp((25 - v) / 10) - 1)
    n_opens = 0.01 * (10 - v) / (ca.exp((10 - v) / 10) - 1)
    gates = [
        gate(m, m_opens, 4 * ca.exp(-v / 18)),
        gate(h, 0.07 * ca.exp(-v / 20), 1 / (ca.exp((30 - v) / 10) + 1)),
        gate(n, n_opens, 0.125 * ca.exp(-v / 80)),
    ]
    return model("Hodgkin-Huxley", [v, m, h, n], [membrane, *gates], current)


def three_van_der_pol() -> OdeModel:
    x, y, mu = [ca.SX.sym(f"x{i}") for i in range(3)], [ca.SX.sym(f"y{i}") for i in range(3)], ca.SX.sym("mu")
    squares = (1.0, 1.02, 0.97)
    pushes = [
        mu * (1 - x[i] ** 2) * y[i] - squares[i] * x[i] + 0.3 * (x[(i + 1) % 3] - 2 * x[i] + x[i - 1]) for i in range(3)
    ]
    return model("three van der Pol", [*x, *y], [*y, *pushes], mu)


def autocatalator() -> OdeModel:
    """Petrov, Scott and Showalter (1992), as BifurcationKit has it."""
    a, b, c, mu = symbols("a b c mu")
    return model(
        "autocatalator", [a, b, c], [mu * (65 + c) - a * b**2 - a, (a * b**2 + a - b) / 5e-3, (b - c) / 2e-2], mu
    )


def neuron() -> OdeModel:
    """Hindmarsh and Rose (1984)."""
    x, y, z, current = symbols("x y z I")
    return model(
        "neuron", [x, y, z], [y - x**3 + 3 * x**2 - z + current, 1 - 5 * x**2 - y, 6e-3 * (4 * x + 6.4 - z)], current
    )


def synapses() -> OdeModel:
    """Tsodyks and Markram's, as in Cortes et al. (2013)."""
    E, x, u, E0 = symbols("E x u E0")
    rate = 1.5 * ca.log(1 + ca.exp((3.07 * u * x * E + E0) / 1.5))
    rhs = [(rate - E) / 0.013, (1 - x) / 0.2 - u * x * E, (0.3 - u) / 1.5 + 0.3 * (1 - u) * E]
    return model("synapses", [E, x, u], rhs, E0)


def morris_lecar() -> OdeModel:
    """Morris and Lecar (1981), with the constants of their Hopf points; phi is the rate of the potassium channel."""
    v, w, current, phi = symbols("v w I phi")
    opens, rests = (1 + ca.tanh((v + 1.2) / 18)) / 2, (1 + ca.tanh((v - 2) / 30)) / 2
    membrane = (current - 4.4 * opens * (v - 120) - 8 * w * (v + 84) - 2 * (v + 60)) / 20
    gate = phi * (rests - w) * ca.cosh((v - 2) / 60)
    return model("Morris-Lecar", [v, w], [membrane, gate], ca.vertcat(current, phi))


def brusselator(cells: int) -> OdeModel:
    """Reaction and diffusion on an interval whose ends are held at (2, B/2)."""
    u, v, B = ca.SX.sym("u", cells), ca.SX.sym("v", cells), ca.SX.sym("B")
    rates = (cells + 1) ** 2 * np.array([8e-3, 4e-3])

    def spread(x: ca.SX, end: Any) -> ca.SX:
        return ca.vertcat(end, x[:-1]) + ca.vertcat(x[1:], end) - 2 * x

    f = 2 - (B + 1) * u + u**2 * v + rates[0] * spread(u, 2.0)
    g = B * u - u**2 * v + rates[1] * spread(v, B / 2)
    return OdeModel("Brusselator", ca.vertcat(u, v), ca.vertcat(f, g), B)


def detuned_ring(units: int) -> OdeModel:
    """Oscillators of van der Pol, each with a frequency of its own, coupled to those beside them."""
    x, y = ca.SX.sym("x", units), ca.SX.sym("y", units)
    beside = ca.vertcat(x[-1], x[:-1]) + ca.vertcat(x[1:], x[0]) - 2 * x
    squares = 1.0 + 0.001 * np.random.default_rng(1).normal(size=units)
    return OdeModel("ring", ca.vertcat(x, y), ca.vertcat(y, 0.5 * (1 - x**2) * y - squares * x + 0.1 * beside))


def circle(model: OdeModel, radius: float, period: float, start: float, copies: int = 1) -> Any:
    """The orbit near a circle in the first states and the second ones."""
    (name,), w = model.parameter_names, 2 * np.pi / period

    def guess(t: float) -> list[float]:
        return [radius * np.cos(w * t)] * copies + [-radius * np.sin(w * t)] * copies

    return find_orbit(model, guess, period, parameters={name: start})


def around_langford(model: OdeModel) -> Any:
    def guess(t: float) -> list[float]:
        return [0.7 * np.cos(3.5 * t), 0.7 * np.sin(3.5 * t), 0.7]

    return find_orbit(model, guess, 2 * np.pi / 3.5, parameters={"rho": 0.3})


SMALL = (
    OdeCase("van der Pol", van_der_pol, lambda m: circle(m, 2.0, 6.6, 1.0), "mu", 5.0, 10.0),
    OdeCase("FitzHugh-Nagumo", fitzhugh_nagumo, lambda m: hopf_of(m, [-1.2, -0.6], 0.0, 2.0), "I", 1.0, 10.0),
    OdeCase("Lur'e", lure, lambda m: hopf_of(m, [0.0] * 3, 2.0, 0.5), "alpha", 0.65, 10.0),
    OdeCase("Langford", langford, around_langford, "rho", 0.8, 10.0),
    OdeCase("Lorenz", lorenz, lambda m: hopf_of(m, [7.1, 7.1, 19.0], 20.0, 28.0), "r", 18.0, 10.0),
    OdeCase(
        "Hodgkin-Huxley", hodgkin_huxley, lambda m: hopf_of(m, [0.0, 0.05, 0.6, 0.3], 0.0, 200.0, 1), "I", 50.0, 20.0
    ),
    OdeCase("three van der Pol", three_van_der_pol, lambda m: circle(m, 2.0, 6.6, 0.5, 3), "mu", 1.2, 20.0),
)
