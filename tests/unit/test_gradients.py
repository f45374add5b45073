"""Derivatives of located values and of quantities of orbits: closed forms, slopes of curves, differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from critical_models import across_circle, cycles_with_fold
from equilibrium_models import ab, symbols
from outputs import read_rows
from programs import Program
from small_models import forced_orbit, fput, limit_cycle

from casadi_skin import (
    Bond,
    BoundaryValueProblem,
    Chain,
    Lattice,
    OdeModel,
    Site,
    SpecialPoint,
    find_equilibrium,
    find_orbit,
    follow_family,
    run_map,
    simulate,
)
from casadi_skin.results.quantities import extremes
from casadi_skin.runs.program import main


def is_close(gradient: Any, exact: Mapping[str, float], largest: float = 1e-9) -> None:
    """The derivatives are the exact ones within their errors, which are small."""
    assert list(gradient) == list(exact)
    for name, value in exact.items():
        rounding = 4e-16 * abs(value)
        assert abs(gradient[name] - value) <= gradient.errors[name] + rounding, (name, gradient[name] - value)
        assert gradient.errors[name] <= largest * max(1.0, abs(value)), (name, gradient.errors[name])


def by_differences(located: Callable[..., float], values: Mapping[str, float], name: str, step: float) -> float:
    """The fourth-order central difference of a located value."""
    a, b, c, d = (located(**{**values, name: values[name] + k * step}) for k in (1.0, -1.0, 2.0, -2.0))
    return (8.0 * (a - b) - (c - d)) / (12.0 * step)


# Special points of equilibria -----------------------------------------------------------------------------------------


def lorenz(units: tuple[float, ...] = (1.0, 1.0, 1.0), parameter: float = 1.0) -> Any:
    """The first Hopf point of Lorenz' equations in r, states in other units, sigma in units of `parameter`."""
    x, y, z, r, sigma, beta = symbols("x y z r sigma beta")
    u, v, w = (unit * one for unit, one in zip(units, (x, y, z), strict=True))
    s = parameter * sigma
    rates = [s * (v - u), r * u - v - u * w, u * v - beta * w]
    rhs = ca.vertcat(*(rate / unit for rate, unit in zip(rates, units, strict=True)))
    model = OdeModel("Lorenz", ca.vertcat(x, y, z), rhs, ca.vertcat(r, sigma, beta))
    values = {"r": 20.0, "sigma": 10.0 / parameter, "beta": 8.0 / 3.0}
    rest = np.array([np.sqrt(19.0 * 8.0 / 3.0)] * 2 + [19.0]) / units
    return find_equilibrium(model, rest, parameters=values).follow("r", 28.0).special_points[0]


LORENZ = {"sigma": 0.146814404432134, "beta": 5.484764542936286}


def test_the_hopf_point_of_lorenz_equations_moves_as_in_closed_form() -> None:
    """r = sigma (sigma + beta + 3) / (sigma - beta - 1)."""
    found = lorenz().gradient()
    is_close(found, LORENZ, largest=1e-11)
    assert found.held == "all parameters but r, and the kind of the point"
    assert found.value == pytest.approx(24.736842105263158, abs=1e-12)
    alone = lorenz().gradient(errors=False)
    assert dict(alone) == pytest.approx(LORENZ, rel=1e-12)
    assert list(alone.errors.values()) == [np.inf, np.inf]


def test_the_spread_is_that_of_the_gradient() -> None:
    found = lorenz().gradient()
    deviations = {"sigma": 0.1, "beta": 0.01}
    known = np.hypot(0.1 * LORENZ["sigma"], 0.01 * LORENZ["beta"])
    assert found.spread(deviations) == pytest.approx(known, rel=1e-12)
    assert lorenz().spread(np.diag([0.01, 1e-4])) == pytest.approx(known, rel=1e-12)
    both = np.array([[0.01, 1e-3], [1e-3, 1e-4]])  # fully correlated: deviations add
    assert found.spread(both) == pytest.approx(0.1 * LORENZ["sigma"] + 0.01 * LORENZ["beta"], rel=1e-12)
    with pytest.raises(ValueError, match="covariance: given 'rho'"):
        found.spread({"rho": 1.0})
    with pytest.raises(ValueError, match=r"accepted: a symmetric matrix of shape \(2, 2\)"):
        found.spread(np.eye(3))
    tiny = np.diag([1e-24, 1e-30]) + 1e-25 * np.eye(2, k=1)
    nones = {"sigma": -0.1}, [[-1.0, 0.0], [0.0, 1.0]], [[1.0, 2.0], [2.0, 1.0]], [[1.0, 2.0], [3.0, 4.0]], tiny
    for none in nones:
        with pytest.raises(ValueError, match=r"covariance: given .*, which is none; accepted: a symmetric"):
            found.spread(none)
    for none, error in (({"sigma": np.inf}, ValueError), ({"sigma": "x"}, TypeError), ([[1j, 0], [0, 1]], TypeError)):
        with pytest.raises(error, match=r"^covariance.*accepted: (a )?finite number"):
            found.spread(none)


@pytest.mark.slow
def test_folds_and_hopf_points_of_a_reaction_move_along_their_curves_and_as_differences_say() -> None:
    values = {"p2": 14.0, "p3": 2.0}

    def located(which: int, **parameters: float) -> float:
        start = find_equilibrium(ab(), [0, 0], parameters={"p": 0.0, **parameters})
        return float(start.follow("p", 0.2).special_points[which].parameters["p"])

    points = find_equilibrium(ab(), [0, 0]).follow("p", 0.2).special_points
    for which in (0, 2):
        found = points[which].gradient()
        for name in values:
            known = by_differences(lambda which=which, **given: located(which, **given), values, name, 1e-3)
            assert found[name] == pytest.approx(known, rel=1e-9)
        curve = points[which].curve("p2", 14.2)
        start = curve.solutions[0]
        assert start.gradient("p")["p2"] == pytest.approx(found["p2"], rel=1e-11)


