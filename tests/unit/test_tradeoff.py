"""The work-precision study: its advice, rows and pictures on data made by hand, and its reference."""

from __future__ import annotations

from dataclasses import replace
from math import isnan, nan
from pathlib import Path

import numpy as np
import pytest
from outputs import read_rows

from casadi_skin import Chain
from casadi_skin.follow.family import Family
from casadi_skin.runs.tradeoff import (
    COLUMNS,
    MEASURED_TOLERANCES,
    QUICK_TOLERANCES,
    Errors,
    Kind,
    Measured,
    Reference,
    Setting,
    WorkPrecision,
    advice,
    advices,
    broken_promises,
    followed,
    front_of,
    front_words,
    measure,
    memory_of,
    multipliers_of,
    paired,
    peak_memory,
    preset_words,
    recommendations,
    settings_of,
    timed,
    work_precision_figure,
)
from casadi_skin.zero.family import family_request

FAMILY = family_request(Chain(2, 1.0, 0.25, -1.0), 1, 0.4, at=(0.2, 0.4))
LONG = family_request(Chain(24, 1.0, 0.25, -1.0), 1, 1.0, at=(1.0,))
KNOWN = Errors(1e-15, 2e-15, 3e-15)


def orbits(transcription: str, walker: str, tolerance: float, seconds: float, error: float) -> Measured:
    setting = Setting(Kind.ORBITS, tolerance, transcription, walker, "newton")
    times = (seconds, 0.95 * seconds, 1.05 * seconds, 0.1)
    return Measured(setting, *times, 50.0, 10, 40, Errors(error, error, error), 1.0)


def flow(name: str, tolerance: float, seconds: float, error: float) -> Measured:
    setting = Setting(Kind.FLOW, tolerance, "trigonometric", "series", flow=name)
    return Measured(setting, seconds, 0.9 * seconds, 1.1 * seconds, 0.1, 50.0, 16, 2, Errors(nan, nan, error), 1.0)


def preset(seconds: float, error: float) -> Measured:
    setting = Setting(Kind.PRESET, 1e-8, "trigonometric", "arclength", name="standard")
    return Measured(setting, seconds, seconds, seconds, 0.0, 60.0, 10, 40, Errors(error, error, error), 1.0)


def made() -> list[Measured]:
    """Series beats arclength beats gauss; the splitting beats cvodes, which does not keep its tightest tolerance."""
    return [
        preset(0.2, 2e-9),
        *(orbits("trigonometric", "series", t, s, e) for t, s, e in ((1e-4, 0.010, 1e-6), (1e-8, 0.014, 1e-9))),
        orbits("trigonometric", "arclength", 1e-8, 0.045, 1e-9),
        *(orbits("gauss", "arclength", t, s, e) for t, s, e in ((1e-4, 0.2, 1e-5), (1e-8, 0.5, 1e-12))),
        *(flow("splitting", t, s, e) for t, s, e in ((1e-4, 0.001, 1e-6), (1e-8, 0.002, 1e-10))),
        *(flow("cvodes", t, s, e) for t, s, e in ((1e-4, 0.010, 1e-5), (1e-8, 0.020, 4e-8))),
    ]


FAILED = Measured(Setting(Kind.ORBITS, 1e-12, "gauss", "arclength"), failure="no step, however short")


# The front ----------------------------------------------------------------------------------------------------------


def test_errors_nearly_the_same_or_below_the_reference_do_not_join_the_front() -> None:
    near = [orbits("gauss", "arclength", 1e-12, s, e) for s, e in ((2.0, 0.9e-6), (1.0, 1e-6), (nan, 0.0), (3.0, 1e-8))]
    assert [m.seconds for m in front_of(near, Kind.ORBITS, Errors(nan, nan))] == [1.0, 3.0]
    measured = [orbits("gauss", "arclength", 1e-12, s, e) for s, e in ((1.0, 1e-14), (2.0, 1e-16), (3.0, 1e-17))]
    assert [m.seconds for m in front_of(measured, Kind.ORBITS, Errors(1e-13, 1e-13))] == [1.0]
    assert len(front_of(measured, Kind.ORBITS, Errors(nan, nan))) == 3


@pytest.mark.parametrize("seed", range(5))
def test_the_front_is_what_no_other_setting_beats(seed: int) -> None:
    points = {(s, 10.0**-e) for s, e in np.random.default_rng(seed).integers(1, 9, (30, 2)).tolist()}
    front = front_of([orbits("gauss", "arclength", 1e-8, *point) for point in points], Kind.ORBITS, Errors(nan, nan))
    beaten = {p for p in points if any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)}
    assert [(m.seconds, m.error) for m in front] == sorted(points - beaten)


