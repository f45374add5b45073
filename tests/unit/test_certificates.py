"""Proofs of orbits: what is known otherwise is inside the enclosures, and no bound is too small."""

import sys
from dataclasses import replace
from fractions import Fraction

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from cosine_operators import explicit, norm
from small_models import fput, limit_cycle, pendulums

from casadi_skin import Chain, OdeModel, follow_family

flint = pytest.importorskip("flint")

from casadi_skin.certify import balls
from casadi_skin.certify.bounds import Constants, FiniteInverse, holds, proved_radius, uniqueness_radius
from casadi_skin.certify.certify import attempt_of, computed_series, cosine_coefficients, distance, step_of
from casadi_skin.certify.system import CosineSeries, system_of


def orbit_of(model, S, mode=1, tolerance=1e-10, **options):
    return follow_family(model, mode=mode, amplitude_max=S, tolerance=tolerance, **options).at(S=S)


def inside(value, interval):
    return interval[0] <= value <= interval[1]


@pytest.mark.parametrize(("g", "S"), [(1.0, 2.0), (-1.0, 1.5), (1.0, 40.0), (-1.0, 1e-8)])
def test_exact_duffing_oscillator_is_inside_its_enclosures(g, S):
    certificate = orbit_of(Chain(1, 1.0, 0.0, g), S).certify()
    with mp.workdps(40):
        square = 3 + mp.mpf(g) * mp.mpf(S)
        Omega = mp.pi * mp.sqrt(square) / (2 * mp.ellipk(mp.mpf(g) * mp.mpf(S) / (2 * square)))
        assert certificate.proved
        assert certificate.least_period
        assert inside(Omega, certificate.Omega)
        assert certificate.Omega[1] - certificate.Omega[0] < 2e-15 * Omega
        assert inside(2 * mp.pi / Omega, certificate.period)
        assert inside(mp.sqrt(mp.mpf(S)), certificate.profile[:, 0])
        assert inside(3 * mp.mpf(S) / 2 + g * mp.mpf(S) ** 2 / 4, certificate.energy)
        middle, radius = (mp.mpf(x) for x in certificate.Omega_digits.strip("[]").split("+/-"))
        assert abs(middle - Omega) <= radius


@pytest.mark.slow
def test_newton_with_forty_digits_is_inside_the_enclosures():
    """Collocation at other nodes and with twice the harmonics, in mpmath."""
    chain, S, H = Chain(2, 1.0, 0.25, -1.0), 1.25, 22
    certificate = orbit_of(chain, S).certify()
    orbit = orbit_of(chain, S)
    with mp.workdps(40):
        nodes = [(i + mp.mpf(1) / 3) * mp.pi / (2 * H) for i in range(H)]
        basis = mp.matrix(H, H)
        for i, node in enumerate(nodes):
            for k in range(H):
                basis[i, k] = mp.cos((2 * k + 1) * node)
        x = mp.matrix([*orbit.coefficients(H).T.ravel().tolist(), orbit.Omega**2])
        for _ in range(5):
            a, square = [x[:H], x[H : 2 * H]], x[2 * H]
            q = [basis * mp.matrix(series) for series in a]
            residual, J = mp.matrix(2 * H + 1, 1), mp.matrix(2 * H + 1, 2 * H + 1)
            for n in range(2):
                coupling = (1 + mp.mpf("0.25")) if n == 1 else (1 - mp.mpf("0.25"))
                for i in range(H):
                    row, here, other = n * H + i, q[n][i], q[1 - n][i]
                    inertia = [basis[i, k] * (2 * k + 1) ** 2 for k in range(H)]
                    bend = mp.fdot(inertia, a[n])
                    residual[row] = square * bend - 3 * here + coupling * other + here**3
                    J[row, 2 * H] = bend
                    for k in range(H):
                        J[row, n * H + k] = square * inertia[k] + (-3 + 3 * here**2) * basis[i, k]
                        J[row, (1 - n) * H + k] = coupling * basis[i, k]
            start = [mp.fsum(series) for series in a]
            residual[2 * H] = mp.fdot(start, start) - mp.mpf(S)
            for n in range(2):
                for k in range(H):
                    J[2 * H, n * H + k] = 2 * start[n]
            x -= mp.lu_solve(J, residual)
        assert mp.norm(residual) < mp.mpf(10) ** -30
        assert inside(mp.sqrt(x[2 * H]), certificate.Omega)
        for n in range(2):
            assert inside(mp.fsum(x[n * H : (n + 1) * H]), certificate.profile[:, n])
        middle, radius = (mp.mpf(s) for s in certificate.Omega_digits.strip("[]").split("+/-"))
        assert abs(middle - mp.sqrt(x[2 * H])) <= radius + mp.mpf(10) ** -24


