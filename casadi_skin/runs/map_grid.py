"""The cells of a map: axes with their values, tasks that share a family, scenes of cells, and which cells are next."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from casadi_skin.runs.axes import AMPLITUDE, Axis, Path, axes_of, set_value
from casadi_skin.runs.reading import scene_of
from casadi_skin.runs.rules import SceneError, toml_repr
from casadi_skin.runs.scene import Scene

Cells = NDArray[np.int64]  # flat numbers of cells in the finest grid
Tables = dict[str, Any]  # a scene as plain values
Settings = Sequence[tuple[Path, Any]]  # where values go in a scene, and the values


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
        if scene.map is None:
            raise SceneError("[map]: missing; accepted: a scene with a [map]")
        grid = cls(axes_of(scene))
        grid._check(plain(scene))
        return grid

    def _check(self, tables: Tables) -> None:
        """Raises SceneError for the end of an axis that the scene refuses wherever the other axes end."""
        for axis in self.axes:
            others = [[a.settings(0), a.settings(-1)] for a in self.axes if a is not axis]
            for place in (0, -1) if axis.numeric else range(len(axis.values)):
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

    def families(self, cells: Cells) -> Cells:
        """The first cell of the family of each cell: cells that differ by S alone are one task."""
        if self.amplitude is None:
            return cells
        places = self.places(cells)
        places[:, self.amplitude] = 0
        return np.asarray(np.ravel_multi_index(tuple(places.T), self.shape))

    def tasks(self, cells: Cells) -> Iterator[Task]:
        """Tasks that compute cells, in their order."""
        if self.amplitude is None:
            for cell in cells.tolist():
                yield Task((cell,), self.settings(cell))
            return
        families = self.families(cells)
        order = np.argsort(families, kind="stable")
        starts = np.flatnonzero(np.diff(families[order], prepend=-1))
        for group in np.split(cells[order], starts[1:]):
            found = sorted((float(self.values(cell)[self.amplitude]), cell) for cell in group.tolist())
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
