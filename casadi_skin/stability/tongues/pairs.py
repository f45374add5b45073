"""Blocks of one or two mu on an interval: every edge of an instability as a simple zero of an analytic function.

On such a block there are matrices k, p, q of one or two rows, with p k symmetric and p q = k^T (1 + k^T). A mu passes 0
or -1 where det p or det q vanishes. Of two mu, both are real where p is definite. Where it is not, it has two null
vectors n+ and n-, and the discriminant of k is 4 f+ f- / rho^2 with f = n^T p k n for each of them and rho = n+^T p n-:
the pair is complex where f+ f- < 0, and the edges of this instability are simple zeros of f+ and f-, however near they
lie. Likewise with q and k^T. Without a symplectic structure there is k alone: zeros are those of det k, det (1 + k)
and the discriminant.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebval

from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.blocks import Booleans, Matrices, Numbers
from casadi_skin.stability.tongues.chebyshev import SERIES_DEGREE, Function, find_zeros
from casadi_skin.zero.problem import Array, Indices

ERROR_SAFETY = 2.0  # of estimated errors of the matrices
FINE_DEGREE = 2 * SERIES_DEGREE  # degree of functions that are products
ROUNDED_MU_DISTANCE = 1e-7  # distance of two mu that rounding makes of none


@dataclass(frozen=True)
class Edge:
    """A place where a block changes between stable and unstable, or from one kind of instability to the other.

    `kind` is "real" where `mu` passes -1 or 0, "complex" where two mu become complex or cease to be so;
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

    `outside` counts mu off the real axis or outside [-1, 0]; `is_complex` distinguishes the two. A segment of no
    length is one whose edge is touched, within errors, but not seen to be passed, or passed in both ways in one place.
    """

    block: Block
    start: float
    end: float
    start_edge: Edge | None
    end_edge: Edge | None
    is_complex: bool
    outside: int

    def holds(self, edge: Edge) -> bool:
        """Whether a place that is touched lies in it, or within its error of it where it is not decided."""
        known = sum(own.error for own in (self.start_edge, self.end_edge) if own is not None)
        alike = self.is_complex == (edge.kind != "real")
        slack = edge.error if alike and self.start_edge and self.end_edge and self.end - self.start <= known else 0.0
        return self.start - slack <= edge.coordinate <= self.end + slack

    def unstable(self, mu: ComplexArray) -> ComplexArray:
        """Those of the block's mu at a place, (m,), that are unstable on it."""
        order = np.argsort(-(mu * (1.0 + mu)).real)  # what is no number comes last
        return np.asarray(mu[order[: self.outside]])

    def edge_at(self, coordinate: float) -> Edge | None:
        """The edge that errors allow at the end of its interval, where none is seen; None where they allow none."""
        block, x = self.block, -1.0 if coordinate == self.block.start else 1.0
        widths = [width for f in block.functions if (width := f.near_zero(x, ERROR_SAFETY)) is not None]
        if not widths:
            return None
        mu = complex(np.mean(self.unstable(evaluate([block], np.array([[coordinate]]))[0][0, 0])))
        error = 0.5 * (block.end - block.start) * max(widths)
        if self.is_complex:
            return Edge(coordinate, error, "complex", mu.real, (1, -1) if block.symplectic else ())
        return Edge(coordinate, error, "real", float(np.round(mu.real)) + 0.0, ())


def growth_of(mu: ComplexArray) -> Array:
    """log |lambda(M)| >= 0 of each mu, with lambda + 1/lambda = 2 + 4 mu."""
    mu = np.asarray(mu, dtype=complex)
    return np.asarray(np.abs(2.0 * np.log(np.abs(np.sqrt(mu) + np.sqrt(mu + 1.0)))))


