"""Following a branch of any kind: its points, with stability, its changes and special points computed beside them.

A continuation goes along the branch point by point; a `BranchIterator` adds the special points between them, and the
values that were requested; a `BranchRun` makes solutions of the points, with their stability in batches, and keeps the
ledger.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np

from casadi_skin.follow.arclength import Continuation
from casadi_skin.follow.boundary_space import at_fixed_period, up_to_period
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.events import Ledger, at_requested_value
from casadi_skin.follow.family import Family
from casadi_skin.follow.search import Monitor, MonitorAccount, NotLocatedError
from casadi_skin.follow.solution import Orbit, Solution, following_settings
from casadi_skin.follow.space import FAMILY, SolutionSpace
from casadi_skin.follow.special_points import StretchPoints, rate
from casadi_skin.model.arguments import by_name, check_name, check_options, duration, function_of, short_repr, truth
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.model.result import in_turn
from casadi_skin.solve.watch import TimeLimitError, one_thread, watched
from casadi_skin.stability.flows import FlowError
from casadi_skin.zero.family import MAX_POINTS, FamilyModel, Method, family_request
from casadi_skin.zero.kinds import BRANCH_POINT, EDGE, FOLD, KINDS, KREIN, STABILITY, Unresolved
from casadi_skin.zero.problem import EPSILON, Scalar
from casadi_skin.zero.settings import End, Point, Target
from casadi_skin.zero.stated_problem import PERIOD

FREQUENCY = "frequency"  # of orbits: it is held where the period is

# Solutions of the points of a branch, with their stability and the ledger ---------------------------------------------

DEAF_SECONDS = 0.02  # for which interruptions may wait: to hold them back for each point costs 3 per cent of a family


class BranchRun:
    """Iterates over the solutions of a branch.

    `branch()` returns the part computed so far, but for the few points whose stability is computed together;
    `keep` is called with each point as it converges, and with the iterator, which has what is missed so far. Solutions
    computed earlier may be given, points after them whose stability is `waiting`, and what was `missed` and
    `unresolved`: the branch goes on from the last of these as if it had not been broken off. It ends before its next
    point once `time_limit` seconds are over, also within the work on that point; points that wait then are finished.
    """

    def __init__(
        self,
        space: Any,
        stability: bool = False,
        events: bool = True,
        solutions: Sequence[Solution] = (),
        until: Callable[[Any], bool] | None = None,
        waiting: Sequence[Point] = (),
        missed: Sequence[Target] = (),
        keep: Callable[[Point, BranchIterator], None] | None = None,
        time_limit: float = math.inf,
        unresolved: Sequence[Unresolved] = (),
    ) -> None:
        self.space, self.until, self.stability = space, until, stability and not space.stability_included
        self.events = events and self.stability
        self._ledger = Ledger(space) if self.events and space.has_ledger else None
        self._keep, self._time_limit, self._end_time = keep, time_limit, time.monotonic() + time_limit
        self._iterator = BranchIterator(space, [*(s.point for s in solutions), *waiting], missed, unresolved)
        self._waiting: deque[Point] = deque(waiting)  # reached, but not yet among the solutions
        self._stopped, self.solutions = False, list[Any]()
        for solution in solutions:  # with the orbits between them at which multipliers cross, sought again
            list(self._entered(solution))

    def _entered(self, solution: Solution) -> Iterator[Solution]:
        """A solution, after the orbits before it at which multipliers cross, as each joins the others.

        In its place the special one where it is at a requested value.
        """
        if self.events and solution.space.closes:
            with suppress(TimeLimitError):  # the stretch before it is named: the time is over there too
                solution = at_requested_value(solution)
        before = self.solutions[-1] if self.solutions else None
        crossings: Iterator[Solution] = iter(())
        if self._ledger is not None and before is not None and before.space.closes and solution.space.closes:
            crossings = self._ledger.between(before, solution, len(self.solutions) == 1)
        for one in chain(crossings, [solution]):
            self.solutions.append(one)
            yield one

    def __iter__(self) -> Iterator[Solution]:
        return chain.from_iterable(self._at_a_time(0.0))

    def _at_a_time(self, seconds: float) -> Iterator[list[Solution]]:
        """Solutions, as many at a time as take so many seconds; the first is one by itself."""
        results, some = self._results(), list[Solution]()
        while True:  # the contexts are not those of the caller's work in between
            over = time.monotonic() + (seconds if self.solutions else 0.0)
            # No point has a residual that is not finite.
            with one_thread(), interrupts_deferred(), np.errstate(all="ignore"), self._watch():
                some = []
                for result in results:
                    some.append(result)
                    if time.monotonic() >= over:
                        break
            if not some:
                return
            yield some

    def _watch(self) -> AbstractContextManager[None]:
        """Solvers end when the time is over, but for the first solution."""
        if math.isinf(self._time_limit) or not (self.solutions or self._waiting):
            return nullcontext()
        return watched(self._end_time - time.monotonic())

    def _points(self) -> Iterator[Point]:
        """The points of the branch, up to the limits of their number and of the time."""
        limit, name = self.space.point_solver.settings.max_points, self.space.parameter
        try:
            for point in self._iterator:
                if time.monotonic() > self._end_time and (self.solutions or self._waiting):
                    raise TimeLimitError
                if len(self.solutions) + len(self._waiting) == limit:
                    last = self._waiting[-1] if self._waiting else self.solutions[-1].point
                    reached = f"{limit} points, up to {name} = {self.space.value(name, last):.10g}"
                    self._iterator.stop(End.POINTS, f"{reached}; try max_points above {limit}")
                    return
                yield point
        except TimeLimitError:
            self._iterator.stop(End.TIME, f"{self._time_limit:g} s")

    def _results(self) -> Iterator[Solution]:
        together = self.space.stability_batch if self.stability else 1
        if len(self._waiting) >= together:
            yield from self._finish_waiting()
        for point in self._points():
            self._waiting.append(point)
            if self._keep is not None:
                self._keep(point, self._iterator)
            # The first ones sooner: a run that is interrupted early has something to write.
            if len(self._waiting) >= (together if self.solutions else max(1, together // 2)):
                yield from self._finish_waiting()
            if self._stopped or self._iterator.end is End.FLOW:
                return
        yield from self._finish_waiting()

    def _finish_waiting(self) -> Iterator[Solution]:
        """The solutions of the points that wait, with their stability, in order."""
        try:
            for solution in self._with_stability():
                yield from self._entered(solution)
                self._waiting.popleft()
                if self.until is not None and self.until(self.solutions[-1]):
                    self._stopped = True
                    self._waiting.clear()
                    return
        except FlowError as error:
            self._iterator.stop(End.FLOW, str(error))
            self._waiting.clear()

    def _with_stability(self) -> Iterable[Solution]:
        """Solutions of the points that wait; raises FlowError at the first whose stability cannot be computed."""
        points = list(self._waiting)
        if not (points and self.stability):
            return [self.space.solution(point) for point in points]
        try:
            known = self.space.floquets(points)
        except FlowError:  # of one of them: those before it are computed by themselves
            return (self.space.solution(point, self.space.floquets([point])[0]) for point in points)
        return [self.space.solution(point, result) for point, result in zip(points, known, strict=True)]

    def to_end(self, progress: Callable[[Any], None] | None = None) -> Branch:
        """The branch followed to its end; `progress` is called with each solution."""
        if progress is None:
            deque(self._at_a_time(DEAF_SECONDS), maxlen=0)
        else:
            for solution in self:
                progress(solution)
        return self.branch()

    def branch(self, known_end: End | None = None, known_detail: str = "") -> Branch:
        """The branch computed so far, with its end where that is known from before."""
        if known_end is not None:
            self._iterator.stop(known_end, known_detail)
        end, detail = None if self._waiting else self._iterator.end, self._iterator.detail
        misses = self._iterator.misses(self.solutions, self._stopped, end)
        changes, unresolved = ((), []) if self._ledger is None else (self._ledger.changes, self._ledger.unresolved)
        self._iterator.unresolved += self.space.unproved()
        return Branch(
            self.space, tuple(self.solutions), tuple(changes),
            self.stability or self.space.stability_included, end, detail, misses,
            self._stopped, self.events, tuple(dict.fromkeys([*self._iterator.unresolved, *unresolved])),
            max(self._end_time - time.monotonic(), 0.0),
        )  # fmt: skip


ROUNDED_PARAMETER_CHANGE = 100.0 * EPSILON  # change of the parameter, of the way to go, that is rounding
CLOSED_BRANCH_DISTANCE = 1e-3  # of a step: distance from the start of a branch that has come back to it


class BranchIterator:
    """Iterates over the points of a branch that are not known yet, without their stability.

    Attributes:
        end: why the branch ended; None where it can go on.
        detail: more about the end, in words.
        missed: requested values that the continuation passed without a solution.
        unresolved: stretches on which special points may be missing.
    """

    def __init__(
        self,
        space: SolutionSpace,
        known: Sequence[Point] = (),
        missed: Sequence[Target] = (),
        unresolved: Sequence[Unresolved] = (),
    ) -> None:
        self.space, self._known, self.missed, self.unresolved = space, known, list(missed), list(unresolved)
        self.end: End | None = None
        self.detail = ""
        self._known_misses = len(missed)  # targets that are known to be missed

    @cached_property
    def _continuation(self) -> Continuation:
        """The continuation from the points that are known."""
        walked = [i for i, point in enumerate(self._known) if point.walked]
        own = tuple(self._known[i] for i in walked)
        reported = tuple(p for p in self._known[walked[-1] + 1 if walked else 0 :] if not p.located)
        history = (self.space.start, *own) if self.space.start_is_limit or not own else own
        found = self.space.continuation(history, reported)
        found.missed = self.missed
        return found

    @cached_property
    def _account(self) -> MonitorAccount:
        """That of the monitors up to the last point that is known."""
        found = MonitorAccount(self.space)
        list(found.passed((self.space.start, *self._known)))
        return found

    def stop(self, end: End | None, detail: str = "") -> None:
        """End the branch for a reason that its points do not show."""
        self.end, self.detail = end, detail

    def __iter__(self) -> Iterator[Point]:
        held = list[Point]() if self._known and self._beyond_start(self._known[-1]) else None
        for point in self._all():
            if held is not None:
                held.append(point)
                continue
            yield point
            held = [] if self._beyond_start(point) else None
        if self.end is End.CLOSED:
            yield from held or ()
        elif held is not None:
            self.stop(End.RETURNED)
        elif self.end is None:
            self.stop(self._continuation.end, self._continuation.detail)

    def _beyond_start(self, point: Point) -> bool:
        """Whether a branch has come back, so that points are kept only if it closes."""
        settings = self.space.point_solver.settings
        beyond = point.parameter * settings.parameter_max <= 0.0 and point is not self.space.start
        return settings.closing and point.walked and beyond

    def _all(self) -> Iterator[Point]:
        """The points of the branch, and those beyond its start where it may close."""
        known = [point for point in self._known if not point.located]
        if known:
            self.stop(*self.space.stop(known[-1]))
            if self.end is not None:
                return
        elif not self.space.start_is_limit:
            yield self.space.start
        if not self.space.locates_folds:
            yield from self._plain()
            return
        walked = max((i for i, point in enumerate(self._known) if point.walked), default=-1)
        before = self._known[walked] if walked >= 0 else self.space.start
        reported = self._known[walked + 1 :]
        for points in self._stretches():
            points[:0] = [point for point in reported if not point.located]
            yield from self._stretch(before, points, len(reported))
            if self.end is not None or not points:
                return
            before, reported = points[-1], ()

    def _plain(self) -> Iterator[Point]:
        """The points of a continuation on which no special points are sought."""
        direction = self.space.point_solver.settings.parameter_max
        for point in self._continuation:
            end, words = self.space.stop(point)
            if self.space.start_is_limit and not point.parameter * direction > 0.0:  # on the other side of S = 0
                end, words = End.RETURNED, ""
            elif not words:
                yield point
            if end is not None:
                self.stop(end, words)
                return

    def _stretches(self) -> Iterator[list[Point]]:
        """The points of the continuation, from behind one that is walked to the next one or to the end."""
        points = list[Point]()
        for point in self._continuation:
            points.append(point)
            if point.walked:
                yield points
                points = []
        yield points

    def _stretch(self, before: Point, points: list[Point], reported: int) -> Iterator[Point]:
        """The points of a stretch with the special ones between them, but for the first ones that are `reported`."""
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
                self.stop(*self.space.stop(point))
            if self.end is None and point.parameter == self.space.point_solver.settings.parameter_max:
                self.stop(End.REACHED)
            if self.end is not None:
                return
        if self.end is None:
            self.stop(end, words)

    def _found(self, before: Point, after: Point, points: Sequence[Point]) -> list[Point]:
        """The points of a stretch in order, special ones among them; the end is set where one cannot be located."""
        if after is before:
            return []
        missed, last = self.missed, self.space.point_solver.settings.parameter_max
        stretch = StretchPoints(self.space, before, after, points, missed[self._known_misses :])
        try:
            found = stretch.points()
        except NotLocatedError as error:
            if points and points[-1] is not after:  # it may lie beyond the end
                return self._found(before, points[-1], points)
            still = self._still_at(before)
            words = still or f"{error}, {before.problem.describe_parameters(before.z)}"
            self.stop(End.STILL if still else End.NO_STEP, words)
            return []
        missed[self._known_misses :] = stretch.missed
        self._known_misses = len(missed)
        stretch.unresolved += self._account.passed((*found, after), stretch.unresolved)
        self.unresolved += [part for part in stretch.unresolved if part not in self.unresolved]
        if after is self._continuation.beyond and all(point.parameter != last for point in found):
            found = list(points)  # up to where the branch was followed
        return found

    def _still_at(self, point: Point) -> str:
        """The value of the parameter, in words, where the longest step changes it by no more than rounding does."""
        name, rounding = self.space.parameter, ROUNDED_PARAMETER_CHANGE * max(1.0, abs(point.parameter))
        if self.space.point_solver.settings.max_step * abs(rate(point)) > rounding:
            return ""
        value, start = (self.space.parameters(one)[name] for one in (point, self.space.start))
        digits = rounding * abs(self.space.to - start)
        return f"{name} comes to {0.0 if abs(value) <= digits else value:.10g} +- {digits:.0e}"

    def _closes(self, before: Point, after: Point) -> bool:
        """Whether the start of the branch lies between two points of it, passed in the same direction."""
        start, solver = self.space.start, self.space.point_solver
        low, high = sorted((before.parameter, after.parameter))
        beside = start.parameter < 1.5 * low - 0.5 * high or start.parameter > 1.5 * high - 0.5 * low
        if before is start or (beside and not self.space.stability_included):  # equilibria cost nothing to compare
            return False
        problem = after.problem
        curve, length = solver.curve(before, after)
        if curve.moving is not None:
            seen = curve.moving.seen(start, curve.moving.nearest(start))
            sigma, aligned = (0.0, False) if seen is None else (seen.sigma + length, True)
        else:
            z, t = (start.problem.prolong(v, problem) for v in (start.z, start.tangent))
            first, slope = curve.coefficients[:2]
            row = solver.metric(problem, first) * slope
            sigma, aligned = float(row @ (z - first)) / float(row @ slope), float(row @ t) > 0.0
        if not (CLOSED_BRANCH_DISTANCE * length < sigma <= (1.0 + CLOSED_BRANCH_DISTANCE) * length and aligned):
            return False
        found = solver.unrefined_along(before, after, min(sigma / length, 1.0))
        if found is None:
            return False
        z = start.problem.prolong(start.z, found.problem)
        return bool(solver.distance(found.problem, z, found.z) <= CLOSED_BRANCH_DISTANCE * length)

    # Requested values -------------------------------------------------------------------------------------------------

    def misses(self, solutions: Sequence[Solution], stopped: bool, end: End | None) -> dict[str, tuple[float, ...]]:
        """Requested values without a solution, by name: those that were missed, and at the end all others.

        Where a condition stopped the branch, those that it had passed before.
        """
        misses, whole = {}, end in (End.REACHED, End.CLOSED) and not stopped
        requested = dict(self.space.requested_values())
        if Target(Scalar.PARAMETER, self.space.point_solver.settings.parameter_max) in self.missed:  # the end itself
            requested[self.space.parameter] = (*requested[self.space.parameter], self.space.to)
        for name, values in requested.items():
            had = {s.value(name) for s in solutions}
            found = {v for v in values if self.space.target(name, v) in self.missed or (whole and v not in had)}
            if stopped:
                found = {v for v in found if min(had) <= v <= max(had)}
            if found:
                misses[name] = tuple(sorted(found))
        return misses


# Following a family from a linear mode, or the branch through a solution: arguments checked, then continuation --------


@in_turn
def follow_family(
    model: FamilyModel,
    mode: int | str,
    amplitude_max: float,
    *,
    at: Sequence[float] = (),
    at_Omega: Sequence[float] = (),
    at_period: Sequence[float] = (),
    period_max: float | None = None,
    max_points: int = MAX_POINTS,
    time_limit: float | None = None,
    until: Callable[[Orbit], bool] | None = None,
    stability: bool = False,
    events: bool = True,
    tolerance: float = 1e-8,
    parameters: Mapping[str, float] | None = None,
    progress: Callable[[Orbit], None] | None = None,
    **method: Any,
) -> Branch:
    """Follow the family of nonlinear modes that grows from a linear mode; dimensionless, or in the model's units.

    Arguments:
        model: a `Chain`, or an `OdeModel` of second order with a declared reversal and an equilibrium at 0.
        mode: the linear mode by ascending frequency from 1, "first" or "last".
        amplitude_max: S at which the family ends: the sum of squares of the positions at the phase where all velocities
            vanish, or the S of the model's normalisation.
        at: values of S at which orbits are wanted exactly, as often as the family passes them.
        at_Omega: frequencies, likewise.
        at_period: periods, likewise.
        period_max: period at which the family ends where that comes before `amplitude_max`.
        max_points: number of orbits after which it ends wherever it is.
        time_limit: seconds after which it ends likewise, with what was computed; what is sought later, as changes of
            stability, has the seconds that are left.
        until: ends the family at the first orbit for which it is true.
        stability: whether multipliers are computed for each orbit.
        events: whether every change of stability is sought.
        tolerance: bounds the relative error of Omega, profile and multipliers.
        parameters: values of the parameters of an `OdeModel` by name, where they are not its nominal ones.
        progress: called with each orbit.
        method: fields of `Method`: transcription, degree, corrector, walker, flow, tail, symmetry,
            stability_sites.

    Returns:
        The branch; one that ended early has `complete` False and a `reason`.

    Raises:
        ValueError, TypeError: an argument is out of range; the message names it.

    Collocation and pseudo-arclength continuation in scaled coordinates (paper, Sec. II; Keller 1977).
    """
    _check_choices(stability, events, until, progress)
    check_options("follow_family", method, follow_family, Method)
    seconds = duration("time_limit", time_limit)
    request = family_request(
        model, mode, amplitude_max, at=at, at_Omega=at_Omega, at_period=at_period, period_max=period_max,
        max_points=max_points, tolerance=tolerance, parameters=parameters, **method,
    )  # fmt: skip
    request = request.for_stability(method.get("walker")) if stability else request
    return BranchRun(Family(request), stability, events, until=until, time_limit=seconds).to_end(progress)


def _check_choices(stability: object, events: object, until: object, progress: object) -> None:
    """Raises TypeError for flags that are no choice, and for callbacks that are neither a function nor None."""
    truth("stability", stability)
    truth("events", events)
    for name, function in (("until", until), ("progress", progress)):
        function_of(name, function, "a solution")


@in_turn
def follow(
    solution: Solution,
    parameter: str,
    to: float,
    *,
    at: Sequence[float] = (),
    max_points: int = MAX_POINTS,
    max_step: float = 0.2,
    back_to: float | None = None,
    time_limit: float | None = None,
    until: Callable[[Any], bool] | None = None,
    stability: bool = False,
    events: bool = True,
    monitors: Mapping[str, Any] | None = None,
    fixed: str | None = None,
    period_max: float | None = None,
    progress: Callable[[Any], None] | None = None,
) -> Branch:
    """The branch through a solution in the direction of `to`, by pseudo-arclength continuation (Keller 1977).

    Arguments:
        solution: an equilibrium, an orbit or a solution of a boundary-value problem without objective; an orbit of a
            family is first solved again as a boundary-value problem at its S.
        parameter: name of the parameter to follow; the others keep their values.
        to: where the branch ends; it goes round folds on its way.
        at: values at which solutions are wanted exactly, as often as the branch passes them.
        max_points: number of points after which the branch ends.
        max_step: longest step, 1 being a change of the states by their own size.
        back_to: a value on the other side of the start, where a branch that comes back ends; left out, it ends at the
            value that it started from, and one of equilibria or of a forced model goes on to see whether it closes.
        time_limit: seconds after which the branch ends, with what was computed.
        until: ends the branch at the first solution for which it is true.
        stability: whether multipliers are computed for each orbit; equilibria have their eigenvalues always.
        events: whether changes of stability are located.
        monitors: expressions in states and parameters by name, or functions f(t, x, p) of CasADi's symbols: where one
            vanishes along the branch is a special point of that name, and `branch[name]` has its values. The states are
            those of an equilibrium, of an orbit at phase zero (see `section` of `find_orbit`), of another solution at
            the start of its interval. A value that is touched without a change of sign is no special point; a change of
            sign on a stretch where rounding is as large as the quantity is `unresolved`.
        fixed: "period" or "frequency", of orbits that `select` picks from a family: these keep their values in place of
            that.
        period_max: of orbits with a period of their own: the branch ends at this period too. Where it comes to a
            homoclinic or heteroclinic orbit it goes on beside that up to this period; left out, it ends where the
            parameter is that of the limit within the tolerance.
        progress: called with each solution.

    Returns:
        The branch. One that is a closed curve is followed once, and its end is named so.

    Raises:
        ValueError: an argument is out of range.
        BoundaryError, EquilibriumError: the start cannot be solved.
    """
    _check_choices(stability, events, until, progress)
    seconds = duration("time_limit", time_limit)
    options = {"at": at, "max_points": max_points, "max_step": max_step, "back_to": back_to}
    space = following_space(solution, parameter, to, **options)
    space = up_to_period(held_space(space, fixed), period_max)
    if stability and not space.closes:
        accepted = "for orbits, and for conditions x(end) = S x(start)"
        raise ValueError(f"stability: given for solutions that are no orbits; accepted: {accepted}")
    space = monitored_space(space, monitors)
    return BranchRun(space, stability, events, until=until, time_limit=seconds).to_end(progress)


def held_space(space: Any, fixed: str | None) -> Any:
    """The space of a branch along which what is `fixed` keeps its value; raises ValueError for others."""
    if fixed is None:
        return space
    check_name("fixed", fixed, [PERIOD, FREQUENCY])
    return at_fixed_period(space)


def monitored_space(space: Any, given: Mapping[str, Any] | None) -> Any:
    """A space with monitors by name; raises ValueError and TypeError for other names and expressions."""
    from casadi_skin.follow.find import checked_scalar

    model, found = space.model, list[Monitor]()
    taken = {*KINDS, EDGE, KREIN, STABILITY, *model.state_names, *model.parameter_names}
    for name, one in by_name("monitors", given, "expressions").items():
        if not name.strip() or not name.isprintable() or name in taken:
            accepted = "names in one line, which no state, parameter or kind of special points has"
            raise ValueError(f"monitors: given {short_repr(name)}; accepted: {accepted}")
        found.append(Monitor(name, model.function("monitor", checked_scalar(f"monitors, {name}", one, model))))
    return replace(space, monitors=tuple(found))


def following_space(solution: Solution, parameter: str, to: float, **options: Any) -> Any:
    """The space of the branch through a solution in a parameter; options and errors are those of `follow`."""
    if solution.space.connects == FAMILY:
        from casadi_skin.follow.find import restated

        solution = restated(solution, parameter)
    if solution.space.optimises:
        raise ValueError("follow: given a solution with an objective; accepted: one without")
    settings = following_settings(solution, parameter, to, **options)
    _check_regular(solution, parameter)
    at = tuple(float(np.float64(value)) for value in options["at"])
    return solution.space.branch_space(solution, parameter, float(to), at, settings)


def _check_regular(solution: Solution, parameter: str) -> None:
    """Raises ValueError for a fold or a branch point, where equations at a held parameter are singular."""
    kind = solution.space.kind or solution.point.special
    if kind in (FOLD, BRANCH_POINT):
        why = f"where the equations at a held {parameter} are singular"
        accepted = f"a solution beside it, or `curve` of the {kind} itself"
        raise ValueError(f"follow: given a {kind}, {why}; accepted: {accepted}")
