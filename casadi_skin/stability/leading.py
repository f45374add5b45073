"""The leading multipliers of orbits of many states, most of whose derivatives vanish, and what bounds all others.

M is the map over the period in units of the components, by Radau's method on the intervals of the orbit: by Gauss' what
decays within an interval, at a rate q, is damped by 1 - O(1/q) alone (Hairer and Wanner 1996, section IV.5), and some
hundreds of multipliers that are zero would be near 1. N = (1 - U U^T) M (1 - U U^T) is M across the columns of U, the
directions and gradients of multipliers that are 1. Both act on vectors through sparse factors of the intervals. From a
block of random columns Arnoldi's method without restarts makes an orthonormal basis V with V^T N V = H; the eigenvalues
of H that have converged, sorted in a Schur form, give Q, (n, k), with N Q = Q T and the multipliers as eigenvalues of T
(Saad 2011, chapter 6). The same with N^T gives their left vectors, hence what rounding makes of them.

All others are eigenvalues of R = (1 - Q Q^T) N (1 - Q Q^T). None has a modulus above b where

    b^p = 10 sqrt(2 / pi) max_i |R^p w_i|, i = 1 .. 10,

with independent Gaussian vectors w_i, but for a probability of 1e-10 (Halko, Martinsson and Tropp 2011, lemma 4.1).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from casadi_skin.solve.intervals import Intervals
from casadi_skin.stability.closed_maps import (
    BACKWARD_ERROR_UNITS,
    MACHINE_EPSILON,
    MAP_ENTRY_ROUNDING,
    Multipliers,
    Spectrum,
    Trivial,
)
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import BoundaryProblem

LEADING_MODULUS = 0.1  # all that are larger are in the list
FEWEST = 6  # and so many at the least
BLOCKS = 4, 16  # columns that are carried together, and where a multiplier was passed over: equal ones are found
MOST_COLUMNS = 240  # of a basis
CONVERGED_RESIDUAL = 1e-13  # of the norm of H
GAP_RATIO, LEAST_GAP_RATIO = 1.2, 1.02  # of the moduli of the last multiplier in the list and of the next
PROBES, PROBE_FACTOR = 10, 10.0 * float(np.sqrt(2.0 / np.pi))  # of the lemma, for a probability of 1e-10
MOST_POWERS = 40

Act = Callable[[Array], Array]


class ManyLeadingError(ArithmeticError):
    """A basis for the leading multipliers has too many columns, or those of both kinds of vectors differ in number."""


@dataclass(frozen=True, eq=False)
class _Invariant:
    """An orthonormal basis Q, (n, k), of an invariant subspace, with T = Q^T N Q.

    `norm` is that of H; the modulus `gap` is between the eigenvalues of T and all others of H.
    """

    basis: Array
    matrix: Array
    norm: float
    gap: float


def leading_multipliers(
    problem: BoundaryProblem, z: Array, trivial: Trivial, units: Array, least: int = FEWEST, checked: bool = True
) -> Multipliers:
    """The multipliers that are 1 for every orbit, and of the others those above LEADING_MODULUS, `least` at the least.

    Where `checked`, with what rounding makes of them and a bound of all others. Raises ManyLeadingError.
    """
    n, known = units.size, trivial.vectors(units)
    intervals = Intervals.by_radau(problem, z, n, units)
    frame, directions, first = np.zeros((n, 0)), 0, 0
    if known is not None:
        frame, directions, first = np.linalg.qr(known[1][0].T)[0], trivial.right.shape[1], int(known[0][0])

    def across(x: Array) -> Array:
        return np.asarray(x - frame @ (frame.T @ x))

    def act(x: Array) -> Array:
        return across(intervals.carried(across(x), first))

    def act_back(w: Array) -> Array:
        return across(intervals.carried_back(across(w), first))

    taken = frame.T @ intervals.carried(frame, first)
    blocks = taken[:directions, :directions], taken[directions:, directions:]
    near = Spectrum.of(np.concatenate([np.linalg.eigvals(block) for block in blocks]).astype(complex))
    for block in BLOCKS:
        found = _invariant(act, n, block, least + trivial.count - near.logs.size)
        beyond = _bound(act, found) if checked else np.inf
        if beyond < 1.0 or not checked:
            break
    values, right = np.linalg.eig(found.matrix)
    order = np.argsort(-np.abs(values), kind="stable")
    values, right = values[order].astype(complex), right[:, order]
    # What is 1 for every orbit shows what rounding of the orbit makes of the others as well.
    off = float(np.max(np.abs(near.values - 1.0), initial=0.0))
    rounding = (
        _rounding(found, _invariant(act_back, n, block, order.size, found.gap), values, right)
        if checked
        else np.zeros(order.size)
    )
    is_other = np.ones(order.size, dtype=bool)
    is_other[np.argsort(np.abs(values - 1.0), kind="stable")[: trivial.count - near.logs.size]] = False
    others = Spectrum.of(values)
    norm = max(1.0, found.norm, float(np.linalg.norm(taken)))
    return Multipliers(
        near.joined(others.taken(~is_other)),
        others.taken(is_other),
        (rounding + off * np.abs(values))[is_other],
        None,
        0.0,
        norm,
        beyond=beyond,
    )


def _invariant(act: Act, n: int, block: int, least: int, gap: float | None = None) -> _Invariant:
    """The subspace of the leading eigenvalues; where a `gap` is given, of the `least` eigenvalues beyond it.

    Raises ManyLeadingError.
    """
    from scipy.linalg import schur

    most = min(MOST_COLUMNS, n // 2) // block * block
    V, H = np.zeros((n, most + block), order="F"), np.zeros((most + block, most))
    V[:, :block] = np.linalg.qr(np.random.default_rng(block + (gap is None)).normal(size=(n, block)))[0]
    for m in range(block, most + 1, block):
        last, following = slice(m - block, m), slice(m, m + block)
        W = act(V[:, last])
        for _ in range(2):  # orthogonal to rounding
            part = V[:, :m].T @ W
            W = W - V[:, :m] @ part
            H[:m, last] += part
        V[:, following], H[following, last] = np.linalg.qr(W)
        edge = _edge(H[: m + block, :m], block, least, gap)
        if edge is not None:
            beyond = partial(_is_beyond, edge)
            T, Z, k = schur(H[:m, :m], output="real", sort=beyond)
            return _Invariant(V[:, :m] @ Z[:, :k], T[:k, :k], float(np.linalg.norm(H[:m, :m], 2)), edge)
    raise ManyLeadingError(f"the leading multipliers of {n} states are not those of {most} vectors")


def _is_beyond(modulus: float, re: float, im: float) -> bool:
    return bool(np.hypot(re, im) >= modulus)


def _edge(H: Array, block: int, least: int, gap: float | None) -> float | None:
    """A modulus between the leading eigenvalues, which have converged, and the others; None where there is none yet."""
    m = H.shape[1]
    values, vectors = np.linalg.eig(H[:m])
    residuals = np.linalg.norm(H[m:, m - block :] @ vectors[m - block :], axis=0)
    order = np.argsort(-np.abs(values), kind="stable")
    moduli, open_ones = np.abs(values)[order], np.flatnonzero(residuals[order] > CONVERGED_RESIDUAL * np.linalg.norm(H))
    first = int(open_ones[0]) if open_ones.size else m - 1
    if gap is not None:
        beyond = int(np.count_nonzero(moduli >= gap))
        return gap if beyond == least and first >= least else None
    need = max(int(np.count_nonzero(moduli >= LEADING_MODULUS)), least)
    if first < need or need >= m:
        return None
    above, below = moduli[need - 1 : first], moduli[need : first + 1]
    ratios = above / np.maximum(below, np.finfo(float).tiny)
    at = int(np.argmax(ratios >= min(GAP_RATIO, np.max(ratios))))
    return float(np.sqrt(above[at] * below[at])) if ratios[at] >= LEAST_GAP_RATIO else None


def _bound(act: Act, found: _Invariant) -> float:
    """A modulus that no eigenvalue exceeds which is not one of T."""
    Q, least = found.basis, np.inf

    def rest(x: Array) -> Array:
        return np.asarray(x - Q @ (Q.T @ x))

    y, logarithm = rest(np.random.default_rng(0).normal(size=(len(Q), PROBES))), 0.0
    for power in range(1, MOST_POWERS + 1):
        y = rest(act(y))
        size = float(np.max(np.linalg.norm(y, axis=0)))
        if size == 0.0:
            return 0.0
        y, logarithm = y / size, logarithm + float(np.log(size))
        least = min(least, float(np.exp((logarithm + np.log(PROBE_FACTOR)) / power)))
        if least <= max(found.gap, LEADING_MODULUS):
            break
    return least


def _rounding(found: _Invariant, back: _Invariant, values: ComplexArray, right: ComplexArray) -> Array:
    """What rounding of the maps, relative to their norm, makes of each eigenvalue, by eigenvectors `right` of T."""
    try:
        left = np.linalg.solve(right, np.linalg.solve(back.basis.T @ found.basis, back.basis.T))
        conditions = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0)
    except np.linalg.LinAlgError:  # exactly defective
        conditions = np.full(values.size, np.inf)
    errors = MACHINE_EPSILON * (MAP_ENTRY_ROUNDING + BACKWARD_ERROR_UNITS) * found.norm
    errors += CONVERGED_RESIDUAL * found.norm
    return np.asarray(np.fmin(conditions * errors, np.sqrt(errors * found.norm)))
