"""Equations that jump are refused where their orbits cross the jump, by name; kinks and jumps in time are not."""

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm

from casadi_skin import BoundaryValueProblem, OdeModel, find_equilibrium, find_orbit, follow_family, simulate
from casadi_skin.runs.program import main

TWO_PI = 2.0 * np.pi
x, v, t, p = (ca.SX.sym(name) for name in "xvtp")
PHASES = np.linspace(0.0, TWO_PI, 501)
CIRCLE = 1.3 * np.column_stack([np.cos(PHASES), -np.sin(PHASES)])


def oscillator(force, name="oscillator", **options):
    """x'' = force, in x, v, t and p."""
    return OdeModel(name, ca.vertcat(x, v), ca.vertcat(v, force), p, **{"nominal": (0.3,)} | options)


def forced(force, name="forced"):
    return oscillator(force, name, time=t, forcing_period=TWO_PI)


JUMPS = {
    "sign(x)": (ca.sign(x), "sign(x)"),
    "if_else": (ca.if_else(x > 0.3, 3 * x, 0), "0.3 < x"),
    "nested": (ca.if_else(x > 0, ca.if_else(v > 0, 1, 0), 0), "0 < "),
    "and": (ca.if_else(ca.logic_and(x > 0, v > 0), 1, 0), "0 < x"),
    "floor": (ca.floor(2 * x), "floor"),
    "ceil": (ca.ceil(x), "ceil(x)"),
    "fmod": (ca.fmod(x, 0.5), "fmod(x, 0.5)"),
    "remainder": (ca.remainder(x, 0.7), "remainder"),
    "copysign": (ca.copysign(ca.SX(1), x), "copysign"),
    "piecewise": (ca.pw_const(x, ca.DM([0.2]), ca.DM([0, 1])), "0.2 <= x"),
    "heaviside": (ca.heaviside(x), "sign(x)"),
    "a small one": (x + 1e-6 * ca.sign(v), "sign(v)"),
    "backlash": (ca.if_else(ca.fabs(x) > 0.5, x, 0), "0.5 < fabs(x)"),
    "a switch by time and state": (ca.sign(ca.sin(t) - 0.3 * x), "sign("),
    "x/|x|": (x / ca.fabs(x), "fabs(x)"),
    "atan(1/x)": (ca.atan(1 / x), "division by x"),
    "atan2": (ca.atan2(v, x), "atan2(v, x)"),
    "a saw of tangents": (ca.atan(ca.tan(3 * x)), "tan("),
}
CONTINUOUS = {
    "x sign(x)": x * ca.sign(x),
    "fabs": ca.fabs(x - 0.2),
    "fmax": ca.fmax(x, 0) + ca.fmin(v, 0.1),
    "branches that agree at 0": ca.if_else(x > 0, 3 * x, 0),
    "branches that agree at 0.3": ca.if_else(x > 0.3, 3 * (x - 0.3), 0),
    "nested": ca.if_else(x > 0, ca.if_else(v > 0, x * v, 0), 0),
    "dead zone": ca.if_else(ca.fabs(x) > 0.5, x - 0.5 * ca.sign(x), 0),
    "an infinite slope": ca.sign(x - 0.3) * ca.sqrt(ca.fabs(x - 0.3)),
    "a periodic function of fmod": ca.sin(2 * np.pi * ca.fmod(x, 0.5) / 0.5),
    "removable": ca.if_else(x == 0, 1, ca.sin(x) / x),
    "a rate of Hodgkin and Huxley": (x + 0.5) / (1 - ca.exp(-(x + 0.5) / 0.1)),
    "piecewise linear": ca.pw_lin(x, ca.DM([-2, 0, 2]), ca.DM([1, 0, 3])),
    "a pole": 1 / x,
    "copysign": ca.copysign(x, x),
    "steep": ca.tanh(1e5 * x),
    "a jump elsewhere": ca.if_else(x > 5, 1, 0),
    "a switch by a parameter": ca.if_else(p > 0.5, x, -x),
    "a switch by time": ca.sign(ca.sin(t)),
}


@pytest.mark.parametrize("name", JUMPS)
def test_jumps_are_named_with_their_equation(name):
    force, words = JUMPS[name]
    found = forced(force - x).jumps.along(PHASES, CIRCLE, np.array([0.3]))
    assert found.startswith("the equation of v jumps, by ")
    assert words in found


@pytest.mark.parametrize("name", CONTINUOUS)
def test_kinks_and_jumps_in_time_are_none(name):
    assert forced(CONTINUOUS[name] - x).jumps.along(PHASES, CIRCLE, np.array([0.3])) == ""


