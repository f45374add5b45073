"""Special points of a family, which are located after it was followed: its folds."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import NotLocatedError, SpecialPoint
from casadi_skin.zero.kinds import FOLD
from casadi_skin.zero.unresolved import Unresolved


def special_point(space: SolutionSpace, solution: Solution) -> SpecialPoint:
    """A solution that is marked as special, as a special point."""
    name, point = space.parameter, solution.point
    values = {**solution.parameters, name: solution.value(name)}
    return SpecialPoint(point.special, name, values, space.parameter_error(point), solution)


def folds_of_family(space: SolutionSpace, solutions: Sequence[Solution]) -> Iterator[SpecialPoint | Unresolved]:
    """Folds between the points of a family."""
    for before, after in pairwise(solutions):
        try:
            for found in space.special_between(before.point, after.point):
                yield found if isinstance(found, Unresolved) else special_point(space, space.solution(found))
        except NotLocatedError as error:
            yield Unresolved(before.value(space.parameter), after.value(space.parameter), str(error), FOLD)
