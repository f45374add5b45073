"""Following a branch of any kind: its continuation, with stability and special points computed beside it."""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from casadi_skin.arguments import check_name, function_of, number, numbers, truth, whole
from casadi_skin.bvp.problem import Scalar
from casadi_skin.continuation.points import Continuation, ContinuationSettings, End, Point, Target
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.bifurcations import bifurcations_between
from casadi_skin.orbits.boundary_space import BoundarySpace
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.making import solution_at
from casadi_skin.orbits.method import MAX_POINTS
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.request import FamilyModel, FamilyRequest, family_request
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.space import Follows, SolutionSpace
from casadi_skin.orbits.special_points import FOLD, NotLocatedError
from casadi_skin.orbits.stability_changes import StabilityChange, locate_change
from casadi_skin.stability.flow import FlowError
from casadi_skin.threads import one_thread


class Following:
    """Iterates over the solutions of a branch and, between two of them, over the changes of stability.

    What has been computed is in `branch()` at any time, but for the few points whose stability is computed together;
    `keep` is called with each point as it converges, and with what the continuation has missed so far. Solutions and
    changes computed earlier may be given, points after them whose stability is `waiting`, and what was `missed`: the
    branch goes on from the last of these as if it had not been broken off.
    """

    def __init__(
        self,
        space: SolutionSpace,
        stability: bool = False,
        events: bool = True,
        solutions: Sequence[Solution] = (),
        changes: Sequence[StabilityChange] = (),
        until: Callable[[Any], bool] | None = None,
        waiting: Sequence[Point] = (),
        missed: Sequence[Target] = (),
        keep: Callable[[Point, Sequence[Target]], None] | None = None,
    ) -> None:
        stability = stability and not space.knows_stability
        self.space, self.stability, self.events, self.until = space, stability, events and stability, until
        self.solutions, self.changes = list(solutions), list(changes)
        self._waiting: deque[Point] = deque(waiting)  # reached, but not yet among the solutions
        self._keep = keep
        self._known = [*(s.point for s in self.solutions), *waiting]
        self._continuation = self._continued() if self._known or space.start_is_limit else None
        if self._continuation is not None:
            self._continuation.missed.extend(missed)
        self._end: End | None = None
        self._detail = ""
        self._stopped = False
        self.solutions = list(self._with_bifurcations(self.solutions))

    def _with_bifurcations(self, solutions: Sequence[Solution]) -> Iterator[Solution]:
        """Solutions computed earlier, with the orbits between them at which multipliers cross, sought again."""
        self.solutions = []
        for solution in solutions:
            for special in (*self._bifurcations_before(solution), solution):
                self.solutions.append(special)
                yield special

    def _continued(self) -> Continuation:
        """The continuation from the points that are known."""
        walked = [i for i, point in enumerate(self._known) if point.walked]
        own = tuple(self._known[i] for i in walked)
        reported = tuple(p for p in self._known[walked[-1] + 1 if walked else 0 :] if not p.located)
        history = (self.space.start, *own) if self.space.start_is_limit or not own else own
        return self.space.continuation(history, reported)

    def __iter__(self) -> Iterator[Solution | StabilityChange]:
        results = self._results()
        while True:
            with one_thread(), interrupts_deferred():  # not while whoever iterates is at work
                result = next(results, None)
            if result is None:
                return
            yield result

    def _points(self) -> Iterator[Point]:
        """Points of the branch with the folds between them; sets `_end` where the branch cannot go on."""
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
            if end is not None:
                self._end = end
                return

    def _special_between(self, before: Point, after: Point) -> Iterator[Point]:
        """Special points between two points; round a fold that is alone the points asked for beside it."""
        found = list(self.space.special_between(before, after))
        if len(found) == 1 and found[0].special == FOLD:
            yield from self._round_fold(before, after, found[0])
            return
        yield from (replace(special, located=True) for special in found)

    def _round_fold(self, before: Point, after: Point, fold: Point) -> Iterator[Point]:
        """A fold between two points, and the points asked for so near to it that the continuation passes them by."""
        solver = self.space.point_solver
        for one, other in ((before, fold), (fold, after)):
            low, high = sorted((one.parameter, other.parameter))
            wanted = [t for t in solver.settings.at if t.held is Scalar.PARAMETER and low < t.value < high]
            inside = tuple(t for t in wanted if not (t.meets(one) or t.meets(other)))
            found = {target: point for target, point in solver.between(one, other, inside) if point is not None}
            for point in found.values():
                yield replace(point, requested=True, located=True)
            assert self._continuation is not None
            self._continuation.missed += [t for t in inside if t not in (*found, *self._continuation.missed)]
            if other is fold:
                yield replace(fold, located=True)

    def _has_amplitude(self, point: Point) -> bool:
        """Whether a point of a family is on the side of S = 0 that it is followed to."""
        return point.parameter * self.space.point_solver.settings.parameter_max > 0.0

    def _results(self) -> Iterator[Solution | StabilityChange]:
        together = self.space.stability_batch if self.stability else 1
        limit = self.space.point_solver.settings.max_points
        if len(self._waiting) >= together:
            yield from self._finish_waiting()
        for point in self._points():
            if len(self.solutions) + len(self._waiting) == limit:
                self._end = End.POINTS
                break
            self._waiting.append(point)
            if self._keep is not None:
                self._keep(point, () if self._continuation is None else self._continuation.missed)
            if len(self._waiting) >= together:
                yield from self._finish_waiting()
            if self._stopped or self._end is End.FLOW:
                return
        yield from self._finish_waiting()

    def _finish_waiting(self) -> Iterator[Solution | StabilityChange]:
        """The solutions of the points that wait, with their stability and its changes, in order."""
        try:
            for solution in self._with_stability():
                for special in self._bifurcations_before(solution):
                    self.solutions.append(special)
                    yield special
                change = self._change_before(solution)
                if change is not None:
                    self.changes.append(change)
                    yield change
                self.solutions.append(solution)
                self._waiting.popleft()
                yield solution
                if self.until is not None and self.until(solution):
                    self._stopped = True
                    self._waiting.clear()
                    return
        except FlowError as error:
            self._end, self._detail = End.FLOW, str(error)
            self._waiting.clear()

    def _change_before(self, solution: Solution) -> StabilityChange | None:
        """The change of stability between the last orbit and this one, where they differ."""
        if not (self.events and self.solutions) or isinstance(self.space, Family):  # of a family see stability_diagram
            return None
        before = self.solutions[-1]
        if not (isinstance(before, Orbit) and isinstance(solution, Orbit)):
            return None
        if before.floquet().stable == solution.floquet().stable:
            return None
        return locate_change(self.space, before, solution)

    def _bifurcations_before(self, solution: Solution) -> Iterator[Solution]:
        """Orbits between the last orbit and this one at which multipliers cross the unit circle."""
        if not (self.events and self.solutions):
            return
        before = self.solutions[-1]
        leaving = isinstance(self.space, BoundarySpace) and self.space.leaves and len(self.solutions) == 1
        if isinstance(before, Orbit) and isinstance(solution, Orbit) and not leaving:
            yield from bifurcations_between(before, solution)

    def _with_stability(self) -> Iterator[Solution]:
        """Solutions of the points that wait; raises FlowError at the first whose stability cannot be computed."""
        points = list(self._waiting)
        if not (points and self.stability):
            yield from (solution_at(self.space, point) for point in points)
            return
        try:
            known = self.space.floquets(points)
        except FlowError:  # of one of them: those before it are computed by themselves
            yield from (solution_at(self.space, point, self.space.floquets([point])[0]) for point in points)
            return
        yield from (solution_at(self.space, point, result) for point, result in zip(points, known, strict=True))

    def branch(self) -> Branch:
        """What has been computed so far."""
        walked_end = None if self._continuation is None or self._waiting else self._continuation.end
        end, detail = self._end or walked_end, self._detail
        if self._continuation is not None and not detail:
            detail = self._continuation.detail
        return self.finished(end, detail, self._misses(end))

    def _misses(self, end: End | None) -> dict[str, tuple[float, ...]]:
        """Values asked for without a solution: those that the continuation missed, and at its end all others.

        Where a condition stopped the branch, those that it had passed before.
        """
        missed = [] if self._continuation is None else self._continuation.missed
        misses, whole = {}, end is End.REACHED and not self._stopped
        for name, values in self._asked().items():
            had = {self._value(name, s) for s in self.solutions}
            found = {v for v in values if self.space.target(name, v) in missed or (whole and v not in had)}
            if self._stopped:
                found = {v for v in found if min(had) <= v <= max(had)}
            if found:
                misses[name] = tuple(sorted(found))
        return misses

    def _asked(self) -> Mapping[str, Sequence[float]]:
        """All values asked for by name, the ends among them where the continuation missed them."""
        asked, settings = dict(self.space.asked()), self.space.point_solver.settings
        missed = [] if self._continuation is None else self._continuation.missed
        if Target(Scalar.PARAMETER, settings.parameter_max) in missed:
            asked[self.space.parameter] = (*asked[self.space.parameter], self.space.to)
        return asked

    def _value(self, name: str, solution: Solution) -> float:
        return solution.exact[name] if name in solution.exact else self.space.value(name, solution.point)

    def finished(
        self, end: End | None, detail: str, misses: Mapping[str, tuple[float, ...]], stopped: bool = False
    ) -> Branch:
        """The branch of what has been computed, with a known end."""
        return Branch(
            self.space, tuple(self.solutions), tuple(self.changes),
            self.stability or self.space.knows_stability, end, detail, misses,
            stopped or self._stopped, self.events,
        )  # fmt: skip


