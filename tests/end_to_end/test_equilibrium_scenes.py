"""Scenes of equilibria: their tables, files and pictures; refusals are among tests/unit/refused_models.txt."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from outputs import EXAMPLES, read_rows
from scenes import Runs, written

from casadi_skin import OdeModel, find_orbit, simulate

MODEL = """
import casadi as ca
from casadi_skin import OdeModel, BoundaryValueProblem
x, y, p, t = (ca.SX.sym(n) for n in "xypt")
crossing = OdeModel("crossing", x, x * (1 - p**2 - x), p, nominal=(-2.0,))
cubic = OdeModel("cubic", ca.vertcat(x, y), ca.vertcat(p + x - x**3, -y), p, nominal=(-1.0,))
v = (p - y**2) * y - x + p
rayleigh = OdeModel("rayleigh", ca.vertcat(x, y), ca.vertcat(y, v), p, nominal=(0.75,))
twins = OdeModel("twins", ca.vertcat(x, y), ca.vertcat(p * x - x**3, p * y - y**3), p)
"""
QUIET = "--quiet"


def continued(run: Runs, name: str, start: str, rest: str) -> str:
    """A scene of a branch in p."""
    return written(run.folder, MODEL, name, f'{start}\n[continuation]\nparameter = "p"\n{rest}\n')


def special(run: Runs, *columns: str) -> list[tuple[str, ...]]:
    """Columns of the table of special points."""
    return [tuple(row[name] for name in columns) for row in run.rows("special_points")]


@pytest.mark.slow
def test_the_example_of_carbon_monoxide(run: Runs) -> None:
    """Values published in MatCont's manual for the catalytic oscillator, to the digits printed there."""
    printed = run(EXAMPLES / "carbon_monoxide.toml").out
    points = run.rows("special_points")
    on_branch = [(p["kind"], round(float(p["q2"]), 5)) for p in points if p["branch"] == "branch"]
    assert on_branch == [("hopf", 1.05156), ("fold", 1.04205), ("fold", 1.05220), ("hopf", 1.04099)]
    assert {p["kind"] for p in points if p["branch"] != "branch"} == {"cusp", "generalized hopf"}
    assert all(0.0 < float(p["error"]) < 1e-10 for p in points)
    assert {"branch.csv", "branch.nc", "branch.png", "curves.png", "curve_1.csv", "curve_2.nc"} <= run.files
    assert "curve_3.csv" not in run.files  # the second fold is on the curve of the first one
    assert list(run.rows("curve_2")[0])[3:5] == ["k", "q2"]
    assert "curve" in printed
    assert "subcrit" in printed


@pytest.mark.slow
def test_the_example_of_prey_and_predators(run: Runs) -> None:
    """Closed forms: predators enter at K = 1; the balance is lost at K = 3, at x = 1 and with frequency 1/sqrt(3)."""
    run(EXAMPLES / "prey_and_predators.toml", QUIET)
    assert special(run, "branch", "kind") == [("branch", "branch point"), ("other_1", "hopf")]
    assert run.columns("special_points", "K")[0] == pytest.approx([1.0, 3.0], abs=1e-12)
    lost = run.rows("special_points")[1]
    assert abs(float(lost["frequency"]) - 3.0**-0.5) < 1e-12
    assert lost["criticality"] == "supercritical"
    assert "portrait.png" in run.files
    cycles = run.rows("cycles_1_1")
    assert float(cycles[0]["period"]) == pytest.approx(2.0 * np.pi * 3.0**0.5, rel=1e-10)
    assert float(cycles[-1]["K"]) == 5.0
    assert {row["stable"] for row in cycles} == {"1"}
    np.testing.assert_allclose(run.columns("other_1", "x")[0], 1.0, rtol=1e-10)
    assert [row["special"] for row in run.rows("other_1")].count("hopf") == 1


@pytest.mark.slow
def test_an_interrupted_diagram_goes_on_where_it_was(run: Runs, monkeypatch: pytest.MonkeyPatch) -> None:
    from casadi_skin.runs.output import Progress

    scene, seen = EXAMPLES / "prey_and_predators.toml", iter(range(25))
    run(scene, QUIET)
    whole = run.out.rename(run.folder / "whole")

    def interrupt(self: Progress, solution: object, points: int) -> None:
        if next(seen, None) is None:
            raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Progress, "solution", interrupt)
        run(scene, QUIET, status=130)
    run(scene, QUIET, "--resume")
    for name in ("branch.csv", "other_1.csv", "cycles_1_1.csv", "special_points.csv"):
        for before, after in zip(read_rows(whole / name), read_rows(run.out / name), strict=True):
            for key, value in before.items():
                try:
                    assert float(after[key]) == pytest.approx(float(value), rel=1e-6, abs=1e-6), (name, key)
                except ValueError:
                    assert after[key] == value