def test_jumps_of_functions_in_mx_are_seen():
    X = ca.MX.sym("X", 2)
    inner = ca.Function("inner", [x], [ca.if_else(x > 0.1, -x, -2 * x)])
    kink = ca.Function("kink", [x], [ca.if_else(x > 0, -x, -2 * x)])
    for function, words in ((inner, "the equation of X_1 jumps, by 0.1 < X_0"), (kink, "")):
        model = OdeModel("mx", X, ca.vertcat(X[1], function(X[0])))
        assert model.jumps.along(PHASES, CIRCLE, np.empty(0)) == words


# Orbits ---------------------------------------------------------------------------------------------------------------


def clock():
    """x'' + 0.1 x' + x = 0.1 sign(x'): its multiplier is exp(-2 pi z/w), and linearised equations alone miss it."""
    return OdeModel("clock", ca.vertcat(x, v), ca.vertcat(v, -x - 0.1 * v + 0.1 * ca.sign(v)))


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_orbit_of_a_clock_is_refused_in_a_line_with_the_jump(tolerance):
    model = clock()
    cycle = simulate(model, [-1.3, 0.0], np.linspace(0.0, 100.0, 2001)).last_cycle()  # which takes jumps
    assert cycle.period == pytest.approx(TWO_PI / np.sqrt(1 - 0.05**2), rel=1e-4)
    with pytest.raises(ValueError, match=r"^clock: the equation of v jumps, by sign\(v\), along the") as refused:
        find_orbit(model, cycle, cycle.period, tolerance=tolerance)
    assert "simulate takes all" in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.slow
def test_a_relay_that_does_not_converge_is_refused_with_its_jump():
    relay = OdeModel("relay", ca.vertcat(x, v), ca.vertcat(-ca.sign(x - v), ca.sign(x) - v))
    with pytest.raises(ValueError, match=r"relay: the equation of \w jumps, by sign"):
        find_orbit(relay, lambda s: [np.cos(s), np.sin(s)], TWO_PI)


def duty(a, k, d, c):
    """A forced oscillator whose stiffness is k + d until t = a in each period, and k - d after it."""
    first = ca.fmod(t, TWO_PI) < a
    return forced(-ca.if_else(first, k + d, k - d) * x - c * v + ca.cos(t) + ca.if_else(first, 0.4, -0.4), "duty")


@pytest.mark.parametrize(("a", "k", "d", "c"), [(np.pi, 1.7, 0.5, 0.2), (2.0, 2.3, 0.8, 0.3), (3.127, 1.2, 0.4, 0.1)])
@pytest.mark.parametrize("tolerance", [1e-4, 1e-8])
def test_multipliers_across_jumps_in_time_are_those_of_matrix_exponentials(a, k, d, c, tolerance):
    """3.127 is near an edge of even meshes: no stage lies between, and no error would show."""
    orbit = find_orbit(duty(a, k, d, c), lambda s: [np.sin(s), np.cos(s)], tolerance=tolerance)

    def matrix(stiffness):
        return np.array([[0.0, 1.0], [-stiffness, -c]])

    truth = np.linalg.eigvals(expm((TWO_PI - a) * matrix(k - d)) @ expm(a * matrix(k + d)))
    found = orbit.floquet().multipliers
    assert np.max(np.abs(np.sort_complex(found) - np.sort_complex(truth))) < 1e-9
    later = simulate(orbit.model, orbit.evaluate([0.0])[0], [0.0, a, TWO_PI], tolerance=1e-12).states[-1]
    assert np.max(np.abs(later - orbit.evaluate([0.0])[0])) < max(10.0 * orbit.error, 1e-7) * np.max(
        np.abs(orbit.states)
    )


def test_branch_ends_where_its_orbits_reach_a_jump():
    """x'' + 0.2 x' + x/2 + (1/2 where x > 1) = p cos t: amplitude p/|1/2 - 1 + 0.2i| is 1 at p = 0.5385."""
    model = forced(-0.5 * x - 0.2 * v - ca.if_else(x > 1, 0.5, 0) + p * ca.cos(t))
    orbit = find_orbit(model, lambda s: [-0.5 * np.cos(s), 0.5 * np.sin(s)])
    branch = orbit.follow("p", 1.0, stability=True)
    assert branch.reason.startswith("the equations jump there: the equation of v jumps, by 1 < x")
    assert not branch.complete
    assert 0.45 < branch.solutions[-1].parameters["p"] < abs(complex(-0.5, 0.2))
    assert orbit.floquet().stable