# Words --------------------------------------------------------------------------------------------------------------


def test_advice_names_method_time_and_lead() -> None:
    words = advice(made(), 1e-8, Kind.ORBITS)
    assert words.startswith("trigonometric, series, newton at tolerance 1e-08, 14 ms")
    assert "3.2 times faster than the next, trigonometric, arclength, newton (45 ms)" in words
    assert advice(made(), 1e-8, Kind.FLOW) == "splitting at tolerance 1e-08, 2 ms; no other method reaches it"
    assert advice(made(), 1e-13, Kind.FLOW) == "no setting measured here promises and keeps it"


def test_equal_advice_is_given_once() -> None:
    lines = advices([*made(), orbits("gauss", "arclength", 1e-5, 1.0, 1e-7)])
    assert len([line for line in lines if line.startswith("For Omega and the profile to")]) == 2
    assert any(line.startswith("For Omega and the profile to 1e-05 and down to 1e-08: ") for line in lines)
    assert not any("mu" in line for line in advices([m for m in made() if m.setting.kind is not Kind.FLOW]))


def test_presets_fronts_and_broken_promises_in_words() -> None:
    words = preset_words(preset(0.2, 2e-9))
    assert words.startswith("`standard` (1e-08): 200 ms with multipliers and 40 points; true errors Omega 2.0e-09")
    assert words.endswith("the tolerance is kept.")
    assert "missed by a factor 5" in preset_words(preset(0.2, 5e-8))
    failed = Measured(preset(0.2, nan).setting, failure="the family ended")
    assert preset_words(failed) == "`standard` (1e-08): the family ended."

    words = front_words(made(), Kind.ORBITS, KNOWN)
    assert words.startswith("The Pareto front of orbits, 3 of 5 settings: ")
    assert "trigonometric, series, newton from 1.0e-06 in 10 ms to 1.0e-09 in 14 ms; gauss" in words
    assert front_words([], Kind.FLOW, KNOWN) == ""

    (line,) = broken_promises(made())
    assert line == "cvodes, tolerance 1e-08: true error 4.0e-08, 4 times that; the program does not say so."
    assert broken_promises([replace(m, told=True) for m in made()])[0].endswith("; the program says so.")
    assert broken_promises([replace(m, at_reference_round_off=True) for m in made()]) == []
    assert broken_promises([FAILED]) == ["gauss, arclength, ipopt, tolerance 1e-12: no result: no step, however short."]


def test_recommendations_hold_all_sections_and_a_table() -> None:
    text = recommendations(FAMILY, made(), KNOWN, 45.0, 5)
    for words in ("What to use", "Where the presets sit", "Pareto fronts", "Not kept", "Measured"):
        assert f"## {words}\n" in text
    assert "agrees with these to 1.0e-15 of Omega and 2.0e-15 of the profile, and their mu to 3.0e-15" in text
    assert "Shooting is left out" not in text
    assert "Shooting is left out: 24 positions move" in recommendations(LONG, made(), KNOWN, 45.0, 5)
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    assert len(rows) == 2 + len(made())
    assert {row.count("|") for row in rows} == {10}
    assert "10 ms (9.5 ms to 10.5 ms) | 100 ms | 50 MB | 10 | 1.0e-06 | 1.0e-06 | 1.0e-06 |" in text


# Settings, rows, measuring ------------------------------------------------------------------------------------------


def test_settings_are_every_method_at_every_tolerance() -> None:
    def of_kind(kind: Kind, family: object = FAMILY, tolerances: tuple[float, ...] = (1e-4,)) -> list[Setting]:
        return [s for s in settings_of(family, tolerances) if s.kind is kind]  # type: ignore[arg-type]

    methods = [s.method for s in of_kind(Kind.ORBITS)]
    assert len(methods) == len(set(methods)) == 10
    assert "shooting, arclength, newton" in methods
    longer = of_kind(Kind.ORBITS, LONG, MEASURED_TOLERANCES)
    assert len(longer) == 8 * len(MEASURED_TOLERANCES)
    assert not any("shooting" in s.method for s in longer)
    assert len({s.method for s in of_kind(Kind.FLOW, tolerances=QUICK_TOLERANCES)}) > 1
    presets = of_kind(Kind.PRESET)
    assert [(s.name, s.tolerance) for s in presets] == [("draft", 1e-4), ("standard", 1e-8), ("reference", 1e-12)]
    assert {(s.transcription, s.walker, s.corrector) for s in presets} == {("trigonometric", "series", "ipopt")}
    lonely = family_request(Chain(1, 1.0, 0.0, -1.0), 1, 0.4, at=(0.2,))
    assert not of_kind(Kind.FLOW, lonely)


