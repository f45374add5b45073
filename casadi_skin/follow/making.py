"""Solutions of a space from its points."""

from __future__ import annotations

from collections.abc import Mapping

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.settings import Point
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.stability.result import Floquet


def solution_at(
    space: SolutionSpace, point: Point, floquet: Floquet | None = None, exact: Mapping[str, float] | None = None
) -> Solution:
    """The orbit or solution of a point, with its stability where that is known and values that it has exactly.

    A space whose solutions are of a kind of their own makes them itself, by its method `solution`.
    """
    own = getattr(space, "solution", None)  # isinstance with a protocol takes ten times as long
    if own is not None:
        found: Solution = own(point, exact)
        return found
    if isinstance(space, BoundarySpace):
        if exact is None:
            value = space.value(space.parameter, point) if space.parameter else None
            exact = {} if value is None else {space.parameter: value}
        if space.periodic is None:
            return Solution(space, point, exact, known_floquet=floquet)
    return Orbit(space, point, exact or {}, known_floquet=floquet)
