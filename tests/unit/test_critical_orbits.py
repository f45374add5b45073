"""Folds, period doublings and tori of orbits in closed form: places, errors, normal forms, curves in two parameters."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from critical_models import across_circle, cycles_with_fold
from equilibrium_models import lorenz, symbols
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar
from test_orbit_bifurcations import _cycle

from casadi_skin import Branch, Chain, OdeModel, find_equilibrium, find_orbit, follow_family, read_result, save_result
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.zero.settings import End


def circle(t: float) -> list[float]:
    return [np.cos(t), np.sin(t), 0.0]


def first_special(model: OdeModel, k: float, start: float, to: float, radius: float = 1.0) -> SpecialPoint:
    """The only special point in a of the orbits near a circle."""
    guess = lambda t: [radius * x for x in circle(t)]  # noqa: E731
    orbit = find_orbit(model, guess, 2.0 * np.pi, parameters={"a": start, "k": k}, corrector="newton")
    (point,) = orbit.follow("a", to, stability=True).special_points
    return point


def test_a_fold_of_cycles_is_where_it_is_known_and_is_followed_in_two_parameters(tmp_path: Path) -> None:
    """r' = r (mu + a r^2 - r^4): the fold is along mu = -a^2/4, and r'' at it is half of -2 sqrt(2) for a = 1."""
    model = cycles_with_fold()
    orbit = find_orbit(
        model, lambda t: circle(t)[:2], 6.28, parameters={"mu": 0.1, "a": 1.0}, corrector="newton", tolerance=1e-6
    )
    branch = orbit.follow("mu", -0.26, until=lambda solution: solution.point.special == "fold")
    (fold,) = branch.special_points
    assert abs(fold.parameters["mu"] + 0.25) <= fold.error < 1e-14
    assert fold.coefficient == pytest.approx(-np.sqrt(2.0), rel=1e-9)
    curve = fold.curve("a", 1.3)
    assert curve.complete
    assert np.max(np.abs(curve["mu"] + curve["a"] ** 2 / 4.0)) < 1e-9
    save_result(curve, tmp_path / "curve")
    assert np.array_equal(read_result(tmp_path / "curve")["mu"], curve["mu"])


def folding_cycles_in_units(length: float, rate: float, mu: tuple[float, float], a: tuple[float, float]) -> OdeModel:
    """`cycles_with_fold` with other units of the state and of time, and parameters with a zero and a unit each."""
    (x, y, p, q), plain = symbols("x y mu a"), cycles_with_fold()
    inner = plain.function("rhs", plain.rhs)
    scaled = ca.vertcat((p - mu[0]) / mu[1], (q - a[0]) / a[1])
    rhs = length * rate * inner(0.0, ca.vertcat(x, y) / length, scaled)
    return OdeModel("folding cycles in units", ca.vertcat(x, y), rhs, ca.vertcat(p, q))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("length", "rate", "mu", "a"),
    [
        (1.0, 1.0, (0.0, 1.0), (0.0, 1.0)),
        (1e4, 1e3, (-2e-4, 1e-4), (-300.0, 100.0)),
        (1e-8, 1e-3, (3e5, 1e5), (5e-3, 1e-3)),
    ],
)
def test_folds_of_cycles_end_at_a_generalized_hopf_point_in_all_units(
    length: float, rate: float, mu: tuple[float, float], a: tuple[float, float]
) -> None:
    """The curve mu = -a^2/4 ends at a = 0, where l1 of the Hopf points mu = 0 is zero."""
    model, guess = folding_cycles_in_units(length, rate, mu, a), lambda t: [length * x for x in circle(rate * t)[:2]]
    values = {"mu": mu[0] + 0.1 * mu[1], "a": a[0] + a[1]}
    orbit = find_orbit(model, guess, 2.0 * np.pi / rate, parameters=values, corrector="newton")
    branch = orbit.follow("mu", mu[0] - 0.5 * mu[1])
    assert branch.end is End.HOPF
    curve = branch.special_points[0].curve("a", a[0] - a[1])
    assert curve.end is End.BAUTIN
    (end,) = curve.special_points
    assert end.kind == "generalized hopf"
    assert abs(end.parameters["a"] - a[0]) <= end.error < 1e-11 * a[1]
    assert abs(end.parameters["mu"] - mu[0]) < 1e-11 * mu[1]
    assert end.solution.period * rate == pytest.approx(2.0 * np.pi, rel=1e-9)
    assert np.max(np.ptp(end.solution.evaluate(np.linspace(0.0, end.solution.period, 9)), axis=0)) < 1e-9 * length


