"""Collocation in odd cosines: positions only, on a quarter of the period, for odd reversible models of second order.

q(theta) = sum_k c_k cos((2k+1) theta), k < H, satisfies the equations at theta_i = (i + 1/2) pi/(2H). The values at
these nodes and the coefficients are related by the type-IV cosine transform, which is its own inverse up to 2/H.
See Boyd, Chebyshev and Fourier Spectral Methods (2001), sections 3.1 and 8.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.bvp.orbit_problem import OrbitProblem
from casadi_skin.bvp.problem import EPSILON, Array, Buffers, Problem, Scalar, sparse_matrix
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.models.lifted import Program, lifted
from casadi_skin.models.ode import OdeModel

MOST = 4000  # instructions of a model up to which it is worth while to compare them with those of others
KEPT = 32  # resolutions of models whose functions are kept
ALIASED = 4.0  # error of a coarser orbit per size of the harmonics that it leaves out: measured


@cache
def cosine_matrix(harmonics: int) -> Array:
    """Symmetric matrix V with V_ik = cos((2k+1) theta_i); V V = (H/2) I, shape (H, H)."""
    i = np.arange(harmonics)
    phase = np.outer(2 * i + 1, 2 * i + 1) % (8 * harmonics)
    matrix = np.cos(np.pi * phase / (4 * harmonics))
    matrix.flags.writeable = False  # kept and shared
    return matrix


@cache
def prolongation_matrix(harmonics: int, others: int) -> Array:
    """Matrix from node values of `harmonics` odd cosines to those of `others`, shape (harmonics, others)."""
    kept = min(harmonics, others)
    return (2.0 / harmonics) * cosine_matrix(harmonics)[:, :kept] @ cosine_matrix(others)[:kept]


@cache
def second_derivative_matrix(harmonics: int) -> Array:
    """Matrix of d^2/dtheta^2 on node values, shape (H, H).

    Entries are of size H^2, and what rounding makes of -cos(theta) goes into every frequency. The diagonal is chosen so
    that the rounded matrix is right for cos(theta) (Baltensperger and Trummer 2003), where long double has more digits.
    """
    i = np.arange(harmonics)
    angle = (np.outer(2 * i + 1, 2 * i + 1) % (8 * harmonics)).astype(np.longdouble) / (4 * harmonics)
    V = np.cos(np.arccos(np.longdouble(-1.0)) * angle)
    exact = -((V * (2 * i + 1) ** 2) @ V) * 2 / harmonics
    rounded = exact.astype(np.float64)
    fundamental = V[:, 0]
    missing = -(fundamental + rounded @ fundamental) / fundamental
    rounded[i, i] = (rounded[i, i] + missing).astype(np.float64)
    rounded.flags.writeable = False  # kept and shared
    return np.asarray(rounded)


@lru_cache(maxsize=KEPT)
def _sampling(harmonics: int, theta: bytes) -> Array:
    """Weights of the values at the nodes in those at phases, given as bytes, shape (harmonics, phases)."""
    phases = np.outer(2 * np.arange(harmonics) + 1, np.frombuffer(theta))
    weights = (2.0 / harmonics) * cosine_matrix(harmonics) @ np.cos(phases)
    weights.flags.writeable = False  # kept and shared
    return np.asarray(weights)


def odd_cosine_equations(
    harmonics: int, symbols: Sequence[ca.SX], force: ca.SX, normalisation: ca.SX, *numbers: ca.MX
) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Unknowns z, residual and Jacobian of the equations of a model at the nodes.

    `symbols` are those of positions, velocities, the free parameter, and of the `numbers` where there are such.
    """
    H, N = harmonics, int(symbols[0].numel())
    states, Omega_index, parameter_index = N * H, N * H + Scalar.OMEGA.value, N * H + Scalar.PARAMETER.value
    D2, at_zero = second_derivative_matrix(H), ((2.0 / H) * cosine_matrix(H)).sum(axis=0)
    q, velocity, parameter, *own = symbols
    slopes = ca.jacobian(force, q), ca.densify(ca.jacobian(force, parameter))
    rhs = ca.Function("rhs", [q, parameter, *own], [ca.densify(force), *slopes])
    start = ca.Function(
        "start", [q, velocity, parameter, *own], [normalisation, ca.densify(ca.jacobian(normalisation, q))]
    )

    z = ca.MX.sym("z", states + 2)
    values, Omega, p = ca.reshape(z[:states], H, N), z[Omega_index], z[parameter_index]
    forces, df_dq, df_dp = rhs.map(H)(values.T, *(ca.repmat(value, 1, H) for value in (p, *numbers)))
    forces, df_dp = ca.vec(forces.T), ca.vec(df_dp.T)
    norm, dn_dq = start(values.T @ at_zero, ca.MX.zeros(N), p, *numbers)
    residual = ca.vertcat(ca.vec(_second_derivative(values)) - forces / Omega**2, norm)

    rows, columns = (np.array(t, dtype=np.int64) for t in rhs.sparsity_out(1).get_triplet())
    node = np.repeat(np.arange(H), rows.size)
    at_nodes = np.tile(rows, H) * H + node, np.tile(columns, H) * H + node
    every = np.arange(states, dtype=np.int64)
    n, i, k = (t.ravel() for t in np.meshgrid(np.arange(N), np.arange(H), np.arange(H), indexing="ij"))
    met = (i == k) & np.isin(n, rows[rows == columns])  # entries of the derivative that are added to those of the force
    added = np.where(at_nodes[0] == at_nodes[1], np.diag(D2)[node], 0.0)
    parts = (
        ((n * H + i)[~met], (n * H + k)[~met], ca.MX(ca.DM(D2[i, k][~met]))),
        (*at_nodes, ca.DM(added) - ca.vec(df_dq.nz[:]) / Omega**2),
        (every, np.full(states, Omega_index), 2 * forces / Omega**3),
        (every, np.full(states, parameter_index), -df_dp / Omega**2),
        (np.full(states, states), every, ca.vec(ca.DM(at_zero) @ dn_dq)),
    )
    at, into, entries = zip(*parts, strict=True)
    shape = (states + 1, states + 2)
    return z, residual, sparse_matrix(shape, np.concatenate(at), np.concatenate(into), ca.vertcat(*entries))


