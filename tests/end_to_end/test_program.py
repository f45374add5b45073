"""The program `casadi-skin` ends at once: with its status, its output whole, after all clean-up that was registered."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import atexit, sys
from casadi_skin import __main__
from casadi_skin.runs import program as commands
def clean_up():
    print("cleaned up", end="")
program = __main__.program
commands.main = lambda: {act}
program()
"""


def ended(act: str) -> tuple[int, str]:
    """Exit status and standard output of the program with another command line."""
    text = PROGRAM.format(act=act)
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False, timeout=60)
    return done.returncode, done.stdout


@pytest.mark.parametrize(("act", "status"), [("0", 0), ("1", 1), ("130", 130), ("sys.exit(2)", 2)])
def test_it_ends_with_its_status_after_what_was_registered(act: str, status: int) -> None:
    assert ended(f"(atexit.register(clean_up), {act})[1]") == (status, "cleaned up")


def test_a_fault_of_the_program_is_status_1() -> None:
    assert ended("(atexit.register(clean_up), 1 / 0)[1]") == (1, "cleaned up")


def test_output_in_a_buffer_is_written(tmp_path: Path) -> None:
    with (tmp_path / "out").open("w") as file:
        words = [sys.executable, "-m", "casadi_skin", "--version"]
        assert subprocess.run(words, stdout=file, check=False, timeout=60).returncode == 0
    assert (tmp_path / "out").read_text().startswith("casadi-skin ")
