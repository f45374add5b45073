"""The cells of a map: axes with their values, tasks that share a family, and the scene of a cell."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from casadi_skin.runs.axes import AMPLITUDE, TOGETHER_SEPARATOR, Path, paths_of, ranges_of, set_value, values_of
from casadi_skin.runs.reading import scene_of
from casadi_skin.runs.rules import SceneError, toml_repr
from casadi_skin.runs.scene import Scene

Cells = NDArray[np.int64]  # flat numbers of cells in the finest grid
Tables = dict[str, Any]  # a scene as plain values


@dataclass(frozen=True)
class Axis:
    """An axis of a map.

    Attributes:
        name: as [map] calls it.
        paths: where its values go in a scene; several where it moves several parameters.
        values: at its finest; of several parameters in words.
        given: values for the scene, one for each path; empty where these are the values.
        stride: values from one of the coarsest to the next.
        numeric: whether it is a range, along which pictures are drawn.
        log: whether its values have equal ratios.
    """

    name: str
    paths: tuple[Path, ...]
    values: tuple[Any, ...]
    stride: int = 1
    numeric: bool = False
    log: bool = False
    given: tuple[tuple[Any, ...], ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of its parameters."""
        return [name.strip() for name in self.name.split(TOGETHER_SEPARATOR)] if self.given else [self.name]

    @property
    def worded(self) -> bool:
        """Whether some of its values are words."""
        return any(isinstance(value, str) for value in self.values)

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Where its values are drawn: those that are words one after the other."""
        return np.array(range(len(self.values)) if self.worded else self.values, dtype=float)

    def settings(self, place: int) -> list[tuple[Path, Any]]:
        """The path of the value at a place, and the value."""
        return list(zip(self.paths, self.given[place] if self.given else (self.values[place],), strict=True))


class Task(msgspec.Struct, frozen=True):
    """Cells computed together: one, or the orbits of one family at several amplitudes.

    Attributes:
        cells: flat numbers.
        settings: where values go in the scene, and the values.
        amplitudes: of the family's orbits, ascending, one a cell; empty where the map has no axis S.
        start, period: of a neighbour's solution, for a second start; empty for the scene's own.
        neighbour: its cell.
    """

    cells: tuple[int, ...]
    settings: tuple[tuple[tuple[str, ...], Any], ...]
    amplitudes: tuple[float, ...] = ()
    start: tuple[float, ...] = ()
    period: float = 0.0
    neighbour: int = -1


@dataclass(frozen=True)
class Grid:
    """The finest grid of a map, cells in the order of C with the last axis fastest."""

    axes: tuple[Axis, ...]

    @classmethod
    def of(cls, scene: Scene) -> Grid:
        """The grid of a scene's [map]; raises SceneError where the scene refuses the end of an axis."""
        table = scene.map
        if table is None:
            raise SceneError("[map]: missing; accepted: a scene with a [map]")
        axes, ranges = [], ranges_of(table)
        for name, given in table.axes.items():
            paths, together, log = paths_of(scene, name), tuple[tuple[Any, ...], ...](), False
            stride, values = 1, given  # type: int, Any
            if name in ranges:
                values, stride = values_of(ranges[name])
                log = ranges[name].log
            elif len(paths) > 1:
                together, values = values, tuple(f"({', '.join(map(str, value))})" for value in values)
            axes.append(Axis(name, paths, values, stride, name in ranges, log, together))
        grid = cls(tuple(axes))
        grid._check(plain(scene))
        return grid

    def _check(self, tables: Tables) -> None:
        """Raises SceneError for the end of an axis that the scene refuses wherever the other axes end."""
        for axis in self.axes:
            others = [[a.settings(0), a.settings(-1)] for a in self.axes if a is not axis]
            for place in (0, -1) if axis.numeric else range(len(axis.values)):
                mine = axis.settings(place)
                corners = [mine + [pair for rest in corner for pair in rest] for corner in product(*others)]
                faults = [fault for settings in (mine, *corners) if (fault := _fault(tables, settings))]
                if len(faults) > len(corners):
                    words = f"given {toml_repr(axis.values[place])}, which the scene refuses: {faults[0]}"
                    raise SceneError(f"[map] {axis.name}: {words}")

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis at its finest."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def size(self) -> int:
        """Number of cells of the finest grid."""
        return math.prod(self.shape)

    @property
    def refined(self) -> bool:
        """Whether cells are refined where a quantity changes."""
        return any(axis.stride > 1 for axis in self.axes)

    @property
    def coarsest(self) -> Cells:
        """The cells of the coarsest grid."""
        places = [np.arange(0, len(axis.values), axis.stride) for axis in self.axes]
        found: Cells = np.ravel_multi_index(np.meshgrid(*places, indexing="ij"), self.shape).ravel().astype(np.int64)
        return found

    def places(self, cells: Cells) -> NDArray[np.int64]:
        """Places along the axes, shape (cells, axes)."""
        return np.stack(np.unravel_index(cells, self.shape), axis=-1).astype(np.int64)

    def values(self, cell: int) -> tuple[Any, ...]:
        """Values of the axes at a cell."""
        return tuple(axis.values[i] for axis, i in zip(self.axes, np.unravel_index(cell, self.shape), strict=True))

    def name(self, cell: int) -> str:
        """A cell in words."""
        return ", ".join(f"{a.name} = {value}" for a, value in zip(self.axes, self.values(cell), strict=True))

    @cached_property
    def amplitude(self) -> int | None:
        """Which axis is S of a family; None where none is."""
        return next((i for i, axis in enumerate(self.axes) if axis.paths == (AMPLITUDE,)), None)

    def tasks(self, cells: Cells) -> Iterator[Task]:
        """Tasks that compute cells, in their order; those that differ by S alone are one."""
        if self.amplitude is None:
            for cell in cells.tolist():
                yield Task((cell,), self.settings(cell))
            return
        places = self.places(cells)
        places[:, self.amplitude] = 0
        families = np.ravel_multi_index(tuple(places.T), self.shape)
        order = np.argsort(families, kind="stable")
        starts = np.flatnonzero(np.diff(families[order], prepend=-1))
        for group in np.split(cells[order], starts[1:]):
            found = sorted((float(self.values(cell)[self.amplitude]), cell) for cell in group.tolist())
            settings = self.settings(found[0][1])
            yield Task(tuple(cell for _, cell in found), settings, tuple(S for S, _ in found))

    def family(self, cell: int) -> Cells:
        """The cells of the coarsest grid that are one task with a cell of it."""
        if self.amplitude is None:
            return np.array([cell], dtype=np.int64)
        axis, places = self.axes[self.amplitude], self.places(np.array([cell]))
        same = np.repeat(places, len(range(0, len(axis.values), axis.stride)), axis=0)
        same[:, self.amplitude] = range(0, len(axis.values), axis.stride)
        return np.asarray(np.ravel_multi_index(tuple(same.T), self.shape), dtype=np.int64)

    def settings(self, cell: int) -> tuple[tuple[Path, Any], ...]:
        """Where values go in the scene of a cell, and the values, but for S of a family."""
        places = zip(self.axes, np.unravel_index(cell, self.shape), strict=True)
        pairs = [pair for axis, place in places for pair in axis.settings(int(place))]
        return tuple((path, value) for path, value in pairs if path != AMPLITUDE)


