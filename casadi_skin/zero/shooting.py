"""Multiple shooting with SUNDIALS CVODES: the flow and its forward sensitivities join states at a few phases.

Unknowns are full states at the ends of M segments of a quarter, half or full period; the equations are continuity by
the flow (Stoer and Bulirsch 2002, section 7.3.5; Hindmarsh et al. 2005). `resolution` counts the digits of CVODES'
local tolerance. The residual jumps by about that tolerance wherever CVODES steps otherwise: no corrector can
be more accurate.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from casadi_skin.model.conserved import SymmetryClass, unfolded_phases
from casadi_skin.model.integrators import TIGHT_ITERATION, CvodesOptions, cvodes_reason, dop853_reason, solve_dop853
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.orbit_collocation import FirstOrderProblem, border_conditions, unfolded_field
from casadi_skin.zero.problem import Array, Problem, SingularError

if TYPE_CHECKING:
    from scipy.integrate import OdeSolution


# The flow over one segment of an orbit by SUNDIALS CVODES, as CasADi callbacks that do not fail but report ------------

FAR_STATE = 1e20
SENSITIVITY_DIGITS = 8  # Newton's steps then err by 1e-6 of themselves, and cost a quarter of those with 13 digits
MAX_STEPS = 5_000  # in one segment: ten times what steep orbits need with 14 digits

Evaluation = Callable[[ca.DM, ca.DM], list[ca.DM]]


class _Callback(ca.Callback):  # type: ignore[misc]
    """A Python function of (x, parameters) as a CasADi function with results of given shapes."""

    def __init__(
        self,
        name: str,
        sizes: tuple[int, int],
        shapes: list[tuple[int, int]],
        evaluation: Evaluation,
        jacobian: ca.Function | None = None,
    ) -> None:
        ca.Callback.__init__(self)
        self._sizes, self._shapes, self._evaluation, self._jacobian = sizes, shapes, evaluation, jacobian
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 2

    def get_n_out(self) -> int:
        return len(self._shapes)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self._shapes[i])

    def eval(self, arguments: list[ca.DM]) -> list[ca.DM]:
        return self._evaluation(arguments[0], arguments[1])

    def has_jacobian(self) -> bool:
        return self._jacobian is not None

    def get_jacobian(self, name: str, inames: list[str], onames: list[str], options: dict[str, Any]) -> ca.Function:
        assert self._jacobian is not None
        arguments = [ca.MX.sym("x", self._sizes[0]), ca.MX.sym("p", self._sizes[1])]
        result = ca.MX.sym("result", *self._shapes[0])
        return ca.Function(name, [*arguments, result], self._jacobian(*arguments), inames, onames)


class SegmentFlow:
    """The state at the end of a segment from that at its start, to a number of digits, and its derivatives.

    Parameters are those of the model, the coefficient of the unfolding damping, and the duration. Local tolerances are
    relative to the largest component of the start.
    """

    def __init__(self, model: OdeModel, digits: int) -> None:
        n, parameters = model.full_size, int(model.parameters.numel()) + 2
        self.failure: str | None = None
        local = 10.0**-digits
        self._flow = _integrator(model, CvodesOptions(local, local, MAX_STEPS, iteration=TIGHT_ITERATION))
        local = 10.0 ** -min(digits, SENSITIVITY_DIGITS)
        loose = _integrator(model, CvodesOptions(local, local, MAX_STEPS, sensitivity_errors=True))
        # The integrator of the sensitivities itself: a call that is not nested in another fails without printing.
        inside = loose.forward(n + parameters).find_functions()
        self._variational = next(f for f in inside if f.class_name() == loose.class_name())
        seeds = ca.DM.eye(n + parameters)
        self._seeds = seeds[:n, :], ca.vertcat(seeds[n:, :], ca.DM(1, n + parameters))
        sizes = (n, parameters)
        self.sensitivities = _Callback("sensitivities", sizes, [(n, n), (n, parameters)], self._sensitivities)
        self.end = _Callback("end", sizes, [(n, 1)], self._end, self.sensitivities)

    def _end(self, x: ca.DM, p: ca.DM) -> list[ca.DM]:
        """The state at the end."""
        scale = _scale(x)
        try:
            return [scale * self._flow(x0=x / scale, p=ca.vertcat(p, scale))["xf"]]
        except RuntimeError as error:
            self.failure = f"cvodes {cvodes_reason(error)}"
            return [x + FAR_STATE]

    def _sensitivities(self, x: ca.DM, p: ca.DM) -> list[ca.DM]:
        """Its derivatives with respect to the start, (n, n), and to the parameters, (n, parameters)."""
        scale, (of_start, of_parameters) = _scale(x), self._seeds
        start, parameters = ca.horzcat(x / scale, of_start), ca.horzcat(ca.vertcat(p, scale), of_parameters)
        try:
            derivatives = self._variational(x0=start, p=parameters)["xf"][:, 1:]
        except RuntimeError as error:
            self.failure = f"cvodes {cvodes_reason(error)}"
            return [ca.DM.eye(x.numel()), ca.DM.zeros(x.numel(), p.numel())]
        return [derivatives[:, : x.numel()], scale * derivatives[:, x.numel() :]]


def _integrator(model: OdeModel, options: CvodesOptions) -> ca.Function:
    """CVODES over the unit of time, with parameters (model's, damping, duration, scale of the state)."""
    x, parameters = ca.SX.sym("x", model.full_size), ca.SX.sym("p", model.parameters.numel() + 1)
    duration, scale = ca.SX.sym("duration"), ca.SX.sym("scale")
    rate = duration / scale * ca.densify(unfolded_field(model)(scale * x, parameters)[0])
    dae = {"x": x, "p": ca.vertcat(parameters, duration, scale), "ode": rate}
    return options.integrator("segment", dae, (0.0, 1.0))


def _scale(x: ca.DM) -> float:
    largest = float(ca.mmax(ca.fabs(x)))
    return largest if np.isfinite(largest) and largest > 0 else 1.0


DIGITS_RANGE = (3, 15)  # of CVODES' local tolerance
QUARTER_SEGMENTS = 4  # of a quarter of the period: with two the metric of a walk sees too little of steep orbits
PATH_TOLERANCE = 3e-14  # of the paths between the segments' ends, which are off by two or three times as much
KEPT_PATHS = 4  # orbits whose paths are kept
CVODES_ROUNDING = (
    1e-13  # error of CVODES' steps by rounding, relative to the largest state: measured with 14 and 15 digits
)


class ShootingError(SingularError):
    """The equations have no value: CVODES cannot follow a segment; the message has its return code."""


class ShootingProblem(FirstOrderProblem):
    """Equations of M segments of equal duration; unknowns ordered in time: x_0, x_1, ..., x_M.

    `digits` of the local tolerance are the resolution; by default a quarter of the period has four segments. `evaluate`
    raises ShootingError. Raises ValueError for missing symmetries and for digits or segments out of range.
    """

    def __init__(self, model: OdeModel, digits: int, symmetry: SymmetryClass, segments: int | None = None) -> None:
        super().__init__(model, digits, symmetry)
        if not DIGITS_RANGE[0] <= digits <= DIGITS_RANGE[1]:
            raise ValueError(f"digits: given {digits}; accepted: {DIGITS_RANGE[0]} to {DIGITS_RANGE[1]}")
        self.segments = round(4 * symmetry.value) * QUARTER_SEGMENTS if segments is None else segments
        if self.segments < 1:
            raise ValueError(f"segments: given {segments}; accepted: a whole number >= 1")
        self.states = model.full_size * (self.segments + 1)
        self.flow = SegmentFlow(model, digits)
        self.noise = 10.0**-digits
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

    def resolution_in_words(self) -> str:
        return f"{self.segments} segments, a local tolerance of 1e-{self.resolution}"

    def rounding(self, z: Array) -> float:
        return CVODES_ROUNDING * float(np.max(np.abs(z[: self.states])))

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
        if len(self._paths) > KEPT_PATHS:
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
