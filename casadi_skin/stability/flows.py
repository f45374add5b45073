"""Flow maps of the variational system Phi' = J(q(t)) Phi along orbits: an orbit in, its transition matrix out.

Maps in equal steps: step numbers, extrapolation, an estimate of the error, and the choice of the steps. Beside them the
sensitivities of CVODES, which share nothing with these. Matrices have shape (orbits, m, m), m components of the state.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import groupby
from typing import TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.conserved import symmetry_class
from casadi_skin.model.integrators import CvodesError, CvodesOptions, run_cvodes
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import kept_by_first
from casadi_skin.native import kernels, transitions
from casadi_skin.stability.reduction import blocks_of, frobenius_norms
from casadi_skin.zero.problem import Array, Buffers, Problem

T = TypeVar("T")


@dataclass(frozen=True)
class OrbitState:
    """An orbit as a flow map takes it: unknowns z of a problem, and the same orbit better known where there is one.

    The difference between transition matrices along the orbit and along `better` is the error that the orbit makes.
    """

    problem: Problem
    z: Array
    better: OrbitState | None = None

    @property
    def Omega(self) -> float:
        """Frequency."""
        return self.problem.frequency(self.z)

    @property
    def parameter(self) -> float:
        """Value of the free parameter."""
        return float(self.z[self.problem.parameter_index])


@dataclass(frozen=True)
class Transition:
    """Transition matrix Phi of (positions, velocities) over `fraction` of the period, with its estimated errors.

    `error` estimates the Frobenius norm of the error of Phi that the integration makes; `truncation` is a matrix
    like that error but for its sign, without round-off. Errors of the orbit itself, which leave Phi symplectic, are in
    neither: `pair` holds Phi along the orbit and along the better one, computed with the same steps, where it is known.
    `steps` is the number of equal steps, 0 of flows without such.
    """

    matrix: Array
    fraction: float
    error: float
    truncation: Array | None = None
    pair: tuple[Array, Array] | None = None
    steps: int = 0

    def blocks(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D of Phi = [[A, B], [C, D]], each (n, n)."""
        return blocks_of(self.matrix)

    def mapped(self, function: Callable[[Array], Array]) -> Transition:
        """With a linear function of matrices in the place of each."""
        pair, truncation = self.pair, self.truncation
        return replace(
            self,
            matrix=function(self.matrix),
            truncation=None if truncation is None else function(truncation),
            pair=None if pair is None else (function(pair[0]), function(pair[1])),
        )


class FlowError(ArithmeticError):
    """A flow map cannot reach its tolerance."""


class FlowMap(ABC):
    """Computes transition matrices of the variational system along orbits of one model.

    They are over the fraction of the period of the model's symmetry class. Where free motions of a model make
    multipliers trivial, they are those of relative positions, the orthonormal columns of a `frame`, (n, m).
    """

    batch = 1  # orbits that are best given together: more cost no less each

    def __init__(self, model: OdeModel, tolerance: float, frame: Array | None = None) -> None:
        self.model, self.tolerance, self.frame = model, tolerance, frame
        self.fraction = symmetry_class(model).value

    @abstractmethod
    def _transitions(self, orbits: Sequence[OrbitState], tolerance: float, alike: bool) -> list[Transition]:
        """Those of all positions."""

    def transitions(
        self, orbits: Sequence[OrbitState], tolerance: float | None = None, alike: bool = False
    ) -> list[Transition]:
        """Transition matrices along several orbits, to `tolerance` where it is not the flow's own.

        Where `alike`, all are computed in one number of steps: their errors are smooth along a branch then. Raises
        FlowError where the tolerance is out of reach for any of them.
        """
        found = self._transitions(orbits, self.tolerance if tolerance is None else tolerance, alike)
        return found if self.frame is None else [transition.mapped(self._across) for transition in found]

    def transition(self, problem: Problem, z: Array) -> Transition:
        """Transition matrix along the orbit z of `problem`; raises FlowError where the tolerance is out of reach."""
        return self.transitions([OrbitState(problem, z)])[0]

    def durations(self, orbits: Sequence[OrbitState]) -> Array:
        """Times that the fraction of the period takes, shape (orbits,)."""
        return np.array([2.0 * np.pi * self.fraction / orbit.Omega for orbit in orbits])

    def _across(self, matrix: Array) -> Array:
        """A matrix of all positions and velocities as one of the relative ones."""
        assert self.frame is not None
        n, size = self.frame.shape
        blocks = matrix.reshape(2, n, 2, n).swapaxes(1, 2)
        return np.asarray((self.frame.T @ blocks @ self.frame).swapaxes(1, 2).reshape(2 * size, 2 * size))


