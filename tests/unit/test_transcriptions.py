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
from scipy.integrate import solve_ivp

from casadi_skin import Chain, OdeModel
from casadi_skin.lattice.closed_forms import duffing_displacement, duffing_frequency
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.butcher import gauss_table, radau_table
from casadi_skin.zero.collocation import CollocationProblem, FirstOrderProblem
from casadi_skin.zero.cosines import TrigonometricProblem
from casadi_skin.zero.problem import OrbitProblem
from casadi_skin.zero.shooting import ShootingProblem

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


# Models ---------------------------------------------------------------------------------------------------------------


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
