"""Following a family: the walk, with stability and its changes computed beside it, point by point."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from casadi_skin.arguments import number, numbers
from casadi_skin.bvp.problem import Scalar
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.continuation.points import End, Point
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.branch import SLOW, Branch
from casadi_skin.orbits.multipliers import floquets_of
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.request import MAX_POINTS, TWO_PI, FamilyRequest
from casadi_skin.orbits.stability_changes import StabilityChange, locate_change
from casadi_skin.orbits.tools import FamilyTools
from casadi_skin.stability.flow import FlowError
from casadi_skin.threads import one_thread

UNCHANGED = 1e-13  # a relative change of S, per that of Omega, that no longer shows
STABILITY_BATCH = 8  # points whose stability is computed at a time: more gain little and are lost in an interruption


class FamilyContinuation:
    """Iterates over the orbits of a family and, between two of them, over the changes of stability.

    What has been computed is in `branch()` at any time, so that an interruption loses no more than the few points whose
    stability is computed together. `orbits` and `changes` computed earlier may be given: the walk goes on from the last
    two points walked.
    """

    def __init__(
        self,
        tools: FamilyTools,
        stability: bool = False,
        events: bool = True,
        orbits: Sequence[Orbit] = (),
        changes: Sequence[StabilityChange] = (),
    ) -> None:
        self.tools, self.stability, self.events = tools, stability, events and stability
        self.orbits, self.changes = list(orbits), list(changes)
        self._walk = tools.walk((tools.start, *(o.point for o in self.orbits if o.point.walked)))
        self._waiting: deque[Point] = deque()  # walked, but not yet among the orbits
        self._end: End | None = None
        self._detail = ""
        self._stopped: End | None = None  # the reason why no more points are taken from the walk

    def __iter__(self) -> Iterator[Orbit | StabilityChange]:
        results = self._results()
        while True:
            with one_thread(), interrupts_deferred():  # not while whoever iterates is at work
                result = next(results, None)
            if result is None:
                return
            yield result

    def _results(self) -> Iterator[Orbit | StabilityChange]:
        together = min(self.tools.flow.batch, STABILITY_BATCH) if self.stability else 1
        for point in self._walk:
            if len(self.orbits) + len(self._waiting) == self.tools.request.max_points:
                self._stopped = End.POINTS
                break
            self._waiting.append(point)
            if len(self._waiting) == together:
                yield from self._finish_waiting()
            if self._end is not None:
                return
            if self._at_limit(point):
                self._stopped = End.LIMIT
                break
        yield from self._finish_waiting()

    def _at_limit(self, point: Point) -> bool:
        """Whether all that is left to ask for is an S that the family does not come to."""
        request = self.tools.request
        if request.chain.g > 0 or SLOW * point.Omega > self.tools.start.Omega or request.period_max is not None:
            return False
        slowest = min((*request.at_Omega, *(TWO_PI / period for period in request.at_period)), default=np.inf)
        return point.Omega < slowest and point.parameter_rate <= UNCHANGED

    def _finish_waiting(self) -> Iterator[Orbit | StabilityChange]:
        """The orbits of the points that wait, with their stability and its changes, in order."""
        try:
            for orbit in self._with_stability():
                if self.events and self.orbits and self.orbits[-1].floquet().stable != orbit.floquet().stable:
                    change = locate_change(self.tools.point_solver, self.orbits[-1], orbit)
                    self.changes.append(change)
                    yield change
                self.orbits.append(orbit)
                self._waiting.popleft()
                yield orbit
        except FlowError as error:
            self._end, self._detail = End.FLOW, str(error)
            self._waiting.clear()

    def _with_stability(self) -> Iterator[Orbit]:
        """Orbits of the points that wait; raises FlowError at the first whose stability cannot be computed."""
        points = list(self._waiting)
        if not (points and self.stability):
            yield from (Orbit(self.tools, point) for point in points)
            return
        try:
            known = floquets_of(self.tools, points)
        except FlowError:  # of one of them: those before it are computed by themselves
            yield from (Orbit(self.tools, point, floquets_of(self.tools, [point])[0]) for point in points)
            return
        yield from (Orbit(self.tools, point, result) for point, result in zip(points, known, strict=True))

    def branch(self) -> Branch:
        """What has been computed so far."""
        request = self.tools.request
        end = self._end or (None if self._waiting else self._stopped or self._walk.end)
        in_S = {request.S_of(t.value) for t in self._walk.missed if t.held is Scalar.PARAMETER}
        in_Omega = {t.value for t in self._walk.missed if t.held is Scalar.OMEGA}
        in_period = {T for T in request.at_period if TWO_PI / T in in_Omega}
        in_Omega &= set(request.at_Omega)
        if end is End.REACHED:
            in_S |= set(request.at) - {orbit.S for orbit in self.orbits}
            in_Omega |= set(request.at_Omega) - {orbit.Omega for orbit in self.orbits}
            in_period |= set(request.at_period) - {orbit.period for orbit in self.orbits}
        missed = (tuple(sorted(in_S)), tuple(sorted(in_Omega)), tuple(sorted(in_period)))
        return self.finished(end, self._detail or self._walk.detail, missed)

    def finished(self, end: End | None, detail: str, missed: Sequence[tuple[float, ...]]) -> Branch:
        """The branch of what has been computed, with a known end; `missed` in S, in Omega and in the period."""
        orbits, changes = tuple(self.orbits), tuple(self.changes)
        return Branch(self.tools, self.tools.start, orbits, changes, self.stability, end, detail, *missed)


def follow_family(
    chain: Chain,
    mode: int | str,
    amplitude_max: float,
    *,
    at: Sequence[float] = (),
    stability: bool = False,
    events: bool = True,
    tolerance: float = 1e-8,
    transcription: str = "trigonometric",
    corrector: str = "ipopt",
    flow: str = "splitting",
    symmetry: SymmetryClass | None = None,
    walker: str | None = None,
    degree: int | None = None,
    at_Omega: Sequence[float] = (),
    at_period: Sequence[float] = (),
    period_max: float | None = None,
    max_points: int = MAX_POINTS,
    tail: str | None = None,
    progress: Callable[[Orbit], None] | None = None,
) -> Branch:
    """Follow the family of nonlinear modes that grows from linear mode `mode` to S = ||y||^2 = `amplitude_max`.

    Points exactly at the S of `at`, the frequencies `at_Omega` and the periods `at_period` are among the orbits, as
    often as the family passes them. It ends at the period `period_max` where that comes before `amplitude_max`, as it
    does for softening orbits that have no larger S, and after `max_points` points wherever it is then. `tolerance`
    bounds the relative error of Omega, profile and multipliers; `progress` is called with each orbit. A family that
    ends early is returned with `complete` False and a `reason`. Raises ValueError for arguments out of range. Method:
    collocation and pseudo-arclength continuation in the gauge (paper, Sec. II; Keller 1977).
    """
    asked = (("at", at), ("at_Omega", at_Omega), ("at_period", at_period))
    wanted, wanted_Omega, wanted_period = (numbers(name, values) for name, values in asked)
    methods = (transcription, corrector, flow, symmetry, walker, degree)
    longest = None if period_max is None else number("period_max", period_max)
    largest = number("amplitude_max", amplitude_max, "a finite number > 0")
    passed = (wanted_Omega, wanted_period, longest, max_points)
    if stability and tail is None and isinstance(chain, Chain) and not chain.infinite:
        tail = "full"  # all sites take part in it
    number_of_mode = chain.mode_number(mode) if isinstance(chain, Chain) else mode
    request = FamilyRequest(chain, number_of_mode, largest, wanted, tolerance, *methods, *passed, tail)
    walk = FamilyContinuation(FamilyTools(request), stability, events)
    for result in walk:
        if progress is not None and isinstance(result, Orbit):
            progress(result)
    return walk.branch()
