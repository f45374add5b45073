"""Every transcription of orbits: tables, derivatives, orders, and orbits in closed form and by other means."""

from __future__ import annotations

from collections.abc import Callable
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
    gauss_problem,
    moved,
    oscillators,
    predator_and_prey,
    radau_problem,
    solved,
)
from scipy.integrate import quad, solve_ivp

from casadi_skin import Chain, OdeModel
from casadi_skin.lattice.closed_forms import duffing_displacement, duffing_frequency
from casadi_skin.model.conserved import SymmetryClass, pinned_components, symmetry_class
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.butcher import gauss_table, radau_table
from casadi_skin.zero.collocation import CollocationProblem, FirstOrderProblem
from casadi_skin.zero.cosines import TrigonometricProblem
from casadi_skin.zero.problem import OrbitProblem
from casadi_skin.zero.shooting import ShootingProblem

Array = NDArray[np.float64]
Make = Callable[[OdeModel, SymmetryClass], FirstOrderProblem]
QUARTER, HALF, FULL = SymmetryClass.QUARTER, SymmetryClass.HALF, SymmetryClass.FULL

# In full states, fine enough for many digits: the problem, and the errors of Omega and of the profile that it may have.
FINE: dict[str, tuple[Make, float, float]] = {
    "gauss": (lambda model, symmetry: gauss_problem(model, round(16 * symmetry.value), symmetry, 6), 3e-13, 2e-6),
    "radau": (lambda model, symmetry: radau_problem(model, round(12 * symmetry.value), symmetry, 8), 1e-11, 2e-6),
    "shooting": (lambda model, symmetry: ShootingProblem(model, 13, symmetry), 3e-11, 2e-9),
}
COARSE: dict[str, Make] = {
    "gauss": lambda model, symmetry: gauss_problem(model, 3, symmetry, 3),
    "gauss of degree 1": lambda model, symmetry: gauss_problem(model, 3, symmetry, 1),
    "radau": lambda model, symmetry: radau_problem(model, 3, symmetry, 2),
    "shooting": lambda model, symmetry: ShootingProblem(model, 13, symmetry, segments=2),
}
slow = pytest.mark.slow


# Tables ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", range(1, 13))
def test_tables_agree_with_forty_digits(degree: int) -> None:
    gauss, radau = gauss_table(degree), radau_table(degree)
    with mp.workdps(40):
        legendre = lambda s: mp.legendre(degree, s)  # noqa: E731
        nodes = [(mp.findroot(legendre, mp.mpf(2 * c - 1)) + 1) / 2 for c in gauss.nodes.tolist()]
        check_table(gauss, nodes, [*nodes, mp.mpf(1)])
        polynomial = lambda s: mp.legendre(degree, s) - mp.legendre(degree - 1, s)  # noqa: E731
        nodes = [(mp.findroot(polynomial, mp.mpf(2 * c - 1)) + 1) / 2 for c in radau.nodes[:-1].tolist()]
        check_table(radau, [*nodes, mp.mpf(1)], [*nodes, mp.mpf(1)])


def test_the_known_radau_method_of_two_stages() -> None:
    np.testing.assert_allclose(radau_table(2).extended, [[5 / 12, -1 / 12], [3 / 4, 1 / 4]], rtol=1e-15)
    np.testing.assert_allclose(radau_table(2).nodes, [1 / 3, 1.0], rtol=1e-15)


# Equations ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("symmetry", SymmetryClass)
@pytest.mark.parametrize("kind", COARSE)
@pytest.mark.parametrize(
    "model",
    [
        Chain(1, 0.8, 0.0, 1.0).gauge_model(),
        pytest.param(Chain(3, 0.8, 0.3, 1.0).gauge_model(), marks=slow),
        asymmetric_oscillator(half_period=(-1, -1)),  # of no use but for the shape of the equations
        predator_and_prey(reversal=(1, -1), half_period=(-1, -1)),
    ],
    ids=lambda model: f"{model.name} {model.size}",
)
def test_jacobian_agrees_with_finite_differences_in_every_column(
    model: OdeModel, kind: str, symmetry: SymmetryClass
) -> None:
    problem = COARSE[kind](model, symmetry)
    if isinstance(problem, CollocationProblem):
        problem = problem.with_constants(np.random.default_rng(0).dirichlet(8.0 * np.ones(3)))  # an uneven mesh
    z = np.random.default_rng(model.size).uniform(0.5, 1.5, size=problem.size)
    if symmetry is FULL:
        z[problem.damping_index] = 0.03  # along a gradient the states grow fast
    check_jacobian(problem, z, 3e-6 if kind == "shooting" else 1e-9)  # sensitivities have eight digits


