"""Bounds of a boundary-value problem hold along its branches: where they are met, by closed forms."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from casadi_skin import BoundaryValueProblem, Branch, OdeModel, find_orbit, read_result, save_result
from casadi_skin.follow.solution import Solution
from casadi_skin.zero.settings import End

X, Y, P, Q, T = (ca.SX.sym(name) for name in ("x", "y", "p", "q", "t"))


def ends_at_bound(branch: Branch, value: float, words: str, within: float = 1e-10) -> None:
    """The branch ends at a value of its parameter, with these words."""
    assert branch.end is End.BOUND
    assert branch.special_points[-1].kind == "bound"
    assert branch.values[-1] == pytest.approx(value, abs=within)
    assert words in branch.reason
    assert not branch.complete


def line(bounds: tuple[float, float]) -> Solution:
    """x' = p from 0: x(1) = p, at p = 1/2."""
    model = OdeModel("line", X, P + 0 * X, P)
    return BoundaryValueProblem(model, [model.start(X)], parameters={"p": 0.5}, bounds={"x": bounds}).solve([0.0])


@pytest.mark.parametrize(("to", "bounds", "value", "words", "within"), [
    (3.0, (-10.0, 1.0), 1.0, "x comes to its upper bound 1 at t = 1, with p = 1", 1e-10),
    (-3.0, (-2.0, 10.0), -2.0, "x comes to its lower bound -2 at t = 1, with p = -2", 1e-10),
    (5.0, (0.0, 2.0), 2.0, "x comes to its upper bound 2 at t = 1", 1e-10),  # its start is held at a bound
    (-1.0, (0.0, 2.0), 0.0, "x comes to its lower bound 0", 1e-7),
])  # fmt: skip
def test_a_line_ends_where_its_end_meets_a_bound(
    to: float, bounds: tuple[float, float], value: float, words: str, within: float
) -> None:
    ends_at_bound(line(bounds).follow("p", to), value, words, within)


def test_without_a_bound_in_its_way_a_branch_reaches_its_end() -> None:
    branch = line((-1.0, np.inf)).follow("p", 3.0)
    assert branch.complete
    assert branch.special_points == ()


def test_a_bound_holds_between_points_of_the_mesh() -> None:
    """x = p sin(3 t) on [0, 1]: the largest value is p, at pi/6."""
    model = OdeModel("arch", ca.vertcat(X, Y), ca.vertcat(Y, -9.0 * X), P)
    conditions = [model.start(X), model.start(Y) - 3.0 * P]
    problem = BoundaryValueProblem(model, conditions, parameters={"p": 0.2}, bounds={"x": (-5.0, 0.7)})
    branch = problem.solve([0.0, 0.0]).follow("p", 2.0, at=[0.5, 1.5])
    ends_at_bound(branch, 0.7, f"x comes to its upper bound 0.7 at t = {np.pi / 6.0:.6g}", 1e-8)
    assert list(branch.values).count(0.5) == 1
    assert branch.values.max() < 1.5
    assert np.max(branch.solutions[-1].evaluate(np.linspace(0.0, 1.0, 5001))[:, 0]) == pytest.approx(0.7, abs=1e-7)


def test_a_bound_on_a_free_parameter_holds() -> None:
    """x' = q, x(0) = 0, x(1) = p^2: q = p^2."""
    model = OdeModel("free", X, Q + 0 * X, ca.vertcat(P, Q))
    conditions = [model.start(X), model.end(X) - P**2]
    problem = BoundaryValueProblem(
        model, conditions, parameters={"p": 0.5, "q": 0.25}, free=["q"], bounds={"q": (0.0, 4.0)}
    )
    ends_at_bound(problem.solve([0.0]).follow("p", 5.0), 2.0, "q comes to its upper bound 4, with p = 2")


def test_a_bound_that_is_passed_and_left_within_a_step_ends_the_branch() -> None:
    """x(1) = 1 - 40 (p - 1/2)^2 + 1e-4 goes beyond 1 for |p - 1/2| < sqrt(1e-4/40)."""
    model = OdeModel("bump", X, 1.0001 - 40.0 * (P - 0.5) ** 2 + 0 * X, P)
    problem = BoundaryValueProblem(model, [model.start(X)], parameters={"p": 0.2}, bounds={"x": (-30.0, 1.0)})
    branch = problem.solve([0.0]).follow("p", 1.0)
    ends_at_bound(branch, 0.5 - np.sqrt(1e-4 / 40.0), "x comes to its upper bound 1")


def test_a_bound_holds_along_orbits() -> None:
    """The circle of radius sqrt(mu): x comes to 1.2 at mu = 1.44."""
    mu, r2 = ca.SX.sym("mu"), X**2 + Y**2
    model = OdeModel("circle", ca.vertcat(X, Y), ca.vertcat(mu * X - Y - X * r2, X + mu * Y - Y * r2), mu)
    guess = lambda t: [np.cos(t), np.sin(t)]  # noqa: E731
    orbit = find_orbit(model, guess, 2.0 * np.pi, parameters={"mu": 1.0}, bounds={"x": (-9.0, 1.2)})
    ends_at_bound(orbit.follow("mu", 3.0), 1.44, "x comes to its upper bound 1.2", 1e-7)


def test_a_bound_holds_on_the_orbits_that_leave_others() -> None:
    """On the unit circle z' = p z - z^3: the orbits that leave at p = 0 have z = sqrt(p), on either side."""
    z, r2 = ca.SX.sym("z"), X**2 + Y**2
    rhs = ca.vertcat(X * (1 - r2) - 2 * Y, 2 * X + Y * (1 - r2), P * z - z**3)
    model = OdeModel("leaving", ca.vertcat(X, Y, z), rhs, P)
    guess = lambda t: [np.cos(2 * t), np.sin(2 * t), 0.0]  # noqa: E731
    orbit = find_orbit(model, guess, np.pi, parameters={"p": -0.5}, bounds={"z": (-0.4, 0.5)})
    (point,) = orbit.follow("p", 0.5, stability=True).special_points
    ends_at_bound(point.follow("p", 1.0), 0.25, "z comes to its upper bound 0.5", 1e-7)
    ends_at_bound(point.follow("p", 1.0, side=-1), 0.16, "z comes to its lower bound -0.4", 1e-7)


def test_a_branch_that_ended_at_a_bound_is_read_back(tmp_path: Path) -> None:
    branch = line((-10.0, 1.0)).follow("p", 3.0)
    back = read_result(save_result(branch, tmp_path / "branch.json"))
    assert (back.end, back.reason) == (End.BOUND, branch.reason)
    assert [point.kind for point in back.special_points] == ["bound"]
