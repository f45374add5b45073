"""Base of studies: a directory to which tables and pictures are written as results arrive, and a report."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, TypeVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from rich.table import Table

from casadi_skin.model.files import replacing
from casadi_skin.results.dataset import Cell, write_csv
from casadi_skin.results.figures.style import save

Case = TypeVar("Case")
Rows = tuple[Sequence[str], Sequence[Mapping[str, object]]]


@dataclass
class Study(ABC):
    """A study that writes into `directory`; `say` is called with each step, `files` are those written so far."""

    directory: Path
    say: Callable[[str], None] = field(default=lambda words: None, kw_only=True)
    formats: Sequence[str] = field(default=("png",), kw_only=True)  # of pictures
    files: list[Path] = field(default_factory=list, kw_only=True)
    done: int = field(default=0, kw_only=True)  # parts of the study, as `part` calls them, that are finished

    part: ClassVar[str] = "cases"

    @abstractmethod
    def run(self) -> None:
        """Compute everything, and write it as it becomes known, also where KeyboardInterrupt ends the study.

        Raises:
            ArithmeticError: The study cannot go on.
        """

    @abstractmethod
    def report(self) -> Iterable[str | Table]:
        """The results, as lines and tables."""

    @property
    def faults(self) -> Sequence[object]:
        """Faults of the study; empty where there are none."""
        return ()

    def work_through(self, cases: Sequence[Case], words: Callable[[Case], str], work: Callable[[Case], None]) -> None:
        """Do the work of one case after the other, and count those that are done."""
        for number, case in enumerate(cases, start=1):
            self.say(f"{words(case)} ({number} of {len(cases)})")
            work(case)
            self.done = number

    # Files ----------------------------------------------------------------------------------------------------------

    def write_table(self, stem: str, columns: Sequence[str], rows: Iterable[Mapping[str, object]]) -> None:
        """Replace STEM.csv; see `cell`."""
        path = self.directory / f"{stem}.csv"
        write_csv(path, columns, ({name: cell(row.get(name)) for name in columns} for row in rows))
        self._written([path])

    def write_text(self, name: str, text: str) -> None:
        """Replace a text file."""
        path = self.directory / name
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
        self._written([path])

    def write_figure(self, stem: str, figure: Figure) -> None:
        """Replace STEM.png, or the files of other `formats`."""
        self._written(save(figure, self.directory / stem, self.formats))

    def _written(self, paths: Iterable[Path]) -> None:
        self.files += [path for path in paths if path not in self.files]


def cell(value: object) -> Cell:
    """A cell of a table: empty for None and nan, 0 or 1 for a truth value."""
    if value is None or value != value:
        return ""
    if isinstance(value, bool):
        return int(value)
    finite = isinstance(value, int) or (isinstance(value, float) and math.isfinite(value))
    return value if finite else str(value)  # type: ignore[return-value]


def table(**columns: ArrayLike) -> Rows:
    """Names and rows of columns of one length; a single value stands in all rows."""
    values = [column.tolist() for column in np.broadcast_arrays(*columns.values())]
    return list(columns), [dict(zip(columns, row, strict=True)) for row in zip(*values, strict=True)]


def stacked(tables: Sequence[Rows]) -> Rows:
    """Tables with the same columns, one below the other."""
    return tables[0][0], [row for _, rows in tables for row in rows]


def text_table(heads: Sequence[str], words: Sequence[int] = (0,)) -> Table:
    """An empty table for the terminal; `words` are the places of columns that do not hold numbers."""
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for place, head in enumerate(heads):
        table.add_column(head, justify="left" if place in words else "right", no_wrap=True)
    return table


def letter(axes: Axes, name: str, words: str = "") -> None:
    """The panel's letter and a few words above it, at the left."""
    axes.set_title(f"({name})  {words}".rstrip(), loc="left")