# Scenes of cells ------------------------------------------------------------------------------------------------------


def plain(scene: Scene) -> Tables:
    """The tables of a scene as plain values, without [map]."""
    tables = msgspec.to_builtins(msgspec.structs.replace(scene, map=None))
    return {name: _given(value) for name, value in tables.items() if value is not None}


def _given(value: Any) -> Any:
    """A value as TOML has it: without keys that are not given, with lists."""
    if isinstance(value, Mapping):
        return {key: _given(v) for key, v in value.items() if v is not None}
    return [_given(v) for v in value] if isinstance(value, tuple | list) else value


def _fault(tables: Tables, settings: Sequence[tuple[Path, Any]]) -> str:
    """Why the scene refuses values in their places; empty where it does not."""
    try:
        scene_at(tables, settings)
    except SceneError as error:
        return str(error)
    return ""


def scene_at(tables: Tables, settings: Sequence[tuple[Path, Any]], amplitudes: Sequence[float] = ()) -> Scene:
    """The scene with values in their places, and with orbits of its family at amplitudes; raises SceneError."""
    found = dict(tables)
    for path, value in settings:
        if path == AMPLITUDE:
            set_value(found, ("family", "amplitude_max"), value)
            set_value(found, ("family", "at"), [])
        else:
            set_value(found, path, value)
    if amplitudes:
        set_value(found, ("family", "amplitude_max"), amplitudes[-1])
        set_value(found, ("family", "at"), list(amplitudes))
    return scene_of(found)


