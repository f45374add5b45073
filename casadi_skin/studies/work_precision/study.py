"""The work-precision study: the cost of each method and setting, and its true errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from casadi_skin.lattice.chain import Chain
from casadi_skin.studies.study import Study
from casadi_skin.studies.work_precision.measuring import measure, memory_of
from casadi_skin.studies.work_precision.reference import REFERENCE_COLUMNS, Reference
from casadi_skin.studies.work_precision.settings import (
    COLUMNS,
    QUICK_TOLERANCES,
    TOLERANCES,
    FamilyCase,
    Kind,
    Measured,
    Setting,
    flow_settings,
    orbit_settings,
    preset_settings,
)
from casadi_skin.studies.work_precision.words import advices, preset_words, promised, recommendations

REPEATS = 5
DEFAULT_AT = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)  # no value next to a change of stability, where mu meet
DEFAULT_FAMILY = FamilyCase(Chain(24, 1.0, 0.25, -1.0), 1, 1.0, DEFAULT_AT)  # the softening end breather of the paper


@dataclass
class WorkPrecision(Study):
    """The study of one family: tradeoff.csv, flows.csv, reference.csv, recommendations.md and a picture."""

    family: FamilyCase
    quick: bool = False
    repeats: int = REPEATS
    measured: list[Measured] = field(default_factory=list)
    baseline: float = float("nan")  # memory of a process that computes nothing

    part = "settings"

    def settings(self) -> list[Setting]:
        """The settings that are measured, in order; the presets first."""
        tolerances, family = QUICK_TOLERANCES if self.quick else TOLERANCES, self.family
        presets = preset_settings(family, str(family.request().method.walker))
        return [*presets, *orbit_settings(family, tolerances), *flow_settings(family, tolerances)]

    def run(self) -> None:
        self.say("reference")
        reference = Reference(self.family)
        self.write_table("reference", REFERENCE_COLUMNS, reference.rows())
        self.baseline = memory_of(None)
        settings = self.settings()
        self._warm_up(settings, reference)
        tightest = min(s.tolerance for s in settings if s.kind is not Kind.PRESET)

        def work(setting: Setting) -> None:
            with_memory = not self.quick or setting.kind is Kind.PRESET or setting.tolerance == tightest
            self.measured.append(measure(setting, reference, self.repeats, with_memory))
            self._write_rows()

        try:
            self.work_through(settings, lambda setting: f"{setting.method}, tolerance {setting.tolerance:.0e}", work)
        finally:
            self._finish(reference)

    def _warm_up(self, settings: Sequence[Setting], reference: Reference) -> None:
        """Measure each method once, without a count: the loading at a first use is no part of any setting's time."""
        self.say("warming up")
        for setting in {s.method: s for s in reversed(settings)}.values():
            measure(setting, reference, 0, with_memory=False)

    def _write_rows(self) -> None:
        for stem, is_flow in (("tradeoff", False), ("flows", True)):
            rows = [m.row() for m in self.measured if (m.setting.kind is Kind.FLOW) == is_flow]
            if rows:
                self.write_table(stem, COLUMNS, rows)

    def _finish(self, reference: Reference) -> None:
        """Write the recommendations and the picture."""
        from casadi_skin.studies.work_precision.figure import work_precision_figure

        if any(m.seconds == m.seconds for m in self.measured):
            family, measured, known = self.family, self.measured, reference.agreement
            text = recommendations(family, measured, known, self.baseline, self.repeats)
            self.write_text("recommendations.md", text)
            self.write_figure("tradeoff", work_precision_figure(family, measured, known))

    def report(self) -> Iterator[str]:
        yield from advices(self.measured, promised(self.measured))
        yield from (preset_words(m, self.measured) for m in self.measured if m.setting.kind is Kind.PRESET)
