"""Special points and cycles do not depend on the units of states, of time and of the parameter."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols
from marks import slow

from casadi_skin import OdeModel, find_equilibrium, find_orbit
from casadi_skin.follow.branch import Branch, End
from casadi_skin.follow.space import FamilyError
from casadi_skin.model.integrators import stiff_cvodes


def hodgkin_huxley(unit: float, shift: float) -> OdeModel:
    """With the voltage v + shift in units of 1/unit mV, rest at v = 2e-5 for I = 0."""
    w, m, h, n, current = symbols("w m h n I")
    v = w / unit - shift
    am, bm = 0.1 * (25 - v) / (ca.exp((25 - v) / 10) - 1), 4 * ca.exp(-v / 18)
    ah, bh = 0.07 * ca.exp(-v / 20), 1 / (ca.exp((30 - v) / 10) + 1)
    an, bn = 0.01 * (10 - v) / (ca.exp((10 - v) / 10) - 1), 0.125 * ca.exp(-v / 80)
    membrane = current - 120 * m**3 * h * (v - 115) - 36 * n**4 * (v + 12) - 0.3 * (v - 10.599)
    gates = [a * (1 - gate) - b * gate for gate, a, b in ((m, am, bm), (h, ah, bh), (n, an, bn))]
    return OdeModel("hodgkin-huxley", ca.vertcat(w, m, h, n), ca.vertcat(unit * membrane, *gates), current)


@pytest.mark.parametrize(("unit", "shift"), [(1.0, 0.0), (1.0, 65.0), (1e-3, 0.0), (1e3, 0.0), (1e3, -65.0)])
def test_hodgkin_huxley_has_both_hopf_points_from_rest_in_any_units(unit: float, shift: float) -> None:
    """Published values; the state of the voltage at rest is accidentally near zero, or not."""
    rest = [unit * shift, 0.05, 0.6, 0.3]
    branch = find_equilibrium(hodgkin_huxley(unit, shift), rest, parameters={"I": 0.0}).follow("I", 200.0)
    points = branch.special_points
    assert [point.kind for point in points] == ["hopf", "hopf"]
    np.testing.assert_allclose([point.parameters["I"] for point in points], [9.779638, 154.526634], atol=5e-7)
    assert branch.unresolved == ()
    current = branch["I"]
    assert np.array_equal(branch.stable, (current <= 9.779638 + 1e-6) | (current >= 154.526634 - 1e-6))


def cubic(seed: int, size: int, *, D: np.ndarray, time: float = 1.0, range_: float = 1.0) -> OdeModel:
    """x' = time D f(x/D, p/range) with random linear, quadratic and cubic terms."""
    random = np.random.default_rng(seed)
    A, B = random.normal(size=(size, size)) - 0.5 * np.eye(size), random.normal(size=(size, size))
    quadratic, cubic_ = 0.4 * random.normal(size=(size, size, size)), 0.06 * random.normal(size=(size, size))
    x, p = ca.SX.sym("x", size), ca.SX.sym("p")
    y, q = x / D, p / range_
    f = ca.mtimes(ca.DM(A) + q * ca.DM(B), y) - y**3 + ca.mtimes(ca.DM(cubic_), y**3)
    f += ca.vertcat(*(ca.mtimes([y.T, ca.DM(form), y]) for form in quadratic))
    return OdeModel("cubic", x, time * D * f, p)


def followed(seed: int, size: int, start: np.ndarray, D: np.ndarray, **units: float) -> Branch:
    """The branch of such a model from p = -1.5 to 1.5 ranges, at most 150 points of it."""
    model, range_ = cubic(seed, size, D=D, **units), units.get("range_", 1.0)
    rest = find_equilibrium(model, D * start, parameters={"p": -1.5 * range_})
    return rest.follow("p", 1.5 * range_, max_points=150)


