"""Designs: against closed forms, plain families, other methods and the conditions of optimality; what is refused."""

from __future__ import annotations

import os
import signal
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar
from scipy.special import ellipk

from casadi_skin import (
    Chain,
    OdeModel,
    find_equilibrium,
    find_orbit,
    follow_family,
    optimise,
    pareto_front,
    search_orbit,
)
from casadi_skin.search.design import Design
from casadi_skin.search.design_problem import DesignProblem
from casadi_skin.search.designs import quantities_of
from casadi_skin.search.families import FamilyOrbit, FamilyStart
from casadi_skin.solve.processes import SearchProgress

SHORT = Chain(sites=6, alpha=1.0, gamma=0.3, g=1.0)


def member(model: Any = SHORT, mode: int | str = "last", S: float = 1.0, **options: Any) -> Any:
    return follow_family(model, mode, S, at=[S], tolerance=1e-9, **options).at(S=S)


def located(orbit: Any, over: tuple[str, ...], slopes: bool = True) -> FamilyOrbit:
    start = FamilyStart.of(orbit)
    expressions = start.expressions(over)
    if slopes:
        expressions.slope(expressions.Omega)
    return start.located(expressions, over)


# Orbits of families: their quantities and derivatives -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("g", "gamma"),
    [(1.0, 0.3), (-1.0, -0.3), (1.0, 0.0), pytest.param(1.0, -0.3, marks=pytest.mark.slow),
     pytest.param(-1.0, 0.3, marks=pytest.mark.slow)],
)  # fmt: skip
def test_quantities_of_an_orbit_are_those_of_its_family(gamma: float, g: float) -> None:
    chain, h, mode = Chain(6, 1.0, gamma, g), 0.01, "last" if g > 0 else "first"
    branch = follow_family(chain, mode, 0.5 + h, at=[0.5 - h, 0.5, 0.5 + h], tolerance=1e-11)
    left, orbit, right = (branch.at(S=S) for S in (0.5 - h, 0.5, 0.5 + h))
    values = quantities_of(located(orbit, ("S",)))
    y = orbit.profile
    expected = {
        "S": 0.5, "Omega": orbit.Omega, "period": orbit.period, "energy": orbit.energy, "gamma": gamma, "g": g,
        "participation": np.sum(y**2) ** 2 / np.sum(y**4), "alpha": 1.0, "roughness": 0.0,
        "upper_cutoff": np.sqrt(chain.band()[1]), "lower_cutoff": np.sqrt(chain.band()[0]),
        "amplification": ((1 + abs(gamma)) / (1 - abs(gamma))) ** 2.5,
    }  # fmt: skip
    for name, value in expected.items():
        assert abs(values[name] - value) < 1e-9, name
    assert abs(values["Omega_slope"] - (right.Omega - left.Omega) / (2 * h)) < 1e-4
    assert abs(values["energy_slope"] - (right.energy - left.energy) / (2 * h)) < 1e-3


def test_an_orbit_too_far_off_is_not_taken_for_that_of_another_family() -> None:
    thing = located(member(S=1.0), ("S",))
    assert thing.near({"S": 1.5}) is not None
    assert thing.near({"S": 500.0}) is None


def test_one_stiffness_a_site_moves_each_site_alone() -> None:
    thing = located(member(), tuple(f"alpha_{n}" for n in range(1, 7)))
    ahead = thing.near({f"alpha_{n}": 1.0 + 1e-5 * (n == 2) for n in range(1, 7)})
    np.testing.assert_allclose(ahead.numbers - thing.numbers, 1e-5 * thing.derivatives[:, 1], rtol=0, atol=1e-9)
    assert quantities_of(ahead)["roughness"] == pytest.approx(2e-10, rel=1e-4)


# Designs of families --------------------------------------------------------------------------------------------------


def frequency(S: float, w: float = 1.0) -> float:
    """Of a pendulum whose largest angle is sqrt(S), by the complete elliptic integral."""
    return float(np.pi * np.sqrt(w) / (2.0 * ellipk(np.sin(0.5 * np.sqrt(S)) ** 2)))


def pendulum(**changes: Any) -> OdeModel:
    q, v, w = (ca.SX.sym(name) for name in "qvw")
    declared: dict[str, Any] = {
        "reversal": (1, -1), "half_period": (-1, -1), "hamiltonian": v**2 / 2 - w * ca.cos(q), "nominal": (1.0,),
        "outputs": {"height": 1 - ca.cos(q)},
    }  # fmt: skip
    return OdeModel("pendulum", q, -w * ca.sin(q), w, 2, v, **(declared | changes))


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_bounds_of_S_hold_in_all_units(unit: float) -> None:
    y, v = ca.SX.sym("y"), ca.SX.sym("v")
    model = OdeModel(
        "oscillator", y, -y - y * (y / unit) ** 2, order=2, velocity=v, reversal=(1, -1), half_period=(-1, -1)
    )
    orbit = follow_family(model, 1, 0.5 * unit**2).orbits[-1]
    for low in (0.05, 0.0):
        result = optimise("Omega", orbit, over=["S"], bounds={"S": (low * unit**2, 0.4 * unit**2)})
        assert result["S"] == pytest.approx((low or 0.4e-6) * unit**2, rel=1e-6)
        assert result.reason.startswith("the optimum sits on a bound: S >= ")


