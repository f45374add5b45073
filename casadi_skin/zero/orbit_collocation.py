"""Collocation of orbits of a family on intervals of a quarter, half or full period, for any model of first order."""

from __future__ import annotations

import numpy as np

from casadi_skin.model.conserved import SymmetryClass, unfolded_phases
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.closure import orbit_formulation
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.orbit import FirstOrderProblem
from casadi_skin.zero.problem import Array


class CollocationProblem(CollocationEquations, FirstOrderProblem):
    """Equations of K intervals with d stages of the part of the period that the symmetry leaves unknown.

    Raises ValueError for missing symmetries.
    """

    def __init__(self, model: OdeModel, intervals: int, symmetry: SymmetryClass, table: CollocationTable) -> None:
        FirstOrderProblem.__init__(self, model, intervals, symmetry)
        self._discretise(orbit_formulation(model, symmetry, self.pinned, self.unfolded), intervals, table)

    def phases(self) -> Array:
        return self.symmetry.value * 2.0 * np.pi * self._fractions()

    def sample(self, z: Array, theta: Array) -> Array:
        fractions, signs = unfolded_phases(self.model, self.symmetry, theta)
        full = signs * self._interpolate(z, fractions)
        return np.asarray(full[:, : self.model.size])
