"""Flow maps of the variational system Phi' = J(q(t)) Phi along orbits: an orbit in, its transition matrix out.

Maps in equal steps: step numbers, extrapolation, an estimate of the error, and the choice of the steps. Beside them the
sensitivities of CVODES, which share nothing with these. Matrices have shape (orbits, m, m), m components of the state.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import groupby
from typing import Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.conserved import symmetry_class
from casadi_skin.model.integrators import CvodesError, CvodesOptions, run_cvodes
from casadi_skin.model.ode import OdeModel
from casadi_skin.stability.jacobian import JacobianAlong
from casadi_skin.stability.reduction import frobenius_norms
from casadi_skin.zero.problem import Array, Problem


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
    All of these matrices may be stored by the bands of their blocks, see `stability.banded`. `steps` is the number of
    equal steps, 0 of flows without such.
    """

    matrix: Array
    fraction: float
    error: float
    truncation: Array | None = None
    pair: tuple[Array, Array] | None = None
    steps: int = 0

    def blocks(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D of Phi = [[A, B], [C, D]], each (n, n)."""
        n = self.matrix.shape[0] // 2
        m = self.matrix
        return m[:n, :n], m[:n, n:], m[n:, :n], m[n:, n:]


class FlowMap(Protocol):
    """Computes transition matrices of the variational system along orbits of one model.

    `batch` is the number of orbits that are best given together: more cost no less each.
    """

    @property
    def batch(self) -> int: ...

    def transition(self, problem: Problem, z: Array) -> Transition:
        """Transition matrix along the orbit z of `problem`; raises FlowError where the tolerance is out of reach."""
        ...

    def transitions(
        self,
        orbits: Sequence[OrbitState],
        tolerance: float | None = None,
        banded: bool = False,
        alike: bool = False,
    ) -> list[Transition]:
        """Transition matrices along several orbits, to `tolerance` where it is not the flow's own.

        Where `banded`, those of long chains may be stored by the bands of their blocks, see `stability.banded`. Where
        `alike`, all are computed in one number of steps: their errors are smooth along a branch then. Raises FlowError
        where the tolerance is out of reach for any of them.
        """
        ...


class FlowError(ArithmeticError):
    """A flow map cannot reach its tolerance."""


def duration(orbit: OrbitState, fraction: float) -> float:
    """Time that a fraction of the orbit's period takes."""
    return 2.0 * np.pi * fraction / orbit.Omega


ROUND_OFF = 2e-14
EXTRAPOLATION_SAFETY = 2.0  # the difference that another extrapolation makes is asymptotically the error itself
BATCH_ENTRIES = 20_000  # entries of a batch of transition matrices: they stay in the cache of a core
TOLERANCE_HEADROOM = 3.0  # of the tolerance over the error expected, before fewer steps are tried


class StepMap(Protocol):
    """Transition matrices of the variational system in a fixed number of equal steps."""

    fractions: Array

    def __call__(self, nonzeros: Array, durations: Array) -> Array:
        """Matrices, shape (points, m, m), over `durations` (points,); J's non-zeros (points, fractions, non-zeros).

        J is taken at `fractions` of the duration; m counts the components of the full state.
        """
        ...


@cache
def extrapolation(steps: tuple[int, ...], orders: tuple[int, ...]) -> Array:
    """Weights, with sum 1, of results in those numbers of steps that cancel errors of the given orders in 1/steps."""
    rows = [[1.0] * len(steps), *([(steps[-1] / n) ** order for n in steps] for order in orders)]
    weights = np.linalg.solve(np.array(rows), np.eye(len(steps))[0])
    weights.flags.writeable = False  # kept and shared
    return weights


@cache
def _remainder(steps: tuple[int, ...], orders: tuple[int, ...]) -> float:
    """What extrapolation over those numbers of steps leaves of an error of the last order in 1/steps."""
    weights = extrapolation(steps, orders[:-1])
    return abs(float(np.sum(weights / np.array(steps, dtype=float) ** orders[-1])))


class SteppedFlow(ABC):
    """Transition matrices at neighbouring step numbers of a step_numbers, extrapolated (Richardson).

    The method's errors go with h^orders[0], h^orders[1], ... With one step number more than `orders` has entries, all
    maps together give a matrix without any of these errors, and all but the coarsest one without all but the last:
    that is the result, and the difference shows its error. The step numbers are chosen so that it meets the tolerance.
    The fraction of the period is that of the model's symmetry class. Raises FlowError when the most steps do not
    suffice.
    """

    method: str
    step_numbers: tuple[int, ...]
    orders: tuple[int, ...]

    def __init__(self, model: OdeModel, tolerance: float) -> None:
        self.model, self.tolerance = model, tolerance
        self.fraction = symmetry_class(model).value
        self._maps: dict[tuple[int, int | None], StepMap] = {}
        self._level = len(self.orders)  # of the finest map where the last orbits with `alike` met the tolerance

    @abstractmethod
    def _build(self, steps: int) -> StepMap:
        """The map with that many steps."""

    @cached_property
    def jacobian(self) -> JacobianAlong:
        """Derivative of the right-hand side along orbits."""
        return JacobianAlong(self.model)

    @property
    def batch(self) -> int:
        """Number of orbits that are best given together."""
        return max(1, BATCH_ENTRIES // self.model.full_size**2 * self.model.order)

    def _banded(self, steps: int, half_width: int) -> StepMap:
        """The map with that many steps to the bands of blocks; of flows that have a `half_width` alone."""
        raise NotImplementedError(self.method)

    def step_map(self, steps: int, half_width: int | None = None) -> StepMap:
        """The map with that many steps, built when first needed."""
        key = steps, half_width
        if key not in self._maps:
            self._maps[key] = self._build(steps) if half_width is None else self._banded(steps, half_width)
        return self._maps[key]

    def matrices(self, steps: int, orbits: Sequence[OrbitState]) -> Array:
        """Transition matrices in a fixed number of steps, not extrapolated, shape (orbits, m, m)."""
        return self.several([(steps, orbits)])[0]

    def half_width(self, orbits: Sequence[OrbitState]) -> int | None:
        """Half bandwidth of the blocks of these orbits' matrices; None where these are not stored by their bands."""
        return None

    def several(self, wanted: Sequence[tuple[int, Sequence[OrbitState]]], half_width: int | None = None) -> list[Array]:
        """Transition matrices in several numbers of steps, each along orbits of its own, as `matrices`."""
        found: list[Array] = []
        for _, group in groupby(wanted, key=lambda item: id(item[1])):  # orbits are sampled once for all their steps
            those = list(group)
            orbits, maps = those[0][1], [self.step_map(steps, half_width) for steps, _ in those]
            nonzeros = self._linearised(orbits, np.concatenate([step_map.fractions for step_map in maps]))
            ends = np.cumsum([step_map.fractions.size for step_map in maps])[:-1]
            durations = self._durations(orbits)
            parts = zip(maps, np.split(nonzeros, ends, axis=1), strict=True)
            found += [step_map(part, durations) for step_map, part in parts]
        return found

    def _durations(self, orbits: Sequence[OrbitState]) -> Array:
        """Times that the fraction of the period takes, shape (orbits,)."""
        return np.array([duration(orbit, self.fraction) for orbit in orbits])

    def _linearised(self, orbits: Sequence[OrbitState], fractions: Array) -> Array:
        """J's non-zeros at fractions of the duration, shape (orbits, fractions, non-zeros)."""
        theta, done = 2.0 * np.pi * self.fraction * fractions, 0
        found = np.empty((len(orbits), theta.size, self.jacobian.indices.size))
        for problem, those in groupby(orbits, key=lambda orbit: orbit.problem):
            z = np.stack([orbit.z for orbit in those])
            self.jacobian.along(problem, z, theta, found[done : done + len(z)])
            done += len(z)
        return found

    def transition(self, problem: Problem, z: Array) -> Transition:
        """Transition matrix of the full state along the orbit."""
        return self.transitions([OrbitState(problem, z)])[0]

    def transitions(
        self,
        orbits: Sequence[OrbitState],
        tolerance: float | None = None,
        banded: bool = False,
        alike: bool = False,
    ) -> list[Transition]:
        """Transition matrices of the full state along several orbits; raises FlowError where one cannot be had."""
        allowed = self.tolerance if tolerance is None else tolerance
        results = self._in_batches(orbits, allowed, banded, self._level if alike else len(self.orders))
        while alike and len({found.steps for found in results}) > 1:
            most = max(found.steps for found in results)
            fewer = [i for i, found in enumerate(results) if found.steps < most]
            again = self._in_batches([orbits[i] for i in fewer], allowed, banded, self.step_numbers.index(most))
            for i, found in zip(fewer, again, strict=True):
                results[i] = found
        if alike and results:
            level = self.step_numbers.index(results[0].steps)
            self._level = self._lower(level, max(found.error for found in results), allowed)
        return results

    def _in_batches(self, orbits: Sequence[OrbitState], tolerance: float, banded: bool, level: int) -> list[Transition]:
        """Those of several orbits, batch by batch; each begins with the `level`."""
        results: list[Transition] = []
        for first in range(0, len(orbits), self.batch):
            part = orbits[first : first + self.batch]
            half_width = self.half_width(part) if banded else None
            results += self._adapted(part, tolerance, half_width, min(level, len(self.step_numbers) - 1))
        return results

    def _adapted(
        self, orbits: Sequence[OrbitState], tolerance: float, half_width: int | None, level: int
    ) -> list[Transition]:
        """One batch, with more steps for those that need more: how many, an orbit's own errors decide.

        The digits of an orbit then depend neither on the others given with it nor on those before.
        """
        done: dict[int, Transition] = {}
        waiting: list[tuple[int, NDArray[np.int64], dict[int, Array]]] = [(level, np.arange(len(orbits)), {})]
        while waiting:
            level, places, maps = waiting.pop()
            those = [orbits[i] for i in places.tolist()]
            levels = range(level - len(self.orders), level + 1)
            missing = [r for r in levels if r not in maps]
            found = self.several([(self.step_numbers[r], those) for r in missing], half_width)
            maps |= dict(zip(missing, found, strict=True))
            matrices, errors = self._extrapolated(level, maps)
            with np.errstate(over="ignore", invalid="ignore"):
                truncation, round_off = frobenius_norms(errors), ROUND_OFF * frobenius_norms(matrices)
            met = truncation <= np.maximum(tolerance, round_off)
            pairs = self._pairs(those, met, self.step_numbers[levels[0]], maps[levels[0]], half_width)
            for k in np.flatnonzero(met).tolist():
                total = float(truncation[k] + round_off[k])
                known = matrices[k], self.fraction, total, errors[k], pairs.get(k)
                done[int(places[k])] = Transition(*known, self.step_numbers[level])
            if not met.all():
                worst = int(np.argmax(np.where(met, -np.inf, truncation)))
                place = _place(those[worst], errors[worst], self.model.size)
                higher = np.full(len(those), level)
                higher[~met] = [self._higher(level, t, tolerance, place) for t in truncation[~met].tolist()]
                for above in np.unique(higher[~met]).tolist():
                    group = higher == above
                    waiting.append((above, places[group], {r: m[group] for r, m in maps.items()}))
        return [done[i] for i in range(len(orbits))]

    def _extrapolated(self, level: int, maps: Mapping[int, Array]) -> tuple[Array, Array]:
        """Extrapolated matrices, and matrices like their errors."""
        levels = range(level - len(self.orders), level + 1)
        steps = tuple(self.step_numbers[r] for r in levels)
        few, all_ = extrapolation(steps[1:], self.orders[:-1]), extrapolation(steps, self.orders)
        found = [maps[r] for r in levels]
        return _combined(found[1:], few), _combined(found, EXTRAPOLATION_SAFETY * (all_ - np.append(0.0, few)))

    def _pairs(
        self, orbits: Sequence[OrbitState], met: NDArray[np.bool_], steps: int, maps: Array, half_width: int | None
    ) -> dict[int, tuple[Array, Array]]:
        """Matrices in so many steps along the orbits that are `met` and along the better ones, by place."""
        better = {k: better for k in np.flatnonzero(met).tolist() if (better := orbits[k].better) is not None}
        if not better:
            return {}
        (found,) = self.several([(steps, list(better.values()))], half_width)
        return {k: (maps[k], matrix) for k, matrix in zip(better, found, strict=True)}

    def _leading(self, level: int) -> float:
        """The error of a level per the method's error of the order that remains, in a step over all the time."""
        return _remainder(self.step_numbers[level - len(self.orders) + 1 : level + 1], self.orders)

    def _lower(self, level: int, truncation: float, tolerance: float) -> int:
        """The level to start from next time: one lower where that would have done for one orbit.

        An orbit for which it does not do costs little: its maps are used again on the next level.
        """
        if level == len(self.orders):
            return level
        expected = truncation * self._leading(level - 1) / self._leading(level)
        return level - 1 if TOLERANCE_HEADROOM * expected <= tolerance else level

    def _higher(self, level: int, truncation: float, tolerance: float, place: str) -> int:
        """The level that should do where one did not; raises FlowError at the end of the step_numbers."""
        steps = self.step_numbers[level]
        if level + 1 == len(self.step_numbers):
            raise FlowError(
                f"the {self.method} leaves {truncation:.1e} with {steps} steps; requested: {tolerance:.1e}; worst "
                f"{place}; try a larger tolerance or another flow (splitting, cvodes)"
            )
        if not np.isfinite(truncation):
            return level + 1
        allowed, above = self._leading(level) * tolerance / truncation, range(level + 1, len(self.step_numbers))
        return next((r for r in above if self._leading(r) <= allowed), level + 1)


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
MAX_STEPS = 100_000
LOCAL_TOLERANCE_RATIO = (
    1e-3  # local tolerance per global tolerance: measured, the global error is up to several hundred local ones
)


class CvodesFlow:
    """Transition matrix as the sensitivity of the flow of the nonlinear equations to its start; Adams, functional.

    The error is estimated by a second run with local tolerances ten times as large: the global error is about
    proportional to them. Raises FlowError where CVODES fails.
    """

    batch = 1

    def __init__(self, model: OdeModel, tolerance: float) -> None:
        self.model, self.tolerance = model.first_order(), tolerance
        self.fraction = symmetry_class(model).value
        self._functions: dict[float, ca.Function] = {}

    def _function(self, local: float) -> ca.Function:
        """Sensitivity of the flow at a local tolerance, built when first needed."""
        if local not in self._functions:
            self._functions[local] = self._build(local)
        return self._functions[local]

    def _build(self, local: float) -> ca.Function:
        model, time = self.model, ca.SX.sym("time")
        dae = {"x": model.state, "p": ca.vertcat(model.parameters, time), "ode": time * model.rhs}
        return CvodesOptions(local, local, MAX_STEPS, sensitivity_errors=True).transition("flow", dae)

    def _matrix(self, orbit: OrbitState, local: float) -> Array:
        """Transition matrix; velocities of a brake orbit vanish at phase zero."""
        positions = orbit.problem.sample(orbit.z, np.zeros(1))[0]
        start = np.concatenate([positions, np.zeros(self.model.size - positions.size)])
        parameters = np.array([orbit.parameter, duration(orbit, self.fraction)])
        try:
            return np.array(run_cvodes(self._function(local), start, parameters)["jac_xf_x0"])
        except CvodesError as error:
            place = f"the orbit of Omega = {orbit.Omega:.10g}, parameter = {orbit.parameter:.10g}"
            raise FlowError(
                f"cvodes fails with a local tolerance of {local:.0e} along {place}: {error}; try a larger "
                "tolerance or flow splitting"
            ) from error

    def transition(self, problem: Problem, z: Array) -> Transition:
        """Transition matrix of the full state along the orbit."""
        return self.transitions([OrbitState(problem, z)])[0]

    def transitions(
        self,
        orbits: Sequence[OrbitState],
        tolerance: float | None = None,
        banded: bool = False,
        alike: bool = False,
    ) -> list[Transition]:
        """Transition matrices along several orbits; local tolerances follow `tolerance` down, by powers of ten."""
        local = LOCAL_TOLERANCE_RATIO * self.tolerance
        if tolerance is not None and tolerance < self.tolerance:
            local = LOCAL_TOLERANCE_RATIO * 10.0 ** np.floor(np.log10(tolerance))
        local = max(float(local), TIGHTEST_LOCAL_TOLERANCE)
        return [self._estimated(orbit, local) for orbit in orbits]

    def _estimated(self, orbit: OrbitState, local: float) -> Transition:
        fine, coarse = self._matrix(orbit, local), self._matrix(orbit, 10.0 * local)
        pair = None if orbit.better is None else (fine, self._matrix(orbit.better, local))
        difference = EXTRAPOLATION_SAFETY * (fine - coarse)
        return Transition(fine, self.fraction, float(np.linalg.norm(difference)), difference, pair)


# Flow maps across the free motions of a model: what a conserved momentum makes trivial is taken out of every map ------


def complement(directions: Array) -> Array:
    """Orthonormal columns that span what is orthogonal to the columns of (n, m), m < n."""
    return np.asarray(np.linalg.qr(directions, mode="complete")[0][:, directions.shape[1] :])


def relative(transition: Transition, frame: Array) -> Transition:
    """A transition matrix with all that estimates its errors, across what the columns of a frame leave out."""

    def across(matrix: Array) -> Array:
        n, size = frame.shape
        blocks = matrix.reshape(2, n, 2, n).swapaxes(1, 2)
        return np.asarray((frame.T @ blocks @ frame).swapaxes(1, 2).reshape(2 * size, 2 * size))

    pair, truncation = transition.pair, transition.truncation
    return replace(
        transition,
        matrix=across(transition.matrix),
        truncation=None if truncation is None else across(truncation),
        pair=None if pair is None else (across(pair[0]), across(pair[1])),
    )


@dataclass(frozen=True)
class RelativeFlow:
    """A flow map of relative positions, the `frame` of which has orthonormal columns; see `FlowMap`."""

    flow: FlowMap
    frame: Array

    @property
    def batch(self) -> int:
        return self.flow.batch

    def transition(self, problem: Problem, z: Array) -> Transition:
        return relative(self.flow.transition(problem, z), self.frame)

    def transitions(
        self, orbits: Sequence[OrbitState], tolerance: float | None = None, banded: bool = False, alike: bool = False
    ) -> list[Transition]:
        found = self.flow.transitions(orbits, tolerance, alike=alike)
        return [relative(transition, self.frame) for transition in found]
