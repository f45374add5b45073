"""Multiple shooting with CVODES: derivatives, exact and independent orbits, errors, failures, families."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from orbit_problems import (
    corrector_of,
)

from casadi_skin.follow.family import CVODES_DIGITS, Family
from casadi_skin.follow.follow import follow_family
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.closed_forms import duffing_frequency
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.levels import Levels
from casadi_skin.solve.newton import NewtonCorrector, Status
from casadi_skin.zero.family import family_request
from casadi_skin.zero.problem import SingularError
from casadi_skin.zero.settings import End
from casadi_skin.zero.shooting import ShootingError, ShootingProblem

Array = NDArray[np.float64]
QUARTER, HALF, FULL = SymmetryClass.QUARTER, SymmetryClass.HALF, SymmetryClass.FULL


# Equations ------------------------------------------------------------------------------------------------------------


def test_the_size_of_the_states_does_not_change_what_digits_mean() -> None:
    """A linear oscillator in other units: the residual scales to round-off, as local tolerances are relative."""
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p")
    model = OdeModel("linear", q, -(1 + p) * q, p, 2, v, reversal=(1, -1), half_period=(-1, -1), normalisation=q - 1)
    problem = ShootingProblem(model, 6, QUARTER, 2)
    z = problem.pack(np.ones(1), 1.2, 0.0)
    scaled = np.concatenate([1e-9 * z[: problem.states], z[problem.states :]])
    expected, found = problem.evaluate(z)[0][:4], problem.evaluate(scaled)[0][:4]
    np.testing.assert_allclose(1e9 * found, expected, rtol=0, atol=1e-13)


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
        guess = problem.pack(exact.problem.sample(exact.z, np.zeros(1))[0], orbit.Omega, exact.parameter)
        correction = levels.corrector(problem).correct(guess, problem.parameter_row(), exact.parameter)
        if not correction.converged:
            continue
        theta = 0.5 * np.pi * np.arange(problem.segments + 1) / problem.segments
        positions = correction.z[: problem.states].reshape(problem.segments + 1, -1)[:, : model.size]
        profile = np.abs(positions - exact.problem.sample(exact.z, theta)).max() / np.abs(positions).max()
        Omega = abs(correction.z[problem.Omega_index] - orbit.Omega) / orbit.Omega
        found.append((levels.refined(problem, correction.z)[0].relative(orbit.Omega), max(profile, Omega)))
    return found


def cases(seed: int, count: int) -> Iterator[tuple[Chain, int, float]]:
    """Random chains with a mode and an amplitude."""
    generator = np.random.default_rng(seed)
    for _ in range(count):
        sites, alpha, gamma = int(generator.integers(1, 9)), generator.uniform(0.2, 3), generator.uniform(-0.6, 0.6)
        chain = Chain(sites, alpha, gamma, generator.choice([-1.0, 1.0]))
        S = 10 ** generator.uniform(-1, 0.5 if chain.g > 0 else -0.2)
        yield chain, int(generator.integers(1, sites + 1)), S


@pytest.mark.parametrize(
    ("chain", "mode", "S", "most"),
    [
        (Chain(3, 1.0, 0.3, -1.0), 1, 1.0, 30.0),
        (Chain(4, 0.5, 0.2, 1.0), 3, 3.0, 30.0),
        *(pytest.param(*case, np.inf, marks=pytest.mark.slow) for case in cases(5, 14)),
    ],
)
def test_the_estimated_error_covers_the_true_one(chain: Chain, mode: int, S: float, most: float) -> None:
    digits = (6, *CVODES_DIGITS) if most < np.inf else CVODES_DIGITS
    found = estimates(chain, mode, S, digits)
    assert len(found) == len(digits) - 1 or most == np.inf
    assert found
    for estimated, true in found:
        assert true <= estimated <= most * true


def test_paths_between_ends_of_segments_are_off_by_rounding_alone() -> None:
    """q'' = -(100 + p) q from exact ends of segments: interpolants of full steps are off by 1e-13."""
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p")
    model = OdeModel("fast", q, -(100 + p) * q, p, 2, v, reversal=(1, -1), half_period=(-1, -1), normalisation=q - 1)
    problem, theta = ShootingProblem(model, 14, QUARTER), np.linspace(0.0, 0.5 * np.pi, 97)
    found = problem.sample(problem.pack(np.ones(1), 10.0, 0.0), theta)[:, 0]
    np.testing.assert_allclose(found, np.cos(theta), rtol=0, atol=5e-15)


def test_errors_of_positions_are_relative_to_positions_and_paths_count_to_their_ends() -> None:
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p")
    model = OdeModel("fast", q, -(100 + p) * q, p, 2, v, reversal=(1, -1), half_period=(-1, -1), normalisation=q - 1)
    problem = ShootingProblem(model, 14, QUARTER, 2)
    z, step, between = problem.pack(np.ones(1), 10.0, 0.0), np.zeros(problem.size), np.zeros(4)
    step[2:4] = 1e-9, 2e-9
    assert problem.profile_change(z, step) == pytest.approx(1e-9, rel=1e-12)  # velocities are up to 10
    between[0] = -2e-9
    assert problem.profile_change(z, step, between) == pytest.approx(3e-9, rel=1e-12)


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


def test_what_fails_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """A path between two segments' starts; and sensitivities, though the state is there."""
    problem, z = escaping(Chain(1, 1.0, 0.0, -1.0))
    with pytest.raises(ShootingError, match="cannot be followed: required step size"):
        problem.sample(z, np.array([1.0]))
    z = problem.pack(np.ones(1), 1.6, -1.0)
    problem.evaluate(z)

    def fail(**_: ca.DM) -> None:
        raise RuntimeError('Error in Function\n.../cvodes.cpp:403: CVode returned "CV_ERR_FAILURE". Consult it.')

    monkeypatch.setattr(problem, "_variational", fail)
    with pytest.raises(ShootingError, match=r"cvodes returned CV_ERR_FAILURE$"):
        problem.evaluate(z)
    refused = {(2, 1): "digits: given 2", (16, 1): "digits: given 16", (8, 0): "segments: given 0"}
    for (digits, segments), words in refused.items():
        with pytest.raises(ValueError, match=words):
            ShootingProblem(problem.model, digits, QUARTER, segments)


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


