"""Passages of a branch through a value of a quantity, corrected exactly there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from casadi_skin.continuation.points import Point
from casadi_skin.orbits.making import solution_at
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.space import SolutionSpace


def passage(space: SolutionSpace, solutions: Sequence[Solution], name: str, value: float, which: int) -> Solution:
    """The solution at a passage of a value, counted from 0.

    Raises ValueError where the branch does not pass it that often, ArithmeticError where none is found there.
    """
    passed = 0
    for solution, point in _passages(space, solutions, name, value):
        if passed < which:
            passed += 1
            continue
        if point is None:
            kind = "orbit" if not solutions or isinstance(solutions[0], Orbit) else "solution"
            raise ArithmeticError(f"at: no {kind} was found at {name} = {value:g}, which the branch passes")
        return solution or solution_at(space, point, exact={name: value})
    values = np.array([solution.value(name) for solution in solutions])
    covered = f"{values.min():g} to {values.max():g}" if solutions else "no point"
    words = f"the branch covers {covered} and passes {name} {passed} times"
    raise ValueError(f"at: given {name} = {value!r}, which = {which}; {words}")


def _passages(
    space: SolutionSpace, solutions: Sequence[Solution], name: str, value: float
) -> Iterator[tuple[Solution | None, Point | None]]:
    """Each passage: a solution, or a point corrected there, None where there is none."""
    target, point_solver = space.target(name, value), space.point_solver
    before = space.start if space.start_is_limit else None
    for solution in solutions:
        if solution.value(name) == value:
            yield solution, solution.point
        elif target.meets(solution.point):
            yield None, point_solver.beside(solution.point, target)
        elif before is not None and not target.meets(before):
            for _, point in point_solver.between(before, solution.point, (target,)):
                yield None, point
        before = solution.point
