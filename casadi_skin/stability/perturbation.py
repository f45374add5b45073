"""Errors of eigenvalues from estimated errors of their matrix: first order, and pairs that nearly meet.

With W = Y dM X, Y and X the left and right eigenvectors with Y X = I, an eigenvalue moves by W_ii and, through another
one at distance d, by about W_ik W_ki / d, at most by the root of W_ik W_ki as in a defective pair (Kato 1995, II.2).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from casadi_skin.stability.reduction import Eigensystems
from casadi_skin.zero.problem import Array

Booleans = NDArray[np.bool_]
LARGE = 128  # eigenvalues from which on only those that are close are coupled
DECIDES = 0.01  # of an eigenvalue's error otherwise: couplings that matter
MACHINE = float(np.finfo(float).eps)
FLOOR = 0.1  # of the largest error in an orbit: W_ii can vanish where the error that it stands for does not


def couplings(systems: Eigensystems, errors: Array) -> Array:
    """|W| for errors of the matrices, shape (points, m, m); not finite at a defective eigenvalue."""
    with np.errstate(invalid="ignore", over="ignore"):
        return systems.couplings(errors @ systems.basis)


def eigenvalue_errors(
    systems: Eigensystems, parts: Sequence[Array], norms: Array, round_off: Array
) -> tuple[Array, Array]:
    """Estimated absolute errors of the eigenvalues, and |W_ii| of the first part alone, each (points, m).

    Arguments:
        systems: eigenvalues with their vectors.
        parts: matrices like the errors of the matrices, each (points, m, m), whose moduli of W are added.
        norms: Frobenius norms of all parts together, shape (points,).
        round_off: norms of errors of which nothing more is known, shape (points,).

    Of large matrices W is formed where two eigenvalues can be close enough for their coupling to matter.
    """
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        images = [part @ systems.basis for part in parts]
        left, chosen = systems.left_sizes, np.ones(systems.values.shape[1], dtype=bool)
        large = chosen.size > LARGE
        if large:
            alone = [systems.expectations(image) for image in images]
        else:
            coupled = [systems.couplings(image) for image in images]
            alone = [np.einsum("pii->pi", W).copy() for W in coupled]
        first = sum(alone) + round_off[:, None] * left
        rest = first + FLOOR * np.max(first, axis=1, keepdims=True)
        if large:
            moved = left * (sum(systems.sizes(image) for image in images) + round_off[:, None])
            chosen = systems.whole_pairs(_close(systems.values.real, moved, DECIDES * rest))
            rest = (1.0 + DECIDES) * rest
        few = systems.of(chosen)
        if large:
            coupled = [few.couplings(image[:, :, chosen]) for image in images]
        W = sum(coupled)
        W = W + (round_off[:, None] * left[:, chosen])[:, :, None]
        product = W * W.swapaxes(1, 2)
        pairs = np.minimum(product / np.maximum(few.distances, MACHINE), np.sqrt(product))
        np.einsum("pii->pi", pairs)[:] = 0.0
        rest[:, chosen] += np.max(pairs, axis=2, initial=0.0)
    # A pair moves by the root of the matrix's error at most, when it is defective; W is infinite there.
    return np.asarray(np.fmin(rest, np.sqrt(norms + round_off)[:, None])), alone[0]


def _close(values: Array, moved: Array, matters: Array) -> Booleans:
    """Which eigenvalues, by ascending real parts, have another within the distance at which their coupling matters.

    |W_ik| is at most the norm of the left vector times that of the image of the right one: |W_ik W_ki| is at most
    `moved`[i] `moved`[k]. All arrays have shape (points, m); one result for all points.
    """
    radius = moved * np.max(moved, axis=1, keepdims=True) / matters
    chosen = np.zeros(values.shape[1], dtype=bool)
    for at, within in zip(values, np.where(np.isnan(radius), np.inf, radius), strict=True):
        low, high = np.searchsorted(at, at - within, "left"), np.searchsorted(at, at + within, "right")
        starts, ends = low[high - low > 1], high[high - low > 1]
        edges = np.bincount(starts, minlength=at.size + 1) - np.bincount(ends, minlength=at.size + 1)
        chosen |= np.cumsum(edges)[: at.size] > 0
    return chosen
