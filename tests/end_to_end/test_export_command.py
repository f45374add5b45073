"""Scenes with [export]: what is written, and what the plan says."""

from __future__ import annotations

import shutil
import subprocess

import numpy as np
import pytest
from outputs import EXAMPLES
from scenes import Runs, chain, family, table

from casadi_skin import Chain, follow_family
from casadi_skin.export.codegen import build_c

pytestmark = pytest.mark.usefixtures("blank")

FAMILY = family([2, 1], 0.5) + "[accuracy]\ntolerance = 1e-11\n"
ORBIT = table("export", c="all", S=0.4, mode=1)
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not there (CI has it)")


@needs_compiler
def test_from_a_scene_to_a_running_program(run: Runs) -> None:
    out = run.out
    assert f"exported to {out / 'export'}" in run(chain() + FAMILY + "[stability]\n" + ORBIT).out
    printed = subprocess.run([str(build_c(out / "export"))], capture_output=True, text=True, check=True).stdout
    found = {name: float(value) for name, value in (line.split() for line in printed.splitlines())}
    orbit = follow_family(Chain(6, 1.0, 0.25, -1.0), mode=1, amplitude_max=0.4, at=(0.4,), tolerance=1e-11).at(S=0.4)
    expected = [orbit.period, orbit.floquet().max_abs_multiplier]
    np.testing.assert_allclose([found["period"], found["largest_multiplier"]], expected, rtol=1e-12)
    before = (out / "export" / "main.c").stat().st_mtime_ns
    run("", "--resume")
    assert (out / "export" / "main.c").stat().st_mtime_ns == before
    assert "holds main, which no run wrote" in run("", "--overwrite", status=2).line
    (out / "export" / "main").unlink()
    run("", "--overwrite")
    assert (out / "export" / "chain_orbit.c").exists()


def test_a_chain_alone(run: Runs) -> None:
    scene = chain() + '[export]\nc = ["rhs"]\n'
    assert "export        C code of the chain in export/: rhs" in run(scene, command="check").out
    run(scene)
    wanted = ["CMakeLists.txt", "README.md", "chain.c", "chain.h", "license.txt", "main.c"]
    assert sorted(path.name for path in (run.out / "export").iterdir()) == wanted


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not there")
def test_cmake_builds_it(run: Runs) -> None:
    run(chain() + '[export]\nc = "all"\n')
    folder, build = run.out / "export", run.folder / "build"
    subprocess.run(["cmake", "-S", str(folder), "-B", str(build)], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", str(build)], check=True, capture_output=True)
    done = subprocess.run([str(build / "chain_main")], check=True, capture_output=True, text=True)
    assert "\nperiod " in done.stdout


def test_an_orbit_that_the_family_does_not_reach(run: Runs) -> None:
    error = run(chain() + FAMILY.replace("0.5", "0.5\nmax_points = 3") + ORBIT, status=1).err
    assert "[export]: at: given S = 0.4, which = 0; the branch covers" in error
    assert "export" not in run.files


@pytest.mark.slow
@needs_compiler
def test_the_example_prints_numbers_of_independent_codes(run: Runs) -> None:
    run(EXAMPLES / "breather_in_c.toml")
    program = build_c(run.out / "export")
    lines = subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout.splitlines()
    found = {name: float(value) for name, value in map(str.split, lines)}
    assert abs(found["period"] / (2 * np.pi / 1.018532435491958) - 1) < 1e-13
    assert abs(found["largest_multiplier"] - 1.171275734790) < 1e-12