class Planted:
    """A system seen through random coordinates, whose special equilibrium is at p = h(q), a random polynomial.

    Its block has the normal form of a fold, a branch point or a Hopf point; others decay.
    """

    def __init__(self, seed: int) -> None:
        generator = np.random.default_rng(seed)
        self.kind = ("fold", "branch point", "hopf")[seed % 3]
        n, m = int(generator.integers(2, 6)), int(generator.integers(1, 4))
        p, x, q = ca.SX.sym("p"), ca.SX.sym("x", n), ca.vertcat(*(ca.SX.sym(f"q{k}") for k in range(m)))
        self.names, self.at = [f"q{k}" for k in range(m)], generator.normal(size=m)
        a, b, c = generator.normal(size=m), generator.normal(size=(m, m)), generator.normal(size=n)
        place = ca.dot(a, q) + ca.bilin(ca.DM(b), q, q) / 4 + ca.sin(q[0])
        self.slopes = a + (b + b.T) @ self.at / 4 + np.eye(m)[0] * np.cos(self.at[0])
        self.place = float(ca.Function("h", [q], [place])(self.at))
        units = 10.0 ** generator.uniform(-3.0, 3.0, n)
        seen = units[:, None] * np.linalg.qr(generator.normal(size=(n, n)))[0]
        u = ca.DM(np.linalg.inv(seen)) @ x
        away = p - place
        turn = 1.0 + float(generator.uniform()) + 0.3 * ca.tanh(q[0])
        decay = [-(1.0 + abs(c[k])) * u[k] + 0.3 * u[0] ** 2 + 0.2 * u[k] * u[0] for k in range(n)]
        if self.kind == "hopf":
            s = u[0] ** 2 + u[1] ** 2
            own = [(away - s) * u[0] - turn * u[1], turn * u[0] + (away - s) * u[1]]
        else:
            own = [away - u[0] ** 2 if self.kind == "fold" else away * u[0] - u[0] ** 3]
        rates = ca.vertcat(*own, *decay[len(own) :])
        self.model = OdeModel("planted", x, ca.DM(seen) @ rates, ca.vertcat(p, q))
        self.start = self.place + (0.4 if self.kind == "fold" else -0.4)
        rest = seen @ np.eye(n)[0] * np.sqrt(0.4) if self.kind == "fold" else np.zeros(n)
        self.equilibrium = find_equilibrium(
            self.model, rest, parameters={"p": self.start, **dict(zip(self.names, self.at, strict=True))}
        )

    def point(self) -> Any:
        to = self.place + (-0.3 if self.kind == "fold" else 0.4)
        found = [one for one in self.equilibrium.follow("p", to).special_points if one.kind == self.kind]
        return found[0]


@pytest.mark.parametrize("part", [0, *(pytest.param(part, marks=pytest.mark.slow) for part in (1, 2, 3))])
def test_errors_of_a_hundred_planted_points_are_never_below_the_truth(part: int) -> None:
    for seed in range(25 * part, 25 * part + 25):
        planted = Planted(seed)
        is_close(planted.point().gradient(), dict(zip(planted.names, planted.slopes, strict=True)), largest=1e-8)


# Special points of orbits ---------------------------------------------------------------------------------------------


def circle(model: OdeModel, size: int, **parameters: float) -> Any:
    guess = lambda t: [np.cos(t), np.sin(t), *[0.0] * (size - 2)]  # noqa: E731
    return find_orbit(model, guess, 2.0 * np.pi, parameters=parameters, corrector="newton", tolerance=1e-10)


def test_a_fold_of_cycles_moves_as_in_closed_form() -> None:
    """mu = -a^2/4."""
    model = cycles_with_fold()
    r = np.sqrt((1.0 + np.sqrt(1.4)) / 2.0)
    guess = lambda t: [r * np.cos(t), r * np.sin(t)]  # noqa: E731
    orbit = find_orbit(model, guess, 2 * np.pi, parameters={"mu": 0.1, "a": 1.0}, tolerance=1e-10)
    branch = orbit.follow("mu", -0.3, until=lambda one: one.point.special == "fold")
    is_close(branch.special_points[-1].gradient(), {"a": -0.5}, largest=1e-10)


def test_a_period_doubling_moves_as_in_closed_form() -> None:
    """a = k^2 + sin k, on a band of Moebius."""
    rates = lambda xi, eta, a, k: (-xi + 0.5 * xi * eta**2, (a - k**2 - ca.sin(k)) * eta - eta**3)  # noqa: E731
    k = 0.4
    branch = circle(across_circle(rates, half=True), 3, a=-0.3, k=k).follow("a", 1.0, stability=True)
    point = next(one for one in branch.special_points if one.kind == "period doubling")
    found = point.gradient()
    is_close(found, {"k": 2.0 * k + np.cos(k)}, largest=1e-9)
    curve = point.curve("k", 0.5)
    assert curve.solutions[0].gradient("a")["k"] == pytest.approx(found["k"], rel=1e-10)


def turning(extra: bool = False) -> OdeModel:
    """The circle with a pair that turns beside it: a torus at a = k^2 + 0.1 k, a branch point at a = 0.5 + k."""
    x, y, z, u, v, a, k, e = symbols("x y z u v a k e")
    growth, rate = 1 - x**2 - y**2, a - k**2 - 0.1 * k - u**2 - v**2
    turn = 0.3 + 0.2 * k * x
    rhs = [growth * x - (1 + k * z) * y, growth * y + (1 + k * z) * x, (a - 0.5 - k) * z - z**3 + e]
    rhs += [rate * u - turn * v, turn * u + rate * v]
    return OdeModel("turning", ca.vertcat(x, y, z, u, v), ca.vertcat(*rhs), ca.vertcat(a, k, e))


def test_a_torus_and_a_branch_point_of_cycles_move_as_in_closed_form() -> None:
    branch = circle(turning(), 5, a=-0.3, k=0.2, e=0.0).follow("a", 1.0, stability=True)
    torus, other = (next(p for p in branch.special_points if p.kind == kind) for kind in ("torus", "branch point"))
    is_close(torus.gradient(), {"k": 0.5, "e": 0.0}, largest=1e-8)
    found = other.gradient()
    assert abs(found["k"] - 1.0) <= found.errors["k"] < 1e-9
    assert np.isnan(found["e"])


def planted_cycle(seed: int) -> tuple[Any, dict[str, float]]:
    """The torus or the branch point of a circle seen through random coordinates at l = h(q, r), and dh/dq and dh/dr."""
    generator = np.random.default_rng(seed)
    turn = float(generator.uniform(0.1, 0.9)) if seed % 2 else 0.0
    n = 5 if turn else 4
    x, (value, q, r) = ca.vertcat(*(ca.SX.sym(f"x{k}") for k in range(n))), symbols("l q r")
    seen = 10.0 ** generator.uniform(-2, 2, n)[:, None] * np.linalg.qr(generator.normal(size=(n, n)))[0]
    u, a, (q0, r0) = ca.DM(np.linalg.inv(seen)) @ x, generator.normal(size=3), generator.uniform(-0.3, 0.3, 2)
    place = lambda q, r, sin: 0.5 + a[0] * q + a[1] * q * r + a[2] * sin(r)  # noqa: E731
    square, speed = u[0] ** 2 + u[1] ** 2, 1 + 0.3 * r
    growth = value - place(q, r, ca.sin) + 0.2 * u[0] * q
    rates = [u[0] * (1 - square) - speed * u[1], u[1] * (1 - square) + speed * u[0]]
    if turn:
        s = u[2] ** 2 + u[3] ** 2
        rates += [(growth - s) * u[2] - turn * u[3], turn * u[2] + (growth - s) * u[3]]
    else:
        rates.append(growth * u[2] - u[2] ** 3)
    rates.append(-u[n - 1] * (1.2 + 0.3 * u[0]))
    model = OdeModel("planted", x, ca.DM(seen) @ ca.vertcat(*rates), ca.vertcat(value, q, r))
    at, w = place(q0, r0, np.sin), 1 + 0.3 * r0
    guess = lambda t: seen[:, :2] @ [np.cos(w * t), np.sin(w * t)]  # noqa: E731
    orbit = find_orbit(model, guess, 2 * np.pi / w, parameters={"l": at - 0.15, "q": q0, "r": r0}, tolerance=1e-8)
    kind = "torus" if turn else "branch point"
    point = next(p for p in orbit.follow("l", at + 0.2, stability=True).special_points if p.kind == kind)
    return point, {"q": a[0] + a[1] * r0, "r": a[1] * q0 + a[2] * np.cos(r0)}