def quintic(with_normalisation=False):
    """y'' = -k y - c y^3/3 - y^5, with S = 2 y^2 by a normalisation of its own or not."""
    y, v, k, c, S = (ca.SX.sym(name) for name in ("y", "v", "k", "c", "S"))
    own = {"normalisation": 2 * y**2 - S} if with_normalisation else {}
    parameters, nominal = (
        (ca.vertcat(k, c, S), (1.3, 0.7, 1.0)) if with_normalisation else (ca.vertcat(k, c), (1.3, 0.7))
    )
    return OdeModel(
        "quintic", y, -k * y - c / 3 * y**3 - y**5, parameters, 2, v, reversal=(1, -1), half_period=(-1, -1),
        nominal=nominal, hamiltonian=v**2 / 2 + k * y**2 / 2 + c * y**4 / 12 + y**6 / 6, **own,
    )  # fmt: skip


@pytest.mark.parametrize("own", [False, True])
def test_period_of_a_quintic_oscillator_by_quadrature_is_inside(own):
    certificate = orbit_of(quintic(own), 1.6).certify()
    with mp.workdps(30):
        k, c = mp.mpf(1.3), mp.mpf(0.7)
        a = mp.sqrt(mp.mpf(1.6) / (2 if own else 1))
        # energy(a) - energy(a sin u) over a^2 cos(u)^2 is a polynomial of sin(u)^2
        rate = lambda u: mp.sqrt(  # noqa: E731
            k + c * a**2 / 6 * (1 + mp.sin(u) ** 2) + a**4 / 3 * (1 + mp.sin(u) ** 2 + mp.sin(u) ** 4)
        )
        period = 4 * mp.quad(lambda u: 1 / rate(u), [0, mp.pi / 4, mp.pi / 2])
        assert inside(period, certificate.period)
        assert inside(k * a**2 / 2 + c * a**4 / 12 + a**6 / 6, certificate.energy)
        assert inside(a, np.sort(np.abs(certificate.profile[:, 0])))


def test_amplitude_with_products_of_positions_is_that_of_the_model():
    """S = x^2 + x y + y^2 of two coupled oscillators: the proved displacements give it back."""
    x, y, u, w, S = (ca.SX.sym(name) for name in ("x", "y", "u", "w", "S"))
    force = ca.vertcat(-2 * x + 0.5 * y - x**3, -2.2 * y + 0.5 * x - 2 * y**3)
    model = OdeModel(
        "pair", ca.vertcat(x, y), force, S, 2, ca.vertcat(u, w), reversal=(1, 1, -1, -1), half_period=(-1,) * 4,
        normalisation=x**2 + x * y + y**2 - S,
    )  # fmt: skip
    certificate = orbit_of(model, 0.8, mode=2).certify()
    assert certificate.proved
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        one, two = (flint.arb(a).union(flint.arb(b)) for a, b in certificate.profile.T.tolist())
        square = one**2 + one * two + two**2
    assert square.overlaps(flint.arb(0.8))
    assert float(square.rad()) < 1e-14
    assert certificate.energy is None


def soft(sites):
    """FPUT-alpha with fixed ends, forces d + d^2/4 of extensions, and y + y^2 at one site; no half-period symmetry."""
    q, v = ca.SX.sym("q", sites), ca.SX.sym("v", sites)
    if sites == 1:
        force, potential = -q - q**2, q**2 / 2 + q**3 / 3
    else:
        d = ca.vertcat(q, 0) - ca.vertcat(0, q)
        pull = d + d**2 / 4
        force, potential = pull[1:] - pull[:-1], ca.sum1(d**2 / 2 + d**3 / 12)
    return OdeModel(
        "soft", q, force, order=2, velocity=v, reversal=(1,) * sites + (-1,) * sites,
        hamiltonian=ca.dot(v, v) / 2 + potential,
    )  # fmt: skip


