"""Breathers from the anticontinuous limit: Marin and Aubry's chain with a Morse potential on each site (1996)."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_models import oscillation

from casadi_skin import OdeModel, find_orbit
from casadi_skin.follow.branch import End
from casadi_skin.follow.solution import Orbit

SITES, FREQUENCY = 11, 0.8


def morse(units: np.ndarray) -> OdeModel:
    """y'' = -(1 - exp(-y)) exp(-y) + C (y_left - 2 y + y_right), free ends, positions in units of their own."""
    q, w, C = ca.SX.sym("q", SITES), ca.SX.sym("w", SITES), ca.SX.sym("C")
    y, v = q / units, w / units
    bonds = y[1:] - y[:-1]
    potential = 0.5 * ca.sumsqr(1 - ca.exp(-y)) + 0.5 * C * ca.sumsqr(bonds)
    force = -(1 - ca.exp(-y)) * ca.exp(-y) + C * (ca.vertcat(bonds, 0) - ca.vertcat(0, bonds))
    return OdeModel(
        "morse", q, units * force, C, order=2, velocity=w, hamiltonian=0.5 * ca.sumsqr(v) + potential,
        reversal=[1] * SITES + [-1] * SITES,
    )  # fmt: skip


def one_site() -> tuple[float, Callable[[float], np.ndarray]]:
    """Amplitude and course (y, v) of one site with the frequency sqrt(1 - 2 E)."""
    top = float(-np.log(1.0 - np.sqrt(1.0 - FREQUENCY**2)))
    period = 2.0 * np.pi / FREQUENCY
    course = solve_ivp(
        lambda t, s: [s[1], -(1 - np.exp(-s[0])) * np.exp(-s[0])], (0.0, period), [top, 0.0],
        rtol=1e-12, atol=1e-12, dense_output=True,
    )  # fmt: skip
    return top, lambda t: np.asarray(course.sol(t % period))


def at_the_limit(units: np.ndarray) -> Orbit:
    """The orbit of the middle site alone, at C = 0."""
    top, course = one_site()
    model, middle = morse(units), SITES // 2

    def guess(t: float) -> np.ndarray:
        found = np.zeros((2, SITES))
        found[:, middle] = units[middle] * course(t)
        return found.ravel()

    select = model.state[middle] / units[middle] - top
    return find_orbit(model, guess, 2.0 * np.pi / FREQUENCY, parameters={"C": 0.0}, select=select, symmetric=True)


@pytest.mark.parametrize("seed", [None, 1])
def test_tails_do_not_govern_the_steps(seed: int | None) -> None:
    """By the sizes of all sites there were 257 points; the same number in any units."""
    units = np.ones(SITES) if seed is None else 10.0 ** np.random.default_rng(seed).uniform(-4.0, 4.0, SITES)
    branch = at_the_limit(units).follow("C", 0.15)
    assert branch.end is End.REACHED
    assert len(branch) == 14
    found = branch.solutions[-1].evaluate(0.0)[:SITES] / units
    assert 0.1 * found[SITES // 2] < found[SITES // 2 + 1] < 0.9 * found[SITES // 2]


@pytest.mark.parametrize("fixed", ["period", "frequency"])
def test_breathers_are_followed_at_their_period(fixed: str) -> None:
    """The value of the middle site at C = 0.1 from a harmonic balance of high order."""
    branch = at_the_limit(np.ones(SITES)).follow("C", 0.15, at=[0.1], fixed=fixed)
    assert branch.end is End.REACHED
    assert len(branch) <= 18
    np.testing.assert_allclose(branch["period"], 2.0 * np.pi / FREQUENCY, rtol=1e-13)
    assert branch.at(C=0.1).evaluate(0.0)[SITES // 2] == pytest.approx(1.65197717, abs=2e-8)


def test_a_period_that_is_the_orbits_own_is_not_held() -> None:
    cycle = oscillation()
    with pytest.raises(ValueError, match="fixed: given with a solution whose period is its own; accepted: an orbit"):
        cycle.follow("mu", 2.0, fixed="period")
    with pytest.raises(ValueError, match="fixed: given 'energy'; accepted: period, frequency"):
        cycle.follow("mu", 2.0, fixed="energy")
