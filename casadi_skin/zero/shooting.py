"""Multiple shooting with SUNDIALS CVODES: the flow and its forward sensitivities join states at a few phases.

x_(k+1) = phi(x_k, sigma) for M segments of a quarter, half or full period, with the flow phi over one of x' = F(x,
sigma)/M in the time of a segment, and the conditions of `orbit_formulation` at both ends (Stoer and Bulirsch 2002,
section 7.3.5; Hindmarsh et al. 2005). Unknowns are x_0, x_1, ..., x_M, n components each, and sigma = (Omega,
parameter, damping of a full period). `resolution` counts the digits of CVODES' local tolerance. The residual jumps by
about that tolerance wherever CVODES steps otherwise: no corrector can be more accurate.
"""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Self

import casadi as ca
import numpy as np

from casadi_skin.model.conserved import SymmetryClass, unfolded_phases
from casadi_skin.model.integrators import TIGHT_ITERATION, CvodesOptions, cvodes_reason, dop853_reason, solve_dop853
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.collocation import FirstOrderProblem, orbit_formulation
from casadi_skin.zero.problem import Array, Indices, SingularError

if TYPE_CHECKING:
    from scipy.integrate import OdeSolution

SENSITIVITY_DIGITS = 8  # Newton's steps then err by 1e-6 of themselves, and cost a quarter of those with 13 digits
MAX_STEPS = 5_000  # in one segment: ten times what steep orbits need with 14 digits
DIGITS_RANGE = (3, 15)  # of CVODES' local tolerance
QUARTER_SEGMENTS = 4  # of a quarter of the period: with two the metric of a walk sees too little of steep orbits
PATH_TOLERANCE = 3e-14  # of the paths between the segments' ends
KEPT_PATHS = 4  # orbits whose paths are kept
# Error of CVODES' steps by rounding, relative to the largest state: measured with 14 and 15 digits.
CVODES_ROUNDING = 1e-13


class ShootingError(SingularError):
    """The equations have no value: CVODES cannot follow a segment; the message has its return code."""


