"""Amplitudes and coefficients from the smallest to the largest double: computed, or ended with the true reason."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scenes import Runs, chain, family
from scipy.special import ellipk

from casadi_skin import Chain, follow_family

pytestmark = pytest.mark.usefixtures("pictures")


@pytest.mark.slow
@pytest.mark.parametrize(
    "rest",
    ["", "[stability]\n", *(pytest.param(f"[method]\n{m}\n", marks=pytest.mark.slow) for m in (
        'walker = "arclength"', 'transcription = "gauss"', 'transcription = "shooting"'))],
)  # fmt: skip
@pytest.mark.parametrize(("g", "S"), [(1.0, 1e-149), (-1e-149, 1.0), (1e200, 1e-300), (1e280, 1e-300)])
def test_amplitudes_next_to_nothing_give_the_linear_mode(g: float, S: float, rest: str, run: Runs) -> None:
    run(chain(3, g=g) + family(1, S) + rest, "--quiet")
    last = run.rows("family")[-1]
    linear = math.sqrt(3.0 + 2.0 * math.sqrt(1.0 - 0.25**2) * math.cos(3 * math.pi / 4))
    assert float(last["S"]) == S
    assert float(last["Omega"]) == pytest.approx(linear, rel=1e-12)


def test_only_the_product_of_coefficient_and_amplitude_counts(run: Runs) -> None:
    run(chain(3, g=1e-300) + family(1, 1e300), "--quiet")
    known = follow_family(Chain(3, 1.0, 0.25, 1.0), 1, 1.0)
    last = run.rows("family")[-1]
    assert float(last["S"]) == 1e300
    assert float(last["Omega"]) == pytest.approx(known.Omega[-1], rel=1e-8)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        pytest.param(chain(1, gamma=0.0) + family(1, 3.0000001) + "[stability]\n",
         "times the linear one and grows without bound: S = 3.0000001 is too near its limit",
         marks=pytest.mark.slow),
        pytest.param(chain(3, g=1e100) + family(), "sizes too far apart for double precision", marks=pytest.mark.slow),
        (chain(3, 1e8, g=1.0) + family() + '[accuracy]\ntolerance = 1e-12\n'
         '[method]\ntranscription = "shooting"\nwalker = "arclength"\n',
         "mode 1: the orbit needs a finer discretisation than the finest there is"),
    ],
    ids=["beyond the softening limit", "a huge coefficient", "a stiff site"],
)  # fmt: skip
def test_a_family_that_cannot_be_followed_tells_the_true_reason(text: str, words: str, run: Runs) -> None:
    told = run(text, "--quiet", status=1).err
    assert words in told
    assert told.count("\n") == 1
    assert "family.csv" not in run.files or float(run.rows("family")[-1]["S"]) > 0.0


def test_a_family_among_modes_that_nearly_coincide_is_named_in_resonance_or_ends_on_one_site() -> None:
    """Linear frequencies 1.1e-8 apart: rounding decides whether the first steps hold, and either end is right."""
    branch = follow_family(Chain(3, 1.0, 1.0 - 1e-15, -1.0), 1, 1.0)
    assert np.all(branch.S > 0.0)
    if branch.complete:  # one site alone, y'' = -3 y + y^3 with y(0) = 1: y = sn(t sqrt(5/2)) with m = 1/5
        assert branch.Omega[-1] == pytest.approx(math.pi * math.sqrt(2.5) / (2.0 * ellipk(0.2)), rel=1e-9)
    else:
        assert "of a 1:1 resonance of modes 1 and 2, where no family starts alone" in branch.reason
