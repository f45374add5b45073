"""The interface of correctors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

from casadi_skin.zero.problem import Array, Problem, Solve


class Status(Enum):
    """The end of a correction, in a readable sentence."""

    CONVERGED = "converged"
    TOO_MANY_ITERATIONS = "the iteration did not converge in the steps allowed"
    DIVERGED = "the iteration left the neighbourhood of its guess"
    SINGULAR = "the equations with their held condition are singular"
    INFEASIBLE = "no point near the guess satisfies the equations"


@dataclass(frozen=True)
class Correction:
    """A corrected point z, or where the corrector stopped; `message` adds the solver's own words.

    `solve` has the factors of the closed Jacobian next to z, where the corrector had them.
    """

    z: Array
    status: Status
    iterations: int
    message: str = ""
    solve: Solve | None = None

    @property
    def converged(self) -> bool:
        """Whether z satisfies the equations and the held condition."""
        return self.status is Status.CONVERGED


HeldState = tuple[Array, Array, float]  # unknowns z, and a row with the value of row . z


class Corrector(Protocol):
    """Solves R(z) = 0 together with one held linear condition row . z = value."""

    problem: Problem

    def on(self, problem: Problem) -> Corrector:
        """This corrector for a problem that differs in its constants only; nothing is built again."""
        ...

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point near `guess`, or a named failure; `row` has shape (size,)."""
        ...


def confirmations(corrector: Corrector, points: Sequence[HeldState]) -> list[Correction]:
    """The last word of a corrector on solutions: each as it is where the corrector agrees, or has no other word."""
    several, one = getattr(corrector, "confirm_all", None), getattr(corrector, "confirm", None)
    if several is not None:
        return list(several(points))
    return [Correction(z, Status.CONVERGED, 0) if one is None else one(z, row, value) for z, row, value in points]
