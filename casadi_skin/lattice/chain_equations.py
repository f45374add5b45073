"""Equations of motion of a chain, in physical coordinates and in its gauge."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from casadi_skin.dynamics.equations import EquationsOfMotion, Gauge
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.problem import Array


class ChainEquations(EquationsOfMotion):
    """Displacements y_n and velocities v_n of all sites; the energy is that of the gauge.

    Raises ValueError for an infinite chain.
    """

    gauge_is_default = True

    def __init__(self, chain: Chain) -> None:
        if chain.infinite:
            raise ValueError("sites: given an infinite chain; accepted for time evolution: a whole number >= 1")
        self.model = chain
        self.parameters = {"alpha": chain.alpha, "gamma": chain.gamma, "g": chain.g}
        if chain.g < 0:
            self.escape = "with g < 0 a large displacement leaves the well and runs to infinity in finite time"
        if chain.g < 0 and chain.alpha > -2.0:
            self.well = float(np.sqrt((2.0 + chain.alpha) / -chain.g))

    @cached_property
    def physical(self) -> OdeModel:
        chain: Chain = self.model
        return chain.physical_model()

    @property
    def values(self) -> Array:
        return np.array([self.parameters["g"]], dtype=float)

    @cached_property
    def gauge(self) -> Gauge:
        chain: Chain = self.model
        return Gauge(chain.gauge_model(), self.values, chain.log_rho)  # eta at S = 1, where kappa is g

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(f"{x}_{n}" for x in "yv" for n in range(1, self.positions + 1))


def equations_of_motion(chain: Chain) -> ChainEquations:
    """The equations of motion of a chain with their gauge; raises ValueError for an infinite one."""
    return ChainEquations(chain)
