"""Radau IIA collocation: order 2d - 1, for stiff equations; the last stage is the end of the interval."""

from __future__ import annotations

from casadi_skin.bvp.butcher import radau_table
from casadi_skin.bvp.orbit_collocation import CollocationProblem
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.models.ode import OdeModel


class RadauProblem(CollocationProblem):
    """Equations of K intervals with d Radau stages: d columns of unknowns an interval.

    On the full period the unfolding parameter makes up for the damping of the method, and is zero but for its error.
    """

    def __init__(self, model: OdeModel, intervals: int, symmetry: SymmetryClass, degree: int = 5) -> None:
        super().__init__(model, intervals, symmetry, radau_table(degree))