@pytest.mark.slow
def test_rounding_of_a_coefficient_that_goes_to_zero_with_the_orbit_is_no_cusp() -> None:
    """r' = r (mu + a r^2 - r^4) in mixed coordinates: the coefficient falls with r^3, its sign is lost at 1e-4."""
    random = np.random.default_rng(1)
    mix, bends = random.normal(size=(3, 3)) + 2.0 * np.eye(3), random.uniform(-0.4, 0.4, (3, 3))
    x, y, (mu, a) = ca.SX.sym("x", 3), ca.SX.sym("y", 3), ca.vertsplit(ca.SX.sym("p", 2))
    u, v, w = ca.vertsplit(y)
    growth = mu + a * (u**2 + v**2) - (u**2 + v**2) ** 2
    rates = ca.vertcat(growth * u - 1.3 * v, growth * v + 1.3 * u, 0.3 * u * v - w)
    curved = ca.vertcat(u, v + bends[1, 0] * u**2, w + bends[2, 0] * u**2 + bends[2, 1] * v**2)
    field = ca.mtimes(ca.jacobian(ca.mtimes(ca.DM(mix), curved), y), rates)
    u, v, w = ca.vertsplit(ca.mtimes(ca.DM(np.linalg.inv(mix)), x))
    v -= bends[1, 0] * u**2
    field = ca.substitute(field, y, ca.vertcat(u, v, w - bends[2, 0] * u**2 - bends[2, 1] * v**2))
    model = OdeModel("mixed", x, field, ca.vertcat(mu, a), nominal=(-1.0, 0.8))
    (hopf,) = find_equilibrium(model, [0.0, 0.0, 0.0]).follow("p_0", 0.5).special_points
    cycles = hopf.follow("p_0", -0.5, stability=True)
    curve = cycles.special_points[0].curve("p_1", -0.5)
    assert [point.kind for point in curve.special_points] == ["generalized hopf"]


@pytest.mark.slow
def test_normal_forms_of_period_doublings_and_tori_are_the_ones_written_down() -> None:
    """xi' = a xi + c xi^3 on a band of Moebius; w' = (a + 0.3 i) w + c w |w|^2, with v of mean square 1 twice c."""
    coefficient = 0.5
    doubling = first_special(
        across_circle(lambda xi, eta, a, k: (a * xi + coefficient * xi**3, -eta + k * xi**2 * eta), half=True),
        0.3,
        -0.1,
        0.1,
    )
    assert doubling.kind == "period doubling"
    assert abs(doubling.parameters["a"]) <= doubling.error < 1e-13
    assert doubling.coefficient == pytest.approx(coefficient, rel=1e-9)
    assert doubling.frequency == pytest.approx(0.5, rel=1e-9)

    def rates(xi: ca.SX, eta: ca.SX, a: ca.SX, k: ca.SX) -> tuple[ca.SX, ca.SX]:
        growth, turn = a + coefficient * (xi**2 + eta**2), 0.3 + k * (xi**2 + eta**2)
        return growth * xi - turn * eta, turn * xi + growth * eta

    torus = first_special(across_circle(rates, half=False), 0.3, -0.1, 0.1)
    assert torus.kind == "torus"
    assert abs(torus.parameters["a"]) <= torus.error < 1e-13
    assert torus.coefficient == pytest.approx(2.0 * coefficient, rel=1e-9)
    assert (torus.criticality, doubling.criticality) == ("subcritical", "subcritical")


@pytest.mark.parametrize("coupling", [0.0, 0.5])
def test_a_torus_of_a_pair_that_no_term_of_third_order_stops_is_degenerate(coupling: float) -> None:
    """Beside r' = r (1 - r^2) the pair is linear: what its coefficient is comes from rounding of its Floquet vector."""
    u, v, p, q, a = symbols("u v p q a")
    grow, stop = a + coupling * u, 1.0 - u**2 - v**2
    rhs = ca.vertcat(u * stop - 2.0 * v, v * stop + 2.0 * u, grow * p - 1.3 * q, 1.3 * p + grow * q)
    model = OdeModel("pair", ca.vertcat(u, v, p, q), rhs, a)
    orbit = find_orbit(model, lambda t: [*circle(2.0 * t)[:2], 0.0, 0.0], np.pi, parameters={"a": -0.3})
    (torus,) = orbit.follow("a", 0.4, stability=True).special_points
    assert torus.parameters["a"] == pytest.approx(0.0, abs=1e-9)
    assert (torus.kind, torus.criticality) == ("torus", "degenerate")
    assert abs(torus.coefficient) < 1e-100


