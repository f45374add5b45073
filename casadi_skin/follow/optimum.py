"""The objective of a boundary-value problem at its solution, and how well the optimality conditions hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Optimality:
    """The Karush-Kuhn-Tucker conditions of a solution, evaluated apart from the solver.

    `kkt` is the largest of stationarity and complementarity relative to the largest gradient or multiplier, `violation`
    that of equations and bounds, and `active` are the bounds with a multiplier, in words. `curved` is true where the
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
    """The smallest value of the objective, with its estimated error, and the optimality conditions there."""

    objective: float
    objective_error: float
    optimality: Optimality
