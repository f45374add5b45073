"""Estimated errors against true ones on random cases, a small draw of what tests/studies/honesty.py measures."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mpmath
import numpy as np
import pytest
from outputs import read_rows

from casadi_skin import Chain, Orbit, follow_family
from casadi_skin.stability.flows import FlowError
from tests.studies import honesty as study_module
from tests.studies.exact import LONG_DOUBLES, exact_orbit
from tests.studies.exact_multipliers import exact_mu, paired
from tests.studies.honesty import COLUMNS, QUANTITIES, ErrorCalibration, Tally
from tests.studies.honesty import main as honesty
from tests.studies.honesty_cases import Case, Outcome, Quantity, draw, find, measure, reference_of

CASES, SEED = 12, 2026


def error(
    true: float, estimate: float, tolerance: float = 1e-6, name: str = "Omega", excused: bool = False
) -> Quantity:
    return Quantity(name, true, estimate, 1.0, tolerance, true, estimate, excused)


@pytest.mark.slow
@pytest.mark.parametrize("count", [4, pytest.param(CASES, marks=pytest.mark.slow)])
def test_estimates_of_random_cases_are_honest(tmp_path: Path, count: int) -> None:
    study = ErrorCalibration(tmp_path, count, SEED)
    study.run()
    assert study.faults == []
    assert [outcome.reason for outcome in study.outcomes] == [""] * count
    assert all(q.true <= 2.0 * q.estimate for q in study.errors())
    assert len(study.errors("Omega")) == len(study.errors("profile")) == count
    assert len(study.errors("multipliers")) == sum(outcome.case.sites > 1 for outcome in study.outcomes)
    written = read_rows(tmp_path / "honesty.csv")
    assert list(written[0]) == list(COLUMNS)
    assert [int(row["index"]) for row in written] == list(range(count))
    for row, outcome in zip(written, study.outcomes, strict=True):
        assert float(row["Omega_true"]) == outcome.quantities[0].true
        assert float(row["tolerance"]) == outcome.case.tolerance
        assert row["profile_verdict"] in ("covered", "low")
    assert {path.name for path in study.files} == {"honesty.csv", "honesty.png"}
    assert all(path.stat().st_size > 1000 for path in study.files)
    assert next(study.tables()).row_count > len(QUANTITIES) + 4


@pytest.mark.slow
def test_a_profile_between_ends_of_segments_is_within_its_estimate() -> None:
    """Interpolants of full steps made it 3.6e-13, positions in units of velocities the estimate 3.3e-13."""
    outcome = measure(draw(0, 93))
    assert not outcome.reason
    assert all(q.covered for q in outcome.quantities)


def test_a_case_depends_on_seed_and_index_alone() -> None:
    case = draw(SEED, 5)
    assert case == draw(SEED, 5)
    assert case != draw(SEED, 6)
    assert replace(case, seed=SEED + 1) != draw(SEED + 1, 5)
    assert measure(case) == measure(draw(SEED, 5))
    kinds = [draw(0, index) for index in range(200)]
    for kind, count in (("transcription", 4), ("corrector", 2), ("walker", 2), ("flow", 2)):
        assert len({getattr(case, kind) for case in kinds}) == count
    assert {case.g > 0 for case in kinds} == {True, False}
    assert min(case.sites for case in kinds) == 1
    assert max(case.sites for case in kinds) > 50
    assert min(case.tolerance for case in kinds) < 1e-11
    assert max(case.tolerance for case in kinds) > 1e-4


@pytest.mark.parametrize(("g", "S"), [(1.0, 3.0), (-1.0, 2.5)])
def test_the_reference_of_one_site_is_the_exact_oscillator(g: float, S: float) -> None:
    """Omega = pi/2 sqrt(k + g S)/K(m), m = g S/(2 (k + g S)), here in 30 digits."""
    chain = Chain(1, 1.0, 0.0, g)
    orbit = follow_family(chain, 1, S, tolerance=1e-5, corrector="newton").orbits[-1]
    with mpmath.workdps(30):
        stiffness = mpmath.mpf(3) + g * S
        exact = mpmath.pi / 2 * mpmath.sqrt(stiffness) / mpmath.ellipk(g * S / (2 * stiffness))
        known = reference_of(orbit).Omega
        assert abs(mpmath.mpf(float(known)) + float(known - np.longdouble(float(known))) - exact) < 1e-17
    assert abs(orbit.Omega / float(exact) - 1.0) > 1e-12


def test_the_reference_is_the_orbit_and_the_multipliers_that_tight_runs_find() -> None:
    chain = Chain(6, 0.9, 0.3, -1.0)
    orbit = follow_family(chain, 2, 2.0, tolerance=1e-12, corrector="newton").orbits[-1]
    start = follow_family(chain, 2, 2.0, tolerance=1e-4, transcription="gauss", corrector="newton").orbits[-1]
    reference = exact_orbit(start, LONG_DOUBLES)
    assert reference.Omega_error(orbit.Omega) < 1e-14
    assert reference.profile_error(orbit) < 1e-12
    mu, uncertain = exact_mu(reference)
    assert uncertain < 1e-15
    found = orbit.floquet().mu
    assert np.max(np.abs(paired(found.astype(np.clongdouble), mu) - found)) < 1e-12


def test_what_tallies_hold_against_estimates() -> None:
    good = [error(1e-8, 2e-8)] * 95
    assert Tally.of("all", [*good, *[error(1e-8, 9e-9)] * 5]).faults == []
    (words,) = Tally.of("all", [*good, *[error(1e-8, 9e-9)] * 6]).faults
    assert "95 of 101" in words
    (words,) = Tally.of("all", [*good, error(1e-8, 9e-10)]).faults
    assert "ten times" in words
    (words,) = Tally.of("all", [error(1e-8, 3.1e-7)] * 3).faults
    assert "median" in words
    assert Tally.of("all", [error(1e-16, 3.1e-14)] * 3).faults == []
    (words,) = Tally.of("all", [error(2e-6, 4e-6)]).faults
    assert "tolerance" in words
    assert Tally.of("all", [error(2e-6, 4e-6, excused=True)]).faults == []
    told = Tally.of("all", [error(2e-6, 4e-6, name="multipliers")])
    assert (told.faults, told.announced) == ([], 1)
    assert len(Tally.of("all", [error(float("nan"), 1e-8)]).faults) == 3


@pytest.mark.usefixtures("pictures")
def test_estimates_that_are_too_small_are_found_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Orbit, "Omega_error", property(lambda self: 0.01 * self.point.error.Omega))
    arguments = ["--cases", "3", "--seed", str(SEED), "--out", str(tmp_path / "out")]
    assert honesty(arguments) == 1
    told = capsys.readouterr().out
    assert "not honest: Omega" in told
    assert any("far off" in row["Omega_verdict"] for row in read_rows(tmp_path / "out" / "honesty.csv"))


@pytest.mark.usefixtures("pictures")
def test_a_case_that_fails_is_a_row_with_its_reason(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(self: Orbit) -> None:
        raise FlowError("out of\nreach")

    monkeypatch.setattr(Orbit, "floquet", fail)
    first = next(index for index in range(CASES) if draw(SEED, index).sites > 1)
    out = tmp_path / "out"
    arguments = ["--cases", "1", "--first", str(first), "--seed", str(SEED), "--out", str(out)]
    assert honesty(arguments) == 1
    (row,) = read_rows(out / "honesty.csv")
    assert (row["index"], row["reason"], row["multipliers_true"]) == (str(first), "FlowError: out of reach", "")
    assert row["Omega_verdict"] == "covered"
    told = capsys.readouterr().out
    assert f"case {first}: FlowError: out of reach" in told
    assert "1 of 1 cases could not be judged" in told


@pytest.mark.usefixtures("pictures")
def test_an_interruption_keeps_what_was_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(case: Case) -> Outcome:
        if case.index == 2:
            raise KeyboardInterrupt
        return measure(case)

    monkeypatch.setattr(study_module, "measure", interrupted)
    out = tmp_path / "out"
    assert honesty(["--cases", "5", "--seed", str(SEED), "--out", str(out)]) == 130
    assert "after 2 cases" in capsys.readouterr().err
    assert [row["index"] for row in read_rows(out / "honesty.csv")] == ["0", "1"]
    assert (out / "honesty.png").exists()


@pytest.mark.parametrize("wrong", [["--cases", "0"], ["--seed", "-1"], ["--first", "-3"]])
def test_numbers_out_of_range_are_refused_in_one_line(
    wrong: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert honesty([*wrong, "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert wrong[0] in told
    assert not (tmp_path / "out").exists()


def test_the_point_asked_for_is_the_one_judged() -> None:
    case = next(c for c in (draw(SEED, i) for i in range(50)) if c.S is not None and c.g > 0)
    orbit, _ = find(case)
    assert orbit.S == case.S
