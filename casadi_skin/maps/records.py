"""What is sent and kept of tasks: rows of named quantities, results, and records of the journal."""

from __future__ import annotations

import msgspec

Value = float | int | str
FAILED, DIED, LATE, LOST = "failed", "died", "late", "lost"  # kinds of faults; a computation tells the first itself
OUTSIDE = (DIED, LATE, LOST)  # those that another run may not meet


class Row(msgspec.Struct, frozen=True):
    """Quantities of a cell by name; what is not known is left out.

    Attributes:
        values: by name.
        fault: why the solution that the cell asks for is not there; empty where it is.
        state, period: of a solution at which a second start of a neighbour may begin.
    """

    values: dict[str, Value]
    fault: str = ""
    state: tuple[float, ...] = ()
    period: float = 0.0


class Result(msgspec.Struct, frozen=True):
    """What a task gave: a row for each of its cells, or why it failed and in what way."""

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
    """What quantities mean by name, in the order in which they came."""

    meanings: dict[str, str]


MapRecord = TaskRecord | MeaningsRecord | MapHead
