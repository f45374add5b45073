"""Records of tasks, sent and kept: rows of named quantities, results, and entries of the journal."""

from __future__ import annotations

import msgspec

Value = float | int | str
FAILED, DIED, LATE, LOST = "failed", "died", "late", "lost"  # kinds of faults; a computation reports the first itself
OUTSIDE = (DIED, LATE, LOST)  # those that another run may not meet


class Row(msgspec.Struct, frozen=True):
    """Quantities of a cell by name, unknown ones left out.

    Attributes:
        values: by name.
        fault: why the cell has no solution; empty where it has one.
        state, period: of a solution at which a second start of a neighbour may begin.
    """

    values: dict[str, Value]
    fault: str = ""
    state: tuple[float, ...] = ()
    period: float = 0.0


class Result(msgspec.Struct, frozen=True):
    """Result of a task: a row for each of its cells, or the reason and kind of its failure."""

    rows: tuple[Row, ...] = ()
    kind: str = ""
    reason: str = ""
    seconds: float = 0.0
    meanings: dict[str, str] = {}


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
