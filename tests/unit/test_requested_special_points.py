"""Requested values that are special points themselves, in closed form, of equilibria, problems and orbits alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols

from casadi_skin import BoundaryValueProblem, OdeModel, find_equilibrium, find_orbit
from casadi_skin.follow.follow import BranchRun, following_space
from casadi_skin.zero.settings import End

x, y, a, b, p = symbols("x y a b p")
FORMS = {"pitchfork": p * x - x**3, "transcritical": p * x - x**2, "fold": p - x**2}
FIELD = {name: ca.Function(name, [x, p], [form]) for name, form in FORMS.items()}
CIRCLE = [x - y - x * (x**2 + y**2), x + y - y * (x**2 + y**2)]  # the cycle (cos t, sin t)


def equilibrium(form: str, start: float, value: float) -> Any:
    return find_equilibrium(OdeModel(form, x, FORMS[form], p), [value], parameters={"p": start})


def boundary(form: str, start: float, value: float) -> Any:
    """The constant x whose value at the start is an equilibrium."""
    model = OdeModel(form, x, 0, p)
    return BoundaryValueProblem(model, [FIELD[form](model.start(x), p)], parameters={"p": start}).solve([value])


def cycle(form: str, start: float, value: float) -> Any:
    """A cycle beside which a third component has the normal form."""
    model = OdeModel(form, ca.vertcat(x, y, a), ca.vertcat(*CIRCLE, FIELD[form](a, p)), p)
    return _cycle(model, start, [value])


def _cycle(model: OdeModel, start: float, rest: list[float]) -> Any:
    def guess(t: Any) -> np.ndarray:
        return np.stack([np.cos(t), np.sin(t), *(0.0 * t + value for value in rest)], axis=-1)

    return find_orbit(model, guess, 2.0 * np.pi, parameters={"p": start})


def component(solution: Any) -> float:
    state = solution.state if hasattr(solution, "state") else solution.evaluate(0.0)
    return float(np.ravel(state)[-1])


KINDS = {"pitchfork": "branch point", "transcritical": "branch point", "fold": "fold"}


STARTS = [("pitchfork", -1.0, 0.0), ("pitchfork", 1.0, 1.0), ("transcritical", 1.0, 1.0), ("fold", 1.0, 1.0)]
CASES = [(equilibrium, *start, ends) for start in STARTS for ends in (False, True)]
FEWER = [(*STARTS[0], False), (*STARTS[0], True), (*STARTS[1], True), (*STARTS[3], False)]
SLOW = [pytest.param(make, *case, marks=pytest.mark.slow) for make in (boundary, cycle) for case in FEWER]


@pytest.mark.parametrize(("make", "form", "start", "value", "ends"), [*CASES, *SLOW])
def test_a_requested_special_point_is_the_solution_there(
    make: Callable[[str, float, float], Any], form: str, start: float, value: float, ends: bool
) -> None:
    """At x = 0, p = 0 in every case; beyond it the branch of zeros, or the other half of the parabola."""
    first = make(form, start, value)
    branch = first.follow("p", 0.0) if ends else first.follow("p", -start, at=[0.0, 0.5 * start])
    assert branch.missed == ()
    (point,) = branch.special_points
    assert point.kind == KINDS[form]
    assert point.parameters["p"] == 0.0
    assert 0.0 < point.error < 1e-7
    assert abs(component(point.solution)) < 1e-7
    there = [solution for solution in branch if solution.parameters["p"] == 0.0]
    assert there == [point.solution]
    if ends:
        assert branch.end is End.REACHED
        assert branch.complete
        assert branch.solutions[-1] is point.solution
    else:
        assert point.solution.point.requested
        last = branch.solutions[-1]
        at_end = last.parameters["p"]
        known = {"transcritical": at_end, "pitchfork": -value * abs(at_end) ** 0.5, "fold": -(abs(at_end) ** 0.5)}
        assert component(last) == pytest.approx(known[form], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("to", [0.0, 1.0])
@pytest.mark.parametrize("kind", ["period doubling", "torus"])
def test_a_requested_value_at_which_multipliers_cross_is_the_special_orbit(kind: str, to: float) -> None:
    """Multipliers -exp(2 pi p), or exp(2 pi (p +- 0.3i)), in closed form: both on the circle at p = 0."""
    if kind == "torus":
        rest = [p * a - 0.3 * b - a * (a**2 + b**2), p * b + 0.3 * a - b * (a**2 + b**2)]
    else:  # (a, b) in axes that turn by half the phase of the cycle: growth p along one, -1 along the other
        mean, half = 0.5 * (p - 1), 0.5 * (p + 1)
        rest = [mean * a + half * (x * a + y * b) - 0.5 * b - a**3, mean * b + half * (y * a - x * b) + 0.5 * a - b**3]
    model = OdeModel(kind, ca.vertcat(x, y, a, b), ca.vertcat(*CIRCLE, *rest), p)
    branch = _cycle(model, -1.0, [0.0, 0.0]).follow("p", to, at=[0.0], stability=True)
    (point,) = branch.special_points
    assert (point.kind, point.parameters["p"], branch.end) == (kind, 0.0, End.REACHED)
    assert [solution for solution in branch if solution.parameters["p"] == 0.0] == [point.solution]
    np.testing.assert_allclose(np.sort(np.abs(point.solution.floquet().others))[-1], 1.0, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("make", "form"), [(equilibrium, "fold"), (equilibrium, "pitchfork"), (boundary, "fold")])
def test_a_branch_that_is_broken_off_anywhere_goes_on_with_the_same_points(
    make: Callable[[str, float, float], Any], form: str
) -> None:
    first = make(form, 1.0, 1.0)
    space = following_space(first, "p", -1.0, at=[0.0, 0.5, 1e-4], max_points=500, max_step=0.2)
    whole = _points(BranchRun(space))
    names = [solution.point.special for solution in whole]
    special = next(number for number, name in enumerate(names) if name)
    for cut in range(special - 1, special + 2):
        again = _points(BranchRun(space, solutions=whole[:cut]))
        assert [one.point.special for one in again] == names, cut
        for one, other in zip(again, whole, strict=True):
            np.testing.assert_array_equal(one.point.z, other.point.z)


def _points(following: BranchRun) -> list[Any]:
    for _ in following:
        pass
    return following.solutions
