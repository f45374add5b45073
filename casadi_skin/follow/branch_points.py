"""The number of branches that cross a stretch of a branch, an even one too: eigenvalues from one end to the other.

The Jacobian bordered by the tangent is J0 at one end and J1 at the other. The eigenvalues of J0^-1 J1 are all 1 where
the ends coincide, and one of them passes through zero where J1 passes a branch point: as many are negative as branches
cross, where the sign of a determinant is that of their product alone. One that passes through zero and comes back is
seen by its rate at either end, an eigenvalue of J^-1 dJ/ds. J0^-1 J1 is 1 plus a compact operator, so that few
eigenvalues lie far from 1: Arnoldi's method (Saad 2011, chapter 6) sees those at once.

The place where k branches cross at once: the Jacobian bordered by the tangent has a kernel of dimension k there.

Bordered by k columns and k rows more it is regular, and the k x k corner G of the inverse vanishes where the kernel is
(Govaerts 2000, chapter 3). The branch itself cannot be corrected there: its points and G are interpolated from places
on both sides. The inverse of the slope of G times G has one eigenvalue for each branch that crosses: how far before
the place it does. Their mean gives the place.

Points of codimension two at which extended equations are singular, as where two null vectors meet: interpolated.

Branch points of boundary-value problems: where the Jacobian bordered by the tangent is singular.

How many branches cross a stretch is counted (see `crossed_branches`), and the stretch parted until one does alone, or
several in one place. From there the sign of the determinant gives the place, on one level of resolution after the
other: the null vector may need a finer mesh than the solution, so that the error is the difference of two levels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from casadi_skin.follow.point import LocalCurve, PointSolver
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLE
from casadi_skin.zero.linearised import bordered, null_spaces, null_vectors
from casadi_skin.zero.problem import EPSILON, Array, Problem, SingularError, Solve
from casadi_skin.zero.settings import Point

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

ARNOLDI_STEPS = 14  # of Arnoldi's method, after which eigenvalues far from the others are known
QUIET_FALL = 0.7  # of 1: an eigenvalue that falls by less on the way, at its rate at an end, reaches no zero
SUSPECT_REAL_PART = 0.5  # largest real part of eigenvalues that are looked at closely
DENSE_UNKNOWNS = 500  # unknowns up to which all eigenvalues are computed
MOST_EIGENVALUES = 20  # eigenvalues that are computed of larger systems


@dataclass(frozen=True, eq=False)
class Bordered:
    """The Jacobian with its border at one place, and the solver of both."""

    matrix: csc_matrix
    solve: Solve


def closed(problem: Problem, nonzeros: Array, row: Array) -> csc_matrix:
    """The Jacobian of these non-zeros, with a row below it."""
    from scipy.sparse import csc_matrix

    return _below(csc_matrix((nonzeros, problem.pattern), shape=(problem.size - 1, problem.size)), row)


def _below(matrix: csc_matrix, row: Array) -> csc_matrix:
    """A matrix with a row below it."""
    from scipy.sparse import csc_matrix, vstack

    return vstack([matrix, csc_matrix(row[None, :])]).tocsc()


def crossings(before: Bordered, after: Bordered) -> int:
    """The number of branches that cross between two places: negative eigenvalues of one matrix relative to another."""
    if np.min(outer_eigenvalues(before, after.matrix).real, initial=1.0) > SUSPECT_REAL_PART:
        return 0
    values = _eigenvalues(before, after)
    real = np.abs(values.imag) <= 1e-6 * np.abs(values)
    return int(np.sum(real & (values.real < 0.0)))


def quiet(rates: Array, way: float, crossed: float | None) -> bool:
    """Whether eigenvalues with these rates go through no zero on a way, but for one at a part of it if it is given."""
    falls = np.sort((rates * way).real)
    if crossed is not None and falls.size:
        falls[0] += 1.0 / max(crossed, np.finfo(float).tiny)
    return bool(np.all(falls > -QUIET_FALL))


def outer_eigenvalues(before: Bordered, matrix: csc_matrix) -> Array:
    """Those of the solver times a matrix that lie far from the others, by a few steps of Arnoldi's method."""
    size = before.matrix.shape[0]
    steps = min(ARNOLDI_STEPS, size)
    basis, hessenberg = np.zeros((steps + 1, size)), np.zeros((steps + 1, steps))
    start = np.random.default_rng(0).normal(size=size)
    basis[0] = start / np.linalg.norm(start)
    for k in range(steps):
        found = before.solve(matrix @ basis[k])
        for _ in range(2):  # twice is enough
            parts = basis[: k + 1] @ found
            hessenberg[: k + 1, k] += parts
            found = found - parts @ basis[: k + 1]
        hessenberg[k + 1, k] = np.linalg.norm(found)
        if hessenberg[k + 1, k] <= 1e-12 * np.max(np.abs(hessenberg[: k + 1, k])):
            steps = k + 1
            break
        basis[k + 1] = found / hessenberg[k + 1, k]
    return np.asarray(np.linalg.eigvals(hessenberg[:steps, :steps]))


