"""Corrected points of a branch: near a guess, at a value of the parameter or Omega, between two other points.

The corrector confirms every point, which is refined until its estimated error meets the tolerance. Between two points a
branch is a polynomial in a coordinate along it, z(sigma) = sum_k c_k sigma^k with c of shape (orders + 1, unknowns).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import groupby
from typing import Any, cast

import numpy as np
from numpy.polynomial.polynomial import polyder, polyroots, polyval

from casadi_skin.follow.moving import Moving
from casadi_skin.solve.bordered import BorderedSolver, Steps
from casadi_skin.solve.levels import Levels, Measured, at_parameter, step_error
from casadi_skin.solve.newton import Correction, Status
from casadi_skin.zero.problem import Array, OrbitProblem, Problem, Scalar, SingularError, Solve
from casadi_skin.zero.settings import ContinuationSettings, ErrorEstimate, Point, Target

# Polynomials of a branch in a coordinate along it ---------------------------------------------------------------------

PREDICTING_POINTS = 4  # points that a prediction is made from
REACH_MARGIN = 1e-9  # of a stretch, by which a place may be beyond its end: rounding is far below
SAME_MISS = 1.01  # of the tangent's miss: that of a curve through one point is the same but for rounding
ALIGNED_COSINE = 0.7  # cosine of the turn since a point, at least: three steps turn by less, a corner by more


@dataclass(frozen=True)
class LocalCurve:
    """z(sigma) = sum_k coefficients[k] sigma^k for 0 <= sigma <= length, of shape (orders + 1, unknowns).

    Where the mesh is `moving`, the end is its start, and unknowns are those on the mesh at sigma.
    """

    coefficients: Array
    length: float
    moving: Moving | None = None

    def on(self, problem: Problem, sigma: float) -> Problem:
        """The equations at a place: `problem` on its mesh, or as far as that moves."""
        return problem if self.moving is None else (self.moving.on(sigma - self.length) or problem)

    @property
    def scale(self) -> float:
        """The length along the branch by sigma, about."""
        return 1.0 if self.moving is None else self.moving.start.scale

    def along(self, problem: Problem, z: Array, tangent: Array, sigma: float) -> Array:
        """The tangent at a place in the direction of the curve."""
        if self.moving is None:
            return tangent
        return np.asarray(np.copysign(1.0, self.moving.slope(problem, z, tangent, sigma - self.length)[1]) * tangent)

    @classmethod
    def line(cls, z0: Array, t0: Array) -> LocalCurve:
        """The tangent line."""
        return cls(np.array([z0, t0]), np.inf)

    @classmethod
    def through(cls, z0: Array, t0: Array, z1: Array, t1: Array, row: Array) -> LocalCurve:
        """Cubic Hermite curve with z(0) = z0 and z(length) = z1; t0 and t1 are tangents of any length with row . t > 0.

        sigma = row . (z - z0) is the coordinate in which the corrector takes its step: the curve is a smooth graph.
        """
        sigma = float(row @ (z1 - z0))
        slope0, slope1 = t0 / float(row @ t0), t1 / float(row @ t1)
        chord = (z1 - z0) / sigma
        quadratic = (3.0 * chord - 2.0 * slope0 - slope1) / sigma
        return cls(np.array([z0, slope0, quadratic, (slope0 + slope1 - 2.0 * chord) / sigma**2]), sigma)

    def at(self, sigma: float | Array) -> Array:
        """Point of the curve, or points, shape (sigma, unknowns)."""
        return np.asarray(_powers(sigma, self.coefficients.shape[0]) @ self.coefficients)

    def at_each(self, sigmas: Array) -> tuple[Array, Array]:
        """Points and slopes at places, shape (sigmas, unknowns): one product a place, whose last bit is its own."""
        powers = _powers(sigmas, self.coefficients.shape[0])[:, None]
        return (powers @ self.coefficients)[:, 0], (powers[..., :-1] @ self._derivative)[:, 0]

    def samples(self, end: float, count: int) -> tuple[Array, Array]:
        """Points and slopes at equal distances from the start to a place, shape (count, unknowns) each."""
        powers = _powers_of_unit(count, self.coefficients.shape[0]) * end ** np.arange(self.coefficients.shape[0])
        return powers @ self.coefficients, powers[:, :-1] @ self._derivative

    @cached_property
    def _derivative(self) -> Array:
        return np.arange(1, self.coefficients.shape[0])[:, None] * self.coefficients[1:]

    def slope(self, sigma: float | Array) -> Array:
        """Derivative dz/dsigma, of one shape with `at`."""
        return np.asarray(_powers(sigma, self._derivative.shape[0]) @ self._derivative)

    def crossings(self, index: int, values: Iterable[float]) -> list[tuple[float, float]]:
        """All (sigma, value) on the curve at which component `index` equals one of `values`, ascending."""
        found = list[tuple[float, float]]()
        scaled = self.coefficients[:, index] * self.length ** np.arange(self.coefficients.shape[0])
        heights = _to_bernstein(scaled.size) @ scaled  # the course lies between the least and the largest of these
        margin = REACH_MARGIN * (np.arange(scaled.size) @ np.abs(scaled))
        for value in values:
            if margin > 0.0 and np.min(heights) - margin <= value <= np.max(heights) + margin:
                roots = _roots_within(np.append(scaled[0] - value, scaled[1:]))
                found += [(self.length * place, value) for place in roots]
        return sorted(found)


@lru_cache(maxsize=8)
def _to_bernstein(count: int) -> Array:
    """Matrix from the coefficients of a polynomial to those of Bernstein's polynomials on (0, 1), (count, count)."""
    order = range(count)
    return np.array([[math.comb(j, i) / math.comb(count - 1, i) for i in order] for j in order])


