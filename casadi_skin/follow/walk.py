"""The points of a branch in order, as its continuation reaches them, with the special points between them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

from casadi_skin.follow.search import NotLocatedError
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.zero.kinds import FOLD, Unresolved
from casadi_skin.zero.problem import EPSILON, Scalar
from casadi_skin.zero.settings import Continuation, End, Point, Target

# The points of one stretch of a branch in order: requested ones, and special ones, which may be the same --------------

SAME_PLACE = 1e-2  # of a stretch: a requested point that near to a special one of the same value is that one
REQUESTED_VALUE_RTOL = 4.0 * EPSILON  # relative difference of a value that is the requested one


def target_of(space: SolutionSpace, special: Point) -> Target | None:
    """The target whose value a special point has within its error; None where there is none."""
    settings, name = space.point_solver.settings, space.parameter
    value, error = space.parameters(special)[name], space.parameter_error(special)
    for target in (*settings.at, *settings.ends):
        if target.held is Scalar.PARAMETER:
            wanted = space.value(name, snapped(special, target))
            if abs(value - wanted) <= max(error, REQUESTED_VALUE_RTOL * abs(wanted)):
                return target
    return None


def snapped(special: Point, target: Target, requested: bool = False) -> Point:
    """A special point with its value exactly the one that it has within its error."""
    z = special.z.copy()
    z[special.problem.parameter_index] = target.value
    return replace(special, z=z, requested=requested)


class StretchPoints:
    """The points between `before` and `after`, which may lie beyond the end of the branch.

    `requested` are the points of the continuation on the stretch, its end among them where that comes before `after`;
    `missed` the targets that it passed without a point, also by this search; `unresolved` fills with the parts on which
    special points may be missing.
    """

    def __init__(
        self, space: SolutionSpace, before: Point, after: Point, requested: Sequence[Point], missed: Sequence[Target]
    ) -> None:
        self.space, self.before, self.after = space, before, after
        self.requested, self.missed, self.unresolved = list(requested), list(missed), list[Unresolved]()
        self._z, t = (before.problem.prolong(v, after.problem) for v in (before.z, before.tangent))
        self._row = space.point_solver.metric(after.problem, self._z) * t

    def place(self, point: Point) -> float:
        """How far from its start along the stretch a point is."""
        return float(self._row @ (point.problem.prolong(point.z, self.after.problem) - self._z))

    def special(self) -> list[Point]:
        """Special points in order, those at requested values exactly there; raises NotLocatedError."""
        targets, found = self.space.point_solver.settings.at, list[Point]()
        for point in self.space.special_between(self.before, self.after):
            if isinstance(point, Unresolved):
                self.unresolved.append(point)
                continue
            target = target_of(self.space, point)
            found.append(point if target is None else snapped(point, target, target in targets))
        for target in self.missed:
            if all(point.parameter != target.value for point in found):
                found += self._at(target)
        self.missed = [target for target in self.missed if all(point.parameter != target.value for point in found)]
        return sorted(found, key=self.place)

    def _at(self, target: Target) -> Iterator[Point]:
        """The special point at a value at which no solution was found, where there is one."""
        solver, problem = self.space.point_solver, self.after.problem
        if target.held is not Scalar.PARAMETER:
            return
        curve, length = solver.curve(self.before, self.after)
        for sigma in curve.crossings(*target.unknown(problem), length)[:1]:
            guess = replace(self.after, z=curve.at(sigma), tangent=curve.slope(sigma), better=None, special="")
            point = self.space.singular_near(guess)
            if point is not None and target_of(self.space, point) == target:
                yield snapped(point, target, target in solver.settings.at)

    def beside_folds(self, special: Sequence[Point]) -> list[Point]:
        """The requested points so near to folds that the continuation passed them by."""
        if not any(point.special == FOLD for point in special):
            return []
        solver, found = self.space.point_solver, list[Point]()
        wanted = [target for target in solver.settings.at if target.held is Scalar.PARAMETER]
        ends = (self.before, *special, self.after)
        for one, other in pairwise(ends):
            low, high = sorted((one.parameter, other.parameter))
            start, end = self.place(one), self.place(other)
            known = {point.parameter for point in self.requested if start <= self.place(point) <= end}
            inside = tuple(t for t in wanted if low < t.value < high and t.value not in known)
            inside = tuple(t for t in inside if not (t.meets(one) or t.meets(other)))
            points = {target: point for target, point in solver.between(one, other, inside) if point is not None}
            found += [replace(point, requested=True) for point in points.values()]
            self.missed += [t for t in inside if t not in (*points, *self.missed)]
        return found

    def points(self) -> list[Point]:
        """All points in order but `after`, those that are no points of the continuation marked as located."""
        special = self.special()
        located = [replace(point, located=True) for point in (*special, *self.beside_folds(special))]
        near = SAME_PLACE * abs(self.place(self.after))
        own = [point for point in self.requested if not any(self._is(point, one, near) for one in special)]
        return sorted([*located, *own], key=self.place)

    def _is(self, point: Point, special: Point, near: float) -> bool:
        same = special.parameter == point.parameter
        return same and abs(self.place(special) - self.place(point)) <= near


ROUNDED_PARAMETER_CHANGE = 100.0 * EPSILON  # change of the parameter, of the way to go, that is rounding
CLOSED_BRANCH_DISTANCE = 1e-3  # of a step: distance from the start of a branch that has come back to it


class Walk:
    """Iterates over the points of a branch that are not known yet, without their stability.

    Attributes:
        end: why the branch ended; None where it can go on.
        detail: more about the end, in words.
        unresolved: stretches on which special points may be missing.
    """

    def __init__(
        self,
        space: SolutionSpace,
        known: Sequence[Point] = (),
        missed: Sequence[Target] = (),
        unresolved: Sequence[Unresolved] = (),
    ) -> None:
        self.space, self._known, self.unresolved = space, known, list(unresolved)
        self._continuation = self._continued() if known or space.start_is_limit else None
        if self._continuation is not None:
            self._continuation.missed.extend(missed)
        self._end: End | None = None
        self._detail = ""
        self._settled = len(missed)  # targets that are known to be missed
        self._pending = False  # whether points of a stretch that the continuation has left are still to come

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
        return self._end or (None if self._continuation is None or self._pending else self._continuation.end)

    @property
    def detail(self) -> str:
        of_its_own = self._continuation is None or self._end is not None
        return self._detail or ("" if of_its_own else self._continuation.detail)  # type: ignore[union-attr]

    @property
    def ended_early(self) -> End | None:
        """Why the branch ended before its continuation did."""
        return self._end

    @property
    def at_hand(self) -> bool:
        """Whether the next point is known: nothing has to be computed for it."""
        return not self.space.locates_folds and getattr(self._continuation, "at_hand", False)

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
        if known:
            self._end, self._detail = self.space.stop(known[-1])
            if self._end is not None:
                return
        if self._continuation is None:
            self._continuation = self.space.continuation((self.space.start,))
            yield self.space.start
        if not self.space.locates_folds:
            yield from self._plain(self._continuation)
            return
        walked = max((i for i, point in enumerate(self._known) if point.walked), default=-1)
        before = self._known[walked] if walked >= 0 else self.space.start
        reported = self._known[walked + 1 :]
        for points in self._stretches(self._continuation):
            self._pending = True
            points[:0] = [point for point in reported if not point.located]
            yield from self._stretch(before, points, len(reported))
            self._pending = False
            if self._end is not None or not points:
                return
            before, reported = points[-1], ()

    def _plain(self, continuation: Continuation) -> Iterator[Point]:
        """The points of a continuation on which no special points are sought."""
        for point in continuation:
            end, words = self.space.stop(point)
            if self.space.start_is_limit and not self._has_amplitude(point):
                self._end = End.RETURNED
                return
            if words:
                self._end, self._detail = end, words
                return
            yield point
            if end is not None:
                self._end = end
                return

    @staticmethod
    def _stretches(continuation: Continuation) -> Iterator[list[Point]]:
        """The points of the continuation, from behind one that is walked to the next one or to the end."""
        points = list[Point]()
        for point in continuation:
            points.append(point)
            if point.walked:
                yield points
                points = []
        yield points

    def _stretch(self, before: Point, points: list[Point], reported: int) -> Iterator[Point]:
        """The points of a stretch with the special ones between them, but for the first ones that are `reported`."""
        assert self._continuation is not None
        end, words = None, ""
        for number, point in enumerate(points):
            end, words = self.space.stop(point)
            if self._closes(points[number - 1] if number else before, point):
                points[number:] = [replace(self.space.start, walked=False, requested=False)]
                end = End.CLOSED
            elif words:
                del points[number:]
            if end is not None or words:
                break
        after = self._continuation.beyond if end is None and not words else None
        stretch = self._found(before, after or (points[-1] if points else before), points)
        for point in stretch:
            reported -= 1
            if reported < 0:
                yield point
            if point.special:
                self._end, self._detail = self.space.stop(point)
            if self._end is None and point.parameter == self.space.point_solver.settings.parameter_max:
                self._end, self._detail = End.REACHED, ""
            if self._end is not None:
                return
        if self._end is None:
            self._end, self._detail = end, words

    def _found(self, before: Point, after: Point, points: Sequence[Point]) -> list[Point]:
        """The points of a stretch in order, special ones among them; the end is set where one cannot be located."""
        if after is before:
            return []
        assert self._continuation is not None
        missed, last = self._continuation.missed, self.space.point_solver.settings.parameter_max
        stretch = StretchPoints(self.space, before, after, points, missed[self._settled :])
        try:
            found = stretch.points()
        except NotLocatedError as error:
            if points and points[-1] is not after:  # it may lie beyond the end
                return self._found(before, points[-1], points)
            self._end, self._detail = End.NO_STEP, f"{error}, {before.problem.whereabouts(before.z)}"
            if self._is_still(before):
                value, digits = self._limit(before)
                self._end, self._detail = End.STILL, f"{self.space.parameter} comes to {value:.10g} +- {digits:.0e}"
            return []
        missed[self._settled :] = stretch.missed
        self._settled = len(missed)
        self.unresolved += [part for part in stretch.unresolved if part not in self.unresolved]
        if after is self._continuation.beyond and all(point.parameter != last for point in found):
            found = list(points)  # up to where the branch was followed
        return found

    def _is_still(self, point: Point) -> bool:
        """Whether the longest step from a point changes the parameter by no more than rounding does."""
        settings, index = self.space.point_solver.settings, point.problem.parameter_index
        change = settings.max_step * abs(float(point.tangent[index]))
        return change <= ROUNDED_PARAMETER_CHANGE * max(1.0, abs(point.parameter))

    def _limit(self, point: Point) -> tuple[float, float]:
        """The value of the parameter at a point, and its rounding."""
        name = self.space.parameter
        value, start = (self.space.parameters(one)[name] for one in (point, self.space.start))
        digits = ROUNDED_PARAMETER_CHANGE * abs(self.space.to - start) * max(1.0, abs(point.parameter))
        return (0.0 if abs(value) <= digits else value), digits

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
        if (
            not CLOSED_BRANCH_DISTANCE * length < sigma <= (1.0 + CLOSED_BRANCH_DISTANCE) * length
            or float(row @ t) <= 0.0
        ):
            return False
        found = solver.corrected_along(before, after, min(sigma / length, 1.0))[0]
        return found is not None and solver.distance(problem, z, found.z) <= CLOSED_BRANCH_DISTANCE * length

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