def _eigenvalues(before: Bordered, after: Bordered) -> Array:
    """All eigenvalues, or those of a large system with the smallest real parts."""
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

    size = before.matrix.shape[0]
    if size <= DENSE_UNKNOWNS:
        return np.asarray(np.linalg.eigvals(before.solve(after.matrix.toarray())))
    operator = LinearOperator((size, size), matvec=lambda v: before.solve(after.matrix @ np.asarray(v).ravel()))
    start = np.random.default_rng(1).normal(size=size)
    try:
        return np.asarray(eigs(operator, MOST_EIGENVALUES, which="SR", v0=start, tol=1e-4, return_eigenvectors=False))
    except ArpackNoConvergence as error:
        return np.asarray(error.eigenvalues)


# The place where k branches cross at once: the Jacobian bordered by the tangent has a kernel of dimension k there -----

ONE_PLACE = 1e-3  # of a step: several branches that cross within it do so in one place
WINDOW_WIDTHS = (0.1, 0.02, 0.004)  # of a step, to both sides; the widest in which interpolation is accurate is taken
WINDOW_PLACES = 12  # places in it; an even number has none in its middle
LEAST_PLACES = 8  # places without which nothing is interpolated
ITERATION_ROUNDS = 4  # of Newton's method
OFFSET_FROM_PLACE = 1e-2  # of the window: nearer to the place points are not corrected


class CrossingPlace(NamedTuple):
    """Unknowns where several branches cross, and their slope along the branch.

    Attributes:
        z: unknowns.
        slope: their derivative by the fraction of the way.
        error: of the fraction: of the interpolation, of rounding, and how far from it single branches cross.
    """

    z: Array
    slope: Array
    error: float


def crossing_places(stretch: _Stretch, near: float, count: int, apart: float) -> list[CrossingPlace]:
    """The places near a fraction of the way where `count` branches cross: one, or each where all are further apart.

    Empty where points beside the place are missing, and where no such place is so near.
    """
    for window in WINDOW_WIDTHS:
        found = _within(window, stretch, near, count, apart)
        if found and all(one.error <= apart for one in found):
            return found
    return _within(WINDOW_WIDTHS[-1], stretch, near, count, float("inf"))


