"""The bounds Y, Z and W of the theorem for one set of coefficients, and the radius that they prove.

The names are those of the page "Orbits that are proved", which derives each bound. Rows and columns of the finite part
are lambda (as a residual: the amplitude), then the first H harmonics, 1, 3, ... or 0, 1, ..., of each position in turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import permutations
from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.certify.balls import SUM_ROUNDING_FACTOR, Enclosed, above, arb, largest, rounded_up, size
from casadi_skin.certify.certificate import Constants
from casadi_skin.certify.system import CosineSeries, CosineSystem, Factors
from casadi_skin.zero.problem import Array, Indices

# The bound W of the theorem: how much A DF changes within a ball, from norms of A and the majorants of the forces -----


def lipschitz(
    system: CosineSystem, nu: arb, curved: arb, norms: Array, weights: Array, beyond: arb, inverse_square: arb,
    in_tail: arb | int = 0, squares_in_tail: arb | int = 0,
) -> float:  # fmt: skip
    """Lipschitz constant of A DF, from upper bounds but for the weights.

    Arguments:
        system, nu: the equations and the weight of the norm.
        curved: of the forces' second derivatives.
        norms: of the weighted norms of the columns of A_f, shape (1 + positions * harmonics,).
        weights: lower bounds of the weights of these columns.
        beyond: of 1 + the norm that a unit of the tail's rows passes to the finite part through the amplitude's row.
        inverse_square: of the factor of the tail's rows times k^2, which is near 1/lambda.
        in_tail, squares_in_tail: of A and of A k^2 in a tail of sites.
    """
    n, harmonic = system.positions, system.harmonic
    H = (norms.size - 1) // n
    numbers = np.array([float(harmonic(i)) for i in range(H)])
    columns, rows = norms / weights * (1.0 + SUM_ROUNDING_FACTOR), inverse_square * beyond
    whole = arb(float(np.max(columns[1:]))).max(rows / harmonic(H) ** 2).max(in_tail)
    squares = columns * np.concatenate([[0.0], np.tile(numbers**2, n)])
    through_square = arb(float(np.max(squares) * (1.0 + SUM_ROUNDING_FACTOR))).max(rows).max(squares_in_tail)
    bend = _largest_second_derivative(system.scaled(None)) / nu ** (2 * harmonic(0))
    return above(through_square + arb(float(norms[0])) * bend + whole * curved)


def series_norms(series: CosineSeries, nu: arb) -> list[arb]:
    """Norms of the series of each position."""
    harmonic = series.system.harmonic
    return [sum((abs(a) * nu ** harmonic(i) for i, a in enumerate(row)), arb(0)) for row in series.coefficients]


def curvature(system: CosineSystem, norms: Sequence[arb], reach: float) -> arb:
    """Largest sum over m of the second derivatives of the majorants of the forces, at norms + reach."""
    forces = [term for row in range(system.positions) for term in system.scaled(row)]
    return _largest_second_derivative(forces, [norm + arb(reach) for norm in norms])


def _largest_second_derivative(terms: Sequence[tuple[Factors, arb]], sizes: Sequence[arb] = ()) -> arb:
    """Largest second derivative of the sum of the moduli of terms at `sizes`, which a quadratic form needs none of."""
    second = dict[Factors, arb]()
    for factors, coefficient in terms:
        for a, b in permutations(range(len(factors)), 2):
            others = (sizes[n] for place, n in enumerate(factors) if place not in (a, b))
            pair = factors[a], factors[b]
            second[pair] = second.get(pair, arb(0)) + prod(others, start=abs(coefficient))
    return largest(second.values())


# What a tail adds to the bounds ---------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class TailSize:
    """Upper bounds, 0 without a tail.

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
        tail, square, a = series.system.tail, series.square, series.tail_series
        if tail is None or a is None:
            return cls(*[arb(0)] * len(fields(cls)))
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
        return 6 * self.cubic * (self.first + arb(reach))


# The bounds -----------------------------------------------------------------------------------------------------------

LARGEST_WEIGHT = 2.0**100  # or parts below the smallest double might count
LARGEST_RADIUS = 0.03  # relative to the largest norm of a series: how far the second derivative is bounded


