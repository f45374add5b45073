"""The examples and the README's Python lines, each with numbers that were computed independently."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from casadi_skin.cli import main

ROOT = Path(__file__).parents[2]

# (g, mode, S): Omega and the largest |multiplier|, N = 24, alpha = 1, gamma = 0.25; computed independently.
REFERENCE = {
    (-1.0, 1, 0.2): (1.036393147166972, 1.0),
    (-1.0, 1, 1.0): (1.018532435491958, 1.1712757347898),
    (-1.0, 1, 3.0): (0.765958900020734, 1.2016342571861),
    (1.0, 24, 0.2): (2.219433261085633, 1.0),
    (1.0, 24, 1.0): (2.227561552547991, 1.0314315571659),
    (1.0, 24, 3.0): (2.320036427769367, 1.0),
}


def requested_points(directory: Path) -> dict[tuple[int, float], tuple[float, float]]:
    with (directory / "family.csv").open(encoding="utf-8", newline="") as file:
        table = [row for row in csv.DictReader(file) if row["requested"] == "1"]
    return {(int(r["mode"]), float(r["S"])): (float(r["Omega"]), float(r["max_abs_multiplier"])) for r in table}


def test_pictures_of_a_run_are_drawn(tmp_path: Path) -> None:
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    chain = "[chain]\nsites = 2\nalpha = 1.0\ngamma = 0.25\ng = 1.0\n"
    scene.write_text(chain + "[family]\nmode = 1\namplitude_max = 0.1\n", encoding="utf-8")
    assert main(["run", str(scene), "--out", str(out), "--quiet"]) == 0
    assert (out / "frequency.png").read_bytes().startswith(b"\x89PNG")
    assert "</svg>" in (out / "frequency.svg").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
def test_softening_end_breather(tmp_path: Path) -> None:
    assert main(["run", str(ROOT / "examples" / "softening_end_breather.toml"), "--out", str(tmp_path / "out")]) == 0
    points = requested_points(tmp_path / "out")
    assert len(points) == 3
    for (mode, S), values in points.items():
        np.testing.assert_allclose(values, REFERENCE[-1.0, mode, S], rtol=0, atol=2e-9)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "g"), [("hardening", 1.0), ("softening", -1.0)])
def test_twelve_families_of_figure_3(name: str, g: float, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    assert main(["run", str(ROOT / "examples" / f"families_{name}.toml"), "--out", str(tmp_path / "out")]) == 0
    points = requested_points(tmp_path / "out")
    assert len(points) == 24
    known = {(mode, S): values for (sign, mode, S), values in REFERENCE.items() if sign == g}
    for place, (Omega, multiplier) in known.items():
        assert abs(points[place][0] - Omega) < 1e-10
        assert abs(points[place][1] - multiplier) < 1e-8
    with xarray.open_dataset(tmp_path / "out" / "family.nc", engine="scipy") as data:
        assert float(data.trivial_deviation.max()) < 1e-10
        shift = np.sign(data.Omega_shift.values)
        np.testing.assert_array_equal(shift, g)


@pytest.mark.slow
def test_the_python_examples_of_the_readme_run() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    family, own = re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL)
    names: dict[str, Any] = {}
    exec(compile(family, "README.md", "exec"), names)
    assert np.isfinite(names["branch"].Omega).all()
    names = {}
    exec(compile(own, "README.md", "exec"), names)
    assert names["orbit"].period == pytest.approx(6.66328685932)  # Hairer, Norsett and Wanner 1993, exercise I.16.1