@pytest.mark.slow
def test_errors_of_planted_points_of_cycles_are_never_below_the_truth() -> None:
    for seed in range(24):
        point, exact = planted_cycle(seed)
        is_close(point.gradient(), exact, largest=1e-8)


def langford(**given: float) -> Any:
    """The torus of Langford's equations in rho, which are not symmetric under rotations."""
    x, y, z, rho, c, w = symbols("x y z rho c w")
    slow = 0.6 + z - z**3 / 3 - (x**2 + y**2) * (1 + rho * z) + 0.1 * z * x**3
    rhs = [(z - c) * x - w * y + 0.1 * z**2, w * x + (z - c) * y, slow]
    model = OdeModel("Langford", ca.vertcat(x, y, z), ca.vertcat(*rhs), ca.vertcat(rho, c, w))
    guess = lambda t: [0.7 * np.cos(3.5 * t), 0.7 * np.sin(3.5 * t), 0.7]  # noqa: E731
    values = {"rho": 0.3, "c": 0.7, "w": 3.5, **given}
    branch = find_orbit(model, guess, 2 * np.pi / 3.5, parameters=values).follow("rho", 0.8, stability=True)
    return next(point for point in branch.special_points if point.kind == "torus")


@pytest.mark.slow
def test_the_torus_of_langfords_equations_moves_along_its_curve_and_as_differences_say() -> None:
    point, values = langford(), {"c": 0.7, "w": 3.5}
    found = point.gradient()
    for name in values:
        place = lambda **given: float(langford(**given).parameters["rho"])  # noqa: E731
        known = by_differences(place, values, name, 5e-3 * values[name])
        assert found[name] == pytest.approx(known, rel=1e-6, abs=1e-8)
    curve = point.curve("c", 0.72)
    assert curve.solutions[0].gradient("rho")["c"] == pytest.approx(found["c"], rel=1e-8)


def loop() -> Any:
    """A cycle on H = (p - q^2)/2, born at a Hopf point at p = q^2 - 1/3, which ends at a homoclinic one at q^2."""
    x, y, p, q, s = symbols("x y p q s")
    u = x - s
    H = y**2 / 2 - u**2 / 2 + u**3 / 3
    rhs = ca.vertcat(y, u - u**2 + (p - q**2 - 2 * H) * y)
    model = OdeModel("loop", ca.vertcat(x, y), rhs, ca.vertcat(p, q, s))
    values = {"p": -0.11, "q": 0.3, "s": 0.1}
    settled = simulate(model, [1.1, 0.05], np.linspace(0.0, 400.0, 8001), parameters=values)
    return find_orbit(model, settled.last_cycle(), parameters=values, tolerance=1e-9)


def test_ends_of_branches_of_orbits_move_as_in_closed_form() -> None:
    orbit = loop()
    for to, kind in ((0.3, "homoclinic"), (-0.4, "hopf")):
        end = orbit.follow("p", to).special_points[-1]
        assert end.kind == kind
        is_close(end.gradient(), {"q": 0.6, "s": 0.0}, largest=1e-12)


@pytest.mark.slow
def test_the_homoclinic_orbit_of_lorenz_equations_moves_as_differences_say() -> None:
    def end(**given: float) -> Any:
        x, y, z, r, sigma, beta = symbols("x y z r sigma beta")
        rhs = ca.vertcat(sigma * (y - x), r * x - y - x * z, x * y - beta * z)
        model = OdeModel("Lorenz", ca.vertcat(x, y, z), rhs, ca.vertcat(r, sigma, beta))
        values = {"r": 20.0, "sigma": 10.0, "beta": 8.0 / 3.0, **given}
        rest = [np.sqrt(19.0 * values["beta"])] * 2 + [19.0]
        hopf = find_equilibrium(model, rest, parameters=values).follow("r", 28.0).special_points[0]
        return hopf.follow("r", 10.0).special_points[-1]

    found, values = end().gradient(), {"sigma": 10.0, "beta": 8.0 / 3.0}
    for name, value in values.items():
        known = by_differences(lambda **given: float(end(**given).parameters["r"]), values, name, 1e-2 * value)
        assert abs(found[name] - known) <= found.errors[name] < 1e-4


def as_program(model: OdeModel) -> tuple[OdeModel, Program]:
    """The same model with its equations out of CasADi's sight, their first derivatives known; and these, to be kept."""
    field = Program(ca.Function("field", [model.state, model.parameters], [ca.densify(model.rhs)]), 1)
    x, p = ca.MX.sym("x", model.size), ca.MX.sym("p", len(model.parameter_names))
    named = {"state_labels": model.state_names, "parameter_labels": model.parameter_names}
    return OdeModel(model.name, x, field(x, p), p, nominal=model.nominal, **named), field


def test_special_points_of_a_program_move_as_those_of_its_equations_within_their_errors() -> None:
    """Second derivatives are differences of its first ones."""
    model, _kept = as_program(ab())
    exact = find_equilibrium(ab(), [0, 0]).follow("p", 0.2).special_points
    found = find_equilibrium(model, [0, 0]).follow("p", 0.2).special_points
    for point, other in zip(found, exact, strict=True):
        is_close(point.gradient(), dict(other.gradient()), largest=1e-8)
    model, _kept = as_program(cycles_with_fold())
    r = np.sqrt((1.0 + np.sqrt(1.4)) / 2.0)
    guess = lambda t: [r * np.cos(t), r * np.sin(t)]  # noqa: E731
    orbit = find_orbit(model, guess, 2 * np.pi, parameters={"mu": 0.1, "a": 1.0}, corrector="newton", tolerance=1e-8)
    is_close(orbit.gradient("x_max"), {"mu": 0.5 / r / np.sqrt(1.4), "a": 0.5 * r / np.sqrt(1.4)}, largest=1e-7)
    branch = orbit.follow("mu", -0.3, until=lambda one: one.point.special == "fold")
    is_close(branch.special_points[-1].gradient(), {"a": -0.5}, largest=1e-6)


# Edges of tongues -----------------------------------------------------------------------------------------------------


