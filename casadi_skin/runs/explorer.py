"""The page of a run, a map, a branch or a diagram as one file: datasets as JSON, of a few hundred points each."""

from __future__ import annotations

import csv
import html
import json
import re
import zipfile
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatch
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.branch import Branch
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.files import replacing
from casadi_skin.results.dataset import Dataset, Variable, dataset_of, read_name, readable
from casadi_skin.results.quantities import places_of
from casadi_skin.results.saving import read_result
from casadi_skin.results.tables import event_rows
from casadi_skin.runs.map_result import NETCDF_FILE, STATUS_WORDS, read_map
from casadi_skin.runs.parts import mode_of

PAGE_FILE = "explore.html"
SHOWN_FILES = ("family.nc", "branch.nc", "cycles_*.nc", "other_*.nc", "curve_*.nc")
MOST_CURVE_POINTS = 3000  # of a curve
MOST_WAVE_NUMBERS = 400_000  # of wave forms, in all
WAVE_PHASES, WAVE_STATES = 49, 24  # of a wave form
MOST_CELLS = 40_000  # of a map, in all
CHANGE_NAME = "stability changes"
FILL_VALUE = 9e36  # values from here on are empty
NOT_CURVES = ("mode", "index", "requested", "stable", "fold", "start", "end")  # numbers of points without a curve
SKIPPED_COLUMNS = ("status", "reason", "regime")  # of maps
ACCEPTED_FOLDERS = f"accepted: the directory of a run, with one of {', '.join(SHOWN_FILES)}"
EXPLORER_FILE_ACCEPTED = "accepted: a file of a branch, a diagram or a map"

Array = NDArray[Any]
Contents = dict[str, Any]  # as JSON takes them


def write_page(source: Path, target: Path) -> Path:
    """Write a page that shows the run or the map in a directory, or a map, a branch or a diagram in a file.

    Raises ValueError where there is none of these.
    """
    if source.is_file() and zipfile.is_zipfile(source):
        data, kind = _of_map(source.name, read_map(source).dataset({"title": source.stem}, True)), "map"
    elif (source / NETCDF_FILE).exists():
        data, kind = map_data(source), "map"
    else:
        data, kind = _of_result(source) if source.is_file() else page_data(source), "run"
    folder = files("casadi_skin.runs.page")

    def text(name: str) -> str:
        return (folder / name).read_text(encoding="utf-8")

    page = text("page.html").replace("@BODY@", text(f"{kind}.html"))
    plotly = text("plotly-basic.min.js").replace("</script", "<\\/script")
    scripts = {"@PLOTLY@": plotly, "@COMMON@": text("common.js"), "@SCRIPT@": text(f"{kind}.js")}
    shown = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    parts = {**scripts, "@HASHES@": " ".join(map(_hash, scripts.values())), "@DATA@": shown}
    parts["@TITLE@"] = html.escape(str(data["title"]))
    page = re.sub("|".join(parts), lambda mark: parts[mark[0]], page)  # at once: a title may be a mark
    with replacing(target) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return target


def _hash(script: str) -> str:
    """A script as the policy of a page names it: the browser runs no other, and fetches nothing."""
    return f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'"


def read_dataset(path: Path) -> Dataset:
    """A netCDF file as a dataset: characters become texts, what is empty NaN."""
    from scipy.io import netcdf_file

    variables = list[Variable]()
    with netcdf_file(path, "r", mmap=False) as file:
        known: dict[str, Any] = vars(file)["_attributes"]
        attributes = {name: value.decode() for name, value in known.items() if isinstance(value, bytes)}
        for name, held in file.variables.items():
            values: Array = np.array(held[:])
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


def short_numbers(values: Array) -> list[float | None]:
    """Numbers with as many digits as a screen shows; None where there is none."""
    return [float(f"{v:.7g}") if np.isfinite(v) else None for v in np.asarray(values, dtype=float).ravel()]


# A run, or branches: curves, and wave forms and multipliers of a few hundred points of each ---------------------------


