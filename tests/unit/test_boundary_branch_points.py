"""Branch points of boundary-value problems against closed forms, and the branches that leave there."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.special import j0, y0
from small_models import bratu

from casadi_skin import BoundaryValueProblem, Branch, OdeModel


@pytest.fixture(scope="module")
def zero() -> Branch:
    """AUTO-07p's demo `bvp`: u'' = -(p pi)^2 u + u^2 with u = 0 at both ends; the branch of zeros."""
    u, v, p = symbols("u v p")
    model = OdeModel("bvp", ca.vertcat(u, v), ca.vertcat(v, -((p * np.pi) ** 2) * u + u**2), p)
    problem = BoundaryValueProblem(model, [model.start(u), model.end(u)], parameters={"p": 0.5})
    return problem.solve([0.0, 0.0]).follow("p", 5.5)


def test_the_branch_points_of_auto_are_found_with_their_errors(zero: Branch) -> None:
    """At p = 1, 2, 3, 4, 5, where sin(p pi x) solves the linear problem."""
    assert [point.kind for point in zero.special_points] == ["branch point"] * 5
    for exact, point in enumerate(zero.special_points, start=1):
        assert abs(point.parameters["p"] - exact) <= point.error < 1e-7


@pytest.mark.parametrize(("place", "to"), [(0, 1.6), (0, 0.7), pytest.param(1, 2.5, marks=pytest.mark.slow)])
def test_the_other_branch_solves_the_problem_by_another_method(zero: Branch, place: int, to: float) -> None:
    point = zero.special_points[place]
    last = point.follow("p", to).solutions[-1]
    assert last.parameters["p"] == to

    def rhs(t: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.vstack([y[1], -((to * np.pi) ** 2) * y[0] + y[0] ** 2])

    def ends(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.array([a[0], b[0]])

    x = np.linspace(0.0, 1.0, 101)
    # below 1e-8 its residuals are rounding next to zeros of the rates, and more nodes increase them
    known = solve_bvp(rhs, ends, x, 1.001 * last.evaluate(x).T, tol=1e-8, max_nodes=20000)
    assert known.success
    size = np.max(np.abs(known.sol(x)[0]))
    assert size > 0.1
    np.testing.assert_allclose(last.evaluate(x)[:, 0], known.sol(x)[0], atol=1e-6 * size)


def test_no_branch_point_is_seen_where_there_is_a_fold_alone() -> None:
    """Bratu's problem: one fold at 3.513830719125."""
    branch = bratu(1.0).solve([0.0, 0.0]).follow("lam", 4.0)
    assert [point.kind for point in branch.special_points] == ["fold"]
    assert branch.special_points[0].parameters["lam"] == pytest.approx(3.513830719125, abs=1e-11)
    assert not branch.complete  # it turns there
    assert "came back to the value" in branch.reason


@pytest.mark.slow
@pytest.mark.parametrize("max_step", [0.2, 1.0])
def test_a_fold_and_a_branch_point_within_one_step_are_both_found(max_step: float) -> None:
    """s^2 = p and t (t - s + 0.02) = 0 for constants s and t: a fold at s = 0, and t = s - 0.02 crosses at s = 0.02."""
    s, t, p = (ca.SX.sym(name) for name in "stp")
    model = OdeModel("constants", ca.vertcat(s, t), ca.vertcat(0, 0), p)
    x, y = model.start(s), model.start(t)
    problem = BoundaryValueProblem(model, [x**2 - p, y * (y - x + 0.02)], parameters={"p": 0.25})
    points = problem.solve([-0.5, 0.0]).follow("p", -1.0, max_step=max_step).special_points
    assert [point.kind for point in points] == ["fold", "branch point"]
    np.testing.assert_allclose([point.parameters["p"] for point in points], [0.0, 4e-4], atol=1e-9)


def copies(fields: Sequence[Callable[[ca.SX, ca.SX], ca.SX]]) -> BoundaryValueProblem:
    """u'' = f(u, y), u = 0 at both ends, for each f; the constant y with y + y^3 = p bends the branch of zeros."""
    count = len(fields)
    x, y, p = ca.SX.sym("x", 2 * count), ca.SX.sym("y"), ca.SX.sym("p")
    rows = [row for k, f in enumerate(fields) for row in (x[2 * k + 1], f(x[2 * k], y))]
    model = OdeModel("copies", ca.vertcat(x, y), ca.vertcat(*rows, 0), p)
    held = [end(x[2 * k]) for k in range(count) for end in (model.start, model.end)]
    return BoundaryValueProblem(model, [*held, model.start(y) + model.start(y) ** 3 - p], parameters={"p": 0.5})


def linear(y: ca.SX) -> ca.SX:
    return -((np.pi * y) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    "fields",
    [
        [lambda u, y: linear(y) * u + u**2] * 2,
        [lambda u, y: linear(y) * u + u**2, lambda u, y: linear(y) * u + u**3, lambda u, y: linear(y) * u - u**2],
        [lambda u, y: linear(y) * u + u**2, lambda u, y: -(np.pi**2) * (1.0 + 100.0 * (y - 1.0)) * u + u**3],
    ],
    ids=["two", "three", "one a hundred times as fast"],
)
def test_where_several_branches_cross_in_one_place_it_has_the_digits_of_the_mesh(
    fields: list[Callable[[ca.SX, ca.SX], ca.SX]],
) -> None:
    """At y = 1, so that p = 2, where sin(pi x) solves every linear problem."""
    points = copies(fields).solve([0.0, 0.0] * len(fields) + [0.4]).follow("p", 2.05).special_points
    assert [point.kind for point in points] == ["branch point"]
    assert abs(points[0].parameters["p"] - 2.0) <= points[0].error < 1e-10
    y = float(points[0].solution.evaluate(np.array([0.3]))[0, -1])
    assert abs(y - 1.0) < 1e-10  # the solution there is one of the branch


@pytest.mark.slow
@pytest.mark.parametrize("shift", [1e-6, 1e-7, 1e-10])
def test_branches_that_cross_next_to_each_other_are_apart_or_within_the_error(shift: float) -> None:
    """At y = 1 - shift and y = 1; the tolerance is 1e-8."""
    fields = [lambda u, y: linear(y) * u + u**2, lambda u, y: linear(y + shift) * u + u**3]
    points = copies(fields).solve([0.0] * 4 + [0.4]).follow("p", 2.7).special_points
    places = [1.0 - shift + (1.0 - shift) ** 3, 2.0]
    assert len(points) == (1 if shift < 1e-9 else 2)
    for k, place in enumerate(places):
        point = points[k % len(points)]
        assert abs(point.parameters["p"] - place) <= point.error < 1e-8


@pytest.mark.slow
def test_where_two_branches_cross_the_digits_are_those_of_bessel_functions() -> None:
    """u'' = -(p pi exp(p t))^2 u has the solutions J0 and Y0 of pi exp(p t)."""
    u, v, w, x, y, p = symbols("u v w x y p")
    rate = -((p * np.pi * y) ** 2)
    rows = ca.vertcat(v, rate * u + u**2, x, rate * w + w**2, p * y)
    model = OdeModel("growing", ca.vertcat(u, v, w, x, y), rows, p)
    held = [end(one) for one in (u, w) for end in (model.start, model.end)]
    problem = BoundaryValueProblem(model, [*held, model.start(y) - 1], parameters={"p": 0.5})
    points = problem.solve([0.0, 0.0, 0.0, 0.0, 1.0], tolerance=1e-10).follow("p", 1.2).special_points

    def crossed(value: float) -> float:
        a, b = np.pi, np.pi * np.exp(value)
        return float(j0(a) * y0(b) - y0(a) * j0(b))

    assert len(points) == 2
    for point, (low, high) in zip(points, [(0.6, 0.8), (1.0, 1.2)], strict=True):
        assert abs(point.parameters["p"] - brentq(crossed, low, high, xtol=1e-15)) <= point.error + 1e-14 < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_branch_points_close_to_each_other_are_all_found(seed: int) -> None:
    """y (y - prod (p - c)) = 0 for a constant y: one eigenvalue passes zero at each c, and comes back at the next."""
    generator = np.random.default_rng(seed)
    first = np.sort(generator.uniform(0.1, 0.9, 2))
    places = np.sort(np.concatenate([first, first + 10.0 ** generator.uniform(-2.5, -1.0, 2)]))
    y, p = symbols("y p")
    model = OdeModel("constant", y, ca.SX(0.0), p)
    start = model.start(y)
    product = ca.SX(30.0)
    for place in places:
        product = product * (p - place)
    problem = BoundaryValueProblem(model, [start * (start - product)], parameters={"p": 0.0})
    points = problem.solve([0.0]).follow("p", 1.2).special_points
    np.testing.assert_allclose([point.parameters["p"] for point in points], places, rtol=0, atol=1e-7)


@pytest.mark.parametrize(("turn", "sign", "kind"), [(2.0, 1.0, "torus"), (0.0, -1.0, "period doubling")])
def test_multipliers_of_closed_solutions_cross_the_circle_where_they_do(turn: float, sign: float, kind: str) -> None:
    """x' = A x - |x|^2 x has the multipliers sign exp(a +- i turn) at x = 0, of which the second is damped if real."""
    x, y, a = symbols("x y a")
    damping = 0.0 if turn else 2.0
    rate = ca.vertcat(a * x - turn * y, turn * x + (a - damping) * y) - (x**2 + y**2) * ca.vertcat(x, y)
    model = OdeModel("closed", ca.vertcat(x, y), rate, a)
    problem = BoundaryValueProblem(
        model, [model.start(x) - sign * model.end(x), model.start(y) - sign * model.end(y)], parameters={"a": -0.7}
    )
    branch = problem.solve([0.0, 0.0]).follow("a", 1.1, stability=True)
    (point,), (change,) = branch.special_points, branch.changes
    assert point.kind == kind
    assert abs(point.parameters["a"]) <= point.error <= 1e-6 * (1.0 + 1e-6)  # a hundred tolerances, but for rounding
    assert abs(change.value) <= change.error < 1e-4
    assert change.stable_before
    assert not change.stable_after
    assert change.angle == pytest.approx(turn or np.pi, abs=1e-5)
    assert np.all(branch.to_dataframe()["max_abs_multiplier"] > 0.0)
    assert repr(point).startswith(f"<{kind} at a = ")
    assert point.coefficient == pytest.approx(-2.0 if turn else -1.0, rel=1e-5)  # v has mean square 1
    assert point.criticality == "supercritical"
    if kind == "torus":
        with pytest.raises(
            ValueError, match="follow: given a torus of a boundary-value problem; accepted: a Hopf point"
        ):
            point.follow("a", 0.5)
    with pytest.raises(ValueError, match="accepted"):
        point.curve("a", 0.5)
