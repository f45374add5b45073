"""The boundary of stability in the plane of a map's two ranges, to the accuracy of a solution and not of a cell.

Where equilibria or orbits of neighbouring cells differ in stability, the branch from the one towards the other passes a
special point, and its curve in both parameters is the boundary. In the plane of S and a parameter of a family the
boundary is where each family first becomes unstable, as its stability diagram has located it; neighbours at which the
same tongue opens are joined.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.maps.columns import Columns
from casadi_skin.maps.grid import Axis, Grid, Tables, scene_at
from casadi_skin.maps.store import DONE, UNKNOWN
from casadi_skin.orbits.special_points import FOLD, HOPF, SpecialPoint
from casadi_skin.results.dataset import write_csv
from casadi_skin.runs.binding import Files, bind
from casadi_skin.runs.first_solution import first_solution
from casadi_skin.scene import Scene, SceneError

Points = NDArray[np.float64]  # shape (points, 2)
Lines = Mapping[tuple[int, ...], tuple[Points, ...]]
OF_BOUNDARY = ("stable", "first_instability", "first_tongue")  # quantities that tell where it is
BOUNDARY = "boundary.csv"
LINE = "line"  # the column with the number of a line
MOST_STARTS = 24  # of curves in a plane
MARGIN = 0.05  # of the plane's extent, by which curves leave it before they end
STEP = 0.05  # longest, of a curve


@dataclass(frozen=True)
class Plane:
    """The two ranges of a map, and which cells lie on them where the other axes have certain places."""

    grid: Grid
    along: tuple[int, int]
    chosen: tuple[int, ...]

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """The two ranges."""
        return self.grid.axes[self.along[0]], self.grid.axes[self.along[1]]

    def cell(self, i: int, j: int) -> int:
        """The cell at places along the two ranges."""
        others = iter(self.chosen)
        place = [
            i if k == self.along[0] else j if k == self.along[1] else next(others) for k in range(len(self.grid.axes))
        ]
        return int(np.ravel_multi_index(place, self.grid.shape))

    @property
    def cells(self) -> NDArray[np.int64]:
        """All cells, shape of the two ranges."""
        n, m = (len(axis.values) for axis in self.axes)
        return np.array([[self.cell(i, j) for j in range(m)] for i in range(n)])


def planes(grid: Grid) -> list[Plane]:
    """A plane for each combination of values of the axes that are no ranges; none where there are not two ranges."""
    ranges = [i for i, axis in enumerate(grid.axes) if axis.numeric]
    if len(ranges) != 2:
        return []
    others = [range(len(axis.values)) for axis in grid.axes if not axis.numeric]
    return [Plane(grid, (ranges[0], ranges[1]), chosen) for chosen in product(*others)]


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
    elif scene.continuation is not None or (scene.equilibrium is None and scene.orbit is None):
        words = "accepted: with [family], or with [equilibrium] or [orbit] alone"
        raise SceneError(f"[map] boundary: given with a scene of other branches; {words}")
    elif scene.orbit is not None and scene.stability is None:
        raise SceneError("[map] boundary: given without [stability]; accepted: beside [orbit] with a [stability]")


def boundaries(scene: Scene, path: Path, tables: Tables, columns: Columns) -> Lines:
    """Lines of the boundary by the places of the axes that are no ranges; a line of one point is a point."""
    grid = columns.store.grid
    found = dict[tuple[int, ...], tuple[Points, ...]]()
    for plane in planes(grid):
        if grid.amplitude in plane.along:
            if "first_tongue" not in columns.texts:
                continue
            found[plane.chosen] = tuple(_first_instabilities(plane, columns))
        elif "stable" in columns.numbers:
            found[plane.chosen] = tuple(_curves(plane, columns, scene, path, tables))
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


# Families ------------------------------------------------------------------------------------------------------------


def _first_instabilities(plane: Plane, columns: Columns) -> Iterator[Points]:
    """Where families first become unstable: neighbours in the same tongue are joined, others are points."""
    amplitude_first = plane.along[0] == plane.grid.amplitude
    cells = plane.cells if not amplitude_first else plane.cells.T
    axis = plane.axes[1 if amplitude_first else 0]
    line, before = list[tuple[float, float]](), ""
    for value, family in zip(axis.values, cells, strict=True):
        known = family[columns.store.states[family] != UNKNOWN]
        if known.size == 0:  # of a refined map, between two families that are known
            continue
        S, tongue = float(columns.numbers["first_instability"][known[0]]), columns.text("first_tongue", int(known[0]))
        if line and tongue != before:
            yield np.array(line)
            line = []
        if tongue:
            line.append((S, float(value)) if amplitude_first else (float(value), S))
        before = tongue
    if line:
        yield np.array(line)


# Equilibria and orbits -----------------------------------------------------------------------------------------------


def _curves(plane: Plane, columns: Columns, scene: Scene, path: Path, tables: Tables) -> Iterator[Points]:
    """Curves of special points through the pairs of neighbours that differ in stability."""
    found, files, starts = list[Points](), dict[Any, Any](), 0
    for one, other in _pairs(plane, columns):
        if starts == MOST_STARTS:
            return
        if any(_passes(curve, plane, one, other) for curve in found):
            continue
        starts += 1
        for curve in _curves_between(plane, one, other, scene, path, tables, files):
            found.append(curve)
            yield curve


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
    """Curves through the special points between two neighbours; none where the branch between them has none."""
    first = 0 if one[0] != other[0] else 1
    (followed, second), towards = (plane.axes[first], plane.axes[1 - first]), plane.axes[first].values[other[first]]
    names = followed.paths[0][-1], second.paths[0][-1]
    options: dict[str, Any] = {} if scene.orbit is None else {"stability": True}
    try:
        settings = plane.grid.settings(plane.cell(*one))
        start = first_solution(bind(scene_at(tables, settings), path, files))
        branch = start.follow(names[0], float(towards), **options)
        points = [point for point in branch.special_points if point.kind in (FOLD, HOPF) or scene.orbit is not None]
    except (ValueError, ArithmeticError):
        return []
    curves = [_curve(point, names, (followed, second)) for point in points]
    return [curve[:, ::-1] if first else curve for curve in curves if len(curve) > 1]


def _curve(point: SpecialPoint, names: Sequence[str], axes: Sequence[Axis]) -> Points:
    """The curve of a special point to both ends of the second range, in the first range with a margin."""
    low, high = sorted((float(axes[0].values[0]), float(axes[0].values[-1])))
    margin = MARGIN * (high - low)

    def outside(solution: Any) -> bool:
        return not low - margin <= solution.parameters[names[0]] <= high + margin

    halves = []
    for to in (float(axes[1].values[0]), float(axes[1].values[-1])):
        try:
            branch = point.curve(names[1], to, until=outside, max_step=STEP)
        except (ValueError, ArithmeticError):
            continue
        halves.append(np.column_stack([branch[name] for name in names]))
    if not halves:
        return np.zeros((0, 2))
    return np.concatenate([halves[0][::-1], *(half[1:] for half in halves[1:])])
