"""Transition matrices by SUNDIALS CVODES with forward sensitivities (Hindmarsh et al. 2005), for any model."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from casadi_skin.model.conserved import symmetry_class
from casadi_skin.model.integrators import CvodesError, CvodesOptions, run_cvodes
from casadi_skin.model.ode import OdeModel
from casadi_skin.stability.stepping import FlowError, OrbitState, Transition, duration
from casadi_skin.zero.problem import Array, Problem

TIGHTEST_LOCAL_TOLERANCE = 1e-13
MAX_STEPS = 100_000
ERROR_SAFETY = 2.0  # errors are not quite proportional to local tolerances: measured, up to 2.4 times the difference
LOCAL_TOLERANCE_RATIO = (
    1e-3  # local tolerance per global tolerance: measured, the global error is up to several hundred local ones
)


class CvodesFlow:
    """Transition matrix as the sensitivity of the flow of the nonlinear equations to its start; Adams, functional.

    The error is estimated by a second run with local tolerances ten times as large: the global error is about
    proportional to them. Raises FlowError where CVODES fails.
    """

    batch = 1

    def __init__(self, model: OdeModel, tolerance: float) -> None:
        self.model, self.tolerance = model.first_order(), tolerance
        self.fraction = symmetry_class(model).value
        self._functions: dict[float, ca.Function] = {}

    def _function(self, local: float) -> ca.Function:
        """Sensitivity of the flow at a local tolerance, built when first needed."""
        if local not in self._functions:
            self._functions[local] = self._build(local)
        return self._functions[local]

    def _build(self, local: float) -> ca.Function:
        model, time = self.model, ca.SX.sym("time")
        dae = {"x": model.state, "p": ca.vertcat(model.parameters, time), "ode": time * model.rhs}
        return CvodesOptions(local, local, MAX_STEPS, sensitivity_errors=True).transition("flow", dae)

    def _matrix(self, orbit: OrbitState, local: float) -> Array:
        """Transition matrix; velocities of a brake orbit vanish at phase zero."""
        positions = orbit.problem.sample(orbit.z, np.zeros(1))[0]
        start = np.concatenate([positions, np.zeros(self.model.size - positions.size)])
        parameters = np.array([orbit.parameter, duration(orbit, self.fraction)])
        try:
            return np.array(run_cvodes(self._function(local), start, parameters)["jac_xf_x0"])
        except CvodesError as error:
            place = f"the orbit of Omega = {orbit.Omega:.10g}, parameter = {orbit.parameter:.10g}"
            raise FlowError(
                f"cvodes fails with a local tolerance of {local:.0e} along {place}: {error}; try a larger "
                "tolerance or flow splitting"
            ) from error

    def transition(self, problem: Problem, z: Array) -> Transition:
        """Transition matrix of the full state along the orbit."""
        return self.transitions([OrbitState(problem, z)])[0]

    def transitions(
        self,
        orbits: Sequence[OrbitState],
        tolerance: float | None = None,
        banded: bool = False,
        alike: bool = False,
    ) -> list[Transition]:
        """Transition matrices along several orbits; local tolerances follow `tolerance` down, by powers of ten."""
        local = LOCAL_TOLERANCE_RATIO * self.tolerance
        if tolerance is not None and tolerance < self.tolerance:
            local = LOCAL_TOLERANCE_RATIO * 10.0 ** np.floor(np.log10(tolerance))
        local = max(float(local), TIGHTEST_LOCAL_TOLERANCE)
        return [self._estimated(orbit, local) for orbit in orbits]

    def _estimated(self, orbit: OrbitState, local: float) -> Transition:
        fine, coarse = self._matrix(orbit, local), self._matrix(orbit, 10.0 * local)
        pair = None if orbit.better is None else (fine, self._matrix(orbit.better, local))
        difference = ERROR_SAFETY * (fine - coarse)
        return Transition(fine, self.fraction, float(np.linalg.norm(difference)), difference, pair)
