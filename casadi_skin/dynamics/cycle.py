"""The cycle that a time evolution settles on: a guess for an orbit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.bvp.problem import Array
from casadi_skin.dynamics.evolution import Evolution

FEWEST = 40  # output times that a cycle is looked for in
CLOSED = 0.02  # distance of two states a cycle apart, relative to the cycle's size


@dataclass(frozen=True, eq=False)
class Cycle:
    """A stretch of a time evolution after which it repeats itself: a guess for `find_orbit`, period included."""

    evolution: Evolution
    start: float
    period: float

    def evaluate(self, t: ArrayLike) -> Array:
        """States at times from the start of the cycle on, shape (time, component)."""
        times = np.mod(np.atleast_1d(np.asarray(t, dtype=float)), self.period)
        return self.evolution.evaluate(np.clip(self.start + times, self.start, self.evolution.t[-1]))


def last_cycle(evolution: Evolution) -> Cycle:
    """The last stretch of time over which the state comes back to itself; raises ValueError where it does not."""
    t, states = evolution.t, evolution.states
    if t.size < FEWEST:
        raise ValueError(f"last_cycle: given {t.size} output times; accepted: {FEWEST} or more, 20 a cycle")
    half = states[t.size // 2 :]
    spread = np.ptp(half, axis=0)
    component = int(np.argmax(np.std(half, axis=0)))
    level = float(np.mean(half[:, component]))
    below = states[:, component] < level
    up = np.flatnonzero(below[:-1] & ~below[1:])
    for earlier in up[-2::-1]:
        start, end = (_crossing(evolution, i, component, level) for i in (earlier, up[-1]))
        gap = np.abs(evolution.evaluate(start) - evolution.evaluate(end))[0]
        if np.all(gap <= CLOSED * np.maximum(spread, 1e-9 * spread.max())):
            return Cycle(evolution, start, end - start)
    raise ValueError(f"last_cycle: from t = {t[0]:g} to {t[-1]:g} the state does not come back to itself")


def _crossing(evolution: Evolution, i: int, component: int, level: float) -> float:
    """The time between two output times at which a component has a value."""
    from scipy.optimize import brentq

    curve = evolution.curve
    return float(brentq(lambda t: curve(t)[component] - level, evolution.t[i], evolution.t[i + 1]))
