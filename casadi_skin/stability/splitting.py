"""Symplectic splitting of the variational flow: order 6, Runge-Kutta-Nystrom type, 11 stages (Blanes and Moan 2002).

For X'' = J(t) X with J = df/dq along the orbit, kicks V += b h J X and drifts X += a h V alternate; time moves with the
drifts. The map is symplectic to round-off at every step number, so that stable orbits do not acquire instabilities.
Several orbits go through the stages together, whatever their numbers of steps: their J are the blocks of one sparse
matrix, and those that are done are left behind. Columns go by themselves where all together would leave the cache.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby
from typing import TYPE_CHECKING, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.ode import OdeModel
from casadi_skin.native import LANES, Sequences, flows, kernels, transitions
from casadi_skin.stability.flows import OrbitState, SteppedFlow
from casadi_skin.stability.jacobian import JacobianAlong, repeated
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from scipy.sparse import csr_array


# The splitting SRKN11b of order 6 (Blanes and Moan 2002): its coefficients, and its sequence of kicks and drifts ------

SPLITTING_ORDER = 6

T = TypeVar("T")


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
STEP_NUMBERS = (3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512)
SPARE_REACH = 2  # components by which the reach of other numbers of steps may be larger
ALIKE_PARTS = 2  # parts with the same J around them that columns are cut into, at least, in multiples of their reach
LONG_CHAIN_COMPONENTS = 128  # components of chains from which on the bands of transition matrices may be stored
CACHED_NUMBERS = 64_000  # numbers of X that stay in the cache of a core, with V and a product of one shape


@dataclass(frozen=True, eq=False)
class SplittingRun:
    """Some orbits in one number of steps: J's non-zeros at all kicks times h^2 and the kick, and the steps h.

    `stages` has shape (kicks, points, non-zeros), `steps` (points,).
    """

    stages: Array
    steps: Array


class SplittingMap:
    """Transition matrices of models of second order by the splitting in `steps` equal steps.

    With a half bandwidth w, which needs the compiled kernel, the bands of their blocks: (points, 2n, 2(2w + 1)).
    """

    def __init__(self, jacobian: JacobianAlong, steps: int, half_width: int | None = None) -> None:
        self.jacobian, self.steps, self.half_width = jacobian, steps, half_width
        self.sequence = KicksAndDrifts.of(steps)
        self.fractions = self.sequence.times / steps

    def run(self, nonzeros: Array, durations: Array) -> SplittingRun:
        """Data for `propagated`, from J's non-zeros (points, len(fractions), non-zeros)."""
        h = durations / self.steps
        weights = self.sequence.kicks[:, None, None] * (h * h)[:, None]
        return SplittingRun(np.multiply(nonzeros.swapaxes(0, 1), weights, order="C"), h)

    def __call__(self, nonzeros: Array, durations: Array) -> Array:
        """Transition matrices, shape (points, 2n, 2n), from J's non-zeros (points, len(fractions), non-zeros)."""
        if not kernels():
            return propagated(self.jacobian, self.sequence.drifts, [self.run(nonzeros, durations)])[0]
        jacobian, sequence = self.jacobian, self.sequence
        pattern, stages = (jacobian.indptr, jacobian.indices), (sequence.kicks, sequence.drifts)
        reach = jacobian.half_bandwidth
        far = reach * sequence.kicks.size
        if far < jacobian.size:
            far = self.reach(nonzeros, durations)
        far = min(far, jacobian.size if self.half_width is None else self.half_width + 1 - LANES)
        return transitions(pattern, (reach, far), stages, durations / self.steps, nonzeros, self.half_width)

    def reach(self, nonzeros: Array, durations: Array) -> int:
        """How far entries that are not negligible are from the diagonals of the blocks."""
        return _reach(self.jacobian, self.sequence.drifts, [self.run(nonzeros, durations)])


