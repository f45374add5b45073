"""Multiple shooting with CVODES: derivatives, exact and independent orbits, errors, failures, families."""

from __future__ import annotations

import os
import signal
import threading
from dataclasses import replace
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from orbit_problems import (
    CORRECTORS,
    asymmetric_oscillator,
    check_jacobian,
    corrector_of,
    gauss_problem,
    moved,
    predator_and_prey,
    solved,
)
from scipy.integrate import solve_ivp

from casadi_skin.follow.branch_run import Following
from casadi_skin.follow.family import CVODES_DIGITS, Family
from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.closed_forms import duffing_displacement, duffing_frequency
from casadi_skin.model.conserved import SymmetryClass, symmetry_class
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.levels import Levels
from casadi_skin.solve.newton import NewtonCorrector, Status
from casadi_skin.zero.cosines import TrigonometricProblem
from casadi_skin.zero.problem import SingularError
from casadi_skin.zero.request import family_request
from casadi_skin.zero.settings import End
from casadi_skin.zero.shooting import ShootingError, ShootingProblem

Array = NDArray[np.float64]
QUARTER, HALF, FULL = SymmetryClass.QUARTER, SymmetryClass.HALF, SymmetryClass.FULL


# Equations ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("symmetry", SymmetryClass)
@pytest.mark.parametrize(
    "model",
    [
        Chain(1, 0.8, 0.0, 1.0).gauge_model(),
        pytest.param(Chain(3, 0.8, 0.3, 1.0).gauge_model(), marks=pytest.mark.slow),
        asymmetric_oscillator(half_period=(-1, -1)),  # of no use but for the shape of the equations
        predator_and_prey(reversal=(1, -1), half_period=(-1, -1)),
    ],
    ids=lambda m: f"{m.name} {m.size}",
)
def test_jacobian_agrees_with_finite_differences_in_every_column(model: OdeModel, symmetry: SymmetryClass) -> None:
    problem = ShootingProblem(model, 13, symmetry, segments=2)
    z = np.random.default_rng(model.size).uniform(0.5, 1.5, size=problem.size)
    if symmetry is FULL:
        z[problem.damping_index] = 0.03  # along a gradient the states grow fast
    check_jacobian(problem, z, 3e-6)  # the sensitivities have eight digits of local tolerance


def test_the_residual_is_what_an_independent_integrator_leaves() -> None:
    model, segments = Chain(2, 0.8, 0.3, 1.0).gauge_model(), 3
    problem = ShootingProblem(model, 13, QUARTER, segments)
    z = np.random.default_rng(2).normal(size=problem.size)
    z[problem.Omega_index] = 1.3
    rhs = ca.Function("f", [model.full_state, model.parameters], [model.full_rhs])
    states = z[: problem.states].reshape(segments + 1, 4)
    duration = 0.5 * np.pi / segments / 1.3
    jumps = []
    for start, end in pairwise(states):
        path = solve_ivp(
            lambda _, x: np.array(rhs(x, z[problem.parameter_index])).ravel(), (0, duration), start, "DOP853",
            rtol=1e-13, atol=1e-14,
        )  # fmt: skip
        jumps.append(end - path.y[:, -1])
    weights = Chain(2, 0.8, 0.3, 1.0).weights
    conditions = [*states[0, 2:], *states[-1, :2], weights @ states[0, :2] ** 2 - 1]
    np.testing.assert_allclose(problem.evaluate(z)[0], np.concatenate([*jumps, conditions]), atol=1e-10)


@pytest.mark.parametrize("symmetry", SymmetryClass)
def test_unknowns_are_counted_one_more_than_equations(symmetry: SymmetryClass) -> None:
    problem = ShootingProblem(Chain(3, 1.0, 0.2, 1.0).gauge_model(), 8, symmetry, segments=5)
    assert problem.states == 6 * 6
    assert problem.size == problem.states + (3 if symmetry is FULL else 2)
    assert problem.evaluate(np.ones(problem.size))[0].size == problem.size - 1
    assert ShootingProblem(problem.model, 8, symmetry).segments == 16 * symmetry.value


