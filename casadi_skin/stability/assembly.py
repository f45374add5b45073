"""From unstable segments to tongues, and from tongues to changes of stability."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.stability.interpolation import Interpolated, Piece
from casadi_skin.stability.rotation import Tracks
from casadi_skin.stability.small_blocks import Edge, Segment
from casadi_skin.stability.tongues import Place, StabilityEdge, StableWindow, Tongue, piece_at, place_on

SAME = 0.05  # distance of two mu at the end of an interval that may be one
SAMPLES = 17  # of a segment, at which its depth is first measured
ZOOMS = 4  # of the neighbourhood of the deepest
LOOSE = 1e-9  # of an interval: error of an edge at its very end that neither side finds


@dataclass(frozen=True)
class Group:
    """Segments that continue one another, in order of their starts, and all of their edges in order."""

    segments: tuple[Segment, ...]
    edges: tuple[Edge, ...]

    @property
    def start(self) -> float:
        return min(segment.start for segment in self.segments)

    @property
    def end(self) -> float:
        return max(segment.end for segment in self.segments)

    @property
    def first_edge(self) -> Edge | None:
        """The edge at its start; None where it is open."""
        return next((edge for edge in self.edges if edge.coordinate == self.start), None)

    @property
    def last_edge(self) -> Edge | None:
        """The edge at its end; None where it is open."""
        return next((edge for edge in reversed(self.edges) if edge.coordinate == self.end), None)

    @property
    def decided(self) -> bool:
        """Whether it is longer than the errors of its edges."""
        first, last = self.first_edge, self.last_edge
        return self.end - self.start > (first.error if first else 0.0) + (last.error if last else 0.0)


def groups_of(segments: Sequence[Segment], ends: Iterable[float]) -> list[Group]:
    """Join segments that continue one another; `ends` are coordinates beyond which nothing is known."""
    order = sorted(segments, key=lambda segment: (segment.start, segment.end))
    parents = list(range(len(order)))

    def root(i: int) -> int:
        while parents[i] != i:
            parents[i] = parents[parents[i]]
            i = parents[i]
        return i

    by_edge: dict[int, int] = {}
    for i, segment in enumerate(order):
        for edge in (segment.start_edge, segment.end_edge):
            if edge is not None:
                parents[root(i)] = root(by_edge.setdefault(id(edge), i))
    unknown = set(ends)
    dropped: set[int] = set()
    added: dict[int, list[Edge]] = defaultdict(list)
    for coordinate, lefts, rights in _boundaries(order):
        loose = [i for i in lefts if order[i].end_edge is None], [i for i in rights if order[i].start_edge is None]
        left_over = _match(order, coordinate, *loose)
        for i, j in left_over.pairs:
            parents[root(j)] = root(i)
        for i, on_left in left_over.alone:
            if coordinate in unknown:
                continue
            others = [k for k in (rights if on_left else lefts) if k not in (*loose[0], *loose[1])]
            twin = _match(order, coordinate, [i] if on_left else others, others if on_left else [i])
            if twin.pairs:  # both sides see the edge at their common end
                other = twin.pairs[0][1] if on_left else twin.pairs[0][0]
                parents[root(other)] = root(i)
                edge = order[other].start_edge if on_left else order[other].end_edge
                dropped.add(id(edge))
            else:
                added[i].append(_loose_edge(order[i], coordinate))
    members = defaultdict(list)
    for i in range(len(order)):
        members[root(i)].append(i)
    return sorted((_group(order, m, dropped, added) for m in members.values()), key=lambda group: group.start)


def _group(
    order: Sequence[Segment], members: Sequence[int], dropped: set[int], added: dict[int, list[Edge]]
) -> Group:
    edges = {}
    for i in members:
        for edge in (order[i].start_edge, order[i].end_edge, *added[i]):
            if edge is not None and id(edge) not in dropped:
                edges[id(edge)] = edge
    return Group(tuple(order[i] for i in members), tuple(sorted(edges.values(), key=lambda edge: edge.coordinate)))


def _boundaries(order: Sequence[Segment]) -> Iterator[tuple[float, list[int], list[int]]]:
    """Coordinates where segments end at the end of an interval: those to the left, and those to the right."""
    lefts, rights = defaultdict(list), defaultdict(list)
    for i, segment in enumerate(order):
        lefts[segment.end].append(i)
        rights[segment.start].append(i)
    loose = {s.end for s in order if s.end_edge is None} | {s.start for s in order if s.start_edge is None}
    for coordinate in sorted(loose):
        yield coordinate, lefts.get(coordinate, []), rights.get(coordinate, [])


@dataclass(frozen=True)
class _Match:
    pairs: list[tuple[int, int]]
    alone: list[tuple[int, bool]]  # which segment, and whether it lies to the left


def _match(order: Sequence[Segment], coordinate: float, lefts: Sequence[int], rights: Sequence[int]) -> _Match:
    """Segments to the left and right of a coordinate with the same mu there."""
    mu = {i: order[i].block.unstable_mu(order[i], coordinate) for i in (*lefts, *rights)}
    pairs = []
    for i in lefts:
        for value in mu[i]:
            near = [(float(np.min(np.abs(mu[j] - value))), j) for j in rights]
            if near and min(near)[0] <= SAME:
                pairs.append((i, min(near)[1]))
    matched = {i for pair in pairs for i in pair}
    alone = [(i, True) for i in lefts if i not in matched] + [(j, False) for j in rights if j not in matched]
    return _Match(pairs, alone)


def _loose_edge(segment: Segment, coordinate: float) -> Edge:
    """The edge at the end of an interval that neither of its sides finds inside."""
    error = LOOSE * (segment.block.end - segment.block.start)
    mu = complex(np.mean(segment.block.unstable_mu(segment, coordinate)))
    if segment.is_complex:
        return Edge(coordinate, error, "collision", mu.real, (1, -1) if segment.block.noise.size == 3 else ())
    return Edge(coordinate, error, "real", float(np.round(mu.real)), ())


# Tongues ------------------------------------------------------------------------------------------------------------


def tongue_of(group: Group, pieces: Sequence[Piece], power: int, tracks: Tracks | None) -> Tongue:
    """The result that a group of segments is."""
    first, last = group.first_edge, group.last_edge
    growth, deepest = depth(group.segments)
    meeting = None
    for edge in (first, last):
        if edge is not None and tracks is not None and meeting is None:
            angle = float(np.arccos(np.clip(1.0 + 2.0 * edge.mu, -1.0, 1.0)))
            meeting = tracks.meeting(edge.coordinate, angle, alone=edge.kind == "real")
    return Tongue(
        start=_place(pieces, group.start, first),
        end=_place(pieces, group.end, last),
        open_start=first is None,
        open_end=last is None,
        kind="complex" if group.segments[0].is_complex else "real",
        modes=None if meeting is None else meeting[:2],
        order=None if meeting is None else meeting[2],
        growth=power * growth,
        S_deepest=float(piece_at(pieces, deepest).S(np.array([deepest]))[0]),
        decided=group.decided,
    )


def depth(segments: Sequence[Segment]) -> tuple[float, float]:
    """Largest log |lambda(M)| on segments, and the coordinate of it."""
    best = (-1.0, segments[0].start, segments[0], 0.0)
    for segment in segments:
        at = np.linspace(segment.start, segment.end, SAMPLES)
        growth = segment.block.growth(at)
        k = int(np.argmax(growth))
        if growth[k] > best[0]:
            best = (float(growth[k]), float(at[k]), segment, (segment.end - segment.start) / (SAMPLES - 1))
    value, place, segment, step = best
    for _ in range(ZOOMS):
        at = np.linspace(max(place - step, segment.start), min(place + step, segment.end), SAMPLES)
        growth = segment.block.growth(at)
        k = int(np.argmax(growth))
        value, place, step = max(value, float(growth[k])), float(at[k]), step * 2.0 / (SAMPLES - 1)
    return max(value, 0.0), place


def _place(pieces: Sequence[Piece], coordinate: float, edge: Edge | None) -> Place:
    return place_on(piece_at(pieces, coordinate), coordinate, 0.0 if edge is None else edge.error)


# Changes ------------------------------------------------------------------------------------------------------------


def edges_of(
    groups: Sequence[Group], tongues: Sequence[Tongue], known: Interpolated
) -> tuple[list[StabilityEdge], list[StabilityEdge], list[StableWindow]]:
    """Changes of stability, further edges, and windows that are not decided; of decided tongues, in order."""
    unions: list[list[int]] = []  # numbers of groups whose union is one interval
    windows: list[StableWindow] = []
    reach = -np.inf
    for i, group in enumerate(groups):
        if unions and group.start > reach:
            last = max(unions[-1], key=lambda k: groups[k].end)
            gap, errors = group.start - reach, tongues[last].end.coordinate_error + tongues[i].start.coordinate_error
            if gap <= errors:
                windows.append(StableWindow(tongues[last].end, tongues[i].start))
            else:
                unions.append([])
        if not unions:
            unions.append([])
        unions[-1].append(i)
        reach = max(reach, group.end)
    changes: list[StabilityEdge] = []
    further: list[StabilityEdge] = []
    for union in unions:
        start, end = min(groups[i].start for i in union), max(groups[i].end for i in union)
        for i in union:
            for edge in groups[i].edges:
                before = edge is groups[i].first_edge and edge.coordinate == start
                after = edge is groups[i].last_edge and edge.coordinate == end
                made = StabilityEdge(
                    _place(known.pieces, edge.coordinate, edge),
                    edge.kind,
                    edge.mu,
                    edge.signatures,
                    before,
                    after,
                    i,
                    tongues[i].width,
                )
                (changes if before != after else further).append(made)
    by_place = lambda edge: edge.place.coordinate  # noqa: E731
    return sorted(changes, key=by_place), sorted(further, key=by_place), windows


def with_tongue(edge: StabilityEdge, tongue: int) -> StabilityEdge:
    """The same edge of another tongue."""
    return replace(edge, tongue=tongue)