def complement(directions: Array) -> Array:
    """Orthonormal columns that span what is orthogonal to the columns of (n, m), m < n."""
    return np.asarray(np.linalg.qr(directions, mode="complete")[0][:, directions.shape[1] :])


# The sparse derivative of a model's right-hand side along orbits ------------------------------------------------------

PHASES_PER_CALL = 64  # enough to hide the cost of a call


class JacobianAlong:
    """Non-zeros of J = d rhs/d state at many states, row by row (CSR); one pattern for all of them.

    `indices` and `indptr` are the pattern of J, shape (size, size).
    """

    def __init__(self, model: OdeModel) -> None:
        self.size = model.size
        # CasADi orders by columns: the non-zeros of the transpose are those of J ordered by rows.
        transposed = ca.jacobian(model.rhs, model.state).T
        self.indptr = np.array(transposed.sparsity().colind(), dtype=np.int32)
        self.indices = np.array(transposed.sparsity().row(), dtype=np.int32)
        nonzeros, parameters = transposed.nz[:], ca.vec(model.parameters)
        moving = np.array(ca.which_depends(nonzeros, ca.vertcat(model.state, parameters), 1, True), dtype=bool)
        # Off-diagonals of a chain are the same everywhere: they are computed once.
        self._constant = np.zeros(moving.size)
        fixed, places = np.flatnonzero(~moving), np.flatnonzero(moving)
        self._constant[fixed] = np.array(ca.evalf(nonzeros[fixed.tolist()])).ravel()
        function = ca.Function("J", [model.state, parameters], [nonzeros[places.tolist()]])
        self._places, self._moving = places, Buffers(function, PHASES_PER_CALL) if places.size else None

    def along(self, problem: Problem, z: Array, theta: Array) -> Array:
        """Non-zeros at phases of several orbits z of a problem, shape (orbits, phases, non-zeros)."""
        states = problem.samples(z, theta).reshape(len(z) * theta.size, -1)
        found = self(states, np.repeat(z[:, problem.parameter_index], theta.size))
        return found.reshape(len(z), theta.size, -1)

    def __call__(self, states: Array, parameters: Array) -> Array:
        """Non-zeros, (phases, non-zeros), at states (phases, size), with the parameter's value at each, (phases,)."""
        result = np.tile(self._constant, (len(states), 1))
        if self._moving is None:
            return result
        for first in range(0, len(states), PHASES_PER_CALL):
            rows = result[first : first + PHASES_PER_CALL]
            these = np.minimum(np.arange(first, first + PHASES_PER_CALL), len(states) - 1)
            (values,) = self._moving(states[these], parameters[these, None])
            rows[:, self._places] = values.reshape(PHASES_PER_CALL, -1)[: len(rows)]
        return result

    @cached_property
    def half_bandwidth(self) -> int:
        """Largest distance of a non-zero from the diagonal."""
        return int(np.max(np.abs(self.rows() - self.indices), initial=0))

    def rows(self) -> NDArray[np.intp]:
        """Row of each non-zero."""
        return np.repeat(np.arange(self.size), np.diff(self.indptr))


# The splitting SRKN11b of order 6 (Blanes and Moan 2002): its coefficients, and its sequence of kicks and drifts ------

