"""A periodic orbit of any model: a solution of its boundary-value problem, over all times, with its multipliers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.symmetry import SymmetryClass, unfolded_phases
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.optimum import Optimum
from casadi_skin.orbits.solution import BoundarySolution
from casadi_skin.stability.full_period import Multipliers, multipliers_by_collocation, multipliers_by_cvodes


@dataclass(frozen=True, eq=False)
class PeriodicOrbit(BoundarySolution):
    """A periodic orbit of `model`, a model of first order; `symmetry` tells which part of the period was unknown."""

    model: OdeModel
    symmetry: SymmetryClass
    optimum: Optimum | None = None  # where something was minimised

    def kept(self) -> dict[str, Any]:
        return {"model": self.model, "symmetry": self.symmetry}

    @property
    def period(self) -> float:
        """Period: of the orbit, which in a forced model is that of the forcing or a multiple."""
        start, end = self.interval
        return (end - start) / self.symmetry.value

    @property
    def period_error(self) -> float:
        """Estimated absolute error of the period; 0 in a forced model."""
        return self.parameter_error * self.period

    @property
    def unfolding(self) -> float:
        """Coefficient of the damping that a conservative model does not have: zero but for errors."""
        return self.parameters.get("unfolding", 0.0)

    @property
    def model_parameters(self) -> Array:
        """Parameters of the model itself, in its order."""
        return np.array([self.parameters[name] for name in self.model.parameter_names])

    def evaluate(self, t: ArrayLike) -> Array:
        """States at any times, shape (time, component)."""
        theta = 2.0 * np.pi * np.atleast_1d(np.asarray(t, dtype=float)) / self.period
        fractions, signs = unfolded_phases(self.model, self.symmetry, theta)
        return np.asarray(signs * self.problem.sample(self.point.z, fractions))

    @cached_property
    def _by_collocation(self) -> Multipliers:
        return multipliers_by_collocation(
            self.problem, self.point.z, self.model, self.symmetry, self.method.tolerance
        )  # fmt: skip

    def multipliers(self, by: str = "collocation") -> Multipliers:
        """Multipliers over the full period, by the linearised collocation or by CVODES sensitivities ("cvodes").

        Warns (TrivialMultiplierWarning) where a multiplier that is 1 for every orbit has drifted from it. Raises
        ValueError for another name, IntegrationError where CVODES fails.
        """
        if by not in ("collocation", "cvodes"):
            raise ValueError(f"by: given {by!r}; accepted: collocation, cvodes")
        if by == "collocation":
            found = self._by_collocation
        else:
            start = self.evaluate(0.0)[0]
            found = multipliers_by_cvodes(self.model, start, self.model_parameters, self.period, self.method.tolerance)
        found.warn()
        return found
