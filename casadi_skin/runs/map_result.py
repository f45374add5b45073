"""A map: the finished cells in its journals, quantities over its axes as columns on the disk, its files and pictures.

One journal of a map that one process drives, one for each part of a batch array; all are read, one's own is written.
Columns are on the disk as well: tables and pictures of any number of cells need no more memory.
"""

from __future__ import annotations

import csv
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatch
from functools import partial
from hashlib import sha256
from itertools import islice, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from casadi_skin.fmu.unzip import Archive
from casadi_skin.model.arguments import check_name, cut, file_path, new_file, short_repr
from casadi_skin.model.files import TemporaryFolder, replacing
from casadi_skin.model.result import WithVerbs, in_turn, renamed
from casadi_skin.results import present
from casadi_skin.results.dataset import (
    LARGEST_WHOLE_NUMBER,
    Dataset,
    Variable,
    on_disk,
    to_xarray,
    write_csv,
    write_netcdf,
)
from casadi_skin.results.figures.map import MapAxis, Panel, draw_maps, map_figure, panel_title
from casadi_skin.results.figures.style import save
from casadi_skin.results.quantities import Cell
from casadi_skin.results.store import Journal, mapped, record_at, scan
from casadi_skin.results.words import Columns, Shown, listed, show
from casadi_skin.runs.directory import SCENE_FILE, DirectoryError
from casadi_skin.runs.map_cell import BY, FAMILY_SUFFIX, FAULTS, OUTSIDE_FAULTS, TEXTS, WATCHED, Result, Row, Value
from casadi_skin.runs.map_grid import UNKNOWN_LABEL, Axis, Cells, Grid, Labels, Task, needed
from casadi_skin.runs.output import Progress
from casadi_skin.runs.reading import parse_scene, read_text
from casadi_skin.runs.rules import SceneError
from casadi_skin.runs.scene import Scene

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


class TaskRecord(msgspec.Struct, frozen=True, tag="task"):
    """A finished task in the journal, with the number of the attempt, and the cell whose solution it started from."""

    cells: tuple[int, ...]
    attempt: int
    seconds: float
    rows: tuple[Row, ...] = ()
    kind: str = ""
    reason: str = ""
    neighbour: int = -1


class MapHead(msgspec.Struct, frozen=True, tag="map"):
    """The first record of a journal: a digest of the scene whose map it is of."""

    digest: bytes


class MeaningsRecord(msgspec.Struct, frozen=True, tag="meanings"):
    """Meanings of quantities by name, in the order in which they came."""

    meanings: dict[str, str]


MapRecord = TaskRecord | MeaningsRecord | MapHead
RECORD_DECODER = msgspec.msgpack.Decoder(MapRecord)
CSV_FILE, NETCDF_FILE, BOUNDARY_FILE, JOURNAL_PATTERN = "map.csv", "map.nc", "boundary.csv", "journal*.msgpack"
MAP_PARTS = (SCENE_FILE, JOURNAL_PATTERN, BOUNDARY_FILE)  # of a map in one file, which is read as its directory is
FILE_DATE = (1980, 1, 1, 0, 0, 0)  # so that the bytes depend on the map alone
UNKNOWN, DONE, ENDED, FAILED = 0, 1, 2, 3  # states of a cell
STATUS_WORDS = ("not computed", "done", "ended early", "failed")  # by state
MOST_ATTEMPTS = 2  # at a cell
CELLS_OF_ONE_SAMPLE, MOST_SAMPLES = 50, 8  # of so many cells one is computed again by --resume, and no more
SMALLEST = np.finfo(float).tiny
REASON, STARTED_FROM = "reason", "started_from"
OF_BOUNDARY = ("stable", "first_instability", "first_tongue")  # quantities that locate a boundary of stability
NOT_DRAWN = ("points", "at_round_off", "residual", "profile_error", "S_error", "intervals")
CHAIN_MEANINGS = {"sites": "number of sites", "N": "number of sites", "alpha": "on-site stiffness",
                  "gamma": "nonreciprocity", "g": "cubic on-site coefficient", "S": "total amplitude: sum of y_n^2 at "
                  "t = 0", "mode": "linear mode by ascending frequency"}  # fmt: skip
