"""Families as power series: elliptic functions, a recursion of its own at 40 digits, orbits, planted singularities."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from outputs import read_rows
from scenes import Runs, chain, family
from scipy.io import netcdf_file
from small_models import fput

from casadi_skin import Chain, OdeModel, follow_family
from casadi_skin.follow.family_series import FamilySeries, nearest_singularity
from casadi_skin.lattice.closed_forms import duffing_displacement
from casadi_skin.model.arguments import with_error
from casadi_skin.zero.amplitude_series import SmallDivisorError

EPS = np.finfo(float).eps
x, v = ca.SX.sym("x"), ca.SX.sym("v")


def off(found: float, exact: mp.mpf) -> float:
    return float(abs(mp.mpf(float(found)) - exact))


def oscillator(force: ca.SX, **options: Any) -> OdeModel:
    return OdeModel("oscillator", x, force, order=2, velocity=v, reversal=(1, -1), **options)


@cache
def series_of(model: Any, mode: int, order: int, S: float = 0.1) -> FamilySeries:
    found: FamilySeries = follow_family(model, mode, S, max_points=1).series(order)
    return found


# One site: elliptic functions -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("g", [1.0, -1.0, 4.0])
def test_the_series_of_duffing_is_that_of_elliptic_functions(g: float) -> None:
    """x'' + x + g x^3 = 0 with x(0)^2 = S: Omega = pi sqrt(1 + g S)/(2 K(m)), m = g S/(2 + 2 g S)."""
    with mp.workdps(120):
        exact = mp.taylor(lambda s: mp.pi * mp.sqrt(1 + s) / (2 * mp.ellipk(s / (2 + 2 * s))), 0, 60)
        exact = [value * mp.mpf(g) ** k for k, value in enumerate(exact)]
    found = series_of(Chain(1, -1.0, 0.0, g), 1, 60)
    np.testing.assert_allclose(found.Omega[:4], [1.0, 3 / 8 * g, -21 / 256 * g**2, 81 / 2048 * g**3], rtol=1e-15)
    errors = np.array([off(value, known) for value, known in zip(found.Omega, exact, strict=True)])
    assert np.all(errors <= found.Omega_error)
    assert np.min(found.digits) > 12.5
    assert abs(found.radius - 1.0 / abs(g)) <= found.radius_error < 0.05 / abs(g)  # where a softening one stands still
    assert found.singularity.real * g < 0.0
    assert abs(found.singularity.imag) < 0.01 / abs(g)


def test_the_profile_of_duffing() -> None:
    """a (cos theta + a^2/32 (cos 3 theta - cos theta) + a^4/1024 (23 cos theta - 24 cos 3 theta + cos 5 theta))."""
    found = series_of(Chain(1, -1.0, 0.0, 1.0), 1, 40)
    expected = [[1, 0, 0], [-1 / 32, 1 / 32, 0], [23 / 1024, -24 / 1024, 1 / 1024]]
    np.testing.assert_allclose(found.profile[:3, :3, 0], expected, atol=1e-16)
    assert found.harmonics[:3].tolist() == [1, 3, 5]
    assert np.all(np.abs(found.profile[:3, :3, 0] - expected) <= found.profile_error[:3, :3, 0] + 1e-18)
    t = np.linspace(0.0, 9.0, 31)
    exact = duffing_displacement(1.0, 1.0, np.sqrt(0.5), t)
    np.testing.assert_allclose(found.displacements(0.5, t)[:, 0], exact, atol=1e-12)
    for given in (None, "a", -1.0, np.nan):
        with pytest.raises((TypeError, ValueError), match=r"^S: given .*; accepted: "):
            found.frequency(given)
        with pytest.raises((TypeError, ValueError), match=r"^S: given .*; accepted: "):
            found.displacements(given, t)


def test_a_quintic_force_has_every_second_order() -> None:
    """Averaged over cos^6, x'' + x + x^5 = 0 has Omega^2 = 1 + 5/8 a^4 to first order."""
    found = series_of(oscillator(-x - x**5, half_period=(-1, -1)), 1, 6)
    assert found.Omega[2] == pytest.approx(5 / 16, rel=1e-14)
    assert np.all(np.abs(found.Omega[1::2]) <= found.Omega_error[1::2])


def test_forces_that_are_not_odd_have_a_series_in_the_root() -> None:
    """x'' + x + x^2 = 0 ends at the orbit of its saddle, from x(0) = 1/2 on: S = 1/4."""
    found = series_of(oscillator(-x - x**2), 1, 40, 0.05)
    assert found.variable == "sqrt(S)"
    np.testing.assert_allclose(found.Omega[:4], [1.0, 0.0, -5 / 12, -5 / 18], atol=1e-15)
    assert abs(found.radius - 0.25) <= found.radius_error < 0.01
    assert found.singularity == pytest.approx(0.5, abs=0.01)
    a = mp.mpf("0.2")
    with mp.workdps(30):
        energy = a**2 / 2 + a**3 / 3
        other = mp.findroot(lambda q: q**2 / 2 + q**3 / 3 - energy, -a)
        middle, half = (a + other) / 2, (a - other) / 2

        def rate(phi: mp.mpf) -> mp.mpf:  # cubic (a - q)(q - b)(q + c)/3 without the ends that are singular
            q = middle + half * mp.sin(phi)
            return 1 / mp.sqrt(2 * (q + mp.mpf("1.5") + a + other) / 3)

        exact = mp.pi / mp.quad(rate, [-mp.pi / 2, 0, mp.pi / 2])
    assert off(found.frequency(float(a) ** 2), exact) <= found.frequency_error(float(a) ** 2) + 2 * EPS < 1e-13


# The chain: the paper's equation, and its higher orders at 40 digits --------------------------------------------------


def exact_slope(sites: int, alpha: float, gamma: float, g: float, mode: int) -> mp.mpf:
    """3 g/(8 omega) sum(v u^3)/(sum(u^2) sum(v u)) with the eigenvectors in closed form (paper, appendix)."""
    with mp.workdps(40 + 4 * sites):
        a, c, angle = mp.mpf(alpha), mp.mpf(gamma), mp.pi * mode / (sites + 1)
        omega, root = mp.sqrt(2 + a - 2 * mp.sqrt(1 - c**2) * mp.cos(angle)), mp.sqrt((1 + c) / (1 - c))
        u = [root**n * mp.sin(n * angle) for n in range(1, sites + 1)]
        w = [root**-n * mp.sin(n * angle) for n in range(1, sites + 1)]
        cubes = mp.fsum(b * y**3 for b, y in zip(w, u, strict=True))
        return 3 * mp.mpf(g) / (8 * omega) * cubes / (mp.fsum(y**2 for y in u) * mp.fdot(w, u))


@pytest.mark.parametrize(
    ("sites", "gamma", "g", "mode"),
    [
        (1, 0.3, 1.0, 1), (2, 0.5, -1.0, 2), (5, 0.0, 1.0, 3), (24, 0.25, -1.0, 1), (24, 0.25, 1.0, 24),
        (24, -0.25, 1.0, 12), (24, 0.6, 0.3, 10), (9, 0.99, -2.0, 4), (40, 0.9, 1.0, 40), (200, 0.9, -1.0, 1),
    ],
)  # fmt: skip
def test_the_first_order_is_the_papers_equation(sites: int, gamma: float, g: float, mode: int) -> None:
    found, exact = series_of(Chain(sites, 1.0, gamma, g), mode, 2), exact_slope(sites, 1.0, gamma, g, mode)
    assert off(found.Omega[1], exact) <= found.Omega_error[1] < 2e-9 * abs(exact)


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.9, 0.99, 0.9999, -0.9999])
def test_nonreciprocity_loses_no_digits_but_those_of_the_gap(gamma: float) -> None:
    """In physical coordinates a product of ratios of couplings would be lost: 1e172 of 40 sites at 0.9999."""
    found, s = series_of(Chain(40, 1.0, gamma, 1.0), 20, 10), np.sqrt((1.0 - gamma) * (1.0 + gamma))
    squares = -2.0 * s * np.cos(np.pi * np.arange(19, 22) / 41)
    lost = 3.0 / np.min(np.diff(squares))  # norm of the stiffness over the distance of the nearest modes
    assert np.all(found.Omega_error[1:] <= 100.0 * EPS * lost * np.abs(found.Omega[1:]))
    assert found.digits[1] > 15.0 - np.log10(100.0 * lost)


def times(left: dict[int, Any], right: dict[int, Any]) -> dict[int, Any]:
    """The product of two sums of cosines, coefficients by harmonic."""
    found: dict[int, Any] = {}
    for i, a in left.items():
        for j, b in right.items():
            for m in (i + j, abs(i - j)):
                found[m] = found.get(m, 0) + a * b / 2
    return found


def physical_series(sites: int, alpha: float, gamma: float, mode: int, orders: int) -> tuple[list[Any], list[Any]]:
    """Omega^2 and Y in powers of g S at the precision of mpmath: in physical coordinates, without nodes.

    Omega^2 Y'' = -D Y - g S Y^3 with sum_n Y_n(0)^2 = 1; an order of Y is a dictionary of harmonics for each site.
    """
    a, c, every = mp.mpf(alpha), mp.mpf(gamma), range(sites)
    D = mp.matrix([[2 + a if n == m else -(1 + c) if n == m + 1 else -(1 - c) if n == m - 1 else 0 for m in every]
                   for n in every])  # fmt: skip
    angle, root = mp.pi * mode / (sites + 1), mp.sqrt((1 + c) / (1 - c))
    u = [root**n * mp.sin(n * angle) for n in range(1, sites + 1)]
    start = [y / mp.norm(u) for y in u]
    squares, Y = [2 + a - 2 * mp.sqrt(1 - c**2) * mp.cos(angle)], [[{1: y} for y in start]]
    at_zero = [start]
    for k in range(1, orders + 1):
        right = {m: mp.zeros(sites + 1, 1) for m in range(1, 2 * k + 2, 2)}
        for n in every:
            for i in range(k):
                for j in range(k - i):
                    for m, value in times(times(Y[i][n], Y[j][n]), Y[k - 1 - i - j][n]).items():
                        right[m][n] -= value
            for m, column in right.items():
                column[n] += mp.fsum(m**2 * squares[j] * Y[k - j][n].get(m, 0) for j in range(1, k))
        new: list[dict[int, Any]] = [{} for _ in every]
        for m in [*range(3, 2 * k + 2, 2), 1]:
            border, matrix = mp.zeros(sites + 1), D - m**2 * squares[0] * mp.eye(sites)
            border[:sites, :sites], border[sites, sites] = matrix, 1
            if m == 1:
                border[sites, sites] = 0
                for n in every:
                    border[n, sites], border[sites, n] = -start[n], 2 * start[n]
                others = mp.fsum(2 * start[n] * mp.fsum(new[n].values()) for n in every)
                right[1][sites] = -others - mp.fsum(mp.fdot(at_zero[j], at_zero[k - j]) for j in range(1, k))
            solution = mp.lu_solve(border, right[m])
            for n in every:
                new[n][m] = solution[n]
        squares.append(solution[sites])
        Y.append(new)
        at_zero.append([mp.fsum(new[n].values()) for n in every])
    return squares, Y


@pytest.mark.parametrize(
    ("sites", "gamma", "g", "mode"), [(2, 0.5, 1.0, 1), (3, 0.95, -1.0, 3), (4, -0.3, 0.5, 2), (5, 0.999, 1.0, 5)]
)
def test_every_coefficient_is_within_its_error(sites: int, gamma: float, g: float, mode: int) -> None:
    orders, found = 8, series_of(Chain(sites, 1.0, gamma, g), mode, 8)
    with mp.workdps(60):
        squares, Y = physical_series(sites, 1.0, gamma, mode, orders)
        Omega = mp.taylor(lambda s: mp.sqrt(mp.fsum(value * s**k for k, value in enumerate(squares))), 0, orders)
    flip = np.sign(float(Y[0][int(np.argmax([abs(y[1]) for y in Y[0]]))][1]))
    for k in range(orders + 1):
        assert off(found.Omega[k], Omega[k] * mp.mpf(g) ** k) <= found.Omega_error[k]
        for n in range(sites):
            for i, m in enumerate(range(1, 2 * k + 2, 2)):
                exact = Y[k][n].get(m, mp.mpf(0)) * mp.mpf(g) ** k * flip
                assert off(found.profile[k, i, n], exact) <= found.profile_error[k, i, n] + 1e-300, (k, m, n)
    assert np.all(found.profile_error <= 1e-9 * np.max(np.abs(found.profile), axis=(1, 2), keepdims=True))


def test_mirrors_and_scales() -> None:
    """gamma to -gamma turns the chain round; g to c g is S to c S; alpha and couplings of a lattice scale time."""
    found, orders = series_of(Chain(5, 1.0, 0.4, 1.0), 2, 8), np.arange(9)
    turned, softer = series_of(Chain(5, 1.0, -0.4, 1.0), 2, 8), series_of(Chain(5, 1.0, 0.4, -2.0), 2, 8)
    np.testing.assert_allclose(turned.Omega, found.Omega, rtol=1e-13)
    sign = np.sign(turned.profile[0, 0, ::-1] @ found.profile[0, 0])
    np.testing.assert_allclose(sign * turned.profile[:, :, ::-1], found.profile, atol=1e-12)
    np.testing.assert_allclose(softer.Omega, found.Omega * (-2.0) ** orders, rtol=1e-12)
    assert softer.radius == pytest.approx(found.radius / 2, rel=1e-6)
    slow = series_of(oscillator(-4 * x - 4 * x**3, half_period=(-1, -1)), 1, 8)
    np.testing.assert_allclose(slow.Omega, 2.0 * series_of(Chain(1, -1.0, 0.0, 1.0), 1, 60).Omega[:9], rtol=1e-13)


# Other models, and followed families ----------------------------------------------------------------------------------


def henon_heiles() -> OdeModel:
    y, w = ca.SX.sym("y"), ca.SX.sym("w")
    force = ca.vertcat(-x - 2 * x * y, -1.69 * y - x**2 + y**2)
    return OdeModel("HH", ca.vertcat(x, y), force, order=2, velocity=ca.vertcat(v, w), reversal=(1, 1, -1, -1))


@pytest.mark.parametrize(
    ("model", "mode", "S"),
    [
        (Chain(24, 1.0, 0.25, -1.0), 1, 0.5), (Chain(6, 0.7, -0.6, 1.0), 3, 0.3), (Chain(3, 1.0, 1.0, 1.0), 3, 0.4),
        (fput(8), 3, 0.1), (henon_heiles(), 1, 0.02), (henon_heiles(), 2, 0.05), (Chain(300, 1.0, 0.9, 1.0), 300, 0.2),
    ],
)  # fmt: skip
def test_sums_are_followed_orbits(model: Any, mode: int, S: float) -> None:
    """Within errors: of 30 orders, and of the orbit."""
    branch = follow_family(model, mode, S, at=[S], tolerance=1e-11)
    found, orbit = branch.series(30), branch.at(S=S)
    assert found.radius - found.radius_error > S
    allowed = found.frequency_error(S) + orbit.Omega_error + 4 * EPS * orbit.Omega
    assert abs(found.frequency(S) - orbit.Omega) <= allowed < 1e-8
    t = np.linspace(0.0, orbit.period, 7)
    expected = orbit.evaluate(t)
    difference = np.max(np.abs(found.displacements(S, t) - expected))
    assert difference <= 1e3 * (allowed + orbit.profile_error * np.sqrt(S)), difference


def test_sums_come_nearer_within_the_radius_and_part_beyond() -> None:
    branch = follow_family(Chain(5, 0.71, 0.3, -1.0), 1, 2.6, at=[1.6, 2.6])
    found = branch.series(40)
    assert 1.6 < found.radius < 2.6
    for S, better in ((1.6, True), (2.6, False)):
        misses = [abs(found.frequency(S, order) - branch.at(S=S).Omega) for order in (10, 40)]
        assert bool(misses[1] < 0.1 * misses[0]) is better
    assert np.isinf(found.frequency_error(2.6))
    errors = found.frequency_error(np.array([0.1, 0.8, 1.6]))
    assert np.all(np.diff(errors) > 0.0)


def test_a_narrow_resonance_ends_the_convergence() -> None:
    """Where 7 Omega meets mode 23 the family turns back within 2e-6 of S = 0.015446, and nothing else shows it."""
    branch = follow_family(Chain(24, 1e-8, 0.25, 1.0), 1, 0.016)
    fold = branch.special_points[0]
    for orders in (20, 40, 60):
        found = branch.series(orders)
        assert abs(found.radius - fold.solution.S) <= found.radius_error < 0.02 * fold.solution.S
        assert found.singularity.imag == 0.0
    assert found.frequency_error(0.014) < 1e-14


def test_a_linear_family_converges_everywhere() -> None:
    found = series_of(oscillator(-4 * x, half_period=(-1, -1)), 1, 12)
    assert (found.Omega[0], found.radius, bool(found.frequency_error(100.0) < 1e-14)) == (2.0, np.inf, True)
    assert repr(found).endswith("radius in S infinite>")


def test_a_radius_that_is_not_estimated_is_said_to_be_unknown() -> None:
    few, more = (series_of(Chain(1, -1.0, 0.0, 1.0), 1, order) for order in (5, 6))
    assert np.isnan(few.radius)
    assert np.isfinite(more.radius)
    for words in (repr(few), str(few)):
        assert "unknown: it is estimated of order 6 and more" in words
        assert "nan" not in words
    assert f"radius in S {with_error(more.radius, more.radius_error)}" in repr(more)


# The radius of convergence --------------------------------------------------------------------------------------------


def power_of(place: complex, exponent: float, orders: int) -> np.ndarray:
    """Coefficients of (1 - x/place)^exponent; of its logarithm where the exponent is 0."""
    k = np.arange(1, orders + 1)
    if exponent == 0.0:
        return np.concatenate([[0.0], -1.0 / (k * place**k)])
    return np.concatenate([[1.0], np.cumprod((k - 1 - exponent) / (k * place))])


def planted(random: np.random.Generator, orders: int) -> tuple[float, np.ndarray]:
    """A series with one singularity, or a pair, on its circle of convergence and two pairs outside."""
    radius, total = 10.0 ** random.uniform(-2, 2), np.zeros(orders + 1)
    for nearest in (True, False, False):
        angle = random.choice([0.0, np.pi, random.uniform(0.0, np.pi)]) if nearest else random.uniform(0.0, np.pi)
        place = radius * (1.0 if nearest else random.uniform(1.1, 3.0)) * np.exp(1j * angle)
        weight = 10.0 ** random.uniform(-0.5, 0.5) * np.exp(2j * np.pi * random.uniform() * (abs(np.sin(angle)) > 1e-9))
        total += (weight * power_of(place, random.choice([-1.0, -0.5, 0.5, 0.5, 1.5, 0.0]), orders)).real
    return radius, total * (1.0 + 1e-15 * random.normal(size=orders + 1))


@pytest.mark.parametrize(("orders", "near"), [(12, 0.5), (20, 0.05), (40, 2e-3)])
def test_planted_radii_are_within_their_errors(orders: int, near: float) -> None:
    random, within, errors = np.random.default_rng(orders), 0, []
    for _ in range(60):
        radius, coefficients = planted(random, orders)
        place, found, error = nearest_singularity(coefficients)
        within += abs(found - radius) <= error
        errors.append(error / radius)
        assert np.isnan(place) or abs(place) == pytest.approx(found)
    assert within >= 55
    assert np.median(errors) < near


# Refusals -------------------------------------------------------------------------------------------------------------


def resonant() -> OdeModel:
    """The ninth harmonic of mode 1 is mode 2, exactly."""
    y, w = ca.SX.sym("y"), ca.SX.sym("w")
    return OdeModel(
        "resonant", ca.vertcat(x, y), ca.vertcat(-x - x**3, -81 * y - x**2 * y), order=2, velocity=ca.vertcat(v, w),
        reversal=(1, 1, -1, -1), half_period=(-1,) * 4,
    )  # fmt: skip


def of_family(model: Any, order: Any, mode: Any = 1) -> Callable[[], Any]:
    return lambda: follow_family(model, mode, 0.01, max_points=1).series(order)


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (of_family(Chain(2, 1.0, 0.2, 1.0), 0), "order: given 0; accepted: a whole number from 1 to 200"),
        (of_family(Chain(2, 1.0, 0.2, 1.0), 2.5), "order: given 2.5; accepted: a whole number from 1 to 200"),
        (of_family(Chain(1000, 1.0, 0.2, 1.0), 150), "order: given 150; accepted with 1000 positions: .* 1 to 100"),
        (of_family(Chain(np.inf, 1.0, 0.7, 1.0), 5, "last"), "sites: given inf; a series is that of all sites"),
        (
            of_family(oscillator(-ca.sin(x), half_period=(-1, -1)), 5),
            "of oscillator that are no polynomials; accepted: ",
        ),
        (lambda: resonant_branch(), "given a branch in p; accepted: a family of follow_family"),
    ],
)
def test_refusals_in_a_line(ask: Callable[[], Any], words: str) -> None:
    with pytest.raises(ValueError, match=words) as caught:
        ask()
    assert "\n" not in str(caught.value)


def resonant_branch() -> Any:
    from casadi_skin import find_equilibrium

    p = ca.SX.sym("p")
    return find_equilibrium(OdeModel("line", x, p - x, p, nominal=(0.0,)), [0.0]).follow("p", 1.0).series(3)


def test_a_resonance_beyond_those_that_families_check_is_named() -> None:
    with pytest.raises(SmallDivisorError, match="harmonic 9 of the mode has the frequency of another mode"):
        of_family(resonant(), 6)()
    assert of_family(resonant(), 3)().order == 3


# Scenes ---------------------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("pictures")
def test_a_scene_writes_the_series_of_its_families(run: Runs) -> None:
    run(chain(3, g=1.0) + family([1, 3], 0.4, series=9))
    rows, known = read_rows(run.out / "series.csv"), series_of(Chain(3, 1.0, 0.25, 1.0), 3, 9)
    assert [(int(row["mode"]), int(row["order"])) for row in rows] == [(j, k) for j in (1, 3) for k in range(10)]
    assert [float(row["Omega"]) for row in rows[10:]] == known.Omega.tolist()
    assert (float(rows[-1]["radius"]), float(rows[-1]["radius_error"])) == (known.radius, known.radius_error)
    with netcdf_file(run.out / "series.nc", mmap=False) as data:
        np.testing.assert_array_equal(data.variables["profile"][1], known.profile)
        assert data.variables["harmonic"][:].tolist() == known.harmonics.tolist()
    assert {path.name for path in run.out.glob("series_j*")} == {"series_j1.png", "series_j3.png"}
    run(chain(3, g=1.0) + family(1, 0.4, series=3), "--overwrite")
    assert {row["radius"] for row in read_rows(run.out / "series.csv")} == {""}  # too few orders
    assert {path.name for path in run.out.glob("series_j*")} == {"series_j1.png"}


def test_a_scene_that_has_no_series_is_refused(run: Runs) -> None:
    endless = "[chain]\nsites = inf\nalpha = 1.0\ngamma = 0.7\ng = 1.0\n"
    for scene, words in (
        (endless + family("last", 0.4, series=3), "[family] series: given 3 with sites = inf; accepted: "),
        (chain(2) + family(1, 0.4, series=0), "[family] series: given 0; accepted: a whole number >= 1 and <= 200"),
    ):
        assert words in run(scene, status=2).err
