"""The boundary of stability in the plane of a map's two ranges, to the accuracy of a solution and not of a cell.

Of equilibria and orbits it is made of curves of special points between neighbouring cells that differ. Of families it
is their first instability over a parameter: edges of tongues, followed from one of them in the parameter. Neighbouring
families that enter the same tongue share a line. It goes on to the neighbours on both sides, at which another tongue
is the first one, as long as no other line lies below it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.arguments import in_words
from casadi_skin.runs.binding import Files, bind
from casadi_skin.runs.first_solution import first_solution
from casadi_skin.runs.map_cell import followed
from casadi_skin.runs.map_grid import Axis, Cells, Settings, plain, scene_at
from casadi_skin.runs.map_result import DONE, UNKNOWN, Lines, Map
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene
from casadi_skin.zero.kinds import EDGE, FOLD, HOPF

BEYOND_EDGE_FRACTION = 1e-3  # of S: how far beyond an edge the family is followed that it is found on
EDGE_S_RTOL = 1e-6  # of S: within which the edge is the one that the map has
RANGE_MARGIN = 0.05  # of a range, by which a curve leaves it before it ends
MOST_STARTS = 24  # of curves in a plane
LONGEST_CURVE_STEP = 0.05  # longest, of a curve
Points = NDArray[np.float64]  # shape (points, 2)
Pair = tuple[tuple[int, int], tuple[int, int]]  # places of two neighbouring cells in a plane


def boundaries(scene: Scene, path: Path, found: Map, report: Callable[[str], None]) -> Lines:
    """Lines of the boundary by the places of the axes that are no ranges; a line of one point is a point.

    `report` takes a line for each edge that cannot be followed, with the reason.
    """
    grid, lines, files = found.grid, dict[tuple[int, ...], tuple[Points, ...]](), Files()
    along = [i for i, axis in enumerate(grid.axes) if axis.numeric]
    cells, tables = np.moveaxis(np.arange(grid.size).reshape(grid.shape), along, (-2, -1)), plain(scene)

    def bound(settings: Settings, amplitudes: Sequence[float] = ()) -> Request:
        return bind(scene_at(tables, settings, amplitudes), path, files)

    for chosen in np.ndindex(cells.shape[:-2]):
        axes, of_family = (grid.axes[along[0]], grid.axes[along[1]]), grid.amplitude in along
        plane = Plane(found, axes, cells[chosen], bound, report)
        if of_family and "first_tongue" in found.columns:
            turned = grid.amplitude == along[0]
            edges = _tongue_lines(plane.turned if turned else plane)
            lines[chosen] = tuple(line[:, ::-1] if turned else line for line in edges)
        elif not of_family and "stable" in found.columns:
            lines[chosen] = tuple(_curves(plane))
    return lines


@dataclass(frozen=True)
class Plane:
    """The two ranges of a map, their cells, shape of the two; how a scene is bound, and reports are taken."""

    map: Map
    axes: tuple[Axis, Axis]
    cells: Cells
    bound: Callable[..., Request]
    report: Callable[[str], None]

    @property
    def turned(self) -> Plane:
        """The plane with its second range first."""
        return Plane(self.map, self.axes[::-1], self.cells.T, self.bound, self.report)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which cells are computed."""
        return np.asarray(self.map.states[self.cells] != UNKNOWN)


def _outside(axis: Axis, name: str, positive: bool = False) -> Callable[[Any], bool]:
    """Whether a solution lies beyond a range of a parameter, with a margin; a positive one stays positive."""
    low, high = sorted((float(axis.values[0]), float(axis.values[-1])))
    margin = RANGE_MARGIN * (high - low)
    least = max(low - margin, 0.5 * low) if positive else low - margin
    return lambda solution: not least <= solution.parameters[name] <= high + margin


# Families: edges of tongues in the plane of a parameter and S ---------------------------------------------------------


@dataclass(frozen=True)
class Entry:
    """The first instability of a family: its value of the parameter, S, the tongue, and a cell of it."""

    value: float
    S: float
    tongue: str
    cell: int


