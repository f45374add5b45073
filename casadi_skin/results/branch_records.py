"""Records of branches in the journal of a run: points as they converge, stability, ends.

A record is a tagged struct; points, multipliers, outcomes and curves are data in it as `store` writes results. What is
read back is verified before a branch goes on from it, as a file may have been edited: points solve their equations, the
records of a branch have their numbers, and its end is where the last point is.
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
from casadi_skin.model.arguments import in_words
from casadi_skin.results.store import DAMAGED_FILE_ERRORS, Reader, SavedResult, Writer
from casadi_skin.stability.flows import FlowError
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.settings import End, Point, Target


class PointRecord(msgspec.Struct, frozen=True, tag="point"):
    """A converged point with all that the continuation needs to go on from it; `number` counts records of a branch."""

    branch: str
    number: int
    point: Any
    missed: tuple[Target, ...] = ()  # by the continuation so far
    unresolved: tuple[Unresolved, ...] = ()  # stretches so far


class StabilityRecord(msgspec.Struct, frozen=True, tag="stability"):
    """Stability of the first point recorded whose stability was not."""

    branch: str
    number: int
    floquet: Any


class EndRecord(msgspec.Struct, frozen=True, tag="end"):
    """The end of a branch."""

    branch: str
    number: int
    end: End | None
    detail: str
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


HeldRecord = PointRecord | StabilityRecord | EndRecord
BranchRecord = HeldRecord | CutRecord | CycleRecord | EdgeRecord
SAME_MULTIPLIER_RTOL = 1e-6  # of multipliers that are computed again, perhaps by another processor


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
    branch: str, number: int, point: Point, points: BranchIterator | None = None, with_better: bool = False
) -> PointRecord:
    """Record of a point of the branch of that name; with its better solution where its stability is to be computed."""
    data = data_of(point if with_better else replace(point, better=None))
    if points is None:
        return PointRecord(branch, number, data)
    return PointRecord(branch, number, data, tuple(points.missed), tuple(points.unresolved))


def stability_record(branch: str, number: int, orbit: Solution) -> StabilityRecord:
    """Record of the stability of the next orbit of a branch."""
    return StabilityRecord(branch, number, data_of(orbit.floquet()))


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
    """The state of a branch by its records, up to the first that does not hold."""
    held = _holding(records, branch)
    known = _known(held, space, stability)
    if stability and known.solutions:
        place, fault = _doubtful(known.solutions)
        if fault:
            of_stability = [k for k, record in enumerate(held) if isinstance(record, StabilityRecord)]
            known = _known(held[: of_stability[place]], space, stability)
            known.fault = fault
    return known


def _known(held: Sequence[HeldRecord], space: SolutionSpace, stability: bool) -> Known:
    """The state of a branch by records of its own, up to the first that is none where it stands."""
    known = Known()
    for record in held:
        try:
            known.fault = _taken(record, known, space, stability)
        except DAMAGED_FILE_ERRORS as error:
            known.fault = in_words(error)
        if known.fault:
            break
        known.kept += 1
    return known


def _doubtful(solutions: Sequence[Solution]) -> tuple[int, str]:
    """The solution whose multipliers differ most from those beside it, and what is wrong with them, computed again."""
    sizes = np.array([solution.floquet().max_abs_multiplier for solution in solutions])
    jumps = np.abs(np.diff(sizes, prepend=sizes[:1], append=sizes[-1:]))
    jumps[[0, -1]] = np.inf  # at the ends of what is known it is the other side that counts
    place = int(np.argmax(np.minimum(jumps[:-1], jumps[1:]))) if sizes.size > 1 else 0
    read = solutions[place].floquet()
    try:
        again = solutions[place].space.floquets([solutions[place].point])[0]
    except FlowError:
        return place, ""
    off = abs(again.max_abs_multiplier - read.max_abs_multiplier)
    same = read.multipliers.shape == again.multipliers.shape and read.stable == again.stable
    allowed = again.error + SAME_MULTIPLIER_RTOL * again.max_abs_multiplier
    return place, "" if same and off <= allowed else f"multipliers that are others, computed again, (off by {off:.1e})"


def _taken(record: HeldRecord, known: Known, space: SolutionSpace, stability: bool) -> str:
    """Add a record to what is known; the reason where it does not hold."""
    if known.end is not None or record.number != known.kept:
        return f"{'an end' if known.end is not None else f'the number {record.number + 1}'}, where others are missing,"
    if isinstance(record, EndRecord):
        if record.end is End.REACHED and not _at_end(known, space):
            return "an end that the points do not reach"
        known.end, known.unresolved = record, record.unresolved
    elif isinstance(record, StabilityRecord):
        found = value_of(record.floquet)
        shapes = {found.others.shape, found.other_errors.shape, found.on_circle.shape, found.real.shape}
        if len(shapes) > 1 or found.multipliers.shape != found.log_moduli.shape:
            return "multipliers of another number"
        known.solutions.append(space.solution(known.waiting.pop(0), found))
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


def _at_end(known: Known, space: SolutionSpace) -> bool:
    """Whether the last point is where the branch is to end, unless no point was found there."""
    points, ends = [*(solution.point for solution in known.solutions), *known.waiting], space.point_solver.settings.ends
    last = points[-1] if points else space.start
    return any(end in known.missed or end.meets(last) for end in ends)


def _fault(space: SolutionSpace, point: Point, known: Known) -> str:
    """Reason why a point is none of the branch; of a special point, whose equations may be singular, by residual."""
    leaves = bool(getattr(space, "leaves", False)) and not (known.solutions or known.waiting)
    if not (point.special or leaves):
        return str(space.point_solver.fault(point))
    if not (np.all(np.isfinite(point.z)) and np.all(np.isfinite(point.tangent))):
        return "a value that is not finite"
    off = point.problem.relative_residual(point.z)
    return "" if off <= max(space.tolerance, point.error.profile) else f"a residual of {off:.1e}"


def _holding(records: Sequence[BranchRecord], branch: str) -> list[HeldRecord]:
    """The records of a branch that hold."""
    mine = list[HeldRecord]()
    for record in records:
        if record.branch != branch or isinstance(record, CycleRecord | EdgeRecord):
            continue
        if isinstance(record, CutRecord):
            del mine[record.kept :]
        else:
            mine.append(record)
    return mine
