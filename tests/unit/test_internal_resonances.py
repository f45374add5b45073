"""Linear modes in exact or nearly exact resonances: no family starts alone, and the message says why."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from lattices import GAINS
from scipy.optimize import brentq

from casadi_skin import Bond, Chain, Lattice, OdeModel, Site, follow_family
from casadi_skin.runs.program import main

RESONANT = Chain(10, 0.3502681971412418, 0.2, 1)  # 3 omega_1 = omega_10


def alpha_at(sites: int, harmonic: int) -> float:
    """Where the highest frequency of a chain with gamma = 0.1 is a multiple of the lowest."""

    def excess(alpha: float) -> float:
        frequencies = Chain(sites, alpha, 0.1, 1).linear_frequencies()
        return float(harmonic * frequencies[0] - frequencies[-1])

    return float(brentq(excess, 1e-3, 10.0, xtol=1e-16))


def test_exact_resonance_of_a_chain_names_mode_and_harmonic() -> None:
    assert 3 * RESONANT.linear_frequencies()[0] == pytest.approx(RESONANT.linear_frequencies()[9], rel=1e-14)
    words = r"^mode: .* an internal resonance at harmonic 3 \(3 omega_1 = omega_10 = 2\.05681373.\)"
    with pytest.raises(ValueError, match=words):
        follow_family(RESONANT, mode=1, amplitude_max=1.0)


def test_exact_resonance_at_the_fifth_harmonic_is_named() -> None:
    with pytest.raises(ValueError, match=r"an internal resonance at harmonic 5 \(5 omega_1 = omega_12"):
        follow_family(Chain(12, alpha_at(12, 5), 0.1, 1), mode=1, amplitude_max=0.5)


def test_resonance_that_is_nearly_exact_is_named_where_the_family_ends() -> None:
    branch = follow_family(Chain(12, alpha_at(12, 5) + 1e-10, 0.1, 1), mode=1, amplitude_max=0.5)
    assert not branch.complete
    assert "of an internal resonance at harmonic 5 (5 omega_1 = omega_12" in branch.reason


def test_exact_resonances_of_lattices_and_of_other_models_are_named() -> None:
    parameters = {"alpha": RESONANT.alpha, "gamma": 0.2}
    lattice = Lattice(10, [Site("a", "alpha*y + sinh(y)^3")], [Bond("a", "a", (1,), gain=GAINS)], "fixed", parameters)
    with pytest.raises(ValueError, match=r"resonance at harmonic 3 \(3 omega_1 = omega_10"):
        follow_family(lattice, mode=1, amplitude_max=1.0)
    y, v = ca.SX.sym("y", 2), ca.SX.sym("v", 2)
    force = -ca.vertcat(y[0] + y[0] ** 2 * y[1], 4 * y[1] + y[0] ** 3 / 3)
    model = OdeModel("pair", y, force, order=2, velocity=v, reversal=(1, 1, -1, -1))
    with pytest.raises(ValueError, match=r"resonance at harmonic 2 \(2 omega_1 = omega_2 = 2\)"):
        follow_family(model, mode=1, amplitude_max=0.1)


def test_modes_of_a_ring_come_in_pairs_and_the_message_has_those_that_are_alone() -> None:
    ring = Lattice(8, [Site("a")], [Bond("a", "a", (1,), "d + d^3")], "periodic")
    words = "modes 2, 3 of lattice have the same frequency: no family belongs to one of them alone, a 1:1 resonance"
    with pytest.raises(ValueError, match=f"^mode: {words}; accepted: a mode with a frequency of its own: 8$"):
        follow_family(ring, mode=2, amplitude_max=0.1)


def test_run_ends_in_one_line_at_an_exact_resonance(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = tmp_path / "scene.toml"
    chain = f"[chain]\nsites = 10\nalpha = {RESONANT.alpha!r}\ngamma = 0.2\ng = 1.0\n"
    scene.write_text(f"{chain}[family]\nmode = 1\namplitude_max = 1.0\n", encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--quiet"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    assert "[family] mode" in told
    assert "resonance at harmonic 3" in told


@pytest.mark.usefixtures("way")
@pytest.mark.parametrize("off", [1e-9, 1e-7])
def test_families_beside_a_resonance_are_followed(off: float) -> None:
    chain = Chain(10, RESONANT.alpha + off, 0.2, 1)
    branch = follow_family(chain, mode=1, amplitude_max=0.5)
    assert branch.complete
    assert np.all(branch.S > 0.0)