SPLITTING_ORDER = 6


def srkn_coefficients() -> tuple[Array, Array]:
    """Drifts a, shape (11,), and kicks b, shape (12,), of the method called SRKN11b by Blanes and Moan (2002)."""
    b = [0.0414649985182624, 0.198128671918067, -0.0400061921041533, 0.0752539843015807, -0.0115113874206879]
    a = [0.123229775946271, 0.290553797799558, -0.127049212625417, -0.246331761062075, 0.357208872795928]
    b.append(0.5 - sum(b))
    a.append(1.0 - 2.0 * sum(a))
    return np.array(a + a[-2::-1]), np.array(b + b[::-1])


@dataclass(frozen=True, eq=False)
class KicksAndDrifts:
    """Kicks b, one more than drifts a, over equal steps, and the `times` of the kicks; a step takes the unit of time.

    The last kick of a step and the first one of the next are one.
    """

    kicks: Array
    drifts: Array
    times: Array

    @classmethod
    @cache
    def of(cls, steps: int) -> KicksAndDrifts:
        """The sequence of a number of steps, which is not to be written to."""
        drifts, kicks = srkn_coefficients()
        later = np.tile(np.append(kicks[1:-1], kicks[-1] + kicks[0]), steps)
        later[-1] = kicks[-1]
        times = (np.arange(steps)[:, None] + np.cumsum(drifts)).ravel()
        return cls(np.append(kicks[0], later), np.tile(drifts, steps), np.append(0.0, times))

    def apply(self, x: T, v: T, kick: Callable[[int, T, T], T], drift: Callable[[float, T, T], T]) -> tuple[T, T]:
        """Positions and velocities after `v = kick(i, x, v)` of each kick i and `x = drift(a, x, v)` between them."""
        v = kick(0, x, v)
        for i, a in enumerate(self.drifts, start=1):
            x = drift(a, x, v)
            v = kick(i, x, v)
        return x, v


def srkn_step(model: OdeModel, h: ca.SX, parameters: ca.SX | float) -> tuple[ca.SX, ca.SX]:
    """Positions and velocities a step h after those of a model of second order, as expressions in its symbols."""
    force = ca.Function("force", [model.state, model.parameters], [ca.densify(model.rhs)])
    one = KicksAndDrifts.of(1)

    def kick(i: int, q: ca.SX, v: ca.SX) -> ca.SX:
        return v + one.kicks[i] * h * force(q, parameters)

    def drift(a: float, q: ca.SX, v: ca.SX) -> ca.SX:
        return q + a * h * v

    return one.apply(model.state, model.velocity, kick, drift)


TINY_NUMBER = 1e-300
NEGLIGIBLE_ENTRY = 1e-20  # of an entry of a transition matrix: entries farther from the diagonal are left out


