"""Scenes of lattices: what `check` prints, and what `run` writes; refusals are among tests/unit/refused_models.txt."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import Runs, chain, family, lattice
from scipy.special import ellipk

from casadi_skin import Bond, Lattice, Site, follow_family

CELLS = lattice(
    12, "alpha*y + g*y^3", parameters={"alpha": 1.0, "gamma": 0.25, "g": -1.0}, force="d",
    gain=["1 - gamma", "1 + gamma"],
)  # fmt: skip
REST = "[spectrum]\n" + family(at=[0.2]) + "[stability]\nevents = false\n"


def test_check_prints_what_the_lattice_shows_of_itself(run: Runs) -> None:
    printed = " ".join(run(CELLS + REST, command="check").out.split())
    for words in (
        "12 cells of 1, 12 sites, 1 bonds a cell; ends fixed", "alpha = 1, gamma = 0.25, g = -1",
        "a diagonal one; displacements lean by a factor of up to 16.6", "Hamiltonian and reversible",
        "polynomial, odd", "conserved energy", "mirrors none",
    ):  # fmt: skip
        assert words in printed


@pytest.mark.slow
def test_lattices_run_as_the_chain_does(run: Runs) -> None:
    """By the chain of the same scene: of twelve cells, and of infinitely many."""
    endless = CELLS.replace("cells = 12", "cells = inf").replace('"g" = -1.0', '"g" = 1.0')
    edge = family("last") + "[accuracy]\ntolerance = 1e-9\n[stability]\n"
    for cells, rest, sites, g in ((CELLS, REST, 12, -1.0), (endless, edge, float("inf"), 1.0)):
        found, spectra = [], []
        for text in (chain(sites, g=g), cells):
            run(text + rest, "--overwrite")
            found.append(run.columns("family", "Omega", "Omega_shift", "energy", "max_abs_multiplier"))
            spectra += run.columns("spectrum", "omega") if "spectrum" in rest else []
        for one, other, allowed in zip(*found, (1e-13, 1e-9, 1e-11, 1e-8), strict=True):
            assert one[-1] == pytest.approx(other[-1], rel=allowed)
        if spectra:
            assert spectra[0] == pytest.approx(spectra[1], rel=1e-13)
    printed = " ".join(run(command="check").out.split())
    assert "inf cells of 1, 1 bonds a cell; ends fixed; a linear tail behind the last cells" in printed
    assert "edge modes 1.03127 (pinned to a band), 2.22182 (pinned to a band)" in printed


def test_an_orbit_of_a_lattice_is_followed_in_the_value_that_selects_it(run: Runs) -> None:
    """The orbit with y_2 = 0.6 at rest against the family of the lowest mode at the same amplitude."""
    cells = lattice([3], "k*y + b*y^3", parameters={"k": 1.0, "b": 1.0}, force="d")
    orbit = "[orbit]\nstart = [0.1, 0.14, 0.1, 0, 0, 0]\nperiod = 4.9\nselect = { y_2 = 0.14 }\nsymmetric = true\n"
    run(cells + orbit + '[continuation]\nparameter = "select"\nto = 0.6\n[figures]\nformats = []\n', "--quiet")
    last = run.rows("branch")[-1]
    assert abs(float(last["y_2_max"]) - 0.6) < 1e-15  # rounding of the condition that selects it
    S = 0.36 + 2.0 * float(last["y_1_max"]) ** 2
    model = Lattice([3], [Site("a", "k*y + b*y^3")], [Bond("a", "a", [1], "d")], parameters={"k": 1.0, "b": 1.0})
    assert float(last["period"]) == pytest.approx(follow_family(model, 1, S, at=[S]).at(S=S).period, rel=1e-7)


def test_an_orbit_of_a_lattice_is_followed_at_its_frequency(run: Runs) -> None:
    """One site, y'' = -k y - y^3, whose period by elliptic functions is that of the start at every k."""
    cells = lattice([1], "k*y + y^3", parameters={"k": 1.0}, force="0*d")
    orbit = "[orbit]\nstart = [1.0, 0.0]\nperiod = 4.77\nselect = { y_1 = 1.0 }\nsymmetric = true\n"
    run(cells + orbit + '[continuation]\nparameter = "k"\nto = 0.5\nfixed = "frequency"\n[figures]\nformats = []\n')
    first, *_, last = run.rows("branch")
    assert float(last["period"]) == pytest.approx(float(first["period"]), rel=1e-12)
    square = float(last["y_1_max"]) ** 2
    assert float(last["period"]) == pytest.approx(4.0 * ellipk(0.5 * square / (0.5 + square)) / np.sqrt(0.5 + square))
