"""Samples of a branch of equilibria: eigenvalues and their rates, and the curvature of the branch."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import cast

import numpy as np

from casadi_skin.bvp.problem import EPSILON, Array, Indices
from casadi_skin.continuation.points import Point
from casadi_skin.equilibria.linearised import ROUNDING, ComplexArray, Linearised
from casadi_skin.equilibria.problem import AlgebraicProblem

APART = 1e6  # distance of values of different groups


@dataclass(frozen=True, eq=False)
class Sample:
    """A point with its eigenvalues, their rates and the second derivative of z along the branch.

    Attributes:
        point: the point.
        row: the metric times the tangent, which closes the equations there.
        values: eigenvalues of dF/dy, shape (n,).
        rates: their rates along the unit tangent.
        noise: rounding errors of the eigenvalues.
        bend: the second derivative of z by the length along the branch.
        orientation: the sign of the determinant of the Jacobian closed by `row`.
        leading: values and rates of other quantities that matter, in place of the rate of the parameter.
        turn: period of the imaginary parts: 2 pi of logarithms of multipliers, infinite of eigenvalues.
        groups: a number for each value where only values of one group may be the same elsewhere; None where all may.
        blurred: whether rounding decides the sign of the rate of the parameter, as at a branch point itself.
    """

    point: Point
    row: Array
    values: ComplexArray
    rates: ComplexArray
    noise: Array
    bend: Array
    orientation: float
    leading: tuple[tuple[float, float], ...] | None = None
    turn: float = np.inf
    groups: Indices | None = None
    blurred: bool = False

    @property
    def symmetric(self) -> bool:
        """Whether with each eigenvalue its opposite is one, as where an energy is conserved, declared or not."""
        apart = np.min(np.abs(self.values[:, None] + self.values), axis=1)
        return bool(np.all(apart <= self.noise) and np.any(self.values))

    def apart(self, values: ComplexArray, others: ComplexArray) -> Array:
        """Distances of values from others, shape (values, others)."""
        difference = values[:, None] - others
        if np.isfinite(self.turn):
            difference -= 1j * self.turn * np.round(difference.imag / self.turn)
        if self.groups is not None and difference.shape == (self.groups.size, self.groups.size):
            difference = np.where(self.groups[:, None] == self.groups, difference, APART)
        return np.abs(difference)

    def along(self, row: Array) -> tuple[float, float, float]:
        """By sigma = row . z: that of the length along the branch, and two derivatives of the parameter."""
        rate, bend = float(row @ self.point.tangent), float(row @ self.bend)
        t, b = self.point.tangent[-1], self.bend[-1]
        return 1.0 / rate, float(t / rate), float((b * rate - t * bend) / rate**3)


def sample_of(point: Point, weights: Array) -> Sample:
    """The sample at a point; derivatives along the branch by differences of the Jacobian."""
    from scipy.linalg import LinAlgWarning, lu_factor, lu_solve

    problem, z, t = cast(AlgebraicProblem, point.problem), point.z, point.tangent
    n, rounding = problem.statics.size, max(EPSILON, problem.statics.model.rounding)
    h = rounding ** (1.0 / 3.0) / max(1e-300, float(np.max(np.abs(t))))
    change = (problem.jacobian(z + h * t) - problem.jacobian(z - h * t)) / (2.0 * h)
    A, row = problem.jacobian(z)[:n, :n], weights * t
    linear = Linearised(A, rounding)
    bent = np.append(-change @ t, 0.0)
    full = np.vstack([problem.jacobian(z), row])
    scale = np.maximum(np.max(np.abs(full), axis=1), 1e-300)
    with warnings.catch_warnings():  # a branch point is singular
        warnings.simplefilter("ignore", LinAlgWarning)
        factors, pivots = lu_factor(full / scale[:, None], check_finite=False)
    swaps = np.sum(pivots != np.arange(pivots.size))
    orientation = np.prod(np.sign(np.diag(factors))) * (-1.0) ** swaps
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        bend = lu_solve((factors, pivots), bent / scale, check_finite=False)
        terms = np.abs(full) @ np.abs(t) + np.append(np.abs(change) @ problem.units_of_all(z), 0.0)
        shaken = ROUNDING * rounding * terms / scale * np.append(problem.probe, 1.0)
        unsure = abs(float(lu_solve((factors, pivots), shaken, check_finite=False)[-1]))
    return Sample(
        point, row, linear.eigensystem[0], linear.rates(change[:n, :n]), linear.errors(),
        np.where(np.isfinite(bend), bend, 0.0), float(orientation), blurred=not unsure < abs(float(t[-1])),
    )  # fmt: skip
