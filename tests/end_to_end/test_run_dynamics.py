"""Scenes with [dynamics]: files, failures, what is built, and what the plan says."""

from __future__ import annotations

import csv
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from apart import modules_of_a_run, undrawn

from casadi_skin.runs.program import main
from casadi_skin.runs.scene import DynamicsTable
from casadi_skin.runs.tasks import sample_times

pytestmark = pytest.mark.usefixtures("blank")

CHAIN = "[chain]\nsites = {sites}\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n"
FAMILY = "[family]\nmode = {mode}\namplitude_max = 0.5\n"
KICK = "[dynamics]\nmode = 1\nS = 0.2\nduration = 10.0\nsite = 6\nsize = 0.01\n"


def write_scene(path: Path, dynamics: str, sites: int = 6, mode: str = "1") -> Path:
    path.write_text(CHAIN.format(sites=sites) + FAMILY.format(mode=mode) + dynamics, encoding="utf-8")
    return path


def table(path: Path) -> tuple[list[str], np.ndarray]:
    with path.open(encoding="utf-8", newline="") as file:
        header, *lines = csv.reader(file)
    return header, np.array(lines, dtype=float)


@pytest.mark.usefixtures("pictures")
def test_run_writes_table_netcdf_and_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    xarray = pytest.importorskip("xarray")
    out = tmp_path / "out"
    scene = write_scene(tmp_path / "kick.toml", KICK + 'samples = 51\nmethod = "dop853"\n', mode="[2, 1]")
    assert main(["run", str(scene), "--out", str(out)]) == 0
    assert "dynamics: dop853 in gauge coordinates, tolerance 1e-11: t = 10 reached" in capsys.readouterr().out
    assert {"dynamics.csv", "dynamics.nc", "dynamics.png"} <= {path.name for path in out.iterdir()}
    header, values = table(out / "dynamics.csv")
    assert header == ["t", "energy", *(f"y_{n}" for n in range(1, 7))]
    np.testing.assert_allclose(values[:, 0], np.linspace(0.0, 10.0, 51), atol=1e-15)
    assert np.ptp(values[:, 1]) < 1e-9 * values[0, 1]
    profile = values[0, 2:] - [0, 0, 0, 0, 0, 0.01]
    assert profile @ profile == pytest.approx(0.2, rel=1e-7)
    assert np.all(profile > 0)  # of mode 1, not of mode 2, whose profile has a node
    with xarray.open_dataset(out / "dynamics.nc", engine="scipy") as data:
        np.testing.assert_array_equal(data.displacements.values, values[:, 2:])
        np.testing.assert_array_equal(data.energy.values, values[:, 1])
        np.testing.assert_array_equal(data.t.values, values[:, 0])
        assert not np.any(data.velocities.values[0])
        numerical = np.gradient(values[:, 2:], values[:, 0], axis=0)[1:-1]
        np.testing.assert_allclose(data.velocities.values[1:-1], numerical, atol=0.02)
        assert (data.attrs["method"], data.attrs["orbit_mode"], data.attrs["orbit_S"]) == ("dop853", 1, 0.2)
        assert "size = 0.01" in data.attrs["scene"]
    assert main(["run", str(scene), "--out", str(out), "--resume"]) == 0
    assert "complete run already" in capsys.readouterr().out
    assert main(["run", str(write_scene(scene, "")), "--out", str(out), "--overwrite"]) == 0
    assert not any(path.name.startswith("dynamics") for path in out.iterdir())


def test_an_escape_keeps_what_was_computed_and_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    dynamics = KICK.replace("size = 0.01", "size = 3.0").replace("10.0", "50.0")
    scene = write_scene(tmp_path / "far.toml", dynamics)
    for flags in ([], ["--resume"]):
        assert main(["run", str(scene), "--out", str(out), *flags]) == 1
        told = capsys.readouterr().err
        assert told.startswith(f"{scene}: [dynamics]: cvodes: the state was followed to t = ")
        assert "leaves the well" in told
        assert told.count("\n") == 1
        _, values = table(out / "dynamics.csv")
        assert 1 < len(values) < 401
        assert np.all(np.isfinite(values))
        assert (out / "family.nc").exists()
        assert (out / "journal.msgpack").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(
    ("method", "number"),
    [
        ("cvodes", signal.SIGINT),
        pytest.param("cvodes", signal.SIGTERM, marks=pytest.mark.slow),
        pytest.param("dop853", signal.SIGINT, marks=pytest.mark.slow),
        pytest.param("symplectic", signal.SIGTERM, marks=pytest.mark.slow),
    ],
)
def test_an_interruption_is_heard_at_once(tmp_path: Path, method: str, number: signal.Signals) -> None:
    out = tmp_path / "out"
    scene = write_scene(tmp_path / "long.toml", f'[dynamics]\nS = 0.2\nperiods = 1000000\nmethod = "{method}"\n')
    process = undrawn("run", scene, "--out", out)
    while not (out / "frequency.png").exists():  # the last file of the family
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)
    time.sleep(0.3)  # most likely the integrator is at work then, for hours; what must hold does not depend on it
    process.send_signal(number)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130, told
    assert "go on with --resume" in told
    assert "Traceback" not in told
    assert (out / "family.nc").exists()
    assert (out / "journal.msgpack").exists()
    assert not (out / "dynamics.csv").exists()


