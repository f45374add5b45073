"""The linear chain in closed form (arXiv:2512.17483) against numpy's diagonalisation and 50 digits."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from casadi_skin.lattice import closed_forms as linear

EPS = float(np.finfo(float).eps)
DIGITS = 50


def paper_dynamical_matrix(sites: int, alpha: float, gamma: float) -> NDArray[np.float64]:
    """D of the paper's appendix: 2 + alpha on, -a_+ above and -a_- below the diagonal, a_+- = 1 -+ gamma."""
    matrix = np.zeros((sites, sites))
    for n in range(sites):
        matrix[n, n] = 2 + alpha
        if n + 1 < sites:
            matrix[n, n + 1] = -(1 - gamma)
            matrix[n + 1, n] = -(1 + gamma)
    return matrix


def exact_squared_frequency(sites: int, alpha: float, gamma: float, mode: int) -> mp.mpf:
    """The paper's squared dispersion relation at 50 digits, exactly as printed."""
    with mp.workdps(DIGITS):
        root = mp.sqrt(1 - mp.mpf(gamma) ** 2)
        return 2 + mp.mpf(alpha) - 2 * root * mp.cos(mp.pi * mode / (sites + 1))


def exact_sine(sites: int, mode: int, site: int) -> mp.mpf:
    """sin(n j pi/(N+1)) at 50 digits, the product n j an integer of any size."""
    with mp.workdps(DIGITS):
        return mp.sin(mp.pi * mp.mpf(site * mode) / (sites + 1))


# Frequencies ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.0, 0.25, -0.6, 0.9])
@pytest.mark.parametrize("sites", [1, 2, 3, 7])
def test_squared_frequencies_are_the_eigenvalues_of_the_papers_dynamical_matrix(sites: int, gamma: float) -> None:
    expected = np.sort(np.linalg.eigvals(paper_dynamical_matrix(sites, 0.4, gamma)).real)
    found = linear.squared_frequency(sites, 0.4, gamma, np.arange(1, sites + 1))
    np.testing.assert_allclose(found, expected, rtol=2e-11)


def test_squared_frequencies_are_the_eigenvalues_of_a_symmetric_matrix_with_the_geometric_mean_coupling() -> None:
    sites, alpha, gamma = 200, 1.0, 0.7
    off_diagonal = -np.sqrt((1 - gamma) * (1 + gamma)) * np.ones(sites - 1)
    matrix = np.diag((2 + alpha) * np.ones(sites)) + np.diag(off_diagonal, 1) + np.diag(off_diagonal, -1)
    found = linear.squared_frequency(sites, alpha, gamma, np.arange(1, sites + 1))
    np.testing.assert_allclose(found, np.linalg.eigvalsh(matrix), rtol=1e-14)


@pytest.mark.parametrize("mode", [1, 2, 3])
@pytest.mark.parametrize("gamma", [0.0, 1e-9, -1e-5, 1e-3])
@pytest.mark.parametrize("alpha", [0.0, 1e-12, 1e-6])
@pytest.mark.parametrize("sites", [10, 1000, 10**6])
def test_squared_frequency_keeps_every_digit_at_the_lower_edge_of_a_soft_chain(
    sites: int, alpha: float, gamma: float, mode: int
) -> None:
    exact = exact_squared_frequency(sites, alpha, gamma, mode)
    found = mp.mpf(float(linear.squared_frequency(sites, alpha, gamma, mode)))
    assert abs(found / exact - 1) < 4 * EPS


@pytest.mark.parametrize("mode", [1, 2, 12, 23, 24])
@pytest.mark.parametrize("gamma", [0.25, -0.6, 0.999, 1 - 1e-12])
def test_squared_frequency_keeps_every_digit_across_the_band(gamma: float, mode: int) -> None:
    exact = exact_squared_frequency(24, 1.0, gamma, mode)
    found = mp.mpf(float(linear.squared_frequency(24, 1.0, gamma, mode)))
    assert abs(found / exact - 1) < 3 * EPS


def test_an_array_of_modes_gives_the_frequencies_of_the_single_modes() -> None:
    together = linear.squared_frequency(9, 0.3, -0.4, np.arange(1, 10))
    assert together.shape == (9,)
    assert together.tolist() == [float(linear.squared_frequency(9, 0.3, -0.4, j)) for j in range(1, 10)]


