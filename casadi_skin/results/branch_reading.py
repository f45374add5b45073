"""Branches read back from the journal of a run: their points are verified.

Each point is solved for again, and is refused where a Newton step moves it away.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from casadi_skin.follow.making import solution_at
from casadi_skin.follow.settings import Point, Target
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.unresolved import Unresolved
from casadi_skin.results.branch_records import (
    BranchRecord,
    CutRecord,
    CycleRecord,
    EdgeRecord,
    EndRecord,
    FullPeriodRecord,
    LocalisedRecord,
    PointRecord,
    RefinementRecord,
    ReversibleRecord,
    StabilityRecord,
    doubles_of,
)
from casadi_skin.solve.estimates import ErrorEstimate, Refinement
from casadi_skin.stability.continuous import ContinuousSpectrum
from casadi_skin.stability.localised import LocalisedFloquet
from casadi_skin.stability.result import Floquet, FullPeriodFloquet, ReversibleFloquet


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
                known.solutions.append(solution_at(space, point))
        elif isinstance(record, StabilityRecord):
            known.solutions.append(solution_at(space, known.waiting.pop(0), _floquet(record.floquet)))
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
