"""The plan of a chain's families without numerics: the same lines as with them, for scenes whose plan is known."""

import subprocess
import sys
from pathlib import Path

import pytest
from scenes import chain, family

from casadi_skin.runs.binding import bind
from casadi_skin.runs.plan import chain_lines, plan_lines
from casadi_skin.runs.reading import parse_scene

FAMILY = chain(24) + family([1, "last"], 3.0, at=[0.5, 3.0])
KNOWN = [
    FAMILY,
    FAMILY.replace("at = [0.5, 3.0]", "at_Omega = [0.9]\nperiod_max = 8.5\nmax_points = 17"),
    FAMILY + "[spectrum]\n[stability]\n[figures]\nformats = []\n[accuracy]\ntolerance = 1e-6\n",
    FAMILY + '[stability]\nevents = false\n[method]\ncorrector = "newton"\nflow = "cvodes"\n',
    FAMILY.replace("24", "1").replace("0.25", "-0.9").replace("-1.0", "2").replace(', "last"', ""),
    FAMILY.replace("sites = 24", "sites = 499").replace("[1, ", "[1, 17, "),
]
OTHERS = [
    FAMILY.replace("sites = 24", "sites = 500"),
    FAMILY.replace("0.25", "1.0").replace('[1, "last"]', "1"),
    FAMILY + "[dynamics]\nmode = 1\nS = 1.0\nduration = 3.0\n",
    FAMILY + "[accuracy]\ncertify = true\n",
    FAMILY + '[method]\ntranscription = "gauss"\n',
    FAMILY.replace("3.0", "1e200"),
    FAMILY.replace("[family]", "[spectrum]\n[family]").replace("alpha = 1.0", "alpha = -0.1").replace("[1,", "[20,"),
]


@pytest.mark.parametrize("text", KNOWN)
def test_lines_are_those_of_the_request(text: str) -> None:
    scene = parse_scene(text, "scene.toml")
    assert chain_lines(scene) == plan_lines(bind(scene, Path("scene.toml")), measure=False)


@pytest.mark.parametrize("text", OTHERS)
def test_other_scenes_are_checked_with_numerics(text: str) -> None:
    assert chain_lines(parse_scene(text, "scene.toml")) is None


@pytest.mark.parametrize("command", ["check", "spectrum", "--help"])
def test_no_numerics_are_loaded(command: str, tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(FAMILY, encoding="utf-8")
    code = f"""
import sys
from casadi_skin.runs.program import main
try:
    status = main([{command!r}, "scene.toml"])
except SystemExit as end:
    status = end.code
sys.exit(status or bool({{"numpy", "casadi", "matplotlib", "rich"}} & set(sys.modules)))
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, capture_output=True)
