"""The page of a run, a map, a branch or a diagram as one file: datasets as JSON, of a few hundred points each."""

from __future__ import annotations

import csv
import html
import json
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatch
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.branch import Branch
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.files import replacing
from casadi_skin.points.diagram import Diagram
from casadi_skin.results.dataset import Dataset, Variable, dataset_of, read_name, readable
from casadi_skin.results.quantities import places_of
from casadi_skin.results.saving import read_result
from casadi_skin.results.tables import event_rows
from casadi_skin.runs.map_result import STATUS_WORDS, read_map
from casadi_skin.runs.parts import mode_of

PAGE_FILE = "explore.html"
SHOWN_FILES = ("family.nc", "branch.nc", "cycles_*.nc", "other_*.nc", "curve_*.nc")
MOST_CURVE_POINTS = 3000  # of a curve
MOST_WAVE_NUMBERS = 400_000  # of wave forms, in all
WAVE_PHASES, WAVE_STATES = 49, 24  # of a wave form
CHANGE_NAME = "stability changes"
FILL_VALUE = 9e36  # values from here on are empty
ACCEPTED_FOLDERS = f"accepted: the directory of a run, with one of {', '.join(SHOWN_FILES)}"
EXPLORER_FILE_ACCEPTED = "accepted: a file of a branch, a diagram or a map"

Variables = Mapping[str, NDArray[Any]]
Contents = dict[str, Any]  # as JSON takes them


def write_page(source: Path, target: Path) -> Path:
    """Write a page that shows the run or the map in a directory, or a map, a branch or a diagram in a file.

    Raises ValueError where there is none of these.
    """
    data, kind = _of_file(source) if source.is_file() else _of_directory(source)
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


def _of_directory(directory: Path) -> tuple[Contents, str]:
    """The contents of a page of a directory, and their kind."""
    return (map_data(directory), "map") if (directory / MAP_FILE).exists() else (page_data(directory), "run")


def _of_file(path: Path) -> tuple[Contents, str]:
    """The contents of a page of a result in one file; raises ValueError for other contents."""
    if zipfile.is_zipfile(path):
        return _map_contents(path.name, read_map(path).dataset({"title": path.stem}, True)), "map"
    result = read_result(path)
    branches = result.branches if isinstance(result, Diagram) else (result,)
    if not all(isinstance(branch, Branch) and len(branch) for branch in branches):
        raise ValueError(f"{path}: holds {short_repr(result)}; {EXPLORER_FILE_ACCEPTED}")
    parts = list[tuple[Path, str, Variables]]()
    for number, branch in enumerate(branches, start=1):
        family = branch.space.is_family
        name = f"other_{number}" if len(branches) > 1 else "family" if family else "branch"
        rows: Sequence[Mapping[str, Any]] = ()
        kinds = None if family else [place.special or "" for place in places_of(branch)]
        if family and branch.diagram_of_changes is not None:
            rows = event_rows(mode_of(branch), branch.diagram_of_changes)
        parts += [(path, *part) for part in _split(name, _variables(dataset_of([branch]), kinds, rows))]
    return _run_contents(path.stem, parts), "run"


def read_dataset(path: Path) -> Dataset:
    """A netCDF file as a dataset: characters become texts, what is empty NaN."""
    from scipy.io import netcdf_file

    variables = list[Variable]()
    with netcdf_file(path, "r", mmap=False) as file:
        known: dict[str, Any] = vars(file)["_attributes"]
        attributes = {name: value.decode() for name, value in known.items() if isinstance(value, bytes)}
        for name, held in file.variables.items():
            values: NDArray[Any] = np.array(held[:])
            words = held.long_name.decode() if hasattr(held, "long_name") else read_name(name)
            if values.dtype.kind == "S":
                rows = values.reshape(-1, values.shape[-1])
                texts = [b"".join(row).decode().rstrip("\0 ") for row in rows]
                values = np.array(texts).reshape(values.shape[:-1])
            elif values.dtype.kind == "f":
                values = np.where(np.abs(values) > FILL_VALUE, np.nan, values).astype(float)
            dimensions = tuple(map(read_name, held.dimensions))
            variables.append(Variable(read_name(name), dimensions, values, words))
    return Dataset(variables, attributes)


# A run, or branches: curves, and wave forms and multipliers of a few hundred points of each ---------------------------


def page_data(directory: Path) -> Contents:
    """All that the page of a run shows; raises ValueError where the directory has no branches."""
    names = sorted(path for path in directory.glob("*.nc") if any(fnmatch(path.name, name) for name in SHOWN_FILES))
    title, parts = "", list[tuple[Path, str, Variables]]()
    for path in names:
        with readable(path):
            dataset, table = read_dataset(path), _rows(path.with_suffix(".csv"))
            title = title or dataset.attributes.get("title", "")
            kinds = [row["special"] for row in table] if table and "special" in table[0] else None
            events = _rows(path.with_name("events.csv")) if path.stem == "family" else []
            parts += [(path, *part) for part in _split(path.stem, _variables(dataset, kinds, events))]
    if not parts:
        raise ValueError(f"{directory}: holds no branches; {ACCEPTED_FOLDERS}")
    return _run_contents(title or directory.name, parts)


