"""The matrices that decide stability, from transition matrices over half of the time that M takes.

With Phi = [[A, B], [C, D]] over a quarter (half) of the period, the map over twice that time is M = [[I + 2K, 2Q],
[2P, I + 2K^T]] with K = B^T C, P = A^T C and Q = B^T D. P and Q are symmetric, K is symmetric with respect to both:
P K and K Q are symmetric, and P Q = K^T (I + K^T). The trivial direction a, with a^T K = -a^T or 0 and Q a = 0, is
taken out: the matrices are those on what is orthogonal to a. Where the model is only reversible, K is -B' C with B'
from the inverse of Phi, there are no such forms, and the direction along the family is taken out instead.
"""

from __future__ import annotations

import numpy as np

from casadi_skin.stability.reduction import half_cosine_errors, half_cosines
from casadi_skin.zero.problem import Array


def reduced_matrices(
    transitions: Array, errors: Array, directions: Array | None, symplectic: bool
) -> tuple[Array, Array]:
    """(K, P, Q), or K alone, without the trivial direction, and matrices like their errors; (points, 3 or 1, m, m).

    Arguments:
        transitions: Phi, shape (points, 2n, 2n).
        errors: matrices like their errors, of one shape with them.
        directions: the trivial ones, shape (points, n), None where there is none.
        symplectic: whether Phi is.
    """
    make = _symplectic_matrices if symplectic else _reversible_matrices
    values, changes = make(transitions, errors)
    if directions is None:
        return values, changes
    frame = orthogonal_complements(directions)[:, None]
    across = frame.swapaxes(2, 3)
    return np.asarray(across @ values @ frame), np.asarray(across @ changes @ frame)


def _symplectic_matrices(transitions: Array, errors: Array) -> tuple[Array, Array]:
    """K = B^T C, P = A^T C, Q = B^T D, and their first-order changes."""
    n = transitions.shape[1] // 2
    A, B, C, D = _blocks(transitions, n)
    dA, dB, dC, dD = _blocks(errors, n)
    At, Bt, dAt, dBt = (block.swapaxes(1, 2) for block in (A, B, dA, dB))
    values = [half_cosines(transitions), _symmetric(At @ C), _symmetric(Bt @ D)]
    by_P, by_Q = dAt @ C + At @ dC, dBt @ D + Bt @ dD
    changes = [half_cosine_errors(transitions, errors), _symmetric(by_P), _symmetric(by_Q)]
    return np.stack(values, axis=1), np.stack(changes, axis=1)


def _reversible_matrices(transitions: Array, errors: Array) -> tuple[Array, Array]:
    """K = -B' C with B' the upper right block of the inverse of Phi, and its first-order change."""
    n = transitions.shape[1] // 2
    inverse = np.linalg.inv(transitions)
    B, dB = inverse[:, :n, n:], -(inverse @ errors @ inverse)[:, :n, n:]
    C, dC = transitions[:, n:, :n], errors[:, n:, :n]
    return (-B @ C)[:, None], (-dB @ C - B @ dC)[:, None]


def _blocks(matrices: Array, n: int) -> tuple[Array, Array, Array, Array]:
    return matrices[:, :n, :n], matrices[:, :n, n:], matrices[:, n:, :n], matrices[:, n:, n:]


def _symmetric(matrices: Array) -> Array:
    return np.asarray(0.5 * (matrices + matrices.swapaxes(-1, -2)))


def orthogonal_complements(directions: Array) -> Array:
    """Orthonormal bases of the orthogonal complement of each direction, smooth along them; to (points, n, n - 1).

    A reflection maps each direction to that of the middle one, whose complement is the same for all.
    """
    n = directions.shape[1]
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    middle = unit[len(unit) // 2]
    fixed = np.linalg.qr(np.column_stack([middle, np.eye(n)]))[0][:, 1:]
    u = unit + middle
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    return np.asarray(fixed - 2.0 * u[:, :, None] * (u @ fixed)[:, None, :])
