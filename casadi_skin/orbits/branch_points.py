"""Branch points of boundary-value problems: where the Jacobian bordered by the tangent is singular.

Its determinant changes its sign where an odd number of branches crosses. The place is found by halving, on one level of
resolution after the other: the null vector may need a finer mesh than the solution, so that the error is the difference
of two levels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.bvp.problem import Array, Problem, SingularError
from casadi_skin.continuation.hermite import LocalCurve
from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import Point
from casadi_skin.orbits.special_points import BRANCH_POINT

HALVINGS = 36
NOISE = 1e-9  # of a step: nearer to a branch point the corrector's own error hides its side
FINER = 6  # levels that are tried


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A stretch between two points in the unknowns of one level."""

    point_solver: PointSolver
    problem: Problem
    curve: LocalCurve
    length: float

    @classmethod
    def of(cls, point_solver: PointSolver, before: Point, after: Point, problem: Problem) -> _Stretch:
        ends = [(p.problem.prolong(p.z, problem), p.problem.prolong(p.tangent, problem)) for p in (before, after)]
        (z, t), (z1, t1) = ends
        row = point_solver.metric(problem, z) * t
        return cls(point_solver, problem, LocalCurve.through(z, t, z1, t1, row), float(row @ (z1 - z)))

    def at(self, fraction: float) -> tuple[Array, Array] | None:
        """Corrected state and the row of the slope there; None where the corrector fails."""
        guess, slope = self.curve.at(fraction * self.length), self.curve.slope(fraction * self.length)
        row = self.point_solver.metric(self.problem, guess) * slope
        found = self.point_solver.correct(self.problem, guess, row, float(row @ guess), self.length)
        return None if found is None else (found.z, row)

    def side(self, fraction: float) -> float:
        """The sign of the determinant at a fraction of the way; 0 where it is not known."""
        found = self.at(fraction)
        if found is None:
            return 0.0
        z, row = found
        return self.point_solver.levels.solver(self.problem).orientation(self.problem.evaluate(z)[1], row)

    def root(self) -> float | None:
        """The fraction at which the sign changes; None where it does not."""
        first, last = self.side(0.0), self.side(1.0)
        if not first * last < 0.0:
            return None
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            here = self.side(middle)
            if here == 0.0 or high - low < NOISE:
                return middle
            low, high = (middle, high) if here == first else (low, middle)
        return 0.5 * (low + high)


def branch_point_between(point_solver: PointSolver, before: Point, after: Point) -> Point | None:
    """The branch point between two points, on the level that its null vector needs; None where there is none."""
    problem, found = after.problem, None
    for _ in range(FINER):
        stretch = _Stretch.of(point_solver, before, after, problem)
        try:
            root = stretch.root()
        except SingularError:
            return None
        if root is None:
            return None
        point = _point(stretch, after, root, found)
        found = point or found
        finer = point_solver.levels.finer(problem)
        if point is None or finer is None or point.error.parameter <= point_solver.settings.tolerance:
            return found
        problem = finer
    return found


def _point(stretch: _Stretch, after: Point, root: float, coarser: Point | None) -> Point | None:
    """The branch point at a fraction of the way, with the difference to that of the coarser level for its error."""
    problem, place = stretch.problem, stretch.problem.parameter_index
    state = next((found for off in (0.0, 1e-8, -1e-8, 1e-6, -1e-6) if (found := stretch.at(root + off))), None)
    if state is None:
        return None
    z, slope = stretch.curve.at(root * stretch.length), stretch.curve.slope(root * stretch.length)
    z = np.where(np.arange(z.size) == place, z, state[0])
    tangent = slope / np.sqrt(np.sum(stretch.point_solver.metric(problem, z) * slope**2))
    apart = 1.0 if coarser is None else abs(float(z[place]) - coarser.parameter)
    moved = 2.0 * apart + NOISE * stretch.length * abs(float(tangent[place]))
    error = replace(after.error, parameter=moved / problem.parameter_size(z))
    step = stretch.point_solver.settings.first_step
    return Point(problem, z, np.asarray(tangent), error, step, 0, walked=False, special=BRANCH_POINT)


def other_tangent(point_solver: PointSolver, point: Point) -> Array:
    """The tangent of the branch that crosses at a branch point, from the quadratic terms of the equations.

    Null vectors by inverse iteration, second derivatives by differences of the Jacobian (Keller 1977).
    """
    from scipy.sparse import csc_matrix

    problem, z, along = point.problem, point.z, point.tangent
    rows, columns = problem.pattern
    sizes = 1.0 / np.sqrt(point_solver.metric(problem, z))

    def jacobian(at: Array) -> csc_matrix:
        values = problem.evaluate(at)[1] * sizes[columns]
        return csc_matrix((values, (rows, columns)), shape=(problem.size - 1, problem.size))

    J, t = jacobian(z), along / sizes
    t = t / np.linalg.norm(t)
    across, psi = _null_vectors(J, t)
    first, _ = _null_vectors(J, across)  # the tangent given may be that of a point beside it
    h = 1e-4

    def form(a: Array, b: Array) -> float:
        moved = (jacobian(z + h * sizes * a) - jacobian(z - h * sizes * a)) @ b / (2.0 * h)
        return float(psi @ moved)

    own, mixed, curved = form(first, first), form(first, across), form(across, across)
    root = mixed + np.copysign(np.sqrt(max(mixed**2 - own * curved, 0.0)), mixed)
    choices = [-root * first + own * across, curved * first - root * across] if root else [across]
    directions = [sizes * choice / np.linalg.norm(choice) for choice in choices]
    return np.asarray(min(directions, key=lambda direction: abs(float(direction / sizes @ t))))


def _null_vectors(J: Any, t: Array) -> tuple[Array, Array]:
    """The vector across t that a Jacobian annihilates at a branch point, and the one from the left; of norm 1."""
    from scipy.sparse import csc_matrix, diags, vstack
    from scipy.sparse.linalg import splu

    closed = vstack([J, csc_matrix(t[None, :])]).tocsc()
    generator = np.random.default_rng(0)
    shift = 1e-11 * float(np.max(np.abs(closed.data)))
    factors = splu((closed + shift * diags(generator.random(t.size))).tocsc())
    right: Array = generator.normal(size=t.size)
    for _ in range(4):
        left = np.asarray(factors.solve(right / np.linalg.norm(right), trans="T"))  # type: ignore[call-overload]
        right = np.asarray(factors.solve(np.asarray(left / np.linalg.norm(left), dtype=float)))
    across = right - t * (t @ right)
    return np.asarray(across / np.linalg.norm(across)), np.asarray(left[:-1] / np.linalg.norm(left[:-1]))