class Operator:
    """A matrix of doubles, real or complex, and bounds of the weighted norms of columns.

    `rows_above` are upper bounds of the weights of its rows, `doubt` of the weighted norms of its columns' errors.
    """

    def __init__(self, matrix: NDArray[Any], rows_above: Array, doubt: Array | None = None) -> None:
        self.matrix, self.rows_above = matrix, rows_above
        self.doubt = np.zeros(len(matrix)) if doubt is None else doubt

    @cached_property
    def norms(self) -> Array:
        """Upper bounds of the weighted norms of its columns."""
        norms = rounded_up(self.rows_above @ np.abs(self.matrix) + self.doubt, len(self.matrix))
        return np.where(norms < LARGEST_WEIGHT, norms, np.inf)

    def image(self, rows: Indices | slice, block: Enclosed, identity: Array | None = None) -> Array:
        """Upper bounds of the weighted norms of the columns of (identity -) it times a block given by its rows."""
        product = self.matrix[:, rows] @ block.middle
        if identity is not None:
            product = identity - product
        count = 2 * len(block.middle) + 4  # of sums of complex products
        lost = self.norms[rows] @ (count * SUM_ROUNDING_FACTOR * np.abs(block.middle) + block.radius)
        lost += self.doubt[rows] @ np.abs(block.middle)
        exact = self.rows_above @ (np.abs(product) * (1.0 + SUM_ROUNDING_FACTOR))
        return rounded_up(exact + rounded_up(lost, count), len(self.matrix))


