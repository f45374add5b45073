"""Large systems and detuned rings, in dense 193 x 193 solves.

Run with `pytest -m benchmark -s tests/benchmarks/test_large_speed.py`, one thread.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from casadi_skin import OdeModel, find_equilibrium, find_orbit
from casadi_skin.stability.result import LostMultiplierWarning

pytestmark = pytest.mark.benchmark


def shown(name: str, unit: float, aim: float, act: Callable[[], Any], repeats: int = 1) -> Any:
    """Print the least time of the processor as units, of calls after one that is not counted if there are several."""
    times = []
    for _ in range(repeats if repeats == 1 else repeats + 1):
        started = time.process_time()
        found = act()
        times.append(time.process_time() - started)
    print(f"\n  {name:<60} {min(times[-repeats:]) / unit:9.0f} units  (aim {aim:g})")
    return found


def brusselator(cells: int) -> OdeModel:
    """Reaction and diffusion on an interval whose ends are held at (2, B/2)."""
    u, v, B = ca.SX.sym("u", cells), ca.SX.sym("v", cells), ca.SX.sym("B")
    rates = (cells + 1) ** 2 * np.array([8e-3, 4e-3])

    def spread(x: ca.SX, end: Any) -> ca.SX:
        return ca.vertcat(end, x[:-1]) + ca.vertcat(x[1:], end) - 2 * x

    f = 2 - (B + 1) * u + u**2 * v + rates[0] * spread(u, 2.0)
    g = B * u - u**2 * v + rates[1] * spread(v, B / 2)
    return OdeModel("Brusselator", ca.vertcat(u, v), ca.vertcat(f, g), B)


def rest(cells: int) -> Any:
    return find_equilibrium(brusselator(cells), [2.0] * cells + [2.0] * cells, parameters={"B": 4.0})


def test_multipliers_of_200_states(unit: float) -> None:
    (hopf, *_) = [p for p in rest(100).follow("B", 6.0).special_points if p.kind == "hopf"]
    orbit = hopf.follow("B", hopf.parameters["B"] + 0.05, max_points=3).orbits[-1]
    with warnings.catch_warnings():  # the smallest of 200 are not resolved
        warnings.simplefilter("ignore", LostMultiplierWarning)
        multipliers = shown("Brusselator of 200 states, multipliers with errors", unit, 2500.0, lambda: orbit.floquet())
    assert abs(multipliers.multipliers[np.argmin(abs(multipliers.multipliers - 1.0))] - 1.0) < 1e-4


def test_equilibria_of_400_states(unit: float) -> None:
    start = rest(200)
    branch = start.follow("B", 5.0)
    points = len(branch.values)
    shown(f"Brusselator of 400 states, {points} equilibria", unit, 100.0 * points, lambda: start.follow("B", 5.0))


@pytest.mark.parametrize(("units", "aim"), [(10, 2000.0), (25, 4000.0)])
def test_a_detuned_ring(unit: float, units: int, aim: float) -> None:
    x, y = ca.SX.sym("x", units), ca.SX.sym("y", units)
    beside = ca.vertcat(x[-1], x[:-1]) + ca.vertcat(x[1:], x[0]) - 2 * x
    squares = 1.0 + 0.001 * np.random.default_rng(1).normal(size=units)
    ring = OdeModel("ring", ca.vertcat(x, y), ca.vertcat(y, 0.5 * (1 - x**2) * y - squares * x + 0.1 * beside))
    phases = 2 * np.pi * np.arange(units) / units
    guess = lambda t: np.concatenate([2 * np.cos(t - phases), -2 * np.sin(t - phases)])  # noqa: E731
    orbit = shown(f"detuned ring of {units}", unit, aim, lambda: find_orbit(ring, guess, 6.4))
    assert 6.0 < orbit.period < 7.0
