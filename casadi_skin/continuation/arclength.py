"""Pseudo-arclength continuation (Keller 1977) in the relative metric, with a guard against landing elsewhere.

A converged corrector is no proof of being on the same branch: families lie close when a chain is long. A step is
refused when the corrected point is farther from the predicted one than a fraction of the step, or when the tangent
turns too far; so the step shortens before another family can be taken for this one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from casadi_skin.bvp.problem import Array, OrbitProblem
from casadi_skin.continuation.hermite import LocalCurve
from casadi_skin.continuation.locating import Locator
from casadi_skin.continuation.points import End, Point, is_any
from casadi_skin.correctors.base import Correction
from casadi_skin.correctors.bordered import SingularError

START_FRACTION = 1e-3  # of the first point walked: where the family's first point, of tiny amplitude, is placed


class ArclengthWalk:
    """A walk by predictor and corrector for any problem (see `Walk`); `rejected` counts steps refused."""

    def __init__(self, locator: Locator, history: tuple[Point, ...]) -> None:
        self.locator, self.settings = locator, locator.settings
        self.history = history[-2:]
        self.end: End | None = None
        self.detail = ""
        self.rejected = 0
        self.missed: list[float] = []

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
            yield following.snapped(self.settings.at)
            if sign * following.parameter <= 0:
                self.end = End.RETURNED
                return
        self.end, self.detail = End.POINTS, f"{self.settings.max_points} points"

    def _advance(self, current: Point) -> Point | None:
        """The next point of the walk; None with `end` set where there is none."""
        problem, settings = current.problem, self.settings
        row = self.locator.metric(problem, current.z) * current.tangent
        curve = LocalCurve.line(current.z, current.tangent)
        if len(self.history) == 2:
            before = self.history[0]
            z, t = (before.problem.prolong(v, problem) for v in (before.z, before.tangent))
            curve = LocalCurve.through(current.z, current.tangent, z, t, row)
        step = min(current.step, self._longest_step(current))
        while step >= settings.min_step:
            guess = curve.at(step)
            correction = self.locator.correct(problem, guess, row, float(row @ current.z) + step, step)
            if correction is not None:
                try:
                    solve = self.locator.factor(problem, correction.z, row)
                    angle = self._angle(problem, current, self.locator.tangent(problem, correction.z, solve))
                    if angle <= settings.guard_angle:
                        point = self.locator.refined(problem, correction, row, held=False)
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
        weights = self.locator.metric(problem, current.z)
        cosine = np.sum(weights * current.tangent * tangent) / np.sqrt(np.sum(weights * tangent**2))
        return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))

    def _next_step(
        self, problem: OrbitProblem, guess: Array, correction: Correction, step: float, angle: float
    ) -> float:
        """Step that would turn by the angle aimed for, and miss by a quarter of what the guard allows."""
        weights = self.locator.metric(problem, correction.z)
        missed = float(np.sqrt(np.sum(weights * (correction.z - guess) ** 2))) / step
        by_angle = self.settings.aim_angle / max(angle, 1e-3)
        by_distance = (0.25 * self.settings.guard_distance / max(missed, 1e-12)) ** (1.0 / 3.0)
        return min(step * float(np.clip(min(by_angle, by_distance), 0.4, 1.8)), self.settings.max_step)

    def _longest_step(self, current: Point) -> float:
        """The step that changes the parameter, to first order, by the most allowed."""
        slope = abs(float(current.tangent[current.problem.parameter_index]))
        allowed = self.settings.max_parameter_step * abs(self.settings.parameter_max)
        return allowed / slope if slope > 0 else np.inf

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
        inside = tuple(v for v in wanted if not any(is_any(end, (v,)) for end in ends))
        for value, point in self.locator.between(current, following, inside):
            if point is None:
                self.missed.append(value)
            else:
                yield replace(point, requested=wanted[value])
            if value == last:
                self.end = End.REACHED
                return
        if is_any(following.parameter, (last,)):  # the step itself ended there
            self.end = End.REACHED
            end = following.snapped((last,))
            yield replace(end, requested=wanted[last], walked=False)