def curved(edge: Any, name: str, step: float) -> float:
    """The derivative of S along curves of an edge, by differences of fourth order."""
    start = edge.parameters[name]
    return by_differences(lambda value: float(edge.curve(name, value).S[-1]), {"value": start}, "value", step)


@pytest.mark.parametrize("number", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_edges_of_tongues_move_along_their_curves_and_scale_with_the_cubic_force(number: int) -> None:
    """S is proportional to 1/|g|. A multiplier is 1 at the first edge of eight sites, two meet at the third."""
    edge = follow_family(Chain(8, 1.0, 0.2, -1.0), 1, 1.0, stability=True, tolerance=1e-9).edge(number)
    found, alone = edge.gradient(), edge.gradient(errors=False)
    assert list(found) == ["alpha", "gamma", "g"]
    assert abs(found["g"] - edge.parameters["S"]) <= found.errors["g"] + edge.error < 1e-9
    assert found["gamma"] == pytest.approx(curved(edge, "gamma", 2e-4), abs=1e-5)
    assert max(found.errors.values()) < 1e-8
    assert dict(alone) == pytest.approx(dict(found), rel=1e-8)
    assert set(alone.errors.values()) == {np.inf}


def ring(sites: int) -> Lattice:
    """A ring whose sites all move alike in its first mode, whose bonds then do nothing."""
    declared = [Site("a", onsite="a*y + c*y^3")], [Bond("a", "a", [1], "d + b*d^3")]
    return Lattice([sites], *declared, "periodic", {"a": 0.3, "b": 1.0, "c": 0.2})


def test_an_edge_of_two_equal_multipliers_is_that_of_lame_in_closed_form() -> None:
    """w'' + (1 + 4 m + 1/(a + c A^2) - 6 m sn^2) w = 0 of waves of the ring with 4 sin^2(k/2) = 1, 6 A^2 = S.

    With m = c A^2/(2 (a + c A^2)) an end of its bands is at 4 + m: 1 = 3 a + 3 c A^2/2.
    """
    edge = follow_family(ring(6), 1, 3.0, stability=True, tolerance=1e-9).edge(1)
    found = edge.gradient()
    assert edge.parameters["S"] == pytest.approx(6 * (1 - 0.9) / 0.3, rel=1e-10)
    is_close(found, {"a": -60.0, "b": 0.0, "c": -10.0}, largest=1e-10)


@pytest.mark.slow
def test_an_edge_at_which_a_branch_of_the_same_class_crosses_is_interpolated() -> None:
    """The mode of alternate sites of a ring of eight has orbits of less symmetry at the edge, at any b."""
    edge = follow_family(ring(8), 8, 1.0, stability=True, tolerance=1e-9).edge(0)
    found = edge.gradient()
    assert found["b"] == pytest.approx(curved(edge, "b", 0.02), rel=1e-6)
    # in other units of displacement b and c change together: S is proportional to their inverse
    assert -edge.parameters["S"] == pytest.approx(found["b"] + 0.2 * found["c"], abs=1e-9)
    assert max(found.errors.values()) < 1e-9


@pytest.mark.slow
def test_the_edge_at_an_extremum_of_the_energy_is_that_of_families_beside_it() -> None:
    """The first edge of 24 sites is where the trivial multiplier meets another, in one Jordan block."""
    edge = follow_family(Chain(24, 1.0, 0.25, -1.0), 1, 0.5, stability=True, tolerance=1e-9).edge(0)
    found = edge.gradient()
    assert abs(found["g"] - edge.parameters["S"]) <= found.errors["g"] + edge.error < 1e-11

    def place(alpha: float, gamma: float) -> float:
        beside = follow_family(Chain(24, alpha, gamma, -1.0), 1, 0.45, stability=True, tolerance=1e-9)
        return min((change.value for change in beside.changes), key=lambda S: abs(S - 0.4317445))

    for name in ("alpha", "gamma"):
        known = by_differences(place, {"alpha": 1.0, "gamma": 0.25}, name, 2e-4)
        assert found[name] == pytest.approx(known, abs=1e-8)
    assert max(found.errors.values()) < 1e-9


def three_oscillators() -> OdeModel:
    """Reversible, but of no potential; two multipliers meet in the second family."""
    x, y, w, u, v, s, k, c, a = symbols("x y w u v s k c a")
    forces = (
        -x - c * (x - y),
        -1.3 * y - c * (y - x) * (1 + a * x**2) - c * (y - w),
        -1.7 * w - c * (w - y) + a * y**2 * w,
    )
    rhs = ca.vertcat(*(force - k * q**3 for force, q in zip(forces, (x, y, w), strict=True)))
    signs: dict[str, Any] = {"reversal": (1, 1, 1, -1, -1, -1), "half_period": (-1,) * 6}
    state, velocity, parameters = ca.vertcat(x, y, w), ca.vertcat(u, v, s), ca.vertcat(k, c, a)
    return OdeModel("three", state, rhs, parameters, 2, velocity, nominal=(-0.7, 0.3, 0.4), **signs)


def two_springs() -> OdeModel:
    """Even and odd forces, so half of the period is solved for: the period doubles at the edge of the first family."""
    x, y, u, v, k, c, a = symbols("x y u v k c a")
    forces = -x - a * x**2 - k * x**3 - c * (x - y), -1.3 * y - a * y**2 - k * y**3 - c * (y - x)
    signs: dict[str, Any] = {"reversal": (1, 1, -1, -1), "nominal": (-0.7, 0.15, 0.2)}
    return OdeModel("two", ca.vertcat(x, y), ca.vertcat(*forces), ca.vertcat(k, c, a), 2, ca.vertcat(u, v), **signs)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "mode", "to", "further"),
    [
        (three_oscillators(), 2, 1.2, None), (two_springs(), 1, 0.8, None),
        (Chain(4, 0.5, 0.38, 1.0), 2, 1.0, None), (Chain(5, 0.5, 0.2, -1.0), 1, 1.1, 0.968627),
    ],
    ids=["no potential", "doubling", "backwards", "1:3 resonance"],
)  # fmt: skip
def test_edges_of_every_kind_move_along_their_curves(model: Any, mode: int, to: float, further: float | None) -> None:
    branch = follow_family(model, mode, to, stability=True, tolerance=1e-9)
    places = [] if further is None else [abs(one.S - further) for one in branch.stability_diagram.further]
    edge = branch.edge(int(np.argmin(places)), further=True) if places else branch.edge(0)
    found = edge.gradient()
    for name, value in found.items():
        known = curved(edge, name, 1e-3 * edge.parameters[name])
        assert value == pytest.approx(known, abs=found.errors[name] + 1e-6 * abs(value) + 1e-7), name
        assert found.errors[name] < 1e-9, name


