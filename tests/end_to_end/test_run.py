"""Runs of scenes through the command line: files, resuming, limits of time, families that end early."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from scenes import Runs, chain, family

from casadi_skin.runs.directory import MADE_BY_RUN
from casadi_skin.runs.program import main
from casadi_skin.stability.family_stability import FLOWS

pytestmark = pytest.mark.usefixtures("blank")

STABILITY_COLUMNS = ["max_abs_multiplier", "stable", "unstable_real", "unstable_complex", "multiplier_error"]
FAMILY_COLUMNS = [
    *("mode", "point", "requested", "S", "Omega", "Omega_shift", "period", "energy"),
    *STABILITY_COLUMNS,
    *("Omega_error", "residual"),
]
SMALL = chain() + family(at=[0.2, 1.0])
QUIET = "--quiet"


@pytest.mark.usefixtures("pictures")
def test_run_writes_tables_pictures_and_netcdf(run: Runs) -> None:
    printed = run(chain() + family([1, 4], at=[0.2, 1.0]) + "[spectrum]\n[stability]\nvectors = true\n").out
    assert "results in" in printed
    assert {
        "frequency.png", "profile.png", "spectrum.png", "family.csv", "events.csv", "tongues.csv", "further_events.csv",
        "spectrum.csv", "family.nc", "scene.toml",
    } <= run.files  # fmt: skip
    assert not any("journal" in name or name.startswith(".") for name in run.files)
    table = run.rows("family")
    assert list(table[0])[: len(FAMILY_COLUMNS)] == FAMILY_COLUMNS
    assert [r["mode"] for r in table] == sorted(r["mode"] for r in table)
    for mode in ("1", "4"):
        (S,) = run.columns("family", "S", mode=mode)
        assert run.columns("family", "point", mode=mode)[0].tolist() == list(range(len(S)))
        assert run.columns("family", "S", mode=mode, requested="1")[0].tolist() == [0.2, 1.0]
        assert S[0] < 1e-3
    assert np.all(np.isfinite(run.columns("family", *table[0])))
    header = (run.out / "events.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.startswith("mode,S,Omega,kind,stable_before,stable_after")
    assert (run.out / "scene.toml").read_text(encoding="utf-8").startswith(f"{MADE_BY_RUN}\n[chain]")


def test_a_film_is_written_where_it_is_asked_for(run: Runs) -> None:
    run(chain(3, g=1.0) + family([1, 3], 0.5, at=[0.2], film=True))
    assert sorted(p.name for p in run.out.glob("*.gif")) == ["film_j1.gif", "film_j3.gif"]
    run(SMALL, "--overwrite")
    assert not list(run.out.glob("*.gif"))


def test_netcdf_is_readable_by_xarray_and_says_the_same_as_the_table(run: Runs) -> None:
    xarray = pytest.importorskip("xarray")
    run(SMALL + "[stability]\nvectors = true\n")
    with xarray.open_dataset(run.out / "family.nc", engine="scipy") as data:
        for name in ("Omega", "multiplier_error"):
            np.testing.assert_array_equal(data[name].values, run.columns("family", name)[0])
        assert (data.profile.values**2).sum(axis=1) == pytest.approx(data.S.values, rel=1e-12)
        np.testing.assert_allclose(data.coefficients.values.sum(axis=1), data.profile.values, atol=1e-14)
        assert data.vectors.shape == (2, 12, 12, 2)
        assert "sites = 6" in data.attrs["scene"]
        assert data.attrs["casadi_version"]
        moduli = np.hypot(*np.moveaxis(data.multipliers.values, -1, 0))
        assert moduli.max(axis=1) == pytest.approx(data.max_abs_multiplier.values, rel=1e-12)
        assert np.all(data.multiplier_error.values >= data.mu_error.values.max(axis=1))


def test_without_stability_no_variational_system_is_built(run: Runs, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise AssertionError("a variational system was built")

    for flow in FLOWS:
        monkeypatch.setitem(FLOWS, flow, refuse)
    run(SMALL)
    assert not set(STABILITY_COLUMNS) & set(run.rows("family")[0])
    assert "events.csv" not in run.files
    with pytest.raises(AssertionError, match="variational"):
        run(SMALL + "[stability]\n", "--overwrite")


@pytest.mark.slow
def test_the_methods_of_a_scene_agree(run: Runs) -> None:
    newton, found = 'corrector = "newton"', []
    for method in ('corrector = "ipopt"', f'transcription = "gauss"\n{newton}', newton, 'flow = "cvodes"'):
        rest = f"[stability]\nevents = false\n[accuracy]\ntolerance = 1e-9\n[method]\n{method}\n"
        run(chain(3, g=1.0) + family(3, at=[0.2, 1.0]) + rest, "--overwrite")
        found.append(run.columns("family", "Omega", "max_abs_multiplier", requested="1"))
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=0, atol=2e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "limit"),  # omega^2/|g| = 3 is where the period diverges; a mesh follows it to where S is 3 but for 1e-4
    [('transcription = "gauss"\ncorrector = "newton"\n', 3.0003), pytest.param("", 3.0, marks=pytest.mark.slow)],
    ids=["gauss", "standard"],
)
def test_a_softening_orbit_that_cannot_exist_ends_with_a_reason(method: str, limit: float, run: Runs) -> None:
    rest = f'[accuracy]\npreset = "draft"\n[method]\n{method}'
    told = run(chain(1) + family(1, 5.0, at=[1.0, 4.0]) + rest, status=1).err
    assert "mode 1" in told
    assert "does not exist at S = 5" in told
    table = run.rows("family")
    assert run.columns("family", "S", requested="1")[0].tolist() == [1.0]
    assert 2.9 < max(float(r["S"]) for r in table) < limit
    run("", "--resume", status=1)
    assert run.rows("family") == table


# Limits of time -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "map"])
def test_a_limit_of_time_ends_a_command_in_one_line(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    axes = "[map]\ngamma = { from = 0.1, to = 0.2, points = 2 }\n" if command == "map" else ""
    scene, out, whole = tmp_path / "scene.toml", tmp_path / "out", tmp_path / "whole"
    options = [QUIET, *(["--no-pictures"] if command == "map" else [])]
    scene.write_text(SMALL + axes, encoding="utf-8")
    assert main([command, str(scene), "--out", str(whole), *options]) == 0
    scene.write_text("time_limit = 1e-3\n" + SMALL + axes, encoding="utf-8")
    assert main([command, str(scene), "--out", str(out), *options]) == 1
    words = f"scene.toml: time_limit: 0.001 s are over; what was computed is in {out}; go on with --resume\n"
    assert capsys.readouterr().err.endswith(words)
    scene.write_text("time_limit = 1e6\n" + SMALL + axes, encoding="utf-8")
    assert main([command, str(scene), "--out", str(out), "--resume", *options]) == 0
    if command == "run":
        assert (out / "family.csv").read_bytes() == (whole / "family.csv").read_bytes()
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0.0


def test_resume_wants_the_same_scene_but_for_its_title(run: Runs) -> None:
    run(SMALL)
    run('title = "another"\n' + SMALL, "--resume")
    assert "[chain] differs" in run(SMALL.replace("sites = 6", "sites = 7"), "--resume", status=2).line


@pytest.mark.parametrize(
    ("name", "cut"), [("family.nc", 0), ("family.nc", 0.03), ("family.nc", 0.9), ("family.csv", 0.9)]
)
def test_resume_of_a_complete_run_names_a_file_that_was_cut_off(name: str, cut: float, run: Runs) -> None:
    run(chain(3) + family(1, 0.2, at=[0.2]), QUIET)
    path = run.out / name
    whole = path.read_bytes()
    path.write_bytes(whole[: int(cut * len(whole))])
    told = run("", "--resume", status=2).line
    assert f"{path}: damaged" in told
    assert "--overwrite" in told
    run("", "--overwrite", QUIET)
    assert path.read_bytes() == whole
    run("", "--resume", QUIET)


# Directories --------------------------------------------------------------------------------------------------------


def test_a_directory_that_holds_something_is_refused_unless_overwritten(run: Runs) -> None:
    run.out.mkdir()
    for name, text in {"thesis.tex": "years of work", "family.csv": "old"}.items():
        (run.out / name).write_text(text, encoding="utf-8")
    assert "--overwrite" in run(SMALL, status=2).line
    assert run.files == {"family.csv", "thesis.tex"}
    run("", "--resume", status=2)
    assert "holds family.csv and no run made it" in run("", "--overwrite", status=2).line
    (run.out / "scene.toml").write_text(SMALL, encoding="utf-8")
    for flag in ("--overwrite", "--resume"):  # nor with a scene that a user wrote
        run("", flag, status=2)
    assert (run.out / "family.csv").read_text(encoding="utf-8") == "old"


def test_overwriting_touches_what_a_run_made_and_nothing_else(run: Runs) -> None:
    run(SMALL)
    out, elsewhere = run.out, run.folder / "elsewhere"
    mine = {"thesis.tex": "years of work", ".notes.csv.abcd1234.csv": "mine", "orbit.txt": "mine"}
    for name, text in mine.items():
        (out / name).write_text(text, encoding="utf-8")
    (out / "branch.csv").mkdir()  # a folder of the user's with the name of a result
    before = {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    assert run("", "--overwrite", status=2).line
    assert before == {path.name: path.stat().st_mtime_ns for path in out.iterdir()}
    (out / "branch.csv").rmdir()
    elsewhere.mkdir()
    (elsewhere / "README.md").write_text("mine", encoding="utf-8")
    (out / "export").symlink_to(elsewhere)
    run("", "--overwrite", status=2)
    assert (elsewhere / "README.md").exists()
    (out / "export").unlink()
    made = {"edges.csv", "edges.png", "energies.csv", "spreading.csv"}
    for name in made:
        (out / name).touch()
    run("", "--overwrite")
    assert {name: (out / name).read_text(encoding="utf-8") for name in mine} == mine
    assert not made & run.files
    assert run.rows("family")[0]["mode"] == "1"


def test_a_path_that_cannot_be_a_directory_is_refused(run: Runs) -> None:
    run.scene.write_text(SMALL, encoding="utf-8")
    for out in (run.scene, run.scene / "below"):
        assert str(out) in run.cli("run", run.scene, "--out", out).line
    if os.geteuid() != 0:  # root may write anywhere
        (run.folder / "locked").mkdir(mode=0o500)
        assert run.cli("run", run.scene, "--out", run.folder / "locked" / "out").status == 2


def test_results_go_to_a_folder_named_after_the_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("weak.toml").write_text(chain() + family(1, 0.1), encoding="utf-8")
    assert main(["run", "weak.toml"]) == 0
    assert (tmp_path / "results" / "weak" / "family.csv").exists()