def _roots_within(coefficients: Array) -> list[float]:
    """The real roots of a polynomial in (0, 1], each with two Newton steps."""
    coefficients = np.trim_zeros(coefficients)  # a root at 0 itself is none
    roots, slope = polyroots(coefficients), polyder(coefficients)
    real = roots[np.isreal(roots)].real
    for _ in range(2):
        real = real - polyval(real, coefficients) / polyval(real, slope)
    return [min(float(root), 1.0) for root in real if 0.0 < root <= 1.0 + REACH_MARGIN]


def predictor(points: Array, row: Array, weights: Array | None = None) -> Callable[[float], Array]:
    """The curve through points with their tangents, (points, 2, unknowns), latest first, over sigma.

    Hermite interpolation of degree 2 n - 1 through n points; sigma = row . (z(sigma) - z) with the latest of them, z.
    Only points in order along `row` are used, so that the curve of a sharp turn is not wilder than the turn. Of three
    and more it is the latest alone where, by these weights, the others predicted it worse than a tangent did: where
    steps are short the polynomial amplifies what the corrector leaves over, and they would stay as short.
    """
    moves, tangents = points[:, 0] - points[0, 0], points[:, 1]
    places, slopes = (moves @ row).tolist(), (tangents @ row).tolist()

    def used(n: int) -> int:
        while n < len(points) and places[n] < places[n - 1] and slopes[n] > ALIGNED_COSINE:
            n += 1
        return n

    n = used(1)
    if weights is not None and len(points) > 2 and slopes[1] > 0.0:
        misses = [_move(0.0, places[1:m], moves[1:m], slopes[1:m], tangents[1:m]) for m in (used(2), 2)]
        by_curve, by_tangent = (float(weights @ miss**2) for miss in misses)
        n = n if by_curve <= SAME_MISS * by_tangent else 1
    known = places[:n], moves[:n], slopes[:n], tangents[:n]
    return lambda place: np.asarray(points[0, 0] + _move(place, *known))


def _move(place: float, places: Sequence[float], moves: Array, slopes: Sequence[float], tangents: Array) -> Array:
    """The polynomial of least degree through what values differ by from one and through tangents, (places, unknowns).

    `slopes` are by how much places change along the tangents. Weights beyond the places multiply rounding, of values
    themselves above all.
    """
    by_moves, by_slopes = zip(*hermite(places, place), strict=True)
    by_tangents = [weight / slope for weight, slope in zip(by_slopes, slopes, strict=True)]
    return np.asarray(np.array(by_moves) @ moves + np.array(by_tangents) @ tangents)


def interpolant(places: Sequence[float], values: Array, slopes: Array) -> Callable[[float], Array]:
    """The polynomial of least degree through values and slopes, each (places, unknowns)."""
    moves, ones = values - values[0], [1.0] * len(places)
    return lambda place: np.asarray(values[0] + _move(place, places, moves, ones, slopes))


