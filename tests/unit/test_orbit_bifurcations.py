"""Period doublings, tori and branch points of orbits, and what leaves there, against published values."""

from __future__ import annotations

import warnings

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols

from casadi_skin import Branch, OdeModel, find_equilibrium, find_orbit, simulate
from casadi_skin.stability.result import TrivialMultiplierWarning


def circuit(epsilon: float) -> OdeModel:
    """AUTO-07p's demo `tor`, an electronic circuit; with epsilon = 0.001 `torBPC1` of MatCont."""
    x, y, z, nu = symbols("x y z nu")
    cubic = 0.93358 * (y - x) ** 3
    first = (-(0.5 + nu) * x + 0.5 * y - 0.32858 * x**3 + cubic) / 0.6
    rhs = ca.vertcat(first, 0.5 * x + 0.1 * y - z - cubic, y + epsilon)
    return OdeModel("circuit", ca.vertcat(x, y, z), rhs, nu)


def cycles(epsilon: float, to: float) -> Branch:
    start = find_equilibrium(circuit(epsilon), [0.00125, -0.001, 0.000525], parameters={"nu": -0.9})
    hopf = start.follow("nu", -0.55).special_points[0]
    return hopf.follow("nu", to, stability=True)


@pytest.mark.slow
def test_the_circuit_has_the_fold_the_torus_and_the_period_doubling_of_matcont() -> None:
    """MatCont 7.6, testtorBPC1: fold -0.5844928424, torus -0.5957504, period doubling -0.6146817, with their periods.

    MatCont stops at a torus whose multipliers have the modulus 1.0000054; here it is 1 within the errors.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", TrivialMultiplierWarning)  # the multiplier that passes 1 does so by itself
        points = cycles(0.001, -0.63).special_points
    assert [point.kind for point in points] == ["fold", "torus", "period doubling"]
    published = [(-0.5844928424, 8.411866), (-0.5957504, 8.861099), (-0.6146817, 9.256846)]
    for point, (nu, period), within in zip(points, published, (1e-10, 3e-7, 1e-7), strict=True):
        assert abs(point.parameters["nu"] - nu) < within
        assert point.solution.period == pytest.approx(period, abs=2e-5)
        assert 0.0 < point.error < 1e-12
    fold, torus, doubling = (point.solution for point in points)
    assert abs(np.abs(torus.floquet(flow="cvodes").multipliers[1]) - 1.0) < 1e-5
    assert np.min(np.abs(doubling.floquet(flow="cvodes").multipliers + 1.0)) < 1e-5
    assert np.min(np.abs(fold.floquet().others - 1.0)) < 1e-9
    assert [point.criticality for point in points] == ["quadratic", "subcritical", "supercritical"]


def _cycle(model: OdeModel, r: float) -> object:
    times = np.linspace(0.0, 40.0, 40001)
    return simulate(model, [10.0, 10.0, r], times, parameters={"r": r}).last_cycle()


@pytest.mark.slow
def test_a_symmetric_cycle_loses_its_symmetry_at_a_branch_point() -> None:
    """Without epsilon the circuit is odd: x(t + T/2) = -x(t) up to the branch point alone."""
    branch = cycles(0.0, -0.6)
    fold, point = branch.special_points
    assert (fold.kind, point.kind) == ("fold", "branch point")
    other = point.follow("nu", -0.6, stability=True)
    assert other.complete
    assert point.lost == ("half-period symmetry in x, y, z",)
    for orbit, symmetric in ((branch.orbits[-1], True), (other.orbits[-1], False)):
        t = np.linspace(0.0, orbit.period, 50)
        odd = np.max(np.abs(orbit.evaluate(t) + orbit.evaluate(t + 0.5 * orbit.period)))
        assert (odd < 1e-6) == symmetric
    assert [special.kind for special in other.special_points] == ["torus"]


@pytest.mark.slow
def test_a_forced_oscillator_doubles_its_period() -> None:
    """Duffing's two wells: the orbit of twice the forcing's period is one of the simulation beyond the doubling."""
    x, y, F, t = symbols("x y F t")
    rhs = ca.vertcat(y, x - x**3 - 0.25 * y + F * ca.cos(t))
    model = OdeModel("two wells", ca.vertcat(x, y), rhs, F, time=t, forcing_period=2 * np.pi)
    orbit = find_orbit(model, lambda s: [1.0, 0.0], parameters={"F": 0.1})
    points = orbit.follow("F", 0.36, stability=True).special_points
    doubling = next(point for point in points if point.kind == "period doubling")
    F_at = doubling.parameters["F"]
    doubled = doubling.follow("F", F_at + 0.003, stability=True)
    last = doubled.orbits[-1]
    assert last.period == pytest.approx(4.0 * np.pi, rel=1e-12)
    times = 2.0 * np.pi * np.arange(202)
    F_end = last.parameters["F"]
    evolution = simulate(model, last.evaluate(0.0) + 1e-3, times, parameters={"F": F_end}, tolerance=1e-9)
    known = last.evaluate([0.0, 2.0 * np.pi])
    assert min(np.max(np.abs(evolution.states[-2] - state)) for state in known) < 1e-4
    assert np.max(np.abs(evolution.states[-2] - evolution.states[-1])) > 1e-2
