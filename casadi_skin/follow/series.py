"""Walking along a branch on its own Taylor series: the asymptotic numerical method (Cochelin 1994).

At each base point the series to high order costs one factorisation; as far as it converges the branch is a polynomial
evaluation. The corrector confirms every point that is reported, and seldom moves it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.arclength import START_FRACTION, Continuation
from casadi_skin.follow.corners import CORNER_STEP_FRACTION, Corner, Side, point_before, shifts, side_of, turned
from casadi_skin.follow.point import STACKED_UNKNOWNS, LocalCurve, PointSolver, newton_steps
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.solve.levels import Measured
from casadi_skin.solve.newton import Correction, Status
from casadi_skin.zero.problem import Array, Problem, Scalar, SingularError
from casadi_skin.zero.settings import End, Point, Target

if TYPE_CHECKING:
    from casadi_skin.zero.cosines import Recursion


# Newton steps from places of a stretch of series: one by one, or all those of a stretch in arrays ---------------------

FAINT_STATE_RATIO = 1e-7  # of the largest state: its square is round-off


def _is_faint(states: Array) -> NDArray[np.bool_]:
    sizes = np.abs(states)
    return np.asarray(sizes < FAINT_STATE_RATIO * np.max(sizes, axis=1)[:, None])


@dataclass(frozen=True)
class Polished:
    """A place after a Newton step of length `step`, with its unit tangent and the sign of the determinant.

    `row` and `value` are what was held; `measured` is the error where that has been estimated.
    """

    z: Array
    tangent: Array
    orientation: float
    step: float
    row: Array
    value: float
    measured: Measured | None = None


TURNING_SAMPLES = 9  # of a stretch, at which the turning of the tangent is measured
AT_BASE = 1e-6  # of the unit of the series: nearer to the base a crossing is the base itself
SPARSE_TURN_FACTOR = 2.0  # times the turn that a walk aims for which predicts each point from the last
CONFIRMED_TOGETHER = 20  # points, of one stretch or several, that the corrector confirms at a time
SHORT_STEP_FACTOR = 3.0  # times the precision of the series: a step whose square is below what correctors leave
NEARLY_AT_CORNER = 0.9  # of the way to a corner: a stretch to it, where the point before it is not found
STRETCH_SHRINKAGE = 0.8  # of a stretch whose end does not satisfy the equations
# Of the way to a stop: where rounding is amplified in one place, it is less beside it.
FRACTIONS_BESIDE_STOP = (1.0, 0.9, 0.7, 0.5)
FRACTION_BEYOND_STOP = 1.2  # of the way to the last stop, beyond which the series loses digits fast


@dataclass(frozen=True)
class _Stop:
    """A point to report at tau; `target` is what to hold there, None where the coordinate is held."""

    tau: float
    target: Target | None
    requested: bool = False


@dataclass(frozen=True)
class _Reached:
    """A stop with its point before the corrector's last word, None where none was found.

    `end` is the cause for which the walk ends with it; `detail` is where the last trouble was.
    """

    stop: _Stop
    point: Point | None
    end: End | None = None
    detail: str = ""


class SeriesContinuation(Continuation):
    """The continuation by Taylor series for problems whose series `recursion` computes.

    `precision` of a problem is the residual, relative to the state, that the series may leave.
    """

    def __init__(
        self,
        point_solver: PointSolver,
        history: tuple[Point, ...],
        recursion: Callable[[Problem], Recursion],
        precision: Callable[[Problem], float],
        reported: tuple[Point, ...] = (),
    ) -> None:
        super().__init__(point_solver, history, reported)
        self._recursion, self._precision, self._trouble = recursion, precision, ""
        self._ready: dict[_Stop, Polished] = {}  # stops of this stretch that are polished
        self._most = np.inf  # length of the next stretch, in the metric, where its base is next to a corner

    def __iter__(self) -> Iterator[Point]:
        count = 0
        while self.end is None:  # each time from the last point, which the corrector may have moved
            for reached, word in self._confirmed():
                point, self.detail = self._emitted(reached, word), reached.detail or self.detail
                if point is None:
                    self._without(reached, word)
                else:
                    count += 1
                    if point.walked:
                        self.history = (self.history[-1], point)
                    yield point
                    if point.parameter * self.settings.parameter_max <= 0:
                        self.end = End.RETURNED
                self.end = self.end or reached.end
                if self.end is None and count >= self.settings.max_points and self.history[-1] is point:
                    self.end, self.detail = End.POINTS, f"{self.settings.max_points} points"
                moved = point is not None and point.walked and (reached.point is None or word is not reached.point)
                if self.end is not None or moved:
                    break

    def _emitted(self, reached: _Reached, word: Point | SingularError | None) -> Point | None:
        """The point of a stop with the corrector's last word on it; None where there is none."""
        before = reached.point
        if before is None or not isinstance(word, Point) or word is before:
            return before if word is before else None
        walked = before.walked or (word.problem is not before.problem and reached.end is None)
        return replace(word, requested=before.requested, walked=walked, step=before.step, along=before.along)

    def _without(self, reached: _Reached, word: Point | SingularError | None) -> None:
        """Take down that there is no point at a stop, and why the walk ends there if it does."""
        if isinstance(word, SingularError):
            self.detail = f'{word}; try walker = "arclength"'
        if reached.stop.target is not None:
            self.missed.append(reached.stop.target)
        elif reached.end is None:
            self.end = End.RESOLUTION if self.detail == "" else End.NO_STEP

    def _confirmed(self) -> Iterator[tuple[_Reached, Point | SingularError | None]]:
        """Stops from the last point of the history on, each with what the corrector makes of its point.

        Points of one problem are confirmed as many at a time as the corrector does, from any number of stretches.
        """
        some, problem = list[_Reached](), None
        for reached in self._ahead(self.history[-1]):
            if reached.point is not None and reached.point.problem is not problem:
                yield from self._words(some)
                some, problem = [], reached.point.problem
            some.append(reached)
            if problem is None or len(some) >= self.point_solver.levels.corrector(problem).together:
                yield from self._words(some)
                some = []
        yield from self._words(some)

    def _words(self, some: list[_Reached]) -> list[tuple[_Reached, Point | SingularError | None]]:
        held = [None if one.stop.target is None else one.stop.target.held for one in some]
        found = [(one.point, what) for one, what in zip(some, held, strict=True) if one.point is not None]
        words = iter(self.point_solver.confirmed(found))
        return [(one, None if one.point is None else next(words)) for one in some]

    def _ahead(self, base: Point) -> Iterator[_Reached]:
        """Stops in arclength order from a base point on, one stretch after the other, up to the end of the walk."""
        last, self._passed = self._passed, 0.0
        self._most = np.inf
        while True:
            found = self._departure(base)
            if found is None:
                yield _Reached(_Stop(0.0, None), None, End.NO_STEP, self._trouble)
                return
            reached = None
            for reached in self._points(*found, last):
                yield reached
                if reached.end is not None or (reached.point is None and reached.stop.target is None):
                    return
            if reached is None or reached.point is None or not reached.point.walked:
                if (
                    self._most < np.inf
                ):  # nearer to a corner than to the next point: a shorter stretch from the same base
                    last = last if reached is None else reached.stop.tau
                    continue
                yield _Reached(_Stop(0.0, None), None, End.NO_STEP, self._trouble)
                return
            base, last = reached.point, 0.0

    # The series -----------------------------------------------------------------------------------------------------

    def _departure(self, base: Point) -> tuple[Point, LocalCurve, Side] | None:
        """A base point, on a coarser level where that is expected to do, with its series; None where there is none."""
        lighter = self.point_solver.lighter(base)
        for problem in dict.fromkeys((lighter, base.problem)):
            if problem is not base.problem:
                z, t = (base.problem.prolong(v, problem) for v in (base.z, base.tangent))
                tried = replace(base, problem=problem, z=z, tangent=t)
            else:
                tried = base
            try:
                found = self._stretch(tried)
            except SingularError as error:
                self._trouble = str(error)
                continue
            if found is None:
                continue
            coarser = problem is not base.problem and self.settings.rounds_corners
            reach = base.step * min(found[0].length, 1.0)  # a base next to a corner may be beyond it on another level
            if not (coarser and shifts(self.point_solver, base, found[1], reach)):
                return tried, *found
        return None

    def _stretch(self, base: Point) -> tuple[LocalCurve, Side] | None:
        """The series at a base point, as far as its end satisfies the equations; None where that is nowhere."""
        problem = base.problem
        precision = self._precision(problem)
        row = self.point_solver.metric(problem, base.z) * base.tangent
        residual, nonzeros = problem.evaluate(base.z)
        solve = self.point_solver.levels.solver(problem).factor(base.z, nonzeros, row)
        z = base.z - solve(np.append(residual, 0.0))
        if base.parameter == 0.0:
            z[problem.parameter_index] = 0.0  # but for round-off, which must not skip tiny requested values
        slope = base.step * self.point_solver.tangent(problem, z, solve)
        recursion = self._recursion(problem)
        coefficients = recursion.series(z, slope, solve)
        sizes = np.sqrt(np.sum(self.point_solver.metric(problem, z) * coefficients[-2:] ** 2, axis=1))
        orders = np.arange(coefficients.shape[0] - 2, coefficients.shape[0])
        stretch = LocalCurve(coefficients, float(np.min((precision / np.maximum(sizes, 1e-300)) ** (1.0 / orders))))
        stretch, self._most = replace(stretch, length=min(stretch.length, self._most / base.step)), np.inf
        if recursion.end is not None:
            passed = stretch.crossings(recursion.end[0], [recursion.end[1]])
            stretch = replace(stretch, length=min([stretch.length, *(tau for tau, _ in passed)]))
        while stretch.length * base.step >= self.settings.min_step:
            end = stretch.at(stretch.length)
            allowed = precision * max(1.0, float(np.max(np.abs(end[: problem.states]))))
            if problem.frequency(end) > 0 and np.max(np.abs(problem.evaluate(end)[0])) <= allowed:
                return stretch, Side(problem, z, slope / base.step, solve.orientation)
            self.rejected += 1
            stretch = replace(stretch, length=STRETCH_SHRINKAGE * stretch.length)
        return None

    # The points -----------------------------------------------------------------------------------------------------

    def _points(self, base: Point, stretch: LocalCurve, side: Side, last: float) -> Iterator[_Reached]:
        """Stops of a stretch beyond the place `last`; the last point is the next base, unless the walk ends before.

        The last one may be a point before a corner, which the series passes by; `side` is that of the base.
        """
        problem, ends = base.problem, self.settings.ends
        stops = [stop for stop in self._stops(base, stretch) if stop.tau > last]
        self._ready = {}
        if len(stops) > 1 and problem.size <= STACKED_UNKNOWNS and BorderedSolver.of(problem).takes_several:
            with suppress(ArithmeticError, RuntimeError):  # at a place that the walk may not come to, or it comes again
                ready = self._polished(problem, stretch, stops)
                self._ready = dict(zip(stops, ready, strict=True))
        for stop in stops:
            reach = max(base.step * (stop.tau - last), self.settings.min_step)  # nearer than that is round-off
            is_last, end = stop is stops[-1], End.REACHED if stop.target in ends else None
            fractions = (*FRACTIONS_BESIDE_STOP, FRACTION_BEYOND_STOP) if is_last else FRACTIONS_BESIDE_STOP
            stop, point, there = self._found(problem, stretch, stop, last, reach, fractions)
            corner = None if there is None else self._corner(side, there, point, reach)
            if corner is not None:
                yield from self._at_corner(base, corner, last)
                return
            side = there or side
            if point is None:
                yield _Reached(stop, None, end, self._trouble)
                continue
            last = stop.tau
            finished = end is None and (is_last or point.problem is not problem)
            step = base.step * stretch.length
            placed = replace(point, requested=stop.requested, walked=finished, step=step, along=stop.tau)
            yield _Reached(stop, placed, end, self._trouble)
            if finished:
                return

    def _corner(self, side: Side, there: Side, point: Point | None, reach: float) -> Corner | None:
        """The corner between two stops; None where there is none, or where none is sought."""
        if not self.settings.rounds_corners:
            return None
        climbed = point is not None and point.problem is not there.problem
        if point is not None and climbed and shifts(self.point_solver, there, point, reach):
            there = side_of(self.point_solver, point.problem, point) or there
        return turned(self.point_solver, side, there)

    def _at_corner(self, base: Point, corner: Corner, last: float) -> Iterator[_Reached]:
        """The point before a corner, from which another series goes on; none where the base is near it."""
        before = corner.before
        start = base.problem.prolong(base.z, before.problem)
        passed, point = self.point_solver.distance(before.problem, start, before.z), None
        try:
            point = None if passed <= self.settings.min_step else point_before(self.point_solver, corner)
        except SingularError as error:
            self._trouble = str(error)
        if point is None or passed <= corner.length:
            self._most = NEARLY_AT_CORNER * passed if passed > corner.length else CORNER_STEP_FRACTION * corner.length
        if point is not None:
            yield _Reached(_Stop(last, None), replace(point, walked=True, along=last), None, self._trouble)

    def _stops(self, base: Point, stretch: LocalCurve) -> list[_Stop]:
        """Places of reported points: requested values, and often enough to draw and to see stability change."""
        wanted, ends = self.settings.wanted, self.settings.ends
        stops = []
        for held in Scalar:
            by_value = {target.unknown(base.problem)[1]: target for target in wanted if target.held is held}
            if not by_value:
                continue
            for tau, value in stretch.crossings(base.problem.index_of(held), by_value):
                target = by_value[value]
                if tau > AT_BASE or not target.meets(base):
                    stops.append(_Stop(tau, target, wanted[target]))
        stops.sort(key=lambda stop: stop.tau)
        final = next((stop.tau for stop in stops if stop.target in ends), stretch.length)
        pieces = self._pieces(base, stretch, final)
        if base.parameter == 0.0:
            stops.append(_Stop(START_FRACTION * final / pieces, None))
        taken = [stop.tau for stop in stops]
        for tau in np.linspace(0.0, final, pieces + 1)[1:]:
            if not any(abs(tau - other) <= 1e-9 * stretch.length for other in taken):
                stops.append(_Stop(float(tau), None))
        return sorted((stop for stop in stops if stop.tau <= final), key=lambda stop: stop.tau)

    def _pieces(self, base: Point, stretch: LocalCurve, final: float) -> int:
        """Number of equal parts in which no limit on a step is exceeded."""
        problem, settings = base.problem, self.settings
        points, slopes = stretch.samples(final, TURNING_SAMPLES)
        weights = self.point_solver.metric(problem, points[0])
        sizes = np.sqrt(np.einsum("ij,ij,j->i", slopes, slopes, weights))
        cosines = np.einsum("ij,ij,j->i", slopes[1:], slopes[:-1], weights) / (sizes[1:] * sizes[:-1])
        steps = points[1:] - points[:-1]
        most = [
            float(np.sum(np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))))
            / (SPARSE_TURN_FACTOR * settings.aim_angle),
            (TURNING_SAMPLES - 1)
            * float(np.max(np.abs(steps[:, problem.parameter_index])))
            / (settings.max_parameter_step * abs(settings.parameter_max)),
            float(np.sum(np.sqrt(np.einsum("ij,ij,j->i", steps, steps, weights)))) / settings.max_step,
        ]
        return max(1, math.ceil(max(most)))

    def _found(
        self, problem: Problem, stretch: LocalCurve, stop: _Stop, last: float, reach: float, fractions: Sequence[float]
    ) -> tuple[_Stop, Point | None, Side | None]:
        """A stop with its point and side, or the first beside it that has one, at fractions of the way from `last`."""
        for fraction in fractions if stop.target is None else FRACTIONS_BESIDE_STOP[:1]:
            here = stop if fraction == 1.0 else replace(stop, tau=last + fraction * (stop.tau - last))
            point, there = self._point(problem, stretch, here, reach)
            if point is not None:
                return here, point, there
        return stop, None, there

    def _point(
        self, problem: Problem, stretch: LocalCurve, stop: _Stop, reach: float
    ) -> tuple[Point | None, Side | None]:
        """The corrected point at a stop and its side; None where the corrector does not find it near the series."""
        target = stop.target
        held = None if target is None else target.held
        try:
            found = self._ready.get(stop)
            if found is None:
                (found,) = self._polished(problem, stretch, [stop])
            correction: Correction | None = Correction(found.z, Status.CONVERGED, 0)
            measured = found.measured
            if not found.step <= SHORT_STEP_FACTOR * self._precision(problem):
                correction, measured = self.point_solver.correct(problem, found.z, found.row, found.value, reach), None
            if correction is None:
                self._trouble = f'{self.point_solver.failure}; try walker = "arclength"'
                return None, None
            if target is not None:
                index, wanted = target.unknown(problem)
                correction.z[index] = wanted  # equal but for round-off of the held row
            there = Side(problem, correction.z, found.tangent, found.orientation)
            known = found.tangent, measured, False
            return self.point_solver.refined(problem, correction, found.row, held, *known), there
        except SingularError as error:
            self._trouble = str(error)
            return None, None

    def _polished(self, problem: Problem, stretch: LocalCurve, stops: Sequence[_Stop]) -> list[Polished]:
        """The places of stops after a Newton step, of several with their errors; raises SingularError.

        At a target its value is held, elsewhere the place along the tangent. In the series small components, as those
        in the tail of a breather, have the absolute precision of large ones. They are left out of the guess, so that
        the step solves for them and finds them accurate relative to themselves. They are small in the output too:
        amplitudes that grow into a tail in the gauge are no reason to leave out the edge.
        """
        z, slopes = stretch.at_each(np.array([stop.tau for stop in stops]))
        held = [None if stop.target is None else stop.target.held for stop in stops]
        weights = self.point_solver.metrics(problem, z)
        rows = weights * slopes / np.sqrt(np.sum(weights * slopes**2, axis=1))[:, None]
        values = np.einsum("ij,ij->i", rows, z)
        wanted = [(i, *stop.target.unknown(problem)) for i, stop in enumerate(stops) if stop.target is not None]
        for i, index, value in wanted:
            rows[i] = problem.row_of(held[i]) * float(np.sign(slopes[i, index]))  # type: ignore[arg-type]
            values[i] = value * rows[i, index]
        states = z[:, : problem.states]  # a view
        faint, scale = _is_faint(states), problem.output_scale
        states[faint if scale is None else faint & _is_faint(scale * states)] = 0.0
        steps = newton_steps(problem, z, np.einsum("ij,ij->i", rows, z) - values, rows)
        z = z - steps.newton
        for i, index, value in wanted:
            z[i, index] = value  # equal but for round-off of the held row
        lengths = np.sqrt(np.sum(weights * steps.newton**2, axis=1))
        tangents = steps.along / np.sqrt(np.sum(weights * steps.along**2, axis=1))[:, None]
        known: Sequence[Measured | None] = [None] * len(z)
        if len(z) > 1:
            known = self.point_solver.levels.all_refined(problem, z, tangents, held) or known
        columns = z, tangents, steps.orientation.tolist(), lengths.tolist(), rows, values.tolist(), known
        return [Polished(*place) for place in zip(*columns, strict=True)]
