"""What a first result costs beside later ones, and instructions beside time: each program in processes of its own.

Run with `pytest -m benchmark -s tests/benchmarks/peers/test_first_call.py`. Times are of a processor, as multiples of a
dense 193 x 193 solve timed beside them. Instructions are counted by valgrind, which needs no counter of the processor
and gives the same number on a busy machine; it runs code without AVX-512 alone, so all programs have AVX2.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import auto_family
import jaxcont_family
import numpy as np
import pytest
from family_case import unit_seconds
from one_program import PROGRAMS

pytestmark = pytest.mark.benchmark

HERE = Path(__file__).parent
SOLVES = """import sys, numpy as np
A = np.random.default_rng(0).normal(size=(193, 193))
for _ in range(int(sys.argv[1])): np.linalg.solve(A, A[0])"""


def skip_without(name: str) -> None:
    """Skip a program that is not installed, with the reason."""
    reason = auto_family.missing() if name.startswith("AUTO") else ""
    if message := jaxcont_family.missing() if name == "JaxCont" else reason:
        pytest.skip(message)


def stages(name: str, calls: int, folder: Path) -> list[float]:
    """Seconds of loading and building, and of each call."""
    command = [sys.executable, str(HERE / "one_program.py"), name, str(calls), str(folder)]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    return [float(value) for value in json.loads(run.stdout.splitlines()[-1])]


def counted(command: list[str], folder: Path) -> int:
    """Instructions of one process."""
    valgrind = ["valgrind", "--tool=cachegrind", "--cache-sim=no", "--cachegrind-out-file=/dev/null"]
    fixed = {"PYTHONHASHSEED": "0", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    run = subprocess.run([*valgrind, *command], cwd=folder, capture_output=True, text=True, env=os.environ | fixed)
    if "SIGILL" in run.stderr:
        pytest.skip("valgrind cannot run AVX-512: install bifpy as auto_family.py says")
    assert run.returncode == 0, run.stderr
    return int(re.findall(r"I\s+refs:\s+([\d,]+)", run.stderr)[-1].replace(",", ""))


@pytest.fixture(scope="module")
def solve_instructions(tmp_path_factory: pytest.TempPathFactory) -> float:
    """Instructions of numpy.linalg.solve on a dense 193 x 193 system."""
    if shutil.which("valgrind") is None:
        pytest.skip("needs valgrind (apt-get install valgrind)")
    few, many = (
        counted([sys.executable, "-c", SOLVES, str(times)], tmp_path_factory.mktemp("solve")) for times in (5, 25)
    )
    print(f"\na solve takes {1e-6 * (many - few) / 20:.2f} million instructions")
    return (many - few) / 20


@pytest.mark.parametrize("name", PROGRAMS)
def test_first_call(name: str, tmp_path: Path) -> None:
    skip_without(name)
    rows = []
    for repeat in range(3):
        before = unit_seconds()
        folder = tmp_path / str(repeat)
        folder.mkdir()
        found = stages(name, 4, folder)
        rows.append(np.array([found[0], found[1], min(found[2:])]) / (0.5 * (before + unit_seconds())))
    built, first, later = np.min(rows, axis=0)
    print(f"\n{name:<46} {built:8.0f} {first:8.0f} {later:8.0f}")
    assert later < built + first


@pytest.mark.parametrize("name", PROGRAMS)
def test_instructions(name: str, solve_instructions: float, tmp_path: Path) -> None:
    skip_without(name)
    if name == "JaxCont":
        pytest.skip("what JAX compiles under valgrind is not what it compiles for the processor")
    if name.startswith("AUTO"):
        PROGRAMS[name](tmp_path)()  # compiled, and its file of constants written
        first = later = counted([str(tmp_path / "family")], tmp_path)
    else:
        command = [sys.executable, str(HERE / "one_program.py"), name]
        counts = [counted([*command, str(calls), str(tmp_path)], tmp_path) for calls in range(3)]
        first, later = counts[1] - counts[0], counts[2] - counts[1]
    solves = f"{first / solve_instructions:8.0f} {later / solve_instructions:8.0f}"
    print(f"\n{name:<46} {solves}   {1e-6 * later:9.0f} million")
    assert 0 < later <= 1.05 * first