class FiniteInverse(Operator):
    """The matrix A_f with the parts of its bounds that are computed once."""

    def __init__(self, series: CosineSeries, nu: arb, matrix: Array | None = None, doubt: Array | None = None) -> None:
        H, n, harmonic = series.harmonics, series.system.positions, series.system.harmonic
        self.series, self.nu = series, nu
        self.numbers = np.array([float(harmonic(i)) for i in range(H)])
        self.tail = harmonic(H)  # the first harmonic beyond the finite part
        powers = [nu ** harmonic(i) for i in range(series.system.degree * H + 1)]
        self.weights_above = np.array([above(p) for p in powers])
        self.weights_below = np.nextafter(np.array([float(p.lower()) for p in powers]), 0.0)
        if not self.weights_above[H - 1] < LARGEST_WEIGHT:
            raise ValueError(f"weights of {self.weights_above[H - 1]:.3g}, accepted: nu^k up to {LARGEST_WEIGHT:.3g}")
        self.rows_above = np.concatenate([[1.0], np.tile(self.weights_above[:H], n)])
        self._extend_rows()
        self.columns_below = np.concatenate([[1.0], np.tile(self.weights_below[:H], n)])
        self.slope = Enclosed.of(series.amplitude_slope())
        self.blocks = [
            {m: Enclosed.of(g) for m, g in series.derivatives(row).items()} for row in range(n)
        ]  # blocks[row][column]
        super().__init__(np.linalg.inv(self._jacobian()) if matrix is None else matrix, self.rows_above, doubt)

    def _extend_rows(self) -> None:
        """Weights of rows with what A makes of them in a tail: the sites' |tau|^n, and what lambda moves there."""
        tail, square = self.series.system.tail, self.series.square
        if tail is None or self.series.tail_series is None:
            return
        moved = arb(1)
        for i, a in enumerate(self.series.tail_series):
            k = 2 * i + 1
            size = abs(tail.root(k, square))
            moved += self.nu**k * k**2 * abs(a) * size / (1 - size) / tail.gap(k, square)
            place = 1 + tail.site * self.numbers.size + i
            self.rows_above[place] = above(self.nu**k / (1 - size))
        self.rows_above[0] = above(moved)

    @property
    def inner(self) -> int:
        """Number of finite unknowns."""
        return int(self.matrix.shape[0])

    # Columns of the derivative ----------------------------------------------------------------------------------------

    def _toeplitz(self, values: Array, columns: int) -> Array:
        """Entries g_|k-j| + g_(k+j), half of that for k = 0, of H harmonics k and `columns` of j; g = 0 beyond."""
        H, step = self.numbers.size, self.series.system.step
        k, j = np.arange(H)[:, None], np.arange(columns)[None, :]
        padded = np.concatenate([values, np.zeros(columns + H + 1)])
        entries = padded[np.abs(k - j)] + padded[k + j + step - 1]
        if step == 1:
            entries[0] *= 0.5
        return np.asarray(entries)

    def _column(self, n: int, columns: int) -> tuple[Indices, Enclosed]:
        """Rows of the finite part and their entries in the columns of q_n's first harmonics; others are 0."""
        H = self.numbers.size
        rows, middle, radius = [np.array([0])], [], []
        amplitude = np.zeros((2, 1, columns))
        amplitude[0, 0, :H] = self.slope.middle[n]  # beyond, A's own row of the amplitude takes it away
        amplitude[1] = self.slope.radius[n]
        middle.append(amplitude[0])
        radius.append(amplitude[1])
        square = Enclosed.of(self._diagonal(n))
        for m in sorted({m for m, row in enumerate(self.blocks) if n in row} | {n}):
            g = self.blocks[m].get(n, Enclosed(np.zeros(1), np.zeros(1)))
            block = self._toeplitz(g.middle, columns)
            error = np.abs(block) * SUM_ROUNDING_FACTOR + 2.0 * self._toeplitz(g.radius, columns)
            if m == n:
                diagonal = np.arange(H)
                block[diagonal, diagonal] += square.middle
                error[diagonal, diagonal] += 2.0 * square.radius
                error[diagonal, diagonal] += np.abs(block[diagonal, diagonal]) * SUM_ROUNDING_FACTOR
            rows.append(1 + m * H + np.arange(H))
            middle.append(block)
            radius.append(error)
        return np.concatenate(rows), Enclosed(np.vstack(middle), np.vstack(radius))

    def _diagonal(self, n: int) -> list[arb]:
        """lambda k^2, with the force of a tail on its site."""
        tail, square = self.series.system.tail, self.series.square
        values = [square * int(k) ** 2 for k in self.numbers.tolist()]
        if tail is not None and n == tail.site:
            values = [v + tail.coupling * tail.share(2 * i + 1, square) for i, v in enumerate(values)]
        return values

    def _frequency_column(self) -> Enclosed:
        """Derivative of the equations with respect to lambda: k^2 a_nk; the amplitude's is 0."""
        harmonic = self.series.system.harmonic
        entries = [harmonic(i) ** 2 * a for row in self.series.coefficients for i, a in enumerate(row)]
        tail, H = self.series.system.tail, self.numbers.size
        if tail is not None:  # and through the tail, whose ratios change with lambda
            for i in range(H):
                entries[tail.site * H + i] *= 1 + tail.squares(2 * i + 1, self.series.square)
        return Enclosed.of([arb(0), *entries])

    def _jacobian(self) -> Array:
        """Midpoints of the finite part of DF."""
        H, n = self.numbers.size, self.series.system.positions
        J = np.zeros((1 + n * H, 1 + n * H))
        J[:, 0] = self._frequency_column().middle
        for q in range(n):
            rows, block = self._column(q, H)
            J[rows, 1 + q * H : 1 + (q + 1) * H] = block.middle
        return J

    # Norms ------------------------------------------------------------------------------------------------------------

    def derivative_norm(self, n: int) -> arb:
        """Upper bound of the sum over m of the norms of d force_m/d q_n, which are cosine series."""
        total, step = arb(0), self.series.system.step
        for row in self.blocks:
            if n in row:
                for i, g in enumerate(row[n].largest.tolist()):
                    total += (1 if i == 0 else 2) * arb(g) * self.nu ** (step * i)
        tail = self.series.system.tail
        return total + tail.coupling if tail is not None and n == tail.site else total

    @cached_property
    def tailed(self) -> TailSize:
        """Bounds of A and of the equations in a tail."""
        return TailSize.of(self.series, self.nu, self.norms, self.weights_below)

    @cached_property
    def beyond(self) -> arb:
        """1 + the norm that a unit of the tail's rows passes to the finite part through the amplitude's row of A."""
        slope = arb(float(np.max(np.abs(self.slope.middle))))
        return 1 + arb(float(self.norms[0])) * slope / self.nu**self.tail

    @cached_property
    def tail_factor(self) -> arb:
        """1/(lambda k^2) for the first harmonic k beyond the finite part: what A makes of the tail's rows at most."""
        return 1 / (self.series.square * self.tail**2)

    # The bounds -------------------------------------------------------------------------------------------------------

    def residual(self, series: CosineSeries) -> tuple[list[arb], arb]:
        """Finite residual with the amplitude's row as A sees it, and the norm of what A makes of the tail's."""
        ((first, *finite), beyond), norm = series.residuals(), arb(0)
        slopes = self.slope.middle.tolist()  # the numbers c_n of the amplitude's row in A, exact
        for n, k, value in beyond:
            scaled = value / (self.series.square * k**2)
            first -= arb(slopes[n]) * scaled
            norm += abs(scaled) * self.nu**k
        return [first, *finite], norm

    def Y(self) -> float:
        """Upper bound of |A F|."""
        finite, tail = self.residual(self.series)
        values = Enclosed.of(finite)
        image = self.image(np.arange(self.inner), Enclosed(values.middle[:, None], values.radius[:, None]))
        tail += self.tailed.residual * self.tailed.factor.max(self.tail_factor * self.beyond)
        return float(np.nextafter(image[0] + size(tail), np.inf))

    def finite_columns(self) -> float:
        """Upper bound of the finite rows of I - A_f DF, over the columns that reach them."""
        H, series = self.numbers.size, self.series
        columns = series.system.degree * H
        unit = np.zeros((self.inner, 1))
        unit[0] = 1.0
        frequency = self._frequency_column()
        column = Enclosed(frequency.middle[:, None], frequency.radius[:, None])
        norm = float(self.image(np.arange(self.inner), column, unit)[0])
        for n in range(series.system.positions):
            identity = np.zeros((self.inner, columns))
            identity[1 + n * H + np.arange(H), np.arange(H)] = 1.0
            rows, block = self._column(n, columns)
            image = self.image(rows, block, identity) / self.weights_below[:columns]
            own = float(np.max(image)) * (1.0 + SUM_ROUNDING_FACTOR)
            norm = max(norm, own) if np.all(np.isfinite(image)) else np.inf
        return norm

    def Z(self) -> float:
        """Upper bound of |I - A DF|: the finite rows, the tail's rows, and what these pass through the amplitude."""
        tail = largest(self.derivative_norm(n) for n in range(self.series.system.positions))
        slope = arb(float(self.norms[0])) * arb(float(np.max(self.slope.radius))) / self.nu**self.tail
        tail = tail.max(self.tailed.derivative)
        slope += self.tailed.cubic_derivative * self.tailed.factor + arb(float(self.norms[0])) * self.tailed.slope
        return above(arb(self.finite_columns()) + tail * self.tail_factor * self.beyond + slope)

    def W(self, reach: float) -> float:
        """Lipschitz constant of A DF within `reach` of the coefficients."""
        curved = curvature(self.series.system, series_norms(self.series, self.nu), reach)
        sizes = self.norms, self.columns_below, self.beyond, 1 / self.series.square
        return lipschitz(
            self.series.system, self.nu, curved.max(self.tailed.curvature(reach)), *sizes, self.tailed.factor,
            self.tailed.square_factor,
        )  # fmt: skip

    def constants(self) -> Constants:
        """The three bounds."""
        reach = LARGEST_RADIUS * max(sum(size(a) for a in row) for row in self.series.coefficients)
        return Constants(self.Y(), self.Z(), self.W(reach), reach)