class SplittingMap:
    """Transition matrices of models of second order by the splitting in `steps` equal steps.

    For X'' = J(t) X with J = df/dq along the orbit, kicks V += b h J X and drifts X += a h V alternate; time moves with
    the drifts. The map is symplectic to round-off at every step number, so that stable orbits do not acquire
    instabilities. Several orbits go through the stages together, whatever their numbers of steps: their J are the
    blocks of one sparse matrix.
    """

    def __init__(self, jacobian: JacobianAlong, steps: int) -> None:
        self.jacobian, self.steps = jacobian, steps
        self.sequence = KicksAndDrifts.of(steps)
        self.fractions = self.sequence.times / steps

    def __call__(self, nonzeros: Array, durations: Array) -> Array:
        """Transition matrices, shape (points, 2n, 2n), from J's non-zeros (points, len(fractions), non-zeros)."""
        jacobian, sequence, h = self.jacobian, self.sequence, durations / self.steps
        if kernels():
            pattern, stages = (jacobian.indptr, jacobian.indices), (sequence.kicks, sequence.drifts)
            return transitions(pattern, (jacobian.half_bandwidth, self._reach(nonzeros, h)), stages, h, nonzeros)
        from scipy.sparse import block_diag, csr_array

        points, n = durations.size, jacobian.size
        one = csr_array((np.ones(jacobian.indices.size), jacobian.indices, jacobian.indptr), shape=(n, n))
        matrix: csr_array = block_diag([one] * points, format="csr")
        scaled = nonzeros * (h * h)[:, None, None]

        def kick(i: int, x: Array, v: Array) -> Array:
            matrix.data = sequence.kicks[i] * scaled[:, i].ravel()
            return np.asarray(v + matrix @ x)

        def drift(a: float, x: Array, v: Array) -> Array:
            return x + a * v

        # Velocities are multiplied by the step h, so that no orbit's step is in the drifts.
        x, v = (np.tile(np.eye(n, 2 * n, k), (points, 1)) for k in (0, n))
        x, v = sequence.apply(x, v * np.repeat(h, n)[:, None], kick, drift)
        halves = [half.reshape(points, n, 2 * n) for half in (x, v / np.repeat(h, n)[:, None])]
        return np.concatenate(halves, axis=1)

    def _reach(self, nonzeros: Array, h: Array) -> int:
        """Components to either side of its own in which a column is not negligible.

        At a distance of k kicks an entry is a sum of products of k kicks between different components and the drifts
        between: with the sums K and D of their norms at most (K D)^k / (k! k^k), as the drifts are k parts of D. Other
        kicks between these, with L as the sum of all, make it no more than exp(2 sqrt(L D)) times larger.
        """
        jacobian, kicks = self.jacobian, np.abs(self.sequence.kicks)
        most, starts, across = kicks.size, jacobian.indptr[:-1], jacobian.rows() != jacobian.indices
        if np.any(np.diff(jacobian.indptr) == 0) or most * jacobian.half_bandwidth >= jacobian.size:
            return min(most * jacobian.half_bandwidth, jacobian.size)
        largest = np.max(np.abs(nonzeros) * (h * h)[:, None, None], axis=0) * kicks[:, None]
        rows = [np.add.reduceat(part, starts, axis=1) for part in (largest * across, largest)]
        K, L = np.sum(np.max(rows, axis=2), axis=1) * float(np.sum(np.abs(self.sequence.drifts)))
        k = np.arange(1.0, most + 1.0)
        logs = k * (np.log(max(K, TINY_NUMBER)) - np.log(k)) - np.cumsum(np.log(k)) + 2.0 * np.sqrt(L)
        falling = np.append(np.diff(logs) < -1.0, True)  # then those beyond add up to less than twice the first
        small = np.flatnonzero((logs < np.log(NEGLIGIBLE_ENTRY)) & falling)
        return min(jacobian.half_bandwidth * (int(k[small[0]]) if small.size else most), jacobian.size)


# Matrices in equal steps, extrapolated --------------------------------------------------------------------------------


ROUND_OFF = 2e-14
EXTRAPOLATION_SAFETY = 2.0  # the difference that another extrapolation makes is asymptotically the error itself
LOWER_LEVEL_HEADROOM = 3.0  # of the tolerance over the error expected, before fewer steps are tried
BATCH_ENTRIES = 20_000  # entries of a batch of transition matrices: they stay in the cache of a core


@cache
def extrapolation(steps: tuple[int, ...], orders: tuple[int, ...]) -> Array:
    """Weights, with sum 1, of results in those numbers of steps that cancel errors of the given orders in 1/steps."""
    rows = [[1.0] * len(steps), *([(steps[-1] / n) ** order for n in steps] for order in orders)]
    weights = np.linalg.solve(np.array(rows), np.eye(len(steps))[0])
    weights.flags.writeable = False  # kept and shared
    return weights


@cache
def remainder(steps: tuple[int, ...], orders: tuple[int, ...]) -> float:
    """What extrapolation over those numbers of steps leaves of an error of the last order in 1/steps."""
    weights = extrapolation(steps, orders[:-1])
    return abs(float(np.sum(weights / np.array(steps, dtype=float) ** orders[-1])))


