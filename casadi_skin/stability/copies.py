"""Matrices along a branch that a symmetry of its orbits makes copies of smaller ones: each of these once.

The symmetries need not be known: the eigenspaces of one random symmetric combination of all matrices are their
smallest building blocks, and where blocks of k rows are coupled by multiples of orthogonal matrices alone, a basis
makes k copies of one smaller set of matrices (Murota, Kanno, Kojima and Kojima 2010). Multipliers that are equal on the
whole branch are so taken apart exactly; what the copies differ by is added to the noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from scipy.sparse.csgraph import connected_components

from casadi_skin.stability.tongues.interpolation import MatrixSeries
from casadi_skin.zero.problem import Array

COMBINATIONS = 4  # random ones, that couple what any of the matrices couples
EQUAL = 1e-7  # distance of eigenvalues that are one, relative to the largest
PLACES = np.array([0.21, 0.5, 0.83])  # of the series
COUPLED = 1e-10  # entries relative to the largest: smaller ones are noise
ALIKE = 1e-9  # difference of copies, relative to the largest entries: noise of orbits and flows


def without_copies(series: MatrixSeries) -> list[MatrixSeries]:
    """A series, or where symmetries repeat its multipliers smaller ones with each of these once."""
    if series.size < 2:
        return [series]
    sizes = np.max(np.abs(series.coefficients), axis=(0, 2, 3))
    matrices = (series.coefficients / np.maximum(sizes, np.finfo(float).tiny)[:, None, None]).reshape(
        -1, series.size, series.size
    )
    weights = np.random.default_rng(0).normal(size=(COMBINATIONS, len(matrices)))
    combined = np.tensordot(weights, matrices, 1)
    values, vectors = np.linalg.eigh(combined[0] + combined[0].T)
    apart = np.flatnonzero(np.diff(values) > EQUAL * np.max(np.abs(values))) + 1
    if apart.size == series.size - 1 and not _repeats(series):
        return [series]
    spaces = [slice(a, b) for a, b in pairwise([0, *apart.tolist(), series.size])]
    entries = vectors.T @ np.concatenate([combined, combined.swapaxes(1, 2)]) @ vectors
    found: list[MatrixSeries] = []
    for group in _coupled(entries, spaces):
        copies = _copies(entries, group)
        once = None if copies is None else _restricted(series, [vectors @ basis for basis in copies])
        every = np.hstack([vectors[:, space] for space in group])
        found.append(once or _restricted(series, [every], np.inf) or series)
    return found


def _repeats(series: MatrixSeries) -> bool:
    """Whether two mu are equal at several places: symmetries in time as well as space do that without copies."""
    mu = np.linalg.eigvals(series.at(series.start + PLACES * (series.end - series.start), 1)[:, 0]).astype(complex)
    apart = np.abs(mu[:, :, None] - mu[:, None, :]) + np.eye(series.size)
    return bool(np.all(np.min(apart, axis=(1, 2)) <= EQUAL))


def _coupled(entries: Array, spaces: Sequence[slice]) -> Iterator[list[slice]]:
    """The eigenspaces in groups that nothing couples to each other; `entries` are those of matrices in their basis."""
    starts = [space.start for space in spaces]
    blocks = np.maximum.reduceat(np.maximum.reduceat(np.max(np.abs(entries), axis=0), starts, 0), starts, 1)
    count, part = connected_components(blocks > COUPLED * np.max(blocks))
    for k in range(count):
        yield [spaces[i] for i in np.flatnonzero(part == k).tolist()]


def _copies(entries: Array, group: Sequence[slice]) -> list[Array] | None:
    """The bases of the copies that a group of eigenspaces of one size is, as columns; None where there is one.

    Each eigenspace is turned so that the largest block that couples it to those before is a multiple of the identity.
    """
    count = group[0].stop - group[0].start
    if count == 1 or any(space.stop - space.start != count for space in group):
        return None
    turned = {0: np.eye(count)}
    while len(turned) < len(group):
        blocks = [
            (turned[i].T @ entries[:, group[i], space], j)
            for i in turned
            for j, space in enumerate(group)
            if j not in turned
        ]
        block, j = max(
            ((max(each, key=lambda one: float(np.linalg.norm(one))), j) for each, j in blocks),
            key=lambda pair: float(np.linalg.norm(pair[0])),
        )
        left, _, right = np.linalg.svd(block)
        turned[j] = (left @ right).T
    bases = np.zeros((count, entries.shape[1], len(group)))
    for j, turn in turned.items():
        bases[:, group[j], j] = turn.T
    return list(bases)


def _restricted(series: MatrixSeries, copies: Sequence[Array], alike: float = ALIKE) -> MatrixSeries | None:
    """The mean of the copies, with what they differ by as noise; None where they are not `alike`."""
    parts = [basis.T @ series.coefficients @ basis for basis in copies]
    mean = np.mean(parts, axis=0)
    rest = np.zeros_like(series.noise)
    for basis in copies:
        right = np.linalg.norm(series.coefficients @ basis - basis @ mean, axis=(2, 3))
        left = np.linalg.norm(basis.T @ series.coefficients - mean @ basis.T, axis=(2, 3))
        rest = np.maximum(rest, np.sum(np.maximum(right, left), axis=0))
    if np.any(rest > alike * np.max(np.abs(series.coefficients), axis=(0, 2, 3))):
        return None
    errors = copies[0].T @ series.errors @ copies[0]
    return MatrixSeries(series.start, series.end, mean, errors, series.noise + rest)
