"""The nonreciprocal chain against the equations and matrices of arXiv:2512.17483, typed out independently."""

from __future__ import annotations

from dataclasses import FrozenInstanceError, replace
from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

from casadi_skin.lattice.chain import Chain

EPS = float(np.finfo(float).eps)
Array = NDArray[np.float64]


def numbers(value: Any) -> Array:
    """A CasADi result as a dense array, a column as a vector."""
    array = np.array(ca.DM(value))
    return array.ravel() if array.shape[1] == 1 else array


def physical_rhs(chain: Chain, y: Array, g: float) -> Array:
    model = chain.physical_model()
    return numbers(ca.Function("f", [model.state, model.parameters], [model.rhs])(y, g))


def gauge_rhs(chain: Chain, q: Array, kappa: float) -> Array:
    model = chain.gauge_model()
    return numbers(ca.Function("f", [model.state, model.parameters], [model.rhs])(q, kappa))


def paper_rhs(y: Array, alpha: float, gamma: float, g: float) -> Array:
    """The paper's first equation, site by site, y_0 = y_{N+1} = 0."""
    a_plus, a_minus = 1 - gamma, 1 + gamma
    x = [0.0, *y, 0.0]
    sites = range(1, len(y) + 1)
    return np.array([a_minus * x[n - 1] - 2 * x[n] + a_plus * x[n + 1] - alpha * x[n] - g * x[n] ** 3 for n in sites])


# Parameters -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("sites", [0, -3, 2.5, True, False])
def test_a_number_of_sites_that_is_not_a_positive_whole_number_is_refused(sites: Any) -> None:
    with pytest.raises(ValueError, match=f"sites: given {sites!r}; accepted: a whole number >= 1"):
        Chain(sites, 1.0, 0.25, 1.0)


@pytest.mark.parametrize("sites", [float("nan"), -float("inf"), 3.0, None])
def test_a_number_of_sites_that_no_chain_can_be_built_with_is_refused_by_name(sites: Any) -> None:
    with pytest.raises(ValueError, match="sites: given"):
        Chain(sites, 1.0, 0.25, 1.0)


def test_a_numpy_integer_is_a_number_of_sites() -> None:
    assert Chain(np.int64(3), 1.0, 0.25, 1.0).gauge_model().full_size == 6


