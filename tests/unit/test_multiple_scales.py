"""The weakly nonlinear modes against the paper's sums at 50 digits and against orbits found by shooting."""

from __future__ import annotations

from typing import NamedTuple

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from casadi_skin.lattice import closed_forms as multiple_scales

DIGITS = 50


def exact_frequency(sites: int, alpha: float, gamma: float, mode: int) -> mp.mpf:
    """omega_j, as printed in the paper."""
    root = mp.sqrt(1 - mp.mpf(gamma) ** 2)
    return mp.sqrt(2 + mp.mpf(alpha) - 2 * root * mp.cos(mp.pi * mode / (sites + 1)))


def exact_slope(sites: int, alpha: float, gamma: float, g: float, mode: int) -> mp.mpf:
    """dOmega_j/dS, as printed in the paper: sums of r^n sin^4 and r^n sin^2 from n = 1 to N."""
    with mp.workdps(DIGITS):
        r = (1 + mp.mpf(gamma)) / (1 - mp.mpf(gamma))
        sine = [mp.sin(mp.pi * n * mode / (sites + 1)) for n in range(1, sites + 1)]
        fourth = mp.fsum(r**n * sine[n - 1] ** 4 for n in range(1, sites + 1))
        second = mp.fsum(r**n * sine[n - 1] ** 2 for n in range(1, sites + 1))
        return 3 * mp.mpf(g) / (4 * (sites + 1) * exact_frequency(sites, alpha, gamma, mode)) * fourth / second


def paper_dynamical_matrix(sites: int, alpha: float, gamma: float) -> NDArray[np.float64]:
    """D of the paper's appendix."""
    return (
        np.diag(np.full(sites, 2 + alpha))
        - np.diag(np.full(sites - 1, 1 - gamma), 1)
        - np.diag(np.full(sites - 1, 1 + gamma), -1)
    )


# The slope --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [1, 6, 10, 14, 18, 24])
@pytest.mark.parametrize("g", [1.0, -1.0])
def test_frequency_slope_agrees_with_the_papers_sums_for_the_papers_families(g: float, mode: int) -> None:
    exact = exact_slope(24, 1.0, 0.25, g, mode)
    found = multiple_scales.frequency_slope(24, 1.0, 0.25, g, mode)
    assert abs(mp.mpf(found) / exact - 1) < 1e-14


@pytest.mark.parametrize(
    ("sites", "alpha", "gamma", "mode"),
    [
        (1, 1.0, 0.25, 1),
        (2, 0.5, -0.4, 2),
        (5, 0.0, 0.0, 3),
        (7, 1.0, 1e-7, 4),
        (60, 2.0, 0.9, 1),
        (60, 2.0, -0.99, 60),
    ],
)
def test_frequency_slope_agrees_with_the_papers_sums_elsewhere(
    sites: int, alpha: float, gamma: float, mode: int
) -> None:
    exact = exact_slope(sites, alpha, gamma, 0.7, mode)
    found = multiple_scales.frequency_slope(sites, alpha, gamma, 0.7, mode)
    assert abs(mp.mpf(found) / exact - 1) < 4e-14


@pytest.mark.parametrize("mode", [1, 3, 6])
@pytest.mark.parametrize("gamma", [0.25, -0.5])
def test_frequency_slope_agrees_with_the_appendix_in_numerical_eigenvectors(gamma: float, mode: int) -> None:
    """3 g/(8 omega) sum(v u^3)/(sum(u^2) sum(v u)), u and v diagonalise D and its transpose."""
    matrix = paper_dynamical_matrix(6, 1.0, gamma)
    values, right = np.linalg.eig(matrix)
    transposed_values, left = np.linalg.eig(matrix.T)
    u = right[:, np.argsort(values)[mode - 1]]
    v = left[:, np.argsort(transposed_values)[mode - 1]]
    omega = np.sqrt(np.sort(values)[mode - 1])
    expected = 3 * 2.0 / (8 * omega) * (v @ u**3) / ((u @ u) * (v @ u))
    found = multiple_scales.frequency_slope(6, 1.0, gamma, 2.0, mode)
    assert found == pytest.approx(expected, rel=1e-13)


@pytest.mark.parametrize("g", [1.0, -1.0, 0.0])
def test_one_site_has_the_slope_of_the_duffing_oscillator(g: float) -> None:
    """Poincare-Lindstedt: Omega = omega + 3 g a^2/(8 omega) + ..."""
    found = multiple_scales.frequency_slope(1, 0.44, 0.3, g, 1)
    assert found == pytest.approx(3 * g / (8 * np.sqrt(2.44)), rel=1e-15)


@pytest.mark.parametrize("mode", [1, 4, 9])
def test_the_mirror_image_has_the_same_slope(mode: int) -> None:
    expected = multiple_scales.frequency_slope(9, 1.0, 0.6, 1.0, mode)
    assert multiple_scales.frequency_slope(9, 1.0, -0.6, 1.0, mode) == pytest.approx(expected, rel=1e-14)