@pytest.mark.slow
def test_thresholds_of_long_chains_move_as_polynomials_through_them_do() -> None:
    """The chain of the opposite gamma is the mirror image."""
    chain = Chain(24, 1.0, 0.4, 2.0)
    found, mirrored = (one.threshold_gradient() for one in (chain, Chain(24, 1.0, -0.4, 2.0)))
    assert found.value == chain.threshold()
    assert found["g"] == pytest.approx(-found.value / 2.0, rel=1e-12)
    assert abs(found["gamma"] + mirrored["gamma"]) <= found.errors["gamma"] + mirrored.errors["gamma"] < 1e-11
    assert abs(found["alpha"] - mirrored["alpha"]) <= found.errors["alpha"] + mirrored.errors["alpha"] < 1e-11
    for name, chains in {
        "alpha": lambda alpha: Chain(24, alpha, 0.4, 2.0), "gamma": lambda gamma: Chain(24, 1.0, gamma, 2.0)
    }.items():  # fmt: skip
        place, way = getattr(chain, name), 0.04
        nodes = np.polynomial.chebyshev.chebpts1(11)
        values = [chains(place + way * x).threshold() for x in nodes]
        series = np.polynomial.Chebyshev.fit(nodes, values, 10, domain=[-1, 1])
        assert found[name] == pytest.approx(float(series.deriv()(0.0)) / way, abs=1e-10)


def test_a_scene_writes_the_derivatives_of_its_special_points(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    tables = "[chain]\nsites = 8\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n[family]\nmode = 1\namplitude_max = 0.3\n"
    scene.write_text(f"{tables}[stability]\ngradient = true\n", encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    rows = read_rows(tmp_path / "out" / "gradient.csv")
    assert [row["parameter"] for row in rows] == ["alpha", "gamma", "g"] * 2
    for row in rows[2::3]:
        assert abs(float(row["derivative"]) - float(row["value"])) <= float(row["error"]) < 1e-8
    scene.write_text(f"{tables}[stability]\ngradient = 3\n", encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "other"), "--quiet"]) == 2


MODEL = """import casadi as ca
from casadi_skin import OdeModel
x, p, a = (ca.SX.sym(name) for name in ("x", "p", "a"))
cubic = OdeModel("cubic", x, p - a * x + x**3, ca.vertcat(p, a), nominal=(3.0, 1.2))
"""


@pytest.mark.slow
def test_maps_have_the_derivatives_of_what_is_located(tmp_path: Path) -> None:
    """The first instability of a chain scales as 1/|g|; the folds of a cubic are at p = a x - x^3, x^2 = a/3."""
    tables = "[chain]\nsites = 8\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n[family]\nmode = 1\namplitude_max = 0.3\n"
    map_table = '[map]\ngamma = [0.25]\nquantities = ["first_instability", "first_instability_by_g"]\n'
    scene = tmp_path / "chain.toml"
    scene.write_text(f"{tables}[stability]\ngradient = true\n{map_table}", encoding="utf-8")
    found = run_map(scene, tmp_path / "chain", quiet=True)
    assert found["first_instability_by_g"] == pytest.approx(found["first_instability"], abs=1e-9)
    scene.write_text(scene.read_text(encoding="utf-8").replace('["first_instability", ', "["), encoding="utf-8")
    assert run_map(scene, tmp_path / "alone", quiet=True)["first_instability_by_g"] == found["first_instability_by_g"]
    endless = tables.replace("sites = 8", "sites = inf").replace("0.25", "0.5").replace("mode = 1", 'mode = "first"')
    map_table = '[map]\ngamma = [0.5]\nquantities = ["threshold", "threshold_by_g"]\n'
    scene.write_text(f"{endless}[stability]\ngradient = true\n{map_table}", encoding="utf-8")
    found = run_map(scene, tmp_path / "endless", quiet=True)
    assert found["threshold_by_g"] == pytest.approx(found["threshold"], rel=1e-11)
    (tmp_path / "cubic.py").write_text(MODEL, encoding="utf-8")
    model = '[model]\nfile = "cubic.py"\nname = "cubic"\n[equilibrium]\nstart = { x = -2.0 }\n'
    walk = '[continuation]\nparameter = "p"\nto = -3.0\ngradient = true\n[map]\na = [1.2, 1.5]\n'
    scene.write_text(model + walk, encoding="utf-8")
    found = run_map(scene, tmp_path / "cubic", quiet=True)
    assert found["first_fold_by_a"] == pytest.approx(-np.sqrt(found.axes["a"] / 3.0), abs=1e-10)


FAILING = """
from casadi_skin import SpecialPoint
from casadi_skin.points.gradient import gradient

def failing(point):
    if point.parameters["a"] > 1.4:
        raise ArithmeticError("its equations are singular")
    return gradient(point)

SpecialPoint.gradient = failing
"""


def test_derivatives_that_fail_are_columns_of_no_numbers_with_the_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SpecialPoint, "gradient", SpecialPoint.gradient)  # as before after the file is read here, too
    (tmp_path / "cubic.py").write_text(MODEL + FAILING, encoding="utf-8")  # in the workers, which read it
    model = '[model]\nfile = "cubic.py"\nname = "cubic"\n[equilibrium]\nstart = { x = -2.0 }\n'
    way, scene = '[continuation]\nparameter = "p"\nto = -3.0\ngradient = true\n', tmp_path / "scene.toml"
    scene.write_text(model + way + "[map]\na = [1.2, 1.5]\n", encoding="utf-8")
    found = run_map(scene, tmp_path / "both", quiet=True)
    assert np.isnan(found["first_fold_by_a"]).tolist() == [False, True]
    assert found.failures() == [("a = 1.5", "derivatives of first_fold: its equations are singular")]
    asked = '[map]\na = [1.5]\nquantities = ["first_fold_by_a", "first_fold_by_a_error", "first_hopf", "first_fold"]\n'
    scene.write_text(model + way + asked, encoding="utf-8")
    found = run_map(scene, tmp_path / "one", quiet=True)
    assert found.names == ["first_fold", "first_fold_by_a", "first_fold_by_a_error", "first_hopf"]
    assert np.isnan([found[name][0] for name in found.names[1:]]).all()
    (row,) = read_rows(tmp_path / "one" / "map.csv")
    assert row["first_fold_by_a"] == row["first_hopf"] == ""
    assert row["status"] == "ended early"
    scene.write_text(model + way + "[map]\na = [1.5]\n", encoding="utf-8")
    assert np.isnan(run_map(scene, tmp_path / "every", quiet=True)["first_fold_by_a"]).all()


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e6])
def test_a_quantity_at_its_kink_has_no_derivatives(unit: float) -> None:
    """a x = p at p = 0 and 0.3 units; a function whose derivative is continuous there has one."""
    x, p, a = symbols("x p a")
    model = OdeModel("line", x, p - a * x, ca.vertcat(p, a), nominal=(0.0, 1.0))
    rest, moved = (find_equilibrium(model, [0.1 * unit], parameters={"p": value * unit}) for value in (0.0, 0.3))
    kinks = [ca.fabs(x), ca.fmax(x, 0), ca.if_else(x > 0, x, 2 * x), ca.sqrt(x**2), ca.fabs(x - p), ca.fabs(a - 1)]
    at = [*((rest, kink) for kink in kinks), (moved, ca.fabs(x - 0.3 * unit)), (moved, ca.fmin(x, 0.3 * unit))]
    for solution, kink in at:
        with pytest.raises(ValueError, match=r"^quantity: given one with a kink at the solution; accepted: one with"):
            solution.gradient(kink)
    smooth = {x * ca.fabs(x): 0.0, x**2: 0.0, ca.fabs(x - unit): -1.0, ca.tanh(99 * x / unit): 99 / unit}
    for quantity, slope in smooth.items():
        assert rest.gradient(quantity)["p"] == pytest.approx(slope, rel=1e-12)


