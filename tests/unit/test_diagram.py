"""Whole diagrams: all that leaves a branch, and what leaves that, each walked once."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from critical_models import cycles_with_fold
from equilibrium_models import rosenzweig_macarthur, symbols

from casadi_skin import OdeModel, find_equilibrium, find_orbit, simulate
from casadi_skin.runs.program import main


def _from_zero(rhs: ca.SX, x: ca.SX, p: ca.SX) -> object:
    return find_equilibrium(OdeModel("diagram", x, rhs, p), [0.0], parameters={"p": -2.0})


def test_both_halves_leave_a_branch_point_and_what_meets_the_branch_again_is_not_walked_back() -> None:
    """x (1 - p^2 - x): a parabola through two branch points; x (1 - p^2 - x^2): a circle through both."""
    x, p = symbols("x p")
    parabola = _from_zero(x * (1 - p**2 - x), x, p).follow_all("p", 2.0)  # type: ignore[attr-defined]
    assert [point.kind for point in parabola.special_points] == ["branch point", "branch point"]
    assert parabola.names == ("", "_1", "_1b")
    assert parabola.complete
    assert {float(branch.values[-1]) for branch in parabola.branches[1:]} == {2.0, -2.0}
    for branch in parabola.branches[1:]:
        states = np.array([solution["x"] for solution in branch.solutions])
        np.testing.assert_allclose(states, 1.0 - branch["p"] ** 2, atol=1e-10)
    circle = _from_zero(x * (1 - p**2 - x**2), x, p).follow_all("p", 2.0)  # type: ignore[attr-defined]
    assert len(circle) == 2
    assert "closed" in circle.branches[1].reason
    assert [point.parameters["p"] for point in circle.special_points] == pytest.approx([-1.0, 1.0])


@pytest.mark.slow
def test_cycles_between_two_hopf_points_are_walked_once_and_lead_to_the_equilibria() -> None:
    """r' = r (1 - p^2 - r^2) at the angular velocity 1: cycles of radius 1 at p = 0, born at p = -1 and 1."""
    x, y, p = symbols("x y p")
    growth = 1 - p**2 - x**2 - y**2
    model = OdeModel("ring", ca.vertcat(x, y), ca.vertcat(x * growth - y, y * growth + x), p)
    from_rest = find_equilibrium(model, [0.0, 0.0], parameters={"p": -2.0}).follow_all("p", 2.0, stability=False)
    assert from_rest.names == ("", "_1")
    guess = lambda t: np.stack([np.cos(t), np.sin(t)], axis=-1)  # noqa: E731
    cycles = find_orbit(model, guess, 2.0 * np.pi, parameters={"p": 0.0}).follow("p", 2.0)
    from_cycles = cycles.follow_all(stability=False)
    assert from_cycles.names == ("", "_1", "_1b")
    assert [point.kind for point in from_cycles.special_points] == ["hopf"]
    assert from_cycles.special_points[0].parameters["p"] == pytest.approx(1.0, abs=1e-12)
    assert [float(branch.values[-1]) for branch in from_cycles.branches[1:]] == [2.0, 0.0]
    assert [branch.solutions[-1].stable for branch in from_cycles.branches[1:]] == [True, False]


@pytest.mark.slow
@pytest.mark.parametrize(("unit", "of_p"), [(1.0, 1.0), (1e-8, 1.0), (1.0, 1e-8), (1e-8, 1e-8), (1e7, 1e7)])
def test_a_diagram_has_all_branches_in_any_unit(unit: float, of_p: float) -> None:
    """Pitchforks of x and y, and those of y where x is +- sqrt(p): in units of 1e8 the latter had been one."""
    x, y, p = symbols("x y p")
    X, Y, P = x / unit, y / unit, p / of_p
    rhs = unit * ca.vertcat(P * X - X**3, (P - 0.5) * Y - Y**3 - 0.2 * X**2 * Y)
    model = OdeModel("two", ca.vertcat(x, y), rhs, p, nominal=(-0.2 * of_p,))
    diagram = find_equilibrium(model, [0.0, 0.0]).follow_all("p", 1.2 * of_p, depth=3, limit=40)
    places = sorted(point.parameters["p"] / of_p for point in diagram.special_points)
    assert (len(diagram), diagram.complete, diagram.failures) == (9, True, ())
    np.testing.assert_allclose(places, [0.0, 0.5, 0.625, 0.625], atol=1e-9)


