"""What accuracy costs, from the command line: files, refusals in one line, and what an interruption leaves."""

from __future__ import annotations

from pathlib import Path

import pytest
from outputs import read_rows
from scenes import Cli, chain, family, lattice

from casadi_skin.runs import tradeoff
from casadi_skin.runs.program import main
from casadi_skin.runs.tradeoff import FLOW, Setting

TINY = chain(2)
LATTICE = lattice([2], "alpha*y + g*y^3", parameters={"alpha": 1.0, "g": -1.0}, force="d")
FAMILY = family([1, 2], 0.4, at=[0.2, 0.4])
FILES = {
    *("reference.csv", "tradeoff.csv", "flows.csv", "recommendations.md"),
    "tradeoff.png",
}


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "tiny.toml"
    path.write_text(TINY + FAMILY, encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("model", [TINY, LATTICE], ids=["chain", "lattice"])
def test_every_method_of_a_tiny_scene(
    model: str, scene: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene.write_text(model + FAMILY, encoding="utf-8")
    out = tmp_path / "out"
    assert main(["tradeoff", str(scene), "--quick", "--out", str(out)]) == 0
    told = capsys.readouterr().out
    assert "For Omega" in told
    assert f"{len(FILES)} files in {out}" in told
    assert {path.name for path in out.iterdir()} == FILES
    rows, flows = read_rows(out / "tradeoff.csv"), read_rows(out / "flows.csv")
    assert (len(rows), len(flows) % 3) == (3 + 10 * 3, 0)
    assert [row["method"] for row in rows[:3]] == ["draft", "standard", "reference"]
    for row in (*rows, *flows):
        assert row["failure"] == ""
        assert 0 < float(row["seconds_min"]) <= float(row["seconds"]) <= float(row["seconds_max"])
        assert (row["memory_MB"] != "") == (row["kind"] == "preset")
        assert 0 < float(row["mu_error"]) < 1e-3
        if row in rows and "shooting" not in row["method"]:
            assert float(row["Omega_error"]) <= float(row["tolerance"])
            assert float(row["profile_error"]) <= float(row["tolerance"])
    differences = [
        float(row[f"{name}_difference"]) for row in read_rows(out / "reference.csv") for name in ("Omega", "mu")
    ]
    assert max(differences) < 1e-12


@pytest.mark.slow
@pytest.mark.usefixtures("blank")
def test_a_few_settings_and_what_an_interruption_leaves(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scene.write_text(TINY + FAMILY.replace("[1, 2]", "2"), encoding="utf-8")
    every, real, count = tradeoff.settings_of, tradeoff.measure, 0

    def few(*asked: object) -> list[object]:
        some = every(*asked)  # type: ignore[arg-type]
        return [*some[:5], *[s for s in some if s.kind == FLOW][:1]]

    def interrupted(*arguments: object) -> Setting:
        nonlocal count
        count += arguments[-1] != 0  # not of the warming up
        if count == 5:
            raise KeyboardInterrupt
        return real(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(tradeoff, "settings_of", few)
    monkeypatch.setattr(tradeoff, "memory_of", lambda *asked: 50.0)
    monkeypatch.setattr(tradeoff, "measure", interrupted)
    words = ["tradeoff", str(scene), "--repeats", "1", "--out", str(tmp_path / "out")]
    assert main(words) == 130
    told = capsys.readouterr()
    assert told.err == f"interrupted after 4 settings; the results so far are in {tmp_path / 'out'}\n"
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES - {"flows.csv"}
    assert len(read_rows(tmp_path / "out" / "tradeoff.csv")) == 4

    monkeypatch.setattr(tradeoff, "measure", real)
    assert main([*words, "--overwrite"]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    assert len(read_rows(tmp_path / "out" / "tradeoff.csv")) == 5
    assert [row["memory_MB"] for row in read_rows(tmp_path / "out" / "flows.csv")] == ["50"]


@pytest.mark.parametrize(
    ("text", "words", "told"),
    [
        (TINY, "", "tiny.toml: asks for no family"),
        (TINY.replace("sites = 2", "sites = inf") + FAMILY.replace("[1, 2]", '"first"'), "", "asks for no family"),
        (TINY + FAMILY, "--repeats 0", "--repeats 0"),
        ("", "", "tiny.toml"),
        (TINY + FAMILY, "--out .", "--overwrite"),
    ],
)
def test_wrong_input_is_refused_in_one_line(
    text: str, words: str, told: str, scene: Path, monkeypatch: pytest.MonkeyPatch, cli: Cli
) -> None:
    monkeypatch.chdir(scene.parent)
    scene.write_text(text, encoding="utf-8")
    done = cli("tradeoff", scene, "--out", "out", *words.split())
    assert done.out == ""
    assert told in done.line
    assert not Path("out").exists()


def test_a_family_that_ends_early_is_told_in_one_line(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def lost(*_: object) -> None:
        raise ArithmeticError("no step, however short, stays on the family")

    monkeypatch.setattr(tradeoff, "Reference", lost)
    assert main(["tradeoff", str(scene), "--quick", "--out", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "no step" in told
