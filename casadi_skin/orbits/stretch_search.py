"""The search for events between two points of a branch of orbits, on the mesh of the second one."""

from __future__ import annotations

from dataclasses import replace

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import Point
from casadi_skin.equilibria.search import Event, Search
from casadi_skin.orbits.exponents import ExponentSampler
from casadi_skin.stability.result import Floquet

DEEPEST = 14  # divisions of a stretch between two orbits
MOST_PARTS = 120  # that such a stretch is divided into


class StretchSearch(Search[Event]):
    """The search on one stretch between two points.

    Attributes:
        first, last: both ends in the unknowns of the second.
        row, length: sigma = row . (z - first.z) is the place along the stretch, from 0 to its length.
        sampler: multipliers at its points.
    """

    deepest, most_parts = DEEPEST, MOST_PARTS

    def __init__(self, solver: PointSolver, before: Point, after: Point) -> None:
        super().__init__("real parts")
        self.solver, self._ends = solver, (before, after)
        problem = after.problem
        z, tangent = (before.problem.prolong(v, problem) for v in (before.z, before.tangent))
        self.first = replace(before, problem=problem, z=z, tangent=tangent, better=None)
        self.last = after
        self.row = self.metric(self.first) * tangent
        self.length = float(self.row @ (after.z - z))
        self.sampler = ExponentSampler(self.floquet, self.metric)

    def metric(self, point: Point) -> Array:
        """Weights of the unknowns of a point."""
        return self.solver.metric(point.problem, point.z)

    def floquet(self, point: Point) -> Floquet:
        """Multipliers at a point."""
        raise NotImplementedError

    def own(self, point: Point) -> Point:
        """The point at which multipliers are computed: the first end on its own mesh."""
        return self._ends[0] if point is self.first else point

    def along(self, before: Point, after: Point, fraction: float) -> Point | None:
        correction, tangent = self.solver.corrected_along(before, after, fraction)
        if correction is None or tangent is None:
            return None
        return replace(self.last, z=correction.z, tangent=tangent, better=None, special="", walked=False)

    def sigma(self, point: Point) -> float:
        """The place of a point along the stretch."""
        return float(self.row @ (point.problem.prolong(point.z, self.last.problem) - self.first.z))

    def outside(self, point: Point) -> tuple[int, int]:
        """The number of multipliers outside the circle at a point, and how many errors leave open."""
        return self.sampler.exponents(self.own(point))[0].outside

    def is_clear(self, point: Point) -> bool:
        return self.outside(point)[1] <= min(self.outside(end)[1] for end in (self.first, self.last))
