"""Blocks of two mu on an interval: every edge of an instability as a simple zero of an analytic function.

On such a block there are matrices k, p, q of two rows, with p k symmetric and p q = k^T (1 + k^T). Where p is definite
both mu are real. Where it is not, it has two null vectors n+ and n-, and the discriminant of k is 4 f+ f- / rho^2 with
f = n^T p k n for each of them and rho = n+^T p n-: the pair is complex where f+ f- < 0, and the edges of this
instability are simple zeros of f+ and f-, however near they lie. Likewise with q and k^T.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.decoupling import SERIES_DEGREE, Booleans, Indices
from casadi_skin.stability.tongues.small_blocks import ERROR_SAFETY, Block, Edge, growth_of, local_places, real_growth
from casadi_skin.stability.tongues.zeros import Function
from casadi_skin.zero.problem import Array

FINE_DEGREE = 2 * SERIES_DEGREE  # degree of functions that are products
ROUNDED_MU_DISTANCE = 1e-7  # distance of two mu that rounding makes of none


class PairBlock(Block):
    """Two mu that may meet.

    `ends` are det p and det q, `meetings` f+ and f-, none for a definite pair; of a map that is not symplectic det k
    and det (1 + k), and the discriminant. `series` are coefficients (FINE + 1, 2) of the mean of both mu and of rho:
    with f+ f- / rho^2 the square of half their difference is known with all digits where it is small. See `Pairs`.
    """

    def __init__(
        self,
        start: float,
        end: float,
        parts: Array,
        errors: Array,
        noise: Array,
        tails: Array,
        ends: tuple[Function, Function],
        meetings: tuple[Function, ...],
        series: Array,
    ) -> None:
        super().__init__(start, end, parts, errors, noise, tails)
        self.ends, self.meetings = ends, meetings
        self.functions = (*meetings, *ends)
        self._series = np.column_stack([series, *(function.coefficients for function in self.functions)])

    @property
    def definite(self) -> bool:
        """Whether its mu have one signature and are real."""
        return not self.meetings

    @property
    def alike(self) -> Hashable:
        return len(self.meetings)

    @classmethod
    def _values(cls, blocks: Sequence[PairBlock], x: Array) -> tuple[Array, Array, Array]:
        """Mean of both mu, the square of half their difference, and the product of both mu (1 + mu).

        At places of each of several blocks that are alike, (blocks, points).
        """
        values = chebyshev.basis(x, FINE_DEGREE) @ np.stack([block._series for block in blocks])
        mean, rho, meetings = values[..., 0], values[..., 1], values[..., 2:-2]
        if meetings.shape[-1] == 2:
            square = meetings[..., 0] * meetings[..., 1] / rho**2
        elif meetings.shape[-1] == 1:
            square = 0.25 * meetings[..., 0]
        else:
            k = np.stack([block.coefficients[:, 0].reshape(-1, 4) for block in blocks])
            k = (chebyshev.basis(x, SERIES_DEGREE) @ k).reshape(*x.shape, 2, 2)
            square = np.maximum(0.25 * discriminants(k), 0.0)
        product = values[..., -2] * values[..., -1]
        conserved = np.array([any(function.is_nothing for function in block.ends) for block in blocks])
        product[conserved] = np.abs(product[conserved])  # a second conserved quantity: one stays at -1 or 0
        return mean, square, product

    @cached_property
    def edges(self) -> list[tuple[Edge, bool]]:
        found = []
        for function in self.meetings:
            for x, width, crosses in function.zeros:
                mu = float((chebyshev.basis(x, FINE_DEGREE) @ self._series)[0])
                met = (1, -1) if self.noise.size == 3 and -1.0 < mu < 0.0 else ()
                found.append((self._edge(x, width, "complex", mu, met), crosses))
        for which, function in enumerate(self.ends):
            for x, width, crosses in function.zeros:
                end, signatures = self._leaving(x, which)
                found.append((self._edge(x, width, "real", end, signatures), crosses))
        return sorted(found, key=lambda item: item[0].coordinate)

    def _leaving(self, x: float, which: int) -> tuple[float, tuple[int, ...]]:
        """The end of [-1, 0] that a mu of the pair is at, and its signature."""
        parts = self.at(np.array([x]))[0]
        values, vectors = np.linalg.eig(parts[0])
        chosen = int(np.argmin(np.abs(values * (1.0 + values))))
        mu = float(np.round(values[chosen].real)) + 0.0  # no negative zero
        if self.noise.size == 1:
            return mu, ()
        if which == 0:
            left = np.linalg.inv(vectors)[chosen].real
            return mu, (int(np.sign(left @ parts[2] @ left)),)
        right = vectors[:, chosen].real
        return mu, (-int(np.sign(right @ parts[1] @ right)),)

    @classmethod
    def states_together(cls, blocks: Sequence[PairBlock], x: Array) -> tuple[Booleans, Indices]:
        mean, square, product = cls._values(blocks, x)
        # Of two real mu that are both in [-1, 0] or both outside, the sum of mu (1 + mu) decides.
        both = mean + mean**2 + square > 0.0
        outside = np.where(product < 0.0, 1, np.where(both, 2, 0))
        return square < 0.0, np.where(square < 0.0, 2, outside)

    @classmethod
    def mu_together(cls, blocks: Sequence[PairBlock], coordinates: Array) -> ComplexArray:
        mean, square, _ = cls._values(blocks, local_places(blocks, coordinates))
        root = np.sqrt(square + 0j)
        return np.stack([mean + root, mean - root], axis=-1)

    @classmethod
    def growths_together(cls, blocks: Sequence[PairBlock], coordinates: Array) -> Array:
        mean, square, product = cls._values(blocks, local_places(blocks, coordinates))
        root = np.sqrt(square + 0j)
        mu = np.stack([mean + root, mean - root], axis=-1)
        inside = np.min((mu * (1.0 + mu)).real, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            one = real_growth(product / inside)
        return np.asarray(np.where(product < 0.0, one, np.max(growth_of(mu), axis=-1)))

    def meetings_without_instability(self) -> list[tuple[float, float, float]]:
        """(coordinate, mu, distance) where the two mu of a definite pair meet within errors."""
        k = self.at(chebyshev.nodes(FINE_DEGREE))[:, 0]
        slope = chebyshev.derivative(FINE_DEGREE) @ chebyshev.transform(FINE_DEGREE) @ discriminants(k)
        allowed = ERROR_SAFETY * float(np.max(np.abs(self.errors[:, 0]))) + float(self.noise[0])
        found = []
        _, zeros, crosses = chebyshev.real_zeros(slope[:, None])
        for x in np.sort(zeros[crosses]).tolist():
            here = self.at(np.array([x]))[:, 0]
            distance = float(np.sqrt(max(discriminants(here)[0], 0.0)))
            if distance <= max(allowed, ROUNDED_MU_DISTANCE):
                found.append((self.coordinate(x), 0.5 * float(np.trace(here[0])), distance))
        return found


def discriminants(k: Array) -> Array:
    """(mu_1 - mu_2)^2 of matrices of two rows."""
    return np.asarray((k[..., 0, 0] - k[..., 1, 1]) ** 2 + 4.0 * k[..., 0, 1] * k[..., 1, 0])


def null_vectors(parts: Array, form: int, turn: Array) -> tuple[Array, Array, Array, Array, Array]:
    """The form, k, form k and the null vectors n+ and n- (pairs, points, 2), in coordinates turned by (pairs, 2, 2).

    The form is p with k, or q with k^T: `form` 1 or 2. No number where it is definite.
    """
    R = turn[:, None]
    back = R.swapaxes(2, 3)
    k = parts[:, :, 0] if form == 1 else parts[:, :, 0].swapaxes(2, 3)
    matrix, k = back @ _symmetric(parts[:, :, form]) @ R, back @ k @ R
    a, b, c = matrix[..., 0, 0], matrix[..., 0, 1], matrix[..., 1, 1]
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - a * c)
        plus, minus = (np.stack([(sign * root - b) / a, np.ones_like(a)], axis=-1) for sign in (1.0, -1.0))
    return matrix, k, _symmetric(matrix @ k), plus, minus


def _value(form: Array, left: Array, right: Array) -> Array:
    """left^T form right, point by point."""
    return np.asarray(np.sum(left[..., :, None] * form * right[..., None, :], axis=(-1, -2)))


def _symmetric(matrices: Array) -> Array:
    return np.asarray(0.5 * (matrices + matrices.swapaxes(-1, -2)))


def _determinants(matrices: Array) -> Array:
    return np.asarray(matrices[..., 0, 0] * matrices[..., 1, 1] - matrices[..., 0, 1] * matrices[..., 1, 0])


def _determinant_errors(matrices: Array, errors: Array, noise: Array) -> Array:
    """Errors of determinants of two rows, from matrices like errors and bounds on the norm of the rest."""
    m, e = matrices, errors
    first = m[..., 1, 1] * e[..., 0, 0] + m[..., 0, 0] * e[..., 1, 1]
    first = first - m[..., 0, 1] * e[..., 1, 0] - m[..., 1, 0] * e[..., 0, 1]
    return np.asarray(ERROR_SAFETY * np.abs(first) + noise * np.linalg.norm(matrices, axis=(-2, -1)))


@dataclass(frozen=True)
class Pairs:
    """Several pairs of mu on their intervals, as `Block` has them.

    `parts` and `errors` have shape (pairs, J, 3 or 1, 2, 2), `noise` and `tails` (pairs, 3 or 1).
    """

    starts: Array
    ends: Array
    parts: Array
    errors: Array
    noise: Array
    tails: Array

    def blocks(self) -> list[PairBlock | None]:
        """A block of each pair, None where its interval is too long for either form."""
        fine = chebyshev.combined(chebyshev.refinement(SERIES_DEGREE, FINE_DEGREE), self.parts)
        ends = self._ends(fine)
        usable, rho = np.ones(len(self.parts), dtype=bool), np.ones(fine.shape[:2])
        if self.parts.shape[2] == 3:
            meetings, rho, usable = self._null_functions(fine, [coefficients for coefficients, _ in ends])
        else:
            meetings = [self._discriminant(fine)]
        mean = 0.5 * (fine[:, :, 0, 0, 0] + fine[:, :, 0, 1, 1])
        series = (chebyshev.transform(FINE_DEGREE) @ np.stack([mean, rho], axis=2)).swapaxes(0, 1)
        first, last = (Function.several(*each) for each in ends)
        all_met = list(zip(*(Function.several(*each) for each in meetings), strict=True))
        found: list[PairBlock | None] = []
        for i in range(len(self.parts)):
            if not usable[i]:
                found.append(None)
                continue
            met = tuple(function for function in all_met[i] if np.isfinite(function.coefficients[0]))
            where = float(self.starts[i]), float(self.ends[i])
            matrices = self.parts[i], self.errors[i], self.noise[i], self.tails[i]
            found.append(PairBlock(*where, *matrices, (first[i], last[i]), met, series[:, i]))
        return found

    def _ends(self, fine: Array) -> list[tuple[Array, Array]]:
        """Coefficients and errors at the nodes of det p and det q, or of det k and det (1 + k)."""
        symplectic = self.parts.shape[2] == 3
        found = []
        for index, shift in ((1, 0.0), (2, 0.0)) if symplectic else ((0, 0.0), (0, 1.0)):
            values = _determinants(fine[:, :, index] + shift * np.eye(2))
            coarse = self.parts[:, :, index] + shift * np.eye(2)
            errors = _determinant_errors(coarse, self.errors[:, :, index], (self.noise + self.tails)[:, [index]])
            found.append(_series(values, errors))
        return found

    def _discriminant(self, fine: Array) -> tuple[Array, Array]:
        """(mu_1 - mu_2)^2 of maps that are not symplectic."""
        k, change, noise = self.parts[:, :, 0], ERROR_SAFETY * self.errors[:, :, 0], (self.noise + self.tails)[:, [0]]
        by_flow = np.abs(discriminants(k + change) - discriminants(k)) + np.abs(discriminants(change))
        by_noise = 4.0 * noise * (np.linalg.norm(k, axis=(2, 3)) + noise)
        return _series(discriminants(fine[:, :, 0]), by_flow + by_noise)

    def _null_functions(self, fine: Array, ends: Sequence[Array]) -> tuple[list[tuple[Array, Array]], Array, Booleans]:
        """f+ and f-, no numbers where the form is definite, and rho, by the form whose determinant has no zero.

        The last result marks the pairs that have one.
        """
        count = len(self.parts)
        usable = np.zeros(count, dtype=bool)
        coefficients, rho = np.full((2, FINE_DEGREE + 1, count), np.nan), np.ones(fine.shape[:2])
        errors = np.zeros((2, count, SERIES_DEGREE + 1))
        for index in (1, 2):
            turn = np.linalg.eigh(_symmetric(fine[:, FINE_DEGREE // 2, index]))[1]
            form, _, s, *vectors = null_vectors(fine, index, turn)
            regular = chebyshev.excludes_zero(ends[index - 1]) & ~usable
            definite = regular & (ends[index - 1][0] > 0.0)
            corner = chebyshev.transform(FINE_DEGREE) @ form[..., 0, 0].T
            split = regular & ~definite & chebyshev.excludes_zero(corner)
            coarse = null_vectors(self.parts[split], index, turn[split])
            for which, n in enumerate(vectors):
                series = _series(_value(s[split], n[split], n[split]), self._errors(coarse, which, index, turn, split))
                coefficients[which][:, split], errors[which][split] = series
            rho[split] = _value(form[split], vectors[0][split], vectors[1][split])
            usable |= split | definite
        return [(coefficients[i], errors[i]) for i in (0, 1)], rho, usable

    def _errors(self, coarse: tuple[Array, ...], which: int, index: int, turn: Array, chosen: Booleans) -> Array:
        """Errors of f at the nodes: at a double mu only those of k show, between p n and n."""
        form, n = coarse[0], coarse[3 + which]
        change = self.errors[chosen][:, :, 0]
        change = (
            turn[chosen][:, None].swapaxes(2, 3)
            @ (change if index == 1 else change.swapaxes(2, 3))
            @ turn[chosen][:, None]
        )
        left = np.sum(form * n[..., None, :], axis=-1)
        size = np.linalg.norm(left, axis=-1) * np.linalg.norm(n, axis=-1)
        return np.asarray(
            ERROR_SAFETY * np.abs(_value(change, left, n)) + (self.noise + self.tails)[chosen][:, [0]] * size
        )


def _series(values: Array, errors: Array) -> tuple[Array, Array]:
    """Coefficients (FINE + 1, pairs) of values (pairs, FINE + 1), and errors (pairs, J) with those of truncation."""
    coefficients = chebyshev.transform(FINE_DEGREE) @ values.T
    return coefficients, errors + chebyshev.tail(coefficients)[:, None]