# Quantities of solutions ----------------------------------------------------------------------------------------------


def pendulum(amplitude: float, tolerance: float, **method: Any) -> tuple[Any, dict[str, float]]:
    """An orbit of a pendulum with the amplitude `size`, and its dT/dw and dT/dsize by elliptic integrals.

    T = 4 K(m) / sqrt(w), m = sin^2(size/2).
    """
    mpmath = pytest.importorskip("mpmath")
    mpmath.mp.dps = 40
    q, v, w, size = symbols("q v w size")
    rhs = ca.vertcat(v, -w * ca.sin(q))
    energy = v**2 / 2 - w * ca.cos(q)
    model = OdeModel("pendulum", ca.vertcat(q, v), rhs, ca.vertcat(w, size), hamiltonian=energy)

    def period(w: Any, size: Any) -> Any:
        return 4 * mpmath.ellipk(mpmath.sin(size / 2) ** 2) / mpmath.sqrt(w)

    values = {"w": 2.0, "size": amplitude}
    settled = simulate(model, [amplitude, 0.0], np.linspace(0.0, float(period(2.0, amplitude)), 401), parameters=values)
    orbit = find_orbit(
        model, settled, settled.t[-1], parameters=values, select=q - size, section=v, tolerance=tolerance, **method
    )
    at = mpmath.mpf(2), mpmath.mpf(amplitude)
    exact = [float(mpmath.diff(period, at, order)) for order in ((1, 0), (0, 1))]
    return orbit, dict(zip(("w", "size"), exact, strict=True))


def test_the_period_of_a_pendulum_is_that_of_elliptic_integrals() -> None:
    """At an amplitude that `select` holds; at a fixed period the amplitude is what moves, dq/dw = -T_w / T_q."""
    orbit, exact = pendulum(1.2, 1e-11)
    is_close(orbit.gradient("period"), exact, largest=1e-10)
    is_close(orbit.gradient("energy"), {"w": -np.cos(1.2), "size": 2.0 * np.sin(1.2)}, largest=1e-10)
    is_close(orbit.gradient("q_max"), {"w": 0.0, "size": 1.0}, largest=1e-10)
    is_close(orbit.gradient("q_min"), {"w": 0.0, "size": -1.0}, largest=1e-10)
    assert orbit.gradient("q_max", fixed="period")["w"] == pytest.approx(-exact["w"] / exact["size"], rel=1e-10)


def test_a_period_that_is_held_is_that_of_any_orbit_of_a_branch() -> None:
    """q'' = -a q - b q^3 from q = 1: inside a branch in a the quantity had been that of another a."""
    q, v, a, b = symbols("q v a b")
    energy = v**2 / 2 + a * q**2 / 2 + b * q**4 / 4
    model = OdeModel(
        "Duffing", ca.vertcat(q, v), ca.vertcat(v, -a * q - b * q**3), ca.vertcat(a, b), nominal=(1.0, 0.5),
        hamiltonian=energy,
    )  # fmt: skip
    start = find_orbit(model, lambda t: [np.cos(1.17 * t), -1.17 * np.sin(1.17 * t)], 2 * np.pi / 1.17, select=q - 1)
    for options in ({}, {"fixed": "period"}):
        orbit = start.follow("a", 1.1, at=(1.04,), **options).at(a=1.04)
        beside = [orbit.follow("a", value, fixed="period").solutions[-1] for value in (1.0399, 1.0401)]
        found = {name: orbit.gradient(name, fixed="period") for name in ("q", "energy")}
        assert found["q"].value == pytest.approx(orbit.evaluate(0.0)[0], rel=1e-12)
        assert found["energy"].value == pytest.approx(orbit.energy, rel=1e-12)
        one, other = ({"q": each.evaluate(0.0)[0], "energy": each.energy} for each in beside)
        for name, gradient in found.items():
            assert gradient["a"] == pytest.approx((other[name] - one[name]) / 2e-4, rel=1e-6)


def test_errors_of_coarse_meshes_are_never_below_the_truth() -> None:
    for amplitude in (0.5, 2.0, 3.0):
        for tolerance, degree in ((1e-2, 2), (1e-4, 3), (1e-6, 4)):
            orbit, exact = pendulum(amplitude, tolerance, degree=degree)
            is_close(orbit.gradient("period"), exact, largest=1.0)


def test_quantities_of_a_limit_cycle_are_those_of_differences() -> None:
    orbit = limit_cycle()
    model = orbit.model

    def at(name: str, mu: float) -> float:
        found = find_orbit(model, orbit, orbit.period, parameters={"mu": mu}, tolerance=1e-11)
        if name == "max_abs_multiplier":
            return float(found.floquet().max_abs_multiplier)
        return float(found.Omega) if name == "Omega" else float(found.period)

    for name in ("period", "Omega", "max_abs_multiplier"):
        known = by_differences(lambda mu, name=name: at(name, mu), {"mu": 1.0}, "mu", 2e-3)
        found = orbit.gradient(name)
        assert abs(found["mu"] - known) <= found.errors["mu"] + 1e-7 * abs(known)
    # int div dt = log mu: of van der Pol's cycle mu int (1 - x^2) dt
    assert orbit.gradient("max_abs_multiplier").value == pytest.approx(orbit.floquet().max_abs_multiplier, rel=1e-9)


def test_a_tiny_multiplier_keeps_its_digits() -> None:
    """Van der Pol's cycle at mu = 3 forgets 15 digits in a period: log of the multiplier = mu int (1 - x^2) dt."""
    orbit = limit_cycle().follow("mu", 3.1, at=[3.0]).at(mu=3.0)
    found, tiny = orbit.gradient("max_abs_multiplier"), orbit.floquet().max_abs_multiplier
    assert found.value == pytest.approx(tiny, rel=1e-9) == pytest.approx(7e-16, rel=0.01)

    def log(mu: float) -> float:
        beside = find_orbit(orbit.model, orbit, orbit.period, parameters={"mu": mu}, tolerance=1e-11)
        return float(np.log(beside.floquet().max_abs_multiplier))

    known = by_differences(log, {"mu": 3.0}, "mu", 2e-2)
    assert found["mu"] / tiny == pytest.approx(known, rel=1e-5)
    assert found.errors["mu"] <= 1e-3 * abs(found["mu"])


