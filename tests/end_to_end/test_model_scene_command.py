"""Scenes of any model through the command line: files, status, interruption, and numbers known independently."""

from __future__ import annotations

import numpy as np
import pytest
from outputs import EXAMPLES
from scenes import Runs, written

from casadi_skin import save_model
from casadi_skin.model.loading import run_file

pytestmark = pytest.mark.usefixtures("blank")

MODEL = """
import casadi as ca
from casadi_skin import BoundaryValueProblem, OdeModel

x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
van_der_pol = OdeModel("van der Pol", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu, nominal=(1.0,))
bratu = OdeModel("Bratu", ca.vertcat(x, y), ca.vertcat(y, -mu * ca.exp(x)), mu, nominal=(1.0,))
problem = BoundaryValueProblem(bratu, [bratu.start(x), bratu.end(x)])
"""
ORBIT = "[orbit]\nstart = [2.0, 0.0]\nperiod = 6.6\n"
FOLDS = (2.2119353170179, 1.4386701455139)  # of the resonance of Duffing
STABILITY = ["max_abs_multiplier", "stable", "unstable", "trivial_deviation"]


def oscillator(run: Runs, rest: str) -> str:
    """A scene of the oscillator of van der Pol."""
    return written(run.folder, MODEL, "van_der_pol", rest)


