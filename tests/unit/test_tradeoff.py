"""The trade-off study on data made by hand: the Pareto front, recommendations, rows, pictures; and its reference."""

from __future__ import annotations

import csv
from dataclasses import replace
from math import isnan, nan
from pathlib import Path

import numpy as np
import pytest

from casadi_skin import Chain
from casadi_skin.results.dataset import write_csv
from casadi_skin.studies.exact_multipliers import paired
from casadi_skin.studies.study import cell
from casadi_skin.studies.work_precision.computing import Computation, requested_orbits
from casadi_skin.studies.work_precision.measuring import measure, memory_of, peak_memory, timed
from casadi_skin.studies.work_precision.reference import Errors, Reference
from casadi_skin.studies.work_precision.settings import (
    COLUMNS,
    PARTS_OF_FAMILY,
    QUICK_TOLERANCES,
    TOLERANCES,
    FamilyCase,
    Kind,
    Measured,
    Setting,
    flow_settings,
    front_of,
    orbit_settings,
    pareto_front,
    preset_settings,
)
from casadi_skin.studies.work_precision.study import DEFAULT_FAMILY, WorkPrecision, work_precision_figure
from casadi_skin.studies.work_precision.words import (
    MU,
    OMEGA,
    advice,
    advices,
    broken_promises,
    busy,
    by_transcription,
    front_words,
    preset_words,
    recommendations,
    table,
)

FAMILY = FamilyCase(Chain(2, 1.0, 0.25, -1.0), 1, 0.4, (0.2, 0.4))
KNOWN = Errors(1e-15, 2e-15, 3e-15)


def orbits(transcription: str, walker: str, tolerance: float, seconds: float, error: float) -> Measured:
    setting = Setting(Kind.ORBITS, FAMILY, tolerance, transcription, walker, "newton")
    times = (seconds, 0.95 * seconds, 1.05 * seconds, 0.1)
    return Measured(setting, *times, 50.0, 10, 40, error, error, error, 1.0)


def flow(name: str, tolerance: float, seconds: float, error: float) -> Measured:
    setting = Setting(Kind.FLOW, FAMILY, tolerance, flow=name)
    return Measured(setting, seconds, 0.9 * seconds, 1.1 * seconds, 0.1, 50.0, 16, 2, nan, nan, error, 1.0)


def preset(seconds: float, error: float) -> Measured:
    setting = Setting(Kind.PRESET, FAMILY, 1e-8, walker="arclength", name="standard")
    return Measured(setting, seconds, seconds, seconds, 0.0, 60.0, 10, 40, error, error, error, 1.0)


def made() -> list[Measured]:
    """Series beats arclength beats gauss; the splitting beats cvodes, which does not keep its tightest tolerance."""
    slow = replace(orbits("trigonometric", "arclength", 1e-8, 0.045, 1e-9), setting=default_orbits(1e-8))
    return [
        preset(0.2, 2e-9),
        *(orbits("trigonometric", "series", t, s, e) for t, s, e in ((1e-4, 0.010, 1e-6), (1e-8, 0.014, 1e-9))),
        slow,
        *(orbits("gauss", "arclength", t, s, e) for t, s, e in ((1e-4, 0.2, 1e-5), (1e-8, 0.5, 1e-12))),
        *(flow("splitting", t, s, e) for t, s, e in ((1e-4, 0.001, 1e-6), (1e-8, 0.002, 1e-10))),
        *(flow("cvodes", t, s, e) for t, s, e in ((1e-4, 0.010, 1e-5), (1e-8, 0.020, 4e-8))),
    ]


def default_orbits(tolerance: float) -> Setting:
    return Setting(Kind.ORBITS, FAMILY, tolerance, walker="arclength")


# The front ----------------------------------------------------------------------------------------------------------


def test_the_front_holds_what_no_other_beats() -> None:
    points = [(2.0, 1e-3), (1.0, 1e-1), (3.0, 1e-3), (2.5, 1e-2), (5.0, 1e-6), (nan, 1e-9), (1.0, 2e-1), (0.5, nan)]
    assert pareto_front(points) == [1, 0, 4]
    assert pareto_front([]) == []
    assert pareto_front([(1.0, 1.0), (1.0, 1.0)]) == [0]


