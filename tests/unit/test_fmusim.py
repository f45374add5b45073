"""The simulator of the FMI standard's Reference-FMUs, fmusim, on what is exported; skipped where it is not there."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from casadi_skin import Chain, evolve, export_fmu

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("fmusim") is None, reason="fmusim of github.com/modelica/Reference-FMUs"),
]
CHAIN = Chain(5, 1.0, 0.25, 1.0)


def simulated(path: Path, table: Path, *options: str) -> NDArray[np.void]:
    """What fmusim writes; it must end well and without a word."""
    command = ["fmusim", "--tolerance", "1e-10", *options, "--output-file", str(table), str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    return np.genfromtxt(table, delimiter=",", names=True)


@pytest.mark.parametrize("fmi", ["2.0", "3.0"])
def test_simulations_inputs_and_saved_states(fmi: str, tmp_path: Path) -> None:
    path = export_fmu(CHAIN, tmp_path / "chain.fmu", fmi, mode=5, S=0.5, inputs=["f_2"])  # type: ignore[arg-type]
    table, state, end = tmp_path / "table.csv", tmp_path / "state", ("--stop-time", "5", "--output-interval", "0.01")
    for kind, most in (("cs", 1e-11), ("me", 1e-8)):
        found = simulated(path, table, "--interface-type", kind, "--solver", "cvode", *end)
        start = np.array([found[f"y_{n}"][0] for n in range(1, 6)])
        truth = evolve(CHAIN, start, None, [5.0], method="dop853", tolerance=1e-13).displacements[0]
        np.testing.assert_allclose([found[f"y_{n}"][-1] for n in range(1, 6)], truth, atol=most)
    (tmp_path / "input.csv").write_text("time,f_2\n0,0.4\n5,0.4\n")
    driven = simulated(path, table, "--interface-type", "cs", *end, "--input-file", str(tmp_path / "input.csv"))
    assert abs(driven["y_2"][-1] - found["y_2"][-1]) > 0.01
    first = simulated(path, table, "--interface-type", "cs", "--stop-time", "2", "--final-fmu-state-file", str(state))
    again = ("--start-time", "2", "--stop-time", "5", "--initial-fmu-state-file", str(state))
    second = simulated(path, table, "--interface-type", "cs", *again)
    assert second["y_5"][0] == first["y_5"][-1]
    np.testing.assert_allclose([second[f"y_{n}"][-1] for n in range(1, 6)], truth, atol=1e-8)