def test_the_size_of_the_states_does_not_change_what_digits_mean() -> None:
    """A linear oscillator in other units: the residual scales to round-off, as local tolerances are relative."""
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p")
    model = OdeModel("linear", q, -(1 + p) * q, p, 2, v, reversal=(1, -1), half_period=(-1, -1), normalisation=q - 1)
    problem = ShootingProblem(model, 6, QUARTER, 2)
    z = problem.pack(np.ones(1), 1.2, 0.0)
    scaled = np.concatenate([1e-9 * z[: problem.states], z[problem.states :]])
    expected, found = problem.evaluate(z)[0][:4], problem.evaluate(scaled)[0][:4]
    np.testing.assert_allclose(1e9 * found, expected, rtol=0, atol=1e-13)


# Orbits ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["newton", pytest.param("ipopt", marks=pytest.mark.slow)])
@pytest.mark.parametrize("symmetry", SymmetryClass)
@pytest.mark.parametrize(("g", "S"), [pytest.param(1.0, 5.0, marks=pytest.mark.slow), (-1.0, 1.2)])
def test_a_duffing_oscillator_is_exact(g: float, S: float, symmetry: SymmetryClass, kind: str) -> None:
    chain = Chain(1, 1.0, 0.0, g)
    problem = ShootingProblem(chain.gauge_model(), 13, symmetry)
    z = solved(problem, chain, 1, g * S, kind=kind)
    Omega = duffing_frequency(3.0, g, np.sqrt(S))
    assert z[problem.Omega_index] == pytest.approx(Omega, rel=2e-11)
    if symmetry is FULL:
        assert abs(z[problem.damping_index]) < 1e-10
    theta = np.random.default_rng(0).uniform(-30, 30, 60)
    exact = duffing_displacement(3.0, g, np.sqrt(S), theta / Omega) / np.sqrt(S)
    np.testing.assert_allclose(problem.sample(z, theta)[:, 0], exact, atol=2e-9)  # thirty radians amplify the frequency


@pytest.mark.parametrize(("g", "S"), [(1.0, 5.0), pytest.param(-1.0, 1.2, marks=pytest.mark.slow)])
def test_more_digits_are_more_accurate(g: float, S: float) -> None:
    chain, exact = Chain(1, 1.0, 0.0, g), duffing_frequency(3.0, g, np.sqrt(S))
    errors = []
    for digits in (5, 8, 11, 14):
        problem = ShootingProblem(chain.gauge_model(), digits, QUARTER)
        errors.append(abs(solved(problem, chain, 1, g * S)[problem.Omega_index] - exact))
    assert all(fine < 0.1 * coarse for coarse, fine in pairwise(errors))
    assert errors[0] > 1e-7  # it is the tolerance that is seen
    assert errors[-1] < 1e-12


@pytest.mark.parametrize("symmetry", [QUARTER, HALF, pytest.param(FULL, marks=pytest.mark.slow)])
@pytest.mark.parametrize(("sites", "mode", "kappa"), [(4, 1, -1.5), pytest.param(4, 3, 2.0, marks=pytest.mark.slow)])
def test_every_class_finds_the_orbit_of_odd_cosines(
    sites: int, mode: int, kappa: float, symmetry: SymmetryClass
) -> None:
    chain = Chain(sites, 1.0, 0.3, np.sign(kappa))
    reference = TrigonometricProblem(chain.gauge_model(), 24)
    exact = solved(reference, chain, mode, kappa)
    problem = ShootingProblem(chain.gauge_model(), 13, symmetry)
    z = solved(problem, chain, mode, kappa)
    assert z[problem.Omega_index] == pytest.approx(exact[reference.Omega_index], rel=3e-11)
    theta = np.random.default_rng(sites).uniform(-25, 25, 60)
    q = reference.sample(exact, theta)
    np.testing.assert_allclose(problem.sample(z, theta), q, rtol=0, atol=1e-9 * np.abs(q).max())


