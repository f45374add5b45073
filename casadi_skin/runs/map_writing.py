"""Files of a map: map.csv, map.nc and a picture a quantity, made from the journals."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.model.arguments import file_path
from casadi_skin.results.dataset import EMPTY, Cell, characters, new_file, put_attributes, stored_name, write_csv
from casadi_skin.runs.directory import SCENE
from casadi_skin.runs.faults import SceneError
from casadi_skin.runs.map_grid import Axis, Grid
from casadi_skin.runs.map_lines import BOUNDARY, read_boundary
from casadi_skin.runs.map_one_file import unpacked
from casadi_skin.runs.map_result import Map
from casadi_skin.runs.map_store import REASON, STATUS, UNKNOWN, Columns, Store, scratch
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.reading import parse_scene, read_text

if TYPE_CHECKING:
    from scipy.io import netcdf_file

CSV, NETCDF = "map.csv", "map.nc"
LARGEST = 2**31  # of whole numbers in netCDF 3
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
            row["status"] = STATUS[columns.store.states[cell]]
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
        words = " ".join(word.replace(" ", "_") for word in STATUS)
        values = np.arange(len(STATUS), dtype="i4")
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
        whole = values.dtype.kind in "bi" and bool(np.all(np.abs(values.astype(float)) < LARGEST))
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
    data[:] = np.where(np.isfinite(values), values, EMPTY)
    stored.__dict__["data"] = data.reshape(columns.store.grid.shape)  # set plainly it becomes an attribute too
    put_attributes(stored, {"long_name": meaning, **_units(unit), "_FillValue": EMPTY})


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

ACCEPTED = "accepted: the directory of a map, with its scene.toml and journals, or a file of Map.save"


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
    if not (directory / SCENE).is_file():
        raise ValueError(f"{shown}: holds no {SCENE}; {ACCEPTED}")
    try:
        scene = parse_scene(read_text(directory / SCENE), str(shown / SCENE))
        if scene.map is None:
            raise ValueError(f"{shown}: its {SCENE} has no [map]; {ACCEPTED}")
        grid = Grid.of(scene)
    except SceneError as error:
        raise ValueError(f"{shown}: {error}; {ACCEPTED}") from None
    with Progress() as progress, Store(directory, grid, scene, None, progress.report) as store:
        columns = Columns(store, scene.map.quantities)
    try:
        boundary = read_boundary(grid, directory / BOUNDARY)
    except (ValueError, KeyError, IndexError) as error:
        accepted = "accepted: the file that the map wrote"
        raise ValueError(f"{shown / BOUNDARY}: cannot be read ({error}); {accepted}") from None
    return Map(directory, columns, store.complete, boundary=boundary)
