"""Processor time of whole processes of `casadi-skin`, start and imports included, as multiples of a 193 x 193 solve.

Run with `pytest -m benchmark -s tests/benchmarks/test_run_speed.py`; with `--record` what is measured is added to
history.csv. Modules are compiled beforehand, as those of an installed package are.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from stopwatch import unit_seconds

pytestmark = pytest.mark.benchmark

EXAMPLES = Path(__file__).parents[2] / "examples"
README = "softening_end_breather.toml"
Record = Callable[[str, float, int], None]


def seconds(words: list[str], compiled: Path, repeats: int) -> float:
    """Least time of the processor in a process with these arguments and its children, after one that is not counted."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    environment = kept | {"PYTHONPYCACHEPREFIX": str(compiled), "OMP_NUM_THREADS": "1"}
    command, times = [sys.executable, "-m", "casadi_skin", *words], []
    for _ in range(repeats + 1):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, env=environment, stdout=subprocess.DEVNULL, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times[1:])


@pytest.mark.parametrize(
    ("case", "words", "most"),
    [
        ("casadi-skin --help", ["--help"], 400),
        ("casadi-skin spectrum, README's scene", ["spectrum", README], 700),
        ("casadi-skin check, README's scene", ["check", README], 700),
        ("casadi-skin check --measure, README's scene", ["check", "--measure", README], 4000),
        ("casadi-skin run, README's scene", ["run", README], 18000),
        ("casadi-skin run, six softening families", ["run", "families_softening.toml"], 45000),
    ],
)
def test_commands(case: str, words: list[str], most: float, record: Record, unit: float, tmp_path: Path) -> None:
    """No more than twice what was measured on a machine with other work."""
    words = [str(EXAMPLES / word) if word.endswith(".toml") else word for word in words]
    run = words[0] == "run"
    value = seconds([*words, "--out", str(tmp_path / "out"), "--overwrite"] if run else words, tmp_path / "pyc", 3)
    record(case, value, 1)
    assert value / max(unit, unit_seconds()) < most