def _second_derivative(values: ca.MX) -> ca.MX:
    """Second derivatives at the nodes, shape (harmonics, sites).

    Sums over entries of size H^2 are left to what is beyond cos(theta): their rounding would show in Omega.
    """
    H = values.shape[0]
    cosine = ca.DM(cosine_matrix(H)[:, 0])
    amplitude = ca.DM((2.0 / H) * cosine_matrix(H)[0]).T @ values
    return ca.DM(second_derivative_matrix(H)) @ (values - cosine @ amplitude) - cosine @ amplitude


@lru_cache(maxsize=8)
def _lifted(model: OdeModel) -> tuple[Program, Array] | None:
    """The force and the normalisation of a model without their numbers, and these; None where they are long."""
    return lifted([model.state, model.velocity, model.parameters], [model.rhs, model.normalisation], MOST)


@dataclass(frozen=True, eq=False)
class _Kept:
    """Functions and buffers that all models of one program share, at one resolution."""

    function: ca.Function
    buffers: Buffers
    shared: dict[Any, Any]


@lru_cache(maxsize=KEPT)
def _kept(program: Program, harmonics: int, thread: int) -> _Kept:
    """Those of a thread: the arguments of functions are arrays of their own."""
    sizes = (program.inputs[0], program.inputs[1], program.inputs[2], program.numbers)
    symbols = tuple(ca.SX.sym(name, size) for name, size in zip("qvpc", sizes, strict=True))
    force, normalisation = program.expressions(symbols[:3], symbols[3])
    numbers = ca.MX.sym("numbers", program.numbers)
    z, residual, jacobian = odd_cosine_equations(harmonics, symbols, force, normalisation, numbers)
    function = ca.Function("equations", [z, numbers], [ca.densify(residual), jacobian])
    return _Kept(function, Buffers(function), {})