@pytest.mark.parametrize("gamma", [0.0, 0.3, -0.99, 1.0])
def test_one_site_oscillates_at_two_plus_alpha_whatever_the_nonreciprocity(gamma: float) -> None:
    assert float(linear.squared_frequency(1, 0.7, gamma, 1)) == pytest.approx(2.7, rel=2 * EPS)


@pytest.mark.parametrize("gamma", [0.0, 0.6, -0.8])
def test_two_sites_split_by_the_coupling(gamma: float) -> None:
    coupling = {0.0: 1.0, 0.6: 0.8, -0.8: 0.6}[gamma]
    found = linear.squared_frequency(2, 1.0, gamma, np.array([1, 2]))
    np.testing.assert_allclose(found, [3 - coupling, 3 + coupling], rtol=2 * EPS)


@pytest.mark.parametrize("gamma", [1.0, -1.0])
def test_all_frequencies_meet_where_the_coupling_is_one_way(gamma: float) -> None:
    found = linear.squared_frequency(50, 1.5, gamma, np.arange(1, 51))
    assert found.tolist() == [3.5] * 50


@pytest.mark.parametrize("gamma", [1 - 1e-15, -(1 - 1e-9), 0.5, 1e-8])
def test_gauge_coupling_keeps_its_digits_near_one_way_coupling(gamma: float) -> None:
    with mp.workdps(DIGITS):
        exact = mp.sqrt(1 - mp.mpf(gamma) ** 2)
    assert abs(mp.mpf(linear.gauge_coupling(gamma)) / exact - 1) < 2 * EPS


# The envelope -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.25, -0.25, 1e-10, 0.9999999, -(1 - 1e-12)])
def test_log_envelope_is_half_the_logarithm_of_r_times_the_distance_to_the_favoured_edge(
    gamma: float,
) -> None:
    sites = 40
    found = linear.log_envelope(sites, gamma)
    favoured = sites if gamma > 0 else 1
    with mp.workdps(DIGITS):
        log_r = mp.log((1 + mp.mpf(gamma)) / (1 - mp.mpf(gamma)))
        for n in range(1, sites + 1):
            exact = log_r * (n - favoured) / 2
            assert abs(mp.mpf(float(found[n - 1])) - exact) <= 3 * EPS * abs(exact)


@pytest.mark.parametrize(("gamma", "edge"), [(1.0, -1), (-1.0, 0)])
def test_one_way_coupling_leaves_the_favoured_edge_alone(gamma: float, edge: int) -> None:
    found = linear.log_envelope(5, gamma)
    expected = np.full(5, -np.inf)
    expected[edge] = 0.0
    np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(np.exp(found), np.isfinite(expected).astype(float))


def test_a_reciprocal_chain_has_no_envelope() -> None:
    assert np.exp(linear.log_envelope(8, 0.0)).tolist() == [1.0] * 8


# Eigenvectors -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [1, 2, 12, 24])
@pytest.mark.parametrize("gamma", [0.25, -0.25, 0.7, 0.0])
def test_right_and_left_eigenvectors_satisfy_the_papers_eigenvalue_problems_row_by_row(gamma: float, mode: int) -> None:
    """Every row is relative to its own size, so a wrong site of size 1e-20 is seen."""
    matrix = paper_dynamical_matrix(24, 1.0, gamma)
    omega_squared = float(exact_squared_frequency(24, 1.0, gamma, mode))
    for operator, vector in (
        (matrix, linear.right_eigenvector(24, gamma, mode)),
        (matrix.T, linear.left_eigenvector(24, gamma, mode)),
    ):
        row_size = np.abs(operator) @ np.abs(vector)
        assert np.all(np.abs(operator @ vector - omega_squared * vector) < 1e-14 * row_size)


@pytest.mark.parametrize("mode", [1, 5, 10])
@pytest.mark.parametrize("gamma", [0.25, -0.7, 0.999])
def test_eigenvectors_have_the_papers_profiles_at_fifty_digits(gamma: float, mode: int) -> None:
    sites = 10
    right, left = linear.right_eigenvector(sites, gamma, mode), linear.left_eigenvector(sites, gamma, mode)
    with mp.workdps(DIGITS):
        root_r = mp.sqrt((1 + mp.mpf(gamma)) / (1 - mp.mpf(gamma)))
        right_edge, left_edge = (sites, 1) if gamma > 0 else (1, sites)
        for n in range(1, sites + 1):
            sine = exact_sine(sites, mode, n)
            u, v = root_r ** (n - right_edge) * sine, root_r ** (left_edge - n) * sine
            assert abs(mp.mpf(float(right[n - 1])) - u) < 2e-14 * abs(u)
            assert abs(mp.mpf(float(left[n - 1])) - v) < 2e-14 * abs(v)


