"""A map, a branch or a diagram in one file, written as the files of a run or a map that a page is made of."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.model.arguments import short_repr
from casadi_skin.points.diagram import Diagram
from casadi_skin.results.dataset import write_csv, write_netcdf
from casadi_skin.results.quantities import dataset_of, places_of
from casadi_skin.results.saving import read_result
from casadi_skin.results.stability_tables import EVENT_COLUMNS, event_rows
from casadi_skin.runs.explorer_map_data import MAP
from casadi_skin.runs.map_writing import write_map
from casadi_skin.runs.read_map import read_map

ACCEPTED = "accepted: a file of a branch, a diagram or a map"


def write_files(path: Path, directory: Path) -> None:
    """Write the netCDF files and the tables of a file's contents; raises ValueError for other contents."""
    if zipfile.is_zipfile(path):
        found = read_map(path)
        write_map(found.columns, directory / MAP, {"title": path.stem}, True)
        return
    result = read_result(path)
    branches = result.branches if isinstance(result, Diagram) else (result,)
    if not all(isinstance(branch, Branch) and len(branch) for branch in branches):
        raise ValueError(f"{path}: holds {short_repr(result)}; {ACCEPTED}")
    for number, branch in enumerate(branches, start=1):
        family = isinstance(branch.space, Family)
        name = f"other_{number}" if len(branches) > 1 else "family" if family else "branch"
        _write_branch(branch, directory / name, path.stem)


def _write_branch(branch: Branch, stem: Path, title: str) -> None:
    """The netCDF file of a branch, and the kinds of its special points, or the changes of stability of a family."""
    write_netcdf(stem.with_suffix(".nc"), replace(dataset_of([branch]), attributes={"title": title}))
    if isinstance(branch.space, Family):
        if branch.diagram_of_changes is not None:
            rows = event_rows(branch.space.coordinates.mode_number, branch.diagram_of_changes)
            write_csv(stem.with_name("events.csv"), EVENT_COLUMNS, rows)
        return
    kinds = [{"special": place.special or ""} for place in places_of(branch)]
    write_csv(stem.with_suffix(".csv"), ("special",), kinds)