@pytest.mark.parametrize("model", [*(Chain(n, 0.8, 0.3, 1.0).gauge_model() for n in (1, 2, 5)), oscillators()])
@pytest.mark.parametrize("harmonics", [1, 4])
def test_jacobian_in_odd_cosines_agrees_with_finite_differences(model: OdeModel, harmonics: int) -> None:
    problem = TrigonometricProblem(model, harmonics)
    z = np.random.default_rng(model.size).normal(size=problem.size)
    z[problem.Omega_index] = 1.3
    check_jacobian(problem, z)


@pytest.mark.parametrize("symmetry", SymmetryClass)
def test_unknowns_are_counted_one_more_than_equations(symmetry: SymmetryClass) -> None:
    model = Chain(3, 1.0, 0.2, 1.0).gauge_model()
    columns = {"gauss": 3 * 4 + 1, "radau": 3 * 2 + 1, "shooting": 2 + 1}
    for kind, count in columns.items():
        problem = COARSE[kind](model, symmetry)
        assert problem.states == 6 * count
        assert problem.size == problem.states + (3 if symmetry is FULL else 2)
        assert problem.evaluate(np.ones(problem.size))[0].size == problem.size - 1
    cosines = TrigonometricProblem(model, 7)
    assert (cosines.states, cosines.size, cosines.Omega_index, cosines.parameter_index) == (21, 23, 21, 22)
    assert cosines.parameter_row() @ np.arange(23.0) == 22.0


# Orders ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("symmetry", SymmetryClass)
@pytest.mark.parametrize(("kind", "degree"), [*(("gauss", d) for d in (1, 2, 3)), *(("radau", d) for d in (2, 3, 4))])
def test_the_frequency_converges_with_the_order_of_the_table(kind: str, degree: int, symmetry: SymmetryClass) -> None:
    """On the full period the damping takes the error of odd order, and what is left of Omega is smaller."""
    chain, S, make = Chain(1, 1.0, 0.0, 1.0), 2.0, {"gauss": gauss_problem, "radau": radau_problem}[kind]
    exact = duffing_frequency(3.0, 1.0, np.sqrt(S))
    first = {("gauss", 1): 8, ("gauss", 2): 4, ("gauss", 3): 2, ("radau", 2): 6, ("radau", 3): 3, ("radau", 4): 2}
    errors, damping = [], []
    for factor in (1, 2, 4):
        problem = make(chain.gauge_model(), factor * first[kind, degree] * round(4 * symmetry.value), symmetry, degree)
        z = solved(problem, chain, 1, S, steps=2)
        errors.append(abs(z[problem.Omega_index] - exact))
        damping.append(abs(z[-1]))
    assert errors[-1] > 1e-13  # truncation, not round-off, is what is seen
    order = problem.table.order
    expected = 2 * degree if symmetry is FULL else order
    found = [float(np.log2(a / b)) for a, b in pairwise(errors)]
    assert found[-1] == pytest.approx(expected, abs=0.35 if kind == "gauss" else 0.5)
    if kind == "gauss":
        assert order == 2 * degree
        assert found[-1] == pytest.approx(expected, abs=abs(found[0] - expected) + 0.02)  # and it settles
    elif symmetry is FULL:
        assert np.log2(damping[-2] / damping[-1]) == pytest.approx(order, abs=0.5)


@pytest.mark.parametrize(("g", "S"), [(1.0, 2.0), (1.0, 30.0), (-1.0, 1.5)])
def test_odd_cosines_converge_spectrally_to_the_duffing_oscillator(g: float, S: float) -> None:
    chain, exact = Chain(1, 1.0, 0.0, g), duffing_frequency(3.0, g, np.sqrt(S))
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
        assert max(ratios) / min(ratios) < 8  # geometric, with no order: it would approach 1 as (1 - 2/H)^order
        assert e[-1] < 1e-14


