"""Running a scene: branches one after the other, every solution kept as it converges, then its tasks, and all files."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.results import figures
from casadi_skin.results.dataset import dataset_of, write_columns, write_csv, write_netcdf
from casadi_skin.results.quantities import Cell, Place, certified, columns_of, csv_row
from casadi_skin.results.tables import (
    EVENT_COLUMNS,
    PROVED_COLUMNS,
    TONGUE_COLUMNS,
    edge_columns,
    event_rows,
    further_rows,
    tongue_rows,
    write_special_points,
)
from casadi_skin.runs.branches import Branches
from casadi_skin.runs.directory import JOURNAL_FILE, renew
from casadi_skin.runs.output import Progress
from casadi_skin.runs.parts import ended_well, mode_of, origin, picture
from casadi_skin.runs.request import Request
from casadi_skin.solve.watch import one_thread
from casadi_skin.zero.model_coordinates import linear_frequencies

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from casadi_skin.points.edges import EdgeCurve
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
        table, mode = ("family", int(name)) if space.is_family else (name, 0)
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
        complete = not self.reasons()
        if complete:
            journal.unlink(missing_ok=True)
        return complete

    def reasons(self) -> list[str]:
        """Reasons why the run is not as requested, in a line each; none where it is complete."""
        scene, reasons = self.request.scene, list[str]()
        for branch in self.branches:
            part = "[continuation]" if branch.parameter else "[stability]"
            part = f"mode {mode_of(branch)}" if branch.space.is_family else part
            if not (ended_well(branch) if scene.has_diagram else branch.complete):  # a natural end is one of a diagram
                reasons.append(f"{part}: {branch.reason}")
            reasons += [f"{part}: not resolved: {stretch}" for stretch in branch.known_unresolved]
        if scene.family is not None and scene.continuation is not None:
            from casadi_skin.runs.further import reasons as of_offshoots

            reasons += of_offshoots(self.offshoots)
        return [*reasons, *self.failures]

    def _write_results(self) -> None:
        self.progress.say("writing tables and pictures")
        if not self.directory.exists():
            renew(self.directory, self.request, self.scene_text)
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
        scene, first = self.request.scene, branches[0]
        if scene.has_diagram:
            self._write_diagram(dict(zip(names, branches, strict=True)))
            return
        vectors = scene.stability is not None and scene.stability.vectors
        dataset = replace(dataset_of(branches, vectors), attributes=origin(self.request, self.scene_text, first))
        if first.space.is_family:
            write_netcdf(self.directory / "family.nc", dataset)
            self._write_families(branches)
        else:
            write_netcdf(self.directory / "branch.nc", dataset)
            self._write_branch(first)
        if scene.family is not None and scene.continuation is not None:
            self._write_offshoots(branches)

    def _picture(self, name: str, draw: Callable[..., Figure | None], *shown: Any) -> None:
        picture(self.request.scene, self.directory / name, draw, *shown)

    def _write_families(self, branches: Sequence[Branch]) -> None:
        """events.csv with the tables beside it, the pictures of families, and films of their modes."""
        scene, directory = self.request.scene, self.directory
        if scene.stability is not None and any(branch.with_events for branch in branches):
            known = [(b, diagram) for b in branches if (diagram := b.diagram_of_changes) is not None]
            certify = scene.accuracy.certify
            columns = (*EVENT_COLUMNS, *PROVED_COLUMNS) if certify else EVENT_COLUMNS
            events = (event_rows(mode_of(b), d, *([b.certify_change] if certify else [])) for b, d in known)
            write_csv(directory / "events.csv", columns, [row for rows in events for row in rows])
            for name, names, make in (
                ("further_events", EVENT_COLUMNS, further_rows),
                ("tongues", TONGUE_COLUMNS, tongue_rows),
            ):
                write_csv(directory / f"{name}.csv", names, [row for b, d in known for row in make(mode_of(b), d)])
            sought = ((mode_of(b), p) for b in branches if b.with_events for p in b.passed_resonances or ())
            passed: list[tuple[Cell, ...]] = [(mode, *p.S, *p.Omega, p.changes, p.met) for mode, p in sought]
            rows = (dict(zip(PASSED_COLUMNS, row, strict=True)) for row in passed)
            write_csv(directory / "passed_resonances.csv", PASSED_COLUMNS, rows)
        self._picture("frequency", figures.frequency_figure, branches)
        self._picture("profile", figures.profile_figure, branches)
        for branch in branches:
            if scene.chain is None:
                from casadi_skin.results.figures.families import plane_figure

                self._picture(f"plane_j{mode_of(branch)}", plane_figure, branch)
            self._picture(f"multipliers_j{mode_of(branch)}", figures.multiplier_figure, branch)
        if scene.family is not None and scene.family.film:
            from casadi_skin.results.figures.solutions import animate

            for branch in branches:
                self.progress.say(f"film of j = {mode_of(branch)}")
                requested = [orbit for orbit in branch.orbits if orbit.point.requested]
                animate((requested or branch.orbits)[-1], directory / f"film_j{mode_of(branch)}.gif")

    def _write_branch(self, branch: Branch) -> None:
        """special_points.csv and the pictures of another branch, or of a single solution."""
        title = self.request.scene.title or ""
        if len(branch) > 1:
            write_special_points(self.directory / "special_points.csv", {"": branch})
            self._picture("branch", figures.branch_figure, branch, title)
        self._picture("orbit", figures.orbit_figure, branch.solutions[-1], title)

    def _write_datasets(self, branches: Mapping[str, Branch]) -> None:
        attributes = origin(self.request, self.scene_text)
        for name, branch in branches.items():
            write_netcdf(self.directory / f"{name}.nc", replace(dataset_of([branch]), attributes=attributes))

    def _write_diagram(self, branches: Mapping[str, Branch]) -> None:
        """special_points.csv, a netCDF file a branch, and the pictures."""
        from casadi_skin.results.figures.solutions import chosen_solutions

        self._write_datasets(branches)
        first, title = next(iter(branches.values())), self.request.scene.title or ""
        if not first.parameter:
            return
        write_special_points(self.directory / "special_points.csv", branches)
        in_one = [branch for branch in branches.values() if not branch.space.kind]
        curves = [branch for branch in branches.values() if branch.space.kind]
        self._picture("branch", figures.bifurcation_figure, in_one, title)
        for name, draw, shown in (
            ("portrait", figures.portrait_figure, chosen_solutions(in_one)),
            ("curves", figures.curves_figure, curves),
        ):
            if shown:
                self._picture(name, draw, shown, title)

    def _write_offshoots(self, families: Sequence[Branch]) -> None:
        """special_points.csv; edges.csv with its picture; a netCDF file for each branch that leaves."""
        found, named = self.offshoots, {f"j{mode_of(family)}": family for family in families}
        write_special_points(self.directory / "special_points.csv", {**named, **dict(found.leaving)})
        self._write_datasets({name: branch for name, branch in found.leaving if len(branch)})
        if found.edges:
            table = [row for edge in found.edges for row in _edge_rows(*edge)]
            write_csv(self.directory / "edges.csv", list(table[0]), table)
            curves = [curve for *_, curve in found.edges]
            self._picture("edges", figures.edges_figure, curves, self.request.scene.title or "")

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
        found = [s.floquet() for s in solutions if s.is_orbit or s.known_floquet is not None]
        off = [f for f in found if f.trivial_deviation > f.allowed_deviation]
        if off:
            worst = max(off, key=lambda f: f.trivial_deviation / f.allowed_deviation)
            count = f"{len(off)} of {len(found)} points"
            size = f"by up to {worst.trivial_deviation:.1e} where {worst.allowed_deviation:.1e} is allowed"
            self.failures.append(
                f"[stability]: the trivial multiplier is off at {count}, {size}; try a smaller tolerance"
            )


# Files of branches and of linear spectra ------------------------------------------------------------------------------

PASSED_COLUMNS = ("mode", "S_before", "S_after", "Omega_before", "Omega_after", "changes", "meetings")


def _edge_rows(mode: int, listed: str, number: int, curve: EdgeCurve) -> Iterator[dict[str, Cell]]:
    """A row for each point of an edge."""
    columns = edge_columns(curve)
    for k in range(len(curve)):
        values: dict[str, Cell] = {name: values[k].item() for name, values in columns.items()}
        yield {"mode": mode, "edge": number, "kind": curve.kind, "table": listed, **values}


def write_spectrum(request: Request, directory: Path) -> None:
    """spectrum.csv and the picture of the linear spectrum; of a lattice also where modes live, and its bands."""
    if request.scene.lattice is not None:
        from casadi_skin.runs.lattices import write_lattice_spectrum

        write_lattice_spectrum(request.scene, request.model, request.parameters, directory)
        return
    frequencies = linear_frequencies(request.model, request.parameters)
    write_columns(directory / "spectrum.csv", {"mode": np.arange(len(frequencies)) + 1, "omega": frequencies})
    picture(request.scene, directory / "spectrum", figures.spectrum_figure, request.model, request.parameters)
