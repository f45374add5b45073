"""Running a scene: branches one after the other, every solution kept as it converges, and all files at the end."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.lattice.spectrum import linear_frequencies
from casadi_skin.model.files import replacing
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.results import figures
from casadi_skin.results.dataset import dataset_of, write_csv, write_netcdf
from casadi_skin.results.quantities import Cell, Place, certified, columns_of, csv_row, unique_names
from casadi_skin.results.tables import (
    EVENT_COLUMNS,
    PROVED_COLUMNS,
    TONGUE_COLUMNS,
    UNRESOLVED,
    event_rows,
    further_rows,
    tongue_rows,
)
from casadi_skin.runs.branches import Branches
from casadi_skin.runs.directory import JOURNAL, SCENE_MODEL, renew
from casadi_skin.runs.parts import Offshoots, mode_of, origin, picture
from casadi_skin.runs.progress import Progress
from casadi_skin.runs.request import Request
from casadi_skin.solve.watch import one_thread
from casadi_skin.zero.family import TWO_PI

if TYPE_CHECKING:
    from casadi_skin.dynamics import Evolution
    from casadi_skin.optimise.search import SearchResult


# The pictures of a run: drawn once, in the formats of its scene -------------------------------------------------------

PASSED_COLUMNS = ("mode", "S_before", "S_after", "Omega_before", "Omega_after", "changes", "meetings")


def write_branches(
    request: Request, branches: Sequence[Branch], scene_text: str, directory: Path, progress: Progress
) -> None:
    """All files of branches but the table of their points."""
    scene = request.scene
    family = isinstance(branches[0].space, Family)
    vectors = scene.stability is not None and scene.stability.vectors
    dataset = dataset_of(branches, vectors)
    dataset = replace(dataset, attributes=origin(request, scene_text, branches[0]))
    write_netcdf(directory / ("family.nc" if family else "branch.nc"), dataset)
    if family:
        _write_families(request, branches, directory)
        if scene.family is not None and scene.family.film:
            _write_films(branches, directory, progress)
    else:
        _write_branch(request, branches[0], directory)


def _write_families(request: Request, branches: Sequence[Branch], directory: Path) -> None:
    """events.csv with the tables beside it, and the pictures of families."""
    stability = request.scene.stability
    if stability is not None and any(branch.with_events for branch in branches):
        diagrams = [(b, b.diagram_of_changes) for b in branches]
        known = [(mode_of(b), diagram) for b, diagram in diagrams if diagram is not None]
        if request.scene.accuracy.certify:
            rows_of = [event_rows(mode_of(b), diagram, b.certify_change) for b, diagram in diagrams if diagram]
            columns = (*EVENT_COLUMNS, *PROVED_COLUMNS)
            write_csv(directory / "events.csv", columns, [row for rows in rows_of for row in rows])
        else:
            write_csv(directory / "events.csv", EVENT_COLUMNS, [row for each in known for row in event_rows(*each)])
        for name, names, make in (
            ("further_events", EVENT_COLUMNS, further_rows),
            ("tongues", TONGUE_COLUMNS, tongue_rows),
        ):
            write_csv(directory / f"{name}.csv", names, [row for each in known for row in make(*each)])
        passed = [row for branch in branches if branch.with_events for row in passed_rows(branch)]
        write_csv(directory / "passed_resonances.csv", PASSED_COLUMNS, passed)
    picture(request.scene, directory / "frequency", figures.frequency_figure, branches)
    picture(request.scene, directory / "profile", figures.profile_figure, branches)
    for branch in branches:
        if request.scene.chain is None:
            from casadi_skin.results.figures.families import plane_figure

            picture(request.scene, directory / f"plane_j{mode_of(branch)}", plane_figure, branch)
        picture(request.scene, directory / f"multipliers_j{mode_of(branch)}", figures.multiplier_figure, branch)


def passed_rows(branch: Branch) -> list[dict[str, Cell]]:
    """Rows of passed_resonances.csv."""
    found = branch.passed_resonances or ()
    rows = [(mode_of(branch), *one.S, *one.Omega, one.changes, one.met) for one in found]
    return [dict(zip(PASSED_COLUMNS, row, strict=True)) for row in rows]


def _write_films(branches: Sequence[Branch], directory: Path, progress: Progress) -> None:
    """A film of each family's mode, at the last requested point or at the end."""
    from casadi_skin.results.figures.solutions import animate

    for branch in branches:
        progress.say(f"film of j = {mode_of(branch)}")
        requested = [orbit for orbit in branch.orbits if orbit.point.requested]
        animate((requested or branch.orbits)[-1], directory / f"film_j{mode_of(branch)}.gif")


def _write_branch(request: Request, branch: Branch, directory: Path) -> None:
    """special_points.csv and the pictures of another branch, or of a single solution."""
    title = request.scene.title or ""
    if len(branch) > 1:
        write_csv(directory / "special_points.csv", special_columns(branch), special_rows(branch))
        picture(request.scene, directory / "branch", figures.branch_figure, branch, title)
    picture(request.scene, directory / "orbit", figures.orbit_figure, branch.solutions[-1], title)


