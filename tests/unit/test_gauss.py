"""Gauss-Legendre collocation on a quarter, half and full period: tables, derivatives, order, symmetric sampling."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray
from orbit_problems import (
    asymmetric_oscillator,
    check_jacobian,
    check_table,
    dense_jacobian,
    gauss_problem,
    moved,
    predator_and_prey,
    solved,
)
from scipy.integrate import quad, solve_ivp

from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.closed_forms import duffing_frequency
from casadi_skin.model.conserved import SymmetryClass, pinned_components, symmetry_class
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.butcher import gauss_table
from casadi_skin.zero.cosines import TrigonometricProblem

Array = NDArray[np.float64]
QUARTER, HALF, FULL = SymmetryClass.QUARTER, SymmetryClass.HALF, SymmetryClass.FULL


@pytest.mark.parametrize("degree", range(1, 9))
def test_table_agrees_with_forty_digits(degree: int) -> None:
    guesses = np.polynomial.legendre.leggauss(degree)[0].tolist()
    with mp.workdps(40):
        nodes = [(mp.findroot(lambda s: mp.legendre(degree, s), mp.mpf(x)) + 1) / 2 for x in guesses]
        check_table(gauss_table(degree), nodes, [*nodes, mp.mpf(1)])


@pytest.mark.parametrize("symmetry", SymmetryClass)
@pytest.mark.parametrize("sites", [1, 2, 5])
def test_jacobian_agrees_with_finite_differences_in_every_column(sites: int, symmetry: SymmetryClass) -> None:
    problem = gauss_problem(Chain(sites, 0.8, 0.3, 1.0).gauge_model(), 2, symmetry, degree=2)
    z = np.random.default_rng(sites).normal(size=problem.size)
    z[problem.Omega_index] = 1.3
    check_jacobian(problem, z)


@pytest.mark.parametrize("model", [asymmetric_oscillator(), predator_and_prey()], ids=lambda m: m.name)
@pytest.mark.parametrize("degree", [1, 3])
def test_jacobian_agrees_with_finite_differences_for_models_written_by_hand(model: OdeModel, degree: int) -> None:
    problem = gauss_problem(model, 3, symmetry_class(model), degree)
    z = np.random.default_rng(0).uniform(0.5, 1.5, size=problem.size)
    check_jacobian(problem, z, 1e-9)


@pytest.mark.parametrize("symmetry", SymmetryClass)
def test_unknowns_are_counted_one_more_than_equations(symmetry: SymmetryClass) -> None:
    problem = gauss_problem(Chain(3, 1.0, 0.2, 1.0).gauge_model(), 4, symmetry, degree=3)
    assert problem.states == 6 * (4 * 4 + 1)
    assert problem.size == problem.states + (3 if symmetry is FULL else 2)
    assert problem.evaluate(np.ones(problem.size))[0].size == problem.size - 1


@pytest.mark.parametrize("symmetry", SymmetryClass)
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_frequency_of_a_duffing_oscillator_converges_with_order_twice_the_degree(
    degree: int, symmetry: SymmetryClass
) -> None:
    chain, S = Chain(1, 1.0, 0.0, 1.0), 2.0
    exact = duffing_frequency(3.0, 1.0, np.sqrt(S))
    first = {1: 8, 2: 4, 3: 2}[degree] * round(4 * symmetry.value)
    errors = []
    for intervals in (first, 2 * first, 4 * first):
        problem = gauss_problem(chain.gauge_model(), intervals, symmetry, degree)
        z = solved(problem, chain, 1, S, steps=2)
        errors.append(abs(z[problem.Omega_index] - exact))
    assert errors[-1] > 1e-13  # truncation, not round-off, is what is seen
    orders = [np.log2(a / b) for a, b in pairwise(errors)]
    assert orders[-1] == pytest.approx(2 * degree, abs=0.35)
    assert orders[-1] == pytest.approx(2 * degree, abs=abs(orders[0] - 2 * degree) + 0.02)  # and it settles


@pytest.mark.parametrize("degree", [2, 4])
def test_a_softening_chain_converges_with_order_twice_the_degree(degree: int) -> None:
    """N = 4 softening, against odd cosines of 24 harmonics."""
    chain, kappa = Chain(4, 1.0, 0.4, -1.0), -1.5
    fine = TrigonometricProblem(chain.gauge_model(), 24)
    exact = solved(fine, chain, 1, kappa)[fine.Omega_index]
    errors = []
    for intervals in (3, 6):
        problem = gauss_problem(chain.gauge_model(), intervals, QUARTER, degree)
        errors.append(abs(solved(problem, chain, 1, kappa)[problem.Omega_index] - exact))
    assert errors[-1] > 1e-13
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * degree, abs=0.7)


@pytest.mark.parametrize(
    ("sites", "mode", "kappa"), [(1, 1, -1.0), (2, 2, 2.0), pytest.param(5, 1, -1.2, marks=pytest.mark.slow)]
)
def test_the_three_classes_and_odd_cosines_find_the_same_orbit(sites: int, mode: int, kappa: float) -> None:
    chain = Chain(sites, 1.0, 0.3, np.sign(kappa))
    reference = TrigonometricProblem(chain.gauge_model(), 20)
    z = solved(reference, chain, mode, kappa)
    theta = np.random.default_rng(sites).uniform(-25, 25, 60)
    q = reference.sample(z, theta)
    for symmetry in SymmetryClass:
        problem = gauss_problem(chain.gauge_model(), round(16 * symmetry.value), symmetry, degree=6)
        other = solved(problem, chain, mode, kappa)
        assert other[problem.Omega_index] == pytest.approx(z[reference.Omega_index], rel=3e-13)
        # Between mesh points the collocation polynomial is of degree d + 1 only.
        np.testing.assert_allclose(problem.sample(other, theta), q, rtol=0, atol=2e-6 * np.abs(q).max())


def test_the_unfolding_parameter_comes_back_as_zero() -> None:
    chain = Chain(3, 1.0, 0.3, -1.0)
    problem = gauss_problem(chain.gauge_model(), 8, FULL, degree=4)
    z = solved(problem, chain, 1, -1.0)
    assert abs(z[problem.damping_index]) < 1e-13
    assert problem.damping_index == problem.size - 1


def test_half_a_period_of_an_asymmetric_oscillator_agrees_with_its_energy_integral() -> None:
    """The turning points are 1/2 and the negative root of q^2/2 + p q^3/3 = E; the half period is an integral."""
    p = 0.6
    E = 0.125 + p / 24
    turn = sorted(np.roots([p / 3, 0.5, 0.0, -E]).real)[1]
    assert turn < 0
    # E - V = p/3 (q - turn)(1/2 - q)(q - other) up to sign; the substitution takes out both end singularities.
    other = sorted(np.roots([p / 3, 0.5, 0.0, -E]).real)[0]
    middle, half = (0.5 + turn) / 2, (0.5 - turn) / 2
    half_period = quad(lambda u: 1 / np.sqrt(2 * p / 3 * (middle + half * np.sin(u) - other)), -np.pi / 2, np.pi / 2)[0]
    problem = gauss_problem(asymmetric_oscillator(), 8, HALF, degree=5)
    z = moved(problem, problem.pack(np.array([0.5]), 1.0, 0.0), p, 4)
    assert z[problem.Omega_index] == pytest.approx(np.pi / half_period, rel=1e-12)
    np.testing.assert_allclose(problem.sample(z, np.array([0.0, np.pi]))[:, 0], [0.5, turn], atol=1e-12)


def test_an_orbit_that_is_not_odd_is_not_sampled_as_if_it_were() -> None:
    """Half and full period of q'' = -q - p q^2 at random phases over several periods, against DOP853."""
    model, p = asymmetric_oscillator(), 0.6
    theta = np.sort(np.random.default_rng(3).uniform(0.0, 20.0, 50))
    for symmetry in (HALF, FULL):
        problem = gauss_problem(model, round(32 * symmetry.value), symmetry, degree=6)
        z = moved(problem, problem.pack(np.array([0.5]), 1.0, 0.0), p, 4)
        t = theta / z[problem.Omega_index]
        path = solve_ivp(
            lambda _, x: [x[1], -x[0] - p * x[0] ** 2], (0, t[-1]), [0.5, 0.0], "DOP853", t, rtol=1e-12, atol=1e-13
        )
        q = problem.sample(z, theta)[:, 0]
        np.testing.assert_allclose(q, path.y[0], atol=2e-9)
        np.testing.assert_allclose(problem.sample(z, -theta)[:, 0], q, atol=1e-9)
        np.testing.assert_allclose(problem.sample(z, theta - 8 * np.pi)[:, 0], q, atol=1e-9)


def test_a_conservative_model_of_first_order_without_reversal_is_solved_on_the_full_period() -> None:
    """Predator and prey with x_max = 2: the orbit, its period and its states against DOP853."""
    problem = gauss_problem(predator_and_prey(), 24, FULL, degree=6)
    # A guess from a small orbit about (1, p): x - 1 = e cos(theta), y - p = e sqrt(p) sin(theta).
    theta = problem.phases()
    guess = np.stack([1 + 0.9 * np.cos(theta), 1 + 0.9 * np.sin(theta)], axis=1)
    z = np.concatenate([guess.ravel(), [0.9, 1.0, 0.0]])
    correction = NewtonCorrector(problem, max_iterations=30).correct(z, problem.parameter_row(), 1.0)
    assert correction.converged, correction.status
    z = moved(problem, correction.z, 1.3, 4)
    assert abs(z[problem.damping_index]) < 1e-9
    period = 2 * np.pi / z[problem.Omega_index]
    path = solve_ivp(
        lambda _, x: [x[0] * (1.3 - x[1]), x[1] * (x[0] - 1)],
        (0, 2.6 * period), [2.0, 1.3], "DOP853", np.linspace(0, 2.6 * period, 40), rtol=1e-12, atol=1e-13,
    )  # fmt: skip
    states = problem.sample(z, z[problem.Omega_index] * path.t)
    np.testing.assert_allclose(states, path.y.T, atol=1e-6)


def test_a_first_order_model_without_a_declared_energy_is_refused_or_regular() -> None:
    try:
        problem = gauss_problem(predator_and_prey(hamiltonian=None), 4, FULL, degree=2)
    except ValueError as refusal:
        assert "hamiltonian" in str(refusal)  # noqa: PT017
        return
    z = np.random.default_rng(0).uniform(0.5, 1.5, size=problem.size)
    z[problem.damping_index] = 0.0
    square = np.vstack([dense_jacobian(problem, z), problem.parameter_row()])
    assert np.linalg.cond(square) < 1e12


@pytest.mark.parametrize("symmetry", SymmetryClass)
def test_a_finer_mesh_continues_the_same_polynomials(symmetry: SymmetryClass) -> None:
    problem = gauss_problem(Chain(2, 1.0, 0.3, 1.0).gauge_model(), 3, symmetry, degree=3)
    finer = gauss_problem(problem.model, 6, symmetry, degree=3)
    other = gauss_problem(problem.model, 4, symmetry, degree=3)
    z = np.random.default_rng(1).normal(size=problem.size)
    part = symmetry.value * 2 * np.pi
    theta = np.random.default_rng(2).uniform(0, part, 30)
    # Halved intervals hold each polynomial of degree d + 1 exactly; a mesh that cuts across them does not.
    np.testing.assert_allclose(
        finer.sample(problem.prolong(z, finer), theta), problem.sample(z, theta), atol=1e-12 * np.abs(z).max()
    )
    knots = part * np.arange(5) / 4
    np.testing.assert_allclose(
        other.sample(problem.prolong(z, other), knots), problem.sample(z, knots), atol=1e-12 * np.abs(z).max()
    )
    np.testing.assert_array_equal(problem.prolong(z, finer)[finer.states :], z[problem.states :])


@pytest.mark.parametrize("symmetry", SymmetryClass)
def test_sampling_at_mesh_and_stage_phases_returns_the_unknowns(symmetry: SymmetryClass) -> None:
    problem = gauss_problem(Chain(2, 1.0, 0.3, 1.0).gauge_model(), 3, symmetry, degree=3)
    z = np.random.default_rng(1).normal(size=problem.size)
    nodes = gauss_table(3).nodes
    fractions = np.concatenate([[k / 3, *((k + nodes) / 3)] for k in range(3)])
    positions = z[: problem.states].reshape(-1, 4)[:-1, :2]
    np.testing.assert_allclose(problem.sample(z, symmetry.value * 2 * np.pi * fractions), positions, atol=1e-12)


def test_samples_of_a_quarter_are_unfolded_by_both_symmetries() -> None:
    problem = gauss_problem(Chain(2, 1.0, 0.3, 1.0).gauge_model(), 3, QUARTER, degree=3)
    z = np.random.default_rng(1).normal(size=problem.size)
    theta = np.random.default_rng(2).uniform(-30, 30, 50)
    q = problem.sample(z, theta)
    np.testing.assert_allclose(problem.sample(z, -theta), q, atol=1e-10)
    np.testing.assert_allclose(problem.sample(z, theta + np.pi), -q, atol=1e-10)
    np.testing.assert_allclose(problem.sample(z, theta + 4 * np.pi), q, atol=1e-10)


def test_the_smallest_part_of_the_period_follows_from_what_is_declared() -> None:
    model = Chain(2, 1.0, 0.3, 1.0).gauge_model()
    assert symmetry_class(model) is QUARTER
    assert symmetry_class(replace(model, half_period=None)) is HALF
    assert symmetry_class(replace(model, reversal=None)) is FULL
    assert pinned_components(model, QUARTER) == ([2, 3], [0, 1])
    assert pinned_components(model, HALF) == ([2, 3], [2, 3])
    assert pinned_components(model, FULL) == ([], [])
    assert [c.value for c in (QUARTER, HALF, FULL)] == [0.25, 0.5, 1.0]
    assert len({c.reason for c in SymmetryClass}) == 3


@pytest.mark.parametrize(
    ("changes", "symmetry"),
    [({"reversal": None}, QUARTER), ({"reversal": None}, HALF), ({"half_period": None}, QUARTER)],
)
def test_classes_whose_symmetries_are_not_declared_are_refused(
    changes: dict[str, Any], symmetry: SymmetryClass
) -> None:
    model = replace(Chain(2, 1.0, 0.3, 1.0).gauge_model(), **changes)
    with pytest.raises(ValueError, match=f"the {symmetry.name.lower()}-period class needs symmetries"):
        gauss_problem(model, 4, symmetry)


@pytest.mark.parametrize("reversal", [(1, 1, 1, -1), (-1, -1, -1, 1), (1, 1, 1, 1)])
def test_a_reversal_that_fixes_the_wrong_number_of_components_is_refused(reversal: tuple[int, ...]) -> None:
    model = replace(Chain(2, 1.0, 0.3, 1.0).gauge_model(), reversal=reversal)
    with pytest.raises(ValueError, match=r"the reversal fixes .* of 4 components"):
        gauss_problem(model, 4, HALF)


@pytest.mark.parametrize("symmetry", SymmetryClass)
def test_a_model_with_no_normalisation_or_another_number_of_parameters_is_refused(symmetry: SymmetryClass) -> None:
    model = Chain(2, 1.0, 0.3, 1.0).gauge_model()
    two = ca.vertcat(model.parameters, ca.SX.sym("other"))
    for changes in ({"normalisation": None}, {"parameters": two}):
        with pytest.raises(ValueError, match="one free parameter and a normalisation"):
            gauss_problem(replace(model, **changes), 4, symmetry)
