"""Matrices between bases that make them block diagonal at each node of an interval, from their eigenvectors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin import native
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.zero.problem import Array

SERIES_DEGREE = 16  # of the series on an interval
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
Indices = NDArray[np.int64]
Numbers = NDArray[Any]  # real or complex


def _weights(K: Numbers, same: Booleans) -> Numbers:
    """1 / (mu_b - mu_a) between blocks, 0 inside of them; shape of K."""
    diagonal = np.diagonal(K, axis1=2, axis2=3)
    gaps = diagonal[:, :, None, :] - diagonal[:, :, :, None]
    inside = same[:, None] | (gaps == 0.0)
    return np.where(inside, 0.0, 1.0 / np.where(inside, 1.0, gaps))


def applied(matrices: Array, columns: Numbers) -> Numbers:
    """Real matrices times columns, those of complex ones as pairs of real ones: half the operations."""
    if columns.dtype.kind != "c":
        return np.asarray(matrices @ columns)
    return np.asarray((matrices @ np.ascontiguousarray(columns).view(float)).view(complex))


def contracts(K: Numbers, same: Booleans) -> Booleans:
    """Whether the iteration for T converges for all mu of an interval, and no two mu of different blocks meet.

    It is tested at five nodes, the middle among them; between these the squares of distances are polynomials.
    """
    if native.kernels():
        values, fine = native.contracts(K[:, PROBE_NODES], same, MOST_STEPS, SMALL_STEP, LARGEST_STEP)
    else:
        values, fine = _steps_from_identity(K[:, PROBE_NODES], same)
    fine[fine] = _stay_apart(values[fine], same[fine])
    return fine


def _steps_from_identity(K: Numbers, same: Booleans) -> tuple[Numbers, Booleans]:
    """All mu at the nodes of intervals, (intervals, nodes, m), and for which intervals steps for T become small."""
    weights, inside = _weights(K, same), same[:, None]
    fine = np.ones(len(K), dtype=bool)
    T = K * weights
    values = np.empty(K.shape[:3], dtype=K.dtype)
    active = np.arange(len(K))
    for count in range(MOST_STEPS):
        with np.errstate(over="ignore", invalid="ignore"):
            product = K[active] + K[active] @ T
            block = np.where(inside[active], product, 0.0)
            step = (product - block - T @ block) * weights[active]
            T = T + step
            largest = np.max(np.abs(step), axis=(1, 2, 3))
        values[active] = np.diagonal(block, axis1=2, axis2=3)
        going = (largest > SMALL_STEP) | (count == 0)
        fine[active[~(largest < LARGEST_STEP)]] = False
        active, T = active[going & fine[active]], T[going & fine[active]]
        if not active.size:
            break
    fine[active] = False
    return values, fine


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
    1, c, c) each. `squares` (intervals, 2, c) are the largest squares of the lengths of right and left columns. All are
    zero where they are not `found`.
    """

    values: Numbers
    changes: Numbers
    squares: Array
    found: Booleans

    def among(self, chosen: Booleans) -> Forms:
        """Those of the intervals that are chosen, among others that have none."""
        every: list[Any] = []
        for each in (self.values, self.changes, self.squares, self.found):
            more = np.zeros((chosen.size, *each.shape[1:]), each.dtype)
            more[chosen] = each
            every.append(more)
        return Forms(*every)


def decoupled(
    K: Numbers,
    same: Booleans,
    columns: Indices,
    near: Booleans,
    vectors: Numbers,
    inverse: Numbers,
    matrices: Array,
    errors: Array | None,
    numbers: Indices,
) -> Forms:
    """The forms on the columns at the nodes of any degree, with the errors where there are any.

    Of matrices and errors those of the intervals are taken by their `numbers`.

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
    matrices, errors = matrices[numbers], None if errors is None else errors[numbers]
    right = vectors[:, None] @ T
    if matrices.shape[2] == 1:
        rows = np.zeros_like(right.swapaxes(2, 3))
    else:
        rows = applied(matrices[:, :, 1], right).swapaxes(2, 3)  # P is symmetric
    for i in np.flatnonzero(special.any(axis=1)).tolist():
        rows[i][:, special[i]] = (S[i].swapaxes(1, 2) @ inverse[i])[:, : np.count_nonzero(special[i])]
    return _forms(right, rows, _within(same, columns), found, matrices, errors)


def _forms(
    right: Numbers, rows: Numbers, within: Booleans, found: Booleans, matrices: Array, errors: Array | None
) -> Forms:
    """The forms by right bases, and left ones that are combinations of rows."""
    products = np.where(within[:, None], rows @ right, 0.0)
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
    """Chosen columns in order, -1 behind them."""
    found = np.full((len(columns), int(np.max(np.sum(chosen, axis=1)))), -1, dtype=np.int64)
    for i, (row, which) in enumerate(zip(columns, chosen, strict=True)):
        found[i, : np.count_nonzero(which)] = row[which]
    return found


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
    valid = columns >= 0
    places = np.where(valid, columns, 0)
    each = np.arange(intervals)[:, None]
    diagonal = np.diagonal(K, axis1=2, axis2=3)
    gaps = diagonal[each, :, places].transpose(0, 2, 1)[:, :, None, :] - diagonal[:, :, :, None]
    skipped = (same[each, places].swapaxes(1, 2) | ~valid[:, None, :])[:, None] | (gaps == 0.0)
    weights = np.where(skipped, 0.0, 1.0 / np.where(skipped, 1.0, gaps))
    inner = _within(same, columns)
    T = np.zeros((intervals, count, size, columns.shape[1]), dtype=K.dtype)
    T[each, degree // 2, places, np.arange(columns.shape[1])] = valid
    done = np.ones(intervals, dtype=bool)
    for known, wanted, prediction in nested_nodes(degree):
        guess = np.tensordot(T[:, known], prediction, (1, 1)).transpose(0, 3, 1, 2)
        T[:, wanted], converged = _iterated(K[:, wanted], guess, weights[:, wanted], places, inner)
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


def _iterated(K: Numbers, T: Numbers, weights: Numbers, places: Indices, inner: Booleans) -> tuple[Numbers, Booleans]:
    """T from a guess, by Newton's method without couplings inside a block, so that it converges linearly."""
    shape, (size, width) = T.shape[:2], T.shape[2:]
    T = np.ascontiguousarray(T).reshape(-1, size, width)
    converged = np.zeros(len(T), dtype=bool)
    active = np.arange(len(T))
    here, turn, weights = K.reshape(-1, size, size), T.copy(), weights.reshape(-1, size, width)
    rows, numbers = np.repeat(places, shape[1], axis=0), np.arange(len(T))[:, None]
    inner = np.repeat(inner, shape[1], axis=0).astype(float)
    for _ in range(MOST_ITERATIONS):
        product = here @ turn
        block = product[numbers[: len(rows)], rows]
        block *= inner
        with np.errstate(over="ignore", invalid="ignore"):
            product -= turn @ block
            step = np.multiply(product, weights, out=product)
            turn += step
            largest = np.max(np.abs(step), axis=(1, 2), initial=0.0)
        enough = largest <= CONVERGED_STEP
        T[active], converged[active] = turn, enough
        going = ~enough & (largest < 1.0)
        if not going.any():
            break
        if not going.all():
            active, here, turn, weights = active[going], here[going], turn[going], weights[going]
            rows, inner = rows[going], inner[going]
    return T.reshape(*shape, size, width), np.asarray(converged.reshape(shape).all(axis=1))
