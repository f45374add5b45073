"""Following a branch of any kind: its points, with stability, its changes and bifurcations computed beside them."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, cast

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.events import Ledger, at_requested_value
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.walk import Walk
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.solve.watch import TimeLimitError, one_thread, watched
from casadi_skin.stability.flows import FlowError
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.settings import End, Point, Target


class Following:
    """Iterates over the solutions of a branch.

    `branch()` returns the part computed so far, but for the few points whose stability is computed together;
    `keep` is called with each point as it converges, and with the walk, which has what is missed so far. Solutions
    computed earlier may be given, points after them whose stability is `waiting`, and what was `missed` and
    `unresolved`: the branch goes on from the last of these as if it had not been broken off. It ends before its next
    point once `time_limit` seconds are over, also within the work on that point; points that wait then are finished.
    """

    def __init__(
        self,
        space: SolutionSpace,
        stability: bool = False,
        events: bool = True,
        solutions: Sequence[Solution] = (),
        until: Callable[[Any], bool] | None = None,
        waiting: Sequence[Point] = (),
        missed: Sequence[Target] = (),
        keep: Callable[[Point, Walk], None] | None = None,
        time_limit: float = math.inf,
        unresolved: Sequence[Unresolved] = (),
    ) -> None:
        stability = stability and not space.stability_included
        events = events and stability
        self.space, self.stability, self.events, self.until = space, stability, events, until
        self._ledger = Ledger(cast(BoundarySpace, space)) if events and space.has_ledger else None
        self._waiting: deque[Point] = deque(waiting)  # reached, but not yet among the solutions
        self._keep = keep
        self._time_limit, self._end_time = time_limit, time.monotonic() + time_limit
        self._walk = Walk(space, [*(s.point for s in solutions), *waiting], missed, unresolved)
        self._stopped = self._at_hand = False  # the second: whether the next result has been computed
        self.solutions = list(self._with_bifurcations(solutions))

    def _with_bifurcations(self, solutions: Sequence[Solution]) -> Iterator[Solution]:
        """Earlier solutions, with the orbits between them at which multipliers cross, sought again."""
        self.solutions = []
        for solution in map(self._critical, solutions):
            for special in (*self._bifurcations_before(solution), solution):
                self.solutions.append(special)
                yield special

    def __iter__(self) -> Iterator[Solution]:
        results = self._results()
        while True:
            if self._at_hand:  # nothing is computed for it
                result = next(results, None)
            else:
                with (
                    one_thread(),
                    interrupts_deferred(),
                    np.errstate(all="ignore"),
                    self._watch(),
                ):  # not while the caller of the iteration is at work
                    result = next(results, None)
            if result is None:
                return
            yield result

    def _watch(self) -> AbstractContextManager[None]:
        """Solvers end when the time is over, but for the first solution."""
        if math.isinf(self._time_limit) or not (self.solutions or self._waiting):
            return nullcontext()
        return watched(self._end_time - time.monotonic())

    def _points(self) -> Iterator[Point]:
        """The points of the walk, up to where the time is over."""
        try:
            yield from self._walk
        except TimeLimitError:
            self._walk.stop(End.TIME, f"{self._time_limit:g} s")

    def _so_far(self, limit: int) -> str:
        """Where a branch has come with its last point, in words."""
        last, name = self._waiting[-1] if self._waiting else self.solutions[-1].point, self.space.parameter
        return f"{limit} points, up to {name} = {self.space.value(name, last):.10g}; try max_points above {limit}"

    def _results(self) -> Iterator[Solution]:
        together = self.space.stability_batch if self.stability else 1
        limit = self.space.point_solver.settings.max_points
        if len(self._waiting) >= together:
            yield from self._finish_waiting()
        for point in self._points():
            if len(self.solutions) + len(self._waiting) == limit:
                self._walk.stop(End.POINTS, self._so_far(limit))
                break
            if time.monotonic() > self._end_time and (self.solutions or self._waiting):
                self._walk.stop(End.TIME, f"{self._time_limit:g} s")
                break
            self._waiting.append(point)
            if self._keep is not None:
                self._keep(point, self._walk)
            # The first ones sooner: a run that is interrupted early has something to write.
            if len(self._waiting) >= (together if self.solutions else max(1, together // 2)):
                yield from self._finish_waiting()
            if self._stopped or self._walk.end is End.FLOW:
                return
        yield from self._finish_waiting()

    def _finish_waiting(self) -> Iterator[Solution]:
        """The solutions of the points that wait, with their stability, in order."""
        try:
            solutions = self._with_stability()
            known = isinstance(solutions, list) and not self.events and self.until is None
            for solution in map(self._critical, solutions):
                for special in self._bifurcations_before(solution):
                    self.solutions.append(special)
                    yield special
                self.solutions.append(solution)
                self._waiting.popleft()
                others = self._waiting or (not self.stability and self._keep is None and self._walk.at_hand)
                self._at_hand = known and bool(others)
                yield solution
                if self.until is not None and self.until(solution):
                    self._stopped = True
                    self._waiting.clear()
                    return
        except FlowError as error:
            self._walk.stop(End.FLOW, str(error))
            self._waiting.clear()

    def _critical(self, solution: Solution) -> Solution:
        """A solution, or the special one at a requested value."""
        if not (self.events and solution.space.closes):
            return solution
        try:
            return at_requested_value(solution)
        except TimeLimitError:  # the stretch before it is named: the time is over there too
            return solution

    def _bifurcations_before(self, solution: Solution) -> Iterator[Solution]:
        """Orbits between the last orbit and this one at which multipliers cross the unit circle."""
        if self._ledger is None or not self.solutions:
            return
        before = self.solutions[-1]
        leaving = self._ledger.space.leaves and len(self.solutions) == 1
        if before.space.closes and solution.space.closes:
            yield from self._ledger.between(before, solution, leaving)

    def _with_stability(self) -> Iterable[Solution]:
        """Solutions of the points that wait, a list where nothing is left to be computed.

        Raises FlowError at the first whose stability cannot be computed.
        """
        points = list(self._waiting)
        if not (points and self.stability):
            return [self.space.solution(point) for point in points]
        try:
            known = self.space.floquets(points)
        except FlowError:  # of one of them: those before it are computed by themselves
            return (self.space.solution(point, self.space.floquets([point])[0]) for point in points)
        return [self.space.solution(point, result) for point, result in zip(points, known, strict=True)]

    def branch(self) -> Branch:
        """The branch computed so far."""
        end = self._walk.ended_early if self._waiting else self._walk.end
        misses = self._walk.misses(self.solutions, self._stopped, end)
        return self.finished(end, self._walk.detail, misses)

    def finished(
        self, end: End | None, detail: str, misses: Mapping[str, tuple[float, ...]], stopped: bool = False
    ) -> Branch:
        """The branch of the solutions computed so far, with a known end."""
        changes, unresolved = ((), []) if self._ledger is None else (self._ledger.changes, self._ledger.unresolved)
        return Branch(
            self.space, tuple(self.solutions), tuple(changes),
            self.stability or self.space.stability_included, end, detail, misses,
            stopped or self._stopped, self.events, tuple(dict.fromkeys([*self._walk.unresolved, *unresolved])),
            max(self._end_time - time.monotonic(), 0.0),
        )  # fmt: skip


def run_following(following: Following, progress: Callable[[Any], None] | None) -> Branch:
    """Follow a branch to its end, calling `progress` with each solution."""
    for result in following:
        if progress is not None and isinstance(result, Solution):
            progress(result)
    return following.branch()
