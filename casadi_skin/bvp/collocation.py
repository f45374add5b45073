"""Collocation on intervals of a quarter, half or full period, for any model of first order.

On each of K intervals the orbit is a polynomial of degree d that satisfies the equations at d stages, written as the
equivalent implicit Runge-Kutta method (Hairer, Lubich and Wanner 2006, section II.1): the ends of the intervals
converge with the order of the method, the rest with order d + 1. The lengths of the intervals are constants of the
compiled equations, so that the mesh may follow the solution.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.bvp import mesh
from casadi_skin.bvp.butcher import CollocationTable
from casadi_skin.bvp.fields import border_conditions, unfolded_field
from casadi_skin.bvp.first_order import FirstOrderProblem
from casadi_skin.bvp.problem import Array, Indices, OrbitProblem, sparse_matrix
from casadi_skin.bvp.symmetry import SymmetryClass, unfolded_phases
from casadi_skin.models.ode import OdeModel

Triplets = tuple[list[Indices], list[Indices], list[ca.MX]]
MESH_NOISE = 4.0 * float(np.finfo(float).eps)  # of a state value, relative to the largest


class CollocationProblem(FirstOrderProblem):
    """Equations of K intervals with d stages; unknowns ordered in time: x_0, X_11 .. X_1d, x_1, ..., x_K.

    `constants` are the lengths of the intervals relative to their sum. Raises ValueError for missing symmetries.
    """

    def __init__(self, model: OdeModel, intervals: int, symmetry: SymmetryClass, table: CollocationTable) -> None:
        super().__init__(model, intervals, symmetry)
        self.table, self.degree = table, table.degree
        self.columns = intervals * table.ends.size + 1
        self.states = model.full_size * self.columns
        self.constants = mesh.uniform(intervals)

    # Equations ------------------------------------------------------------------------------------------------------

    def _columns(self) -> tuple[Indices, Indices, Indices]:
        """Columns of the stages; and of the start and the end of every increment, all in time order."""
        K, d, rows = self.resolution, self.degree, self.table.ends.size
        stage = (np.arange(K)[:, None] * rows + 1 + np.arange(d)).ravel()
        start = np.repeat(np.arange(K) * rows, rows)
        return stage, start, start + np.tile(np.arange(1, rows + 1), K)

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        n, K, d, table = self.model.full_size, self.resolution, self.degree, self.table
        z = ca.MX.sym("z", self.size)
        values = ca.reshape(z[: self.states], n, self.columns)
        Omega, p = z[self.Omega_index], z[self.parameter_index]
        damping = z[self.damping_index] if self.unfolded else ca.MX(0)
        stage, start, target = self._columns()

        parameters = ca.repmat(ca.vertcat(p, damping), 1, K * d)
        F, dF_dx, dF_dp = unfolded_field(self.model).map(K * d)(values[:, stage.tolist()], parameters)
        steps = self.symmetry.value * 2.0 * np.pi / Omega * self.constants_symbol
        # Increments from stage derivatives: (K d) x (K rows), each interval scaled by its length.
        weights = ca.kron(ca.diag(steps), ca.DM(table.extended.T))
        increments = F @ weights
        collocation = values[:, target.tolist()] - values[:, start.tolist()] - increments
        conditions = border_conditions(self.model, self.pinned, self.unfolded)(values[:, 0], values[:, -1], p)
        residual = ca.vertcat(ca.vec(collocation), conditions[0])

        jacobian = self._differences() + self._stiffness(dF_dx, steps)
        jacobian += self._borders(increments / Omega, dF_dp, weights, conditions[1:])
        return z, residual, jacobian

    def _differences(self) -> ca.MX:
        """Derivative of the differences of state values: 1 at the end and -1 at the start of every increment."""
        n, shape = self.model.full_size, (self.size - 1, self.size)
        _, start, target = self._columns()
        rows = np.arange(start.size * n)
        ones = ca.MX(ca.DM(np.ones(rows.size)))
        component = np.arange(n)
        ends = ((column[:, None] * n + component).ravel() for column in (target, start))
        at_target, at_start = (sparse_matrix(shape, rows, column, ones) for column in ends)
        return at_target - at_start

    def _stiffness(self, dF_dx: ca.MX, steps: ca.MX) -> ca.MX:
        """Derivative of the increments by the states; `dF_dx` holds one sparse block a stage."""
        n, K, d, extended = self.model.full_size, self.resolution, self.degree, self.table.extended
        stage, _, _ = self._columns()
        r, c = (np.array(t, dtype=np.int64) for t in unfolded_field(self.model).sparsity_out(1).get_triplet())
        entries = ca.reshape(dF_dx.nz[:], r.size, K * d)
        interval, j = np.arange(K * d) // d, np.arange(K * d) % d
        lengths = steps[interval.tolist()].T
        total = ca.MX(self.size - 1, self.size)
        for i, row_weights in enumerate(extended):
            scaled = -entries * ca.repmat(lengths * ca.DM(row_weights[j]).T, r.size, 1)
            rows = ((interval * extended.shape[0] + i)[:, None] * n + r).ravel()
            columns = (stage[:, None] * n + c).ravel()
            total += sparse_matrix((self.size - 1, self.size), rows, columns, ca.vec(scaled))
        return total

    def _borders(self, by_Omega: ca.MX, dF_dp: ca.MX, weights: ca.MX, conditions: tuple[ca.MX, ...]) -> ca.MX:
        """Columns of Omega, parameter and damping; and the rows of the conditions from their derivatives."""
        n = self.model.full_size
        bottom = by_Omega.numel()
        every = np.arange(bottom)
        dF_dp = ca.reshape(dF_dp, 2 * n, -1)  # column by column: dF/dp above dF/d(damping)
        dense = [(self.Omega_index, by_Omega), (self.parameter_index, -(dF_dp[:n, :] @ weights))]
        if self.unfolded:
            dense.append((self.damping_index, -(dF_dp[n:, :] @ weights)))
        triplets: Triplets = ([], [], [])
        for index, values in dense:
            _append(triplets, every, np.full(bottom, index), ca.vec(values))
        for derivative, offset in zip(conditions, (0, self.states - n, self.parameter_index), strict=True):
            rows, columns = (np.array(t, dtype=np.int64) for t in derivative.sparsity().get_triplet())
            _append(triplets, rows + bottom, columns + offset, derivative.nz[:])
        rows, columns = (np.concatenate(t) for t in triplets[:2])
        return sparse_matrix((self.size - 1, self.size), rows, columns, ca.vertcat(*triplets[2]))

    # Values ---------------------------------------------------------------------------------------------------------

    def _phases(self) -> Array:
        starts = mesh.edges(self.constants)[:-1]
        inner = starts[:, None] + self.constants[:, None] * self.table.ends
        return self.symmetry.value * 2.0 * np.pi * np.concatenate([[0.0], inner.ravel()])

    def _interpolate(self, z: Array, fractions: Array) -> Array:
        """Full states at fractions of the part of the period, shape (len(fractions), full_size)."""
        K, rows = self.resolution, self.table.ends.size
        values = z[: self.states].reshape(self.columns, self.model.full_size)
        starts = mesh.edges(self.constants)
        interval = np.clip(np.searchsorted(starts, fractions, side="right") - 1, 0, K - 1)
        support = np.append(0.0, self.table.ends)
        offset = ((fractions - starts[interval]) / self.constants[interval])[:, None] - support
        hit = np.abs(offset) < 1e-14
        offset[hit] = 1.0
        weights = _barycentric(support) / offset
        weights[hit.any(axis=1)] = 0.0
        weights[hit] = 1.0
        weights /= weights.sum(axis=1, keepdims=True)
        columns = interval[:, None] * rows + np.arange(rows + 1)
        return np.asarray(np.einsum("tk,tkn->tn", weights, values[columns]))

    def prolong(self, z: Array, finer: OrbitProblem) -> Array:
        assert isinstance(finer, CollocationProblem)
        fractions = finer._phases() / (self.symmetry.value * 2.0 * np.pi)
        return np.concatenate([self._interpolate(z, fractions).ravel(), z[self.states :]])

    def sample(self, z: Array, theta: Array) -> Array:
        fractions, signs = unfolded_phases(self.model, self.symmetry, theta)
        full = signs * self._interpolate(z, fractions)
        return np.asarray(full[:, : self.model.size])

    # The mesh -------------------------------------------------------------------------------------------------------

    def _density(self, z: Array) -> Array:
        """Wanted density of intervals for the orbit z, see `mesh.density`."""
        K, d, rows = self.resolution, self.degree, self.table.ends.size
        values = z[: self.states].reshape(self.columns, self.model.full_size)
        columns = np.arange(K)[:, None] * rows + np.arange(d + 1)
        weights = _barycentric(np.append(0.0, self.table.nodes))  # the start and the stages determine the polynomial
        noise = MESH_NOISE * float(np.max(np.abs(values)) * np.sum(np.abs(weights)))
        return mesh.density(self.constants, np.einsum("j,kjn->kn", weights, values[columns]), d, noise)

    def transferred(self, other: OrbitProblem) -> OrbitProblem:
        return other.with_constants(mesh.resampled(self.constants, other.resolution))

    def placed(self, z: Array, other: OrbitProblem) -> OrbitProblem:
        return other.with_constants(mesh.equidistributed(self.constants, self._density(z), other.resolution))

    def imbalance(self, z: Array) -> float:
        return mesh.imbalance(self.constants, self._density(z))

    def expected_error(self, z: Array, error: float, other: OrbitProblem) -> float:
        parts = self.constants * self._density(z)
        growth = float(np.sum(parts)) / other.resolution / float(np.max(parts))
        return error * growth ** (self.degree + 1)


def _barycentric(support: Array) -> Array:
    """Weights of the values at `support` in the leading coefficient of the polynomial through them."""
    gaps = support[:, None] - support
    np.fill_diagonal(gaps, 1.0)
    return np.asarray(1.0 / np.prod(gaps, axis=1))


def _append(triplets: Triplets, rows: Indices, columns: Indices, values: ca.MX) -> None:
    for held, added in zip(triplets, (rows, columns, values), strict=True):
        held.append(added)