def test_each_of_two_pairs_on_the_circle_at_once_has_its_own_angle() -> None:
    """w_k' = (p + i omega_k) w_k - k w_k |w_k|^2 beside a circle, with v of mean square 1: d = -2 k."""
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p")
    growth = [1.0 - ca.sumsqr(x[:2]), p - ca.sumsqr(x[2:4]), p - 2.0 * ca.sumsqr(x[4:])]
    parts = zip(growth, (1.0, 0.3, 0.42), (0, 2, 4), strict=True)
    field = [ca.vertcat(g * x[k] - w * x[k + 1], g * x[k + 1] + w * x[k]) for g, w, k in parts]
    orbit = find_orbit(
        OdeModel("two tori", x, ca.vertcat(*field), p),
        lambda t: [*circle(t), 0.0, 0.0, 0.0],
        6.28,
        parameters={"p": -0.2},
    )
    branch = orbit.follow("p", 0.3, stability=True)
    assert not branch.unresolved
    points = sorted(branch.special_points, key=lambda point: point.frequency)
    for point, k, omega in zip(points, (1, 2), (0.3, 0.42), strict=True):
        assert abs(point.parameters["p"]) <= point.error < 1e-12
        assert (point.frequency, point.coefficient) == (pytest.approx(omega), pytest.approx(-2.0 * k))


@pytest.mark.slow
def test_coefficients_that_change_their_sign_and_double_multipliers_are_named() -> None:
    """c = k along a = 0; det [[a, 1], [-k, -1]] = 0 along a = k, with trace zero at k = 1."""
    flip = first_special(
        across_circle(lambda xi, eta, a, k: (a * xi + k * xi**3 - xi**5, -eta), half=True), -0.5, -0.1, 0.1
    )
    _codimension_two(flip.curve("k", 0.5), {"generalized period doubling": 0.0})
    both = first_special(
        across_circle(lambda xi, eta, a, k: (a * xi + eta - xi**3, -k * xi - eta), half=True), 0.5, 0.4, 0.6
    )
    _codimension_two(both.curve("k", 1.4), {"1:2 resonance": 1.0})

    def rates(xi: ca.SX, eta: ca.SX, a: ca.SX, k: ca.SX) -> tuple[ca.SX, ca.SX]:
        square = xi**2 + eta**2
        growth = a + k * square - square**2
        return growth * xi - 0.3 * eta, 0.3 * xi + growth * eta

    _codimension_two(
        first_special(across_circle(rates, half=False), -0.5, -0.1, 0.1).curve("k", 0.5), {"chenciner": 0.0}
    )


def _codimension_two(curve: Branch, known: dict[str, float]) -> None:
    """The special points of a curve are the known ones, within their errors, which are not more than small."""
    points = curve.special_points
    assert [point.kind for point in points] == list(known)
    for point, value in zip(points, known.values(), strict=True):
        assert abs(point.parameters[curve.parameter] - value) <= 3.0 * point.error < 1e-9


@pytest.mark.slow
def test_tori_pass_the_strong_resonances_and_end_at_one_to_one_and_one_to_two() -> None:
    """Bogdanov and Takens' normal form across the circle: tori along a = -k^2 with the angle 2 pi sqrt(2 k).

    On a band of Moebius xi' = eta, eta' = -k xi + a eta: tori along a = 0 with the cosine -cos(2 pi sqrt(k)).
    """

    def rates(xi: ca.SX, eta: ca.SX, a: ca.SX, k: ca.SX) -> tuple[ca.SX, ca.SX]:
        turn = 1 + 0.7 * xi**2  # as fast as the circle is run through
        return turn * eta, turn * (a + k * eta + xi**2 + xi * eta)

    model = across_circle(rates, half=False)
    curve = first_special(model, 0.058, -0.0045, -0.0028, radius=0.935).curve("k", -0.1)
    _codimension_two(curve, {"1:3 resonance": 1.0 / 18.0, "1:4 resonance": 1.0 / 32.0, "1:1 resonance": 0.0})
    assert curve.end is End.RESONANCE_ONE
    assert np.max(np.abs(curve["a"] + curve["k"] ** 2)) < 1e-9
    model = across_circle(lambda xi, eta, a, k: (eta - xi**3, -k * xi + a * eta), half=True)
    curve = first_special(model, 0.066, -0.1, 0.1).curve("k", -0.1)
    _codimension_two(curve, {"1:4 resonance": 1.0 / 16.0, "1:3 resonance": 1.0 / 36.0, "1:2 resonance": 0.0})
    assert curve.end is End.RESONANCE_TWO


