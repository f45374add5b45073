"""Arcs of the continuous spectrum and the gaps between them, as exponents sigma from 0 to Omega, with all their ends.

A wave of frequency omega has the exponents +-omega modulo 2 Omega; up to their sign they are between 0 and Omega.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

SAME = 1e-12  # of Omega: ends that coincide
START, HALF = "0", "Omega"  # ends of the interval, where multipliers of half a period are 1 and -1


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
            for turns in range(int(low / Omega + SAME), int(np.ceil(high / Omega - SAME))):
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
        found = [End(START, 0.0), End(HALF, self.Omega)]
        for k, frequency in enumerate(np.ravel(self.bands).tolist()):
            turns = int(frequency / self.Omega)
            found.append(End(f"edge {k} {turns}", self._folded(frequency, turns), k, turns))
        return tuple(sorted(found, key=lambda end: (end.sigma, end.name != START, end.name == HALF)))

    def covered(self, sigma: float) -> tuple[int, ...]:
        """Signatures of the arcs over an exponent."""
        return tuple(piece.sign for piece in self.pieces if piece.start < sigma < piece.end)

    @cached_property
    def intervals(self) -> tuple[tuple[End, End, bool], ...]:
        """Between neighbouring ends: both, and whether an arc covers what is between."""
        width = SAME * self.Omega
        apart = [(a, b) for a, b in pairwise(self._distinct) if b.sigma - a.sigma > width]
        return tuple((a, b, bool(self.covered(0.5 * (a.sigma + b.sigma)))) for a, b in apart)

    @cached_property
    def _distinct(self) -> tuple[End, ...]:
        """Ends, of those that coincide one: a multiple of Omega rather than the edge that is pinned to it."""
        width, found = SAME * self.Omega, list[End]()
        for end in self.ends:
            if not found or end.sigma - found[-1].sigma > width:
                found.append(end)
            elif end.name == HALF:
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
        return self.pinned and self.off_edge > SAME

    @property
    def off_edge(self) -> float:
        """Relative distance of the edges of bands from odd multiples of Omega."""
        ratios = np.ravel(self.bands) / self.Omega
        nearest = 2.0 * np.round(0.5 * (ratios - 1.0)) + 1.0
        return float(np.min(np.abs(ratios - nearest) / ratios))

    @property
    def pinned(self) -> bool:
        """Whether the orbit's frequency, or an odd multiple of it, is at the edge of a band."""
        return not any(b.name == HALF for _, b in self.gaps)

    def sums(self) -> tuple[tuple[float, bool], ...]:
        """Frequencies Omega at which two ends meet, times 2 m, and whether waves of opposite signatures do."""
        edges = np.ravel(self.bands)
        pairs = [(float(edges[a]), float(edges[b])) for a in range(edges.size) for b in range(a, edges.size)]
        return tuple([(a + b, True) for a, b in pairs] + [(b - a, False) for a, b in pairs if b > a])


def crossings(first: Layout, last: Layout) -> list[float]:
    """Frequencies between those of two layouts at which two ends meet, in the order from one to the other."""
    low, high = sorted((first.Omega, last.Omega))
    found = set()
    for total, _ in first.sums():
        for m in range(int(np.ceil(total / (2.0 * high))), int(total / (2.0 * low)) + 1):
            if m and low * (1.0 + SAME) < total / (2.0 * m) < high * (1.0 - SAME):
                found.add(total / (2.0 * m))
    return sorted(found, reverse=first.Omega > last.Omega)
