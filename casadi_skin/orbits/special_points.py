"""Points of a branch that stand out: folds, at which the quantity that is followed turns back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import Point

if TYPE_CHECKING:
    from casadi_skin.orbits.solution import Solution

FOLD = "fold"
FOLD_TOLERANCE = 1e-7  # of a step: the parameter is stationary there, so that it has twice the digits


class NotLocatedError(ArithmeticError):
    """A special point that the branch passes cannot be located; the message tells why."""


@dataclass(frozen=True, eq=False)
class SpecialPoint:
    """A point of a branch that stands out.

    Attributes:
        kind: "fold".
        parameters: values of all parameters by name, and of what the branch is followed in.
        error: estimated error of the value that is followed.
        solution: the solution there.
    """

    kind: str
    parameters: Mapping[str, float]
    error: float
    solution: Solution


def turns_between(before: Point, after: Point) -> bool:
    """Whether the quantity that is followed turns back between two points."""
    return parameter_rate(before) * parameter_rate(after) < 0.0


def parameter_rate(point: Point) -> float:
    """Rate of the free parameter along the branch."""
    return float(point.tangent[point.problem.parameter_index])


def fold_between(point_solver: PointSolver, before: Point, after: Point) -> Point:
    """The point between two at which the free parameter is stationary; raises NotLocatedError where none is found."""
    from scipy.optimize import brentq

    known: dict[float, Point] = {0.0: before, 1.0: after}

    def rate(fraction: float) -> float:
        point = known.get(fraction) or point_solver.along(before, after, fraction)
        if point is None:
            why = point_solver.failure or "the equations are singular beside it"
            raise NotLocatedError(f"the parameter turns back at a point that cannot be located: {why}")
        known[fraction] = point
        return parameter_rate(point)

    root = float(brentq(rate, 0.0, 1.0, xtol=FOLD_TOLERANCE))
    rate(root)
    return known[root]