def test_errors_nearly_the_same_or_below_the_reference_do_not_join_the_front() -> None:
    points = [(1.0, 1e-6), (2.0, 0.9e-6), (3.0, 1e-8)]
    assert pareto_front(points) == [0, 1, 2]
    assert pareto_front(points, 1.5) == [0, 2]
    measured = [orbits("gauss", "arclength", 1e-12, s, e) for s, e in ((1.0, 1e-14), (2.0, 1e-16), (3.0, 1e-17))]
    assert [m.seconds for m in front_of(measured, Kind.ORBITS, 1e-13)] == [1.0]
    assert len(front_of(measured, Kind.ORBITS, nan)) == 3


@pytest.mark.parametrize("seed", range(20))
def test_every_point_is_on_the_front_or_beaten_by_one_of_it(seed: int) -> None:
    points = [tuple(p) for p in np.random.default_rng(seed).integers(0, 8, (30, 2)).astype(float).tolist()]
    front = [points[i] for i in pareto_front(points)]
    assert all(any(a <= x and b <= y for a, b in front) for x, y in points)
    for a, b in front:
        assert not any(x <= a and y <= b and (x, y) != (a, b) for x, y in points)


# Words --------------------------------------------------------------------------------------------------------------


def test_advice_names_method_time_and_lead() -> None:
    words = advice(made(), 1e-8, OMEGA)
    assert words.startswith("trigonometric, series, newton at tolerance 1e-08, 14 ms")
    assert "3.2 times faster than the next, trigonometric, arclength, ipopt (45 ms)" in words
    assert advice(made(), 1e-8, MU) == "splitting at tolerance 1e-08, 2 ms; no other method reaches it"
    assert advice(made(), 1e-13, MU) == "no setting measured here promises and keeps it"


def test_times_that_overlap_are_not_distinguished() -> None:
    near = [
        orbits("trigonometric", "series", 1e-8, 0.10, 1e-9),
        orbits("gauss", "arclength", 1e-8, 0.103, 1e-9),
    ]
    assert "not distinguished by these times from gauss, arclength, newton (103 ms)" in advice(near, 1e-8, OMEGA)
    single = [replace(m, seconds=s, seconds_min=s, seconds_max=s) for m, s in zip(near, (0.1, 0.13), strict=True)]
    assert "not distinguished" in advice(single, 1e-8, OMEGA)
    assert "faster" in advice(
        [single[0], replace(single[1], seconds=0.2, seconds_min=0.2, seconds_max=0.2)], 1e-8, OMEGA
    )


def test_equal_advice_is_given_once() -> None:
    lines = advices(made(), [1e-4, 1e-5, 1e-8])
    assert len([line for line in lines if line.startswith("For Omega and the profile to")]) == 2
    assert any(line.startswith("For Omega and the profile to 1e-05 and down to 1e-08: ") for line in lines)
    apart = [replace(m, profile_error=1e-3) for m in made()]
    assert any(
        line.startswith("For the profile to 1e-04 and down to 1e-08: no setting")
        for line in advices(apart, [1e-4, 1e-8])
    )
    assert not any("mu" in line for line in advices([m for m in made() if m.setting.kind is not Kind.FLOW], [1e-4]))


def test_where_a_preset_sits() -> None:
    words = preset_words(preset(0.2, 2e-9), made())
    assert words.startswith("`standard` (1e-08): 200 ms with multipliers and 40 points; true errors Omega 2.0e-09")
    assert "the tolerance is kept" in words
    assert words.endswith(
        "Its orbits alone take 45 ms, 3.2 times as long as the fastest that keeps the tolerance: "
        "trigonometric, series, newton, 14 ms."
    )
    assert "missed by a factor 5" in preset_words(preset(0.2, 5e-8), made())
    failed = Measured(preset(0.2, nan).setting, failure="the family ended")
    assert preset_words(failed, made()) == "`standard` (1e-08): the family ended."
    alone = [m for m in made() if m.setting.walker == "arclength"]
    assert "nothing measured here is faster" in preset_words(preset(0.2, 2e-9), alone)


def test_fronts_and_broken_promises_in_words() -> None:
    words = front_words(made(), Kind.ORBITS, 1e-15)
    assert words.startswith("The Pareto front of orbits, 3 of 5 settings: ")
    assert "trigonometric, series, newton from 1.0e-06 in 10 ms to 1.0e-09 in 14 ms; gauss" in words
    assert front_words([], Kind.FLOW, nan) == ""
    (line,) = broken_promises(made())
    assert line == "cvodes, tolerance 1e-08: true error 4.0e-08, 4 times that; the program does not say so."
    told = [replace(m, told=True) for m in made()]
    assert broken_promises(told)[0].endswith("; the program says so.")
    assert broken_promises([replace(m, at_reference_round_off=True) for m in made()]) == []
    failed = Measured(default_orbits(1e-12), failure="no step")
    assert broken_promises([failed]) == ["trigonometric, arclength, ipopt, tolerance 1e-12: no result: no step."]
    assert by_transcription(made(), 1e-8).endswith("trigonometric 14 ms, gauss 500 ms.")
    assert "gauss does not keep it" in by_transcription([orbits("gauss", "arclength", 1e-8, 1.0, 1e-7)], 1e-8)


