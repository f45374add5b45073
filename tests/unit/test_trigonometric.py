"""Collocation in odd cosines: derivatives, symmetry, spectral convergence, and the models it refuses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from orbit_problems import check_jacobian, linear_mode, solved
from scipy.integrate import solve_ivp

from casadi_skin.follow.family import Family
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.closed_forms import duffing_displacement, duffing_frequency
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import lifted
from casadi_skin.zero.cosines import TrigonometricProblem, cosine_matrix, second_derivative_matrix
from casadi_skin.zero.request import family_request

Array = NDArray[np.float64]


def oscillators(**changes: Any) -> OdeModel:
    """Two coupled cubic oscillators written by hand: q'' = -K q - p q^3, q(0).q(0) = 1."""
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p")
    force = -ca.DM([[2.0, -0.5], [-0.5, 3.0]]) @ q - p * q**3
    declared: dict[str, Any] = {"reversal": (1, 1, -1, -1), "half_period": (-1,) * 4, "normalisation": ca.dot(q, q) - 1}
    return OdeModel("oscillators", q, force, p, 2, v, **(declared | changes))


@pytest.mark.parametrize("harmonics", [1, 2, 5, 16, 128])
def test_node_values_and_coefficients_are_each_others_transform(harmonics: int) -> None:
    V = cosine_matrix(harmonics)
    i = np.arange(harmonics)
    expected = np.cos(np.outer(2 * i + 1, (i + 0.5) * np.pi / (2 * harmonics)))
    np.testing.assert_array_equal(V, V.T)
    np.testing.assert_allclose(V, expected, atol=1e-15 * harmonics**2)
    np.testing.assert_allclose(V @ V, harmonics / 2 * np.eye(harmonics), atol=1e-14 * harmonics)


@pytest.mark.parametrize("harmonics", [1, 3, 8])
def test_second_derivative_is_exact_on_odd_cosines(harmonics: int) -> None:
    theta = (np.arange(harmonics) + 0.5) * np.pi / (2 * harmonics)
    D2 = second_derivative_matrix(harmonics)
    for k in range(harmonics):
        cosine = np.cos((2 * k + 1) * theta)
        np.testing.assert_allclose(D2 @ cosine, -((2 * k + 1) ** 2) * cosine, atol=2e-14 * harmonics**3)


@pytest.mark.parametrize("sites", [1, 2, 5])
@pytest.mark.parametrize("harmonics", [1, 4])
def test_jacobian_agrees_with_finite_differences_in_every_column(sites: int, harmonics: int) -> None:
    problem = TrigonometricProblem(Chain(sites, 0.8, 0.3, 1.0).gauge_model(), harmonics)
    z = np.random.default_rng(sites).normal(size=problem.size)
    z[problem.Omega_index] = 1.3
    check_jacobian(problem, z)


def test_jacobian_agrees_with_finite_differences_for_a_model_written_by_hand() -> None:
    problem = TrigonometricProblem(oscillators(), 3)
    z = np.random.default_rng(0).normal(size=problem.size)
    z[problem.Omega_index] = 0.9
    check_jacobian(problem, z)


def test_unknowns_are_positions_on_a_quarter_of_the_period_and_two_numbers() -> None:
    problem = TrigonometricProblem(Chain(5, 1.0, 0.2, 1.0).gauge_model(), 7)
    assert problem.symmetry is SymmetryClass.QUARTER
    assert (problem.states, problem.size) == (35, 37)
    assert (problem.Omega_index, problem.parameter_index) == (35, 36)
    z = np.arange(37.0)
    assert problem.parameter_row() @ z == 36.0


@pytest.mark.parametrize("reach", [1, 2, 3])
def test_half_bandwidth_holds_every_coupling(reach: int) -> None:
    """Couplings as far as `reach` sites; the band is what the linear solver is told."""
    n = 8
    q, v, p = ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("p")
    i = np.arange(n)
    K = np.where(np.abs(i[:, None] - i) <= reach, -0.2, 0.0) + 3 * np.eye(n)
    model = OdeModel(
        "far", q, -ca.sparsify(ca.DM(K)) @ q - p * q**3, p, 2, v,
        reversal=(1,) * n + (-1,) * n, half_period=(-1,) * (2 * n), normalisation=ca.dot(q, q) - 1,
    )  # fmt: skip
    problem = TrigonometricProblem(model, 4)
    rows, columns = problem.pattern
    inside = (rows < problem.states) & (columns < problem.states)
    assert problem.half_bandwidth is not None
    assert np.abs(rows - columns)[inside].max() <= problem.half_bandwidth


@pytest.mark.parametrize(("sites", "mode"), [(1, 1), (2, 2), (5, 1), (5, 4), (24, 24)])
def test_the_linear_mode_solves_the_equations_without_nonlinearity(sites: int, mode: int) -> None:
    chain = Chain(sites, 1.0, 0.25, -1.0)
    problem = TrigonometricProblem(chain.gauge_model(), 5)
    z = problem.pack(linear_mode(chain, mode), chain.linear_frequency(mode), 0.0)
    residual, _ = problem.evaluate(z)
    assert np.abs(residual).max() <= 1e-13 * np.abs(z).max()
    assert problem.relative_residual(z) <= 1e-14


@pytest.mark.parametrize(("g", "S"), [(1.0, 2.0), (1.0, 30.0), (-1.0, 1.5)])
def test_frequency_and_displacement_converge_spectrally_to_the_duffing_oscillator(g: float, S: float) -> None:
    chain = Chain(1, 1.0, 0.0, g)
    exact = duffing_frequency(3.0, g, np.sqrt(S))
    t = np.linspace(0.0, 2 * np.pi / exact, 33)
    errors, profiles = [], []
    for harmonics in (2, 4, 6, 8, 20):
        problem = TrigonometricProblem(chain.gauge_model(), harmonics)
        z = solved(problem, chain, 1, g * S)
        errors.append(abs(z[problem.Omega_index] - exact) / exact)
        y = np.sqrt(S) * problem.sample(z, exact * t)[:, 0]
        profiles.append(np.abs(y - duffing_displacement(3.0, g, np.sqrt(S), t)).max() / np.sqrt(S))
    for e in (errors, profiles):
        ratios = [b / a for a, b in pairwise(e[:4])]
        assert max(ratios) < 0.05  # two harmonics more, each time by a factor
        # Geometric, with no order: the factor does not approach 1 as (1 - 2/H)^order would.
        assert max(ratios) / min(ratios) < 8
        assert e[-1] < 1e-14


def test_more_harmonics_continue_the_same_function_and_fewer_truncate_it() -> None:
    model = Chain(3, 1.0, 0.3, 1.0).gauge_model()
    coarse, fine = TrigonometricProblem(model, 5), TrigonometricProblem(model, 12)
    z = np.random.default_rng(0).normal(size=coarse.size)  # every harmonic of the same size
    longer = coarse.prolong(z, fine)
    theta = np.random.default_rng(1).uniform(-20, 20, 40)
    np.testing.assert_allclose(fine.sample(longer, theta), coarse.sample(z, theta), atol=1e-12)
    np.testing.assert_array_equal(longer[-2:], z[-2:])
    np.testing.assert_allclose(fine.coefficients(longer)[:, 5:], 0.0, atol=1e-14)
    np.testing.assert_allclose(fine.prolong(longer, coarse), z, atol=1e-14)
    w = np.random.default_rng(2).normal(size=fine.size)
    np.testing.assert_allclose(coarse.coefficients(fine.prolong(w, coarse)), fine.coefficients(w)[:, :5], atol=1e-14)


def test_sampling_at_the_nodes_returns_the_unknowns() -> None:
    problem = TrigonometricProblem(Chain(4, 1.0, 0.3, 1.0).gauge_model(), 6)
    z = np.random.default_rng(2).normal(size=problem.size)
    nodes = (np.arange(6) + 0.5) * np.pi / 12
    np.testing.assert_allclose(problem.sample(z, nodes).T.ravel(), z[: problem.states], atol=1e-13)


def test_samples_are_even_odd_over_half_a_period_and_periodic() -> None:
    problem = TrigonometricProblem(Chain(4, 1.0, 0.3, 1.0).gauge_model(), 6)
    z = np.random.default_rng(3).normal(size=problem.size)
    theta = np.random.default_rng(4).uniform(-30, 30, 50)
    q = problem.sample(z, theta)
    np.testing.assert_allclose(problem.sample(z, -theta), q, atol=1e-12)
    np.testing.assert_allclose(problem.sample(z, theta + np.pi), -q, atol=1e-12)
    np.testing.assert_allclose(problem.sample(z, theta + 6 * np.pi), q, atol=1e-12)


@pytest.mark.parametrize(("sites", "mode", "kappa"), [(2, 1, -0.8), (3, 2, 2.0), (5, 5, 1.0)])
def test_samples_follow_the_integrated_orbit_over_several_periods(sites: int, mode: int, kappa: float) -> None:
    """DOP853 on gauge equations typed out here, from the sampled start, at random times over three periods."""
    chain = Chain(sites, 1.0, 0.3, np.sign(kappa))
    problem = TrigonometricProblem(chain.gauge_model(), 16)
    z = solved(problem, chain, mode, kappa)
    s, w = np.sqrt(1 - 0.3**2), ((1 + 0.3) / (1 - 0.3)) ** (np.arange(1, sites + 1) - sites)

    def field(_: float, x: Array) -> Array:
        q = np.pad(x[:sites], 1)
        return np.concatenate([x[sites:], s * (q[:-2] + q[2:]) - 3.0 * x[:sites] - kappa * w * x[:sites] ** 3])

    t = np.sort(np.random.default_rng(5).uniform(0.0, 6 * np.pi / z[problem.Omega_index], 30))
    start = np.concatenate([problem.sample(z, np.zeros(1))[0], np.zeros(sites)])
    path = solve_ivp(field, (0.0, t[-1]), start, "DOP853", t, rtol=1e-12, atol=1e-13)
    q = problem.sample(z, z[problem.Omega_index] * t)
    np.testing.assert_allclose(q, path.y[:sites].T, rtol=0, atol=2e-9 * np.abs(start).max())
    assert chain.weights @ start[:sites] ** 2 == pytest.approx(1.0, abs=1e-13)


@pytest.mark.parametrize(
    "changes",
    [
        {"reversal": None},
        {"half_period": None},
        {"reversal": (-1, -1, 1, 1)},  # positions odd in time
        {"reversal": (1, -1, -1, 1)},
        {"half_period": (1, -1, 1, -1)},  # one site comes back after half a period
        {"reversal": None, "half_period": None},
    ],
)
def test_models_without_the_symmetries_of_odd_cosines_are_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"oscillators: .*use gauss"):
        TrigonometricProblem(oscillators(checked=False, **changes), 4)


def test_a_model_of_first_order_is_refused() -> None:
    with pytest.raises(ValueError, match="second-order"):
        TrigonometricProblem(oscillators().first_order(), 4)


def test_a_model_with_no_normalisation_or_another_number_of_parameters_is_refused() -> None:
    model = oscillators()
    with pytest.raises(ValueError, match="one free parameter and a normalisation"):
        TrigonometricProblem(oscillators(normalisation=None), 4)
    with pytest.raises(ValueError, match="one free parameter and a normalisation"):
        TrigonometricProblem(replace(model, parameters=ca.vertcat(model.parameters, ca.SX.sym("other"))), 4)


# Equations that models have in common --------------------------------------------------------------------------------


def test_a_problem_of_shared_functions_is_that_of_its_model() -> None:
    """Residual and Jacobian by the functions that chains share, and by those made of one chain's own expressions."""
    generator = np.random.default_rng(5)
    for chain in (Chain(5, 1.0, 0.3, -1.0), Chain(5, 1.7, -0.2, 2.0), Chain(5, 0.5, 0.0, 1.0)):
        problem = TrigonometricProblem(chain.gauge_model(), 6)
        z = generator.normal(size=problem.size)
        z[problem.Omega_index] = 1.3
        residual, nonzeros = problem.evaluate(z)
        own_residual, own_jacobian = problem.function(z, problem.constants)
        np.testing.assert_allclose(residual, np.array(own_residual).ravel(), rtol=0, atol=1e-12)
        jacobian = np.zeros((problem.size - 1, problem.size))
        np.add.at(jacobian, problem.pattern, nonzeros)
        np.testing.assert_allclose(jacobian, np.array(ca.DM(own_jacobian)), rtol=0, atol=1e-12)


