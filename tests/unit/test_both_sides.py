"""Both sides of a branch point of boundary-value problems can be left, also where the branch leaves upright."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from casadi_skin import BoundaryValueProblem, Branch, OdeModel
from casadi_skin.follow.special_points import SpecialPoint

SLOPE = 0.013  # on which the walker starts


def swing(x: ca.SX, slope: ca.SX) -> ca.SX:
    """The simplest walking model (Garcia et al. 1998): angle of the stance leg, of the hip, and their rates."""
    turn = ca.sin(x[0] - slope)
    return ca.vertcat(x[1], turn, x[3], turn + x[1] ** 2 * ca.sin(x[2]) - ca.cos(x[0] - slope) * ca.sin(x[2]))


def after_impact(x: ca.SX) -> ca.SX:
    kept = ca.cos(2.0 * x[0])
    return ca.vertcat(-x[0], kept * x[1], -2.0 * x[0], kept * (1.0 - kept) * x[1])


def step_from(angle: float, rate: float, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of one step, shape (4, times), by another integrator."""
    x, slope = ca.SX.sym("x", 4), ca.SX.sym("slope")
    field = ca.Function("field", [x, slope], [swing(x, slope)])
    start = [angle, rate, 2.0 * angle, (1.0 - np.cos(2.0 * angle)) * rate]
    times = np.linspace(0.0, duration, 201)
    run = solve_ivp(
        lambda t, s: np.array(field(s, SLOPE)).ravel(), (0.0, duration), start, "DOP853", times, rtol=1e-10, atol=1e-11
    )
    return times, run.y


def two_steps() -> Branch:
    """Two steps of a walker one after the other, each with a duration of its own, down a slope."""

    def missed(unknown: np.ndarray) -> list[float]:
        angle, rate, duration = unknown
        _, states = step_from(angle, rate, duration)
        end = states[:, -1]
        return [end[0] + angle, np.cos(2.0 * end[0]) * end[1] - rate, end[2] - 2.0 * end[0]]

    angle, rate, duration = fsolve(missed, [0.97 * SLOPE ** (1 / 3), -1.0 * SLOPE ** (1 / 3), 3.8])
    times, states = step_from(angle, rate, duration)
    one, other = ca.SX.sym("a", 4), ca.SX.sym("b", 4)
    slope, first, second = (ca.SX.sym(name) for name in ("slope", "first", "second"))
    rhs = ca.vertcat(first * swing(one, slope), second * swing(other, slope))
    model = OdeModel("walker", ca.vertcat(one, other), rhs, ca.vertcat(slope, first, second))
    start, end = model.ends
    conditions = [
        start[4:] - after_impact(end[:4]), start[:4] - after_impact(end[4:]), end[2] - 2 * end[0], end[6] - 2 * end[4]
    ]  # fmt: skip
    values = {"slope": SLOPE, "first": duration, "second": duration}
    problem = BoundaryValueProblem(model, conditions, parameters=values, free=["first", "second"])
    branch: Branch = problem.solve((times / duration, np.vstack([states, states]))).follow("slope", 0.017)
    return branch


def branch_point(branch: Branch) -> SpecialPoint:
    (point,) = (point for point in branch.special_points if point.kind == "branch point")
    return point


def test_limping_gaits_leave_two_stacked_steps_to_both_sides() -> None:
    """The doubling at a slope of 0.015 (Garcia et al. 1998): the halves are one gait, begun with either leg."""
    point = branch_point(two_steps())
    assert point.parameters["slope"] == pytest.approx(0.0151, abs=1e-4)
    halves = [point.follow("slope", 0.0165, side=side, at=[0.016]) for side in (1, -1)]
    assert all(half.complete for half in halves)
    left, right = (half.at(0.016) for half in halves)
    assert abs(left["first"] - left["second"]) > 0.1
    assert (left["first"], left["second"]) == pytest.approx((right["second"], right["first"]), abs=1e-7)


def test_a_strut_buckles_to_both_sides() -> None:
    """Euler's: x'' = -p sin(x), clamped to slide: 4 K(sin(a/2))^2 = p at amplitude a, from p = pi^2."""
    x, y, p = (ca.SX.sym(name) for name in "xyp")
    model = OdeModel("strut", ca.vertcat(x, y), ca.vertcat(y, -p * ca.sin(x)), p)
    problem = BoundaryValueProblem(model, [model.start(y), model.end(y)], parameters={"p": 5.0})
    point = branch_point(problem.solve([0.0, 0.0]).follow("p", 20.0))
    assert point.parameters["p"] == pytest.approx(np.pi**2, abs=1e-10)
    ends = [point.follow("p", 20.0, side=side).solutions[-1].evaluate(0.0)[0] for side in (1, -1)]
    assert ends[0] == pytest.approx(-ends[1], abs=1e-6)
    assert abs(ends[0]) > 1.0


def test_the_two_sides_of_a_branch_that_crosses_aslant_go_up_and_down() -> None:
    """x'' = -p (x - x^2) with x = 0 at both ends: the other branch has p < pi^2 on one side, p > pi^2 on the other."""
    x, y, p = (ca.SX.sym(name) for name in "xyp")
    model = OdeModel("aslant", ca.vertcat(x, y), ca.vertcat(y, -p * (x - x**2)), p)
    problem = BoundaryValueProblem(model, [model.start(x), model.end(x)], parameters={"p": 5.0})
    point = branch_point(problem.solve([0.0, 0.0]).follow("p", 20.0))
    up, down = (point.follow("p", 15.0, side=side, back_to=6.0) for side in (1, -1))
    assert up.complete
    assert up.values[-1] == 15.0
    assert down.values[-1] <= 6.0
    assert up.solutions[-1].evaluate(0.5)[0] * down.solutions[-1].evaluate(0.5)[0] < 0.0
