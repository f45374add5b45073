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
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native import eliminated, kernels
from casadi_skin.zero.problem import Array

# Waves of a linear medium of alike cells, as its end answers them: decay from cell to cell, and the response there ----

AT_EDGE = 1e-13  # |C| - 1 below which a frequency is at the edge of a band
COMPLEX_STEP = 1e-20  # imaginary, for a derivative


@dataclass(frozen=True, eq=False)
class Medium:
    """A half-infinite row of alike cells with unit masses, each joined to the next by one bond.

    Attributes:
        stiffness: symmetric, of one cell, shape (sites, sites).
        coupling: s > 0 of the bonds that join cells.
        inlet, outlet: sites of a cell that are joined to the far side and to the near side.
    """

    stiffness: Array
    coupling: float
    inlet: int = 0
    outlet: int = 0

    @property
    def sites(self) -> int:
        """Sites of a cell."""
        return len(self.stiffness)

    @cached_property
    def _spectral(self) -> tuple[Array, Array, Array, Array]:
        """Eigenvalues of a cell, weights of cofactors oo and oi, and eigenvalues without o and i."""
        values, vectors = np.linalg.eigh(self.stiffness)
        kept = [n for n in range(self.sites) if n not in (self.inlet, self.outlet)]
        rest = np.asarray(np.linalg.eigvalsh(self.stiffness[np.ix_(kept, kept)]) if kept else np.empty(0))
        o, i = vectors[self.outlet], vectors[self.inlet]
        return np.asarray(values), np.asarray(o * o), np.asarray(o * i), rest

    def _cofactors(self, z: Any) -> tuple[Any, Any, Any, Any]:
        """D, N_oo, N_oi and N_2 at squares of frequencies."""
        values, oo, oi, rest = self._spectral
        apart = values - np.asarray(z)[..., None]
        others = np.stack([np.prod(np.delete(apart, n, axis=-1), axis=-1) for n in range(self.sites)], axis=-1)
        both = 0.0 if self.inlet == self.outlet else np.prod(rest - np.asarray(z)[..., None], axis=-1)
        return np.prod(apart, axis=-1), others @ oo, others @ oi, both

    @cached_property
    def bound(self) -> Array:
        """Squares of the frequencies of states bound at its end: where it answers without limit."""
        kept = [n for n in range(self.sites) if n != self.inlet]
        if not kept:
            return np.empty(0)
        z = np.linalg.eigvalsh(self.stiffness[np.ix_(kept, kept)])  # the inlet is at rest in such a state
        D, _, oi, _ = self._cofactors(z)
        return np.asarray(z[np.abs(D) < np.abs(self.coupling * oi)])

    def cosine(self, z: Any) -> Any:
        """C at squares of frequencies: within -1 and 1 in the bands."""
        D, _, oi, both = self._cofactors(z)
        return (D - self.coupling**2 * both) / (2.0 * self.coupling * oi)

    def answers(self, frequency: Any) -> tuple[Any, Any, Any]:
        """The answer of the medium to each frequency, to real ones the limit from above.

        Returns:
            beta; the response at the outlet of its first cell to a force there; and the determinant of a cell with
            the rest of the medium behind it, which is nowhere zero.
        """
        z = np.asarray(frequency) ** 2
        D, oo, oi, both = self._cofactors(z)
        C = (D - self.coupling**2 * both) / (2.0 * self.coupling * oi)
        beta = self._beyond(C) if np.iscomplexobj(z) else self._on_axis(C, z, np.asarray(frequency))
        return beta, oo / (D - self.coupling * oi * beta), self.coupling * oi / beta

    def _beyond(self, C: Any) -> Any:
        root = np.sqrt(C - 1.0) * np.sqrt(C + 1.0)
        large = np.where(np.abs(C + root) >= np.abs(C - root), C + root, C - root)
        return 1.0 / large

    def _on_axis(self, C: Array, z: Array, frequency: Array) -> Any:
        C = np.where(np.abs(np.abs(C) - 1.0) <= AT_EDGE, np.sign(C), C)
        root, inside = np.sqrt(np.abs(C * C - 1.0)), np.abs(C) < 1.0
        decays = 1.0 / (C + np.where(C >= 0.0, root, -root))
        if not inside.any():
            return decays
        slope = np.imag(self.cosine(z + 1j * COMPLEX_STEP * np.maximum(np.abs(z), 1.0)))
        return np.where(inside, C - 1j * np.sign(slope * frequency) * root, decays)


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
    medium: Medium
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
        values, count, p = frequency.shape[0], frequency.shape[1], self.medium.sites
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
            return eliminated(cells, *self._springs, self.medium.sites, squares)
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
        p = self.medium.sites
        sizes = np.max(np.abs(self.bonds), axis=0, initial=0.0)
        a, b = divmod(int(np.argmax(sizes[0])), p)
        sizes[0, a, b] = 0.0
        springs = np.asarray(self.bonds[:, 0, a, b])
        return (springs, (a, b)) if np.max(sizes) <= ROUND_OFF * self.medium.coupling else None


def coefficients(samples: Array) -> Array:
    """Coefficients of exp(2 i m Omega t), m >= 0, of an even function from values over half a period, one a row."""
    return np.asarray(np.fft.rfft(samples, axis=0).real / len(samples))


# Arcs of the continuous spectrum and the gaps between them, as exponents sigma from 0 to Omega, with all their ends

