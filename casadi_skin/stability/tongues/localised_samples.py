"""Orbits along a branch at the edge of a linear medium as the search for changes takes them: equations, and errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

from casadi_skin.stability.tongues.hill import Hill, Layout
from casadi_skin.stability.tongues.localised_counts import Counts, count, function_of
from casadi_skin.zero.problem import Array

NARROW_GAP, FILLED_GAP = "narrow", "fills"
BAND_EDGE_RTOL = 1e-14  # relative distance from the edge of a band that rounding leaves
NARROW_GAP_RATIO = 1e-6  # of Omega: a gap beside a harmonic of the orbit in which rounding decides


@dataclass(frozen=True, eq=False)
class Sample:
    """One orbit: its coordinate, amplitude and Hill's equations, and those of the better orbit that shows its error."""

    coordinate: float
    S: float
    hill: Hill
    layout: Layout
    better: Callable[[], Hill] = field(repr=False)
    _functions: dict[str, float] = field(default_factory=dict, init=False, repr=False)

    @property
    def Omega(self) -> float:
        """Frequency."""
        return self.hill.Omega

    def function(self, name: str) -> float:
        """A function of the orbit; each is zero where a multiplier passes an end of a gap."""
        if name not in self._functions:
            self._functions[name] = function_of(self.hill, self.layout, name)
        return self._functions[name]

    @cached_property
    def counts(self) -> Counts:
        """Localised multipliers; raises CountError."""
        return count(self.hill, self.layout)


def names_of_arcs(layout: Layout) -> tuple[str, ...]:
    """Names of a layout; with a mark where a gap beside a harmonic of the orbit is too narrow."""
    if layout.fills:
        return (FILLED_GAP,)
    if layout.pinned:
        return layout.names if layout.off_edge <= BAND_EDGE_RTOL else (NARROW_GAP,)
    start, end = layout.gaps[-1]
    return layout.names if end.sigma - start.sigma > NARROW_GAP_RATIO * layout.Omega else (NARROW_GAP,)


class EdgeBranch(Protocol):
    """A branch of orbits at the edge of a linear medium."""

    @property
    def coordinates(self) -> Array:
        """Coordinates of its points, ascending."""
        ...

    def sample(self, coordinate: float) -> Sample:
        """The orbit there; raises OrbitNotFoundError."""
        ...

    def layout(self, coordinate: float) -> Layout:
        """Its arcs and gaps, from a frequency that is nearly that of the sample; raises OrbitNotFoundError."""
        ...

    def amplitude(self, coordinate: float) -> float:
        """S near a coordinate, to a few digits and without an orbit: it names places that are not known."""
        ...
