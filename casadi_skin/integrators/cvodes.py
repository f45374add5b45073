"""Time evolution by SUNDIALS CVODES."""

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
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.models.ode import OdeModel
from casadi_skin.theory.linear import Array

CVODES_SHARE, CVODES_TIGHTEST = 1e-3, 1e-15  # measured: what CVODES returns is up to 1500 of its local tolerances off
CVODES_ITERATION = 1e-3  # share of a step's error left to the iteration; at the default, 0.1, the order falls to 5
CVODES_STEPS = 200  # allowed per radian of the stiffest vibration: ten times what the tightest run needs
CVODES_GAP = 100.0  # radians from output to output


def cvodes(model: OdeModel, parameters: Array, start: Array, t: Array, tolerance: float) -> Trajectory:
    """States at the times t > 0 by CVODES: Adams formulas, functional iteration (Hindmarsh et al. 2005).

    Raises IntegrationError where CVODES fails, with the last time it reached.
    """
    local = max(CVODES_SHARE * tolerance, CVODES_TIGHTEST)
    # The limit on steps holds from output to output: outputs in long gaps let a blow-up be noticed soon.
    gap = CVODES_GAP / fastest_frequency(model, parameters, start, t[-1])
    grid = np.union1d(t, np.arange(gap, t[-1], gap))
    first = model.first_order()
    options = {
        "reltol": local,
        "abstol": local * size_of(start),
        "linear_multistep_method": "adams",
        "nonlinear_solver_iteration": "functional",
        "nonlin_conv_coeff": CVODES_ITERATION,
        "max_num_steps": int(CVODES_STEPS * CVODES_GAP),
        "disable_internal_warnings": True,
        "show_eval_warnings": False,
    }
    dae = {"x": first.state, "p": first.parameters, "ode": first.rhs}
    integrator = ca.integrator("evolution", "cvodes", dae, 0.0, list(grid), options)
    try:
        with interrupts_deferred(end_solver=True):
            states = np.array(integrator(x0=start, p=parameters)["xf"]).T
    except RuntimeError as error:
        reason = str(error).rpartition("CVode returned ")[2].partition(".")[0].strip('"')
        before = t[t <= integrator.stats()["tcur"]]
        whole = Trajectory(np.empty((0, start.size)), 0)
        if before.size:  # CasADi gives nothing of a run that fails: what went well is done again
            whole = cvodes(model, parameters, start, before, tolerance)
        raise IntegrationError("cvodes", f"it returned {reason}", whole, t) from error
    return finite_trajectory(
        "cvodes", Trajectory(states[np.searchsorted(grid, t)], int(integrator.stats()["nfevals"])), t
    )
