"""Blocks of two mu on an interval: every edge of an instability as a simple zero of an analytic function.

On such a block there are matrices k, p, q of two rows, with p k symmetric and p q = k^T (1 + k^T). Where p is definite
both mu are real. Where it is not, it has two null vectors n+ and n-, and the discriminant of k is 4 f+ f- / rho^2 with
f = n^T p k n for each of them and rho = n+^T p n-: the pair is complex where f+ f- < 0, and the edges of this
instability are simple zeros of f+ and f-, however near they lie. Likewise with q and k^T.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.blocks import Booleans, Indices, Numbers
from casadi_skin.stability.tongues.chebyshev import SERIES_DEGREE, Function
from casadi_skin.zero.problem import Array

# Blocks of mu on an interval, and their instabilities between edges; the block of one mu, and complex ones ------------

ERROR_SAFETY = 2.0  # of estimated errors of the matrices


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
        """Those of the block's mu at a place that are unstable on it."""
        if self.is_complex:
            return mu
        order = np.argsort(-(mu * (1.0 + mu)).real)
        return np.asarray(mu[order[: self.outside]])

    def edge_at(self, coordinate: float) -> Edge | None:
        """The edge that errors allow at the end of its interval, where none is seen; None where they allow none."""
        width = self.block.edge_width(coordinate)
        if width is None:
            return None
        mu = complex(np.mean(self.block.unstable_mu(self, coordinate)))
        error = 0.5 * (self.block.end - self.block.start) * width
        if self.is_complex:
            return Edge(coordinate, error, "complex", mu.real, (1, -1) if self.block.noise.size == 3 else ())
        return Edge(coordinate, error, "real", float(np.round(mu.real)) + 0.0, ())


def growth_of(mu: ComplexArray) -> Array:
    """log |lambda(M)| >= 0 of each mu, with lambda + 1/lambda = 2 + 4 mu."""
    mu = np.asarray(mu, dtype=complex)
    return np.asarray(np.abs(2.0 * np.log(np.abs(np.sqrt(mu) + np.sqrt(mu + 1.0)))))


def real_growth(product: Array) -> Array:
    """The same of a real mu from mu (1 + mu): without loss of digits near -1 and 0."""
    return np.asarray(np.arcsinh(2.0 * np.sqrt(np.maximum(product, 0.0))))


