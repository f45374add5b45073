"""Segments to tongues.

Unstable segments of intervals that touch are joined to groups; a group is a tongue, named by the linear modes whose
rotation angles meet where it begins; the edges of tongues are the changes of stability.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues.diagram import (
    Place,
    StabilityEdge,
    StableWindow,
    Tongue,
    places,
)
from casadi_skin.stability.tongues.interpolation import (
    Gap,
    Piece,
)
from casadi_skin.stability.tongues.pairs import Edge, Segment, evaluate
from casadi_skin.stability.tongues.rotation import Tracks
from casadi_skin.zero.problem import Array

Sides = tuple[list[tuple[int, Edge | None]], list[tuple[int, Edge | None]]]  # segments that end, and begin, somewhere

SAME_MU_DISTANCE = 0.05  # distance of two mu at the end of an interval that may be one
SAME_MU = 1e-6  # difference of mu of edges that coincide
DISAGREEMENT_WORDS = "intervals that touch disagree on whether a multiplier is off the circle"


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
    def errors(self) -> tuple[float, float]:
        """Errors of its first and of its last edge; 0 at an open end."""
        first, last = (0.0 if edge is None else edge.error for edge in (self.first_edge, self.last_edge))
        return first, last

    @property
    def decided(self) -> bool:
        """Whether it is longer than the errors of its edges."""
        return self.end - self.start > sum(self.errors)


def groups_of(segments: Sequence[Segment], unknown: Iterable[float]) -> tuple[list[Group], list[Gap]]:
    """Join segments that continue one another; beyond the coordinates `unknown` nothing is known on one side.

    The second result are stretches on either side of a place where a segment ends that neither side has an edge for.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    order = sorted(segments, key=lambda segment: (segment.start, segment.end))
    if not order:
        return [], []
    ends, by_edge, touching = set(unknown), dict[int, int](), defaultdict[float, Sides](lambda: ([], []))
    joined = list[tuple[int, int]]()  # pairs of segments that are of one group
    for i, segment in enumerate(order):
        for side, (place, edge) in enumerate(((segment.end, segment.end_edge), (segment.start, segment.start_edge))):
            touching[place][side].append((i, edge))
            if edge is not None:
                joined.append((by_edge.setdefault(id(edge), i), i))
    open_ends = {p: sides for p, sides in touching.items() if any(edge is None for side in sides for _, edge in side)}
    mu = _unstable_mu(order, open_ends)
    dropped, added, gaps = set[int](), dict[int, Edge](), list[Gap]()
    for place, sides in sorted(open_ends.items()):
        loose = [[i for i, edge in side if edge is None] for side in sides]
        pairs = _match(mu, place, *loose)
        joined += pairs
        matched = {i for pair in pairs for i in pair}
        left = [(here, i) for here in (0, 1) for i in loose[here] if i not in matched and place not in ends]
        for here, i in left:
            others = {k: edge for k, edge in sides[1 - here] if edge is not None}
            twins = _match(mu, place, [i], list(others))
            if twins:  # the other side sees the edge at their common end
                joined += twins[:1]
                dropped.add(id(others[twins[0][1]]))
            elif (edge := order[i].edge_at(place)) is not None:
                added[i] = edge
            else:
                length = order[i].block.end - order[i].block.start
                gaps.append(Gap(place - length, place + length, DISAGREEMENT_WORDS))
    firsts, seconds = np.array(joined, dtype=np.int64).reshape(-1, 2).T
    shape = len(order), len(order)
    count, labels = connected_components(coo_array((np.ones(len(joined)), (firsts, seconds)), shape=shape), False)
    groups = []
    for label in range(count):
        members = np.flatnonzero(labels == label).tolist()
        every = (edge for i in members for edge in (order[i].start_edge, order[i].end_edge, added.get(i)))
        edges = {id(edge): edge for edge in every if edge is not None and id(edge) not in dropped}
        in_order = sorted(edges.values(), key=lambda edge: edge.coordinate)
        groups.append(Group(tuple(order[i] for i in members), tuple(in_order)))
    return _undecided_once(sorted(groups, key=lambda group: group.start)), gaps


def _undecided_once(groups: Sequence[Group]) -> list[Group]:
    """Groups in order; of those that are not decided and coincide within their errors one.

    Two intervals see the same one at their common end, and mu that touch uncoupled touch by either of two functions.
    """
    found: list[Group] = []
    for group in groups:
        if group.decided or not any(_are_one(other, group) for other in found if not other.decided):
            found.append(group)
    return found


def _are_one(one: Group, other: Group) -> bool:
    """Whether two groups in order that are not decided may be one."""
    near = other.start - one.end <= one.errors[1] + other.errors[0]
    first, second = one.edges[0], other.edges[0]
    return near and first.kind == second.kind and abs(first.mu - second.mu) <= SAME_MU