@pytest.mark.parametrize(("g", "S"), [(1.0, 5.0), pytest.param(-1.0, 1.2, marks=slow)])
def test_more_digits_of_shooting_are_more_accurate(g: float, S: float) -> None:
    chain, exact, errors = Chain(1, 1.0, 0.0, g), duffing_frequency(3.0, g, np.sqrt(S)), []
    for digits in (5, 8, 11, 14):
        problem = ShootingProblem(chain.gauge_model(), digits, QUARTER)
        errors.append(abs(solved(problem, chain, 1, g * S)[problem.Omega_index] - exact))
    assert all(fine < 0.1 * coarse for coarse, fine in pairwise(errors))
    assert errors[0] > 1e-7  # it is the tolerance that is seen
    assert errors[-1] < 1e-12


# Orbits ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("symmetry", SymmetryClass)
@pytest.mark.parametrize("kind", FINE)
@pytest.mark.parametrize(
    ("sites", "mode", "kappa"),
    [(1, 1, -1.2), pytest.param(1, 1, 5.0, marks=slow), (2, 2, 2.0), pytest.param(4, 1, -1.5, marks=slow)],
)
def test_every_class_finds_the_orbit_of_odd_cosines(
    sites: int, mode: int, kappa: float, kind: str, symmetry: SymmetryClass
) -> None:
    """The unfolding parameter comes back as zero; one site is the Duffing oscillator."""
    make, error, apart = FINE[kind]
    chain = Chain(sites, 1.0, 0.3 if sites > 1 else 0.0, np.sign(kappa))
    reference, problem = TrigonometricProblem(chain.gauge_model(), 24), make(chain.gauge_model(), symmetry)
    exact, z = (solved(p, chain, mode, kappa) for p in (reference, problem))
    assert z[problem.Omega_index] == pytest.approx(exact[reference.Omega_index], rel=error)
    if symmetry is FULL:
        assert problem.damping_index == problem.size - 1
        assert abs(z[-1]) < (1e-13 if kind == "gauss" else 1e-10)
    theta = np.random.default_rng(sites).uniform(-25, 25, 60)
    q, size = reference.sample(exact, theta), np.abs(exact[: reference.states]).max()
    np.testing.assert_allclose(problem.sample(z, theta), q, rtol=0, atol=apart * size)
    if sites == 1:
        Omega = duffing_frequency(3.0, chain.g, np.sqrt(abs(kappa)))
        assert z[problem.Omega_index] == pytest.approx(Omega, rel=error)
        y = duffing_displacement(3.0, chain.g, np.sqrt(abs(kappa)), theta / Omega) / np.sqrt(abs(kappa))
        np.testing.assert_allclose(q[:, 0], y, atol=1e-12)


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


@pytest.mark.parametrize("symmetry", [HALF, FULL])
@pytest.mark.parametrize("kind", ["gauss", "shooting"])
def test_an_orbit_that_is_not_odd_is_not_sampled_as_if_it_were(kind: str, symmetry: SymmetryClass) -> None:
    """q'' = -q - p q^2 at random phases over several periods, against DOP853; its half period is an integral."""
    model, p, count = asymmetric_oscillator(), 0.6, round(32 * symmetry.value)
    problem = gauss_problem(model, count, symmetry, 6) if kind == "gauss" else ShootingProblem(model, 13, symmetry)
    z = moved(problem, problem.pack(np.array([0.5]), 1.0, 0.0), p, 4)
    theta = np.sort(np.random.default_rng(3).uniform(0.0, 20.0, 50))
    t = theta / z[problem.Omega_index]
    path = solve_ivp(
        lambda _, x: [x[1], -x[0] - p * x[0] ** 2], (0, t[-1]), [0.5, 0.0], "DOP853", t, rtol=1e-12, atol=1e-13
    )
    for phases in (theta, -theta, theta - 8 * np.pi):
        np.testing.assert_allclose(problem.sample(z, phases)[:, 0], path.y[0], atol=2e-9)
    # The turning points are 1/2 and the negative root of q^2/2 + p q^3/3 = E, the third root lies beyond; the
    # substitution takes out the singularities at both ends.
    other, turn = sorted(np.roots([p / 3, 0.5, 0.0, -0.125 - p / 24]).real)[:2]
    middle, half = (0.5 + turn) / 2, (0.5 - turn) / 2
    half_period = quad(lambda u: 1 / np.sqrt(2 * p / 3 * (middle + half * np.sin(u) - other)), -np.pi / 2, np.pi / 2)[0]
    assert z[problem.Omega_index] == pytest.approx(np.pi / half_period, rel=1e-12 if kind == "gauss" else 1e-10)
    np.testing.assert_allclose(problem.sample(z, np.array([0.0, np.pi]))[:, 0], [0.5, turn], atol=2e-9)