@pytest.mark.parametrize("name", ["alpha", "gamma", "g"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_a_parameter_that_is_not_finite_is_refused_by_name(name: str, value: float) -> None:
    parameters = {"sites": 3, "alpha": 1.0, "gamma": 0.25, "g": 1.0, name: value}
    with pytest.raises(ValueError, match=f"{name}: given {value!r}; accepted: a finite number"):
        Chain(**parameters)


@pytest.mark.parametrize("gamma", [1.0000001, -1.0000001, 2.0])
def test_a_nonreciprocity_beyond_one_is_refused(gamma: float) -> None:
    with pytest.raises(ValueError, match=f"gamma: given {gamma!r}; accepted: -1 <= gamma <= 1"):
        Chain(3, 1.0, gamma, 1.0)


@pytest.mark.parametrize("mode", [0, 5, -1])
def test_a_mode_that_is_not_there_is_refused(mode: int) -> None:
    with pytest.raises(ValueError, match=f"mode: given {mode}; accepted: 1..4"):
        Chain(4, 1.0, 0.25, 1.0).linear_frequency(mode)


def test_a_mode_between_two_modes_is_refused() -> None:
    with pytest.raises(ValueError, match=r"mode: given 1\.5"):
        Chain(4, 1.0, 0.25, 1.0).linear_frequency(1.5)  # type: ignore[arg-type]


@pytest.mark.parametrize(("mode", "bound"), [(1, -1.2), (2, -2.8)])
def test_a_mode_that_does_not_oscillate_is_refused_with_the_bound_on_alpha(mode: int, bound: float) -> None:
    """Two sites and s = 0.8: omega_j^2 = 2 + alpha -+ 0.8."""
    with pytest.raises(ValueError, match=rf"mode {mode} does not oscillate: .*; accepted: alpha > {bound}$"):
        Chain(2, -3.5, 0.6, 1.0).linear_frequency(mode)
    with pytest.raises(ValueError, match=f"alpha > {bound}$"):
        Chain(2, bound - 1e-9, 0.6, 1.0).linear_frequency(mode)
    found = Chain(2, bound + 1e-9, 0.6, 1.0).linear_frequency(mode)
    assert found == pytest.approx(np.sqrt(1e-9), rel=1e-6)


def test_frequencies_are_refused_together_when_the_lowest_does_not_oscillate() -> None:
    with pytest.raises(ValueError, match="mode 1 does not oscillate"):
        Chain(2, -2.0, 0.6, 1.0).linear_frequencies()


def test_a_chain_is_immutable_and_compares_by_its_parameters() -> None:
    chain = Chain(3, 1.0, 0.25, -1.0)
    with pytest.raises(FrozenInstanceError):
        chain.gamma = 0.5  # type: ignore[misc]
    assert chain.rho.shape == (3,)  # cached values take no part in the comparison
    assert chain == Chain(3, 1.0, 0.25, -1.0)
    assert chain != Chain(3, 1.0, 0.25, 1.0)
    assert hash(chain) == hash(Chain(3, 1.0, 0.25, -1.0))


# Equations of motion ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.25, -0.25, 0.0, 1.0, -1.0])
@pytest.mark.parametrize("sites", [1, 2, 3, 24])
def test_physical_equations_are_the_papers(sites: int, gamma: float) -> None:
    y = np.random.default_rng(sites).normal(size=sites)
    found = physical_rhs(Chain(sites, 0.7, gamma, 99.0), y, -1.3)
    np.testing.assert_allclose(found, paper_rhs(y, 0.7, gamma, -1.3), rtol=0, atol=2e-14)


def test_dynamical_matrix_is_the_papers_entry_by_entry() -> None:
    alpha, a_plus, a_minus = 1.0, 0.75, 1.25
    expected = [
        [2 + alpha, -a_plus, 0, 0],
        [-a_minus, 2 + alpha, -a_plus, 0],
        [0, -a_minus, 2 + alpha, -a_plus],
        [0, 0, -a_minus, 2 + alpha],
    ]
    np.testing.assert_array_equal(Chain(4, alpha, 0.25, -1.0).dynamical_matrix(), expected)


def test_dynamical_matrices_of_one_and_two_sites() -> None:
    np.testing.assert_array_equal(Chain(1, 0.5, 0.25, 1.0).dynamical_matrix(), [[2.5]])
    np.testing.assert_array_equal(Chain(2, 0.5, -0.25, 1.0).dynamical_matrix(), [[2.5, -1.25], [-0.75, 2.5]])


def test_the_opposite_nonreciprocity_transposes_the_dynamical_matrix_and_mirrors_it() -> None:
    forward, backward = (Chain(7, 1.0, gamma, 1.0).dynamical_matrix() for gamma in (0.4, -0.4))
    np.testing.assert_array_equal(backward, forward.T)
    np.testing.assert_array_equal(backward, forward[::-1, ::-1])


def test_the_physical_variational_matrix_is_the_papers_entry_by_entry() -> None:
    alpha, a_plus, a_minus, g = 1.0, 0.75, 1.25, -2.0
    y1, y2, y3 = 0.5, -1.0, 0.25
    z21 = [
        [-2 - alpha - 3 * g * y1**2, a_plus, 0],
        [a_minus, -2 - alpha - 3 * g * y2**2, a_plus],
        [0, a_minus, -2 - alpha - 3 * g * y3**2],
    ]
    expected = np.block([[np.zeros((3, 3)), np.eye(3)], [np.array(z21), np.zeros((3, 3))]])
    found = Chain(3, alpha, 0.25, g).variational_matrix()([y1, y2, y3], g)
    np.testing.assert_array_equal(numbers(found), expected)
    assert found.nnz() == 3 + 7  # sparse: the identity and a tridiagonal block


def test_the_gauge_variational_matrix_is_the_papers_with_equal_off_diagonals() -> None:
    """[W_21]_{n,n+-1} = sqrt(a_+ a_-), diagonal -2 - alpha - 3 g y_n^2 at y_n = sqrt(S) rho_n q_n."""
    alpha, g, S, gamma = 1.0, -2.0, 0.3, 0.6
    q = np.array([0.5, -1.0, 0.25])
    y = np.sqrt(S) * np.array([1 / 4, 1 / 2, 1.0]) * q  # r = 4, favoured edge 3
    s = np.sqrt(0.4 * 1.6)
    w21 = [
        [-2 - alpha - 3 * g * y[0] ** 2, s, 0],
        [s, -2 - alpha - 3 * g * y[1] ** 2, s],
        [0, s, -2 - alpha - 3 * g * y[2] ** 2],
    ]
    expected = np.block([[np.zeros((3, 3)), np.eye(3)], [np.array(w21), np.zeros((3, 3))]])
    found = Chain(3, alpha, gamma, g).variational_matrix("gauge")(q, g * S)
    np.testing.assert_allclose(numbers(found), expected, rtol=4 * EPS, atol=0)


@pytest.mark.parametrize(("coordinates", "hamiltonian"), [("gauge", True), ("physical", False)])
def test_the_variational_flow_is_symplectic_in_the_gauge_only(coordinates: str, hamiltonian: bool) -> None:
    """J^-1 W is symmetric, J^-1 Z is not: the paper's V and U."""
    zero, one = np.zeros((5, 5)), np.eye(5)
    J = np.block([[zero, -one], [one, zero]])
    q = np.linspace(-1, 1, 5)
    matrix = numbers(Chain(5, 1.0, 0.25, 1.0).variational_matrix(coordinates)(q, 0.7))
    symmetric_part = np.linalg.solve(J, matrix)
    assert np.array_equal(symmetric_part, symmetric_part.T) is hamiltonian


def test_unknown_coordinates_are_refused() -> None:
    with pytest.raises(ValueError, match="coordinates: given 'polar'; accepted: physical, gauge"):
        Chain(3, 1.0, 0.25, 1.0).variational_matrix("polar")


# The gauge --------------------------------------------------------------------------------------------------


def test_the_gauge_of_three_sites_by_hand() -> None:
    """gamma = 0.6: s = 0.8 and r = 4, so rho falls by 2 and w by 4 a site from the favoured edge."""
    right, left = Chain(3, 1.0, 0.6, 1.0), Chain(3, 1.0, -0.6, 1.0)
    assert right.coupling == pytest.approx(0.8, rel=2 * EPS)
    np.testing.assert_allclose(right.rho, [0.25, 0.5, 1.0], rtol=4 * EPS)
    np.testing.assert_allclose(right.weights, [1 / 16, 1 / 4, 1.0], rtol=8 * EPS)
    np.testing.assert_allclose(np.exp(right.log_rho), right.rho, rtol=EPS)
    np.testing.assert_array_equal(left.rho, right.rho[::-1])
    q, kappa = np.array([0.3, -0.7, 0.9]), 0.5
    w = np.array([1 / 16, 1 / 4, 1.0])
    expected = -3 * q + 0.8 * np.array([q[1], q[0] + q[2], q[1]]) - kappa * w * q**3
    np.testing.assert_allclose(gauge_rhs(right, q, kappa), expected, atol=8 * EPS)


def test_the_hamiltonian_and_the_normalisation_of_the_gauge_by_hand() -> None:
    """H = |q'|^2/2 + q.L.q/2 + kappa sum(w q^4)/4 and sum(w q^2) - 1, gamma = 0.6."""
    model = Chain(3, 1.0, 0.6, 1.0).gauge_model()
    evaluate = ca.Function(
        "h", [model.state, model.velocity, model.parameters], [model.hamiltonian, model.normalisation]
    )
    q, v, kappa = np.array([0.3, -0.7, 0.9]), np.array([0.2, 0.4, -0.6]), 0.5
    L = np.array([[3.0, -0.8, 0.0], [-0.8, 3.0, -0.8], [0.0, -0.8, 3.0]])
    w = np.array([1 / 16, 1 / 4, 1.0])
    energy, normalisation = (float(value) for value in evaluate(q, v, kappa))
    assert energy == pytest.approx(v @ v / 2 + q @ L @ q / 2 + kappa * np.sum(w * q**4) / 4, rel=4 * EPS)
    assert normalisation == pytest.approx(np.sum(w * q**2) - 1, rel=8 * EPS)


@pytest.mark.parametrize("gamma", [0.0, 0.25, -0.7, 1.0, -1.0])
@pytest.mark.parametrize("sites", [1, 2, 9])
def test_both_models_have_the_symmetries_that_they_declare(sites: int, gamma: float) -> None:
    chain = Chain(sites, 1.0, gamma, -1.0)
    for model in (chain.physical_model(), chain.gauge_model()):
        assert model.reversal == (1,) * sites + (-1,) * sites
        assert model.half_period == (-1,) * (2 * sites)
        assert (model.order, model.size) == (2, sites)
        model.check_symmetries()
    assert chain.gauge_model().hamiltonian is not None
    assert chain.physical_model().hamiltonian is None


def test_the_reciprocal_energy_is_not_conserved_by_a_nonreciprocal_chain() -> None:
    chain = Chain(4, 1.0, 0.25, -1.0)
    model = chain.physical_model()
    y, v, g = model.state, model.velocity, model.parameters
    stretch = ca.vertcat(y, 0) - ca.vertcat(0, y)
    energy = ca.dot(v, v) / 2 + ca.dot(stretch, stretch) / 2 + ca.dot(y, y) / 2 + g * ca.sum1(y**4) / 4
    with pytest.raises(ValueError, match="hamiltonian is not conserved"):
        replace(model, hamiltonian=energy).check_symmetries()
    reciprocal = Chain(4, 1.0, 0.0, -1.0).physical_model()
    swapped = ca.substitute(energy, ca.vertcat(y, v, g), ca.vertcat(reciprocal.full_state, reciprocal.parameters))
    replace(reciprocal, hamiltonian=swapped).check_symmetries()


def test_one_site_is_the_same_duffing_oscillator_in_both_coordinates() -> None:
    chain = Chain(1, 0.5, 0.8, 1.0)
    expected = -2.5 * 0.3 - 2.0 * 0.3**3
    assert physical_rhs(chain, np.array([0.3]), 2.0)[0] == pytest.approx(expected, rel=2 * EPS)
    assert gauge_rhs(chain, np.array([0.3]), 2.0)[0] == pytest.approx(expected, rel=2 * EPS)
    assert chain.rho.tolist() == [1.0]


# The linear chain -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gamma", [0.25, -0.25, 0.0])
def test_frequencies_and_cutoffs_are_the_papers(gamma: float) -> None:
    chain = Chain(24, 1.0, gamma, 1.0)
    j = np.arange(1, 25)
    expected = np.sqrt(3 - 2 * np.sqrt(1 - gamma**2) * np.cos(j * np.pi / 25))
    np.testing.assert_allclose(chain.linear_frequencies(), expected, rtol=4 * EPS)
    assert chain.linear_frequency(7) == pytest.approx(expected[6], rel=4 * EPS)
    low, high = chain.band()
    assert low == pytest.approx(3 - 2 * np.sqrt(1 - gamma**2), rel=4 * EPS)
    assert high == pytest.approx(3 + 2 * np.sqrt(1 - gamma**2), rel=4 * EPS)
    assert low < expected[0] ** 2 < expected[-1] ** 2 < high


def test_the_numbers_that_the_paper_states_for_its_chain() -> None:
    """Lowest frequency 1.04 (that is omega_1; the cutoff itself is 1.031), mean spacing about 0.05."""
    chain = Chain(24, 1.0, 0.25, 1.0)
    assert chain.linear_frequency(1) == pytest.approx(1.04, abs=0.005)
    assert np.sqrt(chain.band()[0]) == pytest.approx(1.0313, abs=5e-5)
    assert np.mean(np.diff(chain.linear_frequencies())) == pytest.approx(0.05, abs=0.005)


def test_the_lower_cutoff_keeps_its_digits_in_a_soft_chain() -> None:
    with mp.workdps(50):
        exact = 2 - 2 * mp.sqrt(1 - mp.mpf(1e-4) ** 2)
    assert abs(mp.mpf(Chain(24, 0.0, 1e-4, 1.0).band()[0]) / exact - 1) < 4 * EPS


@pytest.mark.parametrize("gamma", [0.25, -0.7, 0.0])
@pytest.mark.parametrize("sites", [1, 2, 24])
def test_diagonalisation_in_the_gauge_gives_frequencies_and_eigenvectors_of_the_physical_matrix(
    sites: int, gamma: float
) -> None:
    chain = Chain(sites, 0.3, gamma, 1.0)
    values, vectors = chain.diagonalise()
    np.testing.assert_allclose(values, chain.linear_frequencies() ** 2, rtol=1e-14)
    matrix = chain.dynamical_matrix()
    # Row by row relative to the envelope, so that the far edge counts as much as the near one.
    residual = (matrix @ vectors - vectors * values) / chain.rho[:, None]
    assert np.abs(residual).max() < 5e-14
    for column, mode in zip(vectors.T, range(1, sites + 1), strict=True):
        closed_form = chain.right_eigenvector(mode)
        scale = (column @ closed_form) / (closed_form @ closed_form)
        np.testing.assert_allclose(column / chain.rho, scale * closed_form / chain.rho, atol=1e-12)


@pytest.mark.parametrize("mode", [1, 5])
@pytest.mark.parametrize("gamma", [0.25, -0.6])
def test_left_and_right_eigenvectors_belong_to_the_physical_matrix(gamma: float, mode: int) -> None:
    chain = Chain(5, 1.0, gamma, 1.0)
    matrix, omega = chain.dynamical_matrix(), chain.linear_frequency(mode)
    right, left = chain.right_eigenvector(mode), chain.left_eigenvector(mode)
    np.testing.assert_allclose(matrix @ right, omega**2 * right, atol=2e-15)
    np.testing.assert_allclose(left @ matrix, omega**2 * left, atol=2e-15)


# One-way coupling -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("gamma", "edge"), [(1.0, 3), (-1.0, 0)])
def test_one_way_coupling_is_a_jordan_block_whose_gauge_keeps_the_edge_alone(gamma: float, edge: int) -> None:
    chain = Chain(4, 1.0, gamma, 1.0)
    shifted = chain.dynamical_matrix() - 3 * np.eye(4)
    assert np.abs(np.linalg.matrix_power(shifted, 3)).max() == 8.0
    assert not np.linalg.matrix_power(shifted, 4).any()

    alone = np.eye(4)[edge]
    assert chain.coupling == 0.0
    np.testing.assert_array_equal(chain.rho, alone)
    np.testing.assert_array_equal(chain.weights, alone)
    np.testing.assert_array_equal(chain.log_rho, np.where(alone == 1, 0.0, -np.inf))
    assert chain.linear_frequencies().tolist() == [np.sqrt(3.0)] * 4
    assert chain.band() == (3.0, 3.0)

    q = np.array([0.4, -0.2, 0.7, -0.9])
    np.testing.assert_allclose(gauge_rhs(chain, q, 0.5), -3 * q - 0.5 * alone * q**3, rtol=2 * EPS)
    W = numbers(chain.variational_matrix("gauge")(q, 0.5))
    np.testing.assert_allclose(W[4:, :4], np.diag(-3 - 1.5 * alone * q**2), rtol=2 * EPS)
    values, vectors = chain.diagonalise()
    assert values.tolist() == [3.0] * 4
    assert np.isfinite(vectors).all()


# Large chains -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sites", "gamma"),
    [(1000, 0.9), *(pytest.param(3000, gamma, marks=pytest.mark.slow) for gamma in (0.9, -0.9))],
)
def test_a_long_strongly_nonreciprocal_chain_builds_without_overflow_or_nan(sites: int, gamma: float) -> None:
    """rho_1 would be 10^-638, or 10^-1918; warnings are errors in this suite."""
    chain = Chain(sites, 1.0, gamma, 1.0)
    assert chain.rho.max() == 1.0
    assert chain.rho.min() == 0.0
    assert chain.log_rho.min() == pytest.approx(-(sites - 1) * np.arctanh(0.9), rel=1e-14)
    for array in (
        chain.rho,
        chain.weights,
        chain.log_rho,
        chain.right_eigenvector(1),
        chain.linear_frequencies(),
    ):
        assert np.isfinite(array).all()

    q = np.random.default_rng(5).normal(size=sites)
    s, w = np.sqrt(1 - 0.81), 19.0 ** -np.arange(sites, dtype=float)[:: -1 if gamma > 0 else 1]
    neighbours = np.append(q[1:], 0) + np.insert(q[:-1], 0, 0)
    np.testing.assert_allclose(gauge_rhs(chain, q, 0.8), -3 * q + s * neighbours - 0.8 * w * q**3, atol=1e-13)
    jacobian = chain.gauge_model().rhs_and_jacobian()
    assert jacobian.nnz_out("df_dstate") == 3 * sites - 2
    assert np.isfinite(np.array(jacobian(q, 0.8)[1].nonzeros())).all()
