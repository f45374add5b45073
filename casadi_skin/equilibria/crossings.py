"""Which eigenvalues cross the imaginary axis on a stretch of a branch, seen from its two ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.hermite import LocalCurve
from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import Point
from casadi_skin.equilibria.location import jacobian_of
from casadi_skin.equilibria.problem import AlgebraicProblem
from casadi_skin.equilibria.statics import ComplexArray, eigensystem


@dataclass(frozen=True, eq=False)
class End:
    """An end of a stretch: eigenvalues, their rates along it, the sign of the determinant with the tangent."""

    point: Point
    values: ComplexArray
    rates: ComplexArray
    orientation: float


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of branch between two ends, a cubic in z(sigma) for 0 <= sigma <= length."""

    first: End
    last: End
    curve: LocalCurve
    length: float

    @property
    def turns(self) -> bool:
        """Whether the parameter turns back an odd number of times."""
        return bool(self.first.point.tangent[-1] * self.last.point.tangent[-1] < 0.0)

    @property
    def reorients(self) -> bool:
        """Whether an odd number of other branches is met."""
        return self.first.orientation * self.last.orientation < 0.0


def stretch_between(point_solver: PointSolver, before: Point, after: Point) -> Stretch:
    """The stretch between two points of a branch."""
    curve, length = point_solver.curve(before, after)
    ends = [end_of(point, curve.slope(sigma)) for point, sigma in ((before, 0.0), (after, length))]
    return Stretch(ends[0], ends[1], curve, length)


def end_of(point: Point, slope: Array) -> End:
    """What is known at an end; rates by the change of the Jacobian along the slope."""
    problem, z = cast(AlgebraicProblem, point.problem), point.z
    matrix = jacobian_of(problem, z)
    h = 1e-6 / max(1e-300, float(np.max(np.abs(slope))))
    moved = [jacobian_of(problem, z + sign * h * slope) for sign in (1.0, -1.0)]
    values, left, right = eigensystem(matrix)
    products = np.sum(left.conj() * right, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        rates = np.sum(left.conj() * ((moved[0] - moved[1]) / (2.0 * h) @ right), axis=0) / products
    bordered = np.vstack([problem.dense(z), point.tangent])
    sign, _ = np.linalg.slogdet(bordered)
    return End(point, values, np.where(np.isfinite(rates), rates, 0.0), float(sign))


def matched(stretch: Stretch) -> Array:
    """For each eigenvalue of the first end its place at the last: the assignment with the smallest changes."""
    from scipy.optimize import linear_sum_assignment

    first, last, length = stretch.first, stretch.last, stretch.length
    expected = first.values + 0.5 * length * first.rates
    back = last.values - 0.5 * length * last.rates
    direct = np.abs(first.values[:, None] - last.values)
    predicted = np.abs(expected[:, None] - back)
    return np.asarray(linear_sum_assignment(np.minimum(direct, predicted))[1])


def crossings(stretch: Stretch, order: Array) -> tuple[list[int], list[int]]:
    """Eigenvalues whose real part changes sign, by their place at the first end: real ones, and one of each pair."""
    first, last = stretch.first.values, stretch.last.values[order]
    places = np.flatnonzero(np.sign(first.real) * np.sign(last.real) < 0.0).tolist()
    complex_ = [place for place in places if first[place].imag != 0.0 or last[place].imag != 0.0]
    reals = [place for place in places if place not in complex_]
    upper = [place for place in complex_ if height(first[place], last[place]) > 0.0]
    odd = len(complex_) - 2 * len(upper)
    return reals + [place for place in complex_ if place not in upper][: max(odd, 0)], upper


def height(first: complex, last: complex) -> float:
    """Imaginary part where the line between two eigenvalues meets the imaginary axis."""
    share = abs(first.real) / (abs(first.real) + abs(last.real))
    return (1.0 - share) * first.imag + share * last.imag
