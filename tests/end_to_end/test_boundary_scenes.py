"""Diagrams of boundary-value problems from scenes: what leaves, curves in two parameters, multipliers, files."""

from __future__ import annotations

import numpy as np
import pytest
from outputs import EXAMPLES
from scenes import Runs, written
from scipy.special import ellipk

from casadi_skin.runs.output import Progress

pytestmark = pytest.mark.slow

MODEL = """
import casadi as ca
from casadi_skin import BoundaryValueProblem, OdeModel
u, v, lam, q, a, x, y, t = (ca.SX.sym(n) for n in ("u", "v", "lam", "q", "a", "x", "y", "t"))
bent = OdeModel("column", ca.vertcat(u, v), ca.vertcat(v, -lam * ca.sin(u) + q * u), ca.vertcat(lam, q))
column = BoundaryValueProblem(bent, [bent.start(u), bent.end(u)], parameters={"lam": 5.0, "q": 0.0})
rhs = ca.vertcat(a * x - 2 * y + ca.cos(t), 2 * x + a * y) - (x**2 + y**2) * ca.vertcat(x, y)
driven = OdeModel("driven", ca.vertcat(x, y), rhs, a, time=t, forcing_period=6.283185307179586)
ends = [driven.start(x) - driven.end(x), driven.start(y) - driven.end(y)]
pull = ca.vertcat(a * x, (a - 2) * y) - (x**2 + y**2) * ca.vertcat(x, y)
odd = OdeModel("odd", ca.vertcat(x, y), pull, a)
alternates = [odd.end(x) + odd.start(x), odd.end(y) + odd.start(y)]
flip = BoundaryValueProblem(odd, alternates, parameters={"a": -0.3})
w, z, p = (ca.SX.sym(n) for n in "wzp")
rate = -((p * 3.141592653589793) ** 2)
both = OdeModel("twins", ca.vertcat(u, v, w, z), ca.vertcat(v, rate * u + u**2, z, rate * w + w**2), p)
twins = BoundaryValueProblem(both, [both.start(u), both.end(u), both.start(w), both.end(w)], parameters={"p": 0.5})
loop = BoundaryValueProblem(driven, ends, interval=(0, 6.283185307179586), parameters={"a": 0.4})
"""


def scene(run: Runs, name: str, rest: str) -> str:
    guess = {"column": "u = 0.0, v = 0.0", "twins": "u = 0.0, v = 0.0, w = 0.0, z = 0.0"}.get(name, "x = 0.0, y = 0.0")
    return written(run.folder, MODEL, name, f"[solution]\nguess = {{ {guess} }}\n{rest}")


def test_the_example_of_a_heated_slab(run: Runs) -> None:
    printed = run(EXAMPLES / "heated_slab.toml").out
    points = run.rows("special_points")
    assert [(p["branch"], p["kind"]) for p in points] == [("branch", "fold"), ("branch", "fold"), ("curve_1", "cusp")]
    assert float(points[0]["lambda"]) == pytest.approx(4.6479180091289386, abs=1e-12)  # by quadrature with mpmath
    assert float(points[2]["eps"]) == pytest.approx(0.24578042723, abs=1e-11)
    assert {"branch.csv", "branch.nc", "branch.png", "curves.png", "curve_1.csv", "curve_1.nc"} <= run.files
    assert "curve_2.csv" not in run.files  # the second fold is on the curve of the first one
    assert "solutions" in printed
    assert "equilibria" not in printed


def test_bent_columns_and_the_load_at_which_they_bend(run: Runs) -> None:
    rest = '[continuation]\nparameter = "lam"\nto = 15.0\nswitch = ["branch point"]\n'
    rest += 'curve = { parameter = "q", to = 4.0 }\n'
    run(scene(run, "column", rest), "--quiet")
    (point,) = run.rows("special_points")
    assert abs(float(point["lam"]) - np.pi**2) <= float(point["error"]) + 1e-14 < 1e-12
    curve = run.rows("curve_1")
    np.testing.assert_allclose([float(r["lam"]) - float(r["q"]) for r in curve], np.pi**2, rtol=0, atol=1e-10)
    bent = run.rows("other_1")[-1]
    assert float(bent["lam"]) == 15.0
    largest = max(float(bent["u_max"]), -float(bent["u_min"]))  # of a pendulum, which takes 2 K / sqrt(lam) for half
    assert 2.0 * ellipk(np.sin(0.5 * largest) ** 2) / np.sqrt(15.0) == pytest.approx(1.0, abs=1e-7)


def test_two_branches_that_cross_in_one_place_are_one_point_of_a_scene(run: Runs) -> None:
    """At p = 1 and 2, where sin(p pi x) solves the linear problem of both."""
    rest = '[continuation]\nparameter = "p"\nto = 2.3\n'
    run(scene(run, "twins", rest), "--quiet")
    points = run.rows("special_points")
    assert [point["kind"] for point in points] == ["branch point"] * 2
    for exact, point in enumerate(points, start=1):
        assert abs(float(point["p"]) - exact) <= float(point["error"]) < 1e-9


def test_solutions_of_two_turns_are_a_branch_of_the_diagram(run: Runs) -> None:
    """x' = a x - x^3 with x(1) = -x(0): x = 0, and x = sqrt(a) after two turns."""
    rest = '[continuation]\nparameter = "a"\nto = 0.4\nswitch = ["period doubling"]\n[stability]\n'
    printed = run(scene(run, "flip", rest)).out
    (point,) = run.rows("special_points")
    assert (point["kind"], point["criticality"]) == ("period doubling", "supercritical")
    assert float(point["coefficient"]) == pytest.approx(-1.0, rel=1e-9)
    assert abs(float(point["a"])) < 1e-12
    last = run.rows("other_1")[-1]
    assert float(last["x_max"]) == pytest.approx(np.sqrt(0.4), rel=1e-7)
    assert "period doubling" in printed


def test_multipliers_of_solutions_that_close_survive_an_interruption(
    run: Runs, monkeypatch: pytest.MonkeyPatch
) -> None:
    run(scene(run, "loop", '[continuation]\nparameter = "a"\nto = 0.54\n[stability]\n'), "--quiet")
    assert [row["kind"] for row in run.rows("special_points")] == ["branch point", "stability lost (real)"]
    whole, told = (run.out / "branch.csv").read_bytes(), Progress.solution

    def interrupt(self: Progress, solution: object, points: int) -> None:
        told(self, solution, points)  # type: ignore[arg-type]
        if points == 4:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Progress, "solution", interrupt)
        run("", "--quiet", "--overwrite", status=130)
    run("", "--quiet", "--resume")
    assert (run.out / "branch.csv").read_bytes() == whole
