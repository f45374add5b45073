"""The quantities of a map as columns on the disk: tables and pictures of any number of cells need no more memory."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from typing import IO, Any, Self

import numpy as np
from numpy.typing import NDArray

from casadi_skin.maps.store import Store

REASON = "reason"
STATUS = ("not computed", "done", "ended early", "failed")  # by state
Places = NDArray[np.int64]  # where the text of a cell starts, and its length; shape (cells, 2)


class Columns:
    """Columns of a map, one a quantity, in the order in which cells have them; use as a context manager.

    Attributes:
        names: of quantities, in the order of the cells.
        numbers: by name, NaN where there is none; shape (cells,).
        texts: by name, places in a file.
    """

    def __init__(self, store: Store, wanted: Sequence[str] | None = None) -> None:
        self.store, self._stack, self._wanted = store, ExitStack(), wanted
        self.numbers, self.texts = dict[str, NDArray[np.float64]](), dict[str, Places]()
        self._file = self.scratch()
        self._known = dict[str, tuple[int, int]]()
        first = dict[str, tuple[int, int]]()
        axes = {axis.name for axis in store.grid.axes}
        self._reasons: Places = np.memmap(self.scratch(), np.int64, "w+", shape=(store.grid.size, 2))
        for cell, row, record in store.rows():
            reason = record.reason if row is None else row.fault
            if reason:
                self._reasons[cell] = self._placed(reason)
            for place, (name, value) in enumerate(() if row is None else row.values.items()):
                if name not in axes and (wanted is None or name in wanted):
                    first[name] = min(first.get(name, (cell, place)), (cell, place))
                    self._put(cell, name, value)
        self.names = sorted(first, key=first.__getitem__)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _put(self, cell: int, name: str, value: float | int | str) -> None:
        if isinstance(value, str):
            self._column(name, str)[cell] = self._placed(value)
        else:
            self._column(name, float)[cell] = value

    def _column(self, name: str, kind: type) -> NDArray[Any]:
        held: dict[str, NDArray[Any]] = self.texts if kind is str else self.numbers
        if name not in held:
            size = self.store.grid.size
            file = self.scratch()
            if kind is str:
                held[name] = np.memmap(file, np.int64, "w+", shape=(size, 2))
            else:
                held[name] = np.memmap(file, np.float64, "w+", shape=(size,))
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

    def scratch(self) -> IO[bytes]:
        """A file that goes with this object."""
        return self._stack.enter_context(tempfile.TemporaryFile())

    def is_whole(self, name: str) -> bool:
        """Whether all numbers of a column are whole ones, as counts and flags are."""
        values = self.numbers[name]
        known = values[np.isfinite(values)]
        return bool(np.all(known == np.round(known)) and np.all(np.abs(known) < 2**31))
