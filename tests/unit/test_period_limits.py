"""Branches of orbits whose period grows without bound: where they end, by closed forms."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import lorenz, symbols
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from test_rotating_orbits import ENERGY, E, current, pendulum, q, turn_time

from casadi_skin import Branch, OdeModel, find_equilibrium, find_orbit
from casadi_skin.zero.settings import End


def ends_at(branch: Branch, kind: str, value: float) -> None:
    """The branch ends at its only special point, which covers a value with its error."""
    (point,) = branch.special_points
    assert point.kind == kind
    assert branch.end is End.UNBOUNDED
    assert point.solution.period == pytest.approx(np.max(branch.period))
    assert abs(point.parameters[point.parameter] - value) <= point.error < 1e-7
    assert not branch.complete


def test_a_pendulum_that_goes_round_ends_on_its_separatrix() -> None:
    """At E = 1; the period grows as log(32/(E - 1))."""
    period = turn_time(1.2)
    orbit = find_orbit(
        pendulum(), lambda t: [2.0 * np.pi * t / period, 1.6], period, parameters={"E": 1.2}, select=ENERGY - E,
        rotations={"q": 1}, symmetric=True,
    )  # fmt: skip
    branch = orbit.follow("E", 0.5)
    ends_at(branch, "homoclinic", 1.0)
    assert "the period grows without bound: orbits come to one that is homoclinic to (q = 3.14159" in branch.reason
    (end,) = branch.special_points
    assert np.isnan(end.coefficient)  # no normal form is known there
    assert end.criticality == ""
    last = end.solution
    assert last.period == pytest.approx(np.log(32.0 / (last["E"] - 1.0)), abs=0.1)


@pytest.mark.slow
def test_a_pendulum_that_swings_ends_on_its_separatrix_between_two_equilibria() -> None:
    orbit = find_orbit(
        pendulum(), lambda t: [np.sin(t), np.cos(t)], 6.7, parameters={"E": -0.5}, select=ENERGY - E,
        symmetric=True,
    )  # fmt: skip
    branch = orbit.follow("E", 1.5)
    ends_at(branch, "heteroclinic", 1.0)
    assert branch.reason.count("q = 3.14159") == branch.reason.count("q = -3.14159") == 1


@pytest.mark.slow
def test_a_junction_stops_where_two_equilibria_are_born() -> None:
    """q' = I - sin q: at I = 1, a saddle-node on the orbit; the period grows as (I - 1)^-1/2."""
    junction = OdeModel("junction", q, current - ca.sin(q), current)
    orbit = find_orbit(junction, lambda t: [0.2 * t], 31.3, parameters={"I": 1.02}, rotations={"q": 1})
    ends_at(orbit.follow("I", 0.99), "homoclinic", 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("a", [0.3, -0.3])
def test_cycles_end_at_an_exact_homoclinic_orbit(a: float) -> None:
    """Sandstede's planar system (J. Dynam. Diff. Eq. 9, 1997; AUTO-07p's demo `san`): x^2 (1 - x) = y^2 at mu = 0."""
    x, y, mu, shape = symbols("x y mu a")
    rhs = ca.vertcat(
        shape * x + y - shape * x**2 + mu * x * (2 - 3 * x),
        x + shape * y - 1.5 * x**2 - 1.5 * shape * x * y - 2 * mu * y,
    )
    model = OdeModel("leaf", ca.vertcat(x, y), rhs, ca.vertcat(mu, shape))
    start = find_equilibrium(model, [0.67, 0.0], parameters={"mu": -np.sign(a) * 0.5, "a": a})
    (hopf,) = start.follow("mu", np.sign(a) * 0.5).special_points
    branch = hopf.follow("mu", np.sign(a) * 0.5)
    ends_at(branch, "homoclinic", 0.0)
    at = branch.special_points[0].solution.evaluate(np.linspace(0.0, branch.period[-1], 500))
    assert np.max(np.abs(at[:, 0] ** 2 * (1.0 - at[:, 0]) - at[:, 1] ** 2)) < 1e-5


@pytest.mark.slow
def test_mirror_images_of_lorenz_cycles_end_at_one_homoclinic_orbit() -> None:
    """From both Hopf points down to r = 13.92655741, in as many points; the error is that of a truncated problem."""
    (pitchfork,) = find_equilibrium(lorenz(), [0, 0, 0], parameters={"r": 0.5}).follow("r", 2.0).special_points
    branches = []
    for side in (1, -1):
        (hopf,) = (p for p in pitchfork.follow("r", 30.0, side=side).special_points if p.kind == "hopf")
        branches.append(hopf.follow("r", 13.0))
    ends = [branch.special_points[-1] for branch in branches]
    for branch, end in zip(branches, ends, strict=True):
        assert branch.end is End.UNBOUNDED
        assert end.kind == "homoclinic"
        assert abs(end.parameters["r"] - 13.92655741) <= end.error + 5e-9
        assert end.error < 2e-7
    assert abs(len(branches[0]) - len(branches[1])) <= 2  # the ends are where rounding is


def small_cycles(model: OdeModel, state: list[float], parameter: str, start: float, to: float) -> Branch:
    """The cycles of the only Hopf point between two values, followed to the second."""
    equilibria = find_equilibrium(model, state, parameters={parameter: start}).follow(parameter, to)
    (hopf,) = (point for point in equilibria.special_points if point.kind == "hopf")
    branch: Branch = hopf.follow(parameter, to)
    return branch


@pytest.mark.slow
def test_a_canard_explosion_is_followed_to_the_end_that_was_asked_for() -> None:
    """Van der Pol's cycles grow at one value of a but for 1e-12; there is no saddle, so no homoclinic orbit."""
    x, y, a = symbols("x y a")
    model = OdeModel("canards", ca.vertcat(x, y), ca.vertcat((y - x**3 / 3 + x) / 0.02, a - x), a)
    branch = small_cycles(model, [1.2, -0.6], "a", 1.2, 0.5)
    assert branch.complete
    assert branch.special_points == ()
    assert np.max(branch.period) > 4.5
    last = branch.solutions[-1]
    run = solve_ivp(
        lambda t, s: [(s[1] - s[0] ** 3 / 3 + s[0]) / 0.02, 0.5 - s[0]], (0.0, last.period), last.evaluate(0.0),
        "Radau", rtol=1e-9, atol=1e-10,
    )  # fmt: skip
    assert np.max(np.abs(run.y[:, -1] - last.evaluate(0.0))) < 1e-6


@pytest.mark.slow
def test_cycles_between_two_saddles_end_where_melnikov_has_it() -> None:
    """x'' = -x + x^3 + eps (mu - x^2) x': tanh(t/sqrt 2) at mu = 1/5 + O(eps^2), a heteroclinic cycle by symmetry."""
    x, y, mu, eps = symbols("x y mu eps")
    rhs = ca.vertcat(y, -x + x**3 + eps * (mu - x**2) * y)
    ends = []
    for size in (0.05, 0.1):
        model = OdeModel("between", ca.vertcat(x, y), rhs, ca.vertcat(mu, eps), nominal=(0.0, size))
        branch = small_cycles(model, [0.0, 0.0], "mu", -0.1, 0.4)
        end = branch.special_points[-1]
        assert (end.kind, branch.end) == ("heteroclinic", End.UNBOUNDED)
        assert end.error < 1e-8
        ends.append(end.parameters["mu"])
    assert (4.0 * ends[0] - ends[1]) / 3.0 == pytest.approx(0.2, abs=1e-6)  # beyond terms in eps^2


@pytest.mark.slow
def test_cycles_that_spiral_out_of_a_saddle_end_at_its_homoclinic_orbit() -> None:
    """x''' = c x - x^2 - x' - 0.4 x'', a saddle with complex eigenvalues: c turns back and forth around its limit."""
    x, y, z, c = symbols("x y z c")
    model = OdeModel("spiral", ca.vertcat(x, y, z), ca.vertcat(y, z, c * x - x**2 - y - 0.4 * z), c)
    branch = small_cycles(model, [0.1, 0.0, 0.0], "c", 0.1, 2.5)
    *folds, end = branch.special_points
    assert end.kind == "homoclinic"
    turns = np.array([fold.parameters["c"] for fold in folds])
    assert {fold.kind for fold in folds} == {"fold"}
    sides = np.sign(turns - end.parameters["c"])
    assert np.all(sides[1:-1] != sides[2:])  # around the limit, nearer and nearer
    assert np.all(np.diff(np.abs(turns - end.parameters["c"])) < 0.0)


@pytest.mark.slow
def test_cycles_in_the_plane_end_at_a_saddle_node() -> None:
    """r' = r (1 - r^2), theta' = a - cos(theta): the period is 2 pi/sqrt(a^2 - 1), up to a = 1."""
    x, y, a = symbols("x y a")
    r2 = x**2 + y**2
    turn = a - x / ca.sqrt(r2)
    model = OdeModel("ring", ca.vertcat(x, y), ca.vertcat(x * (1 - r2) - y * turn, y * (1 - r2) + x * turn), a)
    start = find_orbit(model, lambda t: [np.cos(t), np.sin(t)], 2.0 * np.pi / np.sqrt(3.0), parameters={"a": 2.0})
    branch = start.follow("a", 0.5)
    ends_at(branch, "homoclinic", 1.0)
    assert "homoclinic to (x = 1, y = 0)" in branch.reason


def comes_back_outside(p: float) -> bool:
    """Whether the orbit that leaves the saddle of the reactor leaves it again with more conversion, once round."""
    field = lambda t, s: [p * (1 - s[0]) * np.exp(s[1]) - s[0], 14 * p * (1 - s[0]) * np.exp(s[1]) - 3 * s[1]]  # noqa: E731
    x = brentq(lambda x: x * np.exp(-14 * x / 3) / (1 - x) - p, 0.3111, 0.6, xtol=1e-15)
    rest = np.array([x, 14 * x / 3])
    growths, modes = np.linalg.eig([[-1 - x / (1 - x), x], [-14 * x / (1 - x), -3 + 14 * x]])
    modes, k = modes * np.sign(modes[0]), int(np.argmax(growths))
    run = solve_ivp(field, (0.0, 100.0), rest + 1e-6 * modes[:, k], "DOP853", rtol=1e-12, atol=1e-14, max_step=0.05)
    away = np.linalg.norm((run.y.T - rest) / [1.0, 8.0], axis=1)
    farthest = run.t[np.argmax(np.where(run.t < 40.0, away, 0.0))]
    left = np.flatnonzero((run.t > farthest + 12.0) & (away > 0.05))[0]
    return bool(np.linalg.inv(modes)[k] @ (run.y[:, left] - rest) > 0.0)


@pytest.mark.slow
def test_a_homoclinic_orbit_beside_a_saddle_node_is_named() -> None:
    """Of Uppal, Ray and Poore's reactor: a saddle 3e-2 of the orbit's extent from a fold, where it is not linear."""
    x, y, p = symbols("x y p")
    rate = p * (1 - x) * ca.exp(y)
    model = OdeModel("reactor", ca.vertcat(x, y), ca.vertcat(-x + rate, -3 * y + 14 * rate), p, nominal=(0.0,))
    rests = find_equilibrium(model, [0.0, 0.0]).follow("p", 0.25)
    (hopf,) = (point for point in rests.special_points if point.kind == "hopf")
    branch = hopf.follow("p", 0.08)
    low, high = 0.1055, 0.1056
    while high - low > 1e-11:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if comes_back_outside(middle) else (middle, high)
    ends_at(branch, "homoclinic", low)
    assert len(branch.values) < 200


def test_the_whole_period_of_a_pendulum_ends_on_its_separatrix() -> None:
    """Without the reversal its energy has an unfolding, whose value is no limit of E."""
    period = turn_time(1.2)
    orbit = find_orbit(
        pendulum(), lambda t: [2.0 * np.pi * t / period, 1.6], period, parameters={"E": 1.2}, select=ENERGY - E,
        rotations={"q": 1},
    )  # fmt: skip
    ends_at(orbit.follow("E", 0.5), "homoclinic", 1.0)


def passes_left(p: float) -> bool:
    """Whether the orbit that leaves the right saddle of prey without predators passes the left one on its left."""
    field = lambda t, s: [3 * s[0] * (1 - s[0]) - s[0] * s[1] - p * (1 - np.exp(-5 * s[0])), s[1] * (3 * s[0] - 1)]  # noqa: E731
    rest = lambda u: 3 * u * (1 - u) - p * (1 - np.exp(-5 * u))  # noqa: E731
    left, right = brentq(rest, 0.05, 0.3, xtol=1e-15), brentq(rest, 0.5, 0.9, xtol=1e-15)
    growth = 3 * right - 1
    slope = 3 - 6 * right - 5 * p * np.exp(-5 * right)
    gone = lambda t, s: s[0] - (left - 0.02)  # noqa: E731
    back = lambda t, s: s[0] - (left + 0.02) if s[1] < 1e-2 else -1.0  # noqa: E731
    gone.terminal = back.terminal = True  # type: ignore[attr-defined]
    gone.direction, back.direction = -1.0, 1.0  # type: ignore[attr-defined]
    start = [right - 1e-7 * right / (growth - slope), 1e-7]
    run = solve_ivp(field, (0.0, 400.0), start, "DOP853", events=(gone, back), rtol=1e-12, atol=1e-14)
    return bool(run.t_events[0].size)


@pytest.mark.slow
def test_cycles_that_end_at_saddles_on_an_invariant_line_are_named() -> None:
    """AUTO-07p's demo `pp2`: one of two connections lies on the line without predators, at every p."""
    u, v, p = symbols("u v p")
    rhs = ca.vertcat(3 * u * (1 - u) - u * v - p * (1 - ca.exp(-5 * u)), -v + 3 * u * v)
    branch = small_cycles(OdeModel("prey", ca.vertcat(u, v), rhs, p), [1 / 3, 1.9], "p", 0.05, 0.9)
    end = branch.special_points[-1]
    assert (end.kind, branch.end) == ("heteroclinic", End.UNBOUNDED)
    assert end.error < 1e-8
    low, high = 0.7080, 0.7082
    side = passes_left(low)
    assert passes_left(high) != side
    while high - low > 1e-9:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if passes_left(middle) == side else (low, middle)
    assert abs(end.parameters["p"] - low) <= end.error + 2e-8  # of shooting, which starts 1e-7 beside the saddle