class ShootingProblem(FirstOrderProblem):
    """Equations of M segments of equal duration; unknowns ordered in time: x_0, x_1, ..., x_M.

    `digits` of the local tolerance are the resolution; by default a quarter of the period has four segments. Local
    tolerances are relative to the largest component of a segment's start. `evaluate` raises ShootingError. Raises
    ValueError for missing symmetries and for digits or segments out of range.
    """

    def __init__(self, model: OdeModel, digits: int, symmetry: SymmetryClass, segments: int | None = None) -> None:
        super().__init__(model, digits, symmetry)
        if not DIGITS_RANGE[0] <= digits <= DIGITS_RANGE[1]:
            raise ValueError(f"digits: given {digits}; accepted: {DIGITS_RANGE[0]} to {DIGITS_RANGE[1]}")
        self.segments = round(4 * symmetry.value) * QUARTER_SEGMENTS if segments is None else segments
        if self.segments < 1:
            raise ValueError(f"segments: given {segments}; accepted: a whole number >= 1")
        self.states, self.noise = model.full_size * (self.segments + 1), 10.0**-digits
        self.formulation = orbit_formulation(model, symmetry, self.pinned, self.unfolded)
        local = max(self.noise, 10.0**-SENSITIVITY_DIGITS)
        self._flow = self._integrator(CvodesOptions(self.noise, self.noise, MAX_STEPS, iteration=TIGHT_ITERATION))
        loose = self._integrator(CvodesOptions(local, local, MAX_STEPS, sensitivity_errors=True))
        n, seeds = model.full_size, ca.DM.eye(model.full_size + self.size - self.states)
        # The integrator of the sensitivities itself: a call that is not nested in another fails without printing.
        inside = loose.forward(seeds.size1()).find_functions()
        self._variational = next(f for f in inside if f.class_name() == loose.class_name())
        self._seeds = seeds[:n, :], ca.vertcat(seeds[n:, :], ca.DM(1, seeds.size1()))
        self._paths: dict[bytes, dict[int, OdeSolution]] = {}

    def _integrator(self, options: CvodesOptions) -> ca.Function:
        """CVODES over the unit of time, of the state over its scale, with parameters (sigma, scale)."""
        of, scale = self.formulation, ca.SX.sym("scale")
        rate = ca.substitute(ca.densify(of.field), of.x, scale * of.x) / (scale * self.segments)
        return options.integrator("segment", {"x": of.x, "p": ca.vertcat(of.scalars, scale), "ode": rate}, (0.0, 1.0))

    # Equations ------------------------------------------------------------------------------------------------------

    def _segment(self, x: Array, sigma: Array) -> tuple[Array, Array]:
        """The state at the end of a segment, and its derivatives by the start and by sigma, shape (n, n + sigma)."""
        largest = float(np.max(np.abs(x)))
        scale = largest if np.isfinite(largest) and largest > 0 else 1.0
        start, parameters, (of_start, of_parameters) = ca.DM(x / scale), ca.DM([*sigma, scale]), self._seeds
        end = scale * self._flow(x0=start, p=parameters)["xf"]
        sizes = np.maximum(np.abs(sigma), 1.0)  # tolerances are absolute: a high frequency moves little by itself
        seeded = ca.horzcat(start, of_start), ca.horzcat(parameters, ca.DM(np.append(sizes, 1.0)) * of_parameters)
        derivatives = np.array(self._variational(x0=seeded[0], p=seeded[1])["xf"][:, 1:])
        derivatives[:, x.size :] *= scale / sizes
        return np.array(end).ravel(), derivatives

    @cached_property
    def _places(self) -> tuple[Indices, Indices, Indices]:
        """Rows and columns of the non-zeros, column by column, and the order in which parts of them come so."""
        n, M, m = self.model.full_size, self.segments, self.size - self.states
        k, i, j = (index.ravel() for index in np.indices((M, n, n + m)))
        rows, columns = [k * n + i], [np.where(j < n, k * n + j, self.states + j - n)]
        rows.append(np.arange(M * n))
        columns.append(np.arange(M * n) + n)
        for pattern, first in zip(self.formulation.patterns[1], (0, M * n, self.states), strict=True):
            rows.append(M * n + np.array(pattern[0], dtype=np.int64))
            columns.append(first + np.array(pattern[1], dtype=np.int64))
        at = np.concatenate(rows), np.concatenate(columns)
        order = np.lexsort(at)
        return at[0][order], at[1][order], order

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        return self._places[:2]

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        states, sigma = z[: self.states].reshape(-1, self.model.full_size), z[self.states :]
        try:
            with interrupts_deferred():
                found = [self._segment(x, sigma) for x in states[:-1]]
        except RuntimeError as error:
            reason = f"cvodes {cvodes_reason(error)}"
            raise ShootingError(f"the flow over a segment of the period cannot be computed: {reason}") from error
        ends, derivatives = (np.array(part) for part in zip(*found, strict=True))
        conditions, *by = self.formulation.condition_buffers(states[0], states[-1], sigma, self.constants)
        values = [-derivatives.ravel(), np.ones(ends.size), *by]
        return np.append(states[1:] - ends, conditions), np.concatenate(values)[self._places[2]]

    def _values(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        return self.evaluate(z)

    # Values ---------------------------------------------------------------------------------------------------------

    def phases(self) -> Array:
        return self.symmetry.value * 2.0 * np.pi * np.arange(self.segments + 1) / self.segments

    def prolong(self, z: Array, finer: Self) -> Array:
        return z.copy()

    def resolution_in_words(self) -> str:
        return f"{self.segments} segments, a local tolerance of 1e-{self.resolution}"

    def missed_between(self, residual: Array) -> Array:
        return residual[: self.states - self.model.full_size]  # of each path at its end, to the start of the next

    def profile_change(self, z: Array, step: Array, between: Array | None = None) -> float:
        """Of the starts of segments, and with what paths miss of their ends as well."""
        steps = np.array([step] if between is None else [step, step])
        steps[1:, self.model.full_size : self.states] -= 0.0 if between is None else between
        return float(np.max(self.profile_changes(np.array([z] * len(steps)), steps)))

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
        start = z[: self.states].reshape(-1, self.model.full_size)[segment]
        rate = 1.0 / self.segments
        solution = solve_dop853(self._field, z[self.states :], start, 1.0, PATH_TOLERANCE, rate=rate)
        path: OdeSolution | None = solution.sol
        if path is None or not solution.success:
            raise ShootingError(f"the orbit cannot be followed: {dop853_reason(solution)}")
        return path

    @cached_property
    def _field(self) -> ca.Function:
        """Function (s, x, sigma) -> dense derivative by the fraction s of the part of the period."""
        of = self.formulation
        return ca.Function("field", [of.s, of.x, of.scalars], [ca.densify(of.field)])
