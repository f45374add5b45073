"""Curves of branch points from scenes, of orbits and boundary-value problems: their points of codimension two."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import Runs, table, written

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
ORBIT = table("orbit", start={"x": 1.0, "y": 0.0, "z": 0.0}, transient=20.0) + "[stability]\n"
SOLUTION = table("solution", guess={"x": 0.0, "y": 0.0})


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "start", "to", "known"), [("mirror", ORBIT, 1.0, 0.2), ("column", SOLUTION, 12.0, np.pi**2 / 6.0)]
)
def test_curves_of_branch_points(name: str, start: str, to: float, known: float, run: Runs) -> None:
    """z' = (a - k^2) z + (k - 0.2) z^3 beside a cycle; u'' + a sin u + k u^3 = 0 has the cubic term pi^2/6 - k."""
    curve = table("continuation", parameter="a", to=to, curve={"parameter": "k", "to": 2.0})
    run(written(run.folder, MODELS, name, start + curve), "--quiet")
    points = [row for row in run.rows("special_points") if row["branch"] == "curve_1"]
    assert [row["kind"] for row in points] == ["degenerate pitchfork"]
    assert abs(float(points[0]["k"]) - known) <= 3.0 * float(points[0]["error"]) + 1e-15 < 1e-9
