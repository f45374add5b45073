"""Running a scene: branches one after the other, every solution kept as it converges, then its tasks, all files.

At the end what was found is printed in a table.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.certify.certificate import STABLE, UNDECIDED, UNSTABLE
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import EQUILIBRIA, FAMILY, ORBITS, SolutionSpace
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.results import figures, tables
from casadi_skin.results.dataset import dataset_of, write_csv, write_netcdf
from casadi_skin.results.quantities import Cell, Place, certified, columns_of, csv_row, places_of
from casadi_skin.runs.branches import Branches
from casadi_skin.runs.directory import JOURNAL_FILE, renew
from casadi_skin.runs.output import Progress, print_table
from casadi_skin.runs.parts import ended_well, mode_of, origin, picture
from casadi_skin.runs.request import Request
from casadi_skin.solve.watch import one_thread
from casadi_skin.zero.kinds import count_in_words

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
        derivatives: how many were written, in words.
    """

    def __init__(self, request: Request, scene_text: str, directory: Path, progress: Progress) -> None:
        super().__init__(request, progress)
        self.scene_text, self.directory = scene_text, directory
        self.tasks: list[Task] = []
        self.derivatives = ""
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
                self.follow_all(journal)
        finally:
            with interrupts_deferred():  # all files are written before an interruption ends the run
                self._write_results()
        if scene.given("dynamics", "design", "export"):
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
            from casadi_skin.runs.tasks import write_spectrum

            with self.named("[spectrum]: "):
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
        if not first.space.is_family:
            write_netcdf(self.directory / "branch.nc", dataset)
            self._write_branch(first)
            return
        write_netcdf(self.directory / "family.nc", dataset)
        self._write_families(branches)
        families = {f"j{mode_of(branch)}": branch for branch in branches}
        self._write_gradients(families | dict(self.offshoots.leaving))
        if scene.continuation is not None:
            self._write_offshoots(families)

    def _write_gradients(self, branches: Mapping[str, Branch]) -> None:
        """gradient.csv: of special points of branches by name, of families of their changes of stability too."""
        scene = self.request.scene
        changes = scene.stability is not None and scene.stability.gradient
        special = scene.continuation is not None and scene.continuation.gradient
        if changes or special:
            asked = ((name, branch, changes, special, self.failures) for name, branch in branches.items())
            rows = [row for given in asked for row in tables.gradient_rows(*given)]
            write_csv(self.directory / "gradient.csv", tables.GRADIENT_COLUMNS, rows)
            self.derivatives = f"{len(rows)} derivatives of special points in gradient.csv; "

    def _picture(self, name: str, draw: Callable[..., Figure | None], *shown: Any) -> None:
        picture(self.request.scene, self.directory / name, draw, *shown)

    def _write_families(self, branches: Sequence[Branch]) -> None:
        """events.csv with the tables beside it, pictures of families, their power series, and films of their modes."""
        scene, directory = self.request.scene, self.directory
        if scene.stability is not None and any(branch.with_events for branch in branches):
            known = [(b, diagram) for b in branches if (diagram := b.diagram_of_changes) is not None]
            certify = scene.accuracy.certify
            columns = (*tables.EVENT_COLUMNS, *tables.PROVED_COLUMNS) if certify else tables.EVENT_COLUMNS
            events = (tables.event_rows(mode_of(b), d, *([b.certify_change] if certify else [])) for b, d in known)
            write_csv(directory / "events.csv", columns, [row for rows in events for row in rows])
            further = [row for b, d in known for row in tables.edge_rows(mode_of(b), d, d.further)]
            write_csv(directory / "further_events.csv", tables.EVENT_COLUMNS, further)
            tongues = [row for b, d in known for row in tables.tongue_rows(mode_of(b), d)]
            write_csv(directory / "tongues.csv", tables.TONGUE_COLUMNS, tongues)
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
        if scene.family is not None and scene.family.series is not None:
            with self.named("[family] "):
                found = [branch.series(scene.family.series) for branch in branches]
                tables.write_series(found, directory, origin(self.request, self.scene_text, branches[0]))
                for branch, series in zip(branches, found, strict=True):
                    self._picture(f"series_j{series.mode}", figures.series_figure, branch, series)
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
            tables.write_special_points(self.directory / "special_points.csv", {"": branch})
            self._write_gradients({"": branch})
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
        tables.write_special_points(self.directory / "special_points.csv", branches)
        self._write_gradients(branches)
        in_one = [branch for branch in branches.values() if not branch.space.kind]
        curves = [branch for branch in branches.values() if branch.space.kind]
        self._picture("branch", figures.bifurcation_figure, in_one, title)
        for name, draw, shown in (
            ("portrait", figures.portrait_figure, chosen_solutions(in_one)),
            ("curves", figures.curves_figure, curves),
        ):
            if shown:
                self._picture(name, draw, shown, title)

    def _write_offshoots(self, families: Mapping[str, Branch]) -> None:
        """special_points.csv; edges.csv with its picture; a netCDF file for each branch that leaves."""
        found = self.offshoots
        tables.write_special_points(self.directory / "special_points.csv", {**families, **dict(found.leaving)})
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
            if missing := [orbit for orbit in proofs if not orbit.certificate.proved]:
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
            count = f"the trivial multiplier is off at {len(off)} of {len(found)} points"
            size = f"by up to {worst.trivial_deviation:.1e} where {worst.allowed_deviation:.1e} is allowed"
            self.failures.append(f"[stability]: {count}, {size}; try a smaller tolerance")