@dataclass(eq=False)
class Block:
    """One or two real mu on an interval, or any number on one side of the real axis that do not come to it.

    Attributes:
        start, end: of the interval.
        matrices: coefficients of (k, p, q), or of k alone, shape (DEGREE + 1, 3 or 1, m, m).
        functions: of real mu, whose zeros are edges; the last two are det p and det q, those before them the functions
            that vanish where two mu meet and may become complex.
        series: of real mu, coefficients (FINE + 1, 6) of their mean, rho, the two functions whose product over rho^2 is
            the square of half their difference, with all digits where it is small, and det p and det q.
        is_coarse: whether the remainder of the series is larger than the other errors: shorter intervals lessen it.
        error: of k, in norm.
        segments: where it is unstable, in order; by `find_segments`.
    """

    start: float
    end: float
    matrices: Numbers
    functions: tuple[Function, ...] = ()
    series: Array = field(default_factory=lambda: np.empty((0, 6)))
    is_coarse: bool = field(default=False, kw_only=True)
    error: float = field(default=0.0, kw_only=True)
    segments: list[Segment] | None = None

    @property
    def size(self) -> int:
        """Number m of mu."""
        return int(self.matrices.shape[-1])

    @property
    def symplectic(self) -> bool:
        """Whether mu have signatures."""
        return bool(self.matrices.shape[1] == 3)

    @cached_property
    def definite(self) -> bool:
        """Whether it has two mu of one signature, which are real."""
        return self.size == 2 and len(self.functions) == 2

    @cached_property
    def conserved(self) -> bool:
        """Whether one mu stays at -1 or 0: a second conserved quantity."""
        return any(function.is_nothing for function in self.functions[-2:])

    @property
    def is_blurred(self) -> bool:
        """Whether a shorter interval would show whether one of its instabilities is there."""
        bounds = [(s.end - s.start, s.start_edge, s.end_edge) for s in self.segments or ()]
        return self.is_coarse and any(a and b and length <= a.error + b.error for length, a, b in bounds)

    def coordinate(self, x: float) -> float:
        """Coordinate of a place in [-1, 1]."""
        if abs(x) == 1.0:
            return self.start if x < 0.0 else self.end
        return self.start + 0.5 * (1.0 + x) * (self.end - self.start)

    def edges(self) -> list[tuple[Edge, bool]]:
        """Edges in order, one within its error of an end of the interval there, and whether functions change sign."""
        found = []
        for number, function in enumerate(self.functions, start=2 - len(self.functions)):
            for x, width, crosses in function.zeros or ():
                kind, (mu, signatures) = (
                    ("complex", self._meeting(x)) if number < 0 else ("real", self._leaving(x, number))
                )
                at, error = self.coordinate(x), 0.5 * (self.end - self.start) * width
                at = next((end for end in (self.start, self.end) if abs(at - end) <= error), at)
                found.append((x, Edge(at, error, kind, mu, signatures), crosses))
        found.sort(key=lambda item: (item[1].coordinate, item[0]))
        return [(edge, crosses) for _, edge, crosses in found]

    def _meeting(self, x: float) -> tuple[float, tuple[int, ...]]:
        """The mu at which two meet, and their signatures."""
        mu = float(chebval(x, self.series[:, 0]))
        return mu, (1, -1) if self.symplectic and -1.0 < mu < 0.0 else ()

    def _leaving(self, x: float, number: int) -> tuple[float, tuple[int, ...]]:
        """The end of [-1, 0] that a mu is at where det p (0) or det q (1) vanishes, and its signature."""
        parts = np.tensordot(chebyshev.basis(x, SERIES_DEGREE), self.matrices, 1)
        values, vectors = np.linalg.eig(parts[0])
        chosen = int(np.argmin(np.abs(values * (1.0 + values))))
        mu = float(np.round(values[chosen].real)) + 0.0  # no negative zero
        if not self.symplectic:
            return mu, ()
        vector = np.linalg.inv(vectors)[chosen].real if number == 0 else vectors[:, chosen].real
        sign = int(np.sign(vector @ parts[2 - number] @ vector))
        return mu, (sign if number == 0 else -sign,)

    def segments_between(self, edges: Sequence[tuple[Edge, bool]], states: tuple[Booleans, Indices]) -> list[Segment]:
        """Where the block is unstable, from edges and the states between: whether mu are complex, how many outside.

        An edge within its error of an end of the interval is there: the interval beside it then sees the same one, and
        what lies between edge and end is nothing. A place where no function changes its sign is an edge all the same
        where the states beside it differ: two equal mu pass -1 or 0 together. Two edges with nothing between them are
        those of a segment too: mu of opposite signatures that pass one another uncoupled.
        """
        places, (is_complex, outside) = [self.start, *(edge.coordinate for edge, _ in edges), self.end], states
        passed = [
            crosses or bool(outside[i] != outside[i + 1] and places[i] < places[i + 1] < places[i + 2])
            for i, (_, crosses) in enumerate(edges)
        ]
        crossed = [edge for (edge, _), passes in zip(edges, passed, strict=True) if passes]
        touched = [edge for (edge, _), passes in zip(edges, passed, strict=True) if not passes]
        if touched:
            places = [self.start, *(edge.coordinate for edge in crossed), self.end]
            is_complex, outside = (each[0] for each in _states([self], _middles([places])))
        bounds: list[Edge | None] = [None, *crossed, None]
        found = [
            Segment(self, places[i], places[i + 1], bounds[i], bounds[i + 1], bool(is_complex[i]), int(outside[i]))
            for i in range(len(places) - 1)
            if outside[i] and (places[i] < places[i + 1] or (bounds[i] and bounds[i + 1]))
        ]
        found += self._passed_twice(crossed, found)
        for edge in touched:
            if not any(segment.holds(edge) for segment in found):
                found.append(Segment(self, edge.coordinate, edge.coordinate, edge, edge, edge.kind != "real", 1))
        return sorted(found, key=lambda segment: segment.start)

    def _passed_twice(self, crossed: Sequence[Edge], segments: Sequence[Segment]) -> Iterator[Segment]:
        """Edges in pairs that coincide within errors, of those that no segment has."""
        known = {id(edge) for segment in segments for edge in (segment.start_edge, segment.end_edge)}
        before: Edge | None = None
        for edge in (edge for edge in crossed if id(edge) not in known):
            if before is None or edge.coordinate - before.coordinate > before.error + edge.error:
                before = edge
                continue
            kind = edge.kind != "real"
            yield Segment(self, before.coordinate, edge.coordinate, before, edge, kind, 2 if kind else 1)
            before = None

    def meetings_without_instability(self) -> Iterator[tuple[float, float, float]]:
        """(coordinate, mu, distance) where the two mu of a definite pair meet within errors."""
        k = chebyshev.combined(chebyshev.basis(chebyshev.nodes(FINE_DEGREE), SERIES_DEGREE), self.matrices[None])[
            0, :, 0
        ]
        slope = np.asarray(chebder(chebyshev.transform(FINE_DEGREE) @ discriminants(k)), dtype=float)
        _, zeros, crosses = chebyshev.real_zeros(slope[:, None])
        for x in np.sort(zeros[crosses]).tolist():
            here = np.tensordot(chebyshev.basis(x, SERIES_DEGREE), self.matrices[:, 0], 1)
            distance = float(np.sqrt(max(float(discriminants(here)), 0.0)))
            if distance <= max(self.error, ROUNDED_MU_DISTANCE):
                yield self.coordinate(x), 0.5 * float(np.trace(here)), distance


