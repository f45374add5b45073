"""The finished cells of a map: journals on the disk are the truth, and an index of their places is all that is held.

One journal of a map that one process drives, one for each part of a batch array; all are read, one's own is written.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from casadi_skin.optimise.names import FREE, NAMED
from casadi_skin.results.dataset import LARGEST_WHOLE_NUMBER, on_disk
from casadi_skin.results.journal import Journal, mapped, record_at, scan
from casadi_skin.results.quantities import FAMILY_ERRORS, FAMILY_PROOFS, FAMILY_QUANTITIES, FAMILY_STABILITY, Cell
from casadi_skin.results.quantities import FIXED as OF_BRANCHES
from casadi_skin.results.quantities import FIXED_AT_REST as OF_EQUILIBRIA
from casadi_skin.runs.directory import DirectoryError
from casadi_skin.runs.map_grid import (
    OUTSIDE_FAULTS,
    Cells,
    Grid,
    MapHead,
    MapRecord,
    MeaningsRecord,
    Result,
    Row,
    Task,
    TaskRecord,
    Watch,
    needed,
)
from casadi_skin.runs.request import Request
from casadi_skin.runs.rules import SceneError, check_known
from casadi_skin.runs.scene import Scene
from casadi_skin.zero.kinds import BRANCH_POINT, CUSP, DOUBLING, FOLD, HOPF, TAKENS, TORUS, ZERO_HOPF

RECORD_DECODER = msgspec.msgpack.Decoder(MapRecord)
JOURNAL_PATTERN = "journal*.msgpack"
UNKNOWN, DONE, ENDED, FAILED = 0, 1, 2, 3  # states of a cell
MOST_ATTEMPTS = 2  # at a cell


def digest(scene: Scene) -> bytes:
    """Digest of a scene in its journal: the same for the same cells with the same results."""
    requested = msgspec.to_builtins(msgspec.structs.replace(scene, title=""))
    del requested["time_limit"]
    return sha256(msgspec.json.encode(requested, order="sorted")).digest()


class Store:
    """The journals of a map in a directory, its own to be written, without one all to be read; a context manager.

    Attributes:
        states: of cells, shape (cells,): UNKNOWN, DONE, ENDED where its branch ended early, or FAILED.
        attempts: at cells, shape (cells,).
        meanings: of quantities by name.
        seconds, finished: time that tasks took, and number of cells that they gave, in all journals.
    """

    def __init__(
        self, directory: Path, grid: Grid, scene: Scene, own: str | None, report: Callable[[str], None]
    ) -> None:
        watched = None if scene.map is None else scene.map.watch
        self.directory, self.grid, self.watch, self._digest = directory, grid, Watch(grid, watched), digest(scene)
        self.states = np.zeros(grid.size, dtype=np.int8)
        self.attempts = np.zeros(grid.size, dtype=np.int8)
        self._places = np.zeros(grid.size, dtype=np.int64)
        self._sources = np.zeros(grid.size, dtype=np.int16)
        self._outside = np.zeros(grid.size, dtype=bool)
        self.meanings, self.seconds, self.finished = dict[str, str](), 0.0, 0
        self._paths, self._ends = list[Path](), list[int]()
        self._journal: Journal[MapRecord] | None = None
        if own is not None:
            self._paths, self._ends = [directory / own], [0]
            self._journal = Journal(directory / own, RECORD_DECODER, partial(self._index, 0))
            if self._journal.fault:
                report(f"{directory / own}: {self._journal.fault}; what follows it is dropped and computed again")
            if self._journal.end == 0:
                self._append(MapHead(self._digest))
        for path, fault in self.refresh().items():
            report(f"{path}: {fault}; what follows it is not read")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._journal is not None:
            self._journal.__exit__()

    def refresh(self) -> dict[Path, str]:
        """Read new records of other parts; returns where they end before the end of a journal, and why."""
        faults = dict[Path, str]()
        for path in sorted(self.directory.glob(JOURNAL_PATTERN)):
            if path not in self._paths:
                self._paths.append(path)
                self._ends.append(0)
        first = 0 if self._journal is None else 1
        for number, path in enumerate(self._paths[first:], start=first):
            with mapped(path) as data:  # one that is being written may end in a part of a record
                self._ends[number], fault = scan(data, RECORD_DECODER, partial(self._index, number), self._ends[number])
            if fault:
                faults[path] = fault
        return faults

    @property
    def complete(self) -> bool:
        """Whether no cell is left to compute."""
        if self.grid.refined:
            return not needed(self.grid, self.watch.labels).size
        return bool(np.all(self.final(self.grid.coarsest)))

    def forget_outside(self, mine: bool = False) -> None:
        """Take cells that failed for reasons outside of their computation as not computed; of a share its own alone."""
        chosen = self._outside & (self._sources == 0) if mine else self._outside
        self.states[chosen] = UNKNOWN
        self.attempts[chosen] = 0
        self.watch.forget(np.flatnonzero(chosen))
        self._outside[chosen] = False

    def add(self, task: Task, attempt: int, result: Result) -> None:
        """Keep the result of a task; raises OSError where it cannot be written."""
        new = {name: words for name, words in result.meanings.items() if name not in self.meanings}
        if new:
            self._append(MeaningsRecord(new))
        given = result.seconds, result.rows, result.kind, result.reason, task.neighbour
        record = TaskRecord(task.cells, attempt, *given)
        self._append(record)

    def _append(self, record: MapRecord) -> None:
        assert self._journal is not None
        place = self._journal.end
        self._journal.append(record)
        self._index(0, place, record)

    def _index(self, source: int, place: int, record: MapRecord) -> None:
        if place == 0 and not (isinstance(record, MapHead) and record.digest == self._digest):
            words = "accepted: that of this scene, or --overwrite"
            raise DirectoryError(f"{self._paths[source]}: is the journal of another scene; {words}")
        if isinstance(record, MapHead):
            return
        if isinstance(record, MeaningsRecord):
            self.meanings |= {name: words for name, words in record.meanings.items() if name not in self.meanings}
            return
        cells = np.array(record.cells, dtype=np.int64)
        if cells.size == 0 or cells.min() < 0 or cells.max() >= self.grid.size:
            return
        self.seconds, self.finished = self.seconds + record.seconds, self.finished + cells.size
        self._places[cells], self._sources[cells] = place, source
        self.attempts[cells] = record.attempt
        self._outside[cells] = record.kind in OUTSIDE_FAULTS
        if record.kind:
            self.states[cells] = FAILED
        else:
            self.states[cells] = [ENDED if row.fault else DONE for row in record.rows]
        if not record.kind or record.attempt >= MOST_ATTEMPTS:
            self.watch.see(record)

    def final(self, cells: Cells) -> NDArray[np.bool_]:
        """Whether nothing is left to do at each of the cells."""
        states, tried = self.states[cells], self.attempts[cells] >= MOST_ATTEMPTS
        return np.asarray((states == DONE) | (states == ENDED) | ((states == FAILED) & tried))

    def record(self, cell: int) -> TaskRecord:
        """The record of a cell that is known."""
        with mapped(self._paths[self._sources[cell]]) as data:
            found, _ = record_at(data, int(self._places[cell]), RECORD_DECODER)
        assert isinstance(found, TaskRecord)
        return found

    def rows(self) -> Iterator[tuple[int, Row | None, TaskRecord]]:
        """Cells with their rows, None of one that failed, in the order of the journals, each cell once."""
        for number, path in enumerate(self._paths):
            mine = np.unique(self._places[(self._sources == number) & (self.states != UNKNOWN)])
            with mapped(path) as data:
                for place in mine.tolist():
                    record, _ = record_at(data, place, RECORD_DECODER)
                    assert isinstance(record, TaskRecord)
                    for i, cell in enumerate(record.cells):
                        if self._places[cell] == place and self._sources[cell] == number:
                            yield cell, None if record.kind else record.rows[i], record

    def row(self, cell: int) -> Row | None:
        """The row of a cell; None of one that failed."""
        record = self.record(cell)
        with suppress(ValueError):
            return None if record.kind else record.rows[record.cells.index(cell)]
        return None


# The quantities of a map as columns on the disk: tables and pictures of any number of cells need no more memory -------

REASON, STARTED_FROM = "reason", "started_from"
STATUS_WORDS = ("not computed", "done", "ended early", "failed")  # by state


class Columns:
    """Columns of a map, one a quantity, in the order in which cells have them.

    Attributes:
        names: of quantities, in the order of the cells.
        numbers: by name, NaN where there is none; shape (cells,).
        texts: by name, places among the different texts, the first of which is empty; shape (cells,).
        words: the different texts.
    """

    def __init__(self, store: Store, wanted: Sequence[str] | None = None) -> None:
        self.store, self.words = store, [""]
        self.numbers, self.texts = dict[str, NDArray[np.float64]](), dict[str, NDArray[np.int32]]()
        self._places, size = {"": 0}, store.grid.size
        self._reasons: NDArray[np.int32] = on_disk(np.int32, (size,))
        first, axes = dict[str, tuple[int, int]](), {axis.name for axis in store.grid.axes}
        for cell, row, record in store.rows():
            self._reasons[cell] = self._place(record.reason if row is None else row.fault)
            values = {} if row is None else row.values
            for place, (name, value) in enumerate(values.items()):
                if name not in axes and (wanted is None or name in wanted):
                    first[name] = min(first.get(name, (cell, place)), (cell, place))
                    self._put(cell, name, value)
            if record.neighbour >= 0 and row is not None:
                first[STARTED_FROM] = (size, 0)
                self._put(cell, STARTED_FROM, store.grid.name(record.neighbour))
        self.names = sorted(first, key=first.__getitem__)

    def _put(self, cell: int, name: str, value: float | int | str) -> None:
        size = self.store.grid.size
        if isinstance(value, str):
            if name not in self.texts:
                self.texts[name] = on_disk(np.int32, (size,))
            self.texts[name][cell] = self._place(value)
            return
        if name not in self.numbers:
            self.numbers[name] = on_disk(np.float64, (size,))
            self.numbers[name][:] = np.nan
        self.numbers[name][cell] = value

    def _place(self, text: str) -> int:
        if text not in self._places:
            self._places[text] = len(self.words)
            self.words.append(text)
        return self._places[text]

    def text(self, name: str, cell: int) -> str:
        """The text of a cell; empty where there is none."""
        return self.words[int((self._reasons if name == REASON else self.texts[name])[cell])]

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Values of a quantity, or the reasons why cells failed; shape of the grid."""
        if name in self.numbers:
            return self.numbers[name].reshape(self.store.grid.shape)
        places = self._reasons if name == REASON else self.texts[name]
        return np.array(self.words, dtype=object)[places].reshape(self.store.grid.shape)

    def cells(self, name: str, cells: Sequence[int]) -> Iterator[Cell]:
        """Values of a quantity at cells as a table has them: nothing for NaN, a whole number where all of them are."""
        if name not in self.numbers:
            return (self.text(name, cell) for cell in cells)
        values = self.numbers[name]
        known = values[np.isfinite(values)]
        whole = bool(np.all(known == np.round(known)) and np.all(np.abs(known) < LARGEST_WHOLE_NUMBER))
        found = (float(values[cell]) for cell in cells)
        return ("" if math.isnan(value) else int(value) if whole else value for value in found)


