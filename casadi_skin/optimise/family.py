"""Orbits of a mode's family, and its parameters that may be free, as a search takes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import Point


@dataclass(frozen=True, eq=False)
class Member:
    """An orbit of the family.

    Attributes:
        Omega: frequency.
        harmonics: number of odd cosines that it needs.
        sample: function of phases that gives q, shape (phases, components).
    """

    Omega: float
    harmonics: int
    sample: Callable[[Array], Array]

    @classmethod
    def of(cls, point: Point) -> Member:
        """From a point of the family in odd cosines."""
        return cls(point.Omega, point.problem.resolution, lambda theta: point.problem.sample(point.z, theta))


@dataclass(frozen=True)
class FreeNumber:
    """A parameter that may be free: its own value, its range where no bound is given, names of its numbers."""

    value: float
    lower: float
    upper: float
    names: tuple[str, ...]
