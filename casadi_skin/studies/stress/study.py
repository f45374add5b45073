"""The stress test: hard cases, where results hold, to how many digits, and where they are refused."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.threshold import threshold
from casadi_skin.studies.stress import physical
from casadi_skin.studies.stress.case import Case, Outcome, measure
from casadi_skin.studies.stress.cases import all_cases
from casadi_skin.studies.study import Study, text_table

if TYPE_CHECKING:
    from rich.table import Table

COLUMNS = (
    *("theme", "case", "asked", "check", "verdict", "got", "digits", "promised", "refused", "fault", "seconds"),
)  # fmt: skip
ALPHA = 1.0  # of thresholds
GAMMAS = (0.02, 0.04, *np.round(np.arange(0.06, 0.96, 0.03), 2).tolist(), 0.97, 0.99)
QUICK_GAMMAS = (0.06, 0.25, 0.5, 0.75, 0.97)


@dataclass
class StressTest(Study):
    """All cases, or the quick ones of them: extremes.csv, physical_against_gauge.csv, threshold.csv and pictures."""

    quick: bool = False
    outcomes: list[Outcome] = field(default_factory=list)

    def run(self) -> None:
        self._compare_coordinates()
        self._find_thresholds()
        cases = [case for case in all_cases() if case.quick or not self.quick]
        try:
            self.work_through(cases, lambda case: f"{case.theme}, {case.name}", self._measure)
        finally:
            self._draw()

    def _measure(self, case: Case) -> None:
        self.outcomes.append(measure(case))
        self.write_table("extremes", COLUMNS, map(row, self.outcomes))

    def _draw(self) -> None:
        from casadi_skin.studies.stress.figure import stress_figure

        if self.outcomes:
            self.write_figure("extremes", stress_figure(self.outcomes))

    def _compare_coordinates(self) -> None:
        """Write physical_against_gauge.csv and its picture."""
        from casadi_skin.studies.stress.figure import physical_figure

        compared = []
        for sites in physical.QUICK_SIZES if self.quick else physical.SIZES:
            for gamma in physical.GAMMAS:
                self.say(f"physical coordinates: N = {sites}, gamma = {gamma:g}")
                compared.append(physical.compare(sites, gamma))
        known = [comparison for comparison in compared if comparison is not None]
        columns = [f.name for f in fields(physical.Comparison)]
        self.write_table("physical_against_gauge", columns, map(asdict, known))
        self.write_figure("physical_against_gauge", physical_figure(known))

    def _find_thresholds(self) -> None:
        """Write threshold.csv and its picture."""
        from casadi_skin.studies.stress.figure import threshold_figure

        gammas, found = QUICK_GAMMAS if self.quick else GAMMAS, {}
        for g in (1.0, -1.0):
            self.say(f"thresholds: g = {g:+g}")
            found[g] = [threshold(Chain(2, ALPHA, gamma, g)) for gamma in gammas]
        rows = [
            {"alpha": ALPHA, "gamma": c, "g": g, "S": S} for g in found for c, S in zip(gammas, found[g], strict=True)
        ]
        self.write_table("threshold", list(rows[0]), rows)
        self.write_figure("threshold", threshold_figure(ALPHA, gammas, found))

    @property
    def faults(self) -> list[Outcome]:
        """Cases that neither hold nor are refused as expected."""
        return [outcome for outcome in self.outcomes if outcome.fault]

    @property
    def refusals(self) -> list[Outcome]:
        """Cases that are refused as expected."""
        return [outcome for outcome in self.outcomes if outcome.verdict == "refused"]

    def report(self) -> Iterator[str | Table]:
        yield self.table()
        for outcome in self.refusals:
            yield f"refused: {outcome.case.name}: {outcome.refused}"
        for outcome in self.faults:
            yield f"not as expected: {outcome.case.theme}, {outcome.case.name}: {outcome.fault}"
        count, refused, faults = len(self.outcomes), len(self.refusals), len(self.faults)
        counts = f"{count - refused - faults} hold, {refused} are refused, {faults} not as expected"
        yield f"{count} cases: {counts}"

    def table(self) -> Table:
        """The outcomes, by theme."""
        table = text_table(("case", "digits", "promised", "checked by"))
        theme = ""
        for outcome in self.outcomes:
            case, finding = outcome.case, outcome.finding
            if case.theme != theme:
                theme = case.theme
                table.add_row(f"[bold]{theme}[/bold]")
            known = ("", "") if finding is None else (f"{finding.digits:.1f}", f"{finding.promised:.1f}")
            words = {"holds": case.check, "refused": "refused", "fault": "NOT AS EXPECTED"}[outcome.verdict]
            table.add_row(f"  {case.name}", *known, words)
        return table


def row(outcome: Outcome) -> dict[str, object]:
    """One row of extremes.csv."""
    case, finding = outcome.case, outcome.finding
    found = ("",) * 3 if finding is None else (finding.got, f"{finding.digits:.2f}", f"{finding.promised:.2f}")
    asked = (case.theme, case.name, case.asked, case.check, outcome.verdict)
    values = (*asked, *found, outcome.refused, outcome.fault, f"{outcome.seconds:.3f}")
    return dict(zip(COLUMNS, values, strict=True))
