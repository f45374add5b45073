"""Passages of a branch through a value of a quantity, corrected exactly there.

What the equations can hold is held by them. Any other quantity is sought along the branch: every value is that of a
corrected solution, between two neighbours on both sides of the value Brent's method has its zero, and where both lie
on one side the extremum between them is looked for that the values around it let expect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point

PLACE_TOLERANCE = 1e-13  # of the way between two solutions, in the place of a passage
EXTREMUM_TOLERANCE = 1e-5  # the same in that of an extremum, which is flat: its value is right to the square of it
SMOOTH_VALUE_RTOL = 1e-6  # of the difference of two neighbours: a value that is missed by more was jumped over
STRETCH_SAMPLES = 33  # places of a stretch at which the cubic through the solutions around it is looked at
BESIDE_LIMIT = 1e-6  # of the way from a limit to the first solution: a quantity may be 0/0 at the limit itself
EXTREMUM_LENIENCE = 2.0  # times what the cubic goes beyond its ends: the extremum there may be, to be looked for


class _NotFoundError(ArithmeticError):
    """No solution was found at a place between two."""


@dataclass(frozen=True)
class _Stretch:
    """Two neighbouring solutions, the quantity less the wanted value at both, and how far the cubic lets it go."""

    space: SolutionSpace
    of: Callable[[Point], float]
    ends: tuple[Point, Point]
    values: tuple[float, float]
    reach: tuple[float, float]

    def at(self, fraction: float) -> float:
        """The quantity less the wanted value of the corrected solution at a fraction of the way."""
        if fraction in (0.0, 1.0):
            return self.values[int(fraction)]
        return self.of(self.point(fraction))

    def point(self, fraction: float) -> Point:
        """The corrected solution; raises _NotFoundError where there is none."""
        solver: PointSolver = self.space.point_solver
        found = solver.along(*self.ends, fraction)
        if found is None:
            raise _NotFoundError(solver.failure)
        return found

    def roots(self) -> Iterator[float]:
        """Fractions at which the value is passed, ascending; the ends are not among them."""
        before, after = self.values
        if before * after < 0.0:
            yield from self._root(0.0, 1.0)
        elif before * after > 0.0:
            sign = np.sign(before)
            beyond = max(0.0, min(abs(before), abs(after)) - float(np.min(sign * np.array(self.reach))))
            if EXTREMUM_LENIENCE * beyond >= min(abs(before), abs(after)):
                turn = self._turn(float(sign))
                if turn is not None:
                    yield from self._root(0.0, turn)
                    yield from self._root(turn, 1.0)

    def _turn(self, sign: float) -> float | None:
        """A fraction beyond the value, on the way to the extremum; None where it does not reach the value."""
        from scipy.optimize import minimize_scalar

        passed: list[float] = []

        def height(fraction: float) -> float:
            found = sign * self.at(float(fraction)) if not passed else 0.0
            if found < 0.0:
                passed.append(float(fraction))
            return found

        minimize_scalar(height, bounds=(0.0, 1.0), method="bounded", options={"xatol": EXTREMUM_TOLERANCE})
        return passed[0] if passed else None

    def _root(self, low: float, high: float) -> Iterator[float]:
        from scipy.optimize import brentq

        ends = self.at(low), self.at(high)
        place = float(brentq(self.at, low, high, xtol=PLACE_TOLERANCE))
        noise = self.space.tolerance * max(map(abs, ends))
        if abs(self.at(place)) <= max(SMOOTH_VALUE_RTOL * abs(ends[1] - ends[0]), noise):
            yield place


def passage(
    space: SolutionSpace, solutions: Sequence[Solution], of: Callable[[Solution], float], wanted: tuple[str, float],
    which: int,
) -> Solution:  # fmt: skip
    """The solution at a passage of a quantity through a wanted value, counted from 0; `wanted` has its name too.

    Where the equations hold the quantity the solution has the value but for rounding. Raises ValueError where the
    branch does not pass it that often, ArithmeticError where none is found there.
    """
    name, value = wanted
    values, passed = np.array([of(solution) for solution in solutions]), 0
    if name in space.held_names:
        found: Iterator[Solution | None] = _held(space, solutions, name, value)
    else:
        found = _sought(space, solutions, lambda point: of(space.solution(point)) - value, values - value)
    kind = "orbit" if not solutions or solutions[0].is_orbit else "solution"
    try:
        for solution in found:
            if passed == which:
                if solution is None:
                    raise _NotFoundError(space.point_solver.failure)
                return solution
            passed += 1
    except _NotFoundError as error:
        raise ArithmeticError(f"at: no {kind} was found at {name} = {value:g}: {error}") from error
    covered = f"{np.nanmin(values):g} to {np.nanmax(values):g}" if np.isfinite(values).any() else "no point"
    words = f"the branch covers {covered} and passes {name} {passed} times"
    raise ValueError(f"at: given {name} = {value!r}, which = {which}; {words}")


def _sought(
    space: SolutionSpace, solutions: Sequence[Solution], of: Callable[[Point], float], values: Array
) -> Iterator[Solution]:
    """Solutions at which a quantity is zero, in order; `values` are those at the solutions."""
    points = [solution.point for solution in solutions]
    if space.start_is_limit and points:
        start, value = _limit(space, points[0], of)
        points, values = [start, *points], np.append(value, values)
    limits = len(points) - len(solutions)
    places = np.cumsum([0.0, *(space.point_solver.curve(*pair)[1] for pair in pairwise(points))])
    for k, (point, value) in enumerate(zip(points, values, strict=True)):
        if k and np.isfinite(values[k - 1 : k + 1]).all():
            low, high = float(values[k - 1]), float(value)
            stretch = _Stretch(space, of, (points[k - 1], point), (low, high), _reach(places, values, k))
            yield from (space.solution(stretch.point(fraction)) for fraction in stretch.roots())
        if value == 0.0 and k >= limits:
            yield solutions[k - limits]


def _limit(space: SolutionSpace, first: Point, of: Callable[[Point], float]) -> tuple[Point, float]:
    """The limit that a family starts from with the quantity there, or where it has none the solution beside it."""
    for point in (space.start, space.point_solver.along(space.start, first, BESIDE_LIMIT)):
        with suppress(ValueError, ArithmeticError):
            if point is not None and np.isfinite(value := of(point)):
                return point, value
    return space.start, float("nan")


def _reach(places: Array, values: Array, k: int) -> tuple[float, float]:
    """Least and largest value between solutions k - 1 and k of the polynomial through the four solutions around."""
    from scipy.interpolate import BarycentricInterpolator

    around = np.arange(max(0, k - 2), min(values.size, k + 2))
    around = around[np.isfinite(values[around])]
    sampled = BarycentricInterpolator(places[around], values[around])(
        np.linspace(places[k - 1], places[k], STRETCH_SAMPLES)
    )
    return float(np.min(sampled)), float(np.max(sampled))


def _held(space: SolutionSpace, solutions: Sequence[Solution], name: str, value: float) -> Iterator[Solution | None]:
    """The solution at each passage, corrected there; None where there is none."""
    target, solver = space.target(name, value), space.point_solver
    before = space.start if space.start_is_limit else None
    for solution in solutions:
        points = list[Point | None]()
        if solution.value(name) == value:
            yield solution
        elif target.meets(solution.point):
            points = [solver.beside(solution.point, target)]
        elif before is not None and not target.meets(before):
            points = [point for _, point in solver.between(before, solution.point, (target,))]
        yield from (None if point is None else space.solution(point, exact={name: value}) for point in points)
        before = solution.point
