"""Whether a point is a local optimum: conditions of first and second order, from multipliers and exact derivatives.

See Nocedal and Wright, Numerical Optimization (2006), theorems 12.1, 12.5 and 12.6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.bvp.problem import Array, Indices
from casadi_skin.optimise.nlp import Nlp, Solution

CURVED = 1e-6  # of what the Hessian does to the free directions: less is rounding
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


@dataclass(frozen=True, eq=False)
class Active:
    """Bounds that are active: in words, unknowns at a bound, and rows of conditions at one (equalities among them)."""

    words: tuple[str, ...]
    unknowns: Indices
    rows: Indices


@dataclass(frozen=True)
class Curvature:
    """Curvature of the Lagrangian on the directions that equations and active bounds leave free.

    `least` is the smallest eigenvalue in the metric of the free numbers, infinite where no direction is left and nan
    where it is not known. `negative` is the most negative one relative to the largest, 0 where none is beyond rounding.
    """

    least: float
    negative: float


def kkt(nlp: Nlp, solution: Solution) -> Kkt:
    """The conditions of first order at a solution, from its multipliers."""
    x, lam_g, lam_x, limits = solution.x, solution.lam_g, solution.lam_x, nlp.limits
    gradient, g, J = nlp.gradient(x), nlp.residual(x), nlp.jacobian(x)
    largest = max(1.0, float(np.max(np.abs(gradient))))
    terms = np.abs(gradient) + np.asarray(abs(J).T @ np.abs(lam_g)).ravel()
    total = gradient + np.asarray(J.T @ lam_g).ravel() + lam_x
    gap = np.maximum(np.maximum(limits.low - g, g - limits.high), 0.0)
    gap /= np.maximum(1.0, np.asarray(abs(J) @ np.abs(x)).ravel())
    outside = np.maximum(np.maximum(limits.lower - x, x - limits.upper), 0.0)
    rows = np.setdiff1d(np.arange(g.size), limits.equations)
    moves = limits.lower < limits.upper
    products = np.append(
        _complementarity(lam_x, limits.upper - x, x - limits.lower)[moves],
        _complementarity(lam_g[rows], (limits.high - g)[rows], (g - limits.low)[rows]),
    )
    return Kkt(
        float(np.max((np.abs(total) / np.maximum(largest, terms))[moves])),
        float(max(np.max(gap, initial=0.0), np.max(outside))),
        float(np.max(products, initial=0.0)) / largest,
    )


def _complementarity(multipliers: Array, above: Array, below: Array) -> Array:
    slack = np.minimum(np.where(multipliers > 0, above, below), 1.0)
    return np.abs(multipliers) * np.abs(np.where(multipliers == 0, 0.0, slack))


def active_bounds(nlp: Nlp, solution: Solution) -> Active:
    """The bounds that are active at a solution: it is next to them, or their multiplier is not small."""
    x, g, limits = solution.x, nlp.residual(solution.x), nlp.limits
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
    return Active(tuple(words), np.unique(np.array(unknowns, dtype=int)), np.unique(np.array(rows, dtype=int)))


def curvature(nlp: Nlp, solution: Solution, active: Active) -> Curvature:
    """The condition of second order at a solution.

    There are few free directions, as many as free numbers less conditions. Random vectors, projected on the null space
    of the equations, span them; conditions and active bounds are taken out after that, since they may depend on each
    other.
    """
    from scipy.linalg import eigh, null_space
    from scipy.sparse import bmat, diags, identity
    from scipy.sparse.linalg import splu

    unknown = Curvature(np.nan, 0.0)
    if not nlp.exact:
        return unknown
    left = nlp.limits.lower < nlp.limits.upper
    scale, jacobian = (
        nlp.sizes(solution.x)[left],
        nlp.jacobian(solution.x)[:, left] @ diags(nlp.sizes(solution.x)[left]),
    )
    J = jacobian[nlp.limits.equations]
    m, n = J.shape
    if n <= m:
        return Curvature(np.inf, 0.0)
    largest = np.asarray(abs(J).max(axis=1).todense()).ravel()
    J = diags(1.0 / np.where(largest > 0.0, largest, 1.0)) @ J
    try:
        project = splu(bmat([[identity(n), J.T], [J, None]]).tocsc())
    except RuntimeError:  # SuperLU: "Factor is exactly singular"
        return unknown
    basis = np.random.default_rng(0).normal(size=(n, n - m))
    for _ in range(2):  # the second time takes away what rounding left of the first
        basis, _ = np.linalg.qr(project.solve(np.vstack([basis, np.zeros((m, n - m))]))[:n])
    place = np.cumsum(left) - 1
    closed = np.vstack(
        [np.asarray(jacobian[active.rows] @ basis), basis[place[active.unknowns[left[active.unknowns]]]]]
    )
    if len(closed):
        basis = basis @ null_space(closed)
    if basis.shape[1] == 0:
        return Curvature(np.inf, 0.0)
    curved = scale[:, None] * np.asarray(
        nlp.hessian(solution.x, solution.lam_g)[left][:, left] @ (scale[:, None] * basis)
    )
    size, reduced = float(np.linalg.norm(curved, 2)), basis.T @ curved
    negative = float(eigh(reduced, eigvals_only=True)[0])
    measured = nlp.measured
    free = (scale[:, None] * basis)[place[measured]] if measured.size else basis
    try:
        least = float(eigh(reduced, free.T @ free, eigvals_only=True)[0])
    except np.linalg.LinAlgError:  # a direction that changes no free number
        least = np.nan
    return Curvature(least, negative / size if negative < -CURVED * size else 0.0)
