"""The examples of designs, each with its number pinned and beside a method that uses no gradients of located orbits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from outputs import load
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, minimize_scalar

from casadi_skin import Chain, follow_family

pytestmark = pytest.mark.slow


def test_hardest_breather() -> None:
    example = load("design_hardest_breather")
    result = example.main()
    assert result.reason.startswith("found an optimum inside its bounds")
    assert abs(result["gamma"] - 0.663154498) < 1e-8
    assert abs(result["S"] - 0.961039022) < 1e-8
    plain = minimize_scalar(lambda gamma: -example.threshold(gamma), bounds=(0.5, 0.8), method="bounded")
    assert abs(plain.x - result["gamma"]) < 1e-4
    assert abs(-plain.fun - result["S"]) < 1e-7
    assert abs(example.threshold(result["gamma"]) - result["S"]) < 1e-7


def test_steady_breather(tmp_path: Path) -> None:
    example = load("design_steady_breather")
    result = example.main()
    assert result.reason.startswith("found an optimum inside its bounds")
    assert abs(result["gamma"] - 0.608631688) < 1e-8
    assert abs(result.value - 0.010172216308) < 1e-11
    plain = minimize_scalar(example.slope, bounds=(0.5, 0.7), method="bounded", options={"xatol": 1e-6})
    assert abs(plain.x - result["gamma"]) < 1e-4
    assert abs(plain.fun - result.value) < 1e-8


def test_energy_cusp() -> None:
    example = load("design_energy_cusp")
    result = example.main()
    assert result.reason.startswith("found an optimum inside its bounds")
    assert abs(result["gamma"] - 0.155799013) < 1e-8
    assert abs(result["S"] - 0.839682703) < 1e-7
    assert 0.14 < result["gamma"] < 0.16

    def least(gamma: float) -> float:
        """Least dE/dS between S = 0.7 and 1, a parabola through three of its values."""
        S = np.array([0.8, 0.84, 0.88])
        a, b, c = np.polyfit(S, example.energy_slope(gamma, S), 2)
        return float(c - b**2 / (4 * a))

    assert abs(brentq(least, 0.15, 0.16, xtol=1e-8) - result["gamma"]) < 1e-5


def test_first_instability() -> None:
    """The edge watched at first alone is at S = 2.06 where the family is unstable from 1.54 on."""
    example = load("design_first_instability")
    result = example.main()
    assert result.found
    assert len(result.located) == 2
    assert abs(result["gamma"] - 0.3575000) < 1e-6
    first = [example.family(result["gamma"] + off).changes[0].S for off in (0.0, -0.01, 0.01)]
    assert abs(result.value - first[0]) < 1e-8
    assert result.value > max(first[1:])


def test_pareto_front() -> None:
    front = load("design_pareto").main(points=4)
    assert front.complete
    assert len(front.points) == 4
    assert abs(front.values[0, 0] - 9.89180544) < 1e-7  # exactly at the end, where Ipopt had needed some room
    assert abs(front.values[-1, 0] - 1.194783879) < 1e-6
    rng = np.random.default_rng(1)
    for gamma, alpha in rng.uniform((0.1, 0.5), (0.75, 2.0), (12, 2)):  # chains at random lie behind the front
        profile = follow_family(Chain(24, alpha, gamma, 1.0), "last", 1.0, at=[1.0]).at(S=1.0).profile
        amplification = 23 * np.arctanh(gamma)
        next_worse = front.values[front.values[:, 1] >= amplification]
        assert 1 / np.sum(profile**4) > next_worse[0, 0]


def test_uneven_chain() -> None:
    example = load("design_uneven_chain")
    result = example.main()
    assert result.found
    assert abs(result.value - 0.0741861680) < 1e-8
    assert 0.7 <= result["alpha_n"].min() < result["alpha_n"].max() <= 1.3
    for orbit in result.located:  # the equations of motion over one period, by an integrator
        couple = np.diag(np.full(23, 1.25), -1) + np.diag(np.full(23, 0.75), 1) - np.diag(2 + result["alpha_n"])

        def field(_: float, x: np.ndarray, couple: np.ndarray = couple) -> np.ndarray:
            return np.concatenate([x[24:], couple @ x[:24] - x[:24] ** 3])

        start = np.concatenate([orbit.profile, np.zeros(24)])
        end = solve_ivp(field, (0.0, 2 * np.pi / 2.2), start, "DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        np.testing.assert_allclose(end, start, rtol=0, atol=1e-8)


def test_hopf_point() -> None:
    """Along the curve of closed form on which the Hopf point is at r = 30 no change is smaller."""
    example = load("design_hopf_point")
    result = example.main()

    def least(sigma: float) -> float:
        beta = brentq(lambda b: example.hopf_of(sigma, b) - 30.0, 1.0, 6.0, xtol=1e-14)
        return (sigma / 10.0 - 1.0) ** 2 + (beta * 3.0 / 8.0 - 1.0) ** 2

    plain = minimize_scalar(least, bounds=(7.0, 11.0), method="bounded", options={"xatol": 1e-8})
    assert result.active == ("r >= 30",)
    assert abs(result.value - plain.fun) < 1e-9
    assert abs(result["sigma"] - plain.x) < 1e-4
