"""Scenes with [export]: what is written, and what the plan says."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from apart import Ended

from casadi_skin import Chain, follow_family
from casadi_skin.export.codegen import build_c
from casadi_skin.runs.program import main

pytestmark = pytest.mark.usefixtures("blank")

Cli = Callable[..., Ended]
CHAIN = "[chain]\nsites = 6\nalpha = 1.0\ngamma = 0.25\ng = -1.0\n"
FAMILY = "[family]\nmode = [2, 1]\namplitude_max = 0.5\n[accuracy]\ntolerance = 1e-11\n"
ORBIT = '[export]\nc = "all"\nS = 0.4\nmode = 1\n'


def write_scene(path: Path, *tables: str) -> Path:
    path.write_text("".join((CHAIN, *tables)), encoding="utf-8")
    return path


needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="cc is not there (CI has it)")


@needs_compiler
def test_from_a_scene_to_a_running_program(tmp_path: Path, cli: Cli) -> None:
    out, scene = tmp_path / "out", write_scene(tmp_path / "s.toml", FAMILY, "[stability]\n", ORBIT)
    assert f"exported to {out / 'export'}" in cli("run", scene, "--out", out).out
    printed = subprocess.run([str(build_c(out / "export"))], capture_output=True, text=True, check=True).stdout
    found = {name: float(value) for name, value in (line.split() for line in printed.splitlines())}
    orbit = follow_family(Chain(6, 1.0, 0.25, -1.0), mode=1, amplitude_max=0.4, at=(0.4,), tolerance=1e-11).at(S=0.4)
    expected = [orbit.period, orbit.floquet().max_abs_multiplier]
    np.testing.assert_allclose([found["period"], found["largest_multiplier"]], expected, rtol=1e-12)
    before = (out / "export" / "main.c").stat().st_mtime_ns
    assert cli("run", scene, "--out", out, "--resume").status == 0
    assert (out / "export" / "main.c").stat().st_mtime_ns == before
    refused = cli("run", scene, "--out", out, "--overwrite").line
    assert "holds main, which no run wrote" in refused  # the program is not ours to remove
    (out / "export" / "main").unlink()
    assert cli("run", scene, "--out", out, "--overwrite").status == 0
    assert (out / "export" / "chain_orbit.c").exists()


def test_a_chain_alone(tmp_path: Path, cli: Cli) -> None:
    scene = write_scene(tmp_path / "s.toml", '[export]\nc = ["rhs"]\n')
    assert "export        C code of the chain in export/: rhs" in cli("check", scene).out
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    wanted = ["CMakeLists.txt", "README.md", "chain.c", "chain.h", "license.txt", "main.c"]
    assert sorted(path.name for path in (tmp_path / "out" / "export").iterdir()) == wanted


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cmake") is None, reason="cmake is not there")
def test_cmake_builds_it(tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "s.toml", '[export]\nc = "all"\n')
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    folder, build = tmp_path / "out" / "export", tmp_path / "build"
    subprocess.run(["cmake", "-S", str(folder), "-B", str(build)], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", str(build)], check=True, capture_output=True)
    done = subprocess.run([str(build / "chain_main")], check=True, capture_output=True, text=True)
    assert done.stdout.startswith("period ")


def test_an_orbit_that_the_family_does_not_reach(tmp_path: Path, cli: Cli) -> None:
    scene = write_scene(tmp_path / "s.toml", FAMILY.replace("0.5", "0.5\nmax_points = 3"), ORBIT)
    status, _, error = cli("run", scene, "--out", tmp_path / "out")
    assert status == 1
    assert "[export]: at: given S = 0.4, which = 0; the branch covers" in error
    assert not (tmp_path / "out" / "export").exists()


@pytest.mark.slow
@needs_compiler
def test_the_example_prints_numbers_of_independent_codes(tmp_path: Path) -> None:
    scene = Path(__file__).parents[2] / "examples" / "breather_in_c.toml"
    assert main(["run", str(scene), "--out", str(tmp_path / "out")]) == 0
    program = build_c(tmp_path / "out" / "export")
    lines = subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout.splitlines()
    found = {name: float(value) for name, value in map(str.split, lines)}
    assert abs(found["period"] / (2 * np.pi / 1.018532435491958) - 1) < 1e-13
    assert abs(found["largest_multiplier"] - 1.171275734790) < 1e-12
