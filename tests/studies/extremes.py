"""The stress test: hard cases, where results hold, to how many digits, and where they are refused."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from casadi_skin.dynamics.resonances import threshold
from casadi_skin.lattice.chain import Chain
from casadi_skin.results.figures.style import blank, finished, style
from casadi_skin.runs.study import Study, letter, study_program
from tests.studies import extreme_physical as physical
from tests.studies.extreme_case import MOST_DIGITS, Case, Outcome, measure
from tests.studies.extreme_cases import all_cases
from tests.studies.honesty import text_table

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
        if self.outcomes:
            self.write_figure("extremes", stress_figure(self.outcomes))

    def _compare_coordinates(self) -> None:
        """Write physical_against_gauge.csv and its picture."""
        compared = []
        for sites in physical.QUICK_SIZES if self.quick else physical.SIZES:
            for gamma in physical.GAMMAS:
                self.say(f"physical coordinates: N = {sites}, gamma = {gamma:g}")
                compared.append(physical.compare(sites, gamma))
        known = [comparison for comparison in compared if comparison is not None]
        columns = [f.name for f in fields(physical.Comparison)]
        self.write_table("physical_against_gauge", columns, map(asdict, known))
        self.write_figure("physical_against_gauge", physical.physical_figure(known))

    def _find_thresholds(self) -> None:
        """Write threshold.csv and its picture."""
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

    def report(self) -> Iterator[str]:
        for outcome in self.refusals:
            yield f"refused: {outcome.case.name}: {outcome.refused}"
        for outcome in self.faults:
            yield f"not as expected: {outcome.case.theme}, {outcome.case.name}: {outcome.fault}"
        count, refused, faults = len(self.outcomes), len(self.refusals), len(self.faults)
        counts = f"{count - refused - faults} hold, {refused} are refused, {faults} not as expected"
        yield f"{count} cases: {counts}"

    def tables(self) -> Iterator[Table]:
        """The outcomes, by theme."""
        table = text_table(("case", "digits", "promised", "checked by"), words=(0, 3))
        theme = ""
        for outcome in self.outcomes:
            case, finding = outcome.case, outcome.finding
            if case.theme != theme:
                theme = case.theme
                table.add_row(Text(theme, style="bold"))
            known = ("", "") if finding is None else (f"{finding.digits:.1f}", f"{finding.promised:.1f}")
            words = {"holds": case.check, "refused": "refused", "fault": "NOT AS EXPECTED"}[outcome.verdict]
            table.add_row(f"  {case.name}", *known, words)
        yield table


def row(outcome: Outcome) -> dict[str, object]:
    """One row of extremes.csv."""
    case, finding = outcome.case, outcome.finding
    found = ("",) * 3 if finding is None else (finding.got, f"{finding.digits:.2f}", f"{finding.promised:.2f}")
    asked = (case.theme, case.name, case.asked, case.check, outcome.verdict)
    values = (*asked, *found, outcome.refused, outcome.fault, f"{outcome.seconds:.3f}")
    return dict(zip(COLUMNS, values, strict=True))


# Pictures -------------------------------------------------------------------------------------------------------------


ROW = 0.18  # inches
SYMBOLS = (("gamma", "γ"), ("alpha", "α"), ("lambda", "λ"), ("= -", "= −"), ("e-", "e−"), ("1 - ", "1 − "))


def stress_figure(outcomes: Sequence[Outcome]) -> Figure:
    """Digits of agreement of every case, by theme, in two columns of rows; refusals at the left edge."""
    themes = list(dict.fromkeys(outcome.case.theme for outcome in outcomes))
    groups = [[outcome for outcome in outcomes if outcome.case.theme == theme] for theme in themes]
    left, right = _halves(groups)
    rows = max(sum(len(group) + 1.5 for group in half) for half in (left, right))
    with style():
        figure = blank(10.6, 1.2 + ROW * rows)
        panels = figure.subplots(1, 2 if right else 1, squeeze=False)[0]
        for axes, half in zip(panels, (left, right), strict=False):
            _draw_rows(axes, half, rows)
        return finished(figure, panels, 3)


def _halves(groups: Sequence[Sequence[Outcome]]) -> tuple[list[Sequence[Outcome]], list[Sequence[Outcome]]]:
    """The groups in order, cut in two where both parts are nearest in length."""
    lengths = np.cumsum([len(group) + 1.5 for group in groups])
    cut = int(np.argmin(np.abs(2.0 * lengths - lengths[-1]))) + 1
    return list(groups[:cut]), list(groups[cut:])


def _draw_rows(axes: Axes, groups: Sequence[Sequence[Outcome]], rows: float) -> None:
    places: list[float] = []
    labels: list[str] = []
    y = 0.0
    for group in groups:
        axes.text(0.0, y, group[0].case.theme, fontweight="bold", va="center", fontsize=9)
        y += 1.0
        for outcome in group:
            places.append(y)
            labels.append(_in_symbols(outcome.case.name))
            _draw_case(axes, outcome, y)
            y += 1.0
        y += 0.5
    axes.set(xlim=(-0.8, MOST_DIGITS + 0.6), ylim=(rows - 0.5, -0.9), yticks=places, xlabel="digits")
    axes.set_yticklabels(labels, fontsize=9)
    axes.set_xticks(range(0, int(MOST_DIGITS) + 1, 2))
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="x", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def _in_symbols(words: str) -> str:
    """Words with the letters and minus signs of formulas."""
    for word, symbol in SYMBOLS:
        words = words.replace(word, symbol)
    return words


def _draw_case(axes: Axes, outcome: Outcome, y: float) -> None:
    finding = outcome.finding
    if outcome.fault:
        label = "not as expected"
        axes.plot(-0.4, y, "*", color="black", ms=9, label=label, ls="none")
    elif outcome.refused:
        axes.plot(-0.4, y, "x", color="black", ms=5, label="refused, saying why", ls="none")
    if finding is None:
        return
    low, high = sorted((finding.promised, finding.digits))
    axes.plot([low, high], [y, y], color="0.75", lw=1.0, zorder=1)
    axes.plot(finding.promised, y, "|", color="0.3", ms=7, mew=1.4, label="promised or asked for", ls="none")
    if outcome.refused:
        label = "agreement of the last orbit before"
        axes.plot(finding.digits, y, "o", color="black", mfc="white", ms=4, label=label, ls="none")
    else:
        axes.plot(finding.digits, y, "o", color="black", ms=4, label="agreement with the check", ls="none")


# Threshold -----------------------------------------------------------------------------------------------------------


def threshold_figure(alpha: float, gammas: Sequence[float], thresholds: Mapping[float, Sequence[float]]) -> Figure:
    """|g| S_c against gamma for each g (a), and how much it differs between the signs of g (b)."""
    looks: dict[float, dict[str, Any]] = {
        1.0: {"marker": "o", "color": "black", "label": "$g = +1$, above the band"},
        -1.0: {"marker": "s", "color": "0.45", "label": "$g = -1$, below the band", "ls": (0, (4.0, 1.5))},
    }
    with style():
        figure = blank(7.2, 3.4)
        left, right = figure.subplots(1, 2)
        for g, S in thresholds.items():
            left.plot(gammas, S, ms=3.0, lw=1.1, **looks[g])
        ratio = np.divide(thresholds[1.0], thresholds[-1.0])
        right.semilogy(gammas, ratio - 1.0, "-o", ms=3.0, color="black", lw=1.1)
        left.set(xlabel=r"nonreciprocity $\gamma$", ylabel=r"threshold $|g|\,S_c$", xlim=(0, 1), ylim=(0, None))
        right.set(xlabel=r"nonreciprocity $\gamma$", ylabel=r"$S_c(g>0)/S_c(g<0) - 1$", xlim=(0, 1))
        letter(left, "a", "end breather of the infinite chain")
        letter(right, "b", rf"$\alpha = {alpha:g}$ (dimensionless)")
        return finished(figure, [left, right], 2)


def main(arguments: Sequence[str] | None = None) -> int:
    """The stress test as a program; returns its exit status, 1 where a case neither holds nor is refused."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.extremes",
        description="Check orbits and multipliers at the extremes of every parameter by independent means; exit "
        "status 1 where a case neither holds nor is refused as expected.",
    )
    parser.add_argument("--quick", action="store_true", help="the shorter cases alone")
    return study_program(parser, Path("results/extremes"), lambda words: StressTest(words.out, words.quick), arguments)


if __name__ == "__main__":
    sys.exit(main())