@pytest.mark.parametrize("S", [1e-6, 0.01, 0.1])
def test_period_of_a_quadratic_force_is_inside(S):
    """y'' = -y - y^2 from y(0) = sqrt(S): the period by elliptic integrals of the three turning points."""
    certificate = orbit_of(soft(1), S).certify()
    with mp.workdps(40):
        a = mp.sqrt(mp.mpf(S))
        energy = a**2 / 2 + a**3 / 3
        b, c = ((-(a + 1.5) + s * mp.sqrt((a + 1.5) ** 2 - 4 * a**2 - 6 * a)) / 2 for s in (1, -1))
        period = 4 * mp.sqrt(mp.mpf(3) / 2) / mp.sqrt(a - c) * mp.ellipk((a - b) / (a - c))
        assert certificate.step == 1
        assert certificate.least_period
        assert inside(period, certificate.period)
        assert inside(2 * mp.pi / period, certificate.Omega)
        assert inside(energy, certificate.energy)
        assert inside(a, certificate.profile[:, 0])


@pytest.mark.parametrize(
    ("model", "S", "mode", "harmonics", "weight"), [(fput(6), 0.7, 6, 30, 1.05), (soft(5), 0.3, 2, 25, 1.1)]
)
def test_lattices_with_nonlinear_bonds_are_proved_at_any_number_of_harmonics(model, S, mode, harmonics, weight):
    """Sums of odd cosines, and of all."""
    orbit = orbit_of(model, S, mode=mode)
    one, other = orbit.certify(), orbit.certify(harmonics=harmonics, weight=weight)
    assert one.proved
    assert other.proved
    for name in ("Omega", "energy", "profile"):
        (a, b), (c, d) = getattr(one, name), getattr(other, name)
        assert np.all(np.maximum(a, c) <= np.minimum(b, d))
    assert abs(orbit.energy - one.energy[0]) < 1e-9 * orbit.energy
    assert abs(orbit.Omega - one.Omega[0]) <= orbit.Omega_error + 1e-15


def test_decimals_are_fractions():
    """alpha = 0.1, g = 0.3 and S = 0.7 as decimals: Omega differs from that of the doubles, and each is inside."""
    orbit = orbit_of(Chain(1, 0.1, 0.0, 0.3), 0.7, tolerance=1e-13)
    enclosed = []
    for decimals in (False, True):
        certificate = orbit.certify(decimals=decimals)
        with mp.workdps(40):
            alpha, g, S = (mp.mpf(str(x)) if decimals else mp.mpf(x) for x in (0.1, 0.3, 0.7))
            square = 2 + alpha + g * S
            Omega = mp.pi * mp.sqrt(square) / (2 * mp.ellipk(g * S / (2 * square)))
            middle, radius = (mp.mpf(x) for x in certificate.Omega_digits.strip("[]").split("+/-"))
            assert abs(middle - Omega) <= radius < 1e-19
            enclosed.append(middle)
            assert certificate.decimals is decimals
            lam = mp.mpf(orbit.Omega) ** 2  # the computed one, not its square rounded
            assert abs(lam - Omega**2) <= certificate.radius
    assert 1e-18 < abs(enclosed[0] - enclosed[1]) < 1e-15


def test_harmonics_that_are_left_out_count_in_the_radius():
    orbit = orbit_of(Chain(2, 1.0, 0.25, -1.0), 1.5)
    count, z = orbit.harmonics, orbit.point.z.copy()
    z[:count] += 1e-3 * np.cos((2 * count - 1) * (np.arange(count) + 0.5) * np.pi / (2 * count))  # of the first site
    wrong = replace(orbit, point=replace(orbit.point, z=z))
    certificate = wrong.certify(harmonics=4, weight=1.1)
    assert certificate.proved
    beyond = np.abs(wrong.coefficients(count)[4:] / certificate.scale)
    away = np.sum(beyond * 1.1 ** (2.0 * np.arange(4, count) + 1.0)[:, None])
    assert certificate.radius >= away > 2.0 * orbit.certify(harmonics=4, weight=1.1).radius


def test_the_frequency_that_a_radius_is_measured_from_is_the_double_itself():
    orbit = orbit_of(Chain(2, 1.0, 0.25, -1.0), 1.5)
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        series = computed_series(orbit, system_of(orbit.space.coordinates, orbit.S), 4)
        square = Fraction(orbit.Omega) ** 2
        assert series.square.overlaps(flint.arb(flint.fmpq(square.numerator, square.denominator)))
        for row, column, d in zip(
            series.coefficients, orbit.coefficients(series.harmonics).T, series.system.scale, strict=True
        ):
            assert all((a * d).contains(flint.arb(c)) for a, c in zip(row, column.tolist(), strict=True))


