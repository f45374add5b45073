"""Samples of a branch of equilibria: eigenvalues and their rates, and the curvature of the branch.

Of a small system they are all of them. Of a large one, whose matrices are sparse, they are those on the right of the
imaginary axis or beside it (see `half_plane`), unless there are too many: then all are computed.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.follow.samples import Sample
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.zero.balanced import DERIVATIVE_ROUNDING, BalancedMatrix, ComplexArray, dense
from casadi_skin.zero.half_plane import HalfPlane, HalfPlaneError
from casadi_skin.zero.problem import EPSILON, Array, SingularError, Solve
from casadi_skin.zero.rest import AlgebraicProblem
from casadi_skin.zero.settings import Point


@dataclass(frozen=True, eq=False)
class Leading:
    """Eigenvalues at a point by descending real part, each of shape (eigenvalues,).

    Attributes:
        values: the eigenvalues.
        rates: their rates along the unit tangent.
        noise: their rounding errors.
        conditions: their condition numbers.
        margin: real parts of others are below minus this; infinite where there are no others.
        units: in which the matrix is balanced.
        change: the rates of the non-zeros of the Jacobian.
        part: of a large system, the part of the plane that they are in.
    """

    values: ComplexArray
    rates: ComplexArray
    noise: Array
    conditions: Array
    margin: float
    units: Array
    change: Array
    part: HalfPlane | None

    @classmethod
    def at(cls, point: Point, whole: bool = False) -> Leading:
        """At a point, by differences of the Jacobian along the branch; all eigenvalues where `whole`."""
        problem, z, t, rounding = point.problem, point.z, point.tangent, _rounding(point.problem)
        h = rounding ** (1.0 / 3.0) / max(1e-300, float(np.max(np.abs(t))))
        change = (problem.entries(z + h * t) - problem.entries(z - h * t)) / (2.0 * h)
        A, rate = problem.states_part(problem.entries(z)), problem.states_part(change)
        found = None if whole else half_plane(problem, A)
        if found is None:
            linear = BalancedMatrix(dense(A), rounding)
            values, rates, noise = linear.eigensystem[0], linear.rates(dense(rate)), linear.errors()
            conditions, margin, units = linear.conditions, np.inf, linear.balanced[1]
        else:
            values, rates, noise, conditions = found.values, found.rates(rate), found.errors(rounding), found.conditions
            margin, units = found.margin, found.units
        order = np.lexsort((-values.imag, -values.real))
        parts = values[order], rates[order], noise[order], conditions[order]
        return cls(*parts, margin, units, change, found)

    @property
    def numbers(self) -> tuple[int, int]:
        """Bounds of the number with a positive real part: those on the axis but for errors are on either side."""
        real = self.values.real
        return int(np.count_nonzero(real > self.noise)), int(np.count_nonzero(real > -self.noise))

    def moved(self, problem: AlgebraicProblem, off: Array, many: int) -> Array:
        """How far changes of the Jacobian move the first eigenvalues to first order, shape (changes, many + 1).

        The last column has by how much they move others towards the axis, of what is between.

        Arguments:
            problem: the equations.
            off: changes of the non-zeros, shape (changes, non-zeros).
            many: the number of eigenvalues.
        """
        chosen, rows, columns = problem.states_places
        scaled = off[:, chosen] * self.units[columns] / self.units[rows]
        sizes, part = np.linalg.norm(scaled, axis=1), self.part
        if part is None:
            moves, others = np.outer(sizes, self.conditions), np.zeros(sizes.size)
        else:
            moves, k = np.abs(scaled @ (part.left[:, rows] * part.right[columns].T).T), int(np.argmax(sizes))
            far = part.moves(problem.states_part(off[k])) * np.max(self.conditions, initial=1.0) / part.room
            others = sizes / max(sizes[k], 1e-300) * far
        others = np.maximum(others, np.max(moves[:, many:], axis=1, initial=0.0) / self.margin)
        return np.column_stack([moves[:, :many], others])

    def needed(self, margin: float) -> int:
        """How many have a real part above minus a margin, pairs not divided."""
        many = int(np.count_nonzero(self.values.real > -margin))
        inside = many < self.values.size and many and self.values[many] == self.values[many - 1].conj()
        return many + 1 if inside and self.values[many].imag else many


def half_plane(problem: AlgebraicProblem, A: object) -> HalfPlane | None:
    """The eigenvalues of a sparse matrix that matter; None of a dense one, and where there are too many."""
    if not problem.statics.is_sparse:
        return None
    try:
        return HalfPlane.of(A)
    except HalfPlaneError:
        return None


def _rounding(problem: AlgebraicProblem) -> float:
    return max(EPSILON, problem.statics.model.rounding)


def sample_of(point: Point, weights: Array, leading: Leading) -> Sample:
    """The sample at a point with its eigenvalues."""
    problem, row = point.problem, weights * point.tangent
    (_, largest, solve), orientation, bend = _closed(point, row), 0.0, np.zeros(problem.size)
    if solve is not None:
        orientation = solve.orientation
        bend = solve(np.append(-problem.times(leading.change, point.tangent) / largest, 0.0))
    bend = np.where(np.isfinite(bend), bend, 0.0)
    return Sample(point, row, leading.values, leading.rates, leading.noise, bend, orientation)


def is_blurred(point: Point, weights: Array, leading: Leading) -> bool:
    """Whether rounding decides the sign of the rate of the parameter, as at a branch point itself."""
    problem, t = point.problem, point.tangent
    raw, largest, solve = _closed(point, weights * t)
    if solve is None:
        return True
    terms = problem.times(np.abs(raw), np.abs(t))
    terms += problem.times(np.abs(leading.change), problem.units_of_all(point.z))
    shaken = DERIVATIVE_ROUNDING * _rounding(problem) * terms / largest * problem.probe
    return not abs(float(solve(np.append(shaken, 0.0))[-1])) < abs(float(t[-1]))


def _closed(point: Point, row: Array) -> tuple[Array, Array, Solve | None]:
    """Derivatives as they are written, the largest of each equation, and the solution of all over these with a row.

    A branch point is singular, and has none.
    """
    problem, raw = point.problem, point.problem.entries(point.z)
    largest = problem.equation_sizes(point.z, raw)
    with suppress(SingularError):
        return raw, largest, BorderedSolver.of(problem).unchecked(raw / largest[problem.pattern[0]], row)
    return raw, largest, None


def rightmost(sample: Sample, count: int) -> Sample:
    """The sample with so many of its eigenvalues."""
    if count >= sample.values.size:
        return sample
    return replace(sample, values=sample.values[:count], rates=sample.rates[:count], noise=sample.noise[:count])
