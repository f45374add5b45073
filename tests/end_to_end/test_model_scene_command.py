"""Scenes of any model through the command line: files, status, interruption, and numbers known independently."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from apart import Ended
from outputs import read_rows

from casadi_skin import save_model
from casadi_skin.model.loading import run_file
from casadi_skin.runs.program import main

pytestmark = pytest.mark.usefixtures("blank")

Cli = Callable[..., Ended]
EXAMPLES = Path(__file__).parents[2] / "examples"
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
PICTURES = {"branch.png", "orbit.png"}
STABILITY = ["max_abs_multiplier", "stable", "unstable", "trivial_deviation"]


def write_scene(folder: Path, name: str, rest: str) -> Path:
    (folder / "model.py").write_text(MODEL, encoding="utf-8")
    path = folder / "scene.toml"
    path.write_text(f'[model]\nfile = "model.py"\nname = "{name}"\n{rest}', encoding="utf-8")
    return path


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
def test_the_python_file_of_a_scene_is_named_before_it_runs(command: str, tmp_path: Path, cli: Cli) -> None:
    scene = write_scene(tmp_path, "van_der_pol", ORBIT)
    (tmp_path / "model.py").write_text("print('ran'); raise SystemExit", encoding="utf-8")
    done = cli(command, scene)
    assert done.status == 2
    assert done.out.splitlines() == [f"program       {tmp_path / 'model.py'} is run as Python", "ran"]
    assert cli("run", scene, "--quiet")[:2] == (2, "ran\n")


def test_a_saved_model_is_no_program(tmp_path: Path, cli: Cli) -> None:
    scene = write_scene(tmp_path, "van_der_pol", ORBIT)
    save_model(run_file(tmp_path / "model.py", MODEL)["van_der_pol"], tmp_path / "model.json")
    text = scene.read_text(encoding="utf-8").replace("model.py", "model.json").replace('name = "van_der_pol"\n', "")
    scene.write_text(text, encoding="utf-8")
    done = cli("check", scene)
    assert done.status == 0
    assert "program" not in done.out


# The examples ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_van_der_pol(tmp_path: Path, cli: Cli) -> None:
    assert "results in" in cli("run", EXAMPLES / "van_der_pol.toml", "--out", tmp_path / "out").out
    table = read_rows(tmp_path / "out" / "branch.csv")
    assert [float(r["mu"]) for r in table if r["requested"] == "1"] == [2.0, 5.0]
    for row in table:
        if float(row["mu"]) in (1.0, 5.0, 10.0):
            assert float(row["period"]) == pytest.approx(period_by_crossings(float(row["mu"])), rel=1e-9)
    assert all(r["stable"] == "1" and r["unstable"] == "0" for r in table)
    assert all(float(r["trivial_deviation"]) < 1e-7 for r in table)


def check_special_points(out: Path, within: float) -> None:
    """At each fold of the resonance a multiplier passes 1: both are told, in order along the branch."""
    points = read_rows(out / "special_points.csv")
    assert list(points[0]) == ["kind", "omega", "error", "period"]
    kinds = [row["kind"] for row in points]
    assert sorted(kinds) == ["fold", "fold", "stability gained (real)", "stability lost (real)"]
    assert [set(kinds[:2]), set(kinds[2:])] == [{"fold", "stability lost (real)"}, {"fold", "stability gained (real)"}]
    values = [float(row["omega"]) for row in points]
    assert values == pytest.approx(np.repeat(FOLDS, 2), abs=within)
    assert [float(row["period"]) for row in points] == pytest.approx(2 * np.pi / np.array(values), rel=1e-12)
    assert all(0.0 <= float(row["error"]) < within for row in points)


@pytest.mark.slow
def test_the_resonance_of_duffing(tmp_path: Path) -> None:
    from scipy.integrate import solve_ivp

    xarray = pytest.importorskip("xarray")
    out = tmp_path / "out"
    assert main(["run", str(EXAMPLES / "duffing_resonance.toml"), "--out", str(out)]) == 0
    table = read_rows(out / "branch.csv")
    folds = [float(r["omega"]) for r in table if r["fold"] == "1"]
    assert folds == pytest.approx(FOLDS, abs=1e-8)
    check_special_points(out, 1e-8)
    at = [r for r in table if r["requested"] == "1"]
    assert [int(r["unstable"]) for r in at] == [0, 1, 0]
    period = 2 * np.pi / 1.8
    for row in (at[0], at[2]):  # a complex pair, whose product is that of Liouville's formula
        assert float(row["max_abs_multiplier"]) == pytest.approx(np.exp(-0.05 * period), abs=1e-9)
    with xarray.open_dataset(out / "branch.nc", engine="scipy") as data:
        assert data.profile.shape == (len(table), 401, 2)
        np.testing.assert_array_equal(data.largest.values[:, 0], [float(r["q_max"]) for r in table])
        assert [name.decode().strip() for name in data.state_name.values] == ["q", "v"]
        assert [name.decode().strip() for name in data.parameter_name.values] == ["omega", "a", "delta"]
        np.testing.assert_allclose(data.profile.values[:, 0], data.profile.values[:, -1], atol=1e-7)
        for row in at:
            start = data.profile.values[int(row["point"]), 0]
            flow = solve_ivp(
                lambda t, s: [s[1], -s[0] - s[0] ** 3 - 0.1 * s[1] + 0.5 * np.cos(1.8 * t)],
                (0.0, period), start, method="DOP853", rtol=1e-11, atol=1e-12, dense_output=True,
            )  # fmt: skip
            np.testing.assert_allclose(flow.y[:, -1], start, atol=1e-7)
            largest = flow.sol(np.linspace(0.0, period, 20_001))[0].max()
            assert float(row["q_max"]) == pytest.approx(largest, abs=1e-7)
        assert 'name = "duffing"' in data.attrs["scene"]
        assert "forcing_period" in data.attrs["model_source"]
        assert data.attrs["casadi_version"]
        moduli = np.hypot(*np.moveaxis(data.multipliers.values, -1, 0))
        np.testing.assert_allclose(moduli.max(axis=1), [float(r["max_abs_multiplier"]) for r in table], rtol=1e-14)
        edges = data.mesh.values
        assert np.array_equal(np.isfinite(edges).sum(axis=1) - 1, data.intervals.values)


# Files and status -----------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.usefixtures("pictures")
def test_the_branch_of_a_boundary_value_problem_with_its_fold(tmp_path: Path) -> None:
    rest = "[solution]\nguess = { x = 0.0 }\n[continuation]\nparameter = 'mu'\nto = 4\nat = [2.0]\nmax_points = 40\n"
    out = tmp_path / "out"
    assert main(["run", str(write_scene(tmp_path, "problem", rest)), "--out", str(out)]) == 1
    table = read_rows(out / "branch.csv")
    assert {path.name for path in out.iterdir()} == PICTURES | {
        "branch.csv", "branch.nc", "special_points.csv", "scene.toml", "scene_model.py", "journal.msgpack",
    }  # fmt: skip
    assert not {"period", *STABILITY} & set(table[0])
    fold = next(r for r in table if r["fold"] == "1")
    assert float(fold["mu"]) == pytest.approx(3.513830719, abs=1e-8)
    lower, upper = (float(r["x_max"]) for r in table if r["requested"] == "1")
    for largest in (lower, upper):
        theta = 4.0 * np.arccosh(np.exp(largest / 2.0))
        assert theta == pytest.approx(np.sqrt(4.0) * np.cosh(theta / 4.0), abs=1e-6)


@pytest.mark.usefixtures("pictures")
def test_one_orbit_alone(tmp_path: Path, cli: Cli) -> None:
    out = tmp_path / "out"
    scene = write_scene(tmp_path, "van_der_pol", ORBIT + "section = { y = 0 }\n")
    assert cli("run", scene, "--out", out).status == 0
    files = {"branch.csv", "branch.nc", "orbit.png", "scene.toml", "scene_model.py"}
    assert {path.name for path in out.iterdir()} == files
    (row,) = read_rows(out / "branch.csv")
    assert list(row) == [
        *("point", "requested", "fold", "period", "mu", "x_min", "x_max", "y_min", "y_max"),
        *("error", "parameter_error", "intervals", "residual"),
    ]
    assert "--overwrite" in cli("run", scene, "--out", out).line
    done = cli("run", scene, "--out", out, "--resume")
    assert done.status == 0
    assert "complete run already" in done.out
    (tmp_path / "model.py").write_text(MODEL + "# changed\n", encoding="utf-8")
    assert "was begun with another model.py" in cli("run", scene, "--out", out, "--resume").err
    assert cli("run", scene, "--out", out, "--overwrite").status == 0
    assert (out / "scene_model.py").read_text(encoding="utf-8").endswith("# changed\n")


def test_methods_agree(tmp_path: Path) -> None:
    found = []
    for rest in ("", "[method]\ntranscription = 'radau'\ncorrector = 'newton'\ndegree = 5\nflow = 'cvodes'\n"):
        scene = write_scene(tmp_path, "van_der_pol", ORBIT + "[stability]\n" + rest)
        assert main(["run", str(scene), "--out", str(tmp_path / "out"), "--overwrite"]) == 0
        row = read_rows(tmp_path / "out" / "branch.csv")[0]
        found.append([float(row[name]) for name in ("period", "max_abs_multiplier", "multiplier_error")])
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
def test_what_cannot_be_computed_is_told_in_a_line(rest: str, reason: str, tmp_path: Path, cli: Cli) -> None:
    scene = write_scene(tmp_path, "van_der_pol", rest)
    status, _, error = cli("run", scene, "--out", tmp_path / "out")
    assert (status, error.count("\n")) == (1, 1)
    assert error.startswith(f"{scene}: ")
    assert reason in error


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ("raise ValueError('no')\n", "model.py, line 1: ValueError: no"),
        ("van_der_poll = 3\n", "defines no van_der_pol"),
        ("def van_der_pol():\n    return {}['a']\n", "model.py, line 2: KeyError: 'a'"),
        ("van_der_pol = 3\n", "van_der_pol gives an int; accepted: an OdeModel or a BoundaryValueProblem"),
    ],
)
def test_what_is_wrong_in_the_model_leaves_with_status_2(source: str, reason: str, tmp_path: Path, cli: Cli) -> None:
    scene = write_scene(tmp_path, "van_der_pol", ORBIT)
    (tmp_path / "model.py").write_text(source, encoding="utf-8")
    for command in (["run", scene, "--out", tmp_path / "out"], ["check", scene]):
        status, _, error = cli(*command)
        assert (status, error.count("\n")) == (2, 1)
        assert error.startswith(f"casadi-skin: {scene}: [model] ")
        assert reason in error
    assert {path.name for path in tmp_path.iterdir()} == {"model.py", "scene.toml"}


def test_check_prints_the_plan_and_other_commands_refuse(tmp_path: Path, cli: Cli) -> None:
    rest = ORBIT + "[continuation]\nparameter = 'mu'\nto = 2\n[stability]\n"
    scene = write_scene(tmp_path, "van_der_pol", rest)
    plan = cli("check", scene).out
    for words in ("x, y", "mu = 1", "no symmetry", "integral phase condition", "one period of 6.6", "170 state values"):
        assert words in plan
    for command in ("spectrum", "tradeoff"):
        status, _, error = cli(command, scene)
        assert (status, error.count("\n")) == (2, 1)
    plan = cli("check", write_scene(tmp_path, "van_der_pol", "")).out
    assert "no [family], [equilibrium], [orbit] or [solution]" in plan
