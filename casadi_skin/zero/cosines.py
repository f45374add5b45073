"""Collocation in odd cosines: positions only, on a quarter of the period, for odd reversible models of second order.

q(theta) = sum_k c_k cos((2k+1) theta), k < H, satisfies q'' = f(q, p)/Omega^2 at theta_i = (i + 1/2) pi/(2H). The
values at these nodes, (sites, H), are the unknowns; they and the coefficients are related by the type-IV cosine
transform, which is its own inverse up to 2/H. See Boyd, Chebyshev and Fourier Spectral Methods (2001), sections 3.1 and
8.

Along a branch z(tau) = sum_k z_k tau^k of polynomial equations every order solves the same linear system, with a
right-hand side that the lower orders give through Cauchy products: the asymptotic numerical method (Damil and
Potier-Ferry 1990; Cochelin and Vergez 2009).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.operations import Program, read
from casadi_skin.model.polynomial import Monomials, terms_of_results
from casadi_skin.native import Structure, TaylorKernel, kernels
from casadi_skin.zero.problem import (
    EPSILON,
    Array,
    Buffers,
    Indices,
    OrbitProblem,
    Problem,
    Scalar,
    Solve,
)


@dataclass(frozen=True, eq=False)
class _Terms:
    """Terms coefficient * p^power * product of states of one power and degree, and series of the products in them.

    Attributes:
        power: of the parameter.
        places: columns of the states' series that are the factors, one a term and node.
        products: series of x_a, x_a x_b, ..., shape (orders + 1, terms * nodes) each.
        scatter: adds values of terms, (terms, nodes), to the components that they belong to.
    """

    power: int
    places: list[Indices]
    products: list[Array]
    scatter: Any

    @classmethod
    def of(cls, monomials: Monomials, components: int, nodes: int, orders: int) -> _Terms:
        """Those of monomials, at every node."""
        from scipy.sparse import csr_matrix

        count, every = monomials.rows.size, np.arange(nodes)
        places = [(factor[:, None] * nodes + every).ravel() for factor in monomials.factors]
        entries = (monomials.coefficients, (monomials.rows, np.arange(count)))
        products = [np.zeros((orders + 1, count * nodes)) for _ in places]
        return cls(monomials.power, places, products, csr_matrix(entries, (components, count)))


class SumOfTerms:
    """Series of a sum of terms, by component; states are (order, all)."""

    def __init__(self, terms: Sequence[Monomials], series: Array, components: int, nodes: int) -> None:
        # Of terms that are linear nothing is left when the order sought is taken out.
        kept = [m for m in terms if m.power + m.degree > 1]
        self._series, self._shape = series, (components, nodes)
        self._terms = [_Terms.of(m, components, nodes, len(series) - 1) for m in kept]
        self.highest = max((m.power for m in kept), default=0)

    def order(self, k: int, powers: Array) -> Array:
        """Order k of the sum, shape (components, nodes); `powers`, (power, order), are series of powers of p."""
        total = np.zeros(self._shape)
        for terms in self._terms:
            value = np.full(terms.scatter.shape[1] * self._shape[1], powers[terms.power, k])
            for level, place in enumerate(terms.places):
                factor, product = self._series[: k + 1, place], terms.products[level]
                left = terms.products[level - 1][: k + 1]
                product[k] = np.einsum("jm,jm->m", left, factor[::-1]) if level else factor[k]
                value = powers[terms.power, k::-1] @ product[: k + 1] if terms.power else product[k]
            total += terms.scatter @ value.reshape(terms.scatter.shape[1], -1)
        return total


@dataclass(frozen=True)
class PolynomialForm:
    """Right-hand side and normalisation of a model as polynomials of its state and parameter."""

    force: tuple[Monomials, ...]
    norm: tuple[Monomials, ...]

    @classmethod
    def of(cls, model: OdeModel) -> PolynomialForm:
        """The form of a model; raises NotPolynomialError where there is none."""
        return _form(model)


@lru_cache(maxsize=8)
def _form(model: OdeModel) -> PolynomialForm:
    program, numbers = _program(model)
    return PolynomialForm(*terms_of_results(program, numbers.tolist(), model.size))


class Recursion(Protocol):
    """Power series of the branch through a point."""

    def series(self, z: Array, slope: Array, solve: Solve) -> Array:
        """Coefficients of the branch from z with first coefficient `slope`, shape (orders + 1, unknowns)."""
        ...

    @property
    def end(self) -> tuple[int, float] | None:
        """An unknown and its value up to which the last series holds; None where the equations are analytic."""
        ...


class CosineUnknowns(Protocol):
    """Where the unknowns of a problem in odd cosines stand: states by site, then node, and then the scalars."""

    model: OdeModel
    resolution: int
    states: int
    second_derivative: Array  # matrix of d^2/dtheta^2 on the values at the nodes
    at_zero: Array  # weights of the values at the nodes in that at phase zero

    @property
    def size(self) -> int: ...

    @property
    def Omega_index(self) -> int: ...

    @property
    def parameter_index(self) -> int: ...


class TaylorRecursion:
    """Coefficients z_k of a branch of one trigonometric problem; buffers are made once and used again."""

    end: tuple[int, float] | None = None  # equations are analytic everywhere

    def __init__(self, problem: CosineUnknowns, form: PolynomialForm, orders: int) -> None:
        H, N = problem.resolution, problem.model.size
        self.problem, self.orders = problem, orders
        self._coefficients = np.zeros((orders + 1, problem.size))
        states = self._coefficients[:, : problem.states]
        D2, at_zero = problem.second_derivative, problem.at_zero
        self.put, self.right_side, self._kernel = self._put, self._right_side, None
        if kernels():
            self._kernel = TaylorKernel(self._coefficients, D2, at_zero, form.force, form.norm)
            self.put, self.right_side = self._kernel.put, self._kernel.right_side
            return
        self._start = np.zeros((orders + 1, N))  # the state at phase zero, which the normalisation is about
        self._curvature = np.zeros((orders + 1, N * H))
        self._D2, self._at_zero = D2, at_zero
        self._by_site = states.reshape(orders + 1, N, H)
        self._force = SumOfTerms(form.force, states, N, H)
        self._norm = SumOfTerms(form.norm, self._start, 1, 1)
        self._powers = np.zeros((max(self._force.highest, self._norm.highest, 1) + 1, orders + 1))
        self._squared = np.zeros(orders + 1)  # Omega^2

    def _put(self, k: int, z: Array) -> None:
        """Take over order k and complete what depends on it."""
        problem = self.problem
        self._coefficients[k] = z
        Omega, p = self._coefficients[:, problem.Omega_index], self._coefficients[:, problem.parameter_index]
        states = self._by_site[k]
        np.matmul(states, self._D2.T, out=self._curvature[k].reshape(states.shape))
        np.matmul(states, self._at_zero, out=self._start[k])
        self._squared[k] = Omega[: k + 1] @ Omega[k::-1]
        self._powers[0, k] = float(k == 0)
        for power in range(1, self._powers.shape[0]):
            self._powers[power, k] = self._powers[power - 1, : k + 1] @ p[k::-1]
        self._force.order(k, self._powers)
        self._norm.order(k, self._powers)

    def _right_side(self, k: int) -> Array:
        """Right-hand side of order k: minus the equations with no part of order k in z, shape (size,)."""
        problem = self.problem
        self._coefficients[k] = self._start[k] = 0.0
        Omega, p = self._coefficients[:, problem.Omega_index], self._coefficients[:, problem.parameter_index]
        self._squared[k] = Omega[1:k] @ Omega[k - 1 : 0 : -1]
        for power in range(1, self._powers.shape[0]):
            self._powers[power, k] = self._powers[power - 1, : k + 1] @ p[k::-1]
        right = np.zeros(problem.size)
        inertia = self._squared[k:0:-1] @ self._curvature[:k]
        force = self._force.order(k, self._powers)
        right[: problem.states] = (force.ravel() - inertia) / self._squared[0]
        right[problem.states] = -self._norm.order(k, self._powers)[0, 0]
        return right

    def series(self, z: Array, slope: Array, solve: Solve) -> NDArray[np.float64]:
        """Coefficients z_0 = z, z_1 = slope, z_2, ..., shape (orders + 1, size).

        `solve` belongs to the Jacobian at z closed by a row; the higher orders have no component along that row.
        """
        self.put(0, z)
        self.put(1, slope)
        if not self.solve_all(solve):
            for k in range(2, self.orders + 1):
                self.put(k, solve(self.right_side(k)))
        return self._coefficients.copy()

    def solve_all(self, solve: Solve, tail: Callable[[], Structure] | None = None) -> bool:
        """All orders beyond the first two by the compiled kernel; False where it or the solver is not there."""
        compiled = getattr(solve, "compiled", None)
        if self._kernel is None or compiled is None:
            return False
        layout, factors = compiled
        self._kernel.solve_all(layout, factors, None if tail is None else tail())
        return True


# Collocation in odd cosines -------------------------------------------------------------------------------------------


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


class CosineEquations:
    """The equations of a model at the nodes; models that differ in numbers alone may have them in common.

    Arguments:
        harmonics: number of nodes.
        symbols: of positions, velocities, the free parameter, and of numbers where these are symbols.
        force, normalisation: expressions in these.

    Attributes:
        symbols: unknowns z, residual R(z), sparse dR/dz.
        function: (z, numbers) -> (R, dR/dz).
        pattern: rows and columns of the non-zeros of dR/dz, column by column.
        buffers: the function, called with arrays.
        shared: objects that all models with these equations share.
    """

    def __init__(self, harmonics: int, symbols: Sequence[ca.SX], force: ca.SX, normalisation: ca.SX) -> None:
        H, N, states = harmonics, int(symbols[0].numel()), harmonics * int(symbols[0].numel())
        Omega_index, parameter_index = states + Scalar.OMEGA.value, states + Scalar.PARAMETER.value
        at_zero = ((2.0 / H) * cosine_matrix(H)).sum(axis=0)
        q, velocity, parameter, *own = symbols
        slopes = ca.jacobian(force, q), ca.densify(ca.jacobian(force, parameter))
        rhs = ca.Function("rhs", [q, parameter, *own], [ca.densify(force), *slopes])
        norms = [normalisation, ca.densify(ca.jacobian(normalisation, q))]
        start = ca.Function("start", [q, velocity, parameter, *own], norms)

        z, symbol = ca.MX.sym("z", states + 2), ca.MX.sym("numbers", sum(block.numel() for block in own))
        numbers = [symbol] if own else []
        values, Omega, p = ca.reshape(z[:states], H, N), z[Omega_index], z[parameter_index]
        forces, df_dq, df_dp = rhs.map(H)(values.T, *(ca.repmat(value, 1, H) for value in (p, *numbers)))
        forces, df_dp = ca.vec(forces.T), ca.vec(df_dp.T)
        norm, dn_dq = start(values.T @ at_zero, ca.MX.zeros(N), p, *numbers)
        residual = ca.densify(ca.vertcat(ca.vec(_second_derivative(values)) - forces / Omega**2, norm))

        # Second derivatives of one site after the other; and what is added to them: slopes of the force at one node
        # after the other, derivatives by the frequency, by the parameter, and of the normalisation.
        node, every = np.arange(H), np.arange(states, dtype=np.int64)
        rows, columns = (np.array(t, dtype=np.int64) for t in rhs.sparsity_out(1).get_triplet())
        n, i, k = (t.ravel() for t in np.meshgrid(np.arange(N), node, node, indexing="ij"))
        parts = [
            (n * H + i, n * H + k),
            tuple(np.add.outer(node, places * H).ravel() for places in (rows, columns)),
            *((every, np.full(states, place)) for place in (Omega_index, parameter_index)),
            (np.full(states, states), every),
        ]
        varying = [-ca.vec(df_dq.nz[:]) / Omega**2, 2 * forces / Omega**3, -df_dp / Omega**2, ca.DM(at_zero) @ dn_dq]
        keys = np.concatenate([part[1] * (states + 1) + part[0] for part in parts])
        places, slots = np.unique(keys, return_inverse=True)
        constant = np.zeros(places.size)
        constant[slots[: n.size]] = second_derivative_matrix(H)[i, k]
        nonzeros = ca.MX(ca.DM(constant))
        nonzeros[slots[n.size :].tolist()] += ca.vertcat(*(ca.vec(part) for part in varying))
        rows, columns = places % (states + 1), places // (states + 1)
        ends = np.searchsorted(columns, np.arange(states + 3)).tolist()
        jacobian = ca.MX(ca.Sparsity(states + 1, states + 2, ends, rows.tolist()), nonzeros)
        self.symbols, self.shared = (z, residual, jacobian), dict[Any, Any]()
        self.function = ca.Function("equations", [z, symbol], [residual, jacobian])
        self.pattern, self.buffers = (rows, columns), Buffers(self.function)


def _second_derivative(values: ca.MX) -> ca.MX:
    """Second derivatives at the nodes, shape (harmonics, sites).

    Sums over entries of size H^2 are left to what is beyond cos(theta): their rounding would show in Omega.
    """
    H = values.shape[0]
    cosine = ca.DM(cosine_matrix(H)[:, 0])
    amplitude = ca.DM((2.0 / H) * cosine_matrix(H)[0]).T @ values
    return ca.DM(second_derivative_matrix(H)) @ (values - cosine @ amplitude) - cosine @ amplitude


# The problem of a family ------------------------------------------------------------------------------------------

# Operations of a model up to which it is worth while to compare them with those of others.
LONGEST_COMPARED_PROGRAM = 4000
KEPT_RESOLUTIONS = 32  # resolutions of models whose functions are kept
ALIASING_FACTOR = 4.0  # error of a coarser orbit per size of the harmonics that it leaves out: measured


@lru_cache(maxsize=KEPT_RESOLUTIONS)
def _sampling(harmonics: int, theta: bytes) -> Array:
    """Weights of the values at the nodes in those at phases, given as bytes, shape (harmonics, phases)."""
    phases = np.outer(2 * np.arange(harmonics) + 1, np.frombuffer(theta))
    weights = (2.0 / harmonics) * cosine_matrix(harmonics) @ np.cos(phases)
    weights.flags.writeable = False  # kept and shared
    return np.asarray(weights)


@lru_cache(maxsize=8)
def _program(model: OdeModel) -> tuple[Program, Array]:
    """The force and the normalisation of a model, of its state and its parameter, without their numbers, and these."""
    at_rest = ca.substitute(model.normalisation, model.velocity, ca.SX.zeros(model.size))
    results = [ca.densify(model.rhs), ca.densify(at_rest)]
    program, numbers = read(ca.Function("program", [model.state, model.parameters], results))
    return program, np.array(numbers)


@lru_cache(maxsize=8)
def _half_bandwidth(model: OdeModel) -> int:
    """Largest distance of a non-zero of the derivative of a force from the diagonal, at least 1."""
    rows, columns = ca.jacobian_sparsity(model.rhs, model.state).get_triplet()
    return int(np.max(np.abs(np.subtract(rows, columns)), initial=1))


@lru_cache(maxsize=KEPT_RESOLUTIONS)
def _equations_of(program: Program, harmonics: int) -> CosineEquations:
    numbers = sum(code == ca.OP_CONST for code, *_ in program.operations)
    q, p, c = (ca.SX.sym(name, size) for name, size in zip("qpc", (*program.inputs, numbers), strict=True))
    return CosineEquations(harmonics, [q, ca.SX.sym("v", q.numel()), p, c], *program.expressions([q, p], c))


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
        self.cosines = harmonics
        self._sites = model.size
        self.states = self._sites * harmonics
        self._to_coefficients = (2.0 / harmonics) * cosine_matrix(harmonics)
        self.second_derivative, self.at_zero = second_derivative_matrix(harmonics), self._to_coefficients.sum(axis=0)
        self.half_bandwidth = harmonics * _half_bandwidth(model)

    @property
    def size(self) -> int:
        return self.states + 2

    def phases(self) -> Array:
        """Phases theta of the positions among the unknowns."""
        return quarter_phases(self.resolution)

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        return self._own_equations().symbols

    def _own_equations(self) -> CosineEquations:
        model = self.model
        symbols = model.state, model.velocity, model.parameters
        return CosineEquations(self.resolution, symbols, model.rhs, model.normalisation)

    # Functions are shared with models that differ in numbers alone --------------------------------------------------

    @cached_property
    def equations(self) -> CosineEquations:
        """The equations as functions, of z and `numbers`."""
        if not self._shares:
            return self._own_equations()
        return _equations_of(_program(self.model)[0], self.resolution)

    @cached_property
    def _shares(self) -> bool:
        """Whether the program is short enough to be compared."""
        return len(_program(self.model)[0].operations) <= LONGEST_COMPARED_PROGRAM

    @property
    def compiled(self) -> ca.Function:
        return self.equations.function

    @cached_property
    def numbers(self) -> Array:
        return _program(self.model)[1] if self._shares else self.constants

    @property
    def shared(self) -> dict[Any, Any]:
        return self.equations.shared

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        return self.equations.pattern

    @property
    def _buffers(self) -> Buffers:
        return self.equations.buffers

    def evaluate_all(self, z: Array) -> tuple[Array, Array]:
        found = np.empty((len(z), self.size - 1)), np.empty((len(z), self.pattern[0].size))
        for k, one in enumerate(z):
            found[0][k], found[1][k] = self._values(one, self.numbers)
        return found

    def recursion(self, form: PolynomialForm, orders: int) -> Recursion:
        """Power series of branches."""
        return TaylorRecursion(self, form, orders)

    def resolution_in_words(self) -> str:
        return f"{self.resolution} odd cosines"

    def of_shorter_period(self, z: Array, turns: int) -> Array:
        return self.sample(z, self.phases() / turns).T.ravel()

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
        return z[: self.states].reshape(self._sites, self.resolution) @ self._to_coefficients

    def all_prolonged(self, z: Array, finer: Problem) -> Array:
        # One product a state, as in `samples`.
        H, found = self.resolution, np.empty((len(z), finer.size))
        values = z[:, : self.states].reshape(len(z), self._sites, H) @ prolongation_matrix(H, finer.resolution)
        found[:, : finer.states], found[:, finer.states :] = values.reshape(len(z), -1), z[:, self.states :]
        return found

    def rounding(self, z: Array) -> float:
        return float(self.roundings(z[None])[0])

    def roundings(self, z: Array) -> Array:
        beyond = z.copy()
        values = beyond[:, : self.states].reshape(len(z), self._sites, self.resolution)
        amplitudes = np.einsum("ijk,k->ij", values, self._to_coefficients[0])
        values -= amplitudes[:, :, None] * cosine_matrix(self.resolution)[0]
        products = np.abs(self.evaluate_all(beyond)[1] * np.take(beyond, self.pattern[1], axis=1))
        return np.asarray(EPSILON * (products.max(axis=1) + np.abs(z[:, : self.states]).max(axis=1)))

    @property
    def round_off(self) -> float:
        return EPSILON * (10.0 + 0.2 * self.resolution)

    def expected_error(self, z: Array, error: float, other: Problem) -> float:
        lost = np.sum(np.abs(self.coefficients(z)[:, other.resolution :]), axis=1)
        sizes = np.max(np.abs(z[: self.states].reshape(self._sites, -1)), axis=1)
        ratio = np.max(lost) / np.max(sizes)
        if self.model.output_scale is not None:
            scale = np.array(self.model.output_scale)
            ratio = max(ratio, np.max(scale * lost) / np.max(scale * sizes))
        return error + ALIASING_FACTOR * float(ratio)

    def samples(self, z: Array, theta: Array) -> Array:
        # One product an orbit: the last bit of a larger one depends on how many there are.
        values = z[:, : self.states].reshape(len(z), self._sites, self.resolution)
        return np.asarray((values @ _sampling(self.resolution, theta.tobytes())).swapaxes(1, 2))
