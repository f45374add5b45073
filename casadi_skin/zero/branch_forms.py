"""The branching equation at branch points that are followed in two parameters: where it degenerates.

Along x0 + w v1 it is a w^2 + c w^3 + ... = 0 at the parameters of the branch point itself (Lyapunov and Schmidt;
Govaerts 2000, chapter 8). Where a symmetry is lost a is zero, and c decides on which side the other branch is; where a
vanishes without a symmetry the fold of the other branch is at the branch point. Both are measured by what the left null
vector sees of the push, which is not zero where the extended equations are regular.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadi_skin.follow.followed import Followed
from casadi_skin.follow.settings import Point
from casadi_skin.zero.all_rows import full_derivative
from casadi_skin.zero.linearised import Linearised, null_vectors
from casadi_skin.zero.problem import Array

SYMMETRIC = 1e-6  # of all terms: a quadratic coefficient that a symmetry makes zero


@dataclass(frozen=True, eq=False)
class BranchingEquation:
    """Its coefficients at a solution of the extended equations of branch points, which is linearised there."""

    linear: Linearised

    @property
    def coefficients(self) -> tuple[float, float]:
        """The coefficients a and c."""
        return float(np.sum(self._terms[0])), float(np.sum(self._terms[1]))

    def symmetric(self, error: float) -> bool:
        """Whether a is zero but for errors of the solution."""
        quadratic, _ = self.coefficients
        scale = sum(float(np.sum(np.abs(terms))) for terms in self._terms)
        return abs(quadratic) <= max(SYMMETRIC, 100.0 * error) * scale

    @cached_property
    def _terms(self) -> tuple[Array, Array]:
        """The terms of a and c."""
        from scipy.sparse import bmat, csc_matrix
        from scipy.sparse.linalg import splu

        matrix, v = self.linear.jacobian, self.linear.joined_vector
        psi = np.asarray(null_vectors(matrix)[1])
        twice, thrice = full_derivative(self.linear, v, v), full_derivative(self.linear, v, v, v)
        closed = bmat([[matrix, csc_matrix(psi[:, None])], [csc_matrix(v[None, :]), None]]).tocsc()
        bent = np.asarray(splu(closed).solve(np.append(-twice, 0.0))[:-1])
        over = psi @ self.linear.by_scalar(-2)  # by the push
        cubic = [*(psi * thrice / 6.0), *(0.5 * psi * full_derivative(self.linear, v, bent))]
        return 0.5 * psi * twice / over, np.array(cubic) / over


def branching_equation(space: Followed, point: Point) -> BranchingEquation:
    """The equation at a point of a curve of branch points."""
    return BranchingEquation(space.linearised(point))


def second_singular(space: Followed, point: Point) -> float:
    """The smallest singular value of the Jacobian bordered by its null vectors."""
    from scipy.sparse import bmat, csc_matrix

    matrix = space.linearised(point).jacobian
    right, left = null_vectors(matrix)
    closed = bmat([[matrix, csc_matrix(left[:, None])], [csc_matrix(right[None, :]), None]]).tocsc()
    return float(np.linalg.norm(closed @ null_vectors(closed)[0]))
