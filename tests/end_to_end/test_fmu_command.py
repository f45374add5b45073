"""Scenes with fmu under [export]: the plan, and the FMU of a run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu

from casadi_skin.runs.program import main

pytestmark = pytest.mark.usefixtures("blank")

CHAIN = "[chain]\nsites = 5\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n"
FAMILY = "[family]\nmode = [2, 1]\namplitude_max = 0.5\n[accuracy]\ntolerance = 1e-10\n"


def scene_file(folder: Path, *tables: str) -> Path:
    path = folder / "s.toml"
    path.write_text("".join((CHAIN, *tables)), encoding="utf-8")
    return path


@pytest.mark.slow
def test_orbit_of_a_run_as_an_fmu(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene, out = scene_file(tmp_path, FAMILY, '[export]\nfmu = "orbit.fmu"\nS = 0.4\nmode = 2\n'), tmp_path / "out"
    assert main(["check", str(scene)]) == 0
    assert "FMU of the orbit j = 2, S = 0.4 in orbit.fmu: FMI 3.0" in capsys.readouterr().out
    assert main(["run", str(scene), "--out", str(out)]) == 0
    assert f"exported to {out / 'orbit.fmu'}" in capsys.readouterr().out
    assert validate_fmu(str(out / "orbit.fmu")) == []
    period = float(fmpy.read_model_description(str(out / "orbit.fmu")).defaultExperiment.stopTime) / 10
    result = fmpy.simulate_fmu(
        str(out / "orbit.fmu"), fmi_type="CoSimulation", stop_time=period, output_interval=period
    )
    assert result["S"][0] == pytest.approx(0.4, rel=1e-12)
    assert result["time"][-1] == pytest.approx(period)
    for n in range(1, 6):
        assert result[f"y_{n}"][-1] == pytest.approx(result[f"y_{n}"][0], abs=1e-8)


def test_chain_alone_in_the_older_version(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, '[export]\nfmu = "chain.fmu"\nfmi = "2.0"\n')
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    assert fmpy.read_model_description(str(tmp_path / "out" / "chain.fmu")).fmiVersion == "2.0"


def test_a_missing_compiler_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    scene = scene_file(tmp_path, '[export]\nfmu = "chain.fmu"\n')
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 1
    assert "compiler: 'no-such-compiler' not found" in capsys.readouterr().err
    assert not (tmp_path / "out" / "chain.fmu").exists()


@pytest.mark.slow
def test_fmpys_own_command_runs_it(tmp_path: Path) -> None:
    scene = scene_file(tmp_path, '[export]\nfmu = "chain.fmu"\n')
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    command = [sys.executable, "-m", "fmpy", "--stop-time", "5", "--output-interval", "1"]
    command += ["--output-file", "result.csv"]
    command += ["--start-values", "g", "1", "gamma", "-0.25", "--validate", "simulate", "out/chain.fmu"]
    environment = os.environ | {"MPLBACKEND": "Agg"}
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, env=environment)
    assert done.returncode == 0, done.stderr
    table = np.genfromtxt(tmp_path / "result.csv", delimiter=",", names=True)
    assert table["time"][-1] == 5.0
    np.testing.assert_allclose(table["energy"], table["energy"][0], rtol=1e-3)
