"""Scenes of lattices: what `check` prints, what `run` writes, and where faults are told."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from casadi_skin import Bond, Lattice, Site, follow_family
from casadi_skin.runs.program import main

CHAIN = """
[lattice]
cells = 12
parameters = { alpha = 1.0, gamma = 0.25, g = -1.0 }

[[lattice.site]]
name = "a"
onsite = "alpha*y + g*y^3"

[[lattice.bond]]
from = "a"
to = "a"
offset = [1]
force = "d"
gain = ["1 - gamma", "1 + gamma"]

[spectrum]

[family]
mode = 1
amplitude_max = 1.0
at = [0.2]

[stability]
events = false
"""


def column(path: Path, name: str) -> np.ndarray:
    """A column of a CSV file."""
    return np.atleast_1d(np.genfromtxt(path, delimiter=",", names=True)[name])


def test_check_prints_what_the_lattice_shows_of_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.toml").write_text(CHAIN)
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for words in (
        "12 cells of 1, 12 sites, 1 bonds a cell; ends fixed", "alpha = 1, gamma = 0.25, g = -1",
        "a diagonal one; displacements lean by a factor of up to 16.6", "Hamiltonian and reversible",
        "polynomial, odd", "conserved energy", "mirrors none",
    ):  # fmt: skip
        assert words in printed


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"alpha*y', '"alhpa*y', '[lattice] site 1 onsite: column 1: given the name "alhpa"; accepted: y, alpha'),
        ('force = "d"', 'forec = "d"', "[[lattice.bond]] 1 forec: unknown key; did you mean 'force'?"),
        ("offset = [1]", "offset = [1.5]", "[[lattice.bond]] 1 offset: given [1.5] (an array); accepted: a list of"),
        ('to = "a"', 'to = "b"', "[lattice] bond 1 to: given 'b'; accepted: a"),
        ('name = "a"', "", "[[lattice.site]] 1 name: missing; accepted: a name"),
        ("cells = 12", "cells = 0", "[lattice] cells: given 0; accepted: a whole number >= 1, inf, or a list"),
        ('"1 - gamma"', '"1 - 4*gamma"', '[lattice] bond 1 gain 1: given "1 - 4*gamma", which is 0 in cell 1'),
        ("g = -1.0", "g = [1.0]", "[lattice] parameters g: given numbers of shape [1]; accepted: 12 finite numbers"),
        ("alpha = 1.0", "alpha = -3", "does not oscillate: omega^2 = -"),
        ("[[lattice.site]]", "[lattice.site]", "[lattice] site: given a table; accepted: one table [[lattice.site]]"),
        ("[lattice]", '[lattice]\nboundary = "perodic"', 'given "perodic"; did you mean "periodic"?'),
        ("[spectrum]", "[model]\nfile = 'm.py'", "[lattice]: given beside [model]; accepted: [chain], [lattice] or"),
        ("[family]", "[solution]\nguess = 'g'\n[family]", "[solution]"),
    ],
)
def test_faults_are_told_in_one_line_with_the_place(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], old: str, new: str, message: str
) -> None:
    (tmp_path / "scene.toml").write_text(CHAIN.replace(old, new, 1))
    assert main(["check", str(tmp_path / "scene.toml")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert message in error


@pytest.mark.slow
def test_lattices_run_as_the_chain_does_and_what_needs_all_sites_is_refused_of_an_endless_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the chain of the same scene: of twelve cells, and of infinitely many."""

    def run(name: str, text: str) -> tuple[float, ...]:
        (tmp_path / f"{name}.toml").write_text(text)
        assert main(["run", str(tmp_path / f"{name}.toml"), "--out", str(tmp_path / name), "--quiet"]) == 0
        columns = ("Omega", "Omega_shift", "energy", "max_abs_multiplier")
        return tuple(column(tmp_path / name / "family.csv", quantity)[-1] for quantity in columns)

    def refused(name: str, text: str) -> str:
        (tmp_path / f"{name}.toml").write_text(text)
        assert main(["check", str(tmp_path / f"{name}.toml")]) == 2
        return capsys.readouterr().err

    endless = CHAIN.replace("cells = 12", "cells = inf").replace("g = -1.0", "g = 1.0").partition("[spectrum]")[0]
    family = '[family]\nmode = "last"\namplitude_max = 1.0\n[accuracy]\ntolerance = 1e-9\n'
    rest = "[spectrum]" + CHAIN.partition("[spectrum]")[2]
    short = CHAIN.partition("[spectrum]")[0]
    cases = (("short", short, rest, 12, -1.0), ("long", endless, f"{family}[stability]\n", "inf", 1.0))
    for name, lattice, more, sites, g in cases:
        chain = f"[chain]\nsites = {sites}\nalpha = 1.0\ngamma = 0.25\ng = {g}\n"
        mine, theirs = run(name, lattice + more), run(f"{name}_chain", chain + more)
        for one, other, allowed in zip(mine, theirs, (1e-13, 1e-9, 1e-11, 1e-8), strict=True):
            assert one == pytest.approx(other, rel=allowed)
    spectra = [column(tmp_path / name / "spectrum.csv", "omega") for name in ("short", "short_chain")]
    assert spectra[0] == pytest.approx(spectra[1], rel=1e-13)
    assert main(["check", str(tmp_path / "long.toml")]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "inf cells of 1, 1 bonds a cell; ends fixed; a linear tail behind the last cells" in printed
    assert "edge modes 1.03127 (pinned to a band), 2.22182 (pinned to a band)" in printed
    vectors = refused("vectors", endless + family + "[stability]\nvectors = true\n")
    assert "[stability] vectors: given true with a linear tail" in vectors
    moving = refused("moving", endless + family + "[dynamics]\nduration = 1.0\n")
    assert "[dynamics]: given with a linear tail (edge, or more than 100000 cells)" in moving


def test_an_orbit_of_a_lattice_is_followed_in_the_value_that_selects_it(tmp_path: Path) -> None:
    """The orbit with y_2 = 0.6 at rest against the family of the lowest mode at the same amplitude."""
    lattice = (
        "[lattice]\ncells = [3]\nparameters = { k = 1.0, b = 1.0 }\n"
        '[[lattice.site]]\nname = "a"\nonsite = "k*y + b*y^3"\n'
        '[[lattice.bond]]\nfrom = "a"\nto = "a"\noffset = [1]\nforce = "d"\n'
    )
    orbit = "[orbit]\nstart = [0.1, 0.14, 0.1, 0, 0, 0]\nperiod = 4.9\nselect = { y_2 = 0.14 }\nsymmetric = true\n"
    rest = '[continuation]\nparameter = "select"\nto = 0.6\n[figures]\nformats = []\n'
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(lattice + orbit + rest, encoding="utf-8")
    assert main(["run", str(scene), "--out", str(out), "--quiet"]) == 0
    with (out / "branch.csv").open(encoding="utf-8", newline="") as file:
        *_, last = csv.DictReader(file)
    assert float(last["y_2_max"]) == 0.6
    S = 0.36 + 2.0 * float(last["y_1_max"]) ** 2
    model = Lattice([3], [Site("a", "k*y + b*y^3")], [Bond("a", "a", [1], "d")], parameters={"k": 1.0, "b": 1.0})
    assert float(last["period"]) == pytest.approx(follow_family(model, 1, S, at=[S]).at(S=S).period, rel=1e-7)