def test_a_pendulum_meets_its_closed_form() -> None:
    """The largest amplitude whose frequency is 0.8 or more, and dOmega/dS there."""
    result = optimise(
        "S", member(pendulum(), 1), over=["S"], bounds={"S": (0.1, 5.0), "Omega": (0.8, None)}, maximise=True,
        subject_to=[(lambda o: o.Omega_slope, -1.0, 1.0), ("height", None, 2.0)],
    )  # fmt: skip
    S = brentq(lambda S: frequency(S) - 0.8, 0.1, 5.0, xtol=1e-13)
    assert result.active == ("Omega >= 0.8",)
    assert abs(result.value - S) <= result.error < 1e-8
    assert result["energy"] == pytest.approx(-np.cos(np.sqrt(S)), abs=1e-8)
    assert result["height"] == pytest.approx(1 - np.cos(np.sqrt(S)), abs=1e-8)
    assert result["Omega_slope"] == pytest.approx((frequency(S + 1e-4) - frequency(S - 1e-4)) / 2e-4, abs=1e-7)
    assert result.solution.profile == pytest.approx(np.sqrt(S))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-5, 1e-8])
def test_the_error_of_the_value_is_at_least_the_true_one(tolerance: float) -> None:
    """Of a pendulum that comes near its upper rest: the S at which its frequency is 0.45, in closed form."""
    orbit = follow_family(pendulum(), 1, 1.0, tolerance=1e-3).orbits[-1]
    asked: dict[str, Any] = {"over": ["S"], "bounds": {"S": (0.1, 9.5), "Omega": (0.45, None)}, "maximise": True}
    result = optimise("S", orbit, tolerance=tolerance, **asked)
    S = brentq(lambda S: frequency(S) - 0.45, 5.0, 9.8, xtol=1e-13)
    assert abs(result.value - S) <= result.error <= tolerance * S


def test_several_orbits_of_one_model() -> None:
    """The w whose frequencies at S = 0.5 and 2 have the mean 1.2."""
    branch = follow_family(pendulum(), 1, 2.0, at=[0.5, 2.0])
    two = [branch.at(S=0.5), branch.at(S=2.0)]
    result = optimise("((a.Omega + b.Omega)/2 - 1.2)^2", two, over=["w"], bounds={"w": (0.5, 4.0)})
    w = (2.4 / (frequency(0.5) + frequency(2.0))) ** 2
    assert result["w"] == pytest.approx(w, abs=1e-7)
    assert [o.Omega for o in result.located] == pytest.approx([frequency(S, w) for S in (0.5, 2.0)], abs=1e-7)


def slope_of(gamma: float) -> float:
    at = 1.0 + 0.01 * np.array([-2.0, -1.0, 1.0, 2.0])
    branch = follow_family(Chain(6, 1.0, gamma, 1.0), "last", at[-1], at=at, tolerance=1e-11)
    a, b, c, d = (branch.at(S=S).Omega for S in at)
    return float((8 * (c - b) - (d - a)) / 0.12)


def test_least_slope_is_that_of_plain_families_and_of_the_mirrored_chain() -> None:
    right = optimise("Omega_slope", member(), over=["gamma"], bounds={"gamma": (0.2, 0.8)})
    plain = minimize_scalar(slope_of, bounds=(0.2, 0.8), method="bounded", options={"xatol": 1e-6})
    assert right.reason.startswith("found an optimum inside its bounds")
    assert right.optimality < 1e-7
    assert abs(right["gamma"] - plain.x) < 1e-4
    assert abs(right.value - plain.fun) < 1e-7
    left = optimise("Omega_slope", member(Chain(6, 1.0, -0.3, 1.0)), over=["gamma"], bounds={"gamma": (-0.8, -0.2)})
    assert abs(right["gamma"] + left["gamma"]) < 1e-6
    assert abs(right.value - left.value) < 1e-10
    np.testing.assert_allclose(np.abs(right.solution.profile), np.abs(left.solution.profile[::-1]), atol=1e-6)


@pytest.mark.slow
def test_a_chain_as_a_model_in_physical_coordinates_has_the_optimum_of_the_chain() -> None:
    own = optimise("Omega_slope", member(), over=["gamma"], bounds={"gamma": (0.2, 0.8)})
    orbit = member(SHORT.tunable_model(), "last")
    best = optimise("Omega_slope", orbit, over=["gamma"], bounds={"gamma": (0.2, 0.8)})
    assert best["gamma"] == pytest.approx(own["gamma"], abs=1e-8)
    assert best.value == pytest.approx(own.value, abs=1e-12)
    np.testing.assert_allclose(np.abs(best.solution.profile), np.abs(own.solution.profile), atol=1e-8)