# Names of the quantities that cells of a scene may have, known before one is computed ---------------------------------

KINDS = (FOLD, HOPF, BRANCH_POINT, DOUBLING, TORUS, CUSP, TAKENS, ZERO_HOPF, "generalized hopf", "hopf-hopf")
OF_ALL = ("points", "end", "end_reason")
STABILITY = ("first_instability", "first_instability_error", "first_tongue", "unresolved", "changes")
LEFT_OUT = ("point", "requested", "special", "fold")  # marks of a place along a branch
FAMILY_SUFFIX = re.compile(r"_(j?\d+)$")  # of a family or a branch among several


def plain_kind(kind: str) -> str:
    """A kind of special point as part of a name."""
    return kind.replace(" ", "_").replace("-", "_")


def known_names(request: Request) -> tuple[str, ...]:
    """Names of quantities without the suffix that distinguishes several branches."""
    scene = request.scene
    if scene.search is not None:
        return ("objective", "optima", "end", "end_reason", "Omega", *FREE, *NAMED)
    if scene.family is not None:
        tables = (FAMILY_QUANTITIES, FAMILY_STABILITY, FAMILY_ERRORS, FAMILY_PROOFS)
        names = [quantity.name for table in tables for quantity in table]
        return (*names, "regime", "threshold", *STABILITY, *OF_ALL)
    states = request.equations.state_names
    special = [
        word for kind in map(plain_kind, KINDS) for word in (f"{kind}_count", f"first_{kind}", f"first_{kind}_error")
    ]
    extremes = [f"{name}_{end}" for name in request.ode.state_names for end in ("min", "max")]
    fixed = OF_EQUILIBRIA if scene.equilibrium is not None else OF_BRANCHES
    fixed = (*fixed, "energy") if scene.orbit is not None and request.ode.hamiltonian is not None else fixed
    found = (*request.parameters, *states, *extremes, *fixed, *STABILITY, *special, *OF_ALL)
    return tuple(name for name in dict.fromkeys(found) if name not in LEFT_OUT)


def check_quantities(request: Request, grid: Grid) -> None:
    """Raises SceneError for a quantity that [map] names and that no cell can have."""
    table = request.scene.map
    known = [name for name in known_names(request) if name not in [axis.name for axis in grid.axes]]
    for key in ("quantities", "watch"):
        for name in getattr(table, key) or ():
            if FAMILY_SUFFIX.sub("", name) not in known:
                check_known(f"[map] {key}", name, known)
    if table is not None and table.growth and "first_instability" not in known:
        raise SceneError("[map] growth: given without a quantity first_instability; accepted: beside a [family]")