def two_oscillators(even: bool, symmetric: bool, c: float = -0.08, tolerance: float = 1e-9) -> Any:
    """An orbit in phase, unstable out of phase; of even potentials a quarter of the period is enough, else a half."""
    x, y, u, v, k, c_, a = symbols("x y u v k c a")
    potential = (x**2 + y**2 + c_ * (x - y) ** 2) / 2 + k * (x**4 + y**4) / 4 + (0 if even else a * (x**3 + y**3) / 3)
    rhs = ca.vertcat(u, v, -ca.gradient(potential, x), -ca.gradient(potential, y))
    signs: dict[str, Any] = {"reversal": (1, 1, -1, -1), "half_period": (-1,) * 4 if even else None}
    energy = (u**2 + v**2) / 2 + potential
    model = OdeModel("two", ca.vertcat(x, y, u, v), rhs, ca.vertcat(k, c_, a), hamiltonian=energy, **signs)
    guess = lambda t: [1.2 * np.cos(1.2 * t)] * 2 + [-1.4 * np.sin(1.2 * t)] * 2  # noqa: E731
    values = {"k": 1.0, "c": c, "a": 0.3}
    return find_orbit(
        model, guess, 2 * np.pi / 1.2, parameters=values, select=x - 1.2, symmetric=symmetric, tolerance=tolerance
    )


@pytest.mark.parametrize("even", [True, False])
def test_multipliers_of_orbits_on_a_part_of_the_period_move_as_those_of_the_whole(even: bool) -> None:
    whole, part = (two_oscillators(even, symmetric).gradient("max_abs_multiplier") for symmetric in (False, True))
    assert part.value == pytest.approx(whole.value, rel=1e-12)
    assert whole.value > 2.0
    for name in whole:
        assert abs(whole[name] - part[name]) <= whole.errors[name] + part.errors[name]
        assert max(whole.errors[name], part.errors[name]) < 1e-10
    place = lambda c: float(two_oscillators(even, True, c, 1e-11).floquet().max_abs_multiplier)  # noqa: E731
    assert part["c"] == pytest.approx(by_differences(place, {"c": -0.08}, "c", 1e-3), rel=1e-7)


def test_a_multiplier_on_the_circle_stays_there_within_the_error() -> None:
    found = two_oscillators(True, symmetric=True, c=0.2).gradient("max_abs_multiplier")
    for name in ("k", "c"):
        assert abs(found[name]) <= found.errors[name] < 1e-9


@pytest.mark.slow
def test_the_multiplier_of_an_orbit_of_a_family_moves_as_those_of_families_beside_it() -> None:
    branch = follow_family(Chain(8, 1.0, 0.2, -1.0), 1, 0.5, stability=True, tolerance=1e-9)
    S = branch.changes[0].value + 0.003
    found = branch.at(S=S).gradient("max_abs_multiplier")
    assert found.value > 1.0005

    def place(gamma: float) -> float:
        beside = follow_family(Chain(8, 1.0, gamma, -1.0), 1, S, at=[S], tolerance=1e-11)
        return float(beside.at(S=S).floquet().max_abs_multiplier)

    assert found["gamma"] == pytest.approx(by_differences(place, {"gamma": 0.2}, "gamma", 2e-5), rel=1e-4)


def test_extremes_of_a_cycle_are_those_of_closed_form_in_any_units() -> None:
    """The circle of radius sqrt(a), stretched by b: x = b sqrt(a) cos, at any phase."""
    for unit in (1.0, 1e6):
        x, y, a, b = symbols("x y a b")
        u, v = unit * x / b, y
        growth = a - u**2 - v**2
        rhs = ca.vertcat((growth * u - 2 * v) * b / unit, growth * v + 2 * u)
        model = OdeModel("ellipse", ca.vertcat(x, y), rhs, ca.vertcat(a, b))
        guess = lambda t, unit=unit: [0.7 * 3 / unit * np.cos(2 * t + 0.3), 0.7 * np.sin(2 * t + 0.3)]  # noqa: E731
        orbit = find_orbit(model, guess, np.pi, parameters={"a": 0.49, "b": 3.0}, tolerance=1e-11)
        exact = np.array([3.0 * 0.5 / 0.7, 0.7]) / unit
        for name, sign in (("x_max", 1.0), ("x_min", -1.0)):
            found = orbit.gradient(name)
            for slope, known in zip(found.values(), sign * exact, strict=True):
                assert slope == pytest.approx(known, rel=1e-9)


def test_a_free_parameter_of_a_boundary_value_problem_moves_as_in_closed_form() -> None:
    """x'' = -l k x with x(0) = x(1) = 0 and x'(0) = 1: l = pi^2/k; the largest x is 1/pi sqrt(...) = 1/sqrt(l k)."""
    x, v, value, k = symbols("x v l k")
    line = OdeModel("string", ca.vertcat(x, v), ca.vertcat(v, -value * k * x), ca.vertcat(value, k))
    conditions = [line.start(x), line.end(x), line.start(v) - k]
    problem = BoundaryValueProblem(line, conditions, parameters={"l": 5.0, "k": 2.0}, free=["l"])
    found = problem.solve(lambda t: [0.6 * np.sin(np.pi * t), 2.0 * np.cos(np.pi * t)], tolerance=1e-11)
    is_close(found.gradient("l"), {"k": -(np.pi**2) / 4.0}, largest=1e-9)
    is_close(found.gradient("x_max"), {"k": 1.0 / np.pi}, largest=1e-9)
    is_close(found.gradient("v"), {"k": 1.0}, largest=1e-9)


def test_the_frequency_of_a_family_at_its_amplitude() -> None:
    """Omega of a Duffing oscillator by elliptic integrals; S is among the parameters."""
    x, u, g = symbols("x u g")
    model = OdeModel("Duffing", x, -x - g * x**3, g, 2, u, reversal=(1, -1), half_period=(-1, -1), nominal=(0.5,))
    mpmath = pytest.importorskip("mpmath")
    orbit = follow_family(model, 1, 1.0, at=[0.8], tolerance=1e-10).at(S=0.8)

    def Omega(g: Any, S: Any) -> Any:
        stiff = 1 + g * S
        return mpmath.pi * mpmath.sqrt(stiff) / 2 / mpmath.ellipk(g * S / (2 * stiff))

    exact = [float(mpmath.diff(Omega, (mpmath.mpf("0.5"), mpmath.mpf("0.8")), order)) for order in ((1, 0), (0, 1))]
    is_close(orbit.gradient("Omega"), dict(zip(("g", "S"), exact, strict=True)), largest=1e-9)


