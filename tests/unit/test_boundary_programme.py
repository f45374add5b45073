"""Boundary-value problems with objectives and bounds against closed forms and against plain solves."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from small_models import bratu, oscillation, van_der_pol

from casadi_skin import BoundaryValueProblem, OdeModel, find_orbit
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import BoundaryError

X, V, A, B, T = (ca.SX.sym(name) for name in ("x", "v", "a", "b", "t"))


def cart(**changes: Any) -> BoundaryValueProblem:
    """From rest at 0 to x(1) = 1 with acceleration a + b t of least square mean."""
    model = OdeModel(
        "cart", ca.vertcat(X, V), ca.vertcat(V, A + B * T), ca.vertcat(A, B), time=T, forcing_period=1.0,
        nominal=(0.0, 0.0),
    )  # fmt: skip
    conditions = [model.start(X), model.start(V), model.end(X) - 1]
    stated: dict[str, Any] = {"free": ["a", "b"], "running": (A + B * T) ** 2}
    return BoundaryValueProblem(model, conditions, **(stated | changes))


def solved(problem: BoundaryValueProblem, **options: Any) -> Solution:
    solution = problem.solve([0.0, 0.0], **options)
    assert solution.optimum.kkt < 1e-9
    assert solution.optimum.violation < 1e-10
    return solution


def test_least_effort_to_a_place_is_the_cubic_of_the_calculus_of_variations() -> None:
    """x'''' = 0 with x''(1) = 0, the natural condition: a = 3, b = -3, cost 3."""
    solution = solved(cart())
    assert solution.parameters == pytest.approx({"a": 3.0, "b": -3.0}, abs=1e-9)
    assert solution.objective == pytest.approx(3.0, abs=1e-9)
    assert solution.status == "a local optimum"


def test_an_end_condition_more_gives_the_other_cubic() -> None:
    """At rest again at t = 1: x = 3 t^2 - 2 t^3, cost 12."""
    problem = cart()
    model = problem.model
    conditions = [*problem.conditions, model.end(V)]
    solution = solved(BoundaryValueProblem(model, conditions, free=problem.free, running=problem.running))
    assert solution.parameters == pytest.approx({"a": 6.0, "b": -12.0}, abs=1e-8)
    assert solution.objective == pytest.approx(12.0, abs=1e-8)


def test_an_active_bound_on_a_parameter_is_named_and_exact() -> None:
    """With a = 2 the condition asks for b = 0: cost 4."""
    solution = solved(cart(bounds={"a": (0.0, 2.0)}))
    assert solution.parameters == pytest.approx({"a": 2.0, "b": 0.0}, abs=1e-8)
    assert solution.optimum.active == ("a <= 2",)
    assert solution.status == "a local optimum on the bounds a <= 2"


@pytest.mark.slow
def test_a_bound_on_a_state_holds_and_tells_its_error() -> None:
    """v = a t + b t^2/2 of mean 1 may reach 1.4 at -a/b: one equation for the ratio, solved apart."""
    solution = solved(cart(bounds={"v": (0.0, 1.4)}))
    assert np.max(solution["v"]) <= 1.4 + 1e-12
    a, b = solution.parameters["a"], solution.parameters["b"]
    assert a**2 / (-2 * b) == pytest.approx(1.4, abs=1e-6)  # the peak of v, between the mesh's points
    best = minimize_scalar(lambda s: s**2 + 6 * s * (1 - s / 2) + 12 * (1 - s / 2) ** 2, bounds=(0, 10))
    assert solution.objective > best.fun  # the unconstrained cost is less
    assert "v <= 1.4" in solution.status


def test_bounds_that_no_solution_meets_are_told_with_condition_and_place() -> None:
    with pytest.raises(BoundaryError, match=r"cart: no point near the guess satisfies .* largest violation .* of "):
        cart(bounds={"v": (0.0, 0.5)}).solve([0.0, 0.0])


def test_the_fold_of_bratu_is_a_maximum_of_its_parameter() -> None:
    """lambda = 3.513830719125162 (Davis 1962; from c tanh(c) = 1, lambda = 8 c^2/cosh(c)^2), the fold of its branch."""
    problem = bratu(1.0, free=["lam"], objective=lambda t, x, p: -p[0])
    assert solved(problem)["lam"] == pytest.approx(3.513830719125162, abs=1e-9)


def test_a_problem_with_bounds_alone_is_solved_within_them() -> None:
    """u'' = -exp(u) has two solutions; bounds choose the upper one."""
    lower, bounds = bratu(1.0).solve([0.0, 0.0]), {"u": (-1e-9, 10.0), "v": (-30.0, 30.0)}
    upper = bratu(1.0, bounds=bounds).solve(lambda t: [16 * t * (1 - t), 16 - 32 * t])
    assert np.max(lower["u"]) == pytest.approx(0.1405, abs=1e-3)
    assert np.max(upper["u"]) == pytest.approx(4.0915, abs=1e-3)


def test_a_solution_with_an_objective_cannot_be_followed() -> None:
    with pytest.raises(ValueError, match="follow: given a solution with an objective"):
        solved(cart()).follow("a", 1.0)


# Orbits ---------------------------------------------------------------------------------------------------------------


def test_the_parameter_of_the_largest_forced_response_agrees_with_plain_orbits() -> None:
    q, v, omega, t = (ca.SX.sym(name) for name in ("q", "v", "omega", "t"))
    field = ca.vertcat(v, -q - q**3 - 0.3 * v + 0.1 * ca.cos(omega * t))
    model = OdeModel("Duffing", ca.vertcat(q, v), field, omega, time=t, forcing_period=2 * ca.pi / omega)
    best = find_orbit(
        model, [0.0, 0.0], parameters={"omega": 1.0}, free=["omega"], running=-(q**2), bounds={"omega": (0.3, 2.0)}
    )

    def response(value: float) -> float:
        orbit = find_orbit(model, best, parameters={"omega": value}, tolerance=1e-10)
        times = orbit.period * np.arange(64) / 64  # the trapezoidal rule is spectral on a period
        return -float(np.mean(orbit.evaluate(times)[:, 0] ** 2))

    found = minimize_scalar(response, bracket=(best["omega"] - 0.01, best["omega"] + 0.01), tol=1e-7)
    assert best["omega"] == pytest.approx(found.x, abs=1e-5)
    assert best.optimum.objective == pytest.approx(found.fun, abs=1e-9)


def test_a_free_parameter_is_found_by_a_condition_at_phase_zero() -> None:
    """The van der Pol oscillator whose largest displacement is 2.01."""
    model = van_der_pol()
    x, y = model.state[0], model.state[1]
    first = find_orbit(model, lambda t: [2 * np.cos(t), -2 * np.sin(t)], 6.6, parameters={"mu": 1.0}, section=y)
    orbit = find_orbit(model, first, parameters={"mu": 1.0}, free=["mu"], select=x - 2.01, section=y)
    check = find_orbit(model, first, parameters={"mu": float(orbit["mu"])}, section=y)
    assert orbit.evaluate(0.0)[0] == pytest.approx(2.01, abs=1e-9)
    assert check.period == pytest.approx(orbit.period, abs=1e-7)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"select": ca.SX.sym("mu") > 1}, "select: given a comparison"),
        ({"objective": "frequency"}, "objective: given 'frequency'; accepted: an expression, or 'period'"),
        ({"bounds": {"mu": (1.0, 0.5)}}, "bounds.mu.: given .*; accepted: .lower, upper., lower <= upper"),
        ({"bounds": {"nu": (0.0, 1.0)}}, "bounds: given 'nu'; accepted: x, y, period, mu"),
        ({"objective": ca.SX.sym("u")}, "objective: depends on u; accepted: x, y, mu"),
        ({"running": ca.SX.sym("u")}, "running: depends on u; accepted: "),
        ({"select": ca.SX.sym("u")}, "select: depends on u; accepted: x, y, mu"),
    ],
)
def test_what_cannot_be_meant_is_refused_before_any_solve(changes: dict[str, Any], words: str) -> None:
    asked: dict[str, Any] = {"free": ["mu"], "objective": "period"}
    with pytest.raises(ValueError, match=words):
        oscillation(**(asked | changes))
