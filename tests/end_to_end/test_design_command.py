"""A scene with a [design]: its plan, its files, its exit status, of orbits of a family and of special points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from outputs import EXAMPLES
from scenes import Runs, chain, table
from scipy.io import netcdf_file

pytestmark = pytest.mark.usefixtures("blank")


def design(**keys: Any) -> str:
    given = {"quantity": "participation", "over": ["gamma"], "bounds": {"gamma": [0.1, 0.6]}}
    return chain(6, gamma=0.3, g=1.0) + table("design", **given | keys)


@pytest.mark.usefixtures("pictures")
def test_run_writes_optima_the_way_and_a_picture(run: Runs) -> None:
    assert "the optimum sits on a bound: gamma <= 0.6; " in run(design(starts=2)).out
    (best,) = run.rows("design")
    assert (best["found"], float(best["gamma"])) == ("1", 0.6)
    way = run.rows("design_path")
    assert float(way[0]["gamma"]) == 0.3
    assert float(way[-1]["value"]) == float(best["value"])
    assert len(way) == int(best["designs"])
    with netcdf_file(run.out / "design.nc", mmap=False) as file:
        profile = file.variables["profile"].data[0, 0].astype(float)
    assert np.sum(profile**2) ** 2 / np.sum(profile**4) == pytest.approx(float(best["value"]), rel=1e-9)
    assert run.files == {"scene.toml", "design.csv", "design_path.csv", "design.nc", "design.png"}
    assert "complete run already" in run("", "--resume").out
    run(status=2)
    run("", "--overwrite")


def test_the_plan_of_a_design(run: Runs) -> None:
    held = [{"quantity": "Omega_slope", "lower": 0.0}, {"quantity": "S*Omega", "equal": 2.0}]
    printed = run(design(subject_to=held, S=[0.5, 1.0], quantity="a.Omega"), command="check", status=2)
    assert "[design] subject_to, Omega_slope: given 'Omega_slope'; accepted: NAME.QUANTITY" in printed.err
    printed = run(design(subject_to=held), command="check").out
    for words in ("smallest participation of the orbits at S = 1.0", "0.1 <= gamma <= 0.6", "S*Omega = 2", "SLSQP"):
        assert words in printed


@pytest.mark.slow
def test_constraints_that_cannot_be_met_have_status_1(run: Runs) -> None:
    told = run(design(subject_to=[{"quantity": "Omega", "lower": 5.0}]), status=1)
    assert len(told.err.splitlines()) == 1
    assert "[design]: the constraints are not met; Omega is off by" in told.err
    assert "design.csv" in run.files


def test_the_example_scene(run: Runs) -> None:
    run(EXAMPLES / "design_hardest_breather.toml")
    best = run.rows("design")[0]
    assert float(best["gamma"]) == pytest.approx(0.663154498, abs=1e-8)
    assert float(best["S"]) == pytest.approx(0.961039022, abs=1e-9)


LORENZ = """
import casadi as ca
from casadi_skin import OdeModel

x, y, z, sigma, r, beta = (ca.SX.sym(name) for name in ("x", "y", "z", "sigma", "r", "beta"))
field = ca.vertcat(sigma * (y - x), x * (r - z) - y, x * y - beta * z)
lorenz = OdeModel("Lorenz", ca.vertcat(x, y, z), field, ca.vertcat(sigma, r, beta))
"""


def test_a_special_point_of_the_branch_is_designed(run: Runs) -> None:
    (run.scene.parent / "lorenz.py").write_text(LORENZ, encoding="utf-8")
    scene = (
        '[model]\nfile = "lorenz.py"\nname = "lorenz"\n'
        "parameters = { sigma = 10.0, r = 20.0, beta = 2.6666666666666665 }\n"
        '[equilibrium]\nstart = [8.0, 8.0, 19.0]\n[continuation]\nparameter = "r"\nto = 30.0\n'
        '[design]\nquantity = "r"\nof = ["hopf"]\nover = ["sigma"]\nbounds = { sigma = [5.0, 40.0] }\n'
    )
    assert "found an optimum inside its bounds" in run(scene).out
    b = 8 / 3
    assert float(run.rows("design")[0]["sigma"]) == pytest.approx(b + 1 + np.sqrt((b + 1) * (2 * b + 4)), abs=1e-6)
    told = run(scene.replace('"hopf"', '"hopf 3"'), "--overwrite", status=1)
    assert "of: given 'hopf 3'; accepted: special points of the branch, whose kinds are: " in told.err
