"""The equations linearised about a proved orbit: an enclosure of their coefficients, symmetric where forces are.

lambda v'' = G(theta) v with G = Dphi(q) = sum over p of G_p exp(i p theta), p even where the orbit's harmonics are odd,
G_-p = G_p real. The orbit itself is known within a radius of the centre, which moves every G_p and lambda: `radius` and
`square` hold that too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.certify.balls import Enclosed, above, below, rounded_up
from casadi_skin.certify.cosine_system import CosineSeries, CosineSystem
from casadi_skin.certify.lipschitz import curvature, series_norms
from casadi_skin.certify.model_terms import potential, weights_of
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from flint import arb


@dataclass(frozen=True, eq=False)
class Linearised:
    """Enclosures of the coefficients about the true orbit.

    Attributes:
        blocks: doubles near G_0, G_step, ..., shape (number, positions, positions).
        radius: bound of the norm of the difference of G and the true one: largest sum over rows and p of moduli in a
            column; where symmetric, of the norm in the Euclidean sense at every theta as well.
        square: ball of lambda.
        symmetric: whether blocks and truth are symmetric matrices.
        step: of p and of the harmonics of solutions, 2 or 1.
        exact: by row and column balls of the entries of G_0, G_step, ... about the orbit's centre.
        moved: the part of `radius` that is the orbit's own.
    """

    blocks: Array
    radius: float
    square: arb
    symmetric: bool
    step: int = 2
    exact: Mapping[tuple[int, int], Sequence[arb]] | None = None
    moved: float = 0.0

    def harmonics(self, highest: int) -> Array:
        """m from -highest to highest, multiples of the step as `highest` is."""
        return np.arange(-highest, highest + 1, self.step, dtype=float)

    def grown(self, highest: int, factor: float) -> int:
        """A multiple of the step near `factor` times another."""
        return self.step * int(np.ceil(factor * highest / self.step))

    @property
    def positions(self) -> int:
        return int(self.blocks.shape[1])

    @property
    def sizes(self) -> Array:
        """Upper bounds of the norms of the G_p, both Euclidean and by columns, without `radius`."""
        return _norms(np.abs(self.blocks))


def linearised(series: CosineSeries, nu: arb, radius: float, reach: float) -> Linearised:
    """The coefficients at the true orbit, which lies within `radius` of a series.

    In positions in which the matrices are symmetric where the linear couplings have such; `reach` is at least `radius`.
    """
    from flint import arb

    n, scale = series.system.positions, _symmetric_scale(series.system)
    symmetric = scale is not None
    scale = [arb(1)] * n if scale is None else scale
    rows = [series.derivatives(m) for m in range(n)]
    count = max((len(g) for row in rows for g in row.values()), default=1)
    exact = dict[tuple[int, int], list[arb]]()
    blocks, radii = np.zeros((count, n, n)), np.zeros((count, n, n))
    for m, row in enumerate(rows):
        for k, g in row.items():
            exact[m, k] = [value * scale[m] / scale[k] for value in g]
            enclosed = Enclosed.of(exact[m, k])
            blocks[: len(g), m, k], radii[: len(g), m, k] = enclosed.middle, enclosed.radius
    if symmetric:  # the true matrices are, so that the other triangle encloses an entry as well
        lower = np.tril(blocks) + np.tril(blocks, -1).swapaxes(1, 2)
        radii, blocks = radii + 2.0 * np.abs(lower - blocks), lower
    own = rounded_up(np.concatenate([radii[:1], 2.0 * radii[1:]]).sum(axis=0), count + 2)
    moved = (
        curvature(series.system, series_norms(series, nu), reach)
        * arb(radius)
        * arb(max(map(above, scale)))
        / arb(min(map(below, scale)))
    )
    doubt = above(arb(float(_norms(own[None])[0])) + moved)
    square = series.square + arb(0, radius)
    return Linearised(blocks, doubt, square, symmetric, series.system.step, exact, above(moved))


def _symmetric_scale(system: CosineSystem) -> list[arb] | None:
    """Factors s_n with s_n phi_n(q) the negative gradient of a potential of s_n q_n; None where there is none."""
    from flint import arb, fmpq

    weights = weights_of(system.forces, 0)
    if weights is None or potential(system.forces, 0) is None:
        return None
    factors = [arb(fmpq(w.numerator, w.denominator)).sqrt() * d for w, d in zip(weights, system.scale, strict=True)]
    return [factor / factors[0] for factor in factors]


def _norms(matrices: Array) -> Array:
    """Upper bounds of the norms of matrices of numbers >= 0, Euclidean and by columns, shape (matrices,)."""
    largest = np.maximum(matrices.sum(axis=1).max(axis=1), matrices.sum(axis=2).max(axis=1))
    return rounded_up(largest, matrices.shape[1])
