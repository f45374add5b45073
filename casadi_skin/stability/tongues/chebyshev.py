"""Chebyshev series on an interval: nodes, coefficients, values, and every real zero.

See Trefethen, Approximation Theory and Approximation Practice (2013), chapters 3, 8 and 18.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from math import prod
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebroots, chebtrim, chebval
from numpy.typing import NDArray

from casadi_skin.zero.problem import Array, Indices

SERIES_DEGREE = 16  # of the series on an interval of a branch
END_SLACK = 1e-9  # beyond the ends, in which a zero still counts
BESIDE_END = 1e-4  # beyond the ends: a zero that Newton steps may bring there
NEARLY_REAL = 1e-2  # imaginary part of a zero that errors or rounding may have made of two real ones
NEGLIGIBLE_COEFFICIENT = (
    1e-14  # of the largest coefficient: smaller ones are left out of the eigenvalue problem of the zeros
)
POLISHING_STEPS = 4  # steps of Newton's method on zeros
TAIL_COEFFICIENTS = 3  # coefficients whose sum shows how far a series is from converged


def _kept(matrix: Array) -> Array:
    matrix.flags.writeable = False  # kept and shared
    return matrix


@cache
def nodes(degree: int) -> Array:
    """The `degree` + 1 points -cos(k pi / degree) in ascending order, the ends -1 and 1 and the middle among them."""
    return _kept(np.sin(0.5 * np.pi * np.arange(-degree, degree + 1, 2) / degree))


@cache
def transform(degree: int) -> Array:
    """Matrix from values at `nodes` to coefficients, shape (degree + 1, degree + 1)."""
    k = np.arange(degree + 1)
    matrix = 2.0 / degree * np.cos(np.pi * np.outer(k, degree - k) / degree)
    matrix[:, [0, -1]] *= 0.5
    matrix[[0, -1]] *= 0.5
    return _kept(matrix)


def basis(points: Array | float, degree: int) -> Array:
    """Values of the polynomials 0 to `degree` at points in [-1, 1], shape (points, degree + 1)."""
    angles = np.arccos(np.clip(points, -1.0, 1.0))
    return np.asarray(np.cos(np.multiply.outer(angles, np.arange(degree + 1))))


@cache
def refinement(degree: int, finer: int) -> Array:
    """Matrix from values at the nodes of one degree to those at the nodes of another, shape (finer + 1, degree + 1)."""
    return _kept(basis(nodes(finer), degree) @ transform(degree))


@cache
def middle_slope(degree: int) -> Array:
    """Weights of values at the nodes that give the derivative at 0, shape (degree + 1,)."""
    return _kept(basis(0.0, degree - 1) @ chebder(transform(degree)))


def combined(matrix: Array, values: Array) -> Array:
    """A matrix times values by their second axis: (rows, J) and (n, J, ...) -> (n, rows, ...)."""
    flat = matrix @ values.reshape(*values.shape[:2], prod(values.shape[2:]))
    return np.asarray(flat.reshape(len(values), len(matrix), *values.shape[2:]))


def tail(coefficients: Array) -> Array:
    """Size of the last coefficients, (degree + 1, ...) -> (...): the remainder of the series is no larger."""
    return np.asarray(np.sum(np.abs(coefficients[-TAIL_COEFFICIENTS:]), axis=0))


def excludes_zero(coefficients: Array) -> NDArray[np.bool_]:
    """Which functions have certainly no zero in [-1, 1]: coefficients (degree + 1, ...) -> (...)."""
    return np.asarray(np.abs(coefficients[0]) > np.sum(np.abs(coefficients[1:]), axis=0))


def real_zeros(coefficients: Array) -> tuple[Indices, Array, NDArray[np.bool_]]:
    """Zeros in [-1, 1] of several functions, and where they come near zero without a change of sign.

    The zeros are eigenvalues of colleague matrices (Good 1961); the places without a change of sign are real parts of
    conjugate ones next to the real axis.

    Arguments:
        coefficients: shape (degree + 1, functions).

    Returns:
        The function of each place, the places, and whether it changes its sign there.
    """
    zeros = [_by_eigenvalues(column) for column in coefficients.T]
    of, found = np.repeat(np.arange(len(zeros)), [each.size for each in zeros]), np.concatenate(zeros)
    crosses, x = found.imag == 0.0, found.real.copy()
    x[crosses] = _polished(coefficients[:, of[crosses]], x[crosses])
    inside = ~crosses | (np.abs(x) <= 1.0 + END_SLACK)
    return of[inside], np.clip(x[inside], -1.0, 1.0), crosses[inside]


def _by_eigenvalues(coefficients: Array) -> NDArray[Any]:
    """Zeros of one function next to the real axis, not below it."""
    size = float(np.max(np.abs(coefficients)))
    roots = chebroots(chebtrim(coefficients, NEGLIGIBLE_COEFFICIENT * size)) if size else np.empty(0)
    near_axis = (roots.imag >= 0.0) & (roots.imag <= NEARLY_REAL) & (np.abs(roots.real) <= 1.0 + BESIDE_END)
    return np.asarray(roots[near_axis])


def _polished(coefficients: Array, x: Array) -> Array:
    """Zeros after a few steps of Newton's method, each of the function with the coefficients in its column."""
    slopes = chebder(coefficients)
    step, start = np.full(x.shape, np.inf), x
    for _ in range(POLISHING_STEPS if x.size else 0):
        here, change = (chebval(x, each, tensor=False) for each in (coefficients, slopes))
        new = np.divide(here, change, out=np.zeros_like(here), where=change != 0.0)
        new = np.where(np.abs(new) < np.abs(step), new, 0.0)
        x, step = x - new, new
    size, before = (np.abs(chebval(each, coefficients, tensor=False)) for each in (x, start))
    return np.where(size > before, start, x)  # at a double zero


