"""Multiple shooting with SUNDIALS CVODES: the flow and its forward sensitivities join states at a few phases.

Unknowns are full states at the ends of M segments of a quarter, half or full period; the equations are continuity by
the flow (Stoer and Bulirsch 2002, section 7.3.5; Hindmarsh et al. 2005). `resolution` counts the digits of CVODES'
local tolerance. The residual jumps by about that tolerance wherever CVODES steps otherwise: no corrector can
be more accurate.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np

from casadi_skin.model.dop853 import dop853_reason, solve_dop853
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.symmetry import SymmetryClass, unfolded_phases
from casadi_skin.zero.fields import border_conditions, unfolded_field
from casadi_skin.zero.first_order import FirstOrderProblem
from casadi_skin.zero.problem import Array, Problem, SingularError
from casadi_skin.zero.segment import SegmentFlow

if TYPE_CHECKING:
    from scipy.integrate import OdeSolution

DIGITS = (3, 15)  # of CVODES' local tolerance
SEGMENTS = 4  # of a quarter of the period: with two the metric of a walk sees too little of steep orbits
PATH_TOLERANCE = 3e-14  # of the paths between the segments' ends, which are off by two or three times as much
PATHS = 4  # orbits whose paths are kept
ROUNDING = 1e-13  # error of CVODES' steps by rounding, relative to the largest state: measured with 14 and 15 digits


class ShootingError(SingularError):
    """The equations have no value: CVODES cannot follow a segment; the message has its return code."""


class ShootingProblem(FirstOrderProblem):
    """Equations of M segments of equal duration; unknowns ordered in time: x_0, x_1, ..., x_M.

    `digits` of the local tolerance are the resolution; by default a quarter of the period has four segments. `evaluate`
    raises ShootingError. Raises ValueError for missing symmetries and for digits or segments out of range.
    """

    def __init__(self, model: OdeModel, digits: int, symmetry: SymmetryClass, segments: int | None = None) -> None:
        super().__init__(model, digits, symmetry)
        if not DIGITS[0] <= digits <= DIGITS[1]:
            raise ValueError(f"digits: given {digits}; accepted: {DIGITS[0]} to {DIGITS[1]}")
        self.segments = round(4 * symmetry.value) * SEGMENTS if segments is None else segments
        if self.segments < 1:
            raise ValueError(f"segments: given {segments}; accepted: a whole number >= 1")
        self.states = model.full_size * (self.segments + 1)
        self.flow = SegmentFlow(model, digits)
        self._paths: dict[bytes, dict[int, OdeSolution]] = {}

    # Equations ------------------------------------------------------------------------------------------------------

    def _duration(self, Omega: float | ca.MX) -> float | ca.MX:
        """Time that a segment takes."""
        return self.symmetry.value * 2.0 * np.pi / self.segments / Omega

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        n, M = self.model.full_size, self.segments
        z = ca.MX.sym("z", self.size)
        states = ca.horzsplit(ca.reshape(z[: self.states], n, M + 1))
        Omega, p = z[self.Omega_index], z[self.parameter_index]
        duration = self._duration(Omega)
        parameters = ca.vertcat(p, z[self.damping_index] if self.unfolded else 0, duration)
        border = border_conditions(self.model, self.pinned, self.unfolded)
        conditions, by_first, by_last, by_p = border(states[0], states[-1], p)
        residual, rows = [], []
        for k in range(M):
            residual.append(states[k + 1] - self.flow.end(states[k], parameters))
            by_start, by_parameters = self.flow.sensitivities(states[k], parameters)
            blocks = [ca.MX(n, k * n), -by_start, ca.MX.eye(n), ca.MX(n, (M - k - 1) * n)]
            borders = [by_parameters[:, 2] * (duration / Omega), -by_parameters[:, 0]]
            if self.unfolded:
                borders.append(-by_parameters[:, 1])
            rows.append(ca.horzcat(*blocks, *borders))
        m = conditions.numel()
        inner, damping = ca.MX(m, (M - 1) * n), ca.MX(m, int(self.unfolded))
        rows.append(ca.horzcat(by_first, inner, by_last, ca.MX(m, 1), by_p, damping))
        return z, ca.vertcat(*residual, conditions), ca.vertcat(*rows)

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """Residual and non-zeros of the Jacobian, as in every problem; raises ShootingError."""
        self.flow.failure = None
        with interrupts_deferred():
            values = super().evaluate(z)
        if self.flow.failure is not None:
            raise ShootingError(f"the flow over a segment of the period cannot be computed: {self.flow.failure}")
        return values

    # Values ---------------------------------------------------------------------------------------------------------

    def phases(self) -> Array:
        return self.symmetry.value * 2.0 * np.pi * np.arange(self.segments + 1) / self.segments

    def prolong(self, z: Array, finer: Problem) -> Array:
        assert isinstance(finer, ShootingProblem)
        assert finer.segments == self.segments
        return z.copy()

    def rounding(self, z: Array) -> float:
        return ROUNDING * float(np.max(np.abs(z[: self.states])))

    def sample(self, z: Array, theta: Array) -> Array:
        """Positions at phases, from the start of the segment that each lies in; raises ShootingError."""
        fractions, signs = unfolded_phases(self.model, self.symmetry, theta)
        values = z[: self.states].reshape(self.segments + 1, self.model.full_size)
        segment = np.clip((fractions * self.segments).astype(int), 0, self.segments - 1)
        offset = np.clip(fractions * self.segments - segment, 0.0, 1.0)
        full = values[segment + (offset == 1.0)]
        inside = (offset > 0.0) & (offset < 1.0)
        for k in np.unique(segment[inside]):
            here = inside & (segment == k)
            full[here] = self._path(z, int(k))(offset[here]).T
        return np.asarray((signs * full)[:, : self.model.size])

    def _path(self, z: Array, segment: int) -> OdeSolution:
        """States of an orbit along one segment, from 0 to 1, by the Dormand-Prince method of order 8."""
        paths = self._paths.setdefault(z.tobytes(), {})
        if len(self._paths) > PATHS:
            self._paths.pop(next(iter(self._paths)))
        if segment not in paths:
            paths[segment] = self._integrate(z, segment)
        return paths[segment]

    def _integrate(self, z: Array, segment: int) -> OdeSolution:
        n = self.model.full_size
        start = z[segment * n : (segment + 1) * n]
        parameters = np.array([z[self.parameter_index], z[self.damping_index] if self.unfolded else 0.0])
        duration = float(self._duration(z[self.Omega_index]))
        solution = solve_dop853(self._field, parameters, start, 1.0, PATH_TOLERANCE, rate=duration)
        path: OdeSolution | None = solution.sol
        if path is None or not solution.success:
            raise ShootingError(f"the orbit cannot be followed: {dop853_reason(solution)}")
        return path

    @cached_property
    def _field(self) -> ca.Function:
        """Function (t, x, (p, damping)) -> dense time derivative."""
        t, x, parameters = ca.SX.sym("t"), ca.SX.sym("x", self.model.full_size), ca.SX.sym("p", 2)
        return ca.Function("field", [t, x, parameters], [ca.densify(unfolded_field(self.model)(x, parameters)[0])])
