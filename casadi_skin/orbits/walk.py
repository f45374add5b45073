"""The points of a branch in order, as its continuation reaches them, with the special points between them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from casadi_skin.bvp.problem import Scalar
from casadi_skin.continuation.points import Continuation, End, Point, Target
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.space import SolutionSpace
from casadi_skin.orbits.special_points import FOLD, NotLocatedError

CLOSED = 1e-3  # of a step: distance from the start of a branch that has come back to it


class Walk:
    """Iterates over the points of a branch that are not known yet, without their stability.

    Attributes:
        end: why the branch ended; None where it can go on.
        detail: more about the end, in words.
    """

    def __init__(self, space: SolutionSpace, known: Sequence[Point] = (), missed: Sequence[Target] = ()) -> None:
        self.space, self._known = space, known
        self._continuation = self._continued() if known or space.start_is_limit else None
        if self._continuation is not None:
            self._continuation.missed.extend(missed)
        self._end: End | None = None
        self._detail = ""

    def _continued(self) -> Continuation:
        """The continuation from the points that are known."""
        walked = [i for i, point in enumerate(self._known) if point.walked]
        own = tuple(self._known[i] for i in walked)
        reported = tuple(p for p in self._known[walked[-1] + 1 if walked else 0 :] if not p.located)
        history = (self.space.start, *own) if self.space.start_is_limit or not own else own
        return self.space.continuation(history, reported)

    @property
    def missed(self) -> Sequence[Target]:
        """Requested values that the continuation passed without a solution."""
        return () if self._continuation is None else self._continuation.missed

    @property
    def end(self) -> End | None:
        return self._end or (None if self._continuation is None else self._continuation.end)

    @property
    def detail(self) -> str:
        of_its_own = self._continuation is None or self._end is not None
        return self._detail or ("" if of_its_own else self._continuation.detail)  # type: ignore[union-attr]

    @property
    def ended_early(self) -> End | None:
        """Why the branch ended before its continuation did."""
        return self._end

    def stop(self, end: End, detail: str = "") -> None:
        """End the branch for a reason that its points do not show."""
        self._end, self._detail = end, detail

    def __iter__(self) -> Iterator[Point]:
        held = list[Point]() if self._known and self._beyond_start(self._known[-1]) else None
        for point in self._all():
            if held is not None:
                held.append(point)
                continue
            yield point
            held = [] if self._beyond_start(point) else None
        if self._end is End.CLOSED:
            yield from held or ()
        elif held is not None:
            self._end, self._detail = End.RETURNED, ""

    def _beyond_start(self, point: Point) -> bool:
        """Whether a branch has come back, so that points are kept only if it closes."""
        settings = self.space.point_solver.settings
        beyond = point.parameter * settings.parameter_max <= 0.0 and point is not self.space.start
        return settings.closing and point.walked and beyond

    def _all(self) -> Iterator[Point]:
        """The points of the branch, and those beyond its start where it may close."""
        known = [point for point in self._known if not point.located]
        last = known[-1] if known else None
        reported = len(self._known) - 1 - next((i for i, p in enumerate(self._known) if p is last), -1)
        if last is not None:
            self._end, self._detail = self.space.stop(last)
            if self._end is not None:
                return
        if self._continuation is None:
            last = self.space.start
            self._continuation = self.space.continuation((last,))
            yield last
        for point in self._continuation:
            end, words = self.space.stop(point)
            if self.space.start_is_limit and not self._has_amplitude(point):
                self._end = End.RETURNED
                return
            if words:
                self._end, self._detail = end, words
                return
            closed = last is not None and not self.space.start_is_limit and self._closes(last, point)
            point = replace(self.space.start, walked=False, requested=False) if closed else point
            if self.space.locates_folds and last is not None:
                try:
                    for special in itertools.islice(self._special_between(last, point), reported, None):
                        yield special
                        self._end, self._detail = self.space.stop(special)
                        if self._end is not None:
                            return
                except NotLocatedError as error:
                    self._end, self._detail = End.NO_STEP, f"{error}, {last.problem.whereabouts(last.z)}"
                    return
            yield point
            last, reported = point, 0
            if closed:
                self._end = End.CLOSED
                return
            if end is not None:
                self._end = end
                return

    def _closes(self, before: Point, after: Point) -> bool:
        """Whether the start of the branch lies between two points of it, passed in the same direction."""
        start, solver = self.space.start, self.space.point_solver
        low, high = sorted((before.parameter, after.parameter))
        beside = start.parameter < 1.5 * low - 0.5 * high or start.parameter > 1.5 * high - 0.5 * low
        if before is start or (beside and not self.space.stability_included):  # equilibria cost nothing to compare
            return False
        problem = after.problem
        z, t = (start.problem.prolong(v, problem) for v in (start.z, start.tangent))
        curve, length = solver.curve(before, after)
        row = solver.metric(problem, curve.z0) * curve.t0
        sigma = float(row @ (z - curve.z0)) / float(row @ curve.t0)
        if not CLOSED * length < sigma <= (1.0 + CLOSED) * length or float(row @ t) <= 0.0:
            return False
        found = solver.corrected_along(before, after, min(sigma / length, 1.0))[0]
        return found is not None and solver.distance(problem, z, found.z) <= CLOSED * length

    def _special_between(self, before: Point, after: Point) -> Iterator[Point]:
        """Special points between two points, and the requested points so near to folds that they were passed by."""
        found = list(self.space.special_between(before, after))
        last = before
        for special in (*found, after):
            if any(one.special == FOLD for one in found):
                yield from self._asked_between(last, special)
            if special is not after:
                yield replace(special, located=True)
            last = special

    def _asked_between(self, one: Point, other: Point) -> Iterator[Point]:
        """The requested points between two points of which one is a fold, or beside one."""
        solver = self.space.point_solver
        low, high = sorted((one.parameter, other.parameter))
        wanted = [t for t in solver.settings.at if t.held is Scalar.PARAMETER and low < t.value < high]
        inside = tuple(t for t in wanted if not (t.meets(one) or t.meets(other)))
        found = {target: point for target, point in solver.between(one, other, inside) if point is not None}
        for point in found.values():
            yield replace(point, requested=True, located=True)
        assert self._continuation is not None
        self._continuation.missed += [t for t in inside if t not in (*found, *self._continuation.missed)]

    def _has_amplitude(self, point: Point) -> bool:
        """Whether a point of a family is on the side of S = 0 that it is followed to."""
        return point.parameter * self.space.point_solver.settings.parameter_max > 0.0

    # Requested values -------------------------------------------------------------------------------------------------

    def misses(self, solutions: Sequence[Solution], stopped: bool, end: End | None) -> dict[str, tuple[float, ...]]:
        """Requested values without a solution, by name: those that were missed, and at the end all others.

        Where a condition stopped the branch, those that it had passed before.
        """
        misses, whole = {}, end in (End.REACHED, End.CLOSED) and not stopped
        for name, values in self._asked().items():
            had = {s.value(name) for s in solutions}
            found = {v for v in values if self.space.target(name, v) in self.missed or (whole and v not in had)}
            if stopped:
                found = {v for v in found if min(had) <= v <= max(had)}
            if found:
                misses[name] = tuple(sorted(found))
        return misses

    def _asked(self) -> Mapping[str, Sequence[float]]:
        """All requested values by name, the ends among them where the continuation missed them."""
        requested = dict(self.space.requested_values())
        if Target(Scalar.PARAMETER, self.space.point_solver.settings.parameter_max) in self.missed:
            requested[self.space.parameter] = (*requested[self.space.parameter], self.space.to)
        return requested
