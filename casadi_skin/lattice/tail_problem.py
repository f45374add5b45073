"""Odd cosines on the nonlinear core of a long chain, whose linear tail is eliminated exactly."""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np

from casadi_skin.bvp.orbit_problem import FREQUENCY_WEIGHT
from casadi_skin.bvp.problem import Array, Scalar
from casadi_skin.bvp.trigonometric import TrigonometricProblem
from casadi_skin.lattice.tail_parameter import Regime, TailValues
from casadi_skin.models.ode import OdeModel


class _TailFunction(ca.Callback):  # type: ignore[misc]
    """u -> Omega, across, down and their derivatives, as one function among CasADi's; NaN where nothing is bound."""

    def __init__(self, tail: TailUnknown) -> None:
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


class TailUnknown(Protocol):
    """The unknown u in place of Omega, of a chain's tail or of that of a lattice."""

    @property
    def harmonics(self) -> int:
        """Number of odd harmonics."""
        ...

    @property
    def coupling(self) -> float:
        """Strength of the bond between core and tail, in the gauge."""
        ...

    def values(self, u: float) -> TailValues:
        """All that the core needs at u; raises ArithmeticError where a harmonic that should be bound is in the band."""
        ...

    def of_frequency(self, Omega: float) -> float:
        """u where the frequency is `Omega`; NaN where there is none."""
        ...

    def regime(self, values: TailValues) -> Regime:
        """Regime of the tail."""
        ...


class CoreWithTailProblem(TrigonometricProblem):
    """Unknowns are the core's positions at the nodes, u in place of Omega, and the free parameter.

    The model is that of the core by itself; its site `attached` is next to the tail, and lacks the bond to it.
    Equations of that site are those of its harmonics, times cos(psi): regular where the tail resonates.
    """

    lifts = False

    def __init__(self, model: OdeModel, harmonics: int, tail: TailUnknown, attached: int = 0) -> None:
        super().__init__(model, harmonics)
        self.tail, self.attached = tail, attached
        if model.size > 1:
            self.half_bandwidth = (self.half_bandwidth or 0) + harmonics - 1

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
        """Regime of the tail at z."""
        return self.tail.regime(self.values(z))

    @cached_property
    def _function_of_tail(self) -> _TailFunction:
        return _TailFunction(self.tail)

    def _equations(self) -> tuple[ca.MX, ca.MX, ca.MX]:
        H, size, s = self.resolution, self.size, self.tail.coupling
        before, after = self.attached * H, (self.attached + 1) * H
        core_z, core_R, core_J = super()._equations()
        core = ca.Function("core", [core_z], [core_R, core_J])
        z = ca.MX.sym("z", size)
        Omega, Omega_slope, across, across_slope, down, down_slope = self._function_of_tail(z[self.Omega_index])
        R, J = core(ca.vertcat(z[: self.states], Omega, z[self.parameter_index]))

        to_coefficients = ca.MX(ca.DM(self._to_coefficients))
        balance, a = to_coefficients @ R[before:after], to_coefficients @ z[before:after]
        from_tail = s / Omega**2 * across * a  # the force that the core's own equations lack, over Omega^2
        residual = ca.vertcat(R[:before], down * balance - from_tail, R[after:])

        own = ca.vertcat(J[:before, :], ca.diag(down) @ to_coefficients @ J[before:after, :], J[after:, :])
        by_Omega = own[:, self.Omega_index] * Omega_slope
        by_states = s / Omega**2 * ca.diag(across) @ to_coefficients
        by_u = down_slope * balance - s / Omega**2 * across_slope * a + 2.0 * Omega_slope / Omega * from_tail
        beside = ca.MX(H, before), -by_states, ca.MX(H, self.states - after), by_u, ca.MX(H, 1)
        extra = ca.vertcat(ca.MX(before, size), ca.horzcat(*beside), ca.MX(size - 1 - after, size))
        return z, residual, ca.horzcat(own[:, : self.states], by_Omega, own[:, self.parameter_index]) + extra

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