def run_following(following: Following, progress: Callable[[Any], None] | None) -> Branch:
    """Follow a branch to its end, calling `progress` with each solution."""
    for result in following:
        if progress is not None and isinstance(result, Solution):
            progress(result)
    return following.branch()


def follow_family(
    model: FamilyModel | OdeModel,
    mode: int | str,
    amplitude_max: float,
    *,
    at: Sequence[float] = (),
    at_Omega: Sequence[float] = (),
    at_period: Sequence[float] = (),
    period_max: float | None = None,
    max_points: int = MAX_POINTS,
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
            vanish, or what the model's normalisation says.
        at: values of S at which orbits are wanted exactly, as often as the family passes them.
        at_Omega: frequencies, likewise.
        at_period: periods, likewise.
        period_max: period at which the family ends where that comes before `amplitude_max`.
        max_points: number of orbits after which it ends wherever it is.
        until: ends the family at the first orbit for which it is true.
        stability: whether multipliers are computed for each orbit.
        events: whether every change of stability is sought.
        tolerance: bounds the relative error of Omega, profile and multipliers.
        parameters: values of the parameters of an `OdeModel` by name, where they are not its nominal ones.
        progress: called with each orbit.
        method: fields of `Method`: transcription, degree, corrector, walker, flow, tail, symmetry.

    Returns:
        The branch; one that ended early has `complete` False and a `reason`.

    Raises:
        ValueError, TypeError: an argument is out of range; the message names it.

    Collocation and pseudo-arclength continuation in scaled coordinates (paper, Sec. II; Keller 1977).
    """
    _check_choices(stability, events, until, progress)
    request = family_request(
        model, mode, amplitude_max, at=at, at_Omega=at_Omega, at_period=at_period, period_max=period_max,
        max_points=max_points, tolerance=tolerance, parameters=parameters, **method,
    )  # fmt: skip
    request = for_stability(request, method.get("walker")) if stability else request
    return run_following(Following(Family(request), stability, events, until=until), progress)


def _check_choices(stability: object, events: object, until: object, progress: object) -> None:
    """Raises TypeError for what is no choice, and for what is neither a function nor None."""
    truth("stability", stability)
    truth("events", events)
    for name, function in (("until", until), ("progress", progress)):
        function_of(name, function, "a solution")


def for_stability(request: FamilyRequest, walker: str | None = None) -> FamilyRequest:
    """The request with every position an unknown, as stability needs, unless its method asks for another way."""
    if request.method.tail is not None or request.coordinates.is_whole:
        return request
    request.coordinates.check_whole()
    return replace(request, method=replace(request.method, tail="full", walker=walker))


def follow(
    solution: Solution,
    parameter: str,
    to: float,
    *,
    at: Sequence[float] = (),
    max_points: int = 500,
    max_step: float = 0.2,
    until: Callable[[Any], bool] | None = None,
    stability: bool = False,
    events: bool = True,
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
        until: ends the branch at the first solution for which it is true.
        stability: whether multipliers are computed for each orbit; equilibria have their eigenvalues always.
        events: whether changes of stability are located.
        progress: called with each solution.

    Returns:
        The branch; it also ends where it comes back to the value that it started from.

    Raises:
        ValueError: an argument is out of range.
        BoundaryError, EquilibriumError: not even the start can be solved.
    """
    _check_choices(stability, events, until, progress)
    space = following_space(solution, parameter, to, at=at, max_points=max_points, max_step=max_step)
    if stability and isinstance(space, BoundarySpace) and space.periodic is None and space.closure is None:
        accepted = "for orbits, and for conditions x(end) = S x(start)"
        raise ValueError(f"stability: given for solutions that are no orbits; accepted: {accepted}")
    return run_following(Following(space, stability, events, until=until), progress)


def following_space(
    solution: Solution, parameter: str, to: float, *, at: Sequence[float], max_points: int, max_step: float
) -> SolutionSpace:
    """The space of the branch through a solution in a parameter; raises ValueError as `follow` does."""
    if isinstance(solution, Orbit) and isinstance(solution.space, Family):
        from casadi_skin.orbits.restating import restated

        solution = restated(solution, parameter)
    space = solution.space
    if isinstance(space, BoundarySpace) and space.statement.optimises:
        raise ValueError("follow: given a solution with an objective; accepted: one without")
    settings = following_settings(solution, parameter, to, at=at, max_points=max_points, max_step=max_step)
    assert isinstance(space, Follows)
    return space.following(solution, parameter, float(to), tuple(float(np.float64(v)) for v in at), settings)


def following_settings(
    solution: Solution, parameter: str, to: float, *, at: Sequence[float], max_points: int, max_step: float
) -> ContinuationSettings:
    """Settings of a branch from a solution in a parameter, checked; raises ValueError as `follow` does."""
    check_name("parameter", parameter, [name for name in solution.parameters if name not in solution.space.free])
    start, end = solution.parameters[parameter], number("to", to)
    if end == start:
        raise ValueError(f"to: given {end!r}, where the branch starts; accepted: another value")
    for value in numbers("at", at):
        if not min(start, end) <= value <= max(start, end):
            raise ValueError(f"at: given {value:g}; accepted: values from {start:g} to {end:g}")
    whole("max_points", max_points, 2)
    if not number("max_step", max_step) > 0.0:
        raise ValueError(f"max_step: given {max_step!r}; accepted: a number > 0")
    wanted = tuple(Target(Scalar.PARAMETER, (value - start) / (end - start)) for value in at)
    return ContinuationSettings(
        1.0, solution.space.tolerance, wanted, max_step=float(max_step), max_points=max_points, tiny_first=False,
        max_parameter_step=0.2,
    )  # fmt: skip
