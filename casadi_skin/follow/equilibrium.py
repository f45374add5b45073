"""One equilibrium with its eigenvalues and its error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.settings import Point
from casadi_skin.follow.solution import Solution
from casadi_skin.model.arrays import at_instants, instants
from casadi_skin.model.centred import centred_model
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_linearised import ComplexArray
from casadi_skin.zero.rest_problem import AlgebraicProblem
from casadi_skin.zero.statics import Spectrum


class HasSpectrum(Protocol):
    """Interface of the space of an equilibrium, beyond that of the space of any solution."""

    def spectrum(self, point: Point) -> Spectrum:
        """Eigenvalues at a point."""
        ...


@dataclass(frozen=True, eq=False)
class Equilibrium(Solution):
    """A state at which a model rests; dimensionless, or in the units of its model."""

    def __repr__(self) -> str:
        named = [f"{name} = {value:.6g}" for name, value in zip(self.space.state_names, self.positions, strict=True)]
        values = [f"{name} = {value:.6g}" for name, value in self.parameters.items()]
        words = f"; {', '.join(values)}" if values else ""
        shown = ", ".join(named[:6]) + (", ..." if len(named) > 6 else "")
        return f"<Equilibrium of {self.model.name}: {shown}{words}; {'stable' if self.stable else 'unstable'}>"

    @property
    def _equations(self) -> AlgebraicProblem:
        return cast(AlgebraicProblem, self.point.problem)

    @property
    def positions(self) -> Array:
        """The unknowns: the state, of a model of second order its positions, shape (state,)."""
        return self._equations.state(self.point.z)

    @property
    def state(self) -> Array:
        """The first-order state: of a model of second order positions and velocities, which vanish."""
        at_rest = np.zeros(self.model.full_size - self.model.size)
        return np.concatenate([self.positions, at_rest])

    def evaluate(self, t: ArrayLike) -> Array:
        """The state at any times, shape (time, component), or at one, shape (component,): it is the same at all."""
        return at_instants(t, np.tile(self.state, (instants(t).size, 1)))

    def __getitem__(self, name: str) -> float | Array:
        """The value of a parameter or of a state; raises KeyError for other names."""
        if name in self.parameters:
            return self.parameters[name]
        names = self.model.state_names
        if name not in names:
            raise KeyError(f"{name}; known: {', '.join((*names, *self.parameters))}")
        return float(self.state[names.index(name)])

    def centred_model(self) -> OdeModel:
        """The model in displacements from this state, which rests at 0: families grow from its linear modes.

        Its parameters have the values that they have here. A reversal that keeps the positions is kept.

        Returns:
            A model of second order, with the names of the states of this one.

        Raises:
            ValueError: the model is of first order, or forced.
        """
        return centred_model(self.model, self.positions, self.parameters)

    # Stability ------------------------------------------------------------------------------------------------------

    @property
    def spectrum(self) -> Spectrum:
        """Eigenvalues with their errors."""
        return cast(HasSpectrum, self.space).spectrum(self.point)

    @property
    def eigenvalues(self) -> ComplexArray:
        """Eigenvalues of the linearisation by descending real part, shape (components of the first-order state,)."""
        return self.spectrum.values

    @property
    def eigenvalue_error(self) -> float:
        """Largest estimated absolute error of the eigenvalues."""
        return float(np.max(self.spectrum.errors))

    @property
    def stable(self) -> bool:
        """Whether no eigenvalue has a positive real part, within estimated errors."""
        return self.spectrum.stable

    @property
    def unstable(self) -> int:
        """Number of eigenvalues with a positive real part, by more than estimated errors."""
        return int(np.sum(self.spectrum.values.real > self.spectrum.errors))

    @property
    def parameter_error(self) -> float:
        """0: no parameter is found with the state."""
        return 0.0