def assert_same(one: Branch, other: Branch, D: np.ndarray, range_: float = 1.0) -> None:
    """The same special points, places within the errors of both, states to 1e-8; nothing unresolved."""
    assert one.unresolved == other.unresolved == ()
    last = min(abs(branch.solutions[-1].point.parameter) for branch in (one, other))
    if one.end != other.end:
        assert last < 1.0  # a limit on points
    pairs = list(zip(one.special_points, other.special_points, strict=one.end is other.end and len(one) < 150))
    assert [a.kind for a, _ in pairs] == [b.kind for _, b in pairs]
    for a, b in pairs:
        apart = abs(a.parameters["p"] - b.parameters["p"] / range_)
        assert apart <= 2.0 * (a.error + b.error / range_) + 1e-14
        np.testing.assert_allclose(b.solution.state / D, a.solution.state, atol=1e-8)


SEEDS = [*range(4), *(slow(seed) for seed in range(4, 44))]


@pytest.mark.parametrize("seed", SEEDS)
def test_random_models_have_the_same_special_points_in_any_units(seed: int) -> None:
    """States in units of 1e-5 to 1e5, time and parameter in other ones; on the zero state too, which has no size."""
    size, random = 2 + seed % 4, np.random.default_rng(seed + 1000)
    D, one = 10.0 ** random.uniform(-5.0, 5.0, size), np.ones(size)
    zero = followed(seed, size, np.zeros(size), one)
    assert_same(zero, followed(seed, size, np.zeros(size), D), D)
    assert_same(zero, followed(seed, size, np.zeros(size), one, time=1e6), one)
    assert_same(zero, followed(seed, size, np.zeros(size), one, range_=1e-5), one, 1e-5)
    values = np.linspace(-1.5, 1.5, 20_001)
    random = np.random.default_rng(seed)
    A, B = random.normal(size=(size, size)) - 0.5 * np.eye(size), random.normal(size=(size, size))
    unstable = np.sum(np.linalg.eigvals(A + values[:, None, None] * B).real > 0.0, axis=1)
    changes = {"hopf": 2, "branch point": 1}
    for where, before, after in zip(values[1:], unstable, unstable[1:], strict=False):
        near = [p for p in zero.special_points if -1.6e-4 < p.parameters["p"] - where <= 1e-14]
        assert abs(int(after) - int(before)) <= sum(changes[point.kind] for point in near)
    assert len(zero.special_points) <= np.count_nonzero(np.diff(unstable))


def test_neighbouring_eigenvalues_of_a_fine_grid_are_two() -> None:
    """Swift-Hohenberg by finite differences, entries like h^-4: eigenvalues of -(1 + D2)^2 next to each other."""
    n, length = 60, 14.2
    h = length / (n + 1)
    second = (np.diag(np.full(n, -2.0)) + np.eye(n, k=1) + np.eye(n, k=-1)) / h**2
    operator = -((np.eye(n) + second) @ (np.eye(n) + second))
    u, r = ca.SX.sym("u", n), ca.SX.sym("r")
    model = OdeModel("swift-hohenberg", u, ca.mtimes(ca.sparsify(ca.DM(operator)), u) + r * u - u**3, r)
    exact = np.sort(-np.linalg.eigvalsh(operator))[:3]
    assert exact[1] - exact[0] < 1e-6 * np.max(np.abs(operator))
    branch = find_equilibrium(model, np.zeros(n), parameters={"r": 0.5 * exact[0]}).follow("r", 1.2 * exact[1])
    points = branch.special_points
    assert [point.kind for point in points] == ["branch point", "branch point"]
    np.testing.assert_allclose([point.parameters["r"] for point in points], exact[:2], rtol=1e-8)
    assert branch.unresolved == ()
    for point in points:
        other = point.follow("r", 1.1 * point.parameters["r"], max_points=5)
        assert np.max(np.abs(other.solutions[-1].state)) > 1e-3


QUICK = [(1e-8, 1.0, 1.0), (1e8, 1.0, 1.0), (1.0, 1e7, 1.0), (1e-8, 1.0, 1e8), (1e8, 1e8, 1e-8)]
UNITS = [
    pytest.param(*units, marks=[] if units in QUICK else pytest.mark.slow)
    for time in (1e-8, 1.0, 1e8)
    for x, y in ((1.0, 1.0), (1e7, 1.0), (1.0, 1e8), (1e-8, 1e-8), (1e8, 1e8), (1e8, 1e-8), (1e-8, 1e8))
    for units in [(time, x, y)]
]