def test_depth_and_limit_bound_a_diagram() -> None:
    """Prey alone; with predators from K = 1 on; cycles from K = 3 on."""
    branch = find_equilibrium(rosenzweig_macarthur(), [0.5, 0], parameters={"K": 0.5}).follow("K", 3.2)
    assert len(branch.follow_all(depth=0)) == 1
    shallow = branch.follow_all(depth=1)
    assert [point.kind for point in shallow.special_points] == ["branch point", "hopf"]
    assert len(shallow) == 3
    assert shallow.complete
    limited = branch.follow_all(depth=1, limit=2)
    assert len(limited) == 2
    assert not limited.complete
    with pytest.raises(ValueError, match="depth: given -1"):
        branch.follow_all(depth=-1)


@pytest.mark.slow
def test_orbits_of_twice_the_period_belong_to_a_diagram_of_orbits() -> None:
    """Roessler's model with a = b = 0.2: the first period doubling at c = 2.8324."""
    x, y, z, c = symbols("x y z c")
    rhs = ca.vertcat(-y - z, x + 0.2 * y, 0.2 + z * (x - c))
    model = OdeModel("Roessler", ca.vertcat(x, y, z), rhs, c, nominal=(2.0,))
    settled = simulate(model, [1.0, 1.0, 0.0], np.linspace(0.0, 400.0, 4001))

    def guess(t: float) -> np.ndarray:
        return np.array([np.interp(t, settled.t - settled.t[-80], column) for column in settled.states.T])

    branch = find_orbit(model, guess, 5.8).follow("c", 3.4, stability=True)
    diagram = branch.follow_all(depth=1)
    assert diagram.names == ("", "_1")
    (doubling,) = diagram.special_points
    assert doubling.kind == "period doubling"
    once, twice = (found.at(c=3.2) for found in diagram)
    assert twice.period == pytest.approx(2.0 * once.period, rel=0.02)
    assert twice.floquet().stable
    assert not once.floquet().stable


@pytest.mark.slow
def test_equilibria_leave_where_orbits_shrink_to_one_and_nothing_else_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Cycles that fold, then end at a Hopf point of the equilibrium 0; of both their fold alone has a curve."""
    start = "from critical_models import cycles_with_fold\nmodel = cycles_with_fold()\n"
    (tmp_path / "model.py").write_text(start, encoding="utf-8")
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(
        '[model]\nfile = "model.py"\nname = "model"\nparameters = { mu = 0.1, a = 1.0 }\n'
        "[orbit]\nstart = [1.05, 0.0]\nperiod = 6.28\n[stability]\n[figures]\nformats = []\n"
        '[continuation]\nparameter = "mu"\nto = -0.3\ndepth = 1\ncurve = { parameter = "a", to = 1.05 }\n',
        encoding="utf-8",
    )
    assert main(["run", str(scene), "--out", str(out)]) == 1  # -0.3 is not reached, and nothing else is wrong
    assert capsys.readouterr().err.splitlines() == [
        f"{scene}: [continuation]: the cycle shrinks to an equilibrium at a Hopf point"
    ]
    header = (out / "special_points.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header == "branch,kind,mu,a,error,period,frequency,coefficient,criticality"
    assert (out / "curve_1.csv").exists()
    assert not (out / "curve_2.csv").exists()
    values = {"mu": 0.1, "a": 1.0}
    orbit = find_orbit(cycles_with_fold(), lambda t: [np.cos(t), np.sin(t)], 2.0 * np.pi, parameters=values)
    diagram = orbit.follow("mu", -0.3).follow_all(depth=1, max_points=40)
    assert [point.kind for point in diagram.special_points] == ["fold", "hopf"]
    assert diagram.failures == ()
    assert diagram.names == ("", "_2", "_2b")
    assert [float(branch.values[-1]) for branch in diagram.branches[1:]] == [-0.3, 0.1]
    assert all(np.all(np.abs(solution.positions) < 1e-12) for branch in diagram.branches[1:] for solution in branch)
