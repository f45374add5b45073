"""Symplectic splitting of the variational flow: order 6, Runge-Kutta-Nystrom type, 11 stages (Blanes and Moan 2002).

For X'' = J(t) X with J = df/dq along the orbit, kicks V += b h J X and drifts X += a h V alternate; time moves with the
drifts. The map is symplectic to round-off at every step number, so that stable orbits do not acquire instabilities.
Several orbits go through the stages together, whatever their numbers of steps: their J are the blocks of one sparse
matrix.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import casadi as ca
import numpy as np

from casadi_skin.model.ode import OdeModel
from casadi_skin.native import kernels, transitions
from casadi_skin.stability.flows import JacobianAlong, SteppedFlow
from casadi_skin.zero.problem import Array

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


class SplittingMap:
    """Transition matrices of models of second order by the splitting in `steps` equal steps."""

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
        points, n = durations.size, jacobian.size
        matrix, scaled = jacobian.block_matrix(points), nonzeros * (h * h)[:, None, None]

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


class SplittingFlow(SteppedFlow):
    """Transition matrices by the splitting, extrapolated to order 8, for models of second order.

    Raises ValueError for a model that is not of second order with forces that depend on positions only.
    """

    method, step_numbers = "splitting", STEP_NUMBERS
    orders = (6, 8)

    def __init__(self, model: OdeModel, tolerance: float, frame: Array | None = None) -> None:
        if model.order != 2:
            raise ValueError(f"{model.name}: the splitting needs a model of second order; use cvodes")
        super().__init__(model, tolerance, frame)

    def _build(self, steps: int) -> SplittingMap:
        return SplittingMap(self.jacobian, steps)
