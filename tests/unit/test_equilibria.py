"""An equilibrium is not an orbit: what has come to rest is refused with where and why, whatever found it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from small_models import oscillation, van_der_pol

from casadi_skin import OdeModel, find_orbit, simulate
from casadi_skin.follow.space import BoundaryError
from casadi_skin.zero.statement import Statement

SHRUNK = r"this is an equilibrium: the orbit has shrunk to it \(x = .*, y = .*, at mu = 0.3\)"
SINGULAR = "repeat or contradict each other"


def damped(rest: float = 0.0) -> OdeModel:
    """A damped oscillator, which has an equilibrium and no orbit."""
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    return OdeModel("damped", ca.vertcat(x, y), ca.vertcat(y, -mu * y - (x - rest) - (x - rest) ** 3), mu)


@pytest.mark.parametrize(
    ("corrector", "period"),
    [("newton", 3.0), ("newton", 6.3), ("ipopt", 6.3), pytest.param("ipopt", 3.0, marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("tolerance", [1e-4, pytest.param(1e-8, marks=pytest.mark.slow)])
def test_an_orbit_that_shrinks_to_an_equilibrium_is_none(period: float, tolerance: float, corrector: str) -> None:
    turn = 2 * np.pi / period
    options = {"parameters": {"mu": 0.3}, "tolerance": tolerance, "corrector": corrector}
    with pytest.raises(BoundaryError, match=SHRUNK) as failure:
        find_orbit(damped(), lambda t: [np.cos(turn * t), -np.sin(turn * t)], period, **options)
    assert SINGULAR not in str(failure.value)


def test_an_equilibrium_that_meets_the_tolerance_is_no_orbit_either(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the solver hands back is looked at whatever it says of it."""
    solve = Statement.solve

    def at_rest(statement: Statement, guess: object, **options: object) -> object:
        solution = solve(statement, guess, **options)  # type: ignore[arg-type]
        solution.point.z[: solution.problem.states] *= 1e-10
        return solution

    monkeypatch.setattr(Statement, "solve", at_rest)
    with pytest.raises(BoundaryError, match=r"the orbit has shrunk to it \(x = .*, y = .*, at mu = 1\)"):
        oscillation()


@pytest.mark.parametrize("rest", [0.0, 5.0])
def test_a_trajectory_that_has_settled_has_no_cycle(rest: float) -> None:
    settled = simulate(damped(rest), [rest + 1.0, 0.0], np.linspace(0.0, 200.0, 4001), parameters={"mu": 0.3})
    with pytest.raises(ValueError, match="last_cycle: from t = 100 on the state rests: this is an equilibrium"):
        settled.last_cycle()


def test_a_small_cycle_is_one() -> None:
    """Beside a Hopf point: x = sqrt(mu) cos t, y = sqrt(mu) sin t exactly."""
    x, y, mu = (ca.SX.sym(name) for name in ("x", "y", "mu"))
    gain = mu - x**2 - y**2
    model = OdeModel("normal form", ca.vertcat(x, y), ca.vertcat(gain * x - y, gain * y + x), mu)
    orbit = find_orbit(model, lambda t: [np.cos(t), np.sin(t)], 6.0, parameters={"mu": 1e-4}, corrector="ipopt")
    np.testing.assert_allclose(np.hypot(*orbit.states.T), 1e-2, rtol=1e-6)
    assert orbit.period == pytest.approx(2 * np.pi, rel=1e-7)


def test_a_bad_guess_is_not_called_a_singular_problem() -> None:
    model = damped()
    with pytest.raises(BoundaryError) as failure:
        find_orbit(
            model, lambda t: [np.cos(t * 2 * np.pi / 14), -np.sin(t * 2 * np.pi / 14)], 14.0,
            parameters={"mu": 0.3}, corrector="newton",
        )  # fmt: skip
    assert SINGULAR not in str(failure.value)


@pytest.mark.slow
@pytest.mark.parametrize("value", [100.0, 1000.0])
def test_a_relaxation_oscillation_is_found_from_its_simulation(value: float) -> None:
    """Van der Pol: jumps of 1e-4 or 1e-6 of the period between output times; the period by LSODA's own events."""
    model = van_der_pol()
    cycle = simulate(model, [2.0, 0.0], np.linspace(0.0, 5.67 * value, 2001), parameters={"mu": value}).last_cycle()
    orbit = find_orbit(model, cycle, parameters={"mu": value}, tolerance=1e-8)

    def upwards(t: float, s: np.ndarray) -> float:
        return float(s[0])

    upwards.direction = 1.0  # type: ignore[attr-defined]
    field = lambda t, s: [s[1], value * (1.0 - s[0] ** 2) * s[1] - s[0]]  # noqa: E731
    found = solve_ivp(field, (0.0, 5.67 * value), [2.0, 0.0], "LSODA", rtol=1e-11, atol=1e-11, events=upwards)
    assert orbit.period == pytest.approx(float(np.diff(found.t_events[0])[-1]), rel=1e-7)
    assert np.max(np.abs(orbit.evaluate(np.linspace(0.0, orbit.period, 4001))[:, 0])) == pytest.approx(2.0, abs=0.01)