# Values of several blocks ---------------------------------------------------------------------------------------------


def find_segments(blocks: Sequence[Block]) -> None:
    """Find the segments of several blocks together: that is cheaper."""
    waiting = [block for block in blocks if block.segments is None]
    find_zeros(function for block in waiting for function in block.functions)
    edges = [block.edges() for block in waiting]
    places = [[b.start, *(edge.coordinate for edge, _ in each), b.end] for b, each in zip(waiting, edges, strict=True)]
    if waiting:
        for block, known, *states in zip(waiting, edges, *_states(waiting, _middles(places)), strict=True):
            block.segments = block.segments_between(known, (states[0], states[1]))


def _middles(places: Sequence[Sequence[float]]) -> Array:
    """Middles between neighbouring places of each of several rows, the last one repeated in shorter rows."""
    count = max(map(len, places))
    filled = np.array([[*row, *[row[-1]] * (count - len(row))] for row in places])
    return np.asarray(0.5 * (filled[:, :-1] + filled[:, 1:]))


def local_places(blocks: Sequence[Block], coordinates: Array) -> Array:
    """Places in [-1, 1] of coordinates of each block, (blocks, points)."""
    starts, ends = (np.array([getattr(block, name) for block in blocks])[:, None] for name in ("start", "end"))
    return np.asarray(np.clip((2.0 * coordinates - starts - ends) / (ends - starts), -1.0, 1.0))


def _real_values(blocks: Sequence[Block], coordinates: Array) -> tuple[Array, Array, Array, Booleans, Booleans]:
    """Of real blocks: mean of mu, square of half the difference, product of mu (1 + mu), whether one, or two are out.

    Of two real mu that are both in [-1, 0] or both outside, the sum of mu (1 + mu) decides.
    """
    x = local_places(blocks, coordinates)
    values = chebyshev.basis(x, FINE_DEGREE) @ np.stack([block.series for block in blocks])
    kinds = np.array([[(block.size == 2, block.definite, block.conserved)] for block in blocks])
    return _decided(values, *np.moveaxis(kinds, -1, 0))