def hermite(places: Sequence[float], x: Any) -> list[tuple[Any, Any]]:
    """Weights of values and of slopes at places in the polynomial of least degree through both, at x or several x.

    L_j(x)^2 (1 - 2 (x - x_j) L_j'(x_j)) and (x - x_j) L_j(x)^2 with Lagrange's polynomials L_j. Written out, as
    scipy.interpolate takes a third of a family's time to load.
    """
    found = []
    for own in places:
        lagrange, rate = 1.0, 0.0
        for other in places:
            if other != own:
                lagrange, rate = lagrange * ((x - other) / (own - other)), rate + 1.0 / (own - other)
        found.append((lagrange**2 * (1.0 - 2.0 * (x - own) * rate), lagrange**2 * (x - own)))
    return found


@lru_cache(maxsize=8)
def _powers_of_unit(samples: int, count: int) -> Array:
    """Powers of samples of a stretch of length 1 at equal distances, shape (samples, count)."""
    powers = _powers(np.linspace(0.0, 1.0, samples), count)
    powers.flags.writeable = False  # kept and shared
    return powers


def _powers(tau: float | Array, count: int) -> Array:
    return np.asarray(np.power.outer(tau, np.arange(count)))


# Corrected points of a branch: near a guess, at a value of the parameter or Omega, between two other points -----------

ROUND_OFF = 1e-7  # an estimate below this that a finer level does not halve
COARSENING_ERROR_RATIO = 0.25  # of the tolerance: the error expected of a coarser level, which is left again beyond 1
NEXT_ERROR_RATIO = 0.5  # of the tolerance: the error expected of the next point
MOST_ERROR_GROWTH = 10.0  # of errors from one point to the next
ROUNDED_ERROR_FACTOR = 4.0  # times the part by rounding: an error beyond which finer meshes lessen it
START_ERROR = 1e-4  # of the linear mode where a walk starts
MOST_FAILED_HALVINGS = 4  # resolutions that may fail, all together, to halve an estimate below MEANINGFUL_ERROR
MEANINGFUL_ERROR = 1e-3
ASYMPTOTIC_ERROR = 1e-2  # relative error below which the gain of finer levels is foreseen
TURNED_TANGENT = 1e-2  # that a tangent may differ from the one computed again, a Newton step and a finer level later
BESIDE_TARGET_REACH = 1e-3  # reach of a correction to a target that the point meets but for round-off


KEPT_STRETCHES = 6  # whose starts are kept in the unknowns of their ends
STACKED_UNKNOWNS = 1000  # unknowns up to which arrays over several states stay in the cache of a core


def newton_steps(problem: Problem, z: Array, defects: Array, rows: Array) -> Steps:
    """Newton steps from states (states, unknowns), each closed by its row, in arrays where that is faster.

    `defects` are those of the values of row . z. Raises SingularError, and what the equations raise at a state.
    """
    solver = BorderedSolver.of(problem)
    if len(z) > 1 and problem.size <= STACKED_UNKNOWNS and solver.takes_several:
        residuals, nonzeros = problem.evaluate_all(z)
        steps = solver.steps(z, np.column_stack([residuals, defects]), nonzeros, rows)
        if steps is not None:
            return steps
    found, right = [], np.zeros((problem.size, 3))
    right[-1, 1], right[:-1, 2] = 1.0, problem.probe
    for one, defect, row in zip(z, defects, rows, strict=True):
        residual, nonzeros = problem.evaluate(one)
        solve = solver.factor(one, nonzeros, row)
        right[:, 0] = np.append(residual, defect)
        found.append((*np.ascontiguousarray(solve(right).T), solve.orientation))
    newton, along, response, orientation = (np.array(each) for each in zip(*found, strict=True))
    return Steps(newton, along, response, orientation)


@dataclass(frozen=True, eq=False)
class Joined:
    """The start of a stretch in the unknowns of its end: z, tangent and the row, the metric times this, of sigma.

    Where the mesh is `moving` it is that from the end back, and both tangents are the derivatives on it.
    """

    z: Array
    tangent: Array
    row: Array
    end: Point
    moving: Moving | None = None

    @property
    def problem(self) -> Problem:
        """The equations that z solves but for the change of meshes."""
        past = None if self.moving is None else self.moving.past
        problem: Problem = self.end.problem if past is None else past.problem
        return problem

    @property
    def end_tangent(self) -> Array:
        """The tangent at the end."""
        return self.end.tangent if self.moving is None else self.moving.start.tangent

    @cached_property
    def curve(self) -> LocalCurve:
        """The local cubic between both."""
        curve = LocalCurve.through(self.z, self.tangent, self.end.z, self.end_tangent, self.row)
        return curve if self.moving is None else replace(curve, moving=self.moving)


