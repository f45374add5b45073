"""Corners that a step of a continuation cuts: where a branch turns aside between two points that predict one another.

In a narrow internal resonance a branch turns sharply into an excursion, and comes back to go on from the other side of
the corner almost as if nothing had been there: two branches that would cross if the coupling of the resonance vanished
have parted. The determinant of the Jacobian closed by the tangent keeps its sign along a smooth branch, but has other
signs on either side of the corner, as on either side of a branch point (Keller 1977; Allgower and Georg 1990, chapter
8).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.follow.hermite import LocalCurve
from casadi_skin.follow.point_solver import PointSolver
from casadi_skin.follow.settings import Point
from casadi_skin.solve.corrector import Correction, Status
from casadi_skin.zero.problem import Array, Problem, SingularError

SHARP = 15.0  # degrees between both sides and their chord at a corner
IN_LINE = 3.0  # degrees between them where branches cross
FRACTIONS = (0.5, 0.3, 0.7)  # of the way between two places: where the branch is sought
ALONG = 0.8  # cosine of the turn from a place to one within a step from it, at least
SHORT = 0.25  # of a step: a chord that turns so much is a corner, not the course of the branch
SMALLEST = 1e-7  # a corner of this size is that of branches that cross
ROUNDED = 1000.0  # times what rounding moves a place by: at 30 times chords turn by 30 degrees for nothing
CLOSE = 0.25  # of the distance to the other side of a corner: the step from which it is walked round
SHIFT = 0.1  # of a step: what another level of resolution may move its start by
ALIKE = 3.0  # ratio of the lengths of a corner on two levels, which halvings determine, at most
POLISHED = 2  # steps of Newton's method on a point before a corner
LOOKED_AT = 6  # levels of resolution, at most, on which a corner is sought until two agree


@dataclass(frozen=True)
class Side:
    """A place of a branch in the unknowns of a problem, with its unit tangent and the sign of the determinant.

    `noise` is the distance by which rounding may move it, 0 where that is not looked at.
    """

    problem: Problem
    z: Array
    tangent: Array
    orientation: float
    noise: float = 0.0


@dataclass(frozen=True)
class Corner:
    """The last place found before a corner, and the distance from there to the other side."""

    before: Side
    length: float


def side_of(point_solver: PointSolver, problem: Problem, place: Point | Side) -> Side | None:
    """A place of the branch on a level of resolution, its own or another one; None where it is not found there."""
    z, tangent = (place.problem.prolong(v, problem) for v in (place.z, place.tangent))
    row = point_solver.metric(problem, z) * tangent
    try:
        if problem is not place.problem:
            correction = point_solver.levels.corrector(problem).correct(z, row, float(row @ z))
            if not correction.converged:
                return None
            z = correction.z
        solve = point_solver.factor(problem, z, row)
    except SingularError:
        return None
    return Side(problem, z, point_solver.tangent(problem, z, solve), solve.orientation)


def shifts(point_solver: PointSolver, place: Point | Side, other: Point | Side | None, step: float) -> bool:
    """Whether a place lies too far from itself on another level for a step, maybe beyond a corner."""
    if other is None:
        return True
    there = place.problem.prolong(place.z, other.problem)
    return point_solver.distance(other.problem, there, other.z) > SHIFT * step


def turned(point_solver: PointSolver, before: Side, after: Side) -> Corner | None:
    """The corner that a step cuts; None where it cuts none.

    Coarse levels have corners where branches cross, and none where they do not: two levels have to agree.
    """
    problem = max(before.problem, after.problem, key=lambda problem: problem.resolution)
    sides = _on(point_solver, problem, before, after)
    if sides is None or sides[0].orientation * sides[1].orientation >= 0.0:
        return None
    found = corner(point_solver, *sides)
    for _ in range(LOOKED_AT):
        finer = point_solver.levels.finer(problem)
        on_finer = None if finer is None else _on(point_solver, finer, *sides)
        if finer is None or on_finer is None or on_finer[0].orientation * on_finer[1].orientation >= 0.0:
            return found
        problem, sides, last = finer, on_finer, found
        found = corner(point_solver, *sides)
        if _agree(found, last):
            return found
    return None


def _agree(one: Corner | None, other: Corner | None) -> bool:
    """Whether two levels of resolution have the same corner, or both none: that of a coarse grid shrinks."""
    if one is None or other is None:
        return one is other
    return bool(1.0 / ALIKE <= one.length / other.length <= ALIKE)


def _on(point_solver: PointSolver, problem: Problem, before: Side, after: Side) -> tuple[Side, Side] | None:
    """Two places on one level; None where one is not found there."""
    one, other = (
        place if place.problem is problem else side_of(point_solver, problem, place) for place in (before, after)
    )
    return None if one is None or other is None else (one, other)


def corner(point_solver: PointSolver, before: Side, after: Side) -> Corner | None:
    """The corner between two places of opposite orientations; None where branches cross there.

    The stretch is halved around the change of sign: the two sides of a corner come no nearer to one another than it is
    wide, while those of a branch point go over into one another.
    """
    whole = length = point_solver.distance(before.problem, before.z, after.z)
    while length > max(SMALLEST, ROUNDED * before.noise, ROUNDED * after.noise):
        turn = _turn(point_solver, before, after)
        if length <= SHORT * whole and turn > SHARP:
            return Corner(before, length)
        tried = (_between(point_solver, before, after, fraction, length) for fraction in FRACTIONS)
        middle = next((one for one in tried if one is not None), None)
        if middle is None:  # where branches cross, no place is found next to the crossing, but both sides are in line
            return Corner(before, min(length, SHORT * whole)) if turn > IN_LINE else None
        if middle.orientation == before.orientation:
            before = middle
        else:
            after = middle
        length = point_solver.distance(before.problem, before.z, after.z)
    return None


def _turn(point_solver: PointSolver, before: Side, after: Side) -> float:
    """The largest angle in degrees between two tangents and the chord."""
    weights = point_solver.metric(before.problem, before.z)
    ways = [np.sqrt(weights) * way for way in (before.tangent, after.z - before.z, after.tangent)]
    first, chord, last = (way / np.linalg.norm(way) for way in ways)
    cosine = min(first @ chord, chord @ last, first @ last)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _between(point_solver: PointSolver, before: Side, after: Side, fraction: float, length: float) -> Side | None:
    """The place of the branch at a fraction of the way between two; None where none is near."""
    problem = before.problem
    row = point_solver.metric(problem, before.z) * before.tangent
    way = float(row @ (after.z - before.z))
    if not (way > 0.0 and float(row @ after.tangent) > 0.0):
        return None
    curve = LocalCurve.through(before.z, before.tangent, after.z, after.tangent, row)
    guess, slope = curve.at(fraction * way), curve.slope(fraction * way)
    row = point_solver.metric(problem, guess) * slope
    correction = point_solver.correct(problem, guess, row, float(row @ guess), length)
    if correction is None:
        return None
    try:
        solve = point_solver.factor(problem, correction.z, row)
        z = correction.z - solve(np.append(problem.evaluate(correction.z)[0], 0.0))  # what is left over is amplified
        response = solve(np.append(problem.rounding(z) * problem.probe, 0.0))
        tangent = point_solver.tangent(problem, z, solve)
    except SingularError:
        return None
    weights = point_solver.metric(problem, z)
    if float((weights * before.tangent) @ tangent) < ALONG:
        return None
    return Side(problem, z, tangent, solve.orientation, float(np.sqrt(np.sum(weights * response**2))))


def point_before(point_solver: PointSolver, found: Corner) -> Point | None:
    """The point before a corner, with the step to go on with; None where none is as near. Raises SingularError."""
    problem, z, tangent = found.before.problem, found.before.z, found.before.tangent
    row = point_solver.metric(problem, z) * tangent
    point = point_solver.near(problem, Correction(z, Status.CONVERGED, 0), tangent, row)
    if point is None:
        return None
    z, tangent = point.z, point.tangent
    for _ in range(POLISHED):  # what a finer level leaves over may be more than a step round the corner
        row = point_solver.metric(point.problem, z) * tangent
        solve = point_solver.factor(point.problem, z, row)
        z = z - solve(np.append(point.problem.evaluate(z)[0], 0.0))
        tangent = point_solver.tangent(point.problem, z, solve)
    point = replace(point, z=z, tangent=tangent, step=CLOSE * found.length)
    return None if shifts(point_solver, found.before, point, found.length) else point