def period_by_crossings(mu: float, until: float = 90.0) -> float:
    """Time from one rising zero of x to the next, once the oscillator of van der Pol has settled."""
    from scipy.integrate import solve_ivp

    def crossing(t: float, state: np.ndarray) -> float:
        return float(state[0])

    crossing.direction = 1.0  # type: ignore[attr-defined]
    flow = solve_ivp(
        lambda t, s: [s[1], mu * (1 - s[0] ** 2) * s[1] - s[0]], (0.0, until), [2.0, 0.0], method="DOP853",
        events=crossing, rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    return float(np.diff(flow.t_events[0])[-1])


@pytest.mark.parametrize("command", ["check", "run"])
def test_the_python_file_of_a_scene_is_named_before_it_runs_and_a_saved_model_is_no_program(
    command: str, run: Runs
) -> None:
    scene, file = oscillator(run, ORBIT), run.folder / "model.py"
    save_model(run_file(file, MODEL)["van_der_pol"], run.folder / "model.json")
    file.write_text("print('ran'); raise SystemExit", encoding="utf-8")
    named = run(scene, command=command, status=2).out
    assert named.splitlines() == [f"program       {file} is run as Python", "ran"]
    assert run(scene, "--quiet", status=2).out == "ran\n"
    saved = scene.replace("model.py", "model.json").replace('name = "van_der_pol"\n', "")
    assert "program" not in run(saved, command="check").out


# The examples ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_van_der_pol(run: Runs) -> None:
    assert "results in" in run(EXAMPLES / "van_der_pol.toml").out
    table = run.rows("branch")
    assert [float(r["mu"]) for r in table if r["requested"] == "1"] == [2.0, 5.0]
    for row in table:
        if float(row["mu"]) in (1.0, 5.0, 10.0):
            assert float(row["period"]) == pytest.approx(period_by_crossings(float(row["mu"])), rel=1e-9)
    assert all(r["stable"] == "1" and r["unstable"] == "0" for r in table)
    assert all(float(r["trivial_deviation"]) < 1e-7 for r in table)


@pytest.mark.slow
def test_the_resonance_of_duffing(run: Runs) -> None:
    """At each fold of the resonance a multiplier passes 1: both are told, in order along the branch."""
    from scipy.integrate import solve_ivp

    xarray = pytest.importorskip("xarray")
    run(EXAMPLES / "duffing_resonance.toml")
    table = run.rows("branch")
    assert [float(r["omega"]) for r in table if r["fold"] == "1"] == pytest.approx(FOLDS, abs=1e-8)
    points = run.rows("special_points")
    assert list(points[0]) == ["kind", "omega", "error", "period"]
    kinds = [row["kind"] for row in points]
    assert sorted(kinds) == ["fold", "fold", "stability gained (real)", "stability lost (real)"]
    assert [set(kinds[:2]), set(kinds[2:])] == [{"fold", "stability lost (real)"}, {"fold", "stability gained (real)"}]
    omega, error, period = run.columns("special_points", "omega", "error", "period")
    assert omega == pytest.approx(np.repeat(FOLDS, 2), abs=1e-8)
    assert period == pytest.approx(2 * np.pi / omega, rel=1e-12)
    assert np.all((error >= 0.0) & (error < 1e-8))
    at = [r for r in table if r["requested"] == "1"]
    assert [int(r["unstable"]) for r in at] == [0, 1, 0]
    T = 2 * np.pi / 1.8
    for row in (at[0], at[2]):  # a complex pair, whose product is that of Liouville's formula
        assert float(row["max_abs_multiplier"]) == pytest.approx(np.exp(-0.05 * T), abs=1e-9)
    with xarray.open_dataset(run.out / "branch.nc", engine="scipy") as data:
        assert data.profile.shape == (len(table), 401, 2)
        np.testing.assert_array_equal(data.largest.values[:, 0], [float(r["q_max"]) for r in table])
        assert [name.decode().strip() for name in data.state_name.values] == ["q", "v"]
        assert [name.decode().strip() for name in data.parameter_name.values] == ["omega", "a", "delta"]
        np.testing.assert_allclose(data.profile.values[:, 0], data.profile.values[:, -1], atol=1e-7)
        for row in at:
            start = data.profile.values[int(row["point"]), 0]
            flow = solve_ivp(
                lambda t, s: [s[1], -s[0] - s[0] ** 3 - 0.1 * s[1] + 0.5 * np.cos(1.8 * t)],
                (0.0, T), start, method="DOP853", rtol=1e-11, atol=1e-12, dense_output=True,
            )  # fmt: skip
            np.testing.assert_allclose(flow.y[:, -1], start, atol=1e-7)
            largest = flow.sol(np.linspace(0.0, T, 20_001))[0].max()
            assert float(row["q_max"]) == pytest.approx(largest, abs=1e-7)
        assert 'name = "duffing"' in data.attrs["scene"]
        assert "forcing_period" in data.attrs["model_source"]
        assert data.attrs["casadi_version"]
        moduli = np.hypot(*np.moveaxis(data.multipliers.values, -1, 0))
        np.testing.assert_allclose(moduli.max(axis=1), [float(r["max_abs_multiplier"]) for r in table], rtol=1e-14)
        assert np.array_equal(np.isfinite(data.mesh.values).sum(axis=1) - 1, data.intervals.values)


# Files and status -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
def test_the_branch_of_a_boundary_value_problem_with_its_fold(run: Runs) -> None:
    rest = "[solution]\nguess = { x = 0.0 }\n[continuation]\nparameter = 'mu'\nto = 4\nat = [2.0]\nmax_points = 40\n"
    run(written(run.folder, MODEL, "problem", rest), status=1)
    assert run.files == {
        "branch.csv", "branch.nc", "branch.png", "orbit.png", "special_points.csv", "scene.toml", "scene_model.py",
        "journal.msgpack",
    }  # fmt: skip
    assert not {"period", *STABILITY} & set(run.rows("branch")[0])
    assert run.columns("branch", "mu", fold="1")[0] == pytest.approx([3.513830719], abs=1e-8)
    for largest in run.columns("branch", "x_max", requested="1")[0]:
        theta = 4.0 * np.arccosh(np.exp(largest / 2.0))
        assert theta == pytest.approx(np.sqrt(4.0) * np.cosh(theta / 4.0), abs=1e-6)


@pytest.mark.usefixtures("pictures")
def test_one_orbit_alone(run: Runs) -> None:
    run(oscillator(run, ORBIT + "section = { y = 0 }\n"))
    assert run.files == {"branch.csv", "branch.nc", "orbit.png", "scene.toml", "scene_model.py"}
    (row,) = run.rows("branch")
    assert list(row) == [
        *("point", "requested", "fold", "period", "mu", "x_min", "x_max", "y_min", "y_max"),
        *("error", "parameter_error", "intervals", "residual"),
    ]
    assert "--overwrite" in run(status=2).line
    assert "complete run already" in run("", "--resume").out
    (run.folder / "model.py").write_text(MODEL + "# changed\n", encoding="utf-8")
    assert "was begun with another model.py" in run("", "--resume", status=2).err
    run("", "--overwrite")
    assert (run.out / "scene_model.py").read_text(encoding="utf-8").endswith("# changed\n")


def test_methods_agree(run: Runs) -> None:
    found = []
    for rest in ("", "[method]\ntranscription = 'radau'\ncorrector = 'newton'\ndegree = 5\nflow = 'cvodes'\n"):
        run(oscillator(run, ORBIT + "[stability]\n" + rest), "--overwrite")
        found.append([column[0] for column in run.columns("branch", "period", STABILITY[0], "multiplier_error")])
    (period, largest, error), (other_period, other_largest, other_error) = found
    assert period == pytest.approx(other_period, rel=1e-7)
    assert abs(largest - other_largest) <= error + other_error < 1e-7


@pytest.mark.parametrize(
    ("rest", "reason"),
    [
        ("[orbit]\nstart = [0, 0]\nperiod = 6\n", "guess: given a state that does not move"),
        ("[orbit]\nstart = [0, 0]\ntransient = 6\n", "this is an equilibrium"),
        (ORBIT + "[continuation]\nparameter = 'mu'\nto = 2\nmax_points = 3\n", "limit on the number of points"),
    ],
)
def test_what_cannot_be_computed_is_told_in_a_line(rest: str, reason: str, run: Runs) -> None:
    error = run(oscillator(run, rest), status=1).err
    assert error.count("\n") == 1
    assert error.startswith(f"{run.scene}: ")
    assert reason in error


def test_what_is_wrong_in_the_model_leaves_with_status_2(run: Runs) -> None:
    scene = oscillator(run, ORBIT)
    (run.folder / "model.py").write_text("def van_der_pol():\n    return {}['a']\n", encoding="utf-8")
    for command in ("run", "check"):
        error = run(scene, command=command, status=2).line
        assert error.startswith(f"casadi-skin: {run.scene}: [model] ")
        assert "model.py, line 2: KeyError: 'a'" in error
    assert {path.name for path in run.folder.iterdir()} == {"model.py", "scene.toml"}


def test_check_prints_the_plan_and_other_commands_refuse(run: Runs) -> None:
    scene = oscillator(run, ORBIT + "[continuation]\nparameter = 'mu'\nto = 2\n[stability]\n")
    plan = run(scene, command="check").out
    for words in ("x, y", "mu = 1", "no symmetry", "integral phase condition", "one period of 6.6", "170 state values"):
        assert words in plan
    for command in ("spectrum", "tradeoff"):
        assert run(scene, command=command, status=2).line
    plan = run(oscillator(run, ""), command="check").out
    assert "no [family], [equilibrium], [orbit] or [solution]" in plan