@pytest.mark.slow
def test_tori_are_followed_where_their_plane_turns_by_more_than_a_right_angle() -> None:
    """Two coordinates with the angle 2 pi (0.3 + 0.05 cos k) in a plane that turns by k about one of its diagonals."""
    x, y, a, k = symbols("x y a k")
    w, axis = ca.SX.sym("w", 3), np.sqrt(0.5) * np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-1.0, 1.0, 0.0]])
    R = ca.SX.eye(3) + ca.sin(k) * ca.DM(axis) + (1 - ca.cos(k)) * ca.DM(axis @ axis)
    u, turn = R.T @ w, 0.3 + 0.05 * ca.cos(k)
    growth, pull = a - u[0] ** 2 - u[1] ** 2, 1 - x**2 - y**2
    rates = ca.vertcat(growth * u[0] - turn * u[1], turn * u[0] + growth * u[1], -u[2])
    rhs = ca.vertcat(pull * x - y, pull * y + x, R @ rates)
    model = OdeModel("turning", ca.vertcat(x, y, w), rhs, ca.vertcat(a, k))
    guess = lambda t: [*circle(t)[:2], 0.0, 0.0, 0.0]  # noqa: E731
    orbit = find_orbit(model, guess, 2.0 * np.pi, parameters={"a": -0.1, "k": 0.0}, corrector="newton")
    (torus,) = orbit.follow("a", 0.1, stability=True).special_points
    curve = torus.curve("k", 3.0)
    _codimension_two(curve, {"1:3 resonance": np.arccos(2.0 / 3.0)})
    assert curve.complete
    assert len(curve) < 80  # 140 where steps are as short as the phase of the plane turns
    assert np.max(np.abs(curve["a"])) < 1e-9


@pytest.mark.slow
def test_two_folds_of_cycles_meet_at_a_cusp() -> None:
    """r' = r (mu + b s - s^3) with s = r^2 - 1: folds along 27 mu^2 = 4 b^3."""
    x, y, mu, b = symbols("x y mu b")
    s = x**2 + y**2 - 1
    growth = mu + b * s - s**3
    rhs = ca.vertcat(growth * x - y, growth * y + x)
    model = OdeModel("three cycles", ca.vertcat(x, y), rhs, ca.vertcat(mu, b))
    guess = lambda t: [1.3 * value for value in circle(t)[:2]]  # noqa: E731
    orbit = find_orbit(model, guess, 6.28, parameters={"mu": 0.0, "b": 0.3}, corrector="newton")
    fold = orbit.follow("mu", -0.3).special_points[0]
    curve = fold.curve("b", -0.1)
    _codimension_two(curve, {"cusp of cycles": 0.0})
    assert np.max(np.abs(27.0 * curve["mu"] ** 2 - 4.0 * curve["b"] ** 3)) < 1e-9


@pytest.mark.slow
def test_a_fold_and_a_period_doubling_meet_at_a_fold_flip() -> None:
    """Cycles that fold along mu = -a^2/4 drive two coordinates that turn half as fast, and grow at the rate a - 1.2."""
    x, y, u, v, mu, a = symbols("x y u v mu a")
    square, angle = x**2 + y**2, ca.atan2(y, x)
    growth, c, s = mu + a * square - square**2, ca.cos(angle / 2), ca.sin(angle / 2)
    xi, eta = c * u + s * v, -s * u + c * v
    xi_rate, eta_rate = (a - 1.2) * xi - xi**3, -eta
    rates = (c * xi_rate - s * eta_rate - v / 2, s * xi_rate + c * eta_rate + u / 2)
    rhs = ca.vertcat(growth * x - y, growth * y + x, *rates)
    model = OdeModel("fold and flip", ca.vertcat(x, y, u, v), rhs, ca.vertcat(mu, a))
    orbit = find_orbit(model, lambda t: [*circle(t), 0.0], 6.28, parameters={"mu": 0.1, "a": 1.0}, corrector="newton")
    fold = orbit.follow("mu", -0.26, until=lambda found: found.point.special == "fold").special_points[0]
    curve = fold.curve("a", 1.5)
    _codimension_two(curve, {"fold-flip": 1.2})