def propagated(jacobian: JacobianAlong, drifts: Array, runs: Sequence[SplittingRun]) -> list[Array]:
    """Transition matrices of several runs, each (points, 2n, 2n), by the drifts of the one with most steps.

    A kick reaches as far as J's band: what is farther from a column's component than kicks carry more than rounding
    stays zero, and is left out. Columns with the same J around them, as in a linear tail, are the same: they are
    computed once.
    """
    n, order = jacobian.size, sorted(range(len(runs)), key=lambda i: -len(runs[i].stages))
    ordered = [runs[i] for i in order]
    points, reach = sum(run.steps.size for run in runs), _reach(jacobian, drifts, ordered)
    width = n
    while width > 1 and points * min(n, width + 2 * reach) * 2 * width > CACHED_NUMBERS:
        width = (width + 1) // 2
    while width > ALIKE_PARTS * reach > 0 and n > ALIKE_PARTS * width:
        width = (width + 1) // 2
    result = np.zeros((points, 2, n, 2 * n))
    known: tuple[object, ...] = ()
    found, steps = np.empty(0), np.concatenate([run.steps for run in ordered])
    for start in range(0, n, width):
        end = min(n, start + width)
        first, last = max(0, start - reach), min(n, end + reach)
        inside, indices, indptr = jacobian.window(first, last)
        stages = [run.stages[..., inside] for run in ordered]
        here = (start - first, end - start, indices.tobytes(), indptr.tobytes(), *(part.tobytes() for part in stages))
        if here != known:
            kicks, h = _kicks(stages, indices, indptr), np.repeat(steps, last - first)
            found, known = _columns(kicks, drifts, h, last - first, start - first, end - start), here
        result[:, :, first:last, start:end] = found[..., : end - start]
        result[:, :, first:last, n + start : n + end] = found[..., end - start :]
    ends = np.cumsum([run.steps.size for run in ordered])
    parts = np.split(result.reshape(-1, 2 * n, 2 * n), ends[:-1])
    return [part for _, part in sorted(zip(order, parts, strict=True), key=lambda item: item[0])]


def _reach(jacobian: JacobianAlong, drifts: Array, runs: Sequence[SplittingRun]) -> int:
    """Components to either side of its own in which a column is not negligible.

    At a distance of k kicks an entry is a sum of products of k kicks between different components and the drifts
    between: with the sums K and D of their norms at most (K D)^k / (k! k^k), as the drifts are k parts of D. Other
    kicks between these, with L as the sum of all, make it no more than exp(2 sqrt(L D)) times larger.
    """
    most, starts, across = len(runs[0].stages), jacobian.indptr[:-1], jacobian.rows() != jacobian.indices
    if np.any(np.diff(jacobian.indptr) == 0) or most * jacobian.half_bandwidth >= jacobian.size:
        return most * jacobian.half_bandwidth
    sums = np.zeros(2)
    for run in runs:
        largest = np.max(np.abs(run.stages), axis=1)
        rows = [np.add.reduceat(part, starts, axis=1) for part in (largest * across, largest)]
        sums = np.maximum(sums, np.sum(np.max(rows, axis=2), axis=1))
    K, L = sums * float(np.sum(np.abs(drifts)))
    k = np.arange(1.0, most + 1.0)
    logs = k * (np.log(max(K, TINY_NUMBER)) - np.log(k)) - np.cumsum(np.log(k)) + 2.0 * np.sqrt(L)
    falling = np.append(np.diff(logs) < -1.0, True)  # then those beyond add up to less than twice the first
    small = np.flatnonzero((logs < np.log(NEGLIGIBLE_ENTRY)) & falling)
    return jacobian.half_bandwidth * (int(k[small[0]]) if small.size else most)


def _kicks(
    stages: Sequence[Array], indices: NDArray[np.int32], indptr: NDArray[np.int32]
) -> list[tuple[csr_array, Array]]:
    """The matrix of each kick and its data, of the runs that are not done yet, from their J (kicks, points, nz)."""
    done, kicks = 0, []
    for active in range(len(stages), 0, -1):
        start, done = done, len(stages[active - 1])
        if done > start:
            parts = [part[start:done].reshape(done - start, -1) for part in stages[:active]]
            matrix = repeated(indices, indptr, sum(part.shape[1] for part in stages[:active]))
            kicks += [(matrix, data) for data in np.concatenate(parts, axis=1)]
    return kicks


def _columns(
    kicks: Sequence[tuple[csr_array, Array]], drifts: Array, h: Array, n: int, first: int, count: int
) -> Array:
    """States that grow from unit positions, then velocities, of some components: shape (points, 2, n, 2 count).

    `h` is the step of each row.
    """
    # Velocities are multiplied by the step h, so that no orbit's step is in the drifts.
    state = np.zeros((2, h.size, 2 * count))
    for k in range(count):
        state[0, first + k :: n, k] = 1.0
        state[1, first + k :: n, count + k] = h[first + k :: n]
    x, v = state
    moved = np.empty_like(x)
    for i, (matrix, data) in enumerate(kicks):
        matrix.data, rows = data, matrix.shape[0]
        if i > 0:
            np.multiply(v[:rows], drifts[i - 1], out=moved[:rows])
            x[:rows] += moved[:rows]
        v[:rows] += matrix @ x[:rows]
    v /= h[:, None]
    return state.reshape(2, -1, n, 2 * count).swapaxes(0, 1)


