"""The splitting SRKN11b of order 6 (Blanes and Moan 2002): its coefficients, and its sequence of kicks and drifts.

For q'' = f(q), kicks v += b h f(q) and drifts q += a h v alternate; a kick begins and ends each step. The map is
symplectic where f is a gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import casadi as ca
import numpy as np

from casadi_skin.lattice.uniform_chain import Array
from casadi_skin.model.ode import OdeModel

ORDER = 6

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
