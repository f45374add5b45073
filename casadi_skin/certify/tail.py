"""The linear tail of a long or infinite chain, solved exactly, with bounds of the effect of its cubic terms.

Beyond the site t of a core the chain goes on with L sites, L finite or not, in a gauge whose linear couplings are c to
either side: (E_k + c (shifts)) a_k = cubic terms, E_k = lambda k^2 - alpha - 2. Where |E_k| > 2c the linear part has an
inverse of norm at most 1/(|E_k| - 2c), and its solution is a_(t+n,k) = u_n a_tk with |u_n| <= |tau_k|^n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from flint import arb


@dataclass(frozen=True, eq=False)
class LinearTail:
    """A tail of a chain's core.

    Attributes:
        site: index of the core's site that it is coupled to.
        first_site: number of the core's first site.
        length: number of its sites; None where it has no end.
        onsite: alpha + 2.
        coupling: c.
        ratio: of the squares of the gauge's factors of neighbours, away from the core.
        cubic: modulus of the cubic coefficient at the core's site, in scaled positions.
        weight: square of the gauge's factor there.
    """

    site: int
    first_site: int
    length: int | None
    onsite: arb
    coupling: arb
    ratio: arb
    cubic: arb
    weight: arb

    def energy(self, k: int, square: arb) -> arb:
        """E_k."""
        return square * k**2 - self.onsite

    def gap(self, k: int, square: arb) -> arb:
        """|E_k| - 2c; raises ValueError where it is not positive."""
        gap = abs(self.energy(k, square)) - 2 * self.coupling
        if not gap > 0:
            times = f"{k} times " if k > 1 else ""
            raise ValueError(f"{times}Omega lies in the band, accepted: outside of it, where the tail decays")
        return gap

    def root(self, k: int, square: arb) -> arb:
        """tau_k, of modulus below 1: the ratio of neighbours in a tail without end."""
        self.gap(k, square)
        E, c = self.energy(k, square), self.coupling
        size = 2 * c / (abs(E) + (E**2 - 4 * c**2).sqrt())
        return -size if E > 0 else size

    def share(self, k: int, square: arb) -> arb:
        """u_1."""
        tau = self.root(k, square)
        if self.length is None:
            return tau
        return (tau - tau ** (2 * self.length + 1)) / (1 - tau ** (2 * self.length + 2))

    def squares(self, k: int, square: arb) -> arb:
        """Sum of u_n^2 over the tail."""
        tau = self.root(k, square)
        if self.length is None:
            return tau**2 / (1 - tau**2)
        L, far = self.length, tau ** (2 * self.length + 2)
        near = (tau**2 + far * tau**2) * (1 - tau ** (2 * L)) / (1 - tau**2)
        return (near - 2 * L * far) / (1 - far) ** 2

    def first(self, series: Sequence[arb], square: arb, nu: arb) -> arb:
        """Bound of the norm of the first site of the tail, from the series of the core's site."""
        from flint import arb

        total = arb(0)
        for i, a in enumerate(series):
            total += abs(a * self.root(2 * i + 1, square)) * nu ** (2 * i + 1)
        return total

    def amplitude(self, series: Sequence[arb], square: arb) -> arb:
        """Contribution of the tail to S, as a ball from 0 to its bound."""
        from flint import arb

        first, slowest = self.first(series, square, arb(1)), self.slowest(len(series), square)
        largest = self.weight * self.ratio * first**2 / (1 - self.ratio * slowest**2)
        return largest.union(arb(0))

    def slowest(self, harmonics: int, square: arb) -> arb:
        """Largest |tau_k|."""
        from flint import arb

        largest = arb(0)
        for i in range(harmonics):
            largest = largest.max(abs(self.root(2 * i + 1, square)))
        return largest

    def cubic_residual(self, series: Sequence[arb], square: arb, nu: arb) -> arb:
        """Bound of the norm of the tail's cubic terms."""
        slowest = self.slowest(len(series), square)
        return self.cubic * self.ratio * self.first(series, square, nu) ** 3 / (1 - self.ratio * slowest**3)