class SplittingFlow(SteppedFlow):
    """Transition matrices by the splitting, extrapolated to order 8, for models of second order.

    Raises ValueError for a model that is not of second order with forces that depend on positions only.
    """

    method, step_numbers = "splitting", STEP_NUMBERS
    orders = (6, 8)

    def __init__(self, model: OdeModel, tolerance: float) -> None:
        if model.order != 2:
            raise ValueError(f"{model.name}: the splitting needs a model of second order; use cvodes")
        super().__init__(model, tolerance)
        self._known: dict[tuple[int, ...], tuple[Sequences, Array]] = {}

    def _build(self, steps: int) -> SplittingMap:
        return SplittingMap(self.jacobian, steps)

    def _banded(self, steps: int, half_width: int) -> SplittingMap:
        return SplittingMap(self.jacobian, steps, half_width)

    def _splitting(self, steps: int) -> SplittingMap:
        found = self.step_map(steps)
        assert isinstance(found, SplittingMap)
        return found

    def half_width(self, orbits: Sequence[OrbitState]) -> int | None:
        if not kernels() or self.model.size <= LONG_CHAIN_COMPONENTS:
            return None
        coarse = self._splitting(
            STEP_NUMBERS[0]
        )  # all numbers of steps reach as far: the sums of their kicks and drifts agree
        width = (
            coarse.reach(self._linearised(orbits, coarse.fractions), self._durations(orbits)) + SPARE_REACH + LANES - 1
        )
        return width if 2 * width + 1 < self.model.size // 2 else None

    def several(self, wanted: Sequence[tuple[int, Sequence[OrbitState]]], half_width: int | None = None) -> list[Array]:
        """As that of other flows; without a compiled kernel all at once where they fit into the cache."""
        if kernels():
            found = None if half_width is not None else self._sampled_inside(wanted)
            return found or super().several(wanted, half_width)
        maps = [self._splitting(steps) for steps, _ in wanted]
        runs = [
            step_map.run(self._linearised(orbits, step_map.fractions), self._durations(orbits))
            for step_map, (_, orbits) in zip(maps, wanted, strict=True)
        ]
        most = max(maps, key=lambda step_map: step_map.steps).sequence.drifts
        if sum(run.steps.size for run in runs) * 2 * self.model.size**2 <= CACHED_NUMBERS:
            return propagated(self.jacobian, most, runs)
        return [propagated(self.jacobian, most, [run])[0] for run in runs]

    def _sampled_inside(self, wanted: Sequence[tuple[int, Sequence[OrbitState]]]) -> list[Array] | None:
        """As `several` by a kernel that samples J orbit by orbit, whose J stays in the cache then.

        None where it cannot, and where kicks do not reach through the whole chain.
        """
        jacobian, found = self.jacobian, list[Array]()
        for _, group in groupby(wanted, key=lambda item: id(item[1])):
            those = list(group)
            sequences, phases = self._sequences(tuple(steps for steps, _ in those))
            if int(min(sequences[0])) * jacobian.half_bandwidth < jacobian.size:
                return None
            orbits, done = those[0][1], 0
            lengths = self._durations(orbits) / np.array([[steps] for steps, _ in those])
            result = np.empty((*lengths.shape, 2 * jacobian.size, 2 * jacobian.size))
            pattern = jacobian.indptr, jacobian.indices
            for problem, some in groupby(orbits, key=lambda orbit: orbit.problem):
                z = np.stack([orbit.z for orbit in some])
                sampled, part = jacobian.orbits(problem, z, phases), slice(done, done + len(z))
                if sampled is None:
                    return None
                flows(sampled, pattern, jacobian.half_bandwidth, sequences, lengths[:, part], result[:, part])
                done += len(z)
            found.extend(result)
        return found

    def _sequences(self, numbers: tuple[int, ...]) -> tuple[Sequences, Array]:
        """Kicks and drifts in several numbers of steps, one after the other, and the phases of the kicks."""
        if numbers not in self._known:
            maps = [self._splitting(steps) for steps in numbers]
            counts = np.array([each.sequence.kicks.size for each in maps])
            parts = ([each.sequence.kicks, each.sequence.drifts, each.fractions] for each in maps)
            kicks, drifts, fractions = (np.concatenate(part) for part in zip(*parts, strict=True))
            self._known[numbers] = (counts, kicks, drifts), 2.0 * np.pi * self.fraction * fractions
        return self._known[numbers]
