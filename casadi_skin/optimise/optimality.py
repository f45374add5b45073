"""Whether a point is an optimum: the first and second order conditions, from multipliers and exact derivatives.

See Nocedal and Wright, Numerical Optimization (2006), theorems 12.1 and 12.6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin.optimise.search_nlp import SearchNlp, Solution

Indices = NDArray[np.int64]


@dataclass(frozen=True)
class Kkt:
    """Conditions of Karush, Kuhn and Tucker from derivatives and multipliers, each relative to its terms."""

    stationarity: float
    violation: float
    complementarity: float

    @property
    def largest(self) -> float:
        """The largest of the three."""
        return max(self.stationarity, self.violation, self.complementarity)


def kkt(programme: SearchNlp, solution: Solution) -> Kkt:
    """The conditions of optimality at a solution, from its multipliers."""
    gradient = programme.gradient(solution.x)
    g, J = programme.residual(solution.x), programme.jacobian(solution.x)
    terms = np.abs(gradient) + np.asarray(abs(J).T @ np.abs(solution.lam_g)).ravel()
    total = gradient + np.asarray(J.T @ solution.lam_g).ravel() + solution.lam_x
    (low, high), (lower, upper) = programme.bounds, programme.condition_bounds
    size = np.maximum(1.0, np.asarray(abs(J) @ np.abs(solution.x)).ravel())
    gap = np.maximum(np.maximum(lower - g, g - upper), 0.0) / size
    outside = np.maximum(np.maximum(low - solution.x, solution.x - high), 0.0)
    slack_x = np.where(solution.lam_x > 0, high - solution.x, solution.x - low)
    slack_g = np.where(solution.lam_g > 0, upper - g, g - lower)
    n = programme.equations
    products = [
        np.abs(lam) * np.abs(np.where(lam == 0, 0.0, np.minimum(slack, 1.0)))
        for lam, slack in ((solution.lam_x, slack_x), (solution.lam_g[n:], slack_g[n:]))
    ]
    largest = max(1.0, float(np.max(np.abs(gradient))))
    return Kkt(
        float(np.max(np.abs(total) / np.maximum(largest, terms))),
        float(max(np.max(gap), np.max(outside))),
        float(np.max(np.concatenate(products), initial=0.0)) / largest,
    )


def curvature(programme: SearchNlp, solution: Solution, active: Indices, rows: Indices) -> float:
    """Smallest eigenvalue of the Hessian of the Lagrangian on the directions that the constraints leave free.

    `active` are the unknowns and `rows` the constraints held. Infinite where nothing is left free.
    """
    from scipy.linalg import eigvalsh
    from scipy.sparse.linalg import splu

    J, n = programme.jacobian(solution.x).tocsc(), programme.equations
    H = programme.hessian(solution.x, solution.lam_g)
    left = np.setdiff1d(np.arange(programme.free_count), active)
    states = np.arange(programme.free_count, programme.size)
    basis = np.zeros((programme.size, left.size))
    basis[left, np.arange(left.size)] = 1.0
    if left.size:  # states move with the free numbers as the equations tell: implicit function theorem
        basis[states] = splu(J[:n, states]).solve(-J[:n, left].toarray())
    if rows.size and left.size:
        from scipy.linalg import null_space

        basis = basis @ null_space(np.asarray(J[rows] @ basis))
    if basis.shape[1] == 0:
        return np.inf
    free = basis[: programme.free_count]
    return float(eigvalsh(basis.T @ (H @ basis), free.T @ free)[0])
