"""A map as computed: values of quantities over its axes, read from its journals on demand; its files and pictures."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from casadi_skin.fmu.unzip import Archive
from casadi_skin.model.arguments import check_name, cut, file_path, short_repr
from casadi_skin.model.files import TemporaryFolder, replacing
from casadi_skin.model.result import WithVerbs
from casadi_skin.results.dataset import LARGEST_WHOLE_NUMBER, Dataset, Variable, to_xarray, write_csv
from casadi_skin.results.figures.map import MapAxis, Panel, draw_maps, map_figure, panel_title
from casadi_skin.results.figures.style import save
from casadi_skin.results.words import Columns as TableColumns
from casadi_skin.results.words import Shown, listed, show
from casadi_skin.runs.directory import SCENE_FILE
from casadi_skin.runs.map_grid import Axis, Grid, Lines
from casadi_skin.runs.map_lines import BOUNDARY_FILE, read_boundary
from casadi_skin.runs.map_store import (
    DONE,
    ENDED,
    FAILED,
    JOURNAL_PATTERN,
    REASON,
    STATUS_WORDS,
    UNKNOWN,
    Columns,
    Store,
)
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.reading import parse_scene, read_text
from casadi_skin.runs.rules import SceneError

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAP_PARTS = (SCENE_FILE, JOURNAL_PATTERN, BOUNDARY_FILE)  # of a map in one file, which is read as its directory is
FILE_DATE = (1980, 1, 1, 0, 0, 0)  # so that the bytes depend on the map alone


@dataclass(frozen=True, eq=False)
class Map(WithVerbs):
    """Quantities of a scene over its parameters.

    Attributes:
        directory: where its journals, tables and pictures are.
        columns: its quantities, on the disk.
        complete: whether every cell is computed, or was tried twice.
        waits: whether shares of a batch array are not there yet.
        boundary: lines of changes of stability in the plane of the ranges, shape (points, 2) each, by the places of
            the other axes.
        folder: the temporary folder of a map that was read from one file; None of one in its directory.
    """

    directory: Path
    columns: Columns
    complete: bool
    waits: bool = False
    boundary: Lines = field(default_factory=dict)
    folder: TemporaryFolder | None = None

    @property
    def store(self) -> Store:
        """The records of its cells."""
        return self.columns.store

    @property
    def axes(self) -> Mapping[str, NDArray[Any]]:
        """Values along each axis by name."""
        return {axis.name: np.array(axis.values) for axis in self.store.grid.axes}

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return self.store.grid.shape

    @property
    def status(self) -> NDArray[np.int8]:
        """0 of a cell that is not computed, 1 done, 2 where a branch ended early, 3 failed; shape as the axes."""
        return self.store.states.reshape(self.shape)

    def failures(self, most: int | None = None) -> list[tuple[str, str]]:
        """Cells that failed or ended early, in words, each with its reason; no more than `most` of them."""
        cells = np.flatnonzero(self.store.states >= ENDED)[:most].tolist()
        return [(self.store.grid.name(cell), self.columns.text(REASON, cell)) for cell in cells]

    @property
    def names(self) -> list[str]:
        """Names of the quantities."""
        return self.columns.names

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Values of a quantity by name, shape as the axes: NaN or an empty text where there is none.

        Raises ValueError, with the nearest known name, for an unknown one.
        """
        check_name("quantity", name, self.names)
        return np.array(self.columns[name])

    def summary(self) -> str:
        """The numbers of cells in words."""
        states = self.store.states
        counts = [(DONE, "done"), (ENDED, "ended early"), (FAILED, "failed")]
        words = [f"{np.sum(states == s)} {word}" for s, word in counts if np.any(states == s)]
        mean = self.store.seconds / max(self.store.finished, 1)
        refined = f" of {self.store.grid.size} at the finest" if self.store.grid.refined else ""
        return f"{int(np.sum(states != UNKNOWN))} cells{refined}: {', '.join(words) or 'none'}; {mean:.3g} s a cell"

    def __repr__(self) -> str:
        sizes = " x ".join(f"{len(axis.values)} {axis.name}" for axis in self.store.grid.axes)
        return f"<Map: {sizes}; {self.summary()}>"

    def save(self, path: str | Path) -> Path:
        """Write the map to one file, from which `casadi_skin.read_map` reads it with the same bits.

        Raises ValueError for the path of a directory or in none, OSError where the file cannot be written.
        """
        target = file_path("path", path)
        if target.is_dir() or not target.parent.is_dir():
            raise ValueError(f"path: given {target}; accepted: the path of a file, in a directory that is there")
        with replacing(target) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            for part in sorted(p for p in self.directory.iterdir() if _is_part(p.name)):
                entry = zipfile.ZipInfo(part.name, FILE_DATE)
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, part.read_bytes())
        return target

    figure: ClassVar[Callable[..., Figure]]
    """The picture of a quantity with all its panels: `casadi_skin.runs.map_result.picture`."""
    plot: ClassVar[Callable[..., Axes]]
    """Draw a quantity over the ranges of the map into matplotlib axes: `casadi_skin.runs.map_result.plot`."""
    to_dataframe: ClassVar[Callable[..., pandas.DataFrame]]
    """A pandas DataFrame with a row a computed cell, as in map.csv: `casadi_skin.results.present.to_dataframe`."""

    def to_xarray(self) -> xarray.Dataset:
        """The map as an xarray Dataset, as in map.nc; raises ImportError, naming the extra, without xarray."""
        dimensions = tuple(axis.name for axis in self.store.grid.axes)
        axes = [Variable(name, (name,), values, name) for name, values in self.axes.items()]
        status = Variable("status", dimensions, self.status, "what is known of a cell")
        return to_xarray(Dataset([*axes, status, *_quantities(self.columns, dimensions)]), dimensions)