# Functions on an interval whose zeros are edges of instabilities, with the effects of their errors on these -----------

FINEST_PLACE = 1e-14  # of an interval: no place in it is known better
ERROR_REACH_NODES = 2  # nodes to either side of a place whose errors count there


def certain(coefficients: Array, errors: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which functions certainly have no zero, and which are zero everywhere, within their errors: see `Function`."""
    rest, mean = np.sum(np.abs(coefficients[1:]), axis=0), np.abs(coefficients[0])
    return mean > rest + np.max(errors, axis=1), mean + rest <= np.min(errors, axis=1)


@dataclass(eq=False)
class Function:
    """A function on [-1, 1] whose zeros are edges.

    Attributes:
        coefficients: of its Chebyshev series.
        errors: of its values at the nodes of `SERIES_DEGREE`.
        excludes_zero: whether it certainly has no zero, nor comes as near to zero as its error.
        is_nothing: whether it is zero everywhere, within its error.
        zeros: (place, its error, whether the function changes sign there) in ascending order; without a change of sign
            where it comes so near to zero that its error may hide two changes. By `find_zeros`.
    """

    coefficients: Array
    errors: Array
    excludes_zero: bool
    is_nothing: bool
    zeros: list[tuple[float, float, bool]] | None = None

    @classmethod
    def several(cls, coefficients: Array, errors: Array) -> list[Function]:
        """Functions from coefficients (degree + 1, functions) and errors (functions, nodes)."""
        excluded, nothing = certain(coefficients, errors)
        rows = np.ascontiguousarray(coefficients.T)
        return [cls(*row) for row in zip(rows, errors, excluded.tolist(), nothing.tolist(), strict=True)]

    def near_zero(self, x: float, safety: float) -> float | None:
        """How far from a place a zero may be that errors allow there; None where they allow none."""
        c, errors, at = self.coefficients[:, None], self.errors[None], np.array([x])
        if self.is_nothing or abs(float(chebval(x, self.coefficients))) > safety * _errors(errors, at)[0]:
            return None
        return float(_widths(c, errors, at)[0])


def find_zeros(functions: Iterable[Function]) -> None:
    """Find the zeros of several functions of one degree together: that is cheaper."""
    chosen = []
    for f in functions:
        if f.zeros is None:
            f.zeros = []
            if not (f.excludes_zero or f.is_nothing):
                chosen.append(f)
    if not chosen:
        return
    coefficients, errors = np.stack([f.coefficients for f in chosen], axis=1), np.stack([f.errors for f in chosen])
    of, x, crosses = real_zeros(coefficients)
    sizes = np.abs(chebval(x, coefficients[:, of], tensor=False))
    seen = crosses | (sizes <= _errors(errors[of], x))
    of, x, crosses = of[seen], x[seen], crosses[seen]
    order = np.lexsort((x, of))
    widths = _widths(coefficients[:, of], errors[of], x)
    for i in order.tolist():
        chosen[of[i]].zeros += [(float(x[i]), float(widths[i]), bool(crosses[i]))]


def _errors(errors: Array, x: Array) -> Array:
    """Errors near places x, each of the function with the errors at the nodes in its row."""
    near = np.searchsorted(nodes(SERIES_DEGREE), x)[:, None] + np.arange(-ERROR_REACH_NODES, ERROR_REACH_NODES)
    return np.asarray(np.max(np.take_along_axis(errors, np.clip(near, 0, SERIES_DEGREE), 1), axis=1))


def _widths(coefficients: Array, errors: Array, x: Array) -> Array:
    """Changes of zeros x when functions change by their errors: by slope, or by curvature where that is more."""
    slope, curvature = (np.abs(chebval(x, chebder(coefficients, m), tensor=False)) for m in (1, 2))
    error = _errors(errors, x)
    by_slope = slope**2 > 2.0 * curvature * error
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.where(by_slope, error / slope, np.sqrt(2.0 * error / curvature)) + FINEST_PLACE
    return np.where(by_slope | (curvature > 0.0), width, 2.0)
