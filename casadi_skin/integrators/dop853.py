"""Time evolution by the Dormand-Prince method of order 8."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.integrators.trajectory import (
    IntegrationError,
    Trajectory,
    fastest_frequency,
    finite_trajectory,
    size_of,
)
from casadi_skin.models.ode import OdeModel
from casadi_skin.theory.linear import Array


def _field(model: OdeModel) -> ca.Function:
    """Function (full state, parameters) -> its dense time derivative."""
    first = model.first_order()
    return ca.Function("field", [first.state, first.parameters], [ca.densify(first.rhs)])


def dop853(model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float) -> Trajectory:
    """States at the times t > 0 by the Dormand-Prince method of order 8 (Hairer, Norsett and Wanner 1993, II.5).

    The paper's integrator. Raises IntegrationError where the step becomes too small.
    """
    from scipy.integrate import solve_ivp

    state, rate, parameters = np.empty(start.size), np.empty(start.size), np.array(parameters, dtype=float)
    buffer, evaluate = _field(model).buffer()
    buffer.set_arg(0, state.data)
    buffer.set_arg(1, parameters.data)
    buffer.set_res(0, rate.data)

    def right_hand_side(_: float, x: Array) -> Array:
        state[:] = x
        evaluate()
        return rate.copy()

    fastest_frequency(model, parameters, start, t[-1])
    with np.errstate(all="ignore"):  # a state that runs away overflows before the step is found too small
        result = solve_ivp(
            right_hand_side, (0.0, t[-1]), start, "DOP853", t, rtol=tolerance, atol=tolerance * size_of(start)
        )
    trajectory = Trajectory(np.asarray(result.y).T if len(result.t) else np.empty((0, start.size)), int(result.nfev))
    if not result.success:
        raise IntegrationError("dop853", str(result.message).strip(" .").lower(), trajectory, t)
    return finite_trajectory("dop853", trajectory, t)
