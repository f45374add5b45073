"""Models that are no chain of the paper, for tests of what every kind of model can do."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from casadi_skin import BoundaryValueProblem, Branch, OdeModel, Orbit, find_equilibrium, find_orbit, simulate


def lattice(name: str, sites: int, bond: float, onsite: bool, gamma: float = 0.0) -> OdeModel:
    """Sites between walls, each bond with force d + bond d^3 of its extension; onsite pendulums sin(q) or nothing.

    The neighbours' forces differ by the factors 1 - gamma and 1 + gamma. The energy is declared where they do not.
    """
    q, v, strength = ca.SX.sym("q", sites), ca.SX.sym("v", sites), ca.SX.sym("bond")
    d = ca.vertcat(q, 0) - ca.vertcat(0, q)
    force = d + strength * d**3
    potential = ca.sum1(d**2 / 2 + strength * d**4 / 4) + (ca.sum1(1 - ca.cos(q)) if onsite else 0)
    return OdeModel(
        name, q, (1 - gamma) * force[1:] - (1 + gamma) * force[:-1] - (ca.sin(q) if onsite else 0), strength, 2, v,
        reversal=(1,) * sites + (-1,) * sites, half_period=(-1,) * (2 * sites), nominal=(bond,),
        hamiltonian=ca.dot(v, v) / 2 + potential if gamma == 0 else None,
    )  # fmt: skip


def fput(sites: int = 8) -> OdeModel:
    """The FPUT-beta lattice with fixed ends."""
    return lattice("FPUT-beta", sites, 1.0, False)


def pendulums(sites: int = 5, gamma: float = 0.0) -> OdeModel:
    """Pendulums with linear bonds: forces that are no polynomials."""
    return lattice("pendulum chain", sites, 0.0, True, gamma)


def two_wells() -> OdeModel:
    """Two positions with quadratic forces: orbits have even and odd harmonics (Henon and Heiles 1964, detuned)."""
    x, y, u, w = (ca.SX.sym(name) for name in ("x", "y", "u", "w"))
    energy = (u**2 + w**2 + x**2 + 1.44 * y**2) / 2 + x**2 * y - y**3 / 3
    force = -ca.vertcat(x + 2 * x * y, 1.44 * y + x**2 - y**2)
    signs = (1, 1, -1, -1)
    return OdeModel(
        "Henon-Heiles", ca.vertcat(x, y), force, order=2, velocity=ca.vertcat(u, w), reversal=signs, hamiltonian=energy
    )


def duffing() -> OdeModel:
    """A damped and driven oscillator with a cubic force."""
    q, v, omega, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "t"))
    rhs = ca.vertcat(v, -q - q**3 - 0.1 * v + 0.5 * ca.cos(omega * t))
    return OdeModel("Duffing", ca.vertcat(q, v), rhs, omega, time=t, forcing_period=2 * ca.pi / omega, nominal=(1.2,))


def forced_orbit() -> Orbit:
    """The response of the driven oscillator below its resonance."""
    model, period = duffing(), 2 * np.pi / 1.2
    settled = simulate(model, [0.0, 0.0], period * np.linspace(0.0, 30.0, 1201))
    return find_orbit(model, lambda t: settled.evaluate(29 * period + t % period), tolerance=1e-10)


def van_der_pol() -> OdeModel:
    """A self-excited oscillator."""
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    return OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu, nominal=(1.0,))


def oscillation(mu: float = 1.0, **options: Any) -> Orbit:
    """The limit cycle of van der Pol from a circle."""
    guess = lambda t: [2 * np.cos(t), -2 * np.sin(t)]  # noqa: E731
    return find_orbit(van_der_pol(), guess, 6.6, parameters={"mu": mu}, **options)


def bratu(lam: float, **options: Any) -> BoundaryValueProblem:
    """u'' + lam exp(u) = 0 with u = 0 at both ends: two solutions up to a fold at lam = 3.513830719125162."""
    u, v, p = (ca.SX.sym(name) for name in ("u", "v", "lam"))
    model = OdeModel("Bratu", ca.vertcat(u, v), ca.vertcat(v, -p * ca.exp(u)), p)
    return BoundaryValueProblem(model, [model.start(u), model.end(u)], parameters={"lam": lam}, **options)


def limit_cycle() -> Orbit:
    """The limit cycle of van der Pol at mu = 1."""
    model = van_der_pol()
    return find_orbit(model, simulate(model, [2.0, 0.0], np.linspace(0.0, 60.0, 1201)).last_cycle(), tolerance=1e-10)


def circles(radius_squared: ca.SX, mu: ca.SX, start: float, **options: Any) -> Orbit:
    """The orbit at mu = start of a family of circles with a known radius and the frequency 1 + mu."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    growth, turn = radius_squared - x**2 - y**2, 1 + mu
    model = OdeModel("circles", ca.vertcat(x, y), ca.vertcat(growth * x - turn * y, growth * y + turn * x), mu)
    size, rate = float(ca.Function("r", [mu], [ca.sqrt(radius_squared)])(start)), 1 + start

    def guess(t: float) -> list[float]:
        return [size * np.cos(rate * t), size * np.sin(rate * t)]

    return find_orbit(model, guess, 2 * np.pi / rate, parameters={str(mu): start}, tolerance=1e-10, **options)


def wave(**options: Any) -> Branch:
    """Equilibria x = p, y = sin(3 p) up to p = 1: y turns at p = pi/6, and is 0.9999 on both sides of it."""
    x, y, p = (ca.SX.sym(name) for name in ("x", "y", "p"))
    model = OdeModel("wave", ca.vertcat(x, y), ca.vertcat(p - x, ca.sin(3 * x) - y), p)
    return find_equilibrium(model, [0.0, 0.0], parameters={"p": 0.0}).follow("p", 1.0, **options)