@pytest.mark.parametrize("kind", ["gauss", "shooting"])
def test_a_conservative_model_of_first_order_without_reversal_is_solved_on_the_full_period(kind: str) -> None:
    """Predator and prey with x_max = 2: the orbit, its period and its states against DOP853."""
    model = predator_and_prey()
    problem = gauss_problem(model, 24, FULL, 6) if kind == "gauss" else ShootingProblem(model, 13, FULL)
    theta = problem.phases()  # a guess from a small orbit about (1, p)
    guess = np.stack([1 + 0.9 * np.cos(theta), 1 + 0.9 * np.sin(theta)], axis=1)
    z = np.concatenate([guess.ravel(), [0.9, 1.0, 0.0]])
    correction = NewtonCorrector(problem, 1e-11, max_iterations=30).correct(z, problem.parameter_row(), 1.0)
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


@pytest.mark.parametrize(("sites", "mode"), [(1, 1), (2, 2), (5, 1), (5, 4), (24, 24)])
def test_the_linear_mode_solves_the_equations_in_odd_cosines_without_nonlinearity(sites: int, mode: int) -> None:
    chain = Chain(sites, 1.0, 0.25, -1.0)
    problem = TrigonometricProblem(chain.gauge_model(), 5)
    z = solved(problem, chain, mode, 0.0, steps=1)
    assert np.abs(problem.evaluate(z)[0]).max() <= 1e-13 * np.abs(z).max()
    assert z[problem.Omega_index] == pytest.approx(chain.linear_frequency(mode), rel=1e-14)
    assert problem.relative_residual(z) <= 1e-14


# Samples and other resolutions ----------------------------------------------------------------------------------------


def of_every_kind(symmetry: SymmetryClass) -> list[OrbitProblem]:
    model = Chain(2, 1.0, 0.3, 1.0).gauge_model()
    problems: list[OrbitProblem] = [COARSE[kind](model, symmetry) for kind in ("gauss", "radau")]
    return [*problems, TrigonometricProblem(model, 6)] if symmetry is QUARTER else problems


@pytest.mark.parametrize("symmetry", SymmetryClass)
def test_samples_return_the_unknowns_and_are_unfolded_by_the_symmetries(symmetry: SymmetryClass) -> None:
    theta = np.random.default_rng(4).uniform(-30, 30, 50)
    for problem in of_every_kind(symmetry):
        z = np.random.default_rng(2).normal(size=problem.size)
        at = problem.phases()
        positions = z[: problem.states].reshape(2, -1).T if problem.cosines else z[: problem.states].reshape(-1, 4)
        inside = slice(None, -1) if symmetry is FULL else slice(None)  # where it closes there are two values
        np.testing.assert_allclose(problem.sample(z, at)[inside], positions[inside, :2], atol=1e-12)
        q = problem.sample(z, theta)
        np.testing.assert_allclose(problem.sample(z, theta + 4 * np.pi), q, atol=1e-10)
        if symmetry is not FULL:
            np.testing.assert_allclose(problem.sample(z, -theta), q, atol=1e-10)
        if symmetry is QUARTER:
            np.testing.assert_allclose(problem.sample(z, theta + np.pi), -q, atol=1e-10)


