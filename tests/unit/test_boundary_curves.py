"""Folds and branch points of boundary-value problems in two parameters, against closed forms and a time map."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols
from scipy.optimize import fsolve

from casadi_skin import BoundaryValueProblem, Branch, OdeModel, read_result, save_result
from casadi_skin.follow.rest_space import UnfoldingError
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.zero.settings import End

BRATU = 3.513830719125161  # 8 (z^2 - 1) where z tanh z = 1


def slab(eps: float = 0.2) -> BoundaryValueProblem:
    """Gelfand's problem in a slab: u'' + lam exp(u / (1 + eps u)) = 0 with u = 0 at both ends."""
    u, v, lam, e = symbols("u v lam eps")
    model = OdeModel("slab", ca.vertcat(u, v), ca.vertcat(v, -lam * ca.exp(u / (1 + e * u))), ca.vertcat(lam, e))
    return BoundaryValueProblem(model, [model.start(u), model.end(u)], parameters={"lam": 1.0, "eps": eps})


def time_map(largest: np.ndarray | float, eps: float) -> np.ndarray:
    """lam at which the slab has a solution with this largest u, by quadrature of its first integral."""
    x, w = np.polynomial.legendre.leggauss(40)
    x, w, a = 0.5 * (x + 1.0), 0.5 * w, np.asarray(largest, dtype=float)[..., None]
    u = a * (1.0 - x**2)
    t = u[..., None] + (a - u)[..., None] * x
    mean = np.exp(t / (1.0 + eps * t)) @ w
    return 8.0 * a[..., 0] * ((1.0 / np.sqrt(mean)) @ w) ** 2


def bends(largest: float, eps: float) -> list[float]:
    """First and second derivative of the time map, by a polynomial through Chebyshev points."""
    x = np.cos(np.pi * (np.arange(17) + 0.5) / 17)
    p = np.polynomial.chebyshev.Chebyshev(np.polynomial.chebyshev.chebfit(x, time_map(largest + 0.5 * x, eps), 16))
    return [float(2.0 * p.deriv(1)(0.0)), float(4.0 * p.deriv(2)(0.0))]


@pytest.fixture(scope="module")
def folds() -> tuple[SpecialPoint, ...]:
    """Ignition and extinction at eps = 0.2."""
    points: tuple[SpecialPoint, ...] = slab().solve([0.0, 0.0]).follow("lam", 6.0).special_points
    return points


@pytest.fixture(scope="module")
def curve(folds: tuple[SpecialPoint, ...]) -> Branch:
    return folds[0].curve("eps", 0.3)


def test_folds_of_a_slab_are_the_turns_of_its_time_map(folds: tuple[SpecialPoint, ...]) -> None:
    assert [point.kind for point in folds] == ["fold", "fold"]
    for point, near in zip(folds, (2.35, 15.0), strict=True):
        largest = float(fsolve(lambda a: bends(a[0], 0.2)[:1], near, xtol=1e-12)[0])
        assert point.solution.evaluate(0.5)[0] == pytest.approx(largest, rel=1e-7)
        assert point.parameters["lam"] == pytest.approx(time_map(largest, 0.2), rel=1e-12)


def test_two_folds_meet_at_the_cusp_of_the_time_map(curve: Branch) -> None:
    """Beyond eps = 0.2457804 there is one solution for every lam: the known limit of ignition in a slab."""
    (cusp,) = curve.special_points
    largest, eps = fsolve(lambda x: bends(x[0], x[1]), (4.9, 0.2457), xtol=1e-12)
    assert cusp.kind == "cusp"
    assert abs(cusp.parameters["eps"] - eps) <= cusp.error + 1e-11 < 1e-10
    assert abs(cusp.parameters["lam"] / time_map(largest, eps) - 1.0) <= cusp.solution.point.error.Omega < 1e-10
    assert cusp.solution.evaluate(0.5)[0] == pytest.approx(largest, rel=1e-5)
    assert curve.end is End.RETURNED
    assert not curve.with_stability


def test_a_curve_of_folds_ends_in_bratus_problem(folds: tuple[SpecialPoint, ...]) -> None:
    ended = folds[0].curve("eps", 0.0)
    assert ended.complete
    assert ended["lam"][-1] == pytest.approx(BRATU, abs=1e-11)


def test_solutions_on_a_curve_are_those_of_the_problem_itself(curve: Branch, tmp_path: Path) -> None:
    for solution in curve.solutions[::6]:
        assert solution.evaluate([0.0, 0.5]).shape == (2, 2)
        largest = float(solution.evaluate(0.5)[0])
        assert solution["lam"] == pytest.approx(time_map(largest, solution["eps"]), rel=1e-9)
        assert abs(bends(largest, solution["eps"])[0]) < 1e-7
    save_result(curve, tmp_path / "curve")
    again = read_result(tmp_path / "curve")
    assert np.array_equal(again["lam"], curve["lam"])
    assert repr(again.special_points) == repr(curve.special_points)


