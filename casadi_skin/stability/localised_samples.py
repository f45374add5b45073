"""Orbits along a branch at the edge of a linear medium as the search for changes takes them: equations, and errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.stability.gaps import HALF, START, Layout
from casadi_skin.stability.hill import Hill
from casadi_skin.stability.localised_counts import Counts, at_end, count

NARROW_GAP, FILLS = "narrow", "fills"
EXACT = 1e-14  # relative distance from the edge of a band that rounding leaves
NARROW = 1e-6  # of Omega: a gap beside a harmonic of the orbit in which rounding decides


@dataclass(frozen=True, eq=False)
class Sample:
    """One orbit: its coordinate, amplitude and Hill's equations, and those of the better orbit that shows its error."""

    coordinate: float
    S: float
    hill: Hill
    layout: Layout
    better: Callable[[], Hill] = field(repr=False)

    @property
    def Omega(self) -> float:
        """Frequency."""
        return self.hill.Omega

    @cached_property
    def functions(self) -> dict[str, float]:
        """Real functions of the orbit, each zero where a multiplier passes an end of a gap, by name."""
        return functions_of(self.hill, self.layout)

    @cached_property
    def counts(self) -> Counts:
        """Localised multipliers; raises CountError."""
        return count(self.hill, self.layout)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the layout; with a mark where a gap beside a harmonic of the orbit is too narrow."""
        if self.layout.fills:
            return (FILLS,)
        if self.layout.pinned:
            return self.layout.names if self.layout.off_edge <= EXACT else (NARROW_GAP,)
        wide = self.layout.gaps[-1][1].sigma - self.layout.gaps[-1][0].sigma > NARROW * self.Omega
        return self.layout.names if wide else (NARROW_GAP,)


class EdgeBranch(Protocol):
    """A branch of orbits at the edge of a linear medium."""

    @property
    def coordinates(self) -> Array:
        """Coordinates of its points, ascending."""
        ...

    def sample(self, coordinate: float) -> Sample:
        """The orbit there; raises OrbitNotFoundError."""
        ...


def functions_of(hill: Hill, layout: Layout) -> dict[str, float]:
    """See `Sample.functions`."""
    found: dict[str, float] = {}
    for start, end in layout.gaps:
        found.update(at_end(hill, start, end.sigma - start.sigma))
        found.update(at_end(hill, end, end.sigma - start.sigma))
    if layout.covers_start:  # of real multipliers, whose determinant is real, there is none left under the arcs
        logs, phases = hill.determinant(np.zeros(1))
        found[START] = float(np.real(phases[0]) * np.exp(logs[0]))
    if layout.pinned:
        found[f"{HALF} cosine"] = hill.at_end(hill.Omega, "cosine")  # that of sines falls to 0 where the gap opens
    return found
