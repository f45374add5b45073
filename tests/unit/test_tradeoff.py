"""The work-precision study: its advice, rows and pictures on data made by hand, and its reference."""

from __future__ import annotations

from dataclasses import replace
from math import isnan, nan
from typing import Any

import numpy as np
import pytest

from casadi_skin import Chain
from casadi_skin.follow.family import Family
from casadi_skin.runs import tradeoff
from casadi_skin.runs.tradeoff import (
    FLOW,
    ORBITS,
    PRESET,
    Reference,
    Setting,
    advice,
    followed,
    front_of,
    largest,
    measure,
    multipliers_of,
    of_kind,
    paired,
    recommendations,
    work_precision_figure,
)
from casadi_skin.zero.family import family_request

FAMILY = family_request(Chain(2, 1.0, 0.25, -1.0), 1, 0.4, at=(0.2, 0.4))
LONG = family_request(Chain(24, 1.0, 0.25, -1.0), 1, 1.0, at=(1.0,))
KNOWN = np.array([1e-15, 2e-15, 3e-15])
NONE = np.full(3, nan)


def setting(transcription: str, walker: str, tolerance: float, corrector: str = "newton") -> Setting:
    method = f"{transcription}, {walker}, {corrector}"
    return Setting(ORBITS, method, transcription, walker, corrector, "", tolerance)


def measured(of: Setting, seconds: float, error: float, spread: float = 0.05, **more: Any) -> Setting:
    """A setting with its times, memory, sizes and errors, those of orbits for flows left out."""
    times = (seconds, (1 - spread) * seconds, (1 + spread) * seconds, 0.1)
    orbits = nan if of.kind == FLOW else error
    names = "seconds", "seconds_min", "seconds_max", "building_seconds", "Omega_error", "profile_error", "mu_error"
    known: dict[str, Any] = dict(zip(names, (*times, orbits, orbits, error), strict=True))
    return replace(of, **{"memory_MB": 50.0, "unknowns": 10, "points": 40, "processor_share": 1.0, **known, **more})


def orbits(transcription: str, walker: str, tolerance: float, seconds: float, error: float) -> Setting:
    return measured(setting(transcription, walker, tolerance), seconds, error)


def flow(name: str, tolerance: float, seconds: float, error: float) -> Setting:
    return measured(Setting(FLOW, name, "", "", "", name, tolerance), seconds, error, 0.1)


def preset(error: float, **more: Any) -> Setting:
    of = Setting(PRESET, "standard", "trigonometric", "arclength", "ipopt", "splitting", 1e-8)
    return measured(of, 0.2, error, 0.0, **more)


def made() -> list[Setting]:
    """Series beats arclength beats gauss; the splitting beats cvodes, which does not keep its tightest tolerance."""
    return [
        preset(2e-9),
        *(orbits("trigonometric", "series", t, s, e) for t, s, e in ((1e-4, 0.010, 1e-6), (1e-8, 0.014, 1e-9))),
        orbits("trigonometric", "arclength", 1e-8, 0.045, 1e-9),
        *(orbits("gauss", "arclength", t, s, e) for t, s, e in ((1e-4, 0.2, 1e-5), (1e-8, 0.5, 1e-12))),
        *(flow("splitting", t, s, e) for t, s, e in ((1e-4, 0.001, 1e-6), (1e-8, 0.002, 1e-10))),
        *(flow("cvodes", t, s, e) for t, s, e in ((1e-4, 0.010, 1e-5), (1e-8, 0.020, 4e-8))),
    ]


FAILED = replace(setting("gauss", "arclength", 1e-12, "ipopt"), failure="no step, however short")


def test_errors_nearly_the_same_or_below_the_reference_do_not_join_the_front() -> None:
    near = [orbits("gauss", "arclength", 1e-12, s, e) for s, e in ((2.0, 0.9e-6), (1.0, 1e-6), (nan, 0.0), (3.0, 1e-8))]
    assert [m.seconds for m in front_of(near, ORBITS, NONE)] == [1.0, 3.0]
    below = [orbits("gauss", "arclength", 1e-12, s, e) for s, e in ((1.0, 1e-14), (2.0, 1e-16), (3.0, 1e-17))]
    assert [m.seconds for m in front_of(below, ORBITS, np.full(3, 1e-13))] == [1.0]
    assert len(front_of(below, ORBITS, NONE)) == 3


