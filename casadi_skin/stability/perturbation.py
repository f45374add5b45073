"""Errors of eigenvalues from estimated errors of their matrix: first order, and pairs that nearly meet.

With W = Y dM X, Y and X the left and right eigenvectors with Y X = I, an eigenvalue moves by W_ii and, through another
one at distance d, by about W_ik W_ki / d, at most by the root of W_ik W_ki as in a defective pair (Kato 1995, II.2).
"""

from __future__ import annotations

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.stability.reduction import Eigensystems

MACHINE = float(np.finfo(float).eps)
FLOOR = 0.1  # of the largest error in an orbit: W_ii can vanish where the error that it stands for does not


def couplings(systems: Eigensystems, errors: Array) -> Array:
    """|W| for errors of the matrices, shape (points, m, m); not finite at a defective eigenvalue."""
    with np.errstate(invalid="ignore", over="ignore"):
        return systems.couplings(errors)


def eigenvalue_errors(systems: Eigensystems, W: Array, norms: Array, round_off: Array) -> Array:
    """Estimated absolute errors of the eigenvalues, shape (points, m), from moduli `W` of couplings.

    `norms` are those of the matrices' errors behind W, `round_off` of errors of which nothing more is known; (points,).
    """
    with np.errstate(invalid="ignore", over="ignore"):
        W = W + (round_off[:, None] * np.linalg.norm(systems.left, axis=2))[:, :, None]
        first = np.diagonal(W, axis1=1, axis2=2)
        product = W * W.swapaxes(1, 2)
        distance = np.abs(systems.values[:, :, None] - systems.values[:, None, :])
        pairs = np.minimum(product / np.maximum(distance, MACHINE), np.sqrt(product))
        np.einsum("pii->pi", pairs)[:] = 0.0
        total = first + np.max(pairs, axis=2) + FLOOR * np.max(first, axis=1, keepdims=True)
    # A pair moves by the root of the matrix's error at most, when it is defective; W is infinite there.
    return np.asarray(np.fmin(total, np.sqrt(norms + round_off)[:, None]))