def test_recommendations_hold_all_sections_and_a_table() -> None:
    text = recommendations(FAMILY, made(), KNOWN, 45.0, 5)
    for words in ("What to use", "Where the presets sit", "Pareto fronts", "Not kept", "Measured"):
        assert f"## {words}\n" in text
    assert "agree to 1.0e-15 of Omega and 2.0e-15 of the profile, and their mu to 3.0e-15" in text
    assert "Shooting is left out" not in text
    assert "Shooting is left out: the chain has 24 sites" in recommendations(DEFAULT_FAMILY, made(), KNOWN, 45.0, 5)
    rows = [line for line in table(made(), (1e-4,)) if line.startswith(("| trig", "| gauss", "| flow", "| preset"))]
    assert len(rows) == 4
    assert {row.count("|") for row in table(made(), (1e-4, 1e-8))} == {10}
    assert "10 ms (9.5 ms to 10.5 ms) | 100 ms | 50 MB | 10 | 1.0e-06 | 1.0e-06 | 1.0e-06 |" in rows[0]


# Settings and rows --------------------------------------------------------------------------------------------------


def test_settings_are_every_method_at_every_tolerance() -> None:
    methods = [s.method for s in orbit_settings(FAMILY, (1e-4,))]
    assert len(methods) == len(set(methods)) == 10
    assert "shooting, arclength, newton" in methods
    assert len(orbit_settings(DEFAULT_FAMILY, TOLERANCES)) == 8 * 10
    assert not any("shooting" in s.method for s in orbit_settings(DEFAULT_FAMILY, TOLERANCES))
    assert len(flow_settings(FAMILY, QUICK_TOLERANCES)) == 4 * 3
    assert FAMILY.request().method.walker == "series"
    presets = preset_settings(FAMILY, "series")
    assert [(s.name, s.tolerance) for s in presets] == [("draft", 1e-4), ("standard", 1e-8), ("reference", 1e-12)]
    assert {s.orbit_methods for s in presets} == {"trigonometric, series, ipopt"}
    lonely = WorkPrecision(Path("."), FamilyCase(Chain(3, 1.0, 1.0, -1.0), 1, 0.4, (0.2,)), quick=True)
    assert not any(s.kind is Kind.FLOW for s in lonely.settings())


def test_points_are_made_where_a_scene_asks_for_none() -> None:
    assert FAMILY.with_points() is FAMILY
    at = replace(FAMILY, at=()).with_points().at
    assert len(at) == PARTS_OF_FAMILY
    assert at[-1] == FAMILY.amplitude_max