@pytest.mark.parametrize("seed", range(5))
def test_the_front_is_what_no_other_setting_beats(seed: int) -> None:
    points = {(s, 10.0**-e) for s, e in np.random.default_rng(seed).integers(1, 9, (30, 2)).tolist()}
    front = front_of([orbits("gauss", "arclength", 1e-8, *point) for point in points], ORBITS, NONE)
    beaten = {p for p in points if any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)}
    assert [(m.seconds, m.error) for m in front] == sorted(points - beaten)


def test_a_page_advises_and_tells_what_was_not_kept() -> None:
    of_flows, settings = of_kind(made(), FLOW), [*made(), orbits("gauss", "arclength", 1e-5, 1.0, 1e-7), FAILED]
    assert advice(of_flows, 1e-8) == "splitting at tolerance 1e-08, 2 ms; no other method reaches it"
    assert advice(of_flows, 1e-13) == "no setting measured here promises and keeps it"
    text = recommendations(FAMILY, settings, KNOWN, 45.0, 5)
    assert "agrees with these to 1.0e-15 of Omega and 2.0e-15 of the profile, and their mu to 3.0e-15" in text
    series, arclength = ("trigonometric, series, newton", "trigonometric, arclength, newton")
    for line in (
        f"- For Omega and the profile to 1e-05 and down to 1e-08: {series} at tolerance 1e-08, 14 ms; 3.2 times faster "
        f"than the next, {arclength} (45 ms).",
        "- `standard` (1e-08): 200 ms with multipliers and 40 points; true errors Omega 2.0e-09, profile 2.0e-09, mu "
        "2.0e-09; the tolerance is kept.",
        f"- The Pareto front of orbits, 3 of 7 settings: {series} from 1.0e-06 in 10 ms to 1.0e-09 in 14 ms; gauss, "
        "arclength, newton at 1.0e-12 in 500 ms.",
        "- cvodes, tolerance 1e-08: true error 4.0e-08, 4 times that; the program does not say so.",
        "- gauss, arclength, ipopt, tolerance 1e-12: no result: no step, however short.",
        f"| {series} | 1e-04 | 10 ms (9.5 ms to 10.5 ms) | 100 ms | 50 MB | 10 | 1.0e-06 | 1.0e-06 | 1.0e-06 |",
    ):
        assert line in text.splitlines()
    assert text.count("- For Omega and the profile to") == 3
    headings = [line[3:] for line in text.splitlines() if line.startswith("## ")]
    assert headings == ["What to use", "Where the presets sit", "Pareto fronts", "Not kept", "Measured"]
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert len(rows) == 2 + len(made())
    assert {row.count("|") for row in rows} == {10}


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ([preset(5e-8)], "the tolerance is missed by a factor 5."),
        ([preset(nan, failure="the family ended")], "- `standard` (1e-08): the family ended."),
        ([replace(m, told=True) for m in made()], "4 times that; the program says so."),
        ([replace(m, processor_share=0.5) for m in made()], "a processor for 50% of the time that passed."),
    ],
)
def test_a_page_says_what_is_not_as_it_should_be(more: list[Setting], words: str) -> None:
    assert words in recommendations(FAMILY, more, KNOWN, 45.0, 5)
    assert words not in recommendations(
        FAMILY, [replace(m, at_reference_round_off=True) for m in made()], KNOWN, 45.0, 5
    )
    assert "Shooting is left out: 24 positions move" in recommendations(LONG, more, KNOWN, 45.0, 5)


