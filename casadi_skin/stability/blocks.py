"""Invariant blocks of the matrices on short intervals: what can meet is kept together, what cannot is taken apart.

On an interval the matrix K(s) has eigenvalues mu that stay apart from one another and some that may meet. With the
eigenvectors at its middle as coordinates K is nearly diagonal, and a basis T(s) with unit diagonal blocks makes it
block diagonal at each node: K T = T L. T is analytic as long as no mu of one block meets one of another (Kato 1966,
chapter II), so that a few nodes give the blocks everywhere: L, and the forms of P and Q on them. A block of one or two mu
is then a handful of numbers with all of the stability in them. Columns of T are computed only where something can
happen: for mu that may meet others, that come near -1 or 0, or that are outside.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.stability import chebyshev
from casadi_skin.stability.reduction import ComplexArray

DEGREE = 16  # of the series on an interval
MIDDLE = DEGREE // 2
APART = 1.3  # half-lengths of an interval from its middle to where two mu of different blocks would meet, at least
COUPLED = 0.35  # of the distance of two mu: a coupling that puts them into one block
RESOLVED = 1e-13  # error of a block that a meeting outside the interval may make, as expected from its distance
PARALLEL = 0.999  # cosine of two eigenvectors that are replaced by their sum and difference
ITERATIONS = 60
CONVERGED = 1e-13
CONTRACTING = 0.5  # of the first step to the last of a few more, for all mu
STEPS = 3
SMALL = 1e-3  # steps below this contract
REAL = 1e-13  # imaginary part of a mu, below which rounding may have made it
REGULAR = 1e8  # condition number of eigenvectors up to which they serve as coordinates
LARGEST = 6  # mu in a block that is taken out of a larger matrix, or a quarter of that
CLEAR = 2.0  # times what couplings move a mu by: a distance from -1 and 0 that it does not cross

Booleans = NDArray[np.bool_]
Numbers = Array | ComplexArray


@dataclass(frozen=True)
class Blocks:
    """Blocks in which something can happen, on several intervals; m mu in all, c columns, J nodes.

    `labels` (intervals, m) tell the block of each mu; `columns` (intervals, c) are the mu of the columns, -1 where an
    interval has fewer. `cosine` (intervals, J, c, c) holds L, `right` (intervals, J, m, c) and `left` (intervals, J, c, m)
    the bases with left @ K @ right = L. `real` (intervals, m) tells which mu have real columns. Where `done` is False
    an interval is too long. `mu`, eigenvectors as columns of `vectors`, and the `rates` of mu per half of the interval are
    those at the middle.
    """

    labels: NDArray[np.int64]
    columns: NDArray[np.int64]
    cosine: Numbers
    right: Numbers
    left: Numbers
    real: Booleans
    done: Booleans
    mu: ComplexArray
    vectors: Numbers
    rates: Numbers

    def parts(self, matrices: Array) -> Numbers:
        """K, P and Q, or K alone, on the columns: (intervals, J, 3 or 1, m, m) -> (intervals, J, 3 or 1, c, c)."""
        X, Y = self.right, self.left
        parts = [Y @ matrices[:, :, 0] @ X]
        if matrices.shape[2] == 3:
            parts += [X.swapaxes(2, 3) @ matrices[:, :, 1] @ X, Y @ matrices[:, :, 2] @ Y.swapaxes(2, 3)]
        return np.stack(parts, axis=2)


def blocks_of(matrices: Array) -> list[tuple[NDArray[np.int64], Blocks]]:
    """Take K apart on several intervals.

    Arguments:
        matrices: K, P and Q, or K alone, at the nodes of each interval, shape (intervals, DEGREE + 1, 3 or 1, m, m).

    Returns:
        Blocks of mu that cannot meet those of other blocks within the interval; of the intervals with complex mu at the
        middle apart from the others, each with the numbers of its intervals.
    """
    mu, vectors = np.linalg.eig(matrices[:, MIDDLE, 0])
    real = np.abs(mu.imag) <= REAL
    found = []
    for chosen in (np.flatnonzero(real.all(axis=1)), np.flatnonzero(~real.all(axis=1))):
        if chosen.size:
            basis = vectors[chosen].real if real[chosen[0]].all() else vectors[chosen]
            found.append((chosen, _blocks(matrices[chosen], mu[chosen], basis.copy(), real[chosen])))
    return found


def _blocks(matrices: Array, mu: ComplexArray, vectors: Numbers, real: Booleans) -> Blocks:
    """Blocks from the eigenvalues and eigenvectors at the middle, `real` or complex."""
    original = vectors.copy()
    glued = _separate_parallel(vectors, mu, real)
    K, inverse, fine = _similar(matrices[:, :, 0], vectors)
    diagonal = np.diagonal(K, axis1=2, axis2=3)
    rates = np.tensordot(chebyshev.middle_slope(DEGREE), diagonal.swapaxes(0, 1), 1)
    same, shifts = _graph(K, glued)
    conjugate = ~real & _conjugates_together(mu, same)
    if conjugate.any():
        _make_real(vectors, mu, conjugate)
        real = real | conjugate
        K, inverse, fine = _similar(matrices[:, :, 0], vectors)
        same, shifts = _graph(K, same)
    counts = np.sum(same, axis=2)
    fine &= np.max(counts, axis=1) <= _most(mu.shape[1])
    near = _near_the_ends(np.diagonal(K, axis1=2, axis2=3).real, shifts)
    near = np.any(same & near[:, None, :], axis=2)
    fine[fine] = _contracts(K[fine], same[fine])
    columns = _columns(((counts > 1) | ~real | near) & fine[:, None])
    right = np.zeros((*K.shape[:3], columns.shape[1]), dtype=K.dtype)
    left, cosine = right.swapaxes(2, 3).copy(), np.zeros((*K.shape[:2], *2 * columns.shape[1:]), dtype=K.dtype)
    if fine.any():
        i = np.flatnonzero(fine)
        bases = _bases(K[i], same[i], columns[i], near[i], vectors[i], inverse[i], matrices[i])
        right[i], left[i], cosine[i], fine[i] = bases
    right[~fine], left[~fine], cosine[~fine] = 0.0, 0.0, 0.0
    scale = np.sqrt(np.linalg.norm(left[:, MIDDLE], axis=2))[:, None]
    scale[scale == 0.0] = 1.0
    return Blocks(
        labels=np.argmax(same, axis=2),
        columns=columns,
        cosine=cosine / scale[..., :, None] * scale[..., None, :],
        right=right * scale[..., None, :],
        left=left / scale[..., :, None],
        real=real,
        done=fine,
        mu=np.asarray(mu, dtype=complex),
        vectors=original,
        rates=rates,
    )


def comes_apart(matrices: Array) -> bool:
    """Whether the blocks on an interval are small: K at its nodes, shape (DEGREE + 1, m, m)."""
    mu, vectors = np.linalg.eig(matrices[MIDDLE])
    basis = vectors[None].copy()
    glued = _separate_parallel(basis, mu[None], np.abs(mu.imag)[None] <= REAL)
    K, _, fine = _similar(matrices[None], basis)
    same, _ = _graph(K, glued)
    return bool(fine[0] and np.max(np.sum(same, axis=2)) <= _most(mu.size) and _contracts(K, same)[0])


def _most(size: int) -> int:
    """Mu in a block that is taken out of matrices of a size."""
    return max(2, size - 1) if size <= LARGEST else max(LARGEST, size // 4)


# Coordinates --------------------------------------------------------------------------------------------------------


def _similar(matrices: Array, vectors: Numbers) -> tuple[Numbers, Numbers, Booleans]:
    """K in the coordinates of its vectors, the inverse of these, and whether it has digits left."""
    try:
        inverse = np.linalg.inv(vectors)
    except np.linalg.LinAlgError:
        regular = np.linalg.matrix_rank(vectors) == vectors.shape[-1]
        vectors = np.where(regular[:, None, None], vectors, np.eye(vectors.shape[-1]))
        inverse = np.linalg.inv(vectors)
    regular = np.linalg.norm(inverse, axis=(1, 2)) < REGULAR
    return inverse[:, None] @ matrices @ vectors[:, None], inverse, regular


def _separate_parallel(vectors: Numbers, mu: ComplexArray, real: Booleans) -> Booleans:
    """Replace pairs of nearly parallel vectors by sum and difference; who belongs together, (intervals, m, m)."""
    overlaps = vectors.conj().swapaxes(1, 2) @ vectors
    together = (np.abs(overlaps) > PARALLEL) | np.eye(vectors.shape[-1], dtype=bool)
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
    return together


def _conjugates_together(mu: ComplexArray, same: Booleans) -> Booleans:
    """Which complex mu are in one block with their conjugate."""
    partners = (np.abs(mu[:, :, None] - mu[:, None, :].conj()) <= 1e-9) & (mu.imag[:, :, None] != 0.0)
    return np.asarray(np.any(partners & same, axis=2))


def _make_real(vectors: ComplexArray, mu: ComplexArray, chosen: Booleans) -> None:
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
    middle = diagonal[:, MIDDLE, :, None] - diagonal[:, MIDDLE, None, :]
    distance = np.abs(middle)
    nearest, farthest, coupling = distance.copy(), np.zeros(distance.shape), np.zeros(distance.shape)
    for node in range(diagonal.shape[1]):  # pair by pair, without an array of all nodes and pairs at once
        difference = diagonal[:, node, :, None] - diagonal[:, node, None, :]
        np.minimum(nearest, np.abs(difference), out=nearest)
        np.maximum(farthest, np.abs(difference - middle), out=farthest)
        np.maximum(coupling, np.abs(K[:, node] * K[:, node].swapaxes(1, 2)), out=coupling)
    away = np.clip(distance / np.maximum(farthest, 1e-300), 1.0, 1e3)
    expected = coupling * away**2 / np.maximum(distance, 1e-300) * (away + np.sqrt(away**2 - 1.0)) ** -DEGREE
    joined = (distance < APART * farthest) | (coupling > (COUPLED * nearest) ** 2) | (expected > RESOLVED) | glued
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
    return np.asarray(room <= CLEAR * shifts + 0.25 * (high - low) + SMALL)


def _columns(needed: Booleans) -> NDArray[np.int64]:
    """The mu that are needed, in order, -1 behind them; (intervals, m) -> (intervals, c)."""
    most = int(np.max(np.sum(needed, axis=1), initial=1))
    columns = np.full((len(needed), max(most, 1)), -1, dtype=np.int64)
    for i, row in enumerate(needed):
        chosen = np.flatnonzero(row)
        columns[i, : chosen.size] = chosen
    return columns


# Decoupling ---------------------------------------------------------------------------------------------------------


def _weights(K: Numbers, same: Booleans) -> Numbers:
    """1 / (mu_b - mu_a) between blocks, 0 inside of them; shape of K."""
    diagonal = np.diagonal(K, axis1=2, axis2=3)
    gaps = diagonal[:, :, None, :] - diagonal[:, :, :, None]
    inside = same[:, None] | (gaps == 0.0)
    return np.where(inside, 0.0, 1.0 / np.where(inside, 1.0, gaps))


def _contracts(K: Numbers, same: Booleans) -> Booleans:
    """Whether the iteration for T converges for all mu of an interval, by its first steps at the ends."""
    K = K[:, [0, -1]]
    weights, inside = _weights(K, same), same[:, None]
    first = T = K * weights
    for _ in range(STEPS):
        product = K + K @ T
        block = np.where(inside, product, 0.0)
        step = (product - block - T @ block) * weights
        T = T + step
    before, after = np.max(np.abs(first), axis=2), np.max(np.abs(step), axis=2)
    return np.asarray(np.all(after <= CONTRACTING * np.maximum(before, SMALL), axis=(1, 2)))


def _bases(
    K: Numbers,
    same: Booleans,
    columns: NDArray[np.int64],
    near: Booleans,
    vectors: Numbers,
    inverse: Numbers,
    matrices: Array,
) -> tuple[Numbers, Numbers, Numbers, Booleans]:
    """Right and left bases of the columns, L, and for which intervals they are found.

    Since P K is symmetric, P makes left bases of right ones, but for mu near -1 and 0, where it is nearly singular.
    """
    T, cosine, found = _invariant(K, same, columns)
    right = vectors[:, None] @ T
    if matrices.shape[2] == 1:
        near = np.ones_like(near)
        rows = np.zeros_like(right.swapaxes(2, 3))
    else:
        rows = right.swapaxes(2, 3) @ matrices[:, :, 1]
    valid = columns >= 0
    special = valid & np.take_along_axis(near, np.where(valid, columns, 0), axis=1)
    if special.any():
        some = _columns_of(columns, special)
        S, _, by_left = _invariant(K.swapaxes(2, 3), same, some)
        found &= by_left
        own = S.swapaxes(2, 3) @ inverse[:, None]
        for i in range(len(K)):
            rows[i][:, special[i]] = own[i][:, : np.count_nonzero(special[i])]
    products = np.where(_within(same, columns)[:, None], rows @ right, 0.0)
    found &= np.all(np.isfinite(products), axis=(1, 2, 3))
    products[~found] = 0.0
    idle = ~np.any(products != 0.0, axis=3)
    products[..., range(products.shape[2]), range(products.shape[2])] += idle
    return right, np.linalg.solve(products, rows), cosine, found


def _columns_of(columns: NDArray[np.int64], chosen: Booleans) -> NDArray[np.int64]:
    """Chosen columns in order, -1 behind them."""
    found = np.full((len(columns), int(np.max(np.sum(chosen, axis=1)))), -1, dtype=np.int64)
    for i, (row, which) in enumerate(zip(columns, chosen, strict=True)):
        found[i, : np.count_nonzero(which)] = row[which]
    return found


def _within(same: Booleans, columns: NDArray[np.int64]) -> Booleans:
    """Which columns are of one block, shape (intervals, c, c)."""
    valid = columns >= 0
    places = np.where(valid, columns, 0)
    each = np.arange(len(columns))[:, None, None]
    return np.asarray(same[each, places[:, :, None], places[:, None, :]] & valid[:, :, None] & valid[:, None, :])


def _invariant(K: Numbers, same: Booleans, columns: NDArray[np.int64]) -> tuple[Numbers, Numbers, Booleans]:
    """Columns of T with unit blocks and L with K T = T L at each node, and for which intervals they converged.

    From the middle, where T is the identity, to ever finer sets of nodes, each from what the last set predicts.
    """
    intervals, count, size = K.shape[:3]
    valid = columns >= 0
    places = np.where(valid, columns, 0)
    each = np.arange(intervals)[:, None]
    diagonal = np.diagonal(K, axis1=2, axis2=3)
    gaps = diagonal[each, :, places].transpose(0, 2, 1)[:, :, None, :] - diagonal[:, :, :, None]
    skipped = (same[each, places].swapaxes(1, 2) | ~valid[:, None, :])[:, None] | (gaps == 0.0)
    weights = np.where(skipped, 0.0, 1.0 / np.where(skipped, 1.0, gaps))
    inner = _within(same, columns)
    T = np.zeros((intervals, count, size, columns.shape[1]), dtype=K.dtype)
    T[each, MIDDLE, places, np.arange(columns.shape[1])] = valid
    L = np.zeros((*T.shape[:2], *2 * columns.shape[1:]), dtype=K.dtype)
    product = np.take_along_axis(K[:, MIDDLE] @ T[:, MIDDLE], places[:, :, None], axis=1)
    L[:, MIDDLE] = np.where(inner, product, 0.0)
    done = np.ones(intervals, dtype=bool)
    for known, wanted, prediction in nested_nodes():
        guess = np.tensordot(T[:, known], prediction, (1, 1)).transpose(0, 3, 1, 2)
        found = _iterated(K[:, wanted], guess, weights[:, wanted], places, inner)
        T[:, wanted], L[:, wanted] = found[0], found[1]
        done &= found[2]
    return T, L, done


@cache
def nested_nodes() -> tuple[tuple[slice | NDArray[np.int64], NDArray[np.int64], Array], ...]:
    """Nodes known, nodes wanted, and the matrix that predicts these from those, from the middle on."""
    found = []
    step = DEGREE
    known: NDArray[np.int64] = np.array([MIDDLE])
    while step >= 1:
        every = np.arange(0, DEGREE + 1, step)
        wanted = np.setdiff1d(every, known)
        degree = known.size - 1
        if degree == 0:
            prediction = np.ones((wanted.size, 1))
        else:
            prediction = chebyshev.basis(chebyshev.nodes(DEGREE)[wanted], degree) @ chebyshev.transform(degree)
        found.append((known, wanted, prediction))
        known, step = np.union1d(known, every), step // 2 if step < DEGREE else DEGREE // 4
    return tuple(found)


def _iterated(
    K: Numbers, T: Numbers, weights: Numbers, places: NDArray[np.int64], inner: Booleans
) -> tuple[Numbers, Numbers, Booleans]:
    """T and L from a guess of T, by Newton's method without couplings inside a block, so that it converges linearly."""
    shape, (size, width) = T.shape[:2], T.shape[2:]
    T = np.ascontiguousarray(T).reshape(-1, size, width)
    L = np.zeros((len(T), width, width), dtype=T.dtype)
    converged = np.zeros(len(T), dtype=bool)
    active = np.arange(len(T))
    here, turn, weights = K.reshape(-1, size, size), T.copy(), weights.reshape(-1, size, width)
    rows, numbers = np.repeat(places, shape[1], axis=0), np.arange(len(T))[:, None]
    inner = np.repeat(inner, shape[1], axis=0).astype(float)
    for _ in range(ITERATIONS):
        product = here @ turn
        block = product[numbers[: len(rows)], rows]
        block *= inner
        with np.errstate(over="ignore", invalid="ignore"):
            product -= turn @ block
            step = np.multiply(product, weights, out=product)
            turn += step
            largest = np.max(np.abs(step), axis=(1, 2), initial=0.0)
        T[active], L[active], converged[active] = turn, block, largest <= CONVERGED
        going = (largest > CONVERGED) & (largest < 1.0)
        if not going.any():
            break
        if not going.all():
            active, here, turn, weights = active[going], here[going], turn[going], weights[going]
            rows, inner = rows[going], inner[going]
    return T.reshape(*shape, size, width), L.reshape(*shape, width, width), converged.reshape(shape).all(axis=1)
