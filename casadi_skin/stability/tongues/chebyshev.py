"""Chebyshev series on an interval: nodes, coefficients, values, and every real zero.

See Trefethen, Approximation Theory and Approximation Practice (2013), chapters 3, 8 and 18.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import groupby

import numpy as np
from numpy.polynomial.chebyshev import chebder
from numpy.typing import NDArray

from casadi_skin.zero.problem import Array, Indices

SERIES_DEGREE = 16  # of the series on an interval of a branch
END_SLACK = 1e-9  # beyond the ends, in which a zero still counts
NEARLY_REAL = 1e-4  # imaginary part of a zero that rounding may have made of two real ones
NEGLIGIBLE_COEFFICIENT = (
    1e-14  # of the largest coefficient: smaller ones are left out of the eigenvalue problem of the zeros
)
POLISHING_STEPS = 4  # steps of Newton's method on zeros
INTERVAL_PARTS = 4  # of [-1, 1], on each of which most functions are monotonic or have no zero
CLEAR_MEAN_RATIO = 0.99  # of a mean: variations that leave no zero, nor one just outside or beside the real axis
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


@cache
def derivative(degree: int) -> Array:
    """Matrix from coefficients to those of the derivative, shape (degree + 1, degree + 1)."""
    matrix = np.zeros((degree + 1, degree + 1))
    matrix[:-1] = chebder(np.eye(degree + 1), axis=0) if degree else 0.0
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
    return _kept(basis(0.0, degree) @ derivative(degree) @ transform(degree))


def combined(matrix: Array, values: Array) -> Array:
    """A matrix times values by their second axis: (rows, J) and (n, J, ...) -> (n, rows, ...)."""
    flat = matrix @ values.reshape(*values.shape[:2], -1)
    return np.asarray(flat.reshape(len(values), len(matrix), *values.shape[2:]))


def tail(coefficients: Array) -> Array:
    """Size of the last coefficients, (degree + 1, ...) -> (...): the remainder of the series is no larger."""
    return np.asarray(np.sum(np.abs(coefficients[-TAIL_COEFFICIENTS:]), axis=0))


def excludes_zero(coefficients: Array, margin: float = 1.0) -> NDArray[np.bool_]:
    """Which functions have certainly no zero in [-1, 1]: coefficients (degree + 1, ...) -> (...).

    With a margin below 1 the variations about the mean are less than that part of it.
    """
    return np.asarray(margin * np.abs(coefficients[0]) > np.sum(np.abs(coefficients[1:]), axis=0))


def value(coefficients: Array, of: NDArray[np.int64], x: Array) -> Array:
    """Values at places x, each of the function numbered `of`; coefficients (degree + 1, functions)."""
    return np.asarray(np.sum(basis(x, len(coefficients) - 1) * coefficients.T[of], axis=1))


def real_zeros(coefficients: Array) -> tuple[NDArray[np.int64], Array, NDArray[np.bool_]]:
    """Zeros in [-1, 1] of several functions, and where they come near zero without a change of sign.

    The second are real parts of conjugate zeros next to the real axis. A function that has no zero or is monotonic on
    each of a few parts has no such ones, and as many zeros as changes of sign; the others have those that are
    eigenvalues of their colleague matrices (Good 1961), all of one size at a time.

    Arguments:
        coefficients: shape (degree + 1, functions).

    Returns:
        The function of each place, the places, and whether it changes its sign there.
    """
    simple, of, x = _simple_zeros(coefficients)
    others = np.flatnonzero(~simple)
    those, zeros = _by_eigenvalues(coefficients[:, others])
    crosses = np.concatenate([np.ones(x.size, dtype=bool), zeros.imag == 0.0])
    of, x = np.concatenate([of, others[those]]), np.concatenate([x, zeros.real])
    x[crosses] = _polished(coefficients, of[crosses], x[crosses])
    inside = ~crosses | (np.abs(x) <= 1.0 + END_SLACK)
    return of[inside], np.clip(x[inside], -1.0, 1.0), crosses[inside]


@cache
def _parts(degree: int) -> tuple[Array, Array]:
    """Places in equal parts of [-1, 1], the nodes of each, shape (PARTS, degree + 1), and the polynomials there."""
    starts = np.linspace(-1.0, 1.0, INTERVAL_PARTS + 1)[:-1, None]
    places = starts + (nodes(degree) + 1.0) / INTERVAL_PARTS
    return _kept(places), _kept(basis(places, degree))


def _simple_zeros(coefficients: Array) -> tuple[NDArray[np.bool_], NDArray[np.int64], Array]:
    """Functions without a zero or an extremum near any part, and the function and the place, nearly, of their zeros."""
    degree = len(coefficients) - 1
    places, polynomials = _parts(degree)
    values = polynomials @ coefficients
    simple = np.ones(coefficients.shape[1], dtype=bool)
    slopes = polynomials @ (derivative(degree) @ coefficients)
    for here, slope in zip(values, slopes, strict=True):
        excluded, monotonic = (excludes_zero(transform(degree) @ each, CLEAR_MEAN_RATIO) for each in (here, slope))
        simple &= excluded | monotonic
    values, slopes = values[..., simple], slopes[..., simple]
    values[0, 0], values[-1, -1] = values[0, 0] - END_SLACK * slopes[0, 0], values[-1, -1] + END_SLACK * slopes[-1, -1]
    positive = values >= 0.0
    positive[:-1, -1] = positive[1:, 0]  # parts that touch agree
    part, which = np.nonzero(positive[:, 0] != positive[:, -1])
    k = np.argmax(positive[part, 1:, which] != positive[part, :-1, which], axis=1)
    before, after, x = values[part, k, which], values[part, k + 1, which], places[part, k]
    share = np.divide(before, before - after, out=np.zeros_like(before), where=before != after)
    return simple, np.flatnonzero(simple)[which], x + np.clip(share, 0.0, 1.0) * (places[part, k + 1] - x)


def _by_eigenvalues(coefficients: Array) -> tuple[NDArray[np.int64], NDArray[np.complex128]]:
    """Zeros next to the real axis, not below it, and the function of each."""
    sizes = np.abs(coefficients)
    significant = sizes > NEGLIGIBLE_COEFFICIENT * np.max(sizes, axis=0)
    degrees = np.max(np.arange(len(sizes))[:, None] * significant, axis=0, initial=0)
    owners, places = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=complex)]
    for degree in np.unique(degrees[degrees > 0]).tolist():
        chosen = np.flatnonzero(degrees == degree)
        values = np.linalg.eigvals(_colleagues(coefficients[: degree + 1, chosen]))
        near_axis = (np.abs(values.imag) <= NEARLY_REAL) & (np.abs(values.real) <= 1.0 + NEARLY_REAL)
        owners.append(chosen[np.nonzero(near_axis)[0]])
        places.append(values[near_axis].astype(complex))
    of, zeros = np.concatenate(owners), np.concatenate(places)
    kept = zeros.imag >= 0.0
    return of[kept], zeros[kept]


def _colleagues(coefficients: Array) -> Array:
    """Matrices whose eigenvalues are the zeros, shape (functions, degree, degree); the last coefficient is not 0."""
    degree, count = coefficients.shape[0] - 1, coefficients.shape[1]
    if degree == 1:
        return np.asarray(-(coefficients[0] / coefficients[1])[:, None, None])
    matrix = np.zeros((degree, degree))
    k = np.arange(degree - 1)
    matrix[k, k + 1] = matrix[k + 1, k] = 0.5
    matrix[0, 1] = 1.0
    matrices = np.tile(matrix, (count, 1, 1))
    matrices[:, -1, :] -= 0.5 * (coefficients[:-1] / coefficients[-1]).T
    return matrices


def _polished(coefficients: Array, of: NDArray[np.int64], x: Array) -> Array:
    """Zeros after a few steps of Newton's method, each of the function numbered `of`."""
    slopes = derivative(len(coefficients) - 1) @ coefficients
    step, start = np.full(x.shape, np.inf), x
    for _ in range(POLISHING_STEPS if x.size else 0):
        here, change = value(coefficients, of, x), value(slopes, of, x)
        new = np.divide(here, change, out=np.zeros_like(here), where=change != 0.0)
        new = np.where(np.abs(new) < np.abs(step), new, 0.0)
        x, step = x - new, new
    worse = np.abs(value(coefficients, of, x)) > np.abs(value(coefficients, of, start))  # at a double zero
    return np.where(worse, start, x)


