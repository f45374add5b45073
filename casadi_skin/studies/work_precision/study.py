"""The work-precision study: the cost of each method and setting, and its true errors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.methods import FLOWS, TRANSCRIPTIONS
from casadi_skin.results.figures.style import blank, colours, finished, style, title
from casadi_skin.studies.study import Study, letter
from casadi_skin.studies.work_precision.measuring import measure, memory_of
from casadi_skin.studies.work_precision.reference import REFERENCE_COLUMNS, Errors, Reference
from casadi_skin.studies.work_precision.settings import (
    COLUMNS,
    QUICK_TOLERANCES,
    TOLERANCES,
    FamilyCase,
    Kind,
    Measured,
    Setting,
    bounded,
    flow_settings,
    front_of,
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
        if any(m.seconds == m.seconds for m in self.measured):
            family, measured, known = self.family, self.measured, reference.agreement
            text = recommendations(family, measured, known, self.baseline, self.repeats)
            self.write_text("recommendations.md", text)
            self.write_figure("tradeoff", work_precision_figure(family, measured, known))

    def report(self) -> Iterator[str]:
        yield from advices(self.measured, promised(self.measured))
        yield from (preset_words(m, self.measured) for m in self.measured if m.setting.kind is Kind.PRESET)


# The picture ----------------------------------------------------------------------------------------------------------


MARKERS = "os^D"
FLOW_MARKERS = "Pv<X"
LOWEST = 1e-17


def look(measured: Measured) -> dict[str, Any]:
    """Marker, colour and line of a method: full markers are Newton's, open ones Ipopt's; series are dashed."""
    setting = measured.setting
    if setting.kind is Kind.FLOW:
        place = list(FLOWS).index(setting.flow)
        return {"marker": FLOW_MARKERS[place], "color": colours(len(FLOWS))[place], "ls": "-", "ms": 5.5}
    place = list(TRANSCRIPTIONS).index(setting.transcription)
    colour = colours(len(TRANSCRIPTIONS))[place]
    face = "white" if setting.corrector == "ipopt" else colour
    dashes: Any = (0, (4.0, 1.5)) if setting.walker == "series" else "-"
    return {"marker": MARKERS[place], "color": colour, "mfc": face, "ls": dashes, "ms": 5.0}


def _draw(axes: Axes, measured: Sequence[Measured], kind: Kind, known: float) -> None:
    """Each method a line through its tolerances, and the front behind them."""
    requested = [m for m in measured if m.setting.kind is kind and not m.failure]
    for method in dict.fromkeys(m.setting.method for m in requested):
        of_method = [m for m in requested if m.setting.method == method]
        label = f"flow: {method}" if kind is Kind.FLOW else method
        times = np.array([[m.seconds, m.seconds_min, m.seconds_max] for m in of_method]).T
        spread = np.maximum([times[0] - times[1], times[2] - times[0]], 0.0)
        errors = [m.error for m in of_method]
        axes.errorbar(
            times[0], errors, xerr=spread, label=label, lw=0.9, elinewidth=0.6, zorder=3, **look(of_method[0])
        )
    front = front_of(measured, kind, known)
    if front:
        steps = np.array([[m.seconds, m.error] for m in front])
        axes.step(*steps.T, where="post", color="0.75", lw=5.0, label="Pareto front", zorder=1, solid_capstyle="round")


def _draw_presets(axes: Axes, measured: Sequence[Measured], of_mu: bool) -> None:
    presets = [m for m in measured if m.setting.kind is Kind.PRESET and not m.failure]
    for m in presets:
        error = m.mu_error if of_mu else m.orbit_error
        if error != error:
            continue
        words = "preset, orbits and multipliers" if m is presets[0] else "_"
        star: dict[str, Any] = {"ms": 11, "mfc": "black", "mec": "white", "mew": 0.8}
        axes.plot(m.seconds, error, "*", label=words, zorder=6, **star)
        box = {"fc": "white", "ec": "none", "alpha": 0.8, "pad": 0.6}
        axes.annotate(m.setting.name, (m.seconds, error), (7, 6), textcoords="offset points", zorder=7, bbox=box)


def _finish(axes: Axes, known: float) -> None:
    """Logarithmic axes, and the errors that the references cannot distinguish from zero."""
    from matplotlib.ticker import LogLocator

    axes.set(xscale="log", yscale="log")
    axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))  # labels of more in a decade overlap
    low, high = axes.get_ylim()
    if known == known and known > 0:
        label = "at the reference's round-off"
        axes.axhspan(LOWEST, known, fc="0.93", ec="0.6", lw=0.6, hatch="....", label=label, zorder=0)
        low = min(low, known / 10.0)
    axes.set_ylim(max(low, LOWEST), high * 2.0)


def work_precision_figure(family: FamilyCase, measured: Sequence[Measured], known: Errors) -> Figure:
    """True error against time: orbits at the left, multipliers at the right.

    Errors up to those in `known`, by which the references differ, lie in a hatched band.
    Bars run from the least to the most time of the repeated runs.
    """
    known_orbits = bounded(Kind.ORBITS, *known)
    with style():
        figure = blank(10.6, 6.0)
        orbits, multipliers = figure.subplots(1, 2)
        _draw(orbits, measured, Kind.ORBITS, known_orbits)
        _draw_presets(orbits, measured, of_mu=False)
        _draw(multipliers, measured, Kind.FLOW, known.mu)
        _draw_presets(multipliers, measured, of_mu=True)
        _finish(orbits, known_orbits)
        _finish(multipliers, known.mu)
        limits = [f(*(axes.get_ylim()[k] for axes in (orbits, multipliers))) for k, f in enumerate((min, max))]
        for axes in (orbits, multipliers):
            axes.set_ylim(*limits)
        orbits.set(xlabel="processor time for the family without multipliers (s)")
        orbits.set_ylabel(r"relative error of $\Omega$ or of the profile, the larger")
        multipliers.set(xlabel=f"processor time for the multipliers of {len(family.at)} orbits (s)")
        multipliers.set_ylabel(r"error of $\mu$ relative to $\max(1, |\mu|)$")
        letter(orbits, "a", "orbits: transcription, walker, corrector")
        letter(multipliers, "b", "multipliers: flow map")
        if not any(m.setting.kind is Kind.FLOW for m in measured):
            words = "no multipliers measured"
            multipliers.text(0.5, 0.5, words, ha="center", va="center", transform=multipliers.transAxes)
        figure.suptitle(rf"$j = {family.mode}$ to $S = {family.amplitude_max:g}$, {title(family.chain)}")
        return finished(figure, (orbits, multipliers), 4)
