"""Whether error estimates are honest: random cases, their true and estimated errors, and the verdict on all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.results.tables import Cell, write_csv
from casadi_skin.studies.calibration.cases import Case, Outcome, Quantity, draw, measure

if TYPE_CHECKING:
    from rich.table import Table

COVERED = 0.95  # share of estimates that may not be below the true error
OVERESTIMATE = 30.0  # median of estimate over true error that is still of use
ROUND_OFF = 1e-14  # relative true errors below this are left out of that median
QUANTITIES = ("Omega", "profile", "multipliers")
METHODS = ("transcription", "corrector", "walker", "flow")
KEEP_EVERY = 20  # cases, after which the table is written


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
        misses = [q for q in errors if q.misses_tolerance]
        announced = sum(q.announced and q.name == "multipliers" for q in misses)
        return cls(
            label,
            len(errors),
            sum(q.covered for q in errors),
            sum(q.far_off for q in errors),
            max((q.true / q.estimate if q.estimate > 0 else math.inf for q in errors if q.true > 0), default=0.0),
            float(np.median(ratios)) if ratios else math.nan,
            len(misses) - announced,
            announced,
        )

    @property
    def faults(self) -> list[str]:
        """What is not as it should be, in words."""
        found = []
        if self.covered < COVERED * self.judged:
            found.append(f"{self.label}: {self.covered} of {self.judged} estimates are no smaller than the true error")
        if self.far_off:
            found.append(f"{self.label}: {self.far_off} true errors are more than ten times the estimate")
        if self.median >= OVERESTIMATE:
            found.append(f"{self.label}: estimates are {self.median:.0f} times the true error in the median")
        if self.missed:
            found.append(f"{self.label}: {self.missed} results miss the tolerance and do not tell")
        return found


@dataclass
class Honesty:
    """Outcomes so far, and the files written of them."""

    directory: Path
    asked: int
    outcomes: list[Outcome] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)

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
        if len(self.outcomes) < self.asked:
            found.append(f"{len(self.outcomes)} of {self.asked} cases were computed")
        return found


def honesty(study: Honesty, seed: int = 0, say: Callable[[str], None] = lambda words: None, first: int = 0) -> None:
    """Measure the cases that `study` asks for of the draw `seed`, from case `first` on, into its directory.

    honesty.csv, .png and .svg are each replaced atomically, and written also where KeyboardInterrupt ends the study.
    """
    study.directory.mkdir(parents=True, exist_ok=True)
    cases = study.asked
    try:
        for index in range(first, first + cases):
            case = draw(seed, index)
            words = f"N = {case.sites}, g = {case.g:.2g}, tolerance {case.tolerance:.0e}, {case.transcription}"
            say(f"case {index - first + 1} of {cases}: {words}")
            study.outcomes.append(measure(case))
            if len(study.outcomes) % KEEP_EVERY == 0:
                _write_table(study)
    finally:
        if study.outcomes:
            _write_table(study)
            _write_figure(study)


# What is written ----------------------------------------------------------------------------------------------------


def columns() -> list[str]:
    """Columns of honesty.csv: the draw, what came out, and four of each quantity."""
    of_quantities = [
        f"{name}_{what}" for name in QUANTITIES for what in ("true", "estimate", "relative_true", "verdict")
    ]
    came_out = ["points", "at_S", "Omega", "at_round_off", "stable", "reference_stable"]
    return [*(f.name for f in fields(Case)), *came_out, *of_quantities, "reason"]


def row(outcome: Outcome) -> dict[str, Cell]:
    """One row of honesty.csv; what is not known is empty."""
    values: dict[str, object] = {
        **asdict(outcome.case),
        "points": outcome.points,
        "at_S": outcome.S,
        "Omega": outcome.Omega,
        "at_round_off": int(outcome.at_round_off),
        "stable": outcome.stable,
        "reference_stable": outcome.reference_stable,
        "reason": outcome.reason,
    }
    for name in QUANTITIES:
        quantity = outcome.quantity(name)
        if quantity is not None:
            values[f"{name}_true"], values[f"{name}_estimate"] = quantity.true, quantity.estimate
            values[f"{name}_relative_true"], values[f"{name}_verdict"] = quantity.relative, verdict(quantity)
    return {name: _cell(values.get(name)) for name in columns()}


def verdict(quantity: Quantity) -> str:
    """What is to say of one estimate, in a word or two."""
    words = "far off" if quantity.far_off else "covered" if quantity.covered else "low"
    if not quantity.misses_tolerance:
        return words
    announced = quantity.announced and quantity.name == "multipliers"
    return f"{words}, tolerance missed{' as told' if announced else ''}"


def _cell(value: object) -> Cell:
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    if isinstance(value, bool):
        return int(value)
    return value if isinstance(value, int) or (isinstance(value, float) and math.isfinite(value)) else str(value)


def _write_table(study: Honesty) -> None:
    path = study.directory / "honesty.csv"
    write_csv(path, columns(), [row(outcome) for outcome in study.outcomes])
    if path not in study.files:
        study.files.append(path)


def _write_figure(study: Honesty) -> None:
    from casadi_skin.figures import save
    from casadi_skin.studies.calibration.figure import honesty_figure

    study.files += save(honesty_figure(study.outcomes), study.directory / "honesty")


def honesty_table(study: Honesty) -> Table:
    """The counts, by quantity and by method."""
    from rich.table import Table

    table = Table(box=None, header_style="bold", padding=(0, 1))
    table.add_column("errors of", no_wrap=True)
    heads = ("covered", "", "largest\ntrue/est.", "median\nest./true", "true >\n10 est.", "missed", "told")
    for head in heads:
        table.add_column(head, justify="right", no_wrap=True)
    tallies = study.tallies
    for i, tally in enumerate((*tallies, *study.method_tallies())):
        if i in (1, len(tallies)):
            table.add_row()
        share = f"{100.0 * tally.covered / tally.judged:.1f}%" if tally.judged else ""
        median = "" if math.isnan(tally.median) else f"{tally.median:.3g}"
        counts = (str(n) for n in (tally.far_off, tally.missed, tally.announced))
        table.add_row(tally.label, f"{tally.covered}/{tally.judged}", share, f"{tally.worst:.2g}", median, *counts)
    return table
