"""Running a scene: branches one after the other, every solution kept as it converges, then its tasks, and all files."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import FAMILY, SolutionSpace
from casadi_skin.model.files import replacing
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.results.dataset import write_csv
from casadi_skin.results.quantities import Cell, Place, certified, columns_of, csv_row
from casadi_skin.runs.branches import Branches
from casadi_skin.runs.directory import JOURNAL_FILE, SCENE_MODEL, renew
from casadi_skin.runs.files import write_branches, write_diagram, write_offshoots, write_spectrum
from casadi_skin.runs.parts import ended_well, is_orbit, mode_of, origin
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.solve.watch import one_thread

if TYPE_CHECKING:
    from casadi_skin.runs.tasks import Task

TABLE_PERIOD = 0.5  # seconds between two writings of the table while a run goes on


class Run(Branches):
    """One run of a request into a directory that is ready for it (see runs.directory).

    An exception or an interruption leaves what was computed in the files and in the journal.

    Attributes:
        tasks: those of the scene beside its branches, with their results.
    """

    def __init__(self, request: Request, scene_text: str, directory: Path, progress: Progress) -> None:
        super().__init__(request, progress)
        self.scene_text, self.directory = scene_text, directory
        self.tasks: list[Task] = []
        self._rows: dict[str, list[dict[str, Cell]]] = {}  # by the name of their file; those of families stand in one
        self._shown: dict[str, int] = {}  # rows of branches by their names
        self._written = 0.0

    def show(self, name: str, solutions: Sequence[Solution], space: SolutionSpace) -> None:
        """Add rows of more solutions to a table, which is replaced at most every TABLE_PERIOD."""
        table, mode = ("family", int(name)) if space.connects == FAMILY else (name, 0)
        rows, known = self._rows.setdefault(table, []), self._shown.get(name, 0)
        for index, solution in enumerate(solutions[known:], start=known):
            quantities = columns_of(Branch(space, (solution,), with_stability=self._with_stability))
            place = Place(solution, index, mode, solution.point.requested, solution.point.special)
            rows.append(csv_row(quantities, place))
        self._shown[name] = len(solutions)
        if rows and time.monotonic() - self._written > TABLE_PERIOD:
            self._write_table(table)

    def _write_table(self, name: str) -> None:
        write_csv(self.directory / f"{name}.csv", list(self._rows[name][0]), self._rows[name])
        self._written = time.monotonic()

    def execute(self) -> bool:
        """Compute, write, and return whether everything requested was found."""
        scene, journal = self.request.scene, self.directory / JOURNAL_FILE
        journal.touch()
        if self.request.path is not None:
            with replacing(self.directory / f"{SCENE_MODEL}{self.request.path.suffix}") as temporary:
                temporary.write_text(self.request.source, encoding="utf-8")
        try:
            with one_thread():
                if scene.search is None:  # its journal is of another kind
                    self.follow_all(journal)
        finally:
            with interrupts_deferred():  # all files are written before an interruption ends the run
                self._write_results()
        if scene.given("dynamics", "search", "export"):
            from casadi_skin.runs.tasks import tasks_of

            self.tasks = tasks_of(self.request)
        for task in self.tasks:
            task.run(self, self.directory, self.scene_text)
        complete = all(self._ended_well(branch) for branch in self.branches) and not self._other_reasons()
        if complete:
            journal.unlink(missing_ok=True)
        return complete

    def reasons(self) -> list[str]:
        """Reasons why the run is not as requested, in a line each."""
        reasons = []
        for branch in self.branches:
            if branch.space.connects == FAMILY:
                part = f"mode {mode_of(branch)}"
            else:
                part = "[continuation]" if branch.parameter else "[stability]"
            if not self._reached_its_end(branch):
                reasons.append(f"{part}: {branch.reason}")
            reasons += [f"{part}: not resolved: {stretch}" for stretch in branch.known_unresolved]
        return [*reasons, *self._other_reasons()]

    def _other_reasons(self) -> list[str]:
        """Reasons why branches that leave families, or another part, are not as requested."""
        if self.request.scene.family is None or self.request.scene.continuation is None:
            return self.failures
        from casadi_skin.runs.further import reasons

        return [*reasons(self.offshoots), *self.failures]

    def _ended_well(self, branch: Branch) -> bool:
        """Whether a branch reached its end, and all of it was resolved."""
        return self._reached_its_end(branch) and not branch.known_unresolved

    def _reached_its_end(self, branch: Branch) -> bool:
        """Whether a branch reached its requested end, or the natural end of a branch that leaves another one."""
        if not self.request.scene.has_diagram:
            return branch.complete
        return ended_well(branch)

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
        self._report_drift(branches)
        self._report_unproved(branches)

    def _write_branches(self, branches: Sequence[Branch]) -> None:
        """The table of points, and the files of whole branches."""
        names = [name for name, rows in self._rows.items() if rows]
        for name in names:
            self._write_table(name)
        if self.request.scene.has_diagram:
            write_diagram(self.request, names, branches, origin(self.request, self.scene_text), self.directory)
            return
        write_branches(self.request, branches, self.scene_text, self.directory, self.progress)
        if self.request.scene.family is not None and self.request.scene.continuation is not None:
            attributes = origin(self.request, self.scene_text)
            write_offshoots(self.request, branches, self.offshoots, attributes, self.directory)

    def _report_unproved(self, branches: Sequence[Branch]) -> None:
        """Report orbits without a proof."""
        for branch in branches:
            proofs = certified(branch)
            missing = [orbit for orbit in proofs if not orbit.certificate.proved]
            if missing:
                count = f"mode {mode_of(branch)}: {len(missing)} of {len(proofs)} orbits are not proved"
                first = f"the first at S = {missing[0].S:.6g}: {missing[0].certificate.reason}"
                self.failures.append(f"[accuracy] certify: {count}, {first}")

    def _report_drift(self, branches: Sequence[Branch]) -> None:
        """Report trivial multipliers that are farther from their value than errors allow."""
        if self.request.scene.stability is None:
            return
        solutions = [solution for branch in branches for solution in branch.solutions]
        found = [s.floquet() for s in solutions if is_orbit(s) or s.known_floquet is not None]
        off = [f for f in found if f.trivial_deviation > f.allowed_deviation]
        if off:
            worst = max(off, key=lambda f: f.trivial_deviation / f.allowed_deviation)
            count = f"{len(off)} of {len(found)} points"
            size = f"by up to {worst.trivial_deviation:.1e} where {worst.allowed_deviation:.1e} is allowed"
            self.failures.append(
                f"[stability]: the trivial multiplier is off at {count}, {size}; try a smaller tolerance"
            )