def test_a_reciprocal_chain_has_the_textbook_slope() -> None:
    """For gamma = 0 the sums are 3(N+1)/8 and (N+1)/2, unless 2j is a multiple of N+1."""
    omega = float(exact_frequency(10, 1.0, 0.0, 3))
    found = multiple_scales.frequency_slope(10, 1.0, 0.0, 1.0, 3)
    assert found == pytest.approx(3 / (4 * 11 * omega) * 3 / 4, rel=1e-14)


# The slope is that of true orbits ---------------------------------------------------------------------------


class BrakeOrbit(NamedTuple):
    frequency: float
    profile: NDArray[np.float64]  # unit vector y(0)/sqrt(S)


def shoot(sites: int, alpha: float, gamma: float, g: float, mode: int, S: float) -> BrakeOrbit:
    """The orbit with y'(0) = 0, y(T/4) = 0 and |y(0)|^2 = S, by shooting from numpy's linear mode."""
    matrix = paper_dynamical_matrix(sites, alpha, gamma)
    values, vectors = np.linalg.eig(matrix)
    chosen = np.argsort(values)[mode - 1]

    def defect(unknown: NDArray[np.float64]) -> NDArray[np.float64]:
        start, quarter = unknown[:-1], unknown[-1]
        end = solve_ivp(
            lambda _, x: np.concatenate([x[sites:], -matrix @ x[:sites] - g * S * x[:sites] ** 3]),
            (0.0, quarter),
            np.concatenate([start, np.zeros(sites)]),
            method="DOP853",
            rtol=1e-13,
            atol=1e-15,
        ).y[:sites, -1]
        return np.append(end, start @ start - 1)

    guess = np.append(vectors[:, chosen], np.pi / 2 / np.sqrt(values[chosen]))
    solution, _, status, message = fsolve(defect, guess, xtol=1e-13, full_output=True)
    assert status == 1, message
    return BrakeOrbit(np.pi / 2 / solution[-1], solution[:-1])


@pytest.mark.parametrize(("g", "mode"), [(1.0, 3), (-1.0, 1)])
def test_small_orbits_found_by_shooting_have_the_predicted_slope_and_profile(g: float, mode: int) -> None:
    sites, alpha, gamma, S = 3, 1.0, 0.25, 2e-3
    small, large = (shoot(sites, alpha, gamma, g, mode, factor * S) for factor in (1, 2))
    omega = float(exact_frequency(sites, alpha, gamma, mode))
    # The two difference quotients extrapolated to S = 0, which leaves an error of order S^2.
    measured = 2 * (small.frequency - omega) / S - (large.frequency - omega) / (2 * S)
    assert multiple_scales.frequency_slope(sites, alpha, gamma, g, mode) == pytest.approx(measured, rel=2e-7)

    # The prediction misses by order S^2 in frequency and by order S in relative profile: doubling S tells.
    predicted = multiple_scales.frequency(sites, alpha, gamma, g, mode, [S, 2 * S])
    miss = np.array([small.frequency, large.frequency]) - predicted
    assert miss[1] / miss[0] == pytest.approx(4.0, rel=2e-3)
    profile = multiple_scales.displacement(sites, alpha, gamma, g, mode, S, 0.0)[0] / np.sqrt(S)
    deviation = [np.linalg.norm(orbit.profile * np.sign(orbit.profile @ profile) - profile) for orbit in (small, large)]
    assert deviation[1] / deviation[0] == pytest.approx(2.0, rel=2e-3)


# Frequency, displacement, sensitivity -----------------------------------------------------------------------


def test_frequency_is_the_linear_one_plus_slope_times_amplitude() -> None:
    S = np.array([[0.0, 0.1], [0.5, 2.0]])
    found = multiple_scales.frequency(24, 1.0, 0.25, -1.0, 1, S)
    omega = exact_frequency(24, 1.0, 0.25, 1)
    slope = exact_slope(24, 1.0, 0.25, -1.0, 1)
    np.testing.assert_allclose(found, [[float(omega + slope * s) for s in row] for row in S], rtol=1e-15)
    assert np.shape(multiple_scales.frequency(24, 1.0, 0.25, -1.0, 1, 0.2)) == ()


@pytest.mark.parametrize(("g", "mode", "period"), [(1.0, 24, 2.83), (-1.0, 1, 6.06)])
def test_periods_at_small_amplitude_are_those_that_the_paper_states(g: float, mode: int, period: float) -> None:
    found = 2 * np.pi / multiple_scales.frequency(24, 1.0, 0.25, g, mode, 0.2)
    assert float(found) == pytest.approx(period, abs=0.006)