def test_a_design_on_its_bounds_is_a_member_of_the_family() -> None:
    bounds = {"gamma": (0.1, 0.6), "alpha": (0.5, 2)}
    result = optimise("participation", member(), over=["gamma", "alpha"], bounds=bounds)
    assert result.found
    assert "gamma <= 0.6" in result.active
    assert "the optimum sits on a bound: gamma <= 0.6" in result.reason
    plain = member(Chain(6, result["alpha"], 0.6, 1.0))
    assert abs(result["Omega"] - plain.Omega) < 1e-8
    np.testing.assert_allclose(result.solution.profile, plain.profile, atol=1e-7)
    y = result.solution.evaluate([0.0, result["period"] / 2])
    np.testing.assert_allclose(y[1], -y[0], atol=1e-12)
    # The multiplier is the derivative by the bound: another bound shows it.
    moved = optimise(
        "participation", member(), over=["gamma", "alpha"], bounds={**bounds, "gamma": (0.1, 0.601)}
    ).value  # fmt: skip
    assert result.multipliers["gamma <= 0.6"] == pytest.approx((moved - result.value) / 0.001, rel=1e-2)


def test_a_front_with_a_concave_part_is_found_where_weights_find_its_ends_alone() -> None:
    """Of the state (a, 1 - 3 a^2 + 2 a^3) the front over a from 0 to 1 is concave below a = 1/2."""
    x, y, a = (ca.SX.sym(name) for name in "xya")
    model = OdeModel("front", ca.vertcat(x, y), ca.vertcat(a - x, 1 - 3 * a**2 + 2 * a**3 - y), a)
    state = find_equilibrium(model, [0.3, 0.8], parameters={"a": 0.3})
    asked: dict[str, Any] = {"over": ["a"], "bounds": {"a": (0.0, 1.0)}}
    front = pareto_front("x", "y", state, points=9, **asked)
    assert (front.complete, front.dominated, len(front.points)) == (True, 0, 9)
    places = front.values[:, 0]
    np.testing.assert_allclose(front.values[:, 1], 1 - 3 * places**2 + 2 * places**3, rtol=0, atol=1e-9)
    assert np.sum((places > 0.02) & (places < 0.5)) >= 3
    apart = np.linalg.norm(np.diff(front.values, axis=0), axis=1)  # both ranges are 1
    assert np.max(apart) < 1.415 * np.min(apart)
    for weight in np.linspace(0.1, 0.9, 9):
        least = optimise(f"{weight}*x + {1 - weight}*y", state, starts=4, **asked)
        assert least["a"] < 1e-6 or least["a"] > 0.5


# Designs of special points, equilibria and orbits ---------------------------------------------------------------------


def lorenz() -> OdeModel:
    x, y, z, s, r, b = (ca.SX.sym(name) for name in ("x", "y", "z", "sigma", "r", "beta"))
    field = ca.vertcat(s * (y - x), x * (r - z) - y, x * y - b * z)
    return OdeModel("Lorenz", ca.vertcat(x, y, z), field, ca.vertcat(s, r, b))


@pytest.fixture(scope="module")
def hopf() -> Any:
    start = find_equilibrium(lorenz(), [8.0, 8.0, 27.0], parameters={"sigma": 10.0, "r": 20.0, "beta": 8 / 3})
    (point,) = (p for p in start.follow("r", 30.0).special_points if p.kind == "hopf")
    return point


def hopf_of(sigma: float, beta: float) -> float:
    """r of Lorenz's Hopf point."""
    return sigma * (sigma + beta + 3) / (sigma - beta - 1)


def test_the_least_change_that_keeps_a_hopf_point_beyond_a_value(hopf: Any) -> None:
    """The nearest (sigma, beta) whose Hopf point is at r = 30, also by an independent minimisation."""

    def change(h: Any) -> Any:
        return (h.sigma - 10) ** 2 + (h.beta - 8 / 3) ** 2

    result = optimise(change, hopf, over=["sigma", "beta"], bounds={"sigma": (5, 40), "beta": (1, 6), "r": (30, None)})

    def least(sigma: float) -> float:
        beta = brentq(lambda b: hopf_of(sigma, b) - 30, 1, 6, xtol=1e-14)
        return (sigma - 10) ** 2 + (beta - 8 / 3) ** 2

    plain = minimize_scalar(least, bounds=(9, 11), method="bounded", options={"xatol": 1e-9})
    assert result.active == ("r >= 30",)
    assert result.value == pytest.approx(plain.fun, abs=1e-8)
    assert result["sigma"] == pytest.approx(plain.x, abs=1e-5)
    assert hopf_of(result["sigma"], result["beta"]) == pytest.approx(30, abs=1e-8)


