"""Diagrams of boundary-value problems from scenes: what leaves, curves in two parameters, multipliers, files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from apart import Ended
from outputs import read_rows as rows
from scipy.special import ellipk

from casadi_skin.runs.program import main
from casadi_skin.runs.progress import Progress

ROOT = Path(__file__).parents[2]

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


def scene(tmp_path: Path, name: str, rest: str) -> str:
    (tmp_path / "model.py").write_text(MODEL, encoding="utf-8")
    guess = {"column": "u = 0.0, v = 0.0", "twins": "u = 0.0, v = 0.0, w = 0.0, z = 0.0"}.get(name, "x = 0.0, y = 0.0")
    text = f'[model]\nfile = "model.py"\nname = "{name}"\n[solution]\nguess = {{ {guess} }}\n{rest}'
    (tmp_path / "scene.toml").write_text(text, encoding="utf-8")
    return str(tmp_path / "scene.toml")


@pytest.mark.slow
def test_the_example_of_a_heated_slab(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert main(["run", str(ROOT / "examples" / "heated_slab.toml"), "--out", str(out)]) == 0
    points = rows(out / "special_points.csv")
    assert [(p["branch"], p["kind"]) for p in points] == [("branch", "fold"), ("branch", "fold"), ("curve_1", "cusp")]
    assert float(points[0]["lambda"]) == pytest.approx(4.6479180091289386, abs=1e-12)  # by quadrature with mpmath
    assert float(points[2]["eps"]) == pytest.approx(0.24578042723, abs=1e-11)
    for name in ("branch.csv", "branch.nc", "branch.png", "curves.png", "curve_1.csv", "curve_1.nc"):
        assert (out / name).exists(), name
    assert not (out / "curve_2.csv").exists()  # the second fold is on the curve of the first one
    printed = capsys.readouterr().out
    assert "solutions" in printed
    assert "equilibria" not in printed


@pytest.mark.slow
def test_bent_columns_and_the_load_at_which_they_bend(tmp_path: Path) -> None:
    rest = '[continuation]\nparameter = "lam"\nto = 15.0\nswitch = ["branch point"]\n'
    rest += 'curve = { parameter = "q", to = 4.0 }\n'
    assert main(["run", scene(tmp_path, "column", rest), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    (point,) = rows(tmp_path / "out" / "special_points.csv")
    assert abs(float(point["lam"]) - np.pi**2) <= float(point["error"]) + 1e-14 < 1e-12
    curve = rows(tmp_path / "out" / "curve_1.csv")
    np.testing.assert_allclose([float(r["lam"]) - float(r["q"]) for r in curve], np.pi**2, rtol=0, atol=1e-10)
    bent = rows(tmp_path / "out" / "other_1.csv")[-1]
    assert float(bent["lam"]) == 15.0
    largest = max(float(bent["u_max"]), -float(bent["u_min"]))  # of a pendulum, which takes 2 K / sqrt(lam) for half
    assert 2.0 * ellipk(np.sin(0.5 * largest) ** 2) / np.sqrt(15.0) == pytest.approx(1.0, abs=1e-7)


@pytest.mark.slow
def test_two_branches_that_cross_in_one_place_are_one_point_of_a_scene(tmp_path: Path) -> None:
    """At p = 1 and 2, where sin(p pi x) solves the linear problem of both."""
    rest = '[continuation]\nparameter = "p"\nto = 2.3\n'
    assert main(["run", scene(tmp_path, "twins", rest), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    points = rows(tmp_path / "out" / "special_points.csv")
    assert [point["kind"] for point in points] == ["branch point"] * 2
    for exact, point in enumerate(points, start=1):
        assert abs(float(point["p"]) - exact) <= float(point["error"]) < 1e-9


@pytest.mark.slow
def test_solutions_of_two_turns_are_a_branch_of_the_diagram(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """x' = a x - x^3 with x(1) = -x(0): x = 0, and x = sqrt(a) after two turns."""
    rest = '[continuation]\nparameter = "a"\nto = 0.4\nswitch = ["period doubling"]\n[stability]\n'
    assert main(["run", scene(tmp_path, "flip", rest), "--out", str(tmp_path / "out")]) == 0
    (point,) = rows(tmp_path / "out" / "special_points.csv")
    assert (point["kind"], point["criticality"]) == ("period doubling", "supercritical")
    assert float(point["coefficient"]) == pytest.approx(-1.0, rel=1e-9)
    assert abs(float(point["a"])) < 1e-12
    last = rows(tmp_path / "out" / "other_1.csv")[-1]
    assert float(last["x_max"]) == pytest.approx(np.sqrt(0.4), rel=1e-7)
    assert "period doubling" in capsys.readouterr().out


@pytest.mark.slow
def test_multipliers_of_solutions_that_close_survive_an_interruption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rest = '[continuation]\nparameter = "a"\nto = 0.54\n[stability]\n'
    path, told = scene(tmp_path, "loop", rest), Progress.solution
    assert main(["run", path, "--out", str(tmp_path / "whole"), "--quiet"]) == 0
    kinds = [row["kind"] for row in rows(tmp_path / "whole" / "special_points.csv")]
    assert kinds == ["branch point", "stability lost (real)"]

    def interrupt(self: Progress, solution: object, points: int) -> None:
        told(self, solution, points)  # type: ignore[arg-type]
        if points == 4:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Progress, "solution", interrupt)
        assert main(["run", path, "--out", str(tmp_path / "parts"), "--quiet"]) == 130
    assert main(["run", path, "--out", str(tmp_path / "parts"), "--quiet", "--resume"]) == 0
    assert (tmp_path / "parts" / "branch.csv").read_bytes() == (tmp_path / "whole" / "branch.csv").read_bytes()


@pytest.mark.parametrize(
    ("rest", "words"),
    [
        ("[stability]\n", "[stability]: given with column, which has other conditions; accepted: x(end) = S x(start)"),
        (
            '[continuation]\nparameter = "lam"\nto = 9.0\nswitch = ["hopf"]\n',
            '[continuation] switch: given "hopf" beside [solution]; accepted: "branch point" and "period doubling"',
        ),
        (
            '[continuation]\nparameter = "lam"\nto = 9.0\ncurve = { parameter = "p", to = 1.0 }\n',
            "[continuation] curve: ",
        ),
    ],
)
def test_what_is_refused(tmp_path: Path, rest: str, words: str, cli: Callable[..., Ended]) -> None:
    done = cli("run", scene(tmp_path, "column", rest), "--out", tmp_path / "out", "--quiet")
    assert words in done.line
    assert not (tmp_path / "out").exists()
