"""Invariant blocks of the matrices on short intervals: mu that can meet are kept together, others are separated.

On an interval the matrix K(s) has eigenvalues mu that stay apart from one another and some that may meet. With the
eigenvectors at its middle as coordinates K is nearly diagonal, and a basis T(s) with unit diagonal blocks makes it
block diagonal at each node: K T = T L. T is analytic as long as no mu of one block meets one of another (Kato 1966,
chapter II), so that a few nodes give the blocks everywhere: L, and the forms of P and Q on them. A block of one or two
mu is then a handful of numbers with all of the stability in them. Columns of T are computed only where something can
happen: for mu that may meet others, that come near -1 or 0, or that are outside.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin import native
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.chebyshev import SERIES_DEGREE
from casadi_skin.zero.problem import Array, Indices

# Matrices between bases that make them block diagonal at each node of an interval, from their eigenvectors ------------

MIDDLE_NODE = SERIES_DEGREE // 2
MOST_ITERATIONS = 60
CONVERGED_STEP = 1e-9  # of a step: blocks are taken between left and right bases, whose errors they have multiplied
PROBE_NODES = np.arange(0, SERIES_DEGREE + 1, SERIES_DEGREE // 4)  # nodes at which the separation of all mu is tested
MOST_STEPS = 12  # at most, until all of one are small
SMALL_STEP = 1e-3  # steps below this converge
LARGEST_STEP = 1e3  # step of an iteration that converges
BETWEEN_DEGREE = 32  # degree of the nodes at which distances are looked at between the probes
NEARER_SQUARE_RATIO = 0.25  # of the least square of a distance at the probes: the least one between them

Booleans = NDArray[np.bool_]
Numbers = NDArray[Any]  # real or complex


def applied(matrices: Array, columns: Numbers) -> Numbers:
    """Real matrices times columns, those of complex ones as pairs of real ones: half the operations."""
    if columns.dtype.kind != "c":
        return np.asarray(matrices @ columns)
    return np.asarray((matrices @ np.ascontiguousarray(columns).view(float)).view(complex))


def contracts(K: Numbers, same: Booleans) -> Booleans:
    """Whether the iteration for T converges for all mu of an interval, and no two mu of different blocks meet.

    It is tested at five nodes, the middle among them; between these the squares of distances are polynomials.
    """
    probes = K[:, PROBE_NODES]
    if native.kernels():
        values, fine = native.contracts(probes, same, MOST_STEPS, SMALL_STEP, LARGEST_STEP)
    else:
        places, T = np.tile(np.arange(K.shape[-1]), (len(K), 1)), np.zeros_like(probes)
        T[:] = np.eye(K.shape[-1])
        _, values, fine = _iterated(probes, T, same, places, (MOST_STEPS + 1, SMALL_STEP, LARGEST_STEP), 2)
    fine[fine] = _stay_apart(values[fine], same[fine])
    return fine


def _stay_apart(values: Numbers, same: Booleans) -> Booleans:
    """Whether mu of different blocks, (intervals, probes, m), stay apart between the probes as well."""
    weights = chebyshev.refinement(len(PROBE_NODES) - 1, BETWEEN_DEGREE)
    squares = (values[:, :, :, None] - values[:, :, None, :]) ** 2
    least = np.min(np.abs(squares), axis=1)
    between = np.tensordot(weights, squares, (1, 1))
    return np.asarray(np.all((np.min(np.abs(between), axis=0) >= NEARER_SQUARE_RATIO * least) | same, axis=(1, 2)))


@dataclass(frozen=True)
class Forms:
    """Matrices between bases that make K block diagonal on intervals; c columns, J nodes.

    `values` are K, P and Q, or K alone, on the columns, and `changes` matrices like their errors, (intervals, J, 3 or
    1, c, c) each. `squares` (intervals, 2, c) are the largest squares of the lengths of right and left columns. They
    are not `found` where the iteration does not converge.
    """

    values: Numbers
    changes: Numbers
    squares: Array
    found: Booleans


def decoupled(
    K: Numbers,
    same: Booleans,
    columns: Indices,
    near: Booleans,
    vectors: Numbers,
    inverse: Numbers,
    matrices: Array,
    errors: Array | None,
) -> Forms:
    """The forms on the columns at the nodes of any degree, with the errors where there are any.

    Since P K is symmetric, P makes left bases of right ones, but for mu near -1 and 0, where it is nearly singular.
    """
    T, found = _invariant(K, same, columns)
    if matrices.shape[2] == 1:
        near = np.ones_like(near)
    valid = columns >= 0
    special = valid & np.take_along_axis(near, np.where(valid, columns, 0), axis=1)
    S = np.zeros((*T.shape[:3], 0), T.dtype)
    if special.any():
        S, by_left = _invariant(K.swapaxes(2, 3), same, _columns_of(columns, special))
        found &= by_left
    right = vectors[:, None] @ T
    if matrices.shape[2] == 1:
        rows = np.zeros_like(right.swapaxes(2, 3))
    else:
        rows = applied(matrices[:, :, 1], right).swapaxes(2, 3)  # P is symmetric
    for i in np.flatnonzero(special.any(axis=1)).tolist():
        rows[i][:, special[i]] = (S[i].swapaxes(1, 2) @ inverse[i])[:, : np.count_nonzero(special[i])]
    products = np.where(_within(same, columns)[:, None], rows @ right, 0.0)
    found &= np.all(np.isfinite(products), axis=(1, 2, 3))
    products[~found] = 0.0
    idle = ~np.any(products != 0.0, axis=3)
    products[..., range(products.shape[2]), range(products.shape[2])] += idle
    left = np.linalg.solve(products, rows)
    right[~found], left[~found] = 0.0, 0.0
    scale = np.sqrt(np.linalg.norm(left[:, left.shape[1] // 2], axis=2))[:, None]  # one length at the middle
    scale[scale == 0.0] = 1.0
    right, left = right * scale[..., None, :], left / scale[..., :, None]
    lengths = np.max(np.linalg.norm(right, axis=2), axis=1), np.max(np.linalg.norm(left, axis=3), axis=1)
    changes = np.zeros(0, right.dtype) if errors is None else _between(errors, right, left)
    return Forms(_between(matrices, right, left), changes, np.stack(lengths, axis=1) ** 2, found)


def _between(matrices: Array, right: Numbers, left: Numbers) -> Numbers:
    """K, P and Q, or K alone, between bases: (intervals, J, 3 or 1, m, m) -> (intervals, J, 3 or 1, c, c)."""
    images = [(left, right), (right.swapaxes(2, 3), right), (left, left.swapaxes(2, 3))]
    found = np.empty((*left.shape[:2], matrices.shape[2], *(left.shape[2],) * 2), dtype=left.dtype)
    for i, (rows, columns) in enumerate(images[: matrices.shape[2]]):
        np.matmul(rows, applied(matrices[:, :, i], columns), out=found[:, :, i])
    return found


def _columns_of(columns: Indices, chosen: Booleans) -> Indices:
    """Chosen columns in order, -1 behind them; (intervals, c)."""
    order = np.argsort(~chosen, axis=1, kind="stable")[:, : max(1, int(np.max(np.sum(chosen, axis=1), initial=1)))]
    found = np.where(chosen, columns, -1)
    return np.asarray(np.take_along_axis(found, order, axis=1))


def _within(same: Booleans, columns: Indices) -> Booleans:
    """Which columns are of one block, shape (intervals, c, c)."""
    valid = columns >= 0
    places = np.where(valid, columns, 0)
    each = np.arange(len(columns))[:, None, None]
    return np.asarray(same[each, places[:, :, None], places[:, None, :]] & valid[:, :, None] & valid[:, None, :])


def _invariant(K: Numbers, same: Booleans, columns: Indices) -> tuple[Numbers, Booleans]:
    """Columns of T with unit blocks and K T = T L at each node, and for which intervals they converged.

    From the middle, where T is the identity, to ever finer sets of nodes, each from what the last set predicts.
    """
    intervals, count, size = K.shape[:3]
    degree = count - 1
    if native.kernels():
        return native.invariant(K, same, columns, nested_nodes(degree), MOST_ITERATIONS, CONVERGED_STEP)
    places, each = np.where(columns >= 0, columns, 0), np.arange(intervals)[:, None]
    T = np.zeros((intervals, count, size, columns.shape[1]), dtype=K.dtype)
    T[each, degree // 2, places, np.arange(columns.shape[1])] = columns >= 0
    done, limits = np.ones(intervals, dtype=bool), (MOST_ITERATIONS, CONVERGED_STEP, 1.0)
    for known, wanted, prediction in nested_nodes(degree):
        guess = np.tensordot(T[:, known], prediction, (1, 1)).transpose(0, 3, 1, 2)
        T[:, wanted], _, converged = _iterated(K[:, wanted], guess, same, columns, limits)
        done &= converged
    return T, done


@cache
def nested_nodes(degree: int) -> tuple[tuple[Indices, Indices, Array], ...]:
    """Nodes known, nodes wanted, and the matrix that predicts these from those, from the middle on."""
    found = []
    step = degree
    known: Indices = np.array([degree // 2])
    while step >= 1:
        every = np.arange(0, degree + 1, step)
        wanted = np.setdiff1d(every, known)
        lower = known.size - 1
        if lower == 0:
            prediction = np.ones((wanted.size, 1))
        else:
            prediction = chebyshev.basis(chebyshev.nodes(degree)[wanted], lower) @ chebyshev.transform(lower)
        found.append((known, wanted, prediction))
        known, step = np.union1d(known, every), step // 2 if step < degree else degree // 4
    return tuple(found)


def _iterated(
    K: Numbers, T: Numbers, same: Booleans, columns: Indices, limits: tuple[int, float, float], fewest: int = 1
) -> tuple[Numbers, Numbers, Booleans]:
    """T from a guess, by Newton's method without couplings inside a block, so that it converges linearly.

    `limits` are the number of steps, the size of a step that is small enough after the `fewest`, and that of one that
    converges. Beside T the diagonals of the blocks, and whether all nodes of an interval have converged.
    """
    places, each = np.where(columns >= 0, columns, 0), np.arange(len(K))[:, None]
    diagonal, inner = np.diagonal(K, axis1=2, axis2=3), _within(same, columns)[:, None]
    apart = diagonal[each, :, places].transpose(0, 2, 1)[:, :, None, :] - diagonal[:, :, :, None]
    skipped = (same[each, places].swapaxes(1, 2) | (columns < 0)[:, None, :])[:, None] | (apart == 0.0)
    weights = np.where(skipped, 0.0, 1.0 / np.where(skipped, 1.0, apart))
    values, active = np.zeros((*T.shape[:2], T.shape[3]), T.dtype), np.ones(T.shape[:2], dtype=bool)
    converged, (most, small, large) = np.zeros(T.shape[:2], dtype=bool), limits
    for count in range(1, most + 1):
        with np.errstate(over="ignore", invalid="ignore"):
            product = K @ T
            block = np.where(inner, product[each, :, places].swapaxes(1, 2), 0.0)
            step = (product - T @ block) * weights
            largest = np.max(np.abs(step), axis=(2, 3), initial=0.0)
        T = np.where(active[..., None, None], T + step, T)
        values = np.where(active[..., None], np.diagonal(block, axis1=2, axis2=3), values)
        converged |= active & (largest <= small) & (count >= fewest)
        active &= ~converged & (largest < large)
        if not active.any():
            break
    return T, values, np.asarray(converged.all(axis=1))


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
MOST_PARTS = 16  # that an interval is cut into at a time: a power of 2
LARGEST_BLOCK = 6  # mu in a block that is taken out of a larger matrix, or a quarter of that
PAIRS_AT_A_TIME = 20_000  # of mu at nodes of intervals that are compared at a time: they stay in the cache of a core
BLOCK_ENTRY_RTOL = 1e-9  # of a block's entries: what its series may leave out
CLEAR_DISTANCE_FACTOR = 2.0  # times the shift of a mu by couplings: a distance from -1 and 0 that it does not cross


@dataclass(frozen=True)
class Matrices:
    """Matrices of several blocks of one number m of mu at the nodes of their intervals, with what bounds their errors.

    Attributes:
        owners: numbers of their intervals.
        members: places of their mu among all, shape (blocks, m).
        is_real: whether all mu of a block are.
        bounds: start and end of the interval, shape (blocks, 2).
        parts: (k, p, q), or k alone, shape (blocks, J, 3 or 1, m, m).
        errors: matrices like their errors, of the same shape.
        noise, tails: bounds on the norm of what comes to these, from elsewhere, and from the series on the interval,
            which shorter intervals lessen; shape (blocks, 3 or 1).
    """

    owners: Indices
    members: Indices
    is_real: Booleans
    bounds: Array
    parts: Numbers
    errors: Numbers
    noise: Array
    tails: Array

    def take(self, chosen: Booleans) -> Matrices:
        """Those of some blocks, as real matrices where all of these are."""
        taken = self if chosen.all() else Matrices(*(getattr(self, each.name)[chosen] for each in fields(self)))
        if not taken.is_real.all():
            return taken
        return replace(taken, parts=np.ascontiguousarray(taken.parts.real), errors=taken.errors.real)

    @classmethod
    def joined(cls, several: Sequence[Matrices]) -> Matrices:
        """Those of several bundles as one."""
        if len(several) == 1:
            return several[0]
        return cls(*(np.concatenate([getattr(each, name.name) for each in several]) for name in fields(cls)))

    @property
    def symplectic(self) -> bool:
        """Whether there are forms p and q."""
        return bool(self.parts.shape[2] == 3)

    @property
    def coarse(self) -> Booleans:
        """Which have series that leave out more than the errors from elsewhere."""
        return np.asarray(np.any(self.tails > self.noise + np.max(np.abs(self.errors), axis=(1, 3, 4)), axis=1))

    @property
    def rough(self) -> Booleans:
        """Which have series that leave out too much of their largest entries."""
        largest = np.max(np.abs(self.parts), axis=(1, 3, 4))
        return np.asarray(np.any(self.tails > BLOCK_ENTRY_RTOL * largest, axis=1))


def tails_of(k: Numbers) -> Array:
    """Norms of what the series of the matrices of blocks leave out, (blocks, J, 3 or 1, m, m) -> (blocks, 3 or 1)."""
    last = chebyshev.transform(k.shape[1] - 1)[-chebyshev.TAIL_COEFFICIENTS :]
    left_out = np.sum(np.abs(chebyshev.combined(last, k)), axis=1)
    return np.asarray(np.sqrt(np.sum(left_out**2, axis=(2, 3))))


@dataclass(frozen=True)
class Blocks:
    """Blocks in which something can happen, on several intervals; m mu in all, c columns, J nodes.

    `mu`, eigenvectors as columns of `vectors`, and the `rates` of mu per half of the interval are those at the middle.
    `labels` (intervals, m) hold the block of each mu; `columns` (intervals, c) are the mu of the columns, -1 where an
    interval has fewer. `real` (intervals, m) marks the mu with real columns, `near` those that may come to -1 or 0;
    `basis` are the vectors made real and apart, with its `inverse`. An interval that is too long is best cut into equal
    `parts`. `rows` are the intervals on whose columns `forms` has K, P and Q where these are found; the others are too
    long.
    """

    rows: Indices
    mu: ComplexArray
    vectors: Numbers
    rates: Numbers
    labels: Indices
    columns: Indices
    real: Booleans
    near: Booleans
    basis: Numbers
    inverse: Numbers
    parts: Indices
    forms: Forms

    @property
    def done(self) -> Booleans:
        """Which intervals are not too long."""
        found = np.zeros(len(self.mu), dtype=bool)
        found[self.rows] = self.forms.found
        return found

    def matrices(self, bounds: Array, noise: Array, first: int) -> Iterator[Matrices]:
        """Those of all blocks by their numbers of mu, with bounds (intervals, 2) and noise (intervals, 3 or 1).

        Their intervals are numbered from the `first` on.
        """
        known, columns, labels = self.forms, self.columns[self.rows], self.labels[self.rows]
        rows, places = np.nonzero((columns >= 0) & known.found[:, None])
        blocks = rows * labels.shape[1] + labels[rows, columns[rows, places]]
        order = np.argsort(blocks, kind="stable")
        _, firsts, counts = np.unique(blocks[order], return_index=True, return_counts=True)
        for count in np.unique(counts).tolist():
            those = order[firsts[counts == count][:, None] + np.arange(count)]
            i, members = rows[those[:, 0]], places[those]
            entries = i[:, None, None], slice(None), slice(None), members[:, :, None], members[:, None, :]
            k, change = (each[entries].transpose(0, 3, 4, 1, 2) for each in (known.values, known.changes))
            right, left = (np.sum(known.squares[i[:, None], side, members], axis=1) for side in (0, 1))
            scales = np.stack([np.sqrt(right * left), right, left], axis=1)[:, : noise.shape[1]]
            mu, owners = columns[i[:, None], members], self.rows[i]
            is_real = np.all(self.real[owners[:, None], mu], axis=1)
            yield Matrices(first + owners, mu, is_real, bounds[owners], k, change, noise[owners] * scales, tails_of(k))


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
    kinds = real.all(axis=1)
    if mu.shape[1] <= LARGEST_BLOCK and not kinds.all():  # small ones cost less together
        kinds[:] = False
    for chosen in (np.flatnonzero(kinds), np.flatnonzero(~kinds)):
        if chosen.size:
            basis = vectors[chosen].real if kinds[chosen[0]] else vectors[chosen]
            K, changes = (each if chosen.size == len(mu) else each[chosen] for each in (matrices, errors))
            found.append((chosen, _blocks(K, changes, mu[chosen], basis.copy(), real[chosen])))
    return found


def _blocks(matrices: Array, errors: Array, mu: ComplexArray, vectors: Numbers, real: Booleans) -> Blocks:
    """Blocks of intervals, from the eigenvalues and eigenvectors at the middle, `real` or complex."""
    original = vectors.copy()
    glued = _separate_parallel(vectors, mu, real)
    K, inverse, fine = _similar(matrices[:, :, 0], vectors)
    rates = chebyshev.middle_slope(SERIES_DEGREE) @ np.diagonal(K, axis1=2, axis2=3)
    same, shifts, parts = _graph(K, glued)
    while (conjugate := ~real & _conjugates_together(mu, same)).any():  # in real coordinates more may be joined
        _make_real(vectors, mu, conjugate)
        real, i = real | conjugate, np.flatnonzero(conjugate.any(axis=1))
        K[i], inverse[i], fine[i] = _similar(matrices[i, :, 0], vectors[i])
        same[i], shifts[i], _ = _graph(K[i], same[i])
    counts = np.sum(same, axis=2)
    fine &= np.max(counts, axis=1) <= _most(mu.shape[1])
    near = _near_the_ends(np.diagonal(K, axis1=2, axis2=3).real, shifts)
    near = np.any(same & near[:, None, :], axis=2)
    fine[fine] = contracts(K[fine], same[fine])
    needed = ((counts > 1) | ~real | near) & fine[:, None]
    columns = _columns_of(np.tile(np.arange(mu.shape[1]), (len(mu), 1)), needed)
    rows = np.flatnonzero(fine)
    those = (K, same, columns, near, vectors, inverse, matrices, errors)
    forms = decoupled(*(those if fine.all() else (each[rows] for each in those)))
    labels, parts = np.argmax(same, axis=2), np.maximum(parts, 2)
    return Blocks(
        rows, mu.astype(complex), original, rates, labels, columns, real, near, vectors, inverse, parts, forms
    )


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


def _graph(K: Numbers, glued: Booleans) -> tuple[Booleans, Array, Indices]:
    """Which mu have to stay in one block, (intervals, m, m), and what the others move each by, (intervals, m).

    The last are the equal parts of each interval that should come apart: on those differences of mu vary by less as
    their lengths do, and couplings are smaller as the squares of these.
    """
    diagonal = np.diagonal(K, axis1=2, axis2=3)
    middle = diagonal[:, MIDDLE_NODE, :, None] - diagonal[:, MIDDLE_NODE, None, :]
    distance = _squares(middle)
    nearest, farthest, coupling = distance.copy(), np.zeros(distance.shape), np.zeros(distance.shape)
    step = max(1, PAIRS_AT_A_TIME // distance.size)
    for first in range(0, diagonal.shape[1], step):
        nodes = slice(first, first + step)
        difference = diagonal[:, nodes, :, None] - diagonal[:, nodes, None, :]
        np.minimum(nearest, np.min(_squares(difference), axis=1), out=nearest)
        np.maximum(farthest, np.max(_squares(difference - middle[:, None]), axis=1), out=farthest)
        sizes = _squares(K[:, nodes])
        np.maximum(coupling, np.max(sizes * sizes.swapaxes(2, 3), axis=1), out=coupling)
    distance, nearest, farthest, coupling = (np.sqrt(each) for each in (distance, nearest, farthest, coupling))
    joined = _joined(distance, nearest, farthest, coupling, glued)
    with np.errstate(divide="ignore", invalid="ignore"):
        shifts = np.sum(np.where(joined, 0.0, coupling / nearest), axis=2)
    parts, rows, together = np.ones(len(K), dtype=np.int64), np.arange(len(K)), joined
    for count in range(1, int(np.log2(MOST_PARTS)) + 1):
        rows = rows[np.max(np.sum(together, axis=2), axis=1) > _most(K.shape[2])]
        if not rows.size:
            break
        parts[rows], share = 2**count, 0.5**count
        near = np.maximum(nearest[rows], distance[rows] - share * farthest[rows])
        together = _joined(distance[rows], near, share * farthest[rows], share**2 * coupling[rows], glued[rows])
    return joined, shifts, parts


def _squares(numbers: Numbers) -> Array:
    """Squares of their sizes."""
    return np.asarray(numbers**2 if numbers.dtype.kind != "c" else numbers.real**2 + numbers.imag**2)


def _joined(distance: Array, nearest: Array, farthest: Array, coupling: Array, glued: Booleans) -> Booleans:
    """Which mu meet, or are coupled, directly or through others, beside those that are glued, (intervals, m, m).

    Arguments:
        distance: of two mu at the middle.
        nearest: the least distance of them on the interval.
        farthest: change of their difference on it, at most.
        coupling: size of the products of entries between them, at most.
        glued: which are together whatever the distances are.
    """
    away = np.clip(distance / np.maximum(farthest, 1e-300), 1.0, 1e3)
    expected = coupling * away**2 / np.maximum(distance, 1e-250) * (away + np.sqrt(away**2 - 1.0)) ** -SERIES_DEGREE
    joined = (
        (distance < MEETING_HALF_LENGTHS * farthest)
        | (coupling > (COUPLING_RATIO * nearest) ** 2)
        | (expected > RESOLVED_BLOCK_ERROR)
        | glued
    )
    joined |= np.eye(distance.shape[-1], dtype=bool)
    for _ in range(int(np.ceil(np.log2(max(distance.shape[-1], 2))))):  # whoever is joined through others
        more = (joined.astype(np.float32) @ joined.astype(np.float32)) > 0.5
        if np.array_equal(more, joined):
            break
        joined = more
    return joined


def _near_the_ends(diagonal: Array, shifts: Array) -> Booleans:
    """Which mu may come to -1 or 0 within an interval, or are outside; diagonal (intervals, J, m) -> (intervals, m)."""
    low, high = np.min(diagonal, axis=1), np.max(diagonal, axis=1)
    room = np.minimum(low + 1.0, -high)
    return np.asarray(room <= CLEAR_DISTANCE_FACTOR * shifts + 0.25 * (high - low) + CLOSE_TO_END)
