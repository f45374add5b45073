"""Multipliers of periodic orbits of any model, over the full period, each with its error.

From the linearised collocation equations, whose interval maps are multiplied (Doedel 1981; Fairgrieve and Jepson 1991),
and, sharing nothing with these, from CVODES sensitivities. Multipliers smaller than 1 are the inverses of those of the
inverse maps multiplied the other way round: of a product with entries near 1 they would have no digits. Huge and tiny
multipliers at once, and those that no double holds, come from a periodic Schur form (`closed_maps`).

The error of a multiplier is its distance from that of a better solution, and what rounding adds (`judged`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from casadi_skin import native
from casadi_skin.model.conserved import SymmetryClass, quantities
from casadi_skin.model.integrators import CvodesError, IntegrationError, Trajectory
from casadi_skin.model.ode import OdeModel
from casadi_skin.native import MOST_STATES, kernels, orbits
from casadi_skin.native.orbits import OrbitKernel
from casadi_skin.solve.between_ends import method_of
from casadi_skin.solve.intervals import MANY_STATES
from casadi_skin.stability.closed_maps import (
    FAR_LOG_EIGENVALUE,
    Multipliers,
    Spectrum,
    Trivial,
    balancing,
    general_frame,
    multipliers_along,
    no_trivial,
    trivial_along,
    trivial_of,
    units_of,
    vectors_along,
)
from casadi_skin.stability.flows import LOCAL_TOLERANCE_RATIO, TIGHTEST_LOCAL_TOLERANCE, FlowError, transition_by_cvodes
from casadi_skin.stability.leading import FEWEST, ManyLeadingError, leading_multipliers
from casadi_skin.stability.result import LARGEST_LOGARITHM, Floquet, verdicts
from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.problem import Array, Indices
from casadi_skin.zero.stated_problem import TURNED_FIELD_RTOL, BoundaryProblem, Closure

# The error of each multiplier, from those of a better solution: what its discretisation, and the orbit's, are off by

MOST_DENSE = 400  # states of which dense maps are made where too many multipliers are not small
DISTANCE_SAFETY = 2.0  # distances to the better solution are the error up to the error of that
LEAST_ERROR_RATIO = 0.1  # of the largest error: that of a single multiplier may vanish at both tolerances
NO_MU, NO_MU_ERROR = np.empty(0, complex), np.empty(0)  # of an orbit that is not reversible
TRIVIAL_DRIFT = 100.0  # tolerances, times the size of the balanced monodromy matrix: of the trivial multiplier


def judged(
    found: Multipliers, better: Multipliers | None, tolerance: float, left: float = 0.0, least: float = 0.0
) -> Floquet:
    """Multipliers with the errors that better ones show, of which the part `left` is in these too; infinite without.

    Relative errors are at least the part `least` of the largest.
    """
    near, others = found.trivial.values, found.others.values
    errors, sizes = np.full(others.size, np.inf), np.maximum(1.0, np.abs(others))
    if better is not None:
        errors = DISTANCE_SAFETY / (1.0 - left) * _distances(found.others, better.others) + found.rounding
        if least:
            errors = np.maximum(errors, least * sizes * np.max(errors / sizes, initial=0.0))
    deviation = float(np.abs(near - 1.0).prod() ** (1.0 / near.size)) if near.size else 0.0
    on_circle, real, error = verdicts(others, errors)
    return Floquet(
        np.concatenate([near, others]), np.concatenate([found.trivial.logs, found.others.logs]), near.size, deviation,
        errors, on_circle, real, error, float(np.abs(others).max(initial=0.0)), NO_MU, NO_MU_ERROR,
        monodromy=None if found.matrix is None else found.matrix * np.exp(min(found.size, LARGEST_LOGARITHM)),
        lost=found.lost, allowed_deviation=float(TRIVIAL_DRIFT * tolerance * found.norm), beyond=found.beyond,
    )  # fmt: skip


def _distances(found: Spectrum, better: Spectrum) -> Array:
    """Of each eigenvalue from the one that it is paired with; infinite without one."""
    values, others = found.values, better.values
    with np.errstate(invalid="ignore", over="ignore"):
        sizes = np.maximum(1.0, np.maximum(np.abs(values)[:, None], np.abs(others)))
        apart = np.abs(values[:, None] / sizes - others / sizes)
        distances = np.full(values.size, np.inf)
        rows, columns = np.arange(values.size), apart.argmin(axis=1) if others.size else np.arange(0)
        if len(set(columns.tolist())) < values.size:  # the nearest is not each one's own
            from scipy.optimize import linear_sum_assignment

            rows, columns = linear_sum_assignment(apart)
        distances[rows] = apart[rows, columns] * sizes[rows, columns]
    if not values.imag.any():
        return distances
    partners = np.argmin(np.abs(values[:, None].conj() - values), axis=1)
    return np.asarray(np.maximum(distances, distances[partners]))


RESOLVED_LOG_GROWTH = 2.0  # logarithm of the factor that a perturbation may change by in an interval
WITHIN_PART = 1.0  # the same in a part
MOST_PARTS = 20_000
# Logarithms of multipliers by intervals and by parts: where they agree, the first ones are more accurate, as an orbit
# is more accurate at ends of intervals.
SAME_LOG_ATOL = 1e-8
MOST_WORK = 1e10  # of the linear systems of all parts: their number times the third power of their size
LARGEST_STACK = 4_000_000  # entries of the matrices of several intervals that are factored in one call


def interval_maps(jacobians: Array, lengths: Array, table: CollocationTable) -> tuple[Array, float]:
    """Transition matrices over intervals, (any, n, n), and the logarithm of the determinant of their product.

    They are solved for in balanced units, powers of 2: where sizes of states differ by 1e10, pivots would be chosen by
    their units, and entries lose all digits that small states have. The logarithm is that of Liouville's formula.

    Arguments:
        jacobians: derivatives of the field at the stages, in order of time.
        lengths: of the intervals.
        table: the method.
    """
    n, d, K = jacobians.shape[1], table.degree, lengths.size
    method = method_of(table)
    if n <= MOST_STATES and method is not None and kernels():
        return native.interval_maps(method, lengths, jacobians.reshape(K, d, n, n))
    units, maps = balancing(np.max(np.abs(jacobians), axis=0)), np.empty((K, n, n))
    of_intervals = (jacobians * (units / units[:, None])).reshape(K, d, n, n)
    for these in np.array_split(np.arange(K), K * (n * d) ** 2 // LARGEST_STACK + 1):
        maps[these] = _solved_maps(of_intervals[these], lengths[these, None, None], table)
    traces = np.trace(jacobians, axis1=1, axis2=2).reshape(-1, d)
    return np.asarray(maps * (units[:, None] / units)), float(lengths @ (traces @ table.extended[-1]))


def _solved_maps(A: Array, h: Array, table: CollocationTable) -> Array:
    """The same of some intervals, from their derivatives (intervals, d, n, n) and lengths (intervals, 1, 1).

    By the matrices 1 - h a_ij A_j of their stages, (intervals, d n, d n).
    """
    K, d, n = A.shape[:3]
    one, weights = np.eye(n), h * table.matrix
    systems = np.eye(d * n) - (weights[:, :, None, :, None] * A.transpose(0, 2, 1, 3)[:, None]).reshape(K, d * n, d * n)
    stages = np.linalg.solve(systems, np.tile(one, (d, 1))).reshape(K, d, n, n)
    return np.asarray(one + h * np.tensordot(A @ stages, table.extended[-1], (1, 0)))


SPECTRAL_SQUARINGS = 3  # of small matrices, whose norms then bound their eigenvalues closely
SMALLEST_RATE_RATIO = 1e-30  # of the largest entry, whose powers are doubles


def needed_parts(problem: BoundaryProblem, jacobians: Array) -> Indices | None:
    """Numbers of parts of each interval in which nothing changes too much; None where no interval is too long."""

    counts = np.maximum(np.ceil(_changes(problem, jacobians) / WITHIN_PART), 1.0).astype(int)
    return None if np.max(counts) * WITHIN_PART <= RESOLVED_LOG_GROWTH else counts


def _changes(problem: BoundaryProblem, jacobians: Array) -> Array:
    """Bounds of the logarithms of the factors by which something may change in each interval.

    From norms, and where one is large from those of powers.
    """
    K, d, n = problem.resolution, problem.degree, jacobians.shape[1]

    def bounds(power: int) -> Array:
        entries = np.abs(matrices)
        found = np.minimum(np.max(np.sum(entries, axis=1), axis=1), np.max(np.sum(entries, axis=2), axis=1))
        return np.asarray(size * np.max(found.reshape(K, -1), axis=1) ** (1.0 / power))

    units, size = balancing(np.max(np.abs(jacobians), axis=0)), 1.0
    matrices = np.repeat(problem.constants, d)[:, None, None] * jacobians * (units / units[:, None])
    rates, squarings = bounds(1), SPECTRAL_SQUARINGS if n <= MOST_STATES else 0
    if np.max(rates) <= RESOLVED_LOG_GROWTH:
        return rates
    size = float(np.max(np.abs(matrices)))
    matrices = matrices / size
    matrices[np.abs(matrices) < SMALLEST_RATE_RATIO] = 0.0
    for _ in range(squarings):
        matrices = matrices @ matrices
    return bounds(2**squarings)


def parts_of(problem: BoundaryProblem, counts: Indices) -> tuple[Array, Array]:
    """Starts and lengths of so many parts of each interval."""
    lengths = np.repeat(problem.constants / counts, counts)
    return np.append(0.0, np.cumsum(lengths)[:-1]), lengths


def maps_of_parts(problem: BoundaryProblem, z: Array, n: int, counts: Indices) -> Array:
    """Maps over so many parts of each interval, of the first n components."""
    (starts, lengths), table = parts_of(problem, counts), problem.table
    places = (starts[:, None] + lengths[:, None] * table.nodes).ravel()
    together = problem.resolution * problem.degree + 1  # places that the equations evaluate together
    chosen = np.minimum(np.arange(-(-places.size // together) * together), places.size - 1)
    states, numbers = problem.sample(z, places)[chosen], (z[problem.states :], problem.values)
    parted = places[chosen].reshape(-1, together, 1), states.reshape(-1, together, states.shape[1])
    finer = [problem.discretisation.jacobians_at(*one, *numbers) for one in zip(*parted, strict=True)]
    return interval_maps(np.concatenate(finer)[: lengths.size * problem.degree, :n, :n], lengths, table)[0]


LEAST_LOCAL_TOLERANCE = 1e-12
TIGHTER_RATIO = 0.01  # times the local tolerance of CVODES, for the multipliers that show the error of the others:
# at a tenth of it they may have the same error, of one sign, as orders and steps change with the tolerance
LEFT_ERROR_RATIO = 0.75  # of the error that the tighter tolerance may leave: measured, up to 0.7 of single multipliers
STILL_VARIATION = 1e-6  # of the largest value: the variation of a solution that rests
CLOSED_VALUE_RTOL = 1e-5  # relative: values that close as the solution does


@dataclass(frozen=True, eq=False)
class Closed:
    """A solution that comes back to its start, or to S times that: its multipliers are those of S^-1 times the flow.

    The state of the problem may have others beside it: those of the model come first, and do not depend on these.

    Attributes:
        problem, z: the problem and its unknowns.
        model: the model, of first order where S is not 1.
        symmetry: the part of the period that is unknown.
        turn: S, shape (n, n), of a solution that conditions take back to S times its start; None where it is 1.
    """

    problem: BoundaryProblem
    z: Array
    model: OdeModel
    symmetry: SymmetryClass = SymmetryClass.FULL
    turn: Array | None = None

    @classmethod
    def by(cls, closure: Closure, problem: BoundaryProblem, z: Array) -> Closed:
        """A solution that its conditions close."""
        return cls(problem, z, closure.statement.model, turn=closure.matrix)

    def found_at_once(self, with_rounding: bool) -> Array | None:
        """Multipliers by a kernel; None where more is known of an orbit than its velocity, or of many states."""
        if self.turn is not None or not self.is_whole or self.conditions or not kernels():
            return None
        problem, key = self.problem, ("multipliers", self.model)
        known = problem.discretisation.shared
        if key not in known:
            known[key] = _kernel_of(problem, self.model)
        kernel: OrbitKernel | None = known[key]
        if kernel is None:
            return None
        most = min(MOST_PARTS, MOST_WORK / (problem.degree * self.size) ** 3)
        return kernel.found(self.z, problem.numbers, with_rounding, problem.polynomials, most)

    @cached_property
    def _all_parameters(self) -> Array:
        """Those of the problem, in its order."""
        return self.problem.parameters(self.z)

    @property
    def parameters(self) -> Array:
        """Those of the model."""
        names, own = self.problem.statement.model.parameter_names, self.model.parameter_names
        return self._all_parameters[[names.index(name) for name in own]]

    @property
    def period(self) -> float:
        """That of a periodic solution."""
        start, end = self.problem.statement.span(self._all_parameters)
        return (end - start) / self.symmetry.value

    @cached_property
    def size(self) -> int:
        """Number n of components of the state of the model."""
        return self.model.full_size

    @property
    def is_whole(self) -> bool:
        """Whether the whole period is solved for."""
        return self.symmetry is SymmetryClass.FULL

    @property
    def conditions(self) -> int:
        """Number of algebraic equations, which changes of the solution meet."""
        implicit = self.model.implicit
        return 0 if implicit is None else len(implicit.conditions)

    @cached_property
    def units(self) -> Array:
        """Sizes of the components."""
        return units_of(self.ends)

    @cached_property
    def ends(self) -> Array:
        """States at the ends of the intervals of the whole period, shape (ends, n)."""
        columns = self.z[: self.problem.states].reshape(self.problem.columns, -1)
        part = columns[:: self.problem.table.ends.size, : self.size]
        if self.is_whole:
            return part
        mirror, half = self._signs
        there = np.concatenate([part, (part * mirror)[-2::-1]])
        return there if half is None else np.concatenate([there, (there * half)[1:]])

    def over_the_period(self, maps: Array) -> Array:
        """Maps over the full period from those over the part that is solved for: reversed and repeated, or turned."""
        if self.turn is not None:
            return np.concatenate([maps, np.linalg.inv(self.turn)[None]])
        if self.is_whole:
            return maps
        mirror, half = self._signs
        there = np.concatenate([maps, mirror[:, None] * np.linalg.inv(maps[::-1]) * mirror])
        return there if half is None else np.concatenate([there, half[:, None] * there * half])

    def contraction(self, part: float) -> tuple[float, float]:
        """Sign and logarithm of the determinant of all maps, from the logarithm over the part that is solved for.

        Of changes that meet algebraic equations: others decay at their rates.
        """
        sign, by_turn = (1.0, 0.0) if self.turn is None else np.linalg.slogdet(self.turn)
        by_rates = self.period * float(np.sum(self.model.implicit.rates)) if self.model.implicit else 0.0
        return float(sign), part / self.symmetry.value - float(by_turn) + by_rates

    @property
    def _signs(self) -> tuple[Array, Array | None]:
        """Those of the components in the part after the unknown one, and in the second half of the period."""
        reversal = np.array(self.model.reversal, dtype=float)
        if self.symmetry is SymmetryClass.HALF:
            return reversal, None
        half = np.array(self.model.half_period, dtype=float)
        return half * reversal, half

    def trivial(self, tolerance: float, ends: Array | None = None) -> Trivial:
        """The multipliers that are 1 for every orbit, with their vectors: those that S maps as it maps the solution."""
        model, S, states = self.model, self.turn, self.ends if ends is None else ends
        if S is None:
            if model.forced:
                return no_trivial(self.size)
            return trivial_along(model, self.symmetry, states, self.units, self.parameters, self.period, tolerance)
        problem, n = self.problem, self.size
        values = self.z[: problem.states].reshape(problem.columns, -1)[:, :n]
        size = max(float(np.max(np.abs(values))), float(np.max(problem.floors[:n])))
        if model.forced or np.max(np.ptp(values, axis=0)) <= STILL_VARIATION * size:  # at rest
            return no_trivial(n)
        states = np.vstack([states, states[0]])  # to which S^-1 takes that at the end
        right, left = vectors_along(model, states, self.parameters)
        right = right[:, [_same(S @ v[0], v[-2]) for v in right.swapaxes(0, 1)]]
        left = left[:, [_same(S.T @ v[-2], v[0]) for v in left.swapaxes(0, 1)]]
        return trivial_of(right, left, units_of(states), tolerance)

    @property
    def moves_freely(self) -> bool:
        """Whether a solution may start at any of its phases: S maps its velocity as it maps the solution."""
        return bool(self.trivial(TURNED_FIELD_RTOL, self.ends[[0, -1]]).right.shape[1])


def _kernel_of(problem: BoundaryProblem, model: OdeModel) -> OrbitKernel | None:
    equations, table, n = problem.discretisation, problem.table, model.full_size
    plain, method = model.forced or not quantities(model), method_of(table)
    if not plain or equations.checks is None or n > MOST_STATES or method is None:
        return None
    apart, trivial = table.ends.size * problem.formulation.states, int(not model.forced)
    data = equations.compiled, method, problem.formulation.entries, table.nodes, general_frame(n)
    return OrbitKernel((n, problem.resolution, table.degree, apart), trivial, *data)


def _same(one: Array, other: Array) -> bool:
    return bool(np.max(np.abs(one - other)) <= CLOSED_VALUE_RTOL * np.max(np.abs(other)))


def by_collocation(orbit: Closed, better: Closed | None, tolerance: float) -> Floquet:
    """Multipliers from the interval maps of the linearised equations; `better` is the orbit on a finer mesh."""
    if orbit.size >= MANY_STATES and orbit.is_whole and orbit.turn is None and not orbit.conditions:
        with suppress(ManyLeadingError):
            return _by_leading(orbit, better, tolerance)
    left = 0.0 if better is None else orbit.problem.left_by(better.problem)
    at_once = _at_once(orbit, better, tolerance, left)
    if at_once is not None:
        return at_once
    found = _multipliers(orbit, tolerance, with_rounding=better is not None)
    return judged(found, None if better is None else _multipliers(better, tolerance, False), tolerance, left)


def _at_once(orbit: Closed, better: Closed | None, tolerance: float, left: float) -> Floquet | None:
    """All that follows by compiled kernels; None where it takes more than these have."""
    found = orbit.found_at_once(better is not None)
    other = None if found is None or better is None else better.found_at_once(False)
    if found is None or (better is not None and other is None):
        return None
    numbers = orbits.judged(orbit.size, found, other, DISTANCE_SAFETY / (1.0 - left), TRIVIAL_DRIFT * tolerance)
    if numbers is None:
        return None
    values, (logs, errors, *flags), matrix, (first, deviation, error, largest, allowed) = numbers
    count, others = int(first), orbit.size - int(first)
    on_circle, real = (flag[:others] != 0.0 for flag in flags)
    return Floquet(
        values, logs, count, deviation, errors[:others], on_circle, real, error, largest, NO_MU, NO_MU_ERROR,
        monodromy=matrix, allowed_deviation=allowed,
    )  # fmt: skip


def _by_leading(orbit: Closed, better: Closed | None, tolerance: float) -> Floquet:
    """The leading multipliers alone; raises ManyLeadingError, of more states than dense maps are made of FlowError."""

    def found(of: Closed, least: int, checked: bool) -> Multipliers:
        return leading_multipliers(of.problem, of.z, of.trivial(tolerance), units_of(of.ends), least, checked)

    try:
        own = found(orbit, FEWEST, better is not None)
        if 1.0 <= own.beyond < np.inf and orbit.size <= MOST_DENSE:
            raise ManyLeadingError("some multipliers outside the unit circle may not be in the list")
    except ManyLeadingError as error:
        if orbit.size > MOST_DENSE:
            raise FlowError(str(error)) from error
        raise
    try:
        finer = None if better is None else found(better, own.others.logs.size, False)
    except ManyLeadingError:  # of a solution that is none, as beside a Hopf point
        finer = None
    return judged(own, finer, tolerance, 0.0 if better is None else orbit.problem.left_by(better.problem))


def _multipliers(orbit: Closed, tolerance: float, with_rounding: bool) -> Multipliers:
    """From maps over intervals; over parts of these where several are so far from 1 that digits may be lost."""
    problem, n = orbit.problem, orbit.size
    jacobians = problem.discretisation.jacobians(orbit.z, problem.numbers, n)  # at all stages, of unit length
    maps, by_part = interval_maps(jacobians, problem.constants, problem.table)
    contraction = orbit.contraction(by_part)

    def multipliers(maps: Array, trivial: Trivial, starts: Array | None = None) -> Multipliers:
        maps = orbit.over_the_period(maps)
        if not orbit.conditions:
            return multipliers_along(maps, trivial, orbit.units, contraction, with_rounding)
        return _of_free_changes(orbit, maps, trivial, starts, contraction, with_rounding)

    trivial = orbit.trivial(tolerance)
    found = multipliers(maps, trivial)
    counts = needed_parts(problem, jacobians) if orbit.is_whole and found.others.far > 1 else None
    if counts is None:
        return found
    if np.sum(counts) > min(MOST_PARTS, MOST_WORK / (problem.degree * n) ** 3):
        return replace(found, lost=True)
    parts = maps_of_parts(problem, orbit.z, n, counts)
    by_parts = multipliers(parts, trivial.carried(parts, counts), parts_of(problem, counts)[0])
    logs, other = found.others.logs, by_parts.others.logs
    as_good = (np.abs(logs) <= FAR_LOG_EIGENVALUE) & (np.abs(logs - other) <= SAME_LOG_ATOL)
    return by_parts.but(found, as_good)


def _of_free_changes(orbit: Closed, maps: Array, trivial: Trivial, starts: Array | None, *how: Any) -> Multipliers:
    """Multipliers of changes that meet the algebraic equations, in orthonormal directions of these at starts of maps.

    Arguments:
        orbit: the solution.
        maps: one after another over the period, shape (maps, n, n).
        trivial: as these carry it.
        starts: of the maps, as fractions of the period; None of those over intervals.
        how: what `multipliers_along` takes further.
    """
    problem, units, implicit = orbit.problem, orbit.units, orbit.model.implicit
    assert implicit is not None
    states = orbit.ends if starts is None else problem.sample(orbit.z, starts)[:, : orbit.size]
    places = np.append(0.0, np.cumsum(problem.constants)) if starts is None else starts
    times = problem.statement.span(orbit._all_parameters)[0] + places * orbit.period
    frames = implicit.frames(times[: len(maps)], states[: len(maps)], orbit.parameters, units)
    frames = np.concatenate([frames, frames[:1]])
    right, left = trivial.right / units, trivial.left * units
    within = replace(trivial, right=right @ frames[: len(right)], left=left @ frames[: len(left)])
    maps = frames[1:].swapaxes(1, 2) @ (maps * units / units[:, None]) @ frames[:-1]
    found = multipliers_along(maps, within, np.ones(maps.shape[1]), *how)
    matrix = None if found.matrix is None else (frames[0] @ found.matrix @ frames[0].T) * units[:, None] / units
    return replace(found, matrix=matrix)


def by_cvodes(orbit: Closed, better: Closed | None, tolerance: float) -> Floquet:
    """Multipliers from the sensitivity of the flow over the period to its start; raises IntegrationError.

    Their errors are seen on the better solution, with a tighter local tolerance.
    """
    local = max(LOCAL_TOLERANCE_RATIO * tolerance, LEAST_LOCAL_TOLERANCE)
    found = _by_sensitivities(orbit, local, tolerance)
    tighter = max(TIGHTER_RATIO * local, TIGHTEST_LOCAL_TOLERANCE)
    finer = _by_sensitivities(better or orbit, tighter, tolerance)
    result = judged(found, finer, tolerance, LEFT_ERROR_RATIO, LEAST_ERROR_RATIO)
    return replace(result, blurred=int(np.count_nonzero(result.log_moduli < np.log(local))))


def _by_sensitivities(orbit: Closed, local: float, tolerance: float) -> Multipliers:
    """Of states in units of their size: local errors are relative to that."""
    start, units = orbit.ends[0], orbit.units
    try:
        numbers = np.concatenate([orbit.parameters, [orbit.period], units])
        matrix = transition_by_cvodes(orbit.model, start, numbers, local, stiff=True)
    except CvodesError as error:
        empty = Trajectory(np.empty((0, start.size)), 0)
        raise IntegrationError("cvodes", str(error), empty, np.array([orbit.period])) from error
    trivial = orbit.trivial(tolerance)
    closed = replace(trivial, right=trivial.right[[0, -1]], left=trivial.left[[0, -1]])
    if orbit.conditions:
        return _of_free_changes(orbit, matrix[None], closed, None)
    return multipliers_along(matrix[None], closed, units)


FULL_PERIOD_FLOWS: Mapping[str, Callable[[Closed, Closed | None, float], Floquet]] = {
    "collocation": by_collocation,
    "cvodes": by_cvodes,
}
