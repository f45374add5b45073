"""Hard cases at the extremes of every parameter: where results hold, to how many digits, and where they are refused."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING

from casadi_skin.results.tables import Cell, write_csv
from casadi_skin.studies.stress import physical
from casadi_skin.studies.stress.case import Case, Outcome, measure

if TYPE_CHECKING:
    from rich.table import Table

COLUMNS = (
    *("theme", "case", "asked", "check", "verdict", "got", "digits", "promised", "refused", "fault", "seconds"),
)  # fmt: skip


@dataclass
class Extremes:
    """Outcomes so far, and the files written of them."""

    directory: Path
    outcomes: list[Outcome] = field(default_factory=list)
    compared: list[physical.Comparison] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)

    @property
    def faults(self) -> list[Outcome]:
        """Cases that neither hold nor are refused as expected."""
        return [outcome for outcome in self.outcomes if not outcome.holds]

    @property
    def refusals(self) -> list[Outcome]:
        """Cases that are refused as expected."""
        return [outcome for outcome in self.outcomes if outcome.verdict == "refused"]


def all_cases() -> list[Case]:
    """Every case, by theme."""
    from casadi_skin.studies.stress import cases_amplitude as amplitude
    from casadi_skin.studies.stress import cases_chain as chain
    from casadi_skin.studies.stress import cases_stability as stability

    makers = (
        *(chain.gamma_cases, chain.size_cases, chain.alpha_cases, chain.mode_cases),
        *(amplitude.small_cases, amplitude.large_cases, amplitude.coupling_cases, amplitude.resonance_cases),
        *(stability.multiplier_cases, stability.physical_cases),
    )
    return [case for maker in makers for case in maker()]


def extremes(
    study: Extremes, quick: bool, say: Callable[[str], None] = lambda words: None, cases: Iterable[Case] | None = None
) -> None:
    """Measure the cases, or the quick ones of them, into the study's directory.

    extremes.csv is replaced atomically after every case; pictures are written at the end, and also where
    KeyboardInterrupt ends the study.
    """
    study.directory.mkdir(parents=True, exist_ok=True)
    _compare_coordinates(study, quick, say)
    _find_thresholds(study, quick, say)
    chosen = [case for case in (all_cases() if cases is None else cases) if case.quick or not quick]
    try:
        for index, case in enumerate(chosen, start=1):
            say(f"case {index} of {len(chosen)}: {case.theme}, {case.name}")
            study.outcomes.append(measure(case))
            _write_table(study)
    finally:
        if study.outcomes:
            _write_figure(study)


def _compare_coordinates(study: Extremes, quick: bool, say: Callable[[str], None]) -> None:
    """Write physical_against_gauge.csv and its picture."""
    from casadi_skin.figures import save
    from casadi_skin.studies.stress.figure import physical_figure

    for sites in physical.QUICK_SIZES if quick else physical.SIZES:
        for gamma in physical.GAMMAS:
            say(f"physical coordinates: N = {sites}, gamma = {gamma:g}")
            found = physical.compare(sites, gamma)
            if found is not None:
                study.compared.append(found)
    columns = [f.name for f in fields(physical.Comparison)]
    path = study.directory / "physical_against_gauge.csv"
    write_csv(path, columns, [{name: _cell(value) for name, value in asdict(c).items()} for c in study.compared])
    study.files += [path, *save(physical_figure(study.compared), study.directory / "physical_against_gauge")]


def _find_thresholds(study: Extremes, quick: bool, say: Callable[[str], None]) -> None:
    """Write threshold.csv, of the end breather of the infinite chain, and its picture."""
    from casadi_skin.figures import save
    from casadi_skin.studies.stress import threshold as born

    found = born.thresholds(born.QUICK_GAMMAS if quick else born.GAMMAS, say)
    path = study.directory / "threshold.csv"
    write_csv(path, [f.name for f in fields(born.Threshold)], [asdict(t) for t in found])
    study.files += [path, *save(born.threshold_figure(found), study.directory / "threshold")]


def _cell(value: float) -> Cell:
    return value if math.isfinite(value) else ""


def row(outcome: Outcome) -> dict[str, Cell]:
    """One row of extremes.csv; what is not known is empty."""
    case, finding = outcome.case, outcome.finding
    return {
        "theme": case.theme,
        "case": case.name,
        "asked": case.asked,
        "check": case.check,
        "verdict": outcome.verdict,
        "got": "" if finding is None else finding.got,
        "digits": "" if finding is None else f"{finding.digits:.2f}",
        "promised": "" if finding is None else f"{finding.promised:.2f}",
        "refused": outcome.refused,
        "fault": outcome.fault,
        "seconds": f"{outcome.seconds:.3f}",
    }


def _write_table(study: Extremes) -> None:
    path = study.directory / "extremes.csv"
    write_csv(path, COLUMNS, [row(outcome) for outcome in study.outcomes])
    if path not in study.files:
        study.files.append(path)


def _write_figure(study: Extremes) -> None:
    from casadi_skin.figures import save
    from casadi_skin.studies.stress.figure import extremes_figure

    study.files += save(extremes_figure(study.outcomes), study.directory / "extremes")


def extremes_table(study: Extremes) -> Table:
    """The outcomes, by theme."""
    from rich.table import Table

    table = Table(box=None, header_style="bold", padding=(0, 1))
    table.add_column("case", no_wrap=True)
    for head in ("digits", "promised"):
        table.add_column(head, justify="right", no_wrap=True)
    table.add_column("checked by", no_wrap=True)
    theme = ""
    for outcome in study.outcomes:
        case, finding = outcome.case, outcome.finding
        if case.theme != theme:
            theme = case.theme
            table.add_row(f"[bold]{theme}[/bold]")
        known = ("", "") if finding is None else (f"{finding.digits:.1f}", f"{finding.promised:.1f}")
        words = {"holds": case.check, "refused": "refused", "fault": "NOT AS EXPECTED"}[outcome.verdict]
        table.add_row(f"  {case.name}", *known, words)
    return table
