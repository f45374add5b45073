"""Contents of a page of a run: curves, and wave forms and multipliers of a few hundred points of each."""

from __future__ import annotations

import csv
import html
import json
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fnmatch import fnmatch
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.files import TemporaryFolder, replacing
from casadi_skin.points.diagram import Diagram
from casadi_skin.results.dataset import dataset_of, read_name, readable, write_csv, write_netcdf
from casadi_skin.results.quantities import places_of
from casadi_skin.results.saving import read_result
from casadi_skin.results.tables import EVENT_COLUMNS, event_rows
from casadi_skin.runs.map_result import read_map, write_map

PAGE_FILE = "explore.html"
SHOWN_FILES = ("family.nc", "branch.nc", "cycles_*.nc", "other_*.nc", "curve_*.nc")
MOST_CURVE_POINTS = 3000  # of a curve
MOST_WAVE_NUMBERS = 400_000  # of wave forms, in all
WAVE_PHASES, WAVE_STATES = 49, 24  # of a wave form
CHANGE_NAME = "stability changes"
FILL_VALUE = 9e36  # values from here on are empty
ACCEPTED_FOLDERS = f"accepted: the directory of a run, with one of {', '.join(SHOWN_FILES)}"

Variables = Mapping[str, NDArray[Any]]


def page_data(directory: Path) -> dict[str, Any]:
    """All that the page shows, as JSON takes it; raises ValueError where the directory has no branches."""
    files = sorted(path for path in directory.glob("*.nc") if any(fnmatch(path.name, name) for name in SHOWN_FILES))
    title, parts = "", list[tuple[Path, str, Variables]]()
    for path in files:
        with readable(path):
            attributes, variables = _read(path)
            title = title or attributes.get("title", "")
            parts += [(path, name, part) for name, part in _split(path.stem, variables)]
    if not parts:
        raise ValueError(f"{directory}: holds no branches; {ACCEPTED_FOLDERS}")
    share = max(MOST_WAVE_NUMBERS // (len(parts) * WAVE_PHASES * WAVE_STATES), 20)
    branches = list[dict[str, Any]]()
    for path, name, part in parts:
        with readable(path):
            branches.append(_branch(name, part, share))
    thinned = [b for b in branches if b["count"] > len(b["columns"]["point"])]
    note = f"curves show {MOST_CURVE_POINTS} of the points of {len(thinned)} branches" if thinned else ""
    return {"title": title or directory.name, "note": note, "branches": branches}


def _read(path: Path) -> tuple[dict[str, str], Variables]:
    """Attributes that are text, and variables, with those of the tables beside the file."""
    attributes, variables, _, _ = read_netcdf(path)
    return attributes, {**variables, **_kinds(path.with_suffix(".csv")), **_events(path)}


def read_netcdf(
    path: Path,
) -> tuple[dict[str, str], dict[str, NDArray[Any]], dict[str, tuple[str, ...]], dict[str, str]]:
    """Attributes that are text; variables, in which characters become names; their dimensions; their meanings."""
    from scipy.io import netcdf_file

    with netcdf_file(path, "r", mmap=False) as file:
        known: dict[str, Any] = vars(file)["_attributes"]
        attributes = {k: v.decode() for k, v in known.items() if isinstance(v, bytes)}
        held = {read_name(name): variable for name, variable in file.variables.items()}
        variables: dict[str, NDArray[Any]] = {name: np.array(variable[:]) for name, variable in held.items()}
        dimensions = {name: tuple(map(read_name, variable.dimensions)) for name, variable in held.items()}
        meanings = {n: v.long_name.decode() for n, v in held.items() if hasattr(v, "long_name")}
    for name, values in variables.items():
        if values.dtype.kind == "S":
            rows = values.reshape(-1, values.shape[-1])
            texts = [b"".join(row).decode().rstrip("\0 ") for row in rows]
            variables[name] = np.array(texts).reshape(values.shape[:-1])
        elif values.dtype.kind == "f":
            variables[name] = np.where(np.abs(values) > FILL_VALUE, np.nan, values).astype(float)
    return attributes, variables, dimensions, meanings


def _kinds(path: Path) -> dict[str, NDArray[Any]]:
    """Kinds of special points, from the table beside a netCDF file."""
    if not path.exists():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {"special": np.array([row["special"] for row in rows])} if rows and "special" in rows[0] else {}


def _events(path: Path) -> dict[str, NDArray[Any]]:
    """Changes of stability of families, from the table of events beside them, with the mode of each."""
    table = path.with_name("events.csv")
    if path.stem != "family" or not table.exists():
        return {}
    with table.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    return {
        "event_mode": np.array([int(row["mode"]) for row in rows], dtype=int),
        "event_S": np.array([float(row["S"] or "nan") for row in rows]),
        "event_Omega": np.array([float(row["Omega"] or "nan") for row in rows]),
        "event_words": np.array([_event_words(row) for row in rows], dtype=str),
    }


def _event_words(row: Mapping[str, str]) -> str:
    """A row of events.csv in words: a change of stability, or a stretch on which some may be missing."""
    if not row["stable_before"]:  # the row of a stretch, as "unresolved"
        where = f"over {float(row['S_width']):.3g} in S" if row["S_width"] else "somewhere along the family"
        return f"{row['kind']}, changes of stability may be missing {where}"
    words = {("1", "0"): "stability lost", ("0", "1"): "stability regained"}
    return f"{words[row['stable_before'], row['stable_after']]} ({row['kind']})"


def _split(stem: str, variables: Variables) -> Iterator[tuple[str, Variables]]:
    """The families of a file one by one; another branch as it is."""
    if "mode" not in variables:
        yield stem.replace("_", " "), variables
        return
    count = variables["mode"].size
    for mode in dict.fromkeys(variables["mode"].tolist()):
        chosen = variables["mode"] == mode
        events = {n: v[variables["event_mode"] == mode] for n, v in variables.items() if n.startswith("event_")}
        yield (
            f"mode {mode}",
            {n: v[chosen] if v.ndim and len(v) == count and n != "site" else v for n, v in variables.items()} | events,
        )


def _branch(name: str, variables: Variables, share: int) -> dict[str, Any]:
    columns = _columns(variables)
    count = len(next(iter(columns.values())))
    special = _special(variables, count)
    kept = _chosen(count, MOST_CURVE_POINTS, special, variables)
    detailed = _chosen(count, share, special, variables)
    x = "S" if "S" in columns else next(iter(columns))
    y = "Omega" if "S" in columns else list(columns)[1]
    return {
        "name": name,
        "count": count,
        "x": x,
        "y": y,
        "columns": {"point": kept.tolist(), **{n: short_numbers(v[kept]) for n, v in columns.items()}},
        "stable": variables["stable"][kept].astype(int).tolist() if "stable" in variables else None,
        "requested": [int(i) for i in np.flatnonzero(variables.get("requested", np.zeros(count))[kept])],
        "special": _listed(columns, x, kept, special, variables),
        "detail": _detail(variables, detailed, kept),
    }


def _columns(variables: Variables) -> dict[str, NDArray[Any]]:
    """Quantities that are one number a point, the followed one first; of a state that moves its largest value."""
    found: dict[str, NDArray[Any]] = {}
    names = [str(n) for n in variables.get("parameter_name", ())]
    for i, name in enumerate(names):
        found[name] = variables["parameters"][:, i]
    moving = sorted(found, key=lambda name: -float(np.ptp(found[name])) / (abs(float(found[name][0])) or 1.0))
    found = {name: found[name] for name in moving}
    for i, name in enumerate(str(n) for n in variables.get("state_name", ())):
        found.setdefault(name, variables["largest" if "largest" in variables else "states"][:, i])
    if "end" in variables and "phase" in variables:
        found["period"] = variables["end"] - variables["start"]
    size = next(v for n, v in variables.items() if n in ("requested", "mode")).size
    variables = {n: v for n, v in variables.items() if not n.startswith("event_")}
    skipped = {"mode", "index", "requested", "stable", "fold", "start", "end"}
    plain = {n: v for n, v in variables.items() if v.ndim == 1 and v.size == size and v.dtype.kind in "fi"}
    return found | {n: v.astype(float) for n, v in plain.items() if n not in skipped and not n.endswith("_name")}


def _special(variables: Variables, count: int) -> dict[int, str]:
    """Kinds of special points by their place; changes of stability where nothing else is known."""
    found = {int(i): "fold" for i in np.flatnonzero(variables.get("fold", np.zeros(count)))}
    found |= {i: str(kind) for i, kind in enumerate(variables.get("special", ())) if kind}
    if "stable" in variables:
        changes = np.flatnonzero(np.diff(variables["stable"].astype(int)))
        near = {j for i in found for j in (i - 1, i, i + 1)}
        found |= {int(i) + 1: CHANGE_NAME for i in changes if not near & {int(i), int(i) + 1}}
    return dict(sorted(found.items()))


def _listed(
    columns: Mapping[str, NDArray[Any]],
    x: str,
    kept: NDArray[np.int64],
    special: Mapping[int, str],
    variables: Variables,
) -> list[dict[str, Any]]:
    """Special points by place, between points too, with the nearest point kept and words for a list."""
    places = [(float(i), kind, columns[x][i]) for i, kind in special.items()]
    if "event_S" in variables:
        places = [place for place in places if place[1] != CHANGE_NAME]
        events = zip(variables["event_S"], variables["event_Omega"], variables["event_words"], strict=True)
        for S, Omega, words in events:
            places.append((_between(columns["S"], columns["Omega"], S, Omega), str(words), S))
    found = []
    for place, kind, value in sorted(places, key=lambda known: known[0]):
        after = int(np.clip(np.searchsorted(kept, place), 1, kept.size - 1))
        gap = float(kept[after] - kept[after - 1])
        where = float(after - 1 + (place - kept[after - 1]) / gap)
        label = f"{kind}: {x} = {value:.8g}" if np.isfinite(value) else kind
        found.append({"point": round(where), "place": round(where, 4), "kind": kind, "label": label})
    return found


def _between(S: NDArray[Any], Omega: NDArray[Any], at: float, height: float) -> float:
    """The place between two points of a family at which it passes an amplitude, the nearest in frequency if known."""
    k = np.flatnonzero((S[:-1] - at) * (S[1:] - at) <= 0.0)
    if not k.size:
        return float(np.argmin(np.abs(S - at)))  # the first point where the amplitude is not known
    part = (at - S[k]) / np.where(S[k + 1] == S[k], 1.0, S[k + 1] - S[k])
    best = int(np.argmin(np.abs(Omega[k] + part * (Omega[k + 1] - Omega[k]) - height)))
    return float(k[best] + part[best])


def _chosen(count: int, most: int, special: Mapping[int, str], variables: Variables) -> NDArray[np.int64]:
    """Places of at most so many points, evenly, with special and requested ones and both ends."""
    even = np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))
    requested = np.flatnonzero(variables.get("requested", np.zeros(count)))[:most]
    return np.unique(np.concatenate([even, requested, np.array(list(special)[:most], dtype=int)])).astype(np.int64)


