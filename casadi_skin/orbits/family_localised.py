"""Every change of localised multipliers of a family with an endless tail: its orbits, given to the search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, Problem
from casadi_skin.continuation.points import Point
from casadi_skin.orbits.family import Family
from casadi_skin.stability.gaps import Layout
from casadi_skin.stability.hill import Hill, coefficients
from casadi_skin.stability.interpolation import OrbitNotFoundError
from casadi_skin.stability.localised_changes import find_localised_changes
from casadi_skin.stability.localised_diagram import LocalisedDiagram
from casadi_skin.stability.localised_samples import Sample
from casadi_skin.threads import one_thread

ORBIT_TOLERANCE = 1e-11  # of the orbits along the family, whatever the tolerance of its points
PHASES = 4  # values over half a period for each odd cosine
SPARE = 16  # further ones


def localised_changes(family: Family, points: Sequence[Point]) -> LocalisedDiagram:
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
        self._mapped: dict[int, ca.Function] = {}

    @property
    def coordinates(self) -> Array:
        return np.arange(len(self.points), dtype=float)

    def sample(self, coordinate: float) -> Sample:
        """The orbit there; raises OrbitNotFoundError."""
        before = int(np.clip(np.floor(coordinate), 0, len(self.points) - 2))
        solver = self.family.point_solver
        point = solver.along(self.points[before], self.points[before + 1], coordinate - before)
        if point is None:
            S = self.family.request.S_of(self.points[before].parameter)
            raise OrbitNotFoundError(f"no orbit is found near S = {S:g}: {solver.failure}")
        better = point.better

        def finer() -> Hill:
            return self.hill(point.problem, point.z) if better is None else self.hill(better.problem, better.z)

        hill = self.hill(point.problem, point.z)
        S = self.family.request.S_of(point.parameter)
        return Sample(coordinate, S, hill, Layout(hill.Omega, self._bands), finer)

    @cached_property
    def _bands(self) -> tuple[tuple[float, float], ...]:
        localised = self.family.coordinates.localised
        assert localised is not None
        return localised.bands

    def _forces(self, count: int) -> ca.Function:
        """Accelerations and their derivatives at so many phases."""
        if count not in self._mapped:
            self._mapped[count] = self.family.coordinates.solved.rhs_and_jacobian().map(count)
        return self._mapped[count]

    def hill(self, problem: Problem, z: Array) -> Hill:
        """Hill's equations of an orbit."""
        coordinates = self.family.coordinates
        medium = coordinates.medium
        assert medium is not None
        count, p = PHASES * problem.resolution + SPARE, medium.sites
        q = problem.sample(z, np.pi * np.arange(count) / count)
        parameter = np.full((1, count), float(z[problem.parameter_index]))
        slopes = self._forces(count)(q.T, parameter)[1]
        rows, columns = (np.asarray(part) for part in slopes.sparsity().get_triplet())
        phases, columns = np.divmod(columns, q.shape[1])
        cells = q.shape[1] // p
        own, beside = np.zeros((count, cells, p, p)), np.zeros((count, cells - 1, p, p))
        cell, next_cell = rows // p, columns // p
        if coordinates.attached >= p:  # the medium is behind the last cell
            cell, next_cell = cells - 1 - cell, cells - 1 - next_cell
        entries = -np.asarray(slopes.nonzeros())
        for target, apart in ((own, 0), (beside, 1)):
            here = next_cell - cell == apart
            target[phases[here], cell[here], rows[here] % p, columns[here] % p] = entries[here]
        parts = [coefficients(part).transpose(1, 0, 2, 3) for part in (own, beside)]
        return Hill(problem.frequency(z), medium, parts[0], parts[1], medium.inlet).without_tail()
