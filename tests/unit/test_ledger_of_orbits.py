"""Events of branches of cycles account for their stability: none missed, none twice, in models in closed form."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from cycles_in_closed_form import Block, Truth, random_truth
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from casadi_skin import Branch, Chain, OdeModel, find_orbit, follow_family, simulate


def check(truth: Truth, branch: Branch, within: float = 1e-7) -> None:
    """Special points and changes of stability are those of the closed form, each within its error."""
    points, events = branch.special_points, truth.events
    assert [point.kind for point in points] == [kind for _, kind in events]
    for point, (place, _) in zip(points, events, strict=True):
        assert abs(point.parameters["l"] - place) <= max(point.error, 1e-13) <= within
    assert len(branch.changes) == len(truth.changes)
    for change, place in zip(branch.changes, truth.changes, strict=True):
        assert abs(change.value - place) <= max(change.error, 1e-13) <= within
        assert change.stable_after == (truth.outside(place + 1e-9) == 0)
    assert branch.unresolved == ()


def test_a_cycle_that_becomes_stable_at_a_torus_has_a_change_of_stability_there() -> None:
    truth = Truth((Block((0.05, -0.1), 0.7),))
    branch = truth.follow()
    assert truth.changes == pytest.approx([0.5])
    check(truth, branch)
    (change,) = branch.changes
    assert (change.kind, change.stable_before, change.stable_after) == ("complex", False, True)
    assert change.angle == pytest.approx(0.6 * np.pi)  # of 0.7 turns a period


def test_two_tori_within_one_step_are_both_seen() -> None:
    """The pair of multipliers touches the circle within a step whose ends show nothing."""
    truth = Truth((Block((0.25 - 1e-6, -1.0, 1.0), 0.7),))
    branch = truth.follow()
    steps = np.diff([orbit.parameters["l"] for orbit in branch.orbits if not orbit.point.special])
    assert np.max(steps) > 10.0 * np.ptp(truth.changes)
    check(truth, branch)


def test_a_cycle_that_becomes_stable_where_its_period_doubles_has_a_change_there() -> None:
    """Roessler's equations from c = 4, where the cycle of one turn is unstable, to 2."""
    x, y, z, c = (ca.SX.sym(name) for name in "xyzc")
    model = OdeModel("roessler", [x, y, z], [-y - z, x + 0.2 * y, 0.2 + z * (x - c)], c)
    cycle = simulate(model, [1.0, 1.0, 0.0], np.linspace(0.0, 300.0, 3001), parameters={"c": 2.5}).last_cycle()
    unstable = find_orbit(model, cycle, parameters={"c": 2.5}).follow("c", 4.0).orbits[-1]
    branch = unstable.follow("c", 2.0, stability=True)
    (doubling,), (change,) = branch.special_points, branch.changes
    assert doubling.kind == "period doubling"
    assert change.value == doubling.parameters["c"] == pytest.approx(2.832445, abs=1e-5)  # cycles of two turns begin
    assert (change.stable_before, change.stable_after, change.angle) == (False, True, np.pi)
    assert branch.unresolved == ()
    for to in (2.0, 4.0):  # a branch that starts there has it, whatever side rounding puts it on
        again = doubling.solution.follow("c", to, stability=True, max_points=5)
        assert [point.kind for point in again.special_points] == ["period doubling"]
        (change,) = again.changes
        assert abs(change.value - doubling.parameters["c"]) <= change.error + doubling.error
        assert (change.stable_before, again.unresolved) == (to > 3.0, ())


SLOW = [pytest.param(seed, 0.0, marks=pytest.mark.slow) for seed in range(4, 40)]
UNITS = [pytest.param(seed, 3.0, marks=pytest.mark.slow) for seed in range(100, 120)]


@pytest.mark.parametrize(("seed", "units"), [*((seed, 0.0) for seed in range(4)), *SLOW, *UNITS])
def test_every_event_of_random_models_is_located_in_any_units(seed: int, units: float) -> None:
    check(truth := random_truth(seed, units), truth.follow(), within=1e-6 if units else 1e-7)


@pytest.mark.slow
def test_an_orbit_of_a_family_followed_in_gamma_has_the_changes_of_the_families_at_each_gamma() -> None:
    """Three windows of instability, one 0.0003 wide; families judge orbits by another matrix over a quarter period."""
    orbit = follow_family(Chain(8, 1.0, 0.25, -1.0), mode=1, amplitude_max=1.2).at(S=1.0901975)
    assert not orbit.stable
    branch = orbit.follow("gamma", 0.4, stability=True)
    assert branch.unresolved == ()
    kinds = ["complex", "real", "real", "complex", "complex", "real", "real"]
    assert [change.kind for change in branch.changes] == kinds
    assert np.min(np.diff([change.value for change in branch.changes])) < 4e-4
    for change in branch.changes:
        for side in (-1e-6, 1e-6):
            chain = Chain(8, 1.0, change.value + side, -1.0)
            same = follow_family(chain, mode=1, amplitude_max=orbit.S).orbits[-1]
            assert same.stable == (change.stable_before if side < 0.0 else change.stable_after)