def test_chains_that_differ_in_numbers_share_what_is_built() -> None:
    chains = Chain(4, 1.0, 0.3, -1.0), Chain(4, 2.0, 0.1, 3.0), Chain(5, 1.0, 0.3, -1.0)
    one, other, longer = (TrigonometricProblem(chain.gauge_model(), 6) for chain in chains)
    assert one.shared is other.shared
    assert one.compiled is other.compiled
    assert one.shared is not longer.shared
    assert not np.array_equal(one.numbers, other.numbers)


def test_families_followed_by_turns_are_those_followed_one_by_one() -> None:
    """What they share keeps nothing of either."""

    def points(gamma: float) -> Iterator[float]:
        tools = Family(family_request(Chain(4, 1.0, gamma, -1.0), 1, 1.5, tolerance=1e-9))
        return (point.Omega for point in tools.continuation((tools.start,)))

    alone = [list(points(gamma)) for gamma in (0.2, 0.4)]
    both = [points(gamma) for gamma in (0.2, 0.4)]
    turns = [[next(walk) for walk in both] for _ in range(min(map(len, alone)))]
    for k in range(2):
        assert [turn[k] for turn in turns] == alone[k][: len(turns)]


def results(x: ca.SX, y: ca.SX, c: list[float]) -> list[ca.SX]:
    return [ca.vertcat(c[0] * ca.sin(x[0]) + y / c[1], ca.fmin(x[1], c[2]) ** 2), c[3] * x[0] * x[1] - 0.25]