@pytest.mark.slow
def test_places_of_period_doublings_and_tori_are_within_their_errors_and_these_are_not_large() -> None:
    """Each at a coarse tolerance against a fine one: the error covers the difference, and is no more than rounding."""
    model, start = lorenz(), _cycle(lorenz(), 240.0)
    found = []
    for tolerance in (1e-4, 1e-10):
        orbit = find_orbit(model, start, parameters={"r": 240.0}, tolerance=tolerance)
        found.append(orbit.follow("r", 225.0, stability=True).special_points[0])
    coarse, fine = found
    apart = abs(coarse.parameters["r"] - fine.parameters["r"])
    assert apart <= coarse.error + fine.error
    assert coarse.error <= max(10.0 * apart, 1e-10)


@pytest.mark.slow
def test_the_adaptive_control_system_doubles_where_matcont_says_and_grows_as_its_coefficient_says() -> None:
    """MatCont's tutorial: alpha = 0.630302, period 6.364071. Beside it w^2 = -(rate of the exponent) d alpha / c."""
    x, y, z, alpha = symbols("x y z alpha")
    model = OdeModel("adaptive control", ca.vertcat(x, y, z), ca.vertcat(y, z, -alpha * z - y - x + x**2), alpha)
    (hopf,) = find_equilibrium(model, [0, 0, 0], parameters={"alpha": 1.2}).follow("alpha", 0.9).special_points
    branch = hopf.follow("alpha", 0.6, stability=True)
    (doubling,) = branch.special_points
    at, period = doubling.parameters["alpha"], doubling.solution.period
    assert (at, period) == pytest.approx((0.630302, 6.364071), abs=5e-7)

    def exponent(alpha: float) -> float:
        orbit = branch.at(alpha=alpha)
        return float(np.log(np.max(-orbit.floquet().others.real)) / orbit.period)

    rate = (exponent(at + 1e-4) - exponent(at - 1e-4)) / 2e-4
    orbit = doubling.follow("alpha", 0.6295, max_points=4).orbits[-1]
    t = orbit.period * np.arange(400) / 400
    apart = orbit.evaluate(t) - orbit.evaluate(t + orbit.period / 2)
    square = np.mean(np.sum(apart**2, axis=1)) / 4.0
    assert doubling.coefficient == pytest.approx(-rate * (orbit.parameters["alpha"] - at) / square, rel=1e-4)


@pytest.mark.slow
def test_tori_of_a_forced_oscillator_have_the_multipliers_of_their_resonances() -> None:
    """Van der Pol's, by CVODES sensitivities; tori end where two multipliers are 1."""
    x, y, F, omega, t = symbols("x y F omega t")
    rhs = ca.vertcat(y, 0.2 * (1 - x**2) * y - x + F * ca.cos(omega * t))
    period = 2 * np.pi / omega
    model = OdeModel("forced", ca.vertcat(x, y), rhs, ca.vertcat(F, omega), time=t, forcing_period=period)
    guess = lambda s: [2.5 * np.cos(1.25 * s), -2.5 * np.sin(1.25 * s)]  # noqa: E731
    orbit = find_orbit(model, guess, parameters={"F": 2.0, "omega": 1.25}, corrector="newton")
    (torus,) = orbit.follow("F", 0.5, stability=True).special_points
    below, above = torus.curve("omega", 1.02), torus.curve("omega", 1.6)
    assert below.end is End.RESONANCE_ONE
    found = [*below.special_points, *above.special_points]
    known = {"1:1 resonance": 1.0, "1:4 resonance": 1j, "1:3 resonance": np.exp(2j * np.pi / 3)}
    assert [point.kind for point in found] == list(known)
    for point, multiplier in zip(found, known.values(), strict=True):
        values = point.solution.floquet(flow="cvodes").multipliers
        assert np.min(np.abs(values - multiplier)) < 1e-4  # the square root of what CVODES leaves, where two are 1


