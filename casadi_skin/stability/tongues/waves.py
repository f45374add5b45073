"""Waves of a linear medium of alike cells, as its end answers them: decay from cell to cell, and the response there.

With z the square of a frequency, D, N_oo, N_oi the determinant and cofactors of K - z and N_2 that without sites o and
i (see `lattice.cell_tail`), waves change from cell to cell by beta: beta + 1/beta = 2 C, C = (D - s^2 N_2)/(2 s N_oi).
Of the two beta perturbations that grow in time have the one below 1 in modulus: on the real axis of frequencies that is
the limit from above, the wave that carries energy away.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from casadi_skin.zero.problem import Array

AT_EDGE = 1e-13  # |C| - 1 below which a frequency is at the edge of a band
STEP = 1e-20  # imaginary, for a derivative


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
        slope = np.imag(self.cosine(z + 1j * STEP * np.maximum(np.abs(z), 1.0)))
        return np.where(inside, C - 1j * np.sign(slope * frequency) * root, decays)
