"""The command line itself: help, version, plans, spectra, and one-line refusals with exit status 2."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from apart import Ended, modules_of

from casadi_skin import Chain, __version__
from casadi_skin.native import kernels_in_words

pytestmark = pytest.mark.usefixtures("blank")
Cli = Callable[..., Ended]

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
CHAIN = GOOD.split("[family]")[0]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(GOOD, encoding="utf-8")
    return path


@pytest.mark.parametrize("command", ["", "run", "check", "spectrum", "tradeoff"])
def test_help_is_there(command: str, cli: Cli) -> None:
    done = cli(*command.split(), "--help")
    assert done.status == 0
    assert "usage: casadi-skin" in done.out


def test_version(cli: Cli) -> None:
    assert cli("--version") == (0, f"casadi-skin {__version__} (kernels: {kernels_in_words()})\n", "")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("", "casadi-skin"),
        ("run", "casadi-skin"),
        ("run a.toml --resume --overwrite", "casadi-skin"),
        ("run no-such-scene.toml", "casadi-skin: no-such-scene.toml"),
        ("rn x.toml", "casadi-skin: COMMAND: given 'rn'; did you mean run? accepted: run, check, "),
        ("new modell", "casadi-skin new: kind: given 'modell'; did you mean model? accepted: chain, "),
        ("run x.toml --outdir y", "casadi-skin run: unrecognized arguments: --outdir y; see casadi-skin run "),
    ],
)
def test_wrong_words_are_refused_in_one_line(words: str, told: str, cli: Cli) -> None:
    assert cli(*words.split()).line.startswith(told)


ASKED = "[family], [equilibrium], [orbit], [solution], [search], [dynamics], [export] or [spectrum]"


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize(
    ("text", "place"),
    [
        (GOOD.replace("[family]", "[famly]"), "[famly]"),
        (GOOD.replace("mode = 1", "mode = 25"), "[family] mode"),
        (GOOD.replace("at = ", "at_omega = "), "'at_Omega'"),
        (GOOD.replace("[chain]", "[chain"), "not TOML"),
        (CHAIN, ASKED),
    ],
)
def test_bad_scenes_are_refused_in_one_line_and_nothing_is_written(
    text: str, place: str, command: str, scene: Path, cli: Cli
) -> None:
    if (text, command) == (CHAIN, "check"):
        return
    out = scene.with_name("out")
    scene.write_text(text, encoding="utf-8")
    done = cli(command, scene, *(["--out", out] if command == "run" else []))
    assert place in done.line
    assert str(scene) in done.line
    assert done.out == ""
    assert not out.exists()


def test_the_plan_tells_what_is_built_and_what_is_not(scene: Path, cli: Cli) -> None:
    plan = cli("check", scene).out
    for words in ("quarter of the period", "not built     the variational system", "ipopt", "check --measure"):
        assert words in plan
    measured = cli("check", scene, "--measure").out
    for words in ("non-zeros", "expected cost"):
        assert words in measured
        assert words not in plan
    unknowns = [next(line for line in text.splitlines() if line.startswith("unknowns")) for text in (plan, measured)]
    assert unknowns[0].split()[1] == unknowns[1].split()[1]  # their number
    assert set(plan.splitlines()[:-1]) - {unknowns[0]} <= set(measured.splitlines())
    scene.write_text(GOOD + "\n[stability]\n", encoding="utf-8")
    plan = cli("check", scene).out
    assert "not built" not in plan
    assert "variational system with the splitting flow" in plan


@pytest.mark.usefixtures("pictures")
def test_spectrum_prints_and_writes_the_linear_frequencies(scene: Path, cli: Cli) -> None:
    out = scene.with_name("out")
    printed, closed = (  # without files in closed form, without numerics
        [float(line.split()[1]) for line in cli("spectrum", scene, *to).out.splitlines()[1:]]
        for to in (["--out", out], [])
    )
    dense = np.sqrt(np.sort(np.linalg.eigvals(Chain(24, 1.0, 0.25, -1.0).dynamical_matrix()).real))
    np.testing.assert_allclose(printed, dense, rtol=1e-12)
    np.testing.assert_allclose(closed, printed, rtol=2e-15)
    assert {"spectrum.csv", "spectrum.png"} <= {p.name for p in out.iterdir()}
    assert not {"numpy", "casadi", "scipy"} & modules_of("spectrum", str(scene))
    scene.write_text(GOOD.replace("alpha = 1.0", "alpha = -1.5"), encoding="utf-8")
    assert cli("spectrum", scene).status == 2
    scene.write_text(CHAIN.replace("g = -1.0", "g = 0.0") + "[spectrum]\n", encoding="utf-8")  # no nonlinearity
    assert cli("run", scene, "--out", out, "--overwrite").status == 0
    assert (out / "spectrum.csv").exists()
