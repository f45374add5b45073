"""The command line itself: help, version, plans, spectra, and one-line refusals with exit status 2."""

from __future__ import annotations

import numpy as np
import pytest
from apart import modules_of
from scenes import Cli, Runs, chain, family

from casadi_skin import Chain, __version__
from casadi_skin.native import kernels_in_words

pytestmark = pytest.mark.usefixtures("blank")
CHAIN = chain(24)
GOOD = CHAIN + family(1, 3.0, at=[0.2, 1.0])
TASKS = "[family], [equilibrium], [orbit], [solution], [design], [dynamics], [export] or [spectrum]"


def test_help_and_version_are_there(cli: Cli) -> None:
    for command in ("", "run", "check", "spectrum", "tradeoff"):
        done = cli(*command.split(), "--help")
        assert done.status == 0
        assert "usage: casadi-skin" in done.out
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


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize(
    ("text", "place"),
    [
        (GOOD.replace("[family]", "[famly]"), "[famly]"),
        (GOOD.replace("mode = 1", "mode = 25"), "[family] mode"),
        (GOOD + "[design]\nquantity = 'S'\nover = ['S']\n", "[design]"),
        (CHAIN + "[dynamics]\nmode = 70\nsize = 0.1\nduration = 10.0\n", "[dynamics] mode: given 70"),
        (CHAIN.replace("[chain]", "[chain"), "not TOML"),
        ("\x00", "not TOML"),
        (CHAIN, TASKS),
    ],
)
def test_bad_scenes_are_refused_in_one_line_and_nothing_is_written(
    text: str, place: str, command: str, run: Runs
) -> None:
    if (text, command) == (CHAIN, "check"):
        return
    done = run(text, command=command, status=2)
    assert place in done.line
    assert str(run.scene) in done.line
    assert done.out == ""
    assert not run.out.exists()


def test_the_plan_tells_what_is_built_and_what_is_not(run: Runs) -> None:
    plan = run(GOOD, command="check").out
    for words in ("quarter of the period", "not built     the variational system", "ipopt", "check --measure"):
        assert words in plan
    measured = run(GOOD, "--measure", command="check").out
    for words in ("non-zeros", "expected cost"):
        assert words in measured
        assert words not in plan
    unknowns = [next(line for line in text.splitlines() if line.startswith("unknowns")) for text in (plan, measured)]
    assert unknowns[0].split()[1] == unknowns[1].split()[1]  # their number
    assert set(plan.splitlines()[:-1]) - {unknowns[0]} <= set(measured.splitlines())
    plan = run(GOOD + "\n[stability]\n", command="check").out
    assert "not built" not in plan
    assert "variational system with the splitting flow" in plan


@pytest.mark.usefixtures("pictures")
def test_spectrum_prints_and_writes_the_linear_frequencies(run: Runs) -> None:
    printed, closed = (  # without files in closed form, without numerics
        [float(line.split()[1]) for line in run(GOOD, *to, command="spectrum").out.splitlines()[1:]]
        for to in (["--out", str(run.out)], [])
    )
    dense = np.sqrt(np.sort(np.linalg.eigvals(Chain(24, 1.0, 0.25, -1.0).dynamical_matrix()).real))
    np.testing.assert_allclose(printed, dense, rtol=1e-12)
    np.testing.assert_allclose(closed, printed, rtol=2e-15)
    assert {"spectrum.csv", "spectrum.png"} <= run.files
    assert not {"numpy", "casadi", "scipy"} & modules_of("spectrum", str(run.scene))
    run(chain(24, -1.5), command="spectrum", status=2)
    run(chain(24, g=0.0) + "[spectrum]\n", "--overwrite")  # no nonlinearity
    assert "spectrum.csv" in run.files
