"""What a search asks of a mode's family of orbits; a chain and a model of second order each have one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import Point
from casadi_skin.models.ode import OdeModel
from casadi_skin.optimise.observables import FamilyEquations


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
    """What may be free: its own value, the range that it has by nature, and of how many numbers it consists."""

    value: float
    lower: float
    upper: float
    count: int = 1


class Family(Protocol):
    """One mode's family of periodic orbits, odd in time over half a period and even about phase zero.

    `values` are parameters by name; those that are missing have the model's own values.
    """

    @property
    def model(self) -> Any:
        """The chain or the model."""
        ...

    @property
    def mode(self) -> int: ...

    @property
    def size(self) -> int:
        """Number of components."""
        ...

    @property
    def free(self) -> Mapping[str, FreeNumber]:
        """Parameters that may be free, by name."""
        ...

    @property
    def columns(self) -> tuple[str, ...]:
        """Parameters that tables show, by name."""
        ...

    def limited(self, bounds: Mapping[str, tuple[float, float]]) -> Family:
        """The family for parameters within bounds; raises ValueError for bounds that cannot be."""
        ...

    def equations(self, values: Mapping[str, ca.SX], S: ca.SX) -> FamilyEquations:
        """The equations of an orbit."""
        ...

    def scale(self, values: Mapping[str, Any], S: float) -> Array:
        """What q has to be multiplied by to give displacements, shape (components,)."""
        ...

    def plain(self, values: Mapping[str, Any], S: float) -> tuple[OdeModel, float]:
        """The equations of q as a model with one parameter, and the value of that at S."""
        ...

    def members(self, values: Mapping[str, Any], amplitudes: Sequence[float], tolerance: float) -> list[Member] | None:
        """The orbits of the family at amplitudes; None where parameters are such that there is no family to follow.

        Raises ValueError or ArithmeticError where an orbit is not found.
        """
        ...
