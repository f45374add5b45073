"""Transition matrices by SUNDIALS CVODES with forward sensitivities (Hindmarsh et al. 2005), for any model."""

from __future__ import annotations

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, OrbitProblem
from casadi_skin.bvp.symmetry import symmetry_class
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.models.ode import OdeModel
from casadi_skin.stability.flow import FlowError, Transition

TIGHTEST = 1e-13
MARGIN = 1e-3  # local tolerance per global tolerance: measured, the global error is up to several hundred local ones


class CvodesFlow:
    """Transition matrix as the sensitivity of the flow of the nonlinear equations to its start; Adams, functional.

    The error is estimated by a second run with local tolerances ten times as large: the global error is proportional
    to them. Raises FlowError where CVODES fails.
    """

    def __init__(self, model: OdeModel, tolerance: float) -> None:
        self.model, self.tolerance = model.first_order(), tolerance
        self.fraction = symmetry_class(model).value
        local = max(MARGIN * tolerance, TIGHTEST)
        self._fine, self._coarse = self._build(local), self._build(10.0 * local)

    def _build(self, local: float) -> ca.Function:
        model, duration = self.model, ca.SX.sym("duration")
        dae = {"x": model.state, "p": ca.vertcat(model.parameters, duration), "ode": duration * model.rhs}
        options = {
            "reltol": local,
            "abstol": local,
            "linear_multistep_method": "adams",
            "nonlinear_solver_iteration": "functional",
            "max_num_steps": 100_000,
            "fsens_err_con": True,
        }
        integrator = ca.integrator("flow", "cvodes", dae, 0.0, 1.0, options)
        return integrator.factory("transition", ["x0", "p"], ["xf", "jac:xf:x0"])

    def _start(self, problem: OrbitProblem, z: Array) -> Array:
        """Full state at phase zero; velocities of a brake orbit vanish there."""
        positions = problem.sample(z, np.zeros(1))[0]
        return np.concatenate([positions, np.zeros(self.model.size - positions.size)])

    def transition(self, problem: OrbitProblem, z: Array) -> Transition:
        """Transition matrix of the full state along the orbit."""
        duration = 2.0 * np.pi * self.fraction / float(z[problem.Omega_index])
        parameters = np.array([z[problem.parameter_index], duration])
        try:
            with interrupts_deferred():
                fine, coarse = (np.array(f(self._start(problem, z), parameters)[1]) for f in (self._fine, self._coarse))
        except RuntimeError as error:
            raise FlowError(f"cvodes: {str(error).splitlines()[0]}") from error
        return Transition(fine, self.fraction, float(np.linalg.norm(fine - coarse)))
