"""Equations with one unknown more: the interface of every transcription to correctors and continuations."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from enum import Enum
from functools import cached_property, lru_cache
from typing import Any, Protocol, Self, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.ode import OdeModel
from casadi_skin.native.places import Buffers as Buffers

Array = NDArray[np.float64]
Indices = NDArray[np.signedinteger[Any]]  # of eight bytes, or of four where there are very many

Other = TypeVar("Other", bound="Problem")

EPSILON = float(np.finfo(float).eps)
NULL_RTOL = (
    1e-14  # of a null vector: what factors of a Jacobian nearby may leave of it; folds are where its rate is zero
)
SLOWEST_STEP = 0.3  # of a step towards it with these: a next one that is longer needs new factors


class SingularError(ArithmeticError):
    """Linear equations cannot be solved to any useful accuracy."""


class Solve(Protocol):
    """The solution of linear equations from their right-hand side."""

    def __call__(self, b: Array, /) -> Array: ...

    @property
    def orientation(self) -> float:
        """The sign of the determinant of their matrix."""
        ...


class Scalar(Enum):
    """The two unknowns beside the state values, by their place after these."""

    OMEGA = 0
    PARAMETER = 1


@lru_cache(maxsize=8)
def _probe(count: int) -> Array:
    return np.asarray(np.cos(np.arange(count) ** 2 % 6.25))


def sparse_matrix(shape: tuple[int, int], rows: Indices, columns: Indices, values: ca.MX) -> ca.MX:
    """Sparse CasADi matrix from triplets without duplicates; `values` in the order of `rows` and `columns`."""
    order = np.lexsort((rows, columns))
    colind = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=shape[1]))])
    sparsity = ca.Sparsity(shape[0], shape[1], colind.tolist(), rows[order].tolist())
    return ca.MX(sparsity, values[order.tolist()])


class Problem(ABC):
    """Unknowns z = (state values, scalars), one more than equations R(z) = 0, and the sparse dR/dz.

    State values come first in z; `size` counts unknowns, `size - 1` equations. One of the scalars is the free
    parameter that a walk follows. `constants` are numbers in the equations, such as interval lengths, that may change
    without anything being built again.
    """

    resolution: int
    states: int  # number of state values in z
    half_bandwidth: int | None = None  # of dR/d(state values), when rows and columns are ordered to make it small
    measured_by_defect: bool = False  # whether errors along branches are those of `improvement`
    in_order: bool = False  # whether unknowns and equations come in an order of `elimination_order`
    keeps_factors: bool = False  # whether those of one Newton step serve the next, as equations cost far less
    cosines: int = 0  # number of odd cosines by whose values at nodes the state is known; 0 in other transcriptions
    noise: float = 0.0  # error of residuals beyond rounding, as of an integrator, relative to the state
    holds_linear_modes: bool = False  # exactly, at every resolution
    may_move: bool = False  # whether the mesh may move with the layers of solutions along a branch
    output_scale: Array | None = None  # factors from state values to those that users see
    constants: Array = np.zeros(0)

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """Symbols z, residual R(z), sparse Jacobian dR/dz assembled from its structure; see `constants_symbol`."""
        raise NotImplementedError("these equations are no expressions of CasADi: `evaluate` assembles them")

    # Of a method of one solution and that of several a transcription states one: each is the other's by default.

    def prolong(self, z: Array, finer: Self) -> Array:
        """The same solution in the unknowns of another resolution of the same transcription."""
        return np.asarray(self.all_prolonged(z[None], finer)[0])

    def all_prolonged(self, z: Array, finer: Self) -> Array:
        """The same of several solutions, shape (states, size)."""
        return np.stack([self.prolong(one, finer) for one in z])

    def profile_change(self, z: Array, step: Array, between: Array | None = None) -> float:
        """Change of the state in a step from z, relative to its size; with what it misses `between` as well."""
        return float(self.profile_changes(z[None], step[None])[0])

    def missed_between(self, residual: Array) -> Array | None:
        """What a state misses between its unknowns, by the residual; None where that is no more than at these."""
        return None

    def profile_changes(self, z: Array, steps: Array) -> Array:
        """The same of several states (states, size) in a step each."""
        return np.array([self.profile_change(*one) for one in zip(z, steps, strict=True)])

    def row_of(self, held: Scalar) -> Array:
        """Row that holds Omega or the free parameter, shape (size,)."""
        row = np.zeros(self.size)
        row[self.index_of(held)] = 1.0
        return row

    def parameter_row(self) -> Array:
        """Row that holds the free parameter, shape (size,)."""
        return self.row_of(Scalar.PARAMETER)

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of unknowns."""

    @property
    def own_tangent(self) -> Array | None:
        """The tangent of every branch where the free parameter is in no equation; None where it is in some."""
        return None

    def unknown_at(self, scalar: Scalar, value: float) -> float:
        """The unknown that stands for Omega or the free parameter, where that has this value."""
        return value

    def index_of(self, scalar: Scalar) -> int:
        """Place of Omega or the free parameter among the unknowns."""
        return self.states + scalar.value

    @cached_property
    def Omega_index(self) -> int:
        """Place of Omega among the unknowns."""
        return self.index_of(Scalar.OMEGA)

    def sample(self, z: Array, theta: Array) -> Array:
        """States (positions, in a family of second order) at places of the solution, shape (len(theta), components).

        Places are phases Omega t of an orbit, or the independent variable.
        """
        return np.asarray(self.samples(z[None], theta)[0])

    def samples(self, z: Array, theta: Array) -> Array:
        """The same of several solutions (any, size), shape (any, len(theta), components)."""
        return np.stack([self.sample(one, theta) for one in z])

    @abstractmethod
    def frequency(self, z: Array) -> float:
        """Omega of z; 1 where there is none."""

    @abstractmethod
    def frequency_step(self, z: Array, step: Array) -> float:
        """Change of Omega in a small step from z; where there is none, the largest relative change of a scalar."""

    @cached_property
    def parameter_index(self) -> int:
        """Place of the free parameter among the unknowns."""
        return self.index_of(Scalar.PARAMETER)

    def parameter_size(self, z: Array) -> float:
        """Scale of small changes of the free parameter."""
        return abs(float(z[self.parameter_index]))

    @cached_property
    def symbols(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """z, R(z) and dR/dz as CasADi expressions."""
        return self._equations()

    @cached_property
    def constants_symbol(self) -> ca.MX:
        """Symbol of `constants`, shape (constants, 1)."""
        return ca.MX.sym("constants", self.constants.size)

    @cached_property
    def function(self) -> ca.Function:
        """CasADi Function (z, constants) -> (R, dR/dz)."""
        z, residual, jacobian = self.symbols
        arguments = [z, self.constants_symbol]
        return ca.Function("equations", arguments, [ca.densify(residual), jacobian], ["z", "constants"], ["R", "dR_dz"])

    @property
    def compiled(self) -> ca.Function:
        """The function that is evaluated, of z and `numbers`; problems that differ in these may have it in common."""
        return self.function

    @property
    def numbers(self) -> Array:
        """The second argument of `compiled`."""
        return self.constants

    @cached_property
    def pattern(self) -> tuple[Indices, Indices]:
        """Rows and columns of the non-zeros of dR/dz, in the order in which `evaluate` returns them."""
        rows, columns = self.compiled.sparsity_out(1).get_triplet()
        return np.array(rows, dtype=np.int64), np.array(columns, dtype=np.int64)

    @cached_property
    def _buffers(self) -> Buffers:
        return Buffers(self.compiled)

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Residual, shape (size - 1,), and the non-zeros of the Jacobian in the order of `pattern`."""
        residual, nonzeros = self._values(z, self.numbers)
        return residual.copy(), nonzeros.copy()

    def applied(self, z: Array, step: Array) -> Array:
        """The Jacobian at z times a step, shape (size - 1,)."""
        return self.times(self.evaluate(z)[1], step)

    def times(self, nonzeros: Array, step: Array) -> Array:
        """A matrix of the pattern of the Jacobian times a step."""
        rows, columns = self.pattern
        return np.asarray(np.bincount(rows, nonzeros * step[columns], self.size - 1), dtype=float)

    def null_vector(self, z: Array, solve: Solve, weights: Array) -> tuple[Array, bool]:
        """What the Jacobian at z maps to zero and the row that closed `solve` to 1; whether its last step was small.

        Factors of unknowns `in_order` may be of a Jacobian near z: what they leave is made up for step by step.
        """
        right = np.zeros(self.size)
        right[-1] = 1.0
        t = solve(right)
        size = before = float(np.sqrt(weights @ t**2))
        right[-1] = 0.0
        while self.in_order:
            right[:-1] = self.applied(z, t)
            change = solve(right)
            t, off = t - change, float(np.sqrt(weights @ change**2))
            if off**2 <= NULL_RTOL * before * size:
                break
            if not off <= SLOWEST_STEP * before:
                return t, False
            before = off
        return t, True

    def evaluate_all(self, z: Array) -> tuple[Array, Array]:
        """The same at several states (states, size): shapes (states, size - 1) and (states, non-zeros)."""
        residuals, nonzeros = zip(*(self.evaluate(one) for one in z), strict=True)
        return np.stack(residuals), np.stack(nonzeros)

    def evaluated(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        """As `evaluate_all` at other `numbers`; not a number where the model cannot be evaluated."""
        found = np.full((len(z), self.size - 1), np.nan), np.full((len(z), self.pattern[0].size), np.nan)
        for k, one in enumerate(z):
            with suppress(ArithmeticError, RuntimeError):
                found[0][k], found[1][k] = self._values(one, numbers)
        return found

    def _values(self, z: Array, numbers: Array) -> Sequence[Array]:
        """Residual and non-zeros of the Jacobian at one state, which the next call may overwrite."""
        return self._buffers(z, numbers)

    def with_constants(self, constants: Array) -> Self:
        """The same equations with other constants; the compiled function is shared.

        Raises ValueError where their number differs.
        """
        self.check_constants(constants)
        if not constants.size:
            return self
        _ = self.symbols, self.pattern, self._buffers, self.shared  # kept by the copy as well
        other = copy.copy(self)
        other.constants = constants
        return other

    def check_constants(self, constants: Array) -> None:
        """Raises ValueError for another number of constants than there are."""
        if constants.shape != self.constants.shape:
            raise ValueError(f"constants: given {constants.size}; accepted: {self.constants.size} of them")

    @property
    def shared(self) -> dict[Any, Any]:
        """Objects by name that all problems share which differ from this one in their constants only."""
        return self._shared

    @cached_property
    def _shared(self) -> dict[Any, Any]:
        return {}

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        """Objects made from the pattern of the equations alone; nobody who uses them changes them."""
        return make()

    @property
    def elimination_order(self) -> Indices:
        """An order of the unknowns in which factors of the Jacobian are sparse, where they are `in_order`."""
        return np.arange(self.size)

    def speed_ratio(self, z: Array) -> float:
        """The largest speed of a solution, of its mean: what it has layers by; 0 where they do not matter."""
        return 0.0

    # Adaptation: where the unknowns of a transcription should lie ------------------------------------

    def transferred(self, other: Other) -> Other:
        """The problem `other`, of another resolution, with its unknowns placed as they are here."""
        return other

    def placed(self, z: Array, other: Other) -> Other:
        """The problem `other`, of any resolution, with its unknowns placed where the solution z needs them."""
        return other

    def imbalance(self, z: Array) -> float:
        """Imbalance of the difficulty of z over the unknowns, as largest over mean; 1 is best."""
        return 1.0

    def expected_error(self, z: Array, error: float, other: Problem) -> float:
        """Relative error to expect of the solution z on `other`, no finer, once placed for z; from its `error` here."""
        return np.inf

    def improvement(self, z: Array, solve: Solve) -> tuple[Array, Array | None] | None:
        """A step to a better solution in the same unknowns, and what the solution misses between these.

        None where this discretisation has no such step of its own; `solve` has the factors of a closed Jacobian near z.
        """
        return None

    def resolution_in_words(self) -> str:
        """The resolution, in words."""
        return f"resolution {self.resolution}"

    def by_itself(self, z: Array) -> tuple[Problem, Array]:
        """The equations of unknown sites alone where others are eliminated, and z in their unknowns."""
        return self, z

    def eliminated(self, z: Array) -> tuple[Array, slice, int]:
        """The contribution of eliminated sites to the derivative by states: a block, its place, and a number.

        It is the number of positive eigenvalues of the eliminated equations, up to one that is the same for all z.
        """
        return np.zeros((0, 0)), slice(0), 0

    @property
    def probe(self) -> Array:
        """Residuals of size 1 in general position, shape (size - 1,), which are not to be written to."""
        return _probe(self.size - 1)

    def sizes_at(self, z: Array) -> tuple[Array | None, float]:
        """Sizes of the unknowns at z, and the least of residuals of conditions; None where all are 1."""
        return None, 1.0

    def units_at(self, z: Array, nonzeros: Array) -> tuple[Array | float, Array | float]:
        """What unknowns at z and residuals are measured by, of each one or of all, with the Jacobian's non-zeros."""
        return 1.0, 1.0

    def rounding(self, z: Array) -> float:
        """Size of the rounding errors in the residuals at z."""
        _, columns = self.pattern
        return EPSILON * float(np.max(np.abs(self.evaluate(z)[1] * z[columns])))

    def roundings(self, z: Array) -> Array:
        """The same at several states (states, size)."""
        return np.array([self.rounding(one) for one in z])

    @property
    def round_off(self) -> float:
        """Relative error of Omega and of the profile left where the equations are solved but for rounding; measured."""
        return 10.0 * EPSILON

    def place(self, equation: int) -> str:
        """Place of an equation, counted from 0, in words; transcriptions describe it in more detail."""
        return f"equation {equation + 1} of {self.size - 1}"

    def _place(self, equation: int, z: Array) -> str:
        """The same at z."""
        return self.place(equation)

    def describe_parameters(self, z: Array) -> str:
        """Which solution z is, in words."""
        return f"Omega = {self.frequency(z):.10g}, parameter = {z[self.parameter_index]:.10g}"

    def describe_largest_residual(self, z: Array) -> str:
        """The largest residual at z and where it is, in words."""
        try:
            residual = np.abs(self.evaluate(z)[0])
        except ArithmeticError as error:
            return str(error)
        equation = int(np.argmax(np.where(np.isfinite(residual), residual, np.inf)))
        if residual[equation] == 0.0:
            return self.describe_parameters(z)
        size = f"largest residual {residual[equation]:.1e}" if np.isfinite(residual[equation]) else "not finite"
        return f"{size} at {self._place(equation, z)}, {self.describe_parameters(z)}"

    def relative_residual(self, z: Array) -> float:
        """Largest residual of the equations relative to their largest term."""
        residual, nonzeros = self.evaluate(z)
        _, columns = self.pattern
        inside = columns < self.states
        largest = np.max(np.abs(nonzeros[inside] * z[columns[inside]]), initial=1.0)
        return float(np.max(np.abs(residual)) / largest)

    def metric(self, z: Array, parameter_scale: float) -> Array:
        """Diagonal of the relative metric at z in which walks measure lengths, shape (size,)."""
        return np.asarray(self.metrics(z[None], parameter_scale)[0])

    def metrics(self, z: Array, parameter_scale: float) -> Array:
        """The same at several states, shape (states, size)."""
        return np.stack([self.metric(one, parameter_scale) for one in z])


# A periodic orbit as equations with one unknown more: properties that only transcriptions of orbits have --------------

FREQUENCY_WEIGHT = 20.0  # a relative change of 5 per cent in Omega counts as much as a wholly new profile


class OrbitProblem(Problem):
    """Unknowns z = (state values, Omega, parameter, ...) of an orbit of a family.

    The one free parameter is that of the model; the last equation is the model's normalisation.
    """

    model: OdeModel
    symmetry: SymmetryClass

    @abstractmethod
    def pack(self, positions: Array, Omega: float, parameter: float) -> Array:
        """Unknowns of the orbit with q(theta) = positions cos(theta), shape (size,)."""

    @abstractmethod
    def phases(self) -> Array:
        """Phases theta of the states among the unknowns, in their order."""

    @abstractmethod
    def of_shorter_period(self, z: Array, turns: int) -> Array:
        """A guess of the state values of the orbit that z runs through `turns` times, shape (states,)."""

    @abstractmethod
    def _spread(self, factors: Array) -> Array:
        """Factors of the model's state components, shape (model.size,), for all state values in z, shape (states,)."""

    @cached_property
    def output_scale(self) -> Array | None:  # type: ignore[override]
        """Factors from the state values to those that users see, shape (states,); None where these are the same."""
        factors = self.model.output_scale
        return None if factors is None or len(set(factors)) == 1 else self._spread(np.array(factors))

    @property
    def measures(self) -> tuple[Array | float, ...]:
        """Factors of state values with which errors are relative to the largest of these: 1, and the output scale."""
        return (1.0,) if self.output_scale is None else (1.0, np.abs(self.output_scale))

    def profile_changes(self, z: Array, steps: Array) -> Array:
        """Largest changes of state values relative to the largest state value, by each of the measures."""
        moves, states = np.abs(steps[:, : self.states]), np.abs(z[:, : self.states])
        return np.asarray(np.max([(m * moves).max(axis=1) / (m * states).max(axis=1) for m in self.measures], axis=0))

    def frequency(self, z: Array) -> float:
        return float(z[self.Omega_index])

    def frequency_step(self, z: Array, step: Array) -> float:
        return float(step[self.Omega_index])

    def place(self, equation: int) -> str:
        return "the normalisation" if equation == self.size - 2 else super().place(equation)

    def metrics(self, z: Array, parameter_scale: float) -> Array:
        """Diagonals of |dq|^2/|q|^2 + (20 dOmega/Omega)^2 + (dp/scale)^2 at states, shape (states, size)."""
        weights, states = np.empty(z.shape), z[:, : self.states]
        weights[:] = 1.0 / np.einsum("ij,ij->i", states, states)[:, None]
        weights[:, self.Omega_index] = (FREQUENCY_WEIGHT / z[:, self.Omega_index]) ** 2
        weights[:, self.parameter_index] = 1.0 / parameter_scale**2
        return weights
