"""Bounds on states and free parameters along a branch: where the first of them is met, and which."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.follow.settings import Point
from casadi_skin.follow.special_points import BOUND, FINE, NotLocatedError
from casadi_skin.zero.method import TWO_PI
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import BoundaryProblem

if TYPE_CHECKING:
    from casadi_skin.follow.boundary_solutions import BoundarySolutions

WITHIN = 8  # places between two columns of a mesh at which a state is looked at
ZOOMS = 4  # into the neighbours of the largest value: places then differ by 1e-5 of theirs, values by the square
PLACES = np.linspace(0.0, 1.0, 17)[1:]  # of a stretch, at which it is predicted whether a bound is met
TINY = 1e-12  # of the size of a quantity: a bound that is as near is met


@dataclass(frozen=True)
class Margin:
    """How far a solution is from one bound, relative to the size of the quantity, and where it is nearest."""

    value: float
    name: str
    bound: str
    time: float | None

    def __str__(self) -> str:
        """Which bound it is, in words."""
        when = "" if self.time is None else f" at t = {self.time:.6g}"
        return f"{self.name} comes to its {self.bound}{when}"


def margin(space: BoundarySolutions, point: Point) -> Margin:
    """The least margin of a solution, over the whole interval; negative beyond a bound."""
    return min(margins(space, point), key=lambda one: one.value)


def margins(space: BoundarySolutions, point: Point) -> list[Margin]:
    """The margins of all finite bounds."""
    problem, names, values = point.problem, space.state_names, space.parameters(point)
    assert isinstance(problem, BoundaryProblem)
    turns = _turns(space, problem)
    states = _states(space, point, turns)
    start, end = space.interval(point)
    found = list[Margin]()
    for name, limits in space.statement.bounds.items():
        for sign, bound, words in ((1.0, limits[1], "upper"), (-1.0, limits[0], "lower")):
            if math.isinf(bound):
                continue
            time, value, size = None, sign * values.get(name, 0.0), abs(values.get(name, 0.0))
            if name in names:
                component = names.index(name)
                size = float(np.max(np.abs(states[:, component])))
                turn, value = _largest(space, point, turns, sign * states[:, component], component, sign)
                time = start + turn * (end - start)
            size = max(abs(bound), size, TINY)
            found.append(Margin((sign * bound - value) / size, name, f"{words} bound {bound:.10g}", time))
    return found


def _turns(space: BoundarySolutions, problem: BoundaryProblem) -> Array:
    """Places in the interval, or in the whole period, on the mesh and between."""
    edges = problem._fractions()
    if space.periodic is not None:
        part = space.periodic.symmetry.value
        edges = np.unique(np.concatenate([edges * part, 1.0 - edges * part, np.linspace(0.0, 1.0, edges.size)]))
    inner = np.linspace(0.0, 1.0, WITHIN, endpoint=False)
    return np.append((edges[:-1, None] + np.diff(edges)[:, None] * inner).ravel(), 1.0)


def _states(space: BoundarySolutions, point: Point, turns: Array) -> Array:
    if space.periodic is not None:
        return space.states_at(point, TWO_PI * turns, None)
    return point.problem.sample(point.z, turns)


def _largest(
    space: BoundarySolutions, point: Point, turns: Array, values: Array, component: int, sign: float
) -> tuple[float, float]:
    """Where a state times a sign is largest, and its value there, between the places that it is known at too."""
    for _ in range(ZOOMS):
        at = int(np.argmax(values))
        if at in (0, turns.size - 1):
            break
        turns = np.linspace(turns[at - 1], turns[at + 1], 4 * WITHIN + 1)
        values = sign * _states(space, point, turns)[:, component]
    at = int(np.argmax(values))
    return float(turns[at]), float(values[at])


def met_between(space: BoundarySolutions, before: Point, after: Point) -> Point | None:
    """The first point between two at which a bound is met; None where none is. Raises NotLocatedError.

    A state that a condition holds at a bound is there all along, but for the error of the solution.
    """
    from scipy.optimize import brentq

    if not space.statement.bounds:
        return None
    solver = space.point_solver
    known: dict[float, Point] = {0.0: before, 1.0: after}

    def values(fraction: float) -> Array:
        if fraction not in known:
            point = solver.along(before, after, fraction)
            if point is None:
                raise NotLocatedError(f"a bound is met at a point that cannot be located: {solver.failure}")
            known[fraction] = point
        return slack + [one.value for one in margins(space, known[fraction])]

    def value(number: int, fraction: float) -> float:
        return float(values(fraction)[number])

    slack = np.zeros(len(margins(space, before)))
    slack = np.where(values(0.0) > space.tolerance, 0.0, space.tolerance)
    curve, length = solver.curve(before, after)
    for place in PLACES:
        predicted = after if place == 1.0 else replace(after, z=curve.at(place * length))
        passed = slack + [one.value for one in margins(space, predicted)] < 0.0
        passed &= values(place) < 0.0 if np.any(passed) else passed
        if np.any(passed):
            numbers = np.flatnonzero(passed).tolist()
            roots = [brentq(partial(value, number), 0.0, place, xtol=FINE) for number in numbers]
            first = float(min(roots))
            values(first)
            return replace(known[first], special=BOUND, walked=False, requested=False)
    return None