class Block:
    """Matrices (k, p, q), or k alone, of some mu at the nodes of an interval, shape (DEGREE + 1, 3 or 1, m, m).

    `errors` are matrices like their errors at the nodes, `noise` and `tails` (3 or 1,) bounds on the norm of what comes
    to these: from elsewhere, and from the series on the interval, which shorter intervals lessen. Its edges are zeros
    of `functions`.
    """

    def __init__(
        self,
        start: float,
        end: float,
        parts: Numbers,
        errors: Array,
        noise: Array,
        tails: Array,
        functions: tuple[Function, ...] = (),
    ) -> None:
        self.start, self.end, self.parts, self.errors, self.tails = start, end, parts, errors, tails
        self.noise, self.functions = noise + tails, functions
        self._others = noise

    @cached_property
    def is_coarse(self) -> bool:
        """Whether the remainder of the series is larger than the other errors."""
        return bool(is_coarse(self.errors[None], self._others[None], self.tails[None])[0])

    @cached_property
    def coefficients(self) -> Numbers:
        """Of the matrices, shape (DEGREE + 1, 3 or 1, m, m)."""
        return np.asarray(chebyshev.combined(chebyshev.transform(SERIES_DEGREE), self.parts[None])[0])

    def at(self, x: Array) -> Numbers:
        """The matrices at places in [-1, 1], shape (places, 3 or 1, m, m)."""
        return np.asarray(chebyshev.combined(chebyshev.basis(x, SERIES_DEGREE), self.coefficients[None])[0])

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
        return np.asarray(self.mu_together([self], coordinates[None])[0])

    @property
    def alike(self) -> Hashable:
        """Blocks of one class for which this is the same are evaluated together."""
        return self.parts.shape[-1], self.parts.dtype.kind

    @classmethod
    def mu_together(cls, blocks: Sequence[Any], coordinates: Array) -> ComplexArray:
        """All mu of blocks that are alike, each at coordinates of its own, (blocks, points) -> (blocks, points, m)."""
        K, size = np.stack([block.parts[:, 0] for block in blocks]), blocks[0].parts.shape[-1]
        coefficients = chebyshev.transform(SERIES_DEGREE) @ K.reshape(len(K), SERIES_DEGREE + 1, -1)
        found = chebyshev.basis(local_places(blocks, coordinates), SERIES_DEGREE) @ coefficients
        if size == 1:
            return np.asarray(found, dtype=complex)
        return np.asarray(np.linalg.eigvals(found.reshape(*coordinates.shape, size, size)), dtype=complex)

    @classmethod
    def growths_together(cls, blocks: Sequence[Any], coordinates: Array) -> Array:
        """log |lambda(M)| of the most unstable multiplier of each, (blocks, points) -> (blocks, points)."""
        return np.asarray(np.max(growth_of(cls.mu_together(blocks, coordinates)), axis=2))

    @property
    def is_blurred(self) -> bool:
        """Whether a shorter interval would show whether one of its instabilities is there."""
        if not self.is_coarse:
            return False
        bounds = [(s.end - s.start, s.start_edge, s.end_edge) for s in self.segments]
        return any(a is not None and b is not None and length <= a.error + b.error for length, a, b in bounds)

    @property
    def is_quiet(self) -> bool:
        """Whether it is stable on the whole interval."""
        return all(f.excludes_zero for f in self.functions) and not self.states(np.zeros(1))[1].any()

    def edge_width(self, coordinate: float) -> float | None:
        """How far from an end of the interval an edge may be, in half-lengths; None where errors allow none there."""
        x = -1.0 if coordinate == self.start else 1.0
        near = [f for f in self.functions if not f.is_nothing and abs(float(f(x))) <= ERROR_SAFETY * f.error(x)]
        return max((f.width(x) for f in near), default=None)

    def unstable_mu(self, segment: Segment, coordinate: float) -> ComplexArray:
        """Those mu of the block that are unstable on a segment, at a coordinate."""
        return segment.unstable(self.mu(np.array([coordinate]))[0])

    @cached_property
    def edges(self) -> list[tuple[Edge, bool]]:
        """Edges in order, and whether the state changes there."""
        return []

    def states(self, x: Array) -> tuple[Booleans, Indices]:
        """Whether the mu outside are complex, and how many are outside, at places that are no edges."""
        is_complex, outside = self.states_together([self], x[None])
        return is_complex[0], outside[0]

    @classmethod
    def states_together(cls, blocks: Sequence[Any], x: Array) -> tuple[Booleans, Indices]:
        """The same of blocks that are alike, (blocks, points) each."""
        raise NotImplementedError

    @staticmethod
    def find_states(blocks: Sequence[Block]) -> None:
        """Find the states between edges of blocks that are alike and have as many edges."""
        stops = np.stack([block._stops for block in blocks])
        x = local_places(blocks, 0.5 * (stops[:, :-1] + stops[:, 1:]))
        for block, *states in zip(blocks, *type(blocks[0]).states_together(blocks, x), strict=True):
            block._states_between = states[0], states[1]

    def _edge(self, x: float, width: float, kind: str, mu: float, signatures: tuple[int, ...]) -> Edge:
        return Edge(self.coordinate(x), 0.5 * (self.end - self.start) * width, kind, mu, signatures)

    @cached_property
    def _edges_in_order(self) -> list[tuple[Edge, bool]]:
        edges = ((self._at_an_end(edge), crosses) for edge, crosses in self.edges)
        return sorted(edges, key=lambda item: item[0].coordinate)

    @cached_property
    def _stops(self) -> Array:
        """The ends of the interval, with the edges between them."""
        return np.array([self.start, *(edge.coordinate for edge, _ in self._edges_in_order), self.end])

    @cached_property
    def _states_between(self) -> tuple[Booleans, Indices]:
        """Between each of the stops and the next."""
        return self.states(self.local(0.5 * (self._stops[:-1] + self._stops[1:])))

    @cached_property
    def segments(self) -> list[Segment]:
        """Where the block is unstable, in order.

        An edge within its error of an end of the interval is there: the interval beside it then sees the same one, and
        what lies between edge and end is nothing. A place where no function changes its sign is an edge all the same
        where the states beside it differ: two equal mu pass -1 or 0 together. Two edges with nothing between them are
        those of a segment too: mu of opposite signatures that pass one another uncoupled.
        """
        edges, stops = self._edges_in_order, self._stops
        is_complex, outside = self._states_between
        passed = [crosses for _, crosses in edges]
        if not all(passed):
            lengths = np.diff(stops)
            differ = (outside[:-1] != outside[1:]) & (lengths[:-1] > 0.0) & (lengths[1:] > 0.0)
            passed = [crosses or bool(differ[i]) for i, crosses in enumerate(passed)]
            stops = stops[[True, *passed, True]]
            is_complex, outside = self.states(self.local(0.5 * (stops[:-1] + stops[1:])))
        crossed = [edge for (edge, _), passes in zip(edges, passed, strict=True) if passes]
        places = stops.tolist()
        bounds: list[Edge | None] = [None, *crossed, None]
        found = [
            Segment(self, places[i], places[i + 1], bounds[i], bounds[i + 1], bool(is_complex[i]), int(outside[i]))
            for i in np.flatnonzero(outside).tolist()
            if places[i] < places[i + 1] or (bounds[i] is not None and bounds[i + 1] is not None)
        ]
        found += self._passed_twice(crossed, found)
        for edge in (edge for (edge, _), passes in zip(edges, passed, strict=True) if not passes):
            place = edge.coordinate
            if not any(segment.holds(edge) for segment in found):
                found.append(Segment(self, place, place, edge, edge, edge.kind != "real", 1))
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

    def _at_an_end(self, edge: Edge) -> Edge:
        """The edge, moved to an end of the interval where that is within its error."""
        for end in (self.start, self.end):
            if abs(edge.coordinate - end) <= edge.error:
                return replace(edge, coordinate=end)
        return edge


