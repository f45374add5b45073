"""Running a scene: branches one after the other, every solution kept as it converges, and all files at the end."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from casadi_skin.continuation.points import End, Point, Target
from casadi_skin.files import replacing
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.follow import following_space
from casadi_skin.orbits.following import Following
from casadi_skin.orbits.making import solution_at
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.space import SolutionSpace
from casadi_skin.orbits.stability_changes import StabilityChange
from casadi_skin.progress import Progress
from casadi_skin.results.branch_records import (
    BranchRecord,
    CutRecord,
    EndRecord,
    known_of,
    point_record,
    stability_record,
)
from casadi_skin.results.dataset import Cell, write_csv
from casadi_skin.results.journal import Journal
from casadi_skin.results.quantities import certified, csv_row, quantities_of
from casadi_skin.results.quantity import Place
from casadi_skin.runs.directory import JOURNAL, SCENE_MODEL, renew
from casadi_skin.runs.request import Request
from casadi_skin.runs.writing import mode_of, origin, write_branches, write_spectrum
from casadi_skin.stability.flow import FlowError
from casadi_skin.threads import one_thread

if TYPE_CHECKING:
    from casadi_skin.dynamics import Evolution
    from casadi_skin.optimise.result import SearchResult

BUILTIN = (ZeroDivisionError, OverflowError, FloatingPointError)
TABLE_PERIOD = 0.5  # seconds between two writings of the table while a run goes on


@dataclass
class Run:
    """One run of a request into a directory that is ready for it (see runs.directory).

    Attributes:
        branches, seconds: fill as branches end; an exception or an interruption leaves what was computed in the files
            and in the journal.
        failures: why a part is not what was asked for, in a line each, with the table that asked for it.
        evolution: the time evolution, as far as it could be followed.
        search: the result of a search.
        exported: what was written for use outside of Python.
    """

    request: Request
    scene_text: str
    directory: Path
    progress: Progress
    branches: list[Branch] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    evolution: Evolution | None = None
    search: SearchResult | None = None
    exported: tuple[Path, ...] = ()
    _tables: dict[str, list[dict[str, Cell]]] = field(default_factory=dict)
    _table: str = "branch.csv"
    _written: float = 0.0

    @property
    def _rows(self) -> list[dict[str, Cell]]:
        """Rows of the table of the branch that is followed."""
        return self._tables.setdefault(self._table, [])

    @property
    def _with_stability(self) -> bool:
        return self.request.scene.stability is not None

    @property
    def _with_events(self) -> bool:
        stability = self.request.scene.stability
        return stability is not None and stability.events

    def execute(self) -> bool:
        """Compute, write, and tell whether all that was asked for was found."""
        (self.directory / JOURNAL).touch()
        if self.request.path is not None:
            with replacing(self.directory / f"{SCENE_MODEL}{self.request.path.suffix}") as temporary:
                temporary.write_text(self.request.source, encoding="utf-8")
        try:
            with one_thread():
                self._follow_all()
        finally:
            with interrupts_deferred():  # all files are written before an interruption ends the run
                self._write_results()
        self._evolve()
        self._search()
        self._export()
        complete = all(self._ended_well(branch) for branch in self.branches) and not self.failures
        if complete:
            (self.directory / JOURNAL).unlink(missing_ok=True)
        return complete

    def reasons(self) -> list[str]:
        """Why the run is not what was asked for, in a line each."""
        reasons = []
        for branch in self.branches:
            if self._ended_well(branch):
                continue
            if isinstance(branch.space, Family):
                reasons.append(f"mode {branch.space.coordinates.mode_number}: {branch.reason}")
            else:
                table = "continuation" if branch.parameter else "stability"
                reasons.append(f"[{table}]: {branch.reason}")
        return [*reasons, *self.failures]

    def _ended_well(self, branch: Branch) -> bool:
        """Whether a branch reached what was asked, or the natural end of what leaves another one."""
        if self.request.scene.equilibrium is None:
            return branch.complete
        from casadi_skin.runs.diagram import ended_well

        return ended_well(branch)

    # Branches -------------------------------------------------------------------------------------------------------

    def _follow_all(self) -> None:
        path = self.directory / JOURNAL
        if self.request.scene.search is not None:  # its journal is of another kind
            return
        with Journal(path, msgspec.msgpack.Decoder(BranchRecord)) as journal:
            if journal.fault:
                self.progress.tell(f"{path}: {journal.fault}; what follows it is dropped and computed again")
            try:
                for name, space in self._spaces(journal):
                    started = time.perf_counter()
                    with self._named(f"mode {name}: " if isinstance(space, Family) else ""):
                        self._follow(name, space, journal)
                        self._seek_changes(name, self.branches[-1])
                    self.seconds.append(time.perf_counter() - started)
            except (ArithmeticError, ValueError) as error:  # of a first orbit that is not found
                self.failures.append(str(error))

    @contextmanager
    def _named(self, where: str) -> Iterator[None]:
        """Keep a failure of the block in words, so that the next branch is followed."""
        try:
            yield
        except BUILTIN as error:  # not raised by this package, so that it names nothing
            self.failures.append(f"{where}numbers leave the range of double precision ({error})")
        except (ArithmeticError, ValueError) as error:
            self.failures.append(f"{where}{error}")

    def _seek_changes(self, name: str, branch: Branch) -> None:
        """Every change of stability of a family, where the scene asks for events."""
        if branch.with_events and isinstance(branch.space, Family):
            self.progress.say(f"j = {name}: changes of stability")
            branch.stability_diagram  # noqa: B018  computed once, and kept by the branch

    def _spaces(self, journal: Journal[BranchRecord]) -> Iterator[tuple[str, SolutionSpace]]:
        """Names and spaces of the branches to follow; what is a single orbit or solution is kept at once."""
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
        first = first_solution(self.request, simulated)
        if table is not None:
            yield (
                "branch",
                following_space(
                    first, table.parameter, table.to, at=table.at, max_points=table.max_points, max_step=table.max_step
                ),
            )
            if scene.equilibrium is not None:
                from casadi_skin.runs.diagram import further_spaces

                yield from further_spaces(self.branches, table, self.request.tolerance, self.failures)
            return
        branch = self._alone(first)
        self._keep(branch.solutions, branch.space)
        self.branches.append(branch)
        self.seconds.append(0.0)

    def _alone(self, solution: Solution) -> Branch:
        """A single orbit or solution as a branch of one point."""
        end, words = End.REACHED, ""
        if self._with_stability and not solution.space.knows_stability:
            try:
                found = solution.space.floquets([solution.point])[0]
                solution = solution_at(solution.space, solution.point, found, solution.exact)
            except FlowError as error:
                end, words = End.FLOW, str(error)
        return Branch(solution.space, (solution,), (), self._with_stability, end, words)

    def _follow(self, name: str, space: SolutionSpace, journal: Journal[BranchRecord]) -> None:
        """Follow one branch to its end; each result goes to the journal before anything else happens.

        An interruption may come before a result is handed over: its row is added then.
        """
        self._table = "family.csv" if isinstance(space, Family) else f"{name}.csv"
        with interrupts_deferred():
            known = known_of(journal.records, name, space, self._with_stability and not space.knows_stability)
        if known.fault:
            words = f"{known.fault} in record {known.kept + 1} of {name}; what follows it is dropped and computed again"
            self.progress.tell(f"{journal.path}: {words}")
            journal.append(CutRecord(name, known.kept))

        def keep(point: Point, missed: Sequence[Target]) -> None:
            journal.append(point_record(name, point, missed, self._with_stability))

        following = Following(
            space, self._with_stability, self._with_events, known.solutions, known.changes,
            waiting=known.waiting, missed=known.missed, keep=keep,
        )  # fmt: skip
        if known.end is not None:
            self._keep(following.solutions, space)
            self.branches.append(following.finished(known.end.end, known.end.detail, known.end.misses))
            return
        before, changes = len(self._rows), list[StabilityChange]()
        self._keep(following.solutions, space)
        try:
            for result in following:
                if isinstance(result, StabilityChange):
                    changes.append(result)
                    continue
                sought_again = result.point.special and not result.point.located  # by the multipliers of its neighbours
                if isinstance(result, Orbit) and self._with_stability and not sought_again:
                    journal.append(stability_record(name, result, changes))
                    changes.clear()
                self._keep([result], space)
                self.progress.solution(result, len(following.solutions))
        finally:
            branch = following.branch()
            if branch.end is None and not branch.stopped:  # interrupted: its changes of stability are not sought now
                branch = replace(branch, with_events=False)
            self.branches.append(branch)
            self._keep(branch.solutions[len(self._rows) - before :], space)
        journal.append(EndRecord(name, branch.end, branch.detail, dict(branch.misses)))

    # Other parts ----------------------------------------------------------------------------------------------------

    def _evolve(self) -> None:
        """The time evolution with its files, where the scene asks for one; nothing of it is imported elsewhere."""
        if self.request.scene.dynamics is None or not self.branches:
            return
        from casadi_skin.dynamics import EvolutionError
        from casadi_skin.runs.dynamics import evolve_scene, scene_orbit, write_dynamics

        self.progress.say("time evolution")
        try:
            orbit = scene_orbit(self.request, self.branches)
            self.evolution = evolve_scene(self.request, orbit)
        except EvolutionError as error:
            self.evolution = error.evolution
            self.failures.append(f"[dynamics]: {error}")
        except (ValueError, ArithmeticError) as error:
            self.failures.append(f"[dynamics]: {error}")
        if self.evolution is not None:
            self.progress.say("writing the time evolution")
            with interrupts_deferred():
                write_dynamics(self.request, self.scene_text, orbit, self.evolution, self.directory)

    def _export(self) -> None:
        """What the scene wants out of Python; nothing of it is imported elsewhere."""
        if self.request.scene.export is None:
            return
        from casadi_skin.runs.export import export_scene

        self.progress.say("exporting")
        try:
            self.exported = export_scene(self.request, self.branches, self.directory)
        except (ValueError, ArithmeticError) as error:
            self.failures.append(f"[export]: {error}")

    def _search(self) -> None:
        """The search with its files, where the scene asks for one."""
        if self.request.scene.search is None:
            return
        from casadi_skin.optimise.result import SearchStatus
        from casadi_skin.runs.search import COMPLETE, run_search, write_results

        self.search = run_search(self.request, self.directory / JOURNAL, self.progress)
        self.progress.say("writing the search")
        write_results(self.request, self.scene_text, self.search, self.directory)
        if self.search.status is SearchStatus.INTERRUPTED:
            raise KeyboardInterrupt
        if self.search.status not in COMPLETE:
            self.failures.append(f"[search]: {self.search.reason}")

    # Writing --------------------------------------------------------------------------------------------------------

    def _keep(self, solutions: Sequence[Solution], space: SolutionSpace) -> None:
        """Add rows to the table, which is replaced at most every TABLE_PERIOD."""
        mode = space.coordinates.mode_number if isinstance(space, Family) else 0
        for solution in solutions:
            quantities = quantities_of(Branch(space, (solution,), with_stability=self._with_stability))
            index = sum(row.get("mode", 0) == mode for row in self._rows)
            place = Place(solution, index, mode, solution.point.requested, solution.point.special)
            self._rows.append(csv_row(quantities, place))
        if self._rows and time.monotonic() - self._written > TABLE_PERIOD:
            self._write_table(self._table)

    def _write_table(self, name: str) -> None:
        rows = self._tables[name]
        write_csv(self.directory / name, list(rows[0]), rows)
        self._written = time.monotonic()

    def _write_results(self) -> None:
        self.progress.say("writing tables and pictures")
        if not self.directory.exists():
            renew(self.directory, self.scene_text)
            self.failures.append(f"{self.directory}: was removed during the run; what was computed is there again")
        if self.request.scene.spectrum is not None:
            write_spectrum(self.request, self.directory)
        branches = [branch for branch in self.branches if len(branch)]
        if not branches:
            return
        try:
            self._write_branches(branches)
        except ArithmeticError as error:  # a value that is not finite
            self.failures.append(str(error))
        self._tell_drift(branches)
        self._tell_unproved(branches)

    def _write_branches(self, branches: Sequence[Branch]) -> None:
        """The table of points, and what is made of whole branches."""
        for name in [name for name, rows in self._tables.items() if rows]:
            self._write_table(name)
        if self.request.scene.equilibrium is not None:
            from casadi_skin.runs.diagram import write_diagram

            names = [name.removesuffix(".csv") for name, rows in self._tables.items() if rows]
            write_diagram(self.request, names, branches, origin(self.request, self.scene_text), self.directory)
            return
        write_branches(self.request, branches, self.scene_text, self.directory, self.progress)

    def _tell_unproved(self, branches: Sequence[Branch]) -> None:
        """Say which orbits no proof was found for."""
        for branch in branches:
            proofs = certified(branch)
            missing = [orbit for orbit in proofs if not orbit.certificate.proved]
            if missing:
                count = f"mode {mode_of(branch)}: {len(missing)} of {len(proofs)} orbits are not proved"
                first = f"the first at S = {missing[0].S:.6g}: {missing[0].certificate.reason}"
                self.failures.append(f"[accuracy] certify: {count}, {first}")

    def _tell_drift(self, branches: Sequence[Branch]) -> None:
        """Say where trivial multipliers are farther from their value than errors allow."""
        if not self._with_stability:
            return
        found = [s.floquet() for branch in branches for s in branch.solutions if isinstance(s, Orbit)]
        off = [f for f in found if f.trivial_deviation > f.allowed_deviation]
        if off:
            worst = max(off, key=lambda f: f.trivial_deviation / f.allowed_deviation)
            count = f"{len(off)} of {len(found)} points"
            size = f"by up to {worst.trivial_deviation:.1e} where {worst.allowed_deviation:.1e} is allowed"
            self.failures.append(
                f"[stability]: the trivial multiplier is off at {count}, {size}; try a smaller tolerance"
            )
