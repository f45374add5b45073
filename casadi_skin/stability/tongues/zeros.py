"""Functions on an interval whose zeros are edges of instabilities, with the effects of their errors on these."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.decoupling import SERIES_DEGREE, Indices
from casadi_skin.zero.problem import Array

FINEST_PLACE = 1e-14  # of an interval: no place in it is known better
ERROR_REACH_NODES = 2  # nodes to either side of a place whose errors count there

Zeros = list[tuple[float, float, bool]]


class Function:
    """A function on [-1, 1] whose zeros are edges: its Chebyshev coefficients, and its errors at the nodes.

    `excludes_zero` where it certainly has no zero, nor comes as near to zero as its error; `is_nothing` where it is
    zero everywhere, within its error.
    """

    def __init__(self, coefficients: Array, errors: Array, excludes_zero: bool, is_nothing: bool) -> None:
        self.coefficients, self.errors = coefficients, errors
        self.excludes_zero, self.is_nothing = excludes_zero, is_nothing
        self._zeros: Zeros | None = None

    @classmethod
    def several(cls, coefficients: Array, errors: Array) -> list[Function]:
        """Functions from coefficients (degree + 1, functions) and errors (functions, nodes)."""
        rest = np.sum(np.abs(coefficients[1:]), axis=0)
        largest, mean = np.max(errors, axis=1), np.abs(coefficients[0])
        excluded, nothing = mean > rest + largest, mean + rest <= np.min(errors, axis=1)
        rows = np.ascontiguousarray(coefficients.T)
        return [cls(*row) for row in zip(rows, errors, excluded.tolist(), nothing.tolist(), strict=True)]

    def __call__(self, x: Array | float) -> Array:
        return np.asarray(chebyshev.basis(x, len(self.coefficients) - 1) @ self.coefficients)

    def error(self, x: float) -> float:
        """Error near a place."""
        return float(_errors(self.errors[None], np.zeros(1, dtype=np.int64), np.array([x]))[0])

    @staticmethod
    def find_zeros(functions: Sequence[Function]) -> None:
        """Find the zeros of several functions together: that is cheaper."""
        waiting = [f for f in functions if f._zeros is None]
        for f in waiting:
            f._zeros = []
        chosen = [f for f in waiting if not (f.excludes_zero or f.is_nothing)]
        chosen.sort(key=lambda f: f.coefficients.size)
        for _, group in groupby(chosen, key=lambda f: f.coefficients.size):
            those = list(group)
            coefficients = np.stack([f.coefficients for f in those], axis=1)
            errors = np.stack([f.errors for f in those])
            of, x, crosses = chebyshev.real_zeros(coefficients)
            seen = crosses | (np.abs(chebyshev.value(coefficients, of, x)) <= _errors(errors, of, x))
            of, x, crosses = of[seen], x[seen], crosses[seen]
            widths = _widths(coefficients, errors, of, x)
            for k, *zero in zip(of.tolist(), x.tolist(), widths.tolist(), crosses.tolist(), strict=True):
                those[k].zeros.append((zero[0], zero[1], zero[2]))
            for f in those:
                f.zeros.sort()

    @property
    def zeros(self) -> Zeros:
        """(place, its error, whether the function changes sign there) in ascending order.

        Without a change of sign where the function comes so near to zero that its error may hide two changes.
        """
        if self._zeros is None:
            Function.find_zeros([self])
        assert self._zeros is not None
        return self._zeros

    def width(self, x: float) -> float:
        """Change of a zero when the function changes by its error: by slope, or by curvature where that is more."""
        one = np.zeros(1, dtype=np.int64)
        return float(_widths(self.coefficients[:, None], self.errors[None], one, np.array([x]))[0])


def _errors(errors: Array, of: Indices, x: Array) -> Array:
    """Errors near places x of the functions numbered `of`, whose errors at the nodes are (functions, nodes)."""
    near = np.searchsorted(chebyshev.nodes(SERIES_DEGREE), x)[:, None] + np.arange(
        -ERROR_REACH_NODES, ERROR_REACH_NODES
    )
    return np.asarray(np.max(errors[of[:, None], np.clip(near, 0, SERIES_DEGREE)], axis=1))


def _widths(coefficients: Array, errors: Array, of: Indices, x: Array) -> Array:
    """`Function.width` at places x of the functions numbered `of`, coefficients (degree + 1, functions)."""
    matrix = chebyshev.derivative(len(coefficients) - 1)
    first = matrix @ coefficients
    slope, curvature = (np.abs(chebyshev.value(c, of, x)) for c in (first, matrix @ first))
    error = _errors(errors, of, x)
    by_slope = slope**2 > 2.0 * curvature * error
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.where(by_slope, error / slope, np.sqrt(2.0 * error / curvature)) + FINEST_PLACE
    return np.where(by_slope | (curvature > 0.0), width, 2.0)