@pytest.mark.parametrize("width", [0.02, 0.003])
def test_a_pair_of_fold_torus_points_within_a_step_is_found_on_a_curve_of_cycles(width: float) -> None:
    """r' = r (mu + a r^2 - r^4) folds along mu = -a^2/4; beside it a pair of rates (a - 1.03)^2 - width^2/4 and 0.7."""
    x, y, u, v, mu, a = (ca.SX.sym(name) for name in ("x", "y", "u", "v", "mu", "a"))
    square = x**2 + y**2
    growth, rate = mu + a * square - square**2, 0.5 * ((a - 1.03) ** 2 - 0.25 * width**2)
    rhs = [growth * x - y, growth * y + x, rate * u - 0.7 * v, 0.7 * u + rate * v]
    model = OdeModel("folding cycles", [x, y, u, v], rhs, [mu, a])
    radius, values = 1.1, {"mu": 1.1**4 - 1.1**2, "a": 1.0}
    orbit = find_orbit(model, lambda t: [radius * np.cos(t), radius * np.sin(t), 0, 0], 2 * np.pi, parameters=values)
    fold = orbit.follow("mu", -0.5).special_points[0]
    assert (fold.kind, fold.parameters["mu"]) == ("fold", pytest.approx(-0.25, abs=1e-10))
    curve = fold.curve("a", 2.0)
    assert [point.kind for point in curve.special_points] == ["fold-torus", "fold-torus"]
    for point, place in zip(curve.special_points, (1.03 - 0.5 * width, 1.03 + 0.5 * width), strict=True):
        assert abs(point.parameters["a"] - place) <= max(3.0 * point.error, 1e-12) < 1e-9
    assert curve.unresolved == ()


MOON = 0.01215058560962404


def three_bodies() -> tuple[OdeModel, ca.SX]:
    """The circular restricted three-body problem in space, and the distance of phase zero from x0."""
    x, y, z, u, v, w, x0 = (ca.SX.sym(name) for name in ("x", "y", "z", "u", "v", "w", "x0"))
    r1, r2 = (ca.sqrt((x + a) ** 2 + y**2 + z**2) for a in (MOON, MOON - 1))
    effective = (x**2 + y**2) / 2 + (1 - MOON) / r1 + MOON / r2
    slope = ca.gradient(effective, ca.vertcat(x, y, z))
    rhs = ca.vertcat(u, v, w, 2 * v + slope[0], -2 * u + slope[1], slope[2])
    energy = (u**2 + v**2 + w**2) / 2 - effective
    state = ca.vertcat(x, y, z, u, v, w)
    return OdeModel("three bodies", state, rhs, x0, hamiltonian=energy, reversal=(1, -1, 1, -1, 1, -1)), x - x0


def planar_orbit(x0: float, speeds: tuple[float, float]) -> tuple[float, object, np.ndarray]:
    """Period and states of the Lyapunov orbit through (x0, 0), and the monodromy matrix of z'' = -U z along it."""

    def rates(_: float, s: np.ndarray) -> list[float]:
        x, y, u, v, *vertical = s
        r1, r2 = ((x + MOON) ** 2 + y * y) ** 1.5, ((x - 1 + MOON) ** 2 + y * y) ** 1.5
        pull = (1 - MOON) / r1 + MOON / r2
        ax = 2 * v + x - (1 - MOON) * (x + MOON) / r1 - MOON * (x - 1 + MOON) / r2
        across = [rate for a, b in (vertical[:2], vertical[2:]) for rate in (b, -pull * a)]
        return [u, v, ax, -2 * u + y - pull * y, *across]

    def half(speed: float) -> object:
        def crossing(_: float, s: np.ndarray) -> float:
            return float(s[1])

        crossing.terminal, crossing.direction = True, -1.0  # type: ignore[attr-defined]
        start = [x0, 1e-300, 0.0, speed, 1.0, 0.0, 0.0, 1.0]
        return solve_ivp(rates, (0.0, 5.0), start, "DOP853", events=crossing, rtol=1e-12, atol=1e-13)

    speed = brentq(lambda s: half(s).y[2, -1], *speeds, xtol=1e-14)  # type: ignore[attr-defined]
    period = 2.0 * half(speed).t[-1]  # type: ignore[attr-defined]
    start = [x0, 0.0, 0.0, speed, 1.0, 0.0, 0.0, 1.0]
    known = solve_ivp(rates, (0.0, period), start, "DOP853", rtol=1e-12, atol=1e-13, dense_output=True)
    return period, known.sol, known.y[4:, -1].reshape(2, 2).T


@pytest.mark.parametrize("symmetric", [False, True])
def test_halo_orbits_leave_lyapunov_orbits_where_their_vertical_pair_passes_1(symmetric: bool) -> None:
    """The orbits are unstable before and after; z'' = -U_zz z along a planar orbit has the trace 2 at the same x0."""
    model, select = three_bodies()
    period, states, _ = planar_orbit(1.1247, (0.15, 0.16))

    def guess(t: float) -> list[float]:
        x, y, u, v = states(t)[:4]  # type: ignore[operator]
        return [x, y, 0.0, u, v, 0.0]

    orbit = find_orbit(
        model, guess, period, parameters={"x0": 1.1247}, select=select, tolerance=1e-9, symmetric=symmetric
    )
    branch = orbit.follow("x0", 1.115, stability=True)
    (point,) = branch.special_points
    assert (point.kind, branch.changes, branch.unresolved) == ("branch point", (), ())
    place = point.parameters["x0"]
    beside = [np.trace(planar_orbit(place + off, (0.165, 0.185))[2]) - 2.0 for off in (1e-5, -1e-5)]
    assert beside[0] < 0.0 < beside[1]
    assert place + 1e-5 * (beside[0] + beside[1]) / (beside[0] - beside[1]) == pytest.approx(place, abs=1e-8)
    if symmetric:
        with pytest.raises(ValueError, match=r"follow: given a branch point on a part of the period of three bodies"):
            point.follow("x0", 1.11)
    else:
        halo = point.follow("x0", 1.11, max_points=12).orbits[-1]
        heights = halo.evaluate(np.linspace(0.0, halo.period, 50))[:, 2]
        assert np.ptp(heights) > 1e-4
        assert halo.error < 1e-8
