"""Balls of python-flint, and their enclosures by doubles.

A ball is a midpoint with a radius and encloses a real number; results computed from balls enclose those that would be
computed from the numbers (Johansson 2017). Matrices are products of doubles, whose rounding is bounded beforehand.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.zero.problem import Array

try:
    from flint import acb as acb
    from flint import acb_poly as acb_poly
    from flint import arb as arb
    from flint import arb_mat as arb_mat
    from flint import arb_poly as arb_poly
    from flint import fmpq as fmpq
except ImportError:  # the extra "certify" is missing, as `flint` says
    acb = acb_poly = arb = arb_mat = arb_poly = fmpq = None

BALL_PRECISION_BITS = 128  # bits of balls
SUM_ROUNDING_FACTOR = 2.0**-51  # four times the unit roundoff, for each operation of a sum
UNDERFLOW_BOUND = 2.0**-900  # more than all operations of a bound can lose below the smallest double


def flint() -> Any:
    """The module python-flint; raises ImportError, naming the extra, where it is missing."""
    try:
        import flint
    except ImportError:
        extra = 'install casadi-skin with the extra "certify", as in: pip install "casadi-skin[certify]"'
        raise ImportError(f"certify: python-flint is missing; {extra}") from None
    return flint


def above(value: arb) -> float:
    """A double that no number in a ball exceeds."""
    return float(np.nextafter(float(value.upper()), np.inf))


def below(value: arb) -> float:
    """A double that no number in a ball falls below."""
    return float(np.nextafter(float(value.lower()), -np.inf))


def size(value: arb) -> float:
    """A double that the modulus of no number in a ball exceeds."""
    return above(abs(value))


def largest(values: Iterable[arb]) -> arb:
    """A ball that no number of any ball >= 0 exceeds."""
    found = arb(0)
    for value in values:
        found = found.max(value)
    return found


def rounded_up(value: Array, operations: int) -> Array:
    """An upper bound of sums of products of numbers >= 0, from their value in doubles after so many operations.

    Holds in any order of the sums, with and without fused operations (Higham 2002, chapter 3).
    """
    return np.asarray(value * (1.0 + (operations + 8) * SUM_ROUNDING_FACTOR) + UNDERFLOW_BOUND)


@dataclass(frozen=True, eq=False)
class Enclosed:
    """Numbers within `radius` of the doubles `middle`, arrays of one shape."""

    middle: NDArray[Any]
    radius: Array

    @classmethod
    def of(cls, balls: Iterable[arb]) -> Enclosed:
        """Doubles around balls, shape (balls,)."""
        values = list(balls)
        middle = np.array([float(value.mid()) for value in values])
        radius = np.array([size(v - arb(m)) for v, m in zip(values, middle.tolist(), strict=True)])
        return cls(middle, radius)

    @property
    def largest(self) -> Array:
        """Upper bounds of the moduli."""
        return np.asarray(np.nextafter(np.abs(self.middle) + self.radius, np.inf))


def exact(value: float, decimals: bool) -> Fraction:
    """Exact value of a double: itself, or the shortest decimal that rounds to it."""
    return Fraction(repr(value)) if decimals else Fraction(value)


def ball(number: Fraction) -> arb:
    """A ball around a fraction."""
    return arb(fmpq(number.numerator, number.denominator))
