"""A periodic orbit as equations with one unknown more: properties that only transcriptions of orbits have."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property

import numpy as np

from casadi_skin.model.ode import OdeModel
from casadi_skin.model.symmetry import SymmetryClass
from casadi_skin.zero.problem import Array, Problem

FREQUENCY_WEIGHT = 20.0  # a relative change of 5 per cent in Omega counts as much as a wholly new profile


class OrbitProblem(Problem):
    """Unknowns z = (state values, Omega, parameter, ...) of an orbit of a family.

    The one free parameter is that of the model; the last equation is the model's normalisation.
    """

    model: OdeModel
    symmetry: SymmetryClass
    holds_linear_modes: bool = False  # exactly, at every resolution

    @abstractmethod
    def pack(self, positions: Array, Omega: float, parameter: float) -> Array:
        """Unknowns of the orbit with q(theta) = positions cos(theta), shape (size,)."""

    @abstractmethod
    def _spread(self, factors: Array) -> Array:
        """Factors of the model's state components, shape (model.size,), for all state values in z, shape (states,)."""

    @cached_property
    def output_scale(self) -> Array | None:
        """Factors from the state values to those that users see, shape (states,); None where these are the same."""
        factors = self.model.output_scale
        return None if factors is None or len(set(factors)) == 1 else self._spread(np.array(factors))

    def profile_change(self, z: Array, step: Array) -> float:
        """Largest change of a state value relative to the largest state value, also in the output scale."""
        return float(self.profile_changes(z[None], step[None])[0])

    def profile_changes(self, z: Array, steps: Array) -> Array:
        moves, states, scale = np.abs(steps[:, : self.states]), np.abs(z[:, : self.states]), self.output_scale
        change = moves.max(axis=1) / states.max(axis=1)
        if scale is not None:
            scale = np.abs(scale)
            change = np.maximum(change, (scale * moves).max(axis=1) / (scale * states).max(axis=1))
        return np.asarray(change)

    def frequency(self, z: Array) -> float:
        return float(z[self.Omega_index])

    def frequency_step(self, z: Array, step: Array) -> float:
        return float(step[self.Omega_index])

    def place(self, equation: int) -> str:
        return "the normalisation" if equation == self.size - 2 else super().place(equation)

    def metric(self, z: Array, parameter_scale: float) -> Array:
        """Diagonal of |dq|^2/|q|^2 + (20 dOmega/Omega)^2 + (dp/scale)^2 at z, shape (size,)."""
        states = z[: self.states]
        weights = np.full(z.size, 1.0 / np.einsum("i,i->", states, states))
        weights[self.Omega_index] = (FREQUENCY_WEIGHT / z[self.Omega_index]) ** 2
        weights[self.parameter_index] = 1.0 / parameter_scale**2
        return weights

    def metrics(self, z: Array, parameter_scale: float) -> Array:
        weights, states = np.empty(z.shape), z[:, : self.states]
        weights[:] = 1.0 / np.einsum("ij,ij->i", states, states)[:, None]
        weights[:, self.Omega_index] = (FREQUENCY_WEIGHT / z[:, self.Omega_index]) ** 2
        weights[:, self.parameter_index] = 1.0 / parameter_scale**2
        return weights
