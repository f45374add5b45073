"""Records of branches and searches in the journal of a run: points as they converge, stability, ends, outcomes.

A record is a tagged struct; points, multipliers, outcomes and curves are data in it as `store` writes results. Points
that are read back are verified before a branch goes on from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np

from casadi_skin.follow.follow import BranchIterator
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.results.store import DAMAGED_FILE_ERRORS, Reader, SavedResult, Writer
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.settings import End, Point, Target


class PointRecord(msgspec.Struct, frozen=True, tag="point"):
    """A converged point with all that the continuation needs to go on from it."""

    branch: str
    point: Any
    missed: tuple[Target, ...] = ()  # by the continuation so far
    unresolved: tuple[Unresolved, ...] = ()  # stretches so far


class StabilityRecord(msgspec.Struct, frozen=True, tag="stability"):
    """Stability of the first point recorded whose stability was not."""

    branch: str
    floquet: Any


class EndRecord(msgspec.Struct, frozen=True, tag="end"):
    """The end of a branch."""

    branch: str
    end: End | None
    detail: str
    misses: dict[str, tuple[float, ...]]
    unresolved: tuple[Unresolved, ...] = ()  # stretches


class CutRecord(msgspec.Struct, frozen=True, tag="cut"):
    """Of the records of a branch before this one, only the first few hold."""

    branch: str
    kept: int


class CycleRecord(msgspec.Struct, frozen=True, tag="cycle"):
    """The simulated cycle from which the first orbit is solved for."""

    branch: str
    t: Any
    states: Any
    start: float
    period: float


class EdgeRecord(msgspec.Struct, frozen=True, tag="edge"):
    """A curve of edges that has ended."""

    branch: str
    curve: SavedResult


class OutcomeRecord(msgspec.Struct, frozen=True, tag="outcome"):
    """Where one start of a search led."""

    outcome: Any


BranchRecord = PointRecord | StabilityRecord | EndRecord | CutRecord | CycleRecord | EdgeRecord


class Records(Protocol):
    """Records of branches, kept or not: a journal has these."""

    path: Path
    records: list[BranchRecord]

    def append(self, record: BranchRecord) -> None:
        """Keep one more."""


def data_of(value: Any) -> Any:
    """A value of numbers alone, as records have it: no model or space is among it but that of its points."""
    return Writer().value(value)


def value_of(data: Any, space: SolutionSpace | None = None) -> Any:
    """The value of data, points those of a space; raises one of `DAMAGED` for other data."""
    return Reader().value(data, space)


def point_record(
    branch: str, point: Point, points: BranchIterator | None = None, with_better: bool = False
) -> PointRecord:
    """Record of a point of the branch of that name; with its better solution where its stability is to be computed."""
    data = data_of(point if with_better else replace(point, better=None))
    if points is None:
        return PointRecord(branch, data)
    return PointRecord(branch, data, tuple(points.missed), tuple(points.unresolved))


def stability_record(branch: str, orbit: Solution) -> StabilityRecord:
    """Record of the stability of the next orbit of a branch."""
    return StabilityRecord(branch, data_of(orbit.floquet()))


@dataclass
class Known:
    """The record of a branch in a journal.

    Attributes:
        solutions: with their stability where that is computed.
        waiting: points after them whose stability is to be computed.
        missed: requested values without a solution.
        unresolved: stretches on which special points may be missing.
        end: how the branch ended; None where it goes on.
        kept: number of its records that hold.
        fault: why the others do not, in words.
    """

    solutions: list[Solution] = field(default_factory=list)
    waiting: list[Point] = field(default_factory=list)
    missed: tuple[Target, ...] = ()
    unresolved: tuple[Unresolved, ...] = ()
    end: EndRecord | None = None
    kept: int = 0
    fault: str = ""


def known_of(records: Sequence[BranchRecord], branch: str, space: SolutionSpace, stability: bool) -> Known:
    """The state of a branch by its records, up to the first point that does not solve the equations."""
    known = Known()
    for record in _holding(records, branch):
        try:
            known.fault = _taken(record, known, space, stability)
        except DAMAGED_FILE_ERRORS as error:
            known.fault = " ".join(str(error).split()) or type(error).__name__
        if known.fault:
            break
        known.kept += 1
    return known


def _taken(
    record: PointRecord | StabilityRecord | EndRecord, known: Known, space: SolutionSpace, stability: bool
) -> str:
    """Add a record to what is known; the reason where it does not hold."""
    if isinstance(record, EndRecord):
        known.end, known.unresolved = record, record.unresolved
    elif isinstance(record, StabilityRecord):
        known.solutions.append(space.solution(known.waiting.pop(0), value_of(record.floquet)))
    else:
        point = value_of(record.point, space)
        if not point.z.size == point.tangent.size == point.problem.size:
            return "a point of another discretisation"
        fault = _fault(space, point, known)
        if fault:
            return fault
        known.missed, known.unresolved = record.missed, record.unresolved
        if stability:
            known.waiting.append(point)
        else:
            known.solutions.append(space.solution(point))
    return ""


def _fault(space: SolutionSpace, point: Point, known: Known) -> str:
    """Reason why a point is none of the branch; of a special point, whose equations may be singular, by residual."""
    leaves = bool(getattr(space, "leaves", False)) and not (known.solutions or known.waiting)
    if not (point.special or leaves):
        return str(space.point_solver.fault(point))
    if not (np.all(np.isfinite(point.z)) and np.all(np.isfinite(point.tangent))):
        return "a value that is not finite"
    off = point.problem.relative_residual(point.z)
    return "" if off <= max(space.tolerance, point.error.profile) else f"a residual of {off:.1e}"


def _holding(records: Sequence[BranchRecord], branch: str) -> list[PointRecord | StabilityRecord | EndRecord]:
    """The records of a branch that hold."""
    mine = list[PointRecord | StabilityRecord | EndRecord]()
    for record in records:
        if record.branch != branch or isinstance(record, CycleRecord | EdgeRecord):
            continue
        if isinstance(record, CutRecord):
            del mine[record.kept :]
        else:
            mine.append(record)
    return mine