def test_the_energy_of_a_family_is_that_of_its_model() -> None:
    """E = f(bond S) / bond of the FPUT-beta lattice; that of a chain by differences of its families."""
    orbit = follow_family(fput(4), 1, 1.0, at=[0.8], tolerance=1e-10).at(S=0.8)
    found = orbit.gradient("energy")
    assert found.value == pytest.approx(orbit.energy, rel=1e-10)
    assert found["bond"] == pytest.approx(0.8 * found["S"] - found.value, abs=1e-11)

    def energy(gamma: float) -> float:
        return float(follow_family(Chain(4, 1.0, gamma, -1.0), 1, 0.5, tolerance=1e-11).at(S=0.2).energy)

    chained = follow_family(Chain(4, 1.0, 0.25, -1.0), 1, 0.5, at=[0.2], tolerance=1e-9).at(S=0.2)
    found = chained.gradient("energy")
    assert found.value == pytest.approx(chained.energy, rel=1e-9)
    assert found["gamma"] == pytest.approx((energy(0.251) - energy(0.249)) / 0.002, rel=1e-5)


def test_a_fold_of_a_family_scales_with_the_cubic_force() -> None:
    """S is proportional to 1/|g|."""
    fold = follow_family(Chain(2, 1.224, 0.86, -1.0), 1, 3.2, tolerance=1e-10).special_points[0]
    found = fold.gradient()
    assert fold.kind == "fold"
    assert list(found) == ["alpha", "gamma", "g"]
    assert abs(found["g"] - fold.parameters["S"]) <= found.errors["g"] + fold.error < 1e-9


def test_a_parameter_that_moves_the_time_of_a_switch_moves_the_orbit() -> None:
    """x' = a u - x, u = 1 up to t = d of a period 1: x(0) = a (e^(d - 1) - e^-1)/(1 - e^-1)."""
    x, d, a, t = symbols("x d a t")
    rhs = a * ca.if_else(ca.fmod(t, 1.0) < d, 1.0, 0.0) - x
    model = OdeModel("square wave", x, rhs, ca.vertcat(d, a), time=t, forcing_period=1.0)
    orbit = find_orbit(model, [0.3], parameters={"d": 0.4, "a": 1.0}, tolerance=1e-10)
    start, by_d = (np.exp(-0.6) - np.exp(-1.0)) / (1.0 - np.exp(-1.0)), np.exp(-0.6) / (1.0 - np.exp(-1.0))
    is_close(orbit.gradient("x"), {"d": by_d, "a": start}, largest=1e-10)
    top = 1.0 - (1.0 - start) * np.exp(-0.4)
    is_close(orbit.gradient("x_max"), {"d": (1.0 - start + by_d) * np.exp(-0.4), "a": top}, largest=1e-10)
    is_close(orbit.gradient("max_abs_multiplier"), {"d": 0.0, "a": 0.0}, largest=1e-10)
    k, T = symbols("k T")
    field = -k * x + ca.if_else(t - T * ca.floor(t / T) < d, a, 0.0)
    model = OdeModel("square wave", x, field, ca.vertcat(k, d, T, a), time=t, forcing_period=T)
    orbit = find_orbit(model, [0.5], parameters={"k": 0.7, "d": 1.1, "T": 3.0, "a": 2.0})
    known = {"k": -3.0 * np.exp(-2.1), "d": 0.0, "T": -0.7 * np.exp(-2.1), "a": 0.0}
    is_close(orbit.gradient("max_abs_multiplier"), known, largest=1e-8)


@pytest.mark.slow
def test_quantities_of_forced_and_symmetric_orbits_are_those_of_differences() -> None:
    response = forced_orbit()

    def largest(omega: float) -> float:
        guess = lambda t: response.evaluate(t * omega / 1.2)  # noqa: E731
        return float(extremes(find_orbit(response.model, guess, parameters={"omega": omega}, tolerance=1e-11))[1][0])

    found = response.gradient("q_max")
    known = by_differences(lambda omega: largest(omega), {"omega": 1.2}, "omega", 2e-3)
    assert found.value == pytest.approx(largest(1.2), abs=1e-9)
    assert found["omega"] == pytest.approx(known, rel=1e-6)
    x, u, k, size = symbols("x u k size")
    model = OdeModel("well", x, -x - k * x**2, ca.vertcat(k, size), 2, u, reversal=(1, -1))
    guess = lambda t: [0.3 * np.cos(t), -0.3 * np.sin(t)]  # noqa: E731
    options = {"select": x - size, "symmetric": True, "tolerance": 1e-11}
    values = {"k": 0.5, "size": 0.3}
    orbit = find_orbit(model, guess, 2 * np.pi, parameters=values, **options)

    def smallest(**given: float) -> float:
        return float(extremes(find_orbit(model, guess, 2 * np.pi, parameters=given, **options))[0][0])

    for name in values:
        known = by_differences(smallest, values, name, 2e-3)
        assert orbit.gradient("x_min")[name] == pytest.approx(known, rel=1e-8)


def test_what_is_no_quantity_is_refused() -> None:
    with pytest.raises(ValueError, match="quantity: given perid; did you mean period"):
        limit_cycle().gradient("perid")
    rest = lorenz().solution
    x, y = rest.space.model.state[:2].elements()
    for given, words in (
        (None, "given None"), (ca.SX.sym("zz"), "depends on zz"),
        (x == y, "given a comparison"), (ca.log(-x * x), "given an expression, which is nan there"),
    ):  # fmt: skip
        with pytest.raises((TypeError, ValueError), match=f"^quantity: {words}[^\n]*accepted"):
            rest.gradient(given)
    with pytest.raises(ValueError, match="fixed: given with a solution whose period is its own; accepted: an orbit"):
        rest.gradient("x", fixed="period")
    with pytest.raises(TypeError, match="errors: given 5; accepted: True or False"):
        rest.gradient("x", errors=5)
    with pytest.raises(KeyError, match="accepted: sigma, beta"):
        lorenz().gradient()["rho"]


def test_solutions_that_are_not_regular_have_no_gradient() -> None:
    """Where x = 0 meets x = r - c the derivative by e is infinite; an orbit at rest has none."""
    x, r, c, e = symbols("x r c e")
    model = OdeModel("transcritical", x, (r - c) * x - x**2 + e * c, ca.vertcat(r, c, e))
    branch = find_equilibrium(model, [0.0], parameters={"r": -1.0, "c": 0.3, "e": 0.0}).follow("r", 1.0)
    with pytest.raises(ArithmeticError, match="gradient: given the solution at a branch point, which is not regular"):
        branch.special_points[0].solution.gradient("x")
    cycles = lorenz().follow("r", 20.0, max_points=3)
    with pytest.raises(ArithmeticError, match="gradient: given an orbit at rest, which is not regular"):
        cycles.orbits[0].gradient("x_max")
