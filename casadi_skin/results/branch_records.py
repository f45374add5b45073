"""Records of branches in the journal of a run: points as they converge, their stability, and how a branch ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import msgspec
import numpy as np

from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.walk import Walk
from casadi_skin.stability.localised import LocalisedFloquet
from casadi_skin.stability.result import ContinuousSpectrum, Floquet, FullPeriodFloquet, ReversibleFloquet
from casadi_skin.zero.settings import End, ErrorEstimate, Point, Refinement, Target
from casadi_skin.zero.unresolved import Unresolved


class ReversibleRecord(msgspec.Struct, frozen=True, tag="reversible"):
    """Stability by the N x N problem; arrays as bytes of little-endian doubles."""

    mu: bytes
    mu_error: bytes
    trivial_deviation: float
    power: int
    pairs: int = 1


class LocalisedRecord(msgspec.Struct, frozen=True, tag="localised"):
    """Stability of localised perturbations at the edge of a long tail."""

    mu: bytes
    mu_error: bytes
    trivial_deviation: float
    power: int
    Omega: float
    bands: tuple[tuple[float, float], ...]
    sites: int
    finite_size: bytes
    unresolved: bytes
    counted: int | None = None


class FullPeriodRecord(msgspec.Struct, frozen=True, tag="full period"):
    """Stability by the monodromy matrix."""

    multipliers: bytes
    monodromy: bytes
    trivial: int
    trivial_deviation: float
    other_errors: bytes
    allowed_deviation: float
    log_moduli: bytes = b""
    lost: bool = False


class RefinementRecord(msgspec.Struct, frozen=True):
    """The better solution that shows the error of a point whose stability is not computed yet."""

    resolution: int
    constants: bytes
    z: bytes


class PointRecord(msgspec.Struct, frozen=True, tag="point"):
    """A converged point with all that the continuation needs to go on from it."""

    branch: str
    resolution: int
    constants: bytes  # of the problem: the mesh
    z: bytes
    tangent: bytes
    Omega_error: float
    profile_error: float
    parameter_error: float
    step: float
    along: float
    iterations: int
    requested: bool
    walked: bool
    located: bool
    special: str
    at_round_off: bool
    better: RefinementRecord | None
    missed: tuple[Target, ...]  # by the continuation so far
    unresolved: tuple[Unresolved, ...] = ()  # stretches so far


class StabilityRecord(msgspec.Struct, frozen=True, tag="stability"):
    """Stability of the first point recorded whose stability was not."""

    branch: str
    floquet: ReversibleRecord | LocalisedRecord | FullPeriodRecord


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
    t: bytes
    states: bytes
    start: float
    period: float


class EdgeRecord(msgspec.Struct, frozen=True, tag="edge"):
    """A curve of edges that has ended, as `saving.saved` has it."""

    branch: str
    curve: bytes


BranchRecord = PointRecord | StabilityRecord | EndRecord | CutRecord | CycleRecord | EdgeRecord


class Records(Protocol):
    """Records of branches, kept or not: a journal has these."""

    path: Path
    records: list[BranchRecord]

    def append(self, record: BranchRecord) -> None:
        """Keep one more."""


def doubles_of(data: bytes, kind: str = "<f8") -> np.ndarray:
    return np.frombuffer(data, kind).copy()


def bytes_of(values: np.ndarray, kind: str = "<f8") -> bytes:
    return values.astype(kind).tobytes()


# Writing ------------------------------------------------------------------------------------------------------------


def point_record(branch: str, point: Point, walk: Walk | None = None, with_better: bool = False) -> PointRecord:
    """Record of a point of the branch of that name; with its better solution where its stability is to be computed."""
    better = point.better if with_better else None
    return PointRecord(
        branch=branch,
        resolution=point.problem.resolution,
        constants=bytes_of(point.problem.constants),
        z=bytes_of(point.z),
        tangent=bytes_of(point.tangent),
        Omega_error=point.error.Omega,
        profile_error=point.error.profile,
        parameter_error=point.error.parameter,
        step=point.step,
        along=point.along,
        iterations=point.iterations,
        requested=point.requested,
        walked=point.walked,
        located=point.located,
        special=point.special,
        at_round_off=point.at_round_off,
        better=None
        if better is None
        else RefinementRecord(better.problem.resolution, bytes_of(better.problem.constants), bytes_of(better.z)),
        missed=() if walk is None else tuple(walk.missed),
        unresolved=() if walk is None else tuple(walk.unresolved),
    )


def stability_record(branch: str, orbit: Solution) -> StabilityRecord:
    """Record of the stability of the next orbit of a branch."""
    floquet = orbit.floquet()
    if isinstance(floquet, LocalisedFloquet):
        found: ReversibleRecord | LocalisedRecord | FullPeriodRecord = LocalisedRecord(
            bytes_of(floquet.mu, "<c16"), bytes_of(floquet.mu_error), floquet.trivial_deviation, floquet.power,
            floquet.continuous.Omega, floquet.continuous.bands, floquet.sites, bytes_of(floquet.finite_size, "<c16"),
            bytes_of(floquet.unresolved, "<c16"), floquet.counted,
        )  # fmt: skip
    elif isinstance(floquet, ReversibleFloquet):
        mu, errors = bytes_of(floquet.mu, "<c16"), bytes_of(floquet.mu_error)
        found = ReversibleRecord(mu, errors, floquet.trivial_deviation, floquet.power, floquet.pairs)
    else:
        assert isinstance(floquet, FullPeriodFloquet)
        multipliers, monodromy = bytes_of(floquet.multipliers, "<c16"), bytes_of(floquet.monodromy)
        found = FullPeriodRecord(
            multipliers, monodromy, floquet.trivial, floquet.trivial_deviation, bytes_of(floquet.other_errors),
            floquet.allowed_deviation, bytes_of(floquet.log_moduli), floquet.lost,
        )  # fmt: skip
    return StabilityRecord(branch, found)


# Branches read back from the journal of a run: their points are verified ----------------------------------------------


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
        if isinstance(record, PointRecord):
            point = _point(record, space)
            known.fault = "a point of another discretisation" if point is None else _fault(space, point, known)
            if point is None or known.fault:
                return known
            known.missed, known.unresolved = record.missed, record.unresolved
            if stability:
                known.waiting.append(point)
            else:
                known.solutions.append(space.solution(point))
        elif isinstance(record, StabilityRecord):
            known.solutions.append(space.solution(known.waiting.pop(0), _floquet(record.floquet)))
        else:
            known.end, known.unresolved = record, record.unresolved
        known.kept += 1
    return known


def _fault(space: SolutionSpace, point: Point, known: Known) -> str:
    """Reason why a point is none of the branch; of a special point, whose equations may be singular, by residual."""
    leaves = bool(getattr(space, "leaves", False)) and not (known.solutions or known.waiting)
    if not (point.special or leaves):
        return space.point_solver.fault(point)
    if not (np.all(np.isfinite(point.z)) and np.all(np.isfinite(point.tangent))):
        return "a value that is not finite"
    off = point.problem.relative_residual(point.z)
    return "" if off <= max(space.tolerance, point.error.profile) else f"a residual of {off:.1e}"


def _holding(records: Sequence[BranchRecord], branch: str) -> list[PointRecord | StabilityRecord | EndRecord]:
    """The records of a branch that hold."""
    mine = list[PointRecord | StabilityRecord | EndRecord]()
    for record in records:
        if record.branch != branch:
            continue
        if isinstance(record, CycleRecord | EdgeRecord):
            continue
        if isinstance(record, CutRecord):
            del mine[record.kept :]
        else:
            mine.append(record)
    return mine


def _point(record: PointRecord, space: SolutionSpace) -> Point | None:
    """The point of a record; None where the problem has another number of unknowns."""
    if record.resolution not in space.levels.resolutions:
        return None
    problem = space.levels.problem(record.resolution)
    constants, z, tangent = doubles_of(record.constants), doubles_of(record.z), doubles_of(record.tangent)
    if (constants.size, z.size, tangent.size) != (problem.constants.size, problem.size, problem.size):
        return None
    return Point(
        problem=problem.with_constants(constants),
        z=z,
        tangent=tangent,
        error=ErrorEstimate(record.Omega_error, record.profile_error, parameter=record.parameter_error),
        step=record.step,
        along=record.along,
        iterations=record.iterations,
        requested=record.requested,
        walked=record.walked,
        located=record.located,
        special=record.special,
        better=None if record.better is None else _refinement(record.better, space),
        at_round_off=record.at_round_off,
    )


def _refinement(record: RefinementRecord, space: SolutionSpace) -> Refinement:
    problem = space.levels.problem(record.resolution).with_constants(doubles_of(record.constants))
    return Refinement(problem, doubles_of(record.z))


def _floquet(record: ReversibleRecord | LocalisedRecord | FullPeriodRecord) -> Floquet:
    if isinstance(record, LocalisedRecord):
        mu, weak, left = (doubles_of(values, "<c16") for values in (record.mu, record.finite_size, record.unresolved))
        continuous = ContinuousSpectrum(record.Omega, record.bands, record.power)
        errors, deviation = doubles_of(record.mu_error), record.trivial_deviation
        return LocalisedFloquet(
            mu, errors, deviation, record.power, continuous, record.sites, weak, left, record.counted
        )
    if isinstance(record, ReversibleRecord):
        mu, errors = doubles_of(record.mu, "<c16"), doubles_of(record.mu_error)
        return ReversibleFloquet(mu, errors, record.trivial_deviation, record.power, pairs=record.pairs)
    multipliers = doubles_of(record.multipliers, "<c16")
    monodromy = doubles_of(record.monodromy).reshape(multipliers.size, multipliers.size)
    errors, logs = doubles_of(record.other_errors), doubles_of(record.log_moduli)
    return FullPeriodFloquet(
        multipliers, monodromy, record.trivial, record.trivial_deviation, errors, record.allowed_deviation, logs,
        record.lost,
    )  # fmt: skip