@pytest.mark.parametrize(("time", "x", "y"), UNITS)
def test_cycles_are_followed_to_their_hopf_point_in_any_units(time: float, x: float, y: float) -> None:
    """r' = r (p - r^2), angle' = 1 + 0.3 r^2: a cycle of radius sqrt(p), frequency 1 + 0.3 p, born at p = 0."""
    u, v, p = symbols("u v p")
    a, b = u / x, v / y
    square = a**2 + b**2
    turn, growth = 1 + 0.3 * square, p - square
    rates = ca.vertcat(time * x * (growth * a - turn * b), time * y * (turn * a + growth * b))
    model = OdeModel("normal form", ca.vertcat(u, v), rates, p)
    frequency = 1.3 * time

    def circle(t: float) -> list[float]:
        return [x * np.cos(frequency * t), y * np.sin(frequency * t)]

    branch = find_orbit(model, circle, 2.0 * np.pi / frequency, parameters={"p": 1.0}).follow("p", -0.5)
    assert branch.end is End.HOPF
    assert len(branch) == 43  # whatever the units
    assert [(point.kind, abs(point.parameters["p"]) <= 1e-14) for point in branch.special_points] == [("hopf", True)]
    np.testing.assert_allclose(branch["period"], 2.0 * np.pi / (1 + 0.3 * branch["p"]) / time, rtol=1e-8)


@pytest.mark.parametrize(("time", "x", "y"), UNITS)
def test_orbits_of_an_undeclared_energy_are_one_of_a_family_in_any_units(time: float, x: float, y: float) -> None:
    q, v = symbols("q v")
    rates = ca.vertcat(time * x * (v / y), -time * y * (q / x + (q / x) ** 3))
    model = OdeModel("undeclared", ca.vertcat(q, v), rates)
    with pytest.raises(FamilyError, match="seems to conserve something"):
        find_orbit(model, lambda t: [x * np.cos(1.3 * time * t), -1.3 * y * np.sin(1.3 * time * t)], 4.8 / time)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6])
def test_a_cycle_that_passes_an_equilibrium_is_none_of_a_family(tolerance: float) -> None:
    """Its prey falls to 1e-7 of its largest and grows as much: the equations are singular within 1e-6."""
    x, y = symbols("x y")
    eaten = x * y / (1 + x)
    model = OdeModel("prey", ca.vertcat(x, y), ca.vertcat(x * (1 - x / 12) - eaten, eaten - 0.4 * y))
    cycle = stiff_cvodes(model, np.empty(0), np.array([1.0, 10.0]), np.linspace(0.0, 300.0, 30001)[1:], 1e-10).states
    (*_, first, last) = np.flatnonzero((cycle[:-1, 0] < 1.0) & (cycle[1:, 0] >= 1.0))
    period = (last - first) / 100.0
    orbit = find_orbit(
        model, lambda t: cycle[first + int(np.clip(round(100 * t), 0, last - first))], period, tolerance=tolerance
    )
    assert abs(orbit.period / period - 1.0) <= 1e-3
    assert abs(orbit.floquet().multipliers[1]) <= 1e-6


@pytest.mark.parametrize("unit", [1.0, 1e-6, 1e6])
def test_cycles_come_to_their_homoclinic_orbit_in_any_unit(unit: float) -> None:
    """Bogdanov and Takens' equations; the value of m2 by shooting from the saddle's manifolds, of eighth order."""
    x, y, m1, m2 = symbols("x y m1 m2")
    u, v = x / unit, y / unit
    model = OdeModel("bt", ca.vertcat(x, y), unit * ca.vertcat(v, m1 + m2 * v + u**2 + u * v), ca.vertcat(m1, m2))
    rest = find_equilibrium(model, [-0.2 * unit, 0.0], parameters={"m1": -0.04, "m2": 0.5})
    (hopf,) = rest.follow("m2", -0.5).special_points
    branch = hopf.follow("m2", 0.0)
    (last,) = (point for point in branch.special_points if point.kind == "homoclinic")
    assert abs(last.parameters["m2"] - 0.1440510191604) < last.error < 1e-7