def _tongue_lines(plane: Plane) -> list[Points]:
    """Lines of the boundary; where an edge cannot be followed, its line joins the families."""
    entries, lines, found = list[Entry](), list[Points](), plane.map
    tongues = found.values("first_tongue").ravel()
    for value, family, known in zip(plane.axes[0].values, plane.cells, plane.known, strict=True):
        if np.any(known):
            cell = int(family[known][0])
            S = float(found.columns["first_instability"][cell])
            entries.append(Entry(float(value), S, tongues[cell], cell))
    values = [entry.value for entry in entries]
    for tongue, group in groupby(range(len(entries)), key=lambda k: entries[k].tongue):
        places = list(group)
        if not tongue:
            continue
        run = [entries[k] for k in places]
        reach = values[max(places[0] - 1, 0)], values[min(places[-1] + 1, len(values) - 1)]
        try:
            lines.append(_followed(plane, run, reach))
        except (ValueError, ArithmeticError) as error:
            names = ", ".join(axis.name for axis in found.grid.axes if axis in plane.axes)
            words = f"{names}: the edge of the tongue {tongue} is not followed, its line joins families"
            plane.report(f"{words}: {in_words(error)}")
            lines.append(np.array([(entry.value, entry.S) for entry in run]))
    return [part for k, line in enumerate(lines) for part in lowest(line, lines[:k] + lines[k + 1 :])]


