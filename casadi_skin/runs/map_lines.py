"""First instabilities of families over a parameter: edges of tongues, followed from one of them in the parameter.

Neighbouring families that enter the same tongue share a line. It goes on to the neighbours on both sides, at which
another tongue is the first one, as long as no other line lies below it.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.results.dataset import write_csv
from casadi_skin.runs.binding import Files, bind
from casadi_skin.runs.first_solution import first_solution
from casadi_skin.runs.map_cell import followed
from casadi_skin.runs.map_grid import Axis, Grid, Lines, Plane, Points, Tables, planes, scene_at
from casadi_skin.runs.map_store import DONE, UNKNOWN, Columns
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import Scene
from casadi_skin.zero.kinds import EDGE, FOLD, HOPF

BEYOND_EDGE_FRACTION = 1e-3  # of S: how far beyond an edge the family is followed that it is found on
EDGE_S_RTOL = 1e-6  # of S: within which the edge is the one that the map has
RANGE_MARGIN = 0.05  # of a range, by which a curve leaves it before it ends
Bound = Callable[[Sequence[Any], float], Request]


@dataclass(frozen=True)
class Entry:
    """The first instability of a family: its value of the parameter, S, the tongue, and a cell of it."""

    value: float
    S: float
    tongue: str
    cell: int


def tongue_lines(plane: Plane, columns: Columns, bound: Bound, report: Callable[[str], None]) -> list[Points]:
    """Lines of the boundary, in the order of the plane's axes.

    Arguments:
        bound: the request of a family up to an amplitude, at settings of the scene.
        report: takes the reason why an edge cannot be followed; its line joins the families then.
    """
    entries, lines = _entries(plane, columns), list[Points]()
    values = [entry.value for entry in entries]
    for tongue, group in groupby(range(len(entries)), key=lambda k: entries[k].tongue):
        places = list(group)
        if not tongue:
            continue
        run = [entries[k] for k in places]
        reach = values[max(places[0] - 1, 0)], values[min(places[-1] + 1, len(values) - 1)]
        try:
            lines.append(_followed(plane, run, reach, bound))
        except (ValueError, ArithmeticError) as error:
            words = f"{plane.axes[0].name}, {plane.axes[1].name}: the edge of the tongue {tongue} is not followed"
            report(f"{words}, its line joins families: {' '.join(str(error).split())}")
            lines.append(np.array([(entry.value, entry.S) for entry in run]))
    shown = [part for k, line in enumerate(lines) for part in lowest(line, lines[:k] + lines[k + 1 :])]
    return [line if plane.along[1] == plane.grid.amplitude else line[:, ::-1] for line in shown]


def _entries(plane: Plane, columns: Columns) -> list[Entry]:
    """The families of a plane, in the order of their parameter; of a refined map those that are known."""
    amplitude_first, found = plane.along[0] == plane.grid.amplitude, list[Entry]()
    families = plane.cells.T if amplitude_first else plane.cells
    for value, family in zip(plane.axes[1 if amplitude_first else 0].values, families, strict=True):
        known = family[columns.store.states[family] != UNKNOWN]
        if known.size:
            cell = int(known[0])
            S = float(columns.numbers["first_instability"][cell])
            found.append(Entry(float(value), S, columns.text("first_tongue", cell), cell))
    return found


def _followed(plane: Plane, run: Sequence[Entry], reach: tuple[float, float], bound: Bound) -> Points:
    """The edge that the families of a run have, from one end of a reach of the parameter to the other one.

    Raises ValueError and ArithmeticError where it cannot be followed, or does not pass all of them.
    """
    first = plane.along[0] == plane.grid.amplitude
    S_axis, parameter = plane.axes if first else plane.axes[::-1]
    middle, name = run[len(run) // 2], parameter.paths[0][-1]
    (branch,), fault = followed(bound(plane.grid.settings(middle.cell), middle.S * (1.0 + BEYOND_EDGE_FRACTION)))
    diagram = branch.stability_diagram
    edges = [] if diagram is None else [*diagram.changes, *diagram.further]
    near = [edge for edge in edges if abs(edge.S - middle.S) <= EDGE_S_RTOL * middle.S]
    if not near:
        raise ArithmeticError(fault or "it is not found again")
    orbit, outside = branch.at(S=near[0].S), _outside(S_axis, "S", positive=True)
    point = SpecialPoint(EDGE, "S", {**orbit.parameters, "S": near[0].S}, near[0].error, orbit)
    halves = []
    for to in reach:
        at = [entry.value for entry in run if min(middle.value, to) < entry.value < max(middle.value, to)]
        if to != middle.value:
            order = sorted(at, reverse=to < middle.value)
            halves.append(checked(point.curve(name, to, at=order, until=outside), name, run))
    if not halves:
        return np.array([(middle.value, middle.S)])
    below = halves[0] if len(halves) == 2 else halves[0][:1]
    return np.concatenate([below[::-1], halves[-1][1:]])


def _outside(axis: Axis, name: str, positive: bool = False) -> Callable[[Any], bool]:
    """Whether a solution lies beyond a range of a parameter, with a margin; a positive one stays positive."""
    low, high = sorted((float(axis.values[0]), float(axis.values[-1])))
    margin = RANGE_MARGIN * (high - low)
    least = max(low - margin, 0.5 * low) if positive else low - margin
    return lambda solution: not least <= solution.parameters[name] <= high + margin


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


# The boundary of stability in the plane of a map's two ranges, to the accuracy of a solution and not of a cell --------

OF_BOUNDARY = ("stable", "first_instability", "first_tongue")  # quantities that locate it
BOUNDARY_FILE = "boundary.csv"
LINE_COLUMN = "line"  # the column with the number of a line
MOST_STARTS = 24  # of curves in a plane
LONGEST_CURVE_STEP = 0.05  # longest, of a curve


def check_boundary(scene: Scene, grid: Grid) -> None:
    """Raises SceneError for a map whose boundary of stability cannot be followed."""
    if scene.map is None or not scene.map.boundary:
        return
    found = planes(grid)
    if not found:
        raise SceneError("[map] boundary: given without two ranges; accepted: beside two ranges")
    if scene.family is not None:
        if scene.stability is None or not scene.stability.events or grid.amplitude not in found[0].along:
            words = "accepted: beside [family] a range of S, and [stability] with its events"
            raise SceneError(f"[map] boundary: given without S or [stability]; {words}")
        varied = [path for axis in grid.axes for path in axis.paths]
        if isinstance(scene.family.mode, tuple) and len(scene.family.mode) > 1 and ("family", "mode") not in varied:
            raise SceneError("[map] boundary: given with several families in a cell; accepted: one, or an axis mode")
    elif scene.continuation is not None or (scene.equilibrium is None and scene.orbit is None):
        words = "accepted: with [family], or with [equilibrium] or [orbit] alone"
        raise SceneError(f"[map] boundary: given with a scene of other branches; {words}")
    elif scene.orbit is not None and scene.stability is None:
        raise SceneError("[map] boundary: given without [stability]; accepted: beside [orbit] with a [stability]")


def boundaries(scene: Scene, path: Path, tables: Tables, columns: Columns, report: Callable[[str], None]) -> Lines:
    """Lines of the boundary by the places of the axes that are no ranges; a line of one point is a point.

    `report` takes a line for each edge that cannot be followed, with the reason.
    """
    grid = columns.store.grid
    found, files = dict[tuple[int, ...], tuple[Points, ...]](), dict[Any, Any]()

    def bound(settings: Sequence[Any], S: float) -> Request:
        return bind(scene_at(tables, settings, (S,)), path, files)

    for plane in planes(grid):
        if grid.amplitude in plane.along:
            if "first_tongue" not in columns.texts:
                continue
            found[plane.chosen] = tuple(tongue_lines(plane, columns, bound, report))
        elif "stable" in columns.numbers:
            found[plane.chosen] = tuple(_curves(plane, columns, scene, path, tables, report))
    return found


def write_boundary(lines: Lines, grid: Grid, path: Path) -> None:
    """boundary.csv: points of the lines in their order."""
    others = [axis for axis in grid.axes if not axis.numeric]
    ranges = [axis.name for axis in grid.axes if axis.numeric]
    rows = (
        {**{axis.name: axis.values[k] for axis, k in zip(others, chosen, strict=True)}, LINE_COLUMN: number,
         **dict(zip(ranges, point, strict=True))}
        for chosen, curves in lines.items()
        for number, curve in enumerate(curves, start=1)
        for point in curve.tolist()
    )  # fmt: skip
    write_csv(path, [*(axis.name for axis in others), LINE_COLUMN, *ranges], rows)


def read_boundary(grid: Grid, path: Path) -> Lines:
    """The lines that `write_boundary` wrote; none where there is no file."""
    if not path.is_file():
        return {}
    others = [axis for axis in grid.axes if not axis.numeric]
    places = [{str(value): k for k, value in enumerate(axis.values)} for axis in others]
    found = dict[tuple[int, ...], dict[str, list[list[float]]]]()
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.reader(itertools.islice(file, 1, None)):
            words, line, point = row[: len(others)], row[len(others)], row[len(others) + 1 :]
            chosen = tuple(place[word] for place, word in zip(places, words, strict=True))
            found.setdefault(chosen, {}).setdefault(line, []).append([float(value) for value in point])
    return {chosen: tuple(np.array(curve) for curve in curves.values()) for chosen, curves in found.items()}


# Equilibria and orbits -----------------------------------------------------------------------------------------------


def _curves(
    plane: Plane, columns: Columns, scene: Scene, path: Path, tables: Tables, report: Callable[[str], None]
) -> Iterator[Points]:
    """Curves of special points through the pairs of neighbours that differ in stability."""
    found, files, starts, without = list[Points](), dict[Any, Any](), 0, list[str]()
    for one, other in _pairs(plane, columns):
        if any(_passes(curve, plane, one, other) for curve in found):
            continue
        if starts == MOST_STARTS:
            report(f"the boundary is not sought beyond {MOST_STARTS} pairs of neighbouring cells that differ")
            break
        starts += 1
        try:
            curves = _curves_between(plane, one, other, scene, path, tables, files)
        except (ValueError, ArithmeticError) as error:
            names = [plane.grid.name(int(plane.cells[place])) for place in (one, other)]
            without.append(f"{' and '.join(names)}: {' '.join(str(error).split())}")
            continue
        found += curves
        yield from curves
    if without:
        report(f"no boundary is followed between {len(without)} pair(s) of cells that differ, such as {without[0]}")


def _pairs(plane: Plane, columns: Columns) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Places of computed neighbours of which one is stable and the other is not."""
    cells = plane.cells
    stable, states = columns.numbers["stable"][cells], columns.store.states[cells]
    known = states != UNKNOWN
    for axis in (0, 1):
        for line in range(cells.shape[1 - axis]):
            at = [(k, line) if axis == 0 else (line, k) for k in range(cells.shape[axis])]
            at = [place for place in at if known[place]]
            for one, other in pairwise(at):
                if states[one] == states[other] == DONE and stable[one] != stable[other]:
                    yield one, other