@pytest.mark.parametrize("symmetry", SymmetryClass)
@pytest.mark.parametrize("kind", ["gauss", "radau"])
def test_halved_intervals_hold_the_same_polynomials_on_any_mesh(kind: str, symmetry: SymmetryClass) -> None:
    make = {"gauss": gauss_problem, "radau": radau_problem}[kind]
    coarse, finer, other = (make(Chain(2, 1.0, 0.3, 1.0).gauge_model(), K, symmetry, degree=3) for K in (3, 6, 4))
    uneven = coarse.with_constants(np.random.default_rng(0).dirichlet(8.0 * np.ones(3)))
    part = symmetry.value * 2 * np.pi
    theta = np.random.default_rng(2).uniform(0, part, 30)
    z = np.random.default_rng(1).normal(size=coarse.size)
    for problem in (coarse, uneven):
        halved = problem.transferred(finer)
        np.testing.assert_allclose(halved.constants, np.repeat(problem.constants / 2, 2), rtol=1e-12)
        found = halved.sample(problem.prolong(z, halved), theta)
        np.testing.assert_allclose(found, problem.sample(z, theta), atol=1e-11 * np.abs(z).max())
    knots = part * np.arange(5) / 4  # a mesh that cuts across has the values at its own ends
    found = other.sample(coarse.prolong(z, other), knots)
    np.testing.assert_allclose(found, coarse.sample(z, knots), atol=1e-12 * np.abs(z).max())
    np.testing.assert_array_equal(coarse.prolong(z, finer)[finer.states :], z[coarse.states :])


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


# Models ---------------------------------------------------------------------------------------------------------------


def test_the_smallest_part_of_the_period_follows_from_what_is_declared() -> None:
    model = Chain(2, 1.0, 0.3, 1.0).gauge_model()
    assert symmetry_class(model) is QUARTER
    assert symmetry_class(replace(model, half_period=None)) is HALF
    assert symmetry_class(replace(model, reversal=None)) is FULL
    assert pinned_components(model, QUARTER) == ([2, 3], [0, 1])
    assert pinned_components(model, HALF) == ([2, 3], [2, 3])
    assert pinned_components(model, FULL) == ([], [])
    assert [c.value for c in (QUARTER, HALF, FULL)] == [0.25, 0.5, 1.0]


def changed(model: OdeModel, changes: dict[str, Any]) -> OdeModel:
    """A model with other declarations, or with a second parameter."""
    if "parameters" in changes:
        changes = {"parameters": ca.vertcat(model.parameters, ca.SX.sym("other"))}
    return replace(model, checked=False, **changes)


@pytest.mark.parametrize("kind", ["gauss", "shooting"])
@pytest.mark.parametrize(
    ("changes", "symmetry", "words"),
    [
        ({"reversal": None}, QUARTER, "the quarter-period class needs symmetries"),
        ({"reversal": None}, HALF, "the half-period class needs symmetries"),
        ({"half_period": None}, QUARTER, "the quarter-period class needs symmetries"),
        ({"reversal": (1, 1, 1, -1)}, HALF, r"the reversal fixes .* of 4 components"),
        ({"reversal": (1, 1, 1, 1)}, HALF, r"the reversal fixes .* of 4 components"),
        ({"normalisation": None}, HALF, "one free parameter and a normalisation"),
        ({"parameters": "two"}, FULL, "one free parameter and a normalisation"),
    ],
)
def test_models_that_do_not_fit_are_refused(
    changes: dict[str, Any], symmetry: SymmetryClass, words: str, kind: str
) -> None:
    with pytest.raises(ValueError, match=words):
        COARSE[kind](changed(Chain(2, 1.0, 0.3, 1.0).gauge_model(), changes), symmetry)
    with pytest.raises(ValueError, match="declare its hamiltonian"):
        COARSE[kind](predator_and_prey(hamiltonian=None), FULL)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"reversal": None}, "use gauss"),
        ({"half_period": None}, "use gauss"),
        ({"reversal": (-1, -1, 1, 1)}, "use gauss"),  # positions odd in time
        ({"reversal": (1, -1, -1, 1)}, "use gauss"),
        ({"half_period": (1, -1, 1, -1)}, "use gauss"),  # one site comes back after half a period
        ({"normalisation": None}, "one free parameter and a normalisation"),
        ({"parameters": "two"}, "one free parameter and a normalisation"),
    ],
)
def test_models_that_odd_cosines_do_not_fit_are_refused(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=rf"oscillators: .*{words}"):
        TrigonometricProblem(changed(oscillators(), changes), 4)
    with pytest.raises(ValueError, match="second-order"):
        TrigonometricProblem(oscillators().first_order(), 4)