def test_branch_in_the_time_of_a_jump_is_refused_beside_its_start():
    """Meshes have their edges at the jump of the start; those of others lie between edges, where no error shows."""
    force = ca.if_else(ca.fmod(t, TWO_PI) < p, 1, -1)
    orbit = find_orbit(forced(-1.7 * x - 0.2 * v + force), lambda s: [np.sin(s), np.cos(s)], parameters={"p": 2.0})
    branch = orbit.follow("p", 3.0)
    assert "in time beside the edges of the mesh" in branch.reason


def test_solution_of_a_boundary_value_problem_across_a_jump_is_refused():
    model = OdeModel("bang", ca.vertcat(x, v), ca.vertcat(v, ca.sign(x)))
    problem = BoundaryValueProblem(model, lambda start, end, p: [start[0] + 1, end[0] - 1])
    with pytest.raises(ValueError, match=r"bang: the equation of v jumps, by sign\(x\)"):
        problem.solve((np.array([0.0, 1.0]), np.array([[-1.0, 2.0], [1.0, 2.0]])))


# Equilibria and families ----------------------------------------------------------------------------------------------


def test_equilibrium_on_a_jump_is_refused_and_one_beside_is_not():
    friction = oscillator(-x - 0.2 * v - 0.1 * ca.sign(v), "friction")
    with pytest.raises(ValueError, match=r"^friction: the equation of v jumps, by sign\(v\), at the equilibrium"):
        find_equilibrium(friction, [0.0, 0.0])
    kink = find_equilibrium(oscillator(-x - 0.2 * v - ca.fmax(x, 0), "kink"), [0.0, 0.0])
    assert kink.stable
    relay = OdeModel("relay", x, p - x - 2 * ca.sign(x - 1) - 3, p, nominal=(0.5,))
    start = find_equilibrium(relay, [0.2])
    assert start["x"] == pytest.approx(-0.5)
    branch = start.follow("p", 3.0)  # x = p - 1 until x = 1
    assert "the equation of x jumps, by sign((x-1))" in branch.reason
    assert branch.solutions[-1].parameters["p"] == pytest.approx(2.0, abs=0.1)


def test_a_curve_of_folds_ends_where_the_equations_jump():
    """x' = a + b x - x^3, and 1e-5 x^2 where b > 1: folds on both sides, which are nearly the same."""
    x, a, b = (ca.SX.sym(name) for name in "xab")
    rhs = a + b * x - x**3 + ca.if_else(b > 1, 1e-5 * x**2, 0.0)
    model = OdeModel("jump", x, rhs, ca.vertcat(a, b), nominal=(-2.0, 0.5))
    fold = find_equilibrium(model, [-1.5]).follow("a", 2.0).special_points[0]
    curve = fold.curve("b", 2.0)
    assert not curve.complete
    assert "the equations jump there: the equation of x jumps, by 1 < b" in str(curve)
    assert 0.9 < curve["b"][-1] < 1.0


def test_families_across_jumps_are_refused():
    y, w = ca.SX.sym("y"), ca.SX.sym("w")
    signs = {"order": 2, "velocity": w, "reversal": (1, -1)}
    for force, words in ((-y - 0.1 * ca.sign(y), r"sign\(y\)"), (-y - ca.if_else(y > 0.5, y, 0), "0.5 < y")):
        with pytest.raises(ValueError, match=f"^gap: the equation of w jumps, by {words}, in the linear mode"):
            follow_family(OdeModel("gap", y, force, **signs), mode=1, amplitude_max=1.0)
    free = follow_family(OdeModel("gap", y, -y - ca.if_else(y > 1.5, y, 0), **signs), mode=1, amplitude_max=1.0)
    assert free.complete


# Scenes ---------------------------------------------------------------------------------------------------------------

CLOCK = """import casadi as ca
from casadi_skin import OdeModel
x, v = ca.SX.sym("x"), ca.SX.sym("v")
model = OdeModel("clock", ca.vertcat(x, v), ca.vertcat(v, -x - 0.1 * v + 0.1 * ca.sign(v)))
"""
ORBIT = """[model]
file = "clock.py"
name = "model"
[orbit]
start = [-1.3, 0.0]
transient = 100.0
[stability]
"""


def test_scene_of_a_clock_is_refused_before_anything_is_written(tmp_path, capsys):
    (tmp_path / "clock.py").write_text(CLOCK)
    (tmp_path / "scene.toml").write_text(ORBIT)
    out = tmp_path / "out"
    assert main(["run", str(tmp_path / "scene.toml"), "--out", str(out)]) == 2
    message = capsys.readouterr().err
    assert "[model] clock: the equation of v jumps, by sign(v)" in message
    assert message.count("\n") == 1
    assert not out.exists()
