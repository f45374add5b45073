"""Every change of stability of a family: the family's orbits and flow, given to the search for tongues."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from casadi_skin.follow.arclength import with_what_lies_between
from casadi_skin.follow.branch_sampler import OrbitSampler
from casadi_skin.follow.family import Family
from casadi_skin.lattice.spectrum import linear_spectrum
from casadi_skin.solve.watch import heed, one_thread
from casadi_skin.stability.result import Floquet
from casadi_skin.stability.tongues.counts import EdgeHill, Sample
from casadi_skin.stability.tongues.diagram import StabilityDiagram
from casadi_skin.stability.tongues.find_changes import Entry, find_changes
from casadi_skin.stability.tongues.hill import Hill, Layout
from casadi_skin.stability.tongues.interpolation import OrbitNotFoundError
from casadi_skin.stability.tongues.localised import find_localised_changes
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point, Refinement

ORBIT_TOLERANCE = 1e-12  # of the orbits along the family, whatever the tolerance of its points
AT_REST = 1e-12  # of the largest omega^2: rounding in that of a mode without restoring force
ACCURATE_POINT_TOLERANCE = 1e-7  # tolerance of points that orbits between them are predicted from as they are
LOOKING_ROUNDS = 3  # of looking, each with orbits added where some were not found
FLOW_TOLERANCE = 1e-9  # of the norm of transition matrices; errors of multipliers are 10 to 1000 times smaller


def family_tongues(
    family: Family,
    points: Sequence[Point],
    flow_tolerance: float = FLOW_TOLERANCE,
    stability: Sequence[Floquet | None] = (),
) -> StabilityDiagram:
    """Every change of stability along a family, however narrow its window.

    The result depends on the course of the family, not on its points or their tolerance: orbits and transition matrices
    are computed anew, to tolerances of their own.

    Arguments:
        family: the family.
        points: of it in order; the first may be its linear mode of zero amplitude.
        flow_tolerance: of the transition matrices, in norm; a smaller one decides narrower tongues.
        stability: of the points, where it is known: tongues have to account for it, or the stretch is unresolved.

    Returns:
        Changes of stability, tongues, and undecided and unresolved places.
    """
    whole = family.whole
    squares = linear_spectrum(whole.request.model, whole.coordinates.parameters).squares
    frequencies = np.sqrt(np.maximum(squares, 0.0))
    others = {k + 1: float(w) for k, w in enumerate(frequencies) if k + 1 != whole.coordinates.mode_number}
    known = {id(point): each for point, each in zip(points, stability, strict=False)}
    oscillate = bool(squares[0] >= -AT_REST * squares[-1])
    with one_thread():
        for _ in range(LOOKING_ROUNDS):
            sampler = _sampler(family, points, flow_tolerance, family.request.tolerance <= ACCURATE_POINT_TOLERANCE)
            entries = [
                Entry(float(coordinate), found.mu, found.mu_error)
                for coordinate, point in zip(sampler.coordinates, points, strict=False)
                if (found := known.get(id(point))) is not None
            ]
            diagram = find_changes(sampler, others if oscillate else None, entries=entries)
            lost = sampler.lost_between([(u.coordinate_start, u.coordinate_end) for u in diagram.unresolved])
            more = with_what_lies_between(family.point_solver, points, lost) if lost.any() else points
            if len(more) == len(points):
                break
            points = more
    stretches = sorted([*diagram.unresolved, *sampler.unknown], key=lambda stretch: stretch.coordinate_start)
    return replace(diagram, unresolved=tuple(stretches))


def tongues_on(family: Family, points: Sequence[Point]) -> StabilityDiagram:
    """Every change of stability on a short stretch of a family, without names of modes.

    Arguments:
        family: the family, of any amplitude.
        points: of the stretch in order, or guesses of them.

    Raises OrbitNotFoundError where these are no orbits.
    """
    with one_thread():
        sampler = _sampler(family, points, FLOW_TOLERANCE, False)
        if sampler.unknown:
            raise OrbitNotFoundError(sampler.unknown[0].reason)
        return find_changes(sampler, short=True)


def _sampler(family: Family, points: Sequence[Point], flow_tolerance: float, converged: bool) -> OrbitSampler:
    """Orbits and transition matrices anywhere between points of a family."""
    whole = family.whole
    request = replace(whole.request, tolerance=flow_tolerance)
    return OrbitSampler(
        whole.point_solver,
        [family.on_all_positions(point) for point in points],
        Family(request).flow,
        whole.accelerations,
        request.S_of,
        ORBIT_TOLERANCE,
        whole.symmetry.value,
        whole.coordinates.symplectic,
        whole.coordinates.S_rate,
        converged,
        whole.across,
    )


# Localised multipliers of a family with an endless tail: its orbits, given to the search ------------------------------

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