@dataclass(frozen=True)
class Part:
    """A branch of a page: its file, variables by name, kinds of special points along it, rows of events.csv."""

    path: Path
    name: str
    variables: Mapping[str, Array]
    kinds: Sequence[str]
    events: Sequence[Mapping[str, Any]]

    def __getitem__(self, name: str) -> Array:
        """Marks of points; zeros where the branch does not have them."""
        return self.variables.get(name, np.zeros(self.count, dtype=int))

    @property
    def count(self) -> int:
        """Number of points."""
        return int(self.variables["requested" if "requested" in self.variables else "mode"].size)


def page_data(directory: Path) -> Contents:
    """All that the page of a run shows; raises ValueError where the directory has no branches."""
    title, parts = "", list[Part]()
    for path in sorted(p for p in directory.glob("*.nc") if any(fnmatch(p.name, name) for name in SHOWN_FILES)):
        with readable(path):
            dataset, table = read_dataset(path), _rows(path.with_suffix(".csv"))
            title = title or dataset.attributes.get("title", "")
            kinds = [row["special"] for row in table if "special" in row]
            events = _rows(path.with_name("events.csv")) if path.stem == "family" else []
            parts += _parts(path, path.stem, dataset, kinds, events)
    if not parts:
        raise ValueError(f"{directory}: holds no branches; {ACCEPTED_FOLDERS}")
    return _contents(title or directory.name, parts)


def _of_result(path: Path) -> Contents:
    """The contents of a page of a branch or a diagram in a file; raises ValueError for other contents."""
    result = read_result(path)
    branches = getattr(result, "branches", (result,))
    if not all(isinstance(branch, Branch) and len(branch) for branch in branches):
        raise ValueError(f"{path}: holds {short_repr(result)}; {EXPLORER_FILE_ACCEPTED}")
    with readable(path):  # a field of it may be another one than the class has
        parts = [*_parts_of(path, branches)]
    return _contents(path.stem, parts)


def _parts_of(path: Path, branches: Sequence[Branch]) -> Iterator[Part]:
    for number, branch in enumerate(branches, start=1):
        family, rows = branch.space.is_family, list[Mapping[str, Any]]()
        name = f"other_{number}" if len(branches) > 1 else "family" if family else "branch"
        kinds = [] if family else [place.special or "" for place in places_of(branch)]
        if family and branch.diagram_of_changes is not None:
            rows += event_rows(mode_of(branch), branch.diagram_of_changes)
        yield from _parts(path, name, dataset_of([branch]), kinds, rows)


