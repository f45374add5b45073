"""Solutions that the corrector does not reach from the guess, and what is told of how they were found."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from equilibrium_models import symbols
from scipy.integrate import solve_ivp
from small_models import bratu

from casadi_skin import BoundaryValueProblem, OdeModel
from casadi_skin.follow.space import BoundaryError


def nozzle(eps: float) -> BoundaryValueProblem:
    """Number 24 of the test set of Cash and Mazzia: flow with a shock through a nozzle."""
    u, v, e, x = symbols("u v eps x")
    area, slope, gamma = 1 + x**2, 2 * x, 1.4
    force = ((1 + gamma) / 2 - e * slope) * u * v - v / u - slope / area * (1 - (gamma - 1) * u**2 / 2)
    model = OdeModel("nozzle", ca.vertcat(u, v), ca.vertcat(v, force / (e * area * u)), e, time=x, forcing_period=1.0)
    return BoundaryValueProblem(model, [model.start(u) - 0.9129, model.end(u) - 0.375], parameters={"eps": eps})


@pytest.mark.slow
def test_a_shock_is_reached_by_a_short_continuation_that_is_told() -> None:
    """Shooting from the point behind the shock, and before it, agrees."""
    guess = {"u": lambda t: 0.9129 - 0.5379 * t, "v": -0.5379}
    solution = nozzle(1e-3).solve(guess, tolerance=1e-6)
    assert solution.found_by == "eps followed from 0.01 to 0.001"
    assert nozzle(1e-2).solve(guess, tolerance=1e-6).found_by in ("", "Newton's method")
    field = solution.statement.model.vector_field
    start = 0.9 if np.abs(solution.evaluate(0.9)[1]) < 10.0 else 0.0
    state = solution.evaluate(start)
    after = solve_ivp(
        lambda t, y: np.array(field(t, y, [1e-3])).ravel(), (start, start + 0.02), state, "Radau", rtol=1e-9, atol=1e-9
    )
    assert after.y[0, -1] == pytest.approx(solution.evaluate(start + 0.02)[0], abs=1e-4)


@pytest.mark.slow
def test_what_was_tried_is_told_where_nothing_leads_to_a_solution() -> None:
    """Bratu's problem beyond its fold."""
    words = r"tried as well: .*lam followed from 50, 500, 0\.5; not tried: lam by arclength past folds, with follow"
    with pytest.raises(BoundaryError, match=words):
        bratu(5.0).solve([0.0, 0.0])