def _passes(curve: Points, plane: Plane, one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether a curve passes between two neighbours, or very near."""
    ends = np.array([[axis.values[k] for axis, k in zip(plane.axes, place, strict=True)] for place in (one, other)])
    extents = np.array([abs(axis.values[-1] - axis.values[0]) for axis in plane.axes])
    sizes = extents / np.array([max(len(axis.values) - 1, 1) for axis in plane.axes])
    reach = np.maximum(np.abs(ends[1] - ends[0]), sizes)
    dense = np.concatenate([np.linspace(a, b, 17) for a, b in pairwise(curve)] or [curve])
    return bool(np.any(np.all(np.abs(dense - ends.mean(axis=0)) <= reach, axis=1)))


def _curves_between(
    plane: Plane, one: tuple[int, int], other: tuple[int, int], scene: Scene, path: Path, tables: Tables, files: Files
) -> list[Points]:
    """Curves through the special points between two neighbours.

    Raises ValueError and ArithmeticError where there is none, or none can be followed.
    """
    first = 0 if one[0] != other[0] else 1
    (followed, second), towards = (plane.axes[first], plane.axes[1 - first]), plane.axes[first].values[other[first]]
    names = followed.paths[0][-1], second.paths[0][-1]
    options: dict[str, Any] = {} if scene.orbit is None else {"stability": True}
    settings = plane.grid.settings(int(plane.cells[one]))
    start = first_solution(bind(scene_at(tables, settings), path, files))
    branch = start.follow(names[0], float(towards), **options)
    points = [point for point in branch.special_points if point.kind in (FOLD, HOPF) or scene.orbit is not None]
    if not points:
        raise ArithmeticError(f"no special point on the branch between them, which {branch.reason}")
    curves = [_curve(point, names, (followed, second)) for point in points]
    return [curve[:, ::-1] if first else curve for curve in curves]


def _curve(point: SpecialPoint, names: Sequence[str], axes: Sequence[Axis]) -> Points:
    """The curve of a special point to both ends of the second range, in the first range with a margin."""
    outside = _outside(axes[0], names[0])
    halves, faults = [], list[str]()
    for to in (float(axes[1].values[0]), float(axes[1].values[-1])):
        try:
            branch = point.curve(names[1], to, until=outside, max_step=LONGEST_CURVE_STEP)
        except (ValueError, ArithmeticError) as error:
            faults.append(str(error))
            continue
        halves.append(np.column_stack([branch[name] for name in names]))
    if len(halves) < 2 and not (halves and len(halves[0]) > 1):
        raise ArithmeticError(faults[0] if faults else "its curve has one point")
    return np.concatenate([halves[0][::-1], *(half[1:] for half in halves[1:])])