def special_columns(branch: Branch) -> list[str]:
    """Columns of special_points.csv; the period of orbits alone."""
    fixed = ("kind", "error", "period")
    return [fixed[0], *unique_names([branch.parameter], fixed), *fixed[1 : 3 if _has_orbits(branch) else 2]]


def special_rows(branch: Branch) -> list[dict[str, Cell]]:
    """Rows of special_points.csv: folds and changes of stability in the order of the branch; what is unresolved last.

    The error of a stretch that is not resolved is its width.
    """
    columns, rows, changes = special_columns(branch), list[list[Cell]](), iter(branch.located)
    folds = {id(point.solution): point for point in branch.special_points}
    for before, here in zip((None, *branch.solutions), branch.solutions, strict=False):
        if branch.located and before is not None and before.stable != here.stable:
            change = next(changes)
            kind = f"stability {'gained' if change.stable_after else 'lost'} ({change.kind})"
            rows.append([kind, change.value, change.error, TWO_PI / change.Omega])
        if id(here) in folds:
            fold = folds[id(here)]
            period = here.period if isinstance(here, Orbit) else math.nan
            rows.append([fold.kind, fold.parameters[branch.parameter], fold.error, period])
    rows += [[UNRESOLVED, stretch.start, abs(stretch.end - stretch.start), math.nan] for stretch in branch.passed_over]
    return [dict(zip(columns, row, strict=False)) for row in rows]


def _has_orbits(branch: Branch) -> bool:
    return isinstance(branch.solutions[0], Orbit)


def write_spectrum(request: Request, directory: Path) -> None:
    """spectrum.csv and the picture of the linear spectrum; of a lattice also where modes live, and its bands."""
    if request.scene.chain is None:
        from casadi_skin.lattice.lattice import Lattice

        if isinstance(request.model, Lattice):
            from casadi_skin.runs.family_points import write_lattice_spectrum

            write_lattice_spectrum(request.scene, request.model, request.parameters, directory)
            return
    frequencies = linear_frequencies(request.model, request.parameters)
    rows = [{"mode": j, "omega": float(w)} for j, w in enumerate(frequencies, start=1)]
    write_csv(directory / "spectrum.csv", ("mode", "omega"), rows)
    picture(request.scene, directory / "spectrum", figures.spectrum_figure, request.model, request.parameters)


TABLE_PERIOD = 0.5  # seconds between two writings of the table while a run goes on


@dataclass
class Tables:
    """Rows of every branch's table by the name of its file; those of families stand in one.

    Attributes:
        directory: where the tables are written.
        with_stability: whether rows have the stability of their solution.
        rows: by name of the file.
    """

    directory: Path
    with_stability: bool
    rows: dict[str, list[dict[str, Cell]]] = field(default_factory=dict)
    _written: float = 0.0

    def add(self, name: str, solutions: Sequence[Solution], space: SolutionSpace) -> None:
        """Add rows to a table, which is replaced at most every TABLE_PERIOD."""
        table, rows = table_of(name, space), self.rows.setdefault(table_of(name, space), [])
        mode = space.coordinates.mode_number if isinstance(space, Family) else 0
        for solution in solutions:
            quantities = columns_of(Branch(space, (solution,), with_stability=self.with_stability))
            index = sum(row.get("mode", 0) == mode for row in rows)
            place = Place(solution, index, mode, solution.point.requested, solution.point.special)
            rows.append(csv_row(quantities, place))
        if rows and time.monotonic() - self._written > TABLE_PERIOD:
            self._write(table)

    def count(self, name: str, space: SolutionSpace) -> int:
        """Number of rows of the table that a branch stands in."""
        return len(self.rows.get(table_of(name, space), ()))

    def write(self) -> list[str]:
        """Write every table that has rows; their names without the suffix."""
        names = [name for name, rows in self.rows.items() if rows]
        for name in names:
            self._write(name)
        return [name.removesuffix(".csv") for name in names]

    def _write(self, name: str) -> None:
        rows = self.rows[name]
        write_csv(self.directory / name, list(rows[0]), rows)
        self._written = time.monotonic()


def table_of(name: str, space: SolutionSpace) -> str:
    """The file that the rows of a branch stand in."""
    return "family.csv" if isinstance(space, Family) else f"{name}.csv"


