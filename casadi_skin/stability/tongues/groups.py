"""Unstable segments of neighbouring intervals that continue one another, joined to groups."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues.interpolation import Gap
from casadi_skin.stability.tongues.small_blocks import Block, Edge, Segment
from casadi_skin.zero.problem import Array

SAME = 0.05  # distance of two mu at the end of an interval that may be one
SAME_MU = 1e-6  # difference of mu of edges that coincide
DISAGREEMENT = "intervals that touch disagree on whether a multiplier is off the circle"


@dataclass(frozen=True)
class Group:
    """Segments that continue one another, in order of their starts, and all of their edges in order."""

    segments: tuple[Segment, ...]
    edges: tuple[Edge, ...]

    @cached_property
    def start(self) -> float:
        """Coordinate where it begins."""
        return min(segment.start for segment in self.segments)

    @cached_property
    def end(self) -> float:
        """Coordinate where it ends."""
        return max(segment.end for segment in self.segments)

    @cached_property
    def first_edge(self) -> Edge | None:
        """The edge at its start; None where it is open."""
        return next((edge for edge in self.edges if edge.coordinate == self.start), None)

    @cached_property
    def last_edge(self) -> Edge | None:
        """The edge at its end; None where it is open."""
        return next((edge for edge in reversed(self.edges) if edge.coordinate == self.end), None)

    @property
    def decided(self) -> bool:
        """Whether it is longer than the errors of its edges."""
        return self.end - self.start > sum(edge.error for edge in (self.first_edge, self.last_edge) if edge is not None)


class _Union:
    """Numbers in groups that are joined pair by pair."""

    def __init__(self, count: int) -> None:
        self._parents = list(range(count))

    def root(self, i: int) -> int:
        """The number that stands for the group of i."""
        while self._parents[i] != i:
            self._parents[i] = self._parents[self._parents[i]]
            i = self._parents[i]
        return i

    def join(self, i: int, j: int) -> None:
        """Make one group of those of i and j."""
        self._parents[self.root(j)] = self.root(i)


def error_of(edge: Edge | None) -> float:
    """Error of an edge; 0 at an open end."""
    return 0.0 if edge is None else edge.error


def groups_of(segments: Sequence[Segment], unknown: Iterable[float]) -> tuple[list[Group], list[Gap]]:
    """Join segments that continue one another; beyond the coordinates `unknown` nothing is known on one side.

    The second result are stretches on either side of a place where a segment ends that neither side has an edge for.
    """
    order = sorted(segments, key=lambda segment: (segment.start, segment.end))
    union, ends = _Union(len(order)), set(unknown)
    by_edge: dict[int, int] = {}
    for i, segment in enumerate(order):
        for edge in (segment.start_edge, segment.end_edge):
            if edge is not None:
                union.join(by_edge.setdefault(id(edge), i), i)
    dropped: set[int] = set()
    added: dict[int, Edge] = {}
    gaps: list[Gap] = []
    boundaries = list(_boundaries(order))
    mu = _unstable_mu(order, boundaries)
    for coordinate, lefts, rights in boundaries:
        loose_lefts = [i for i in lefts if order[i].end_edge is None]
        loose_rights = [i for i in rights if order[i].start_edge is None]
        pairs = _match(mu, coordinate, loose_lefts, loose_rights)
        for i, j in pairs:
            union.join(i, j)
        matched = {i for pair in pairs for i in pair}
        for i in (i for i in (*loose_lefts, *loose_rights) if i not in matched and coordinate not in ends):
            others = [k for k in (rights if i in loose_lefts else lefts) if k not in (*loose_lefts, *loose_rights)]
            twins = _match(mu, coordinate, [i], others)
            if twins:  # the other side sees the edge at their common end
                twin = twins[0][1]
                union.join(i, twin)
                dropped.add(id(order[twin].start_edge if i in loose_lefts else order[twin].end_edge))
                continue
            edge = order[i].edge_at(coordinate)
            if edge is not None:
                added[i] = edge
            else:
                length = order[i].block.end - order[i].block.start
                gaps.append(Gap(coordinate - length, coordinate + length, DISAGREEMENT))
    members: dict[int, list[int]] = defaultdict(list)
    for i in range(len(order)):
        members[union.root(i)].append(i)
    groups = sorted((_group(order, m, dropped, added) for m in members.values()), key=lambda group: group.start)
    return _undecided_once(groups), gaps


def _undecided_once(groups: Sequence[Group]) -> list[Group]:
    """Groups in order; of those that are not decided and coincide within their errors one.

    Two intervals see the same one at their common end, and mu that touch uncoupled touch by either of two functions.
    """
    found: list[Group] = []
    for group in groups:
        if group.decided or not any(_are_one(other, group) for other in found):
            found.append(group)
    return found


def _are_one(one: Group, other: Group) -> bool:
    """Whether two groups in order, the second of which is not decided, may be one."""
    apart = other.start - one.end > error_of(one.last_edge) + error_of(other.first_edge)
    if one.decided or apart:
        return False
    first, second = one.edges[0], other.edges[0]
    return first.kind == second.kind and abs(first.mu - second.mu) <= SAME_MU


def _group(order: Sequence[Segment], members: Sequence[int], dropped: set[int], added: dict[int, Edge]) -> Group:
    edges: dict[int, Edge] = {}
    for i in members:
        for edge in (order[i].start_edge, order[i].end_edge, added.get(i)):
            if edge is not None and id(edge) not in dropped:
                edges[id(edge)] = edge
    return Group(tuple(order[i] for i in members), tuple(sorted(edges.values(), key=lambda edge: edge.coordinate)))


def _boundaries(order: Sequence[Segment]) -> Iterator[tuple[float, list[int], list[int]]]:
    """Ends of intervals in the middle of an instability, with the segments that end and begin there."""
    lefts, rights = defaultdict(list), defaultdict(list)
    for i, segment in enumerate(order):
        lefts[segment.end].append(i)
        rights[segment.start].append(i)
    loose = {s.end for s in order if s.end_edge is None} | {s.start for s in order if s.start_edge is None}
    for coordinate in sorted(loose):
        yield coordinate, lefts.get(coordinate, []), rights.get(coordinate, [])


def _unstable_mu(
    order: Sequence[Segment], boundaries: Sequence[tuple[float, list[int], list[int]]]
) -> dict[tuple[int, float], ComplexArray]:
    """The unstable mu of segments at these ends of their intervals, by number and coordinate."""
    wanted = [(i, place) for place, lefts, rights in boundaries if lefts and rights for i in (*lefts, *rights)]
    if not wanted:
        return {}
    blocks, places = [order[i].block for i, _ in wanted], np.array([[place] for _, place in wanted])
    mu = values_together(blocks, places, lambda cls, those, at: list(cls.mu_together(those, at)[:, 0]))
    return {(i, place): order[i].unstable(values) for (i, place), values in zip(wanted, mu, strict=True)}


def _match(
    mu: Mapping[tuple[int, float], ComplexArray], coordinate: float, lefts: Sequence[int], rights: Sequence[int]
) -> list[tuple[int, int]]:
    """Segments with the same unstable mu at a coordinate: each mu of one side is at most one of the other."""
    if not lefts or not rights:
        return []
    (one, owners), (other, others) = (_of_all(mu, coordinate, side) for side in (lefts, rights))
    distances = np.abs(one[:, None] - other)
    pairs: list[tuple[int, int]] = []
    while distances.size and np.min(distances) <= SAME:
        a, b = (int(k) for k in np.unravel_index(np.argmin(distances), distances.shape))
        pairs.append((owners[a], others[b]))
        distances[a], distances[:, b] = np.inf, np.inf
    return pairs


def _of_all(
    mu: Mapping[tuple[int, float], ComplexArray], coordinate: float, side: Sequence[int]
) -> tuple[ComplexArray, list[int]]:
    """All unstable mu of segments at a coordinate, and the segment of each."""
    values = [mu[i, coordinate] for i in side]
    return np.concatenate(values), [i for i, each in zip(side, values, strict=True) for _ in each]


Evaluated = TypeVar("Evaluated")


def values_together(
    blocks: Sequence[Block],
    coordinates: Array,
    evaluate: Callable[[type[Block], Sequence[Block], Array], Iterable[Evaluated]],
) -> list[Evaluated]:
    """Values of each block at coordinates, (blocks, points), of those that are alike together."""
    kinds: dict[tuple[type[Block], Hashable], list[int]] = defaultdict(list)
    for i, block in enumerate(blocks):
        kinds[type(block), block.alike].append(i)
    found: dict[int, Evaluated] = {}
    for (kind, _), those in kinds.items():
        found |= zip(those, evaluate(kind, [blocks[i] for i in those], coordinates[those]), strict=True)
    return [found[i] for i in range(len(blocks))]
