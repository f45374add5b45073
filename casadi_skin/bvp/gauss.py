"""Gauss-Legendre collocation on elements of a quarter, half or full period, for any model of first order.

On each of K intervals the orbit is a collocation polynomial at d Gauss points, written as the equivalent implicit
Runge-Kutta method (Hairer, Lubich and Wanner 2006, section II.1): values at mesh points converge with order 2d. The
tables come from numpy's Legendre quadrature, which keeps digits that casadi.collocation_coeff loses.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, OrbitProblem, sparse_matrix
from casadi_skin.bvp.symmetry import SymmetryClass, pinned_components
from casadi_skin.models.ode import OdeModel


@dataclass(frozen=True)
class GaussTable:
    """Butcher table of the d-stage Gauss method; `extended` is A with b as its last row, shape (d + 1, d)."""

    nodes: Array
    extended: Array


@cache
def gauss_table(degree: int) -> GaussTable:
    """Nodes and weights of the d-stage Gauss method on [0, 1], from integrals of the Lagrange polynomials."""
    x, quadrature = np.polynomial.legendre.leggauss(degree)
    nodes, b = (x + 1.0) / 2.0, quadrature / 2.0
    # Lagrange polynomials in the Legendre basis, l_j = sum_k (2k+1) b_j P_k(x_j) P_k, integrated term by term.
    vandermonde = np.polynomial.legendre.legvander(x, degree)
    order = 2 * np.arange(degree) + 1
    below = np.concatenate([np.zeros((degree, 1)), vandermonde[:, : degree - 1]], axis=1)
    integrals = (vandermonde[:, 1:] - below) / (2 * order)  # of P_k from 0, in the variable on [0, 1]
    integrals[:, 0] = nodes
    a = integrals @ ((order * vandermonde[:, :degree]).T * b)
    return GaussTable(nodes, np.vstack([a, b]))


class GaussProblem(OrbitProblem):
    """Equations of K intervals with d stages; unknowns ordered in time: x_0, X_11 .. X_1d, x_1, ..., x_K.

    For the full period an unfolding parameter, the coefficient of a damping that a conservative model does not have,
    makes the equations regular (Sepulchre and MacKay 1997; Munoz-Almaraz et al. 2003); it comes back as zero. The
    phase is where the model's normalisation is stationary along the flow. Raises ValueError for missing symmetries.
    """

    def __init__(self, model: OdeModel, intervals: int, symmetry: SymmetryClass, degree: int = 5) -> None:
        if model.parameters.numel() != 1 or model.normalisation is None:
            raise ValueError(f"{model.name}: a family needs one free parameter and a normalisation")
        if symmetry is SymmetryClass.FULL and model.order == 1 and model.hamiltonian is None:
            raise ValueError(f"{model.name}: the full period unfolds a conserved quantity; declare its hamiltonian")
        self.model, self.resolution, self.symmetry, self.degree = model, intervals, symmetry, degree
        self.pinned = pinned_components(model, symmetry)
        self.columns = intervals * (degree + 1) + 1
        self.states = model.full_size * self.columns
        self.unfolded = symmetry is SymmetryClass.FULL
        self._table = gauss_table(degree)

    @property
    def size(self) -> int:
        return self.states + 2 + int(self.unfolded)

    @property
    def damping_index(self) -> int:
        """Place of the unfolding parameter among the unknowns (full period only)."""
        return self.states + 2

    # Equations ------------------------------------------------------------------------------------------------------

    def _field(self) -> ca.Function:
        """Function (x, (p, damping)) -> (F, dF/dx, dF/d(p, damping)) of the unfolded first-order field."""
        model, damping = self.model, ca.SX.sym("damping")
        if model.velocity is not None:
            direction = ca.vertcat(ca.SX.zeros(model.size), model.velocity)
        elif model.hamiltonian is not None:
            direction = ca.gradient(model.hamiltonian, model.full_state)
        else:  # of no use: only the full period unfolds
            direction = ca.SX(model.full_size, 1)
        x, parameters = model.full_state, ca.vertcat(model.parameters, damping)
        field = model.full_rhs + damping * direction
        results = [field, ca.jacobian(field, x), ca.densify(ca.jacobian(field, parameters))]
        return ca.Function("field", [x, parameters], results)

    def _conditions(self) -> ca.Function:
        """Function (x_0, x_K, p) -> boundary conditions, normalisation, phase; then their derivatives."""
        model = self.model
        x, p, end = model.full_state, model.parameters, ca.SX.sym("end", model.full_size)
        first, last = self.pinned
        conditions = ca.vertcat(x[first], end[last], end - x) if self.unfolded else ca.vertcat(x[first], end[last])
        rows = ca.vertcat(conditions, model.normalisation)
        if self.unfolded:
            rows = ca.vertcat(rows, ca.jacobian(model.normalisation, x) @ model.full_rhs)
        derivatives = [ca.jacobian(rows, v) for v in (x, end, p)]
        return ca.Function("conditions", [x, end, p], [rows, *derivatives])

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        n, K, d = self.model.full_size, self.resolution, self.degree
        extended = self._table.extended
        z = ca.MX.sym("z", self.size)
        values = ca.reshape(z[: self.states], n, self.columns)
        Omega, p = z[self.Omega_index], z[self.parameter_index]
        damping = z[self.damping_index] if self.unfolded else ca.MX(0)
        stage = np.array([k * (d + 1) + 1 + j for k in range(K) for j in range(d)])
        start = np.repeat(np.arange(K) * (d + 1), d + 1)
        target = start + np.tile(np.arange(1, d + 2), K)

        field = self._field()
        F, dF_dx, dF_dp = field.map(K * d)(values[:, stage.tolist()], ca.repmat(ca.vertcat(p, damping), 1, K * d))
        step = self.symmetry.value * 2.0 * np.pi / K / Omega
        weights = ca.kron(ca.DM.eye(K), ca.DM(extended.T))  # (K d) x (K (d + 1)): increments from stage derivatives
        increments = F @ weights
        collocation = values[:, target.tolist()] - values[:, start.tolist()] - step * increments
        conditions, dc_dstart, dc_dend, dc_dp = self._conditions()(values[:, 0], values[:, -1], p)
        residual = ca.vertcat(ca.vec(collocation), conditions)

        shape = (self.size - 1, self.size)
        block = np.arange(K * (d + 1))
        component = np.arange(n)
        row_of = (block[:, None] * n + component).ravel()
        ones = np.ones(row_of.size)
        identity = sparse_matrix(shape, row_of, (target[:, None] * n + component).ravel(), ca.MX(ca.DM(ones)))
        identity -= sparse_matrix(shape, row_of, (start[:, None] * n + component).ravel(), ca.MX(ca.DM(ones)))

        r, c = (np.array(t, dtype=np.int64) for t in field.sparsity_out(1).get_triplet())
        entries = ca.reshape(dF_dx.nz[:], r.size, K * d)
        interval, j = np.arange(K * d) // d, np.arange(K * d) % d
        stiffness = ca.MX(*shape)
        for i in range(d + 1):
            scaled = -step * entries * ca.repmat(ca.DM(extended[i][j]).T, r.size, 1)
            rows = ((interval * (d + 1) + i)[:, None] * n + r).ravel()
            columns = (stage[:, None] * n + c).ravel()
            stiffness += sparse_matrix(shape, rows, columns, ca.vec(scaled))

        bottom = row_of.size
        by_Omega = ca.vec(step / Omega * increments)
        dF_dp = ca.reshape(dF_dp, 2 * n, K * d)  # column by column: dF/dp above dF/d(damping)
        border_rows = [row_of, row_of]
        border_columns = [np.full(bottom, self.Omega_index), np.full(bottom, self.parameter_index)]
        border_values = [by_Omega, ca.vec(-step * (dF_dp[:n, :] @ weights))]
        if self.unfolded:
            border_rows.append(row_of)
            border_columns.append(np.full(bottom, self.damping_index))
            border_values.append(ca.vec(-step * (dF_dp[n:, :] @ weights)))
        for derivative, offset in (
            (dc_dstart, 0),
            (dc_dend, self.states - n),
            (dc_dp, self.parameter_index),
        ):
            rows, columns = (np.array(t, dtype=np.int64) for t in derivative.sparsity().get_triplet())
            border_rows.append(rows + bottom)
            border_columns.append(columns + offset)
            border_values.append(derivative.nz[:])
        borders = sparse_matrix(
            shape, np.concatenate(border_rows), np.concatenate(border_columns), ca.vertcat(*border_values)
        )
        return z, residual, identity + stiffness + borders

    # Values ---------------------------------------------------------------------------------------------------------

    def _phases(self) -> Array:
        """Phases theta of the columns of unknowns, shape (columns,)."""
        inner = np.concatenate([[0.0], self._table.nodes])
        fractions = np.concatenate([(k + inner) / self.resolution for k in range(self.resolution)] + [[1.0]])
        return self.symmetry.value * 2.0 * np.pi * fractions

    def pack(self, positions: Array, Omega: float, parameter: float) -> Array:
        theta = self._phases()
        state = np.outer(np.cos(theta), positions)
        if self.model.order == 2:
            state = np.hstack([state, np.outer(-Omega * np.sin(theta), positions)])
        return np.concatenate([state.ravel(), [Omega, parameter], np.zeros(int(self.unfolded))])

    def _interpolate(self, z: Array, fractions: Array) -> Array:
        """Full states at fractions of the part of the period, shape (len(fractions), full_size)."""
        K, d = self.resolution, self.degree
        values = z[: self.states].reshape(self.columns, self.model.full_size)
        interval = np.clip((fractions * K).astype(int), 0, K - 1)
        support = np.concatenate([[0.0], self._table.nodes, [1.0]])
        gaps = support[:, None] - support
        np.fill_diagonal(gaps, 1.0)
        barycentric = 1.0 / np.prod(gaps, axis=1)
        offset = (fractions * K - interval)[:, None] - support
        hit = np.abs(offset) < 1e-14
        offset[hit] = 1.0
        weights = barycentric / offset
        weights[hit.any(axis=1)] = 0.0
        weights[hit] = 1.0
        weights /= weights.sum(axis=1, keepdims=True)
        columns = interval[:, None] * (d + 1) + np.arange(d + 2)
        return np.asarray(np.einsum("tk,tkn->tn", weights, values[columns]))

    def prolong(self, z: Array, finer: OrbitProblem) -> Array:
        assert isinstance(finer, GaussProblem)
        fractions = finer._phases() / (self.symmetry.value * 2.0 * np.pi)
        return np.concatenate([self._interpolate(z, fractions).ravel(), z[self.states :]])

    def sample(self, z: Array, theta: Array) -> Array:
        turn = np.mod(np.asarray(theta, dtype=float) / (2.0 * np.pi), 1.0)
        signs = np.ones((turn.size, self.model.full_size))
        if self.symmetry is SymmetryClass.QUARTER:
            later = turn >= 0.5
            turn = np.where(later, turn - 0.5, turn)
            signs[later] *= np.array(self.model.half_period)
        if self.symmetry is not SymmetryClass.FULL:
            # x(-t) = R x(t); with x(t + T/2) = P x(t) it folds the second quarter onto the first.
            fold = 0.25 if self.symmetry is SymmetryClass.QUARTER else 0.5
            back = turn > fold
            turn = np.where(back, 2 * fold - turn, turn)
            image = np.array(self.model.reversal)
            if self.symmetry is SymmetryClass.QUARTER:
                image = image * np.array(self.model.half_period)
            signs[back] *= image
        full = signs * self._interpolate(z, turn / self.symmetry.value)
        return np.asarray(full[:, : self.model.size])