@show.register
def _(found: Map) -> Shown:
    axes, names = found.store.grid.axes, drawn_names(found)
    rows = [(axis.name, f"{len(axis.values)} values") for axis in axes]
    rows += [("cells", found.summary()), ("quantities", listed(found.names))]

    def draw(places: Axes) -> None:
        if not names:
            raise ValueError("plot: no quantity changes over the map")
        along = _along(axes)
        plot(found, names[0], places, {axis.name: axis.values[0] for i, axis in enumerate(axes) if i not in along})

    def columns() -> TableColumns:
        cells = np.flatnonzero(found.store.states != UNKNOWN)
        places = found.store.grid.places(cells).T
        table = {axis.name: np.array(axis.values)[at] for axis, at in zip(axes, places, strict=True)}
        table |= {"status": [STATUS_WORDS[state] for state in found.store.states[cells]]}
        return table | {name: found.columns[name].ravel()[cells] for name in (*found.names, REASON)}

    return Shown("Map", rows, draw, "quantities over the axes of a map", columns)


# Files of a map: map.csv, map.nc and a picture a quantity, made from the journals -------------------------------------

CSV, NETCDF = "map.csv", "map.nc"
CHAIN_MEANINGS = {"sites": "number of sites", "N": "number of sites", "alpha": "on-site stiffness",
                  "gamma": "nonreciprocity", "g": "cubic on-site coefficient", "S": "total amplitude: sum of y_n^2 at "
                  "t = 0", "mode": "linear mode by ascending frequency"}  # fmt: skip


def write_table(columns: Columns, path: Path) -> None:
    """map.csv: a row a cell that is known, axes first."""
    grid, states = columns.store.grid, columns.store.states
    names = [*(axis.name for axis in grid.axes), "status", *columns.names, REASON]
    known = np.flatnonzero(states != UNKNOWN).tolist()
    values = zip(*(columns.cells(name, known) for name in (*columns.names, REASON)), strict=True)
    rows = (
        dict(zip(names, (*grid.values(cell), STATUS_WORDS[states[cell]], *row), strict=True))
        for cell, row in zip(known, values, strict=True)
    )
    write_csv(path, names, rows)


def map_dataset(columns: Columns, attributes: Mapping[str, Any], dimensionless: bool) -> Dataset:
    """The variables of map.nc: dimensions named by the parameters, quantities over them.

    Numbers of a model of the user's have whatever unit the model has.
    """
    axes, names, units = columns.store.grid.axes, list[str](), {"units": "1"} if dimensionless else {}
    for axis in axes:
        name = re.sub(r"\W+", "_", axis.name)
        while name in names:
            name = f"{name}_"
        names.append(name)
    variables = [_axis_variable(axis, name, units) for axis, name in zip(axes, names, strict=True)]
    words = " ".join(word.replace(" ", "_") for word in STATUS_WORDS)
    flags = {"flag_values": np.arange(len(STATUS_WORDS), dtype="i4"), "flag_meanings": words}
    status = columns.store.states.reshape(columns.store.grid.shape)
    variables += [Variable("status", tuple(names), status, "what is known of a cell", attributes=flags)]
    variables += _quantities(columns, tuple(names), units)
    taken, unique = {f"{v.name}_length" for v in variables if v.values.dtype.kind in "USO"}, list[Variable]()
    for place, variable in enumerate(variables):
        name = variable.name
        while place >= len(axes) and (name in taken or name in names):
            name = f"{name}_of_cell"
        taken.add(name)
        unique.append(replace(variable, name=name))
    return Dataset(unique, attributes)


