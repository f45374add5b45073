"""The bound W of the theorem: how much A DF changes within a ball, from norms of A and the majorants of the forces."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.certify.balls import ROUNDING, above
from casadi_skin.certify.cosine_system import CosineSeries, CosineSystem
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from flint import arb


@dataclass(frozen=True, eq=False)
class OperatorSize:
    """Upper bounds of the image of residuals under the operator A.

    Attributes:
        norms: of the weighted norms of the columns of A_f, shape (1 + positions * harmonics,).
        weights: lower bounds of the weights of these columns.
        beyond: of 1 + the norm that a unit of the tail's rows passes to the finite part through the amplitude's row.
        inverse_square: of the factor of the tail's rows times k^2, which is near 1/lambda.
    """

    norms: Array
    weights: Array
    beyond: arb
    inverse_square: arb

    def lipschitz(
        self, system: CosineSystem, nu: arb, curved: arb, in_tail: arb | None = None, squares_in_tail: arb | None = None
    ) -> float:
        """Lipschitz constant of A DF where the forces' second derivatives are at most `curved`.

        In a tail of sites A is at most `in_tail`, and A k^2 `squares_in_tail`.
        """
        from flint import arb

        n = system.positions
        harmonics = (self.norms.size - 1) // n
        numbers = np.array([float(system.harmonic(i)) for i in range(harmonics)])
        columns = self.norms / self.weights * (1.0 + ROUNDING)
        rows = self.inverse_square * self.beyond
        whole = arb(float(np.max(columns[1:]))).max(rows / system.harmonic(harmonics) ** 2)
        squares = np.concatenate([[0.0], np.tile(numbers**2, n)])
        through_square = arb(float(np.max(columns * squares) * (1.0 + ROUNDING))).max(rows)
        if in_tail is not None and squares_in_tail is not None:
            whole, through_square = whole.max(in_tail), through_square.max(squares_in_tail)
        through_amplitude = arb(float(self.norms[0])) * _amplitude_curvature(system) / nu ** (2 * system.harmonic(0))
        return above(through_square + through_amplitude + whole * curved)


def _amplitude_curvature(system: CosineSystem) -> arb:
    """Largest modulus of a second derivative of the amplitude."""
    from flint import arb

    second = dict[tuple[int, int], arb]()
    for (i, j), coefficient in system.scaled(None):
        for pair in ((i, j), (j, i)):
            second[pair] = second.get(pair, arb(0)) + coefficient
    return _largest(abs(value) for value in second.values())


def series_norms(series: CosineSeries, nu: arb) -> list[arb]:
    """Norms of the series of each position."""
    from flint import arb

    harmonic = series.system.harmonic
    return [sum((abs(a) * nu ** harmonic(i) for i, a in enumerate(row)), arb(0)) for row in series.coefficients]


def curvature(system: CosineSystem, norms: Sequence[arb], reach: float) -> arb:
    """Largest sum over m of the second derivatives of the majorants of the forces, at norms + reach."""
    from flint import arb

    sizes = [norm + arb(reach) for norm in norms]
    second = dict[tuple[int, int], arb]()
    for row in range(system.positions):
        for factors, coefficient in system.scaled(row):
            for a in range(len(factors)):
                for b in range(len(factors)):
                    if a == b:
                        continue
                    value = abs(coefficient)
                    for place, n in enumerate(factors):
                        value = value * sizes[n] if place not in (a, b) else value
                    pair = factors[a], factors[b]
                    second[pair] = second.get(pair, arb(0)) + value
    return _largest(second.values())


def _largest(values: Iterable[arb]) -> arb:
    from flint import arb

    largest = arb(0)
    for value in values:
        largest = largest.max(value)
    return largest