@pytest.mark.slow
@pytest.mark.parametrize(("sites", "g", "gamma", "to", "most"), [(4, 1.0, 0.2, 0.25, 1.3), (16, -1.0, 0.3, 0.32, 1.0)])
def test_edges_of_tongues_of_a_chain_are_followed_in_gamma(
    sites: int, g: float, gamma: float, to: float, most: float
) -> None:
    """Real ones and Krein collisions, against every change of stability of the whole family at the other gamma.

    Those of 16 sites go on to where the chain is unstable on both sides, or beyond S = 1.
    """

    def family(gamma: float, most: float) -> Branch:
        chain = Chain(sites=sites, alpha=0.5, gamma=gamma, g=g)
        return follow_family(chain, mode=1, amplitude_max=most, stability=True)

    branch = family(gamma, most)
    curves = [branch.edge(number).curve("gamma", to) for number in range(len(branch.changes))]
    assert {curve.kind for curve in curves} == ({"real"} if sites == 4 else {"real", "complex"})
    diagram = family(to, 1.2 * max(curve.S[-1] for curve in curves)).stability_diagram
    known = np.array([edge.S for edge in (*diagram.changes, *diagram.further)])
    for curve, change in zip(curves, branch.changes, strict=True):
        assert curve.complete
        assert curve.S[0] == pytest.approx(change.S, rel=1e-10)
        assert np.min(np.abs(known - curve.S[-1])) <= 1e-10 * curve.S[-1]
    if sites == 16:  # where a tongue closes its edges cross, and each goes on along its own
        assert curves[3].S[0] - curves[2].S[0] > 1e-5
        assert curves[2].S[-1] - curves[3].S[-1] > 1e-3
    with pytest.raises(ValueError, match="number: given 70; accepted: 0 to "):
        branch.edge(70)


@pytest.mark.slow
def test_edges_of_lames_equation_are_followed_in_the_coupling() -> None:
    """Two equal Duffing oscillators in phase: Lame's equation of degree 2, whose edges are known in closed form.

    Its solutions with h = 4 + k^2 and 2 (1 + k^2) + 2 sqrt(1 - k^2 + k^4) in u'' + (h - 6 k^2 sn^2) u = 0 are periodic
    (Ince 1940); k^2 = S/4 / (1 + S/2), and 2 c = (1 + S/2) (h - 6 k^2) - 1.
    """
    y, v, c = ca.SX.sym("y", 2), ca.SX.sym("v", 2), ca.SX.sym("c")
    rhs = -y - y**3 + c * (y[::-1] - y)
    model = OdeModel(
        "two oscillators", y, rhs, c, order=2, velocity=v, nominal=(1.9,), reversal=[1, 1, -1, -1],
        half_period=[-1, -1, -1, -1],
    )  # fmt: skip
    branch = follow_family(model, 1, 2.5, stability=True)
    assert len(branch.changes) == 2
    for number in (0, 1):
        curve = branch.edge(number).curve("c", 2.1, at=[2.0])
        assert curve.complete
        assert 2.0 in curve["c"]
        k2 = curve.S / 4.0 / (1.0 + curve.S / 2.0)
        ends = [4.0 + k2, 2.0 * (1.0 + k2) + 2.0 * np.sqrt(1.0 - k2 + k2**2)]
        known = [0.5 * ((1.0 + curve.S / 2.0) * (h - 6.0 * k2) - 1.0) for h in ends]
        assert min(np.max(np.abs(curve["c"] - exact)) for exact in known) < 1e-9
    with pytest.raises(ValueError, match="parameter: given 'd'; accepted: c"):
        branch.edge(0).curve("d", 2.0)