def proved_radius(constants: Constants) -> float | None:
    """A radius r with Y + Z r + W r^2 / 2 <= r, Z + W r < 1 and r <= reach, checked in balls; None without one."""
    guess = _smallest_root(constants)
    return next((r for r in (guess * (1.0 + 1e-9), guess * 1.01, guess * 1.5) if holds(constants, r)), None)


def uniqueness_radius(constants: Constants, radius: float) -> float:
    """The largest radius found within which the orbit is the only one."""
    trials = [constants.reach * 2.0**-i for i in range(60)]
    return next((r for r in trials if r > radius and holds(constants, r)), radius)


def holds(constants: Constants, r: float) -> bool:
    """Whether a radius satisfies the theorem's conditions, in balls."""
    Y, Z, W, reach = (arb(x) for x in (constants.Y, constants.Z, constants.W, constants.reach))
    ball = arb(r)
    return bool(ball > 0 and Y + Z * ball + W * ball**2 / 2 <= ball and Z + W * ball < 1 and ball <= reach)


def _smallest_root(constants: Constants) -> float:
    gap = 1.0 - constants.Z
    root = gap**2 - 2.0 * constants.Y * constants.W
    return float(2.0 * constants.Y / (gap + np.sqrt(root))) if gap > 0 and root > 0 else float("nan")
