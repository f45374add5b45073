"""The linear tail of a long or infinite chain, solved exactly, with bounds of the effect of its cubic terms.

Beyond the site t of a core the chain goes on with L sites, L finite or not, in a gauge whose linear couplings are c to
either side: (E_k + c (shifts)) a_k = cubic terms, E_k = lambda k^2 - alpha - 2. Where |E_k| > 2c the linear part has an
inverse of norm at most 1/(|E_k| - 2c), and its solution is a_(t+n,k) = u_n a_tk with |u_n| <= |tau_k|^n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from casadi_skin.certify.system import CosineSeries, CosineSystem, ball, system_of
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.lattice.full_chain import FullChain
from casadi_skin.zero.problem import Array

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


# Bounds of the operator A and of the equations in the linear tail of a chain; see `linear_tail` -----------------------


@dataclass(frozen=True, eq=False)
class TailSize:
    """Upper bounds.

    Attributes:
        factor: of |A| on residuals of the tail's sites in the finite part's harmonics.
        square_factor: of |A k^2| on them.
        residual: of the norm of the tail's cubic terms.
        first: of the norm of its first site.
        cubic: of its first cubic coefficient.
        cubic_derivative: of the norm of the cubic terms' derivative at a site.
        derivative: of that of all forces' derivatives with respect to one of its sites.
        slope: of the derivative of S with respect to a harmonic of its sites, over the smallest weight.
    """

    factor: arb
    square_factor: arb
    residual: arb
    first: arb
    cubic: arb
    cubic_derivative: arb
    derivative: arb
    slope: arb

    @classmethod
    def of(cls, series: CosineSeries, nu: arb, norms: Array, weights: Array) -> TailSize:
        """From the centre, the norms of A_f's columns and the weights of harmonics, rounded down."""
        from flint import arb

        tail, square, a = series.system.tail, series.square, series.tail_series
        assert tail is not None
        assert a is not None
        factor, square_factor = arb(0), arb(0)
        for i in range(len(a)):
            k, column = 2 * i + 1, arb(float(norms[1 + tail.site * len(a) + i])) / arb(float(weights[i]))
            size = 1 / tail.gap(k, square) + column * abs(tail.root(k, square))
            factor, square_factor = factor.max(size), square_factor.max(size * k**2)
        first, cubic = tail.first(a, square, nu), tail.cubic * tail.ratio
        bend = 3 * cubic * first**2
        start = tail.first(a, square, arb(1))
        return cls(
            factor,
            square_factor,
            tail.cubic_residual(a, square, nu),
            first,
            cubic,
            bend,
            abs(tail.onsite) + 2 * tail.coupling + bend,
            2 * tail.weight * tail.ratio * start / nu,
        )

    def curvature(self, reach: float) -> arb:
        """Of the cubic terms' second derivative within `reach`."""
        from flint import arb

        return 6 * self.cubic * (self.first + arb(reach))


# The equations of a chain's core with the linear tail that it is coupled to -------------------------------------------


def tailed_system(coordinates: CoreWithTail, S: float, decimals: bool) -> CosineSystem:
    """The equations of the core, in the order of its sites, with the tail that they are coupled to."""
    chain, sites = coordinates.chain, coordinates.core.sites
    alone = FullChain(replace(chain, sites=sites), 1)
    if coordinates.declared is not None:
        lattice, values = coordinates.declared
        alone.declared = lattice.of_cells(sites), values
    core = system_of(alone, S, 2, decimals)
    weak, strong = sorted((core.forces[0][1,], core.forces[1][0,]))  # 1 - |gamma| and 1 + |gamma|
    ratio = ball(weak / strong)
    inner = 0 if chain.gamma > 0 else sites - 1
    unit = core.scale[sites - 1 - inner]
    scale = [unit * ratio.sqrt() ** (sites - 1 - abs(n - inner)) for n in range(sites)]
    system = replace(core, scale=scale)
    terms = dict(system.scaled(inner))
    tail = LinearTail(
        inner,
        int(coordinates.output_sites[0]),
        None if chain.infinite else int(chain.sites) - sites,
        -terms[inner,],
        ball(weak * strong).sqrt(),
        ratio,
        abs(terms[inner, inner, inner]),
        scale[inner] ** 2,
    )
    return replace(system, tail=tail)
