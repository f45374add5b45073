"""The search for events between two points of a branch of orbits, on the mesh of the second one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from casadi_skin.follow.exponents import Exponents, ExponentSampler
from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.search import Event, Search
from casadi_skin.follow.stretch import Stretch
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point

DEEPEST = 14  # divisions of a stretch between two orbits
MOST_PARTS = 120  # that such a stretch is divided into
CLEAR = 0.5  # of the changes of a quantity on a stretch: a distance from zero at both ends that needs no sample between


class StretchSearch(Search[Event]):
    """The search on one stretch between two points.

    Attributes:
        ends: both ends.
        first, last: these in the unknowns of the second.
        row, length: sigma = row . (z - first.z) is the place along the stretch, from 0 to its length.
        sampler: multipliers at its points.
    """

    deepest, most_parts = DEEPEST, MOST_PARTS

    def __init__(
        self, solver: PointSolver, before: Point, after: Point, alone: Callable[[Point], Floquet],
        exponents: Sequence[Exponents] = (),
    ) -> None:  # fmt: skip
        super().__init__("real parts")
        self.solver, self.ends = solver, (before, after)
        problem = after.problem
        z, tangent = (before.problem.prolong(v, problem) for v in (before.z, before.tangent))
        self.first = replace(before, problem=problem, z=z, tangent=tangent, better=None)
        self.last = after
        self.row = self.metric(self.first) * tangent
        self.length = float(self.row @ (after.z - z))
        self.sampler = ExponentSampler(alone, self.metric, tuple(zip(self.ends, exponents, strict=False)))

    def metric(self, point: Point) -> Array:
        """Weights of the unknowns of a point."""
        return self.solver.metric(point.problem, point.z)

    def own(self, point: Point) -> Point:
        """The point at which multipliers are computed: the first end on its own mesh."""
        return self.ends[0] if point is self.first else point

    def along(self, before: Point, after: Point, fraction: float) -> Point | None:
        correction, tangent = self.solver.corrected_along(before, after, fraction)
        if correction is None or tangent is None:
            return None
        return replace(self.last, z=correction.z, tangent=tangent, better=None, special="", walked=False)

    def passes(self, ends: Stretch) -> bool:
        """Whether every quantity stays far from zero, by its values and rates at both ends."""
        if not (self.is_clear(ends.first.point) or self.is_clear(ends.last.point)):
            return False
        g, d = ends.quantities
        moves = np.abs(g[-1] - g[0]) + ends.length * (np.abs(d[0]) + np.abs(d[-1]))
        clear = (np.sign(g[0]) == np.sign(g[-1])) & (np.min(np.abs(g), axis=0) > CLEAR * moves)
        return bool(np.all(clear | np.all(g == 0.0, axis=0)))

    def sigma(self, point: Point) -> float:
        """The place of a point along the stretch."""
        return float(self.row @ (point.problem.prolong(point.z, self.last.problem) - self.first.z))

    def outside(self, point: Point) -> tuple[int, int]:
        """The number of multipliers outside the circle at a point, and how many errors leave open."""
        return self.sampler.exponents(self.own(point))[0].outside

    def is_clear(self, point: Point) -> bool:
        return self.outside(point)[1] <= min(self.outside(end)[1] for end in (self.first, self.last))