def test_the_widest_window_between_two_folds() -> None:
    """x' = p + a x - x^3/(1 + b^2): folds at p = -+ 2/3 a sqrt(a (1 + b^2)/3); b is off 0 by a penalty."""
    x, p, a, b = (ca.SX.sym(name) for name in "xpab")
    model = OdeModel("cubic", x, p + a * x - x**3 / (1 + b**2), ca.vertcat(p, a, b))
    start = find_equilibrium(model, [-2.0], parameters={"p": -2.0, "a": 1.0, "b": 0.1})
    first, second = (point for point in start.follow("p", 2.0).special_points if point.kind == "fold")
    ends = sorted([first, second], key=lambda point: point.parameters["p"])
    result = optimise(
        "high.p - low.p - low.b^2", {"low": ends[0], "high": ends[1]}, over=["a", "b"], maximise=True,
        bounds={"a": (0.5, 2.0), "b": (0.05, 5.0)},
    )  # fmt: skip
    c = 4 / 3 * 2 * np.sqrt(2 / 3)  # at a = 2 the width is c sqrt(1 + b^2), and b = sqrt(c^2/4 - 1) is best
    best = np.sqrt(c**2 / 4 - 1)
    assert result.active == ("a <= 2",)
    assert result["b"] == pytest.approx(best, abs=1e-6)
    assert result.value == pytest.approx(c * np.sqrt(1 + best**2) - best**2, abs=1e-10)
    assert result.multipliers["a <= 2"] == pytest.approx(1.5 / 2 * c * np.sqrt(1 + best**2), rel=1e-6)


@pytest.mark.slow
def test_a_doubling_is_kept_beyond_a_value_with_the_least_change() -> None:
    """Roessler's first doubling in c, held at c >= 3.2 by a and b: where the change is along the gradient."""
    x, y, z, a, b, c = (ca.SX.sym(name) for name in "xyzabc")
    field = ca.vertcat(-y - z, x + a * y, b + z * (x - c))
    model = OdeModel("Roessler", ca.vertcat(x, y, z), field, ca.vertcat(a, b, c))

    def crosses(t: float, s: np.ndarray) -> float:
        return float(s[1])

    crosses.direction = 1.0  # type: ignore[attr-defined]
    known = solve_ivp(
        lambda t, s: [-s[1] - s[2], s[0] + 0.2 * s[1], 0.2 + s[2] * (s[0] - 2.5)], (0.0, 300.0), [3.0, 0.0, 0.0],
        rtol=1e-9, atol=1e-11, events=crosses, dense_output=True,
    )  # fmt: skip
    first, last = known.t_events[0][-2:]
    values = {"a": 0.2, "b": 0.2, "c": 2.5}
    orbit = find_orbit(model, lambda t: known.sol(first + t), last - first, parameters=values)
    branch = orbit.follow("c", 3.2, stability=True)
    doubling = next(p for p in branch.special_points if p.kind == "period doubling")
    assert doubling.parameters["c"] < 3.0
    result = optimise(
        lambda d: (d.a - 0.2) ** 2 + (d.b - 0.2) ** 2, doubling, over=["a", "b"],
        bounds={"a": (0.05, 0.4), "b": (0.05, 2.0), "c": (3.2, None)},
    )  # fmt: skip
    assert result.active == ("c >= 3.2",)
    found = result.solution
    multipliers = found.solution.floquet().multipliers
    assert np.min(np.abs(multipliers + 1.0)) < 1e-6
    # Along the constraint nothing is nearer: the gradient of the located c is parallel to the change.
    slopes = found.gradient()
    change = np.array([result["a"] - 0.2, result["b"] - 0.2])
    normal = np.array([slopes["a"], slopes["b"]])
    assert abs(change[0] * normal[1] - change[1] * normal[0]) < 1e-6 * np.linalg.norm(change) * np.linalg.norm(normal)


def test_an_orbit_and_an_equilibrium() -> None:
    """A Hopf normal form, radius sqrt(mu/a) and period 2 pi/(w - c mu/a); and a state that is a closed form."""
    x, y, mu, a, w, c = (ca.SX.sym(name) for name in ("x", "y", "mu", "a", "w", "c"))
    r2 = x**2 + y**2
    field = ca.vertcat(mu * x - w * y - (a * x - c * y) * r2, w * x + mu * y - (c * x + a * y) * r2)
    model = OdeModel("circle", ca.vertcat(x, y), field, ca.vertcat(mu, a, w, c))
    values = {"mu": 1.0, "a": 1.0, "w": 2.0, "c": 0.5}
    orbit = find_orbit(model, lambda t: [np.cos(1.5 * t), np.sin(1.5 * t)], 4.0, parameters=values)
    result = optimise(
        "(period - 5)^2 + (x_max - 1.1)^2", orbit, over=["mu", "c"], bounds={"mu": (0.5, 2.0), "c": (0.0, 2.0)}
    )
    assert result["mu"] == pytest.approx(1.21, abs=1e-4)
    assert result["c"] == pytest.approx((2.0 - 2 * np.pi / 5) / 1.21, abs=1e-4)
    assert result.solution.period == pytest.approx(5.0, abs=1e-5)

    u, p, q = (ca.SX.sym(name) for name in "upq")
    rest = OdeModel("rest", u, p - q * u + p * q**2, ca.vertcat(p, q))  # u = p (1 + q^2)/q, least at q = 1
    state = find_equilibrium(rest, [2.5], parameters={"p": 1.0, "q": 2.0})
    least = optimise("u", state, over=["q"], bounds={"q": (0.2, 5.0)})
    assert least["q"] == pytest.approx(1.0, abs=1e-6)
    assert least.value == pytest.approx(2.0, abs=1e-10)


