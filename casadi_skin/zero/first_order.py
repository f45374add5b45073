"""Common parts of transcriptions in full states: the models that they take, and the order of their unknowns."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np

from casadi_skin.model.ode import OdeModel
from casadi_skin.model.symmetry import SymmetryClass, pinned_components
from casadi_skin.zero.orbit_problem import OrbitProblem
from casadi_skin.zero.problem import Array


class FirstOrderProblem(OrbitProblem):
    """Unknowns are full states in the order of time, Omega, the free parameter and the unfolding parameter.

    The last is there for the full period only: the coefficient of a damping that a conservative model does not have,
    which makes the equations regular (Sepulchre and MacKay 1997; Munoz-Almaraz et al. 2003); it comes back as zero. The
    phase is where the model's normalisation is stationary along the flow. Raises ValueError for missing symmetries.
    """

    def __init__(self, model: OdeModel, resolution: int, symmetry: SymmetryClass) -> None:
        if model.parameters.numel() != 1 or model.normalisation is None:
            raise ValueError(f"{model.name}: a family needs one free parameter and a normalisation")
        if symmetry is SymmetryClass.FULL and model.order == 1 and model.hamiltonian is None:
            raise ValueError(f"{model.name}: the full period unfolds a conserved quantity; declare its hamiltonian")
        self.model, self.resolution, self.symmetry = model, resolution, symmetry
        self.pinned = pinned_components(model, symmetry)
        self.unfolded = symmetry is SymmetryClass.FULL

    @property
    def size(self) -> int:
        return self.states + 2 + int(self.unfolded)

    @property
    def damping_index(self) -> int:
        """Place of the unfolding parameter among the unknowns (full period only)."""
        return self.states + 2

    @abstractmethod
    def phases(self) -> Array:
        """Phases theta of the full states among the unknowns, in their order."""

    def _spread(self, factors: Array) -> Array:
        return np.tile(factors, self.states // factors.size)  # velocities are shown as positions are

    def pack(self, positions: Array, Omega: float, parameter: float) -> Array:
        theta = self.phases()
        state = np.outer(np.cos(theta), positions)
        if self.model.order == 2:
            state = np.hstack([state, np.outer(-Omega * np.sin(theta), positions)])
        return np.concatenate([state.ravel(), [Omega, parameter], np.zeros(int(self.unfolded))])
