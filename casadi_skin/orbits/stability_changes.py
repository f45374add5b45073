"""Where stability changes between two orbits of a family, by root finding on corrected orbits."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.stability.result import Floquet

WIDTH = 1e-6  # of the bracket in S, or in S relative to the family's largest where that is below 1
FINEST = 1e-14  # of the way from one orbit to the next
TINY = 1e-300  # a gap of nothing, which still has its sign


@dataclass(frozen=True)
class StabilityChange:
    """A change of stability at S, with the bracket's width in S.

    `kind` is that of the instability on the unstable side, "real" or "complex"; `mu` is where on the mu axis it is
    born: -1 (where the energy has an extremum along the family) or 0 for a real one, the collision for a complex one.
    """

    S: float
    Omega: float
    kind: str
    stable_before: bool
    stable_after: bool
    mu: float
    S_width: float


class _NotFoundError(ArithmeticError):
    """The corrector does not find an orbit inside the bracket."""


class _Bracket:
    """Two orbits of different stability, the nearest found on either side of the change, and a function of the way.

    `gap` of a fraction of the way is analytic through the change, but for the choice of the mu that it is about: the
    squared distance of the two mu that meet, or the distance of one from the end of [-1, 0].
    """

    def __init__(self, point_solver: PointSolver, before: Orbit, after: Orbit) -> None:
        self._point_solver, self._ends = point_solver, (before, after)
        self.first, self.last, self.low, self.high = before, after, 0.0, 1.0

    @property
    def width(self) -> float:
        """Distance in S."""
        return abs(self.last.S - self.first.S)

    @property
    def unstable(self) -> Floquet:
        """Stability of the unstable end."""
        return (self.last if self.first.floquet().stable else self.first).floquet()

    def gap(self, fraction: float) -> float:
        """Positive where the stability is that of the start; raises _NotFoundError, FlowError."""
        before, after = self._ends
        if fraction in (0.0, 1.0):
            orbit = after if fraction else before
        else:
            point = self._point_solver.along(before.point, after.point, fraction)
            if point is None:
                raise _NotFoundError
            orbit = Orbit(before.tools, point)
        known = orbit.floquet()
        as_before = known.stable == before.floquet().stable
        if as_before and fraction > self.low:
            self.first, self.low = orbit, fraction
        elif not as_before and fraction < self.high:
            self.last, self.high = orbit, fraction
        size = _to_instability(known, self.unstable) if known.stable else _from_stability(known)
        return max(size, TINY) if as_before else -max(size, TINY)

    def close(self, width: float) -> None:
        """Narrow the bracket to a width in S: by the root of `gap`, then by halving what is left."""
        from scipy.optimize import brentq

        reach = width / max(self.width, width)  # of the way, if S went along evenly
        root = brentq(self.gap, 0.0, 1.0, xtol=0.2 * reach, rtol=FINEST)
        for fraction in (root - 0.4 * reach, root + 0.4 * reach):
            if self.low < fraction < self.high:
                self.gap(fraction)
        while self.width > width and self.high - self.low > FINEST:
            self.gap(0.5 * (self.low + self.high))


def _from_stability(unstable: Floquet) -> float:
    """Size of the instability that `_born` names, in the measure of `_Bracket.gap`."""
    mu, real = _born(unstable)
    error = float(unstable.mu_error[np.argmin(np.abs(unstable.mu - mu))])
    return abs(mu.real + 0.5) - 0.5 - error if real else 4.0 * mu.imag**2


def _to_instability(stable: Floquet, unstable: Floquet) -> float:
    """How far the mu of a stable orbit are from the instability of a near one, in the measure of `_Bracket.gap`."""
    mu, real = _born(unstable)
    if real:
        outwards = stable.mu.real if mu.real > -0.5 else -1.0 - stable.mu.real
        return float(np.min(stable.mu_error - outwards))
    values = np.sort(stable.mu.real)
    middles = 0.5 * (values[1:] + values[:-1])
    pair = int(np.argmin(np.abs(middles - mu.real)))
    return float(values[pair + 1] - values[pair]) ** 2


def _born(unstable: Floquet) -> tuple[complex, bool]:
    """The mu by which an orbit is unstable, and whether it is real; that farthest from the middle of [-1, 0]."""
    outside = np.flatnonzero(~unstable.is_inside)
    real = outside[unstable.is_real[outside]]
    chosen = real if real.size else outside
    return complex(unstable.mu[chosen[np.argmax(np.abs(unstable.mu[chosen] + 0.5))]]), real.size > 0


def locate_change(point_solver: PointSolver, before: Orbit, after: Orbit) -> StabilityChange:
    """Find the change of stability on the stretch of branch between two neighbouring orbits (Brent 1973).

    Where the corrector fails inside the bracket the change is given with the bracket reached (`S_width`). Raises
    FlowError from the flow map.
    """
    bracket = _Bracket(point_solver, before, after)
    with suppress(_NotFoundError):
        bracket.close(WIDTH * min(1.0, before.tools.request.amplitude_max))
    first, last = bracket.first, bracket.last
    mu, real = _born(bracket.unstable)
    return StabilityChange(
        S=0.5 * (first.S + last.S),
        Omega=0.5 * (first.Omega + last.Omega),
        kind="real" if real else "complex",
        stable_before=before.floquet().stable,
        stable_after=after.floquet().stable,
        mu=mu.real,
        S_width=abs(last.S - first.S),
    )
