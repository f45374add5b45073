"""Values of odd cosines at the nodes theta_i = (i + 1/2) pi/(2H): transform, prolongation, second derivative."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache

import casadi as ca
import numpy as np

from casadi_skin.model.polynomial import Program, lifted
from casadi_skin.native import EquationsKernel, has_kernel
from casadi_skin.zero.problem import Array, Indices, Scalar, sparse_matrix


def quarter_phases(nodes: int) -> Array:
    """Midpoints of `nodes` equal parts of a quarter of the period."""
    return (np.arange(nodes) + 0.5) * np.pi / (2 * nodes)


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


# Equations of collocation in odd cosines: where entries of the Jacobian go, for CasADi and for the compiled kernel ----

LONGEST_PROGRAM = 40_000  # instructions of a model with its derivatives, at most


@dataclass(frozen=True, eq=False)
class JacobianPlaces:
    """Rows and columns of the parts of the Jacobian, by the non-zeros of a force's derivative.

    The parts are what second derivatives alone give, derivatives of the force by the positions at one node after the
    other, those by the frequency and by the parameter, and those of the normalisation. Of the first two `constants` are
    what does not depend on the state.
    """

    rows: tuple[Indices, ...]
    columns: tuple[Indices, ...]
    constants: tuple[Array, Array]

    @classmethod
    def of(cls, harmonics: int, sites: int, rows: Indices, columns: Indices) -> JacobianPlaces:
        """Those of a force on `sites` positions, whose derivative has non-zeros in these rows and columns."""
        H, N, states, D2 = harmonics, sites, sites * harmonics, second_derivative_matrix(harmonics)
        node, every = np.repeat(np.arange(H), rows.size), np.arange(states, dtype=np.int64)
        at, into = np.tile(rows, H) * H + node, np.tile(columns, H) * H + node
        n, i, k = (t.ravel() for t in np.meshgrid(np.arange(N), np.arange(H), np.arange(H), indexing="ij"))
        met = (i == k) & np.isin(n, rows[rows == columns])  # entries that are added to those of the force
        scalars = [np.full(states, states + scalar.value) for scalar in (Scalar.OMEGA, Scalar.PARAMETER)]
        return cls(
            ((n * H + i)[~met], at, every, every, np.full(states, states)),
            ((n * H + k)[~met], into, *scalars, every),
            (D2[i, k][~met], np.where(at == into, np.diag(D2)[node], 0.0)),
        )

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        """Rows and columns of all non-zeros, column by column."""
        rows, columns = np.concatenate(self.rows), np.concatenate(self.columns)
        order = np.lexsort((rows, columns))
        return rows[order], columns[order]

    @property
    def slots(self) -> list[Indices]:
        """Of each part, its places among the non-zeros column by column."""
        rows, columns = np.concatenate(self.rows), np.concatenate(self.columns)
        slots = np.empty(rows.size, dtype=np.int64)
        slots[np.lexsort((rows, columns))] = np.arange(rows.size)
        return np.split(slots, np.cumsum([part.size for part in self.rows])[:-1])


@dataclass(frozen=True, eq=False)
class _Programs:
    """Programs of a force and of a normalisation with their derivatives, each with its constants.

    `rows` and `columns` are those of the non-zeros of the force's derivative by the positions.
    """

    force: tuple[Program, Array]
    norm: tuple[Program, Array]
    rows: Indices
    columns: Indices


@lru_cache(maxsize=8)
def _programs(model: Program) -> _Programs | None:
    """Those of a model; None where there is no kernel for them."""
    sizes = (*model.inputs, model.numbers)
    symbols = [ca.SX.sym(name, size) for name, size in zip("qvpc", sizes, strict=True)]
    force, normalisation = model.expressions(symbols[:3], symbols[3])
    slopes, by_norm = ca.jacobian(force, symbols[0]), ca.jacobian(normalisation, symbols[0])
    of_force = [force, ca.vertcat(*slopes.nonzeros()), ca.jacobian(force, symbols[2])]
    found = [lifted(symbols, results, LONGEST_PROGRAM) for results in (of_force, [normalisation, by_norm.T])]
    rows, columns = (np.array(t, dtype=np.int64) for t in slopes.sparsity().get_triplet())
    if found[0] is None or found[1] is None or not has_kernel(found[0][0], found[1][0]):
        return None
    return _Programs(found[0], found[1], rows, columns)


@dataclass(frozen=True, eq=False)
class CompiledEquations:
    """The equations of a model of one program by the compiled kernel, with the rows and columns of the Jacobian."""

    kernel: EquationsKernel
    pattern: tuple[Indices, Indices]

    @classmethod
    def of(cls, model: Program, harmonics: int) -> CompiledEquations | None:
        """Those at so many nodes; None where there is no kernel for them."""
        programs = _programs(model)
        if programs is None:
            return None
        H, sites, V = harmonics, model.inputs[0], (2.0 / harmonics) * cosine_matrix(harmonics)
        places = JacobianPlaces.of(H, sites, programs.rows, programs.columns)
        fixed, at_slopes, *rest = places.slots
        constant = np.zeros(sum(part.size for part in places.rows))
        constant[fixed], constant[at_slopes] = places.constants
        matrices = second_derivative_matrix(H), cosine_matrix(H)[:, 0], V[0], V.sum(axis=0)
        slots = at_slopes.reshape(H, -1).T, *rest
        kernel = EquationsKernel(programs.force, programs.norm, matrices, constant, slots)
        return cls(kernel, places.pattern)


def odd_cosine_equations(
    harmonics: int, symbols: Sequence[ca.SX], force: ca.SX, normalisation: ca.SX, *numbers: ca.MX
) -> tuple[ca.MX, ca.MX, ca.MX]:
    """Unknowns z, residual and Jacobian of the equations of a model at the nodes.

    `symbols` are those of positions, velocities, the free parameter, and of the `numbers` where there are such.
    """
    H, N = harmonics, int(symbols[0].numel())
    states, Omega_index, parameter_index = N * H, N * H + Scalar.OMEGA.value, N * H + Scalar.PARAMETER.value
    at_zero = ((2.0 / H) * cosine_matrix(H)).sum(axis=0)
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

    triplet = (np.array(t, dtype=np.int64) for t in rhs.sparsity_out(1).get_triplet())
    places = JacobianPlaces.of(H, N, *triplet)
    alone, added = (ca.DM(constants) for constants in places.constants)
    entries = ca.vertcat(
        alone,
        added - ca.vec(df_dq.nz[:]) / Omega**2,
        2 * forces / Omega**3,
        -df_dp / Omega**2,
        ca.vec(ca.DM(at_zero) @ dn_dq),
    )
    shape, at = (states + 1, states + 2), (np.concatenate(places.rows), np.concatenate(places.columns))
    return z, residual, sparse_matrix(shape, *at, entries)


def _second_derivative(values: ca.MX) -> ca.MX:
    """Second derivatives at the nodes, shape (harmonics, sites).

    Sums over entries of size H^2 are left to what is beyond cos(theta): their rounding would show in Omega.
    """
    H = values.shape[0]
    cosine = ca.DM(cosine_matrix(H)[:, 0])
    amplitude = ca.DM((2.0 / H) * cosine_matrix(H)[0]).T @ values
    return ca.DM(second_derivative_matrix(H)) @ (values - cosine @ amplitude) - cosine @ amplitude
