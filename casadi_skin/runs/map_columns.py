"""The quantities of a map as columns on the disk: tables and pictures of any number of cells need no more memory."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from casadi_skin.runs.map_store import Store

REASON, STARTED_FROM = "reason", "started_from"
STATUS = ("not computed", "done", "ended early", "failed")  # by state
Places = NDArray[np.int64]  # where the text of a cell starts, and its length; shape (cells, 2)


def scratch(kind: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """An array of zeros on the disk, in a file that has no name and goes with it."""
    with tempfile.TemporaryFile() as file:
        return np.memmap(file, kind, "w+", shape=shape)


class Columns:
    """Columns of a map, one a quantity, in the order in which cells have them.

    Attributes:
        names: of quantities, in the order of the cells.
        numbers: by name, NaN where there is none; shape (cells,).
        texts: by name, places in a file.
    """

    def __init__(self, store: Store, wanted: Sequence[str] | None = None) -> None:
        self.store = store
        self.numbers, self.texts = dict[str, NDArray[np.float64]](), dict[str, Places]()
        self._file = tempfile.TemporaryFile()  # noqa: SIM115  closed when this object goes
        weakref.finalize(self, self._file.close)
        self._known = dict[str, tuple[int, int]]()
        first = dict[str, tuple[int, int]]()
        axes = {axis.name for axis in store.grid.axes}
        self._reasons: Places = scratch(np.int64, (store.grid.size, 2))
        for cell, row, record in store.rows():
            reason = record.reason if row is None else row.fault
            if reason:
                self._reasons[cell] = self._placed(reason)
            if record.neighbour >= 0 and row is not None:
                self._put(cell, STARTED_FROM, store.grid.name(record.neighbour))
                first[STARTED_FROM] = (store.grid.size, 0)
            for place, (name, value) in enumerate(() if row is None else row.values.items()):
                if name not in axes and (wanted is None or name in wanted):
                    first[name] = min(first.get(name, (cell, place)), (cell, place))
                    self._put(cell, name, value)
        self.names = sorted(first, key=first.__getitem__)

    def _put(self, cell: int, name: str, value: float | int | str) -> None:
        if isinstance(value, str):
            self._column(name, str)[cell] = self._placed(value)
        else:
            self._column(name, float)[cell] = value

    def _column(self, name: str, kind: type) -> NDArray[Any]:
        held: dict[str, NDArray[Any]] = self.texts if kind is str else self.numbers
        if name not in held:
            size = self.store.grid.size
            if kind is str:
                held[name] = scratch(np.int64, (size, 2))
            else:
                held[name] = scratch(np.float64, (size,))
                held[name][:] = np.nan
        return held[name]

    def _placed(self, text: str) -> tuple[int, int]:
        """Where a text is in the file; one of the last few is not written again."""
        if text not in self._known:
            data = text.encode()
            if len(self._known) >= 1000:
                self._known.clear()
            self._file.seek(0, 2)
            self._known[text] = self._file.tell(), len(data)
            self._file.write(data)
        return self._known[text]

    def text(self, name: str, cell: int) -> str:
        """The text of a cell; empty where there is none."""
        place, length = (self._reasons if name == REASON else self.texts[name])[cell].tolist()
        self._file.seek(place)
        return self._file.read(length).decode()

    def lengths(self, name: str) -> NDArray[np.int64]:
        """Lengths of the texts of a column in bytes, shape (cells,)."""
        return (self._reasons if name == REASON else self.texts[name])[:, 1]

    def is_whole(self, name: str) -> bool:
        """Whether all numbers of a column are whole ones, as counts and flags are."""
        values = self.numbers[name]
        known = values[np.isfinite(values)]
        return bool(np.all(known == np.round(known)) and np.all(np.abs(known) < 2**31))
