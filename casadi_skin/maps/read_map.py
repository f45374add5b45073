"""A map read back from its directory: the journals are the truth, tables and pictures are not needed."""

from __future__ import annotations

from pathlib import Path

from casadi_skin.arguments import file_path
from casadi_skin.maps.boundary import BOUNDARY, read_boundary
from casadi_skin.maps.columns import Columns
from casadi_skin.maps.grid import Grid
from casadi_skin.maps.result import Map
from casadi_skin.maps.store import Store
from casadi_skin.progress import Progress
from casadi_skin.runs.directory import SCENE
from casadi_skin.scene import SceneError, parse_scene, read_text

ACCEPTED = "accepted: the directory of a map, with its scene.toml and journals"


def read_map(directory: str | Path) -> Map:
    """Read a map that was computed, or is being computed, without its model and without computing anything.

    Arguments:
        directory: of its results.

    Returns:
        The map, with the values, the bits and the boundary that `run_map` gave; `complete` is False while cells are
        missing.

    Raises:
        ValueError: the directory holds no map, or its files cannot be read; the message names it.
        TypeError: the directory is no path.
    """
    path = file_path("directory", directory)
    if not (path / SCENE).is_file():
        raise ValueError(f"{path}: holds no {SCENE}; {ACCEPTED}")
    try:
        scene = parse_scene(read_text(path / SCENE), str(path / SCENE))
        if scene.map is None:
            raise ValueError(f"{path}: its {SCENE} has no [map]; {ACCEPTED}")
        grid = Grid.of(scene)
    except SceneError as error:
        raise ValueError(f"{path}: {error}; {ACCEPTED}") from None
    with Progress() as progress, Store(path, grid, scene, None, progress.tell) as store:
        columns = Columns(store, scene.map.quantities)
    try:
        boundary = read_boundary(grid, path / BOUNDARY)
    except (ValueError, KeyError, IndexError) as error:
        raise ValueError(
            f"{path / BOUNDARY}: cannot be read ({error}); accepted: the file that the map wrote"
        ) from None
    return Map(path, columns, store.complete, boundary=boundary)