@pytest.mark.parametrize("gamma", [0.3, -0.3, 0.0])
def test_left_and_right_eigenvectors_are_biorthogonal_with_the_papers_norm(gamma: float) -> None:
    sites = 12
    right = np.array([linear.right_eigenvector(sites, gamma, j) for j in range(1, sites + 1)])
    left = np.array([linear.left_eigenvector(sites, gamma, j) for j in range(1, sites + 1)])
    # Both are scaled to their own edge: v_n u_n carries r^(-(N-1)/2) beside the paper's (N+1)/2.
    r = (1 + abs(gamma)) / (1 - abs(gamma))
    product = left @ right.T * r ** ((sites - 1) / 2)
    np.testing.assert_allclose(product, (sites + 1) / 2 * np.eye(sites), atol=1e-13)


@pytest.mark.parametrize("mode", [1, 2, 7])
def test_the_opposite_nonreciprocity_has_the_mirrored_profile(mode: int) -> None:
    mirrored = linear.right_eigenvector(7, -0.4, mode)[::-1]
    parity = 1 if mode % 2 else -1
    np.testing.assert_allclose(mirrored, parity * linear.right_eigenvector(7, 0.4, mode), rtol=1e-14, atol=EPS)


def test_right_eigenvectors_lean_right_and_left_ones_left_for_positive_gamma() -> None:
    right, left = linear.right_eigenvector(24, 0.6, 1), linear.left_eigenvector(24, 0.6, 1)
    assert np.argmax(np.abs(right)) >= 20
    assert np.argmax(np.abs(left)) <= 3


def test_left_and_right_eigenvectors_of_a_reciprocal_chain_are_the_same_standing_wave() -> None:
    expected = np.sin(np.arange(1, 6) * 2 * np.pi / 6)
    np.testing.assert_allclose(linear.right_eigenvector(5, 0.0, 2), expected, atol=4 * EPS)
    np.testing.assert_array_equal(linear.left_eigenvector(5, 0.0, 2), linear.right_eigenvector(5, 0.0, 2))


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_the_only_eigenvector_of_a_jordan_block_is_its_favoured_edge(mode: int) -> None:
    right, left = linear.right_eigenvector(3, 1.0, mode), linear.left_eigenvector(3, 1.0, mode)
    assert right[:2].tolist() == [0.0, 0.0]
    assert left[1:].tolist() == [0.0, 0.0]
    assert right[2] == pytest.approx(np.sin(3 * mode * np.pi / 4), abs=4 * EPS)
    assert left[0] == pytest.approx(np.sin(mode * np.pi / 4), abs=4 * EPS)


# Large chains -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.9, -0.9, 1.0])
@pytest.mark.parametrize("mode", [1, 1500, 3000])
def test_a_long_strongly_nonreciprocal_chain_neither_overflows_nor_gives_nan(gamma: float, mode: int) -> None:
    """Warnings are errors in this suite, so an overflow anywhere fails."""
    right, left = linear.right_eigenvector(3000, gamma, mode), linear.left_eigenvector(3000, gamma, mode)
    for vector in (right, left):
        assert np.all(np.isfinite(vector))
        assert 0 < np.abs(vector).max() <= 1
    np.testing.assert_allclose(np.abs(right[::-1]), np.abs(left), rtol=1e-9, atol=1e-300)


@pytest.mark.parametrize("mode", [1, 17, 499_999, 999_983, 10**6])
def test_standing_waves_of_a_million_sites_agree_with_fifty_digits(mode: int) -> None:
    """n j reaches 1e12: left unreduced, the argument alone would cost ten digits."""
    sites = 10**6
    wave = linear.standing_wave(sites, mode)
    for n in (1, 2, 3, 1001, 499_999, 500_000, 777_777, 999_998, 10**6):
        assert abs(mp.mpf(float(wave[n - 1])) - exact_sine(sites, mode, n)) < 6 * EPS


@pytest.mark.parametrize("mode", [1, 17])
def test_standing_waves_keep_their_relative_digits_at_the_edge_where_skin_modes_live(mode: int) -> None:
    sites = 10**6
    wave = linear.standing_wave(sites, mode)
    for n in (1, 2, 999_998, 10**6):
        exact = exact_sine(sites, mode, n)
        assert abs(mp.mpf(float(wave[n - 1])) / exact - 1) < 4 * EPS