class SplittingFlow(FlowMap):
    """Transition matrices of models of second order by the splitting at neighbouring numbers of steps, extrapolated.

    The method's errors go with h^orders[0], h^orders[1], ... With one step number more than `orders` has entries, all
    maps together give a matrix without any of these errors, and all but the coarsest one without all but the last:
    that is the result, and the difference shows its error. The step numbers are chosen so that it meets the tolerance.

    Raises ValueError for a model that is not of second order with forces that depend on positions only.
    """

    step_numbers = (3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
    orders = (SPLITTING_ORDER, 8)

    def __init__(self, model: OdeModel, tolerance: float, frame: Array | None = None) -> None:
        if model.order != 2:
            raise ValueError(f"{model.name}: the splitting needs a model of second order; use cvodes")
        super().__init__(model, tolerance, frame)
        self._maps: dict[int, SplittingMap] = {}
        self._level = len(self.orders)  # of the finest map where the last orbits with `alike` met the tolerance

    @cached_property
    def jacobian(self) -> JacobianAlong:
        """Derivative of the right-hand side along orbits."""
        return JacobianAlong(self.model)

    @property
    def batch(self) -> int:  # type: ignore[override]
        return max(1, 2 * (BATCH_ENTRIES // self.model.full_size**2))

    def matrices(self, numbers: Sequence[int], orbits: Sequence[OrbitState]) -> list[Array]:
        """Transition matrices in several numbers of steps, not extrapolated, shape (orbits, m, m) each."""
        for steps in numbers:
            self._maps[steps] = self._maps.get(steps) or SplittingMap(self.jacobian, steps)
        maps = [self._maps[steps] for steps in numbers]
        theta = 2.0 * np.pi * self.fraction * np.concatenate([step_map.fractions for step_map in maps])
        groups = [(problem, list(those)) for problem, those in groupby(orbits, key=lambda orbit: orbit.problem)]
        sampled = [self.jacobian.along(problem, np.stack([o.z for o in those]), theta) for problem, those in groups]
        nonzeros = sampled[0] if len(sampled) == 1 else np.concatenate(sampled)
        durations = self.durations(orbits)
        ends = np.cumsum([step_map.fractions.size for step_map in maps])[:-1]
        return [step(part, durations) for step, part in zip(maps, np.split(nonzeros, ends, axis=1), strict=True)]

    def _transitions(self, orbits: Sequence[OrbitState], tolerance: float, alike: bool) -> list[Transition]:
        level, results = self._level if alike else len(self.orders), list[Transition]()
        for first in range(0, len(orbits), self.batch):
            results += self._adapted(orbits[first : first + self.batch], tolerance, level)
        while alike and len({found.steps for found in results}) > 1:
            most = max(found.steps for found in results)
            fewer = [i for i, found in enumerate(results) if found.steps < most]
            again = self._adapted([orbits[i] for i in fewer], tolerance, self.step_numbers.index(most))
            for i, found in zip(fewer, again, strict=True):
                results[i] = found
        if alike and results:  # a level lower where that may do for the next ones
            level, error = self.step_numbers.index(results[0].steps), max(found.error for found in results)
            steps = self.step_numbers[level - len(self.orders) : level + 1]
            higher = remainder(steps[:-1], self.orders) / remainder(steps[1:], self.orders)
            self._level = max(level - (LOWER_LEVEL_HEADROOM * higher * error <= tolerance), len(self.orders))
        return results

    def _adapted(
        self, orbits: Sequence[OrbitState], tolerance: float, level: int, known: Mapping[int, Array] | None = None
    ) -> list[Transition]:
        """From the `level`, and on at that which should do for each orbit by its own errors, until it does.

        The digits of an orbit then depend neither on the others given with it nor on those before. Raised one level at
        a time, it would end with an error just below the tolerance: 14 times larger at edges of a chain of 16 sites.
        Matrices in some numbers of steps may be `known`.
        """
        maps, steps = dict(known or {}), self.step_numbers[level - len(self.orders) : level + 1]
        missing = [number for number in steps if number not in maps]
        maps |= dict(zip(missing, self.matrices(missing, orbits), strict=True))
        matrices, errors = self._extrapolated(steps, maps)
        with np.errstate(over="ignore", invalid="ignore"):
            truncation, round_off = frobenius_norms(errors), ROUND_OFF * frobenius_norms(matrices)
        met = truncation <= np.maximum(tolerance, round_off)
        if not met.all() and level + 1 == len(self.step_numbers):
            worst = int(np.argmax(np.where(met, -np.inf, truncation)))
            raise FlowError(
                f"the splitting leaves {truncation[worst]:.1e} with {steps[-1]} steps; requested: {tolerance:.1e}; "
                f"worst {_place(orbits[worst], errors[worst], self.model.size)}; try a larger tolerance or another "
                "flow (splitting, cvodes)"
            )
        pairs, totals = self._pairs(orbits, met, steps[0], maps[steps[0]]), (truncation + round_off).tolist()
        found = [
            Transition(matrix, self.fraction, total, error, pairs.get(k), steps[-1])
            for k, (matrix, total, error) in enumerate(zip(matrices, totals, errors, strict=True))
        ]
        levels = np.array(
            [
                0 if ok else self._sufficient_level(level, error, tolerance)
                for ok, error in zip(met, truncation, strict=True)
            ]
        )
        for higher in np.unique(levels[~met]).tolist():
            places = np.flatnonzero(levels == higher)
            kept = {number: each[places] for number, each in maps.items()}
            again = self._adapted([orbits[i] for i in places.tolist()], tolerance, higher, kept)
            for i, transition in zip(places.tolist(), again, strict=True):
                found[i] = transition
        return found

    def _sufficient_level(self, level: int, error: float, tolerance: float) -> int:
        """The level that should meet a tolerance where one leaves an error above it; the next one at least."""

        def left(level: int) -> float:
            return remainder(self.step_numbers[level - len(self.orders) + 1 : level + 1], self.orders)

        above = range(level + 1, len(self.step_numbers))
        return next((r for r in above if left(r) * error <= left(level) * tolerance), level + 1)

    def _extrapolated(self, steps: tuple[int, ...], maps: Mapping[int, Array]) -> tuple[Array, Array]:
        """Extrapolated matrices from those in numbers of steps, and matrices like their errors."""
        few, all_ = extrapolation(steps[1:], self.orders[:-1]), extrapolation(steps, self.orders)
        found = [maps[number] for number in steps]
        return _combined(found[1:], few), _combined(found, EXTRAPOLATION_SAFETY * (all_ - np.append(0.0, few)))

    def _pairs(
        self, orbits: Sequence[OrbitState], met: NDArray[np.bool_], steps: int, maps: Array
    ) -> dict[int, tuple[Array, Array]]:
        """Matrices in so many steps along the orbits that are `met` and along the better ones, by place."""
        better = {k: better for k in np.flatnonzero(met).tolist() if (better := orbits[k].better) is not None}
        if not better:
            return {}
        (found,) = self.matrices([steps], list(better.values()))
        return {k: (maps[k], matrix) for k, matrix in zip(better, found, strict=True)}


def _combined(maps: Sequence[Array], weights: Array) -> Array:
    """The sum of maps times weights, with one array beside it: those of long chains leave the cache."""
    total, term = weights[0] * maps[0], np.empty_like(maps[0])
    for weight, matrices in zip(weights[1:], maps[1:], strict=True):
        np.multiply(matrices, weight, out=term)
        total += term
    return np.asarray(total)


def _place(orbit: OrbitState, errors: Array, size: int) -> str:
    """The orbit and the component, counted from 1, whose transition is least accurate, in words."""
    components = np.linalg.norm(errors, axis=1)
    component = int(np.argmax(np.nan_to_num(components, nan=np.inf))) % size + 1
    return f"at site {component} of the orbit of Omega = {orbit.Omega:.10g}, parameter = {orbit.parameter:.10g}"


# Transition matrices by SUNDIALS CVODES with forward sensitivities (Hindmarsh et al. 2005), for any model -------------

TIGHTEST_LOCAL_TOLERANCE = 1e-13
MAX_STEPS = 200_000
LOCAL_TOLERANCE_RATIO = 1e-3  # of the global tolerance: measured, the global error is up to several hundred local ones


def transition_by_cvodes(model: OdeModel, start: Array, numbers: Array, local: float, stiff: bool) -> Array:
    """Sensitivity of the flow to its start, shape (n, n); raises CvodesError.

    The `numbers` are parameters, the duration, and units of the components, which local tolerances are relative to.
    """
    units = numbers[-start.size :]
    found = run_cvodes(_sensitivities(model, local, stiff), start / units, numbers)["jac_xf_x0"]
    return np.asarray(np.array(found) * units[:, None] / units)


@kept_by_first
def _sensitivities(model: OdeModel, local: float, stiff: bool) -> ca.Function:
    """The flow of states in units over a time of 1, with its sensitivity: of parameters, duration and units."""
    kind, n = type(model.state), model.full_size
    s, y, p = kind.sym("s"), kind.sym("y", n), kind.sym("p", model.parameters.numel())
    duration, units = kind.sym("duration"), kind.sym("units", n)
    own = units if stiff else 1.0  # else all states have a size of 1
    rates = duration * model.field_at(duration * s, own * y, p) / own
    options = CvodesOptions(local, local, MAX_STEPS, stiff=stiff, sensitivity_errors=True)
    return options.transition("flow", {"t": s, "x": y, "p": ca.vertcat(p, duration, units), "ode": rates})


class CvodesFlow(FlowMap):
    """Transition matrix as the sensitivity of the flow of the nonlinear equations to its start; Adams, functional.

    The error is estimated by a second run with local tolerances ten times as large: the global error is about
    proportional to them. Local tolerances follow the tolerance down from the flow's own, by powers of ten.
    """

    def _matrix(self, orbit: OrbitState, local: float) -> Array:
        """Transition matrix; velocities of a brake orbit vanish at phase zero."""
        positions = orbit.problem.sample(orbit.z, np.zeros(1))[0]
        start = np.concatenate([positions, np.zeros(self.model.full_size - positions.size)])
        numbers = np.concatenate([[orbit.parameter], self.durations([orbit]), np.ones(start.size)])
        try:
            return transition_by_cvodes(self.model, start, numbers, local, stiff=False)
        except CvodesError as error:
            place = f"the orbit of Omega = {orbit.Omega:.10g}, parameter = {orbit.parameter:.10g}"
            raise FlowError(
                f"cvodes fails with a local tolerance of {local:.0e} along {place}: {error}; try a larger "
                "tolerance or flow splitting"
            ) from error

    def _transitions(self, orbits: Sequence[OrbitState], tolerance: float, alike: bool) -> list[Transition]:
        local = LOCAL_TOLERANCE_RATIO * self.tolerance
        if tolerance < self.tolerance:
            local = LOCAL_TOLERANCE_RATIO * 10.0 ** np.floor(np.log10(tolerance))
        return [self._estimated(orbit, max(float(local), TIGHTEST_LOCAL_TOLERANCE)) for orbit in orbits]

    def _estimated(self, orbit: OrbitState, local: float) -> Transition:
        fine, coarse = self._matrix(orbit, local), self._matrix(orbit, 10.0 * local)
        pair = None if orbit.better is None else (fine, self._matrix(orbit.better, local))
        difference = EXTRAPOLATION_SAFETY * (fine - coarse)
        return Transition(fine, self.fraction, float(np.linalg.norm(difference)), difference, pair)
