"""Guesses of orbits that close after another time than the one stated."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import casadi as ca
import numpy as np
import pytest
from marks import slow
from scipy.optimize import root

from casadi_skin.follow.find import find_orbit
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.orbit import OrbitRequest, over_its_own_period

TWO_PI, ZERO = 2.0 * np.pi, np.zeros(2)
NAMES = ("x", "y")


def cosines(t: float) -> list[float]:
    return [2.0 * np.cos(t), -2.0 * np.sin(t)]


@pytest.mark.parametrize("guess", [cosines, {"x": lambda t: 2.0 * np.cos(t), "y": lambda t: -2.0 * np.sin(t)}])
def test_a_function_is_taken_over_the_time_after_which_it_closes(guess: Any) -> None:
    taken: Any = over_its_own_period(guess, NAMES, 6.6, ZERO)
    for turn in (0.0, 0.3, 1.0):
        np.testing.assert_allclose(taken(6.6 * turn), cosines(TWO_PI * turn), rtol=0, atol=1e-8)


def test_what_rotates_closes_but_for_its_rotation() -> None:
    taken: Any = over_its_own_period(
        lambda t: [t + 0.1 * np.sin(t), 2.0 * np.cos(t)], NAMES, 6.0, np.array([TWO_PI, 0.0])
    )
    np.testing.assert_allclose(np.subtract(taken(6.0), taken(0.0)), [TWO_PI, 0.0], rtol=0, atol=1e-8)


def test_a_state_that_does_not_move_has_no_part_in_the_reference_of_the_phase() -> None:
    """Its rounding gave twelve harmonics to a circle; a small state that moves keeps its own."""
    model = OdeModel("three", list(ca.SX.sym("x", 3).elements()), [0.0, 0.0, 0.0])
    for third, harmonics in ((lambda t: 0.7, 1), (lambda t: 1e-12 * np.cos(3.0 * t), 3)):
        guess = partial(lambda w, t: [*cosines(t), w(t)], third)
        request = OrbitRequest(model, TWO_PI, 1, {}, np.zeros(3), guess)
        assert len(request.reference.coefficients) == harmonics
        np.testing.assert_allclose(request.reference.along(np.array([0.2]))[0], guess(0.2 * TWO_PI), atol=1e-14)


def line(t: float) -> list[float]:
    return [t, 1.0]


def ends(t: float) -> list[float]:
    if t > 6.6:
        raise ValueError("no data")
    return [2.0 * np.cos(t), 0.0]


@pytest.mark.parametrize(
    ("guess", "period"),
    [
        (cosines, TWO_PI),  # which closes as it is
        (cosines, 3.0),  # and far from the stated time
        (line, 6.6),  # which closes nowhere
        (ends, 6.6),
        (lambda t: [np.nan, 1.0 + t], 6.6),
        ([1.0, 2.0], 6.6),
        (([0.0, 6.6], [[1.0, 2.0], [1.5, 2.0]]), 6.6),
        ({"x": 1.0}, 6.6),
        ({"z": np.cos}, 6.6),  # refused where it is sampled
    ],
)
def test_other_guesses_stay_as_they_are(guess: Any, period: float) -> None:
    assert over_its_own_period(guess, NAMES, period, ZERO) is guess


def ring(units: int, stiffness: Any = 1.0, turns: int = 1) -> tuple[OdeModel, Callable[[float], Any]]:
    """Van der Pol oscillators in a ring, and a wave of cosines around it."""
    x, y = ca.SX.sym("x", units), ca.SX.sym("y", units)
    beside = ca.vertcat(x[-1], x[:-1]) + ca.vertcat(x[1:], x[0]) - 2 * x
    model = OdeModel("ring", ca.vertcat(x, y), ca.vertcat(y, 0.5 * (1 - x**2) * y - stiffness * x + 0.1 * beside))
    phases = TWO_PI * turns * np.arange(units) / units
    return model, lambda t: np.concatenate([2 * np.cos(t - phases), -2 * np.sin(t - phases)])


def period_of_the_wave(units: int) -> float:
    """The period by harmonic balance of one oscillator, whose neighbours are itself a part of the period away."""
    M = 128
    order = np.fft.fftfreq(M, 1.0 / M)
    coupling = 0.2 * (np.cos(TWO_PI * order / units) - 1.0)

    def defects(unknowns: Any) -> Any:
        X, Omega = unknowns[:M], unknowns[M]
        c = np.fft.fft(X)
        slope, curvature, beside = (
            np.fft.ifft(f * c).real for f in (1j * Omega * order, -((Omega * order) ** 2), coupling)
        )
        return np.append(curvature - 0.5 * (1 - X**2) * slope + X - beside, slope[0])

    found = root(defects, np.append(2.0 * np.cos(TWO_PI * np.arange(M) / M), 1.0), tol=1e-13)
    assert np.max(np.abs(found.fun)) < 1e-10
    return float(TWO_PI / found.x[M])


@pytest.mark.parametrize("units", [8, slow(100)])
def test_a_wave_is_found_from_cosines_of_another_period(units: int) -> None:
    """Of 100 oscillators from cosines that jump at the end of the period neither Newton's method nor Ipopt finds it."""
    model, guess = ring(units)
    orbit = find_orbit(model, guess, 6.4, tolerance=1e-8)
    assert orbit.period == pytest.approx(period_of_the_wave(units), abs=1e-7)
    wave = orbit.evaluate(np.array([0.0, orbit.period / units]))
    np.testing.assert_allclose(wave[1, :units], np.roll(wave[0, :units], 1), rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("units", "spread", "seed", "period"),
    [(10, 0.001, 0, 6.373235), (10, 0.005, 1, 6.357597), slow(25, 0.005, 1, 6.319568)],
)
def test_detuned_oscillators_are_found_in_step(units: int, spread: float, seed: int, period: float) -> None:
    """Periods by shooting from the state in which the motion from the guess is at time 2000."""
    detuned = 1.0 + spread * np.random.default_rng(seed).standard_normal(units)
    orbit = find_orbit(*ring(units, ca.DM(detuned), turns=0), 6.4, tolerance=1e-8)
    assert orbit.period == pytest.approx(period, abs=1e-6)