def test_rows_are_cells_of_a_table(tmp_path: Path) -> None:
    failed = Measured(default_orbits(1e-8), failure="no step, however short")
    rows = [{name: cell(value) for name, value in m.row().items()} for m in (*made(), failed)]
    write_csv(tmp_path / "rows.csv", COLUMNS, rows)
    with (tmp_path / "rows.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["kind"] for row in rows] == ["preset", *["orbits"] * 5, *["flow"] * 4, "orbits"]
    assert rows[0]["method"] == "standard"
    assert float(rows[1]["seconds"]) == 0.010
    assert float(rows[1]["seconds_min"]) < 0.010 < float(rows[1]["seconds_max"])
    assert rows[6]["transcription"] == rows[6]["Omega_error"] == ""
    assert rows[1]["flow"] == ""
    assert rows[-1]["failure"] == failed.failure
    assert rows[-1]["seconds"] == rows[-1]["memory_MB"] == ""


# Measuring ----------------------------------------------------------------------------------------------------------


def test_times_of_repeated_runs() -> None:
    calls = []
    result, times = timed(lambda: calls.append(sum(range(10_000))) or len(calls), 3)
    assert result == len(calls) > 3  # a run this short is many, timed together
    assert 0 < times["seconds_min"] <= times["seconds"] <= times["seconds_max"]
    assert times["building_seconds"] >= 0
    assert 0 < times["processor_share"] < 1.5
    assert timed(int, 0) == (0, {})


def test_a_busy_machine_is_told() -> None:
    assert busy(made()) == ""
    assert busy([replace(m, processor_share=0.99) for m in made()]) == ""
    assert "for 50% of the time" in busy([replace(m, processor_share=0.5) for m in made()])


def test_values_are_paired_before_they_are_compared() -> None:
    true = np.array([-0.5, -0.2 + 0.1j, 4.0])
    np.testing.assert_array_equal(paired(true, true[[2, 0, 1]]), true)
    assert paired(np.zeros(0, complex), np.zeros(0, complex)).size == 0


@pytest.fixture(scope="module")
def reference() -> Reference:
    return Reference(FAMILY)


def test_reference_and_the_methods_that_confirm_it_agree(reference: Reference) -> None:
    assert max(reference.agreement) < 1e-13
    assert [row["S"] for row in reference.rows()] == [0.2, 0.4]
    computation = Computation(Setting(Kind.ORBITS, FAMILY, 1e-6, corrector="newton"))
    found = requested_orbits(computation.follow())
    errors = reference.errors_of(found, computation.multipliers(found))
    assert 1e-13 < max(errors) < 1e-6
    assert [float(exact.Omega) for exact in reference.exact] == pytest.approx([o.Omega for o in found], rel=1e-6)
    with pytest.raises(ArithmeticError, match="1 points"):
        reference.errors_of(found[:1], computation.multipliers(found[:1]))


def test_the_errors_of_mu_are_those_of_pairs(reference: Reference) -> None:
    computation = Computation(Setting(Kind.ORBITS, FAMILY, 1e-13, corrector="newton"))
    known = computation.multipliers(reference.orbits)
    assert reference.errors_of(reference.orbits, known).mu < 1e-13
    off = [replace(floquet, mu=floquet.mu + 1e-6) for floquet in known]
    assert reference.errors_of(reference.orbits, off).mu == pytest.approx(1e-6, rel=1e-6)
    none = [replace(floquet, mu=np.zeros(0, complex)) for floquet in known]
    assert isnan(reference.errors_of(reference.orbits, none).mu)


@pytest.mark.slow
@pytest.mark.usefixtures("harmonics")
def test_a_setting_is_measured_and_a_failure_is_a_line(reference: Reference) -> None:
    quick = measure(orbit_settings(FAMILY, (1e-4,))[0], reference, 1, with_memory=False)
    assert 0 < quick.seconds_min <= quick.seconds <= quick.seconds_max
    assert 0 < quick.orbit_error < 1e-4
    assert 0 < quick.mu_error < 1e-3
    assert isnan(quick.memory_MB)
    soft = FamilyCase(Chain(1, 1.0, 0.0, -1.0), 1, 5.0, (1.0,))  # beyond S = 3 there is no orbit
    methods = {"transcription": "gauss", "walker": "arclength", "corrector": "newton"}
    failed = measure(Setting(Kind.ORBITS, soft, 1e-4, **methods), reference, 1, with_memory=False)
    assert failed.failure
    assert "\n" not in failed.failure
    assert isnan(failed.seconds)


@pytest.mark.slow
def test_memory_is_that_of_another_process() -> None:
    held = np.ones(15_000_000)
    ours, started = peak_memory(), memory_of(None)
    assert held.nbytes / 1e6 < ours
    assert 10 < started < ours


# The picture --------------------------------------------------------------------------------------------------------


def test_the_picture_shows_methods_presets_and_fronts() -> None:
    figure = work_precision_figure(FAMILY, [*made(), Measured(default_orbits(1e-12), failure="none")], KNOWN)
    labels = {text.get_text() for text in figure.legends[0].get_texts()}
    assert {"Pareto front", "preset, orbits and multipliers", "at the reference's round-off"} <= labels
    assert {"trigonometric, series, newton", "gauss, arclength, newton", "flow: splitting", "flow: cvodes"} <= labels
    assert [text.get_text() for axes in figure.axes for text in axes.texts] == ["standard", "standard"]
    assert figure.axes[0].get_ylim() == figure.axes[1].get_ylim()
    lonely = work_precision_figure(FAMILY, [m for m in made() if m.setting.kind is Kind.ORBITS], KNOWN._replace(mu=nan))
    assert [text.get_text() for text in lonely.axes[1].texts] == ["no multipliers measured"]
