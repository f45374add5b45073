"""A map as computed: values of quantities over its axes, read from its journals on demand."""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
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
from casadi_skin.results.dataset import NETCDF_FILL_VALUE, characters, new_file, put_attributes, stored_name, write_csv
from casadi_skin.results.figures.map import MapAxis, Panel, draw_maps, map_figure, panel_title
from casadi_skin.results.figures.style import save
from casadi_skin.results.quantities import Cell
from casadi_skin.results.words import listed
from casadi_skin.runs.directory import SCENE_FILE
from casadi_skin.runs.map_grid import Axis, Grid
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
    scratch,
)
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.reading import parse_scene, read_text
from casadi_skin.runs.rules import SceneError

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from scipy.io import netcdf_file


# A map as one file: an archive of its scene, its journals and its boundary, read as its directory is ------------------

MAP_PARTS = (SCENE_FILE, JOURNAL_PATTERN, BOUNDARY_FILE)
FILE_DATE = (1980, 1, 1, 0, 0, 0)  # so that the bytes depend on the map alone


def save_map(directory: Path, path: str | Path) -> Path:
    """Write the map of a directory to one file, from which `read_map` reads it; see `Map.save`."""
    target = file_path("path", path)
    if target.is_dir() or not target.parent.is_dir():
        raise ValueError(f"path: given {target}; accepted: the path of a file, in a directory that is there")
    parts = sorted(p for p in directory.iterdir() if _is_part(p.name))
    with replacing(target) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for part in parts:
            entry = zipfile.ZipInfo(part.name, FILE_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, part.read_bytes())
    return target


def unpacked(path: Path) -> TemporaryFolder:
    """The parts of a map in one file, in a folder that goes with the object; raises ValueError for other files."""
    archive = Archive(path, "a map in one file")
    try:
        folder = TemporaryFolder("casadi_skin_map_")
        try:
            archive.write(folder.path, _is_part)
        except BaseException:
            folder.remove()
            raise
    finally:
        archive.close()
    return folder


def _is_part(name: str) -> bool:
    return any(fnmatch(name, part) for part in MAP_PARTS) and "/" not in name


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
    boundary: Mapping[tuple[int, ...], tuple[NDArray[np.float64], ...]] = field(default_factory=dict)
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
        if name in self.columns.numbers:
            return np.array(self.columns.numbers[name]).reshape(self.shape)
        cells = np.flatnonzero(self.columns.lengths(name)).tolist()
        texts = np.full(self.store.grid.size, "", dtype=object)
        for cell in cells:
            texts[cell] = self.columns.text(name, cell)
        return texts.reshape(self.shape)

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
        return save_map(self.directory, path)

    figure: ClassVar[Callable[..., Figure]]
    """The picture of a quantity with all its panels: `casadi_skin.runs.map_result.picture`."""
    plot: ClassVar[Callable[..., Axes]]
    """Draw a quantity over the ranges of the map into matplotlib axes: `casadi_skin.runs.map_result.plot`."""

    def lines(self, chosen: tuple[int, ...]) -> tuple[NDArray[np.float64], ...]:
        """Lines of the boundary at places of the axes that are no ranges."""
        return self.boundary.get(chosen, ())

    def to_dataframe(self) -> pandas.DataFrame:
        """A pandas DataFrame with a row a computed cell, as in map.csv; raises ImportError, naming the extra."""
        try:
            import pandas
        except ImportError as error:
            extra = 'it comes with the extra: pip install "casadi-skin[pandas]"'
            raise ImportError(f"pandas is not installed; {extra}") from error
        cells = np.flatnonzero(self.store.states != UNKNOWN)
        columns: dict[str, Any] = {}
        for axis, places in zip(self.store.grid.axes, self.store.grid.places(cells).T, strict=True):
            columns[axis.name] = np.array(axis.values)[places]
        columns["status"] = [STATUS_WORDS[state] for state in self.store.states[cells]]
        columns |= {name: self[name].ravel()[cells] for name in self.names}
        columns[REASON] = [self.columns.text(REASON, cell) for cell in cells.tolist()]
        return pandas.DataFrame(columns)

    def to_xarray(self) -> xarray.Dataset:
        """The map as an xarray Dataset, as in map.nc; raises ImportError, naming the extra, without xarray."""
        try:
            import xarray as xr
        except ImportError as error:
            words = 'xarray is not installed; it comes with the extra: pip install "casadi-skin[xarray]"'
            raise ImportError(words) from error
        dimensions = tuple(axis.name for axis in self.store.grid.axes)
        meanings = self.store.meanings
        found = {n: xr.Variable(dimensions, self[n], {"long_name": meanings.get(n, n)}) for n in self.names}
        return xr.Dataset({"status": (dimensions, self.status), **found}, coords=dict(self.axes))


