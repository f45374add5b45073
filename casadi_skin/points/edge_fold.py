"""Edges of tongues around a fold in the parameter: there both edges of a tongue, or of a window, meet and vanish.

Multipliers are functions of S and of the parameter. Where two mu meet, their discriminant vanishes, where one has a
value, as -1 or 0, its distance from that: an equation whose solutions `continuation` follows by arclength.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Never

import numpy as np

from casadi_skin.follow.arclength import ArclengthContinuation
from casadi_skin.follow.branch_sampler import flow_error
from casadi_skin.follow.family import Family
from casadi_skin.follow.point import PointSolver
from casadi_skin.solve.levels import ExactLevels
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.stability.family_stability import orbit_state
from casadi_skin.stability.multipliers import reduced_matrices
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.problem import Array, Indices, Problem, Scalar, SingularError
from casadi_skin.zero.settings import ContinuationSettings, End, ErrorEstimate, Point

DIFFERENCE = 1e-3  # of the sizes: that of derivatives
NEWTON = 1e-7  # of the sizes: a step of Newton's method after which an edge is one
FAR = 4.0  # distances to the fold as foreseen, beyond which there is none
SETTINGS = ContinuationSettings(
    parameter_max=FAR, tolerance=1e-6, first_step=0.1, max_step=0.5, max_parameter_step=0.2, min_step=1e-3,
    max_points=80, tiny_first=False, guard_distance=0.3, guard_angle=40.0, aim_angle=20.0,
)  # fmt: skip

Multipliers = Callable[[float, float], ComplexArray]


class NoFoldError(ArithmeticError):
    """The edge is not followed around a fold; the message gives the reason."""


@dataclass(frozen=True)
class Start:
    """An edge before a fold: its kind, S, mu, the parameter, and the distances to the fold in S and the parameter."""

    kind: str
    S: float
    mu: float
    value: float
    S_away: float
    away: float


@dataclass(frozen=True)
class Turn:
    """A fold of a curve of edges, and edges beyond it in order.

    Attributes:
        S, S_error, mu, value, error: S, mu and the parameter at the fold.
        beyond: S, mu and the parameter of each edge.
    """

    S: float
    S_error: float
    mu: float
    value: float
    error: float
    beyond: tuple[tuple[float, float, float], ...]


def turn(multipliers: Multipliers, rougher: Multipliers, start: Start) -> Turn:
    """Follow an edge around a fold ahead of it.

    Arguments:
        multipliers: gives all mu at an S and a value of the parameter; raises ArithmeticError where there is no orbit.
        rougher: the same with a larger tolerance, which shows the error.
        start: the edge before the fold.

    Raises:
        NoFoldError: there is no fold, or the edge is not followed around it.
    """
    problem = EdgeProblem(multipliers, start)
    solver = PointSolver(ExactLevels(problem, lambda problem: NewtonCorrector(problem, NEWTON)), SETTINGS)
    points = _walked(solver, problem)
    turned = (k for k, pair in enumerate(itertools.pairwise(points)) if _rate(pair[0]) * _rate(pair[1]) < 0.0)
    last_before = next(turned, None)
    if last_before is None:
        raise NoFoldError("no fold of the edge is found")
    near = min(points[last_before : last_before + 2], key=lambda point: abs(_rate(point)))
    fold, coarse = (_fold(problem, near.z, factor * DIFFERENCE) for factor in (1.0, 2.0))
    S, value = problem.where(fold)
    noise = abs(EdgeProblem(rougher, start).test(fold) - problem.test(fold)) / abs(problem.slopes(fold)[1, 2])
    S_error = abs(start.S_away) * (abs(fold[0] - coarse[0]) + DIFFERENCE**2)
    error = abs(start.away) * (abs(fold[2] - coarse[2]) + noise)
    after = [(*problem.where(point.z), float(point.z[1])) for point in points[last_before + 1 :]]
    beyond = tuple((S, mu, value) for S, value, mu in after[-2:])
    return Turn(S, S_error, float(fold[1]), value, error, beyond)


def _walked(solver: PointSolver, problem: EdgeProblem) -> list[Point]:
    """Points from the start around the fold to beyond the value of the start; raises NoFoldError."""
    z = problem.begin
    row = np.array([0.0, 0.0, 1.0])
    try:
        correction = solver.levels.corrector(problem).correct(z, row, 0.0)
        if not correction.converged:
            raise NoFoldError(f"the edge is not found again: {correction.message}")
        tangent = solver.tangent(problem, correction.z, solver.factor(problem, correction.z, row))
        first = Point(problem, correction.z, tangent, ErrorEstimate(0.0, 0.0), SETTINGS.first_step, 0)
        walk = ArclengthContinuation(solver, (first,))
        points = [first, *(point for point in walk if point.walked)]
    except SingularError as error:
        raise NoFoldError(str(error)) from error
    if walk.end is not End.RETURNED:
        raise NoFoldError(f"no fold of the edge is passed: {walk.detail or walk.end}")
    return points


def _rate(point: Point) -> float:
    return float(point.tangent[-1])


def _fold(problem: EdgeProblem, near: Array, difference: float) -> Array:
    """The fold near a point of the curve: there the test function vanishes with its derivative in S."""
    from scipy.optimize import root

    def conditions(x: Array) -> list[float]:
        z = np.array([x[0], near[1], x[1]])
        low, high = (problem.test(z + np.array([side * difference, 0.0, 0.0])) for side in (-1.0, 1.0))
        return [problem.test(z) / size, (high - low) / (2.0 * difference) / size]

    size = float(np.max(np.abs(problem.slopes(near)[1])))
    found = root(conditions, near[[0, 2]], tol=1e-12)
    x = found.x
    off = np.max(np.abs(found.fun))
    if not (off <= 1e-6 and np.max(np.abs(x - near[[0, 2]])) <= 1.0):
        raise NoFoldError("the fold of the edge is not located")
    z = np.array([x[0], near[1], x[1]])
    return np.array([x[0], problem.values(z)[0], x[1]])


def multipliers_of(family: Family, point: Point, moved: bool = False) -> ComplexArray:
    """All mu of an orbit of a family but the trivial one; if `moved` by as much as the error of the flow moves them."""
    whole, everywhere = family.whole, family.on_all_positions(point)
    state = orbit_state(everywhere)
    transition = whole.flow.transition(everywhere.problem, everywhere.z)
    symplectic = whole.coordinates.symplectic
    if symplectic:
        directions = whole.accelerations([state])
    else:  # the rate along the family of positions at phase zero, see `branch_sampler`
        problem, k = everywhere.problem, everywhere.problem.parameter_index
        q, change = (problem.sample(v, np.zeros(1))[0] for v in (everywhere.z, everywhere.tangent))
        S_rate = whole.coordinates.S_rate
        directions = whole.across((2.0 / S_rate * everywhere.z[k] * change + everywhere.tangent[k] * q)[None])
    matrix, error = transition.matrix[None], flow_error(transition)[None]
    reduced, errors = reduced_matrices(matrix, error, directions, symplectic)
    return np.asarray(np.linalg.eigvals(reduced[0, 0] + moved * errors[0, 0]).astype(complex))


class EdgeProblem(Problem):
    """Unknowns z = (s, mu, u) with S = start.S + s S_away and the parameter = start.value + u away.

    The equations are that mu is where multipliers meet, or the value that one has, and that they do.
    """

    resolution = 1
    states = 2

    def __init__(self, multipliers: Multipliers, start: Start) -> None:
        self._multipliers, self._start = multipliers, start
        self._last: tuple[Array, tuple[Array, Array]] | None = None

    @property
    def begin(self) -> Array:
        """The start."""
        return np.array([0.0, self._start.mu, 0.0])

    def where(self, z: Array) -> tuple[float, float]:
        """S and the parameter."""
        return self._start.S + float(z[0]) * self._start.S_away, self._start.value + float(z[2]) * self._start.away

    def values(self, z: Array) -> Array:
        """The place where multipliers meet, and the value that vanishes there."""
        mu = self._multipliers(*self.where(z))
        if self._start.kind != "complex":
            end = self._start.mu
            return np.array([end, float(mu[np.argmin(np.abs(mu - end))].real) - end])
        one, other = mu[np.argsort(np.abs(mu - z[1]))[:2]]
        return np.array([0.5 * (one + other).real, (0.25 * (one - other) ** 2).real])

    def test(self, z: Array) -> float:
        """The value that vanishes at an edge."""
        return float(self.values(z)[1])

    def slopes(self, z: Array) -> Array:
        """Derivatives of `values`, shape (2, 3), those in mu 0, by differences to one side."""
        found, here = np.zeros((2, 3)), self.values(z)
        for column in (0, 2):
            found[:, column] = (self.values(z + DIFFERENCE * np.eye(3)[column]) - here) / DIFFERENCE
        return found

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Residuals and derivatives, the second equation relative to its largest derivative."""
        if self._last is None or not np.array_equal(self._last[0], z):
            try:
                values, slopes = self.values(z), self.slopes(z)
            except ArithmeticError as error:
                raise SingularError(str(error)) from error
            size = float(np.max(np.abs(slopes[1])))
            if not size > 0.0:
                raise SingularError("the multipliers do not depend on S and the parameter")
            matrix = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]]) + slopes * np.array([[-1.0], [1.0 / size]])
            self._last = z.copy(), (np.array([z[1] - values[0], values[1] / size]), matrix.ravel(order="F"))
        residual, nonzeros = self._last[1]
        return residual.copy(), nonzeros.copy()

    # As continuations take it -----------------------------------------------------------------------------------------

    @property
    def size(self) -> int:
        return 3

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        return np.tile(np.arange(2), 3), np.repeat(np.arange(3), 2)

    def index_of(self, scalar: Scalar) -> int:
        """Place of u among the unknowns; there is no Omega."""
        if scalar is Scalar.OMEGA:
            raise ValueError("an edge has no Omega among its unknowns")
        return 2

    def _equations(self) -> Never:
        raise NotImplementedError("edges are functions of orbits, not expressions")

    def prolong(self, z: Array, finer: Problem) -> Array:
        return z.copy()

    def parameter_size(self, z: Array) -> float:
        return 1.0

    def profile_change(self, z: Array, step: Array) -> float:
        return float(np.max(np.abs(step[:2])))

    def sample(self, z: Array, theta: Array) -> Array:
        return np.tile(z[:2], (np.size(theta), 1))

    def frequency(self, z: Array) -> float:
        return 1.0

    def frequency_step(self, z: Array, step: Array) -> float:
        return 0.0

    def metric(self, z: Array, parameter_scale: float) -> Array:
        return np.ones(3)

    def rounding(self, z: Array) -> float:
        return DIFFERENCE**3

    def whereabouts(self, z: Array) -> str:
        S, value = self.where(z)
        return f"S = {S:.8g}, parameter = {value:.8g}"
