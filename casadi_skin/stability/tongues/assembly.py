"""From groups of unstable segments to tongues, and from tongues to changes of stability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casadi_skin.stability.tongues.decoupling import Indices
from casadi_skin.stability.tongues.diagram import Place, StabilityEdge, StableWindow, Tongue, places
from casadi_skin.stability.tongues.groups import SAME_MU, Group, error_of, values_together
from casadi_skin.stability.tongues.interpolation import Piece
from casadi_skin.stability.tongues.rotation import Tracks
from casadi_skin.stability.tongues.small_blocks import Edge
from casadi_skin.zero.problem import Array

SAMPLES = 17  # of a segment, at which its depth is measured, and of the neighbourhood of the deepest
ZOOMS = 2
NO_AMPLITUDE = 1e-12  # of S at the end of a piece that begins at rest: rounding of its series


# Tongues ------------------------------------------------------------------------------------------------------------


def tongues_of(groups: Sequence[Group], pieces: Sequence[Piece], power: int, tracks: Tracks | None) -> list[Tongue]:
    """The result that each group of segments is."""
    if not groups:
        return []
    growths, deepest = depths(groups)
    nothing = np.zeros(len(groups))
    starts = places(pieces, np.array([g.start for g in groups]), np.array([error_of(g.first_edge) for g in groups]))
    ends = places(pieces, np.array([g.end for g in groups]), np.array([error_of(g.last_edge) for g in groups]))
    bottoms = places(pieces, deepest, nothing)
    meetings = _meetings(groups, tracks)
    found = []
    for i, group in enumerate(groups):
        meeting = meetings.get(i)
        found.append(
            Tongue(
                start=starts[i],
                end=ends[i],
                open_start=group.first_edge is None or at_rest(pieces, group.first_edge),
                open_end=group.last_edge is None,
                kind="complex" if group.segments[0].is_complex else "real",
                modes=None if meeting is None else meeting[:2],
                order=None if meeting is None else meeting[2],
                growth=power * float(growths[i]),
                S_deepest=bottoms[i].S,
                decided=group.decided,
            )
        )
    return found


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
    segments = [segment for group in groups for segment in group.segments]
    owners = np.repeat(np.arange(len(groups)), [len(group.segments) for group in groups])
    starts, ends = (np.array([getattr(segment, name) for segment in segments]) for name in ("start", "end"))
    steps, deepest = np.zeros(len(groups)), (np.full(len(groups), -np.inf), np.zeros(len(groups)))
    np.maximum.at(steps, owners, ends - starts)
    near, low, high = np.arange(len(segments)), starts, ends
    for zoom in range(ZOOMS + 1):
        at = np.linspace(low[near], high[near], SAMPLES, axis=1)
        blocks = [segments[i].block for i in near.tolist()]
        growth = np.array(values_together(blocks, at, lambda cls, those, places: cls.growths_together(those, places)))
        k = np.argmax(growth, axis=1)[:, None]
        found, where = (np.take_along_axis(each, k, 1)[:, 0] for each in (growth, at))
        deepest = _largest(owners[near], found, where, *deepest)
        steps *= (2.0 if zoom else 1.0) / (SAMPLES - 1)
        low, high = np.maximum(starts, (deepest[1] - steps)[owners]), np.minimum(ends, (deepest[1] + steps)[owners])
        near = np.flatnonzero(low <= high)
    return np.maximum(deepest[0], 0.0), deepest[1]


def _largest(owners: Indices, values: Array, places: Array, before: Array, where: Array) -> tuple[Array, Array]:
    """The largest value of each owner, of these and the one before, and its place."""
    every = np.concatenate([np.arange(before.size), owners])
    values, places = np.concatenate([before, values]), np.concatenate([where, places])
    order = np.lexsort((places, values, every))
    last = order[np.append(np.diff(every[order]) > 0, True)]
    return values[last], places[last]


# Changes ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Edges:
    """Changes of stability, further edges, and windows that are not decided, each in order along the branch."""

    changes: tuple[StabilityEdge, ...]
    further: tuple[StabilityEdge, ...]
    windows: tuple[StableWindow, ...]


def edges_of(groups: Sequence[Group], tongues: Sequence[Tongue], pieces: Sequence[Piece], power: int) -> Edges:
    """Edges of decided tongues, distinguished by whether orbits on either side are stable."""
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
        return Edges((), (), tuple(windows))
    at = places(pieces, np.array([row[0].coordinate for row in rows]), np.array([row[0].error for row in rows]))
    widths = [tongue.width for tongue in tongues]
    every = [
        StabilityEdge(place, edge.kind, edge.mu, edge.signatures, before, after, i, widths[i], power)
        for place, (edge, before, after, i) in zip(at, rows, strict=True)
    ]
    made = _each_once(every)
    changes = tuple(edge for edge in made if edge.stable_before != edge.stable_after)
    return Edges(changes, tuple(edge for edge in made if edge.stable_before == edge.stable_after), tuple(windows))


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
            gap = np.inf if last < 0 else group.start - groups[last].end
            if gap > error_of(group.first_edge) + (0.0 if last < 0 else error_of(groups[last].last_edge)):
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
