"""Amplitudes and coefficients from the smallest to the largest double: computed, or refused with the true reason."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ellipk

from casadi_skin import Chain, follow_family
from casadi_skin.runs.program import main

pytestmark = pytest.mark.usefixtures("pictures")


def write(
    folder: Path, sites: int = 3, alpha: float = 1.0, gamma: float = 0.25, g: float = 1.0, S: float = 1.0,
    rest: str = "",
) -> Path:  # fmt: skip
    chain = f"[chain]\nsites = {sites}\nalpha = {alpha!r}\ngamma = {gamma!r}\ng = {g!r}\n"
    path = folder / "scene.toml"
    path.write_text(f"{chain}[family]\nmode = 1\namplitude_max = {S!r}\n{rest}", encoding="utf-8")
    return path


def end_of(folder: Path) -> dict[str, str]:
    with (folder / "family.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))[-1]


@pytest.mark.slow
@pytest.mark.parametrize(
    "rest",
    ["", "[stability]\n", *(pytest.param(f"[method]\n{m}\n", marks=pytest.mark.slow) for m in (
        'walker = "arclength"', 'transcription = "gauss"', 'transcription = "shooting"'))],
)  # fmt: skip
@pytest.mark.parametrize(("g", "S"), [(1.0, 1e-149), (-1e-149, 1.0), (1e200, 1e-300), (1e280, 1e-300)])
def test_amplitudes_next_to_nothing_give_the_linear_mode(g: float, S: float, rest: str, tmp_path: Path) -> None:
    assert main(["run", str(write(tmp_path, g=g, S=S, rest=rest)), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    last = end_of(tmp_path / "out")
    linear = math.sqrt(3.0 + 2.0 * math.sqrt(1.0 - 0.25**2) * math.cos(3 * math.pi / 4))
    assert float(last["S"]) == S
    assert float(last["Omega"]) == pytest.approx(linear, rel=1e-12)


def test_only_the_product_of_coefficient_and_amplitude_counts(tmp_path: Path) -> None:
    assert main(["run", str(write(tmp_path, g=1e-300, S=1e300)), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    known = follow_family(Chain(3, 1.0, 0.25, 1.0), 1, 1.0)
    last = end_of(tmp_path / "out")
    assert float(last["S"]) == 1e300
    assert float(last["Omega"]) == pytest.approx(known.Omega[-1], rel=1e-8)


@pytest.mark.parametrize(
    ("g", "S", "rest", "words"),
    [
        (-1.0, 1e-160, "", "has the size 1e-160 there; accepted: sizes from 1e-150 to 1e+150"),
        (-1.0, 1e-300, "[stability]\n", "has the size 1e-300 there"),
        (1e-200, 1.0, "", "has the size 1e-200 there"),
        (1e-300, 1e-300, "", "has the size 0 there"),
        (1.0, 1.7e308, "", "has the size 1.7e+308 there"),
        (1e300, 1e300, "", "has the size inf there"),
        (-1e-308, 1.7e308, "", "amplitude_max: given 1.7e+308; accepted: a number up to 1e+300"),
        (1.0, 1.0, "at = [1e-300]\n", "at: given 1e-300"),
    ],
)
def test_sizes_beyond_double_precision_are_refused(
    g: float, S: float, rest: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(write(tmp_path, g=g, S=S, rest=rest)), "--out", str(tmp_path / "out")]) == 2
    told = capsys.readouterr().err
    assert words in told
    assert told.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        pytest.param({"sites": 1, "gamma": 0.0, "g": -1.0, "S": 3.0000001, "rest": "[stability]\n"},
         "times the linear one and grows without bound: S = 3.0000001 is too near its limit",
         marks=pytest.mark.slow),
        pytest.param({"g": 1e100}, "sizes too far apart for double precision", marks=pytest.mark.slow),
        ({"alpha": 1e8, "rest": '[accuracy]\ntolerance = 1e-12\n'
          '[method]\ntranscription = "shooting"\nwalker = "arclength"\n'},
         "mode 1: the orbit needs a finer discretisation than the finest there is"),
    ],
    ids=["beyond the softening limit", "a huge coefficient", "a stiff site"],
)  # fmt: skip
def test_a_family_that_cannot_be_followed_tells_the_true_reason(
    values: dict[str, float], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(write(tmp_path, **values)), "--out", str(tmp_path / "out"), "--quiet"]) == 1  # type: ignore[arg-type]
    told = capsys.readouterr().err
    assert words in told
    assert told.count("\n") == 1
    table = tmp_path / "out" / "family.csv"
    assert not table.exists() or float(end_of(tmp_path / "out")["S"]) > 0.0


def test_a_family_among_modes_that_nearly_coincide_is_named_in_resonance_or_ends_on_one_site() -> None:
    """Linear frequencies 1.1e-8 apart: rounding decides whether the first steps hold, and either end is right."""
    branch = follow_family(Chain(3, 1.0, 1.0 - 1e-15, -1.0), 1, 1.0)
    assert np.all(branch.S > 0.0)
    if branch.complete:  # one site alone, y'' = -3 y + y^3 with y(0) = 1: y = sn(t sqrt(5/2)) with m = 1/5
        assert branch.Omega[-1] == pytest.approx(math.pi * math.sqrt(2.5) / (2.0 * ellipk(0.2)), rel=1e-9)
    else:
        assert "of a 1:1 resonance of modes 1 and 2, where no family starts alone" in branch.reason
