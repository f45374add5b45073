"""The example scripts of boundary-value problems and of orbits of any model, each against an independent number."""

from __future__ import annotations

import numpy as np
import pytest
from outputs import RunExample, load
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

pytestmark = pytest.mark.slow


def test_bratu_fold(run_example: RunExample) -> None:
    branch = run_example("bratu_fold")
    assert [round(fold["lambda"], 9) for fold in branch.folds] == [3.513830719]  # Bratu 1914: 8 (z^2 - 1), z tanh z = 1
    for which, bracket in enumerate(((0.0, 4.5), (4.5, 20.0))):  # u(1/2) = 2 log cosh(theta/4), lambda = 1
        theta = brentq(lambda z: z - np.sqrt(2.0) * np.cosh(z / 4.0), *bracket, xtol=1e-15)
        assert abs(branch.at(1.0, which).evaluate(0.5)[0] - 2.0 * np.log(np.cosh(theta / 4.0))) < 1e-7


def test_reaction_diffusion(run_example: RunExample) -> None:
    """Where the trace of the reaction with an eigenvalue of the second differences vanishes."""
    cells, (A, B, D) = 60, (2.0, 5.45, 0.012)
    branch = run_example("reaction_diffusion", cells)
    kappa = 4.0 * (cells + 1) ** 2 * np.sin(0.5 * np.pi * np.arange(1, 4) / (cells + 1)) ** 2
    exact = np.sqrt(D * kappa / (B - 1.0 - A**2))
    np.testing.assert_allclose([point.parameters["L"] for point in branch.special_points], exact, rtol=1e-10)
    assert all(point.criticality == "supercritical" for point in branch.special_points)
    assert branch.solutions[-1].unstable == 6


def test_oscillating_reaction(run_example: RunExample) -> None:
    """From the Hopf point of `test_reaction_diffusion`, with few multipliers and a bound of the others."""
    cells = 60
    branch = run_example("oscillating_reaction", cells, 4)
    kappa = 4.0 * (cells + 1) ** 2 * np.sin(0.5 * np.pi / (cells + 1)) ** 2
    assert abs(branch.values[0] - np.sqrt(0.012 * kappa / (5.45 - 1.0 - 4.0))) < 1e-10
    found = [orbit.floquet() for orbit in branch.orbits[1:]]
    assert all(one.stable and one.multipliers.size < 12 and one.beyond < 0.2 for one in found)


def test_turning_orbits(run_example: RunExample) -> None:
    """Both sides of the separatrix end at E = 1; Melnikov's integral gives the junction's end, 4 c/pi for small c."""
    swings, turns, carries = run_example("turning_orbits")
    assert [branch.special_points[0].kind for branch in (swings, turns, carries)] == [
        "heteroclinic",
        *["homoclinic"] * 2,
    ]
    for branch, side in ((swings, -1), (turns, 1)):
        point = branch.special_points[0]
        assert 0.0 < side * (point.parameters["E"] - 1.0) <= point.error
    assert abs(carries.special_points[0].parameters["I"] - 4.0 * 0.5 / np.pi) < 0.05


def test_van_der_pol(run_example: RunExample) -> None:
    branch = run_example("van_der_pol")
    assert abs(branch.at(1.0).period - 6.6632868593231301897) < 1e-9  # Hairer, Norsett and Wanner 1993, exercise I.16.1
    orbit = branch.at(10.0)
    run = solve_ivp(
        lambda t, s: [s[1], 10 * (1 - s[0] ** 2) * s[1] - s[0]], (0.0, orbit.period), orbit.evaluate(0.0), "DOP853",
        rtol=1e-12, atol=1e-13,
    )  # fmt: skip
    assert np.abs(run.y[:, -1] - orbit.evaluate(0.0)).max() < 1e-6
    assert abs(orbit.period - 19.078369567) < 1e-8


def test_forced_duffing(run_example: RunExample) -> None:
    branch = run_example("forced_duffing")
    for fold in branch.folds:  # where a multiplier is 1
        assert np.abs(fold.floquet().multipliers - 1.0).min() < 1e-3
    assert [branch.at(2.0, which).floquet().stable for which in range(3)] == [True, False, True]
    for which in range(3):
        orbit = branch.at(2.0, which)
        run = solve_ivp(
            lambda t, s: [s[1], -s[0] - s[0] ** 3 - 0.1 * s[1] + 0.5 * np.cos(2.0 * t)], (0.0, np.pi),
            orbit.evaluate(0.0), "DOP853", rtol=1e-12, atol=1e-13,
        )  # fmt: skip
        np.testing.assert_allclose(run.y[:, -1], orbit.evaluate(0.0), atol=1e-6)


def test_lyapunov_orbit(run_example: RunExample) -> None:
    branch = run_example("lyapunov_orbit")
    orbit, mu = branch.at(-1.55), 0.0121505856

    def field(_: float, s: np.ndarray) -> list[float]:
        x, y, u, v = s
        r1, r2 = ((x + mu) ** 2 + y**2) ** 1.5, ((x - 1 + mu) ** 2 + y**2) ** 1.5
        return [u, v, 2 * v + x - (1 - mu) * (x + mu) / r1 - mu * (x - 1 + mu) / r2,
                -2 * u + y - (1 - mu) * y / r1 - mu * y / r2]  # fmt: skip

    # From one crossing at right angles to the other: half a period, no digits lost to the multiplier of 1112.
    run = solve_ivp(field, (0.0, orbit.period / 2), orbit.evaluate(0.0), "DOP853", rtol=1e-12, atol=1e-13)
    assert np.abs(run.y[[1, 2], -1]).max() < 1e-7
    assert abs(orbit.period - 3.1237510090) < 1e-8


def test_boundary_layer(run_example: RunExample) -> None:
    example = load("boundary_layer")
    found = run_example("boundary_layer")
    for solution in found:
        assert example.true_error(solution) <= solution.error <= 1e-7
        assert solution.intervals <= 60
    assert found[-1]["eps"] == 1e-6


def test_colpitts(run_example: RunExample) -> None:
    branches, chaos = run_example("colpitts")
    (hopf,), *doublings = (branch.special_points for branch in branches)
    R = 2**0.5 / 1.4
    assert abs(hopf.parameters["bias"] - 2.0 * R) < 1e-12
    assert abs(hopf.frequency - 2.0**0.5) < 1e-12  # s^3 + R s^2 + 2 s + I = 0
    found = [point.parameters["bias"] for (point,) in doublings]
    assert found == pytest.approx([4.1103451502505, 4.8331660136020, 5.0006010754211], abs=1e-11)  # of the ODE

    def field(_: float, s: np.ndarray) -> list[float]:
        collector, emitter, coil = s
        through = 1e-3 * np.exp(-emitter)
        slope = coil - 5.5
        return [slope + coil - through, slope, 5.0 - R * coil - collector]

    start, times = chaos.states[0, 2:5], chaos.t[:501]  # 10 units of time: nearby motions part later
    run = solve_ivp(field, (0.0, times[-1]), start, "DOP853", times, rtol=1e-11, atol=1e-12)
    assert np.abs(run.y.T - chaos.states[:501, 2:5]).max() < 1e-5
    assert np.abs(chaos.states[:, 0] - 5.0).max() < 1e-9
