"""Solutions of a space from its points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from casadi_skin.continuation.points import Point
from casadi_skin.orbits.boundary_space import BoundarySpace
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.space import SolutionSpace
from casadi_skin.stability.result import Floquet


@runtime_checkable
class MakesSolutions(Protocol):
    """A space whose solutions are of a kind of their own."""

    def solution(self, point: Point, exact: Mapping[str, float] | None) -> Solution:
        """The solution of a point."""
        ...


def solution_at(
    space: SolutionSpace, point: Point, floquet: Floquet | None = None, exact: Mapping[str, float] | None = None
) -> Solution:
    """The orbit or solution of a point, with its stability where that is known and values that it has exactly."""
    if isinstance(space, MakesSolutions):
        return space.solution(point, exact)
    if isinstance(space, BoundarySpace):
        if exact is None:
            value = space.value(space.parameter, point) if space.parameter else None
            exact = {} if value is None else {space.parameter: value}
        if space.periodic is None:
            return Solution(space, point, exact, known_floquet=floquet)
    return Orbit(space, point, exact or {}, known_floquet=floquet)
