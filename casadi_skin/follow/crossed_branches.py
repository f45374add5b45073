"""The number of branches that cross a stretch of a branch, an even one too: eigenvalues from one end to the other.

The Jacobian bordered by the tangent is J0 at one end and J1 at the other. The eigenvalues of J0^-1 J1 are all 1 where
the ends coincide, and one of them passes through zero where J1 passes a branch point: as many are negative as branches
cross, where the sign of a determinant is that of their product alone. One that passes through zero and comes back is
seen by its rate at either end, an eigenvalue of J^-1 dJ/ds. J0^-1 J1 is 1 plus a compact operator, so that few
eigenvalues lie far from 1: Arnoldi's method (Saad 2011, chapter 6) sees those at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.zero.problem import Array, Problem, Solve

if TYPE_CHECKING:
    from scipy.sparse import csc_matrix

STEPS = 14  # of Arnoldi's method, after which eigenvalues far from the others are known
QUIET = 0.7  # of 1: an eigenvalue that falls by less on the way, at its rate at an end, reaches no zero
SUSPECT = 0.5  # largest real part of eigenvalues that are looked at closely
DENSE = 500  # unknowns up to which all eigenvalues are computed
MOST = 20  # eigenvalues that are computed of larger systems


@dataclass(frozen=True, eq=False)
class Bordered:
    """The Jacobian with its border at one place, and the solver of both."""

    matrix: csc_matrix
    solve: Solve

    @classmethod
    def at(cls, problem: Problem, nonzeros: Array, row: Array, solve: Solve) -> Bordered:
        """Of a problem's Jacobian closed by `row`."""
        return cls(closed(problem, nonzeros, row), solve)


def closed(problem: Problem, nonzeros: Array, row: Array) -> csc_matrix:
    """The Jacobian of these non-zeros, with a row below it."""
    from scipy.sparse import csc_matrix, vstack

    jacobian = csc_matrix((nonzeros, problem.pattern), shape=(problem.size - 1, problem.size))
    return vstack([jacobian, csc_matrix(row[None, :])]).tocsc()


def crossings(before: Bordered, after: Bordered) -> int:
    """The number of branches that cross between two places: negative eigenvalues of one matrix relative to another."""
    if np.min(outer_eigenvalues(before, after.matrix).real, initial=1.0) > SUSPECT:
        return 0
    values = _eigenvalues(before, after)
    real = np.abs(values.imag) <= 1e-6 * np.abs(values)
    return int(np.sum(real & (values.real < 0.0)))


def quiet(rates: Array, way: float, crossed: float | None) -> bool:
    """Whether eigenvalues with these rates go through no zero on a way, but for one at a part of it if it is given."""
    falls = np.sort((rates * way).real)
    if crossed is not None and falls.size:
        falls[0] += 1.0 / max(crossed, np.finfo(float).tiny)
    return bool(np.all(falls > -QUIET))


def outer_eigenvalues(before: Bordered, matrix: csc_matrix) -> Array:
    """Those of the solver times a matrix that lie far from the others, by a few steps of Arnoldi's method."""
    size = before.matrix.shape[0]
    steps = min(STEPS, size)
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
    if size <= DENSE:
        return np.asarray(np.linalg.eigvals(before.solve(after.matrix.toarray())))
    operator = LinearOperator((size, size), matvec=lambda v: before.solve(after.matrix @ np.asarray(v).ravel()))
    start = np.random.default_rng(1).normal(size=size)
    try:
        return np.asarray(eigs(operator, MOST, which="SR", v0=start, tol=1e-4, return_eigenvectors=False))
    except ArpackNoConvergence as error:
        return np.asarray(error.eigenvalues)