SAME_END_RTOL = 1e-12  # of Omega: ends that coincide
START_END, HALF_END = "0", "Omega"  # ends of the interval, where multipliers of half a period are 1 and -1


@dataclass(frozen=True)
class End:
    """An end of a gap, or a place where arcs meet: that of a band's frequency number `edge`, or START or HALF.

    `turns` is the number of half turns Omega that are taken off the frequency.
    """

    name: str
    sigma: float
    edge: int = -1
    turns: int = 0


@dataclass(frozen=True)
class Piece:
    """An arc, or the part of it between two multiples of Omega; `sign` is the Krein signature of its waves."""

    start: float
    end: float
    sign: int


@dataclass(frozen=True)
class Layout:
    """Arcs and gaps of waves of `bands`, lowest and highest frequency of each, for orbits of frequency Omega."""

    Omega: float
    bands: tuple[tuple[float, float], ...]

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """All arcs, folded into the interval from 0 to Omega."""
        found, Omega = [], self.Omega
        for low, high in self.bands:
            for turns in range(int(low / Omega + SAME_END_RTOL), int(np.ceil(high / Omega - SAME_END_RTOL))):
                first, last = max(low, turns * Omega), min(high, (turns + 1) * Omega)
                one, other = self._folded(first, turns), self._folded(last, turns)
                found.append(Piece(min(one, other), max(one, other), 1 if turns % 2 == 0 else -1))
        return tuple(found)

    def _folded(self, frequency: float, turns: int) -> float:
        sigma = frequency - turns * self.Omega if turns % 2 == 0 else (turns + 1) * self.Omega - frequency
        return float(np.clip(sigma, 0.0, self.Omega))

    @cached_property
    def ends(self) -> tuple[End, ...]:
        """Edges of all bands and the ends of the interval, ascending."""
        found = [End(START_END, 0.0), End(HALF_END, self.Omega)]
        for k, frequency in enumerate(np.ravel(self.bands).tolist()):
            turns = int(frequency / self.Omega)
            found.append(End(f"edge {k} {turns}", self._folded(frequency, turns), k, turns))
        return tuple(sorted(found, key=lambda end: (end.sigma, end.name != START_END, end.name == HALF_END)))

    def covered(self, sigma: float) -> tuple[int, ...]:
        """Signatures of the arcs over an exponent."""
        return tuple(piece.sign for piece in self.pieces if piece.start < sigma < piece.end)

    @cached_property
    def intervals(self) -> tuple[tuple[End, End, bool], ...]:
        """Between neighbouring ends: both, and whether an arc covers what is between."""
        width = SAME_END_RTOL * self.Omega
        apart = [(a, b) for a, b in pairwise(self._distinct) if b.sigma - a.sigma > width]
        return tuple((a, b, bool(self.covered(0.5 * (a.sigma + b.sigma)))) for a, b in apart)

    @cached_property
    def _distinct(self) -> tuple[End, ...]:
        """Ends, of those that coincide one: a multiple of Omega rather than the edge that is pinned to it."""
        width, found = SAME_END_RTOL * self.Omega, list[End]()
        for end in self.ends:
            if not found or end.sigma - found[-1].sigma > width:
                found.append(end)
            elif end.name == HALF_END:
                found[-1] = end
        return tuple(found)

    @cached_property
    def gaps(self) -> tuple[tuple[End, End], ...]:
        """Intervals that no arc covers, ascending."""
        return tuple((a, b) for a, b, covered in self.intervals if not covered)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The order of all ends, with what is covered: alike along a stretch on which no two of them meet."""
        words = [f"{a.name} {'=' if covered else '-'}" for a, _, covered in self.intervals]
        return (*words, self.intervals[-1][1].name)

    @property
    def covers_start(self) -> bool:
        """Whether arcs cover the exponent 0: waves of a multiple of 2 Omega are in a band."""
        return self.intervals[0][2]

    @property
    def fills(self) -> bool:
        """Whether a harmonic of the orbit is within a band, so that it fills the medium."""
        return self.pinned and self.off_edge > SAME_END_RTOL

    @property
    def off_edge(self) -> float:
        """Relative distance of the edges of bands from odd multiples of Omega."""
        ratios = np.ravel(self.bands) / self.Omega
        nearest = 2.0 * np.round(0.5 * (ratios - 1.0)) + 1.0
        return float(np.min(np.abs(ratios - nearest) / ratios))

    @property
    def pinned(self) -> bool:
        """Whether the orbit's frequency, or an odd multiple of it, is at the edge of a band."""
        return not any(b.name == HALF_END for _, b in self.gaps)

    def sums(self) -> tuple[float, ...]:
        """Frequencies Omega at which two ends meet, times 2 m."""
        edges = np.ravel(self.bands)
        pairs = [(float(edges[a]), float(edges[b])) for a in range(edges.size) for b in range(a, edges.size)]
        return tuple([a + b for a, b in pairs] + [b - a for a, b in pairs if b > a])


def crossings(first: Layout, last: Layout) -> list[float]:
    """Frequencies between those of two layouts at which two ends meet, in the order from one to the other."""
    low, high = sorted((first.Omega, last.Omega))
    found = set()
    for total in first.sums():
        for m in range(int(np.ceil(total / (2.0 * high))), int(total / (2.0 * low)) + 1):
            if m and low * (1.0 + SAME_END_RTOL) < total / (2.0 * m) < high * (1.0 - SAME_END_RTOL):
                found.add(total / (2.0 * m))
    return sorted(found, reverse=first.Omega > last.Omega)