def _within(window: float, stretch: _Stretch, near: float, count: int, apart: float) -> list[CrossingPlace]:
    """As `crossing_places`, from points in a window."""
    from scipy.interpolate import KroghInterpolator
    from scipy.sparse.linalg import splu

    problem, middle = stretch.problem, np.clip(near, window, 1.0 - window)
    places = middle - window * np.cos(np.pi * (np.arange(WINDOW_PLACES) + 0.5) / WINDOW_PLACES)
    places = places[np.abs(places - near) > OFFSET_FROM_PLACE * window]
    known = {float(f): there for f in places if (there := stretch.at(float(f))) is not None}
    if len(known) < LEAST_PLACES:
        return []
    try:
        matrices, unknowns = [], []
        for z, row in known.values():  # one Newton step more: beside a singular place the corrector's last one counts
            residual, nonzeros = problem.evaluate(z)
            unknowns.append(z - splu(closed(problem, nonzeros, row)).solve(np.append(residual, 0.0)))
            matrices.append(closed(problem, problem.evaluate(unknowns[-1])[1], row))
        places = np.array(list(known))
        matrix = matrices[int(np.argmin(np.abs(places - near)))]
        right, left = null_spaces(matrix, count)
        corners = np.array([_corner(one, right, left) for one in matrices])
    except (RuntimeError, SingularError):  # of SuperLU: exactly singular
        return []
    whole, fewer = (_zeros(places[k], corners[k], near, apart) for k in (slice(None), slice(1, -1)))
    if len(whole) != len(fewer) or any(abs(zero.place - near) > ONE_PLACE for zero in whole):
        return []
    noise = EPSILON * float(np.linalg.norm(np.abs(left.T) @ (abs(matrix) @ np.abs(right))))
    errors = [abs(one.place - other.place) + noise * one.steepness for one, other in zip(whole, fewer, strict=True)]
    course = KroghInterpolator(places, np.array(unknowns))
    return [
        CrossingPlace(np.asarray(course(one.place)), np.asarray(course.derivative(one.place)), error + one.spread)
        for one, error in zip(whole, errors, strict=True)
    ]


def _corner(matrix: Any, right: Array, left: Array) -> Array:
    """The corner of the inverse of a matrix bordered by vectors, which is zero where these are its kernels."""
    from scipy.sparse.linalg import splu

    size, count = right.shape
    unit = np.vstack([np.zeros((size, count)), np.eye(count)])
    return np.asarray(splu(bordered(matrix, right, left)).solve(unit)[size:])


class _Zero(NamedTuple):
    """Where matrices vanish, how far from there their eigenvalues do, and how far a change of 1 moves it."""

    place: float
    spread: float
    steepness: float


def _zeros(places: Array, corners: Array, near: float, apart: float) -> list[_Zero]:
    """The zeros near a place of eigenvalues of interpolated matrices: their mean, or each where all are further apart.

    Empty where there is none among the places of the matrices.
    """
    from scipy.interpolate import KroghInterpolator

    polynomial = KroghInterpolator(places, corners)

    def moves(place: float) -> Array:
        return np.asarray(-np.linalg.eigvals(np.linalg.solve(polynomial.derivative(place), polynomial(place))))

    try:
        for _ in range(ITERATION_ROUNDS):
            near += float(np.mean(moves(near).real))
            if not places[0] < near < places[-1]:
                return []
        found = moves(near)
        steepness = float(np.linalg.norm(np.linalg.inv(polynomial.derivative(near)), 2))
        if np.any(found.imag) or np.any(np.diff(np.sort(found.real)) <= apart):
            return [_Zero(near, float(np.max(np.abs(found))), steepness)]
        zeros = near + np.sort(found.real)
        for _ in range(ITERATION_ROUNDS):
            zeros = np.array([zero + min(moves(zero), key=abs).real for zero in zeros])
    except np.linalg.LinAlgError:
        return []
    return [_Zero(float(zero), 0.0, steepness) for zero in zeros]


# Points of codimension two at which extended equations are singular, as where two null vectors meet: interpolated -----

INTERPOLATION_NODES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(12) + 0.5) / 12)  # of a step
LEAST_INTERPOLATED = 6  # of these places: with fewer the error is not seen
SECOND_SINGULAR_RATIO = 1e-3  # of its usual size: a second singular value that is zero


def double_between(
    solver: PointSolver, before: Point, after: Point, test: Callable[[Point], float], second: Callable[[Point], float]
) -> tuple[float, Point] | None:
    """The double branch point between two branch points, with its place; None where the Jacobian has one null vector.

    `test` changes its sign there; `second` is the second smallest singular value of the Jacobian.
    """
    found = interpolated(solver, before, after, test)
    if found is None or second(found[1]) > SECOND_SINGULAR_RATIO * max(second(before), second(after)):
        return None
    return found[0], replace(found[1], special=DOUBLE)