class ComplexBlock(Block):
    """Mu on one side of the real axis that do not come to it within the interval."""

    @classmethod
    def states_together(cls, blocks: Sequence[ComplexBlock], x: Array) -> tuple[Booleans, Indices]:
        sizes = np.array([block.parts.shape[-1] for block in blocks])
        return np.ones(x.shape, dtype=bool), np.tile(sizes[:, None], (1, x.shape[1]))


class SingleBlock(Block):
    """One real mu; its `functions` are those of `single_functions`."""

    @cached_property
    def edges(self) -> list[tuple[Edge, bool]]:
        first, second = self.functions
        found = []
        for function, other, sign in ((first, second, 1), (second, first, -1)):
            for x, width, crosses in function.zeros:
                mu = float(np.round(self.mu(np.array([self.coordinate(x)]))[0, 0].real)) + 0.0  # no negative zero
                signatures = (sign * int(np.sign(other(x))),) if self.noise.size == 3 else ()
                found.append((self._edge(x, width, "real", mu, signatures), crosses))
        return sorted(found, key=lambda item: item[0].coordinate)

    @classmethod
    def states_together(cls, blocks: Sequence[SingleBlock], x: Array) -> tuple[Booleans, Indices]:
        outside = (cls._products(blocks, x) > 0.0).astype(np.int64)
        conserved = [any(function.is_nothing for function in block.functions) for block in blocks]
        outside[conserved] = 0  # a second conserved quantity: they stay at -1 or 0
        return np.zeros(x.shape, dtype=bool), outside

    @classmethod
    def _products(cls, blocks: Sequence[SingleBlock], x: Array) -> Array:
        """mu (1 + mu) at places in [-1, 1] of each, (blocks, points)."""
        series = np.stack([[function.coefficients for function in block.functions] for block in blocks])
        values = chebyshev.basis(x, SERIES_DEGREE) @ series.swapaxes(1, 2)
        return np.asarray(values[..., 0] * values[..., 1])

    @classmethod
    def growths_together(cls, blocks: Sequence[SingleBlock], coordinates: Array) -> Array:
        return real_growth(cls._products(blocks, local_places(blocks, coordinates)))


