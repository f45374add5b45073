"""Blocks of mu on an interval, and their instabilities between edges; the block of one mu, and complex ones.

With right and left eigenvectors x, y of K (y.x = 1), pi = x^T P x and kappa = y^T Q y, there is pi kappa = mu (1 + mu).
One real mu lies in (-1, 0) where pi kappa < 0, and leaves through -1 or 0 where pi or kappa passes zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.stability import chebyshev
from casadi_skin.stability.decoupling import DEGREE, Booleans, Indices, Numbers
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.zeros import Function

SAFETY = 2.0  # of estimated errors of the matrices


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
    length is one whose edge is touched, within errors, but not seen to be passed.
    """

    block: Block
    start: float
    end: float
    start_edge: Edge | None
    end_edge: Edge | None
    is_complex: bool
    outside: int

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
        self.is_coarse = bool(np.any(tails > noise + np.max(np.abs(errors), axis=(0, 2, 3))))

    @cached_property
    def coefficients(self) -> Numbers:
        """Of the matrices, shape (DEGREE + 1, 3 or 1, m, m)."""
        return np.asarray(np.tensordot(chebyshev.transform(DEGREE), self.parts, 1))

    def at(self, x: Array) -> Numbers:
        """The matrices at places in [-1, 1], shape (places, 3 or 1, m, m)."""
        return np.asarray(np.tensordot(chebyshev.basis(x, DEGREE), self.coefficients, 1))

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
        near = [f for f in self.functions if not f.is_nothing and abs(float(f(x))) <= SAFETY * f.error(x)]
        return max((f.width(x) for f in near), default=None)

    def unstable_mu(self, segment: Segment, coordinate: float) -> ComplexArray:
        """Those mu of the block that are unstable on a segment, at a coordinate."""
        mu = self.mu(np.array([coordinate]))[0]
        if segment.is_complex:
            return np.asarray(mu)
        order = np.argsort(-(mu * (1.0 + mu)).real)
        return np.asarray(mu[order[: segment.outside]])

    @cached_property
    def edges(self) -> list[tuple[Edge, bool]]:
        """Edges in order, and whether the state changes there."""
        return []

    def states(self, x: Array) -> tuple[Booleans, Indices]:
        """Whether the mu outside are complex, and how many are outside, at places that are no edges."""
        raise NotImplementedError

    def _edge(self, x: float, width: float, kind: str, mu: float, signatures: tuple[int, ...]) -> Edge:
        return Edge(self.coordinate(x), 0.5 * (self.end - self.start) * width, kind, mu, signatures)

    @cached_property
    def segments(self) -> list[Segment]:
        """Where the block is unstable, in order.

        An edge within its error of an end of the interval is there: the interval beside it then sees the same one, and
        what lies between edge and end is nothing. A place where no function changes its sign is an edge all the same
        where the states beside it differ: two equal mu pass -1 or 0 together.
        """
        edges = sorted(
            ((self._at_an_end(edge), crosses) for edge, crosses in self.edges), key=lambda item: item[0].coordinate
        )
        stops = np.array([self.start, *(edge.coordinate for edge, _ in edges), self.end])
        lengths, (_, outside) = np.diff(stops), self.states(self.local(0.5 * (stops[:-1] + stops[1:])))
        differ = (outside[:-1] != outside[1:]) & (lengths[:-1] > 0.0) & (lengths[1:] > 0.0)
        passed = [crosses or bool(differ[i]) for i, (_, crosses) in enumerate(edges)]
        crossed = [edge for (edge, _), passes in zip(edges, passed, strict=True) if passes]
        places = [self.start, *(edge.coordinate for edge in crossed), self.end]
        bounds: list[Edge | None] = [None, *crossed, None]
        stops = np.array(places)
        is_complex, outside = self.states(self.local(0.5 * (stops[:-1] + stops[1:])))
        found = [
            Segment(self, places[i], places[i + 1], bounds[i], bounds[i + 1], bool(is_complex[i]), int(outside[i]))
            for i in np.flatnonzero(outside).tolist()
            if places[i] < places[i + 1] or (bounds[i] is not None and bounds[i + 1] is not None)
        ]
        for edge in (edge for (edge, _), passes in zip(edges, passed, strict=True) if not passes):
            place = edge.coordinate
            if not any(segment.start <= place <= segment.end for segment in found):
                found.append(Segment(self, place, place, edge, edge, edge.kind != "real", 1))
        return sorted(found, key=lambda segment: segment.start)

    def _at_an_end(self, edge: Edge) -> Edge:
        """The edge, moved to an end of the interval where that is within its error."""
        for end in (self.start, self.end):
            if abs(edge.coordinate - end) <= edge.error:
                return replace(edge, coordinate=end)
        return edge


class ComplexBlock(Block):
    """Mu on one side of the real axis that do not come to it within the interval."""

    def states(self, x: Array) -> tuple[Booleans, Indices]:
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
                mu = float(np.round(self.mu(np.array([self.coordinate(x)]))[0, 0].real)) + 0.0  # no negative zero
                signatures = (sign * int(np.sign(other(x))),) if self.noise.size == 3 else ()
                found.append((self._edge(x, width, "real", mu, signatures), crosses))
        return sorted(found, key=lambda item: item[0].coordinate)

    def states(self, x: Array) -> tuple[Booleans, Indices]:
        outside = (self.functions[0](x) * self.functions[1](x) > 0.0).astype(np.int64)
        if any(function.is_nothing for function in self.functions):
            outside[:] = 0  # a second conserved quantity: it stays at -1 or 0
        return np.zeros(x.shape, dtype=bool), outside

    def growth(self, coordinates: Array) -> Array:
        x = self.local(coordinates)
        return real_growth(self.functions[0](x) * self.functions[1](x))
