"""Speed for accuracy, measured: what each method and setting costs, and how wrong it truly is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from casadi_skin.files import replacing
from casadi_skin.lattice.chain import Chain
from casadi_skin.results.tables import write_csv
from casadi_skin.studies.work_precision.cases import measure
from casadi_skin.studies.work_precision.measured import (
    COLUMNS,
    QUICK_TOLERANCES,
    TOLERANCES,
    Kind,
    Measured,
    Setting,
    flow_settings,
    orbit_settings,
    preset_settings,
)
from casadi_skin.studies.work_precision.memory import memory_of
from casadi_skin.studies.work_precision.reference import REFERENCE_COLUMNS, Reference
from casadi_skin.studies.work_precision.words import advices, preset_words, promised, recommendations

REPEATS = 5
DEFAULT_AT = (0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0)  # no value next to a change of stability, where mu meet
PARTS_OF_FAMILY = 5  # where a scene asks for no points


def default_request() -> FamilyRequest:
    """The softening end breather of the paper: j = 1, g = -1, N = 24, to S = 1."""
    return FamilyRequest(Chain(24, 1.0, 0.25, -1.0), 1, 1.0, DEFAULT_AT)


def with_points(request: FamilyRequest) -> FamilyRequest:
    """The request with its own points, or with equal parts of the family where it asks for none."""
    if request.at:
        return request
    end = request.amplitude_max
    at = (*(end * k / PARTS_OF_FAMILY for k in range(1, PARTS_OF_FAMILY)), end)
    return FamilyRequest(request.chain, request.mode, end, at)


@dataclass
class Tradeoff:
    """The study of one family into a directory: measurements and files so far, in order."""

    request: FamilyRequest
    directory: Path
    quick: bool = False
    repeats: int = REPEATS
    say: Callable[[str], None] = lambda words: None
    reference: Reference | None = None
    baseline: float = float("nan")
    measured: list[Measured] = field(default_factory=list)
    files: list[Path] = field(default_factory=list)

    @property
    def settings(self) -> list[Setting]:
        """What is measured, in order; the presets first."""
        tolerances = QUICK_TOLERANCES if self.quick else TOLERANCES
        settings = [*preset_settings(self.request), *orbit_settings(self.request, tolerances)]
        moving = self.request.chain.sites if abs(self.request.chain.gamma) < 1.0 else 1
        return settings + (flow_settings(self.request, tolerances) if moving > 1 else [])

    def execute(self) -> None:
        """Measure every setting, each a row of a table as it ends, and write what follows, also when interrupted.

        Raises ArithmeticError where there is no reference.
        """
        self.directory.mkdir(parents=True, exist_ok=True)
        self.say("reference")
        self.reference = Reference(self.request)
        self._table("reference", REFERENCE_COLUMNS, self.reference.rows())
        self.baseline = memory_of(None)
        settings = self.settings
        self._warm_up(settings)
        tightest = min(s.tolerance for s in settings if s.kind is not Kind.PRESET)
        try:
            for number, setting in enumerate(settings, start=1):
                self.say(f"{setting.method}, tolerance {setting.tolerance:.0e} ({number} of {len(settings)})")
                with_memory = not self.quick or setting.kind is Kind.PRESET or setting.tolerance == tightest
                self.measured.append(measure(setting, self.reference, self.repeats, with_memory))
                self._write_rows()
        finally:
            self._finish()

    def advice(self) -> list[str]:
        """What to use for which quantity and error, and where the presets sit, in lines."""
        presets = [preset_words(m, self.measured) for m in self.measured if m.setting.kind is Kind.PRESET]
        return [*advices(self.measured, promised(self.measured)), *presets]

    def _warm_up(self, settings: Sequence[Setting]) -> None:
        """Each method once, not counted: what is loaded when first used is no part of any setting's time."""
        assert self.reference is not None
        self.say("warming up")
        for setting in {s.method: s for s in reversed(settings)}.values():
            measure(setting, self.reference, 0, with_memory=False)

    def _write_rows(self) -> None:
        for stem, is_flow in (("tradeoff", False), ("flows", True)):
            rows = [m.row() for m in self.measured if (m.setting.kind is Kind.FLOW) == is_flow]
            if rows:
                self._table(stem, COLUMNS, rows)

    def _table(self, stem: str, columns: tuple[str, ...], rows: list[dict[str, float | int | str]]) -> None:
        path = self.directory / f"{stem}.csv"
        write_csv(path, columns, rows)
        if path not in self.files:
            self.files.append(path)

    def _finish(self) -> None:
        """The recommendations and the picture of what was measured."""
        from casadi_skin.figures import save
        from casadi_skin.studies.work_precision.figure import tradeoff_figure

        if not any(m.seconds == m.seconds for m in self.measured) or self.reference is None:
            return
        self.say("writing the recommendations and the picture")
        path, known = self.directory / "recommendations.md", self.reference.agreement
        words = recommendations(self.request, self.measured, known, self.baseline, self.repeats)
        with replacing(path) as temporary:
            temporary.write_text(words, encoding="utf-8")
        self.files.append(path)
        figure = tradeoff_figure(self.request, self.measured, known)
        self.files += save(figure, self.directory / "tradeoff")