@pytest.mark.parametrize("size", [1e-6, 1e-3])
def test_disturbed_orbit_is_not_certified_to_less_than_the_disturbance(size):
    orbit = orbit_of(Chain(6, 1.0, 0.25, -1.0), 1.0)
    z = orbit.point.z.copy()
    z[: orbit.point.problem.states] *= 1.0 + size * np.random.default_rng(1).normal(size=orbit.point.problem.states)
    wrong = replace(orbit, point=replace(orbit.point, z=z))
    right, certificate = orbit.certify(), wrong.certify()
    assert right.radius < 1e-9
    scaled = (wrong.coefficients(12) - orbit.coefficients(12)) / right.scale
    away = np.sum(np.abs(scaled) * 1.02 ** (2.0 * np.arange(12) + 1.0)[:, None])
    assert away > size
    assert not certificate.proved or certificate.radius >= 0.999 * away
    if certificate.proved:  # then the true orbit is inside
        assert max(right.Omega[0], certificate.Omega[0]) <= min(right.Omega[1], certificate.Omega[1])


# Bounds that are large enough, and not twice as large -----------------------------------------------------------------


def unrefined(orbit, harmonics, weight=1.02):
    """Bounds about the coefficients as the orbit has them, cut to a few harmonics."""
    system = system_of(orbit.space.whole.coordinates, orbit.S, step_of(orbit.space))
    columns = cosine_coefficients(orbit, system, 40)[:harmonics].T.tolist()
    exact = [[(flint.arb(c) / d).mid() for c in column] for column, d in zip(columns, system.scale, strict=True)]
    series = CosineSeries(system, flint.arb(orbit.Omega**2), exact)
    return FiniteInverse(series, flint.arb(weight))


def padded(series, harmonics):
    rows = [[*row, *[flint.arb(0)] * (harmonics - len(row))] for row in series.coefficients]
    return CosineSeries(series.system, series.square, rows)


def test_radius_is_the_distance_of_the_true_orbit_but_for_a_little():
    """The radius of coarse coefficients against the true distance: Y lowered by half would not hold it."""
    orbit = orbit_of(Chain(3, 1.0, 0.25, -1.0), 1.0)
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        bounds = unrefined(orbit, 6)
        constants = bounds.constants()
        radius = proved_radius(constants)
        true = attempt_of(orbit, bounds.series.system, 24, 1.02).series
        away = distance(padded(bounds.series, 24), true, bounds.nu)
    assert 0.9 * constants.Y <= away <= radius
    assert away > 0.55 * radius
    assert proved_radius(replace(constants, Y=constants.Y / 2)) < away


@pytest.mark.parametrize(
    ("chain", "S", "harmonics", "sharp", "part"),
    [
        (Chain(1, 1.0, 0.0, 5.0), 3.0, 4, 0.5, 1.0),
        (Chain(4, 0.2, -0.5, 2.0), 1.0, 6, 0.5, 1.0),
        (Chain(3, 1.0, 0.25, -1.0), 2.0, 5, 0.4, 1.0),
        (Chain(3, 1.0, 0.25, -1.0), 1.0, 12, 0.8, 0.6),  # of six tenths of an inverse finite rows are four tenths off
    ],
)
def test_z_bounds_the_operator_on_many_harmonics_and_not_by_much_more(chain, S, harmonics, sharp, part):
    orbit = orbit_of(chain, S)
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        good = unrefined(orbit, harmonics, 1.05 if part == 1.0 else 1.02)
        bounds = FiniteInverse(good.series, good.nu, part * good.matrix)
        Z = bounds.Z()
    A, DF, weights = explicit(bounds, 60)
    assert sharp * Z < norm(np.eye(len(DF)) - A @ DF, weights) <= Z


@pytest.mark.parametrize(("sites", "S", "harmonics"), [(1, 0.08, 4), pytest.param(3, 0.3, 6, marks=pytest.mark.slow)])
def test_z_and_w_bound_the_operator_of_all_cosines(sites, S, harmonics):
    """Bounds about coarse series, whose k = 0 matters: beside them twice its rows would be outside."""
    orbit = orbit_of(soft(sites), S)
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        bounds = unrefined(orbit, harmonics, 1.05)
        Z, W = bounds.Z(), bounds.W(1e-3)
        J = bounds._jacobian()
    A, DF, weights = explicit(bounds, 40)
    assert 0.4 * Z < norm(np.eye(len(DF)) - A @ DF, weights) <= Z
    finite = np.concatenate([[0], *(1 + m * 40 + np.arange(harmonics) for m in range(sites))])
    assert np.allclose(J, DF[np.ix_(finite, finite)], rtol=1e-9, atol=1e-11)
    assert 0.1 * W < largest_change(bounds, 4) <= W


