"""A periodic orbit as equations with one unknown more: what every transcription offers to correctors and walkers."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.models.ode import OdeModel

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

FREQUENCY_WEIGHT = 20.0  # a relative change of 5 per cent in Omega counts as much as a wholly new profile


def sparse_matrix(shape: tuple[int, int], rows: Indices, columns: Indices, values: ca.MX) -> ca.MX:
    """Sparse CasADi matrix from triplets without duplicates; `values` in the order of `rows` and `columns`."""
    order = np.lexsort((rows, columns))
    colind = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=shape[1]))])
    sparsity = ca.Sparsity(shape[0], shape[1], colind.tolist(), rows[order].tolist())
    return ca.MX(sparsity, values[order.tolist()])


class OrbitProblem(ABC):
    """Unknowns z = (state values, Omega, parameter, ...), one more than equations R(z) = 0, and the sparse dR/dz.

    Subclasses are transcriptions. State values come first in z; `size` counts unknowns, `size - 1` equations. The
    one free parameter is that of the model; the last equation is the model's normalisation.
    """

    model: OdeModel
    symmetry: SymmetryClass
    resolution: int
    states: int  # number of state values in z
    half_bandwidth: int | None = None  # of dR/d(state values), when rows and columns are ordered to make it small

    @abstractmethod
    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """Symbols z, residual R(z), sparse Jacobian dR/dz assembled from its structure."""

    @abstractmethod
    def pack(self, positions: Array, Omega: float, parameter: float) -> Array:
        """Unknowns of the orbit with q(theta) = positions cos(theta), shape (size,)."""

    @abstractmethod
    def prolong(self, z: Array, finer: OrbitProblem) -> Array:
        """The same orbit in the unknowns of another resolution of the same transcription."""

    def parameter_row(self) -> Array:
        """Row that holds the free parameter, shape (size,)."""
        row = np.zeros(self.size)
        row[self.parameter_index] = 1.0
        return row

    @abstractmethod
    def sample(self, z: Array, theta: Array) -> Array:
        """Positions (states, in a model of first order) at phases theta = Omega t, shape (len(theta), model.size)."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of unknowns."""

    @property
    def Omega_index(self) -> int:
        """Place of Omega among the unknowns."""
        return self.states

    @property
    def parameter_index(self) -> int:
        """Place of the free parameter among the unknowns."""
        return self.states + 1

    @cached_property
    def symbols(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """z, R(z) and dR/dz as CasADi expressions."""
        return self._equations()

    @cached_property
    def function(self) -> ca.Function:
        """CasADi Function z -> (R, dR/dz)."""
        z, residual, jacobian = self.symbols
        return ca.Function("orbit", [z], [ca.densify(residual), jacobian], ["z"], ["R", "dR_dz"])

    @cached_property
    def pattern(self) -> tuple[Indices, Indices]:
        """Rows and columns of the non-zeros of dR/dz, in the order in which `evaluate` returns them."""
        rows, columns = self.function.sparsity_out(1).get_triplet()
        return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)

    @cached_property
    def _buffers(self) -> tuple[ca.FunctionBuffer, object, Array, Array, Array]:
        z, residual = np.zeros(self.size), np.zeros(self.size - 1)
        nonzeros = np.zeros(self.function.nnz_out(1))
        buffer, trigger = self.function.buffer()
        buffer.set_arg(0, z.data)
        buffer.set_res(0, residual.data)
        buffer.set_res(1, nonzeros.data)
        return buffer, trigger, z, residual, nonzeros

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Residual, shape (size - 1,), and the non-zeros of the Jacobian in the order of `pattern`."""
        _, trigger, argument, residual, nonzeros = self._buffers
        argument[:] = z
        trigger()  # type: ignore[operator]
        return residual.copy(), nonzeros.copy()

    def relative_residual(self, z: Array) -> float:
        """Largest residual of the equations relative to their largest term."""
        residual, nonzeros = self.evaluate(z)
        _, columns = self.pattern
        inside = columns < self.states
        largest = np.max(np.abs(nonzeros[inside] * z[columns[inside]]), initial=1.0)
        return float(np.max(np.abs(residual)) / largest)

    def metric(self, z: Array, parameter_scale: float) -> Array:
        """Diagonal of the relative metric |dq|^2/|q|^2 + (20 dOmega/Omega)^2 + (dp/scale)^2 at z, shape (size,)."""
        weights = np.ones(self.size)
        weights[: self.states] = 1.0 / np.sum(z[: self.states] ** 2)
        weights[self.Omega_index] = (FREQUENCY_WEIGHT / z[self.Omega_index]) ** 2
        weights[self.parameter_index] = 1.0 / parameter_scale**2
        return weights
