"""Runs of scenes through the command line: files, resuming, interruption, families that end early."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from apart import Ended, ended, killed
from outputs import read_rows

from casadi_skin.runs.program import main
from casadi_skin.stability.family_stability import FLOWS

pytestmark = pytest.mark.usefixtures("blank")

Cli = Callable[..., Ended]
STABILITY_COLUMNS = ["max_abs_multiplier", "stable", "unstable_real", "unstable_complex", "multiplier_error"]
FAMILY_COLUMNS = [
    *("mode", "point", "requested", "S", "Omega", "Omega_shift", "period", "energy"),
    *STABILITY_COLUMNS,
    *("Omega_error", "residual"),
]

CHAIN = "[chain]\nsites = {sites}\nalpha = 1.0\ngamma = 0.25\ng = {g}\n"
FAMILY = "[family]\nmode = {mode}\namplitude_max = {end}\nat = {at}\n"


def write_scene(
    path: Path,
    sites: int = 6,
    g: float = -1.0,
    mode: str = "1",
    end: float = 1.0,
    at: str = "[0.2, 1.0]",
    rest: str = "",
) -> Path:
    text = CHAIN.format(sites=sites, g=g) + FAMILY.format(mode=mode, end=end, at=at) + rest
    path.write_text(text, encoding="utf-8")
    return path


def requested(directory: Path) -> dict[tuple[int, float], float]:
    """Omega at the requested points by mode and S."""
    table = read_rows(directory / "family.csv")
    return {(int(r["mode"]), float(r["S"])): float(r["Omega"]) for r in table if r["requested"] == "1"}


@pytest.mark.usefixtures("pictures")
def test_run_writes_tables_pictures_and_netcdf(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = write_scene(tmp_path / "small.toml", mode="[1, 4]", rest="[spectrum]\n[stability]\nvectors = true\n")
    out = tmp_path / "out"
    assert main(["run", str(scene), "--out", str(out)]) == 0
    names = {path.name for path in out.iterdir()}
    pictures = {f"{stem}.png" for stem in ("frequency", "profile", "spectrum")}
    assert (
        pictures
        | {"family.csv", "events.csv", "tongues.csv", "further_events.csv", "spectrum.csv", "family.nc", "scene.toml"}
        <= names
    )
    assert not any("journal" in name or name.startswith(".") for name in names)
    table = read_rows(out / "family.csv")
    assert list(table[0])[: len(FAMILY_COLUMNS)] == FAMILY_COLUMNS
    assert [r["mode"] for r in table] == sorted(r["mode"] for r in table)
    for mode in ("1", "4"):
        mine = [r for r in table if r["mode"] == mode]
        assert [int(r["point"]) for r in mine] == list(range(len(mine)))
        assert [float(r["S"]) for r in mine if r["requested"] == "1"] == [0.2, 1.0]
        assert float(mine[0]["S"]) < 1e-3
    assert np.all(np.isfinite([[float(v) for v in r.values()] for r in table]))
    header = (out / "events.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.startswith("mode,S,Omega,kind,stable_before,stable_after")
    assert "results in" in capsys.readouterr().out


def test_a_film_is_written_where_it_is_asked_for(tmp_path: Path) -> None:
    scene = tmp_path / "film.toml"
    text = CHAIN.format(sites=3, g=1.0) + FAMILY.format(mode="[1, 3]", end=0.5, at="[0.2]") + "film = true\n"
    scene.write_text(text, encoding="utf-8")
    out = tmp_path / "out"
    assert main(["run", str(scene), "--out", str(out)]) == 0
    assert sorted(p.name for p in out.glob("*.gif")) == ["film_j1.gif", "film_j3.gif"]
    assert main(["run", str(write_scene(tmp_path / "a.toml")), "--out", str(out), "--overwrite"]) == 0
    assert not list(out.glob("*.gif"))


def test_netcdf_is_readable_by_xarray_and_says_the_same_as_the_table(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    scene = write_scene(tmp_path / "small.toml", rest="[stability]\nvectors = true\n")
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    with xarray.open_dataset(tmp_path / "out" / "family.nc", engine="scipy") as data:
        table = read_rows(tmp_path / "out" / "family.csv")
        np.testing.assert_array_equal(data.Omega.values, [float(r["Omega"]) for r in table])
        assert (data.profile.values**2).sum(axis=1) == pytest.approx(data.S.values, rel=1e-12)
        at_zero = data.coefficients.values.sum(axis=1)
        np.testing.assert_allclose(at_zero, data.profile.values, atol=1e-14)
        assert data.vectors.shape == (2, 12, 12, 2)
        assert "sites = 6" in data.attrs["scene"]
        assert data.attrs["casadi_version"]
        moduli = np.hypot(*np.moveaxis(data.multipliers.values, -1, 0))
        assert moduli.max(axis=1) == pytest.approx(data.max_abs_multiplier.values, rel=1e-12)
        np.testing.assert_array_equal(data.multiplier_error.values, [float(r["multiplier_error"]) for r in table])
        assert np.all(data.multiplier_error.values >= data.mu_error.values.max(axis=1))


def test_without_stability_no_variational_system_is_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a variational system was built")

    for flow in FLOWS:
        monkeypatch.setitem(FLOWS, flow, refuse)
    scene = write_scene(tmp_path / "small.toml")
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    assert not set(STABILITY_COLUMNS) & set(read_rows(tmp_path / "out" / "family.csv")[0])
    assert not (tmp_path / "out" / "events.csv").exists()
    with pytest.raises(AssertionError, match="variational"):
        main(["run", str(write_scene(tmp_path / "b.toml", rest="[stability]\n")), "--out", str(tmp_path / "b")])


METHODS = (
    'corrector = "ipopt"',
    'transcription = "gauss"\ncorrector = "newton"',
    'corrector = "newton"',
    'flow = "cvodes"',
)


@pytest.mark.slow
def test_the_methods_of_a_scene_agree(tmp_path: Path) -> None:
    found = []
    for method in METHODS:
        rest = f"[stability]\nevents = false\n[accuracy]\ntolerance = 1e-9\n[method]\n{method}\n"
        scene = write_scene(tmp_path / "scene.toml", sites=3, g=1.0, mode="3", rest=rest)
        out = tmp_path / method[:18].replace('"', "").replace(" ", "")
        assert main(["run", str(scene), "--out", str(out), "--overwrite"]) == 0
        points = [r for r in read_rows(out / "family.csv") if r["requested"] == "1"]
        found.append([(float(r["Omega"]), float(r["max_abs_multiplier"])) for r in points])
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=0, atol=2e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "limit"),  # omega^2/|g| = 3 is where the period diverges; a mesh follows it to where S is 3 but for 1e-4
    [('transcription = "gauss"\ncorrector = "newton"\n', 3.0003), pytest.param("", 3.0, marks=pytest.mark.slow)],
    ids=["gauss", "standard"],
)
def test_a_softening_orbit_that_cannot_exist_ends_with_a_reason(
    tmp_path: Path, method: str, limit: float, capsys: pytest.CaptureFixture[str]
) -> None:
    rest = f'[accuracy]\npreset = "draft"\n[method]\n{method}'
    scene = write_scene(tmp_path / "duffing.toml", sites=1, end=5.0, at="[1.0, 4.0]", rest=rest)
    out = tmp_path / "out"
    assert main(["run", str(scene), "--out", str(out)]) == 1
    told = capsys.readouterr().err
    assert "mode 1" in told
    assert "does not exist at S = 5" in told
    table = read_rows(out / "family.csv")
    assert [float(r["S"]) for r in table if r["requested"] == "1"] == [1.0]
    assert 2.9 < max(float(r["S"]) for r in table) < limit
    assert main(["run", str(scene), "--out", str(out), "--resume"]) == 1
    assert read_rows(out / "family.csv") == table


# Interruption -------------------------------------------------------------------------------------------------------

SHORT = {"sites": 3, "mode": "[1, 2, 3]", "end": 1.0, "at": "[0.2, 0.5, 1.0]"}
LONG = {"sites": 100, "mode": "[1, 2, 3, 4, 57, 58, 59, 60]", "end": 3.0, "at": "[0.5, 2.0, 3.0]"}
SECONDS_TO_SECOND_SIGNAL = 2.5  # a signal is lost in some runs, measured in 1 to 2 of 40: a user gives another


def ended_from_outside(number: signal.Signals, scene: Path, out: Path) -> int:
    """Exit status of a run in a process of its own that gets a signal when its journal has some length."""
    command = [sys.executable, "-m", "casadi_skin.runs.program", "run", str(scene), "--out", str(out)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    journal = out / "journal.msgpack"
    while not journal.exists() or journal.stat().st_size < 100_000:
        assert process.poll() is None, process.communicate()
        time.sleep(0.01)
    process.send_signal(number)
    try:
        told = process.communicate(timeout=SECONDS_TO_SECOND_SIGNAL)[1]
    except subprocess.TimeoutExpired:
        process.send_signal(number)
        told = process.communicate()[1]
    print(told, end="", file=sys.stderr)
    return process.returncode


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, *(pytest.param(n, marks=pytest.mark.slow) for n in (15, 9))])
@pytest.mark.parametrize("chain", [SHORT, pytest.param(LONG, marks=pytest.mark.slow)], ids=["short", "long"])
def test_a_run_that_is_ended_keeps_its_points_and_resumes_to_the_same_result(
    tmp_path: Path, chain: dict[str, Any], number: int, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = write_scene(tmp_path / "scene.toml", **chain, rest="[stability]\nevents = false\n")
    out, whole, was_killed = tmp_path / "out", tmp_path / "whole", number == signal.SIGKILL
    end = ended_from_outside if chain is LONG else partial(ended, records=20)
    status = (
        killed(12, scene, out) if was_killed and chain is SHORT else end(signal.Signals(number), scene=scene, out=out)
    )
    assert status == (-9 if was_killed else 130)
    told = capsys.readouterr().err
    assert "Traceback" not in told
    assert ("--resume" in told) != was_killed
    assert (out / "journal.msgpack").stat().st_size > 0
    if was_killed:
        with (out / "journal.msgpack").open("ab") as journal:
            journal.write(b"\xff\x00\x00\x00 half a record")
    else:
        assert len(read_rows(out / "family.csv")) > 1
    assert (out / "family.nc").exists() != was_killed
    assert main(["run", str(scene), "--out", str(out), "--resume", "--quiet"]) == 0
    assert main(["run", str(scene), "--out", str(whole), "--quiet"]) == 0
    resumed, expected = requested(out), requested(whole)
    assert list(resumed) == list(expected)
    np.testing.assert_allclose(list(resumed.values()), list(expected.values()), rtol=0, atol=1e-10)
    assert len(read_rows(out / "family.csv")) == len(read_rows(whole / "family.csv"))


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "map"])
def test_a_limit_of_time_ends_a_command_in_one_line(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    axes = "[map]\ngamma = { from = 0.1, to = 0.2, points = 2 }\n" if command == "map" else ""
    scene, out, whole = write_scene(tmp_path / "scene.toml", rest=axes), tmp_path / "out", tmp_path / "whole"
    text = scene.read_text(encoding="utf-8")
    options = ["--quiet", *(["--no-pictures"] if command == "map" else [])]
    assert main([command, str(scene), "--out", str(whole), *options]) == 0
    scene.write_text("time_limit = 1e-3\n" + text, encoding="utf-8")
    assert main([command, str(scene), "--out", str(out), *options]) == 1
    words = f"scene.toml: time_limit: 0.001 s are over; what was computed is in {out}; go on with --resume\n"
    assert capsys.readouterr().err.endswith(words)
    scene.write_text("time_limit = 1e6\n" + text, encoding="utf-8")
    assert main([command, str(scene), "--out", str(out), "--resume", *options]) == 0
    if command == "run":
        assert (out / "family.csv").read_bytes() == (whole / "family.csv").read_bytes()
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


def test_resume_wants_the_same_scene_but_for_its_title(tmp_path: Path, cli: Cli) -> None:
    out, scene, titled = tmp_path / "out", write_scene(tmp_path / "a.toml"), tmp_path / "b.toml"
    assert cli("run", scene, "--out", out).status == 0
    titled.write_text('title = "another"\n' + scene.read_text(encoding="utf-8"), encoding="utf-8")
    assert cli("run", titled, "--out", out, "--resume").status == 0
    other = write_scene(tmp_path / "c.toml", sites=7)
    assert "[chain] differs" in cli("run", other, "--out", out, "--resume").line


@pytest.mark.parametrize(
    ("name", "cut"), [("family.nc", 0), ("family.nc", 0.03), ("family.nc", 0.9), ("family.csv", 0.9)]
)
def test_resume_of_a_complete_run_names_a_file_that_was_cut_off(
    name: str, cut: float, tmp_path: Path, cli: Cli
) -> None:
    out, scene = tmp_path / "out", write_scene(tmp_path / "a.toml", sites=3, end=0.2, at="[0.2]")
    assert cli("run", scene, "--out", out, "--quiet").status == 0
    whole = (out / name).read_bytes()
    (out / name).write_bytes(whole[: int(cut * len(whole))])
    told = cli("run", scene, "--out", out, "--resume").line
    assert f"{out / name}: damaged" in told
    assert "--overwrite" in told
    assert cli("run", scene, "--out", out, "--overwrite", "--quiet").status == 0
    assert (out / name).read_bytes() == whole
    assert cli("run", scene, "--out", out, "--resume", "--quiet").status == 0


# Directories --------------------------------------------------------------------------------------------------------


def test_a_directory_that_holds_something_is_refused_unless_overwritten(tmp_path: Path, cli: Cli) -> None:
    scene, out = write_scene(tmp_path / "a.toml"), tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").write_text("years of work", encoding="utf-8")
    (out / "family.csv").write_text("old", encoding="utf-8")
    assert "--overwrite" in cli("run", scene, "--out", out).line
    assert sorted(p.name for p in out.iterdir()) == ["family.csv", "thesis.tex"]
    assert cli("run", scene, "--out", out, "--resume").status == 2
    assert "holds family.csv and no run made it" in cli("run", scene, "--out", out, "--overwrite").line
    (out / "scene.toml").write_text(scene.read_text(encoding="utf-8"), encoding="utf-8")
    for flag in ("--overwrite", "--resume"):  # nor with a scene that a user wrote
        assert cli("run", scene, "--out", out, flag).status == 2
    assert (out / "family.csv").read_text(encoding="utf-8") == "old"


def test_overwriting_touches_what_a_run_made_and_nothing_else(tmp_path: Path, cli: Cli) -> None:
    scene, out = write_scene(tmp_path / "a.toml"), tmp_path / "out"
    assert cli("run", scene, "--out", out).status == 0
    mine = {"thesis.tex": "years of work", ".notes.csv.abcd1234.csv": "mine", "orbit.txt": "mine"}
    for name, text in mine.items():
        (out / name).write_text(text, encoding="utf-8")
    (out / "branch.csv").mkdir()  # a folder of the user's with the name of a result
    before = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert cli("run", scene, "--out", out, "--overwrite").line
    assert before == {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    (out / "branch.csv").rmdir()
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "README.md").write_text("mine", encoding="utf-8")
    (out / "export").symlink_to(elsewhere)
    assert cli("run", scene, "--out", out, "--overwrite").status == 2
    assert (elsewhere / "README.md").exists()
    (out / "export").unlink()
    made = ("edges.csv", "edges.png", "energies.csv", "spreading.csv")
    for name in made:
        (out / name).touch()
    assert cli("run", scene, "--out", out, "--overwrite").status == 0
    assert {name: (out / name).read_text(encoding="utf-8") for name in mine} == mine
    assert not any((out / name).exists() for name in made)
    assert read_rows(out / "family.csv")[0]["mode"] == "1"


def test_a_path_that_cannot_be_a_directory_is_refused(tmp_path: Path, cli: Cli) -> None:
    scene, locked = write_scene(tmp_path / "a.toml"), tmp_path / "locked"
    for out in (scene, scene / "below"):
        assert str(out) in cli("run", scene, "--out", out).line
    if os.geteuid() != 0:  # root may write anywhere
        locked.mkdir(mode=0o500)
        assert cli("run", scene, "--out", locked / "out").status == 2


def test_results_go_to_a_folder_named_after_the_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "weak.toml", end=0.1, at="[]")
    assert main(["run", "weak.toml"]) == 0
    assert (tmp_path / "results" / "weak" / "family.csv").exists()
