"""An approximate exponent with its vector in more digits than doubles have, and its residual in balls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.certify.linearised import Linearised
from casadi_skin.stability.reduction import ComplexArray

if TYPE_CHECKING:
    from flint import acb, arb

STEPS = 6


@dataclass(frozen=True, eq=False)
class Eigenpair:
    """sigma and w_m of the harmonics m = -highest, ..., highest, exact numbers; `rows` are those of each position."""

    sigma: acb
    rows: Sequence[Sequence[acb]]

    @classmethod
    def refined(cls, problem: Linearised, sigma: complex, w: ComplexArray, inverse: ComplexArray) -> Eigenpair:
        """Newton's method with a fixed inverse from doubles; w of shape (harmonics, positions)."""
        from flint import acb

        normal, last = w.conj(), np.inf
        rows = [[acb(x.real, x.imag) for x in column] for column in w.T.tolist()]
        pair = cls(acb(sigma.real, sigma.imag), rows)
        for _ in range(STEPS):
            residual = np.array([complex(value.mid()) for value in pair.residual(problem, normal)[0]])
            step = inverse @ residual
            size = float(np.sum(np.abs(step)))
            if not size < 0.5 * last:
                break
            last = size
            changes = step[1:].reshape(w.shape).T.tolist()
            rows = [
                [(x - acb(d.real, d.imag)).mid() for x, d in zip(row, line, strict=True)]
                for row, line in zip(pair.rows, changes, strict=True)
            ]
            pair = cls((pair.sigma - acb(step[0].real, step[0].imag)).mid(), rows)
        return pair

    def doubles(self) -> tuple[complex, ComplexArray]:
        """The nearest doubles, w of shape (harmonics, positions)."""
        return complex(self.sigma), np.array([[complex(x) for x in row] for row in self.rows]).T

    def rounding(self, sigma: complex) -> arb:
        """Distance of sigma from a double."""
        from flint import acb

        return abs(self.sigma - acb(sigma.real, sigma.imag))

    def residual(self, problem: Linearised, normal: ComplexArray) -> tuple[list[acb], list[acb]]:
        """c w - 1 and the rows of the pair's harmonics, in its order, and all further rows; c of shape of w."""
        from flint import acb, acb_poly

        n, count = problem.positions, len(self.rows[0])
        reach = max((len(g) for g in self._coefficients(problem).values()), default=1) - 1
        vectors = [acb_poly(list(row)) for row in self.rows]
        sums = [acb_poly() for _ in range(n)]
        for (m, k), g in self._coefficients(problem).items():
            both = [*reversed(g[1:]), *g] if len(g) > 1 else list(g)
            padding = [acb(0)] * (reach + 1 - len(g))
            sums[m] += acb_poly([*padding, *both]) * vectors[k]
        first = sum((acb(c.real, c.imag) * x for c, x in self._paired(normal)), acb(-1))
        middle, outside = [[acb(0)] * n for _ in range(count)], list[acb]()
        for m, total in enumerate(sums):
            for i in range(count + 2 * reach):
                if reach <= i < reach + count:
                    h = problem.step * (i - reach) - problem.step * (count - 1) // 2
                    middle[i - reach][m] = total[i] + problem.square * (self.sigma + h) ** 2 * self.rows[m][i - reach]
                else:
                    outside.append(total[i])
        return [first, *(value for row in middle for value in row)], outside

    def _paired(self, normal: ComplexArray) -> list[tuple[complex, acb]]:
        return [
            (c, x)
            for row, line in zip(normal.T.tolist(), self.rows, strict=True)
            for c, x in zip(row, line, strict=True)
        ]

    @staticmethod
    def _coefficients(problem: Linearised) -> Mapping[tuple[int, int], Sequence[arb]]:
        """The entries of G in balls: those about the orbit's centre, or the doubles where there is no orbit."""
        from flint import arb

        if problem.exact is not None:
            return problem.exact
        n = problem.positions
        return {(m, k): [arb(g) for g in problem.blocks[:, m, k].tolist()] for m in range(n) for k in range(n)}
