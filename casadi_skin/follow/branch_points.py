"""Branch points of boundary-value problems: where the Jacobian bordered by the tangent is singular.

How many branches cross a stretch is counted (see `crossed_branches`), and the stretch parted until one does alone, or
several in one place. From there the sign of the determinant gives the place, on one level of resolution after the
other: the null vector may need a finer mesh than the solution, so that the error is the difference of two levels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.crossings import (
    ONE_PLACE,
    Bordered,
    closed,
    crossing_places,
    crossings,
    outer_eigenvalues,
    quiet,
)
from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.polynomials import LocalCurve
from casadi_skin.zero.kinds import BRANCH_POINT
from casadi_skin.zero.problem import EPSILON, Array, Problem, SingularError
from casadi_skin.zero.settings import Point

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

MOST_HALVINGS = 36
SIDE_NOISE = 1e-9  # of a step: nearer to a branch point the corrector's own error hides its side
FINER_LEVELS_TRIED = 6  # levels that are tried
DOUBLE_PASSAGE_WIDTH = 1e-2  # of a step: one eigenvalue that passes zero twice within it is not seen
MOST_PLACES = 80  # on a stretch: more are needed only where rounding hides the branch, as on its way to infinity
PARTING_FRACTION = 0.4823  # of a stretch: where it is parted, seldom at a branch point
OFFSET_AT_BRANCH_POINT = 1e-6  # of a step: where a branch point itself is looked at
UPRIGHT_RATE = 1e-4  # of the rate of the parameter along a branch: that of one that crosses upright, by differences
ROUNDED_RATE = 1e-8  # a rate that is rounding, where neither branch changes the parameter
DIFFERENCE_STEP = 1e-4  # of a step: that of derivatives along it


@dataclass(frozen=True, eq=False)
class _Stretch:
    """A stretch between two points in the unknowns of one level."""

    point_solver: PointSolver
    problem: Problem
    curve: LocalCurve
    length: float
    known: dict[float, Bordered] = field(default_factory=dict)
    known_rates: dict[float, Array] = field(default_factory=dict)

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

    def bordered(self, fraction: float) -> Bordered:
        """The Jacobian with its border at a fraction of the way; raises SingularError where it is not known."""
        if fraction not in self.known:
            try:
                self.known[fraction] = self._bordered(fraction)
            except SingularError:  # at a branch point itself
                self.known[fraction] = self._bordered(fraction + OFFSET_AT_BRANCH_POINT)
        return self.known[fraction]

    def _bordered(self, fraction: float) -> Bordered:
        found = self.at(fraction)
        if found is None:
            raise SingularError("no point of the branch there")
        z, row = found
        nonzeros = self.problem.evaluate(z)[1].copy()
        solve = self.point_solver.levels.solver(self.problem).factor(z, nonzeros, row)
        return Bordered.at(self.problem, nonzeros, row, solve)

    def rates(self, fraction: float) -> Array:
        """Rates along the way of the eigenvalues that are 1 at a fraction of it; raises SingularError."""
        if fraction not in self.known_rates:
            change = (self._predicted(fraction + DIFFERENCE_STEP) - self._predicted(fraction - DIFFERENCE_STEP)) / (
                2.0 * DIFFERENCE_STEP
            )
            self.known_rates[fraction] = outer_eigenvalues(self.bordered(fraction), change)
        return self.known_rates[fraction]

    def _predicted(self, fraction: float) -> csc_matrix:
        guess, slope = self.curve.at(fraction * self.length), self.curve.slope(fraction * self.length)
        row = self.point_solver.metric(self.problem, guess) * slope
        return closed(self.problem, self.problem.evaluate(guess)[1], row)

    def roots(self, low: float = 0.0, high: float = 1.0) -> list[tuple[float, int]]:
        """The fractions of the way at which branches cross, in order, and how many do; raises SingularError."""
        count, way = crossings(self.bordered(low), self.bordered(high)), high - low
        if count < 2 or way < ONE_PLACE:
            found = [(self._place(low, high, count), count)] if count else []
            before = (found[0][0] - low) / way if found else None
            after = (high - found[0][0]) / way if found else None
            if (
                way < DOUBLE_PASSAGE_WIDTH
                or len(self.known) > MOST_PLACES
                or (quiet(self.rates(low), way, before) and quiet(-self.rates(high), way, after))
            ):
                return found
        middle = low + PARTING_FRACTION * way
        return [*self.roots(low, middle), *self.roots(middle, high)]

    def _place(self, low: float, high: float, count: int) -> float:
        """Places where branches cross within a part of the way, one or an even number of them in one place."""
        first = self.side(low)
        for _ in range(MOST_HALVINGS):
            middle = 0.5 * (low + high)
            if high - low < SIDE_NOISE:
                break
            if count % 2:
                here = self.side(middle)
                if here == 0.0:
                    break
                before = here != first
            else:
                try:
                    before = crossings(self.bordered(low), self.bordered(middle)) > 0
                except SingularError:  # which the place itself is
                    break
            low, high = (low, middle) if before else (middle, high)
        return middle


def branch_points_between(point_solver: PointSolver, before: Point, after: Point) -> list[tuple[Point, bool]]:
    """The branch points between two points in order, on the level of resolution that their null vectors need.

    Each with whether it is one of several that cross there, which `crossing_places` has found. Where the corrector
    fails on a level they are those of the level before.
    """
    problem: Problem | None = after.problem
    found: list[tuple[Point, bool]] = []
    for _ in range(FINER_LEVELS_TRIED):
        assert problem is not None
        stretch = _Stretch.of(point_solver, before, after, problem)
        try:
            coarser = [point for point, _ in found]
            located = [_points(stretch, after, root, count, coarser) for root, count in stretch.roots()]
        except SingularError:
            break
        found = [one for points in located for one in points]
        if all(point.error.parameter <= point_solver.settings.tolerance for point, _ in found):
            break
        problem = point_solver.levels.finer(problem)
        if problem is None:
            break
    return found


def _points(
    stretch: _Stretch, after: Point, root: float, count: int, coarser: Sequence[Point]
) -> list[tuple[Point, bool]]:
    """The branch points at a fraction of the way, each with whether it is one of several that cross there."""
    tolerance = stretch.point_solver.settings.tolerance
    if count > 1:
        places = crossing_places(stretch.problem, stretch.at, root, count, tolerance / stretch.length)
        if places:
            return [(_as_point(stretch, after, one.z, one.slope, one.error, coarser), True) for one in places]
    state = next((found for off in (0.0, 1e-8, -1e-8, 1e-6, -1e-6) if (found := stretch.at(root + off))), None)
    if state is None:
        return []
    z, slope = stretch.curve.at(root * stretch.length), stretch.length * stretch.curve.slope(root * stretch.length)
    z = np.where(np.arange(z.size) == stretch.problem.parameter_index, z, state[0])
    return [(_as_point(stretch, after, z, slope, SIDE_NOISE, coarser), False)]


def _as_point(stretch: _Stretch, after: Point, z: Array, slope: Array, own: float, coarser: Sequence[Point]) -> Point:
    """A branch point; its error is its own, of the fraction of the way, and the difference to the coarser level."""
    problem, place = stretch.problem, stretch.problem.parameter_index
    tangent = slope / np.sqrt(np.sum(stretch.point_solver.metric(problem, z) * slope**2))
    apart = min((abs(float(z[place]) - point.parameter) for point in coarser), default=1.0)
    moved = 2.0 * apart + own * abs(float(slope[place])) + EPSILON * abs(float(z[place]))
    error = replace(after.error, parameter=moved / problem.parameter_size(z))
    step = stretch.point_solver.settings.first_step
    return Point(problem, z, np.asarray(tangent), error, step, 0, walked=False, special=BRANCH_POINT)


def leaving_tangent(point_solver: PointSolver, point: Point, side: int) -> Array:
    """The tangent of the branch that leaves at a branch point with the tangent of the other one, of length 1.

    Its side 1 goes to larger values of the parameter followed; where that rests to first order, as where a symmetry is
    lost, it is the side on which the component that changes most grows. What is left of the parameter's rate there is
    rounding, and is taken out: it would turn back next to the start.
    """
    tangent, problem = other_tangent(point_solver, point), point.problem
    place, states = problem.parameter_index, tangent[: problem.states]
    along = point.tangent / np.sqrt(np.sum(point_solver.metric(problem, point.z) * point.tangent**2))
    tangent = tangent / np.sqrt(np.sum(point_solver.metric(problem, point.z) * tangent**2))
    upright = abs(tangent[place]) <= max(UPRIGHT_RATE * abs(along[place]), ROUNDED_RATE)
    tangent[place] = 0.0 if upright else tangent[place]
    sign = np.sign(states[np.argmax(np.abs(states))]) if upright else np.sign(tangent[place])
    return np.asarray(side * sign * tangent)


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
