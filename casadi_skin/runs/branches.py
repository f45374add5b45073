"""The branches of a run, followed one after the other, each result kept in the journal as it converges."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path

import msgspec

from casadi_skin.follow.boundary_space import up_to_period
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.follow import BranchIterator, BranchRun, following_space, held_space, monitored_space
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.results.branch_records import (
    BranchRecord,
    CutRecord,
    EndRecord,
    Records,
    known_of,
    point_record,
    stability_record,
)
from casadi_skin.results.store import Journal
from casadi_skin.runs.output import Progress
from casadi_skin.runs.parts import Offshoots
from casadi_skin.runs.request import Request
from casadi_skin.solve.watch import watched
from casadi_skin.stability.flows import FlowError
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
        from casadi_skin.runs.further import follow_edges, leaving_spaces

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
            space = up_to_period(held_space(space, table.fixed), table.period_max)
            model, values = first.space.model, table.monitors or {}
            states = {name: model.full_state[model.state_names.index(name)] for name in values}
            monitors = {f"{name} = {v:g}": states[name] - v for name, v in values.items()}
            yield "branch", monitored_space(space, monitors)
            if scene.has_diagram:
                from casadi_skin.runs.further import further_spaces

                yield from further_spaces(self.branches, table, self.request.tolerance, self.failures)
            return
        branch = self.alone(first)
        self.show("branch", branch.solutions, branch.space)
        self.branches.append(branch)
        self.seconds.append(0.0)

    def alone(self, solution: Solution) -> Branch:
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
        numbers = count(known.kept)  # of the records of this branch

        def keep(point: Point, points: BranchIterator) -> None:
            journal.append(point_record(name, next(numbers), point, points, self._with_stability))

        following = BranchRun(
            space, self._with_stability, stability is not None and stability.events, known.solutions,
            waiting=known.waiting, missed=known.missed, keep=keep, unresolved=known.unresolved,
        )  # fmt: skip
        self.show(name, following.solutions, space)
        if known.end is not None:
            self.branches.append(following.branch(known.end.end, known.end.detail))
            return
        try:
            for result in following:
                point = result.point  # one that its neighbours' multipliers lead to is sought again
                sought_again = point.special and not (point.located or point.requested)
                periodic = result.is_orbit or result.known_floquet is not None
                if periodic and self._with_stability and not sought_again:
                    journal.append(stability_record(name, next(numbers), result))
                self.show(name, following.solutions, space)
                self.progress.solution(result, len(following.solutions))
        finally:
            branch = following.branch()
            if branch.end is None and not branch.stopped:  # interrupted: its changes of stability are not sought now
                branch = replace(branch, with_events=False)
            self.branches.append(branch)
            self.show(name, branch.solutions, space)
        journal.append(EndRecord(name, next(numbers), branch.end, branch.detail, branch.passed_over))
