"""The theorem for all values of a parameter at once: about a polynomial curve of series, with a polynomial operator A.

The centre, A_f and the factor of the tail are polynomials of x in [-1, 1], given by Chebyshev coefficients that are
exact doubles. The bounded quantity is then a polynomial of x with values in a normed space, of known degree d. At
M > d Chebyshev nodes it is bounded by balls, and in between by 1/cos(pi d/(2 M)) times the largest value at the nodes
(Ehlich and Zeller 1964; through functionals it holds for values in a normed space).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from casadi_skin.certify.balls import ROUNDING, above, rounded_up, size
from casadi_skin.certify.bounds import LARGEST_RADIUS, FiniteInverse
from casadi_skin.certify.certificate import Constants
from casadi_skin.certify.cosine_system import CosineSeries, CosineSystem
from casadi_skin.certify.lipschitz import OperatorSize, curvature, series_norms
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from flint import arb

MORE_NODES = 1.3  # than the degree of the bounded polynomial
LARGEST_Z = 0.9  # from which on no further node is looked at


@dataclass(frozen=True, eq=False)
class Curve:
    """Series that are polynomials of the parameter on an interval, with those that make up A.

    Attributes:
        system: the equations in positions of amplitude 1, without a value of their parameter.
        start, end: the interval of the parameter.
        centre: Chebyshev coefficients of lambda and of all a_nk, shape (degree + 1, 1 + positions * harmonics).
        inverse: those of A_f, shape (degree + 1, 1 + positions * harmonics, 1 + positions * harmonics).
        factor: those of the factor that is near 1/lambda, shape (degree + 1,).
    """

    system: CosineSystem
    start: float
    end: float
    centre: Array
    inverse: Array
    factor: Array

    @property
    def degree(self) -> int:
        return len(self.factor) - 1

    def parameter(self, x: arb) -> arb:
        """The parameter at a place of [-1, 1]."""
        from flint import arb

        return (arb(self.start) * (1 - x) + arb(self.end) * (1 + x)) / 2

    def place(self, parameter: arb) -> arb:
        """The place of [-1, 1] of a parameter."""
        from flint import arb

        return (2 * parameter - arb(self.start) - arb(self.end)) / (arb(self.end) - arb(self.start))

    def at(self, x: arb) -> CosineSeries:
        """The series at a place of [-1, 1]."""
        from flint import arb_mat

        values = (arb_mat([self.chebyshev(x)]) * self._exact).entries()
        n = self.system.positions
        H = (len(values) - 1) // n
        rows = [values[1 + m * H : 1 + (m + 1) * H] for m in range(n)]
        return CosineSeries(replace(self.system, parameter=self.parameter(x)), values[0], rows)

    def chebyshev(self, x: arb) -> list[arb]:
        """T_0, ..., T_degree."""
        from flint import arb

        values = [arb(1), x]
        while len(values) <= self.degree:
            values.append(2 * x * values[-1] - values[-2])
        return values[: self.degree + 1]

    @cached_property
    def _exact(self) -> Any:
        from flint import arb_mat

        return arb_mat(self.centre.tolist())

    def bounds_at(self, x: arb, nu: arb) -> Node:
        """Values at one place from which the bounds are computed."""
        from flint import arb

        T = self.chebyshev(x)
        matrix = np.tensordot(np.array([float(t) for t in T]), self.inverse, axes=1)
        series = self.at(x)
        bounds = FiniteInverse(series, nu, matrix, self._doubt(series, nu))
        factor = sum((arb(c) * t for c, t in zip(self.factor.tolist(), T, strict=True)), arb(0))
        return Node.of(bounds, factor)

    def _doubt(self, series: CosineSeries, nu: arb) -> Array:
        """Weighted norms of the errors of A_f in doubles: sums of degree + 1 products with rounded T_k."""
        H, harmonic = series.harmonics, series.system.harmonic
        weights = np.array([1.0] + [above(nu ** harmonic(i)) for i in range(H)] * series.system.positions)
        moduli = self._moduli
        return rounded_up((self.degree + 6) * ROUNDING * (weights @ moduli), len(moduli))

    @cached_property
    def _moduli(self) -> Array:
        return rounded_up(np.abs(self.inverse).sum(axis=0), self.degree + 1)


@dataclass(frozen=True, eq=False)
class Node:
    """Bounds at one place of polynomials in the parameter.

    Attributes:
        finite: of the finite rows of I - A_f DF.
        residual: moduli of the finite rows of F, shape (1 + positions * harmonics,).
        tail: norm of the tail's rows of F over k^2.
        norms: of the columns of A_f.
        weights: lower bounds of the weights of its columns.
        slope: largest modulus of c_n.
        derivatives: of the forces' derivatives with respect to each position.
        factor: modulus of a number near 1/lambda; `defect` of 1 - lambda times it.
        sizes: norms of the series of each position.
    """

    finite: float
    residual: Array
    tail: arb
    norms: Array
    weights: Array
    slope: float
    derivatives: list[arb]
    factor: arb
    defect: arb
    sizes: list[arb]

    @classmethod
    def of(cls, bounds: FiniteInverse, factor: arb) -> Node:
        """From the bounds at the place, with the factor of the tail's rows there."""
        from flint import arb

        series, H = bounds.series, bounds.series.harmonics
        tail, finite, harmonic = arb(0), [series.amplitude_residual()], series.system.harmonic
        for n in range(series.system.positions):
            values = series.residual(n)
            finite += values[:H]
            for i in range(H, len(values)):
                tail += abs(values[i]) * bounds.nu ** harmonic(i) / harmonic(i) ** 2
        return cls(
            bounds.finite_columns(),
            np.array([size(value) for value in finite]),
            tail,
            bounds.norms,
            bounds.columns_below,
            float(np.max(bounds.slope.largest)),
            [bounds.derivative_norm(n) for n in range(series.system.positions)],
            abs(factor),
            abs(1 - factor * series.square),
            series_norms(series, bounds.nu),
        )