def hopf_of_reaction() -> Any:
    """The Hopf point of the Brusselator at B = 1 + k A^2, of which there is none at A = 0."""
    x, y, A, B, k = (ca.SX.sym(name) for name in ("x", "y", "A", "B", "k"))
    field = ca.vertcat(A - (B + 1) * x + x**2 * y, k * (B * x - x**2 * y))
    model = OdeModel("reaction", ca.vertcat(x, y), field, ca.vertcat(A, B, k))
    start = find_equilibrium(model, [1.5, 1 / 1.5], parameters={"A": 1.5, "B": 1.0, "k": 1.5})
    return start.follow("B", 12.0).special_points[0]


def test_where_what_is_located_ends_the_design_says_that_it_is_no_optimum() -> None:
    result = optimise("B", hopf_of_reaction(), over=["A"])
    assert not result.found
    assert result.reason.startswith("no optimum, ")
    assert 1.0 <= result.value <= 1.5
    assert result.located
    with pytest.raises(ArithmeticError, match=r"optimise: .* at the start: log\(-B\) or its derivative is no"):
        optimise("log(-B)", hopf_of_reaction(), over=["A"])


@pytest.mark.parametrize("low", [0.0, -1.0])
def test_an_orbit_that_shrinks_to_a_rest_is_not_located_there(low: float) -> None:
    """A circle of radius sqrt(mu), least at the bound, or at no design: what is located is right."""
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    r2 = x**2 + y**2
    model = OdeModel("circle", ca.vertcat(x, y), ca.vertcat(mu * x - y - x * r2, x + mu * y - y * r2), mu)
    orbit = find_orbit(model, lambda t: [np.cos(t), np.sin(t)], 6.0, parameters={"mu": 1.0}, tolerance=1e-10)
    result = optimise("x_max", orbit, over=["mu"], bounds={"mu": (low, 2.0)})
    assert result.found == (low == 0.0)
    assert abs(result.value - np.sqrt(result["mu"])) <= result.error
    assert 1e-4 <= result.value <= (2.5 * result.error if result.found else 0.5)


@pytest.mark.slow
def test_the_first_instability_is_pushed_to_the_largest_S() -> None:
    """Of a short chain over gamma: until the edge of another tongue comes before it, but for a distance."""
    branch = follow_family(Chain(4, 1.0, 0.35, -1.0), 1, 2.2, stability=True)
    edges = {"first": branch.edge(0), "other": branch.edge(2)}
    result = optimise(
        "first.S", edges, over=["gamma"], bounds={"gamma": (0.2, 0.5)}, maximise=True,
        subject_to=[("other.S - first.S", 1e-3, None)],
    )  # fmt: skip
    assert result.active == ("other.S - first.S >= 0.001",)
    family = follow_family(Chain(4, 1.0, result["gamma"], -1.0), 1, 2.2, stability=True)
    places = [change.S for change in family.changes]
    assert places[0] == pytest.approx(result.value, abs=1e-8)
    further = [place.S for place in family.stability_diagram.further]
    assert min(abs(S - result.value - 1e-3) for S in (*places, *further)) < 1e-8
    beyond = follow_family(Chain(4, 1.0, result["gamma"] + 0.005, -1.0), 1, 2.2, stability=True)
    assert result.value > beyond.changes[0].S


# How designs end, and what they say -----------------------------------------------------------------------------------


def test_constraints_that_cannot_be_met_are_named_at_the_nearest_design() -> None:
    result = optimise("Omega", member(S=0.5), over=["S"], bounds={"S": (0.1, 1.0), "Omega": (4.0, 5.0)},
                         subject_to=[("energy", 0.0, 100.0)])  # fmt: skip
    nearest = member().Omega  # Omega grows with S: the end is nearest
    assert not result.found
    assert result["S"] == pytest.approx(1.0)
    assert len(result.path) <= 10
    assert f"the constraints are not met; Omega is off by {4.0 - nearest:.3g} at the nearest design" in result.reason