@dataclass
class Run:
    """One run of a request into a directory that is ready for it (see runs.directory).

    Attributes:
        branches, seconds: fill as branches end; an exception or an interruption leaves what was computed in the files
            and in the journal.
        failures: reasons why a part is not as requested, in a line each, with the table that requests it.
        evolution: the time evolution, as far as it could be followed.
        search: the result of a search.
        exported: files written for use outside of Python.
    """

    request: Request
    scene_text: str
    directory: Path
    progress: Progress
    branches: list[Branch] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    offshoots: Offshoots = field(default_factory=Offshoots)
    evolution: Evolution | None = None
    search: SearchResult | None = None
    exported: tuple[Path, ...] = ()
    _tables: Tables = field(init=False)

    def __post_init__(self) -> None:
        self._tables = Tables(self.directory, self.request.scene.stability is not None)

    def execute(self) -> bool:
        """Compute, write, and return whether everything requested was found."""
        (self.directory / JOURNAL).touch()
        if self.request.path is not None:
            with replacing(self.directory / f"{SCENE_MODEL}{self.request.path.suffix}") as temporary:
                temporary.write_text(self.request.source, encoding="utf-8")
        try:
            with one_thread():
                self._follow()
        finally:
            with interrupts_deferred():  # all files are written before an interruption ends the run
                self._write_results()
        self._evolve()
        self._search()
        self._export()
        complete = all(self._ended_well(branch) for branch in self.branches) and not self._other_reasons()
        if complete:
            (self.directory / JOURNAL).unlink(missing_ok=True)
        return complete

    def _follow(self) -> None:
        if self.request.scene.search is not None:  # its journal is of another kind
            return
        followed = Branches(
            self.request, self._tables, self.progress, self.branches, self.seconds, self.failures, self.offshoots
        )  # fmt: skip
        followed.follow_all(self.directory / JOURNAL)

    def reasons(self) -> list[str]:
        """Reasons why the run is not as requested, in a line each."""
        reasons = []
        for branch in self.branches:
            if isinstance(branch.space, Family):
                part = f"mode {branch.space.coordinates.mode_number}"
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
        from casadi_skin.runs.family_points import reasons

        return [*reasons(self.offshoots), *self.failures]

    def _ended_well(self, branch: Branch) -> bool:
        """Whether a branch reached its end, and all of it was resolved."""
        return self._reached_its_end(branch) and not branch.known_unresolved

    def _reached_its_end(self, branch: Branch) -> bool:
        """Whether a branch reached its requested end, or the natural end of a branch that leaves another one."""
        if not self.request.scene.has_diagram:
            return branch.complete
        from casadi_skin.runs.parts import ended_well

        return ended_well(branch)

    # Other parts ----------------------------------------------------------------------------------------------------

    def _evolve(self) -> None:
        """The time evolution with its files, where the scene requests one; nothing of it is imported elsewhere."""
        scene = self.request.scene
        alone = scene.family is None and scene.orbit is None
        if scene.dynamics is None or not (self.branches or alone):
            return
        from casadi_skin.dynamics import EvolutionError
        from casadi_skin.runs.tasks import evolve_from_rest, evolve_scene, scene_orbit, write_dynamics

        self.progress.say("time evolution")
        try:
            orbit = None if alone else scene_orbit(self.request, self.branches)
            self.evolution = evolve_from_rest(self.request) if orbit is None else evolve_scene(self.request, orbit)
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
        """The exports of the scene; nothing of them is imported elsewhere."""
        if self.request.scene.export is None:
            return
        from casadi_skin.runs.tasks import export_scene

        self.progress.say("exporting")
        try:
            self.exported = export_scene(self.request, self.branches, self.directory)
        except (ValueError, ArithmeticError) as error:
            self.failures.append(f"[export]: {error}")

    def _search(self) -> None:
        """The search with its files, where the scene requests one."""
        if self.request.scene.search is None:
            return
        from casadi_skin.optimise.search import SearchStatus
        from casadi_skin.runs.tasks import COMPLETE, run_search, write_results

        self.search = run_search(self.request, self.directory / JOURNAL, self.progress)
        self.progress.say("writing the search")
        write_results(self.request, self.scene_text, self.search, self.directory)
        if self.search.status is SearchStatus.INTERRUPTED:
            raise KeyboardInterrupt
        if self.search.status not in COMPLETE:
            self.failures.append(f"[search]: {self.search.reason}")

    # Writing --------------------------------------------------------------------------------------------------------

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
        names = self._tables.write()
        if self.request.scene.has_diagram:
            from casadi_skin.runs.diagram import write_diagram

            write_diagram(self.request, names, branches, origin(self.request, self.scene_text), self.directory)
            return
        write_branches(self.request, branches, self.scene_text, self.directory, self.progress)
        if self.request.scene.family is not None and self.request.scene.continuation is not None:
            from casadi_skin.runs.family_points import write_offshoots

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
        found = [s.floquet() for s in solutions if isinstance(s, Orbit) or s.known_floquet is not None]
        off = [f for f in found if f.trivial_deviation > f.allowed_deviation]
        if off:
            worst = max(off, key=lambda f: f.trivial_deviation / f.allowed_deviation)
            count = f"{len(off)} of {len(found)} points"
            size = f"by up to {worst.trivial_deviation:.1e} where {worst.allowed_deviation:.1e} is allowed"
            self.failures.append(
                f"[stability]: the trivial multiplier is off at {count}, {size}; try a smaller tolerance"
            )