Lines = Mapping[tuple[int, ...], tuple[NDArray[np.float64], ...]]  # of a boundary, by the places of other axes


def digest(scene: Scene) -> bytes:
    """Digest of a scene in its journal: the same for the same cells with the same results."""
    requested = msgspec.to_builtins(msgspec.structs.replace(scene, title=""))
    del requested["time_limit"]
    return sha256(msgspec.json.encode(requested, order="sorted")).digest()


class Map(WithVerbs):
    """Quantities of a scene over its parameters; a context manager while its journal is written.

    Attributes:
        directory: where its journals, tables and pictures are.
        grid: its cells.
        states: of cells, shape (cells,): UNKNOWN, DONE, ENDED where its branch ended early, or FAILED.
        attempts: at cells, shape (cells,).
        columns: quantities by name, on the disk; NaN where there is none, texts as places among the different ones;
            shape (cells,).
        meanings: of quantities by name.
        seconds, finished: time that tasks took, and number of cells that they gave, in all journals.
        waits: whether shares of a batch array are not there yet.
        boundary: lines of changes of stability in the plane of the ranges, shape (points, 2) each, by the places of
            the other axes.
        folder: the temporary folder of a map that was read from one file; None of one in its directory.
    """

    waits = False
    folder: TemporaryFolder | None = None

    def __init__(
        self, directory: Path, grid: Grid, scene: Scene, own: str | None, report: Callable[[str], None]
    ) -> None:
        """Read the journals of a directory; `own` is the name of the one that is written, None where none is."""
        self.directory, self.grid, table = directory, grid, scene.map
        assert table is not None
        watched = table.watch or WATCHED
        self.boundary: Lines = {}
        self._levels = watched if isinstance(watched, Mapping) else dict.fromkeys(watched, ())
        wanted = self._wanted = None if table.quantities is None else {*table.quantities, STARTED_FROM}
        others = {REASON, *OF_BOUNDARY, *(self._levels if grid.refined else ())}
        self._kept = None if wanted is None else wanted | others  # names of columns, but for all of them
        self._head, size = MapHead(digest(scene)), grid.size
        self.states, self.attempts = np.zeros(size, dtype=np.int8), np.zeros(size, dtype=np.int8)
        self._places, self._sources = np.zeros(size, dtype=np.int64), np.zeros(size, dtype=np.int16)
        self._outside, self._axes = np.zeros(size, dtype=bool), {axis.name for axis in grid.axes}
        self.columns, self._kinds = dict[str, NDArray[np.float64]](), dict[str, type]()
        self._texts, self._first = {"": 0}, dict[str, tuple[int, int]]()
        self.meanings = {STARTED_FROM: "the cell whose solution the second start began at",
                         REASON: "why a cell failed, or ended early"}  # fmt: skip
        self.seconds, self.finished = 0.0, 0
        self._ends = dict[Path, int]()  # how far each journal is read
        self._faults = list[str]()  # records that no task of this map gives
        self._journal: Journal[MapRecord] | None = None
        if own is not None:
            self._ends[directory / own] = 0
            self._journal = Journal(directory / own, RECORD_DECODER, partial(self._read, 0))
            if self._journal.fault:
                report(f"{directory / own}: {self._journal.fault}; what follows it is dropped and computed again")
            if self._journal.end == 0:
                self._append(self._head)
        for path, fault in self.refresh().items():
            report(f"{path}: {fault}; what follows it is not read")
        if self._faults:
            more = f", and {len(self._faults) - 1} more" if len(self._faults) > 1 else ""
            report(f"{self._faults[0]}{more}: such cells are not believed, and computed again by --resume")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._journal is not None:
            self._journal.__exit__()

    # Records of tasks -------------------------------------------------------------------------------------------------

    def refresh(self) -> dict[Path, str]:
        """Read new records of other parts; returns where they end before the end of a journal, and why."""
        faults = dict[Path, str]()
        for path in sorted(self.directory.glob(JOURNAL_PATTERN)):
            self._ends.setdefault(path, 0)
        for number, path in enumerate(self._ends):
            if self._journal is None or number > 0:
                with mapped(path) as data:  # one that is being written may end in a part of a record
                    self._ends[path], fault = scan(data, RECORD_DECODER, partial(self._read, number), self._ends[path])
                if fault:
                    faults[path] = fault
        return faults

    def add(self, task: Task, attempt: int, result: Result) -> None:
        """Keep the result of a task; raises OSError where it cannot be written."""
        new = {name: words for name, words in result.meanings.items() if name not in self.meanings}
        if new:
            self._append(MeaningsRecord(new))
        given = result.seconds, result.rows, result.kind, result.reason, task.neighbour
        self._append(TaskRecord(task.cells, attempt, *given))

    def _append(self, record: MapRecord) -> None:
        assert self._journal is not None
        place = self._journal.end
        self._journal.append(record)
        self._index(0, place, record)

    def _read(self, source: int, place: int, record: MapRecord) -> None:
        """Take a record of a journal, unless it is none that a task of this map gives."""
        fault = self._fault(record) if isinstance(record, TaskRecord) else ""
        if fault:
            self._faults.append(f"{list(self._ends)[source]}: {fault} at byte {place}")
        else:
            self._index(source, place, record)

    def _fault(self, record: TaskRecord) -> str:
        """Why the record of a task is none, in words; empty where it is one."""
        cells, size = np.array(record.cells, dtype=np.int64), self.grid.size
        if not (cells.size and 0 <= cells.min() <= cells.max() < size):
            return "cells that the map does not have"
        where, numbers = self.grid.name(record.cells[0]), [record.seconds]
        together = np.unique(self.grid.families(cells)).size == 1 and np.unique(cells).size == cells.size
        known = 1 <= record.attempt <= MOST_ATTEMPTS and record.kind in FAULTS and -1 <= record.neighbour < size
        if not (together and known and len(record.rows) == (0 if record.kind else cells.size)):
            return f"{where}: a record that no task gives"
        for row in record.rows:
            numbers += [*row.state, row.period]
            for name, value in row.values.items():
                if isinstance(value, str) != (FAMILY_SUFFIX.sub("", name) in TEXTS):
                    return f"{where}: {name} = {short_repr(value)}"
                numbers += [] if isinstance(value, str) else [value]
        return "" if np.all(np.isfinite(numbers)) else f"{where}: a number that is not finite"

    def sample(self) -> Iterator[TaskRecord]:
        """Records of the cells that stand out most among all: the first to be computed again, to see if they hold."""
        done = np.flatnonzero((self.states == DONE) & (self.attempts == 1))
        scores = [_apart(v[done]) for name, v in self.columns.items() if self._kinds[name] is float and compared(name)]
        if not (scores and done.size):
            return
        order = done[np.argsort(-np.max(scores, axis=0), kind="stable")]
        for cell in order[: min(1 + done.size // CELLS_OF_ONE_SAMPLE, MOST_SAMPLES)]:
            yield self._record(cell)

    def _index(self, source: int, place: int, record: MapRecord) -> None:
        if place == 0 and record != self._head:
            words = "accepted: that of this scene, or --overwrite"
            raise DirectoryError(f"{list(self._ends)[source]}: is the journal of another scene; {words}")
        if isinstance(record, MeaningsRecord):
            self.meanings = {**record.meanings, **self.meanings}
        elif isinstance(record, TaskRecord):
            self._index_task(source, place, record)

    def _index_task(self, source: int, place: int, record: TaskRecord) -> None:
        cells = np.array(record.cells, dtype=np.int64)
        self.seconds, self.finished = self.seconds + record.seconds, self.finished + cells.size
        if record.kind and np.any((self.states[cells] == DONE) | (self.states[cells] == ENDED)):
            return  # another part has computed them
        self._places[cells], self._sources[cells] = place, source
        self.attempts[cells] = record.attempt
        self._outside[cells] = record.kind in OUTSIDE_FAULTS
        for i, cell in enumerate(record.cells):
            row = Row({}, record.reason) if record.kind else record.rows[i]
            failed = record.kind or (row.fault and not row.values)
            self.states[cell] = FAILED if failed else ENDED if row.fault else DONE
            has_start = record.neighbour >= 0 and row.values
            start = {STARTED_FROM: self.grid.name(record.neighbour)} if has_start else {}
            self._put(cell, {**row.values, **start, REASON: row.fault})

    def _put(self, cell: int, values: Mapping[str, Value]) -> None:
        """Put values of a cell into the columns, each made with its first value."""
        for place, (name, value) in enumerate(values.items()):
            if name in self._axes or not (self._kept is None or name in self._kept):
                continue
            if name not in self.columns:
                self.columns[name], self._kinds[name] = on_disk(np.float64, (self.grid.size,)), type(value)
                self.columns[name][:] = np.nan
            self._first[name] = min(self._first.get(name, (cell, place)), (cell, place))
            number = self._texts.setdefault(value, len(self._texts)) if isinstance(value, str) else value
            self.columns[name][cell] = number

    def forget_outside(self, mine: bool = False) -> None:
        """Take cells that failed for reasons outside of their computation as not computed; of a share its own alone."""
        chosen = self._outside & (self._sources == 0) if mine else self._outside
        self.states[chosen] = self.attempts[chosen] = UNKNOWN
        if REASON in self.columns:
            self.columns[REASON][chosen] = np.nan
        self._outside[chosen] = False

    def start(self, cell: int) -> tuple[tuple[float, ...], float]:
        """State and period of the solution of a computed cell, at which that of a neighbour may start."""
        record = self._record(cell)
        row = record.rows[record.cells.index(cell)]
        return row.state, row.period

    def _record(self, cell: int) -> TaskRecord:
        """The record of a computed cell."""
        with mapped(list(self._ends)[self._sources[cell]]) as data:
            record: Any = record_at(data, int(self._places[cell]), RECORD_DECODER)[0]
        return record  # type: ignore[no-any-return]

    # What is known of cells -------------------------------------------------------------------------------------------

    def final(self, cells: Cells | slice = slice(None)) -> NDArray[np.bool_]:
        """Whether nothing is left to do at each of the cells."""
        states, tried = self.states[cells], self.attempts[cells] >= MOST_ATTEMPTS
        return np.asarray((states == DONE) | (states == ENDED) | ((states == FAILED) & tried))

    def may_recover(self, cell: int) -> bool:
        """Whether a cell failed for a reason outside of its computation, which another attempt may not meet."""
        return bool(self._outside[cell])

    @property
    def complete(self) -> bool:
        """Whether every cell is computed, or was tried twice."""
        return not needed(self.grid, self.labels()).size

    def labels(self) -> Labels:
        """Labels of cells: the same where a map that is refined shows the same behaviour, and UNKNOWN_LABEL."""
        labels, known = np.full(self.grid.size, UNKNOWN_LABEL, dtype=np.int32), np.flatnonzero(self.final())
        labels[known] = 0
        if self.grid.refined and known.size:
            watched = [self._watched(name, levels, known) for name, levels in self._levels.items()]
            behaviour = np.stack([self.states[known].astype(float), *watched], axis=-1)
            labels[known] = np.unique(behaviour, axis=0, return_inverse=True)[1].ravel()
        return labels.reshape(self.grid.shape)

    def _watched(self, name: str, levels: Sequence[float], cells: Cells) -> NDArray[np.float64]:
        """A word or a whole number itself, a number by the levels that it is above; -inf where there is none."""
        if name not in self.columns:
            return np.zeros(cells.size)
        values, kind = self.columns[name][cells], self._kinds[name]
        itself = kind is str or (kind is int and not levels)
        found = values if itself else np.sum([values > at for at in levels or ()], axis=0)
        return np.where(np.isnan(values), -np.inf, found)

    @property
    def axes(self) -> Mapping[str, NDArray[Any]]:
        """Values along each axis by name."""
        return {axis.name: np.array(axis.values) for axis in self.grid.axes}

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each axis."""
        return self.grid.shape

    @property
    def status(self) -> NDArray[np.int8]:
        """0 of a cell that is not computed, 1 done, 2 where a branch ended early, 3 failed; shape as the axes."""
        return self.states.reshape(self.shape)

    @property
    def known(self) -> list[int]:
        """Flat numbers of the cells that are computed."""
        return np.flatnonzero(self.states != UNKNOWN).tolist()

    def failures(self, most: int | None = None) -> list[tuple[str, str]]:
        """Cells that failed or ended early, in words, each with its reason; no more than `most` of them."""
        cells = np.flatnonzero(self.states >= ENDED)[:most].tolist()
        return list(zip(map(self.grid.name, cells), map(str, self.cells(REASON, cells)), strict=True))

    @property
    def names(self) -> list[str]:
        """Names of the quantities, in the order in which cells have them."""
        asked = (name for name in self.meanings if BY in name) if self._wanted is None else self._wanted
        absent = {*asked} - {*self._first, *self._axes, STARTED_FROM}  # of which no cell has a number
        known = [n for n in self._first if n != REASON and (self._wanted is None or n in self._wanted)]
        return [*sorted(known, key=lambda name: (name == STARTED_FROM, self._first[name])), *sorted(absent)]

    def is_text(self, name: str) -> bool:
        """Whether a quantity, or the reasons why cells failed, are texts."""
        return name == REASON or self._kinds.get(name) is str or FAMILY_SUFFIX.sub("", name) in TEXTS

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Values of a quantity by name, shape as the axes: NaN or an empty text where there is none.

        Raises ValueError, with the nearest known name, for an unknown one.
        """
        check_name("quantity", name, self.names)
        return np.array(self.values(name))

    def values(self, name: str) -> NDArray[Any]:
        """Values of a quantity, or reasons why cells failed, as they are on the disk; shape as the axes."""
        values: NDArray[Any] = self.columns.get(name, np.full(self.grid.size, np.nan))
        if self.is_text(name):
            values = np.array([*self._texts], dtype=object)[np.nan_to_num(values).astype(int)]
        return np.asarray(values.reshape(self.shape))

    def cells(self, name: str, cells: Sequence[int]) -> Iterator[Cell]:
        """Values of a quantity at cells as a table has them: nothing for NaN, a whole number where all of them are."""
        if self.is_text(name):
            return iter(self.values(name).ravel()[cells])
        values = self.values(name).ravel()
        known = values[np.isfinite(values)]
        whole = bool(np.all(known == np.round(known)) and np.all(np.abs(known) < LARGEST_WHOLE_NUMBER))
        found = (float(values[cell]) for cell in cells)
        return ("" if math.isnan(value) else int(value) if whole else value for value in found)

    # A map as a result ------------------------------------------------------------------------------------------------

    def summary(self) -> str:
        """The numbers of cells in words."""
        counts, mean = np.bincount(self.states, minlength=len(STATUS_WORDS)), self.seconds / max(self.finished, 1)
        words = [f"{counts[s]} {STATUS_WORDS[s]}" for s in (DONE, ENDED, FAILED) if counts[s]]
        of = f" of {self.grid.size} at the finest" if self.grid.refined else ""
        return f"{counts[DONE:].sum()} cells{of}: {', '.join(words) or 'none'}; {mean:.3g} s a cell"

    def __repr__(self) -> str:
        sizes = " x ".join(f"{len(axis.values)} {axis.name}" for axis in self.grid.axes)
        return f"<Map: {sizes}; {self.summary()}>"

    def save(self, path: str | Path) -> Path:
        """Write the map to one file, from which `casadi_skin.read_map` reads it with the same bits.

        Raises ValueError for the path of a directory or in none, OSError where the file cannot be written.
        """
        target = new_file("path", path)
        with replacing(target) as temporary, zipfile.ZipFile(temporary, "w") as archive:
            for part in sorted(p for p in self.directory.iterdir() if _is_part(p.name)):
                entry = zipfile.ZipInfo(part.name, FILE_DATE)
                entry.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(entry, part.read_bytes())
        return target

    to_dataframe: ClassVar[Callable[..., pandas.DataFrame]]
    """A pandas DataFrame with a row a computed cell, as in map.csv: `casadi_skin.results.present.to_dataframe`."""

    def to_xarray(self) -> xarray.Dataset:
        """The map as an xarray Dataset, as in map.nc; raises ImportError, naming the extra, without xarray."""
        names = [axis.name for axis in self.grid.axes]
        return to_xarray(Dataset(list(self._variables(names, {}))), names)

    def figure(self, name: str) -> Figure:
        """The picture of a quantity of a map: a panel for each combination of values of axes that are lists.

        Raises ValueError for an unknown quantity, or a text.
        """
        others, drawn, panel = self._panels(name)
        panels = [panel(chosen) for chosen in product(*(range(len(axis.values)) for axis in others))]
        return map_figure(name, self.meanings.get(name, name), drawn, panels)

    def plot(self, name: str, axes: Axes | None = None, at: Mapping[str, Any] | None = None) -> Axes:
        """Draw a quantity over the ranges of the map into matplotlib axes.

        Arguments:
            name: the quantity.
            axes: where it is drawn; new ones of pyplot by default.
            at: values of the axes that are lists, by name; one of a single value may be left out.

        Returns:
            The axes.

        Raises:
            ValueError: there is no such quantity, it is a text, or there is no such value of an axis.
        """
        return present.plot(self, axes, name=name, at=dict(at or {}))

    # Files: map.csv, map.nc, boundary.csv, and a picture a quantity ---------------------------------------------------

    def write(self, attributes: Mapping[str, Any], dimensionless: bool, pictures: bool) -> None:
        """Write map.csv, a row a cell that is known, axes first; map.nc; and a picture a quantity, map_NAME."""
        known, given = self.known, (*self.names, REASON)
        names = [*(axis.name for axis in self.grid.axes), "status", *given]
        places = ((*self.grid.values(cell), STATUS_WORDS[self.states[cell]]) for cell in known)
        values = zip(*(self.cells(name, known) for name in given), strict=True)
        rows = (dict(zip(names, place + row, strict=True)) for place, row in zip(places, values, strict=True))
        write_csv(self.directory / CSV_FILE, names, rows)
        write_netcdf(self.directory / NETCDF_FILE, self.dataset(attributes, dimensionless))
        for name in self.drawn_names if pictures else ():
            safe = "".join(char if char.isalnum() or char in "-_" else "_" for char in name)
            save(self.figure(name), self.directory / f"map_{safe}")

    def dataset(self, attributes: Mapping[str, Any], dimensionless: bool) -> Dataset:
        """The variables of map.nc: dimensions named by the parameters, quantities over them.

        Numbers of a model of the user's have whatever unit the model has.
        """
        taken = set[str]()
        names = [_distinct(re.sub(r"\W+", "_", axis.name), "_", taken) for axis in self.grid.axes]
        variables = list(self._variables(names, {"units": "1"} if dimensionless else {}))
        taken |= {f"{v.name}_length" for v in variables if v.values.dtype.kind in "USO"}
        unique = [replace(v, name=_distinct(v.name, "_of_cell", taken)) for v in variables[len(names) :]]
        return Dataset([*variables[: len(names)], *unique], attributes)

    def _variables(self, names: Sequence[str], units: Mapping[str, str]) -> Iterator[Variable]:
        """Axes under these names, and quantities over them: NaN and empty texts where there is none."""
        for axis, name in zip(self.grid.axes, names, strict=True):
            values, meaning = np.array(axis.values), f"the parameter {', '.join('.'.join(path) for path in axis.paths)}"
            if not any("parameters" in path for path in axis.paths):  # those of the user have a meaning of their own
                meaning = CHAIN_MEANINGS.get(axis.name, meaning)
            if not axis.worded and not np.all(np.abs(values.astype(float)) < LARGEST_WHOLE_NUMBER):
                values = values.astype(float)
            yield Variable(name, (name,), values, meaning, attributes={} if axis.worded else units)
        over, words = tuple(names), " ".join(word.replace(" ", "_") for word in STATUS_WORDS)
        flags = {"flag_values": np.arange(len(STATUS_WORDS), dtype="i4"), "flag_meanings": words}
        yield Variable("status", over, self.status, "what is known of a cell", attributes=flags)
        for name in (*self.names, REASON):
            number, meaning = not self.is_text(name), self.meanings.get(name, name)
            yield Variable(name, over, self.values(name), meaning, number, units if number else {})

    def write_boundary(self, lines: Lines) -> None:
        """Keep the lines of the boundary, in boundary.csv as well: their points in their order."""
        axes, self.boundary, rows = self.grid.axes, lines, list[dict[str, Cell]]()
        others = [axis for axis in axes if not axis.numeric]
        names = [*(axis.name for axis in others), "line", *(axis.name for axis in axes if axis.numeric)]
        for chosen, curves in lines.items():
            places = [axis.values[k] for axis, k in zip(others, chosen, strict=True)]
            for n, curve in enumerate(curves, start=1):
                rows += [dict(zip(names, (*places, n, *point), strict=True)) for point in curve.tolist()]
        write_csv(self.directory / BOUNDARY_FILE, names, rows)

    # Pictures: a quantity each, over the axes that are ranges; other axes have a panel a value ------------------------

    @property
    def drawn_names(self) -> list[str]:
        """Quantities with a picture: numbers that change over the map, but for error bars."""
        known, names = self.states != UNKNOWN, list[str]()
        for name in self.names:
            if not (self.is_text(name) or name.endswith("_error") or name in NOT_DRAWN):
                values = self.values(name).ravel()[known]
                finite = values[np.isfinite(values)]
                if 0 < finite.size < values.size or (finite.size and float(np.ptp(finite)) > 0.0):
                    names.append(name)
        return names

    @property
    def _along(self) -> list[int]:
        """Axes that are drawn: the ranges; where there is none the longest list of numbers."""
        axes = dict(enumerate(self.grid.axes))
        lists = [i for i, axis in axes.items() if not axis.worded]
        return [i for i in axes if axes[i].numeric] or sorted(lists, key=lambda i: -len(axes[i].values))[:1] or [0]

    def _panels(self, name: str) -> tuple[list[Axis], list[MapAxis], Callable[[Sequence[int]], Panel]]:
        """Axes that are not drawn, those that are, and the panel of a quantity at places along the first."""
        check_name("quantity", name, [n for n in self.names if not self.is_text(n)])
        axes, along = self.grid.axes, self._along
        others = [i for i in range(len(axes)) if i not in along]
        names = [part for i in others for part in axes[i].names]

        def panel(chosen: Sequence[int]) -> Panel:
            places = dict(zip(others, chosen, strict=True))
            index = tuple(places.get(i, slice(None)) for i in range(len(axes)))
            values, states = self[name].astype(float)[index], self.status[index]
            at = [value for i, k in places.items() for _, value in axes[i].settings(k)]
            shown = filled(np.where(np.isfinite(values), values, np.nan), states, [axes[i].stride for i in along])
            lines = self.boundary.get(tuple(chosen), ())
            return Panel(panel_title(names, at), shown, states >= ENDED, states != UNKNOWN, lines)

        numbers = [range(len(axes[i].values)) if axes[i].worded else axes[i].values for i in along]  # words in order
        drawn = [MapAxis(axes[i].name, np.array(v, float), axes[i].log) for i, v in zip(along, numbers, strict=True)]
        return [axes[i] for i in others], drawn, panel

    def draw(self, places: Axes, name: str, at: Mapping[str, Any]) -> None:
        """Draw a quantity into axes, at values of the axes that are lists; see `plot`."""
        others, drawn, panel = self._panels(name)
        for key in at:
            check_name("at", key, [axis.name for axis in others])
        draw_maps([places], name, drawn, [panel([_place_of(axis, at) for axis in others])])


def compared(name: str) -> bool:
    """Whether a quantity is the same wherever it is computed; errors and marks may differ."""
    return not name.endswith("_error") and FAMILY_SUFFIX.sub("", name) not in NOT_DRAWN


def _apart(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far each value is from the nearest other one, relative to the range of the others and to their size."""
    known = np.flatnonzero(np.isfinite(values))
    found = np.zeros(values.size)
    if known.size > 1:
        order = known[np.argsort(values[known])]
        rising = values[order]
        gaps = np.diff(rising, prepend=-np.inf, append=np.inf)
        ranges = np.full(known.size, rising[-1] - rising[0])
        ranges[[0, -1]] -= gaps[[1, -2]]  # without the first, and without the last
        found[order] = np.minimum(gaps[:-1], gaps[1:]) / np.maximum(ranges, max(abs(np.median(rising)), SMALLEST))
    return found


def _distinct(name: str, more: str, taken: set[str]) -> str:
    """The name, with `more` behind it until it is not taken; it is taken then."""
    while name in taken:
        name += more
    taken.add(name)
    return name


def _place_of(axis: Axis, given: Mapping[str, Any]) -> int:
    """The value of a list that is drawn: the requested one, or the only one; raises ValueError for no value."""
    if axis.name not in given and len(axis.values) == 1:
        return 0
    value = given.get(axis.name)
    if axis.name not in given or value not in axis.values:
        words = f"given {short_repr(value)}" if axis.name in given else "missing"
        raise ValueError(f"at: {axis.name}: {words}; accepted: {cut(', '.join(map(repr, axis.values)))}")
    return axis.values.index(value)


def filled(values: NDArray[np.float64], states: NDArray[np.int8], strides: list[int]) -> NDArray[np.float64]:
    """Values with those of the nearest computed cell where a refined map computed none."""
    if max(strides) == 1 or not np.any(states == UNKNOWN):
        return values
    from scipy.ndimage import distance_transform_edt

    _, nearest = distance_transform_edt(states == UNKNOWN, sampling=[1.0 / s for s in strides], return_indices=True)
    return np.asarray(values[tuple(nearest)])


@show.register
def _(found: Map) -> Shown:
    axes = found.grid.axes
    rows = [(axis.name, f"{len(axis.values)} values") for axis in axes]
    rows += [("cells", found.summary()), ("quantities", listed(found.names))]
    first = {axis.name: axis.values[0] for i, axis in enumerate(axes) if i not in found._along}

    def draw(places: Axes, name: str = "", at: Mapping[str, Any] = first) -> None:
        if not name and not found.drawn_names:
            raise ValueError("plot: no quantity changes over the map")
        found.draw(places, name or found.drawn_names[0], at)

    def columns() -> Columns:
        known = found.known
        places = found.grid.places(np.array(known, dtype=np.int64)).T
        table = {axis.name: np.array(axis.values)[at] for axis, at in zip(axes, places, strict=True)}
        table |= {"status": [STATUS_WORDS[state] for state in found.states[known]]}
        return table | {name: found.values(name).ravel()[known] for name in (*found.names, REASON)}

    return Shown("Map", rows, draw, "quantities over the axes of a map", columns)


# A map read back from its directory: the journals are the truth, tables and pictures are not needed -------------------

ACCEPTED_MAPS = "accepted: the directory of a map, with its scene.toml and journals, or a file of Map.save"


@renamed(directory="path")
@in_turn
def read_map(path: str | Path) -> Map:
    """Read a map that was computed, or is being computed, without its model and without computing anything.

    Arguments:
        path: the directory of its results, or one file that `Map.save` wrote.

    Returns:
        The map, with the values, the bits and the boundary that `run_map` gave; `complete` is False while cells are
        missing.

    Raises:
        ValueError: there is no map, or its files cannot be read; the message names the place.
        TypeError: the argument is no path.
    """
    source = file_path("path", path)
    if not source.is_file():
        return _in_directory(source, source)
    archive, folder = Archive(source, "a map in one file"), TemporaryFolder("casadi_skin_map_")
    try:
        archive.write(folder.path, _is_part)
        found = _in_directory(folder.path, source)
        found.folder = folder
        return found
    except BaseException as error:
        folder.remove()
        if isinstance(error, ValueError):
            raise ValueError(str(error).replace(str(folder.path), str(source))) from None
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
    found = Map(directory, grid, scene, None, Progress().report)
    try:
        found.boundary = read_boundary(grid, directory / BOUNDARY_FILE)
    except (ValueError, KeyError, IndexError) as error:
        accepted = "accepted: the file that the map wrote"
        raise ValueError(f"{shown / BOUNDARY_FILE}: cannot be read ({error}); {accepted}") from None
    return found


def read_boundary(grid: Grid, path: Path) -> Lines:
    """The lines that `write_boundary` wrote; none where there is no file."""
    if not path.is_file():
        return {}
    places = [{str(value): k for k, value in enumerate(axis.values)} for axis in grid.axes if not axis.numeric]
    found = dict[tuple[int, ...], dict[str, list[list[float]]]]()
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.reader(islice(file, 1, None)):
            words, line, point = row[: len(places)], row[len(places)], row[len(places) + 1 :]
            chosen = tuple(place[word] for place, word in zip(places, words, strict=True))
            found.setdefault(chosen, {}).setdefault(line, []).append([float(value) for value in point])
    return {chosen: tuple(np.array(curve) for curve in curves.values()) for chosen, curves in found.items()}
