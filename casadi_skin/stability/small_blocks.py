"""Blocks of one or two mu on an interval: every edge of an instability as a simple zero of an analytic function.

One mu: with right and left eigenvectors x, y of K (y.x = 1), pi = x^T P x and kappa = y^T Q y, there is pi kappa =
mu (1 + mu). It lies in (-1, 0) where pi kappa < 0, and leaves through -1 or 0 where pi or kappa passes zero.

Two mu: on the block there are matrices k, p, q of two rows, with p k symmetric and p q = k^T (1 + k^T). Where p is
definite both mu are real. Where it is not, it has two null vectors n+ and n-, and the discriminant of k is
4 f+ f- / rho^2 with f = n^T p k n for each of them and rho = n+^T p n-: the pair is complex where f+ f- < 0, and the edges
of this instability are simple zeros of f+ and f-, however near they lie. Likewise with q and k^T.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.stability import chebyshev
from casadi_skin.stability.blocks import DEGREE, Numbers
from casadi_skin.stability.reduction import ComplexArray

FINE = 2 * DEGREE  # degree of functions that are products
FINEST = 1e-14  # of an interval: no place in it is known better
SAFETY = 2.0  # of estimated errors of the matrices
ROUNDED = 1e-7  # distance of two mu that rounding makes of none
REACH = 2  # nodes to either side of a place whose errors count there


@dataclass(frozen=True)
class Edge:
    """A place where a block changes between stable and unstable, or from one kind of instability to the other.

    `kind` is "real" where `mu` passes -1 or 0, "collision" where two mu become complex or cease to be so;
    `signatures` are those of what meets, () where there are none.
    """

    coordinate: float
    error: float
    kind: str
    mu: float
    signatures: tuple[int, ...]


@dataclass(frozen=True)
class Segment:
    """A part of an interval in which a block is unstable; an edge is None where the interval ends before.

    `outside` counts mu off the real axis or outside [-1, 0]; `is_complex` tells which of the two. A segment of no
    length is one whose edge is touched, within errors, but not seen to be passed.
    """

    block: Block
    start: float
    end: float
    start_edge: Edge | None
    end_edge: Edge | None
    is_complex: bool
    outside: int


class Function:
    """A function on [-1, 1] whose zeros are edges: its Chebyshev coefficients, and its errors at the nodes."""

    def __init__(self, coefficients: Array, errors: Array) -> None:
        self.coefficients, self.errors = coefficients, errors
        self._places: tuple[Array, Array] | None = None

    def __call__(self, x: Array | float) -> Array:
        return np.asarray(chebyshev.basis(x, len(self.coefficients) - 1) @ self.coefficients)

    def error(self, x: float) -> float:
        """Error near a place."""
        near = int(np.searchsorted(chebyshev.nodes(DEGREE), x))
        return float(np.max(self.errors[max(near - REACH, 0) : near + REACH]))

    @property
    def excludes_zero(self) -> bool:
        """Whether it certainly has no zero, nor comes as near to zero as its error."""
        rest = float(np.sum(np.abs(self.coefficients[1:])) + np.max(self.errors))
        return bool(abs(self.coefficients[0]) > rest)

    @property
    def is_nothing(self) -> bool:
        """Whether it is zero everywhere, within its error."""
        return bool(np.sum(np.abs(self.coefficients)) <= np.min(self.errors))

    @staticmethod
    def find_zeros(functions: Sequence[Function]) -> None:
        """Find the zeros of several functions together: that is cheaper."""
        open_ones = [f for f in functions if f._places is None]
        for f in open_ones:
            f._places = (np.empty(0), np.empty(0))
        for size in {f.coefficients.size for f in open_ones}:
            chosen = [f for f in open_ones if f.coefficients.size == size and not (f.excludes_zero or f.is_nothing)]
            if chosen:
                found = chebyshev.real_zeros(np.stack([f.coefficients for f in chosen], axis=1))
                for function, places in zip(chosen, found, strict=True):
                    function._places = places

    @cached_property
    def zeros(self) -> list[tuple[float, float, bool]]:
        """(place, its error, whether the function changes sign there) in ascending order.

        Without a change of sign where the function comes so near to zero that its error may hide two changes.
        """
        Function.find_zeros([self])
        assert self._places is not None
        changes, near = self._places
        found = [(x, self._width(x), True) for x in changes.tolist()]
        found += [(x, self._width(x), False) for x in near.tolist() if abs(self(x)) <= self.error(x)]
        return sorted(found)

    def _width(self, x: float) -> float:
        """How far a zero moves when the function changes by its error: by slope, or by curvature where that is more."""
        degree = len(self.coefficients) - 1
        matrix, error = chebyshev.derivative(degree), self.error(x)
        here, first = chebyshev.basis(x, degree), matrix @ self.coefficients
        slope, curvature = abs(float(here @ first)), abs(float(here @ (matrix @ first)))
        if slope**2 > 2.0 * curvature * error:
            return error / slope + FINEST
        return float(np.sqrt(2.0 * error / curvature)) + FINEST if curvature > 0.0 else 2.0


def growth_of(mu: ComplexArray) -> Array:
    """log |lambda(M)| >= 0 of each mu, with lambda + 1/lambda = 2 + 4 mu."""
    mu = np.asarray(mu, dtype=complex)
    return np.asarray(np.abs(2.0 * np.log(np.abs(np.sqrt(mu) + np.sqrt(mu + 1.0)))))


def _real_growth(product: Array) -> Array:
    """The same of a real mu from mu (1 + mu): without loss of digits near -1 and 0."""
    return np.asarray(np.arcsinh(2.0 * np.sqrt(np.maximum(product, 0.0))))


class Block:
    """Matrices (k, p, q), or k alone, of some mu at the nodes of an interval, shape (DEGREE + 1, 3 or 1, m, m).

    `errors` are matrices like their errors at the nodes, `noise` and `tails` (3 or 1,) bounds on the norm of what comes
    to these: from elsewhere, and from the series on the interval, which shorter intervals lessen.
    """

    functions: tuple[Function, ...] = ()

    def __init__(
        self, start: float, end: float, parts: Numbers, errors: Array, noise: Array, tails: Array
    ) -> None:
        self.start, self.end, self.parts, self.errors, self.tails = start, end, parts, errors, tails
        self.noise = noise + tails
        self._coarse = bool(np.any(tails > noise + np.max(np.abs(errors), axis=(0, 2, 3))))

    @cached_property
    def coefficients(self) -> Numbers:
        """Of the matrices, shape (DEGREE + 1, 3 or 1, m, m)."""
        return np.tensordot(chebyshev.transform(DEGREE), self.parts, 1)

    def at(self, x: Array) -> Numbers:
        """The matrices at places in [-1, 1], shape (places, 3 or 1, m, m)."""
        return np.tensordot(chebyshev.basis(x, DEGREE), self.coefficients, 1)

    def local(self, coordinates: Array | float) -> Array:
        """Places in [-1, 1] of coordinates."""
        x = (2.0 * np.asarray(coordinates) - self.start - self.end) / (self.end - self.start)
        return np.asarray(np.clip(x, -1.0, 1.0))

    def coordinate(self, x: float) -> float:
        """Coordinate of a place in [-1, 1]."""
        if abs(x) == 1.0:
            return self.start if x < 0.0 else self.end
        return self.start + 0.5 * (1.0 + x) * (self.end - self.start)

    def mu(self, coordinates: Array) -> ComplexArray:
        """All mu of the block, shape (points, m)."""
        return np.asarray(np.linalg.eigvals(self.at(self.local(coordinates))[:, 0]), dtype=complex)

    def growth(self, coordinates: Array) -> Array:
        """log |lambda(M)| of the most unstable multiplier of the block at coordinates."""
        return np.asarray(np.max(growth_of(self.mu(coordinates)), axis=1))

    @property
    def is_blurred(self) -> bool:
        """Whether a shorter interval would tell whether one of its instabilities is there."""
        if not self._coarse:
            return False
        bounds = [(s.end - s.start, s.start_edge, s.end_edge) for s in self.segments]
        return any(a is not None and b is not None and length <= a.error + b.error for length, a, b in bounds)

    @property
    def is_quiet(self) -> bool:
        """Whether it is stable on the whole interval."""
        return all(f.excludes_zero for f in self.functions) and not self.states(np.zeros(1))[1].any()

    def unstable_mu(self, segment: Segment, coordinate: float) -> ComplexArray:
        """Those mu of the block that are unstable on a segment, at a coordinate."""
        mu = self.mu(np.array([coordinate]))[0]
        if segment.is_complex:
            return mu
        order = np.argsort(-(mu * (1.0 + mu)).real)
        return np.asarray(mu[order[: segment.outside]])

    @cached_property
    def edges(self) -> list[tuple[Edge, bool]]:
        """Edges in order, and whether the state changes there."""
        return []

    def states(self, x: Array) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        """Whether the mu outside are complex, and how many are outside, at places that are no edges."""
        raise NotImplementedError

    def _edge(self, x: float, width: float, kind: str, mu: float, signatures: tuple[int, ...]) -> Edge:
        return Edge(self.coordinate(x), 0.5 * (self.end - self.start) * width, kind, mu, signatures)

    @cached_property
    def segments(self) -> list[Segment]:
        """Where the block is unstable, in order."""
        crossed = [edge for edge, crosses in self.edges if crosses]
        stops = [self.start, *(edge.coordinate for edge in crossed), self.end]
        bounds: list[Edge | None] = [None, *crossed, None]
        is_complex, outside = self.states(self.local(0.5 * (np.array(stops[:-1]) + np.array(stops[1:]))))
        found = [
            Segment(self, stops[i], stops[i + 1], bounds[i], bounds[i + 1], bool(is_complex[i]), int(outside[i]))
            for i in np.flatnonzero(outside).tolist()
        ]
        for edge in (edge for edge, crosses in self.edges if not crosses):
            place = edge.coordinate
            if not any(segment.start <= place <= segment.end for segment in found):
                found.append(Segment(self, place, place, edge, edge, edge.kind != "real", 1))
        return sorted(found, key=lambda segment: segment.start)


class ComplexBlock(Block):
    """Mu on one side of the real axis that do not come to it within the interval."""

    def states(self, x: Array) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        return np.ones(x.shape, dtype=bool), np.full(x.shape, self.parts.shape[-1])


class SingleBlock(Block):
    """One real mu; `functions` are pi and kappa, of a map that is not symplectic mu and 1 + mu."""

    def __init__(self, start: float, end: float, parts: Array, errors: Array, noise: Array, tails: Array) -> None:
        super().__init__(start, end, parts, errors, noise, tails)
        noise = self.noise
        c = np.asarray(self.coefficients[:, :, 0, 0].real)
        error = SAFETY * np.abs(errors[:, :, 0, 0]) + noise
        if noise.size == 3:
            self.functions = Function(c[:, 1], error[:, 1]), Function(c[:, 2], error[:, 2])
        else:
            shifted = c[:, 0].copy()
            shifted[0] += 1.0
            self.functions = Function(c[:, 0], error[:, 0]), Function(shifted, error[:, 0])

    @cached_property
    def edges(self) -> list[tuple[Edge, bool]]:
        first, second = self.functions
        found = []
        for function, other, sign in ((first, second, 1), (second, first, -1)):
            for x, width, crosses in function.zeros:
                mu = float(np.round(self.mu(np.array([self.coordinate(x)]))[0, 0].real))
                signatures = (sign * int(np.sign(other(x))),) if self.noise.size == 3 else ()
                found.append((self._edge(x, width, "real", mu, signatures), crosses))
        return sorted(found, key=lambda item: item[0].coordinate)

    def states(self, x: Array) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        outside = (self.functions[0](x) * self.functions[1](x) > 0.0).astype(np.int64)
        if any(function.is_nothing for function in self.functions):
            outside[:] = 0  # a second conserved quantity: it stays at -1 or 0
        return np.zeros(x.shape, dtype=bool), outside

    def growth(self, coordinates: Array) -> Array:
        x = self.local(coordinates)
        return _real_growth(self.functions[0](x) * self.functions[1](x))


class PairBlock(Block):
    """Two mu that may meet: `ends` are det p and det q (det k and det (1 + k)), `meetings` f+ and f- (the discriminant).

    `series` are coefficients (FINE + 1, 2) of the mean of both mu and of rho; with f+ f- / rho^2 the square of half their
    difference is known with all digits where it is small. Without null vectors rho is 1 and half the difference that of
    k. See `Pairs`.
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

    def _values(self, x: Array) -> tuple[Array, Array, Array]:
        """Mean of both mu, the square of half their difference, and the product of both mu (1 + mu), at places."""
        values = chebyshev.basis(x, FINE) @ self._series
        mean, rho, meetings = values[..., 0], values[..., 1], values[..., 2:-2]
        if meetings.shape[-1] == 2:
            square = meetings[..., 0] * meetings[..., 1] / rho**2
        elif meetings.shape[-1] == 1:
            square = 0.25 * meetings[..., 0]
        else:
            square = np.maximum(0.25 * discriminants(self.at(x)[:, 0]), 0.0)
        product = values[..., -2] * values[..., -1]
        if any(function.is_nothing for function in self.ends):
            product = np.abs(product)  # a second conserved quantity: one of them stays at -1 or 0
        return mean, square, product

    @cached_property
    def edges(self) -> list[tuple[Edge, bool]]:
        found = []
        for function in self.meetings:
            for x, width, crosses in function.zeros:
                mu = float((chebyshev.basis(x, FINE) @ self._series)[0])
                signatures = (1, -1) if self.noise.size == 3 and -1.0 < mu < 0.0 else ()
                found.append((self._edge(x, width, "collision", mu, signatures), crosses))
        for which, function in enumerate(self.ends):
            for x, width, crosses in function.zeros:
                mu, signatures = self._leaving(x, which)
                found.append((self._edge(x, width, "real", mu, signatures), crosses))
        return sorted(found, key=lambda item: item[0].coordinate)

    def _leaving(self, x: float, which: int) -> tuple[float, tuple[int, ...]]:
        """The end of [-1, 0] that a mu of the pair is at, and its signature."""
        parts = self.at(np.array([x]))[0]
        values, vectors = np.linalg.eig(parts[0])
        chosen = int(np.argmin(np.abs(values * (1.0 + values))))
        mu = float(np.round(values[chosen].real))
        if self.noise.size == 1:
            return mu, ()
        if which == 0:
            left = np.linalg.inv(vectors)[chosen].real
            return mu, (int(np.sign(left @ parts[2] @ left)),)
        right = vectors[:, chosen].real
        return mu, (-int(np.sign(right @ parts[1] @ right)),)

    def states(self, x: Array) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
        mean, square, product = self._values(x)
        # Of two real mu that are both in [-1, 0] or both outside, the sum of mu (1 + mu) tells which.
        both = mean + mean**2 + square > 0.0
        outside = np.where(product < 0.0, 1, np.where(both, 2, 0))
        return square < 0.0, np.where(square < 0.0, 2, outside)

    def mu(self, coordinates: Array) -> ComplexArray:
        mean, square, _ = self._values(self.local(coordinates))
        root = np.sqrt(square + 0j)
        return np.stack([mean + root, mean - root], axis=-1)

    def growth(self, coordinates: Array) -> Array:
        mean, square, product = self._values(self.local(coordinates))
        root = np.sqrt(square + 0j)
        mu = np.stack([mean + root, mean - root], axis=-1)
        inside = np.min((mu * (1.0 + mu)).real, axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            one = _real_growth(product / inside)
        return np.asarray(np.where(product < 0.0, one, np.max(growth_of(mu), axis=1)))

    def meetings_without_instability(self) -> list[tuple[float, float, float]]:
        """(coordinate, mu, distance) where the two mu of a definite pair meet within errors."""
        k = self.at(chebyshev.nodes(FINE))[:, 0]
        slope = chebyshev.derivative(FINE) @ chebyshev.transform(FINE) @ discriminants(k)
        allowed = SAFETY * float(np.max(np.abs(self.errors[:, 0]))) + float(self.noise[0])
        found = []
        for x in chebyshev.real_zeros(slope[:, None])[0][0].tolist():
            here = self.at(np.array([x]))[:, 0]
            distance = float(np.sqrt(max(discriminants(here)[0], 0.0)))
            if distance <= max(allowed, ROUNDED):
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
    return np.asarray(SAFETY * np.abs(first) + noise * np.linalg.norm(matrices, axis=(-2, -1)))


@dataclass(frozen=True)
class Pairs:
    """Several pairs of mu on their intervals: matrices (pairs, J, 3 or 1, 2, 2), errors of one shape, noise and tails (pairs, 3 or 1)."""

    starts: Array
    ends: Array
    parts: Array
    errors: Array
    noise: Array
    tails: Array

    def blocks(self) -> list[PairBlock | None]:
        """A block of each pair, None where its interval is too long for either form."""
        fine = np.tensordot(chebyshev.refinement(DEGREE, FINE), self.parts, (1, 1)).swapaxes(0, 1)
        ends = self._ends(fine)
        usable, rho = np.ones(len(self.parts), dtype=bool), np.ones(fine.shape[:2])
        if self.parts.shape[2] == 3:
            meetings, rho, usable = self._null_functions(fine, [coefficients for coefficients, _ in ends])
        else:
            meetings = [self._discriminant(fine)]
        mean = 0.5 * (fine[:, :, 0, 0, 0] + fine[:, :, 0, 1, 1])
        series = np.tensordot(chebyshev.transform(FINE), np.stack([mean, rho], axis=2), (1, 1))
        found: list[PairBlock | None] = []
        for i in range(len(self.parts)):
            functions = [tuple(Function(c[:, i], e[i]) for c, e in some if np.isfinite(c[0, i])) for some in (ends, meetings)]
            where = float(self.starts[i]), float(self.ends[i])
            matrices = self.parts[i], self.errors[i], self.noise[i], self.tails[i]
            found.append(PairBlock(*where, *matrices, *functions, series[:, i]) if usable[i] else None)
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
        k, change, noise = self.parts[:, :, 0], SAFETY * self.errors[:, :, 0], (self.noise + self.tails)[:, [0]]
        by_flow = np.abs(discriminants(k + change) - discriminants(k)) + np.abs(discriminants(change))
        by_noise = 4.0 * noise * (np.linalg.norm(k, axis=(2, 3)) + noise)
        return _series(discriminants(fine[:, :, 0]), by_flow + by_noise)

    def _null_functions(
        self, fine: Array, ends: Sequence[Array]
    ) -> tuple[list[tuple[Array, Array]], Array, NDArray[np.bool_]]:
        """f+ and f-, no numbers where the form is definite, and rho, by the form whose determinant has no zero.

        The last result tells for which pairs there is one.
        """
        count = len(self.parts)
        usable = np.zeros(count, dtype=bool)
        coefficients, rho = np.full((2, FINE + 1, count), np.nan), np.ones(fine.shape[:2])
        errors = np.zeros((2, count, DEGREE + 1))
        for index in (1, 2):
            turn = np.linalg.eigh(_symmetric(fine[:, FINE // 2, index]))[1]
            form, _, s, *vectors = null_vectors(fine, index, turn)
            regular = chebyshev.excludes_zero(ends[index - 1]) & ~usable
            definite = regular & (ends[index - 1][0] > 0.0)
            corner = chebyshev.transform(FINE) @ form[..., 0, 0].T
            split = regular & ~definite & chebyshev.excludes_zero(corner)
            coarse = null_vectors(self.parts[split], index, turn[split])
            for which, n in enumerate(vectors):
                series = _series(_value(s[split], n[split], n[split]), self._errors(coarse, which, index, turn, split))
                coefficients[which][:, split], errors[which][split] = series
            rho[split] = _value(form[split], vectors[0][split], vectors[1][split])
            usable |= split | definite
        return [(coefficients[i], errors[i]) for i in (0, 1)], rho, usable

    def _errors(
        self, coarse: tuple[Array, ...], which: int, index: int, turn: Array, chosen: NDArray[np.bool_]
    ) -> Array:
        """Errors of f at the nodes: at a double mu only those of k show, between p n and n."""
        form, n = coarse[0], coarse[3 + which]
        change = self.errors[chosen][:, :, 0]
        change = turn[chosen][:, None].swapaxes(2, 3) @ (change if index == 1 else change.swapaxes(2, 3)) @ turn[chosen][:, None]
        left = np.sum(form * n[..., None, :], axis=-1)
        size = np.linalg.norm(left, axis=-1) * np.linalg.norm(n, axis=-1)
        return np.asarray(SAFETY * np.abs(_value(change, left, n)) + (self.noise + self.tails)[chosen][:, [0]] * size)


def _series(values: Array, errors: Array) -> tuple[Array, Array]:
    """Coefficients (FINE + 1, pairs) of values (pairs, FINE + 1), and errors (pairs, J) with what these leave out."""
    coefficients = chebyshev.transform(FINE) @ values.T
    return coefficients, errors + chebyshev.tail(coefficients)[:, None]
