"""Scenes with [dynamics]: files, failures, what is built, and what the plan says."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from apart import modules_of_a_run, undrawn
from scenes import Runs, chain, family, table

from casadi_skin.runs.scene import DynamicsTable
from casadi_skin.runs.tasks import sample_times

pytestmark = pytest.mark.usefixtures("blank")


def kick(**keys: Any) -> str:
    given = {"mode": 1, "S": 0.2, "duration": 10.0, "site": 6, "size": 0.01}
    return table("dynamics", **given | keys)


@pytest.mark.usefixtures("pictures")
def test_run_writes_table_netcdf_and_picture(run: Runs) -> None:
    xarray = pytest.importorskip("xarray")
    families = chain() + family([2, 1], 0.5)
    printed = run(families + kick(samples=51, method="dop853")).out
    assert "dynamics: dop853 in gauge coordinates, tolerance 1e-11: t = 10 reached" in printed
    assert {"dynamics.csv", "dynamics.nc", "dynamics.png"} <= run.files
    header = list(run.rows("dynamics")[0])
    assert header == ["t", "energy", *(f"y_{n}" for n in range(1, 7))]
    values = np.transpose(run.columns("dynamics", *header))
    np.testing.assert_allclose(values[:, 0], np.linspace(0.0, 10.0, 51), atol=1e-15)
    assert np.ptp(values[:, 1]) < 1e-9 * values[0, 1]
    profile = values[0, 2:] - [0, 0, 0, 0, 0, 0.01]
    assert profile @ profile == pytest.approx(0.2, rel=1e-7)
    assert np.all(profile > 0)  # of mode 1, not of mode 2, whose profile has a node
    with xarray.open_dataset(run.out / "dynamics.nc", engine="scipy") as data:
        np.testing.assert_array_equal(data.displacements.values, values[:, 2:])
        np.testing.assert_array_equal(data.energy.values, values[:, 1])
        np.testing.assert_array_equal(data.t.values, values[:, 0])
        assert not np.any(data.velocities.values[0])
        numerical = np.gradient(values[:, 2:], values[:, 0], axis=0)[1:-1]
        np.testing.assert_allclose(data.velocities.values[1:-1], numerical, atol=0.02)
        assert (data.attrs["method"], data.attrs["orbit_mode"], data.attrs["orbit_S"]) == ("dop853", 1, 0.2)
        assert "size = 0.01" in data.attrs["scene"]
    assert "complete run already" in run("", "--resume").out
    run(families, "--overwrite")
    assert not any(name.startswith("dynamics") for name in run.files)


def test_an_escape_keeps_what_was_computed_and_says_why(run: Runs) -> None:
    scene = chain() + family(1, 0.5) + kick(size=3.0, duration=50.0)
    for flags in ([], ["--resume"]):
        told = run(scene, *flags, status=1).err
        assert told.startswith(f"{run.scene}: [dynamics]: cvodes: the state was followed to t = ")
        assert "leaves the well" in told
        assert told.count("\n") == 1
        (values,) = run.columns("dynamics", "y_6")
        assert 1 < len(values) < 401
        assert np.all(np.isfinite(values))
        assert {"family.nc", "journal.msgpack"} <= run.files


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
    scene, out = tmp_path / "long.toml", tmp_path / "out"
    motion = table("dynamics", S=0.2, periods=1e6, method=method)
    scene.write_text(chain() + family(1, 0.5) + motion, encoding="utf-8")
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
    scene = tmp_path / "plain.toml"
    scene.write_text(chain() + family(1, 0.5), encoding="utf-8")
    loaded = modules_of_a_run(scene, tmp_path / "out")
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
def test_motion_that_starts_near_rest_needs_no_orbit(kind: str, energy: float | None, run: Runs) -> None:
    """The energy of a kick is v^2/2 in the weights of the gauge; modes of small size go on at their frequency."""
    size = 1e-3 if energy is None else 0.5
    scene = chain() + f"[dynamics]\n{kind}\nsize = {size}\nduration = 10.0\nsamples = 41\n[figures]\nformats = []\n"
    assert "from rest, to t = 10; 41 times" in run(scene, command="check").out
    assert "t = 10 reached" in run(scene).out
    values = np.transpose(run.columns("dynamics", *run.rows("dynamics")[0]))
    if energy is not None:
        assert not values[0, 2:].any()
        assert values[:, 1] == pytest.approx(energy * (1.25 / 0.75) ** 3, rel=1e-9)  # the last of six has weight 1
    else:
        assert np.linalg.norm(values[0, 2:]) == pytest.approx(size, rel=1e-12)
    if kind == "mode = 2":
        omega = np.sqrt(3.0 - 2.0 * np.sqrt(1 - 0.25**2) * np.cos(2 * np.pi / 7))
        assert values[:, 2:] == pytest.approx(np.cos(omega * values[:, :1]) * values[0, 2:], abs=1e-8)
    assert "complete run already" in run("", "--resume").out
