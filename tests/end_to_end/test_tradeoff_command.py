"""What accuracy costs, from the command line: files, refusals in one line, and what an interruption leaves."""

from __future__ import annotations

from pathlib import Path

import pytest
from outputs import read_rows

from casadi_skin.runs.program import main
from casadi_skin.studies.work_precision import measuring, settings
from casadi_skin.studies.work_precision import study as study_module
from casadi_skin.studies.work_precision.settings import Measured

TINY = """
[chain]
sites = 2
alpha = 1.0
gamma = 0.25
g = -1.0
"""
FAMILY = """
[family]
mode = [1, 2]
amplitude_max = 0.4
at = [0.2, 0.4]
"""
FILES = {
    *("reference.csv", "tradeoff.csv", "flows.csv", "recommendations.md"),
    "tradeoff.png",
}


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(TINY + FAMILY, encoding="utf-8")
    return path


def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tolerance of each method in place of three, no shooting, and no memory."""
    monkeypatch.setattr(settings, "SHOOTING_SITES", 1)
    monkeypatch.setattr(study_module, "QUICK_TOLERANCES", (1e-6,))
    monkeypatch.setattr(study_module, "memory_of", lambda setting: 40.0)
    monkeypatch.setattr(measuring, "memory_of", lambda setting: 50.0)


@pytest.mark.slow
def test_every_method_of_a_tiny_scene(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["tradeoff", str(scene), "--quick", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "For Omega" in told
    assert f"45 settings; {len(FILES)} files in {out}" in told
    assert {path.name for path in out.iterdir()} == FILES
    rows, flows = read_rows(out / "tradeoff.csv"), read_rows(out / "flows.csv")
    assert (len(rows), len(flows)) == (3 + 10 * 3, 4 * 3)
    assert [row["method"] for row in rows[:3]] == ["draft", "standard", "reference"]
    for row in (*rows, *flows):
        assert row["failure"] == ""
        assert 0 < float(row["seconds_min"]) <= float(row["seconds"]) <= float(row["seconds_max"])
        assert (row["memory_MB"] != "") == (row["kind"] == "preset" or float(row["tolerance"]) == 1e-12)
        assert 0 < float(row["mu_error"]) < 1e-3
        if row in rows and "shooting" not in row["method"]:
            assert float(row["Omega_error"]) <= float(row["tolerance"])
            assert float(row["profile_error"]) <= float(row["tolerance"])
    differences = [
        float(row[f"{name}_difference"]) for row in read_rows(out / "reference.csv") for name in ("Omega", "mu")
    ]
    assert max(differences) < 1e-13


@pytest.mark.slow
@pytest.mark.usefixtures("blank")
@pytest.mark.parametrize(
    ("modes", "methods", "flows"), [("2", 2, 1), pytest.param("[1, 2]", 8, 4, marks=pytest.mark.slow)]
)
def test_a_few_settings_and_what_an_interruption_leaves(
    scene: Path,
    tmp_path: Path,
    modes: str,
    methods: int,
    flows: int,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    few(monkeypatch)
    scene.write_text(TINY + FAMILY.replace("[1, 2]", modes), encoding="utf-8")
    monkeypatch.setattr(study_module, "orbit_settings", lambda *asked: settings.orbit_settings(*asked)[:methods])
    monkeypatch.setattr(study_module, "flow_settings", lambda *asked: settings.flow_settings(*asked)[:flows])
    real, count = study_module.measure, 0

    def interrupted(*arguments: object, **named: object) -> Measured:
        nonlocal count
        count += arguments[2] != 0  # not of the warming up
        if count == 5:
            raise KeyboardInterrupt
        return real(*arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(study_module, "measure", interrupted)
    out = tmp_path / "out"
    assert main(["tradeoff", str(scene), "--quick", "--repeats", "1", "--out", str(out)]) == 130
    told = capsys.readouterr()
    assert told.err == f"interrupted after 4 settings; the results so far are in {out}\n"
    assert {path.name for path in out.iterdir()} == FILES - {"flows.csv"}
    assert len(read_rows(out / "tradeoff.csv")) == 4

    monkeypatch.setattr(study_module, "measure", real)
    assert main(["tradeoff", str(scene), "--quick", "--repeats", "1", "--out", str(out), "--overwrite"]) == 0
    assert {path.name for path in out.iterdir()} == FILES
    assert len(read_rows(out / "tradeoff.csv")) == 3 + methods
    assert len(read_rows(out / "flows.csv")) == flows
    assert {row["memory_MB"] for row in read_rows(out / "flows.csv")} == {"50"}


def test_wrong_input_is_refused_in_one_line(scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    texts = {
        "bare": TINY,
        "endless": TINY.replace("sites = 2", "sites = inf") + FAMILY.replace("[1, 2]", '"first"'),
        "model": '[model]\nfile = "pendulum.py"\nname = "pendulum"\n' + FAMILY,
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    for words, part in (
        *(([str(tmp_path / f"{name}.toml")], f"{name}.toml: asks for no family") for name in texts),
        ([str(scene), "--repeats", "0"], "--repeats 0"),
        ([str(tmp_path / "none.toml")], "none.toml"),
    ):
        assert main(["tradeoff", *words, "--out", str(out)]) == 2
        told = capsys.readouterr()
        assert told.out == ""
        assert told.err.count("\n") == 1
        assert part in told.err
        assert not out.exists()
    assert main(["tradeoff", str(scene), "--out", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "--overwrite" in told


def test_a_family_that_ends_early_is_told_in_one_line(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lost(*_: object) -> None:
        raise ArithmeticError("no step, however short, stays on the family")

    monkeypatch.setattr(study_module, "Reference", lost)
    assert main(["tradeoff", str(scene), "--quick", "--out", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "no step" in told
