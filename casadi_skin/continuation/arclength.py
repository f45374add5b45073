"""Pseudo-arclength continuation (Keller 1977) in the relative metric, with a guard against landing elsewhere.

A converged corrector is no proof of being on the same branch: families lie close when a chain is long. A step is
refused when the corrected point is farther from the predicted one than a fraction of the step, or when the tangent
turns too far; so the step shortens before another family can be taken for this one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from casadi_skin.bvp.problem import Array, OrbitProblem
from casadi_skin.continuation.hermite import LocalCurve
from casadi_skin.correctors.base import Correction
from casadi_skin.correctors.bordered import SingularError, Solve
from casadi_skin.correctors.ladder import ErrorEstimate, Ladder, step_error

ROUND_OFF = 1e-7  # an estimate below this that a finer rung does not halve
BESIDE = 1e-3  # reach of a correction to a value of the parameter that is the point's own but for round-off
SAME = 1e-12  # relative difference below which a point walked is the one asked for
START_FRACTION = 1e-3  # of the first point walked: where the family's first point, of tiny amplitude, is placed


@dataclass(frozen=True)
class WalkSettings:
    """What the walk aims for and refuses; lengths in the relative metric, angles in degrees."""

    parameter_max: float  # the walk ends at this value of the free parameter; its sign is the direction
    tolerance: float  # relative error of Omega and of the profile at every point
    at: tuple[float, ...] = ()  # values of the free parameter at which points are wanted exactly
    first_step: float = 0.01
    max_step: float = 0.2
    max_parameter_step: float = 1.0 / 30.0  # of parameter_max: points to draw, and to see stability change between
    min_step: float = 1e-7
    max_points: int = 20_000
    guard_distance: float = 0.08  # of the step, between predicted and corrected point
    guard_angle: float = 14.0
    aim_angle: float = 8.0


class End(Enum):
    """Why a walk ended, in words."""

    REACHED = "reached the end asked for"
    NO_STEP = "no step, however short, stays on the family"
    RESOLUTION = "the orbit needs a finer discretisation than the finest there is"
    RETURNED = "the family came back to zero amplitude"
    POINTS = "the limit on the number of points was reached"
    FLOW = "the flow map of the variational system cannot reach the tolerance"


@dataclass(frozen=True)
class Point:
    """A converged point of the branch with its unit tangent; `step` is the step to try next."""

    problem: OrbitProblem
    z: Array
    tangent: Array
    error: ErrorEstimate
    step: float
    iterations: int
    requested: bool = False
    walked: bool = True  # a point of the walk itself; others lie between two of these

    @property
    def parameter(self) -> float:
        """Value of the free parameter."""
        return float(self.z[self.problem.parameter_index])

    @property
    def Omega(self) -> float:
        """Frequency."""
        return float(self.z[self.problem.Omega_index])


class Walk:
    """Iterator over the points of a branch in arclength order; `end` tells why it stopped, `detail` where.

    `history` holds the last two points walked; a walk made from them goes on exactly as the one that was broken off.
    """

    def __init__(self, ladder: Ladder, settings: WalkSettings, history: tuple[Point, ...]) -> None:
        self.ladder, self.settings = ladder, settings
        self.history = history[-2:]
        self.end: End | None = None
        self.detail = ""
        self.rejected = 0
        self.missed: list[float] = []  # requested values at which no point was found

    # Geometry -------------------------------------------------------------------------------------------------------

    def _metric(self, problem: OrbitProblem, z: Array) -> Array:
        return problem.metric(z, abs(self.settings.parameter_max))

    def _factor(self, problem: OrbitProblem, z: Array, row: Array) -> Solve:
        """Solver of the Jacobian at z closed by `row`; raises SingularError."""
        return self.ladder.solver(problem).factor(z, problem.evaluate(z)[1], row)

    def _tangent(self, problem: OrbitProblem, z: Array, solve: Solve) -> Array:
        """Unit tangent at z with row . t > 0, by the solver closed by that row."""
        unit = np.zeros(problem.size)
        unit[-1] = 1.0
        t = solve(unit)
        return np.asarray(t / np.sqrt(np.sum(self._metric(problem, z) * t**2)))

    def start(self, positions: Array, Omega: float) -> Point:
        """The linear mode at zero amplitude with the tangent of its family, at the coarsest resolution; not walked."""
        problem = self.ladder.problem(self.ladder.rungs[0])
        z = problem.pack(positions, Omega, 0.0)
        direction = float(np.sign(self.settings.parameter_max))
        tangent = self._tangent(problem, z, self._factor(problem, z, direction * problem.parameter_row()))
        return Point(problem, z, tangent, ErrorEstimate(0.0, 0.0), self.settings.first_step, 0)

    # Correcting -----------------------------------------------------------------------------------------------------

    def _correct(
        self, problem: OrbitProblem, guess: Array, row: Array, value: float, reach: float
    ) -> Correction | None:
        """Corrected point within the guard's fraction of `reach` of the guess, or None."""
        correction = self.ladder.corrector(problem).correct(guess, row, value)
        if not correction.converged or correction.z[problem.Omega_index] <= 0:
            return None
        distance = float(np.sqrt(np.sum(self._metric(problem, guess) * (correction.z - guess) ** 2)))
        return correction if distance <= self.settings.guard_distance * reach else None

    def _refined(self, problem: OrbitProblem, correction: Correction, row: Array, held: bool) -> Point | None:
        """The point on the coarsest rung from `problem` up that meets the tolerance; None at the top of the ladder.

        `held` tells that `row` holds the parameter. Where most of the error is what the corrector left over, a Newton
        step and the corrector once more take it away; what stays after that, or what a finer rung does not lessen, is
        round-off, and the point is kept with its estimate. Raises SingularError.
        """
        z, iterations, polished = correction.z, correction.iterations, False
        coarser: tuple[float, Point] | None = None  # the same point one rung below, with its error
        while True:
            solve = self._factor(problem, z, row)
            tangent = self._tangent(problem, z, solve)
            error = self.ladder.error(problem, z, None if held else tangent)
            relative = error.relative(float(z[problem.Omega_index]))
            left_over = solve(np.append(problem.evaluate(z)[0], 0.0))
            algebraic = step_error(problem, z, left_over).relative(float(z[problem.Omega_index]))
            point = Point(problem, z, tangent, error, self.settings.first_step, iterations)
            if relative <= self.settings.tolerance or (polished and algebraic > 0.25 * relative):
                return point
            if coarser is not None and 0.5 * coarser[0] < relative < ROUND_OFF:
                return coarser[1]  # no better for its finer rung, whose round-off is larger
            if algebraic > 0.25 * relative:
                polished, target, guess = True, problem, z - left_over
            else:
                finer = self.ladder.finer(problem)
                if finer is None or self.ladder.finer(finer) is None:
                    return None
                polished, target, guess, coarser = False, finer, problem.prolong(z, finer), (relative, point)
                if held:
                    row = finer.parameter_row() * row[problem.parameter_index]
                else:
                    row = self._metric(finer, guess) * problem.prolong(tangent, finer)
            correction = self.ladder.corrector(target).correct(guess, row, float(row @ guess))
            if not correction.converged:
                raise SingularError(f"{correction.status.value} {correction.message}".strip())
            problem, z, iterations = target, correction.z, iterations + correction.iterations

    # Walking --------------------------------------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Point]:
        sign = float(np.sign(self.settings.parameter_max))
        for _ in range(self.settings.max_points):
            current = self.history[-1]
            following = self._advance(current)
            if following is None:
                return
            yield from self._requested(current, following)
            if self.end is End.REACHED:
                return
            self.history = (current, following)
            yield self._snapped(following, self.settings.at)
            if sign * following.parameter <= 0:
                self.end = End.RETURNED
                return
        self.end, self.detail = End.POINTS, f"{self.settings.max_points} points"

    def _advance(self, current: Point) -> Point | None:
        """The next point of the walk; None with `end` set where there is none."""
        problem, settings = current.problem, self.settings
        row = self._metric(problem, current.z) * current.tangent
        curve = LocalCurve.line(current.z, current.tangent)
        if len(self.history) == 2:
            before = self.history[0]
            z, t = (before.problem.prolong(v, problem) for v in (before.z, before.tangent))
            curve = LocalCurve.through(current.z, current.tangent, z, t, row)
        step = min(current.step, self._longest_step(current))
        while step >= settings.min_step:
            guess = curve.at(step)
            correction = self._correct(problem, guess, row, float(row @ current.z) + step, step)
            if correction is not None:
                try:
                    tangent = self._tangent(problem, correction.z, self._factor(problem, correction.z, row))
                    angle = self._angle(problem, current, tangent)
                    if angle <= settings.guard_angle:
                        point = self._refined(problem, correction, row, held=False)
                        if point is None:
                            self.end = End.RESOLUTION
                            return None
                        return replace(point, step=self._next_step(problem, guess, correction, step, angle))
                except SingularError as error:
                    self.detail = str(error)
            self.rejected += 1
            step *= 0.5
        self.end = End.NO_STEP
        return None

    def _angle(self, problem: OrbitProblem, current: Point, tangent: Array) -> float:
        """Angle in degrees between the tangent at `current` and another, in the metric at `current`."""
        weights = self._metric(problem, current.z)
        cosine = np.sum(weights * current.tangent * tangent) / np.sqrt(np.sum(weights * tangent**2))
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))

    def _next_step(
        self, problem: OrbitProblem, guess: Array, correction: Correction, step: float, angle: float
    ) -> float:
        """Step that would turn by the angle aimed for, and miss by a quarter of what the guard allows."""
        weights = self._metric(problem, correction.z)
        missed = float(np.sqrt(np.sum(weights * (correction.z - guess) ** 2))) / step
        by_angle = self.settings.aim_angle / max(angle, 1e-3)
        by_distance = (0.25 * self.settings.guard_distance / max(missed, 1e-12)) ** (1.0 / 3.0)
        return min(step * float(np.clip(min(by_angle, by_distance), 0.4, 1.8)), self.settings.max_step)

    def _longest_step(self, current: Point) -> float:
        """The step that changes the parameter, to first order, by the most allowed."""
        slope = abs(float(current.tangent[current.problem.parameter_index]))
        allowed = self.settings.max_parameter_step * abs(self.settings.parameter_max)
        return allowed / slope if slope > 0 else np.inf

    @staticmethod
    def is_any(parameter: float, values: tuple[float, ...]) -> bool:
        return any(abs(parameter - value) <= SAME * abs(value) for value in values)

    def _snapped(self, point: Point, values: tuple[float, ...]) -> Point:
        """The point, requested and with its parameter exact where that is one of `values` but for round-off."""
        for value in values:
            if self.is_any(point.parameter, (value,)):
                z = point.z.copy()
                z[point.problem.parameter_index] = value
                return replace(point, z=z, requested=True)
        return point

    def _requested(self, current: Point, following: Point) -> Iterator[Point]:
        """Points asked for between two points walked, the walk's end among them, in arclength order.

        Sets `end` where the stretch passes the walk's end, also where it folds back before it closes.
        """
        settings, last = self.settings, self.settings.parameter_max
        wanted = dict.fromkeys(settings.at, True)
        wanted.setdefault(last, False)
        if current.parameter == 0.0:
            wanted.setdefault(START_FRACTION * following.parameter, False)
        ends = (current.parameter, following.parameter)
        inside = tuple(v for v in wanted if not any(self.is_any(end, (v,)) for end in ends))
        for value, point in self.between(current, following, inside):
            if point is None:
                self.missed.append(value)
            else:
                yield replace(point, requested=wanted[value])
            if value == last:
                self.end = End.REACHED
                return
        if self.is_any(following.parameter, (last,)):  # the step itself ended there
            self.end = End.REACHED
            end = self._snapped(following, (last,))
            yield replace(end, requested=wanted[last], walked=False)

    def between(
        self, current: Point, following: Point, values: tuple[float, ...]
    ) -> Iterator[tuple[float, Point | None]]:
        """Points with the free parameter at any of `values` between two points of the branch, in arclength order.

        Yields (value, point), and (value, None) where the corrector does not find the point that the branch passes.
        """
        curve, length = self.curve(current, following)
        index = following.problem.parameter_index
        places = sorted((s, v) for v in values for s in curve.crossings(index, v, length))
        for sigma, value in places:
            yield value, self._exactly(following.problem, curve, sigma, value, length)

    def beside(self, point: Point, value: float) -> Point | None:
        """The point with the free parameter at `value`, which is next to that of `point`; None where none is found."""
        return self._exactly(point.problem, LocalCurve.line(point.z, point.tangent), 0.0, value, BESIDE)

    def curve(self, current: Point, following: Point) -> tuple[LocalCurve, float]:
        """The local cubic from one point to the next, in the unknowns of the second, and its length in sigma."""
        problem = following.problem
        z, t = (current.problem.prolong(v, problem) for v in (current.z, current.tangent))
        row = self._metric(problem, z) * t
        curve = LocalCurve.through(z, t, following.z, following.tangent, row)
        return curve, float(row @ (following.z - z))

    def along(self, current: Point, following: Point, fraction: float) -> Point | None:
        """A corrected point at a fraction of the way between two points of the branch, or None."""
        problem = following.problem
        curve, length = self.curve(current, following)
        guess, slope = curve.at(fraction * length), curve.slope(fraction * length)
        row = self._metric(problem, guess) * slope
        correction = self._correct(problem, guess, row, float(row @ guess), length)
        try:
            point = None if correction is None else self._refined(problem, correction, row, held=False)
        except SingularError:
            return None
        return None if point is None else replace(point, walked=False)

    def _exactly(
        self, problem: OrbitProblem, curve: LocalCurve, sigma: float, value: float, length: float
    ) -> Point | None:
        """The point with the free parameter at `value`, near curve(sigma); None where none is found there."""
        guess = curve.at(sigma)
        direction = float(np.sign(curve.slope(sigma)[problem.parameter_index]))
        row = problem.parameter_row() * direction
        correction = self._correct(problem, guess, row, value * direction, length)
        if correction is None:
            return None
        correction.z[problem.parameter_index] = value  # equal but for round-off of the held row
        try:
            point = self._refined(problem, correction, row, held=True)
        except SingularError:
            return None
        return None if point is None else replace(point, walked=False)