def local_places(blocks: Sequence[Block], coordinates: Array) -> Array:
    """Places in [-1, 1] of coordinates of each block, (blocks, points)."""
    starts, ends = (np.array([getattr(block, name) for block in blocks])[:, None] for name in ("start", "end"))
    return np.asarray(np.clip((2.0 * coordinates - starts - ends) / (ends - starts), -1.0, 1.0))


def single_functions(coefficients: Array, errors: Array, noise: Array) -> list[tuple[Function, Function]]:
    """pi and kappa, of a map that is not symplectic mu and 1 + mu, of blocks of one mu.

    Coefficients and errors at the nodes have shape (blocks, J, 3 or 1), `noise` (blocks, 3 or 1).
    """
    c, error = coefficients.swapaxes(0, 1), ERROR_SAFETY * np.abs(errors) + noise[:, None]
    if noise.shape[1] == 3:
        return list(zip(*(Function.several(c[..., i], error[..., i]) for i in (1, 2)), strict=True))
    shifted = c[..., 0].copy()
    shifted[0] += 1.0
    return list(zip(*(Function.several(values, error[..., 0]) for values in (c[..., 0], shifted)), strict=True))


def is_coarse(errors: Array, noise: Array, tails: Array) -> Booleans:
    """Which blocks have series that leave out more than the errors from elsewhere: (blocks, J, 3 or 1, m, m)."""
    return np.asarray(np.any(tails > noise + np.max(np.abs(errors), axis=(1, 3, 4)), axis=1))


def find_segments(blocks: Sequence[Block]) -> None:
    """Compute the values that `Block.segments` needs of several blocks together: that is cheaper."""
    Function.find_zeros([function for block in blocks for function in block.functions])
    kinds: dict[Hashable, list[Block]] = defaultdict(list)
    for block in blocks:
        kinds[type(block), block.alike, block._stops.size].append(block)
    for those in kinds.values():
        Block.find_states(those)


FINE_DEGREE = 2 * SERIES_DEGREE  # degree of functions that are products
ROUNDED_MU_DISTANCE = 1e-7  # distance of two mu that rounding makes of none


class PairBlock(Block):
    """Two mu that may meet.

    Its functions are the `meetings` f+ and f-, none for a definite pair, and the `ends` det p and det q; of a map that
    is not symplectic the discriminant, det k and det (1 + k). `mean_and_rho` are coefficients (FINE + 1, 2) of the mean
    of both mu and of rho: with f+ f- / rho^2 the square of half their difference is known with all digits where it is
    small. See `Pairs`.
    """

    mean_and_rho: Array

    @property
    def meetings(self) -> tuple[Function, ...]:
        return self.functions[:-2]

    @property
    def ends(self) -> tuple[Function, ...]:
        return self.functions[-2:]

    @cached_property
    def _series(self) -> Array:
        return np.column_stack([self.mean_and_rho, *(function.coefficients for function in self.functions)])

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
            block = PairBlock(*where, *matrices, (*met, first[i], last[i]))
            block.mean_and_rho = series[:, i]
            found.append(block)
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
