"""Solutions of boundary-value problems with an objective or bounds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from casadi_skin.orbits.solution import BoundarySolution


@dataclass(frozen=True)
class Optimality:
    """The Karush-Kuhn-Tucker conditions of a solution, evaluated apart from the solver.

    `kkt` is the largest of stationarity and complementarity relative to the largest gradient or multiplier, `violation`
    that of equations and bounds, and `active` are the bounds with a multiplier, in words. `curved` tells whether the
    curvature is that of a minimum; it is not known where the model holds a program, such as an FMU.
    """

    kkt: float
    violation: float
    active: tuple[str, ...]
    curved: bool

    def holds_states(self, names: Sequence[str]) -> bool:
        """Whether bounds on any of the states named are active."""
        return any(words.split()[0] in names for words in self.active)


@dataclass(frozen=True)
class Optimum:
    """The smallest value found of what is minimised, with its estimated error, and the optimality conditions there."""

    objective: float
    objective_error: float
    optimality: Optimality


@dataclass(frozen=True, eq=False)
class OptimalSolution(BoundarySolution):
    """A local optimum and how well it satisfies the optimality conditions."""

    optimum: Optimum

    @property
    def objective(self) -> float:
        """What is minimised."""
        return self.optimum.objective

    @property
    def status(self) -> str:
        """What was found, in a sentence."""
        active, error = ", ".join(self.optimum.optimality.active), max(self.error, self.parameter_error)
        kind = "a local optimum" if self.optimum.optimality.curved else "a stationary point"
        words = f"{kind}{f' on the bounds {active}' if active else ''}"
        if error > self.method.tolerance:
            words += f", to {error:.1e}: bounds hold states at the mesh's points only"
        return words