# Records of tasks, sent and kept: rows of named quantities, results, and entries of the journal -----------------------

Value = float | int | str
FAILED, DIED, LATE, LOST = "failed", "died", "late", "lost"  # kinds of faults; a computation reports the first itself
OUTSIDE_FAULTS = (DIED, LATE, LOST)  # those that another run may not meet


class Row(msgspec.Struct, frozen=True):
    """Quantities of a cell by name, unknown ones left out.

    Attributes:
        values: by name.
        fault: why the cell has no solution; empty where it has one.
        state, period: of a solution at which a second start of a neighbour may begin.
    """

    values: dict[str, Value]
    fault: str = ""
    state: tuple[float, ...] = ()
    period: float = 0.0


class Result(msgspec.Struct, frozen=True):
    """Result of a task: a row for each of its cells, or the reason and kind of its failure."""

    rows: tuple[Row, ...] = ()
    kind: str = ""
    reason: str = ""
    seconds: float = 0.0
    meanings: dict[str, str] = {}


class TaskRecord(msgspec.Struct, frozen=True, tag="task"):
    """A finished task in the journal, with the number of the attempt, and the cell whose solution it started from."""

    cells: tuple[int, ...]
    attempt: int
    seconds: float
    rows: tuple[Row, ...] = ()
    kind: str = ""
    reason: str = ""
    neighbour: int = -1


class MapHead(msgspec.Struct, frozen=True, tag="map"):
    """The first record of a journal: a digest of the scene whose map it is of."""

    digest: bytes


class MeaningsRecord(msgspec.Struct, frozen=True, tag="meanings"):
    """Meanings of quantities by name, in the order in which they came."""

    meanings: dict[str, str]


MapRecord = TaskRecord | MeaningsRecord | MapHead


# Labels of cells in a map that is refined: cells of one label show the same behaviour ---------------------------------

UNKNOWN_LABEL = -1  # of the label of a cell that is not computed
Labels = NDArray[np.int32]  # shape of the finest grid, equal where the watched quantities are equal
Places = NDArray[np.int64]  # shape (boxes, axes)


