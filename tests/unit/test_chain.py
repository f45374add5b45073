"""The nonreciprocal chain and its closed forms against arXiv:2512.17483: equations typed out, 50 digits, shooting."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from marks import slow
from numpy.typing import NDArray
from paper_data import sensitivity

from casadi_skin import Chain
from casadi_skin.lattice import closed_forms

EPS = float(np.finfo(float).eps)
DIGITS = 50
Array = NDArray[np.float64]


def numbers(value: Any) -> Array:
    """A CasADi result as a dense array, a column as a vector."""
    array = np.array(ca.DM(value))
    return array.ravel() if array.shape[1] == 1 else array


def force(model: Any, positions: Array, parameter: float) -> Array:
    return numbers(ca.Function("f", [model.state, model.parameters], [model.rhs])(positions, parameter))


def paper_rhs(y: Array, alpha: float, gamma: float, g: float) -> Array:
    """The paper's first equation, site by site, y_0 = y_{N+1} = 0."""
    x = [0.0, *y, 0.0]
    return np.array([
        (1 + gamma) * x[n - 1] - 2 * x[n] + (1 - gamma) * x[n + 1] - alpha * x[n] - g * x[n] ** 3
        for n in range(1, len(y) + 1)
    ])  # fmt: skip


def paper_matrix(sites: int, alpha: float, gamma: float) -> Array:
    """D of the paper's appendix: 2 + alpha on, -a_+ above and -a_- below the diagonal, a_+- = 1 -+ gamma."""
    beside = np.ones(sites - 1)
    return (2 + alpha) * np.eye(sites) - np.diag((1 - gamma) * beside, 1) - np.diag((1 + gamma) * beside, -1)


def exact_square(sites: int, alpha: float, gamma: float, mode: int) -> mp.mpf:
    """omega_j^2 of the paper at 50 digits, as printed."""
    with mp.workdps(DIGITS):
        return 2 + mp.mpf(alpha) - 2 * mp.sqrt(1 - mp.mpf(gamma) ** 2) * mp.cos(mp.pi * mode / (sites + 1))


def exact_sine(sites: int, mode: int, site: int) -> mp.mpf:
    """sin(n j pi/(N+1)) at 50 digits, the product n j an integer of any size."""
    with mp.workdps(DIGITS):
        return mp.sin(mp.pi * mp.mpf(site * mode) / (sites + 1))


def exact_slope(sites: int, alpha: float, gamma: float, g: float, mode: int) -> mp.mpf:
    """dOmega_j/dS of the paper: sums of r^n sin^4 and r^n sin^2, over the 60 sites at the edge: others are 1e-70."""
    with mp.workdps(DIGITS):
        r = (1 + abs(mp.mpf(gamma))) / (1 - abs(mp.mpf(gamma)))
        far = min(sites, 60) if abs(gamma) > 0.6 else sites
        sine = [exact_sine(sites, mode, m) for m in range(1, far + 1)]
        ratio = mp.fsum(r**-m * s**4 for m, s in enumerate(sine)) / mp.fsum(r**-m * s**2 for m, s in enumerate(sine))
        return 3 * mp.mpf(g) * ratio / (4 * (sites + 1) * mp.sqrt(exact_square(sites, alpha, gamma, mode)))


def off(found: float, exact: mp.mpf) -> float:
    """Relative error."""
    return float(abs(mp.mpf(float(found)) / exact - 1))


