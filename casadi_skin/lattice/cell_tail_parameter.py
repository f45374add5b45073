"""The unknown in place of Omega where the tail of a long lattice is eliminated: the angle of its fundamental."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from casadi_skin.lattice.cell_tail import CellTail, Place
from casadi_skin.lattice.tail_parameter import KEPT_VALUES, Regime, TailValues
from casadi_skin.lattice.tail_series import Harmonics, TailSeries


@dataclass(frozen=True, eq=False)
class CellTailParameter:
    """u = phi of the fundamental, in or beside one gap: Omega(u) is monotone, also where it is pinned to a band.

    Attributes:
        tail: the tail.
        gap: number of bands below the fundamental.
        harmonics: number of odd harmonics.
        slowest: decay a cell of the fundamental in the gauge below which the core would be too short.
        lean: logarithm by which displacements fall from cell to cell beside the gauge's, away from the core.
    """

    tail: CellTail
    gap: int
    harmonics: int
    slowest: float
    lean: float

    @property
    def coupling(self) -> float:
        """Coupling of neighbouring cells in the gauge."""
        return self.tail.coupling

    def of_frequency(self, Omega: float) -> float:
        """u where the frequency is `Omega`, bound in the gap; NaN where it is not there."""
        try:
            place = self.tail.place(Omega**2)
        except ArithmeticError:
            return float("nan")
        return self.tail.angle(place) if place.gap == self.gap else float("nan")

    def places(self, u: float) -> list[Place]:
        """Where all harmonics are; raises ArithmeticError where one that should be bound is not."""
        first = self.tail.at_angle(self.gap, u)
        if self.tail.decay(first) < self.slowest:
            raise ArithmeticError("the fundamental decays too slowly for the core")
        found, squared = [first], self.tail.square(first)
        if not squared > 0.0:
            raise ArithmeticError("the frequency is not real")
        for k in range(3, 2 * self.harmonics, 2):
            found.append(self.tail.place(k**2 * squared))
            if self.tail.decay(found[-1]) + self.lean <= 0.0:
                raise ArithmeticError(f"harmonic {k} grows along the lattice")
        return found

    def values(self, u: float) -> TailValues:
        """All that the core needs at u; raises ArithmeticError where a harmonic that should be bound is not."""
        return self._kept(u)

    @cached_property
    def _kept(self) -> Callable[[float], TailValues]:
        return lru_cache(KEPT_VALUES)(self._values)

    def _values(self, u: float) -> TailValues:
        places = self.places(u)
        squares = (2.0 * np.arange(self.harmonics) + 1.0) ** 2
        phi = np.array([u, *(self.tail.angle(place) for place in places[1:])])
        slope = self.tail.slope(places[0])
        squared_slope = 0.0 if np.isinf(slope) else 1.0 / slope
        by_u = np.array([1.0, *(self.tail.slope(place) for place in places[1:])]) * squares * squared_slope
        by_u[0] = 1.0
        Omega = float(np.sqrt(self.tail.square(places[0])))
        return TailValues(
            Omega, squared_slope / (2.0 * Omega), np.sin(phi), np.cos(phi) * by_u, np.cos(phi), -np.sin(phi) * by_u, phi
        )

    def series(self, u: float, orders: int) -> TailSeries:
        """Power series of the same by changes of u; raises ArithmeticError as well where none is found."""
        in_u = np.zeros(self.harmonics)
        in_u[0] = 1.0
        return Harmonics(self.tail, self.places(u), self.values(u).psi, 0, in_u).series(orders)

    def passed(self, values: TailValues) -> int:
        """Modes of the tail by itself that harmonics lie above, counted from those above which they lie in gaps."""
        return int(np.sum(np.floor(values.psi / np.pi + 0.5)))

    def regime(self, values: TailValues) -> Regime:
        """Whether Omega is pinned to a band."""
        below, above = self.tail.sides(self.gap)
        phi = values.psi[0]
        pinned = (below is not None and phi < self.tail.angle(Place(self.gap, below, 0.0))) or (
            above is not None and phi > self.tail.angle(Place(self.gap, above, 0.0))
        )
        return Regime.PINNED if pinned else Regime.BOUND