def test_the_nearest_design_has_the_least_violation(hopf: Any) -> None:
    """Of a Hopf point that is to come before the least r, and of a slope that is to vanish: where each is least."""
    b = 8 / 3
    sigma = b + 1 + np.sqrt((b + 1) * (2 * b + 4))
    wide = {"over": ["sigma"], "bounds": {"sigma": (5, 40)}}
    least = optimise("Omega_slope", member(), over=["gamma"], bounds={"gamma": (0.2, 0.8)})
    for lower in (None, 20.0):
        result = optimise(lambda h: h.sigma, hopf, subject_to=[("r", lower, 20.0)], **wide)
        assert not result.found
        assert result["sigma"] == pytest.approx(sigma, abs=1e-6)
        assert len(result.path) <= 100
        assert f"r is off by {hopf_of(sigma, b) - 20.0:.3g} at the nearest design" in result.reason
        steady = optimise("gamma", member(), over=["gamma"], bounds={"gamma": (0.2, 0.8)},
                          subject_to=[("Omega_slope", lower and 0.0, 0.0)])  # fmt: skip
        assert not steady.found
        assert steady["gamma"] == pytest.approx(least["gamma"], abs=1e-6)
        assert len(steady.path) <= 100


def test_a_flat_direction_is_an_optimum_where_it_is() -> None:
    """One site has no neighbour, so that its frequency does not depend on gamma."""
    result = optimise("Omega", member(Chain(1, 1.0, 0.25, -1.0), "first", 0.5), over=["gamma"],
                         bounds={"gamma": (0.1, 0.6)})  # fmt: skip
    assert result.found
    assert (result["gamma"], result.optimality) == (0.25, 0.0)
    assert result.reason.startswith("every design is one: Omega does not change with gamma; ")


def test_a_quantity_that_is_held_is_not_optimised() -> None:
    """The position that `select` holds, and the period that a branch holds, do not change with b; others do."""
    q, v, a, b = (ca.SX.sym(name) for name in "qvab")
    rhs, energy = ca.vertcat(v, -a * q - b * q**3), v**2 / 2 + a * q**2 / 2 + b * q**4 / 4
    model = OdeModel("Duffing", ca.vertcat(q, v), rhs, ca.vertcat(a, b), nominal=(1.0, 0.5), hamiltonian=energy)
    orbit = find_orbit(model, lambda t: [np.cos(1.17 * t), -1.17 * np.sin(1.17 * t)], 2 * np.pi / 1.17, select=q - 1)
    moved = orbit.follow("a", 1.1, fixed="period").solutions[-1]
    for of, held, changing in ((orbit, "q", "period"), (moved, "period", "q")):
        design = optimise(held, of, over=["b"], bounds={"b": (0.4, 0.9)})
        assert design.reason.startswith(f"every design is one: {held} does not change with b; ")
        assert optimise(changing, of, over=["b"], bounds={"b": (0.4, 0.9)}).active
    start = find_equilibrium(OdeModel("line", q, a - q, a, nominal=(0.0,)), [0.0])
    design = optimise("q^2", start, over=["a"])
    assert design.reason.startswith("found an optimum inside its bounds; ")  # it is least where it begins


@pytest.mark.slow
def test_several_starts_lead_to_distinct_optima(hopf: Any) -> None:
    """(r_H - 26)^2 has two minima in sigma, one on each side of the least r_H."""
    asked: dict[str, Any] = {"over": ["sigma"], "bounds": {"sigma": (6, 30)}, "starts": 3, "seed": 1}
    result = optimise("(r - 26)^2", hopf, **asked)
    found = sorted([result["sigma"], *(other["sigma"] for other in result.others)])
    assert [hopf_of(sigma, 8 / 3) for sigma in found] == pytest.approx([26.0, 26.0], abs=1e-3)
    assert len(found) == 2


def test_progress_tells_every_design() -> None:
    told = list[SearchProgress]()
    result = optimise("participation", member(), over=["gamma"], bounds={"gamma": (0.1, 0.6)}, progress=told.append)
    assert len(told) == len(result.path) - 1
    assert [one.iteration for one in told] == list(range(1, len(told) + 1))
    assert [one.objective for one in told] == result.values[:-1].tolist()
    assert str(told[0]).startswith("0 of 1 starts done; start 1 (gamma = 0.3), iteration 1: objective ")
    assert result.path[0].tolist() == [0.3]


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("at", [(2, 3), (1, 2)])
def test_an_interruption_keeps_the_best_so_far(at: tuple[int, int]) -> None:
    def tell(progress: SearchProgress) -> None:
        if (progress.start, progress.iteration) == at:
            os.kill(os.getpid(), signal.SIGINT)

    given: dict[str, Any] = {"over": ["gamma"], "bounds": {"gamma": (0.1, 0.6)}}
    result = optimise("participation", member(), **given, starts=3, progress=tell)
    assert result.reason.startswith(f"interrupted at start {at[0]} of 3; ")
    assert (result.found, len(result.starts)) == (at[0] == 2, at[0])
    if result.found:
        assert result.value == optimise("participation", member(), **given).value
    else:
        assert result.value == min(result.values)
        assert result.located


