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

from casadi_skin.bvp.problem import Array
from casadi_skin.stability.waves import Medium

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
        beta, response, free = self.medium.answers(frequency)
        values, count, p = frequency.shape[0], frequency.shape[1], self.medium.sites
        squares = np.repeat(frequency**2, p, axis=1)
        complex_ = np.iscomplexobj(beta)
        diagonal, at_inlet = np.arange(count * p), np.arange(count) * p + self.inlet
        sizes = 1.0 + (2.0 * self.Omega * np.arange(-(count // 2), count - count // 2)[:, None]) ** 2
        poles = np.prod((frequency[:, :, None] ** 2 - self.medium.bound) / sizes, axis=2)  # of the medium's answer
        logs = np.sum(np.log(np.maximum(np.abs(poles), 1e-300)), axis=1)
        phases = np.prod(np.where(poles == 0.0, 1.0, poles / np.maximum(np.abs(poles), 1e-300)), axis=1)
        log_free = np.sum(np.log(np.abs(free)), axis=1)
        phase_free = np.prod(free / np.abs(free), axis=1)
        behind: Any = None
        for n, cell in enumerate(cells):
            A = np.empty((values, count * p, count * p), complex if complex_ else float)
            A[:] = cell
            A[:, diagonal, diagonal] -= squares
            if n == 0:
                A[:, at_inlet, at_inlet] -= self.medium.coupling**2 * response
            else:
                bond = bonds[n - 1]
                A -= bond.T @ behind @ bond
            sign, log = np.linalg.slogdet(A)
            logs += log - log_free
            phases = phases * sign / phase_free
            if n + 1 < len(cells):
                behind = np.linalg.inv(A)
        return logs, phases / np.abs(phases)


def coefficients(samples: Array) -> Array:
    """Coefficients of exp(2 i m Omega t), m >= 0, of an even function from values over half a period, one a row."""
    return np.asarray(np.fft.rfft(samples, axis=0).real / len(samples))