@pytest.mark.parametrize("numbers", [[0.3, 1.2, 1.1, 2.5], [5.0, 5.0, 5.0, 5.0], [1.0, 0.7, 2.0, 1.0]])
def test_expressions_with_numbers_as_symbols_are_the_same(numbers: list[float]) -> None:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    found = lifted([x, y], results(x, y, numbers), 100)
    assert found is not None
    program, values = found
    c = ca.SX.sym("c", values.size)
    symbolic = ca.Function("symbolic", [x, y, c], program.expressions([x, y], c))
    exact = ca.Function("exact", [x, y], results(x, y, numbers))
    for one, other in zip(symbolic([0.3, 1.2], -0.7, values), exact([0.3, 1.2], -0.7), strict=True):
        np.testing.assert_allclose(np.array(one), np.array(other), rtol=1e-14)


def test_programs_are_equal_where_numbers_alone_differ() -> None:
    x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
    cases = [0.3, 1.2, 1.1, 2.5], [7.1, -0.2, 3.3, 9.0], [1.0, 1.2, 1.1, 2.5]
    first, other, shorter = (lifted([x, y], results(x, y, case), 100) for case in cases)
    assert first is not None
    assert other is not None
    assert shorter is not None
    assert first[0] == other[0]
    assert first[0] != shorter[0]  # of a product with 1 no instruction is left
    assert lifted([x, y], results(x, y, cases[0]), 3) is None