@pytest.mark.slow
def test_the_edge_of_a_tongue_is_followed_around_a_fold_in_the_coupling(tmp_path: Path) -> None:
    """Two oscillators in phase, y'' = -y - y^3 + y^5/2: Hill's equation by Dormand-Prince is zero along the whole edge.

    The coupling of the edge, as a function of S, is largest at the fold; the curve goes on to where it started from.
    """

    def coefficient(S: float, coupling: float) -> float:
        def field(_: float, x: np.ndarray) -> list[float]:
            rate = 1.0 + 3.0 * x[0] ** 2 - 2.5 * x[0] ** 4 + 2.0 * coupling
            return [x[1], -x[0] - x[0] ** 3 + 0.5 * x[0] ** 5, x[3], -rate * x[2]]

        def at_rest(_: float, x: np.ndarray) -> float:
            return float(x[0])

        at_rest.terminal = True  # type: ignore[attr-defined]  # a quarter of the period
        start = [np.sqrt(S / 2.0), 0.0, 0.0, 1.0]
        return float(solve_ivp(field, (0.0, 9.0), start, "DOP853", rtol=1e-12, atol=1e-13, events=at_rest).y[2, -1])

    def edge(S: float) -> float:
        return float(brentq(lambda coupling: coefficient(S, coupling), 1.8, 2.4, xtol=1e-13))

    y, v, c = ca.SX.sym("y", 2), ca.SX.sym("v", 2), ca.SX.sym("c")
    rhs = -y - y**3 + 0.5 * y**5 + c * (y[::-1] - y)
    model = OdeModel(
        "two oscillators", y, rhs, c, order=2, velocity=v, nominal=(2.09,), reversal=[1, 1, -1, -1],
        half_period=[-1, -1, -1, -1],
    )  # fmt: skip
    branch = follow_family(model, 1, 2.9, stability=True)
    number = int(np.argmin([abs(coefficient(change.S, 2.09)) for change in branch.changes]))
    curve = branch.edge(number).curve("c", 2.5)
    assert curve.end is End.AWAY
    assert curve["c"][0] == curve["c"][-1] == 2.09
    (fold,) = curve.folds
    known = minimize_scalar(lambda S: -edge(S), bounds=(3.0, 3.4), method="bounded", options={"xatol": 1e-7})
    assert fold.parameters["c"] == pytest.approx(-known.fun, abs=fold.parameter_error + 1e-12)
    assert 0.0 < fold.parameter_error < 1e-8
    assert fold.parameters["S"] == pytest.approx(known.x, abs=fold.edge.error + 1e-6)
    assert np.all(np.diff(curve.S) > 0.0)
    assert max(abs(coefficient(S, c)) for S, c in zip(curve.S, curve["c"], strict=True)) < 1e-8
    read = read_result(curve.save(tmp_path / "edge.result"))
    assert (read["S"] == curve["S"]).all()
    assert read.reason == curve.reason
    assert read.folds[0].orbit.Omega == fold.orbit.Omega


def test_a_curve_of_orbits_tells_what_it_accepts() -> None:
    model = cycles_with_fold()
    orbit = find_orbit(model, lambda t: circle(t)[:2], 6.28, parameters={"mu": 0.1, "a": 1.0}, tolerance=1e-6)
    point = SpecialPoint("homoclinic", "mu", orbit.parameters, 0.0, orbit)
    with pytest.raises(
        ValueError, match="curve: given a homoclinic of orbits; accepted: fold, period doubling, torus, branch point"
    ):
        point.curve("a", 2.0)


@pytest.mark.slow
@pytest.mark.parametrize(("half", "start", "apart"), [(True, -0.34, 0.03), (False, 0.2, 0.005)])
def test_pairs_of_special_points_between_two_orbits_are_not_missed(half: bool, start: float, apart: float) -> None:
    """Growth rates with two roots so near to each other that no orbit of the branch lies between them."""

    def rates(xi: ca.SX, eta: ca.SX, a: ca.SX, k: ca.SX) -> tuple[ca.SX, ca.SX]:
        growth = (a - start) * (a - start - apart)
        if half:
            return growth * xi - xi**3, -eta
        growth = growth - xi**2 - eta**2
        return growth * xi - 0.3 * eta, 0.3 * xi + growth * eta

    orbit = find_orbit(across_circle(rates, half), circle, 6.28, parameters={"a": -1.0, "k": 0.0}, corrector="newton")
    branch = orbit.follow("a", 1.0, stability=True)
    kind = "period doubling" if half else "torus"
    assert [point.kind for point in branch.special_points] == [kind, kind]
    found = [point.parameters["a"] for point in branch.special_points]
    assert np.allclose(found, [start, start + apart], atol=1e-9)
    ordinary = [orbit.parameters["a"] for orbit in branch.orbits if not orbit.point.special]
    assert not any(start <= value <= start + apart for value in ordinary)


