"""The account of a branch of orbits: its events in order, and the changes of stability that follow from them.

At each orbit the number n_u of multipliers outside the unit circle is known within errors. The jumps of the events
between two orbits account for its change; stability changes where n_u becomes 0 or leaves it, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.events import KREIN, Event, events_between
from casadi_skin.follow.exponents import Exponents
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.special_points import DOUBLING, TORUS
from casadi_skin.solve.watch import TimeLimitError
from casadi_skin.zero.unresolved import Unresolved

BESIDE_SPECIAL = 1e-2  # of the way from a special orbit to the next one: where its own multiplier has a side


@dataclass(frozen=True)
class StabilityChange:
    """A change of stability between two solutions of a branch that is no family (see `StabilityEdge`).

    Attributes:
        value: of the quantity that the branch is followed in.
        Omega: frequency there; of a boundary-value problem 2 pi over the length of its interval.
        kind: that of the instability on the unstable side, "real" or "complex".
        stable_before, stable_after: in the order of the branch.
        angle: of the multiplier that crosses the unit circle, in [0, pi]: pi where a period doubles.
        error: estimated error of `value`.
    """

    value: float
    Omega: float
    kind: str
    stable_before: bool
    stable_after: bool
    angle: float
    error: float


class Ledger:
    """The account of one branch, which is kept as its solutions come in order.

    Attributes:
        changes: changes of stability.
        unresolved: stretches on which the account does not balance.
    """

    def __init__(self, space: BoundarySpace) -> None:
        self.space = space
        self.changes: list[StabilityChange] = []
        self.unresolved: list[Unresolved] = []
        self._count: int | None = None  # n_u behind the last solution; None where it is not known

    def between(self, before: Solution, after: Solution, leaving: bool = False) -> Iterator[Solution]:
        """Special orbits between two solutions in order; their changes of stability are entered.

        Arguments:
            before, after: neighbours on the branch, which may be special orbits themselves.
            leaving: whether the branch leaves a special point at the first of them.
        """
        try:
            yield from self._between(before, after, leaving)
        except TimeLimitError as error:
            self._count = None
            self._name(before, after, str(error))

    def _between(self, before: Solution, after: Solution, leaving: bool) -> Iterator[Solution]:
        """The same; raises TimeLimitError."""
        first = self._beside(before, after, BESIDE_SPECIAL) if before.point.special or leaving else before
        last = self._beside(before, after, 1.0 - BESIDE_SPECIAL) if after.point.special else after
        if first is None or last is None:
            self._count = None
            self._name(before, after, f"no orbit is found beside the special one: {self.space.point_solver.failure}")
            return
        start, open_at_start = Exponents.from_floquet(first.floquet()).outside
        if before.point.special and not leaving and self._count is not None:
            self._passed(before, self._count, start, _angle_of(before))
        self._count = start
        known = len(self.unresolved)
        for event in events_between(self.space, first, last):
            if isinstance(event, Unresolved):
                self.unresolved.append(event)
                continue
            self._enter(event)
            if event.kind != KREIN:
                yield event.solution
        end, open_at_end = Exponents.from_floquet(last.floquet()).outside
        if len(self.unresolved) == known and abs(end - self._count) > min(open_at_start, open_at_end):
            words = f"{end} multipliers are outside the unit circle where events account for {self._count}"
            self._name(first, last, words)
        self._count = end

    def _enter(self, event: Event) -> None:
        assert self._count is not None
        self._passed(event.solution, self._count, self._count + event.jump, event.angle)
        self._count += event.jump

    def _passed(self, solution: Solution, before: int, after: int, angle: float) -> None:
        """Enter the change of stability at an orbit, where there is one."""
        if (before <= 0) == (after <= 0):
            return
        start, end = solution.interval
        self.changes.append(
            StabilityChange(
                value=self.space.value(self.space.parameter, solution.point),
                Omega=float(getattr(solution, "Omega", 2.0 * np.pi / (end - start))),
                kind="real" if angle in (0.0, np.pi) else "complex",
                stable_before=before <= 0,
                stable_after=after <= 0,
                angle=angle,
                error=self.space.parameter_error(solution.point),
            )
        )

    def _beside(self, before: Solution, after: Solution, fraction: float) -> Solution | None:
        """The orbit at a fraction of the way between two."""
        point = self.space.point_solver.along(before.point, after.point, fraction)
        return None if point is None else self.space.solution(point, self.space.floquets([point])[0])

    def _name(self, before: Solution, after: Solution, reason: str) -> None:
        start, end = (self.space.value(self.space.parameter, one.point) for one in (before, after))
        self.unresolved.append(Unresolved(start, end, reason, parameter=self.space.parameter))


def _angle_of(special: Solution) -> float:
    """The angle of the multiplier that is on the circle at a special orbit."""
    kind = special.point.special
    if kind == TORUS:
        others = special.floquet().others
        return float(abs(np.angle(others[np.argmin(np.abs(np.abs(others) - 1.0))])))
    return np.pi if kind == DOUBLING else 0.0
