"""The boundary of stability in the plane of a map's two ranges, to the accuracy of a solution and not of a cell.

Where equilibria or orbits of neighbouring cells differ in stability, the branch from the one towards the other passes a
special point, and its curve in both parameters is the boundary. In the plane of S and a parameter of a family the
boundary is where each family first becomes unstable: the edge of a tongue, followed in the parameter (`tongue_lines`).
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from casadi_skin.follow.special_points import FOLD, HOPF, SpecialPoint
from casadi_skin.results.dataset import write_csv
from casadi_skin.runs.binding import Files, bind
from casadi_skin.runs.faults import SceneError
from casadi_skin.runs.first_solution import first_solution
from casadi_skin.runs.map_columns import Columns
from casadi_skin.runs.map_grid import Axis, Grid, Tables, scene_at
from casadi_skin.runs.map_planes import Plane, Points, planes
from casadi_skin.runs.map_store import DONE, UNKNOWN
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import Scene
from casadi_skin.runs.tongue_lines import tongue_lines

Lines = Mapping[tuple[int, ...], tuple[Points, ...]]
OF_BOUNDARY = ("stable", "first_instability", "first_tongue")  # quantities that locate it
BOUNDARY = "boundary.csv"
LINE = "line"  # the column with the number of a line
MOST_STARTS = 24  # of curves in a plane
MARGIN = 0.05  # of the plane's extent, by which curves leave it before they end
STEP = 0.05  # longest, of a curve


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
        {**{axis.name: axis.values[k] for axis, k in zip(others, chosen, strict=True)}, LINE: number,
         **dict(zip(ranges, point, strict=True))}
        for chosen, curves in lines.items()
        for number, curve in enumerate(curves, start=1)
        for point in curve.tolist()
    )  # fmt: skip
    write_csv(path, [*(axis.name for axis in others), LINE, *ranges], rows)


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
            names = [plane.grid.name(plane.cell(*place)) for place in (one, other)]
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
    settings = plane.grid.settings(plane.cell(*one))
    start = first_solution(bind(scene_at(tables, settings), path, files))
    branch = start.follow(names[0], float(towards), **options)
    points = [point for point in branch.special_points if point.kind in (FOLD, HOPF) or scene.orbit is not None]
    if not points:
        raise ArithmeticError(f"no special point on the branch between them, which {branch.reason}")
    curves = [_curve(point, names, (followed, second)) for point in points]
    return [curve[:, ::-1] if first else curve for curve in curves]


def _curve(point: SpecialPoint, names: Sequence[str], axes: Sequence[Axis]) -> Points:
    """The curve of a special point to both ends of the second range, in the first range with a margin."""
    low, high = sorted((float(axes[0].values[0]), float(axes[0].values[-1])))
    margin = MARGIN * (high - low)

    def outside(solution: Any) -> bool:
        return not low - margin <= solution.parameters[names[0]] <= high + margin

    halves, faults = [], list[str]()
    for to in (float(axes[1].values[0]), float(axes[1].values[-1])):
        try:
            branch = point.curve(names[1], to, until=outside, max_step=STEP)
        except (ValueError, ArithmeticError) as error:
            faults.append(str(error))
            continue
        halves.append(np.column_stack([branch[name] for name in names]))
    if len(halves) < 2 and not (halves and len(halves[0]) > 1):
        raise ArithmeticError(faults[0] if faults else "its curve has one point")
    return np.concatenate([halves[0][::-1], *(half[1:] for half in halves[1:])])
