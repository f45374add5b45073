"""The Dormand-Prince method of order 8 (Hairer, Norsett and Wanner 1993, II.5) of scipy on CasADi functions."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.lattice.uniform_chain import Array
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.trajectory import (
    IntegrationError,
    Trajectory,
    fastest_frequency,
    finite_trajectory,
    size_of,
)


def solve_dop853(
    field: ca.Function,
    parameters: Array,
    start: Array,
    end: float,
    tolerance: float,
    t: Array | None = None,
    rate: float = 1.0,
) -> Any:
    """Solution by scipy of x' = rate field(rate t, x, p) from 0 to `end`: at the times t, or a dense one without t.

    `field` has a dense result. Tolerances are relative to the largest component of the start.
    """
    from scipy.integrate import solve_ivp

    time, state, result = np.empty(1), np.empty(start.size), np.empty(start.size)
    held = np.array(parameters, dtype=float)
    buffer, evaluate = field.buffer()  # arguments and result live in arrays of our own: calls convert nothing
    for i, argument in enumerate((time, state, held)):
        buffer.set_arg(i, argument.data)
    buffer.set_res(0, result.data)

    def right_hand_side(t: float, x: Array) -> Array:
        time[0], state[:] = rate * t, x
        evaluate()
        return rate * result

    options: dict[str, Any] = {"rtol": tolerance, "atol": tolerance * size_of(start), "dense_output": t is None}
    with np.errstate(all="ignore"):  # a state that runs away overflows before the step is found too small
        return solve_ivp(right_hand_side, (0.0, end), start, "DOP853", t, **options)


def dop853_reason(solution: Any) -> str:
    """Why scipy's solution ended early, in lower case and without a full stop."""
    return str(solution.message).strip(" .").lower()


def dop853(model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float) -> Trajectory:
    """States at the times t > 0; the paper's integrator. Raises IntegrationError where the step becomes too small."""
    fastest_frequency(model, parameters, start, t[-1])
    solution = solve_dop853(model.vector_field, parameters, start, t[-1], tolerance, t)
    states = np.asarray(solution.y).T if len(solution.t) else np.empty((0, start.size))
    trajectory = Trajectory(states, int(solution.nfev))
    if not solution.success:
        raise IntegrationError("dop853", dop853_reason(solution), trajectory, t)
    return finite_trajectory("dop853", trajectory, t)
