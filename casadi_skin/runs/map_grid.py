"""The cells of a map: its axes with their values, tasks that share a family, scenes of cells, and which are next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import cut, did_you_mean, nearest
from casadi_skin.runs.reading import scene_of
from casadi_skin.runs.rules import SceneError, refusal, toml_repr
from casadi_skin.runs.scene import OPTIONS, ChainTable, RangeTable, Scene

AMPLITUDE = ("family", "S")  # the orbit at an amplitude: cells that differ by it alone are orbits of one family
TOGETHER_SEPARATOR = ","  # between the names of parameters that one axis moves
MOST_TRIED = 1000  # values of a list that a scene is tried with at once; the cells of others name their faults
MOST_CELLS = 10_000_000  # of a map at its finest: an index of them is kept in memory
Path = tuple[str, ...]


# Axes with their values -----------------------------------------------------------------------------------------------


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

    def settings(self, place: int) -> list[tuple[Path, Any]]:
        """The path of the value at a place, and the value."""
        return list(zip(self.paths, self.given[place] if self.given else (self.values[place],), strict=True))


def axes_of(scene: Scene) -> tuple[Axis, ...]:
    """The axes of a scene with a [map]; raises SceneError for those that cannot be meant."""
    given: Mapping[str, Any] = {} if scene.map is None else scene.map.axes
    ranges: dict[str, RangeTable] = {name: axis for name, axis in given.items() if not isinstance(axis, tuple)}
    if len(ranges) > 2:
        raise refusal(f"[map] {list(ranges)[2]}", "a third range", "one or two ranges, and lists beside them")
    seen, size, resolved = dict[Path, str](), 1, any(axis.resolution for axis in ranges.values())
    for name, axis in sorted(given.items(), key=lambda item: item[0] not in ranges):
        if name in ranges:
            _check_range(name, axis)
        else:
            _check_list(name, axis)
        size *= (axis.points - 1) * _stride(axis) + 1 if name in ranges else len(axis)
    for name in given:
        for path in paths_of(scene, name):
            if path in seen:
                raise refusal(f"[map] {cut(name)}", f"the same parameter as {cut(seen[path])}", "each parameter once")
            seen[path] = name
    if size > MOST_CELLS:
        finest = " at its finest" if resolved else ""
        raise refusal("[map]", f"more than {MOST_CELLS} cells{finest}", f"at most {MOST_CELLS}")
    return tuple(_axis(name, paths_of(scene, name), axis, name in ranges) for name, axis in given.items())


def _axis(name: str, paths: tuple[Path, ...], axis: Any, is_range: bool) -> Axis:
    if is_range:
        return Axis(name, paths, _values(axis), _stride(axis), True, axis.log)
    words = tuple(f"({', '.join(map(str, value))})" for value in axis) if len(paths) > 1 else ()
    return Axis(name, paths, words or axis, given=axis if words else ())


def _check_range(name: str, axis: RangeTable) -> None:
    place = f"[map] {cut(name)}"
    if TOGETHER_SEPARATOR in name:
        raise refusal(place, "a range for several parameters", "a list of lists")
    if axis.start == axis.to:
        raise refusal(f"{place}, to", f"{axis.to!r}, where it starts", "another number")
    if not math.isfinite(float(axis.to) - axis.start):  # of integers the difference may be no float at all
        raise refusal(f"{place}, to", f"{axis.to!r}, farther from {axis.start!r} than numbers reach", "a nearer one")
    if axis.log and not (axis.start > 0 and axis.to > 0):
        raise refusal(f"{place}, log", f"true from {axis.start!r} to {axis.to!r}", "with numbers > 0")
    if axis.resolution is not None and axis.log and axis.resolution <= 1:
        raise refusal(f"{place}, resolution", repr(axis.resolution), "with log = true a ratio > 1")


def _check_list(name: str, axis: tuple[object, ...]) -> None:
    place, count, seen = f"[map] {cut(name)}", len(name.split(TOGETHER_SEPARATOR)), set[object]()
    for i, value in enumerate(axis):
        if (len(value) if isinstance(value, tuple) else 1) != count:
            accepted = f"a list of {count} values in each" if count > 1 else "numbers or names"
            plain = list(value) if isinstance(value, tuple) else value
            raise refusal(place, f"{toml_repr(plain)} as item {i + 1}", accepted)
        if value in seen:
            raise refusal(place, f"{toml_repr(value)} as item {i + 1} again", "each value once")
        seen.add(value)


def _values(axis: RangeTable) -> tuple[Any, ...]:
    """All values of a range at its finest."""
    count, difference = (axis.points - 1) * _stride(axis), axis.to - axis.start
    whole = isinstance(axis.start, int) and isinstance(axis.to, int) and not axis.log
    if whole and difference % count == 0:
        return (*range(int(axis.start), int(axis.to), int(difference) // count), axis.to)
    parts, ratio = [k / count for k in range(1, count)], axis.to / axis.start if axis.log else 1.0
    between = [axis.start * ratio**part if axis.log else axis.start + difference * part for part in parts]
    return (float(axis.start), *map(float, between), float(axis.to))


def _stride(axis: RangeTable) -> int:
    """Values of a range at its finest from one of its coarsest to the next; no more than those of too many cells."""
    stride = 1
    if axis.resolution is not None:
        length = abs(math.log(axis.to / axis.start)) if axis.log else abs(axis.to - axis.start)
        finest = math.log(axis.resolution) if axis.log else axis.resolution
        while length / ((axis.points - 1) * stride) > finest * (1 + 1e-12) and stride <= MOST_CELLS:
            stride *= 2
    return stride


# Where values go in a scene -------------------------------------------------------------------------------------------


def paths_of(scene: Scene, name: str) -> tuple[Path, ...]:
    """Targets of the values of an axis: one place, or one for each of the parameters that a name holds."""
    found = tuple(path_of(scene, part.strip()) for part in name.split(TOGETHER_SEPARATOR))
    if len(found) > 1 and AMPLITUDE in found:
        raise refusal(f"[map] {cut(name)}", "S among several", "S alone, or amplitude_max")
    return found


def path_of(scene: Scene, name: str) -> Path:
    """Keys, from the table on, of the parameter of a scene that an axis names; raises SceneError for an unknown one.

    A name is that of a parameter of the model, of `mode`, `S` or `seed`, or TABLE.KEY, such as "continuation.to".
    """
    parts = tuple(name.split("."))
    if len(parts) > 1:
        if not all(parts) or parts[0] == "map" or parts[0] not in Scene.__struct_encode_fields__:
            raise refusal(f"[map] {cut(name)}", "no key of the scene", "TABLE.KEY")
        return parts
    known = _named_paths(scene)
    if name in known:
        return known[name]
    if scene.model is not None:  # which names it has shows with the model alone
        return "model", "parameters", name
    near = nearest(name, (*known, *OPTIONS))
    words = f"{', '.join(known)}, or TABLE.KEY; options: {', '.join(OPTIONS)}"
    raise SceneError(f"[map] {cut(name)}: neither a parameter of the scene nor an option; {did_you_mean(near, words)}")


def _named_paths(scene: Scene) -> dict[str, Path]:
    found: dict[str, Path] = {}
    if scene.chain is not None:
        found = {key: ("chain", key) for key in ChainTable.__struct_encode_fields__}
        found["N"] = ("chain", "sites")
    if scene.lattice is not None:
        found |= {key: ("lattice", "parameters", key) for key in scene.lattice.parameters}
        found.setdefault("cells", ("lattice", "cells"))
    if scene.family is not None:
        found |= {"mode": ("family", "mode"), "S": AMPLITUDE, "amplitude_max": ("family", "amplitude_max")}
    if scene.design is not None:
        found |= {"mode": ("design", "mode"), "S": ("design", "S")}
    drawn = {} if scene.lattice is None else scene.lattice.parameters
    seeds: list[Path] = [("lattice", "parameters", name, "seed") for name, v in drawn.items() if hasattr(v, "seed")]
    seeded = [name for name in ("design", "dynamics") if getattr(getattr(scene, name), "seed", None) is not None]
    seeds += [(name, "seed") for name in seeded]
    if len(seeds) == 1:
        found.setdefault("seed", seeds[0])
    return found


def set_value(raw: dict[str, Any], path: Path, value: object) -> None:
    """Put a value into the tables of a scene, which are changed; tables on the way are made."""
    *tables, key = path
    for name in tables:
        inner = raw.get(name)
        raw[name] = dict(inner) if isinstance(inner, Mapping) else {}
        raw = raw[name]
    raw[key] = value


# The grid -----------------------------------------------------------------------------------------------------------

Cells = NDArray[np.int64]  # flat numbers of cells in the finest grid
Tables = dict[str, Any]  # a scene as plain values
Settings = Sequence[tuple[Path, Any]]  # where values go in a scene, and the values
SERVED_CELLS = 16  # of a row at most, which one branch serves: others go to other workers


class Task(msgspec.Struct, frozen=True):
    """Cells computed together: one, or the orbits of one family at several amplitudes.

    Attributes:
        cells: flat numbers.
        settings: where values go in the scene, and the values.
        amplitudes: of the family's orbits, ascending, one a cell; empty where the map has no axis S.
        along, values: parameter of the branch that serves the cells, and its values, one a cell; empty where each cell
            starts anew.
        checked: whether it serves cells alone between two whose own starts lead to it.
        start, period: of a neighbour's solution, for a second start; empty for the scene's own.
        neighbour: its cell.
    """

    cells: tuple[int, ...]
    settings: tuple[tuple[tuple[str, ...], Any], ...]
    amplitudes: tuple[float, ...] = ()
    along: str = ""
    values: tuple[float, ...] = ()
    checked: bool = False
    start: tuple[float, ...] = ()
    period: float = 0.0
    neighbour: int = -1


@dataclass(frozen=True)
class Grid:
    """The finest grid of a map, cells in the order of C with the last axis fastest.

    One branch serves cells that differ along the axis named `along`, if any; `checked` those alone between two whose
    own starts lead to it.
    """

    axes: tuple[Axis, ...]
    along: str | None = None
    checked: bool = False

    @classmethod
    def of(cls, scene: Scene) -> Grid:
        """The grid of a scene's [map]; raises SceneError where the scene refuses the end of an axis."""
        if scene.map is None:
            raise SceneError("[map]: missing; accepted: a scene with a [map]")
        grid = cls(axes_of(scene), scene.map.along)
        alone = (scene.equilibrium is not None or scene.orbit is not None) and scene.continuation is None
        of_model = [axis for axis in grid.axes if axis.numeric and axis.paths[0][:2] == ("model", "parameters")]
        ranges = {axis.name: axis for axis in of_model}
        if grid.along is not None and not (alone and grid.along in ranges):
            known = f"a range of a parameter ({', '.join(ranges) or 'none here'})"
            raise refusal("[map] along", toml_repr(grid.along), f"{known}, beside [equilibrium] or [orbit] alone")
        if grid.along is None and alone and scene.orbit is not None and ranges:  # the longest, of these the last
            longest = max(reversed(ranges), key=lambda name: len(ranges[name].values))
            grid = replace(grid, along=longest, checked=True)
        grid._check(plain(scene))
        return grid

    def _check(self, tables: Tables) -> None:
        """Raises SceneError for the end of an axis that the scene refuses wherever the other axes end."""
        for axis in self.axes:
            others = [[a.settings(0), a.settings(-1)] for a in self.axes if a is not axis]
            every = range(0, len(axis.values), -(-len(axis.values) // MOST_TRIED))
            for place in (0, -1) if axis.numeric else every:
                mine = axis.settings(place)
                corners = ([*mine, *(pair for rest in corner for pair in rest)] for corner in product(*others))
                fault = _fault(tables, mine)
                if fault and all(_fault(tables, settings) for settings in corners):
                    words = f"given {toml_repr(axis.values[place])}, which the scene refuses: {fault}"
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
        cells = np.arange(self.size).reshape(self.shape)
        return cells[tuple(slice(None, None, axis.stride) for axis in self.axes)].ravel()

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

    @cached_property
    def together(self) -> int | None:
        """Which axis has cells that are one task: S of a family, or that along which one branch serves them."""
        return next((i for i, axis in enumerate(self.axes) if axis.name == self.along), self.amplitude)

    def families(self, cells: Cells) -> Cells:
        """The first cell of the task of each cell, whose cells differ along one axis alone."""
        if self.together is None:
            return cells
        places = self.places(cells)
        places[:, self.together] = 0
        return np.asarray(np.ravel_multi_index(tuple(places.T), self.shape))

    def tasks(self, cells: Cells, apart: bool = False) -> Iterator[Task]:
        """Tasks that compute cells, in their order; `apart` those that one branch may serve."""
        along = self.together
        if along is None or (apart and self.along is not None):
            for cell in cells.tolist():
                yield Task((cell,), self.settings(cell))
            return
        families = self.families(cells)
        order = np.argsort(families, kind="stable")
        starts = np.flatnonzero(np.diff(families[order], prepend=-1))
        for group in np.split(cells[order], starts[1:]):
            if self.along is not None:
                size = SERVED_CELLS if self.checked else len(group)
                for part in (group[k : k + size].tolist() for k in range(0, len(group), size)):
                    values, settings = tuple(float(self.values(cell)[along]) for cell in part), self.settings(part[0])
                    yield Task(tuple(part), settings, along=self.along, values=values, checked=self.checked)
                continue
            found = sorted((float(self.values(cell)[along]), cell) for cell in group.tolist())
            yield Task(tuple(c for _, c in found), self.settings(found[0][1]), tuple(S for S, _ in found))

    def settings(self, cell: int) -> tuple[tuple[Path, Any], ...]:
        """Where values go in the scene of a cell, and the values, but for S of a family."""
        places = zip(self.axes, np.unravel_index(cell, self.shape), strict=True)
        pairs = [pair for axis, place in places for pair in axis.settings(int(place))]
        return tuple((path, value) for path, value in pairs if path != AMPLITUDE)


# Scenes of cells ------------------------------------------------------------------------------------------------------


def plain(scene: Scene) -> Tables:
    """The tables of a scene as plain values, without [map]."""
    return _given(msgspec.to_builtins(msgspec.structs.replace(scene, map=None)))  # type: ignore[no-any-return]


def _given(value: Any) -> Any:
    """A value as TOML has it: without keys that are not given, with lists."""
    if isinstance(value, Mapping):
        return {key: _given(v) for key, v in value.items() if v is not None}
    return [_given(v) for v in value] if isinstance(value, tuple | list) else value


def _fault(tables: Tables, settings: Settings) -> str:
    """Why the scene refuses values in their places; empty where it does not."""
    try:
        scene_at(tables, settings)
    except SceneError as error:
        return str(error)
    return ""


def scene_at(tables: Tables, settings: Settings, amplitudes: Sequence[float] = ()) -> Scene:
    """The scene with values in their places, and with orbits of its family at amplitudes; raises SceneError."""
    found = dict(tables)
    pairs = [(("family", "amplitude_max") if path == AMPLITUDE else path, value) for path, value in settings]
    if any(path == AMPLITUDE for path, _ in settings):
        pairs.append((("family", "at"), []))
    if amplitudes:
        pairs += [(("family", "amplitude_max"), amplitudes[-1]), (("family", "at"), list(amplitudes))]
    for path, value in pairs:
        set_value(found, path, value)
    return scene_of(found)


# Refinement: cells of one label show the same behaviour ---------------------------------------------------------------

UNKNOWN_LABEL = -1  # of the label of a cell that is not computed
Labels = NDArray[np.int32]  # shape of the finest grid, equal where the watched quantities are equal


def needed(grid: Grid, labels: Labels) -> Cells:
    """Cells to compute next, ascending; none where the map is as fine as it is to be.

    Boxes between neighbouring cells, of the strides of the coarsest grid and then of half of it and so on, are halved
    where all their corners are known and the known labels in them, their sides among it, are not all the same.
    """
    coarse = grid.coarsest
    missing = coarse[labels.ravel()[coarse] == UNKNOWN_LABEL]
    strides = [axis.stride for axis in grid.axes]
    if missing.size or max(strides) == 1:
        return np.asarray(missing)
    wanted = np.zeros(grid.shape, dtype=bool)
    while max(strides) > 1:
        first = labels[_boxes(grid, strides, [0] * len(strides))]
        mixed, known = np.zeros(first.shape, dtype=bool), np.ones(first.shape, dtype=bool)
        for offset in _offsets(grid, strides, strides):
            here = labels[_boxes(grid, strides, offset)]
            mixed |= (here != first) & (here != UNKNOWN_LABEL)
        for offset in _offsets(grid, strides, [1] * len(strides)):
            known &= labels[_boxes(grid, strides, offset)] != UNKNOWN_LABEL
        for offset in _offsets(grid, strides, [2] * len(strides)):
            wanted[_boxes(grid, strides, offset)] |= mixed & known
        strides = [max(s // 2, 1) for s in strides]
    return np.flatnonzero(wanted & (labels == UNKNOWN_LABEL)).astype(np.int64)


def _offsets(grid: Grid, strides: Sequence[int], parts: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Places in a box, its sides among it, that divide it into parts along each axis that is refined."""
    sides = zip(grid.axes, strides, parts, strict=True)
    return product(*(range(0, s + 1, max(s // k, 1)) if axis.stride > 1 else (0,) for axis, s, k in sides))


def _boxes(grid: Grid, strides: Sequence[int], offset: Sequence[int]) -> tuple[slice, ...]:
    """The cells at a place in every box; along an axis that is not refined all."""
    sides = zip(grid.axes, grid.shape, strides, offset, strict=True)
    return tuple(slice(o, n - s + o, s) if axis.stride > 1 else slice(None) for axis, n, s, o in sides)