def test_an_orbit_that_is_not_odd_is_found_on_half_and_full_period() -> None:
    model, p = asymmetric_oscillator(), 0.6
    theta = np.sort(np.random.default_rng(3).uniform(0.0, 20.0, 50))
    for symmetry in (HALF, FULL):
        problem = ShootingProblem(model, 13, symmetry)
        z = moved(problem, problem.pack(np.array([0.5]), 1.0, 0.0), p, 4)
        t = theta / z[problem.Omega_index]
        path = solve_ivp(
            lambda _, x: [x[1], -x[0] - p * x[0] ** 2], (0, t[-1]), [0.5, 0.0], "DOP853", t, rtol=1e-12, atol=1e-13
        )
        np.testing.assert_allclose(problem.sample(z, theta)[:, 0], path.y[0], atol=2e-9)
        np.testing.assert_allclose(problem.sample(z, -theta)[:, 0], path.y[0], atol=2e-9)


def test_a_model_of_first_order_without_reversal_is_found_on_the_full_period() -> None:
    model = predator_and_prey()
    problem, reference = ShootingProblem(model, 13, FULL), gauss_problem(model, 24, FULL, degree=6)
    guesses = []
    for p in (problem, reference):
        theta = 2 * np.pi * np.arange(17) / 16 if isinstance(p, ShootingProblem) else reference.phases()
        states = np.stack([1 + 0.9 * np.cos(theta), 1 + 0.9 * np.sin(theta)], axis=1)
        guess = np.concatenate([states.ravel(), [0.9, 1.0, 0.0]])
        correction = NewtonCorrector(p, 1e-11, max_iterations=30).correct(guess, p.parameter_row(), 1.0)
        assert correction.converged, correction.status
        guesses.append(moved(p, correction.z, 1.3, 4))
    z, exact = guesses
    assert abs(z[problem.damping_index]) < 1e-9
    assert z[problem.Omega_index] == pytest.approx(exact[reference.Omega_index], rel=1e-9)
    theta = np.linspace(-3, 9, 40)
    np.testing.assert_allclose(problem.sample(z, theta), reference.sample(exact, theta), atol=1e-6)


