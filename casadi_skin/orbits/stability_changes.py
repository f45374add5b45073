"""Changes of stability between two orbits of a branch, by root finding on corrected orbits."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.orbits.space import SolutionSpace
from casadi_skin.stability.result import Floquet

if TYPE_CHECKING:
    from casadi_skin.orbits.solution import Solution

WIDTH = 1e-6  # of the bracket in the continuation parameter
FINEST = 1e-14  # of the way from one orbit to the next
TINY = 1e-300  # a gap of nothing, which still has its sign


@dataclass(frozen=True)
class StabilityChange:
    """A change of stability between two solutions of a branch that is no family (see `StabilityEdge`).

    Attributes:
        value: of the quantity that the branch is followed in.
        Omega: frequency there; of a boundary-value problem 2 pi over the length of its interval.
        kind: that of the instability on the unstable side, "real" or "complex".
        stable_before, stable_after: in the order of the branch.
        angle: of the multiplier by which the unstable side is unstable, in [0, pi]: pi where a period doubles.
        error: width of the bracket, in what the branch is followed in, and what the multiplier's error adds to it.
    """

    value: float
    Omega: float
    kind: str
    stable_before: bool
    stable_after: bool
    angle: float
    error: float


class _NotFoundError(ArithmeticError):
    """The corrector does not find the orbit at a fraction of the way."""

    def __init__(self, fraction: float) -> None:
        super().__init__(fraction)
        self.fraction = fraction


class _Bracket:
    """Two orbits of different stability, the nearest found on either side of the change, and a function of the way.

    `gap` of a fraction of the way is analytic through the change, but for the choice of its multiplier.
    """

    def __init__(self, space: SolutionSpace, before: Solution, after: Solution) -> None:
        self._space, self._ends = space, (before, after)
        self.first, self.last, self.low, self.high = before, after, 0.0, 1.0

    def value(self, orbit: Solution) -> float:
        """Place of an orbit along the branch."""
        return self._space.value(self._space.parameter, orbit.point)

    @property
    def width(self) -> float:
        """Distance in the continuation parameter."""
        return abs(self.value(self.last) - self.value(self.first))

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
            point = self._space.point_solver.along(before.point, after.point, fraction)
            if point is None:
                raise _NotFoundError(fraction)
            orbit = type(before)(before.space, point)
        found = orbit.floquet()
        as_before = found.stable == before.floquet().stable
        if as_before and fraction > self.low:
            self.first, self.low = orbit, fraction
        elif not as_before and fraction < self.high:
            self.last, self.high = orbit, fraction
        size = max(abs(found.max_abs_multiplier - 1.0), TINY)
        return size if as_before else -size

    def close(self, width: float) -> None:
        """Narrow the bracket to a width: by the root of `gap`, then by bisection."""
        from scipy.optimize import brentq

        reach = width / max(self.width, width)  # of the way, if the branch went along evenly
        try:
            root = brentq(self.gap, 0.0, 1.0, xtol=0.2 * reach, rtol=FINEST)
        except _NotFoundError as error:  # another branch leaves where stability changes, and no orbit is alone there
            root = error.fraction
        for off in (-0.4 * reach, 0.4 * reach):
            self._beside(root, off)
        while self.width > width and self.high - self.low > FINEST:
            self.gap(0.5 * (self.low + self.high))

    def _beside(self, fraction: float, off: float) -> None:
        """Narrow the bracket to an orbit a little off a fraction of the way, or farther off where none is found."""
        while self.low < fraction + off < self.high:
            try:
                self.gap(fraction + off)
            except _NotFoundError:
                off *= 2.0
            else:
                return


def locate_change(space: SolutionSpace, before: Solution, after: Solution) -> StabilityChange:
    """Find the change of stability on the stretch of branch between two neighbouring orbits (Brent 1973).

    Where the corrector fails inside the bracket the change is given with the bracket reached. Raises FlowError from
    the flow map.
    """
    bracket = _Bracket(space, before, after)
    with suppress(_NotFoundError):
        bracket.close(WIDTH)
    first, last = bracket.first, bracket.last
    others = bracket.unstable.others[bracket.unstable.outside]
    multiplier = complex(others[np.argmax(np.abs(others))])
    value = 0.5 * (bracket.value(first) + bracket.value(last))
    far = after if before.floquet().stable else before
    beyond = abs(far.floquet().max_abs_multiplier - 1.0)
    moved = bracket.unstable.error * abs(bracket.value(far) - value) / max(beyond, TINY)
    return StabilityChange(
        value=value,
        Omega=0.5 * (_frequency(first) + _frequency(last)),
        kind="complex" if multiplier.imag else "real",
        stable_before=before.floquet().stable,
        stable_after=after.floquet().stable,
        angle=abs(float(np.angle(multiplier))),
        error=bracket.width + min(moved, abs(bracket.value(after) - bracket.value(before))),
    )


def _frequency(solution: Solution) -> float:
    start, end = solution.interval
    return float(getattr(solution, "Omega", 2.0 * np.pi / (end - start)))