def test_rows_are_cells_of_a_table(tmp_path: Path) -> None:
    study = WorkPrecision(tmp_path, FAMILY)
    study.write_table("rows", COLUMNS, (m.row() for m in (*made(), FAILED)))
    rows = read_rows(tmp_path / "rows.csv")
    assert [row["kind"] for row in rows] == ["preset", *["orbits"] * 5, *["flow"] * 4, "orbits"]
    assert rows[0]["method"] == "standard"
    assert float(rows[1]["seconds_min"]) < float(rows[1]["seconds"]) == 0.010 < float(rows[1]["seconds_max"])
    assert rows[6]["transcription"] == rows[6]["Omega_error"] == rows[1]["flow"] == ""
    assert rows[-1]["failure"] == FAILED.failure
    assert rows[-1]["seconds"] == rows[-1]["memory_MB"] == ""


def test_times_of_repeated_runs() -> None:
    calls: list[int] = []
    result, times = timed(lambda: calls.append(sum(range(10_000))) or len(calls), 3)
    assert result == len(calls) > 3  # a run this short is many, timed together
    assert 0 < times["seconds_min"] <= times["seconds"] <= times["seconds_max"]
    assert times["building_seconds"] >= 0
    assert 0 < times["processor_share"] < 1.5
    assert timed(int, 0) == (0, {})


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
        assert exact.Omega_error(orbit.Omega) <= max(reference.agreement.Omega, 4e-16) * orbit.Omega
        assert exact.profile_error(orbit) < 1e-13
        np.testing.assert_allclose(paired(exact_mu(exact)[0], mu), mu, atol=reference.agreement.mu)
    space = Family(Setting(Kind.ORBITS, 1e-6, "trigonometric", "series", "newton").of(FAMILY))
    _, found = followed(space)
    mu = multipliers_of(space, found)
    assert 1e-13 < max(reference.errors_of(found, mu)) < 1e-6
    with pytest.raises(ArithmeticError, match="1 points"):
        reference.errors_of(found[:1], mu[:1])


@pytest.mark.slow
@pytest.mark.usefixtures("harmonics")
def test_a_setting_is_measured_and_a_failure_is_a_line(reference: Reference) -> None:
    quick = measure(FAMILY, Setting(Kind.ORBITS, 1e-4, "gauss", "arclength"), reference, 1)
    assert 0 < quick.seconds_min <= quick.seconds <= quick.seconds_max
    assert 0 < quick.error < 1e-4
    assert 0 < quick.errors.mu < 1e-3
    soft = family_request(Chain(1, 1.0, 0.0, -1.0), 1, 5.0, at=(1.0,))  # beyond S = 3 there is no orbit
    failed = measure(soft, Setting(Kind.ORBITS, 1e-4, "gauss", "arclength", "newton"), reference, 1)
    assert failed.failure
    assert "\n" not in failed.failure
    assert isnan(failed.seconds)


@pytest.mark.slow
def test_memory_is_that_of_another_process() -> None:
    held = np.ones(30_000_000)
    assert held.nbytes / 1e6 < peak_memory()
    started, followed = memory_of(None), memory_of(FAMILY)
    assert 10 < started <= followed < peak_memory()


def test_the_picture_shows_methods_presets_and_fronts() -> None:
    figure = work_precision_figure(FAMILY, [*made(), FAILED], KNOWN)
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"Pareto front", "preset, orbits and multipliers", "at the reference's round-off"} <= labels
    assert {"trigonometric, series, newton", "gauss, arclength, newton", "flow: splitting", "flow: cvodes"} <= labels
    assert [text.get_text() for axes in figure.axes for text in axes.texts] == ["standard", "standard"]
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()
    lonely = work_precision_figure(FAMILY, [m for m in made() if m.setting.kind is Kind.ORBITS], KNOWN._replace(mu=nan))
    assert [text.get_text() for text in lonely.axes[1].texts] == ["no multipliers measured"]
