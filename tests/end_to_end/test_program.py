"""The program `casadi-skin` ends at once: with its status, its output whole, after all clean-up that was registered."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from casadi_skin.commands.lean_imports import LATER

PROGRAM = """
import atexit, sys
from casadi_skin import __main__
def clean_up():
    print("cleaned up", end="")
program = __main__.program
__main__.main = lambda: {act}
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


LEAN = """
import sys, warnings
from casadi_skin.commands import lean_imports
lean_imports.install()
warnings.simplefilter("error")
import matplotlib.figure, msgspec, scipy.linalg
left_out = [name for name in ("mpl_toolkits.mplot3d", "typing_extensions") if name in sys.modules]
later = [name for name in sorted(lean_imports.LATER) if "_LazyModule" in str(type(sys.modules[name]))]
import numpy, typing_extensions
from mpl_toolkits.mplot3d import Axes3D
numpy.testing.assert_equal(1, 1)
assert callable(numpy.f2py.get_include) and issubclass(Axes3D, matplotlib.axes.Axes)
assert matplotlib.artist.kwdoc(matplotlib.lines.Line2D).startswith("Properties:")
print(left_out, *later)
"""


def test_what_the_program_leaves_out_can_be_used_afterwards() -> None:
    done = subprocess.run([sys.executable, "-c", LEAN], capture_output=True, text=True, check=False, timeout=60)
    assert done.stdout.split() == ["[]", *sorted(LATER)], done.stderr


def test_pictures_are_those_of_whole_imports(tmp_path: Path) -> None:
    scene = str(Path(__file__).parents[2] / "examples" / "softening_end_breather.toml")
    call = "import sys; from casadi_skin.cli import main; main(sys.argv[1:])"
    for name, start in (("lean", ["-m", "casadi_skin"]), ("whole", ["-c", call])):
        words = ["spectrum", scene, "--quiet", "--out", str(tmp_path / name)]
        subprocess.run([sys.executable, *start, *words], check=True, timeout=60)
    lean, whole = ((tmp_path / name / "spectrum.png").read_bytes() for name in ("lean", "whole"))
    assert lean == whole