def _unstable_mu(order: Sequence[Segment], places: Mapping[float, Sides]) -> dict[tuple[int, float], ComplexArray]:
    """The unstable mu of segments at ends of intervals that segments touch from both sides, by number and place."""
    wanted = [(i, place) for place, sides in places.items() if all(sides) for side in sides for i, _ in side]
    if not wanted:
        return {}
    mu, _ = evaluate([order[i].block for i, _ in wanted], np.array([[place] for _, place in wanted]))
    return {(i, place): order[i].unstable(values) for (i, place), values in zip(wanted, mu[:, 0], strict=True)}


def _match(
    mu: Mapping[tuple[int, float], ComplexArray], place: float, lefts: Sequence[int], rights: Sequence[int]
) -> list[tuple[int, int]]:
    """Segments with the same unstable mu at a place: each mu of one side is at most one of the other."""
    if not lefts or not rights:
        return []
    one, other = (np.concatenate([mu[i, place] for i in side]) for side in (lefts, rights))
    owners, others = ([i for i in side for _ in mu[i, place]] for side in (lefts, rights))
    distances, pairs = np.abs(one[:, None] - other), list[tuple[int, int]]()
    while distances.size and np.min(distances) <= SAME_MU_DISTANCE:
        a, b = (int(k) for k in np.unravel_index(np.argmin(distances), distances.shape))
        pairs.append((owners[a], others[b]))
        distances[a], distances[:, b] = np.inf, np.inf
    return pairs


# Tongues ------------------------------------------------------------------------------------------------------------

DEPTH_SAMPLES = 17  # of a segment, at which its depth is measured, and of the neighbourhood of the deepest
DEPTH_ZOOMS = 2
NO_AMPLITUDE = 1e-12  # of S at the end of a piece that begins at rest: rounding of its series


def tongues_of(groups: Sequence[Group], pieces: Sequence[Piece], power: int, tracks: Tracks | None) -> list[Tongue]:
    """The result that each group of segments is."""
    if not groups:
        return []
    growths, deepest = depths(groups)
    errors = np.array([group.errors for group in groups])
    starts, ends = (
        places(pieces, np.array([getattr(group, name) for group in groups]), errors[:, side])
        for side, name in enumerate(("start", "end"))
    )
    bottoms, meetings = places(pieces, deepest, np.zeros(len(groups))), _meetings(groups, tracks)
    return [
        Tongue(
            start=starts[i],
            end=ends[i],
            open_start=group.first_edge is None or at_rest(pieces, group.first_edge),
            open_end=group.last_edge is None,
            kind="complex" if group.segments[0].is_complex else "real",
            modes=meetings[i][:2] if i in meetings else None,
            order=meetings[i][2] if i in meetings else None,
            growth=power * float(growths[i]),
            S_deepest=bottoms[i].S,
            decided=group.decided,
        )
        for i, group in enumerate(groups)
    ]


def at_rest(pieces: Sequence[Piece], edge: Edge) -> bool:
    """Whether an edge is at the linear mode of zero amplitude that a family grows from, and which is no orbit of it."""
    start = pieces[0].matrices.start
    if edge.coordinate - edge.error > start:
        return False
    S = pieces[0].S(np.array([start, pieces[0].matrices.end]))
    return bool(abs(S[0]) <= NO_AMPLITUDE * abs(S[1]))


def _meetings(groups: Sequence[Group], tracks: Tracks | None) -> dict[int, tuple[int, int, int]]:
    """The modes that meet at the first or last edge of groups, and the orders of their resonances, where certain."""
    ends = [(i, edge) for i, group in enumerate(groups) for edge in (group.last_edge, group.first_edge)]
    edges = [(i, edge) for i, edge in ends if edge is not None]
    if tracks is None or not edges:
        return {}
    coordinates, mu = (np.array([getattr(edge, name) for _, edge in edges]) for name in ("coordinate", "mu"))
    angles = np.arccos(np.clip(1.0 + 2.0 * mu, -1.0, 1.0))
    found = tracks.meetings(coordinates, angles, np.array([edge.kind == "real" for _, edge in edges]))
    return {i: meeting for (i, _), meeting in zip(edges, found, strict=True) if meeting is not None}


