"""Hill's equations of an orbit at the edge of a linear medium: a determinant whose zeros are its localised multipliers.

Perturbations exp(i sigma t) sum_m x_m exp(2 i m Omega t) of an orbit that is odd over half its period have multipliers
exp(i sigma T/2) of the map over half of it. The medium answers every sideband by itself and in closed form, so that
only the cells at the edge are eliminated, one after the other. The determinant D(sigma), over that of the medium
without an edge, is analytic for Im sigma > 0; its zeros are the localised multipliers off the circle. In a gap between
arcs of the continuous spectrum it is real, and its zeros are those on the circle. Under the arcs it is complex, the
limit from above. At sigma = 0 and Omega, where a multiplier of the half period is 1 or -1, cosines and sines part.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.lattice.tail import Tail
from casadi_skin.native import eliminated, kernels
from casadi_skin.stability.flows import OrbitState
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.medium import (
    FILLED_GAP,
    HALF_END,
    NARROW_GAP,
    START_END,
    Gap,
    Layout,
    names_of_arcs,
)
from casadi_skin.zero.coordinates import Coordinates
from casadi_skin.zero.problem import Array, Indices, Problem

ROUND_OFF = 1e-15
NEGLIGIBLE_SIDEBAND = 1e-13  # of the largest coefficient: sidebands that are not coupled
FEWEST_SIDEBANDS, MOST_SIDEBANDS = 4, 60  # sidebands to either side
SPARE_SIDEBANDS = 2  # sidebands beyond those that are coupled
SIGMA_BATCH = 64  # values of sigma at a time

Parity = Literal["cosine", "sine"]


@dataclass(frozen=True, eq=False)
class Hill:
    """The variational equations of one orbit, cell by cell.

    Attributes:
        Omega: frequency of the orbit.
        medium: beyond the cells.
        cells: stiffness of each cell from the medium to the edge, as coefficients of exp(2 i m Omega t), m >= 0, shape
            (cells, harmonics, sites, sites); they are even in time.
        bonds: the same between each cell and the next, (cells - 1, harmonics, sites of the farther, of the nearer one).
        inlet: site of the first cell that is joined to the medium.
        negligible: of the largest coefficient: sidebands that are not coupled.
        further: sidebands beyond those.
    """

    Omega: float
    medium: Tail
    cells: Array
    bonds: Array
    inlet: int
    negligible: float = NEGLIGIBLE_SIDEBAND
    further: int = 0

    @cached_property
    def sidebands(self) -> int:
        """Number of sidebands to either side."""
        sizes = np.max(np.abs(self.cells), axis=(0, 2, 3))
        if self.bonds.size:
            sizes = np.maximum(sizes, np.max(np.abs(self.bonds), axis=(0, 2, 3)))
        last = int(np.flatnonzero(sizes > self.negligible * sizes[0])[-1])
        return int(np.clip(last + SPARE_SIDEBANDS, FEWEST_SIDEBANDS, MOST_SIDEBANDS)) + self.further

    def with_more(self, sidebands: int) -> Hill:
        """The same with more sidebands, which show the error of leaving them out."""
        return replace(self, further=self.further + sidebands)

    def without_tail(self, negligible: float = ROUND_OFF) -> Hill:
        """The same without the first cells, as far as their nonlinear stiffness is negligible beside the largest."""
        own = np.max(np.abs(self.cells[:, 1:]), axis=(1, 2, 3), initial=0.0)
        first = min(int(np.argmax(own > negligible * np.max(np.abs(self.cells)))), len(self.cells) - 1)
        return replace(self, cells=self.cells[first:], bonds=self.bonds[first:])

    def coarser(self, negligible: float) -> Hill:
        """The same without cells and sidebands whose part of the stiffness is negligible."""
        return replace(self.without_tail(negligible), negligible=negligible)

    # The determinant --------------------------------------------------------------------------------------------------

    def determinant(self, sigma: Any) -> tuple[Array, Any]:
        """Logarithms of |D| and D/|D| at values of sigma, real ones from above, shape (values,) each."""
        sigma = np.atleast_1d(sigma)
        m = np.arange(-self.sidebands - 1, self.sidebands + 1)  # symmetric about sigma = Omega
        blocks = self._blocks
        parts = [
            self._eliminated(sigma[n : n + SIGMA_BATCH, None] + 2.0 * m * self.Omega, *blocks)
            for n in range(0, sigma.size, SIGMA_BATCH)
        ]
        logs, phases = zip(*parts, strict=True)
        return np.concatenate(logs), np.concatenate(phases)

    def within(self, gap: Gap, x: Array) -> Array:
        """D at values of x in a gap, not at its mirrored end, divided by the double zero there."""
        sigma = gap.sigma(x)
        logs, signs = self.determinant(sigma)
        if gap.mirrored:
            logs = logs - 2.0 * np.log((gap.end.sigma - sigma) / gap.half)
        return np.asarray(np.real(signs) * np.exp(logs))

    @cached_property
    def _blocks(self) -> tuple[Array, Array]:
        """Cells and bonds as matrices of all sidebands."""
        m = np.arange(2 * self.sidebands + 2)
        return self._toeplitz(self.cells, m[:, None] - m), self._toeplitz(self.bonds, m[:, None] - m)

    def at_end(self, end: float, parity: Parity) -> float:
        """D of cosines or of sines alone at sigma = `end`, 0 or Omega, real outside of arcs."""
        odd, sign = int(end != 0.0), 1.0 if parity == "cosine" else -1.0
        k = np.arange(0 if odd or parity == "cosine" else 1, self.sidebands + 1)
        half = np.sqrt(np.where((k == 0) & (odd == 0), 0.5, 1.0))

        def both(parts: Array) -> Array:
            found = self._toeplitz(parts, k[:, None] - k) + sign * self._toeplitz(parts, k[:, None] + k + odd)
            rows, columns = np.repeat(half, parts.shape[2]), np.repeat(half, parts.shape[3])
            return np.asarray(found * rows[:, None] * columns)

        frequency = (2.0 * k[None] + odd) * self.Omega
        logs, phases = self._eliminated(frequency, both(self.cells), both(self.bonds))
        return float(np.real(phases[0])) * float(np.exp(logs[0]))

    def _toeplitz(self, parts: Array, apart: NDArray[np.int64]) -> Array:
        """Coefficients (cells, harmonics, a, b) as matrices of sidebands by sites, (cells, size, size)."""
        apart, known = np.abs(apart), parts.shape[1]
        blocks = np.where((apart < known)[:, :, None, None], parts[:, np.minimum(apart, known - 1)], 0.0)
        cells, rows, columns, a, b = blocks.shape
        return np.asarray(blocks.transpose(0, 1, 3, 2, 4).reshape(cells, rows * a, columns * b))

    def _eliminated(self, frequency: Any, cells: Array, bonds: Array) -> tuple[Array, Any]:
        """Logarithms and phases of D, cell by cell from the medium to the edge; frequencies (values, sidebands)."""
        _, response, free = self.medium.answers(frequency)
        values, count, p = frequency.shape[0], frequency.shape[1], len(self.medium.stiffness)
        squares = np.repeat(frequency**2, p, axis=1)
        diagonal, at_inlet = np.arange(count * p), np.arange(count) * p + self.inlet
        sizes = 1.0 + (2.0 * self.Omega * np.arange(-(count // 2), count - count // 2)[:, None]) ** 2
        poles = np.prod((frequency[:, :, None] ** 2 - self.medium.bound) / sizes, axis=2)  # of the medium's answer
        logs = np.sum(np.log(np.maximum(np.abs(poles), 1e-300)), axis=1)
        phases = np.prod(np.where(poles == 0.0, 1.0, poles / np.maximum(np.abs(poles), 1e-300)), axis=1)
        logs -= len(cells) * np.sum(np.log(np.abs(free)), axis=1)
        phases = phases / np.prod(free / np.abs(free), axis=1) ** len(cells)
        log, phase, behind = self._but_the_first(squares, cells, bonds)
        A = np.empty((values, count * p, count * p), np.result_type(squares, response))
        A[:] = cells[0] - (0.0 if behind is None else self._through(bonds, 0, behind))
        A[:, diagonal, diagonal] -= squares
        A[:, at_inlet, at_inlet] -= self.medium.coupling**2 * response
        sign, last = np.linalg.slogdet(A)
        phases = phases * phase * sign
        return logs + log + last, phases / np.abs(phases)

    def _but_the_first(self, squares: Any, cells: Array, bonds: Array) -> tuple[Any, Any, Any]:
        """Logarithm and phase of the determinant of all cells but that at the medium, and the response of the next.

        They are eliminated from the edge on: what the medium answers, alone complex at real exponents, comes last.
        """
        if kernels() and len(cells) > 1 and self._springs is not None:
            return eliminated(cells, *self._springs, len(self.medium.stiffness), squares)
        log, phase, behind = 0.0, 1.0, None
        for n in range(len(cells) - 1, 0, -1):
            A = np.asarray(cells[n] - (0.0 if behind is None else self._through(bonds, n, behind)), squares.dtype)
            A = np.array(np.broadcast_to(A, (len(squares), *cells[n].shape)))
            diagonal = np.arange(len(cells[n]))
            A[:, diagonal, diagonal] -= squares
            sign, more = np.linalg.slogdet(A)
            log, phase, behind = log + more, phase * sign, np.linalg.inv(A)
        return log, phase, behind

    def _through(self, bonds: Array, n: int, behind: Any) -> Any:
        """The effect on a cell of the response of the next one."""
        return bonds[n] @ behind @ bonds[n].T

    @cached_property
    def _springs(self) -> tuple[Array, tuple[int, int]] | None:
        """Bonds as numbers, and the sites of two cells that they join; None where they oscillate or join others."""
        p = len(self.medium.stiffness)
        sizes = np.max(np.abs(self.bonds), axis=0, initial=0.0)
        a, b = divmod(int(np.argmax(sizes[0])), p)
        sizes[0, a, b] = 0.0
        springs = np.asarray(self.bonds[:, 0, a, b])
        return (springs, (a, b)) if np.max(sizes) <= ROUND_OFF * self.medium.coupling else None


def coefficients(samples: Array) -> Array:
    """Coefficients of exp(2 i m Omega t), m >= 0, of an even function from values over half a period, one a row."""
    return np.asarray(np.fft.rfft(samples, axis=0).real / len(samples))


# The number of localised multipliers: those on the circle gap by gap, and those off it by the argument ----------------
#
# The determinant of Hill's equations tends to 1 where perturbations grow fast, and is periodic along the real axis, so
# that its argument turns there once for every zero above. Zeros on the axis are those in gaps, where it is real: they,
# and the one of the velocity of the flow, are passed above, by half a turn each.

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

    @property
    def numbers(self) -> tuple[tuple[int, ...], int]:
        """These, and the number off the circle."""
        return self.inside, self.off


def count(hill: Hill, layout: Layout) -> Counts:
    """Count localised multipliers; raises CountError where the argument does not turn by whole half turns."""
    zeros = tuple(zeros_in(hill, gap) for gap in layout.gaps)
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


def zeros_in(hill: Hill, gap: Gap) -> tuple[float, ...]:
    """Exponents in a gap, all of them as zeros of a converged series."""
    values = np.empty(0)
    middle = [by_velocity(hill, gap.half)] if gap.mirrored else []
    for degree in SERIES_DEGREES:
        x = chebyshev.nodes(degree)
        x, known = (x[x < 0.0] if gap.mirrored else x), values
        values = np.empty(x.size)
        new = np.full(x.size, True)
        new[: 2 * known.size : 2] = False  # nodes of half the degree
        values[~new], values[new] = known, hill.within(gap, x[new])
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
    found = dict.fromkeys(end.name for gap in layout.gaps for end in (gap.start, gap.end))
    if START_END in found:
        found |= dict.fromkeys((COSINE_START, SINE_START))
    if HALF_END in found:  # that of cosines alone is zero where Omega is extremal, and no multiplier passes
        found[HALF_VELOCITY] = None
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
        return by_velocity(hill, layout.gaps[-1].half)
    sigma = next((end.sigma for end in layout.ends if end.name == name), 0.0)
    logs, signs = hill.determinant(np.array([sigma]))
    return float(np.real(signs[0]) * np.exp(logs[0]))


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
        with np.errstate(all="ignore"):  # what is not finite is not counted: None
            hill = self.hill(best.problem, best.z)
            layout = Layout(hill.Omega, localised.bands)
            if names_of_arcs(layout) in ((FILLED_GAP,), (NARROW_GAP,)):
                return None
            try:
                return count(hill, layout).off
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
        medium = Tail(np.inf, localised.stiffness, localised.coupling, localised.inlet, localised.outlet)
        count, p = PHASES_PER_COSINE * problem.resolution + SPARE_PHASES, len(medium.stiffness)
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
