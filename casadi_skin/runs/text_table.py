"""Tables on standard output, without the time that a library for terminals takes to load."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, field

BOLD, PLAIN = "\033[1m", "\033[0m"


@dataclass
class TextTable:
    """A title, columns by name, and rows of cells; printed right-justified, with bold names on a terminal."""

    title: str | None
    columns: Sequence[str]
    rows: list[tuple[str, ...]] = field(default_factory=list)

    def add_row(self, *cells: str) -> None:
        """Add a row; cells that are left out are empty."""
        self.rows.append((*cells, *[""] * (len(self.columns) - len(cells))))

    def lines(self) -> list[str]:
        """The names of the columns, and the rows."""
        widths = [max(map(len, column)) for column in zip(self.columns, *self.rows, strict=True)]
        cells = [zip(row, widths, strict=True) for row in (self.columns, *self.rows)]
        return [" " + "  ".join(cell.rjust(width) for cell, width in row).rstrip() for row in cells]

    def print(self) -> None:
        """Write the table to standard output."""
        if self.title:
            print(self.title)
        names, *rows = self.lines()
        print("\n".join([f"{BOLD}{names}{PLAIN}" if sys.stdout.isatty() else names, *rows]))
