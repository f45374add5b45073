"""Running a scene of a model: the first orbit or solution, its branch, multipliers; tables and pictures at the end."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path

import casadi_skin.figures as figures
from casadi_skin.figures.branch import branch_figure, orbit_figure
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.orbits.periodic_orbit import PeriodicOrbit
from casadi_skin.orbits.solution import BoundarySolution
from casadi_skin.progress import Progress
from casadi_skin.results.branch import BranchPoint, branch_row, fold_marks, write_netcdf
from casadi_skin.results.tables import Cell, write_csv
from casadi_skin.runs.directory import JOURNAL, SCENE_MODEL
from casadi_skin.runs.model_request import ModelRequest
from casadi_skin.runs.model_solution import first_solution
from casadi_skin.stability.full_period import TrivialMultiplierWarning
from casadi_skin.threads import one_thread

TABLE_PERIOD = 0.5  # seconds between two writings of branch.csv while a run goes on


@dataclass
class ModelRun:
    """One run of a scene of a model into a directory that is ready for it (see runs.directory).

    `points` fill in arclength order, with multipliers where the scene asks for stability; `reasons` are told, one a
    line, where a run is not what was asked for. An empty journal in the directory marks a run that is not complete: it
    starts again when resumed.
    """

    request: ModelRequest
    scene_text: str
    directory: Path
    progress: Progress
    points: list[BranchPoint] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    _rows: list[dict[str, Cell]] = field(default_factory=list)
    _written: float = 0.0

    def execute(self) -> bool:
        """Compute, write, and tell whether all that was asked for was found."""
        journal = self.directory / JOURNAL
        journal.touch()
        suffix = self.request.path.suffix
        (self.directory / f"{SCENE_MODEL}{suffix}").write_text(self.request.source, encoding="utf-8")
        try:
            with one_thread():
                self._compute()
        except (ArithmeticError, ValueError) as error:
            self.reasons.append(str(error))
        finally:
            self._write_results()
        if not self.reasons:
            journal.unlink()
        return not self.reasons

    # Computing ------------------------------------------------------------------------------------------------------

    def _compute(self) -> None:
        request, table = self.request, self.request.scene.continuation
        self.progress.say("simulating and solving" if request.problem is None else "solving")
        first = first_solution(request)
        if table is None:
            self._keep(first)
        else:
            options = {"max_points": table.max_points, "max_step": table.max_step}
            branch = first.follow(table.parameter, table.to, at=table.at, progress=self._keep, **options)
            if not branch.complete:
                self.reasons.append(f"[continuation]: {branch.reason}")
            self._tell_missed(branch.missed)
        self._tell_drift()

    def _keep(self, solution: BoundarySolution) -> None:
        """Add a solution, with its multipliers; branch.csv is replaced at most every TABLE_PERIOD."""
        found = None
        if self.request.scene.stability is not None and isinstance(solution, PeriodicOrbit):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", TrivialMultiplierWarning)  # told at the end, for all points
                found = solution.multipliers(self.request.scene.method.flow)
        point = BranchPoint(solution, found)
        row = branch_row(self.request, point, len(self._rows))
        with interrupts_deferred():  # both or none
            self.points.append(point)
            self._rows.append(row)
        table = self.request.scene.continuation
        if table is not None:
            value = solution.parameters[table.parameter]
            self.progress.say(f"{table.parameter} = {value:.6g} to {table.to:g}, {len(self.points)} points")
        if time.monotonic() - self._written > TABLE_PERIOD:
            self._write_table()

    def _tell_missed(self, missed: tuple[float, ...]) -> None:
        table = self.request.scene.continuation
        if table is None:
            return
        for value in table.at:
            if value in missed:
                self.reasons.append(f"[continuation] at: no solution was found at {table.parameter} = {value:g}")
            elif not any(p.solution.parameters[table.parameter] == value for p in self.points):
                self.reasons.append(f"[continuation] at: the branch does not pass {table.parameter} = {value:g}")

    def _tell_drift(self) -> None:
        found = [p.multipliers for p in self.points if p.multipliers is not None]
        off = [m for m in found if m.deviation > m.allowed]
        if off:
            worst = max(off, key=lambda m: m.deviation / m.allowed)
            count = f"{len(off)} of {len(found)} points"
            size = f"by up to {worst.deviation:.1e} where {worst.allowed:.1e} is allowed"
            words = f"the trivial multiplier is off at {count}, {size}"
            self.reasons.append(f"[stability]: {words}; try a smaller tolerance")

    # Writing --------------------------------------------------------------------------------------------------------

    def _write_table(self) -> None:
        for row, fold in zip(self._rows, fold_marks(self.points), strict=True):
            row["fold"] = int(fold)
        write_csv(self.directory / "branch.csv", list(self._rows[0]), self._rows)
        self._written = time.monotonic()

    def _write_results(self) -> None:
        if not self.points:
            return
        self.progress.say("writing tables and pictures")
        self._write_table()
        write_netcdf(self.directory / "branch.nc", self.request, self.points, self.scene_text)
        if len(self.points) > 1:
            figures.save(branch_figure(self.request, self.points), self.directory / "branch")
        figures.save(orbit_figure(self.request, self.points[-1]), self.directory / "orbit")
