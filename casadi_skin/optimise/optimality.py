"""Whether a point is a local optimum: conditions of first and second order, from multipliers and exact derivatives.

See Nocedal and Wright, Numerical Optimization (2006), theorems 12.1, 12.5 and 12.6.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.optimise.nlp import Nlp, Solution
from casadi_skin.zero.problem import Array, Indices

CURVED = 1e-6  # of the Hessian in the free directions: less is rounding
NOISE = 1e-8  # curvature, relative to the gradient, that errors of multipliers make where there is none
FLAT = 1e-9  # curvature of an objective that has the same value at neighbours
NEAR_BOUND = 1e-6  # distance to a bound, relative to the range or to 1, at which it is active
HOLDS = 1e-5  # size of a multiplier, relative to the largest, at which its bound is active


@dataclass(frozen=True)
class Kkt:
    """Residuals of the conditions of Karush, Kuhn and Tucker, each relative to its terms."""

    stationarity: float
    violation: float
    complementarity: float

    @property
    def largest(self) -> float:
        """The largest of the three."""
        return max(self.stationarity, self.violation, self.complementarity)


@dataclass(frozen=True)
class Optimality:
    """The conditions of optimality at a point, and how well they hold.

    Attributes:
        kkt: the conditions of first order.
        active: bounds that are active: the point is next to them, or their multiplier is not small.
        curvature: smallest eigenvalue of the Hessian of the Lagrangian on the directions that equations and active
            bounds leave free, in the metric of the free numbers; infinite where none is left, nan where not known.
        negative: the most negative one relative to the largest; 0 where none is beyond rounding.
    """

    kkt: Kkt
    active: tuple[str, ...]
    curvature: float
    negative: float


def optimality(nlp: Nlp, solution: Solution) -> Optimality:
    """The conditions at a solution."""
    g, J = nlp.residual(solution.x), nlp.jacobian(solution.x)
    words, unknowns, rows = _active(nlp, solution, g)
    curvature, negative = _curvature(nlp, solution, J, unknowns, rows) if nlp.exact else (np.nan, 0.0)
    return Optimality(_kkt(nlp, solution, g, J), words, curvature, negative)


def _kkt(nlp: Nlp, solution: Solution, g: Array, J: Any) -> Kkt:
    x, lam_g, lam_x, limits = solution.x, solution.lam_g, solution.lam_x, nlp.limits
    gradient, moves = nlp.gradient(x), limits.lower < limits.upper
    largest = max(1.0, float(np.max(np.abs(gradient))))
    terms = np.abs(gradient) + np.asarray(abs(J).T @ np.abs(lam_g)).ravel()
    total = gradient + np.asarray(J.T @ lam_g).ravel() + lam_x
    gap = limits.violations(g) / np.maximum(1.0, np.asarray(abs(J) @ np.abs(x)).ravel())
    outside = np.maximum(np.maximum(limits.lower - x, x - limits.upper), 0.0)
    rows = limits.condition_rows
    products = np.append(
        _complementarity(lam_x, limits.upper - x, x - limits.lower)[moves],
        _complementarity(lam_g, limits.high - g, g - limits.low)[rows],
    )
    return Kkt(
        float(np.max((np.abs(total) / np.maximum(largest, terms))[moves])),
        float(max(np.max(gap, initial=0.0), np.max(outside))),
        float(np.max(products, initial=0.0)) / largest,
    )


def _complementarity(multipliers: Array, above: Array, below: Array) -> Array:
    slack = np.minimum(np.where(multipliers > 0, above, below), 1.0)
    return np.abs(multipliers) * np.abs(np.where(multipliers == 0, 0.0, slack))


def _active(nlp: Nlp, solution: Solution, g: Array) -> tuple[tuple[str, ...], Indices, Indices]:
    """Active bounds in words, the unknowns at them, and the rows of conditions at them, equalities included."""
    x, limits = solution.x, nlp.limits
    held = HOLDS * max(1.0, *(float(np.max(np.abs(v), initial=0.0)) for v in (solution.lam_g, nlp.gradient(x))))
    words, unknowns, rows = list[str](), list[int](), list[int]()
    for name, places in limits.unknowns.items():
        low, high = limits.lower[places], limits.upper[places]
        near = NEAR_BOUND * np.where(np.isfinite(high - low), high - low, np.maximum(1.0, np.abs(x[places])))
        for bound, sign, side in ((low, ">=", -1.0), (high, "<=", 1.0)):
            at = (np.abs(x[places] - bound) <= near) | (side * solution.lam_x[places] > held)
            if np.any(at):
                where = "" if places.size == 1 else f" at {np.count_nonzero(at)} of {places.size} points"
                words.append(f"{name} {sign} {bound[0]:.10g}{where}")
                unknowns += places[at].tolist()
    for name, places in limits.conditions.items():
        for bound, sign in ((limits.low[places], ">="), (limits.high[places], "<=")):
            at = np.isfinite(bound) & (np.abs(g[places] - bound) <= NEAR_BOUND * np.maximum(1.0, np.abs(bound)))
            rows += places[at].tolist()
            words += [f"{name} {sign} {b:.10g}" for b in bound[at & (limits.low[places] < limits.high[places])]]
    return tuple(words), np.unique(np.array(unknowns, dtype=int)), np.unique(np.array(rows, dtype=int))


def _curvature(nlp: Nlp, solution: Solution, J: Any, unknowns: Indices, rows: Indices) -> tuple[float, float]:
    """`curvature` and `negative` with these unknowns and rows held.

    There are few free directions, as many as free numbers less conditions. Random vectors, projected on the null space
    of the equations, span them; conditions and active bounds are taken out after that, since they may depend on each
    other.
    """
    from scipy.linalg import eigh, null_space

    moves = np.flatnonzero(nlp.limits.lower < nlp.limits.upper)
    sizes = nlp.sizes(solution.x)[:, None]
    basis = np.zeros((nlp.size, max(0, moves.size - nlp.limits.equations.size)))
    try:
        basis[moves] = _null_space(J[nlp.limits.equations][:, moves].multiply(sizes[moves].T))
    except RuntimeError:  # SuperLU: "Factor is exactly singular"
        return np.nan, 0.0
    closed = np.vstack([np.asarray(J[rows] @ (sizes * basis)), basis[unknowns]])
    basis = basis @ null_space(closed) if len(closed) else basis
    if basis.shape[1] == 0:
        return np.inf, 0.0
    directions = sizes * basis
    curved = sizes * np.asarray(nlp.hessian(solution.x, solution.lam_g) @ directions)
    size, reduced = float(np.linalg.norm(curved, 2)), basis.T @ curved
    negative = float(eigh(reduced, eigvals_only=True)[0])
    free = directions[nlp.measured] if nlp.measured.size else basis
    try:
        least = float(eigh(reduced, free.T @ free, eigvals_only=True)[0])
    except np.linalg.LinAlgError:  # a direction that changes no free number
        least = np.nan
    noise = max(CURVED * size, NOISE * float(np.max(np.abs(sizes.ravel() * nlp.gradient(solution.x)))))
    return least, negative / size if negative < -noise else 0.0


def _null_space(J: Any) -> Array:
    """Orthonormal vectors that a sparse matrix (m, n) of full rank maps to zero, (n, n - m); raises RuntimeError."""
    from scipy.sparse import bmat, diags, identity
    from scipy.sparse.linalg import splu

    m, n = J.shape
    if n <= m:
        return np.zeros((n, 0))
    largest = np.asarray(abs(J).max(axis=1).todense()).ravel()
    J = diags(1.0 / np.where(largest > 0.0, largest, 1.0)) @ J
    project = splu(bmat([[identity(n), J.T], [J, None]]).tocsc())
    basis = np.random.default_rng(0).normal(size=(n, n - m))
    for _ in range(2):  # the second time takes away the rounding of the first
        basis, _ = np.linalg.qr(project.solve(np.vstack([basis, np.zeros((m, n - m))]))[:n])
    return basis