# Files of a map: map.csv, map.nc and a picture a quantity, made from the journals -------------------------------------

CSV, NETCDF = "map.csv", "map.nc"
LARGEST_WHOLE_NUMBER = 2**31  # of whole numbers in netCDF 3
CHAIN_MEANINGS = {"sites": "number of sites", "N": "number of sites", "alpha": "on-site stiffness",
                  "gamma": "nonreciprocity", "g": "cubic on-site coefficient", "S": "total amplitude: sum of y_n^2 at "
                  "t = 0", "mode": "linear mode by ascending frequency"}  # fmt: skip


def write_table(columns: Columns, path: Path) -> None:
    """map.csv: a row a cell that is known, axes first."""
    axes = columns.store.grid.axes
    names = [*(axis.name for axis in axes), "status", *columns.names, REASON]

    def rows() -> Iterator[Mapping[str, Cell]]:
        whole = {name: columns.is_whole(name) for name in columns.numbers}
        for cell in np.flatnonzero(columns.store.states != UNKNOWN).tolist():
            row: dict[str, Cell] = dict(zip(names, columns.store.grid.values(cell), strict=False))
            row["status"] = STATUS_WORDS[columns.store.states[cell]]
            for name in columns.names:
                if name in columns.texts:
                    row[name] = columns.text(name, cell)
                else:
                    value = float(columns.numbers[name][cell])
                    row[name] = "" if np.isnan(value) else int(value) if whole[name] else value
            row[REASON] = columns.text(REASON, cell)
            yield row

    write_csv(path, names, rows())


def write_map(columns: Columns, path: Path, attributes: Mapping[str, Any], dimensionless: bool) -> None:
    """map.nc: dimensions named by the parameters, quantities over them; netCDF 3, which every reader opens."""
    unit = "1" if dimensionless else ""
    with new_file(path, attributes) as file:
        names = dimension_names(columns)
        for axis, dimension in zip(columns.store.grid.axes, names, strict=True):
            _put_axis(file, axis, dimension, unit)
        shape = columns.store.grid.shape
        flags = file.createVariable(_free(file, "status"), "i4", names)
        flags[:] = columns.store.states.reshape(shape)
        words = " ".join(word.replace(" ", "_") for word in STATUS_WORDS)
        values = np.arange(len(STATUS_WORDS), dtype="i4")
        put_attributes(flags, {"long_name": "what is known of a cell", "flag_values": values, "flag_meanings": words})
        for name in columns.names:
            meaning = columns.store.meanings.get(name, "the cell whose solution the second start began at")
            if name in columns.texts:
                _put_text(file, columns, name, names, meaning)
            else:
                _put_numbers(file, columns, name, names, meaning, unit)
        _put_text(file, columns, REASON, names, "why a cell failed, or ended early")


def dimension_names(columns: Columns) -> tuple[str, ...]:
    """Names of the dimensions, as they are stored: those of the parameters, each once."""
    found = list[str]()
    for axis in columns.store.grid.axes:
        name = stored_name(re.sub(r"\W+", "_", axis.name))
        while name in found:
            name = f"{name}_"
        found.append(name)
    return tuple(found)


def _put_axis(file: netcdf_file, axis: Axis, dimension: str, unit: str) -> None:
    values, words = np.array(axis.values), ", ".join(".".join(path) for path in axis.paths)
    declared = any("parameters" in path for path in axis.paths)  # by the user, with a meaning of their own
    long_name = f"the parameter {words}" if declared else CHAIN_MEANINGS.get(axis.name, f"the parameter {words}")
    meaning = {"long_name": long_name}
    file.createDimension(dimension, len(axis.values))
    if values.dtype.kind in "US":
        encoded = characters([str(value) for value in axis.values])
        file.createDimension(f"{dimension}_length", encoded.shape[1])
        stored = file.createVariable(dimension, "c", (dimension, f"{dimension}_length"))
        stored[:] = encoded
    else:
        whole = values.dtype.kind in "bi" and bool(np.all(np.abs(values.astype(float)) < LARGEST_WHOLE_NUMBER))
        kind = "i4" if whole else "f8"
        stored = file.createVariable(dimension, kind, (dimension,))
        stored[:] = values.astype(kind)
        meaning |= _units(unit)
    put_attributes(stored, meaning)