def _decided(
    values: Array, both: Booleans, definite: Booleans, conserved: Booleans
) -> tuple[Array, Array, Array, Booleans, Booleans]:
    """As `_real_values`, from values of series, (..., 6), and the kinds of their blocks."""
    mean, square = values[..., 0], values[..., 2] * values[..., 3] / values[..., 1] ** 2
    product, square = values[..., 4] * values[..., 5], np.where(definite, np.maximum(square, 0.0), square)
    product = np.where(conserved, np.where(both, np.abs(product), -np.abs(product)), product)
    one = (product < 0.0) == both
    one &= product != 0.0
    return mean, square, product, one, both & ((square < 0.0) | (~one & (mean + mean**2 + square > 0.0)))


def _states(blocks: Sequence[Block], coordinates: Array) -> tuple[Booleans, Indices]:
    """Whether the mu outside are complex, and how many are outside, at coordinates of each that are no edges."""
    is_complex = np.ones(coordinates.shape, dtype=bool)
    outside = np.tile(np.array([[block.size] for block in blocks]), (1, coordinates.shape[1]))
    real = [i for i, block in enumerate(blocks) if block.series.size]
    if real:
        _, square, _, one, two = _real_values([blocks[i] for i in real], coordinates[real])
        is_complex[real], outside[real] = square < 0.0, np.where(two, 2, one)
    return is_complex, outside


def evaluate(blocks: Sequence[Block], coordinates: Array) -> tuple[ComplexArray, Array]:
    """All mu, and log |lambda(M)| of the most unstable multiplier, of each block at coordinates of its own.

    Coordinates (blocks, points) -> (blocks, points, most mu), no numbers behind those of smaller ones, and (blocks,
    points).
    """
    mu = np.full((*coordinates.shape, max(block.size for block in blocks)), np.nan, dtype=complex)
    growths, keys = np.empty(coordinates.shape), [0 if block.series.size else block.size for block in blocks]
    mu = np.pad(mu, ((0, 0), (0, 0), (0, max(0, 2 - mu.shape[2]))), constant_values=np.nan)
    for size in set(keys):
        i = [n for n, key in enumerate(keys) if key == size]
        those, at = [blocks[n] for n in i], coordinates[i]
        if size == 0:
            mean, square, product, one, _ = _real_values(those, at)
            root, single = np.sqrt(square + 0j), np.array([[block.size == 1] for block in those])
            mu[i, :, 0], mu[i, :, 1] = mean + root, np.where(single, np.nan, mean - root)
            inside = np.where(single, 1.0, np.fmin.reduce((mu[i, :, :2] * (1.0 + mu[i, :, :2])).real, axis=-1))
            with np.errstate(divide="ignore", invalid="ignore"):  # without loss of digits near -1 and 0
                found = np.arcsinh(2.0 * np.sqrt(np.maximum(product / inside, 0.0)))
            both = ~(one | single)
            found[both] = np.max(growth_of(mu[i, :, :2][both]), axis=-1)
            growths[i] = found
            continue
        k = np.stack([block.matrices[:, 0] for block in those]).reshape(len(i), SERIES_DEGREE + 1, -1)
        K = (chebyshev.basis(local_places(those, at), SERIES_DEGREE) @ k).reshape(*at.shape, size, size)
        mu[i, :, :size] = K[..., 0] if size == 1 else np.linalg.eigvals(K)
        growths[i] = np.max(growth_of(mu[i, :, :size]), axis=-1)
    return mu, growths


# Blocks from the matrices on their intervals --------------------------------------------------------------------------


def complex_blocks(those: Matrices) -> list[Block]:
    """Blocks of mu off the real axis."""
    coefficients = chebyshev.combined(chebyshev.transform(SERIES_DEGREE), those.parts)
    rows = zip(those.bounds.tolist(), coefficients, those.coarse.tolist(), strict=True)
    return [Block(bounds[0], bounds[1], k, is_coarse=coarse) for bounds, k, coarse in rows]


