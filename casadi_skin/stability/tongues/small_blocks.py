"""Blocks of mu on an interval, and their instabilities between edges; the block of one mu, and complex ones.

With right and left eigenvectors x, y of K (y.x = 1), pi = x^T P x and kappa = y^T Q y, there is pi kappa = mu (1 + mu).
One real mu lies in (-1, 0) where pi kappa < 0, and leaves through -1 or 0 where pi or kappa passes zero.
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
from casadi_skin.stability.tongues.decoupling import SERIES_DEGREE, Booleans, Indices, Numbers
from casadi_skin.stability.tongues.zeros import Function
from casadi_skin.zero.problem import Array

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
    to these: from elsewhere, and from the series on the interval, which shorter intervals lessen.
    """

    functions: tuple[Function, ...] = ()

    def __init__(self, start: float, end: float, parts: Numbers, errors: Array, noise: Array, tails: Array) -> None:
        self.start, self.end, self.parts, self.errors, self.tails = start, end, parts, errors, tails
        self.noise = noise + tails
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

    def __init__(
        self,
        start: float,
        end: float,
        parts: Array,
        errors: Array,
        noise: Array,
        tails: Array,
        functions: tuple[Function, Function],
    ) -> None:
        super().__init__(start, end, parts, errors, noise, tails)
        self.functions = functions

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