def _put_numbers(
    file: netcdf_file, columns: Columns, name: str, dimensions: tuple[str, ...], meaning: str, unit: str
) -> None:
    """A column as it is on the disk; unknown values are netCDF's fill value."""
    stored = file.createVariable(_free(file, name), "f8", dimensions)
    values = columns.numbers[name]
    data = scratch(">f8", values.shape)
    data[:] = np.where(np.isfinite(values), values, NETCDF_FILL_VALUE)
    stored.__dict__["data"] = data.reshape(columns.store.grid.shape)  # set plainly it becomes an attribute too
    put_attributes(stored, {"long_name": meaning, **_units(unit), "_FillValue": NETCDF_FILL_VALUE})


def _units(unit: str) -> dict[str, str]:
    """Attributes of quantities with a unit: numbers of a model of the user's have whatever unit the model has."""
    return {"units": unit} if unit else {}


def _put_text(file: netcdf_file, columns: Columns, name: str, dimensions: tuple[str, ...], meaning: str) -> None:
    """Texts as characters along a last dimension, the convention of netCDF 3."""
    width = max(int(columns.lengths(name).max(initial=0)), 1)
    free = _free(file, name)
    file.createDimension(f"{free}_length", width)
    stored = file.createVariable(free, "c", (*dimensions, f"{free}_length"))
    data = scratch("S1", (columns.store.grid.size, width))
    data[:] = b" "
    for cell in np.flatnonzero(columns.lengths(name)).tolist():
        text = columns.text(name, cell).encode()
        data[cell, : len(text)] = np.frombuffer(text, "S1")
    stored.__dict__["data"] = data.reshape(*columns.store.grid.shape, width)
    put_attributes(stored, {"long_name": meaning})


def _free(file: netcdf_file, name: str) -> str:
    """A name that no dimension and no other variable has, as it is stored."""
    name = stored_name(name)
    while name in file.variables or name in file.dimensions:
        name = f"{name}_of_cell"
    return name


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
    folder = unpacked(source)
    try:
        return replace(_in_directory(folder.path, source), folder=folder)
    except ValueError as error:
        folder.remove()
        raise ValueError(str(error).replace(str(folder.path), str(source))) from None
    except BaseException:
        folder.remove()
        raise


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

LEFT_OUT = ("points", "at_round_off", "residual", "profile_error", "S_error", "intervals")


def drawn_names(found: Map) -> list[str]:
    """Quantities with a picture: numbers that change over the map, but for error bars."""
    names = []
    for name in found.names:
        if name not in found.columns.numbers:
            continue
        values = found.columns.numbers[name][found.store.states != UNKNOWN]
        known = values[np.isfinite(values)]
        changes = known.size < values.size or float(np.ptp(known)) > 0.0
        if changes and not name.endswith("_error") and name not in LEFT_OUT:
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
    check_name("quantity", name, [n for n in found.names if n in found.columns.numbers])
    axes = found.store.grid.axes
    along = _along(axes)
    others = [i for i in range(len(axes)) if i not in along]
    every = product(*(range(len(axes[i].values)) for i in others))
    panels = [_panel(found, name, along, dict(zip(others, chosen, strict=True))) for chosen in every]
    drawn = [MapAxis(axes[i].name, numbers(axes[i]), axes[i].log) for i in along]
    return map_figure(name, found.store.meanings.get(name, name), drawn, panels)


def html(found: Map) -> str:
    """A map as a small table beside the picture of its first quantity that changes, for notebooks."""
    from casadi_skin.results.present import page

    rows = [(axis.name, f"{len(axis.values)} values") for axis in found.store.grid.axes]
    rows += [("cells", found.summary()), ("quantities", listed(found.names))]
    names = drawn_names(found)
    lists = {axis.name: axis.values[0] for axis in _lists(found)}
    return page("Map", rows, lambda axes: plot(found, names[0], axes, lists) if names else refuse())