# Parameters ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "message"),
    [
        *(({"sites": n}, f"sites: given {n!r}; accepted: a whole number >= 1") for n in (0, -3, 2.5, True, -np.inf)),
        *(({"sites": n}, "sites: given") for n in (float("nan"), 3.0, None)),
        *(({k: v}, f"{k}: given {v!r}; accepted: a finite number") for k in ("alpha", "gamma", "g")
          for v in (float("nan"), float("inf"))),
        *(({"gamma": v}, f"gamma: given {v!r}; accepted: -1 <= gamma <= 1") for v in (1.0000001, -2.0)),
    ],
)  # fmt: skip
def test_parameters_out_of_range_are_refused_by_name(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Chain(**{"sites": 3, "alpha": 1.0, "gamma": 0.25, "g": 1.0} | given)


@pytest.mark.parametrize("mode", [0, 5, -1, 1.5])
def test_a_mode_that_is_not_there_is_refused(mode: Any) -> None:
    with pytest.raises(ValueError, match=f"mode: given {mode}; accepted: 1..4"):
        Chain(4, 1.0, 0.25, 1.0).linear_frequency(mode)


@pytest.mark.parametrize(("mode", "bound"), [(1, -1.2), (2, -2.8)])
def test_a_mode_that_does_not_oscillate_is_refused_with_the_bound_on_alpha(mode: int, bound: float) -> None:
    """Two sites and s = 0.8: omega_j^2 = 2 + alpha -+ 0.8."""
    with pytest.raises(ValueError, match=rf"mode {mode} does not oscillate: .*; accepted: alpha > {bound}$"):
        Chain(2, bound - 1e-9, 0.6, 1.0).linear_frequency(mode)
    found = Chain(2, bound + 1e-9, 0.6, 1.0).linear_frequency(mode)
    assert found == pytest.approx(np.sqrt(1e-9), rel=1e-6)
    with pytest.raises(ValueError, match="mode 1 does not oscillate"):
        Chain(2, -2.0, 0.6, 1.0).linear_frequencies()


def test_a_chain_is_immutable_and_compares_by_its_parameters() -> None:
    chain = Chain(3, 1.0, 0.25, -1.0)
    with pytest.raises(FrozenInstanceError):
        chain.gamma = 0.5  # type: ignore[misc]
    assert chain.rho.shape == (3,)  # cached values take no part in the comparison
    assert chain == Chain(np.int64(3), 1.0, 0.25, -1.0)
    assert chain != Chain(3, 1.0, 0.25, 1.0)
    assert hash(chain) == hash(Chain(3, 1.0, 0.25, -1.0))


# Equations of motion ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.25, -0.25, 0.0, 1.0, -1.0])
@pytest.mark.parametrize("sites", [1, 2, 3, 24])
def test_physical_equations_and_their_matrix_are_the_papers(sites: int, gamma: float) -> None:
    chain, y = Chain(sites, 0.7, gamma, 99.0), np.random.default_rng(sites).normal(size=sites)
    found = force(chain.physical_model(), y, -1.3)
    np.testing.assert_allclose(found, paper_rhs(y, 0.7, gamma, -1.3), rtol=0, atol=2e-14)
    np.testing.assert_array_equal(chain.dynamical_matrix(), paper_matrix(sites, 0.7, gamma))


def test_the_variational_matrices_are_the_papers_entry_by_entry() -> None:
    """Z_21 has a_+-, W_21 their root; the diagonal is -2 - alpha - 3 g y_n^2 at y_n = sqrt(S) rho_n q_n."""
    alpha, gamma, g, S = 1.0, 0.6, -2.0, 0.3
    q = np.array([0.5, -1.0, 0.25])
    y = np.sqrt(S) * np.array([1 / 4, 1 / 2, 1.0]) * q  # r = 4, favoured edge 3
    chain, diagonal = Chain(3, alpha, gamma, g), np.diag(-2 - alpha - 3 * g * y**2)
    for coordinates, at, parameter, above, below in (
        ("physical", y, g, 0.4, 1.6), ("gauge", q, g * S, np.sqrt(0.64), np.sqrt(0.64)),
    ):  # fmt: skip
        lower = diagonal + np.diag([above] * 2, 1) + np.diag([below] * 2, -1)
        expected = np.block([[np.zeros((3, 3)), np.eye(3)], [lower, np.zeros((3, 3))]])
        found = chain.variational_matrix(coordinates)(at, parameter)
        np.testing.assert_allclose(numbers(found), expected, rtol=4 * EPS, atol=0)
        assert found.nnz() == 3 + 7  # sparse: the identity and a tridiagonal block
    with pytest.raises(ValueError, match="coordinates: given 'polar'; accepted: physical, gauge"):
        chain.variational_matrix("polar")


def test_the_gauge_of_three_sites_by_hand() -> None:
    """gamma = 0.6: s = 0.8 and r = 4, so rho falls by 2 and w by 4 a site from the favoured edge."""
    right, left = Chain(3, 1.0, 0.6, 1.0), Chain(3, 1.0, -0.6, 1.0)
    assert right.coupling == pytest.approx(0.8, rel=2 * EPS)
    np.testing.assert_allclose(right.rho, [0.25, 0.5, 1.0], rtol=4 * EPS)
    np.testing.assert_allclose(right.weights, [1 / 16, 1 / 4, 1.0], rtol=8 * EPS)
    np.testing.assert_array_equal(left.rho, right.rho[::-1])
    q, v, kappa = np.array([0.3, -0.7, 0.9]), np.array([0.2, 0.4, -0.6]), 0.5
    L, w = np.array([[3.0, -0.8, 0.0], [-0.8, 3.0, -0.8], [0.0, -0.8, 3.0]]), np.array([1 / 16, 1 / 4, 1.0])
    model = right.gauge_model()
    np.testing.assert_allclose(force(model, q, kappa), -L @ q - kappa * w * q**3, atol=8 * EPS)
    evaluate = ca.Function(
        "h", [model.state, model.velocity, model.parameters], [model.hamiltonian, model.normalisation]
    )
    energy, normalisation = (float(value) for value in evaluate(q, v, kappa))
    assert energy == pytest.approx(v @ v / 2 + q @ L @ q / 2 + kappa * np.sum(w * q**4) / 4, rel=4 * EPS)
    assert normalisation == pytest.approx(np.sum(w * q**2) - 1, rel=8 * EPS)


@pytest.mark.parametrize(("gamma", "edge"), [(1.0, 3), (-1.0, 0)])
def test_one_way_coupling_is_a_jordan_block_whose_gauge_keeps_the_edge_alone(gamma: float, edge: int) -> None:
    chain, alone = Chain(4, 1.0, gamma, 1.0), np.eye(4)[edge]
    shifted = chain.dynamical_matrix() - 3 * np.eye(4)
    assert np.abs(np.linalg.matrix_power(shifted, 3)).max() == 8.0
    assert not np.linalg.matrix_power(shifted, 4).any()
    assert chain.coupling == 0.0
    np.testing.assert_array_equal(chain.rho, alone)
    np.testing.assert_array_equal(chain.log_rho, np.where(alone == 1, 0.0, -np.inf))
    assert chain.linear_frequencies().tolist() == [np.sqrt(3.0)] * 4
    assert chain.band() == (3.0, 3.0)
    q = np.array([0.4, -0.2, 0.7, -0.9])
    np.testing.assert_allclose(force(chain.gauge_model(), q, 0.5), -3 * q - 0.5 * alone * q**3, rtol=2 * EPS)
    values, vectors = chain.diagonalise()
    assert values.tolist() == [3.0] * 4
    assert np.isfinite(vectors).all()
    right, left = chain.right_eigenvector(2), chain.left_eigenvector(2)
    assert np.flatnonzero(right).tolist() == [edge]
    assert np.flatnonzero(left).tolist() == [3 - edge]


# The linear chain ---------------------------------------------------------------------------------------------------


def test_the_numbers_that_the_paper_states_for_its_chain() -> None:
    """Lowest frequency 1.04 (that is omega_1; the cutoff itself is 1.031), mean spacing about 0.05."""
    chain = Chain(24, 1.0, 0.25, 1.0)
    assert chain.linear_frequency(1) == pytest.approx(1.04, abs=0.005)
    assert np.sqrt(chain.band()) == pytest.approx([np.sqrt(3 - 2 * np.sqrt(0.9375)), np.sqrt(3 + 2 * np.sqrt(0.9375))])
    assert np.mean(np.diff(chain.linear_frequencies())) == pytest.approx(0.05, abs=0.005)


@pytest.mark.parametrize("alpha", [0.0, 1e-12, 1e-6, 1.0])
@pytest.mark.parametrize("gamma", [0.0, 1e-9, -1e-5, 0.25, -0.6, 0.999, 1 - 1e-12])
@pytest.mark.parametrize(("sites", "modes"), [(1, (1,)), (2, (1, 2)), (24, (1, 12, 24)), (10**6, (1, 2, 3))])
def test_squared_frequencies_keep_every_digit(sites: int, modes: tuple[int, ...], gamma: float, alpha: float) -> None:
    found = closed_forms.squared_frequency(sites, alpha, gamma, np.array(modes))
    assert max(off(f, exact_square(sites, alpha, gamma, j)) for f, j in zip(found, modes, strict=True)) < 4 * EPS
    lower, _ = Chain(sites, alpha, gamma, 1.0).band()
    limit = exact_square(1, alpha, gamma, 0)
    assert lower == limit == 0 or off(lower, limit) < 4 * EPS


@pytest.mark.parametrize("gamma", [1 - 1e-15, -(1 - 1e-9), 0.5, 1e-8])
def test_gauge_coupling_keeps_its_digits_near_one_way_coupling(gamma: float) -> None:
    with mp.workdps(DIGITS):
        assert off(closed_forms.gauge_coupling(gamma), mp.sqrt(1 - mp.mpf(gamma) ** 2)) < 2 * EPS


@pytest.mark.parametrize("gamma", [0.25, -0.25, 1e-10, 0.9999999, -(1 - 1e-12)])
def test_log_envelope_is_half_the_logarithm_of_r_times_the_distance_to_the_favoured_edge(gamma: float) -> None:
    found, favoured = closed_forms.log_envelope(40, gamma), 40 if gamma > 0 else 1
    with mp.workdps(DIGITS):
        log_r = mp.log((1 + mp.mpf(gamma)) / (1 - mp.mpf(gamma)))
        for n in range(1, 41):
            exact = log_r * (n - favoured) / 2
            assert abs(mp.mpf(float(found[n - 1])) - exact) <= 3 * EPS * abs(exact)


@pytest.mark.parametrize("mode", [1, 5, 10])
@pytest.mark.parametrize("gamma", [0.25, -0.7, 0.999, 0.0])
def test_eigenvectors_have_the_papers_profiles_at_fifty_digits(gamma: float, mode: int) -> None:
    """u_n = r^(n/2) sin, v_n = r^(-n/2) sin: the sign of the appendix belongs to v."""
    sites = 10
    right, left = closed_forms.right_eigenvector(sites, gamma, mode), closed_forms.left_eigenvector(sites, gamma, mode)
    with mp.workdps(DIGITS):
        root_r = mp.sqrt((1 + mp.mpf(gamma)) / (1 - mp.mpf(gamma)))
        right_edge, left_edge = (sites, 1) if gamma > 0 else (1, sites)
        for n in range(1, sites + 1):
            sine = exact_sine(sites, mode, n)
            assert off(right[n - 1], root_r ** (n - right_edge) * sine) < 2e-14
            assert off(left[n - 1], root_r ** (left_edge - n) * sine) < 2e-14
    matrix, square = paper_matrix(sites, 1.0, gamma), float(exact_square(sites, 1.0, gamma, mode))
    for operator, vector in ((matrix, right), (matrix.T, left)):
        row_size = np.abs(operator) @ np.abs(vector)
        assert np.all(np.abs(operator @ vector - square * vector) < 1e-14 * row_size)


@pytest.mark.parametrize("mode", [1, 17, 499_999, 999_983, 10**6])
def test_standing_waves_of_a_million_sites_agree_with_fifty_digits(mode: int) -> None:
    """n j reaches 1e12: left unreduced, the argument alone would cost ten digits."""
    wave = closed_forms.standing_wave(10**6, mode)
    for n in (1, 2, 3, 1001, 499_999, 500_000, 777_777, 999_998, 10**6):
        exact = exact_sine(10**6, mode, n)
        assert abs(mp.mpf(float(wave[n - 1])) - exact) < 6 * EPS
        assert mode > 17 or n in range(4, 999_998) or off(wave[n - 1], exact) < 4 * EPS  # where skin modes live


@pytest.mark.parametrize(("sites", "gamma"), [(1000, 0.9), *(slow(3000, gamma) for gamma in (0.9, -0.9))])
def test_a_long_strongly_nonreciprocal_chain_builds_without_overflow_or_nan(sites: int, gamma: float) -> None:
    """rho_1 would be 10^-638, or 10^-1918; warnings are errors in this suite."""
    chain = Chain(sites, 1.0, gamma, 1.0)
    assert (chain.rho.min(), chain.rho.max()) == (0.0, 1.0)
    assert chain.log_rho.min() == pytest.approx(-(sites - 1) * np.arctanh(0.9), rel=1e-14)
    for mode in (1, sites // 2, sites):
        right, left = chain.right_eigenvector(mode), chain.left_eigenvector(mode)
        assert 0 < np.abs(right).max() <= 1
        np.testing.assert_allclose(np.abs(right[::-1]), np.abs(left), rtol=1e-9, atol=1e-300)
    assert np.isfinite([chain.weights, chain.linear_frequencies()]).all()
    q = np.random.default_rng(5).normal(size=sites)
    s, w = np.sqrt(1 - 0.81), 19.0 ** -np.arange(sites, dtype=float)[:: -1 if gamma > 0 else 1]
    neighbours = np.append(q[1:], 0) + np.insert(q[:-1], 0, 0)
    model = chain.gauge_model()
    np.testing.assert_allclose(force(model, q, 0.8), -3 * q + s * neighbours - 0.8 * w * q**3, atol=1e-13)
    assert model.rhs_and_jacobian().nnz_out("df_dstate") == 3 * sites - 2


# Weakly nonlinear modes by multiple scales --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sites", "alpha", "gamma", "mode"),
    [
        *((24, 1.0, 0.25, mode) for mode in (1, 6, 10, 14, 18, 24)), (1, 1.0, 0.25, 1), (2, 0.5, -0.4, 2),
        (5, 0.0, 0.0, 3), (7, 1.0, 1e-7, 4), (60, 2.0, 0.9, 1), (60, 2.0, -0.99, 60), (9, 1.0, 0.6, 4),
        (9, 1.0, -0.6, 4), *((3000, 1.0, gamma, mode) for gamma in (0.9, -0.9) for mode in (1, 1500, 3000)),
    ],
)  # fmt: skip
def test_the_slope_of_the_frequency_is_that_of_the_papers_sums(
    sites: int, alpha: float, gamma: float, mode: int
) -> None:
    exact = exact_slope(sites, alpha, gamma, -0.7, mode)
    assert off(closed_forms.frequency_slope(sites, alpha, gamma, -0.7, mode), exact) < (1e-12 if sites > 60 else 4e-14)
    relative = abs(exact) / mp.sqrt(exact_square(sites, alpha, gamma, mode))
    assert off(sensitivity(sites, alpha, gamma, -0.7, mode), relative) < 1e-12


@pytest.mark.parametrize("mode", [1, 2, 3])
def test_one_way_coupling_gives_the_limit_of_the_papers_sums(mode: int) -> None:
    """As gamma -> 1 the edge site alone is left in both sums: the ratio is sin^2(N j pi/(N+1))."""
    found = closed_forms.frequency_slope(3, 1.0, 1.0, 1.0, mode)
    assert found == pytest.approx(3 / (4 * 4 * np.sqrt(3.0)) * np.sin(3 * mode * np.pi / 4) ** 2, rel=1e-14)


@pytest.mark.parametrize(("g", "mode", "period"), [(1.0, 24, 2.83), (-1.0, 1, 6.06)])
def test_periods_at_small_amplitude_are_those_that_the_paper_states(g: float, mode: int, period: float) -> None:
    slope = closed_forms.frequency_slope(24, 1.0, 0.25, g, mode)
    found = 2 * np.pi / (float(mp.sqrt(exact_square(24, 1.0, 0.25, mode))) + 0.2 * slope)
    assert float(found) == pytest.approx(period, abs=0.006)