def _axis_variable(axis: Axis, dimension: str, units: Mapping[str, str]) -> Variable:
    values, words = np.array(axis.values), ", ".join(".".join(path) for path in axis.paths)
    meaning = f"the parameter {words}"
    if not any("parameters" in path for path in axis.paths):  # declared by the user, with a meaning of their own
        meaning = CHAIN_MEANINGS.get(axis.name, meaning)
    if values.dtype.kind in "US":
        return Variable(dimension, (dimension,), values, meaning)
    if not np.all(np.abs(values.astype(float)) < LARGEST_WHOLE_NUMBER):
        values = values.astype(float)
    return Variable(dimension, (dimension,), values, meaning, attributes=units)


def _quantities(columns: Columns, dimensions: tuple[str, ...], units: Mapping[str, str] = {}) -> list[Variable]:
    """Variables over the cells: numbers with NaN and texts with nothing where there is none, reasons last."""
    found = []
    for name in columns.names:
        meaning = columns.store.meanings.get(name, "the cell whose solution the second start began at")
        number = name in columns.numbers
        found.append(Variable(name, dimensions, columns[name], meaning, number, units if number else {}))
    return [*found, Variable(REASON, dimensions, columns[REASON], "why a cell failed, or ended early")]


# A map read back from its directory: the journals are the truth, tables and pictures are not needed -------------------

ACCEPTED_MAPS = "accepted: the directory of a map, with its scene.toml and journals, or a file of Map.save"


def read_map(directory: str | Path) -> Map:
    """Read a map that was computed, or is being computed, without its model and without computing anything.

    Arguments:
        directory: of its results, or one file that `Map.save` wrote.

    Returns:
        The map, with the values, the bits and the boundary that `run_map` gave; `complete` is False while cells are
        missing.

    Raises:
        ValueError: there is no map, or its files cannot be read; the message names the place.
        TypeError: the argument is no path.
    """
    source = file_path("directory", directory)
    if not source.is_file():
        return _in_directory(source, source)
    archive, folder = Archive(source, "a map in one file"), TemporaryFolder("casadi_skin_map_")
    try:
        archive.write(folder.path, _is_part)
        return replace(_in_directory(folder.path, source), folder=folder)
    except ValueError as error:
        folder.remove()
        raise ValueError(str(error).replace(str(folder.path), str(source))) from None
    except BaseException:
        folder.remove()
        raise
    finally:
        archive.close()


def _is_part(name: str) -> bool:
    return any(fnmatch(name, part) for part in MAP_PARTS) and "/" not in name


def _in_directory(directory: Path, shown: Path) -> Map:
    """The map in a directory, which messages call by another name."""
    if not (directory / SCENE_FILE).is_file():
        raise ValueError(f"{shown}: holds no {SCENE_FILE}; {ACCEPTED_MAPS}")
    try:
        scene = parse_scene(read_text(directory / SCENE_FILE), str(shown / SCENE_FILE))
        if scene.map is None:
            raise ValueError(f"{shown}: its {SCENE_FILE} has no [map]; {ACCEPTED_MAPS}")
        grid = Grid.of(scene)
    except SceneError as error:
        raise ValueError(f"{shown}: {error}; {ACCEPTED_MAPS}") from None
    with Progress() as progress, Store(directory, grid, scene, None, progress.report) as store:
        columns = Columns(store, scene.map.quantities)
    try:
        boundary = read_boundary(grid, directory / BOUNDARY_FILE)
    except (ValueError, KeyError, IndexError) as error:
        accepted = "accepted: the file that the map wrote"
        raise ValueError(f"{shown / BOUNDARY_FILE}: cannot be read ({error}); {accepted}") from None
    return Map(directory, columns, store.complete, boundary=boundary)


# Pictures of a map: a quantity each, over the axes that are ranges; other axes have a panel a value -------------------

NOT_DRAWN = ("points", "at_round_off", "residual", "profile_error", "S_error", "intervals")


def drawn_names(found: Map) -> list[str]:
    """Quantities with a picture: numbers that change over the map, but for error bars."""
    names, known = list[str](), found.store.states != UNKNOWN
    for name in (n for n in found.names if n in found.columns.numbers):
        values = found.columns.numbers[name][known]
        finite = values[np.isfinite(values)]
        changes = finite.size < values.size or float(np.ptp(finite)) > 0.0
        if changes and not name.endswith("_error") and name not in NOT_DRAWN:
            names.append(name)
    return names


