"""Invariant blocks of the matrices on short intervals: mu that can meet are kept together, others are separated.

On an interval the matrix K(s) has eigenvalues mu that stay apart from one another and some that may meet. With the
eigenvectors at its middle as coordinates K is nearly diagonal, and a basis T(s) with unit diagonal blocks makes it
block diagonal at each node: K T = T L. T is analytic as long as no mu of one block meets one of another (Kato 1966,
chapter II), so that a few nodes give the blocks everywhere: L, and the forms of P and Q on them. A block of one or two
mu is then a handful of numbers with all of the stability in them. Columns of T are computed only where something can
happen: for mu that may meet others, that come near -1 or 0, or that are outside.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.decoupling import (
    MIDDLE_NODE,
    SERIES_DEGREE,
    Booleans,
    Forms,
    Indices,
    Numbers,
    applied,
    contracts,
    decoupled,
)
from casadi_skin.zero.problem import Array

MEETING_HALF_LENGTHS = (
    1.3  # half-lengths of an interval from its middle to where two mu of different blocks would meet, at least
)
COUPLING_RATIO = 0.35  # of the distance of two mu: a coupling that puts them into one block
RESOLVED_BLOCK_ERROR = (
    1e-13  # error of a block that a meeting outside the interval may make, as expected from its distance
)
PARALLEL_COSINE = 0.999  # cosine of two eigenvectors that are replaced by their sum and difference
CLOSE_TO_END = 1e-3  # to -1 or 0: a mu there is looked at
REAL_MU_ATOL = 1e-13  # imaginary part of a mu, below which rounding may have made it
REGULAR_CONDITION = 1e8  # condition number of eigenvectors up to which they serve as coordinates
LARGEST_BLOCK = 6  # mu in a block that is taken out of a larger matrix, or a quarter of that
PAIRS_AT_A_TIME = 20_000  # of mu at nodes of intervals that are compared at a time: they stay in the cache of a core
CLEAR_DISTANCE_FACTOR = 2.0  # times the shift of a mu by couplings: a distance from -1 and 0 that it does not cross


@dataclass(frozen=True)
class Blocks:
    """Blocks in which something can happen, on several intervals; m mu in all, c columns, J nodes.

    `labels` (intervals, m) hold the block of each mu; `columns` (intervals, c) are the mu of the columns, -1 where an
    interval has fewer, and `forms` K, P and Q on them. `real` (intervals, m) marks the mu with real columns. Where
    `done` is False an interval is too long. `mu`, eigenvectors as columns of `vectors`, and the `rates` of mu per half
    of the interval are those at the middle; `basis` are these vectors made real and apart, with its `inverse`, and
    `near` marks the mu that may come to -1 or 0.
    """

    labels: Indices
    columns: Indices
    forms: Forms
    real: Booleans
    done: Booleans
    mu: ComplexArray
    vectors: Numbers
    rates: Numbers
    basis: Numbers
    inverse: Numbers
    near: Booleans

    def members(self) -> Iterator[tuple[Indices, Indices]]:
        """Blocks by their numbers of mu, where `done`: their intervals (b,) and the places of columns, (b, m)."""
        i, places = np.nonzero((self.columns >= 0) & self.done[:, None])
        blocks = i * self.labels.shape[1] + self.labels[i, self.columns[i, places]]
        order = np.argsort(blocks, kind="stable")
        _, firsts, counts = np.unique(blocks[order], return_index=True, return_counts=True)
        for count in np.unique(counts).tolist():
            those = order[firsts[counts == count][:, None] + np.arange(count)]
            yield i[those[:, 0]], places[those]

    def finer(self, chosen: Indices, columns: Indices, matrices: Array) -> tuple[Numbers, Booleans]:
        """Some columns of some intervals anew, from the matrices at the nodes of a higher degree.

        Arguments:
            chosen: numbers of the intervals.
            columns: mu of whole blocks, shape (intervals, c), -1 behind them.
            matrices: shape (intervals, J, 3 or 1, m, m).

        Returns:
            Their parts (intervals, J, 3 or 1, c, c), and for which intervals these are found.
        """
        labels = self.labels[chosen]
        same, basis, inverse = labels[:, :, None] == labels[:, None, :], self.basis[chosen], self.inverse[chosen]
        K = inverse[:, None] @ applied(matrices[:, :, 0], basis[:, None])
        forms = decoupled(K, same, columns, self.near[chosen], basis, inverse, matrices, None, np.arange(len(matrices)))
        return forms.values, forms.found


def blocks_of(matrices: Array, errors: Array) -> list[tuple[Indices, Blocks]]:
    """Take K apart on several intervals.

    Arguments:
        matrices: K, P and Q, or K alone, at the nodes of each interval, shape (intervals, DEGREE + 1, 3 or 1, m, m).
        errors: matrices like their errors.

    Returns:
        Blocks of mu that cannot meet those of other blocks within the interval; of the intervals with complex mu at the
        middle apart from the others, each with the numbers of its intervals.
    """
    mu, vectors = np.linalg.eig(matrices[:, MIDDLE_NODE, 0])
    real = np.abs(mu.imag) <= REAL_MU_ATOL
    found = []
    for chosen in (np.flatnonzero(real.all(axis=1)), np.flatnonzero(~real.all(axis=1))):
        if chosen.size:
            basis = vectors[chosen].real if real[chosen[0]].all() else vectors[chosen]
            found.append((chosen, _blocks(matrices, errors, chosen, mu[chosen], basis.copy(), real[chosen])))
    return found


def _blocks(
    matrices: Array, errors: Array, chosen: Indices, mu: ComplexArray, vectors: Numbers, real: Booleans
) -> Blocks:
    """Blocks of chosen intervals, from the eigenvalues and eigenvectors at the middle, `real` or complex."""
    original, here = vectors.copy(), matrices[:, :, 0] if chosen.size == len(matrices) else matrices[chosen, :, 0]
    glued = _separate_parallel(vectors, mu, real)
    K, inverse, fine = _similar(here, vectors)
    diagonal = np.diagonal(K, axis1=2, axis2=3)
    rates = chebyshev.middle_slope(SERIES_DEGREE) @ diagonal
    same, shifts = _graph(K, glued)
    while (conjugate := ~real & _conjugates_together(mu, same)).any():  # in real coordinates more may be joined
        _make_real(vectors, mu, conjugate)
        real = real | conjugate
        K, inverse, fine = _similar(here, vectors)
        same, shifts = _graph(K, same)
    counts = np.sum(same, axis=2)
    fine &= np.max(counts, axis=1) <= _most(mu.shape[1])
    near = _near_the_ends(np.diagonal(K, axis1=2, axis2=3).real, shifts)
    near = np.any(same & near[:, None, :], axis=2)
    fine[fine] = contracts(K[fine], same[fine])
    columns = _columns(((counts > 1) | ~real | near) & fine[:, None])
    if fine.all():
        forms = decoupled(K, same, columns, near, vectors, inverse, matrices, errors, chosen)
    else:
        i = np.flatnonzero(fine)
        some = K[i], same[i], columns[i], near[i], vectors[i], inverse[i]
        forms = decoupled(*some, matrices, errors, chosen[i]).among(fine)
    return Blocks(
        labels=np.argmax(same, axis=2),
        columns=columns,
        forms=forms,
        real=real,
        done=forms.found,
        mu=np.asarray(mu, dtype=complex),
        vectors=original,
        rates=rates,
        basis=vectors,
        inverse=inverse,
        near=near,
    )


def comes_apart(matrices: Array) -> bool:
    """Whether the blocks on an interval are small: K at its nodes, shape (DEGREE + 1, m, m)."""
    mu, vectors = np.linalg.eig(matrices[MIDDLE_NODE])
    basis = vectors[None].copy()
    glued = _separate_parallel(basis, mu[None], np.abs(mu.imag)[None] <= REAL_MU_ATOL)
    K, _, fine = _similar(matrices[None], basis)
    same, _ = _graph(K, glued)
    return bool(fine[0] and np.max(np.sum(same, axis=2)) <= _most(mu.size) and contracts(K, same)[0])


def _most(size: int) -> int:
    """Mu in a block that is taken out of matrices of a size."""
    return max(2, size - 1) if size <= LARGEST_BLOCK else max(LARGEST_BLOCK, size // 4)


# Coordinates --------------------------------------------------------------------------------------------------------


def _similar(matrices: Array, vectors: Numbers) -> tuple[Numbers, Numbers, Booleans]:
    """K in the coordinates of its vectors, the inverse of these, and whether it has digits left."""
    try:
        inverse = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        regular = np.linalg.matrix_rank(vectors) == vectors.shape[-1]
        vectors = np.where(regular[:, None, None], vectors, np.eye(vectors.shape[-1]))
        inverse = np.linalg.inv(vectors)
    regular = np.linalg.norm(inverse, axis=(1, 2)) < REGULAR_CONDITION
    return inverse[:, None] @ applied(matrices, vectors[:, None]), inverse, regular


def _separate_parallel(vectors: Numbers, mu: ComplexArray, real: Booleans) -> Booleans:
    """Replace pairs of nearly parallel vectors by sum and difference; who belongs together, (intervals, m, m)."""
    overlaps = vectors.conj().swapaxes(1, 2) @ vectors
    together = (np.abs(overlaps) > PARALLEL_COSINE) | np.eye(vectors.shape[-1], dtype=bool)
    for i, a, b in np.argwhere(np.triu(together, 1)).tolist():
        turned = vectors[i, :, b] * np.conj(overlaps[i, a, b]) / abs(overlaps[i, a, b])
        total, difference = vectors[i, :, a] + turned, vectors[i, :, a] - turned
        if abs(mu[i, a] - mu[i, b].conj()) <= 1e-9 and not real[i, a]:
            # Two conjugate vectors, but for a factor: real and imaginary part after that is divided out.
            phase = np.sqrt(total @ total)
            total, difference = (total / phase).real, (difference / phase).imag
            real[i, [a, b]] = True
        vectors[i, :, a] = total / np.linalg.norm(total)
        vectors[i, :, b] = difference / (np.linalg.norm(difference) or 1.0)
    return np.asarray(together)


def _conjugates_together(mu: ComplexArray, same: Booleans) -> Booleans:
    """Which complex mu are in one block with their conjugate."""
    partners = (np.abs(mu[:, :, None] - mu[:, None, :].conj()) <= 1e-9) & (mu.imag[:, :, None] != 0.0)
    return np.asarray(np.any(partners & same, axis=2))


def _make_real(vectors: Numbers, mu: ComplexArray, chosen: Booleans) -> None:
    """Replace pairs of conjugate vectors by their real and imaginary parts, at right angles to each other."""
    for i, a in np.argwhere(chosen & (mu.imag > 0.0)).tolist():
        b = int(np.argmin(np.abs(mu[i] - mu[i, a].conj())))
        phase = np.sqrt(vectors[i, :, a] @ vectors[i, :, a])
        turned = vectors[i, :, a] / (phase / abs(phase) if abs(phase) > 0.0 else 1.0)
        vectors[i, :, a] = turned.real / np.linalg.norm(turned.real)
        vectors[i, :, b] = turned.imag / np.linalg.norm(turned.imag)


# Who belongs together -----------------------------------------------------------------------------------------------


def _graph(K: Numbers, glued: Booleans) -> tuple[Booleans, Array]:
    """Which mu have to stay in one block, (intervals, m, m), and what the others move each by, (intervals, m)."""
    diagonal = np.diagonal(K, axis1=2, axis2=3)
    size = diagonal.shape[-1]
    middle = diagonal[:, MIDDLE_NODE, :, None] - diagonal[:, MIDDLE_NODE, None, :]
    distance = np.abs(middle)
    nearest, farthest, coupling = distance.copy(), np.zeros(distance.shape), np.zeros(distance.shape)
    step = max(1, PAIRS_AT_A_TIME // distance.size)
    for first in range(0, diagonal.shape[1], step):
        nodes = slice(first, first + step)
        difference = diagonal[:, nodes, :, None] - diagonal[:, nodes, None, :]
        np.minimum(nearest, np.min(np.abs(difference), axis=1), out=nearest)
        np.maximum(farthest, np.max(np.abs(difference - middle[:, None]), axis=1), out=farthest)
        products = np.abs(K[:, nodes] * K[:, nodes].swapaxes(2, 3))
        np.maximum(coupling, np.max(products, axis=1), out=coupling)
    away = np.clip(distance / np.maximum(farthest, 1e-300), 1.0, 1e3)
    expected = coupling * away**2 / np.maximum(distance, 1e-300) * (away + np.sqrt(away**2 - 1.0)) ** -SERIES_DEGREE
    joined = (
        (distance < MEETING_HALF_LENGTHS * farthest)
        | (coupling > (COUPLING_RATIO * nearest) ** 2)
        | (expected > RESOLVED_BLOCK_ERROR)
        | glued
    )
    joined |= np.eye(size, dtype=bool)
    for _ in range(int(np.ceil(np.log2(max(size, 2))))):  # whoever is joined through others
        more = (joined.astype(np.float32) @ joined.astype(np.float32)) > 0.5
        if np.array_equal(more, joined):
            break
        joined = more
    with np.errstate(divide="ignore", invalid="ignore"):
        shifts = np.sum(np.where(joined, 0.0, coupling / nearest), axis=2)
    return joined, shifts


def _near_the_ends(diagonal: Array, shifts: Array) -> Booleans:
    """Which mu may come to -1 or 0 within an interval, or are outside; diagonal (intervals, J, m) -> (intervals, m)."""
    low, high = np.min(diagonal, axis=1), np.max(diagonal, axis=1)
    room = np.minimum(low + 1.0, -high)
    return np.asarray(room <= CLEAR_DISTANCE_FACTOR * shifts + 0.25 * (high - low) + CLOSE_TO_END)


def _columns(needed: Booleans) -> Indices:
    """The mu that are needed, in order, -1 behind them; (intervals, m) -> (intervals, c)."""
    most = int(np.max(np.sum(needed, axis=1), initial=1))
    columns = np.full((len(needed), max(most, 1)), -1, dtype=np.int64)
    for i, row in enumerate(needed):
        chosen = np.flatnonzero(row)
        columns[i, : chosen.size] = chosen
    return columns
