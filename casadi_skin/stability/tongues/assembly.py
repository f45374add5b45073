"""Every change of stability along a branch: matrices interpolated, segments found, groups, tongues and changes.

Unstable segments of intervals that touch are joined to groups; a group is a tongue, named by the linear modes whose
rotation angles meet where it begins; the edges of tongues are the changes of stability.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from casadi_skin.stability.closed_maps import without_copies
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.tongues.blocks import Indices
from casadi_skin.stability.tongues.crossings import NOT_LOOKED_AT, Crossings, find_crossings
from casadi_skin.stability.tongues.diagram import (
    Passage,
    Place,
    StabilityDiagram,
    StabilityEdge,
    StableWindow,
    Tongue,
    places,
)
from casadi_skin.stability.tongues.interpolation import (
    FIRST_LENGTH,
    BranchSampler,
    Gap,
    Interpolated,
    MatrixSeries,
    Piece,
    interpolate,
    joined,
)
from casadi_skin.stability.tongues.pairs import Block, Edge, Segment
from casadi_skin.zero.problem import Array
from casadi_skin.zero.unresolved import Unresolved

# Signed rotation angles of multipliers, followed along a branch from the linear modes that they begin as --------------

Booleans = NDArray[np.bool_]
TWO_PI = 2.0 * np.pi
FASTEST_RATE_FACTOR = 4.0  # times the median rate: faster angles are those of mu about to meet, whose rates say little
CERTAIN_ANGLE_FRACTION = 0.5  # of the distance to the next angle: how far one may be from where it is expected


@dataclass(frozen=True)
class Spectrum:
    """All mu at a coordinate, shape (m,), with d mu/d coordinate and Krein signatures (0 off the circle)."""

    coordinate: float
    mu: ComplexArray
    rates: ComplexArray
    signatures: NDArray[np.int64]

    def angles(self) -> tuple[Array, Array]:
        """Signed angles and their rates, (m,) each; two complex mu have the angles that they met with."""
        on_circle = self.signatures != 0
        cosine = np.clip(1.0 + 2.0 * self.mu.real, -1.0, 1.0)
        lambdas = (np.sqrt(self.mu) + np.sqrt(1.0 + self.mu)) ** 2
        size = np.where(on_circle, np.arccos(cosine), np.abs(np.angle(lambdas)))
        sign = np.where(on_circle, self.signatures, np.where(self.mu.imag < 0.0, -1, 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            rates = np.where(on_circle, -2.0 * self.rates.real / np.sqrt(1.0 - cosine**2), 0.0) * sign
        limit = FASTEST_RATE_FACTOR * float(np.median(np.abs(rates[on_circle]))) if on_circle.any() else 0.0
        return sign * size, np.where(np.abs(rates) <= limit, rates, 0.0)


@dataclass(frozen=True)
class Tracks:
    """Rotation angles along a branch, continuous, one column a linear mode, followed in two ways.

    `angles` (2, places, m) at `coordinates`: each angle goes to the nearest one, or all keep their order around the
    circle. Where two angles of one signature meet, they pass or avoid each other: what differs then is not certain.
    """

    modes: tuple[int, ...]
    coordinates: Array
    angles: Array

    def meetings(self, coordinates: Array, angles: Array, alone: Booleans) -> list[tuple[int, int, int] | None]:
        """Modes (k, n) and the order of each meeting at an angle in [0, pi]; one mode twice where it is `alone`.

        None where it is not certain which angles meet.
        """
        right = np.clip(np.searchsorted(self.coordinates, coordinates), 1, self.coordinates.size - 1)
        low, high = self.coordinates[right - 1], self.coordinates[right]
        weight = np.clip((coordinates - low) / (high - low), 0.0, 1.0)[:, None]
        here = (1.0 - weight) * self.angles[:, right - 1] + weight * self.angles[:, right]
        (first, sure), (second, sure_too) = _nearest(here, angles), _nearest(here, -angles)
        second, sure_too = np.where(alone, first, second), sure_too | alone
        sure &= sure_too & (alone | (first != second))
        each = np.take_along_axis(here, np.stack([first, second], axis=2), 2)
        orders = np.round(np.sum(each, axis=2) / TWO_PI).astype(np.int64)
        modes = np.sort(np.array(self.modes)[np.stack([first, second], axis=2)], axis=2)
        known = np.concatenate([modes, orders[..., None]], axis=2)
        certain = np.all(sure, axis=0) & np.all(known[0] == known[1], axis=1)
        return [
            (k, n, m) if sure else None for (k, n, m), sure in zip(known[0].tolist(), certain.tolist(), strict=True)
        ]


def _nearest(angles: Array, wanted: Array) -> tuple[NDArray[np.int64], Booleans]:
    """The angle nearest to each one, modulo 2 pi, and whether no other is nearly as near; angles (2, wanted, m)."""
    distance = np.abs((angles - wanted[:, None] + np.pi) % TWO_PI - np.pi)
    first = np.argmin(distance, axis=2)
    if angles.shape[2] == 1:
        return first, np.ones(first.shape, dtype=bool)
    least = np.partition(distance, 1, axis=2)
    return first, least[..., 0] <= CERTAIN_ANGLE_FRACTION * least[..., 1]


def follow_angles(
    spectra: Sequence[Spectrum], frequencies: Mapping[int, float], start: float, duration: float
) -> Tracks | None:
    """Rotation angles of linear modes along a branch.

    Arguments:
        spectra: at coordinates in ascending order.
        frequencies: of the linear modes by number, without the one that the branch begins as.
        start: coordinate of the linear modes, where the branch has zero amplitude.
        duration: time that M takes there.

    Returns:
        The angles, or None where the numbers of modes and of mu differ.
    """
    modes = tuple(frequencies)
    if not spectra or len(modes) != spectra[0].mu.size:
        return None
    first = duration * np.array([frequencies[k] for k in modes])
    places = [(spectrum.coordinate, *spectrum.angles()) for spectrum in spectra]
    courses = [_course(first, places, start, assign) for assign in (_to_the_nearest, _in_cyclic_order)]
    return Tracks(modes, np.array([start, *(spectrum.coordinate for spectrum in spectra)]), np.array(courses))


Assignment = Callable[[Array, Array, Array], NDArray[np.int64]]


def _course(first: Array, places: Sequence[tuple[float, Array, Array]], start: float, assign: Assignment) -> Array:
    """Angles from the first ones on, shape (1 + places, m), by coordinates with the angles and their rates there."""
    course, before, rates = [first], start, np.zeros(first.size)
    for coordinate, angles, slopes in places:
        step = coordinate - before
        share = 0.5 if len(course) > 1 else 0.0  # of the step by the rates before it, which linear modes have none of
        ahead, back = course[-1] + share * step * rates, angles - (1.0 - share) * step * slopes
        distance = (back[None, :] - ahead[:, None] + np.pi) % TWO_PI - np.pi
        chosen = assign(course[-1], angles, distance)
        course.append(ahead + distance[np.arange(first.size), chosen] + (angles - back)[chosen])
        before, rates = coordinate, slopes[chosen]
    return np.array(course)


def _to_the_nearest(before: Array, after: Array, distance: Array) -> NDArray[np.int64]:
    """Which angle each one goes to where the sum of distances from what rates predict is smallest."""
    moves = np.abs(distance)
    nearest = np.argmin(moves, axis=1)
    if np.unique(nearest).size == nearest.size:  # then no other sum is smaller
        return np.asarray(nearest, dtype=np.int64)
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching  # scipy.optimize takes long to load

    costs = csr_array(1.0 + moves)  # with no entry zero, which would be none
    return np.asarray(min_weight_full_bipartite_matching(costs)[1], dtype=np.int64)


def _in_cyclic_order(before: Array, after: Array, distance: Array) -> NDArray[np.int64]:
    """The same among assignments that keep the order around the circle."""
    first, second = np.argsort(before % TWO_PI), np.argsort(after % TWO_PI)
    each = np.arange(first.size)
    turned = (each - each[:, None]) % first.size  # row by row by one place more
    moves = np.sum(np.abs(distance[first, second[turned]]), axis=1)
    chosen = np.empty(first.size, dtype=np.int64)
    chosen[first] = second[turned[np.argmin(moves)]]
    return chosen


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
                gaps.append(Gap(coordinate - length, coordinate + length, DISAGREEMENT_WORDS))
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
    while distances.size and np.min(distances) <= SAME_MU_DISTANCE:
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


DEPTH_SAMPLES = 17  # of a segment, at which its depth is measured, and of the neighbourhood of the deepest
DEPTH_ZOOMS = 2
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
    for zoom in range(DEPTH_ZOOMS + 1):
        at = np.linspace(low[near], high[near], DEPTH_SAMPLES, axis=1)
        blocks = [segments[i].block for i in near.tolist()]
        growth = np.array(values_together(blocks, at, lambda cls, those, places: cls.growths_together(those, places)))
        k = np.argmax(growth, axis=1)[:, None]
        found, where = (np.take_along_axis(each, k, 1)[:, 0] for each in (growth, at))
        deepest = _largest(owners[near], found, where, *deepest)
        steps *= (2.0 if zoom else 1.0) / (DEPTH_SAMPLES - 1)
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


# The account of a family: multipliers outside the unit circle at its orbits, each beside the tongue that it is in -----

CLEARLY_OUTSIDE_ERRORS = 4.0  # errors of a mu that it is outside by, to be in the account
LEAST_DISTANCE = 1e-9  # of such a distance: rounding of two mu that nearly meet
SAME_PLACE = 1e-13  # of a coordinate: rounding of sums
NEAR_TONGUE_DISTANCE = 1e-3  # distance of a mu at an orbit from that of its tongue there, beside ten errors
UNBALANCED_WORDS = (
    "the account does not balance: multipliers outside the unit circle at an orbit are not those of its tongues"
)


@dataclass(frozen=True)
class Entry:
    """All mu at an orbit, with their errors, and the coordinate of the orbit along the branch."""

    coordinate: float
    mu: ComplexArray
    errors: Array


def unbalanced(entries: Sequence[Entry], groups: Sequence[Group], gaps: Sequence[Gap]) -> list[Gap]:
    """Stretches around orbits whose unstable mu are not those of the groups of segments there.

    Each reaches from the last orbit before to the next one behind at which the account balances. Orbits in `gaps` are
    in no account, and neither are mu that are outside by no more than errors.
    """
    segments = [segment for group in groups for segment in group.segments]
    starts, ends = (np.array([getattr(segment, name) for segment in segments]) for name in ("start", "end"))
    found: list[Gap] = []
    balanced = True
    last = entries[0].coordinate if entries else 0.0
    for entry in entries:
        if any(gap.start <= entry.coordinate <= gap.end for gap in gaps):
            continue
        slack = SAME_PLACE * abs(entry.coordinate)
        here = np.flatnonzero((starts <= entry.coordinate + slack) & (entry.coordinate - slack <= ends))
        parts = [segments[i].block.unstable_mu(segments[i], entry.coordinate) for i in here.tolist()]
        fits = _fits(entry, np.concatenate([np.empty(0, complex), *parts]))
        if not fits and balanced:
            found.append(Gap(last, entry.coordinate, UNBALANCED_WORDS))
        elif not balanced:
            found[-1] = Gap(found[-1].start, entry.coordinate, UNBALANCED_WORDS)
        balanced, last = fits, entry.coordinate
    return found


def _fits(entry: Entry, unstable: ComplexArray) -> bool:
    """Whether all mu that are clearly outside at an orbit are near one of a tongue, and the other way round."""
    if entry.mu.size == 0:
        return True
    own, theirs = (mu.real + 1j * np.abs(mu.imag) for mu in (entry.mu, unstable))
    far = _outside(own) > CLEARLY_OUTSIDE_ERRORS * entry.errors + LEAST_DISTANCE
    if np.any(far) and unstable.size == 0:
        return False
    apart = np.abs(own[:, None] - theirs)
    if np.any(np.min(apart[far], axis=1, initial=np.inf) > NEAR_TONGUE_DISTANCE + 10.0 * entry.errors[far]):
        return False
    nearest = np.argmin(apart, axis=0)
    clear = _outside(theirs) > CLEARLY_OUTSIDE_ERRORS * entry.errors[nearest] + LEAST_DISTANCE
    return bool(np.all(_outside(own[nearest[clear]]) > 0.0))


def _outside(mu: ComplexArray) -> Array:
    """Distances from [-1, 0]; 0 inside."""
    return np.asarray(np.abs(mu - np.clip(mu.real, -1.0, 0.0)))


# Every change of stability along a branch, for certain: the whole way from transition matrices to tongues -------------

INTERPOLATION_TOLERANCE = 1e-11  # tolerance, relative to the largest entries
WORK_LIMIT = 2e9  # see `Crossings.work`: a minute or two
SAMPLE_WORK = 0.1  # an orbit with its transition matrix, in such problems
EXPECTED_INTERVALS = 16  # of a piece of the branch, as expected
PIECES_WORK = 1e7  # m^3 over the intervals of pieces that are looked at together
ONE_PLACE = 1e-9  # of the branch: meetings without instability that are no farther apart are one
WORK_SHARE = 0.05  # of the work that is left, at most, for such pieces
POWERS_BY_FRACTION = {
    0.25: 2,
    0.5: 1,
}  # of lambda(M) that give multipliers, by the fraction of the period of transition matrices


def find_changes(
    branch: BranchSampler,
    modes: Mapping[int, float] | None = None,
    tolerance: float = INTERPOLATION_TOLERANCE,
    work: float = WORK_LIMIT,
    progress: Callable[[float], None] | None = None,
    short: bool = False,
    entries: Sequence[Entry] = (),
) -> StabilityDiagram:
    """Find every change of stability along a branch of periodic orbits of a reversible model.

    Arguments:
        branch: the source of transition matrices at any coordinate along it.
        modes: frequencies of the linear modes, by number, at its start of zero amplitude, but for that mode which it
            begins as; tongues are named by them.
        tolerance: of the interpolation of the matrices along the branch, relative to their largest entries.
        work: limit of `Crossings.work`, the sum of m^3 and more over the problems of m multipliers; the rest of the
            branch is then unresolved. The default is a minute or two.
        progress: called with the coordinate up to which everything is looked at.
        short: whether one piece of the lowest degree is tried on each section of the branch first.
        entries: all mu at orbits of the branch, in order: where those outside are not those of tongues is unresolved.

    Returns:
        Changes of stability and tongues, with undecided and unresolved places.
    """
    power = POWERS_BY_FRACTION[branch.fraction]
    known, found = _looked_at(branch, tolerance, work, progress, short)
    groups, disagreements = groups_of(found.segments, _unknown(known, found))
    found.gaps += disagreements
    found.gaps += unbalanced(entries, groups, [*known.gaps, *found.gaps])
    tracks = None if modes is None else _tracks(known, found, modes, branch.fraction)
    tongues = tongues_of(groups, known.pieces, power, tracks)
    decided = [i for i, tongue in enumerate(tongues) if tongue.decided]
    edges = edges_of([groups[i] for i in decided], [tongues[i] for i in decided], known.pieces, power)
    return StabilityDiagram(
        changes=edges.changes,
        further=edges.further,
        tongues=tuple(tongues[i] for i in decided),
        undecided=tuple(tongue for tongue in tongues if not tongue.decided),
        windows=edges.windows,
        passages=tuple(_passages(known, found)),
        unresolved=tuple(_unresolved(branch, known, found)),
        symplectic=branch.symplectic,
        power=power,
        samples=known.samples,
        pieces=tuple(known.pieces),
    )


def _looked_at(
    branch: BranchSampler, tolerance: float, work: float, progress: Callable[[float], None] | None, short: bool
) -> tuple[Interpolated, Crossings]:
    """Pieces of the branch one after the other, and the events on them, as far as the work allows."""
    known, found = Interpolated(), Crossings()
    waiting: list[MatrixSeries] = []
    for piece in interpolate(branch, tolerance, known, 1.0 if short else FIRST_LENGTH):
        waiting += without_copies(piece.matrices)
        for_orbits = SAMPLE_WORK * known.samples * float(piece.matrices.size) ** 3
        expected = EXPECTED_INTERVALS * len(waiting) * float(piece.matrices.size) ** 3
        if expected >= min(PIECES_WORK, WORK_SHARE * (work - found.work - for_orbits)):
            find_crossings(waiting, found, work - for_orbits, progress, piece.matrices.size)
            waiting = []
            end = branch.sections[-1][1]
            if found.work + for_orbits >= work and piece.matrices.end < end:
                found.gaps.append(Gap(piece.matrices.end, end, NOT_LOOKED_AT))
                break
    if waiting:
        for_orbits = SAMPLE_WORK * known.samples * float(piece.matrices.size) ** 3
        find_crossings(waiting, found, work - for_orbits, progress, piece.matrices.size)
    found.spectra.sort(key=lambda spectrum: spectrum.coordinate)
    return known, found


def _passages(known: Interpolated, found: Crossings) -> Iterator[Passage]:
    """Meetings without instability in order, those that two intervals see at their common end once."""
    last, near = (-np.inf, 0.0), 0.0
    for coordinate, mu, distance in sorted(found.passages):
        near = near or ONE_PLACE * (known.pieces[-1].matrices.end - known.pieces[0].matrices.start)
        if coordinate - last[0] > near or abs(mu - last[1]) > SAME_MU:
            yield Passage(place_at(known.pieces, coordinate), mu, distance)
        last = coordinate, mu


def _unknown(known: Interpolated, found: Crossings) -> set[float]:
    """Coordinates where the computed part of the branch, or of its multipliers, ends."""
    starts = {piece.matrices.start for piece in known.pieces}
    ends = {piece.matrices.end for piece in known.pieces}
    return (starts ^ ends) | {coordinate for gap in (*known.gaps, *found.gaps) for coordinate in (gap.start, gap.end)}


def _tracks(known: Interpolated, found: Crossings, modes: Mapping[int, float], fraction: float) -> Tracks | None:
    """Rotation angles of the linear modes along the branch."""
    if not known.pieces:
        return None
    start = place_at(known.pieces, known.pieces[0].matrices.start)
    return follow_angles(found.spectra, modes, start.coordinate, 2.0 * TWO_PI * fraction / start.Omega)


def _unresolved(branch: BranchSampler, known: Interpolated, found: Crossings) -> Iterator[Unresolved]:
    """Stretches that are not known, with the amplitudes at their ends."""
    rest = [gap for gap in found.gaps if gap.reason == NOT_LOOKED_AT]
    if rest:  # as one, though in between some blocks may have been looked at
        rest = [Gap(min(gap.start for gap in rest), max(gap.end for gap in rest), NOT_LOOKED_AT)]
    others = [gap for gap in (*known.gaps, *found.gaps) if gap.reason != NOT_LOOKED_AT]
    for gap in sorted([*joined(others), *rest], key=lambda gap: gap.start):
        S_start, S_end = (_amplitude(branch, known.pieces, at) for at in (gap.start, gap.end))
        yield Unresolved(S_start, S_end, gap.reason, coordinates=(gap.start, gap.end))


def _amplitude(branch: BranchSampler, pieces: Sequence[Piece], coordinate: float) -> float:
    """S at a coordinate, from the pieces where these hold it."""
    if any(piece.matrices.start <= coordinate <= piece.matrices.end for piece in pieces):
        return place_at(pieces, coordinate).S
    return branch.amplitude(coordinate)