# Families -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("chain", "mode", "at", "kind", "symmetry"),
    [
        (Chain(2, 1.0, 0.25, -1.0), 1, (0.5, 1.5), "ipopt", None),
        pytest.param(Chain(3, 1.0, 0.25, -1.0), 1, (0.5, 1.0), "newton", None, marks=pytest.mark.slow),
        pytest.param(Chain(2, 1.0, 0.3, 1.0), 2, (0.2, 1.0), "newton", HALF, marks=pytest.mark.slow),
        pytest.param(Chain(2, 1.0, 0.3, 1.0), 2, (0.2, 1.0), "newton", FULL, marks=pytest.mark.slow),
        pytest.param(Chain(24, 1.0, 0.25, -1.0), 1, (0.2, 1.0, 3.0), "newton", None, marks=pytest.mark.slow),
        pytest.param(Chain(24, 1.0, 0.25, -1.0), 1, (0.2, 1.0, 3.0), "ipopt", None, marks=pytest.mark.slow),
    ],
)
def test_a_family_is_that_of_odd_cosines_within_its_errors(
    chain: Chain, mode: int, at: tuple[float, ...], kind: str, symmetry: SymmetryClass | None
) -> None:
    """Frequencies, profiles, and multipliers; on a quarter of the period or more."""
    options: dict[str, Any] = {"transcription": "shooting", "corrector": kind, "symmetry": symmetry}
    found = follow_family(chain, mode, at[-1], at=at, tolerance=1e-9, **options)
    exact = follow_family(chain, mode, at[-1], at=at, tolerance=1e-12, corrector="newton")
    assert found.complete
    assert found.start.problem.symmetry is (symmetry or QUARTER)
    for S in at:
        a, b = found.at(S), exact.at(S)
        assert a.Omega == pytest.approx(b.Omega, rel=1e-9)
        assert abs(a.Omega - b.Omega) <= a.point.error.relative(a.Omega) * a.Omega
        assert np.abs(a.profile - b.profile).max() <= 1e-8 * np.abs(b.profile).max()
        assert a.Omega_shift == pytest.approx(b.Omega_shift, abs=1e-8)
        if chain.sites < 4:
            np.testing.assert_allclose(np.sort(a.floquet().mu.real), np.sort(b.floquet().mu.real), atol=1e-6)
    for orbit in found.orbits:
        assert orbit.point.error.relative(orbit.Omega) <= 1e-9


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
