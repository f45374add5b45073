"""Scenes of infinite and very long chains from the command line: files, the threshold, resuming, what is refused."""

from __future__ import annotations

import signal
from pathlib import Path

import numpy as np
import pytest
from apart import ended
from outputs import read_rows
from scenes import Cli
from scipy.io import netcdf_file

from casadi_skin import Chain
from casadi_skin.runs.program import main

pytestmark = pytest.mark.usefixtures("blank")

EXAMPLES = Path(__file__).parents[2] / "examples"
SCENE = """
[chain]
sites = {sites}
alpha = {alpha}
gamma = 0.25
g = {g}
[family]
mode = {mode}
amplitude_max = 1.0
at = [0.2, 1.0]
[method]
corrector = "newton"
{rest}
"""


def written(path: Path, **values: object) -> Path:
    filled = {"sites": "inf", "alpha": 1.0, "g": 1.0, "mode": '"last"', "rest": ""} | values
    path.write_text(SCENE.format(**filled), encoding="utf-8")
    return path


@pytest.mark.usefixtures("pictures")
@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "rest", "regime"),
    [
        ("3.0", '[method]\ncorrector = "newton"\n', "bound"),
        pytest.param("3.2", "", "third", marks=pytest.mark.slow),  # of the third harmonic, slow to follow
    ],
)
def test_the_example_of_an_infinite_chain(
    tmp_path: Path, end: str, rest: str, regime: str, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    text = (EXAMPLES / "infinite_chain.toml").read_text(encoding="utf-8")
    assert "amplitude_max = 3.2" in text
    scene.write_text(text.replace("amplitude_max = 3.2", f"amplitude_max = {end}") + rest, encoding="utf-8")
    assert main(["run", str(scene), "--out", str(out)]) == 0
    assert "end breather of the infinite chain born at S_c = 0.3669929036" in capsys.readouterr().out
    points = read_rows(out / "family.csv")
    asked = {float(row["S"]): row for row in points if row["requested"] == "1"}
    assert float(asked[3.0]["Omega"]) == pytest.approx(0.7659589000207, abs=1e-8)
    assert asked[0.2]["energy"] == ""
    assert float(asked[0.2]["Omega_shift"]) == 0.0
    assert [points[0]["regime"], asked[1.0]["regime"], points[-1]["regime"]] == ["pinned", "bound", regime]
    with netcdf_file(out / "family.nc", mmap=False) as file:
        assert np.isinf(file.sites)
        sites, profile = file.variables["site"].data, file.variables["profile"].data
        assert sites[-1] == 0
        assert sites[0] == 1 - sites.size
        np.testing.assert_allclose(np.linalg.norm(profile, axis=1) ** 2, file.variables["S"].data, rtol=1e-7)


@pytest.mark.slow
@pytest.mark.usefixtures("interruptible")
def test_a_million_sites_resume_to_the_same_bytes(tmp_path: Path) -> None:
    scene = written(tmp_path / "million.toml", sites=1_000_000)
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert main(["run", str(scene), "--out", str(whole), "--quiet"]) == 0
    assert ended(signal.SIGINT, 13, scene, broken) == 130
    assert 1 < len(read_rows(broken / "family.csv")) < len(read_rows(whole / "family.csv"))
    assert main(["run", str(scene), "--out", str(broken), "--quiet", "--resume"]) == 0
    assert (whole / "family.csv").read_bytes() == (broken / "family.csv").read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("interruptible")
def test_stability_of_an_infinite_chain_resumes_to_the_same_bytes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = written(tmp_path / "stable.toml", rest="[stability]\nsites = 120")
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert main(["check", str(scene)]) == 0
    assert "localised multipliers, on 120 sites at the edge" in capsys.readouterr().out
    assert main(["run", str(scene), "--out", str(whole), "--quiet"]) == 0
    assert (whole / "multipliers_j-1.png").exists()
    assert (whole / "events.csv").exists()
    assert ended(signal.SIGINT, 13, scene, broken) == 130
    assert main(["run", str(scene), "--out", str(broken), "--quiet", "--resume"]) == 0
    for table in ("family.csv", "events.csv"):
        assert (whole / table).read_bytes() == (broken / table).read_bytes()
    rows = read_rows(whole / "family.csv")
    assert {row["stability_sites"] for row in rows} == {"120"}
    assert rows[0]["localised"] == "0"
    with netcdf_file(whole / "family.nc", mmap=False) as file:
        period = file.variables["arc_end"].data[:, 0] / np.sqrt(Chain(1, 1.0, 0.25, 1.0).band()[1])
        np.testing.assert_allclose(period, 2.0 * np.pi / file.variables["Omega"].data, rtol=1e-14)


def test_the_plan_tells_what_is_eliminated(tmp_path: Path, cli: Cli) -> None:
    plan = cli("check", written(tmp_path / "long.toml", sites=1000)).out
    assert "the linear tail is eliminated exactly" in plan
    assert "eliminated" not in cli("check", written(tmp_path / "full.toml", sites=1000, rest='tail = "full"')).out


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"mode": 3}, '[family] mode: given 3; accepted: "last"'),
        ({"mode": '"first"'}, '[family] mode: given "first"; accepted: "last"'),
        ({"mode": '"middle"'}, "[family] mode: given"),
        ({"sites": 2000, "mode": 2001}, "accepted: whole numbers from 1 to 2000 (sites), first, last"),
        ({"sites": 2000, "mode": 5, "rest": 'tail = "eliminated"'}, "[method] tail: given"),
        ({"rest": 'tail = "full"'}, "[method] tail: given"),
        ({"g": -1.0, "alpha": 0.1, "mode": '"first"'}, "three times the lowest frequency"),
        ({"rest": "[stability]\nvectors = true"}, "[stability] vectors: given true with sites = inf"),
        ({"rest": "[stability]\nsites = 20"}, "[stability] sites: given 20; accepted: 90 to inf: so many sites"),
        (
            {"sites": 24, "rest": "[stability]\nsites = 20"},
            "[stability] sites: given 20; accepted: with more than 92 sites",
        ),
        ({"rest": "[spectrum]"}, "[spectrum]: given with sites = inf"),
        ({"rest": "[dynamics]\nS = 1.0\nperiods = 2.0"}, "[dynamics]: given with sites = inf"),
        ({"sites": "-inf"}, "[chain] sites: given"),
        ({"sites": "1e6"}, "[chain] sites: given"),
    ],
)
def test_what_an_infinite_chain_does_not_have_is_refused_in_a_line(
    tmp_path: Path, cli: Cli, values: dict[str, object], words: str
) -> None:
    scene = written(tmp_path / "wrong.toml", **values)
    for command in (["run", scene, "--out", tmp_path / "out"], ["check", scene]):
        assert words in cli(*command).line
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("key", ["growth = 0.1", "boundary = true"])
def test_maps_of_infinite_chains_have_no_changes_of_stability(tmp_path: Path, cli: Cli, key: str) -> None:
    scene = written(tmp_path / "map.toml", rest=f"[stability]\n[map]\ngamma = [0.5, 0.6]\n{key}")
    line = cli("map", scene, "--out", tmp_path / "out").line
    assert f"[map] {key.split()[0]}: given with sites = inf" in line
