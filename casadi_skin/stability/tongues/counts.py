"""The number of localised multipliers of an orbit: those on the circle gap by gap, and those off it by the argument.

The determinant of Hill's equations tends to 1 where perturbations grow fast, and is periodic along the real axis, so
that its argument turns there once for every zero above. Zeros on the axis are those in gaps, where it is real: they,
and the one of the velocity of the flow, are passed above, by half a turn each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np

from casadi_skin.stability.flows import OrbitState
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.hill import HALF_END, START_END, End, Hill, Layout, Medium, coefficients
from casadi_skin.zero.family import Coordinates
from casadi_skin.zero.problem import Array, Indices, Problem

FIRST_SIGMA_VALUES = 12  # values of sigma under each part of an arc, at first
LARGEST_ARGUMENT_TURN = 0.6  # of the argument from one value to the next, at most
MOST_SIGMA_VALUES = 4000  # values of sigma under arcs
SERIES_DEGREES = (16, 32, 64, 128)  # of the series in a gap
CONVERGED_RTOL = 1e-6
ROUGH_STIFFNESS_RATIO = 1e-8  # of the stiffness: what the argument does without
WHOLE_NUMBER_DISTANCE = 0.02  # distance of a count from a whole number, at most
COSINE_START, SINE_START = f"{START_END} cosine", f"{START_END} sine"
COSINE_HALF, HALF_VELOCITY = f"{HALF_END} cosine", f"{HALF_END} velocity"
DOUBLE_ZERO_RADIUS = (
    0.25  # of the gap: radius of the circle about sigma = Omega on which its double zero is divided out
)
QUARTER_CIRCLE_VALUES = 6  # values on a quarter of it: those of all of it leave out the 24th order


class CountError(ArithmeticError):
    """The multipliers of an orbit cannot be counted."""


@dataclass(frozen=True)
class Counts:
    """Localised multipliers of an orbit: exponents in each gap, in the order of gaps, and how many are off the circle.

    Of these a pair of real ones counts one, four complex ones two.
    """

    zeros: tuple[tuple[float, ...], ...]
    off: int

    @property
    def inside(self) -> tuple[int, ...]:
        """Numbers of exponents in the gaps."""
        return tuple(len(some) for some in self.zeros)


def count(hill: Hill, layout: Layout) -> Counts:
    """Count localised multipliers; raises CountError where the argument does not turn by whole half turns."""
    zeros = tuple(zeros_in(hill, start, end) for start, end in layout.gaps)
    rough = hill.coarser(ROUGH_STIFFNESS_RATIO)
    turned = sum(_turned(rough, a.sigma, b.sigma) for a, b, covered in layout.intervals if covered) / np.pi
    total = turned - sum(map(len, zeros)) - (0 if layout.pinned else 1) + hill.medium.bound.size
    if abs(total - round(total)) > WHOLE_NUMBER_DISTANCE or round(total) < 0:
        raise CountError(f"the argument of Hill's determinant turns by {total:.3f} half turns")
    return Counts(zeros, round(total))


def _turned(hill: Hill, start: float, end: float) -> float:
    """The change of the argument of D under an arc, from one end to the other."""
    angles = np.pi * np.arange(FIRST_SIGMA_VALUES + 1) / FIRST_SIGMA_VALUES

    def phases(angle: Array) -> Array:
        sigma = 0.5 * (start + end) - 0.5 * (end - start) * np.cos(angle)
        sigma[angle == 0.0], sigma[angle == np.pi] = start, end
        return np.asarray(hill.determinant(sigma)[1], dtype=complex)

    known = phases(angles)
    while True:
        turns = np.angle(known[1:] / known[:-1])
        wide = np.flatnonzero(np.abs(turns) > LARGEST_ARGUMENT_TURN)
        if not wide.size:
            return float(np.sum(turns))
        if known.size > MOST_SIGMA_VALUES or np.min(np.diff(angles)[wide]) < 1e-9:
            raise CountError("a localised multiplier is on an arc of the continuous spectrum")
        middle = 0.5 * (angles[wide] + angles[wide + 1])
        angles = np.insert(angles, wide + 1, middle)
        known = np.insert(known, wide + 1, phases(middle))


@dataclass(frozen=True)
class Gap:
    """A gap between arcs in a variable x from -1 to 1 in which D is analytic; up to Omega with its mirror image."""

    start: End
    end: End

    @property
    def mirrored(self) -> bool:
        """Whether it ends at Omega, where the velocity of the flow makes a double zero."""
        return self.end.name == HALF_END

    @property
    def half(self) -> float:
        """Half its length, of both images."""
        return (self.end.sigma - self.start.sigma) * (1.0 if self.mirrored else 0.5)

    def sigma(self, x: Array) -> Array:
        """Exponents at values of x."""
        away = 2.0 * self.half * np.sin(0.25 * np.pi * (1.0 + x)) ** 2
        return np.asarray(np.minimum(self.start.sigma + away, self.end.sigma))

    def place(self, sigma: float) -> float:
        """x of an exponent."""
        return 4.0 / np.pi * float(np.arcsin(np.sqrt((sigma - self.start.sigma) / (2.0 * self.half)))) - 1.0

    def values(self, hill: Hill, x: Array) -> Array:
        """D at values of x, not at the mirrored end, divided by its double zero there."""
        sigma = self.sigma(x)
        logs, signs = hill.determinant(sigma)
        if self.mirrored:
            logs = logs - 2.0 * np.log((self.end.sigma - sigma) / self.half)
        return np.asarray(np.real(signs) * np.exp(logs))


def zeros_in(hill: Hill, start: End, end: End) -> tuple[float, ...]:
    """Exponents in a gap, all of them as zeros of a converged series."""
    gap = Gap(start, end)
    values = np.empty(0)
    middle = [by_velocity(hill, gap.half)] if gap.mirrored else []
    for degree in SERIES_DEGREES:
        x = chebyshev.nodes(degree)
        x, known = (x[x < 0.0] if gap.mirrored else x), values
        values = np.empty(x.size)
        new = np.full(x.size, True)
        new[: 2 * known.size : 2] = False  # nodes of half the degree
        values[~new], values[new] = known, gap.values(hill, x[new])
        everywhere = np.concatenate([values, middle, values[::-1]]) if gap.mirrored else values
        series = chebyshev.transform(degree) @ everywhere
        if np.sum(np.abs(series[-chebyshev.TAIL_COEFFICIENTS :])) <= CONVERGED_RTOL * np.max(np.abs(series)):
            break
    else:
        raise CountError("Hill's determinant does not converge in a gap")
    _, places, crosses = chebyshev.real_zeros(series[:, None])
    kept = places[crosses & (np.abs(places) < 1.0) & ((places < 0.0) | (not gap.mirrored))]
    return tuple(sorted(gap.sigma(kept).tolist()))


def by_velocity(hill: Hill, gap: float) -> float:
    """D over ((Omega - sigma)/gap)^2 at sigma = Omega, where the velocity of the flow makes a double zero.

    It is the mean over a circle, and even about Omega and real: a quarter of the circle has all of it.
    """
    turns = DOUBLE_ZERO_RADIUS * np.exp(
        0.5j * np.pi * (1.0 + (np.arange(QUARTER_CIRCLE_VALUES) + 0.5) / QUARTER_CIRCLE_VALUES)
    )
    logs, phases = hill.determinant(hill.Omega + gap * turns)
    return float(np.mean(np.real(np.exp(logs) * phases / turns**2)))


def names_of(layout: Layout) -> tuple[str, ...]:
    """Names of the real functions of an orbit that vanish where a localised multiplier passes an end of a gap."""
    found = dict.fromkeys(end.name for gap in layout.gaps for end in gap)
    if START_END in found:
        found |= dict.fromkeys((COSINE_START, SINE_START))
    if HALF_END in found:
        found |= dict.fromkeys((COSINE_HALF, HALF_VELOCITY))
    at_ends = [name for name in found if name not in (START_END, HALF_END)]
    covered = [START_END] if layout.covers_start else []  # real multipliers, whose determinant is real, leave the arcs
    pinned = [COSINE_HALF] if layout.pinned else []  # that of sines falls to 0 where the gap opens
    return (*at_ends, *covered, *pinned)


def function_of(hill: Hill, layout: Layout, name: str) -> float:
    """The value of one of them."""
    if name in (COSINE_START, SINE_START):
        return hill.at_end(0.0, "cosine" if name == COSINE_START else "sine")
    if name == COSINE_HALF:
        return hill.at_end(hill.Omega, "cosine")
    if name == HALF_VELOCITY:
        return by_velocity(hill, Gap(*layout.gaps[-1]).half)
    sigma = next((end.sigma for end in layout.ends if end.name == name), 0.0)
    logs, signs = hill.determinant(np.array([sigma]))
    return float(np.real(signs[0]) * np.exp(logs[0]))


# Orbits along a branch at the edge of a linear medium as the search for changes takes them: equations, and errors -----

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


# Hill's equations of orbits at the edge of an endless tail, and the number of their multipliers off the circle --------

PHASES_PER_COSINE = 4  # values over half a period for each odd cosine
SPARE_PHASES = 16  # further ones


class EdgeHill:
    """Hill's equations of the orbits of a family at the edge of a medium without an end."""

    def __init__(self, coordinates: Coordinates) -> None:
        self.coordinates = coordinates
        self._mapped: dict[int, tuple[ca.Function, Indices, Indices]] = {}

    def off_circle(self, state: OrbitState) -> int | None:
        """Number of localised multipliers outside the circle, of the better orbit; None where they are not counted."""
        best, localised = state.better or state, self.coordinates.localised
        assert localised is not None
        with np.errstate(all="ignore"):
            hill = self.hill(best.problem, best.z)
            layout = Layout(hill.Omega, localised.bands)
            if names_of_arcs(layout) in ((FILLED_GAP,), (NARROW_GAP,)):
                return None
            try:
                return Sample(0.0, 0.0, hill, layout, lambda: hill).counts.off
            except (ArithmeticError, np.linalg.LinAlgError):
                return None

    def _forces(self, count: int) -> tuple[ca.Function, Indices, Indices]:
        """Accelerations and their derivatives at so many phases, and the rows and columns of the second."""
        if count not in self._mapped:
            forces = self.coordinates.solved.rhs_and_jacobian().map(count)
            rows, columns = (np.asarray(part) for part in forces.sparsity_out(1).get_triplet())
            self._mapped[count] = forces, rows, columns
        return self._mapped[count]

    def hill(self, problem: Problem, z: Array) -> Hill:
        """Hill's equations of an orbit."""
        localised = self.coordinates.localised
        assert localised is not None
        medium = Medium(localised.stiffness, localised.coupling, localised.inlet, localised.outlet)
        count, p = PHASES_PER_COSINE * problem.resolution + SPARE_PHASES, medium.sites
        q = problem.sample(z, np.pi * np.arange(count) / count)
        parameter = np.full((1, count), float(z[problem.parameter_index]))
        forces, rows, columns = self._forces(count)
        slopes = forces(q.T, parameter)[1]
        phases, columns = np.divmod(columns, q.shape[1])
        cells = q.shape[1] // p
        own, beside = np.zeros((count, cells, p, p)), np.zeros((count, cells - 1, p, p))
        cell, next_cell = rows // p, columns // p
        if localised.attached >= p:  # the medium is behind the last cell
            cell, next_cell = cells - 1 - cell, cells - 1 - next_cell
        entries = -np.asarray(slopes.nonzeros())
        for target, apart in ((own, 0), (beside, 1)):
            here = next_cell - cell == apart
            target[phases[here], cell[here], rows[here] % p, columns[here] % p] = entries[here]
        parts = [coefficients(part).transpose(1, 0, 2, 3) for part in (own, beside)]
        return Hill(problem.frequency(z), medium, parts[0], parts[1], medium.inlet).without_tail()