def _lists(found: Map) -> list[Axis]:
    """Axes that are not drawn."""
    axes = found.store.grid.axes
    return [axis for i, axis in enumerate(axes) if i not in _along(axes)]


def refuse() -> None:
    """Raises ValueError: nothing changes over the map."""
    raise ValueError("plot: no quantity changes over the map")


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

    check_name("quantity", name, [n for n in found.names if n in found.columns.numbers])
    ranges = found.store.grid.axes
    along, given = _along(ranges), dict(at or {})
    others = {ranges[i].name: i for i in range(len(ranges)) if i not in along}
    for key in given:
        check_name("at", key, others)
    chosen = {i: _place_of(ranges[i], given) for i in others.values()}
    if axes is None:
        from matplotlib import pyplot

        axes = pyplot.subplots(layout="constrained")[1]
    if not isinstance(axes, Axes):
        raise TypeError(f"axes: given {short_repr(axes)}; accepted: axes of matplotlib, or None")
    drawn = [MapAxis(ranges[i].name, numbers(ranges[i]), ranges[i].log) for i in along]
    draw_maps([axes], name, drawn, [_panel(found, name, along, chosen)])
    if axes.get_legend_handles_labels()[0]:
        axes.legend()
    return axes


def _place_of(axis: Axis, given: Mapping[str, Any]) -> int:
    """The value of a list that is drawn: the requested one, or the only one; raises ValueError for no value."""
    if axis.name not in given and len(axis.values) == 1:
        return 0
    value = given.get(axis.name)
    if axis.name not in given or value not in axis.values:
        words = f"given {short_repr(value)}" if axis.name in given else "missing"
        raise ValueError(f"at: {axis.name}: {words}; accepted: {cut(', '.join(map(repr, axis.values)))}")
    return axis.values.index(value)


def _panel(found: Map, name: str, along: list[int], chosen: Mapping[int, int]) -> Panel:
    """The panel of a quantity at certain places of the other axes."""
    axes = found.store.grid.axes
    index = tuple(chosen.get(i, slice(None)) for i in range(len(axes)))
    values, states = found[name].astype(float)[index], found.status[index]
    values = np.where(np.isfinite(values), values, np.nan)
    at = [value for i, k in chosen.items() for value in _values_at(axes[i], k)]
    words = panel_title([name for i in chosen for name in _names_of(axes[i])], at)
    shown = filled(values, states, [axes[i].stride for i in along])
    return Panel(words, shown, states >= ENDED, states != UNKNOWN, found.lines(tuple(chosen.values())))


def _names_of(axis: Axis) -> list[str]:
    """Names of the parameters of an axis, of which several may change together."""
    return [name.strip() for name in axis.name.split(",")] if axis.given else [axis.name]


def _values_at(axis: Axis, place: int) -> tuple[Any, ...]:
    """Their values at a place."""
    return axis.given[place] if axis.given else (axis.values[place],)


def _along(axes: tuple[Axis, ...]) -> list[int]:
    """Axes that are drawn: the ranges; where there is none the longest list of numbers."""
    ranges = [i for i, axis in enumerate(axes) if axis.numeric]
    if ranges:
        return ranges
    lists = [i for i, axis in enumerate(axes) if not any(isinstance(v, str) for v in axis.values)]
    return sorted(lists, key=lambda i: -len(axes[i].values))[:1] or [0]


def numbers(axis: Axis) -> NDArray[np.float64]:
    """Where the values of an axis are drawn: those that are words one after the other."""
    words = any(isinstance(value, str) for value in axis.values)
    return np.arange(len(axis.values), dtype=float) if words else np.array(axis.values, dtype=float)


def filled(values: NDArray[np.float64], states: NDArray[np.int8], strides: list[int]) -> NDArray[np.float64]:
    """Values with those of the nearest computed cell where a refined map computed none."""
    if max(strides) == 1 or not np.any(states == UNKNOWN):
        return values
    from scipy.ndimage import distance_transform_edt

    _, nearest = distance_transform_edt(states == UNKNOWN, sampling=[1.0 / s for s in strides], return_indices=True)
    return np.asarray(values[tuple(nearest)])


# Planes of a map's two ranges, one for each combination of values of its other axes -----------------------------------