def depths(groups: Sequence[Group]) -> tuple[Array, Array]:
    """Largest log |lambda(M)| on each group of segments, and the coordinates of it."""
    counts, segments = [len(g.segments) for g in groups], [segment for group in groups for segment in group.segments]
    starts, ends = (np.array([[getattr(segment, name)] for segment in segments]) for name in ("start", "end"))
    firsts = np.cumsum([0, *counts[:-1]])
    steps = np.maximum.reduceat(ends - starts, firsts)
    growths, deepest, low, high = np.full(len(groups), -np.inf), np.zeros(len(groups)), starts, ends
    for zoom in range(DEPTH_ZOOMS + 1):
        at, near = np.linspace(low[:, 0], high[:, 0], DEPTH_SAMPLES, axis=1), np.flatnonzero(low <= high)
        growth = np.full(at.shape, -np.inf)
        growth[near] = np.fmax(evaluate([segments[i].block for i in near.tolist()], at[near])[1], -np.inf)
        k = np.argmax(growth, axis=1)[:, None]  # of each segment, and the first largest of each group
        growth, at = (np.take_along_axis(each, k, 1)[:, 0] for each in (growth, at))
        largest = np.maximum.reduceat(growth, firsts)
        which = np.flatnonzero(growth == np.repeat(largest, counts))
        where = at[which[np.searchsorted(which, firsts)]]
        growths, deepest = np.maximum(largest, growths), np.where(largest > growths, where, deepest)
        steps = steps * (2.0 if zoom else 1.0) / (DEPTH_SAMPLES - 1)
        middle, reach = (np.repeat(each, counts, axis=0) for each in (deepest[:, None], steps))
        low, high = np.maximum(starts, middle - reach), np.minimum(ends, middle + reach)
    return np.maximum(growths, 0.0), deepest


# Changes ------------------------------------------------------------------------------------------------------------


def edges_of(
    groups: Sequence[Group], tongues: Sequence[Tongue], pieces: Sequence[Piece], power: int
) -> tuple[list[StabilityEdge], list[StableWindow]]:
    """Edges of decided tongues, and windows that are not decided, each in order along the branch."""
    unions, windows = _unions(groups, tongues)
    rows = []  # edge, whether stable before, whether stable after, number of its group
    for union in unions:
        start, end = min(groups[i].start for i in union), max(groups[i].end for i in union)
        for i in union:
            for edge in (edge for edge in groups[i].edges if not at_rest(pieces, edge)):
                before = edge is groups[i].first_edge and edge.coordinate == start
                after = edge is groups[i].last_edge and edge.coordinate == end
                rows.append((edge, before, after, i))
    rows.sort(key=lambda row: row[0].coordinate)
    if not rows:
        return [], windows
    at = places(pieces, np.array([row[0].coordinate for row in rows]), np.array([row[0].error for row in rows]))
    widths = [tongue.width for tongue in tongues]
    every = [
        StabilityEdge(place, edge.kind, edge.mu, edge.signatures, before, after, power, i, widths[i])
        for place, (edge, before, after, i) in zip(at, rows, strict=True)
    ]
    return _each_once(every), windows


def _each_once(edges: Sequence[StabilityEdge]) -> list[StabilityEdge]:
    """Edges in order; of those that coincide within their errors one: a change of stability, else the most exact.

    Multipliers that a symmetry makes equal leave the circle at one place; and where a family crosses one whose period
    is a third of its own, two tongues touch (Meyer 1970).
    """
    places: list[list[StabilityEdge]] = []
    errors = np.array([edge.place.coordinate_error for edge in edges])
    coordinates = np.array([edge.place.coordinate for edge in edges])
    reached = np.maximum.accumulate(np.append(-np.inf, coordinates + errors))[:-1]
    for edge, alone in zip(edges, (coordinates - errors > reached).tolist(), strict=True):
        others = () if alone else reversed(places)
        twin = next((place for place in others if _coincide(place[-1], edge)), None)
        if twin is None:
            places.append([edge])
        else:
            twin.append(edge)
    chosen = (min(p, key=lambda edge: (edge.stable_before == edge.stable_after, edge.error)) for p in places)
    return list(chosen)


def _coincide(one: StabilityEdge, other: StabilityEdge) -> bool:
    errors = one.place.coordinate_error + other.place.coordinate_error
    near = abs(one.place.coordinate - other.place.coordinate) <= errors
    return near and one.kind == other.kind and abs(one.mu - other.mu) <= SAME_MU


def _unions(groups: Sequence[Group], tongues: Sequence[Tongue]) -> tuple[list[list[int]], list[StableWindow]]:
    """Numbers of groups that overlap, or are no farther apart than their errors, and the windows between the latter."""
    unions: list[list[int]] = []
    windows: list[StableWindow] = []
    last = -1  # the group that reaches farthest
    for i, group in enumerate(groups):
        if last < 0 or group.start > groups[last].end:
            if last < 0 or group.start - groups[last].end > group.errors[0] + groups[last].errors[1]:
                unions.append([])
            else:
                windows.append(StableWindow(tongues[last].end, tongues[i].start))
        unions[-1].append(i)
        if last < 0 or group.end > groups[last].end:
            last = i
    return unions, windows


def place_at(pieces: Sequence[Piece], coordinate: float) -> Place:
    """The place at a coordinate that is known exactly."""
    return places(pieces, np.array([coordinate]), np.zeros(1))[0]
