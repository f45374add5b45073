"""The quadratic term at folds of boundary-value problems along a curve of them: it vanishes where two of them meet.

With the null vectors v and psi of the linearised equations it is psi . F''(v, v) / 2 (Govaerts 2000, chapter 8), to
which conditions and integrals contribute that are not linear; at a cusp the parameters do not depend on the place
to first order. The sign of psi is that for which the normal of the curve in the plane of the two parameters, psi . F_p,
goes on as it does through a cusp.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from casadi_skin.follow.followed import Followed
from casadi_skin.follow.settings import Point
from casadi_skin.zero.all_rows import full_derivative
from casadi_skin.zero.linearised import null_vectors
from casadi_skin.zero.problem import Array


def quadratic_term(space: Followed, beside: Point) -> Callable[[Point], float]:
    """The quadratic term as a function of points of the curve; its sign goes on from a point beside them."""
    reference = _normal(space, beside)[1]

    def term(point: Point) -> float:
        psi, normal = _normal(space, point)
        linear = space.linearised(point)
        v = linear.joined_vector
        return float(0.5 * np.copysign(1.0, normal @ reference) * (psi @ full_derivative(linear, v, v)))

    return term


def _normal(space: Followed, point: Point) -> tuple[Array, Array]:
    """The left null vector of norm 1, and its products with the derivatives by both parameters."""
    linear = space.linearised(point)
    psi = np.asarray(null_vectors(linear.jacobian)[1])
    return psi, np.array([psi @ linear.by_scalar(len(linear.statement.free)), psi @ linear.by_scalar(-1)])
