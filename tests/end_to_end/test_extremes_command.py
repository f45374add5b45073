"""The extremes from the command line: files, verdicts, what a fault and an interruption leave."""

from __future__ import annotations

from pathlib import Path

import pytest
from outputs import read_rows

from tests.studies import extreme_physical as physical
from tests.studies import extremes as study_module
from tests.studies.extreme_case import Case, Finding, Outcome, measure
from tests.studies.extreme_cases import all_cases
from tests.studies.extremes import COLUMNS
from tests.studies.extremes import main as extremes

pytestmark = pytest.mark.usefixtures("blank")

FILES = {
    *("extremes.csv", "extremes.png"),
    *(f"{name}.{kind}" for name in ("physical_against_gauge", "threshold") for kind in ("csv", "png")),
}


CHOSEN = ("gamma = 1, g = 1", "gamma = 0, g = -1", "gamma = 1, j = 12", "gamma = nan", "gamma = -1.5")


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Five cases of gamma, and two small chains in physical coordinates."""
    chosen = [case for case in all_cases() if case.name in CHOSEN]
    monkeypatch.setattr(study_module, "all_cases", lambda: chosen)
    monkeypatch.setattr(physical, "QUICK_SIZES", (4, 8))
    monkeypatch.setattr(physical, "GAMMAS", (0.25,))
    monkeypatch.setattr(study_module, "QUICK_GAMMAS", (0.25, 0.5))


@pytest.fixture
def fewest(few: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same with one chain and one threshold."""
    monkeypatch.setattr(physical, "QUICK_SIZES", (4,))
    monkeypatch.setattr(study_module, "QUICK_GAMMAS", (0.5,))


def test_every_case_has_a_name_of_its_own() -> None:
    cases = all_cases()
    assert len({(case.theme, case.name, case.check) for case in cases}) == len(cases)
    assert 30 < sum(case.quick for case in cases) < len(cases)
    assert {case.theme for case in cases} == {case.theme for case in cases if case.quick}


@pytest.mark.slow
@pytest.mark.usefixtures("few", "pictures")
def test_cases_of_gamma(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert extremes(["--quick", "--out", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == FILES
    written = read_rows(out / "extremes.csv")
    assert tuple(written[0]) == COLUMNS
    verdicts = {row["case"]: row["verdict"] for row in written}
    assert verdicts["gamma = 1, g = 1"] == verdicts["gamma = 0, g = -1"] == "holds"
    assert verdicts["gamma = 1, j = 12"] == verdicts["gamma = nan"] == "refused"
    for row in written:
        assert row["fault"] == ""
        assert (row["digits"] == "") == (row["verdict"] == "refused")
        assert row["digits"] == "" or float(row["digits"]) >= float(row["promised"]) == 12.0
    assert [row["sites"] for row in read_rows(out / "physical_against_gauge.csv")] == ["4", "8"]
    assert [float(row["S"]) for row in read_rows(out / "threshold.csv")][::2] == pytest.approx(
        [0.367762016876, 0.366992903607]
    )
    told = capsys.readouterr().out
    assert "5 cases: 2 hold, 3 are refused, 0 not as expected" in told
    assert "refused: gamma = -1.5: gamma: given -1.5; accepted: -1 <= gamma <= 1" in told
    assert extremes(["--quick", "--out", str(out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.usefixtures("fewest")
def test_a_fault_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    wrong = Case("theme", "a wrong one", "asked", "check", lambda: Finding("it", 1e-3, 1e-6), quick=True)
    monkeypatch.setattr(study_module, "all_cases", lambda: [wrong])
    out = tmp_path / "out"
    assert extremes(["--quick", "--out", str(out)]) == 1
    assert "not as expected: theme, a wrong one: 3.0 digits agree, 6.0 are promised" in capsys.readouterr().out
    assert read_rows(out / "extremes.csv")[0]["verdict"] == "fault"


@pytest.mark.slow
@pytest.mark.usefixtures("fewest")
def test_an_interruption_keeps_what_was_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    count = 0

    def interrupted(case: Case) -> Outcome:
        nonlocal count
        count += 1
        if count == 3:
            raise KeyboardInterrupt
        return measure(case)

    monkeypatch.setattr(study_module, "measure", interrupted)
    out = tmp_path / "out"
    assert extremes(["--quick", "--out", str(out)]) == 130
    assert "after 2 cases" in capsys.readouterr().err
    assert len(read_rows(out / "extremes.csv")) == 2
    assert (out / "extremes.png").exists()


@pytest.mark.slow
def test_the_quick_cases(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert extremes(["--quick", "--out", str(out)]) == 0
    assert all(row["fault"] == "" for row in read_rows(out / "extremes.csv"))
