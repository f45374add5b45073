"""Every change of localised multipliers of a family with an endless tail: its orbits, given to the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from casadi_skin.follow.family import Family
from casadi_skin.solve.watch import heed, one_thread
from casadi_skin.stability.tongues.counts import EdgeHill, Sample
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.hill import Hill, Layout
from casadi_skin.stability.tongues.interpolation import OrbitNotFoundError
from casadi_skin.stability.tongues.localised import find_localised_changes
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point, Refinement

ORBIT_TOLERANCE = 1e-11  # of the orbits along the family, whatever the tolerance of its points


def localised_changes(family: Family, points: Sequence[Point]) -> StabilityDiagram:
    """Every change of localised multipliers along a family.

    Arguments:
        family: the family, of an endless tail.
        points: of it in order, without its linear mode of zero amplitude.

    Returns:
        Changes, and what is unresolved.
    """
    with one_thread(), np.errstate(all="ignore"):
        return find_localised_changes(EdgeOrbits(family, points))


class EdgeOrbits:
    """Orbits anywhere between points of a family: an `EdgeBranch` whose coordinates count points."""

    def __init__(self, family: Family, points: Sequence[Point]) -> None:
        tolerance = min(ORBIT_TOLERANCE, family.tolerance)
        self.family = Family(replace(family.request, tolerance=tolerance))
        levels = self.family.levels
        self.points = [replace(point, problem=levels.problem(point.problem.resolution)) for point in points]
        self._equations = EdgeHill(self.family.coordinates)

    @property
    def coordinates(self) -> Array:
        return np.arange(len(self.points), dtype=float)

    def sample(self, coordinate: float) -> Sample:
        """The orbit there; raises OrbitNotFoundError, and TimeLimitError."""
        heed("orbits between the points of a family")
        point = self._point(coordinate)
        own, better = Refinement(point.problem, point.z), point.better
        if better is not None and coordinate == round(coordinate):  # of the branch, as precise as the others
            own, better = better, own
        hill, S = self._hill(own), self.family.request.S_of(float(own.z[own.problem.parameter_index]))
        return Sample(coordinate, S, hill, Layout(hill.Omega, self._bands), lambda: self._hill(better or own))

    def layout(self, coordinate: float) -> Layout:
        """Arcs and gaps there, on the level of the next point of the branch; raises OrbitNotFoundError."""
        before, solver = self._before(coordinate), self.family.point_solver
        here, following = self.points[before], self.points[before + 1]
        if coordinate == before:
            return Layout(here.Omega, self._bands)
        correction, _ = solver.corrected_along(here, following, coordinate - before)
        if correction is None:
            raise self._not_found(before)
        return Layout(following.problem.frequency(correction.z), self._bands)

    def amplitude(self, coordinate: float) -> float:
        """S between two points, without an orbit."""
        S = [self.family.request.S_of(point.parameter) for point in self.points]
        return float(np.interp(coordinate, self.coordinates, S))

    def _before(self, coordinate: float) -> int:
        """Number of the point before a coordinate."""
        return int(np.clip(np.floor(coordinate), 0, len(self.points) - 2))

    def _not_found(self, before: int) -> OrbitNotFoundError:
        S = self.family.request.S_of(self.points[before].parameter)
        return OrbitNotFoundError(f"no orbit is found near S = {S:g}: {self.family.point_solver.failure}")

    def _point(self, coordinate: float) -> Point:
        """The point of the branch there, or one that is solved for."""
        if coordinate == round(coordinate) and self.points[int(coordinate)].better is not None:
            return self.points[int(coordinate)]
        before, solver = self._before(coordinate), self.family.point_solver
        point = solver.along(self.points[before], self.points[before + 1], coordinate - before)
        if point is None:
            raise self._not_found(before)
        return point

    def _hill(self, orbit: Refinement) -> Hill:
        return self._equations.hill(orbit.problem, orbit.z)

    @cached_property
    def _bands(self) -> tuple[tuple[float, float], ...]:
        localised = self.family.coordinates.localised
        assert localised is not None
        return localised.bands