@pytest.mark.parametrize("gamma", [0.25, -0.25, 0.0])
def test_displacement_is_the_normalised_mode_times_a_cosine(gamma: float) -> None:
    sites, mode, S = 5, 2, 0.3
    t = np.linspace(0.0, 20.0, 13)
    found = multiple_scales.displacement(sites, 1.0, gamma, 1.0, mode, S, t)
    assert found.shape == (13, sites)
    r = (1 + gamma) / (1 - gamma)
    n = np.arange(1, sites + 1)
    u = r ** (n / 2) * np.sin(n * mode * np.pi / (sites + 1))
    frequency = float(exact_frequency(sites, 1.0, gamma, mode) + S * exact_slope(sites, 1.0, gamma, 1.0, mode))
    for row, time in zip(found, t, strict=True):
        expected = np.sqrt(S) * u / np.sqrt(np.sum(u**2)) * np.cos(frequency * time)
        np.testing.assert_allclose(row, expected, rtol=0, atol=1e-14)
    assert np.sum(found[0] ** 2) == pytest.approx(S, rel=1e-15)


def test_displacement_at_one_time_is_one_row() -> None:
    assert multiple_scales.displacement(4, 1.0, 0.2, 1.0, 1, 0.1, 3.0).shape == (1, 4)


@pytest.mark.parametrize("g", [2.0, -2.0])
def test_sensitivity_is_the_positive_relative_slope(g: float) -> None:
    expected = abs(exact_slope(24, 1.0, 0.4, g, 1)) / exact_frequency(24, 1.0, 0.4, 1)
    assert multiple_scales.sensitivity(24, 1.0, 0.4, g, 1) == pytest.approx(float(expected), rel=1e-14)


@pytest.mark.parametrize(("gamma", "limit"), [(0.25, 320.2), (0.4, 106.2), (0.55, 44.1), (0.7, 19.4)])
def test_sensitivity_falls_as_the_inverse_cube_of_the_size_in_the_end(gamma: float, limit: float) -> None:
    """Near the favoured edge sin(m pi/(N+1)) ~ m pi/(N+1); sums of m^4 r^-m and m^2 r^-m are rational in r.

    Their ratio gives (N+1)^3 times the sensitivity -> 3 pi^2 (3 - 2 gamma^2)/(4 gamma^2 omega_min^2), j = 1.
    """
    omega_min_squared = 3 - 2 * np.sqrt(1 - gamma**2)
    closed_form = 3 * np.pi**2 * (3 - 2 * gamma**2) / (4 * gamma**2 * omega_min_squared)
    assert closed_form == pytest.approx(limit, abs=0.06)  # measured independently
    deviation = [
        (sites + 1) ** 3 * multiple_scales.sensitivity(sites, 1.0, gamma, 1.0, 1) / closed_form - 1
        for sites in (1000, 2000, 4000)
    ]
    # Corrections are even in 1/(N+1).
    assert deviation[0] / deviation[1] == pytest.approx((2001 / 1001) ** 2, rel=1e-2)
    assert deviation[1] / deviation[2] == pytest.approx((4001 / 2001) ** 2, rel=1e-2)
    assert abs(deviation[2]) < 5e-5


# Extremes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.9, -0.9])
@pytest.mark.parametrize("mode", [1, 1500, 3000])
def test_a_long_strongly_nonreciprocal_chain_agrees_with_the_sums_over_its_favoured_edge(
    gamma: float, mode: int
) -> None:
    """r^3000 is 10^3836: only sums counted from the edge survive. After 60 sites terms are below 1e-70."""
    sites = 3000
    with mp.workdps(DIGITS):
        r = (1 + abs(mp.mpf(gamma))) / (1 - abs(mp.mpf(gamma)))
        sine = [mp.sin(mp.pi * m * mode / (sites + 1)) for m in range(60)]
        ratio = mp.fsum(r**-m * s**4 for m, s in enumerate(sine)) / mp.fsum(r**-m * s**2 for m, s in enumerate(sine))
        exact = 3 * ratio / (4 * (sites + 1) * exact_frequency(sites, 1.0, gamma, mode))
    found = multiple_scales.frequency_slope(sites, 1.0, gamma, 1.0, mode)
    assert abs(mp.mpf(found) / exact - 1) < 1e-12
    motion = multiple_scales.displacement(sites, 1.0, gamma, 1.0, mode, 1.0, [0.0, 1.0])
    assert np.all(np.isfinite(motion))
    assert np.sum(motion[0] ** 2) == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_one_way_coupling_gives_the_limit_of_the_papers_sums(mode: int) -> None:
    """As gamma -> 1 the edge site alone is left in both sums: the ratio is sin^2(N j pi/(N+1))."""
    found = multiple_scales.frequency_slope(3, 1.0, 1.0, 1.0, mode)
    expected = 3 / (4 * 4 * np.sqrt(3.0)) * np.sin(3 * mode * np.pi / 4) ** 2
    assert found == pytest.approx(expected, rel=1e-14)
    near = exact_slope(3, 1.0, 1 - 1e-12, 1.0, mode)
    assert found == pytest.approx(float(near), rel=1e-5)