def largest_change(bounds, directions, reach=1e-3):
    """Of A DF over the length of a shift along one of the first coefficients."""
    A, DF, weights = explicit(bounds, 40)
    shifts = reach / weights[:directions, None] * np.eye(directions, len(DF))
    return max(norm(A @ (explicit(bounds, 40, shift)[1] - DF), weights) / reach for shift in shifts)


@pytest.mark.parametrize(("model", "S"), [(Chain(3, 1.0, 0.25, -1.0), 2.0), (soft(3), 0.3)])
def test_derivatives_of_forces_have_the_norms_of_their_columns(model, S):
    """With weights near 1 a column far from both ends has the whole norm of the series that makes it."""
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        bounds = unrefined(orbit_of(model, S), 6, 1.0001)
        bound = max(float(bounds.derivative_norm(n)) for n in range(3))
    _, DF, weights = explicit(bounds, 40)
    numbers = bounds.series.system.step * np.arange(1.0, 41.0) - 1.0
    forces = DF[1:, 1:] - np.diag(float(bounds.series.square) * np.tile(numbers**2, 3))
    found = np.max((weights[1:] @ np.abs(forces) / weights[1:])[[20, 60, 100]])
    assert 0.99 * bound < found <= bound


def test_finite_rows_of_z_are_those_of_the_operator():
    """A third harmonic near the other mode makes columns beyond the finite part reach far into it."""
    orbit = orbit_of(Chain(2, -0.7, 0.0, -0.3), 0.4)
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        bounds = unrefined(orbit, 2, 2.0)
        finite, beyond = bounds.finite_columns(), float(bounds.beyond)
        through_amplitude = (bounds.Z() - finite) * (1.0 - 1.0 / beyond)
    A, DF, weights = explicit(bounds, 60)
    rows = np.array([0, 1, 2, 61, 62])
    off = weights[rows] @ np.abs((np.eye(len(DF)) - A @ DF)[rows]) / weights
    assert 0.9 * finite < np.max(off) <= finite + through_amplitude


@pytest.mark.parametrize(
    ("chain", "S", "sharp"),
    [
        (Chain(1, -1.9, 0.0, 0.01), 1.0, 0.9),  # a soft oscillator: what Omega^2 does
        (Chain(1, 0.1, 0.0, 40.0), 1.0, 0.3),  # a hard one: what the forces do
        (Chain(3, 1.0, 0.25, -1.0), 2.0, 0.1),
    ],
)
def test_w_bounds_differences_of_the_operator(chain, S, sharp):
    orbit, reach = orbit_of(chain, S), 1e-3
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        bounds = unrefined(orbit, 5, 1.05)
        W = bounds.W(reach)
    assert sharp * W < largest_change(bounds, 5) <= W


def test_w_is_its_formula():
    """For one cubic oscillator each part of W by hand, from the explicit inverse."""
    S, g = 1.7, 3.0
    orbit, reach = orbit_of(Chain(1, 0.5, 0.0, g), S), 1e-3
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        bounds = unrefined(orbit, 6, 1.05)
        W = bounds.W(reach)
    A, _, weights = explicit(bounds, 40)
    unit, odd = float(bounds.series.system.scale[0]), 2.0 * np.arange(40) + 1.0
    columns = weights @ np.abs(A) / weights
    size = sum(abs(float(a)) * w for a, w in zip(bounds.series.coefficients[0], weights[1:], strict=False))
    forces = np.max(columns[1:]) * 6.0 * g * unit**2 * (size + reach)
    by_hand = np.max(columns[1:] * odd**2) + columns[0] * 2.0 * unit**2 / 1.05**2 + forces
    assert by_hand * (1.0 - 1e-9) <= W <= 1.02 * by_hand


def test_rounding_of_matrix_products_is_enclosed():
    """Each column of I - A_f J in balls, where it is nothing but rounding, against its bound by doubles."""
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS):
        bounds = unrefined(orbit_of(Chain(6, 1.0, 0.25, -1.0), 2.0), 12)
        H, size = 12, bounds.inner
        for n in range(6):
            rows, block = bounds._column(n, H)
            identity = np.zeros((size, H))
            identity[1 + n * H + np.arange(H), np.arange(H)] = 1.0
            found = bounds.image(rows, block, identity)
            exact = flint.arb_mat(bounds.matrix[:, rows].tolist()) * flint.arb_mat(block.middle.tolist())
            for j in range(H):
                column = [abs(flint.arb(identity[i, j]) - exact[i, j]) for i in range(size)]
                norm_ = sum(w * v for w, v in zip(bounds.rows_above.tolist(), column, strict=True))
                assert norm_ < found[j] < 1e-8