@pytest.mark.usefixtures("interruptible")
def test_an_interrupted_front_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    right, known = DesignProblem.evaluated, list[Any]()

    def interrupted(self: DesignProblem, things: Any) -> Any:
        known.append(things)
        if len(known) == 3:
            os.kill(os.getpid(), signal.SIGINT)
        return right(self, things)

    monkeypatch.setattr(DesignProblem, "evaluated", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pareto_front("participation", "S", member(), over=["gamma"], bounds={"gamma": (0.1, 0.6)}, points=2)
    assert len(known) == 3


def test_wrong_derivatives_are_no_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    right = DesignProblem.evaluated

    def wrong(self: DesignProblem, things: Any) -> Any:
        rows, slopes = right(self, things)
        return rows, slopes + 0.01

    monkeypatch.setattr(DesignProblem, "evaluated", wrong)
    result: Design = optimise("Omega_slope", member(), over=["gamma"], bounds={"gamma": (0.2, 0.8)})
    good = minimize_scalar(slope_of, bounds=(0.2, 0.8), method="bounded").x
    assert not result.found or abs(result["gamma"] - good) > 1e-3


# Refusals -------------------------------------------------------------------------------------------------------------


def vector(o: Any) -> ca.SX:
    return o.y0


def unknown(o: Any) -> ca.SX:
    return o.Omaga


REFUSED: list[tuple[dict[str, Any], type[Exception], str]] = [
    ({"quantity": vector}, ValueError, r"quantity: given an expression of shape \(6, 1\); accepted: a scalar"),
    ({"quantity": unknown}, ValueError, "quantity: given 'Omaga'; did you mean Omega"),
    ({"quantity": "Omaga"}, ValueError, "quantity: given 'Omaga'; did you mean Omega"),
    ({"quantity": "Omega +"}, ValueError, "quantity: column 8"),
    ({"quantity": 3.0}, TypeError, "quantity: given 3.0; accepted: a name, a formula or a function"),
    ({"quantity": lambda o: "S"}, TypeError, "accepted: a CasADi expression"),
    ({"quantity": lambda o: o.y0 + ca.SX.zeros(5)}, TypeError, "the function given fails"),
    ({"quantity": lambda o: 1.0}, ValueError, "quantity: given the constant 1"),
    ({"over": ("gama",)}, ValueError, "over: given 'gama'; did you mean gamma"),
    ({"over": ()}, ValueError, "over: given none"),
    ({"over": ("alpha", "alpha_n")}, ValueError, "accepted: one of them"),
    ({"bounds": {"gama": (0, 1)}}, ValueError, "did you mean gamma"),
    ({"bounds": {"gamma": (0.6, 0.1)}}, ValueError, "lower <= upper"),
    ({"bounds": {"gamma": (0.3, 0.3)}}, ValueError, "different bounds"),
    ({"bounds": {"gamma": (-0.3, 0.3)}}, ValueError, "the chain's side of 0"),
    ({"bounds": {"gamma": (0.3, 1.0)}}, ValueError, r"\|gamma\| < 1"),
    ({"bounds": {"gamma": (0.3,)}}, TypeError, "a pair"),
    ({"bounds": {"gamma": "ab"}}, TypeError, "a pair"),
    ({"bounds": {"alpha": (0.5, 1)}}, ValueError, "which is not free"),
    ({"bounds": {"gamma": (0.3, float("nan"))}}, ValueError, "nan"),
    ({"over": ("S",), "bounds": {"S": (-1.0, 2.0)}}, ValueError, r"bounds\[S\]: given"),
    ({"subject_to": [("Omega", 2.0)]}, TypeError, "subject_to, item 1"),
    ({"subject_to": [3]}, TypeError, "subject_to, item 1"),
    ({"subject_to": [("Omaga", 2, 3)]}, ValueError, "did you mean Omega"),
    ({"subject_to": [("Omega", 2, 2), ("energy", 1, 1)]}, ValueError, "2 equalities over 1 parameters"),
    ({"subject_to": [vector]}, ValueError, "6 equalities over 1"),
    ({"subject_to": [lambda o: o.Omega == 2.0]}, ValueError, "given a comparison"),
    ({"tolerance": 2.0}, ValueError, "tolerance"),
    ({"starts": 0}, ValueError, "starts: given 0"),
    ({"maximise": 1}, TypeError, "maximise"),
    ({"of": 3}, TypeError, "of: given 3; accepted: a special point, an orbit or an equilibrium"),
    ({"of": []}, TypeError, r"of: given \[\]"),
    ({"of": {"a b": SHORT}}, ValueError, "of: given the name 'a b'; accepted: letters"),
    ({"of": {1: SHORT}}, ValueError, "of: given the name 1; accepted: letters"),
    ({"of": [SHORT] * 27}, ValueError, "of: given the name '{'; accepted: .* at most 26 without names"),
    ({"quantity": lambda o: 1 / 0}, TypeError, "quantity: the function given fails: division by zero"),
]


@pytest.fixture(scope="module")
def orbit() -> Any:
    return member()


@pytest.mark.parametrize(("changes", "kind", "words"), REFUSED)
def test_what_cannot_be_meant_is_refused_before_any_solve(
    changes: dict[str, Any], kind: type[Exception], words: str, orbit: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(FamilyOrbit, "on", lambda *_: pytest.fail("something was solved"))
    given: dict[str, Any] = {"quantity": "Omega", "of": orbit, "over": ("gamma",)} | changes
    with pytest.raises(kind, match=words) as caught:
        optimise(given.pop("quantity"), given.pop("of"), **given)
    assert len(str(caught.value).splitlines()) == 1


def test_several_orbits_and_points_name_whose_a_quantity_is(orbit: Any, hopf: Any) -> None:
    with pytest.raises(ValueError, match="over: given S with several orbits"):
        optimise("a.S", [orbit, orbit], over=["S"])
    with pytest.raises(ValueError, match=r"given 'Omega'; accepted: NAME\.QUANTITY, with a name of a, b"):
        optimise("Omega", [orbit, orbit], over=["gamma"])
    with pytest.raises(ValueError, match="over: given 'r'; accepted: sigma, beta"):
        optimise("r", hopf, over=["r"])
    with pytest.raises(ValueError, match="quantity: given 'amplitude'; accepted: sigma, beta, r"):
        optimise("amplitude", hopf, over=["sigma"])


def test_names_that_quantities_have_are_refused() -> None:
    model = pendulum(parameter_labels=("slope",))
    with pytest.raises(ValueError, match="pendulum: given a parameter or output called slope; accepted: other names"):
        optimise("Omega", member(model, 1), over=["S"])


def test_families_that_are_no_sums_of_odd_cosines_are_refused() -> None:
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    even = OdeModel("even", q, -q - q**2, ca.SX(0, 1), 2, v, reversal=(1, -1))
    with pytest.raises(ValueError, match="of: given an orbit of even; accepted in a family: one of second order that"):
        optimise("Omega", member(even, 1, 0.02), over=["S"])


# Searches over a family, as scripts state them ------------------------------------------------------------------------


def test_a_search_over_a_family_is_its_design() -> None:
    result = search_orbit(
        SHORT, objective="S", maximise=True, free=("S", "gamma"), bounds={"S": (0.01, 3.0), "gamma": (0.0, 0.9)},
        constraints=[lambda o: o.Omega - o.upper_cutoff], starts=2, seed=1,
    )  # fmt: skip
    best = result.best
    assert "SLSQP" in result.engine

    def threshold(gamma: float) -> float:
        """S at which the family itself leaves the band."""
        chain = Chain(SHORT.sites, SHORT.alpha, gamma, SHORT.g)
        cutoff = float(np.sqrt(chain.band()[1]))
        return float(follow_family(chain, "last", 3.0, at_Omega=[cutoff], tolerance=1e-9).at(Omega=cutoff).S)

    assert best.S == best.objective == pytest.approx(threshold(best.gamma), rel=1e-7)
    assert all(threshold(best.gamma + off) < best.S for off in (0.02, -0.02))
    assert best.orbit.Omega == best.Omega
    assert [one.objective for one in result.optima] == sorted((one.objective for one in result.optima), reverse=True)
    with pytest.raises(AttributeError, match="design: given nothing; accepted: "):
        best.nothing  # noqa: B018


def test_functions_of_a_search_at_several_amplitudes_get_the_tuple_of_their_orbits() -> None:
    uniform = Chain(SHORT.sites, 0.9, SHORT.gamma, SHORT.g)
    targets = [member(uniform, S=0.2).Omega, 1.002 * member(uniform, S=0.6).Omega]
    result = search_orbit(
        SHORT, S=(0.2, 0.6), objective="roughness", free=("alpha_n",), bounds={"alpha_n": (0.7, 1.3)},
        constraints=[lambda orbits: ca.vertcat(*(o.Omega - w for o, w in zip(orbits, targets, strict=True)))], starts=1,
    )  # fmt: skip
    assert [orbit.Omega for orbit in result.best.orbits] == pytest.approx(targets, abs=1e-8)
    assert result.best.objective > 0.0


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"S": -1.0}, "S: given -1.0; accepted: a finite number > 0"),
        ({"free": ("Q",)}, "free: given 'Q'; accepted: S, gamma"),
        ({"constraints": ["nope"]}, "constraints, nope: given 'nope'; accepted: "),
        ({"objective": "Omga"}, "objective: given 'Omga'; did you mean Omega? accepted: "),
        ({"bound": {}}, "search_orbit: given the option 'bound'; did you mean bounds?"),
        ({"constraints": 3}, "constraints: given 3; accepted: a list of items"),
        ({"starts": 0}, "starts: given 0; accepted: "),
        ({"tolerance": 1.0}, "tolerance: given 1.0; accepted: "),
    ],
)
def test_a_search_over_a_family_refuses_what_cannot_be_meant(given: dict[str, Any], words: str) -> None:
    stated = {"objective": "Omega", "free": ("S",), "bounds": {"S": (0.1, 0.2)}} | given
    with pytest.raises((ValueError, TypeError)) as told:
        search_orbit(SHORT, **stated)
    assert words in str(told.value)
    assert "\n" not in str(told.value)