def real_blocks(those: Matrices) -> tuple[list[Block | None], Booleans, Booleans]:
    """Blocks of one or two real mu, which of them are stable throughout, and which intervals are too long for them.

    Of those that are stable throughout there is a block only where two mu have one signature, and may meet.
    """
    fine = chebyshev.combined(chebyshev.refinement(SERIES_DEGREE, FINE_DEGREE), those.parts)
    ends = _ends(those, fine)
    met, met_errors, rho, vanish, usable = _meetings(those, fine, [coefficients for coefficients, _ in ends])
    mean = np.trace(fine[:, :, 0], axis1=2, axis2=3) / fine.shape[-1]
    mean_and_rho = (chebyshev.transform(FINE_DEGREE) @ np.stack([mean, rho], axis=2)).swapaxes(0, 1)
    series = np.concatenate([mean_and_rho, met.transpose(1, 2, 0), np.stack([e for e, _ in ends], axis=2)], axis=2)
    every = [*zip(met, met_errors, strict=True), *ends]
    excluded, nothing = np.array([chebyshev.certain(*each) for each in every]).swapaxes(0, 1)
    both = np.full(len(fine), fine.shape[-1] == 2)
    definite = both & ~vanish.any(axis=0)
    middle = np.tensordot(chebyshev.basis(0.0, FINE_DEGREE), series, 1)
    *_, one, two = _decided(middle, both, definite, nothing[2:].any(axis=0))
    quiet = np.all(excluded[:2] | ~vanish, axis=0) & excluded[2:].all(axis=0) & ~one & ~two
    wanted = np.flatnonzero(~quiet | definite).tolist()
    functions = [Function.several(values[:, wanted], errors[wanted]) for values, errors in every]
    coefficients = chebyshev.combined(chebyshev.transform(SERIES_DEGREE), those.parts[wanted])
    allowed = ERROR_SAFETY * np.max(np.abs(those.errors[:, :, 0]), axis=(1, 2, 3)) + (those.noise + those.tails)[:, 0]
    coarse, bounds, blocks = those.coarse, those.bounds.tolist(), list[Block | None]([None] * len(fine))
    for k, (n, *those_of) in enumerate(zip(wanted, *functions, strict=True)):
        own = tuple(f for f, present in zip(those_of, (*vanish[:, n], True, True), strict=True) if present)
        start, end = bounds[n]
        blocks[n] = Block(
            start, end, coefficients[k], own, series[:, n], is_coarse=bool(coarse[n]), error=float(allowed[n])
        )
    return blocks, quiet, ~usable


def _ends(those: Matrices, fine: Array) -> list[tuple[Array, Array]]:
    """Coefficients (FINE + 1, blocks) and errors (blocks, J) of det p and det q, or of det k and det (1 + k)."""
    one, noise, found = np.eye(fine.shape[-1]), those.noise + those.tails, []
    for index, shift in ((1, 0.0), (2, 0.0)) if those.symplectic else ((0, 0.0), (0, 1.0)):
        coarse = those.parts[:, :, index] + shift * one
        errors = _determinant_errors(coarse, those.errors[:, :, index], noise[:, [index]])
        found.append(_series(_determinants(fine[:, :, index] + shift * one), errors))
    return found


