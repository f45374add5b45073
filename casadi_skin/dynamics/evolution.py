"""Result of a time evolution: states at the requested times, the method, and the drift of the energy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.dynamics.equations import GAUGE, EquationsOfMotion
from casadi_skin.model.arrays import at_instants, instants
from casadi_skin.model.result import NoQuantityError, Result
from casadi_skin.zero.problem import Array


@dataclass(frozen=True, eq=False)
class Evolution(Result):
    """States of a model in time; dimensionless, or in the units of the model.

    Attributes:
        equations: the equations of motion, with the model and the values of its parameters.
        t: times, ascending, shape (time,).
        states: in the coordinates of the model, shape (time, component): displacements, then velocities in a model of
            second order.
        method: name of the integrator.
        tolerance: tolerance requested of the integrator.
        coordinates: "gauge" or "physical", those that were integrated in.
        evaluations: of the forces, or of the right-hand side.
        step: of a method with a fixed one.
    """

    equations: EquationsOfMotion
    t: Array
    states: Array
    method: str
    tolerance: float
    coordinates: str
    evaluations: int
    step: float | None = None

    def __repr__(self) -> str:
        name = getattr(self.model, "name", None) or repr(self.model)
        times = f"{self.t.size} times from {self.t[0]:g} to {self.t[-1]:g}"
        return f"<Evolution of {name}: {times}, {self.states.shape[1]} components, by {self.method}>"

    @property
    def model(self) -> Any:
        """The model that moves, in its own coordinates."""
        return self.equations.model

    @property
    def parameters(self) -> Mapping[str, float]:
        """Values of the parameters of the model by name."""
        return self.equations.parameters

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the components of the state."""
        return self.equations.names

    @property
    def displacements(self) -> Array:
        """Positions, shape (time, position); raises ValueError for a model of first order."""
        return self.states[:, : self._positions("displacements")]

    @property
    def velocities(self) -> Array:
        """Velocities, shape (time, position); raises ValueError for a model of first order."""
        return self.states[:, self._positions("velocities") :]

    def _positions(self, name: str) -> int:
        if not self.equations.positions:
            raise NoQuantityError(f"{name}: {self.equations.physical.name} is of first order; accepted: states")
        return self.equations.positions

    def evaluate(self, t: ArrayLike) -> Array:
        """States at times between the first and the last by cubic Hermite interpolation.

        Shape (time, component), of one time (component,). Raises ValueError and TypeError for other times.
        """
        times = instants(t)
        if np.any((times < self.t[0]) | (times > self.t[-1])):
            raise ValueError(f"t: given {times.min():g} to {times.max():g}; accepted: {self.t[0]:g} to {self.t[-1]:g}")
        return at_instants(t, np.asarray(self.curve(times)))

    @cached_property
    def curve(self) -> Any:
        """The states as a spline of scipy."""
        from scipy.interpolate import CubicHermiteSpline

        field, values = self.equations.physical.vector_field, self.equations.values
        rates = field.map(self.t.size)(self.t[None], self.states.T, np.tile(values[:, None], self.t.size))
        return CubicHermiteSpline(self.t, self.states, np.array(rates).T)

    def last_cycle(self) -> Cycle:
        """The last stretch of time over which the state returns to itself.

        Where the output times are too far apart to show it, as in the jumps of a relaxation oscillation, the motion is
        followed on from the last of them for as long again by CVODES, at places evenly along its path.

        Raises:
            ValueError: there is none.
        """
        from casadi_skin.dynamics.cycles import last_cycle

        return Cycle(*last_cycle(self))

    # Energy -----------------------------------------------------------------------------------------------------------

    @property
    def has_energy(self) -> bool:
        """Whether the model declares a conserved quantity."""
        return self.equations.conserves

    @cached_property
    def energy(self) -> Array:
        """The conserved quantity that the model declares, shape (time,).

        Of a chain that of its gauge, with rho = 1 at the edge that the modes lean to. Raises ValueError where none is
        declared, and at |gamma| = 1 of a chain where sites off that edge move.
        """
        return self.equations.energy(self.states)

    @property
    def energy_drift(self) -> Array:
        """H(t) - H(first t), which the equations keep at 0, relative to |H(first t)|, shape (time,).

        In a model of second order it is relative to the largest kinetic energy where that is larger, as beside negative
        potential energies. Raises ValueError where `energy` does.
        """
        energy, n = self.energy, self.equations.positions
        size = abs(energy[0])
        if n:
            at_rest = np.hstack([self.states[:, :n], np.zeros((self.t.size, n))])
            size = max(size, float(np.max(energy - self.equations.energy(at_rest))))
        return np.asarray((energy - energy[0]) / (size or 1.0))

    @property
    def status(self) -> str:
        """The computation, its method and the drift of the energy, in a sentence."""
        words = f"{self.method} in {self.coordinates} coordinates, tolerance {self.tolerance:.3g}"
        if self.step is not None:
            words += f", step {self.step:.4g}"
        words += f": t = {self.t[-1]:.6g} reached with {self.evaluations} evaluations"
        if self.equations.physical.hamiltonian is not None or (self.has_energy and self.coordinates == GAUGE):
            words += f", energy kept to {np.abs(self.energy_drift).max():.1e}"
        return words


@dataclass(frozen=True, eq=False)
class Cycle:
    """A stretch of a time evolution after which it repeats itself: a guess for `find_orbit`, period included.

    `turns` are how many times 2 pi each state has grown by then, where angles rotate.
    """

    evolution: Evolution
    start: float
    period: float
    turns: tuple[int, ...] = ()

    def __repr__(self) -> str:
        return f"<Cycle: from t = {self.start:.6g}, period {self.period:.10g}>"

    @property
    def times(self) -> Array:
        """Times of the samples of the states, from 0 at the start of the cycle to the period."""
        t = self.evolution.t - self.start
        return np.concatenate([[0.0], t[(t > 0.0) & (t < self.period)], [self.period]])

    def evaluate(self, t: ArrayLike) -> Array:
        """States at times from the start of the cycle on, shape (time, component), or at one, shape (component,)."""
        periods, within = np.divmod(instants(t), self.period)
        states = self.evolution.evaluate(np.clip(self.start + within, self.start, self.evolution.t[-1]))
        if any(self.turns):
            states = states + 2.0 * np.pi * np.outer(periods, self.turns)
        return at_instants(t, states)


class EvolutionError(ArithmeticError):
    """A time evolution could not be followed to its end: the message names the time and the reason in one line.

    `evolution` holds the part computed before; None where there is none.
    """

    def __init__(self, message: str, evolution: Evolution | None) -> None:
        super().__init__(message)
        self.evolution = evolution