class PointSolver:
    """Makes points of one branch on a levels of resolutions, to the tolerance of the settings."""

    def __init__(self, levels: Levels, settings: ContinuationSettings) -> None:
        self.levels, self.settings = levels, settings
        self.failure = ""  # why the last correction came to nothing, in words
        self._joined = deque[tuple[Point, Point, Joined]](maxlen=KEPT_STRETCHES)

    # Geometry -------------------------------------------------------------------------------------------------------

    def metric(self, problem: Problem, z: Array) -> Array:
        return problem.metric(z, abs(self.settings.parameter_max))

    def metrics(self, problem: Problem, z: Array) -> Array:
        """The metric at several states, shape (states, unknowns)."""
        return problem.metrics(z, abs(self.settings.parameter_max))

    def distance(self, problem: Problem, z: Array, other: Array) -> float:
        """Distance of two states in the metric at the first one."""
        return math.sqrt(self.metric(problem, z) @ (other - z) ** 2)

    def factor(self, problem: Problem, z: Array, row: Array) -> Solve:
        """Solver of the Jacobian at z closed by `row`; raises SingularError."""
        return self.levels.solver(problem).factor(z, problem.evaluate(z)[1], row)

    def factors(self, problem: Problem, correction: Correction, row: Array) -> Solve:
        """The corrector's factors of a Jacobian next to the corrected point, where these serve; those there else."""
        return correction.solve or self.factor(problem, correction.z, row)

    def tangent(self, problem: Problem, z: Array, solve: Solve, there: bool = False) -> Array:
        """Unit tangent at z with row . t > 0, by the solver closed by that row; its factors may be from near z.

        They are of z itself where this is `there`.
        """
        weights = self.metric(problem, z)
        t, settled = problem.null_vector(z, solve, weights)
        if not (settled or there):  # what its own factors leave is rounding
            return self.tangent(problem, z, self.factor(problem, z, weights * t), there=True)
        return np.asarray(t / math.sqrt(weights @ t**2))

    def start(self, positions: Array, Omega: float) -> Point:
        """The linear mode at zero amplitude with the tangent of its family; not walked.

        On the coarsest level whose own linear mode is this one, but for an error that the guard does not see.
        """
        direction = float(np.sign(self.settings.parameter_max))
        for resolution in self.levels.resolutions:
            problem = cast(OrbitProblem, self.levels.problem(resolution))
            z = problem.pack(positions, Omega, 0.0)
            solve = self.factor(problem, z, direction * problem.parameter_row())
            own = step_error(problem, z, solve(np.append(problem.evaluate(z)[0], 0.0)))
            enough = min(self.settings.tolerance, START_ERROR)
            if problem.holds_linear_modes or own.relative(problem.frequency(z)) <= enough:
                break
        tangent = self.tangent(problem, z, solve)
        return Point(problem, z, tangent, ErrorEstimate(0.0, 0.0), self.settings.first_step, 0)

    def fault(self, point: Point) -> str:
        """Why a point from elsewhere is none of the branch, in words; empty where it is.

        The residual and the tangent are computed anew: a Newton step may move the point by its own error, or by the
        tolerance, and no more.
        """
        problem, z, error = point.problem, point.z, point.error
        sizes = (point.step, point.along, error.Omega, error.profile, error.parameter)
        if not all(np.all(np.isfinite(values)) for values in (z, point.tangent, problem.constants, sizes)):
            return "a value that is not finite"
        if not (problem.frequency(z) > 0 and point.step > 0):
            return "a frequency or a step that is not positive"
        row = self.metric(problem, z) * point.tangent
        try:
            with np.errstate(all="ignore"):  # what is not finite is said to be no point below
                solve = self.factor(problem, z, row)
                left_over, tangent = solve(np.append(problem.evaluate(z)[0], 0.0)), self.tangent(problem, z, solve)
                moved = step_error(problem, z, left_over).relative(problem.frequency(z))
        except (SingularError, RuntimeError):
            return "a point at which the equations are singular"
        if not moved <= 2.0 * max(self.settings.tolerance, error.relative(problem.frequency(z))):
            return f"a point that does not solve the equations (a Newton step moves it by {moved:.1e})"
        turned = float(np.sqrt(np.sum(self.metric(problem, z) * (tangent - point.tangent) ** 2)))
        return "" if turned <= TURNED_TANGENT else f"a tangent that is none (off by {turned:.1e})"

    # Correcting -----------------------------------------------------------------------------------------------------

    def correct(
        self, problem: Problem, guess: Array, row: Array, value: float, reach: float, near: bool = False
    ) -> Correction | None:
        """Corrected point within the guard's fraction of `reach` of the guess, or None; sought `near` that alone."""
        corrector = self.levels.corrector(problem)
        correction = (corrector.near if near else corrector.correct)(guess, row, value)
        if not correction.converged or problem.frequency(correction.z) <= 0:
            self.failure = f"{correction.status.value}: {correction.message}".rstrip(": ")
            return None
        distance = self.distance(problem, guess, correction.z)
        allowed = self.settings.guard_distance * reach
        if distance <= allowed:
            return correction
        if reach <= 0.0:
            self.failure = f"the next point lies behind the one before it ({problem.describe_parameters(guess)})"
            return None
        apart = f"the corrected point is {distance:.1e} from the predicted one, more than {allowed:.1e}"
        self.failure = f"{apart} ({problem.describe_parameters(guess)})"
        return None

    def refined(
        self, problem: Problem, correction: Correction, row: Array, held: Scalar | None = None,
        tangent: Array | None = None, measured: Measured | None = None, confirm: bool = True,
    ) -> Point | None:  # fmt: skip
        """The point on the coarsest level from `problem` up that meets the tolerance; None at the top of the levels.

        Where most of the error is what the corrector left over, a Newton step and the corrector once more take it away;
        what stays after that, or what a finer level does not lessen, is round-off, and the point is kept with its
        estimate. Raises SingularError.

        Arguments:
            problem, correction: the corrected point.
            row: that closed the equations there.
            held: what `row` holds; None where it is a row of its own.
            tangent: the unit tangent there where it is known, which saves a factorisation.
            measured: likewise its error.
            confirm: whether the corrector confirms the point (see `confirmed`).
        """
        known = None if tangent is None else self._measured(problem, correction, tangent, held, measured)
        climbed = self._climbed(problem, correction, row, held, known)
        if climbed is None or not (confirm and self.levels.corrector(climbed.problem).confirms):
            return climbed
        (point,) = self.confirmed([(climbed, held)])
        if isinstance(point, SingularError):
            raise point
        return point

    def confirmed(self, points: Sequence[tuple[Point, Scalar | None]]) -> list[Point | SingularError | None]:
        """Points as the corrector confirms them, each with its held value; an error where it refuses one."""
        found: list[Point | SingularError | None] = []
        for problem, these in groupby(points, key=lambda item: item[0].problem):
            some = list(these)
            rows = self._rows(problem, some)
            held_states = [(point.z, row, float(row @ point.z)) for (point, _), row in zip(some, rows, strict=True)]
            corrections = self.levels.corrector(problem).confirm_all(held_states)
            for (point, held), row, correction in zip(some, rows, corrections, strict=True):
                found.append(self._last_word(point, held, row, correction))
        return found

    def _rows(self, problem: Problem, points: Sequence[tuple[Point, Scalar | None]]) -> Array:
        """The rows of the held values, or of the places along the tangents."""
        rows = self.metrics(problem, np.stack([point.z for point, _ in points]))
        rows *= np.stack([point.tangent for point, _ in points])
        for row, (_, held) in zip(rows, points, strict=True):
            if held is not None:
                row[:] = problem.row_of(held)
        return rows

    def _last_word(
        self, point: Point, held: Scalar | None, row: Array, correction: Correction
    ) -> Point | SingularError | None:
        """A point with the corrector's last word on it: measured anew where that moves it."""
        if correction.converged and correction.z is point.z:
            return point
        if not correction.converged:
            return SingularError(f"{correction.status.value} {correction.message}".strip())
        try:
            return self._climbed(point.problem, correction, row, held, None)
        except SingularError as error:
            return error

    def _climbed(
        self,
        problem: Problem,
        correction: Correction,
        row: Array,
        held: Scalar | None,
        known: tuple[Point, float] | None,
    ) -> Point | None:
        """As `refined`, before the last word."""
        z, iterations, polished, placed = correction.z, correction.iterations, False, False
        coarser: tuple[float, Point] | None = None  # the same point one level below, with its error
        climbed: list[tuple[int, float]] = []
        while True:
            if known is not None and self._is_finished(*known):
                return known[0]
            tangent, solve = problem.own_tangent, correction.solve
            if tangent is None:
                solve = solve or self.factor(problem, z, row)
                tangent = self.tangent(problem, z, solve) if known is None else known[0].tangent
            if known is None:
                known = self._measured(problem, replace(correction, z=z, iterations=iterations), tangent, held)
            point, relative = known
            if self._is_finished(point, relative):
                return point
            left_over = (solve or self.factor(problem, z, row))(np.append(problem.evaluate(z)[0], 0.0))
            at_held = at_parameter(problem, z, left_over, tangent if held is None else None)
            algebraic = step_error(problem, z, at_held, held is Scalar.OMEGA).relative(point.Omega)
            if polished and algebraic > 0.25 * relative:
                return replace(point, at_round_off=True)
            if coarser is not None and 0.5 * coarser[0] < relative < ROUND_OFF:
                return replace(coarser[1], at_round_off=True)  # its finer level has more round-off, not less error
            if algebraic > 0.25 * relative:
                polished, target, guess = True, problem, z - left_over
            elif not placed and problem.expected_error(z, relative, problem) <= self.settings.tolerance:
                polished, placed, target = False, True, problem.placed(z, problem)
                guess = problem.prolong(z, target)
            else:
                climbed.append((problem.resolution, relative))
                _check_gain(climbed, point)
                excess = relative / self.settings.tolerance if relative < ASYMPTOTIC_ERROR else 1.0
                finer = self.levels.finer(problem, z, excess)
                if finer is None or self.levels.finer(finer) is None:
                    return None
                polished, placed, target, coarser = False, False, finer, (relative, point)
                guess = problem.prolong(z, target)
            row = self._closing(problem, target, guess, row, point.tangent, held)
            correction = self.levels.corrector(target).correct(guess, row, float(row @ guess))
            if not correction.converged:
                raise SingularError(f"{correction.status.value} {correction.message}".strip())
            problem, z, iterations, known = target, correction.z, iterations + correction.iterations, None

    def _is_finished(self, point: Point, relative: float) -> bool:
        """Whether nothing is to be done about an error."""
        return point.at_round_off or relative <= self.settings.tolerance

    def _measured(
        self,
        problem: Problem,
        correction: Correction,
        tangent: Array,
        held: Scalar | None,
        measured: Measured | None = None,
    ) -> tuple[Point, float]:
        """The point of a correction with its estimated error; and that relative, the larger of both."""
        z, allowed = correction.z, self.settings.tolerance
        error, better = measured or self.levels.near(problem, z, allowed, correction.solve, tangent, held)
        relative = error.relative(problem.frequency(z))
        at_round_off = self.settings.tolerance < relative <= error.round_off
        step, iterations = self.settings.first_step, correction.iterations
        point = Point(problem, z, tangent, error, step, iterations, better=better, at_round_off=at_round_off)
        return point, relative

    def _closing(
        self, problem: Problem, target: Problem, guess: Array, row: Array, tangent: Array, held: Scalar | None
    ) -> Array:
        """The row that closes the equations of `target` as `row` closed those of `problem`."""
        if target is problem:
            return row
        if held is not None:
            return np.asarray(target.row_of(held) * row[problem.index_of(held)])
        return np.asarray(self.metric(target, guess) * problem.prolong(tangent, target))

    def lighter(self, point: Point, before: Point | None = None) -> Problem:
        """The problem of the next step from a point: on a coarser level where that is expected to suffice.

        Where errors grow since the point `before`, so that the next would not do, on a mesh for this point.
        """
        problem, tolerance, error = point.problem, self.settings.tolerance, point.error.relative(point.Omega)
        if (
            before is not None
            and problem.measured_by_defect
            and ROUNDED_ERROR_FACTOR * point.error.round_off < error < ASYMPTOTIC_ERROR
        ):
            known = before.problem.expected_error(before.z, before.error.relative(before.Omega), problem)
            error *= min(max(error / known, 1.0), MOST_ERROR_GROWTH) if known > 0.0 else 1.0
            better = self.levels.ahead(problem, point.z, error, NEXT_ERROR_RATIO * tolerance)
            if better is not problem:
                return better
        return self.levels.lighter(problem, point.z, error, COARSENING_ERROR_RATIO * tolerance)

    # At a value of the parameter or of Omega, between two points -----------------------------------------------------

    def between(
        self, current: Point, following: Point, targets: Iterable[Target], passed: float = 0.0
    ) -> Iterator[tuple[Target, Point | None]]:
        """Points at any of `targets` between two points of the branch, in arclength order, beyond the place `passed`.

        Those that one of the two meets are not between them. Yields (target, point), and (target, None) where the
        corrector does not find the point that the branch passes.
        """
        curve, length = self.curve(current, following)
        problem = following.problem
        inside = (target for target in targets if not (target.meets(current) or target.meets(following)))
        unknowns = [(target, *target.unknown(problem)) for target in inside]
        places = [(sigma, target) for target, index, v in unknowns for sigma, _ in curve.crossings(index, [v])]
        for sigma, target in sorted(places, key=lambda place: place[0]):
            if sigma > passed:
                point = self._exactly(problem, curve, sigma, target, length)
                yield target, None if point is None else replace(point, along=sigma)

    def beside(self, point: Point, target: Target) -> Point | None:
        """The point at a target that `point` meets but for round-off; None where none is found."""
        return self._exactly(point.problem, LocalCurve.line(point.z, point.tangent), 0.0, target, BESIDE_TARGET_REACH)

    def joined(self, current: Point, following: Point) -> Joined:
        """One point as it is joined to the next, computed once for each of the last few stretches."""
        for first, last, found in self._joined:
            if first.is_at(current) and last.is_at(following):
                return found
        joined = self._moving(current, following) or self._held(current, following)
        self._joined.append((current, following, joined))
        return joined

    def _held(self, current: Point, following: Point) -> Joined:
        """The same on the mesh of the second."""
        problem = following.problem
        z, t = current.problem.all_prolonged(np.array([current.z, current.tangent]), problem)
        return Joined(z, t, self.metric(problem, z) * t, following)

    def _moving(self, current: Point, following: Point) -> Joined | None:
        """The same on a mesh that moves with layers; None where there are none."""
        (problem, z), ends = (following.problem, following.z), (current, following)
        if not (any(one.moves for one in ends) and all(np.any(one.tangent) for one in ends)):
            return None
        weights = self.metric(problem, z)
        unit = following.tangent / np.sqrt(float(weights @ following.tangent**2))
        moving = Moving.of(problem, z, unit, weights, current)
        past = None if moving is None else moving.past
        if moving is None or past is None or not past.sigma < 0.0:
            return None
        return Joined(past.z, past.tangent, moving.row, following, moving)

    def curve(self, current: Point, following: Point) -> tuple[LocalCurve, float]:
        """The local cubic from one point to the next, in the unknowns of the second, and its length in sigma."""
        curve = self.joined(current, following).curve
        return curve, curve.length

    def length(self, current: Point, following: Point) -> float:
        """The length of the branch between two points, about."""
        curve, length = self.curve(current, following)
        return length * curve.scale

    def guess_along(self, current: Point, following: Point, fraction: float) -> Point:
        """The point at a fraction of the way between two points of the branch, not corrected."""
        curve, length = self.curve(current, following)
        problem = curve.on(following.problem, fraction * length)
        return replace(following, problem=problem, z=curve.at(fraction * length), better=None, special="")

    def along(self, current: Point, following: Point, fraction: float) -> Point | None:
        """A corrected point at a fraction of the way between two points of the branch, or None."""
        curve, length = self.curve(current, following)
        problem = curve.on(following.problem, fraction * length)
        correction, row = self.on_curve(problem, curve, fraction)
        if correction is None:
            return None
        try:
            tangent = None
            if curve.moving is not None:
                tangent = self.tangent(problem, correction.z, self.factors(problem, correction, row))
                tangent = curve.along(problem, correction.z, tangent, fraction * length)
            point = self.refined(problem, correction, row, tangent=tangent)
        except SingularError as error:
            self.failure = str(error)
            return None
        return None if point is None else replace(point, walked=False)

    def unrefined_along(self, current: Point, following: Point, fraction: float) -> Point | None:
        """As `along`, on the level of the second point whatever its error, which is not estimated."""
        curve, length = self.curve(current, following)
        problem = curve.on(following.problem, fraction * length)
        correction, row = self.on_curve(problem, curve, fraction)
        if correction is None:
            return None
        try:
            tangent = self.tangent(problem, correction.z, self.factors(problem, correction, row))
        except SingularError as error:
            self.failure = str(error)
            return None
        tangent = curve.along(problem, correction.z, tangent, fraction * length)
        return replace(
            following, problem=problem, z=correction.z, tangent=tangent, better=None, special="", walked=False
        )  # fmt: skip

    def coarse_along(self, current: Point, following: Point, fraction: float) -> Point | None:
        """As `unrefined_along`, with its error: crossing branches amplify rounding."""
        point = self.unrefined_along(current, following, fraction)
        if point is None:
            return None
        try:
            correction = Correction(point.z, Status.CONVERGED, 0)
            point = self._measured(point.problem, correction, point.tangent, None)[0]
        except SingularError:
            return None
        return replace(point, walked=False, at_round_off=True)

    def on_curve(self, problem: Problem, curve: LocalCurve, fraction: float) -> tuple[Correction | None, Array]:
        """The correction of the point at a fraction of a curve, or None, and the row that closes the equations."""
        sigma = fraction * curve.length
        guess = curve.at(sigma)
        row = self.metric(problem, guess) * curve.slope(sigma) if curve.moving is None else curve.moving.row
        return self.correct(problem, guess, row, float(row @ guess), curve.length * curve.scale), row

    def _exactly(
        self, problem: Problem, curve: LocalCurve, sigma: float, target: Target, length: float
    ) -> Point | None:
        """The point at a target near curve(sigma); None where none is found there."""
        guess, problem, length = curve.at(sigma), curve.on(problem, sigma), length * curve.scale
        index, value = target.unknown(problem)
        direction = float(np.sign(curve.slope(sigma)[index]))
        row = problem.row_of(target.held) * direction
        correction = self.correct(problem, guess, row, value * direction, length)
        if correction is None:
            return None
        correction.z[index] = value  # equal but for round-off of the held row
        try:
            point = self.refined(problem, correction, row, target.held)
        except SingularError:
            return None
        return None if point is None else replace(point, walked=False)