def test_settings_are_every_method_at_every_tolerance() -> None:
    methods = [s.method for s in of_kind(tradeoff.settings_of(FAMILY, (1e-4,)), ORBITS)]
    assert len(methods) == len(set(methods)) == 10
    assert "shooting, arclength, newton" in methods
    longer = of_kind(tradeoff.settings_of(LONG, tradeoff.MEASURED_TOLERANCES), ORBITS)
    assert len(longer) == 8 * len(tradeoff.MEASURED_TOLERANCES)
    assert not any("shooting" in s.method for s in longer)
    quick = tradeoff.settings_of(FAMILY, tradeoff.QUICK_TOLERANCES)
    assert len({s.method for s in of_kind(quick, FLOW)}) > 1
    presets = of_kind(quick, PRESET)
    assert [(s.method, s.tolerance) for s in presets] == [("draft", 1e-4), ("standard", 1e-8), ("reference", 1e-12)]
    assert {(s.transcription, s.walker, s.corrector) for s in presets} == {("trigonometric", "series", "ipopt")}
    lonely = family_request(Chain(1, 1.0, 0.0, -1.0), 1, 0.4, at=(0.2,))
    assert not of_kind(tradeoff.settings_of(lonely, (1e-4,)), FLOW)


@pytest.fixture(scope="module")
def reference() -> Reference:
    return Reference(FAMILY)


def test_reference_and_the_method_that_confirms_it_agree(reference: Reference) -> None:
    from tests.studies.exact import LONG_DOUBLES, exact_orbit
    from tests.studies.exact_multipliers import exact_mu

    assert max(reference.agreement) < 1e-12
    assert [row["S"] for row in reference.rows()] == [0.2, 0.4]
    for orbit, (mu, _) in zip(reference.orbits, reference.mu, strict=True):
        exact = exact_orbit(orbit, LONG_DOUBLES)
        assert exact.Omega_error(orbit.Omega) <= reference.agreement[0] * orbit.Omega
        assert exact.profile_error(orbit) < 1e-13
        np.testing.assert_allclose(paired(exact_mu(exact)[0], mu), mu, atol=reference.agreement[2])
    space = Family(setting("trigonometric", "series", 1e-6).of(FAMILY))
    _, found = followed(space)
    mu = multipliers_of(space, found)
    assert 1e-13 < largest(reference.errors_of(found, mu), PRESET) < 1e-6
    with pytest.raises(ArithmeticError, match="1 points"):
        reference.errors_of(found[:1], mu[:1])


@pytest.mark.slow
@pytest.mark.usefixtures("harmonics")
def test_a_setting_is_measured_and_a_failure_is_a_line(reference: Reference) -> None:
    quick = measure(FAMILY, setting("gauss", "arclength", 1e-4, "ipopt"), reference, 1)
    assert 0 < quick.seconds_min <= quick.seconds <= quick.seconds_max
    assert 0 < quick.error < 1e-4
    assert 0 < quick.mu_error < 1e-3
    soft = family_request(Chain(1, 1.0, 0.0, -1.0), 1, 5.0, at=(1.0,))  # beyond S = 3 there is no orbit
    failed = measure(soft, setting("gauss", "arclength", 1e-4), reference, 1)
    assert failed.failure
    assert "\n" not in failed.failure
    assert isnan(failed.seconds)


@pytest.mark.slow
def test_memory_is_that_of_another_process() -> None:
    held = np.ones(30_000_000)
    assert held.nbytes / 1e6 < tradeoff.peak_memory()
    started, followed = tradeoff.memory_of(None), tradeoff.memory_of(FAMILY)
    assert 10 < started <= followed < tradeoff.peak_memory()


def test_the_picture_shows_methods_presets_and_fronts() -> None:
    figure = work_precision_figure(FAMILY, [*made(), FAILED], KNOWN)
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"Pareto front", "preset, orbits and multipliers", "at the reference's round-off"} <= labels
    assert {"trigonometric, series, newton", "gauss, arclength, newton", "flow: splitting", "flow: cvodes"} <= labels
    assert [text.get_text() for axes in figure.axes for text in axes.texts] == ["standard", "standard"]
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()
    lonely = work_precision_figure(FAMILY, of_kind(made(), ORBITS), np.array([1e-15, 2e-15, nan]))
    assert [text.get_text() for text in lonely.axes[1].texts] == ["no multipliers measured"]


def test_a_transcription_more_has_a_mark_and_a_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    more = {**tradeoff.TRANSCRIPTIONS, "lobatto": "Lobatto IIIA", "midpoint": "another one"}
    monkeypatch.setattr(tradeoff, "TRANSCRIPTIONS", more)
    last = [replace(setting, transcription="midpoint") for setting in of_kind(made(), ORBITS)]
    assert work_precision_figure(FAMILY, last, KNOWN).axes[0].lines