@pytest.mark.slow
def test_a_whole_diagram_has_both_halves_of_what_crosses(run: Runs) -> None:
    """x' = x (1 - p^2 - x): x = 1 - p^2 crosses x = 0 at p = -1 and at p = 1."""
    scene = continued(run, "crossing", "parameters = { p = -2.0 }\n[equilibrium]\nstart = [0]", "to = 2.0\ndepth = 1")
    run(scene, QUIET)
    assert {(kind, round(float(p), 12)) for kind, p in special(run, "kind", "p")} == {
        ("branch point", -1.0), ("branch point", 1.0),
    }  # fmt: skip
    for name, end in (("other_1", 2.0), ("other_1b", -2.0)):
        p, x = run.columns(name, "p", "x")
        assert p[-1] == end
        assert x == pytest.approx(1.0 - p**2, abs=1e-10)
    assert not list(run.out.glob("other_2*"))
    run(scene + "limit = 2\n", QUIET, "--overwrite", status=1)


@pytest.mark.slow
def test_the_equilibria_to_which_cycles_shrink_leave_an_orbit(run: Runs) -> None:
    """Cycles about x = p, born at p = 0: the equilibria go on to -1 with stable focus, and without one cycle more."""
    start = "[orbit]\nstart = [1.9, 0.0]\nperiod = 6.28\n[figures]\nformats = []"
    run(continued(run, "rayleigh", start, 'to = -1.0\nswitch = ["hopf"]'), QUIET, status=1)  # cycles end before -1
    assert special(run, "branch", "kind") == [("branch", "hopf"), ("other_1", "hopf")]
    assert {(row["stable"], row["y"]) for row in run.rows("other_1")[1:]} == {("1", "0")}
    p, x = run.columns("other_1", "p", "x")
    assert abs(p[0]) <= 1e-15
    assert p[-1] == -1.0
    assert x == pytest.approx(p, abs=1e-12)
    assert sorted(path.name for path in run.out.glob("*_1*.csv")) == ["other_1.csv"]


def test_what_is_not_resolved_is_in_every_answer_of_a_run(run: Runs) -> None:
    """Two branch points at once: the table, standard error and the exit status name the stretch, again on resuming."""
    scene = continued(run, "twins", "[model.parameters]\np = -1.0\n[equilibrium]\nstart = [0.0, 0.0]", "to = 1.0")
    for more in ([], ["--resume"]):
        (words,) = run(scene, *more, status=1).err.splitlines()[-1:]
        assert "[continuation]: not resolved: branch point at p = " in words
        assert special(run, "kind") == [("branch point",), ("unresolved",)]
        p, error = run.columns("special_points", "p", "error")
        assert abs(p[1]) <= 2.0 * error[1] < 1e-5


def test_a_single_equilibrium_has_one_row_and_one_that_is_not_found_a_reason(run: Runs) -> None:
    scene = written(run.folder, MODEL, "cubic", "[equilibrium]\nstart = [-1.2, 0.1]\n")
    run(scene, QUIET)
    (row,) = run.rows("branch")
    assert abs(-1.0 + float(row["x"]) - float(row["x"]) ** 3) < 1e-12
    assert row["stable"] == "1"
    rest = "parameters = { p = 0.0 }\n[equilibrium]\nstart = [0.1, 1.0]\ntransient = 0.5\n"
    assert "does not settle" in run(written(run.folder, MODEL, "cubic", rest), "--overwrite", status=1).err


def test_check_tells_the_plan(run: Runs) -> None:
    printed = run(EXAMPLES / "prey_and_predators.toml", command="check").out
    assert "near x = 0.5, y = 0" in printed
    assert "branches at every branch point and hopf" in printed


@pytest.mark.slow
def test_the_example_of_roessler_follows_its_period_doublings(run: Runs) -> None:
    """On the curve the multiplier is -1, by CVODES and not by collocation."""
    run(EXAMPLES / "roessler.toml")
    assert special(run, "kind", "criticality") == [("period doubling", "supercritical")]
    assert run.columns("special_points", "c")[0] == pytest.approx([2.832445], abs=1e-6)
    every_a, every_c = run.columns("curve_1", "a", "c")
    assert (every_a[0], every_a[-1]) == (0.2, 0.22)
    assert "curves.png" in run.files
    x, y, z, c = (ca.SX.sym(name) for name in "xyzc")
    a, at = every_a[-1], every_c[-1]
    model = OdeModel("Roessler", ca.vertcat(x, y, z), ca.vertcat(-y - z, x + a * y, 0.2 + z * (x - c)), c)
    cycle = simulate(model, [3.0, 0.0, 0.0], np.linspace(0.0, 200.0, 4001), parameters={"c": at - 0.2}).last_cycle()
    orbit = find_orbit(model, cycle, parameters={"c": at - 0.2}).follow("c", at).orbits[-1]
    assert np.min(np.abs(orbit.floquet(flow="cvodes").multipliers + 1.0)) < 1e-5


def test_a_requested_value_that_is_a_special_point_is_one_in_the_tables(run: Runs) -> None:
    """x (1 - p^2 - x) = 0 branches at p = -1 and 1, where the run ends: both are requested, and none is missing."""
    run(continued(run, "crossing", "[equilibrium]\nstart = [0.0]", "to = 1.0\nat = [-1.0, 0.5]"), QUIET)
    assert [(kind, float(p)) for kind, p in special(run, "kind", "p")] == [
        ("branch point", -1.0),
        ("branch point", 1.0),
    ]
    branch = run.rows("branch")
    assert [float(row["p"]) for row in branch if row["special"]] == [-1.0, 1.0]
    assert [row["special"] for row in branch if float(row["p"]) == -1.0] == ["branch point"]
    assert float(branch[-1]["p"]) == 1.0
