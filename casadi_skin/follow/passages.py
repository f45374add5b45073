"""Passages of a branch through a value of a quantity, corrected exactly there.

A value of a quantity that the equations can hold is held by them. Any other quantity is sought along the branch: every
value is that of a corrected solution, between two neighbours on both sides of the value Brent's method has its zero,
and where both lie on one side an extremum between them is sought where the values around suggest one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point

PLACE_TOLERANCE = 1e-13  # of the way between two solutions, in the place of a passage
EXTREMUM_TOLERANCE = 1e-5  # the same in that of an extremum, which is flat: its value is right to the square of it
SMOOTH_VALUE_RTOL = 1e-6  # of the difference of two neighbours: a value that is missed by more was jumped over
BESIDE_LIMIT = 1e-6  # of the way from a limit to the first solution: a quantity may be 0/0 at the limit itself
EXTREMUM_LENIENCE = 2.0  # times what the cubic goes beyond its ends: the extremum there may be, to be looked for


class _NotFoundError(ArithmeticError):
    """No solution was found at a place between two."""


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
            ends = float(values[k - 1]), float(value)
            yield from zeros_between(space, (points[k - 1], point), of, ends, _reach(places, values, k))
        if value == 0.0 and k >= limits:
            yield solutions[k - limits]


def zeros_between(
    space: SolutionSpace, ends: tuple[Point, Point], of: Callable[[Point], float], values: tuple[float, float],
    reach: tuple[float, float],
) -> Iterator[Any]:  # fmt: skip
    """Solutions between two at which a quantity is zero, in order; raises _NotFoundError where one is not found.

    Arguments:
        space: of the solutions.
        ends: the points of both.
        of: the quantity of a corrected point.
        values: of it at both ends.
        reach: least and largest value in between that is expected.
    """
    from scipy.optimize import brentq, minimize_scalar

    def point_at(fraction: float) -> Point:
        found = space.point_solver.along(*ends, fraction)
        if found is None:
            raise _NotFoundError(space.point_solver.failure)
        return found  # type: ignore[no-any-return]

    def at(fraction: float) -> float:
        return values[int(fraction)] if fraction in (0.0, 1.0) else of(point_at(fraction))

    def passed(low: float, high: float) -> Iterator[Any]:
        sides = at(low), at(high)
        place = float(brentq(at, low, high, xtol=PLACE_TOLERANCE))
        noise = space.tolerance * max(map(abs, sides))
        if abs(at(place)) <= max(SMOOTH_VALUE_RTOL * abs(sides[1] - sides[0]), noise):
            yield space.solution(point_at(place))

    nearest, sign = min(map(abs, values)), float(np.sign(values[0]))
    if values[0] * values[1] < 0.0:
        yield from passed(0.0, 1.0)
    elif nearest and EXTREMUM_LENIENCE * max(0.0, nearest - min(sign * value for value in reach)) >= nearest:
        beyond = list[float]()  # on the way to the extremum

        def height(fraction: float) -> float:
            found = sign * at(float(fraction)) if not beyond else 0.0
            beyond.extend([float(fraction)] * (found < 0.0))
            return found

        minimize_scalar(height, bounds=(0.0, 1.0), method="bounded", options={"xatol": EXTREMUM_TOLERANCE})
        if beyond:
            yield from passed(0.0, beyond[0])
            yield from passed(beyond[0], 1.0)


def _limit(space: SolutionSpace, first: Point, of: Callable[[Point], float]) -> tuple[Point, float]:
    """The limit that a family starts from with the quantity there, or where it has none the solution beside it."""
    for point in (space.start, space.point_solver.along(space.start, first, BESIDE_LIMIT)):
        with suppress(ValueError, ArithmeticError):
            if point is not None and np.isfinite(value := of(point)):
                return point, value
    return space.start, float("nan")


def _reach(places: Array, values: Array, k: int) -> tuple[float, float]:
    """Least and largest value between solutions k - 1 and k of the polynomial through the four solutions around."""
    around = np.arange(max(0, k - 2), min(values.size, k + 2))
    around = around[np.isfinite(values[around])]
    through = Polynomial.fit(places[around], values[around], around.size - 1)
    turns = through.deriv().roots()
    inside = (turns.imag == 0.0) & (places[k - 1] < turns.real) & (turns.real < places[k])
    reached = np.append(through(turns.real[inside]), values[k - 1 : k + 1])
    return float(np.min(reached)), float(np.max(reached))


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
        elif before is not None:
            points = [point for _, point in solver.between(before, solution.point, (target,))]
        yield from (None if point is None else space.solution(point, exact={name: value}) for point in points)
        before = solution.point