def piece_constants(curve: Curve, nu: arb) -> Constants | None:
    """The bounds of the theorem for every parameter of a curve's interval; None where Z is seen to be too large."""
    forces, degree = _degrees(curve)
    count = int(np.ceil(MORE_NODES * (curve.degree + forces))) + 1
    nodes = list[Node]()
    for x in _nodes(count):
        nodes.append(curve.bounds_at(x, nu))
        if not nodes[-1].finite < LARGEST_Z:
            return None
    return _Uniform(curve, nu, nodes, count).constants(forces, degree)


def _degrees(curve: Curve) -> tuple[int, int]:
    """Degrees in the parameter of the derivative of the equations, and of the equations."""
    system, m = curve.system, curve.degree
    degrees = {len(factors) for terms in system.forces for factors in terms} | {1}
    derivative = max(m, *((p - 1) * m + (p - 1) // system.step for p in degrees))
    return derivative, max(2 * m, *(p * m + (p - 1) // system.step for p in degrees))


def _nodes(count: int) -> Iterator[arb]:
    """Chebyshev nodes from the ends to the middle, where bounds fail last."""
    from flint import arb

    for i in sorted(range(count), key=lambda i: min(i, count - 1 - i)):
        yield (arb.pi() * (2 * i + 1) / (2 * count)).cos()


@dataclass(frozen=True, eq=False)
class _Uniform:
    """Bounds for the whole interval from those at `count` nodes."""

    curve: Curve
    nu: arb
    nodes: Sequence[Node]
    count: int

    def between(self, degree: int) -> arb:
        """How much larger than at the nodes the norm of a polynomial may be anywhere."""
        from flint import arb

        if degree >= self.count:
            raise ArithmeticError(f"a polynomial of degree {degree} is not bounded by {self.count} values")
        return 1 / (arb.pi() * degree / (2 * self.count)).cos()

    def largest(self, values: Sequence[arb], degree: int) -> arb:
        """Bound of a polynomial's norm from those at the nodes."""
        from flint import arb

        top = arb(0)
        for value in values:
            top = top.max(value)
        return top * self.between(degree)

    def rows(self, values: Sequence[Array], degree: int) -> Array:
        """The same for each entry of an array."""
        largest: Array = np.max(values, axis=0) * above(self.between(degree)) * (1.0 + ROUNDING)
        return largest

    def constants(self, derivative: int, equations: int) -> Constants:
        """Y, Z and W from the degrees of DF and F."""
        from flint import arb

        curve, nodes, m = self.curve, self.nodes, self.curve.degree
        system, nu = curve.system, self.nu
        n = system.positions
        tail = system.harmonic((nodes[0].norms.size - 1) // n)
        norms = self.rows([node.norms for node in nodes], m)
        slope = self.largest([arb(node.slope) for node in nodes], m)
        factor = self.largest([node.factor for node in nodes], m)
        beyond = 1 + arb(float(norms[0])) * slope / nu**tail
        # Y
        finite = self.rows([node.residual for node in nodes], equations)
        outside = factor * self.largest([node.tail for node in nodes], equations)
        Y = above(arb(float(rounded_up(norms @ finite, norms.size))) + beyond * outside)
        # Z
        inside = self.largest([arb(node.finite) for node in nodes], m + derivative)
        defect = self.largest([node.defect for node in nodes], 2 * m)
        rows = [self.largest([node.derivatives[i] for node in nodes], derivative) for i in range(n)]
        top = arb(0)
        for row in rows:
            top = top.max(row)
        Z = above(inside + beyond * (defect + factor * top / tail**2))
        # W
        sizes = [self.largest([node.sizes[i] for node in nodes], m) for i in range(n)]
        reach = LARGEST_RADIUS * max(size(value) for value in sizes)
        strongest = replace(system, parameter=arb(max(abs(curve.start), abs(curve.end))))
        operator = OperatorSize(norms, nodes[0].weights, beyond, factor)
        return Constants(Y, Z, operator.lipschitz(system, nu, curvature(strongest, sizes, reach)), reach)