def _detail(variables: Variables, chosen: NDArray[np.int64], kept: NDArray[np.int64]) -> dict[str, Any]:
    """Wave forms over the period and multipliers of chosen points, by their place among those kept."""
    chosen = chosen[np.isin(chosen, kept)]
    detail: dict[str, Any] = {"point": np.searchsorted(kept, chosen).tolist(), "names": [], "waves": None}
    for name in ("multipliers", "eigenvalues"):
        if name in variables:
            detail[name] = [short_numbers(pairs) for pairs in variables[name][chosen].reshape(chosen.size, -1)]
    waves, names = _waves(variables, chosen)
    if waves is not None:
        moving = np.sort(np.argsort(-np.max(np.ptp(waves, axis=1), axis=0), kind="stable")[:WAVE_STATES])
        detail["waves"] = [[short_numbers(state) for state in wave[:, moving].T] for wave in waves]
        detail["names"] = [names[i] for i in moving]
    return detail


def _waves(variables: Variables, chosen: NDArray[np.int64]) -> tuple[NDArray[np.float64] | None, list[str]]:
    """States at even phases, shape (points, phases, states), and their names."""
    phases = np.linspace(0.0, 1.0, WAVE_PHASES)
    if "coefficients" in variables:
        names = [f"y_{n}" for n in variables["site"].tolist()]
        c = variables["coefficients"][chosen]
        odd = 2 * np.arange(c.shape[1]) + 1
        return np.einsum("tk,pks->pts", np.cos(2 * np.pi * np.outer(phases, odd)), c), names
    if "profile" in variables and variables["profile"].ndim == 3:
        places = np.linspace(0, variables["profile"].shape[1] - 1, WAVE_PHASES).astype(int)
        return variables["profile"][chosen][:, places], [str(n) for n in variables["state_name"]]
    return None, []