def _meetings(those: Matrices, fine: Array, ends: Sequence[Array]) -> tuple[Array, Array, Array, Booleans, Booleans]:
    """The two functions whose product over rho^2 is the square of half the difference of two mu.

    These are f+ and f- by the form, p or q, whose determinant has no zero; where it is definite, or without a form, the
    discriminant and 1.

    Returns:
        Coefficients (2, FINE + 1, blocks) and errors (2, blocks, J), both 0 of one mu; rho at the nodes (blocks, FINE +
        1); which of the functions may vanish at edges, (2, blocks); which blocks are short enough for a form.
    """
    count = len(fine)
    met, errors = np.zeros((2, FINE_DEGREE + 1, count)), np.zeros((2, count, SERIES_DEGREE + 1))
    rho, vanish, usable = np.ones(fine.shape[:2]), np.zeros((2, count), dtype=bool), np.ones(count, dtype=bool)
    if fine.shape[-1] == 1:
        return met, errors, rho, vanish, usable
    met[1, 0], rho[:] = 1.0, 2.0
    met[0], errors[0] = _discriminant(fine[:, :, 0], those)
    if not those.symplectic:
        vanish[0] = True
        return met, errors, rho, vanish, usable
    usable[:] = False
    for index in (1, 2):
        if usable.all():
            break
        turn = np.linalg.eigh(_symmetric(fine[:, FINE_DEGREE // 2, index]))[1]
        form, _, s, *vectors = null_vectors(fine, index, turn)
        regular = chebyshev.excludes_zero(ends[index - 1]) & ~usable
        definite = regular & (ends[index - 1][0] > 0.0)
        corner = chebyshev.transform(FINE_DEGREE) @ form[..., 0, 0].T
        split = regular & ~definite & chebyshev.excludes_zero(corner)
        coarse = null_vectors(those.parts[split], index, turn[split])
        for which, n in enumerate(vectors):
            own = _null_errors(coarse, which, index, turn[split], those.take(split))
            met[which][:, split], errors[which][split] = _series(_value(s[split], n[split], n[split]), own)
        rho[split] = _value(form[split], vectors[0][split], vectors[1][split])
        vanish[:, split] = True
        usable |= split | definite
    return met, errors, rho, vanish, usable


def _discriminant(fine: Array, those: Matrices) -> tuple[Array, Array]:
    """(mu_1 - mu_2)^2, with errors where these are not of a symplectic map."""
    k, change, noise = those.parts[:, :, 0], ERROR_SAFETY * those.errors[:, :, 0], (those.noise + those.tails)[:, [0]]
    by_flow = np.abs(discriminants(k + change) - discriminants(k)) + np.abs(discriminants(change))
    by_noise = 4.0 * noise * (np.linalg.norm(k, axis=(2, 3)) + noise)
    return _series(discriminants(fine), by_flow + by_noise)


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


def _null_errors(coarse: tuple[Array, ...], which: int, index: int, turn: Array, those: Matrices) -> Array:
    """Errors of f at the nodes: at a double mu only those of k show, between p n and n."""
    form, n, change = coarse[0], coarse[3 + which], those.errors[:, :, 0]
    change = turn[:, None].swapaxes(2, 3) @ (change if index == 1 else change.swapaxes(2, 3)) @ turn[:, None]
    left = np.sum(form * n[..., None, :], axis=-1)
    size = np.linalg.norm(left, axis=-1) * np.linalg.norm(n, axis=-1)
    return np.asarray(ERROR_SAFETY * np.abs(_value(change, left, n)) + (those.noise + those.tails)[:, [0]] * size)


def discriminants(k: Array) -> Array:
    """(mu_1 - mu_2)^2 of matrices of two rows."""
    return np.asarray((k[..., 0, 0] - k[..., 1, 1]) ** 2 + 4.0 * k[..., 0, 1] * k[..., 1, 0])


def _value(form: Array, left: Array, right: Array) -> Array:
    """left^T form right, point by point."""
    return np.asarray(np.sum(left[..., :, None] * form * right[..., None, :], axis=(-1, -2)))


def _symmetric(matrices: Array) -> Array:
    return np.asarray(0.5 * (matrices + matrices.swapaxes(-1, -2)))


def _determinants(matrices: Array) -> Array:
    """Determinants of one or two rows."""
    if matrices.shape[-1] == 1:
        return np.asarray(matrices[..., 0, 0])
    return np.asarray(matrices[..., 0, 0] * matrices[..., 1, 1] - matrices[..., 0, 1] * matrices[..., 1, 0])


def _determinant_errors(matrices: Array, errors: Array, noise: Array) -> Array:
    """Errors of determinants, from matrices like errors and bounds on the norm of the rest."""
    m, e = matrices, errors
    if m.shape[-1] == 1:
        return np.asarray(ERROR_SAFETY * np.abs(e[..., 0, 0]) + noise)
    first = m[..., 1, 1] * e[..., 0, 0] + m[..., 0, 0] * e[..., 1, 1]
    first = first - m[..., 0, 1] * e[..., 1, 0] - m[..., 1, 0] * e[..., 0, 1]
    return np.asarray(ERROR_SAFETY * np.abs(first) + noise * np.linalg.norm(matrices, axis=(-2, -1)))


def _series(values: Array, errors: Array) -> tuple[Array, Array]:
    """Coefficients (FINE + 1, pairs) of values (pairs, FINE + 1), and errors (pairs, J) with those of truncation."""
    coefficients = chebyshev.transform(FINE_DEGREE) @ values.T
    return coefficients, errors + chebyshev.tail(coefficients)[:, None]