@pytest.mark.parametrize("symmetry", SymmetryClass)
def test_samples_at_the_segments_starts_are_the_unknowns_and_paths_join_them(symmetry: SymmetryClass) -> None:
    chain = Chain(2, 1.0, 0.3, 1.0)
    problem = ShootingProblem(chain.gauge_model(), 13, symmetry, 3)
    z = solved(problem, chain, 1, 1.0)
    starts = symmetry.value * 2 * np.pi * np.arange(3) / 3
    states = z[: problem.states].reshape(4, 4)
    np.testing.assert_array_equal(problem.sample(z, np.zeros(1))[0], states[0, :2])
    np.testing.assert_allclose(problem.sample(z, starts), states[:3, :2], atol=1e-11)
    theta = np.linspace(0.0, 8.0, 400)
    slopes = np.diff(problem.sample(z, theta), axis=0) / np.diff(theta)[:, None]
    assert np.abs(np.diff(slopes, axis=0)).max() < 0.05  # no jump
    other = z.copy()
    other[problem.states // 2] += 0.1
    assert np.abs(problem.sample(other, theta) - problem.sample(z, theta)).max() > 0.05  # nothing stale is kept


# Errors ---------------------------------------------------------------------------------------------------------------


def estimates(chain: Chain, mode: int, S: float, digits: tuple[int, ...]) -> list[tuple[float, float]]:
    """Estimated and true error of an orbit, relative, by digits; truth from odd cosines."""
    tools = Family(family_request(chain, mode, S, tolerance=1e-13, corrector="newton"))
    orbit = follow_family(chain, mode, S, at=(S,), tolerance=1e-13, corrector="newton").orbits[-1]
    exact, model = orbit.point, tools.coordinates.scaled
    levels = Levels(lambda d: ShootingProblem(model, d, QUARTER), corrector_of, digits)
    found = []
    for d in digits[:-1]:
        problem = levels.problem(d)
        assert isinstance(problem, ShootingProblem)
        guess = problem.pack(exact.problem.sample(exact.z, np.zeros(1))[0], orbit.Omega, exact.parameter)
        correction = levels.corrector(problem).correct(guess, problem.parameter_row(), exact.parameter)
        if not correction.converged:
            continue
        theta = 0.5 * np.pi * np.arange(problem.segments + 1) / problem.segments
        positions = correction.z[: problem.states].reshape(problem.segments + 1, -1)[:, : model.size]
        size = np.abs(correction.z[: problem.states]).max()
        profile = np.abs(positions - exact.problem.sample(exact.z, theta)).max() / size
        Omega = abs(correction.z[problem.Omega_index] - orbit.Omega) / orbit.Omega
        found.append((levels.error(problem, correction.z).relative(orbit.Omega), max(profile, Omega)))
    return found


def test_the_estimated_error_covers_the_true_one() -> None:
    for chain, mode, S in [(Chain(3, 1.0, 0.3, -1.0), 1, 1.0), (Chain(4, 0.5, 0.2, 1.0), 3, 3.0)]:
        found = estimates(chain, mode, S, (6, 8, 10, 12, 14, 15))
        assert len(found) == 5
        for estimated, true in found:
            assert true <= estimated <= 30 * true


@pytest.mark.slow
def test_the_estimated_error_covers_the_true_one_in_random_chains() -> None:
    generator, checked = np.random.default_rng(5), 0
    while checked < 60:
        sites, alpha, gamma = int(generator.integers(1, 9)), generator.uniform(0.2, 3), generator.uniform(-0.6, 0.6)
        chain = Chain(sites, alpha, gamma, generator.choice([-1.0, 1.0]))
        S = 10 ** generator.uniform(-1, 0.5 if chain.g > 0 else -0.2)
        found = estimates(chain, int(generator.integers(1, sites + 1)), S, CVODES_DIGITS)
        assert found
        for estimated, true in found:
            assert true <= estimated
            checked += 1


def test_prolonging_changes_nothing_but_the_tolerance() -> None:
    chain = Chain(2, 1.0, 0.3, -1.0)
    coarse, fine = (ShootingProblem(chain.gauge_model(), d, QUARTER) for d in (6, 12))
    z = solved(coarse, chain, 1, -1.0)
    np.testing.assert_array_equal(coarse.prolong(z, fine), z)
    at_coarse, at_fine = (np.abs(p.evaluate(z)[0]).max() for p in (coarse, fine))
    assert at_coarse < 1e-7 < at_fine < 1e-4


# Failures -------------------------------------------------------------------------------------------------------------


def escaping(chain: Chain) -> tuple[ShootingProblem, Array]:
    """Unknowns from which a softening oscillator runs away to infinity within a segment."""
    problem = ShootingProblem(chain.gauge_model(), 8, QUARTER, 1)
    z = problem.pack(np.ones(1), 1.6, -1.0)
    z[: problem.states] *= 30.0
    return problem, z


@pytest.mark.parametrize("kind", ["newton", pytest.param("ipopt", marks=pytest.mark.slow)])
def test_a_flow_that_fails_is_a_failed_correction_and_nothing_is_printed(
    kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    problem, z = escaping(Chain(1, 1.0, 0.0, -1.0))
    correction = corrector_of(problem, kind).correct(z, problem.parameter_row(), -1.0)
    assert correction.status is not Status.CONVERGED
    if kind == "newton":
        assert "cvodes returned CV_" in correction.message
    with pytest.raises(ShootingError, match="segment of the period cannot be computed: cvodes returned CV_"):
        problem.evaluate(z)
    with pytest.raises(SingularError):  # which every walk and levels expects
        problem.evaluate(z)
    output = capfd.readouterr()
    assert output.out == output.err == ""
    exact = duffing_frequency(3.0, -1.0, 1.0)
    good = problem.pack(np.ones(1), 1.5, -1.0)
    found = corrector_of(problem, kind).correct(good, problem.parameter_row(), -1.0)  # and it works again
    assert found.converged
    assert found.z[problem.Omega_index] == pytest.approx(exact, rel=1e-6)


def test_sensitivities_that_fail_are_named_though_the_state_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    chain = Chain(1, 1.0, 0.0, -1.0)
    problem = ShootingProblem(chain.gauge_model(), 8, QUARTER, 1)
    z = problem.pack(np.ones(1), 1.6, -1.0)
    problem.evaluate(z)

    def fail(**_: ca.DM) -> None:
        raise RuntimeError('Error in Function\n.../cvodes.cpp:403: CVode returned "CV_ERR_FAILURE". Consult it.')

    monkeypatch.setattr(problem.flow, "_variational", fail)
    with pytest.raises(ShootingError, match=r"cvodes returned CV_ERR_FAILURE$"):
        problem.evaluate(z)


def test_a_path_that_cannot_be_followed_is_named() -> None:
    problem, z = escaping(Chain(1, 1.0, 0.0, -1.0))
    with pytest.raises(ShootingError, match="cannot be followed: required step size"):
        problem.sample(z, np.array([1.0]))


@pytest.mark.usefixtures("interruptible")
def test_an_interruption_within_cvodes_is_heard() -> None:
    problem = ShootingProblem(Chain(8, 1.0, 0.3, -1.0).gauge_model(), 13, QUARTER)
    z = problem.pack(np.full(8, 0.3), 1.2, -1.0)
    problem.evaluate(z)
    timer = threading.Timer(0.05, lambda: os.kill(os.getpid(), signal.SIGINT))

    def forever() -> None:
        timer.start()
        for _ in range(2000):
            problem.evaluate(z)

    with pytest.raises(KeyboardInterrupt):
        forever()
    timer.join()


@pytest.mark.parametrize(
    ("changes", "symmetry", "words"),
    [
        ({"reversal": None}, QUARTER, "the quarter-period class needs symmetries"),
        ({"reversal": None}, HALF, "the half-period class needs symmetries"),
        ({"half_period": None}, QUARTER, "the quarter-period class needs symmetries"),
        ({"normalisation": None}, QUARTER, "one free parameter and a normalisation"),
        ({"parameters": None}, FULL, "one free parameter and a normalisation"),
    ],
)
def test_models_that_do_not_fit_are_refused(changes: dict[str, Any], symmetry: SymmetryClass, words: str) -> None:
    model = Chain(2, 1.0, 0.3, 1.0).gauge_model()
    if "parameters" in changes:
        changes = {"parameters": ca.vertcat(model.parameters, ca.SX.sym("other"))}
    with pytest.raises(ValueError, match=words):
        ShootingProblem(replace(model, **changes), 8, symmetry)


def test_a_first_order_model_without_a_declared_energy_is_refused() -> None:
    with pytest.raises(ValueError, match="declare its hamiltonian"):
        ShootingProblem(predator_and_prey(hamiltonian=None), 8, FULL)


@pytest.mark.parametrize(
    ("digits", "segments", "words"),
    [(2, 1, "digits: given 2"), (16, 1, "digits: given 16"), (8, 0, "segments: given 0")],
)
def test_digits_and_segments_out_of_range_are_refused(digits: int, segments: int, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        ShootingProblem(Chain(2, 1.0, 0.3, 1.0).gauge_model(), digits, QUARTER, segments)


# Families -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [pytest.param("newton", marks=pytest.mark.slow), "ipopt"])
def test_a_family_agrees_with_that_of_odd_cosines_within_its_errors(kind: str) -> None:
    chain, at = Chain(2, 1.0, 0.25, -1.0), (0.5, 1.5)
    found = follow_family(chain, 1, 1.5, at=at, transcription="shooting", corrector=kind)
    exact = follow_family(chain, 1, 1.5, at=at, tolerance=1e-12, corrector="newton")
    assert found.complete
    for S in at:
        a, b = found.at(S), exact.at(S)
        assert a.Omega == pytest.approx(b.Omega, rel=1e-8)
        assert abs(a.Omega - b.Omega) <= a.point.error.relative(a.Omega) * a.Omega
        assert np.abs(a.profile - b.profile).max() <= 1e-8 * np.abs(b.profile).max()
        assert a.Omega_shift == pytest.approx(b.Omega_shift, abs=1e-8)
    for orbit in found.orbits:
        assert orbit.point.error.relative(orbit.Omega) <= 1e-8


@pytest.mark.slow
def test_two_folds_are_passed_as_odd_cosines_pass_them() -> None:
    folds = []
    for name in ("shooting", "trigonometric"):
        request = family_request(
            Chain(4, 1.0, 0.2, -1.0), 1, 8.0, tolerance=1e-6, transcription=name, corrector="newton"
        )
        S: list[float] = []
        for result in Following(Family(request)):
            assert isinstance(result, Orbit)
            S.append(result.S)
            turns = np.flatnonzero(np.diff(np.sign(np.diff(S))) != 0)
            if turns.size == 2:
                break
        folds.append([S[i + 1] for i in turns])
    assert len(folds[0]) == 2
    np.testing.assert_allclose(folds[0], folds[1], atol=2e-3)  # the points next to a fold are not the fold
    assert folds[0][0] > 3.9 > 2.3 > folds[0][1]


@pytest.mark.slow
@pytest.mark.parametrize("S", [0.2, pytest.param(1.0, marks=pytest.mark.slow)])
def test_stability_along_shot_orbits_is_that_of_the_others(S: float) -> None:
    chain = Chain(3, 1.0, 0.25, -1.0)
    mus = []
    for name in ("shooting", "trigonometric"):
        orbit = follow_family(chain, 1, S, at=(S,), transcription=name, corrector="newton", stability=True).at(S)
        mus.append(np.sort(orbit.floquet().mu.real))
    np.testing.assert_allclose(mus[0], mus[1], atol=1e-6)


def test_a_tolerance_out_of_reach_ends_the_family_by_name() -> None:
    chain = Chain(2, 1.0, 0.25, -1.0)
    within = follow_family(chain, 1, 0.5, tolerance=1e-10, transcription="shooting", corrector="newton")
    assert within.complete
    beyond = follow_family(chain, 1, 0.5, tolerance=1e-13, transcription="shooting", corrector="newton")
    told = all(o.point.at_round_off or o.point.error.relative(o.Omega) <= 1e-13 for o in beyond.orbits)
    assert told
    assert beyond.complete or beyond.end is End.RESOLUTION


def test_a_corrector_is_not_asked_for_less_than_the_noise() -> None:
    tools = Family(family_request(Chain(2, 1.0, 0.3, 1.0), 1, 1.0, tolerance=1e-6, transcription="shooting"))
    assert tools.levels.resolutions == CVODES_DIGITS
    assert CVODES_DIGITS[-3:] == (12, 14, 15)
    newton = Family(
        replace(tools.request, method=replace(tools.request.method, corrector="newton"), tolerance=1e-10)
    ).levels
    assert newton.resolutions == (12, 14, 15)
    corrector = newton.corrector(ShootingProblem(tools.coordinates.scaled, 9, QUARTER))
    assert isinstance(corrector, NewtonCorrector)
    assert corrector.tolerance == pytest.approx(1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("S", [0.2, pytest.param(1.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("symmetry", [HALF, pytest.param(FULL, marks=pytest.mark.slow)])
def test_a_larger_part_of_the_period_gives_the_same_family(symmetry: SymmetryClass, S: float) -> None:
    chain = Chain(2, 1.0, 0.3, 1.0)
    branches = [
        follow_family(chain, 2, S, at=(S,), transcription="shooting", corrector="newton", symmetry=kind)
        for kind in (None, symmetry)
    ]
    assert symmetry_class(branches[0].space.coordinates.scaled) is QUARTER
    assert isinstance(branches[1].start.problem, ShootingProblem)
    assert branches[1].start.problem.symmetry is symmetry
    assert branches[1].at(S).Omega == pytest.approx(branches[0].at(S).Omega, rel=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("kind", CORRECTORS)
def test_the_breather_of_twenty_four_sites(kind: str) -> None:
    """Omega from odd cosines at tolerance 1e-12."""
    known = {0.2: 1.036393147166972, 1.0: 1.018532435491958, 3.0: 0.765958900020734}
    branch = follow_family(
        Chain(24, 1.0, 0.25, -1.0), 1, 3.0, at=tuple(known), tolerance=1e-9, transcription="shooting", corrector=kind
    )
    assert branch.complete
    for S, Omega in known.items():
        orbit = branch.at(S)
        assert orbit.Omega == pytest.approx(Omega, rel=1e-9)
        assert abs(orbit.Omega - Omega) <= orbit.point.error.relative(Omega) * Omega
