"""Collocation in odd cosines: positions only, on a quarter of the period, for odd reversible models of second order.

q(theta) = sum_k c_k cos((2k+1) theta), k < H, satisfies the equations at theta_i = (i + 1/2) pi/(2H). The values at
these nodes and the coefficients are related by the type-IV cosine transform, which is its own inverse up to 2/H.
See Boyd, Chebyshev and Fourier Spectral Methods (2001), sections 3.1 and 8.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, OrbitProblem, sparse_matrix
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.models.ode import OdeModel


def cosine_matrix(harmonics: int) -> Array:
    """Symmetric matrix V with V_ik = cos((2k+1) theta_i); V V = (H/2) I, shape (H, H)."""
    i = np.arange(harmonics)
    phase = np.outer(2 * i + 1, 2 * i + 1) % (8 * harmonics)
    return np.cos(np.pi * phase / (4 * harmonics))


def second_derivative_matrix(harmonics: int) -> Array:
    """Matrix of d^2/dtheta^2 on node values, shape (H, H)."""
    V = cosine_matrix(harmonics)
    return -(2.0 / harmonics) * (V * (2.0 * np.arange(harmonics) + 1.0) ** 2) @ V


class TrigonometricProblem(OrbitProblem):
    """Equations q''(theta) - f(q, p)/Omega^2 = 0 at the nodes; unknowns ordered by site, then node.

    Raises ValueError for a model that is not of second order, reversible with even positions, and odd.
    """

    def __init__(self, model: OdeModel, harmonics: int) -> None:
        even_positions = model.reversal == (1,) * model.size + (-1,) * model.size
        odd = model.half_period == (-1,) * model.full_size
        if model.order != 2 or not (even_positions and odd):
            raise ValueError(f"{model.name}: odd cosines need a second-order, reversible and odd model; use gauss")
        if model.parameters.numel() != 1 or model.normalisation is None:
            raise ValueError(f"{model.name}: a family needs one free parameter and a normalisation")
        self.model, self.resolution, self.symmetry = model, harmonics, SymmetryClass.QUARTER
        self.states = model.size * harmonics
        self._to_coefficients = (2.0 / harmonics) * cosine_matrix(harmonics)
        width = int(np.max(np.abs(np.subtract(*model.rhs_and_jacobian().sparsity_out(1).get_triplet())), initial=0))
        self.half_bandwidth = harmonics * max(width, 1)

    @property
    def size(self) -> int:
        return self.states + 2

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        H, N = self.resolution, self.model.size
        D2, at_zero = second_derivative_matrix(H), self._to_coefficients.sum(axis=0)
        z = ca.MX.sym("z", self.size)
        values, Omega, p = ca.reshape(z[: self.states], H, N), z[self.Omega_index], z[self.parameter_index]
        rhs = self.model.rhs_and_jacobian()
        force, df_dq, df_dp = rhs.map(H)(values.T, ca.repmat(p, 1, H))
        force, df_dp = ca.vec(force.T), ca.vec(df_dp.T)

        model = self.model
        start = ca.Function(
            "start",
            [model.state, model.velocity, model.parameters],
            [model.normalisation, ca.densify(ca.jacobian(model.normalisation, model.state))],
        )
        normalisation, dn_dq = start(values.T @ at_zero, ca.MX.zeros(N), p)
        residual = ca.vertcat(ca.vec(ca.DM(D2) @ values) - force / Omega**2, normalisation)

        rows, columns = (np.array(t, dtype=np.int64) for t in rhs.sparsity_out(1).get_triplet())
        node = np.repeat(np.arange(H), rows.size)
        shape = (self.size - 1, self.size)
        every = np.arange(self.states, dtype=np.int64)
        n_index, i_index, k_index = np.meshgrid(np.arange(N), np.arange(H), np.arange(H), indexing="ij")
        derivative = sparse_matrix(
            shape,
            (n_index * H + i_index).ravel(),
            (n_index * H + k_index).ravel(),
            ca.MX(ca.DM(np.broadcast_to(D2, (N, H, H)).ravel())),
        )
        stiffness = sparse_matrix(
            shape, np.tile(rows, H) * H + node, np.tile(columns, H) * H + node, -ca.vec(df_dq.nz[:]) / Omega**2
        )
        borders = sparse_matrix(
            shape,
            np.concatenate([every, every, np.full(self.states, self.states)]),
            np.concatenate([np.full(self.states, self.Omega_index), np.full(self.states, self.parameter_index), every]),
            ca.vertcat(2 * force / Omega**3, -df_dp / Omega**2, ca.vec(ca.DM(at_zero) @ dn_dq)),
        )
        return z, residual, derivative + stiffness + borders

    def pack(self, positions: Array, Omega: float, parameter: float) -> Array:
        theta = (np.arange(self.resolution) + 0.5) * np.pi / (2 * self.resolution)
        return np.concatenate([np.outer(positions, np.cos(theta)).ravel(), [Omega, parameter]])

    def coefficients(self, z: Array) -> Array:
        """Coefficients c_k of cos((2k+1) theta), shape (model.size, harmonics)."""
        return z[: self.states].reshape(self.model.size, self.resolution) @ self._to_coefficients

    def prolong(self, z: Array, finer: OrbitProblem) -> Array:
        H = finer.resolution
        kept = self.coefficients(z)[:, :H]
        padded = np.zeros((self.model.size, H))
        padded[:, : kept.shape[1]] = kept
        return np.concatenate([(padded @ cosine_matrix(H)).ravel(), z[self.states :]])

    def sample(self, z: Array, theta: Array) -> Array:
        basis = np.cos(np.outer(theta, 2 * np.arange(self.resolution) + 1))
        return np.asarray(basis @ self.coefficients(z).T)