def _followed(plane: Plane, run: Sequence[Entry], reach: tuple[float, float]) -> Points:
    """The edge that the families of a run have, from one end of a reach of the parameter to the other one.

    Raises ValueError and ArithmeticError where it cannot be followed, or does not pass all of them.
    """
    (parameter, S_axis), middle = plane.axes, run[len(run) // 2]
    name, beyond = parameter.paths[0][-1], middle.S * (1.0 + BEYOND_EDGE_FRACTION)
    (branch,), fault = followed(plane.bound(plane.map.grid.settings(middle.cell), (beyond,)))
    diagram = branch.stability_diagram
    edges = [] if diagram is None else [*diagram.changes, *diagram.further]
    near = [edge for edge in edges if abs(edge.S - middle.S) <= EDGE_S_RTOL * middle.S]
    if not near:
        raise ArithmeticError(fault or "it is not found again")
    orbit, outside = branch.at(S=near[0].S), _outside(S_axis, "S", positive=True)
    point = SpecialPoint(EDGE, "S", {**orbit.parameters, "S": near[0].S}, near[0].error, orbit)
    halves = []
    for to in reach:
        if to != middle.value:
            at = [entry.value for entry in run if min(middle.value, to) < entry.value < max(middle.value, to)]
            order = sorted(at, reverse=to < middle.value)
            halves.append(checked(point.curve(name, to, at=order, until=outside), name, run))
    if not halves:
        return np.array([(middle.value, middle.S)])
    below = halves[0] if len(halves) == 2 else halves[0][:1]
    return np.concatenate([below[::-1], halves[-1][1:]])


def checked(curve: Any, name: str, run: Sequence[Entry]) -> Points:
    """The points of a curve, which passes the families of a run; raises ArithmeticError where it does not."""
    points = np.column_stack([curve[name], curve["S"]])
    low, high = points[:, 0].min(), points[:, 0].max()
    for entry in run:
        if low <= entry.value <= high:
            near = np.abs(points[points[:, 0] == entry.value, 1] - entry.S)
            if not np.any(near <= EDGE_S_RTOL * entry.S):
                raise ArithmeticError(f"it passes {name} = {entry.value:g} elsewhere")
    return points


def lowest(line: Points, others: Sequence[Points]) -> Iterator[Points]:
    """The parts of a line below which no other line is."""
    above = np.zeros(len(line), dtype=bool)
    for other in others:
        x, S = other[np.argsort(other[:, 0], kind="stable")].T
        inside = (line[:, 0] >= x[0]) & (line[:, 0] <= x[-1])
        single = len(x) > 1 and bool(np.all(np.diff(x) > 0.0))
        above |= inside & single & (line[:, 1] > np.interp(line[:, 0], x, S))
    cuts = [0, *(np.flatnonzero(np.diff(above)) + 1).tolist(), len(line)]
    for first, last in pairwise(cuts):
        if not above[first]:
            yield line[first:last]


# Equilibria and orbits: curves of special points ----------------------------------------------------------------------


def _curves(plane: Plane) -> Iterator[Points]:
    """Curves of special points through the pairs of neighbours that differ in stability."""
    found, starts, without = list[Points](), 0, list[str]()
    for pair in _pairs(plane):
        if any(_passes(curve, plane, pair) for curve in found):
            continue
        if starts == MOST_STARTS:
            plane.report(f"the boundary is not sought beyond {MOST_STARTS} pairs of neighbouring cells that differ")
            break
        starts += 1
        try:
            curves = _curves_between(plane, *pair)
        except (ValueError, ArithmeticError) as error:
            names = [plane.map.grid.name(int(plane.cells[place])) for place in pair]
            without.append(f"{' and '.join(names)}: {in_words(error)}")
            continue
        found += curves
    if without:
        words = f"no boundary is followed between {len(without)} pair(s) of cells that differ"
        plane.report(f"{words}, such as {without[0]}")
    yield from found


def _pairs(plane: Plane) -> Iterator[Pair]:
    """Places of computed neighbours of which one is stable and the other is not."""
    states, stable = plane.map.states[plane.cells], plane.map.columns["stable"][plane.cells]
    for axis in (0, 1):
        for line in range(states.shape[1 - axis]):
            at = [(k, line) if axis == 0 else (line, k) for k in range(states.shape[axis])]
            for one, other in pairwise(place for place in at if states[place] != UNKNOWN):
                if states[one] == states[other] == DONE and stable[one] != stable[other]:
                    yield one, other


def _passes(curve: Points, plane: Plane, pair: Pair) -> bool:
    """Whether a curve passes between two neighbours, or very near."""
    ends = np.array([[axis.values[k] for axis, k in zip(plane.axes, place, strict=True)] for place in pair])
    sizes = [abs(axis.values[-1] - axis.values[0]) / max(len(axis.values) - 1, 1) for axis in plane.axes]
    reach = np.maximum(np.abs(ends[1] - ends[0]), sizes)
    dense = np.concatenate([np.linspace(a, b, 17) for a, b in pairwise(curve)] or [curve])
    return bool(np.any(np.all(np.abs(dense - ends.mean(axis=0)) <= reach, axis=1)))


def _curves_between(plane: Plane, one: tuple[int, int], other: tuple[int, int]) -> list[Points]:
    """Curves through the special points between two neighbours.

    Raises ValueError and ArithmeticError where there is none, or none can be followed.
    """
    if one[0] == other[0]:  # along the second range
        return [curve[:, ::-1] for curve in _curves_between(plane.turned, one[::-1], other[::-1])]
    request = plane.bound(plane.map.grid.settings(int(plane.cells[one])))
    of_orbits, name = request.scene.orbit is not None, plane.axes[0].paths[0][-1]
    options: dict[str, Any] = {"stability": True} if of_orbits else {}
    branch = first_solution(request).follow(name, float(plane.axes[0].values[other[0]]), **options)
    points = [point for point in branch.special_points if point.kind in (FOLD, HOPF) or of_orbits]
    if not points:
        raise ArithmeticError(f"no special point on the branch between them, which {branch.reason}")
    return [_curve(point, plane.axes) for point in points]


def _curve(point: SpecialPoint, axes: tuple[Axis, Axis]) -> Points:
    """The curve of a special point to both ends of the second range, in the first range with a margin."""
    first, second = (axis.paths[0][-1] for axis in axes)
    halves, faults = list[Points](), list[str]()
    for to in (float(axes[1].values[0]), float(axes[1].values[-1])):
        try:
            branch = point.curve(second, to, until=_outside(axes[0], first), max_step=LONGEST_CURVE_STEP)
        except (ValueError, ArithmeticError) as error:
            faults.append(str(error))
            continue
        halves.append(np.column_stack([branch[first], branch[second]]))
    if len(halves) < 2 and not (halves and len(halves[0]) > 1):
        raise ArithmeticError(faults[0] if faults else "its curve has one point")
    return np.concatenate([halves[0][::-1], *(half[1:] for half in halves[1:])])
