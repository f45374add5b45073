"""Walking along a branch on its own Taylor series: the asymptotic numerical method (Cochelin 1994).

At each base point the series to high order costs one factorisation; as far as it converges the branch is a polynomial
evaluation. The corrector has the last word on every point that is reported, and finds nothing to do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from casadi_skin.bvp.problem import Array, Problem, Scalar, SingularError, Solve
from casadi_skin.continuation.arclength import START_FRACTION
from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import End, Point, Target, known_end
from casadi_skin.continuation.taylor import Stretch
from casadi_skin.solvers.corrector import Correction, Status

SAMPLES = 9  # of a stretch, at which the turning of the tangent is measured
AT_BASE = 1e-6  # of the unit of the series: nearer to the base a crossing is the base itself
FAINT = 1e-7  # of the largest state: its square is round-off
SPARSE = 2.0  # times the turn that a walk aims for which predicts each point from the last
TOGETHER = 8  # points of a stretch, about as many as one has, that the corrector confirms at a time
SHORT = 3.0  # times the precision of the series: the square of such a step is below what correctors leave
SHRINK = 0.8  # of a stretch whose end does not satisfy the equations


class Recursion(Protocol):
    """Power series of the branch through a point."""

    def series(self, z: Array, slope: Array, solve: Solve) -> Array:
        """Coefficients of the branch from z with first coefficient `slope`, shape (orders + 1, unknowns)."""
        ...


@dataclass(frozen=True)
class _Stop:
    """A point to report at tau; `target` is what to hold there, None where the coordinate is held."""

    tau: float
    target: Target | None
    requested: bool = False


class SeriesContinuation:
    """A walk by Taylor series (see `Continuation`) for problems whose series `recursion` computes.

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
        self.point_solver, self.settings = point_solver, point_solver.settings
        self.history, self._reported = history[-2:], reported
        self.end: End | None = None
        self.detail = ""
        self.rejected = 0
        self.missed: list[Target] = []
        self._recursion, self._precision = recursion, precision

    def __iter__(self) -> Iterator[Point]:
        sign, count = float(np.sign(self.settings.parameter_max)), 0
        known = known_end(self.settings, (*self.history, *self._reported))
        if known is not None:
            self.end = known
            return
        while count < self.settings.max_points:
            base = self.history[-1]
            found = self._departure(base)
            if found is None:
                self.end = End.NO_STEP
                return
            base, stretch = found
            for point in self._points(base, stretch):
                count += 1
                if point.walked:
                    self.history = (self.history[-1], point)
                yield point
                if sign * point.parameter <= 0:
                    self.end = End.RETURNED
            if self.end is not None:
                return
        self.end, self.detail = End.POINTS, f"{self.settings.max_points} points"

    # The series -----------------------------------------------------------------------------------------------------

    def _departure(self, base: Point) -> tuple[Point, Stretch] | None:
        """A base point, on a coarser level where that is expected to do, with its series; None where there is none."""
        lighter = self.point_solver.lighter(base)
        for problem in dict.fromkeys((lighter, base.problem)):
            if problem is not base.problem:
                z, t = (base.problem.prolong(v, problem) for v in (base.z, base.tangent))
                tried = replace(base, problem=problem, z=z, tangent=t)
            else:
                tried = base
            try:
                stretch = self._stretch(tried)
            except SingularError as error:
                self.detail = str(error)
                continue
            if stretch is not None:
                return tried, stretch
        return None

    def _stretch(self, base: Point) -> Stretch | None:
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
        coefficients = self._recursion(problem).series(z, slope, solve)
        sizes = np.sqrt(np.sum(self.point_solver.metric(problem, z) * coefficients[-2:] ** 2, axis=1))
        orders = np.arange(coefficients.shape[0] - 2, coefficients.shape[0])
        stretch = Stretch(coefficients, float(np.min((precision / np.maximum(sizes, 1e-300)) ** (1.0 / orders))))
        while stretch.length * base.step >= self.settings.min_step:
            end = stretch.at(stretch.length)
            allowed = precision * max(1.0, float(np.max(np.abs(end[: problem.states]))))
            if problem.frequency(end) > 0 and np.max(np.abs(problem.evaluate(end)[0])) <= allowed:
                return stretch
            self.rejected += 1
            stretch = replace(stretch, length=SHRINK * stretch.length)
        return None

    # The points -----------------------------------------------------------------------------------------------------

    def _points(self, base: Point, stretch: Stretch) -> Iterator[Point]:
        """Points of a stretch in arclength order; the last one is the next base, unless the walk ends before."""
        problem, ends = base.problem, self.settings.ends
        last, self._reported = max((point.along for point in self._reported), default=0.0), ()
        stops = [stop for stop in self._stops(base, stretch) if stop.tau > last]
        for stop, point in self._solved(base, stretch, stops, last):
            if point is None:
                if stop.target is None:
                    self.end = End.RESOLUTION if self.detail == "" else End.NO_STEP
                    return
                self.missed.append(stop.target)
            else:
                finished = stop.target not in ends and (stop is stops[-1] or point.problem is not problem)
                step = base.step * stretch.length
                yield replace(point, requested=stop.requested, walked=finished, step=step, along=stop.tau)
                if finished:
                    return
            if stop.target in ends:
                self.end = End.REACHED
                return

    def _solved(
        self, base: Point, stretch: Stretch, stops: list[_Stop], last: float
    ) -> Iterator[tuple[_Stop, Point | None]]:
        """Points at stops beyond the place `last`, a few confirmed at a time; None where the corrector finds none."""
        found: list[tuple[_Stop, Point]] = []
        for stop in stops:
            reach = max(base.step * (stop.tau - last), self.settings.min_step)  # nearer than that is round-off
            point = self._point(base.problem, stretch, stop, reach)
            if point is not None:
                last = stop.tau
                found.append((stop, point))
                if len(found) < TOGETHER and stop is not stops[-1] and point.problem is base.problem:
                    continue
            yield from self._confirmed(found)
            found = []
            if point is None:
                yield stop, None

    def _confirmed(self, found: list[tuple[_Stop, Point]]) -> Iterator[tuple[_Stop, Point | None]]:
        """Points with the corrector's last word on them."""
        held = [(point, None if stop.target is None else stop.target.held) for stop, point in found]
        for (stop, _), point in zip(found, self.point_solver.confirmed(held), strict=True):
            if isinstance(point, SingularError):
                self.detail = f'{point}; try walker = "arclength"'
            yield stop, None if isinstance(point, SingularError) else point

    def _stops(self, base: Point, stretch: Stretch) -> list[_Stop]:
        """Places of reported points: requested values, and often enough to draw and to see stability change."""
        wanted, ends = self.settings.wanted, self.settings.ends
        stops = []
        for held in Scalar:
            by_value = {target.unknown(base.problem)[1]: target for target in wanted if target.held is held}
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

    def _pieces(self, base: Point, stretch: Stretch, final: float) -> int:
        """Number of equal parts in which no limit on a step is exceeded."""
        problem, settings = base.problem, self.settings
        taus = np.linspace(0.0, final, SAMPLES)
        points = stretch.at(taus)
        weights = np.sqrt(self.point_solver.metric(problem, points[0]))
        slopes = weights * stretch.slope(taus)
        slopes /= np.linalg.norm(slopes, axis=1)[:, None]
        angles = np.degrees(np.arccos(np.clip(np.sum(slopes[1:] * slopes[:-1], axis=1), -1.0, 1.0)))
        moves = np.abs(np.diff(points[:, problem.parameter_index]))
        lengths = np.linalg.norm(weights * np.diff(points, axis=0), axis=1)
        most = [
            np.sum(angles) / (SPARSE * settings.aim_angle),
            (SAMPLES - 1) * np.max(moves) / (settings.max_parameter_step * abs(settings.parameter_max)),
            np.sum(lengths) / settings.max_step,
        ]
        return max(1, int(np.ceil(max(most))))

    def _point(self, problem: Problem, stretch: Stretch, stop: _Stop, reach: float) -> Point | None:
        """The corrected point at a stop; None where the corrector does not find it near the series."""
        guess, slope = stretch.at(stop.tau), stretch.slope(stop.tau)
        weights = self.point_solver.metric(problem, guess)
        tangent = slope / np.sqrt(np.sum(weights * slope**2))
        target = stop.target
        if target is None:
            row, value = weights * tangent, float((weights * tangent) @ guess)
        else:
            index, wanted = target.unknown(problem)
            row = problem.row_of(target.held) * float(np.sign(slope[index]))
            value = wanted * float(row[index])
        held = None if target is None else target.held
        try:
            polished, tangent, converged = self._polished(problem, guess, row, value)
            correction: Correction | None = Correction(polished, Status.CONVERGED, 0)
            if not converged:
                correction = self.point_solver.correct(problem, polished, row, value, reach)
            if correction is None:
                self.detail = f'{self.point_solver.failure}; try walker = "arclength"'
                return None
            if target is not None:
                correction.z[index] = wanted  # equal but for round-off of the held row
            return self.point_solver.unconfirmed(problem, correction, tangent, row, held)
        except SingularError as error:
            self.detail = str(error)
            return None

    def _polished(self, problem: Problem, guess: Array, row: Array, value: float) -> tuple[Array, Array, bool]:
        """A Newton step from a point of the series, the tangent, and whether the step is so short that one is enough.

        What is faint, as the tail of a breather, the series gives to the precision of what is not. It is left out of
        the guess, so that the step does not correct it but solves for it, and finds it accurate relative to itself.
        """
        states = guess[: problem.states]  # a view
        states[np.abs(states) < FAINT * np.max(np.abs(states))] = 0.0
        residual, nonzeros = problem.evaluate(guess)
        solve = self.point_solver.levels.solver(problem).factor(guess, nonzeros, row)
        polished = guess - solve(np.append(residual, row @ guess - value))
        step = self.point_solver.distance(problem, guess, polished)
        return polished, self.point_solver.tangent(problem, guess, solve), step <= SHORT * self._precision(problem)