def _run_contents(title: str, parts: Sequence[tuple[Path, str, Variables]]) -> Contents:
    """Branches by name, each with the file that messages blame."""
    share = max(MOST_WAVE_NUMBERS // (len(parts) * WAVE_PHASES * WAVE_STATES), 20)
    branches = list[Contents]()
    for path, name, part in parts:
        with readable(path):
            branches.append(_branch(name, part, share))
    thinned = [b for b in branches if b["count"] > len(b["columns"]["point"])]
    note = f"curves show {MOST_CURVE_POINTS} of the points of {len(thinned)} branches" if thinned else ""
    return {"title": title, "note": note, "branches": branches}


def _rows(path: Path) -> list[dict[str, str]]:
    """Rows of a table; none where there is no file."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _variables(dataset: Dataset, kinds: Iterable[str] | None, events: Sequence[Mapping[str, Any]]) -> Variables:
    """Variables by name, with kinds of special points and changes of stability, which stand in tables beside them."""
    found = {variable.name: np.asarray(variable.values) for variable in dataset.variables}
    for name, values in found.items():
        if np.iscomplexobj(values):
            found[name] = np.stack([values.real, values.imag], axis=-1)
    if kinds is not None:
        found["special"] = np.array(list(kinds))
    if events:
        found["event_mode"] = np.array([int(row["mode"]) for row in events], dtype=int)
        for name in ("S", "Omega"):
            found[f"event_{name}"] = np.array([float(row[name] if row[name] != "" else "nan") for row in events])
        found["event_words"] = np.array([_event_words(row) for row in events], dtype=str)
    return found


def _event_words(row: Mapping[str, Any]) -> str:
    """A row of events.csv in words: a change of stability, or a stretch on which some may be missing."""
    if row["stable_before"] == "":  # the row of a stretch, as "unresolved"
        where = "somewhere along the family" if row["S_width"] == "" else f"over {float(row['S_width']):.3g} in S"
        return f"{row['kind']}, changes of stability may be missing {where}"
    words = {(1, 0): "stability lost", (0, 1): "stability regained"}
    return f"{words[int(row['stable_before']), int(row['stable_after'])]} ({row['kind']})"


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
SKIPPED_COLUMNS = ("status", "reason", "regime")


def map_data(directory: Path) -> Contents:
    """All that the page of a map shows; raises ValueError where the map has no cells."""
    with readable(directory / MAP_FILE):
        dataset = read_dataset(directory / MAP_FILE)
        empty = not next(v for v in dataset.variables if v.name == "status").values.size
    if empty:
        raise ValueError(f"{directory}: a map without cells; accepted: one with at least one")
    with readable(directory / MAP_FILE):
        return _map_contents(directory.name, dataset)


def _map_contents(name: str, dataset: Dataset) -> Contents:
    held = {variable.name: variable for variable in dataset.variables}
    axes, shape = held["status"].dimensions, held["status"].values.shape
    chosen = _thinned(shape)
    index = np.ix_(*chosen)
    status = held["status"].values[index]
    numbers = [
        {"name": v.name, "words": v.meaning, "values": short_numbers(v.values.astype(float)[index])}
        for v in held.values()
        if v.dimensions == axes and v.name not in SKIPPED_COLUMNS and v.values.dtype.kind in "fi"
    ]
    left = status.size < held["status"].values.size
    return {
        "title": dataset.attributes.get("title", "") or name,
        "note": f"{status.size} of {held['status'].values.size} cells are shown" if left else "",
        "axes": [_axis(held[n], places) for n, places in zip(axes, chosen, strict=True)],
        "quantities": numbers,
        "status": status.astype(int).ravel().tolist(),
        "reasons": [str(text) for text in held["reason"].values[index].ravel()] if np.any(status > 1) else [],
        "states": list(STATUS_WORDS),
    }


def _thinned(shape: tuple[int, ...]) -> list[NDArray[np.int64]]:
    """Places along each axis, evenly, so that the cells are few enough; the longest axes are thinned first."""
    sizes = list(shape)
    while np.prod(sizes) > MOST_CELLS:
        longest = int(np.argmax(sizes))
        sizes[longest] = (sizes[longest] + 1) // 2
    return [np.unique(np.linspace(0, n - 1, m).round().astype(np.int64)) for n, m in zip(shape, sizes, strict=True)]


def _axis(axis: Variable, places: NDArray[np.int64]) -> Contents:
    values = axis.values[places]
    numbers = values.dtype.kind in "fi"
    shown = short_numbers(values) if numbers else [str(value) for value in values]
    return {"name": axis.name, "words": axis.meaning, "values": shown, "numbers": numbers}
