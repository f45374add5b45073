"""Functions on an interval whose zeros are edges of instabilities, with the effects of their errors on these."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.stability import chebyshev
from casadi_skin.stability.decoupling import DEGREE

FINEST = 1e-14  # of an interval: no place in it is known better
REACH = 2  # nodes to either side of a place whose errors count there


class Function:
    """A function on [-1, 1] whose zeros are edges: its Chebyshev coefficients, and its errors at the nodes."""

    def __init__(self, coefficients: Array, errors: Array) -> None:
        self.coefficients, self.errors = coefficients, errors
        self._places: tuple[Array, Array] | None = None

    def __call__(self, x: Array | float) -> Array:
        return np.asarray(chebyshev.basis(x, len(self.coefficients) - 1) @ self.coefficients)

    def error(self, x: float) -> float:
        """Error near a place."""
        near = int(np.searchsorted(chebyshev.nodes(DEGREE), x))
        return float(np.max(self.errors[max(near - REACH, 0) : near + REACH]))

    @property
    def excludes_zero(self) -> bool:
        """Whether it certainly has no zero, nor comes as near to zero as its error."""
        rest = float(np.sum(np.abs(self.coefficients[1:])) + np.max(self.errors))
        return bool(abs(self.coefficients[0]) > rest)

    @property
    def is_nothing(self) -> bool:
        """Whether it is zero everywhere, within its error."""
        return bool(np.sum(np.abs(self.coefficients)) <= np.min(self.errors))

    @staticmethod
    def find_zeros(functions: Sequence[Function]) -> None:
        """Find the zeros of several functions together: that is cheaper."""
        open_ones = [f for f in functions if f._places is None]
        for f in open_ones:
            f._places = (np.empty(0), np.empty(0))
        for size in {f.coefficients.size for f in open_ones}:
            chosen = [f for f in open_ones if f.coefficients.size == size and not (f.excludes_zero or f.is_nothing)]
            if chosen:
                found = chebyshev.real_zeros(np.stack([f.coefficients for f in chosen], axis=1))
                for function, places in zip(chosen, found, strict=True):
                    function._places = places

    @cached_property
    def zeros(self) -> list[tuple[float, float, bool]]:
        """(place, its error, whether the function changes sign there) in ascending order.

        Without a change of sign where the function comes so near to zero that its error may hide two changes.
        """
        Function.find_zeros([self])
        assert self._places is not None
        changes, near = self._places
        found = [(x, self.width(x), True) for x in changes.tolist()]
        found += [(x, self.width(x), False) for x in near.tolist() if abs(self(x)) <= self.error(x)]
        return sorted(found)

    def width(self, x: float) -> float:
        """Change of a zero when the function changes by its error: by slope, or by curvature where that is more."""
        degree = len(self.coefficients) - 1
        matrix, error = chebyshev.derivative(degree), self.error(x)
        here, first = chebyshev.basis(x, degree), matrix @ self.coefficients
        slope, curvature = abs(float(here @ first)), abs(float(here @ (matrix @ first)))
        if slope**2 > 2.0 * curvature * error:
            return error / slope + FINEST
        return float(np.sqrt(2.0 * error / curvature)) + FINEST if curvature > 0.0 else 2.0
