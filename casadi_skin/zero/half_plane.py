"""Eigenvalues of a large sparse matrix on the right of the imaginary axis and beside it, and a proof of their number.

Of B, (n, n), in units in which it is balanced, every eigenvalue has a real part of X at the most, the largest
eigenvalue of (B + B^T)/2, and an imaginary part of W at the most, the norm of (B - B^T)/2 (Bendixson 1902); both are
bounded by sums of entries. So those with a real part above -m lie within a circle |z - s| < r around a shift s that is
on the right of all of them. Arnoldi's method with (B - s)^-1 finds them, and some more (Lehoucq, Sorensen and Yang
1998). None within the circle is missing where

    g(z) = det(z - B) / prod_k (z - lambda_k)

does not turn around zero as z goes round it: its turns are the number within less that of the known ones, whatever
values outside are among the lambda_k. The determinants are those of sparse factors, at places so near to each other
that other eigenvalues do not turn g by half a turn in between: by the trace of (s - B)^-1 (Hutchinson 1990).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from casadi_skin.zero.balanced import (
    DERIVATIVE_ROUNDING,
    ComplexArray,
    balanced,
    logarithms_of_units,
    scaled,
    upper_pair,
)
from casadi_skin.zero.problem import Array

MARGIN_RATIO = 0.25  # of |X| + W: how far on the left of the axis eigenvalues are known at the least
FIRST_COUNT, MOST_EIGENVALUES, MOST_RESTARTS = 24, 120, 100  # of Arnoldi's method
FEWEST = 6  # eigenvalues within the circle
MOST_PLACES = 400  # on half of the circle
SURE_TURN = 2.0  # bound of what g may turn between two places by eigenvalues outside: less than half a turn
LEAST_PLACES, TRACE_PROBES = 5, 16
LEFT_ACCURACY = 1e-9  # of left eigenvectors, of which rates and conditions are made
NORM_ROUNDS = 8
PAIR_ROUNDS, PAIR_OFFSET = (6, 3), 1e-9  # of inverse iteration, with the first shift and with a better one off by this
WIDE_REACH, FAR_REACH = 1.2, 2.0  # of the radius: the farthest known eigenvalue is beyond, for a proof farther


class HalfPlaneError(ArithmeticError):
    """Too many eigenvalues are near the axis, or their number is not proved."""


@dataclass(frozen=True, eq=False)
class HalfPlane:
    """The eigenvalues within the circle.

    Attributes:
        matrix: the balanced matrix B, sparse.
        units: d, of the state.
        margin, height, shift, radius: m, W, s and r.
        values: by descending real part, shape (k,).
        right, left: eigenvectors in these units, shape (n, k) and (k, n), with left @ right = 1.
    """

    matrix: Any
    units: Array
    margin: float
    height: float
    shift: float
    radius: float
    values: ComplexArray
    right: ComplexArray
    left: ComplexArray

    @classmethod
    def of(cls, A: Any) -> HalfPlane:
        """Of a sparse matrix; raises HalfPlaneError where too many eigenvalues are within the circle."""
        B, d = scaled(A, np.exp2(logarithms_of_units(A)))
        bound, height = _bounds(B)
        margin = MARGIN_RATIO * (abs(bound) + height) or 1.0
        shift = max(bound, 0.0) + height + margin
        reach = float(np.hypot(shift + margin, height))
        factors = _Shifted(B).factors(shift)
        values, right = _within(factors.solve, d.size, FIRST_COUNT, shift, WIDE_REACH * reach)
        apart = np.sort(np.abs(values - shift))
        reach = max(reach, float(apart[FEWEST - 1]))
        least = np.maximum(np.append(0.0, apart[:-1]), reach)
        gap = int(np.argmax(np.where(least < WIDE_REACH * reach, apart / least, 0.0)))  # nothing is near the circle
        radius = float(np.sqrt(least[gap] * min(apart[gap], WIDE_REACH * least[gap])))
        within = int(np.count_nonzero(np.abs(values - shift) < radius))
        others, left = _nearest(
            lambda b: factors.solve(b, "T"), d.size, min(within + 2, values.size), shift, LEFT_ACCURACY
        )
        inside, left = np.abs(values - shift) < radius, left[:, np.abs(others - shift) < radius]
        if left.shape[1] != np.count_nonzero(inside):
            raise HalfPlaneError("left and right eigenvectors differ in number")
        order = np.lexsort((-values[inside].imag, -values[inside].real))
        right = right[:, inside][:, order]
        margin = float(np.sqrt(radius**2 - height**2)) - shift
        try:
            dual = np.asarray(np.linalg.solve(left.T @ right, left.T), dtype=np.complex128)
        except np.linalg.LinAlgError as error:
            raise HalfPlaneError("an eigenvalue is defective") from error
        return cls(B, d, margin, height, shift, radius, values[inside][order], right, dual)

    @cached_property
    def missing(self) -> int:
        """How many eigenvalues within the circle are not among the values; raises HalfPlaneError where undecided."""
        shifted = _Shifted(self.matrix)
        factors, n = shifted.factors(self.shift), self.units.size
        try:
            known = _within(
                factors.solve, n, 2 * max(self.values.size, FIRST_COUNT), self.shift, FAR_REACH * self.radius
            )[0]
        except HalfPlaneError:
            known = _nearest(factors.solve, n, min(MOST_EIGENVALUES, n // 2), self.shift)[0]
        turns = _turning(factors, self.height, self.radius, known - self.shift)
        inside = int(np.count_nonzero(np.abs(known - self.shift) < self.radius))
        return _missing(shifted, self.shift, self.radius, known, turns) + inside - self.values.size

    def numbers(self, rounding: float) -> tuple[int, int]:
        """Bounds of the number with a positive real part: those on the axis but for errors are on either side."""
        errors = self.errors(rounding)
        return int(np.sum(self.values.real > errors)), int(np.sum(self.values.real > -errors))

    @property
    def room(self) -> float:
        """How far eigenvalues outside the circle are from the right of the axis, of their distance from s at least."""
        return 1.0 - float(np.hypot(self.shift, self.height)) / self.radius

    @cached_property
    def conditions(self) -> Array:
        """Condition numbers of the eigenvalues."""
        return np.asarray(np.linalg.norm(self.left, axis=1) * np.linalg.norm(self.right, axis=0))

    def errors(self, rounding: float) -> Array:
        """Errors of the eigenvalues by those of the entries, relative."""
        terms = np.sum(np.abs(self.left).T * (abs(self.matrix) @ np.abs(self.right)), axis=0)
        return np.asarray(DERIVATIVE_ROUNDING * rounding * terms)

    def rates(self, rate: Any) -> ComplexArray:
        """Rates of the eigenvalues where the matrix, in the units of the state, changes at a rate, sparse."""
        moved = (rate @ (self.units[:, None] * self.right)) / self.units[:, None]
        return np.asarray(np.sum(self.left.T * moved, axis=0))

    def moves(self, change: Any) -> float:
        """How far a change of the matrix moves eigenvalues outside the circle towards s, of their distance from it.

        The norm of (B - s)^-1 change, to a few per cent: theirs is no larger but for their condition.
        """
        scaled = change.multiply(self.units[None, :] / self.units[:, None]).tocsc()
        factors, size = _Shifted(self.matrix).factors(self.shift), 0.0
        v = np.random.default_rng(2).normal(size=self.units.size)
        for _ in range(NORM_ROUNDS):
            size = float(np.linalg.norm(v))
            if not 0.0 < size < np.inf:
                break
            v = scaled.T @ factors.solve(factors.solve(scaled @ (v / size)), "T")
        return float(np.sqrt(size))


def pair_near(A: Any, near: float | None = None) -> tuple[complex, ComplexArray, ComplexArray]:
    """The upper eigenvalue of the pair of a sparse matrix that is nearest to i `near`, and its eigenvectors.

    By default that nearest to the imaginary axis; q with A q = lambda q and p with p^H A = lambda p^H, by inverse
    iteration. Raises ArithmeticError where all are real.
    """
    B, d = balanced(A)
    if near is None:
        part = HalfPlane.of(A)
        found = complex(part.values[upper_pair(part.values)])
    else:
        found = 1j * near
    shifted, v = _Shifted(B), np.asarray(np.random.default_rng(3).normal(size=d.size), dtype=np.complex128)
    w = v
    for rounds in PAIR_ROUNDS:
        factors = shifted.factors(found * (1.0 + PAIR_OFFSET))
        for _ in range(rounds):
            v, w = factors.solve(v), factors.solve(w, "H")
            v, w = v / np.linalg.norm(v), w / np.linalg.norm(w)
        found = complex(np.vdot(w, B @ v) / np.vdot(w, v))
    if not found.imag > 0.0:
        raise ArithmeticError("no pair of complex eigenvalues is near the imaginary axis")
    return found, np.asarray(v * d), np.asarray(w / d)


def _bounds(B: Any) -> tuple[float, float]:
    """Bounds X and W of real and imaginary parts of eigenvalues."""
    symmetric, skew = (B + B.T) * 0.5, (B - B.T) * 0.5
    diagonal = symmetric.diagonal()
    sums, heights = (np.asarray(abs(part).sum(axis=1)).ravel() for part in (symmetric, skew))
    return float(np.max(diagonal + sums - np.abs(diagonal))), float(np.max(heights))


def _within(
    solve: Callable[[Array], Array], n: int, count: int, shift: float, reach: float
) -> tuple[ComplexArray, ComplexArray]:
    """The eigenvalues nearest to a shift, and their eigenvectors, `count` or so many that some are beyond a reach."""
    while count <= min(MOST_EIGENVALUES, n // 2):
        values, vectors = _nearest(solve, n, count, shift)
        if np.max(np.abs(values - shift)) > reach:
            return values, vectors
        count *= 2
    raise HalfPlaneError("too many eigenvalues are near the imaginary axis")


def _nearest(
    solve: Callable[[Array], Array], n: int, count: int, shift: float, accuracy: float = 0.0
) -> tuple[ComplexArray, ComplexArray]:
    """The eigenvalues nearest to a shift, with eigenvectors as columns, by solutions with the shifted matrix.

    They are right to a relative accuracy, or to rounding where that is 0.
    """
    from scipy.sparse.linalg import ArpackError, LinearOperator, eigs

    start = np.random.default_rng(0).normal(size=n)
    try:
        found, vectors = eigs(
            LinearOperator((n, n), matvec=solve, dtype=float), count, v0=start, maxiter=MOST_RESTARTS, tol=accuracy
        )
    except ArpackError as error:
        raise HalfPlaneError(str(error)) from error
    return shift + 1.0 / found, vectors


class _Shifted:
    """Factors and determinants of z - B, whose pattern is the same for all z."""

    def __init__(self, B: Any) -> None:
        from scipy.sparse import csc_matrix

        entries, n = B.tocoo(), B.shape[0]
        row, column = (np.append(part, np.arange(n)) for part in (entries.row, entries.col))
        data = np.append(entries.data, np.zeros(n))  # the diagonal with them
        self._matrix = csc_matrix((data, (row, column)), shape=B.shape)
        columns = np.repeat(np.arange(n), np.diff(self._matrix.indptr))
        self._diagonal = np.flatnonzero(self._matrix.indices == columns)

    def factors(self, z: complex) -> Any:
        """Those of B - z by SuperLU."""
        from scipy.sparse import csc_matrix
        from scipy.sparse.linalg import splu

        data = self._matrix.data.astype(type(z))
        data[self._diagonal] -= z
        return splu(csc_matrix((data, self._matrix.indices, self._matrix.indptr), shape=self._matrix.shape))

    def angle(self, z: complex) -> float:
        """The argument of the determinant of z - B, of a number of turns that is not known."""
        factors = self.factors(z)
        odd = sum(is_odd(permutation) for permutation in (factors.perm_r, factors.perm_c))
        return float(np.sum(np.angle(-factors.U.diagonal())) + np.pi * odd)


def is_odd(permutation: Any) -> int:
    """Whether a permutation is odd, by the number of its cycles."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import connected_components

    n = permutation.size
    graph = csr_matrix((np.ones(n), permutation, np.arange(n + 1)), shape=(n, n))
    return int(n - connected_components(graph, directed=False, return_labels=False)) % 2


