"""Cosine systems of a core whose linear tail is eliminated, and what the tail adds to their bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from casadi_skin.certify.balls import ball
from casadi_skin.certify.system import CosineSeries, CosineSystem, system_of
from casadi_skin.certify.tail import LinearTail
from casadi_skin.lattice.chain_coordinates import FullChain, LongChain
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from flint import arb


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


def tailed_system(coordinates: LongChain, S: float, decimals: bool) -> CosineSystem:
    """The equations of the core, in the order of its sites, with the tail that they are coupled to."""
    chain, sites = coordinates.chain, coordinates.core.cells
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
