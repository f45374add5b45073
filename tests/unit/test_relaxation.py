"""Branches of orbits with layers that move: canards, relaxation oscillations, orbits that come to a saddle-focus."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols
from scipy.integrate import solve_ivp

from casadi_skin import OdeModel, find_equilibrium, find_orbit
from casadi_skin.follow.branch import Branch, End


def from_hopf(branch: Branch, place: int, parameter: str, to: float, **options: object) -> Branch:
    """The orbits that leave at one of the Hopf points of a branch of equilibria."""
    points = [point for point in branch.special_points if point.kind == "hopf"]
    return points[place].follow(parameter, to, **options)


def van_der_pol() -> OdeModel:
    x, y, mu = symbols("x y mu")
    return OdeModel("van der pol", ca.vertcat(x, y), ca.vertcat(y, mu * (1 - x**2) * y - x), mu)


def test_steps_go_by_what_the_prediction_misses() -> None:
    """By the angle between tangents they were 21 points."""
    circle = find_orbit(van_der_pol(), lambda t: [2 * np.cos(t), -2 * np.sin(t)], 6.6, parameters={"mu": 1.0})
    branch = circle.follow("mu", 5.0)
    assert branch.end is End.REACHED
    assert len(branch) <= 15


@pytest.mark.slow
def test_a_canard_is_passed_and_the_relaxation_oscillation_followed() -> None:
    """FitzHugh and Nagumo's equations at eps = 0.01: by the angle between tangents 649 points."""
    x, y, a = symbols("x y a")
    model = OdeModel("canard", ca.vertcat(x, y), ca.vertcat((y - x**3 / 3 + x) / 0.01, a - x), a)
    branch = from_hopf(find_equilibrium(model, [1.1, -0.6], parameters={"a": 1.1}).follow("a", 0.9), 0, "a", 0.5)
    assert branch.end is End.REACHED
    assert len(branch) <= 320
    last = branch.solutions[-1]

    def up(t: float, state: np.ndarray) -> float:
        return float(state[0])

    up.direction = 1.0  # type: ignore[attr-defined]
    course = solve_ivp(
        lambda t, s: [(s[1] - s[0] ** 3 / 3 + s[0]) / 0.01, 0.5 - s[0]], (0.0, 4.0 * last.period), last.evaluate(0.0),
        method="Radau", rtol=1e-9, atol=1e-11, events=up,
    )  # fmt: skip
    turns = np.diff(course.t_events[0])
    np.testing.assert_allclose(turns[-1], last.period, rtol=1e-6)


@pytest.mark.slow
def test_orbits_that_pass_a_saddle_focus_again_come_to_its_homoclinic_orbit() -> None:
    """Tsodyks and Markram's synapses (Cortes et al. 2013): the folds come to the limit like a geometric series."""
    E, x, u, E0 = symbols("E x u E0")
    rate = 1.5 * ca.log(1 + ca.exp((3.07 * u * x * E + E0) / 1.5))
    rates = ca.vertcat((rate - E) / 0.013, (1 - x) / 0.2 - u * x * E, (0.3 - u) / 1.5 + 0.3 * (1 - u) * E)
    model = OdeModel("synapses", ca.vertcat(E, x, u), rates, E0)
    rest = find_equilibrium(model, [0.238616, 0.982747, 0.367876], parameters={"E0": -2.0}).follow("E0", -0.9)
    branch = from_hopf(rest, -1, "E0", -5.0)
    assert branch.end is End.UNBOUNDED
    limit, error = branch.special_points[-1].parameters["E0"], branch.special_points[-1].error
    folds = np.array([point.parameters["E0"] for point in branch.special_points if point.kind == "fold"])
    first, second = np.diff(folds[-3:])
    assert abs(folds[-1] + second**2 / (first - second) - limit) <= error