def test_a_solution_on_a_curve_of_folds_starts_no_branch(curve: Branch, folds: tuple[SpecialPoint, ...]) -> None:
    for solution, parameter in ((curve.solutions[3], "eps"), (folds[0].solution, "lam")):
        words = f"given a fold, where the equations at a held {parameter} are singular; accepted: a solution beside it"
        with pytest.raises(ValueError, match=words):
            solution.follow(parameter, 0.5)
    with pytest.raises(ValueError, match="parameter: given 'lam'; accepted: eps"):
        curve.solutions[3].follow("lam", 1.0)


def cusp_of_constants() -> BoundaryValueProblem:
    """A constant y = c with y^3 - q y - p = 0 in the mean, on an interval to 1 + q^2: folds at 27 p^2 = 4 q^3."""
    y, c, p, q = symbols("y c p q")
    model = OdeModel("constant", y, ca.SX(0.0), ca.vertcat(c, p, q))
    return BoundaryValueProblem(
        model, [model.start(y) - c], [y**3 - q * c - p], (0.0, 1 + q**2), {"c": -1.5, "p": -2.0, "q": 1.0}, ["c"]
    )


@pytest.mark.slow
def test_conditions_integrals_and_intervals_enter_the_equations_of_folds() -> None:
    points = cusp_of_constants().solve([-1.5]).follow("p", 2.0).special_points
    exact = np.sqrt(4.0 / 27.0)
    for point, value in zip(points, (exact, -exact), strict=True):
        assert abs(point.parameters["p"] - value) <= point.error + 1e-15 < 1e-12
    found = points[0].curve("q", -1.0, max_step=1.0, at=[0.25])
    np.testing.assert_allclose(27.0 * found["p"] ** 2, 4.0 * found["q"] ** 3, rtol=0, atol=1e-10)
    shown = found.at(q=0.25)
    assert shown.interval == (0.0, 1.0 + 0.25**2)
    assert shown.t[-1] == shown.mesh[-1] == shown.interval[1]
    (cusp,) = found.special_points
    assert cusp.kind == "cusp"
    assert abs(cusp.parameters["q"]) <= cusp.error < 1e-12
    assert abs(cusp.parameters["p"]) < 1e-12


@pytest.fixture(scope="module")
def column() -> Branch:
    """A column on an elastic bed, u'' + lam sin(u) - q u - r = 0: straight for r = 0, buckles at (k pi)^2 + q."""
    u, v, lam, q, r = symbols("u v lam q r")
    rhs = ca.vertcat(v, -lam * ca.sin(u) + q * u + r)
    model = OdeModel("column", ca.vertcat(u, v), rhs, ca.vertcat(lam, q, r))
    problem = BoundaryValueProblem(model, [model.start(u), model.end(u)], parameters={"lam": 5.0, "q": 0.0, "r": 0.0})
    return problem.solve([0.0, 0.0]).follow("lam", 45.0)


def test_branch_points_of_a_column_are_located_and_followed(column: Branch) -> None:
    for k, point in enumerate(column.special_points, start=1):
        assert abs(point.parameters["lam"] - (k * np.pi) ** 2) <= point.error + 1e-14 < 1e-11
        found = point.curve("q", 10.0)
        assert found.complete
        np.testing.assert_allclose(found["lam"] - found["q"], (k * np.pi) ** 2, rtol=0, atol=1e-10)


def test_a_load_from_the_side_keeps_the_second_branch_point_alone(column: Branch) -> None:
    """It is even about the middle, as the first mode is: bent states of the second one still come in pairs."""
    first, second = column.special_points
    with pytest.raises(UnfoldingError, match="the branch point is none at other values of r"):
        first.curve("r", 1.0)
    assert second.curve("r", 1.0).complete


@pytest.mark.slow
def test_branch_points_do_not_depend_on_the_tolerance() -> None:
    """A driven cycle that loses its symmetry: 5e-7 of the place were lost to the predictor at 1e-8."""
    x, y, a, t = symbols("x y a t")
    rhs = ca.vertcat(a * x - 2 * y + ca.cos(t), 2 * x + a * y) - (x**2 + y**2) * ca.vertcat(x, y)
    model = OdeModel("driven", ca.vertcat(x, y), rhs, a, time=t, forcing_period=2.0 * np.pi)
    conditions = [model.start(x) - model.end(x), model.start(y) - model.end(y)]
    problem = BoundaryValueProblem(model, conditions, interval=(0.0, 2.0 * np.pi), parameters={"a": 0.4})
    places = []
    for tolerance in (1e-6, 1e-9):
        (point,) = problem.solve([0.0, 0.0], tolerance=tolerance).follow("a", 0.54).special_points
        assert abs(complex(np.max(np.abs(point.solution.floquet().others))) - 1.0) < 1e-7
        places.append(point.parameters["a"])
    assert places[0] == pytest.approx(places[1], abs=1e-10)
