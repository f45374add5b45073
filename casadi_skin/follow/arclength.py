"""Pseudo-arclength continuation (Keller 1977) in the relative metric, with a guard against landing elsewhere.

A converged corrector is no proof of being on the same branch: families lie close when a chain is long. A step is
refused when the corrected point is farther from the predicted one than a fraction of the step, or when the tangent
turns too far; so the step shortens before another family can be taken for this one.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.follow.corners import Corner, Side, point_before, shifts, side_of, turned
from casadi_skin.follow.moving import Moving
from casadi_skin.follow.point import PREDICTING_POINTS, PointSolver, interpolant, predictor
from casadi_skin.solve.newton import Correction
from casadi_skin.zero.problem import Array, Problem, Scalar, SingularError
from casadi_skin.zero.settings import LAYER_SPEED_RATIO, End, Point, Target

HELD_BELOW = 0.1  # of a step: shorter ones are taken on a mesh that is held, and sought far from their guess
START_FRACTION = 1e-3  # of the first point walked: where the family's first point, of tiny amplitude, is placed


@dataclass(frozen=True)
class _Departure:
    """A point to step from, in the unknowns of the problem to be solved: its tangent t, the metric, the way on.

    `turning` is how many times the angles of the settings a step may turn. On a mesh that is `moving` t is the unit
    derivative there.
    """

    problem: Problem
    z: Array
    t: Array
    weights: Array
    row: Array
    curve: Callable[[float], Array]
    side: Side | None
    turning: float
    moving: Moving | None = None

    @property
    def closing(self) -> Array:
        """The row that closes the equations."""
        return self.row if self.moving is None else self.moving.row

    @property
    def scale(self) -> float:
        """The length along the branch by the step."""
        return 1.0 if self.moving is None else self.moving.start.scale

    def angle(self, tangent: Array) -> float:
        """Angle in degrees between t and another tangent, in the metric at z."""
        cosine = float(self.row @ tangent) / math.sqrt(self.weights @ tangent**2)
        return math.degrees(math.acos(max(min(cosine, 1.0), -1.0)))

    def on(self, step: float) -> Problem | None:
        """The equations on the mesh a step away; None where it cannot move so far."""
        return self.problem if self.moving is None else self.moving.on(step)


class Continuation(ABC):
    """A way along a branch: an iterator over its points in arclength order.

    A continuation that is made from the last points of another one, and from the points `reported` after the last of
    them, goes on exactly as that one would have.

    Attributes:
        history: the last few points of the continuation itself.
        end: the cause of its end; None where it goes on.
        detail: where it ended, or where the last trouble was.
        rejected: number of steps refused.
        missed: targets that were passed, at which no point was found.
        beyond: the point behind the end of the branch, where that lies between two points.
    """

    def __init__(self, point_solver: PointSolver, history: tuple[Point, ...], reported: tuple[Point, ...] = ()) -> None:
        self.point_solver, self.settings = point_solver, point_solver.settings
        self.history, self.detail, self.rejected, self.missed = history[-PREDICTING_POINTS:], "", 0, list[Target]()
        self.end = self._known_end((*history, *reported))
        self.beyond: Point | None = None
        self._passed = max((point.along for point in reported), default=0.0)  # place behind the last one, reported

    def _known_end(self, points: Sequence[Point]) -> End | None:
        """The end that a continuation has come to with the last of its points."""
        settings, last = self.settings, points[-1]
        if any(float(last.z[i]) == value for i, value in (end.unknown(last.problem) for end in settings.ends)):
            return End.REACHED
        lowest = settings.lowest * abs(settings.parameter_max)
        returned = len(points) > 1 and np.sign(settings.parameter_max) * last.parameter <= lowest
        return End.RETURNED if returned else None

    @abstractmethod
    def __iter__(self) -> Iterator[Point]: ...


class ArclengthContinuation(Continuation):
    """The continuation by predictor and corrector for any problem."""

    _last_side: Side | None = None

    def __iter__(self) -> Iterator[Point]:
        sign, known = float(np.sign(self.settings.parameter_max)), self.end
        if known is not None:
            return
        for _ in range(self.settings.max_points):
            current = self.history[-1]
            following = self._advance(current)
            if following is None:
                return
            yield from self._requested(current, following)
            if self.end is End.REACHED:
                return
            self.history = (*self.history, following)[-PREDICTING_POINTS:]
            yield following.snapped(self.settings.at)
            if sign * following.parameter <= self.settings.lowest * abs(self.settings.parameter_max):
                self.end = End.RETURNED if self.settings.parameter_min == 0.0 else End.AWAY
                return
        self.end, self.detail = End.POINTS, f"{self.settings.max_points} points"

    def _advance(self, current: Point) -> Point | None:
        """The next point of the walk; None with `end` set where there is none."""
        lighter = self.point_solver.lighter(current, self.history[-2] if len(self.history) > 1 else None)
        departure = self._departure(current, lighter)
        coarser = lighter is not current.problem and self.settings.rounds_corners
        if coarser and shifts(self.point_solver, current, departure.side, current.step):
            departure = self._departure(current, current.problem)
        step = first = min(current.step, self._longest_step(current) / departure.scale)
        while step >= self.settings.min_step:
            try:
                point = self._stepped(departure, step, step > HELD_BELOW * first)
                if point is not None or self.end is not None:
                    return point
            except SingularError as error:
                self.detail = str(error)
            self.rejected += 1
            if departure.problem is not current.problem:  # perhaps for the error of the coarser level
                departure = self._departure(current, current.problem)
                continue
            step *= 0.5
            if departure.moving is not None and step < HELD_BELOW * first:
                departure = self._departure(current, current.problem, held=True)
        self.end, advice = End.NO_STEP, "try another transcription or a larger tolerance"
        self.detail = f"{self.detail or self.point_solver.failure}; {advice}".removeprefix("; ")
        return None

    def _departure(self, current: Point, problem: Problem, held: bool = False) -> _Departure:
        """The current point and the way on from it in the unknowns of `problem`, on its mesh where that is `held`."""
        moves = not held and len(self.history) > 1 and current.moves
        past = () if moves else self.history[-2::-1]
        points = np.array(
            [one.problem.all_prolonged(np.array([one.z, one.tangent]), problem) for one in (current, *past)]
        )
        z, t = points[0]
        weights = self.point_solver.metric(problem, z)
        if problem is not current.problem:
            t /= math.sqrt(weights @ t**2)
        if moves:
            known = problem is current.problem and self.point_solver.joined(self.history[-2], current).moving
            moving = known or Moving.of(problem, z, t, weights, self.history[-2])
            return self._departure(current, problem, held=True) if moving is None else self._moving(moving, weights)
        row = weights * t
        curve = predictor(points, row, weights)
        speed = current.speed_ratio if problem is current.problem else problem.speed_ratio(z)
        turning = self.settings.layer_angles if speed > LAYER_SPEED_RATIO else 1.0
        return _Departure(problem, z, t, weights, row, curve, self._side_of(current, problem), turning)

    def _moving(self, moving: Moving, weights: Array) -> _Departure:
        """The way on where the mesh moves: a cubic through the last two points."""
        start, past = moving.start, moving.past
        seen = [start] if past is None or not past.sigma < 0.0 else [start, past]
        places, values, slopes = (np.array(v) for v in zip(*(one[:3] for one in seen), strict=True))
        t = start.slope / math.sqrt(weights @ start.slope**2)
        curve, turning = interpolant(places.tolist(), values, slopes), self.settings.layer_angles
        return _Departure(moving.problem, start.z, t, weights, weights * t, curve, None, turning, moving)

    def _side_of(self, current: Point, problem: Problem) -> Side | None:
        """The side of a corner that the current point is on; None where corners are not sought."""
        if not self.settings.rounds_corners:
            return None
        if self._last_side is None or self._last_side.problem is not problem or self._last_side.z is not current.z:
            self._last_side = side_of(self.point_solver, problem, current)
        return self._last_side

    def _stepped(self, departure: _Departure, step: float, near: bool) -> Point | None:
        """The point a step away; None where the guard refuses it, or, with `end` set, where no level is fine enough.

        Where it is `near` its guess or nowhere, a shorter step costs less than a search for it.
        """
        problem, row, reach = departure.on(step), departure.closing, departure.scale * step
        if problem is None:
            return None
        guess = departure.curve(step)
        correction = self.point_solver.correct(problem, guess, row, float(row @ departure.z) + step, reach, near)
        if correction is None:
            return None
        solve = self.point_solver.factors(problem, correction, row)
        tangent = slope = self.point_solver.tangent(problem, correction.z, solve)
        if departure.moving is not None:
            slope, sign = departure.moving.slope(problem, correction.z, tangent, step)
            tangent = np.copysign(1.0, sign) * tangent
        angle = departure.angle(slope) / departure.turning
        if max(angle, departure.angle(correction.z - departure.z) / departure.turning) > self.settings.guard_angle:
            return None  # a prediction of high order may land on a part of the branch beyond a turn
        if departure.side is not None:
            there = Side(problem, correction.z, tangent, solve.orientation)
            found = turned(self.point_solver, departure.side, there)
            if found is not None:
                return self._before(departure, found)
        point = self.point_solver.refined(problem, replace(correction, solve=solve), row, tangent=tangent)
        if point is None:
            self.end = End.RESOLUTION
            return None
        if departure.side is not None:
            if point.problem is not problem and shifts(self.point_solver, there, point, step):
                there = side_of(self.point_solver, point.problem, point) or there
                found = turned(self.point_solver, departure.side, there)
                if found is not None:
                    return self._before(departure, found)
            self._last_side = there
        return replace(point, step=self._next_step(problem, guess, correction, step, reach, angle))

    def _before(self, departure: _Departure, found: Corner) -> Point | None:
        """The point before a corner, from which it is walked round; None where the departure is as near to it."""
        problem = found.before.problem
        start = departure.problem.prolong(departure.z, problem)
        near = self.point_solver.distance(problem, start, found.before.z) <= found.length
        return None if near else point_before(self.point_solver, found)

    def _next_step(
        self, problem: Problem, guess: Array, correction: Correction, step: float, reach: float, angle: float
    ) -> float:
        """Step that would turn by the angle aimed for, and miss by a quarter of what the guard allows."""
        weights = self.point_solver.metric(problem, correction.z)
        missed = math.sqrt(weights @ (correction.z - guess) ** 2) / reach
        by_angle = self.settings.aim_angle / max(angle, 1e-3)
        by_distance = (0.25 * self.settings.guard_distance / max(missed, 1e-12)) ** (1.0 / 3.0)
        factor = float(min(max(min(by_angle, by_distance), 0.4), 1.8))
        return min(step * factor, self.settings.max_step)

    def _longest_step(self, current: Point) -> float:
        """The step that changes the parameter, to first order, by the most allowed."""
        slope = abs(float(current.tangent[current.problem.parameter_index]))
        allowed = self.settings.max_parameter_step * abs(self.settings.parameter_max)
        return allowed / slope if slope > 0 else np.inf

    def _requested(self, current: Point, following: Point) -> Iterator[Point]:
        """Requested points between two points of the continuation, its end among them, in arclength order.

        Sets `end` where the stretch passes the walk's end, also where it folds back before it closes.
        """
        ends, wanted = self.settings.ends, self.settings.wanted
        if current.parameter == 0.0 and self.settings.tiny_first:
            wanted.setdefault(Target(Scalar.PARAMETER, START_FRACTION * following.parameter), False)
        passed, self._passed = self._passed, 0.0
        for target, point in self.point_solver.between(current, following, wanted, passed):
            self.beyond = following if target in ends else None
            if point is None:
                self.missed.append(target)
                self.detail = self.point_solver.failure
            else:
                yield replace(point, requested=wanted[target])
            if target in ends:
                self.end = End.REACHED
                return
        reached = tuple(target for target in ends if target.meets(following))
        if reached:  # the step itself ended there
            self.end = End.REACHED
            end = following.snapped((*reached, *self.settings.at))
            yield replace(end, requested=any(t.meets(end) for t in self.settings.at), walked=False)
