"""The finished cells of a map: journals on the disk are the truth, and an index of their places is all that is held.

One journal of a map that one process drives, one for each part of a batch array; all are read, one's own is written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Self

import msgspec
import numpy as np
from numpy.typing import NDArray

from casadi_skin.results.journal import Journal, mapped, record_at, scan
from casadi_skin.runs.directory import DirectoryError
from casadi_skin.runs.map_grid import Cells, Grid, Task
from casadi_skin.runs.map_records import OUTSIDE, MapHead, MapRecord, MeaningsRecord, Result, Row, TaskRecord
from casadi_skin.runs.map_refine import needed
from casadi_skin.runs.map_watch import Watch
from casadi_skin.runs.scene import Scene

DECODER = msgspec.msgpack.Decoder(MapRecord)
JOURNALS = "journal*.msgpack"
UNKNOWN, DONE, ENDED, FAILED = 0, 1, 2, 3  # states of a cell
ATTEMPTS = 2  # at a cell


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
            self._journal = Journal(directory / own, DECODER, partial(self._index, 0))
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
        for path in sorted(self.directory.glob(JOURNALS)):
            if path not in self._paths:
                self._paths.append(path)
                self._ends.append(0)
        first = 0 if self._journal is None else 1
        for number, path in enumerate(self._paths[first:], start=first):
            with mapped(path) as data:  # one that is being written may end in a part of a record
                self._ends[number], fault = scan(data, DECODER, partial(self._index, number), self._ends[number])
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
        self._outside[cells] = record.kind in OUTSIDE
        if record.kind:
            self.states[cells] = FAILED
        else:
            self.states[cells] = [ENDED if row.fault else DONE for row in record.rows]
        if not record.kind or record.attempt >= ATTEMPTS:
            self.watch.see(record)

    def final(self, cells: Cells) -> NDArray[np.bool_]:
        """Whether nothing is left to do at each of the cells."""
        states, tried = self.states[cells], self.attempts[cells] >= ATTEMPTS
        return np.asarray((states == DONE) | (states == ENDED) | ((states == FAILED) & tried))

    def record(self, cell: int) -> TaskRecord:
        """The record of a cell that is known."""
        with mapped(self._paths[self._sources[cell]]) as data:
            found, _ = record_at(data, int(self._places[cell]), DECODER)
        assert isinstance(found, TaskRecord)
        return found

    def rows(self) -> Iterator[tuple[int, Row | None, TaskRecord]]:
        """Cells with their rows, None of one that failed, in the order of the journals, each cell once."""
        for number, path in enumerate(self._paths):
            mine = np.unique(self._places[(self._sources == number) & (self.states != UNKNOWN)])
            with mapped(path) as data:
                for place in mine.tolist():
                    record, _ = record_at(data, place, DECODER)
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
