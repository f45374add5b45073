"""Samples of a branch of equilibria: eigenvalues and their rates, and the curvature of the branch."""

from __future__ import annotations

import warnings

import numpy as np

from casadi_skin.follow.samples import Sample
from casadi_skin.zero.balanced import DERIVATIVE_ROUNDING, BalancedMatrix
from casadi_skin.zero.problem import EPSILON, Array
from casadi_skin.zero.settings import Point


def sample_of(point: Point, weights: Array) -> Sample:
    """The sample at a point; derivatives along the branch by differences of the Jacobian."""
    from scipy.linalg import LinAlgWarning, lu_factor, lu_solve

    problem, z, t = point.problem, point.z, point.tangent
    n, rounding = problem.statics.size, max(EPSILON, problem.statics.model.rounding)
    h = rounding ** (1.0 / 3.0) / max(1e-300, float(np.max(np.abs(t))))
    change = (problem.jacobian(z + h * t) - problem.jacobian(z - h * t)) / (2.0 * h)
    A, row = problem.jacobian(z)[:n, :n], weights * t
    linear = BalancedMatrix(A, rounding)
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
        shaken = DERIVATIVE_ROUNDING * rounding * terms / scale * np.append(problem.probe, 1.0)
        unsure = abs(float(lu_solve((factors, pivots), shaken, check_finite=False)[-1]))
    return Sample(
        point, row, linear.eigensystem[0], linear.rates(change[:n, :n]), linear.errors(),
        np.where(np.isfinite(bend), bend, 0.0), float(orientation), blurred=not unsure < abs(float(t[-1])),
    )  # fmt: skip
