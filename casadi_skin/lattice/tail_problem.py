"""Odd cosines on the nonlinear core of a long chain, whose linear tail is eliminated exactly."""

from __future__ import annotations

from enum import Enum
from functools import cached_property

import casadi as ca
import numpy as np

from casadi_skin.bvp.orbit_problem import FREQUENCY_WEIGHT
from casadi_skin.bvp.problem import Array, Scalar
from casadi_skin.bvp.trigonometric import TrigonometricProblem
from casadi_skin.lattice.tail_parameter import TailParameter, TailValues
from casadi_skin.models.ode import OdeModel


class _TailFunction(ca.Callback):  # type: ignore[misc]
    """u -> Omega, across, down and their derivatives, as one function among CasADi's; NaN where nothing is bound."""

    def __init__(self, tail: TailParameter) -> None:
        ca.Callback.__init__(self)
        self._tail = tail
        self.construct("tail", {})

    def get_n_in(self) -> int:
        return 1

    def get_n_out(self) -> int:
        return 6

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(1 if i < 2 else self._tail.harmonics, 1)

    def eval(self, arguments: list[ca.DM]) -> list[ca.DM | Array | float]:
        try:
            v = self._tail.values(float(arguments[0]))
        except ArithmeticError:
            return [ca.DM(np.full(self.size1_out(i), np.nan)) for i in range(6)]
        return [v.Omega, v.Omega_slope, v.across, v.across_slope, v.down, v.down_slope]


class Regime(Enum):
    """What the linear tail of a long chain does, in words."""

    PINNED = "the frequency is pinned to the edge of the band"
    BOUND = "the breather is bound to the edge of the chain"
    THIRD = "three times the frequency is pinned to the band: the third harmonic fills the tail"


class CoreWithTailProblem(TrigonometricProblem):
    """Unknowns are the core's positions at the nodes, u of `TailParameter` in place of Omega, and the free parameter.

    The model is that of the core by itself, first site next to the tail; `coupling` is what it lacks there. Equations
    of the first site are those of its harmonics, times cos(psi): regular where the tail resonates.
    """

    def __init__(self, model: OdeModel, harmonics: int, tail: TailParameter) -> None:
        super().__init__(model, harmonics)
        self.tail = tail
        self.half_bandwidth = 2 * harmonics - 1 if model.size > 1 else harmonics

    def values(self, z: Array) -> TailValues:
        """The tail at z; raises ArithmeticError where a harmonic that should be bound is in the band."""
        return self.tail.values(float(z[self.Omega_index]))

    def frequency(self, z: Array) -> float:
        """Omega of z; NaN, as are the equations, where there is none."""
        try:
            return self.values(z).Omega
        except ArithmeticError:
            return float("nan")

    def frequency_step(self, z: Array, step: Array) -> float:
        return float(self.values(z).Omega_slope * step[self.Omega_index])

    def unknown_at(self, scalar: Scalar, value: float) -> float:
        return self.tail.of_frequency(value) if scalar is Scalar.OMEGA else value

    def regime(self, z: Array) -> Regime:
        """What the tail does at z."""
        psi, edge = self.values(z).psi, self.tail.tail.edge_angle
        if psi[0] > edge:
            return Regime.PINNED
        return Regime.THIRD if psi[1] > edge else Regime.BOUND

    @cached_property
    def _function_of_tail(self) -> _TailFunction:
        return _TailFunction(self.tail)

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        H, size, s = self.resolution, self.size, self.tail.tail.coupling
        core_z, core_R, core_J = super()._equations()
        core = ca.Function("core", [core_z], [core_R, core_J])
        z = ca.MX.sym("z", size)
        Omega, Omega_slope, across, across_slope, down, down_slope = self._function_of_tail(z[self.Omega_index])
        R, J = core(ca.vertcat(z[: self.states], Omega, z[self.parameter_index]))

        to_coefficients = ca.MX(ca.DM(self._to_coefficients))
        balance, a = to_coefficients @ R[:H], to_coefficients @ z[:H]
        from_tail = s / Omega**2 * across * a  # the force that the core's own equations lack, over Omega^2
        residual = ca.vertcat(down * balance - from_tail, R[H:])

        first = ca.diag(down) @ to_coefficients
        transform = ca.diagcat(first, ca.MX.eye(size - 1 - H))
        chain_rule = ca.diagcat(ca.MX.eye(self.states), Omega_slope, ca.MX.eye(1))
        by_states = s / Omega**2 * ca.diag(across) @ to_coefficients
        by_u = down_slope * balance - s / Omega**2 * across_slope * a + 2.0 * Omega_slope / Omega * from_tail
        extra = ca.horzcat(-by_states, ca.MX(H, self.states - H), by_u, ca.MX(H, 1))
        jacobian = transform @ J @ chain_rule + ca.vertcat(extra, ca.MX(size - 1 - H, size))
        return z, residual, jacobian

    def metric(self, z: Array, parameter_scale: float) -> Array:
        """A change of u by 1 counts as much as a wholly new profile, and the change of Omega that it makes besides."""
        weights = super().metric(z, parameter_scale)
        weights[self.Omega_index] = 1.0
        try:
            values = self.values(z)
        except ArithmeticError:  # a guess that is none
            return weights
        weights[self.Omega_index] += (FREQUENCY_WEIGHT * values.Omega_slope / values.Omega) ** 2
        return weights