# Files of branches and of linear spectra ------------------------------------------------------------------------------

PASSED_COLUMNS = ("mode", "S_before", "S_after", "Omega_before", "Omega_after", "changes", "meetings")


def _edge_rows(mode: int, listed: str, number: int, curve: EdgeCurve) -> Iterator[dict[str, Cell]]:
    """A row for each point of an edge."""
    columns = tables.edge_columns(curve)
    for k in range(len(curve)):
        values: dict[str, Cell] = {name: values[k].item() for name, values in columns.items()}
        yield {"mode": mode, "edge": number, "kind": curve.kind, "table": listed, **values}


# The summary on standard output ---------------------------------------------------------------------------------------


def print_summary(run: Run) -> None:
    """A table of the families, or of the points of another branch that a reader looks for; and where results are."""
    branches = [branch for branch in run.branches if len(branch)]
    families = not run.branches or run.branches[0].space.connects == FAMILY
    if run.branches and families:
        stability = ["max |multiplier|", "changes"] if run.request.scene.stability is not None else []
        columns = ["mode", "points", "S", "Omega", "its error", *stability, "seconds"]
        print_table(run.request.scene.title, columns, _family_rows(run))
        for lines in (_thresholds(run.branches), _stability(branches), _proofs(branches), _offshoots(run)):
            for line in lines:
                print(line)
    elif branches:
        columns, rows = (_diagram if run.request.scene.has_diagram else _points)(run, branches)
        print_table(run.request.scene.title or run.request.ode.name, columns, rows)
        if not run.request.scene.has_diagram and branches[0].with_events and len(branches[0]) > 1:
            print("changes of stability were sought where neighbouring points differ; others may lie between points")
    for task in run.tasks:
        print(*task.words(), sep="\n")
    print(f"{'' if families else _counted(branches) + '; '}{run.derivatives}results in {run.directory}")


def _counted(branches: Sequence[Branch]) -> str:
    points = sum(len(branch) for branch in branches)
    return f"{points} point{'' if points == 1 else 's'}"


# The summary of families ----------------------------------------------------------------------------------------------


def _family_rows(run: Run) -> Iterator[list[str]]:
    """A row a family; the largest modulus of a multiplier is that of orbits, and in the tongues between them."""
    for branch, seconds in zip(run.branches, [*run.seconds, 0.0], strict=False):
        cells = [str(mode_of(branch)), str(len(branch))]
        if not len(branch):
            yield cells
            continue
        last = branch.orbits[-1]
        cells += [f"{last.S:.6g}", f"{last.Omega:.10g}", f"{max(o.Omega_error for o in branch.orbits):.1e}"]
        if branch.with_stability:
            tongues = () if branch.stability_diagram is None else branch.stability_diagram.tongues
            largest = max([float(branch.max_abs_multiplier.max()), *(tongue.max_abs_multiplier for tongue in tongues)])
            known = count_in_words(len(branch.changes), branch.unresolved) if branch.with_events else ""
            cells += [f"{largest:.8g}", known or "not sought"]
        yield [*cells, f"{seconds:.2f}"]


def _thresholds(branches: Sequence[Branch]) -> Iterator[str]:
    for branch in branches:
        if branch.threshold is not None:
            words = f"end breather of the infinite chain born at S_c = {branch.threshold:.10g}"
            yield f"mode {mode_of(branch)}: {words}"


def _stability(branches: Sequence[Branch]) -> Iterator[str]:
    """Stability beyond the columns: unresolved stretches, and changes that were not sought."""
    computed = [branch for branch in branches if branch.with_stability]
    if any(not branch.with_events for branch in computed):
        yield "changes of stability between points were not sought"
    for branch in computed:
        for stretch in branch.unresolved:
            where = f"from S = {stretch.S_start:.6g} to {stretch.S_end:.6g}"
            yield f"mode {mode_of(branch)}: changes of stability are not known {where}: {stretch.reason}"
        for point in branch.not_located if "_sought" in vars(branch) else ():
            yield f"mode {mode_of(branch)}: not located: {point}"
        for passed in (branch.passed_resonances or ()) if branch.with_events else ():
            yield f"mode {mode_of(branch)}: {passed}"


