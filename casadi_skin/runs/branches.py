"""The branches of a run, followed one after the other, each result kept in the journal as it converges.

What a run follows from branches: branches that leave, curves in two parameters, and edges of tongues of families.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.follow import BranchIterator, BranchRun, following_space, monitored_space
from casadi_skin.follow.rest_space import UnfoldingError
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import EQUILIBRIA, SolutionSpace
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.points.curves import curve_space
from casadi_skin.points.diagram import LEAVING_KINDS, Further
from casadi_skin.points.edges import EdgeCurve
from casadi_skin.points.switch import leaving_space
from casadi_skin.results.saving import (
    BranchRecord,
    CutRecord,
    EdgeRecord,
    EndRecord,
    Records,
    known_of,
    point_record,
    restored,
    saved,
    stability_record,
)
from casadi_skin.results.store import Journal
from casadi_skin.runs.output import Progress
from casadi_skin.runs.parts import Offshoots, ended_well, mode_of
from casadi_skin.runs.request import Request
from casadi_skin.runs.scene import ContinuationTable
from casadi_skin.solve.watch import watched
from casadi_skin.stability.flows import FlowError
from casadi_skin.zero.kinds import EQUILIBRIUM_CURVES, HOPF, ORBIT_CURVES
from casadi_skin.zero.settings import End, Point

BUILTIN_ERRORS = (ZeroDivisionError, OverflowError, FloatingPointError)


@dataclass
class Branches:
    """The branches of a request.

    Attributes:
        branches, seconds: fill as branches end.
        failures: reasons why a part is not as requested, in a line each.
        offshoots: branches and edges followed from families.
    """

    request: Request
    progress: Progress
    branches: list[Branch] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    offshoots: Offshoots = field(default_factory=Offshoots)

    def show(self, name: str, solutions: Sequence[Solution], space: SolutionSpace) -> None:
        """Take the solutions of a branch so far, whenever there are more of them; they stand in tables of a run."""

    @property
    def _with_stability(self) -> bool:
        return self.request.scene.stability is not None

    def follow_all(self, path: Path) -> None:
        """Follow every branch, with every solution in the journal at `path` before anything else happens to it."""
        with Journal(path, msgspec.msgpack.Decoder(BranchRecord)) as journal:
            if journal.fault:
                self.progress.report(f"{path}: {journal.fault}; what follows it is dropped and computed again")
            self.follow(journal)

    def follow(self, journal: Records) -> None:
        """Follow every branch, each result appended to the records before anything else happens to it."""
        try:
            for name, space in self._spaces(journal):
                started = time.perf_counter()
                with self.named(f"mode {name}: " if space.is_family else ""):
                    self._follow(name, space, journal)
                    branch = self.branches[-1]
                    if branch.with_events and branch.space.is_family:
                        self.progress.say(f"j = {name}: changes of stability")
                        branch.diagram_of_changes  # noqa: B018  computed once, and kept by the branch
                        branch.passed_resonances  # noqa: B018  likewise
                self.seconds.append(time.perf_counter() - started)
            self._from_families(journal)
        except (ArithmeticError, ValueError) as error:  # no first orbit exists
            self.failures.append(str(error))

    def _from_families(self, journal: Records) -> None:
        """Branches that leave families, and edges of their tongues, where the scene requests them."""
        table = self.request.scene.continuation
        if self.request.scene.family is None or table is None:
            return
        from casadi_skin.runs.branches import follow_edges, leaving_spaces

        families = [branch for branch in self.branches if len(branch)]
        for name, space in leaving_spaces(families, table, self.failures):
            self.progress.say(name)
            before = len(self.branches)
            try:
                with self.named(f"[continuation] switch: {name}: "):
                    self._follow(name, space, journal)
            finally:  # beside the families, also where it is interrupted
                self.offshoots.leaving += [(name, branch) for branch in self.branches[before:]]
                del self.branches[before:]
        follow_edges(families, table, self.offshoots, self.failures, self.progress, journal)

    @contextmanager
    def named(self, where: str) -> Iterator[None]:
        """Keep a failure of the block in words, so that the next branch is followed."""
        try:
            yield
        except BUILTIN_ERRORS as error:  # not raised by this package, so that it names nothing
            self.failures.append(f"{where}numbers leave the range of double precision ({error})")
        except (ArithmeticError, ValueError) as error:
            self.failures.append(f"{where}{error}")

    def _spaces(self, journal: Records) -> Iterator[tuple[str, SolutionSpace]]:
        """Names and spaces of the branches to follow; a single orbit or solution is kept at once."""
        for family in self.request.families:
            self.progress.say(f"j = {family.mode}: building")
            yield str(family.mode), Family(family)
        scene, table = self.request.scene, self.request.scene.continuation
        if scene.equilibrium is None and scene.orbit is None and scene.solution is None:
            return
        from casadi_skin.runs.first_solution import cycle, cycle_record, first_solution, known_cycle

        simulated = None
        if scene.orbit is not None:
            simulated = known_cycle(journal.records, self.request.ode, self.request.parameters)
            if simulated is None:
                self.progress.say("simulating")
                simulated = cycle(self.request)
                journal.append(cycle_record(simulated))
        self.progress.say("solving")
        with watched(report=self.progress.say):
            first = first_solution(self.request, simulated)
        if table is not None:
            space = following_space(
                first, table.parameter, table.to, at=table.at, max_points=table.max_points, max_step=table.max_step,
                back_to=table.back_to,
            )  # fmt: skip
            model, values = first.space.model, table.monitors or {}
            states = {name: model.full_state[model.state_names.index(name)] for name in values}
            monitors = {f"{name} = {v:g}": states[name] - v for name, v in values.items()}
            yield "branch", monitored_space(space, monitors)
            if scene.has_diagram:
                from casadi_skin.runs.branches import further_spaces

                yield from further_spaces(self.branches, table, self.request.tolerance, self.failures)
            return
        branch = self._alone(first)
        self.show("branch", branch.solutions, branch.space)
        self.branches.append(branch)
        self.seconds.append(0.0)

    def _alone(self, solution: Solution) -> Branch:
        """A single orbit or solution as a branch of one point."""
        end, words = End.REACHED, ""
        if self._with_stability and not solution.space.stability_included:
            try:
                found = solution.space.floquets([solution.point])[0]
                solution = solution.space.solution(solution.point, found, solution.exact)
            except FlowError as error:
                end, words = End.FLOW, str(error)
        return Branch(solution.space, (solution,), (), self._with_stability, end, words)

    def _follow(self, name: str, space: SolutionSpace, journal: Records) -> None:
        """Follow one branch to its end; each result goes to the journal before anything else happens.

        An interruption may come before a result is handed over: its row is added then.
        """
        stability = self.request.scene.stability
        with interrupts_deferred():
            known = known_of(journal.records, name, space, self._with_stability and not space.stability_included)
        if known.fault:
            words = f"{known.fault} in record {known.kept + 1} of {name}; what follows it is dropped and computed again"
            self.progress.report(f"{journal.path}: {words}")
            journal.append(CutRecord(name, known.kept))

        def keep(point: Point, points: BranchIterator) -> None:
            journal.append(point_record(name, point, points, self._with_stability))

        following = BranchRun(
            space, self._with_stability, stability is not None and stability.events, known.solutions,
            waiting=known.waiting, missed=known.missed, keep=keep, unresolved=known.unresolved,
        )  # fmt: skip
        self.show(name, following.solutions, space)
        if known.end is not None:
            self.branches.append(following.finished(known.end.end, known.end.detail, known.end.misses))
            return
        try:
            for result in following:
                point = result.point  # one that its neighbours' multipliers lead to is sought again
                sought_again = point.special and not (point.located or point.requested)
                periodic = result.is_orbit or result.known_floquet is not None
                if periodic and self._with_stability and not sought_again:
                    journal.append(stability_record(name, result))
                self.show(name, following.solutions, space)
                self.progress.solution(result, len(following.solutions))
        finally:
            branch = following.branch()
            if branch.end is None and not branch.stopped:  # interrupted: its changes of stability are not sought now
                branch = replace(branch, with_events=False)
            self.branches.append(branch)
            self.show(name, branch.solutions, space)
        journal.append(EndRecord(name, branch.end, branch.detail, dict(branch.misses), branch.passed_over))


# What a run follows from branches -------------------------------------------------------------------------------------

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
    known: dict[str, Any] = {
        record.branch: record.curve for record in journal.records if isinstance(record, EdgeRecord)
    }
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
                    curve: Any = restored(known[name]) if name in known else None
                    if curve is None:
                        point = family.edge(number - 1, further=listed == FURTHER_EVENTS_FILE)
                        curve = point.curve(asked.parameter, asked.to, **options)
                        _keep(name, curve, journal, progress)
                except (ValueError, ArithmeticError) as error:
                    failures.append(f"[continuation] curve: mode {mode}, edge {number} of {listed}: {error}")
                else:
                    found.edges.append((mode, listed, number, curve))


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
        has_curve = point.mu is None and point.kind in {*EQUILIBRIUM_CURVES, *ORBIT_CURVES}
        at_rest = point.kind == HOPF and point.solution.is_orbit  # cycles have shrunk: their own branch has the curve
        if table.curve is not None and has_curve and not at_rest and not passed:
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
    return bool(np.max(np.abs(x - y)) <= SAME_POINT_DISTANCE * max(1.0, float(np.max(np.abs(x)))))