def _rows(path: Path) -> list[dict[str, str]]:
    """Rows of a table; none where there is no file."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _parts(
    path: Path, stem: str, dataset: Dataset, kinds: Sequence[str], events: Sequence[Mapping[str, Any]]
) -> Iterator[Part]:
    """The families of a dataset one by one; another branch as it is."""
    found = {variable.name: np.asarray(variable.values) for variable in dataset.variables}
    for name, values in found.items():
        if np.iscomplexobj(values):
            found[name] = np.stack([values.real, values.imag], axis=-1)
    whole = Part(path, stem.replace("_", " "), found, kinds, events)
    if "mode" not in found:
        yield whole
        return
    for mode in dict.fromkeys(found["mode"].tolist()):
        chosen = found["mode"] == mode
        mine = {n: v[chosen] if v.ndim and len(v) == chosen.size and n != "site" else v for n, v in found.items()}
        rows = [row for row in events if int(row["mode"]) == mode]
        yield replace(whole, name=f"mode {mode}", variables=mine, events=rows)


def _contents(title: str, parts: Sequence[Part]) -> Contents:
    share = max(MOST_WAVE_NUMBERS // (len(parts) * WAVE_PHASES * WAVE_STATES), 20)
    branches = list[Contents]()
    for part in parts:
        with readable(part.path):
            branches.append(_branch(part, share))
    thinned = [b for b in branches if b["count"] > len(b["columns"]["point"])]
    note = f"curves show {MOST_CURVE_POINTS} of the points of {len(thinned)} branches" if thinned else ""
    return {"title": title, "note": note, "branches": branches}


def _branch(part: Part, share: int) -> Contents:
    columns, special = _columns(part), _special(part)
    count = len(next(iter(columns.values())))
    requested = np.flatnonzero(part["requested"])

    def chosen(most: int) -> NDArray[np.int64]:
        """Places of at most so many points, evenly, with special and requested ones and both ends."""
        even = np.linspace(0, count - 1, min(count, most)).astype(int)
        marked = requested[:most], np.array(list(special)[:most], dtype=int)
        return np.unique(np.concatenate([even, *marked])).astype(np.int64)

    kept = chosen(MOST_CURVE_POINTS)
    x, y = ("S", "Omega") if "S" in columns else list(columns)[:2]
    shown = {"point": kept.tolist(), **{n: short_numbers(v[kept]) for n, v in columns.items()}}
    stable = part["stable"][kept].astype(int).tolist() if "stable" in part.variables else None
    marks = np.flatnonzero(part["requested"][kept]).tolist()
    listed, detail = _listed(part, columns, x, kept, special), _detail(part.variables, chosen(share), kept)
    known = {"name": part.name, "count": count, "x": x, "y": y, "columns": shown, "stable": stable}
    return known | {"requested": marks, "special": listed, "detail": detail}


def _columns(part: Part) -> dict[str, Array]:
    """Quantities that are one number a point, the followed one first; of a state that moves its largest value."""
    variables = part.variables
    parameters = [(str(n), variables["parameters"][:, i]) for i, n in enumerate(variables.get("parameter_name", ()))]
    found = dict(sorted(parameters, key=lambda pair: -float(np.ptp(pair[1])) / (abs(float(pair[1][0])) or 1.0)))
    for i, name in enumerate(str(n) for n in variables.get("state_name", ())):
        found.setdefault(name, variables["largest" if "largest" in variables else "states"][:, i])
    if "end" in variables and "phase" in variables:
        found["period"] = variables["end"] - variables["start"]
    for name, values in variables.items():
        along = values.ndim == 1 and values.size == part.count and values.dtype.kind in "fi"
        if along and name not in NOT_CURVES and not name.endswith("_name"):
            found[name] = values.astype(float)
    return found


def _special(part: Part) -> dict[int, str]:
    """Kinds of special points by their place; changes of stability where nothing else is known."""
    found = dict.fromkeys(np.flatnonzero(part["fold"]).tolist(), "fold")
    found |= {i: kind for i, kind in enumerate(part.kinds) if kind}
    near = {j for i in found for j in (i - 1, i, i + 1)}
    changes = np.flatnonzero(np.diff(part["stable"].astype(int))).tolist()
    return dict(sorted((found | {i + 1: CHANGE_NAME for i in changes if not near & {i, i + 1}}).items()))


def _listed(
    part: Part, columns: Mapping[str, Array], x: str, kept: NDArray[np.int64], special: Mapping[int, str]
) -> list[Contents]:
    """Special points by place, between points too, with the nearest point kept and words for a list."""
    places = [(float(i), kind, columns[x][i]) for i, kind in special.items() if kind != CHANGE_NAME or not part.events]
    for row in part.events:
        S, Omega = (float(row[name]) if row[name] != "" else np.nan for name in ("S", "Omega"))
        places.append((_between(columns["S"], columns["Omega"], S, Omega), _event_words(row), S))
    found = []
    for place, kind, value in sorted(places, key=lambda known: known[0]):
        after = int(np.clip(np.searchsorted(kept, place), 1, kept.size - 1))
        where = float(after - 1 + (place - kept[after - 1]) / float(kept[after] - kept[after - 1]))
        label = f"{kind}: {x} = {value:.8g}" if np.isfinite(value) else kind
        found.append({"point": round(where), "place": round(where, 4), "kind": kind, "label": label})
    return found


def _event_words(row: Mapping[str, Any]) -> str:
    """A row of events.csv in words: a change of stability, or a stretch on which some may be missing."""
    if row["stable_before"] == "":  # the row of a stretch, as "unresolved"
        where = "somewhere along the family" if row["S_width"] == "" else f"over {float(row['S_width']):.3g} in S"
        return f"{row['kind']}, changes of stability may be missing {where}"
    words = {(1, 0): "stability lost", (0, 1): "stability regained"}
    return f"{words[int(row['stable_before']), int(row['stable_after'])]} ({row['kind']})"


def _between(S: Array, Omega: Array, at: float, height: float) -> float:
    """The place between two points of a family at which it passes an amplitude, the nearest in frequency if known."""
    k = np.flatnonzero((S[:-1] - at) * (S[1:] - at) <= 0.0)
    if not k.size:
        return float(np.argmin(np.abs(S - at)))  # the first point where the amplitude is not known
    part = (at - S[k]) / np.where(S[k + 1] == S[k], 1.0, S[k + 1] - S[k])
    best = int(np.argmin(np.abs(Omega[k] + part * (Omega[k + 1] - Omega[k]) - height)))
    return float(k[best] + part[best])


def _detail(variables: Mapping[str, Array], chosen: NDArray[np.int64], kept: NDArray[np.int64]) -> Contents:
    """Wave forms over the period and multipliers of chosen points, by their place among those kept."""
    chosen = chosen[np.isin(chosen, kept)]
    detail: Contents = {"point": np.searchsorted(kept, chosen).tolist(), "names": [], "waves": None}
    for name in ("multipliers", "eigenvalues"):
        if name in variables:
            detail[name] = [short_numbers(pairs) for pairs in variables[name][chosen].reshape(chosen.size, -1)]
    if "coefficients" in variables:
        names = [f"y_{n}" for n in variables["site"].tolist()]
        c, phases = variables["coefficients"][chosen], np.linspace(0.0, 1.0, WAVE_PHASES)
        waves = np.einsum("tk,pks->pts", np.cos(2 * np.pi * np.outer(phases, 2 * np.arange(c.shape[1]) + 1)), c)
    elif "profile" in variables and variables["profile"].ndim == 3:
        places = np.linspace(0, variables["profile"].shape[1] - 1, WAVE_PHASES).astype(int)
        waves, names = variables["profile"][chosen][:, places], [str(n) for n in variables["state_name"]]
    else:
        return detail
    moving = np.sort(np.argsort(-np.max(np.ptp(waves, axis=1), axis=0), kind="stable")[:WAVE_STATES])
    detail["waves"] = [[short_numbers(state) for state in wave[:, moving].T] for wave in waves]
    detail["names"] = [names[i] for i in moving]
    return detail


# A map: quantities over its axes, thinned where there are too many cells ----------------------------------------------


def map_data(directory: Path) -> Contents:
    """All that the page of a map shows; raises ValueError where the map has no cells."""
    with readable(directory / NETCDF_FILE):
        dataset = read_dataset(directory / NETCDF_FILE)
        if {v.name: v for v in dataset.variables}["status"].values.size:
            return _of_map(directory.name, dataset)
    raise ValueError(f"{directory}: a map without cells; accepted: one with at least one")


def _of_map(name: str, dataset: Dataset) -> Contents:
    held = {variable.name: variable for variable in dataset.variables}
    axes, shape = held["status"].dimensions, held["status"].values.shape
    sizes = list(shape)
    while np.prod(sizes) > MOST_CELLS:  # the longest axes are thinned first
        longest = int(np.argmax(sizes))
        sizes[longest] = (sizes[longest] + 1) // 2
    chosen = [np.unique(np.linspace(0, n - 1, m).round().astype(np.int64)) for n, m in zip(shape, sizes, strict=True)]
    index = np.ix_(*chosen)
    status, count = held["status"].values[index], held["status"].values.size
    quantities = [v for v in held.values() if v.dimensions == axes and v.name not in SKIPPED_COLUMNS and _counts(v)]
    return {
        "title": dataset.attributes.get("title", "") or name,
        "note": f"{status.size} of {count} cells are shown" if status.size < count else "",
        "axes": [{**_shown(held[n], k), "numbers": _counts(held[n])} for n, k in zip(axes, chosen, strict=True)],
        "quantities": [_shown(variable, index) for variable in quantities],
        "status": status.astype(int).ravel().tolist(),
        "reasons": [str(text) for text in held["reason"].values[index].ravel()] if np.any(status > 1) else [],
        "states": list(STATUS_WORDS),
    }


def _counts(variable: Variable) -> bool:
    """Whether its values are numbers."""
    return variable.values.dtype.kind in "fi"


def _shown(variable: Variable, places: Any) -> Contents:
    values = variable.values[places]
    shown = short_numbers(values) if _counts(variable) else [str(value) for value in values]
    return {"name": variable.name, "words": variable.meaning, "values": shown}
