"""Hill's equations of orbits at the edge of an endless tail, and the number of their multipliers off the circle."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.stability.stepping import OrbitState
from casadi_skin.stability.tongues.hill import Hill, Layout, Medium, coefficients
from casadi_skin.stability.tongues.localised_samples import FILLED_GAP, NARROW_GAP, Sample, names_of_arcs
from casadi_skin.zero.family import Coordinates
from casadi_skin.zero.problem import Array, Indices, Problem

PHASES_PER_COSINE = 4  # values over half a period for each odd cosine
SPARE_PHASES = 16  # further ones


class EdgeHill:
    """Hill's equations of the orbits of a family at the edge of a medium without an end."""

    def __init__(self, coordinates: Coordinates) -> None:
        self.coordinates = coordinates
        self._mapped: dict[int, tuple[ca.Function, Indices, Indices]] = {}

    def off_circle(self, state: OrbitState) -> int | None:
        """Number of localised multipliers outside the circle, of the better orbit; None where they are not counted."""
        best, localised = state.better or state, self.coordinates.localised
        assert localised is not None
        with np.errstate(all="ignore"):
            hill = self.hill(best.problem, best.z)
            layout = Layout(hill.Omega, localised.bands)
            if names_of_arcs(layout) in ((FILLED_GAP,), (NARROW_GAP,)):
                return None
            try:
                return Sample(0.0, 0.0, hill, layout, lambda: hill).counts.off
            except (ArithmeticError, np.linalg.LinAlgError):
                return None

    def _forces(self, count: int) -> tuple[ca.Function, Indices, Indices]:
        """Accelerations and their derivatives at so many phases, and the rows and columns of the second."""
        if count not in self._mapped:
            forces = self.coordinates.solved.rhs_and_jacobian().map(count)
            rows, columns = (np.asarray(part) for part in forces.sparsity_out(1).get_triplet())
            self._mapped[count] = forces, rows, columns
        return self._mapped[count]

    def hill(self, problem: Problem, z: Array) -> Hill:
        """Hill's equations of an orbit."""
        localised = self.coordinates.localised
        assert localised is not None
        medium = Medium(localised.stiffness, localised.coupling, localised.inlet, localised.outlet)
        count, p = PHASES_PER_COSINE * problem.resolution + SPARE_PHASES, medium.sites
        q = problem.sample(z, np.pi * np.arange(count) / count)
        parameter = np.full((1, count), float(z[problem.parameter_index]))
        forces, rows, columns = self._forces(count)
        slopes = forces(q.T, parameter)[1]
        phases, columns = np.divmod(columns, q.shape[1])
        cells = q.shape[1] // p
        own, beside = np.zeros((count, cells, p, p)), np.zeros((count, cells - 1, p, p))
        cell, next_cell = rows // p, columns // p
        if localised.attached >= p:  # the medium is behind the last cell
            cell, next_cell = cells - 1 - cell, cells - 1 - next_cell
        entries = -np.asarray(slopes.nonzeros())
        for target, apart in ((own, 0), (beside, 1)):
            here = next_cell - cell == apart
            target[phases[here], cell[here], rows[here] % p, columns[here] % p] = entries[here]
        parts = [coefficients(part).transpose(1, 0, 2, 3) for part in (own, beside)]
        return Hill(problem.frequency(z), medium, parts[0], parts[1], medium.inlet).without_tail()