def _turning(factors: Any, height: float, radius: float, known: ComplexArray) -> Array:
    """Turns of z - s = radius exp(i turn), 0 to pi, between which unknown eigenvalues turn g by `SURE_TURN` at most.

    They are farther away from s than all known ones, `known` less s, and not higher than `height`. With d_j their
    distances from s, they turn g at a rate of sum_j radius / |z - lambda_j| <= f(turn) sum_j radius / d_j at most.
    """
    probes = np.random.default_rng(1).choice([-1.0, 1.0], (factors.shape[0], TRACE_PROBES))
    traces = -np.sum(probes * factors.solve(probes), axis=0)
    others = float(np.mean(traces) + 3.0 * np.std(traces) / np.sqrt(TRACE_PROBES) + np.sum(1.0 / known).real)
    farthest = float(np.max(np.abs(known)))
    aside = float(np.arcsin(min(height / farthest, 1.0)))
    turns = np.linspace(0.0, np.pi, MOST_PLACES)
    between = np.maximum(np.pi - turns - aside, 0.0)  # the angle at s between z and the nearest of them
    ratio = np.clip(np.cos(between), 0.0, radius / farthest)
    nearness = 1.0 / np.sqrt(1.0 - 2.0 * ratio * np.cos(between) + ratio**2)
    bound = radius * nearness * max(others, 0.0) / max(np.cos(aside), 1e-3)
    passed = np.append(0.0, np.cumsum(0.5 * (bound[1:] + bound[:-1]) * np.diff(turns)))
    places = int(np.ceil(passed[-1] / SURE_TURN)) + LEAST_PLACES
    if places > MOST_PLACES:
        raise HalfPlaneError("the number of eigenvalues near the imaginary axis is not decided")
    return np.interp(np.linspace(0.0, passed[-1], places), passed, turns)


def _missing(shifted: _Shifted, shift: float, radius: float, known: ComplexArray, turns: Array) -> int:
    """How many eigenvalues within a circle are not among the known ones."""
    places = shift + radius * np.exp(1j * turns)
    angles = np.array([shifted.angle(complex(z)) - np.sum(np.angle(z - known)) for z in places])
    changes = (np.diff(angles) + np.pi) % (2.0 * np.pi) - np.pi
    return round(float(np.sum(changes)) / np.pi)