def short_numbers(values: NDArray[Any]) -> list[float | None]:
    """Numbers with as many digits as a screen shows; None where there is none."""
    return [float(f"{v:.7g}") if np.isfinite(v) else None for v in np.asarray(values, dtype=float).ravel()]


# Contents of a page of a map: quantities over its axes, thinned where there are too many cells ------------------------

MAP_FILE = "map.nc"
MOST_CELLS = 40_000  # of a map, in all
STATUS_WORDS = ("not computed", "done", "ended early", "failed")
SKIPPED_COLUMNS = ("status", "reason", "regime")


def map_data(directory: Path) -> dict[str, Any]:
    """All that the page shows, as JSON takes it; raises ValueError where the map has no cells."""
    with readable(directory / MAP_FILE):
        contents = read_netcdf(directory / MAP_FILE)
        empty = not contents[1]["status"].size
    if empty:
        raise ValueError(f"{directory}: a map without cells; accepted: one with at least one")
    with readable(directory / MAP_FILE):
        return _contents(directory.name, *contents)


def _contents(
    name: str,
    attributes: Mapping[str, str],
    variables: Mapping[str, NDArray[Any]],
    dimensions: Mapping[str, tuple[str, ...]],
    words: Mapping[str, str],
) -> dict[str, Any]:
    axes = list(dimensions["status"])
    chosen = _thinned(variables["status"].shape)
    index = np.ix_(*chosen)
    status = variables["status"][index]
    whole = [n for n, d in dimensions.items() if list(d) == axes and n not in SKIPPED_COLUMNS]
    numbers = {n: short_numbers(variables[n].astype(float)[index]) for n in whole if variables[n].dtype.kind in "fi"}
    left = status.size < variables["status"].size
    return {
        "title": attributes.get("title", "") or name,
        "note": f"{status.size} of {variables['status'].size} cells are shown" if left else "",
        "axes": [_axis(n, variables[n][places], words.get(n, n)) for n, places in zip(axes, chosen, strict=True)],
        "quantities": [{"name": n, "words": words.get(n, n), "values": values} for n, values in numbers.items()],
        "status": status.astype(int).ravel().tolist(),
        "reasons": [str(text) for text in variables["reason"][index].ravel()] if np.any(status > 1) else [],
        "states": list(STATUS_WORDS),
    }