class TrigonometricProblem(OrbitProblem):
    """Equations q''(theta) - f(q, p)/Omega^2 = 0 at the nodes; unknowns ordered by site, then node.

    Raises ValueError for a model that is not of second order, reversible with even positions, and odd.
    """

    holds_linear_modes = True

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
        model = self.model
        symbols = model.state, model.velocity, model.parameters
        return odd_cosine_equations(self.resolution, symbols, model.rhs, model.normalisation)

    # What is built is kept for other models that differ in numbers alone -------------------------------------------

    @cached_property
    def _kept(self) -> _Kept | None:
        lifted = _lifted(self.model)
        return None if lifted is None else _kept(lifted[0], self.resolution, threading.get_ident())

    @cached_property
    def compiled(self) -> ca.Function:
        return self.function if self._kept is None else self._kept.function

    @cached_property
    def numbers(self) -> Array:
        lifted = None if self._kept is None else _lifted(self.model)
        return self.constants if lifted is None else lifted[1]

    @cached_property
    def _buffers(self) -> Buffers:
        return Buffers(self.compiled) if self._kept is None else self._kept.buffers

    @property
    def shared(self) -> dict[Any, Any]:
        return super().shared if self._kept is None else self._kept.shared

    def place(self, equation: int) -> str:
        """Place of an equation, counted from 0, in words."""
        if equation >= self.states:
            return super().place(equation)
        site, node = divmod(equation, self.resolution)
        return f"site {site + 1}, node {node + 1} of {self.resolution}"

    def pack(self, positions: Array, Omega: float, parameter: float) -> Array:
        theta = (np.arange(self.resolution) + 0.5) * np.pi / (2 * self.resolution)
        return np.concatenate([np.outer(positions, np.cos(theta)).ravel(), [Omega, parameter]])

    def _spread(self, factors: Array) -> Array:
        return np.repeat(factors, self.resolution)

    def coefficients(self, z: Array) -> Array:
        """Coefficients c_k of cos((2k+1) theta), shape (model.size, harmonics)."""
        return z[: self.states].reshape(self.model.size, self.resolution) @ self._to_coefficients

    def prolong(self, z: Array, finer: Problem) -> Array:
        H = self.resolution
        values = z[: self.states].reshape(self.model.size, H) @ prolongation_matrix(H, finer.resolution)
        return np.concatenate([values.ravel(), z[self.states :]])

    def rounding(self, z: Array) -> float:
        beyond = z.copy()
        values = beyond[: self.states].reshape(self.model.size, self.resolution)
        values -= np.outer(values @ self._to_coefficients[0], cosine_matrix(self.resolution)[0])
        return super().rounding(beyond) + EPSILON * float(np.max(np.abs(z[: self.states])))

    @property
    def round_off(self) -> float:
        return EPSILON * (10.0 + 0.2 * self.resolution)

    def expected_error(self, z: Array, error: float, other: Problem) -> float:
        lost = np.sum(np.abs(self.coefficients(z)[:, other.resolution :]), axis=1)
        sizes = np.max(np.abs(z[: self.states].reshape(self.model.size, -1)), axis=1)
        ratio = np.max(lost) / np.max(sizes)
        if self.model.output_scale is not None:
            scale = np.array(self.model.output_scale)
            ratio = max(ratio, np.max(scale * lost) / np.max(scale * sizes))
        return error + ALIASED * float(ratio)

    def sample(self, z: Array, theta: Array) -> Array:
        return np.asarray(self.samples(z[None], theta)[0])

    def samples(self, z: Array, theta: Array) -> Array:
        # One product an orbit: the last bit of a larger one depends on how many there are.
        values = z[:, : self.states].reshape(len(z), self.model.size, self.resolution) @ self.sampling(theta)
        return np.asarray(values.swapaxes(1, 2))

    def sampling(self, theta: Array) -> Array:
        return _sampling(self.resolution, theta.tobytes())