def write_pictures(found: Map) -> None:
    """Draw each quantity as map_NAME."""
    for name in drawn_names(found):
        safe = "".join(char if char.isalnum() or char in "-_" else "_" for char in name)
        save(picture(found, name), found.directory / f"map_{safe}")


def picture(found: Map, name: str) -> Figure:
    """The picture of a quantity of a map: a panel for each combination of values of axes that are lists.

    Raises ValueError for an unknown quantity, or a text.
    """
    axes, drawn, panel = _panels(found, name)
    others = [range(len(axis.values)) for axis in axes]
    panels = [panel(chosen) for chosen in product(*others)]
    return map_figure(name, found.store.meanings.get(name, name), drawn, panels)


def plot(found: Map, name: str, axes: Axes | None = None, at: Mapping[str, Any] | None = None) -> Axes:
    """Draw a quantity over the ranges of the map into matplotlib axes.

    Arguments:
        found: the map.
        name: the quantity.
        axes: where it is drawn; new ones of pyplot by default.
        at: values of the axes that are lists, by name; one of a single value may be left out.

    Returns:
        The axes.

    Raises:
        ValueError: there is no such quantity, it is a text, or there is no such value of an axis.
    """
    from matplotlib.axes import Axes

    others, drawn, panel = _panels(found, name)
    given = dict(at or {})
    for key in given:
        check_name("at", key, [axis.name for axis in others])
    chosen = [_place_of(axis, given) for axis in others]
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(layout="constrained")[1]
    if not isinstance(axes, Axes):
        raise TypeError(f"axes: given {short_repr(axes)}; accepted: axes of matplotlib, or None")
    draw_maps([axes], name, drawn, [panel(chosen)])
    if axes.get_legend_handles_labels()[0]:
        axes.legend()
    return axes


def _panels(found: Map, name: str) -> tuple[list[Axis], list[MapAxis], Callable[[Sequence[int]], Panel]]:
    """Axes that are not drawn, those that are, and the panel of a quantity at places along the first."""
    check_name("quantity", name, [n for n in found.names if n in found.columns.numbers])
    axes = found.store.grid.axes
    along = _along(axes)
    others = [i for i in range(len(axes)) if i not in along]

    def panel(chosen: Sequence[int]) -> Panel:
        places = dict(zip(others, chosen, strict=True))
        index = tuple(places.get(i, slice(None)) for i in range(len(axes)))
        values, states = found[name].astype(float)[index], found.status[index]
        values = np.where(np.isfinite(values), values, np.nan)
        names = [part for i in others for part in axes[i].names]
        at = [value for i, k in places.items() for _, value in axes[i].settings(k)]
        shown = filled(values, states, [axes[i].stride for i in along])
        lines = found.boundary.get(tuple(chosen), ())
        return Panel(panel_title(names, at), shown, states >= ENDED, states != UNKNOWN, lines)

    drawn = [MapAxis(axes[i].name, axes[i].numbers, axes[i].log) for i in along]
    return [axes[i] for i in others], drawn, panel


def _place_of(axis: Axis, given: Mapping[str, Any]) -> int:
    """The value of a list that is drawn: the requested one, or the only one; raises ValueError for no value."""
    if axis.name not in given and len(axis.values) == 1:
        return 0
    value = given.get(axis.name)
    if axis.name not in given or value not in axis.values:
        words = f"given {short_repr(value)}" if axis.name in given else "missing"
        raise ValueError(f"at: {axis.name}: {words}; accepted: {cut(', '.join(map(repr, axis.values)))}")
    return axis.values.index(value)


def _along(axes: tuple[Axis, ...]) -> list[int]:
    """Axes that are drawn: the ranges; where there is none the longest list of numbers."""
    ranges = [i for i, axis in enumerate(axes) if axis.numeric]
    lists = [i for i, axis in enumerate(axes) if not axis.worded]
    return ranges or sorted(lists, key=lambda i: -len(axes[i].values))[:1] or [0]


def filled(values: NDArray[np.float64], states: NDArray[np.int8], strides: list[int]) -> NDArray[np.float64]:
    """Values with those of the nearest computed cell where a refined map computed none."""
    if max(strides) == 1 or not np.any(states == UNKNOWN):
        return values
    from scipy.ndimage import distance_transform_edt

    _, nearest = distance_transform_edt(states == UNKNOWN, sampling=[1.0 / s for s in strides], return_indices=True)
    return np.asarray(values[tuple(nearest)])