def needed(grid: Grid, labels: Labels) -> Cells:
    """Cells to compute next, ascending; none where the map is as fine as it is to be."""
    coarse = grid.coarsest
    missing = coarse[labels.ravel()[coarse] == UNKNOWN_LABEL]
    if missing.size or not grid.refined:
        return np.asarray(missing)
    wanted, along = np.zeros(grid.shape, dtype=bool), [axis.stride > 1 for axis in grid.axes]
    sides = [axis.stride for axis in grid.axes]
    corners = [np.arange(0, n - 1, s) if s > 1 else np.arange(n) for n, s in zip(grid.shape, sides, strict=True)]
    boxes = np.stack(np.meshgrid(*corners, indexing="ij"), -1).reshape(-1, len(sides))
    while boxes.size and max(sides) > 1:
        inside = [range(s + 1) if a else (0,) for s, a in zip(sides, along, strict=True)]
        boxes = boxes[_mixed(labels, boxes, inside)]
        finer = [tuple(range(0, s + 1, max(s // 2, 1))) if a else (0,) for s, a in zip(sides, along, strict=True)]
        for offset in itertools.product(*finer):
            wanted[_at(boxes, offset)] = True
        lower = [(0, s // 2) if s > 1 else (0,) for s in sides]
        sides = [max(s // 2, 1) for s in sides]
        boxes = np.concatenate([boxes + np.array(offset) for offset in itertools.product(*lower)])
        ends = [(0, s) if a else (0,) for s, a in zip(sides, along, strict=True)]
        known = [labels[_at(boxes, offset)] != UNKNOWN_LABEL for offset in itertools.product(*ends)]
        boxes = boxes[np.all(known, axis=0)]
    return np.flatnonzero(wanted & (labels == UNKNOWN_LABEL)).astype(np.int64)


def _mixed(labels: Labels, boxes: Places, inside: Iterable[Iterable[int]]) -> NDArray[np.bool_]:
    """Whether the known labels of each box, its sides among it, are not all the same."""
    mixed, first = np.zeros(len(boxes), dtype=bool), labels[tuple(boxes.T)]
    for offset in itertools.product(*inside):
        here = labels[_at(boxes, offset)]
        mixed |= (here != first) & (here != UNKNOWN_LABEL)
    return mixed


def _at(boxes: Places, offset: tuple[int, ...]) -> tuple[NDArray[np.int64], ...]:
    return tuple((boxes + np.array(offset)).T)


DEFAULT_QUANTITIES = ("stable", "end")
Watched = Sequence[str] | Mapping[str, Sequence[float]] | None


class Watch:
    """Labels of cells, shape of the finest grid; none are kept of a map that is not refined."""

    def __init__(self, grid: Grid, watched: Watched = None) -> None:
        names = DEFAULT_QUANTITIES if watched is None else watched
        self._levels: Mapping[str, Sequence[float]] = names if isinstance(names, Mapping) else dict.fromkeys(names, ())
        self._codes: dict[tuple[object, ...], int] = {}
        self.labels = (
            np.full(grid.shape, UNKNOWN_LABEL, dtype=np.int32) if grid.refined else np.zeros(0, dtype=np.int32)
        )

    def see(self, record: TaskRecord) -> None:
        """Label the cells of a record."""
        if self.labels.size:
            rows: Sequence[Row | None] = record.rows or (None,) * len(record.cells)
            for cell, row in zip(record.cells, rows, strict=True):
                self.labels.flat[cell] = self._codes.setdefault(self._label(row), len(self._codes))

    def forget(self, cells: Cells) -> None:
        """Take labels back."""
        if self.labels.size:
            self.labels.flat[cells] = UNKNOWN_LABEL

    def _label(self, row: Row | None) -> tuple[object, ...]:
        if row is None:
            return ()
        return (bool(row.fault), *(self._of(row.values.get(name), at) for name, at in self._levels.items()))

    def _of(self, value: object, levels: Sequence[float]) -> object:
        """A word or a whole number itself, a number by the levels that it is above; whether it is there."""
        if isinstance(value, float):
            return -1 if math.isnan(value) else sum(value > level for level in levels)
        return sum(value > level for level in levels) if levels and isinstance(value, int) else value


# Planes of a map's two ranges, one for each combination of values of its other axes -----------------------------------

Points = NDArray[np.float64]  # shape (points, 2)
Lines = Mapping[tuple[int, ...], tuple[Points, ...]]  # of a boundary, by the places of the axes that are no ranges


@dataclass(frozen=True)
class Plane:
    """The two ranges of a map, their cells, shape of the two, and the places of the other axes, where these lie."""

    grid: Grid
    along: tuple[int, int]
    chosen: tuple[int, ...]
    cells: Cells

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """The two ranges."""
        return self.grid.axes[self.along[0]], self.grid.axes[self.along[1]]


def planes(grid: Grid) -> list[Plane]:
    """A plane for each combination of values of the axes that are no ranges; none where there are not two ranges."""
    ranges = [i for i, axis in enumerate(grid.axes) if axis.numeric]
    if len(ranges) != 2:
        return []
    cells = np.moveaxis(np.arange(grid.size).reshape(grid.shape), ranges, (-2, -1))
    along = ranges[0], ranges[1]
    return [Plane(grid, along, chosen, cells[chosen]) for chosen in np.ndindex(cells.shape[:-2])]
