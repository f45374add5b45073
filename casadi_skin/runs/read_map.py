"""A map read back from its directory: the journals are the truth, tables and pictures are not needed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from casadi_skin.model.arguments import file_path
from casadi_skin.runs.directory import SCENE
from casadi_skin.runs.faults import SceneError
from casadi_skin.runs.map_boundary import BOUNDARY, read_boundary
from casadi_skin.runs.map_columns import Columns
from casadi_skin.runs.map_grid import Grid
from casadi_skin.runs.map_one_file import unpacked
from casadi_skin.runs.map_result import Map
from casadi_skin.runs.map_store import Store
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.reading import parse_scene, read_text

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