def _thinned(shape: tuple[int, ...]) -> list[NDArray[np.int64]]:
    """Places along each axis, evenly, so that the cells are few enough; the longest axes are thinned first."""
    sizes = list(shape)
    while np.prod(sizes) > MOST_CELLS:
        longest = int(np.argmax(sizes))
        sizes[longest] = (sizes[longest] + 1) // 2
    return [np.unique(np.linspace(0, n - 1, m).round().astype(np.int64)) for n, m in zip(shape, sizes, strict=True)]


def _axis(name: str, values: NDArray[Any], words: str) -> dict[str, Any]:
    numbers = values.dtype.kind in "fi"
    shown = short_numbers(values) if numbers else [str(value) for value in values]
    return {"name": name, "words": words, "values": shown, "numbers": numbers}


# A map, a branch or a diagram in one file, written as the files of a run or a map that a page is made of --------------

EXPLORER_FILE_ACCEPTED = "accepted: a file of a branch, a diagram or a map"


def write_files(path: Path, directory: Path) -> None:
    """Write the netCDF files and the tables of a file's contents; raises ValueError for other contents."""
    if zipfile.is_zipfile(path):
        found = read_map(path)
        write_map(found.columns, directory / MAP_FILE, {"title": path.stem}, True)
        return
    result = read_result(path)
    branches = result.branches if isinstance(result, Diagram) else (result,)
    if not all(isinstance(branch, Branch) and len(branch) for branch in branches):
        raise ValueError(f"{path}: holds {short_repr(result)}; {EXPLORER_FILE_ACCEPTED}")
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


# The page of a run, a map, a branch or a diagram as one file ----------------------------------------------------------


def write_page(source: Path, target: Path) -> Path:
    """Write a page that shows the run or the map in a directory, or a map, a branch or a diagram in a file.

    Raises ValueError where there is none of these.
    """
    data, kind = _data_of_file(source) if source.is_file() else _data_in(source)
    folder = files("casadi_skin.runs.page")

    def text(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    page = text("page.html").replace("@BODY@", text(f"{kind}.html"))
    parts = {
        "@TITLE@": html.escape(str(data["title"])),
        "@PLOTLY@": text("plotly-basic.min.js").replace("</script", "<\\/script"),
        "@COMMON@": text("common.js"),
        "@SCRIPT@": text(f"{kind}.js"),
        "@DATA@": json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c"),
    }
    for mark, words in parts.items():
        page = page.replace(mark, words)
    with replacing(target) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return target


def _data_in(directory: Path) -> tuple[dict[str, Any], str]:
    """The contents of a page of a directory, and their kind."""
    return (map_data(directory), "map") if (directory / MAP_FILE).exists() else (page_data(directory), "run")


def _data_of_file(path: Path) -> tuple[dict[str, Any], str]:
    """The contents of a page of one file, which is written as a run or a map writes it, and read again."""

    folder = TemporaryFolder("casadi_skin_page_")
    try:
        write_files(path, folder.path)
        return _data_in(folder.path)
    finally:
        folder.remove()
