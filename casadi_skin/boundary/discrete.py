"""A stated boundary-value problem on a mesh, as correctors and walkers take it."""

from __future__ import annotations

import numpy as np

from casadi_skin.boundary.statement import HELD, BoundaryValueProblem
from casadi_skin.bvp.butcher import CollocationTable
from casadi_skin.bvp.collocation import CollocationEquations
from casadi_skin.bvp.formulation import Formulation
from casadi_skin.bvp.problem import Array, Scalar

SMALLEST = 1e-6  # of the largest component: smaller ones are measured by that


class BoundaryProblem(CollocationEquations):
    """Unknowns z = (states, free parameters, u), where u is what is held or followed.

    Each component of the state is measured by its own largest value, and by no less than its entry in `floors`; free
    parameters by their value and no less than `scalar_floors`.
    """

    def __init__(
        self,
        statement: BoundaryValueProblem,
        formulation: Formulation,
        intervals: int,
        table: CollocationTable,
        floors: Array,
        scalar_floors: Array,
        walking: str | None = None,
        end: float = 1.0,
    ) -> None:
        self.statement, self.walking, self.end = statement, walking, end
        self.floors, self.scalar_floors = floors, scalar_floors
        self._discretise(formulation, intervals, table)

    def index_of(self, scalar: Scalar) -> int:
        """Place of u among the unknowns; there is no Omega."""
        if scalar is Scalar.OMEGA:
            raise ValueError("a boundary-value problem has no Omega")
        return self.size - 1

    # Values ---------------------------------------------------------------------------------------------------------

    def parameters(self, z: Array) -> Array:
        """All parameters of the model, in its order."""
        found = self.statement.parameters_at(z[self.states :], self.walking, self.end)
        return np.asarray(found, dtype=float)

    def sample(self, z: Array, theta: Array) -> Array:
        return self._interpolate(z, np.asarray(theta, dtype=float))

    def frequency(self, z: Array) -> float:
        return 1.0

    def frequency_step(self, z: Array, step: Array) -> float:
        free = slice(self.states, self.size - 1)
        return float(np.max(np.abs(step[free]) / self._scalar_sizes(z), initial=0.0))

    def profile_change(self, z: Array, step: Array) -> float:
        move, values = (v[: self.states].reshape(self.columns, -1) for v in (step, z))
        return float(np.max(np.abs(move) / self._component_sizes(values)))

    def _component_sizes(self, values: Array) -> Array:
        own = np.maximum(np.max(np.abs(values), axis=0), self.floors)
        return np.asarray(np.maximum(own, SMALLEST * np.max(own)))

    def _scalar_sizes(self, z: Array) -> Array:
        return np.asarray(np.maximum(np.abs(z[self.states : -1]), self.scalar_floors))

    def metric(self, z: Array, parameter_scale: float) -> Array:
        """Diagonal of the mean over the columns of |dx|^2 relative to the components' sizes, and of the scalars."""
        values = z[: self.states].reshape(self.columns, -1)
        sizes = np.tile(self._component_sizes(values), self.columns)
        scalars = [*self._scalar_sizes(z), parameter_scale]
        return np.concatenate([1.0 / (sizes**2 * self.columns), np.array(scalars) ** -2.0])

    # Words ----------------------------------------------------------------------------------------------------------

    def whereabouts(self, z: Array) -> str:
        names, values = self.statement.model.parameter_names, self.parameters(z)
        words = ", ".join(f"{name} = {value:.6g}" for name, value in zip(names, values, strict=True))
        return f"with {words}" if words else f"on {self.resolution} intervals"

    def place(self, equation: int) -> str:
        """Variable and place of an equation of the field; or which condition it is."""
        n, rows = self.formulation.states, self.table.ends.size
        model = self.statement.model
        if equation < self.resolution * rows * n:
            start, end = self.statement.span(self.parameters(np.zeros(self.size)))
            fraction = self._fractions()[equation // n + 1]
            return f"the equation of {model.state_names[equation % n]} at t = {start + fraction * (end - start):.6g}"
        condition = equation - self.resolution * rows * n
        ends = int(self.formulation.conditions.numel())
        if condition < ends:
            return f"condition {condition + 1}"
        return f"integral {condition - ends + 1}"


def scalar_names(statement: BoundaryValueProblem, walking: str | None) -> tuple[str, ...]:
    """Names of the scalars among the unknowns."""
    return (*statement.free, walking or HELD)