def interpolated(
    solver: PointSolver, before: Point, after: Point, test: Callable[[Point], float]
) -> tuple[float, Point] | None:
    """The point between two at which a test changes its sign, with its place; None where it does not.

    Unknowns and test are interpolated from places around it, as far as they are found.
    """
    from scipy.interpolate import KroghInterpolator
    from scipy.optimize import brentq

    tried = [(float(f), solver.along(before, after, float(f))) for f in INTERPOLATION_NODES]
    around = [(f, point) for f, point in tried if point is not None]
    if len(around) < LEAST_INTERPOLATED:
        return None
    places, values = np.array([f for f, _ in around]), np.array([test(point) for _, point in around])
    roots = list[float]()
    for chosen in (slice(None), slice(1, -1)):  # fewer of them, for the error
        polynomial = KroghInterpolator(places[chosen], values[chosen])
        if polynomial(0.0) * polynomial(1.0) >= 0.0:
            return None
        roots.append(float(brentq(lambda f, p=polynomial: float(p(f)), 0.0, 1.0, xtol=1e-14)))
    near = min(around, key=lambda one: abs(one[0] - roots[0]))[1]
    unknowns = KroghInterpolator(places, [point.problem.prolong(point.z, near.problem) for _, point in around])
    rate = float(np.asarray(unknowns.derivative(roots[0]))[-1])
    apart = abs((roots[1] - roots[0]) * rate) + near.error.relative(1.0)
    error = replace(near.error, parameter=float(apart))
    z = np.asarray(unknowns(roots[0]))
    return roots[0], near.marked(near.special, z=z, error=error, better=None)


# Branch points of boundary-value problems: where the Jacobian bordered by the tangent is singular --------------------

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
    known: dict[float, Bordered] = field(default_factory=dict)
    known_rates: dict[float, Array] = field(default_factory=dict)

    @property
    def length(self) -> float:
        return self.curve.length

    def at(self, fraction: float) -> tuple[Array, Array] | None:
        """Corrected state and the row of the slope there; None where the corrector fails."""
        found, row = self.point_solver.on_curve(self.problem, self.curve, fraction)
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
        return Bordered(closed(self.problem, nonzeros, row), solve)

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
        z, tangent = (after.problem.prolong(v, problem) for v in (after.z, after.tangent))
        curve, _ = point_solver.curve(before, replace(after, problem=problem, z=z, tangent=tangent))
        stretch = _Stretch(point_solver, problem, curve)
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
        places = crossing_places(stretch, root, count, tolerance / stretch.length)
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
    across, psi = null_vectors(_below(J, t))
    across, psi = (part / np.linalg.norm(part) for part in (across - t * (t @ across), psi[:-1]))
    first = null_vectors(_below(J, across))[0]  # the tangent given may be that of a point beside it
    first = first - across * (across @ first)
    first = first / np.linalg.norm(first)
    h = 1e-4

    def form(a: Array, b: Array) -> float:
        moved = (jacobian(z + h * sizes * a) - jacobian(z - h * sizes * a)) @ b / (2.0 * h)
        return float(psi @ moved)

    return sizes * other_direction(form, first, across, t)[0]


def other_direction(
    form: Callable[[Array, Array], float], first: Array, second: Array, along: Array
) -> tuple[Array, float]:
    """The tangent of norm 1 of the other of two branches that cross, and the discriminant, which is positive there.

    Tangents are a first + b second with form(first, first) a^2 + 2 form(first, second) a b + form(second, second) b^2
    = 0, of which that of one branch is `along`; without cancellation.
    """
    own, mixed, curved = form(first, first), form(first, second), form(second, second)
    discriminant = mixed**2 - own * curved
    root = mixed + np.copysign(np.sqrt(max(discriminant, 0.0)), mixed)
    choices = [-root * first + own * second, curved * first - root * second] if root else [second]
    directions = [choice / np.linalg.norm(choice) for choice in choices]
    return min(directions, key=lambda direction: abs(float(direction @ along))), discriminant
