"""Bounds of the operator A and of the equations in the linear tail of a chain; see `linear_tail`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from casadi_skin.certify.cosine_system import CosineSeries
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
