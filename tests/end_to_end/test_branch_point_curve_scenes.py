"""Curves of branch points from scenes, of orbits and boundary-value problems: their points of codimension two."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from casadi_skin.runs.program import main

MODELS = """
import casadi as ca
import numpy as np
from casadi_skin import BoundaryValueProblem, OdeModel
x, y, z, a, k = (ca.SX.sym(name) for name in ("x", "y", "z", "a", "k"))
growth = 1 - x**2 - y**2
rhs = ca.vertcat(growth * x - y, growth * y + x, (a - k**2) * z + (k - 0.2) * z**3 - z**5)
mirror = OdeModel("mirror", ca.vertcat(x, y, z), rhs, ca.vertcat(a, k), nominal=(-0.2, -0.5))
bent = OdeModel("column", ca.vertcat(x, y), ca.vertcat(y, -a * ca.sin(x) - k * x**3), ca.vertcat(a, k))
column = BoundaryValueProblem(bent, [bent.start(x), bent.end(x)], parameters={"a": 5.0, "k": 0.0})
"""
ORBIT = """
[orbit]
start = { x = 1.0, y = 0.0, z = 0.0 }
transient = 20.0

[stability]
"""
SOLUTION = """
[solution]
guess = { x = 0.0, y = 0.0 }
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "start", "to", "known"), [("mirror", ORBIT, 1.0, 0.2), ("column", SOLUTION, 12.0, np.pi**2 / 6.0)]
)
def test_curves_of_branch_points(tmp_path: Path, name: str, start: str, to: float, known: float) -> None:
    """z' = (a - k^2) z + (k - 0.2) z^3 beside a cycle; u'' + a sin u + k u^3 = 0 has the cubic term pi^2/6 - k."""
    (tmp_path / "models.py").write_text(MODELS, encoding="utf-8")
    text = f'[model]\nfile = "models.py"\nname = "{name}"\n{start}'
    text += f'[continuation]\nparameter = "a"\nto = {to}\ncurve = {{ parameter = "k", to = 2.0 }}\n'
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    with (tmp_path / "out" / "special_points.csv").open(encoding="utf-8", newline="") as file:
        points = [row for row in csv.DictReader(file) if row["branch"] == "curve_1"]
    assert [row["kind"] for row in points] == ["degenerate pitchfork"]
    assert abs(float(points[0]["k"]) - known) <= 3.0 * float(points[0]["error"]) + 1e-15 < 1e-9
