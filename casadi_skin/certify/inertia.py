"""Numbers of negative eigenvalues of L(sigma), proved; each change of them between two sigma is an exponent.

L(sigma) w = lambda (sigma + m)^2 w_m + sum over p of G_p w_(m-p), m a multiple of the step, is selfadjoint for real
sigma, bounded from below, and has a kernel where exp(i sigma theta) is a multiplier, over theta = pi for even m and
over 2 pi for all. Its number of negative eigenvalues changes at such sigma alone.
"""

from __future__ import annotations

import numpy as np

from casadi_skin.certify.balls import ROUNDING, Enclosed, below, rounded_up
from casadi_skin.certify.linearised import Linearised
from casadi_skin.zero.problem import Array

LARGEST = 4000  # rows of the finite part
GROWTH = 1.5
FIRST = 4  # highest harmonic of the smallest finite part


def negative_eigenvalues(problem: Linearised, sigma: float) -> int | None:
    """Number of negative eigenvalues of L(sigma); None where no finite part of up to LARGEST rows decides."""
    highest = FIRST
    while problem.harmonics(highest).size * problem.positions <= LARGEST:
        found, helps = _count(problem, sigma, highest)
        if found is not None or not helps:
            return found
        highest = problem.grown(highest, GROWTH)
    return None


def _count(problem: Linearised, sigma: float, highest: int) -> tuple[int | None, bool]:
    """The same from the harmonics |m| <= highest, and whether more of them may help where it is None.

    By Schur's complement L has the inertia of M - B T^-1 B^T where the tail's T >= t > 0, and 0 <= B T^-1 B^T <=
    B B^T/t <= diag(beta)/t, beta being sums of norms along the rows of B B^T.
    """
    from flint import arb

    harmonics = problem.harmonics(highest)
    sizes, n = problem.sizes, problem.positions
    total = float(sizes[0] + 2.0 * sizes[1:].sum()) * (1.0 + sizes.size * ROUNDING)
    nearest = arb(highest + problem.step) - abs(arb(sigma))
    floor = below(problem.square * nearest**2 - arb(total) - arb(problem.radius))
    if not floor > 0.0:
        return None, True
    kinetic = Enclosed.of([problem.square * (arb(sigma) + int(m)) ** 2 for m in harmonics.tolist()])
    matrix, unsure = _finite_part(problem.blocks, harmonics, kinetic)
    through_tail = np.repeat(_coupling(problem, highest) / floor, n)
    slack = np.repeat(kinetic.radius + problem.radius + unsure, n)
    return _inertia(matrix, slack, through_tail)


def _finite_part(blocks: Array, harmonics: Array, kinetic: Enclosed) -> tuple[Array, Array]:
    """The finite part of L in doubles, and the rounding of its diagonal."""
    n, count = blocks.shape[1], harmonics.size
    matrix = np.zeros((count, n, count, n))
    for p in range(min(blocks.shape[0], count)):
        for i in range(count - p):
            matrix[i, :, i + p, :] = matrix[i + p, :, i, :] = blocks[p]
    sites = np.arange(n)
    rounding = np.zeros(count)
    for i in range(count):
        diagonal = matrix[i, sites, i, sites] + kinetic.middle[i]
        matrix[i, sites, i, sites] = diagonal
        rounding[i] = np.max(np.abs(diagonal)) * ROUNDING
    return matrix.reshape(count * n, count * n), rounding


def _coupling(problem: Linearised, highest: int) -> Array:
    """Bounds of the sums of norms along the rows of B B^T, shape (harmonics,)."""
    sizes, step, harmonics = problem.sizes, problem.step, problem.harmonics(highest)
    tail = np.arange(highest + step, highest + step * (sizes.size - 1) + 1, step)
    outside = np.concatenate([-tail[::-1], tail])
    if not outside.size:
        return np.zeros(harmonics.size)
    distance = np.abs(harmonics[:, None] - outside).astype(int) // step
    norms = np.where(distance < sizes.size, sizes[np.minimum(distance, sizes.size - 1)], 0.0)
    return rounded_up(norms @ rounded_up(norms.sum(axis=0), harmonics.size), outside.size)


def _inertia(matrix: Array, slack: Array, through_tail: Array) -> tuple[int | None, bool]:
    """Negative eigenvalues of every symmetric matrix that differs by a diagonal of moduli <= slack + through_tail.

    With W = V |d|^-1/2 of computed eigenvectors W^T (matrix + change) W is within 1 of a diagonal of signs: Sylvester's
    law, and a perturbation of norm below 1 moves no eigenvalue through 0. The change is at most its trace. Without a
    number also whether a smaller `through_tail` would give one.
    """
    values, vectors = np.linalg.eigh(matrix)
    if not np.all(np.abs(values) > 0.0):
        return None, False
    W = vectors / np.sqrt(np.abs(values))
    error = np.abs(W.T @ (matrix @ W) - np.diag(np.sign(values)))
    n, moduli, squares = len(matrix), np.abs(W), (W**2).sum(axis=1)
    rounding = moduli.T @ (np.abs(matrix) @ moduli.sum(axis=1)) * (2 * n + 4) * ROUNDING
    own = max(float(np.max(error.sum(axis=0))), float(np.max(error.sum(axis=1)))) + 2.0 * float(np.max(rounding))
    fixed, tail = own + float(slack @ squares), float(through_tail @ squares)
    proved = float(rounded_up(np.array(fixed + tail), n + 4)) < 1.0
    return (int(np.sum(values < 0.0)) if proved else None), fixed < 0.9
