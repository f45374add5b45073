"""Collocation of a boundary-value problem on the intervals of a mesh.

On each of K intervals the solution is a polynomial of degree d that satisfies the equations at d stages, written as the
equivalent implicit Runge-Kutta method (Hairer, Lubich and Wanner 2006, section II.1): the ends of the intervals
converge with the order of the method, the rest with order d + 1. The lengths of the intervals are constants of the
compiled equations, so that the mesh may follow the solution.

Orbits of a family in full states: the unfolded field, their conditions, and collocation of any first-order model.

x' = T f(x, p) + T damping D(x) on a quarter, half or full period of length T = part 2 pi/Omega, from one fixed set of
the reversal to the other, or closed; see `FirstOrderProblem` for the order of the unknowns.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any, Self

import casadi as ca
import numpy as np

from casadi_skin.model.conserved import SymmetryClass, pinned_components, unfolded_phases
from casadi_skin.model.ode import OdeModel
from casadi_skin.native import Structure, kernels
from casadi_skin.native.collocation import INTERVALS
from casadi_skin.zero import mesh
from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.discretisation import Discretisation, Formulation
from casadi_skin.zero.problem import (
    NULL_RTOL,
    SLOWEST_STEP,
    Array,
    Indices,
    OrbitProblem,
    Other,
    Problem,
    Solve,
    sparse_matrix,
)

NO_VALUES: Array = np.zeros(0)
FEW_PLACES = 2_000  # places whose weights are kept for the next solution on the same mesh
MESH_NOISE = 4.0 * float(np.finfo(float).eps)  # of a state value, relative to the largest


class CollocationEquations(Problem):
    """Equations of K intervals with d stages; unknowns ordered in time, x_0, X_11 .. X_1d, x_1, ..., x_K, then scalars.

    `constants` are the lengths of the intervals relative to their sum, `values` those of the formulation's constants.
    """

    formulation: Formulation
    table: CollocationTable
    values: Array
    in_order = keeps_factors = True
    mesh: mesh.Mesh
    _placing: tuple[bytes, Array] | None = None

    def _discretise(
        self, formulation: Formulation, intervals: int, table: CollocationTable, values: Array = NO_VALUES
    ) -> None:
        """Set the parts of the equations."""
        self.formulation, self.table, self.resolution, self.values = formulation, table, intervals, values
        self.degree = table.degree
        self.columns = intervals * table.ends.size + 1
        self.states = formulation.states * self.columns
        self._size = self.states + int(formulation.scalars.numel())
        self.mesh = mesh.Mesh(mesh.uniform(intervals), table.ends)

    @property
    def constants(self) -> Array:  # type: ignore[override]
        return self.mesh.lengths

    @property
    def size(self) -> int:
        return self._size

    @property
    def equations(self) -> int:
        """Number of equations; one less than unknowns but where something is minimised, and there are fewer."""
        collocation = self.states - self.formulation.states
        return collocation + int(self.formulation.conditions.numel()) + self.formulation.integrals

    # Equations ------------------------------------------------------------------------------------------------------

    @cached_property
    def discretisation(self) -> Discretisation:
        """The equations on this number of intervals, shared by all problems of the formulation that have it."""
        key, known = (self.resolution, self.table), self.formulation.discretisations
        if key not in known:
            known[key] = Discretisation(self.formulation, self.resolution, self.table)
        found: Discretisation = known[key]
        return found

    @property
    def shared(self) -> dict[Any, Any]:
        return self.discretisation.shared

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        return self.discretisation.rows, self.discretisation.columns

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        return self.discretisation(z, self.numbers)

    def _values(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        return self.discretisation(z, numbers)

    def times(self, nonzeros: Array, step: Array) -> Array:
        return self.discretisation.times(nonzeros, step)

    def null_vector(self, z: Array, solve: Solve, weights: Array) -> tuple[Array, bool]:
        compiled = getattr(solve, "compiled", None)
        if compiled is None or not kernels():
            return super().null_vector(z, solve, weights)
        nonzeros, t, limits = self.evaluate(z)[1], np.empty(self.size), (NULL_RTOL, SLOWEST_STEP)
        data = self.discretisation.compiled, *compiled, nonzeros, weights, *limits
        return t, not kernels()["collocation_null_vector"](*data, t, np.empty(self.size))

    compiled_units: Structure | None = None  # of the unknowns, as kernels take them; all are 1 without

    @cached_property
    def numbers(self) -> Array:
        return np.concatenate([self.constants, self.values]) if self.values.size else self.constants

    def repeated(self, z: Array, count: int) -> tuple[Array, Array]:
        """Scalars of z and values of the constants as columns for `count` places."""
        scalars, values = z[self.states :, None], self.values[:, None]
        return np.tile(scalars, count), np.tile(values, count)

    def with_constants(self, constants: Array) -> Self:
        """The same equations on intervals of other lengths; nothing is built again.

        Raises ValueError where their number differs.
        """
        self.check_constants(constants)
        _ = self.discretisation
        other = copy.copy(self)
        other.mesh = mesh.Mesh(constants, self.table.ends)
        other.__dict__.pop("numbers", None)
        return other

    def kept(self, name: str, make: Callable[[], Any]) -> Any:
        return self.discretisation.structure.kept(name, make)

    @property
    def elimination_order(self) -> Indices:
        n, inner = self.formulation.states, self.table.ends.size - 1  # columns between two ends of intervals
        columns = np.arange(self.resolution)[:, None] * (inner + 1) + 1 + np.arange(inner)
        between = columns[:, None, :] * n + self.formulation.component_order[:, None]
        ends = np.arange(self.resolution + 1)[:, None] * (inner + 1) * n + np.arange(n)
        return np.concatenate([between.ravel(), ends.ravel(), np.arange(self.states, self.size)])

    @property
    def stages(self) -> Indices:
        """Columns of the state values that are stages, in the order of time."""
        return self.discretisation.structure.stage[:-1]

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        """As `Discretisation` has them in numbers: increments less their integrals, conditions, integrals."""
        n, K, d, rows = self.formulation.states, self.resolution, self.degree, self.table.ends.size
        m, extended, structure = self.size - self.states, self.table.extended, self.discretisation.structure
        z, lengths = ca.MX.sym("z", self.size), self.constants_symbol
        values, scalars, constants = ca.reshape(z[: self.states], n, self.columns), z[self.states :], ca.DM(self.values)
        along = [self.places, values[:, self.stages.tolist()], *(ca.repmat(v, 1, K * d) for v in (scalars, constants))]
        field, by_states, by_scalars = self.formulation.at_stages(*along)
        weights = ca.kron(ca.diag(lengths), ca.DM(extended.T))  # stages by increments, each interval by its length
        starts = np.repeat(structure.start, rows).tolist()
        conditions = self.formulation.condition_function(values[:, 0], values[:, -1], scalars, constants)
        residual = [ca.vec(values[:, 1:] - values[:, starts] - field @ weights), conditions[0]]
        k, i, j = (index.ravel() for index in np.indices((K, rows, d)))
        entries = ca.reshape(by_states.nz[:], -1, K * d)[:, (k * d + j).tolist()]
        scales = (lengths[k.tolist()] * ca.DM(extended[i, j])).T
        stiff = ca.DM(structure.differences[structure.stiff]) - ca.vec(entries * ca.repmat(scales, entries.size1(), 1))
        rest = [-ca.vec(ca.reshape(by_scalars, m * n, K * d) @ weights), *(part.nz[:] for part in conditions[1:])]
        if self.formulation.integrals:
            e, by_x, by_s = self.formulation.integrand_function.map(K * d)(*along)
            quadrature = ca.vec(ca.kron(lengths, ca.DM(extended[-1])))
            residual.append(e @ quadrature)
            per_stage = ca.reshape(by_x, e.size1() * n, K * d)
            rest += [ca.vec(per_stage * ca.repmat(quadrature.T, e.size1() * n, 1))]
            rest += [ca.reshape(by_s, e.size1() * m, K * d) @ quadrature]
        parts = [ca.DM(structure.differences), stiff, *(ca.vec(part) for part in rest if part.numel())]
        taken = np.arange(structure.rows.size)
        for slots, first in ((structure.stiff, taken.size), (structure.rest, taken.size + structure.stiff.size)):
            taken[slots] = first + np.arange(slots.size)
        nonzeros = ca.vertcat(*parts)[taken.tolist()]
        shape = self.equations, self.size
        return z, ca.vertcat(*residual), sparse_matrix(shape, structure.rows, structure.columns, nonzeros)

    def resolution_in_words(self) -> str:
        return f"{self.resolution} intervals, polynomials of degree {self.degree}"

    @property
    def places(self) -> ca.MX:
        """Places of the stages in [0, 1], shape (1, K d)."""
        lengths = self.constants_symbol
        starts = ca.cumsum(lengths) - lengths
        return ca.vec(ca.repmat(starts.T, self.degree, 1) + ca.DM(self.table.nodes) @ lengths.T).T

    # Values ---------------------------------------------------------------------------------------------------------

    def _fractions(self) -> Array:
        """Places of the columns of state values in [0, 1], shape (columns,)."""
        return self.mesh.places

    def _interpolate(self, z: Array, fractions: Array) -> Array:
        """States at fractions of the interval, shape (len(fractions), components)."""
        found = np.empty((fractions.size, self.formulation.states))
        self._interpolate_all(z[None], fractions, found[None])
        return found

    def weights_at(self, fraction: float) -> tuple[Indices, Array]:
        """Columns of state values, and their weights in the state at a fraction of the interval."""
        at = np.array([fraction]).tobytes()
        columns, weights = _weights.__wrapped__(self.constants.tobytes(), self.table.ends.tobytes(), at)
        return columns[0], weights[0]

    def _interpolate_all(self, z: Array, fractions: Array, found: Array) -> None:
        """Several solutions (any, size) likewise, to the first numbers of each of the arrays `found`."""
        count = self.formulation.states * fractions.size
        if kernels():
            z, apart = np.ascontiguousarray(z), found.size // len(z)
            data = self.mesh.edges, len(z), z, z.shape[1], fractions.size, np.ascontiguousarray(fractions), found, apart
            kernels()["collocation_interpolated"](self._intervals, *data)
            return
        weights_at = _weights if fractions.size <= FEW_PLACES else _weights.__wrapped__
        columns, weights = weights_at(*(array.tobytes() for array in (self.constants, self.table.ends, fractions)))
        for one, to in zip(z, found.reshape(len(z), -1), strict=True):
            values = one[: self.states].reshape(self.columns, self.formulation.states)
            to[:count] = np.einsum("tk,tkn->tn", weights, values[columns]).ravel()

    @cached_property
    def _intervals(self) -> Structure:
        """The polynomials on the intervals, as kernels take them."""
        return _intervals(self.formulation.states, self.resolution, self.table)

    @property
    def polynomials(self) -> tuple[Structure, Array]:
        """The same with the edges of the intervals."""
        return self._intervals, self.mesh.edges

    def all_prolonged(self, z: Array, finer: Self) -> Array:
        if self.is_placed_as(finer):
            return z
        found = np.empty((len(z), finer.states + z.shape[1] - self.states))  # `finer` may have other scalars
        self._interpolate_all(z, finer.mesh.places, found)
        found[:, finer.states :] = z[:, self.states :]
        return found

    def prolong(self, z: Array, finer: Self) -> Array:
        return z if self.is_placed_as(finer) else np.asarray(self.all_prolonged(z[None], finer)[0])

    def is_placed_as(self, other: CollocationEquations) -> bool:
        """Whether unknowns of both are values at the same places."""
        return self.table is other.table and (self.mesh is other.mesh or self.mesh.key == other.mesh.key)

    def left_by(self, finer: CollocationEquations) -> float:
        """The part of the error at ends of intervals that a finer mesh leaves: it falls faster there."""
        return float((self.resolution / finer.resolution) ** self.table.order)

    # The mesh -------------------------------------------------------------------------------------------------------

    def _component_sizes(self, z: Array) -> Array:
        """Scales of the changes of each component of the states, shape (components,)."""
        return np.full(self.formulation.states, float(np.max(np.abs(z[: self.states]))))

    def _density(self, z: Array) -> Array:
        """Wanted density of intervals for the solution z, see `mesh.density`; the last one is kept."""
        at = z.tobytes() + self.constants.tobytes()
        if self._placing is None or self._placing[0] != at:
            self._placing = at, self._wanted(z)
        return self._placing[1]

    def _wanted(self, z: Array) -> Array:
        K, d, rows = self.resolution, self.degree, self.table.ends.size
        values = z[: self.states].reshape(self.columns, self.formulation.states)
        sizes, weights = self._component_sizes(z), _leading(self.table)
        noise = MESH_NOISE * float(np.abs(weights).sum())
        if kernels():
            wanted, limits = np.empty(K), (mesh.DENSITY_FLOOR, mesh.NEIGHBOUR_LENGTH_RATIO)
            data = self._intervals, self.constants, self.mesh.edges, values, sizes, noise, *limits
            kernels()["collocation_density"](*data, wanted, np.empty(3 * K))
            return wanted
        columns = np.arange(K)[:, None] * rows + np.arange(d + 1)
        return mesh.density(self.constants, np.einsum("j,kjn->kn", weights, (values / sizes)[columns]), d, noise)

    def transferred(self, other: Other) -> Other:
        return other.with_constants(mesh.resampled(self.constants, other.resolution))

    def placed(self, z: Array, other: Other) -> Other:
        return other.with_constants(mesh.equidistributed(self.constants, self._density(z), other.resolution))

    def imbalance(self, z: Array) -> float:
        return mesh.imbalance(self.constants, self._density(z))

    def expected_error(self, z: Array, error: float, other: Problem) -> float:
        parts = self.constants * self._density(z)
        growth = float(parts.sum() / parts.max()) / other.resolution
        return error * growth ** (self.degree + 1)


@lru_cache(maxsize=64)
def _intervals(states: int, intervals: int, table: CollocationTable) -> Structure:
    """Polynomials on intervals, as kernels take them."""
    support = np.append(0.0, table.ends)
    return Structure(
        INTERVALS, states, intervals, table.ends.size, table.degree, support, _barycentric(support), _leading(table)
    )


@lru_cache(maxsize=32)
def _weights(lengths: bytes, ends: bytes, fractions: bytes) -> tuple[Indices, Array]:
    """Columns of state values, and their weights in the states at fractions of the interval, one row for each."""
    h, support, places = np.frombuffer(lengths), np.append(0.0, np.frombuffer(ends)), np.frombuffer(fractions)
    starts = mesh.edges(h)
    interval = np.clip(np.searchsorted(starts, places, side="right") - 1, 0, h.size - 1)
    offset = ((places - starts[interval]) / h[interval])[:, None] - support
    hit = np.abs(offset) < 1e-14
    offset[hit] = 1.0
    weights = _barycentric(support) / offset
    weights[hit.any(axis=1)] = 0.0
    weights[hit] = 1.0
    weights /= weights.sum(axis=1, keepdims=True)
    return interval[:, None] * (support.size - 1) + np.arange(support.size), weights


@lru_cache(maxsize=8)
def _leading(table: CollocationTable) -> Array:
    """Weights of the values that determine the polynomial in its leading coefficient."""
    return _barycentric(table.support)


def _barycentric(support: Array) -> Array:
    """Weights of the values at `support` in the leading coefficient of the polynomial through them."""
    gaps = support[:, None] - support
    np.fill_diagonal(gaps, 1.0)
    return np.asarray(1.0 / np.prod(gaps, axis=1))


# Orbits of a family in full states ------------------------------------------------------------------------------------

PHASE_DIFFERENCE_STEP = 1e-5  # of a phase, for velocities


def damping_direction(model: OdeModel) -> ca.SX:
    """Where the unfolding damping acts: along the velocities, or along the gradient of the conserved quantity."""
    if model.velocity is not None:
        return ca.vertcat(ca.SX.zeros(model.size), model.velocity)
    if model.hamiltonian is not None:
        return ca.gradient(model.hamiltonian, model.full_state)
    return ca.SX(model.full_size, 1)  # of no use: only the full period unfolds


def orbit_formulation(
    model: OdeModel, symmetry: SymmetryClass, pinned: tuple[list[int], list[int]], unfolded: bool
) -> Formulation:
    """The part of a period that the symmetry leaves unknown, with scalars (Omega, parameter, damping if unfolded).

    The components `pinned` vanish at the start and at the end; an unfolded orbit closes, and its phase is where the
    normalisation is stationary along the flow.
    """
    Omega, damping = ca.SX.sym("Omega"), ca.SX.sym("damping", int(unfolded))
    field = model.full_rhs
    if unfolded:
        field = field + damping * damping_direction(model)
    duration = symmetry.value * 2.0 * np.pi / Omega
    x, p, end = model.full_state, model.parameters, ca.SX.sym("end", model.full_size)
    first, last = pinned
    closed = end - x if unfolded else ca.SX(0, 1)
    rows = ca.vertcat(x[first], end[last], closed, model.normalisation)
    if unfolded:
        rows = ca.vertcat(rows, ca.jacobian(model.normalisation, x) @ model.full_rhs)
    return Formulation(
        ca.SX.sym("s"), x, (x, end), ca.vertcat(Omega, p, damping), duration * field, rows, ca.SX(0, 1),
        constants=ca.SX.sym("constants", 0),
    )  # fmt: skip


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

    def of_shorter_period(self, z: Array, turns: int) -> Array:
        phases = self.phases() / turns
        states = self.sample(z, phases)
        if self.model.order == 2:
            ends = [self.sample(z, phases + side * PHASE_DIFFERENCE_STEP) for side in (-1.0, 1.0)]
            states = np.hstack([states, self.frequency(z) * (ends[1] - ends[0]) / (2.0 * PHASE_DIFFERENCE_STEP)])
        return states.ravel()

    def _spread(self, factors: Array) -> Array:
        return np.tile(factors, self.states // factors.size)  # velocities are shown as positions are

    @property
    def measures(self) -> tuple[Array | float, ...]:
        """The same; positions, beside which velocities of fast orbits are large, by the largest position as well."""
        positions = self._spread(np.repeat([1.0, 0.0], [self.model.size, self.model.full_size - self.model.size]))
        return super().measures + tuple(m * positions for m in super().measures if self.model.order == 2)

    def pack(self, positions: Array, Omega: float, parameter: float) -> Array:
        theta = self.phases()
        state = np.outer(np.cos(theta), positions)
        if self.model.order == 2:
            state = np.hstack([state, np.outer(-Omega * np.sin(theta), positions)])
        return np.concatenate([state.ravel(), [Omega, parameter], np.zeros(int(self.unfolded))])


class CollocationProblem(CollocationEquations, FirstOrderProblem):
    """Equations of K intervals with d stages of the part of the period that the symmetry leaves unknown.

    Raises ValueError for missing symmetries.
    """

    def __init__(self, model: OdeModel, intervals: int, symmetry: SymmetryClass, table: CollocationTable) -> None:
        FirstOrderProblem.__init__(self, model, intervals, symmetry)
        self._discretise(orbit_formulation(model, symmetry, self.pinned, self.unfolded), intervals, table)

    def phases(self) -> Array:
        return self.symmetry.value * 2.0 * np.pi * self._fractions()

    def sample(self, z: Array, theta: Array) -> Array:
        fractions, signs = unfolded_phases(self.model, self.symmetry, theta)
        full = signs * self._interpolate(z, fractions)
        return np.asarray(full[:, : self.model.size])