@pytest.mark.slow
def test_without_a_table_nothing_of_it_is_imported(tmp_path: Path) -> None:
    loaded = modules_of_a_run(write_scene(tmp_path / "plain.toml", ""), tmp_path / "out")
    assert not loaded & {"casadi_skin.dynamics", "casadi_skin.runs.tasks", "casadi_skin.results.figures.evolutions"}
    assert not [name for name in loaded if "export" in name and name.startswith("casadi_skin")]
    assert not (tmp_path / "out" / "dynamics.csv").exists()


@pytest.mark.parametrize(("periods", "samples"), [(1.0, 401), (60.5, 1211), (200.0, 4001)])
def test_default_samples_resolve_the_period(periods: float, samples: int) -> None:
    t = sample_times(DynamicsTable(S=0.2, periods=periods), 6.0)
    assert t.size == samples
    assert t[-1] == pytest.approx(6.0 * periods)


@pytest.mark.parametrize("periods", [400.0, 1000.0, 10_000.0, 12_345.6])
def test_default_samples_of_long_runs_fall_on_all_phases(periods: float) -> None:
    t = sample_times(DynamicsTable(S=0.2, duration=6.0 * periods), 6.0)
    assert 3600 < t.size <= 4001
    phases = np.sort((t[:20] / 6.0) % 0.5)  # of twenty samples, in half periods, where |y| repeats
    assert np.diff(np.append(phases, phases[0] + 0.5)).max() < 0.1


@pytest.mark.parametrize(
    ("kind", "energy"), [("mode = 2", None), ("site = 3\nmoving = true", 0.125), ("seed = 1", None)]
)
def test_motion_that_starts_near_rest_needs_no_orbit(
    kind: str, energy: float | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The energy of a kick is v^2/2 in the weights of the gauge; modes of small size go on at their frequency."""
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    size = 1e-3 if energy is None else 0.5
    text = CHAIN.format(sites=6) + f"[dynamics]\n{kind}\nsize = {size}\nduration = 10.0\nsamples = 41\n"
    scene.write_text(text + "[figures]\nformats = []\n", encoding="utf-8")
    assert main(["check", str(scene)]) == 0
    assert "from rest, to t = 10; 41 times" in capsys.readouterr().out
    assert main(["run", str(scene), "--out", str(out)]) == 0
    assert "t = 10 reached" in capsys.readouterr().out
    _, values = table(out / "dynamics.csv")
    if energy is not None:
        assert not values[0, 2:].any()
        assert values[:, 1] == pytest.approx(energy * (1.25 / 0.75) ** 3, rel=1e-9)  # the last of six has weight 1
    else:
        assert np.linalg.norm(values[0, 2:]) == pytest.approx(size, rel=1e-12)
    if kind == "mode = 2":
        omega = np.sqrt(3.0 - 2.0 * np.sqrt(1 - 0.25**2) * np.cos(2 * np.pi / 7))
        assert values[:, 2:] == pytest.approx(np.cos(omega * values[:, :1]) * values[0, 2:], abs=1e-8)
    assert main(["run", str(scene), "--out", str(out), "--resume"]) == 0
    assert "complete run already" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ("mode = 7", "[dynamics] mode: given 7; accepted: 1..6"),
        (
            "vector = [1.0]",
            "[dynamics] vector: given a list of 1; accepted: 6 displacements, or these and 6 velocities",
        ),
        ("mode = 1\nmoving = 1", "[dynamics] moving: given 1 (a whole number); accepted: true or false"),
    ],
)
def test_starts_that_the_model_does_not_have(
    changed: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "scene.toml"
    text = CHAIN.format(sites=6) + f"[dynamics]\n{changed}\nsize = 0.1\nduration = 10.0\n"
    scene.write_text(text, encoding="utf-8")
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