def _proofs(branches: Sequence[Branch]) -> Iterator[str]:
    """Number of orbits that are proved to exist, the accuracy of Omega that this proves, and their stability."""
    for branch in branches:
        asked, mode, space = certified(branch), f"mode {mode_of(branch)}", branch.space
        if not asked:
            continue
        proved = [orbit.certificate for orbit in asked if orbit.certificate.proved]
        width = max((c.Omega[1] - c.Omega[0] for c in proved), default=0.0)
        words = f"; Omega enclosed to {width:.1e}, orbits to {max(c.radius for c in proved):.1e}" if proved else ""
        yield f"{mode}: {len(proved)} of {len(asked)} orbits proved to exist{words}"
        if space.request.certify == "all":
            try:
                yield f"{mode}: {branch.certify(0.0, float(branch.S[-1]))!r}"
            except ValueError as error:
                yield f"{mode}: not proved to be one curve: {error}"
        if branch.with_stability:
            verdicts = [orbit.proved_stability.verdict for orbit in asked]
            counts = ", ".join(f"{verdicts.count(v)} {v}" for v in (STABLE, UNSTABLE, UNDECIDED))
            yield f"{mode}: proved stability: {counts}"


def _offshoots(run: Run) -> Iterator[str]:
    """Branches and curves followed from families."""
    found = run.offshoots
    if found.leaving:
        points = _counted([branch for _, branch in found.leaving])
        yield f"branches that leave: {len(found.leaving)}, with {points}"
    if found.edges:
        yield f"edges of tongues: {len(found.edges)}, with {sum(len(curve) for *_, curve in found.edges)} points"


# The summary of other branches ----------------------------------------------------------------------------------------


def _diagram(run: Run, branches: Sequence[Branch]) -> tuple[list[str], Iterator[list[str]]]:
    """A row for the first and the last point of each branch, and for special points."""
    table = run.request.scene.continuation
    asked = () if table is None else (table.parameter, *([] if table.curve is None else [table.curve.parameter]))
    names = [name for name in asked if branches[0].parameter]
    contents = {FAMILY: "cycles", ORBITS: "cycles", EQUILIBRIA: "equilibria"}

    def rows() -> Iterator[list[str]]:
        for number, branch in enumerate(branches, start=1):
            first, last = branch.solutions[0], branch.solutions[-1]
            what = "curve" if branch.space.kind else contents.get(first.space.connects, "solutions")
            ends = [("start", first.parameters, "", _stable(branch, 0))]
            ends += [("end", last.parameters, "", _stable(branch, -1))] if len(branch) > 1 else []
            special = [
                (point.kind, point.parameters, f"{point.error:.1e}", point.criticality if point.has_criticality else "")
                for point in branch.special_points
            ]
            unresolved = [
                (tables.UNRESOLVED, {**first.parameters, branch.parameter: stretch.start},
                 f"{abs(stretch.end - stretch.start):.1e}", stretch.kind)
                for stretch in branch.passed_over
            ]  # fmt: skip
            for kind, values, error, words in (ends[0], *special, *unresolved, *ends[1:]):
                yield [f"{number}: {what}", kind, *(f"{values[name]:.10g}" for name in names), error, words]

    return ["branch", "", *names, "its error", ""], rows()


def _stable(branch: Branch, place: int) -> str:
    if not branch.with_stability:
        return ""
    return "stable" if branch.solutions[place].stable else "unstable"


def _points(run: Run, branches: Sequence[Branch]) -> tuple[list[str], Iterator[list[str]]]:
    """A row for the first and the last point, requested points, and folds."""
    branch = branches[0]
    first = branch.solutions[0]
    columns = ["point", "", *([branch.parameter] if branch.parameter else [])]
    columns += ["period"] if first.is_orbit else []
    columns += [f"largest {first.space.state_names[0]}", "its error", *(["max |mult.|"] * branch.with_stability)]

    def rows() -> Iterator[list[str]]:
        for place in places_of(branch):
            solution: Any = place.solution
            last = place.index == len(branch) - 1
            marks = {"start": place.index == 0, "asked for": place.requested, place.special: place.special, "end": last}
            words = [word for word, holds in marks.items() if holds and word]
            if not words:
                continue
            row = [str(place.index), ", ".join(words) if len(branch) > 1 else "alone"]
            row += [f"{solution.parameters[branch.parameter]:.8g}"] if branch.parameter else []
            row += [f"{solution.period:.10g}"] if solution.is_orbit else []
            row += [f"{place.extremes[1][0]:.8g}", f"{solution.error:.1e}"]
            if branch.with_stability:
                moduli = np.abs(place.floquet.others)
                row.append(f"{moduli.max():.6g}" if moduli.size else "")
            yield row

    return columns, rows()