@pytest.mark.slow
def test_a_branch_point_of_cycles_is_followed_in_two_parameters_where_a_mirror_keeps_it() -> None:
    """Across the circle eta' = (a - k^2) eta - eta^3: a mirror symmetry is lost along a = k^2, for eta^2 = a - k^2."""
    model = across_circle(lambda xi, eta, a, k: (-xi, (a - k**2) * eta - eta**3), half=False)
    point = first_special(model, 0.5, -0.2, 1.0)
    assert "mirror symmetry in z" in point.lost
    assert abs(point.parameters["a"] - 0.25) <= point.error < 1e-13
    curve = point.curve("k", 0.8)
    assert curve.complete
    assert np.max(np.abs(curve["a"] - curve["k"] ** 2)) < 1e-9
    halves = [point.follow("a", 1.0, side=side, at=[0.5]).at(a=0.5).evaluate(0.0)[2] for side in (1, -1)]
    assert halves == pytest.approx([0.5, -0.5], abs=1e-8)


def test_two_branches_of_cycles_cross_and_the_other_one_goes_to_both_sides() -> None:
    """AUTO's demo `lcbp`: cycles of radius a and of radius b cross at a = b, which c takes apart."""
    x, y, a, b, c = (ca.SX.sym(name) for name in "xyabc")
    r = ca.sqrt(x**2 + y**2)
    growth = r**2 - (a + b) * r + a * b + c
    rhs = ca.vertcat(-x * growth - 2 * np.pi * y, -y * growth + 2 * np.pi * x)
    model = OdeModel("crossing", ca.vertcat(x, y), rhs, ca.vertcat(a, b, c), nominal=(1.0, 2.0, 0.0))
    orbit = find_orbit(model, lambda t: [np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)], 1.0)
    (point,) = orbit.follow("a", 3.0, stability=True).special_points
    assert point.kind == "branch point"
    assert point.lost == ()
    assert abs(point.parameters["a"] - 2.0) <= point.error < 1e-13
    for to in (3.0, 1.0):
        other = point.follow("a", to)
        assert other.complete
        assert np.linalg.norm(other.solutions[-1].evaluate(0.0)) == pytest.approx(2.0, abs=1e-9)
    with pytest.raises(ArithmeticError, match="is none at other values of c: no symmetry"):
        point.curve("c", 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("half", [True, False])
def test_orbits_that_come_back_to_those_they_left_end_there(half: bool) -> None:
    """xi' = (1 - a^2) xi - xi^3 across the circle, or a band of Moebius: the others are there from a = -1 to 1."""
    rates = lambda xi, eta, a, k: (-xi, (1 - a**2) * eta - eta**3)  # noqa: E731
    model = across_circle(rates, half)
    branch = find_orbit(model, circle, 2.0 * np.pi, parameters={"a": -2.0, "k": 0.0}).follow("a", 2.0, stability=True)
    diagram = branch.follow_all(depth=2)
    assert diagram.names == (("", "_1") if half else ("", "_1", "_1b"))
    for found in diagram.branches[1:]:
        assert found.end is End.REJOINED
        end = found.special_points[-1]
        assert end.kind == "branch point"
        assert abs(end.parameters["a"] - 1.0) <= end.error < 1e-13
        # Not a = 0: there eta is 1, the orbit of two turns passes r = 0, and its equations are singular.
        assert found.at(a=0.5).period == pytest.approx(4.0 * np.pi if half else 2.0 * np.pi, abs=1e-6)
    assert [point.parameters["a"] for point in diagram.special_points] == pytest.approx([-1.0, 1.0], abs=1e-12)


@pytest.mark.slow
def test_nothing_crosses_along_orbits_of_one_parameter_value() -> None:
    """AUTO's demo `vhb`: at p = 0 energy is conserved, and every cycle is at p = 0, up to a homoclinic orbit."""
    x, y, p = (ca.SX.sym(name) for name in "xyp")
    model = OdeModel("vertical", ca.vertcat(x, y), ca.vertcat(p * x - y, x * (1 - x)), p)
    (hopf,) = find_equilibrium(model, [0, 0], parameters={"p": -1.0}).follow("p", 1.0).special_points
    cycles = hopf.follow("p", 0.5, stability=True, max_points=60)
    assert [point.kind for point in cycles.special_points] == ["homoclinic"]
    assert np.max(np.abs(cycles["p"])) < 1e-9
