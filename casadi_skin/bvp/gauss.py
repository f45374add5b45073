"""Gauss-Legendre collocation: order 2d at the ends of the intervals, symmetric in time."""

from __future__ import annotations

from casadi_skin.bvp.butcher import gauss_table
from casadi_skin.bvp.orbit_collocation import CollocationProblem
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.models.ode import OdeModel

__all__ = ["GaussProblem", "gauss_table"]


class GaussProblem(CollocationProblem):
    """Equations of K intervals with d Gauss stages and the interval's end: d + 1 columns of unknowns an interval."""

    def __init__(self, model: OdeModel, intervals: int, symmetry: SymmetryClass, degree: int = 5) -> None:
        super().__init__(model, intervals, symmetry, gauss_table(degree))