# Functions on an interval whose zeros are edges of instabilities, with the effects of their errors on these -----------

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
        return np.asarray(basis(x, len(self.coefficients) - 1) @ self.coefficients)

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
            of, x, crosses = real_zeros(coefficients)
            seen = crosses | (np.abs(value(coefficients, of, x)) <= _errors(errors, of, x))
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
    near = np.searchsorted(nodes(SERIES_DEGREE), x)[:, None] + np.arange(-ERROR_REACH_NODES, ERROR_REACH_NODES)
    return np.asarray(np.max(errors[of[:, None], np.clip(near, 0, SERIES_DEGREE)], axis=1))


def _widths(coefficients: Array, errors: Array, of: Indices, x: Array) -> Array:
    """`Function.width` at places x of the functions numbered `of`, coefficients (degree + 1, functions)."""
    matrix = derivative(len(coefficients) - 1)
    first = matrix @ coefficients
    slope, curvature = (np.abs(value(c, of, x)) for c in (first, matrix @ first))
    error = _errors(errors, of, x)
    by_slope = slope**2 > 2.0 * curvature * error
    with np.errstate(divide="ignore", invalid="ignore"):
        width = np.where(by_slope, error / slope, np.sqrt(2.0 * error / curvature)) + FINEST_PLACE
    return np.where(by_slope | (curvature > 0.0), width, 2.0)