@pytest.mark.parametrize(
    ("Y", "Z", "W", "held"),
    [
        (0.375, 0.0, 1.0, True),  # Y + W r^2/2 = r, in numbers that doubles hold
        (0.376, 0.0, 1.0, False),
        (0.4, 0.0, 1.0, False),
        (0.1, 0.5, 1.0, False),  # Z + W r = 1
        (0.1, 0.25, 1.0, True),
        (0.3, 0.5, 0.0, False),
        (0.25, 0.5, 0.0, True),
        (float("nan"), 0.1, 1.0, False),
    ],
)
def test_conditions_are_those_of_the_theorem_at_their_limits(Y, Z, W, held):
    """At the radius 1/2: Y + Z/2 + W/8 <= 1/2 and Z + W/2 < 1."""
    assert holds(Constants(Y, Z, W, 1.0), 0.5) is held
    assert not holds(Constants(Y, Z, W, 0.25), 0.5)
    assert not holds(Constants(-1.0, Z, W, 1.0), 0.0)


def test_the_radius_of_uniqueness_is_the_largest_trial_that_holds():
    """At W = 3/2 the radius 1 is no contraction, 1/2 is one; from 0.6 on there is no larger one."""
    constants = Constants(0.01, 0.0, 1.5, 1.0)
    assert uniqueness_radius(constants, 0.02) == 0.5
    assert uniqueness_radius(constants, 0.6) == 0.6
    assert uniqueness_radius(replace(constants, W=0.5), 0.02) == 1.0
    assert uniqueness_radius(replace(constants, reach=0.25), 0.02) == 0.25


@pytest.mark.parametrize(("Y", "Z", "W"), [(0.01, 0.25, 2.0), (1e-9, 0.1, 1e4), (0.1, 0.0, 4.9)])
def test_the_proved_radius_is_the_smaller_root(Y, Z, W):
    """Of Y + (Z - 1) r + W r^2/2."""
    roots = np.roots([W / 2, Z - 1.0, Y])
    assert proved_radius(Constants(Y, Z, W, 1.0)) == pytest.approx(min(roots), rel=3e-9)
    assert proved_radius(Constants(Y, Z, 1.001 * (1 - Z) ** 2 / (2 * Y), 1.0)) is None


# What is not proved, and refused --------------------------------------------------------------------------------------


def test_too_few_harmonics_prove_nothing_and_say_what_helps():
    certificate = orbit_of(Chain(4, 1.0, 0.25, -1.0), 2.5).certify(harmonics=1)
    assert not certificate.proved
    assert np.isnan(certificate.Omega).all()
    assert np.isnan(certificate.radius)
    for words in ("with 1 odd harmonics", "more harmonics", "no proof that there is no orbit"):
        assert words in repr(certificate)
    assert "\n" not in certificate.reason


@pytest.mark.parametrize(
    ("orbit", "options", "words"),
    [
        (lambda: orbit_of(pendulums(3), 0.1), {}, "odd polynomials"),
        (limit_cycle, {}, "sums of cosines"),
        (lambda: orbit_of(Chain(4, 1.0, 1.0, 1.0), 0.5, mode=4), {}, "|gamma| < 1"),
        (lambda: orbit_of(Chain(1, 1.0, 0.0, 1.0), 1.0), {"weight": 1.0}, "weight"),
        (lambda: orbit_of(Chain(1, 1.0, 0.0, 1.0), 1.0), {"harmonics": 0}, "harmonics"),
    ],
)
def test_what_the_theorem_is_not_about_is_refused(orbit, options, words):
    with pytest.raises(ValueError, match=r"given .*; ") as error:
        orbit().certify(**options)
    assert words in str(error.value)
    assert "\n" not in str(error.value)


def test_missing_library_is_named_with_its_extra(monkeypatch):
    orbit = orbit_of(Chain(1, 1.0, 0.0, 1.0), 1.0)
    monkeypatch.setitem(sys.modules, "flint", None)
    with pytest.raises(ImportError, match=r'extra "certify"'):
        orbit.certify()
