"""How searches end: units that are far apart, and a parent that is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from maps import is_running

from casadi_skin import OdeModel, find_orbit, search_orbit

PARENT = """
import os, sys, time
from dataclasses import dataclass
from casadi_skin.solve.processes import Runner

@dataclass(frozen=True)
class Job:
    number: int
    name: str = ""

def work(job, monitor):
    os.write(1, f"{os.getpid()}\\n".encode())  # at once: lines of two processes are not mixed
    while True:  # busy, as a solver is
        monitor(0, 0.0, 0.0)

if __name__ == "__main__":
    list(Runner(workers=2).run(work, [Job(1), Job(2)]))
"""


def children(process: int) -> list[int]:
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text(encoding="utf-8").rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == process:
            found.append(int(path.parent.name))
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_a_parent_that_is_killed_leaves_no_process_running(tmp_path: Path) -> None:
    script = tmp_path / "parent.py"
    script.write_text(PARENT, encoding="utf-8")
    paths = f"{Path(__file__).parents[2]}:{os.environ.get('PYTHONPATH', '')}"
    environment = {**os.environ, "PYTHONPATH": paths}
    command = [sys.executable, str(script)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment) as parent:
        workers = [int(parent.stdout.readline()) for _ in range(2)]
        started = children(parent.pid)  # those that share the queue and the resources of Python among them
        assert set(workers) <= set(started)
        parent.send_signal(signal.SIGKILL)
    until = time.monotonic() + 20.0
    while any(map(is_running, started)) and time.monotonic() < until:
        time.sleep(0.1)
    left = [process for process in started if is_running(process)]
    for process in left:
        os.kill(process, signal.SIGKILL)
    assert left == []


def in_units(size: float) -> tuple[OdeModel, Callable[[float], list[float]]]:
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    rate = size * (mu * (1 - x**2) * y / size - x)
    return OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y / size, rate), mu), (
        lambda t: [2 * np.cos(t), -2 * size * np.sin(t)]
    )


@pytest.mark.parametrize("size", [1e-12, 1e-9, 1e6, 1e9, 1e12])
def test_units_that_are_far_apart_give_one_optimum(size: float) -> None:
    """The period grows with mu: its least value is that at the bound."""
    model, guess = in_units(size)
    found = search_orbit(
        model, objective="period", free=["mu"], guess=guess, bounds={"mu": (0.5, 2.0)}, starts=1, period=6.6,
        parameters={"mu": 1.0},
    )  # fmt: skip
    assert found.reason == "the optimum sits on a bound: mu >= 0.5"
    assert found.value == pytest.approx(find_orbit(model, guess, 6.6, parameters={"mu": 0.5}).period, rel=1e-9)
