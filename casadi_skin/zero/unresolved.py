"""A stretch of a branch on which something may be missing: what is not resolved is named."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

STABILITY = "changes of stability"


@dataclass(frozen=True)
class Unresolved:
    """A stretch of a branch on which special points or changes of stability may be missing.

    Attributes:
        start, end: values of the parameter at both ends, in the order of the branch.
        reason: why it is not resolved, in words.
        kind: what may be missing: "hopf", "fold" or another kind of special points, or "changes of stability".
        parameter: name of the parameter: S of a family.
        coordinates: places of both ends along a family.
    """

    start: float
    end: float
    reason: str
    kind: str = STABILITY
    parameter: str = "S"
    coordinates: tuple[float, ...] = ()

    def __str__(self) -> str:
        """One line."""
        where = f" to {self.end:.8g}" if self.end != self.start else ""
        return f"{self.kind} at {self.parameter} = {self.start:.8g}{where}: {self.reason}"

    @property
    def S_start(self) -> float:
        """S at the start of a stretch of a family."""
        return self.start

    @property
    def S_end(self) -> float:
        """S at the end of a stretch of a family."""
        return self.end

    @property
    def coordinate_start(self) -> float:
        """Place of the start along a family."""
        return self.coordinates[0]

    @property
    def coordinate_end(self) -> float:
        """Place of the end along a family."""
        return self.coordinates[1]


def count_in_words(count: int, unresolved: Collection[object]) -> str:
    """A count of what is found on a branch: the least that it can be where something is unresolved."""
    return f"at least {count}" if unresolved else str(count)
