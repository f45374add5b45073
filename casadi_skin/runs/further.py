"""What a run follows from branches: branches that leave, curves in two parameters, and edges of tongues of families."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.rest_space import UnfoldingError
from casadi_skin.follow.space import EQUILIBRIA, SolutionSpace
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.points.curves import curve_space
from casadi_skin.points.diagram import LEAVING_KINDS, Further
from casadi_skin.points.edges import EdgeCurve, EdgePoint
from casadi_skin.points.switch import leaving_space
from casadi_skin.results.branch_records import EdgeRecord, Records
from casadi_skin.results.saving import restored, saved
from casadi_skin.results.store import DAMAGED_FILE_ERRORS, SavedResult
from casadi_skin.runs.output import Progress
from casadi_skin.runs.parts import Offshoots, ended_well, mode_of
from casadi_skin.runs.scene import ContinuationTable
from casadi_skin.zero.kinds import HOPF
from casadi_skin.zero.settings import End

EVENTS_FILE, FURTHER_EVENTS_FILE = "events.csv", "further_events.csv"  # where edges are listed


def reasons(found: Offshoots) -> Iterator[str]:
    """Why something that was followed from families did not end well, in a line each."""
    for name, branch in found.leaving:
        if not ended_well(branch):
            yield f"[continuation] switch: {name}: {branch.reason}"
    for mode, listed, number, curve in found.edges:
        if not curve.complete:
            yield f"[continuation] curve: mode {mode}, edge {number} of {listed}: {curve.reason}"


def leaving_spaces(
    families: Sequence[Branch], table: ContinuationTable, failures: list[str]
) -> Iterator[tuple[str, SolutionSpace]]:
    """Names and spaces of the branches that leave families at special points of the requested kinds."""
    for family in families:
        for number, point in enumerate(family.special_points, start=1):
            if point.kind not in table.switch:
                continue
            options = {"at": (), "max_points": table.max_points, "max_step": table.max_step, "tolerance": 1e-8}
            try:
                space = leaving_space(point, "S", table.to, side=1, **options)  # type: ignore[arg-type]
            except (ValueError, ArithmeticError) as error:
                where = f"mode {mode_of(family)}, {point.kind} at S = {point.parameters['S']:.8g}"
                failures.append(f"[continuation] switch: {where}: {error}")
            else:
                yield f"other_j{mode_of(family)}_{number}", space


def follow_edges(
    families: Sequence[Branch], table: ContinuationTable, found: Offshoots, failures: list[str], progress: Progress,
    journal: Records,
) -> None:  # fmt: skip
    """Follow edges of tongues of families in the second parameter; those that the journal holds are not followed again.

    They are those of every change of stability, and where the scene requests it those between unstable orbits.
    """
    asked = table.curve
    if asked is None:
        return
    known = {record.branch: record.curve for record in journal.records if isinstance(record, EdgeRecord)}
    options = {"max_points": table.max_points, "max_step": table.max_step}
    for family in families:
        mode, diagram = mode_of(family), family.stability_diagram
        if family.localised_diagram is not None:
            words = "changes of localised multipliers are not followed in another parameter"
            failures.append(f"[continuation] curve: mode {mode}: {words}")
            continue
        further = len(diagram.further) if diagram and asked.further else 0
        for listed, count in ((EVENTS_FILE, len(family.changes)), (FURTHER_EVENTS_FILE, further)):
            for number in range(1, count + 1):
                name = f"{listed} {mode} {number}"
                progress.say(f"j = {mode}: edge {number} of {count} in {asked.parameter}")
                try:
                    point = family.edge(number - 1, further=listed == FURTHER_EVENTS_FILE)
                    curve: Any = _known(known[name], point) if name in known else None
                    if curve is None:
                        if name in known:
                            progress.report(f"{journal.path}: the record of {name} is none of it; it is followed again")
                        curve = point.curve(asked.parameter, asked.to, **options)
                        _keep(name, curve, journal, progress)
                except (ValueError, ArithmeticError) as error:
                    failures.append(f"[continuation] curve: mode {mode}, edge {number} of {listed}: {error}")
                else:
                    found.edges.append((mode, listed, number, curve))


def _known(data: SavedResult, point: SpecialPoint) -> EdgeCurve | None:
    """The curve of a record, unless it is none that begins at the edge."""
    try:
        curve = restored(data)
        first: EdgePoint = curve.points[0]
        values = {**first.orbit.parameters, "S": first.edge.value}
        near = all(abs(values[k] - v) <= SAME_POINT_DISTANCE * abs(v) for k, v in point.parameters.items())
        return curve if near and isinstance(curve, EdgeCurve) else None
    except DAMAGED_FILE_ERRORS:
        return None


def _keep(name: str, curve: EdgeCurve, journal: Records, progress: Progress) -> None:
    """Append a curve to the journal, where its model can be saved."""
    try:
        journal.append(EdgeRecord(name, saved(curve)))
    except ValueError as error:
        progress.report(f"{journal.path}: {error}; the edge is followed again by --resume")


CYCLES, OTHER, CURVE = "cycles", "other", "curve"
SAME_POINT_DISTANCE = 1e-6  # distance of special points that are one


def further_spaces(
    branches: Sequence[Branch], table: ContinuationTable, tolerance: float, failures: list[str]
) -> Iterator[tuple[str, SolutionSpace]]:
    """Names and spaces of the branches that leave at special points, then of the curves through them.

    `branches` grows: its last one is what was followed for the name and space before. A name ends with the numbers of
    the special points that lead to it; a special point that was met before is not left again. Branches that cannot be
    started are named in `failures`.
    """
    options = {"max_points": table.max_points, "max_step": table.max_step}
    kinds = table.switch or (() if table.depth is None else LEAVING_KINDS)
    depth, halves = (float("inf"), 1) if table.depth is None else (table.depth, 2)
    further = Further(branches[-1], kinds, depth, {**options, "tolerance": tolerance}, halves)
    for name, point, space in further:
        if len(further.branches) == table.limit:
            most = "one branch belongs" if table.limit == 1 else f"{table.limit} branches belong"
            failures.append(f"[continuation] limit: more than {most} to the diagram")
            break
        has_cycles = point.kind == HOPF and point.solution.space.connects == EQUILIBRIA
        yield f"{CYCLES if has_cycles else OTHER}{name}", space
        if branches[-1].space is space:
            further.add(branches[-1], space, point)
    failures += [f"[continuation] switch: {line}" for line in further.failures]
    curves = list[Branch]()
    for place, point in further.reached:
        passed = any(_passes(curve, point) for curve in curves)
        if table.curve is not None and point.has_curve and not passed:
            try:
                space = curve_space(point, table.curve.parameter, table.curve.to, at=(), **options)
                yield f"{CURVE}{place}", space
            except UnfoldingError:  # it is one at these values alone
                continue
            except (ValueError, ArithmeticError) as error:
                failures.append(f"[continuation] curve: {point.kind} {place[1:]}: {error}")
            else:
                curves.append(branches[-1])


def _passes(curve: Branch, point: SpecialPoint) -> bool:
    """Whether a curve that came back to the value of its parameter did so at another special point."""
    if curve.end is not End.RETURNED or curve.space.kind != point.kind:
        return False
    try:
        found = curve.at(point.parameters[curve.parameter], which=1)
    except (ValueError, ArithmeticError):
        return False
    if found.space.connects != EQUILIBRIA:
        a, b = found.parameters[point.parameter], point.parameters[point.parameter]
        return bool(abs(a - b) <= SAME_POINT_DISTANCE * max(abs(a), abs(b)))
    x, y = found.positions, point.solution.evaluate(0.0)[: found.positions.size]
    largest = max(float(np.max(np.abs(one.positions))) for one in curve.solutions)
    return bool(np.max(np.abs(x - y)) <= SAME_POINT_DISTANCE * largest)
