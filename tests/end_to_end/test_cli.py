"""The command line itself: help, version, plans, spectra, and one-line refusals with exit status 2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from apart import modules_of

from casadi_skin import Chain, __version__
from casadi_skin.native import kernels_in_words
from casadi_skin.runs.program import main

pytestmark = pytest.mark.usefixtures("blank")

GOOD = """
[chain]
sites = 24
alpha = 1.0
gamma = 0.25
g = -1.0

[family]
mode = 1
amplitude_max = 3.0
at = [0.2, 1.0]
"""


def status(arguments: list[str]) -> int:
    """Exit status, also where argparse leaves by SystemExit."""
    try:
        return main(arguments)
    except SystemExit as stop:
        return int(stop.code or 0)


@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["run", "--help"], ["check", "--help"], ["spectrum", "--help"], ["tradeoff", "--help"]],
)
def test_help_is_there(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert status(arguments) == 0
    assert "usage: casadi-skin" in capsys.readouterr().out


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert status(["--version"]) == 0
    assert capsys.readouterr().out.strip() == f"casadi-skin {__version__} (kernels: {kernels_in_words()})"


@pytest.mark.parametrize(
    "arguments", [[], ["rum"], ["run"], ["run", "a.toml", "--resume", "--overwrite"], ["run", "a.toml", "--nonsense"]]
)
def test_wrong_words_are_refused_in_one_line(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert status(arguments) == 2
    told = capsys.readouterr().err
    assert told.startswith("casadi-skin")
    assert told.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["rn", "x.toml"], "casadi-skin: COMMAND: given 'rn'; did you mean run? accepted: run, check, "),
        (["new", "modell"], "casadi-skin new: kind: given 'modell'; did you mean model? accepted: chain, "),
        (
            ["run", "x.toml", "--outdir", "y"],
            "casadi-skin run: unrecognized arguments: --outdir y; see casadi-skin run ",
        ),
    ],
)
def test_words_that_are_nearly_right_are_met_with_those_that_are(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status(arguments) == 2
    assert capsys.readouterr().err.startswith(words)


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("[family]", "[famly]", "[famly]"),
        ("sites", "sitse", "[chain] sitse"),
        ("sites = 24", 'sites = "24"', "[chain] sites"),
        ("sites = 24", "sites = 0", "[chain] sites"),
        ("gamma = 0.25", "gamma = 1.25", "[chain] gamma"),
        ("mode = 1", "mode = 25", "[family] mode"),
        ("alpha = 1.0", "alpha = -1.5", "[family] mode"),
        ("g = -1.0", "g = 0.0", "[chain] g"),
        ("amplitude_max = 3.0", "amplitude_max = 0", "[family] amplitude_max"),
        ("amplitude_max = 3.0", "amplitude_max = inf", "[family] amplitude_max"),
        ("at = [0.2, 1.0]", "at = [0.2, 4.0]", "[family] at"),
        ("at = [0.2, 1.0]", "at = [1.0, 0.2]", "[family] at"),
        ("at = [0.2, 1.0]", "at = [0.0]", "[family] at"),
        ("at = [0.2, 1.0]", "at_Omega = [0.9, 0.9]", "[family] at_Omega"),
        ("at = [0.2, 1.0]", "at_Omega = [-1.0]", "[family] at_Omega"),
        ("at = [0.2, 1.0]", "at_period = 7.0", "[family] at_period"),
        ("at = [0.2, 1.0]", "at_period = [7.0, 9.0]\nperiod_max = 8.0", "[family] at_period"),
        ("at = [0.2, 1.0]", "period_max = 6.0", "[family] period_max"),
        ("at = [0.2, 1.0]", "at_omega = [0.9]", "'at_Omega'"),
        ("at = [0.2, 1.0]", "max_points = 0", "[family] max_points"),
        ("[family]", '[accuracy]\npreset = "fast"\n[family]', "[accuracy] preset"),
        ("[family]", '[method]\ncorrector = "nweton"\n[family]', "[method] corrector"),
        ("[family]", '[method]\nwalker = "taylor"\n[family]', "[method] walker"),
        ("[chain]", "[chain", "not TOML"),
    ],
)
@pytest.mark.parametrize("command", ["run", "check"])
def test_bad_scenes_are_refused_in_one_line_and_nothing_is_written(
    old: str, new: str, place: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    assert old in GOOD
    scene.write_text(GOOD.replace(old, new), encoding="utf-8")
    assert main([command, str(scene), *(["--out", str(out)] if command == "run" else [])]) == 2
    told = capsys.readouterr()
    assert place in told.err
    assert str(scene) in told.err
    assert told.err.count("\n") == 1
    assert told.out == ""
    assert not out.exists()


def test_a_scene_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "no-such-scene.toml"]) == 2
    assert "no-such-scene.toml" in capsys.readouterr().err


def test_a_scene_that_asks_for_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(GOOD.split("[family]")[0], encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert (
        "[family], [equilibrium], [orbit], [solution], [search], [dynamics], [export] or [spectrum]"
        in capsys.readouterr().err
    )


def test_the_plan_tells_what_is_built_and_what_is_not(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(GOOD, encoding="utf-8")
    assert main(["check", str(scene)]) == 0
    plan = capsys.readouterr().out
    for words in ("quarter of the period", "not built     the variational system", "ipopt", "check --measure"):
        assert words in plan
    assert main(["check", str(scene), "--measure"]) == 0
    measured = capsys.readouterr().out
    for words in ("non-zeros", "expected cost"):
        assert words in measured
        assert words not in plan
    known, found = (line_of("unknowns", text) for text in (plan, measured))
    assert known.split()[1] == found.split()[1]  # their number
    assert set(plan.splitlines()[:-1]) - {known} <= set(measured.splitlines())
    scene.write_text(GOOD + "\n[stability]\n", encoding="utf-8")
    assert main(["check", str(scene)]) == 0
    plan = capsys.readouterr().out
    assert "not built" not in plan
    assert "variational system with the splitting flow" in plan


def line_of(subject: str, text: str) -> str:
    (line,) = (line for line in text.splitlines() if line.startswith(subject))
    return line


@pytest.mark.usefixtures("pictures")
def test_spectrum_prints_and_writes_the_linear_frequencies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(GOOD, encoding="utf-8")
    assert main(["spectrum", str(scene), "--out", str(out)]) == 0
    printed = [float(line.split()[1]) for line in capsys.readouterr().out.splitlines()[1:]]
    dense = np.sqrt(np.sort(np.linalg.eigvals(Chain(24, 1.0, 0.25, -1.0).dynamical_matrix()).real))
    np.testing.assert_allclose(printed, dense, rtol=1e-12)
    assert {"spectrum.csv", "spectrum.png"} <= {p.name for p in out.iterdir()}
    assert main(["spectrum", str(scene)]) == 0  # without files in closed form, without numerics
    closed = [float(line.split()[1]) for line in capsys.readouterr().out.splitlines()[1:]]
    np.testing.assert_allclose(closed, printed, rtol=2e-15)
    scene.write_text(GOOD.replace("alpha = 1.0", "alpha = -1.5"), encoding="utf-8")
    assert main(["spectrum", str(scene)]) == 2


def test_the_spectrum_of_a_chain_loads_no_numerics(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    scene.write_text(GOOD, encoding="utf-8")
    assert not {"numpy", "casadi", "scipy"} & modules_of("spectrum", str(scene))


def test_a_chain_without_nonlinearity_has_a_spectrum(tmp_path: Path) -> None:
    scene = tmp_path / "scene.toml"
    linear = GOOD.split("[family]")[0].replace("g = -1.0", "g = 0.0")
    scene.write_text(linear + "[spectrum]\n", encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    assert (tmp_path / "out" / "spectrum.csv").exists()
