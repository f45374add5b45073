"""Neighbouring points of a branch that are too far apart to predict the stretch between them: smaller steps there.

In a narrow resonance a branch turns aside, goes far and comes back, as it was or half a period later. A walk in long
steps may pass it by, so that two neighbouring points are on either side of it and no orbit is where they predict it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, pairwise

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.arclength import ArclengthContinuation
from casadi_skin.follow.point_solver import PointSolver
from casadi_skin.follow.settings import End, Point
from casadi_skin.zero.problem import Array

FIRST = 1 / 16  # of the way from one point to the next: the first step
AIM = 3.0  # degrees that the branch turns by in a step
MOST = 3000  # points of a walk


def with_what_lies_between(point_solver: PointSolver, points: Sequence[Point], lost: NDArray[np.bool_]) -> list[Point]:
    """Points with those between each and the next where an orbit is lost.

    A walk that does not come to the next point, but to the end of the branch, takes the place of all that follow.

    Arguments:
        point_solver: of the branch.
        points: of it in order.
        lost: whether an orbit between a point and the next is not found, shape (points - 1,).
    """
    found = [points[0]]
    for (before, after), is_lost in zip(pairwise(points), lost.tolist(), strict=True):
        if is_lost and before.parameter != 0.0:
            walked, at_the_end = _walked(point_solver, before, after)
            found += walked
            if at_the_end:
                return found
        found.append(after)
    return found


def _walked(point_solver: PointSolver, before: Point, after: Point) -> tuple[list[Point], bool]:
    """The points of a walk from one point to another, and whether it came to the branch's end instead; else none."""
    step = FIRST * float(np.linalg.norm(_way(point_solver, before, after)))
    settings = replace(point_solver.settings, at=(), first_step=step, aim_angle=AIM, tiny_first=False)
    walk = ArclengthContinuation(PointSolver(point_solver.levels, settings), (replace(before, step=step),))
    found = [before]
    for point in islice(walk, MOST):
        if _passes(point_solver, found[-1], point, after):
            return found[1:], False
        found.append(point)
    return (found[1:], True) if walk.end is End.REACHED else ([], False)


def _way(point_solver: PointSolver, start: Point, end: Point) -> Array:
    """From one point to another, in coordinates in which the metric is that of Euclid."""
    finer = max(start.problem, end.problem, key=lambda problem: problem.resolution)
    z, z_end = start.problem.prolong(start.z, finer), end.problem.prolong(end.z, finer)
    return np.asarray(np.sqrt(point_solver.metric(finer, z)) * (z_end - z))


def _passes(point_solver: PointSolver, start: Point, end: Point, point: Point) -> bool:
    """Whether a step goes by a point."""
    step = float(np.linalg.norm(_way(point_solver, start, end)))
    before, beyond = (float(np.linalg.norm(_way(point_solver, p, point))) for p in (start, end))
    return bool(before + beyond <= step / np.cos(np.radians(AIM)))
