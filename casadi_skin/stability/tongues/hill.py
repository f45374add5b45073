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

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native.elimination import eliminated
from casadi_skin.stability.tongues.waves import Medium
from casadi_skin.zero.problem import Array

ROUND_OFF = 1e-15
NEGLIGIBLE = 1e-13  # of the largest coefficient: sidebands that are not coupled
FEWEST, MOST = 4, 60  # sidebands to either side
SPARE = 2  # sidebands beyond those that are coupled
BATCH = 64  # values of sigma at a time

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
    negligible: float = NEGLIGIBLE
    further: int = 0

    @cached_property
    def sidebands(self) -> int:
        """Number of sidebands to either side."""
        sizes = np.max(np.abs(self.cells), axis=(0, 2, 3))
        if self.bonds.size:
            sizes = np.maximum(sizes, np.max(np.abs(self.bonds), axis=(0, 2, 3)))
        last = int(np.flatnonzero(sizes > self.negligible * sizes[0])[-1])
        return int(np.clip(last + SPARE, FEWEST, MOST)) + self.further

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
            self._eliminated(sigma[n : n + BATCH, None] + 2.0 * m * self.Omega, *blocks)
            for n in range(0, sigma.size, BATCH)
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
        if len(cells) > 1 and self._springs is not None:
            springs, ends = self._springs
            found = eliminated(cells, springs, ends, self.medium.sites, squares)
            if found is not None:
                behind, log, phase = found
                return log, phase, behind
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
