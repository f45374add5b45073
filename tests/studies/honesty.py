"""Error calibration: random cases, their true and estimated errors, and the verdict on all of them."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, astuple, dataclass, field, fields
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from rich.table import Table

from casadi_skin.results.figures.style import blank, finished, style
from casadi_skin.runs.output import InputError
from casadi_skin.runs.study import Study, letter, study_program
from tests.studies.honesty_cases import Case, Outcome, Quantity, draw, measure

COVERED = 0.95  # share of estimates that may not be below the true error
OVERESTIMATE = 30.0  # median of estimate over true error that is still of use
ROUND_OFF = 1e-14  # relative true errors below this are left out of that median
QUANTITIES = ("Omega", "profile", "multipliers")
METHODS = ("transcription", "corrector", "walker", "flow")
KEEP_EVERY = 20  # cases, after which the table is written
COLUMNS = (
    *(f.name for f in fields(Case)),
    *("points", "at_S", "Omega", "at_round_off", "stable", "reference_stable"),
    *(f"{name}_{what}" for name in QUANTITIES for what in ("true", "estimate", "relative_true", "verdict")),
    "reason",
)


@dataclass(frozen=True)
class Tally:
    """Counts over some of the judged errors; `label` says which.

    `missed` counts true errors above the tolerance where the result speaks neither of round-off nor, for multipliers,
    of an estimate above the tolerance; `announced` those where the multipliers' estimate does.
    """

    label: str
    judged: int
    covered: int
    far_off: int
    worst: float
    median: float
    missed: int
    announced: int

    @classmethod
    def of(cls, label: str, errors: Sequence[Quantity]) -> Tally:
        """Counts over `errors`."""
        ratios = [q.estimate / q.true for q in errors if q.relative > ROUND_OFF]
        announced = sum(q.announced for q in errors)
        return cls(
            label,
            len(errors),
            sum(q.covered for q in errors),
            sum(q.far_off for q in errors),
            max((q.true / q.estimate if q.estimate > 0 else math.inf for q in errors if q.true > 0), default=0.0),
            float(np.median(ratios)) if ratios else math.nan,
            sum(q.misses_tolerance for q in errors) - announced,
            announced,
        )

    @property
    def faults(self) -> list[str]:
        """Faults of the study, in words."""
        found = []
        if self.covered < COVERED * self.judged:
            found.append(f"{self.label}: {self.covered} of {self.judged} estimates are no smaller than the true error")
        if self.far_off:
            found.append(f"{self.label}: {self.far_off} true errors are more than ten times the estimate")
        if self.median >= OVERESTIMATE:
            found.append(f"{self.label}: estimates are {self.median:.0f} times the true error in the median")
        if self.missed:
            found.append(f"{self.label}: {self.missed} results miss the tolerance without saying so")
        return found


@dataclass
class ErrorCalibration(Study):
    """The study of `cases` cases of the draw `seed`, from case `first` on: honesty.csv and its picture."""

    cases: int
    seed: int = 0
    first: int = 0
    outcomes: list[Outcome] = field(default_factory=list)

    def run(self) -> None:
        cases = [draw(self.seed, index) for index in range(self.first, self.first + self.cases)]
        try:
            self.work_through(cases, lambda case: f"case {case.index}: {case}", self._measure)
        finally:
            self._write()

    def _measure(self, case: Case) -> None:
        self.outcomes.append(measure(case))
        if len(self.outcomes) % KEEP_EVERY == 0:
            self.write_table("honesty", COLUMNS, map(row, self.outcomes))

    def _write(self) -> None:
        if self.outcomes:
            self.write_table("honesty", COLUMNS, map(row, self.outcomes))
            self.write_figure("honesty", calibration_figure(self.outcomes))

    @property
    def failures(self) -> list[Outcome]:
        """Cases of which something could not be computed or judged."""
        return [outcome for outcome in self.outcomes if outcome.reason]

    def errors(self, name: str = "") -> list[Quantity]:
        """The judged errors of one quantity, or of all."""
        return [q for outcome in self.outcomes for q in outcome.quantities if name in ("", q.name)]

    @property
    def tallies(self) -> list[Tally]:
        """Counts over all errors and by quantity: those that are judged."""
        return [Tally.of("all", self.errors()), *(Tally.of(name, self.errors(name)) for name in QUANTITIES)]

    def method_tallies(self) -> Iterator[Tally]:
        """Counts by method; of flows over the errors of multipliers alone, of other methods over those of orbits."""
        for kind in METHODS:
            for method in sorted({str(getattr(o.case, kind)) for o in self.outcomes}):
                chosen = [q for o in self.outcomes if getattr(o.case, kind) == method for q in o.quantities]
                label = f"{method} flow" if kind == "flow" else method
                yield Tally.of(label, [q for q in chosen if (q.name == "multipliers") == (kind == "flow")])

    @property
    def faults(self) -> list[str]:
        """Why the estimates are not honest, in words; none where they are."""
        found = [fault for tally in self.tallies for fault in tally.faults]
        if self.failures:
            found.append(f"{len(self.failures)} of {len(self.outcomes)} cases could not be judged")
        if len(self.outcomes) < self.cases:
            found.append(f"{len(self.outcomes)} of {self.cases} cases were computed")
        return found

    def report(self) -> Iterator[str]:
        for outcome in self.failures:
            yield f"case {outcome.case.index}: {outcome.reason}"
        for fault in self.faults:
            yield f"not honest: {fault}"

    def tables(self) -> Iterator[Table]:
        """The counts, by quantity and by method."""
        heads = ("covered", "", "largest\ntrue/est.", "median\nest./true", "true >\n10 est.", "missed", "declared")
        table = text_table(("errors of", *heads))
        tallies = self.tallies
        for i, tally in enumerate((*tallies, *self.method_tallies())):
            if i in (1, len(tallies)):
                table.add_row()
            label, judged, covered, far_off, worst, median, missed, announced = astuple(tally)
            share = f"{100.0 * covered / judged:.1f}%" if judged else ""
            ratio = "" if math.isnan(median) else f"{median:.3g}"
            counts = map(str, (far_off, missed, announced))
            table.add_row(label, f"{covered}/{judged}", share, f"{worst:.2g}", ratio, *counts)
        yield table


def text_table(heads: Sequence[str], words: Sequence[int] = (0,)) -> Table:
    """An empty table for the terminal; `words` are the places of columns that do not hold numbers."""
    table = Table(box=None, header_style="bold", padding=(0, 1))
    for place, head in enumerate(heads):
        table.add_column(head, justify="left" if place in words else "right", no_wrap=True)
    return table


def row(outcome: Outcome) -> dict[str, object]:
    """One row of honesty.csv; unknown values are missing."""
    values: dict[str, object] = {**asdict(outcome.case), **vars(outcome), "at_S": outcome.S, "S": outcome.case.S}
    for q in outcome.quantities:
        numbers = {"true": q.true, "estimate": q.estimate, "relative_true": q.relative, "verdict": q.verdict}
        values |= {f"{q.name}_{what}": value for what, value in numbers.items()}
    return values


# The picture ----------------------------------------------------------------------------------------------------------


LOWEST = 1e-17  # of the axes, where smaller errors are drawn
SIZE = (8.6, 3.7)
MARKERS = {  # quantity: label, marker, its edge and face
    "Omega": (r"$\Omega$", "o", "black", "none"),
    "profile": ("profile", "^", "0.35", "0.8"),
    "multipliers": ("multipliers", "x", "0.2", "none"),
}


def calibration_figure(outcomes: Iterable[Outcome]) -> Figure:
    """Estimated against true error, a panel and a marker a quantity, both relative to its size."""
    drawn = [q for outcome in outcomes for q in outcome.quantities]
    finite = [q.estimate / q.scale for q in drawn if math.isfinite(q.estimate)]
    highest = 10.0 ** math.ceil(math.log10(max([1e-3, *finite, *(q.relative for q in drawn)])))
    ends, ticks = np.array([LOWEST, highest]), 10.0 ** np.arange(-16, math.log10(highest), 4)
    with style():
        figure = blank(*SIZE)
        panels = figure.subplots(1, len(MARKERS), sharey=True)
        for axes, name, panel in zip(panels, MARKERS, "abc", strict=True):
            label, marker, edge, face = MARKERS[name]
            pairs = [(q.relative, min(q.estimate / q.scale, highest)) for q in drawn if q.name == name]
            true, estimate = np.maximum(np.array(pairs).reshape(-1, 2), LOWEST).T
            axes.fill_between(ends, ends / 10.0, LOWEST, color="0.9", linewidth=0)
            axes.loglog(ends, ends, "k-", linewidth=0.9, label="estimate = true error")
            axes.loglog(ends, ends / 10.0, "k--", linewidth=0.9, label="estimate = a tenth of it")
            if pairs:  # the layout fails on markers of nothing that are not clipped
                axes.loglog(
                    true, estimate, marker, markersize=4.0, markeredgewidth=0.7, markeredgecolor=edge,
                    markerfacecolor=face, clip_on=False,
                )  # fmt: skip
            axes.set(xlim=ends, ylim=ends, xticks=ticks, yticks=ticks, aspect="equal", xlabel="true relative error")
            letter(axes, panel, label)
        panels[0].set_ylabel("estimated relative error")
        return finished(figure, panels, columns=2)


def main(arguments: Sequence[str] | None = None) -> int:
    """The calibration as a program; returns its exit status, 1 where the estimates are not honest."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.studies.honesty",
        description="Compare estimated with true errors of random orbits; exit status 1 where they are not honest.",
    )
    parser.add_argument("--cases", type=int, default=200, metavar="K", help="number of cases (default: 200)")
    parser.add_argument("--seed", type=int, default=0, metavar="K", help="of the draw (default: 0)")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="index of the first case (default: 0)")
    return study_program(parser, Path("results/honesty"), _study, arguments)


def _study(words: argparse.Namespace) -> ErrorCalibration:
    for name, least in (("cases", 1), ("seed", 0), ("first", 0)):
        if getattr(words, name) < least:
            raise InputError(f"honesty: given --{name} {getattr(words, name)}; accepted: a whole number >= {least}")
    return ErrorCalibration(words.out, words.cases, words.seed, words.first)


if __name__ == "__main__":
    sys.exit(main())
