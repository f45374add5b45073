"""Running a scene: families one after the other, every orbit kept as it converges, tables and pictures at the end."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import casadi_skin.figures as figures
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.follow import Following
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.progress import Progress
from casadi_skin.results.journal import (
    ChangeRecord,
    EndRecord,
    Journal,
    orbit_record,
    read_journal,
    restore,
    resumable,
    trim_journal,
)
from casadi_skin.results.netcdf import write_netcdf
from casadi_skin.results.tables import EVENT_COLUMNS, Cell, event_row, orbit_row, spectrum_rows, write_csv
from casadi_skin.runs.directory import JOURNAL
from casadi_skin.runs.request import scene_chain, scene_requests
from casadi_skin.scene import Scene

if TYPE_CHECKING:
    from casadi_skin.dynamics import Evolution
    from casadi_skin.optimise.result import SearchResult

TABLE_PERIOD = 0.5  # seconds between two writings of family.csv while a run goes on


@dataclass
class Run:
    """One run of a scene into a directory that is ready for it (see runs.directory).

    `branches` and `seconds` fill as families end; an exception or an interruption leaves what was computed in the
    files and in the journal. `evolution` is the time evolution where the scene asks for one, as far as it could be
    followed; `evolution_failure` tells in one line why that is not to its end. `search` is the result of a search.
    `exported` are what was written for use outside of Python; `export_failure` tells why that could not be.
    """

    scene: Scene
    scene_text: str
    directory: Path
    progress: Progress
    branches: list[Branch] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    evolution: Evolution | None = None
    evolution_failure: str = ""
    search: SearchResult | None = None
    exported: tuple[Path, ...] = ()
    export_failure: str = ""
    _rows: list[dict[str, Cell]] = field(default_factory=list)
    _written: float = 0.0

    @property
    def _with_stability(self) -> bool:
        return self.scene.stability is not None

    def execute(self) -> bool:
        """Compute, write, and tell whether every family is complete and the time evolution, if any, was followed."""
        try:
            self._follow_all()
        finally:
            self._write_results()
        self._evolve()
        searched = self._search()
        self._export()
        complete = all(branch.complete for branch in self.branches) and not self.evolution_failure and searched
        complete = complete and not self.export_failure
        if complete:
            (self.directory / JOURNAL).unlink(missing_ok=True)
        return complete

    # Computing ------------------------------------------------------------------------------------------------------

    def _follow_all(self) -> None:
        requests = scene_requests(self.scene)
        if not requests:
            return
        path = self.directory / JOURNAL
        records = resumable(read_journal(path)) if path.exists() else []
        trim_journal(path, records)
        stability = self.scene.stability
        with Journal(path) as journal:
            for request in requests:
                known = restore(
                    records, Family(request), stability is not None, stability is not None and stability.events
                )
                started = time.perf_counter()
                self._keep(known.orbits)
                if isinstance(known, Following):
                    self._follow(known, journal)
                else:
                    self.branches.append(known)
                self.seconds.append(time.perf_counter() - started)

    def _follow(self, walk: Following, journal: Journal) -> None:
        """Follow one family to its end; each result goes to the journal before anything else happens."""
        request = walk.space.request
        self.progress.say(f"j = {request.mode}: building")
        try:
            for result in walk:
                if isinstance(result, Orbit):
                    journal.append(orbit_record(result, self._with_stability))
                    self._keep([result])
                    self.progress.orbit(result, len(walk.orbits))
                else:
                    journal.append(ChangeRecord(request.mode, result))
        finally:
            branch = walk.branch()
            self.branches.append(branch)
        missed = (branch.missed, branch.missed_Omega, branch.missed_period)
        journal.append(EndRecord(request.mode, branch.end, branch.detail, *missed))

    def _evolve(self) -> None:
        """The time evolution with its files, where the scene asks for one; nothing of it is imported elsewhere."""
        if self.scene.dynamics is None:
            return
        from casadi_skin.dynamics import EvolutionError
        from casadi_skin.runs.dynamics import evolve_scene, scene_orbit, write_dynamics

        self.progress.say("time evolution")
        try:
            orbit = scene_orbit(self.scene, self.branches)
            self.evolution = evolve_scene(self.scene, orbit)
        except EvolutionError as error:
            self.evolution, self.evolution_failure = error.evolution, str(error)
        except (ValueError, ArithmeticError) as error:
            self.evolution_failure = str(error)
        if self.evolution is not None:
            self.progress.say("writing the time evolution")
            write_dynamics(self.scene, self.scene_text, orbit, self.evolution, self.directory)

    def _export(self) -> None:
        """What the scene wants out of Python; nothing of it is imported elsewhere."""
        if self.scene.export is None:
            return
        from casadi_skin.runs.export import export_scene

        self.progress.say("exporting")
        try:
            self.exported = export_scene(self.scene, self.branches, self.directory)
        except (ValueError, ArithmeticError) as error:
            self.export_failure = str(error)

    def _search(self) -> bool:
        """The search with its files, where the scene asks for one, and whether it found an optimum."""
        if self.scene.search is None:
            return True
        from casadi_skin.optimise.result import SearchStatus
        from casadi_skin.runs.search import COMPLETE, run_search, write_results

        self.search = run_search(self.scene, self.directory / JOURNAL, self.progress)
        self.progress.say("writing the search")
        write_results(self.scene, self.scene_text, self.search, self.directory)
        if self.search.status is SearchStatus.INTERRUPTED:
            raise KeyboardInterrupt
        return self.search.status in COMPLETE

    # Writing --------------------------------------------------------------------------------------------------------

    def _keep(self, orbits: Sequence[Orbit]) -> None:
        """Add rows to family.csv, which is replaced at most every TABLE_PERIOD."""
        for orbit in orbits:
            index = sum(row["mode"] == orbit.space.coordinates.mode_number for row in self._rows)
            self._rows.append(orbit_row(orbit, index, self._with_stability))
        if self._rows and time.monotonic() - self._written > TABLE_PERIOD:
            self._write_family()

    def _write_family(self) -> None:
        write_csv(self.directory / "family.csv", list(self._rows[0]), self._rows)
        self._written = time.monotonic()

    def _write_results(self) -> None:
        self.progress.say("writing tables and pictures")
        if self.scene.spectrum is not None:
            write_spectrum(scene_chain(self.scene), self.directory)
        if not self._rows:
            return
        self._write_family()
        stability = self.scene.stability
        if stability is not None and stability.events:
            events = [event_row(b.space.coordinates.mode_number, c) for b in self.branches for c in b.changes]
            write_csv(self.directory / "events.csv", EVENT_COLUMNS, events)
        branches = [branch for branch in self.branches if len(branch)]
        vectors = stability is not None and stability.vectors
        title = self.scene.title or ""
        write_netcdf(self.directory / "family.nc", branches, self.scene_text, title, vectors)
        figures.save(figures.frequency_figure(branches), self.directory / "frequency")
        profile = figures.profile_figure(branches)
        if profile is not None:
            figures.save(profile, self.directory / "profile")
        for branch in branches:
            multipliers = figures.multiplier_figure(branch)
            if multipliers is not None:
                figures.save(multipliers, self.directory / f"multipliers_j{branch.space.coordinates.mode_number}")
        if self.scene.family is not None and self.scene.family.film:
            self._write_films(branches)

    def _write_films(self, branches: Sequence[Branch]) -> None:
        """A film of each family's mode, at the last requested point or at the end."""
        from casadi_skin.animation import animate

        for branch in branches:
            mode = branch.space.coordinates.mode_number
            self.progress.say(f"film of j = {mode}")
            asked = [orbit for orbit in branch.orbits if orbit.point.requested]
            animate((asked or branch.orbits)[-1], self.directory / f"film_j{mode}.gif")


def write_spectrum(chain: Chain, directory: Path) -> None:
    """spectrum.csv and the picture of the linear spectrum."""
    write_csv(directory / "spectrum.csv", ("mode", "omega"), spectrum_rows(chain))
    figures.save(figures.spectrum_figure(chain), directory / "spectrum")