def _check_gain(climbed: list[tuple[int, float]], point: Point) -> None:
    """Raises SingularError where finer resolutions do not lessen the error: rounding is amplified there."""
    if len(climbed) <= MOST_FAILED_HALVINGS:
        return
    (coarse, before), (fine, now) = climbed[-1 - MOST_FAILED_HALVINGS], climbed[-1]
    if 0.5 * before < now < MEANINGFUL_ERROR:
        raise SingularError(
            f"resolutions {coarse} to {fine} leave an error of {now:.1e} at parameter {point.parameter:.6g}, Omega = "
            f"{point.Omega:.10g}: rounding is amplified there; try a tolerance above {now:.0e}"
        )


# Components of an orbit that are far smaller than the largest, recomputed to relative accuracy ------------------------

SMALL_COMPONENT_RATIO = 1e-7  # of the largest state: below it the corrector leaves errors relative to the largest
SMALLEST_COMPONENT_RATIO = 1e-250  # of the largest state: below it doubles run out


def with_small_components(point_solver: PointSolver, point: Point) -> tuple[Array, float]:
    """Unknowns whose small components are right relative to themselves, and down to which size, of the largest.

    Small components are left out of the guess of a Newton step, which then does not correct them but solves for them.
    """
    problem = point.problem
    if not problem.cosines:
        return point.z, SMALL_COMPONENT_RATIO
    states = np.abs(point.z[: problem.states])
    small = np.flatnonzero(states < SMALL_COMPONENT_RATIO * np.max(states))
    if small.size == 0:
        return point.z, SMALLEST_COMPONENT_RATIO
    guess = point.z.copy()
    guess[small] = 0.0
    row = point_solver.metric(problem, point.z) * point.tangent
    try:
        steps = newton_steps(problem, guess[None], np.array([row @ (guess - point.z)]), row[None])
    except SingularError:
        return point.z, SMALL_COMPONENT_RATIO
    z = point.z.copy()
    z[small] = -steps.newton[0, small]
    return z, SMALLEST_COMPONENT_RATIO
