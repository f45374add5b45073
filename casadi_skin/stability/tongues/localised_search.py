"""Orbits along a branch that a search for changes of localised multipliers has computed, and what it has found."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from casadi_skin.stability.flow import FlowError
from casadi_skin.stability.tongues.diagram import Place
from casadi_skin.stability.tongues.gaps import Layout
from casadi_skin.stability.tongues.hill import Hill
from casadi_skin.stability.tongues.localised_diagram import LocalisedChange
from casadi_skin.stability.tongues.localised_samples import EdgeBranch, Sample

PRECISE = 1e-12  # of an interval between points: where a zero is
FINEST = 1e-7  # of such an interval: stretches that are halved no further
SAFETY = 2.0
ROUNDING = 1e-13  # of a determinant relative to its size
MORE = 4  # sidebands that show the error of those left out
FAILURES = (ArithmeticError, np.linalg.LinAlgError, FlowError, RuntimeError)  # of orbits and linear algebra


@dataclass
class Search:
    """Orbits known so far, and what has been found."""

    branch: EdgeBranch
    known: dict[float, Sample] = field(default_factory=dict)
    layouts: dict[float, Layout] = field(default_factory=dict)
    found: list[LocalisedChange] = field(default_factory=list)
    gaps: list[tuple[float, float, str]] = field(default_factory=list)

    def at(self, coordinate: float) -> Sample:
        """The orbit at a coordinate, solved once."""
        if coordinate not in self.known:
            self.known[coordinate] = self.branch.sample(coordinate)
        return self.known[coordinate]

    def layout(self, coordinate: float) -> Layout:
        """Arcs and gaps at a coordinate."""
        if coordinate in self.known:
            return self.known[coordinate].layout
        if coordinate not in self.layouts:
            self.layouts[coordinate] = self.branch.layout(coordinate)
        return self.layouts[coordinate]

    def amplitude(self, coordinate: float) -> float:
        """S at a coordinate, to a few digits where no orbit is known there."""
        known = self.known.get(coordinate)
        return self.branch.amplitude(coordinate) if known is None else known.S

    def place(self, coordinate: float, error: float) -> Place:
        """A place with the error of S, by its slope and bend."""
        points = self.branch.coordinates
        step = max(error, 1e-5)
        ends = np.clip([coordinate - step, coordinate + step], points[0], points[-1])
        here, sides = self.at(coordinate), [self.at(float(end)) for end in ends]
        change = max(abs(side.S - here.S) for side in sides) * error / step
        return Place(coordinate, error, here.S, change, here.Omega)


def others(sample: Sample) -> tuple[Hill, Hill]:
    """Equations that show the errors of an orbit's: those of the better orbit, and those with more sidebands."""
    return sample.better(), sample.hill.with_more(MORE)


def layout_like(hill: Hill, sample: Sample) -> Layout:
    """Arcs for the frequency of equations like those of a sample."""
    return Layout(hill.Omega, sample.layout.bands)


def mu_of(sigma: float, Omega: float) -> float:
    """mu of an exponent: lambda + 1/lambda = 2 + 4 mu for the multiplier of half the period."""
    return -float(np.sin(0.5 * np.pi * sigma / Omega) ** 2)
