"""Power series of a family about its linear mode, harmonic by harmonic: Lindstedt and Poincare's, to any order.

Positions q(theta; p) = sum_k p^k sum_m c_km cos(m theta) solve Omega^2 q'' = J q + N(q, p), every term of N with p as a
factor, under q(0)^T A q(0) = 1. With Omega^2 = sum_k sigma_k p^k, harmonic m of order k reads

    (-m^2 sigma_0 - J) c_km - [m = 1] sigma_k c_01 = N_km + m^2 sum_(0<j<k) sigma_j c_(k-j)m,
    2 q_0(0)^T A q_k(0) = -sum_(0<j<k) q_j(0)^T A q_(k-j)(0),

with one factorisation a harmonic for all orders, and the second line as the border of m = 1. Order k has harmonics up
to 2k + 1 of odd forces, where p is in proportion to S, and up to k + 1 of others, where it is to sqrt(S): nothing is
cut off. So errors are those of rounding: what changes where all coefficients of the equations are rounded at random,
and products are formed at other nodes (Vignes 1993).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from casadi_skin.model.polynomial import Monomials
from casadi_skin.zero.cosines import PolynomialForm, SumOfTerms
from casadi_skin.zero.problem import EPSILON, Array, Indices

ROUNDED_SAMPLES = 5  # series of which errors are estimated
SAMPLES_FACTOR = 3.0  # times the largest change among them: none of 3,000 coefficients was beyond


class SmallDivisorError(ArithmeticError):
    """A harmonic of the linear mode has the frequency of another mode: the family has no such series."""


def amplitude_series(
    form: PolynomialForm, mode: Array, square: float, orders: int, odd: bool
) -> tuple[Indices, tuple[Array, Array], tuple[Array, Array]]:
    """The power series of a family.

    Arguments:
        form: force and normalisation, in one parameter p.
        mode: the linear mode, shape (positions,).
        square: of its frequency.
        orders: the highest power of p.
        odd: whether forces are odd, so that there are odd harmonics alone.

    Returns:
        The harmonics m; coefficients of Omega, shape (orders + 1,), and c_km, shape (orders + 1, harmonics, positions);
        and their estimated errors.

    Raises:
        SmallDivisorError: a harmonic is in resonance with a linear mode.
    """
    random = np.random.default_rng(0)

    def rounded(term: Monomials) -> Monomials:
        return replace(term, coefficients=term.coefficients * (1.0 + random.uniform(-EPSILON, EPSILON, term.rows.size)))

    harmonics, found = _series(form, mode, square, orders, odd)
    off = [np.zeros_like(values) for values in found]
    for extra in range(1, ROUNDED_SAMPLES + 1):
        other = PolynomialForm(tuple(map(rounded, form.force)), tuple(map(rounded, form.norm)))
        Omega, cosines = _series(other, mode, square, orders, odd, extra)[1]
        for part, values, known in zip(off, (Omega, cosines[:, : harmonics.size]), found, strict=True):
            np.maximum(part, np.abs(values - known), out=part)
    # What came out alike by chance is as far off, of its size, as all of its order are, or of an order before.
    sums, sizes = (np.sum(np.abs(values), axis=(1, 2)) for values in (off[1], found[1]))
    typical = np.maximum.accumulate(np.divide(sums, sizes, out=np.zeros_like(sums), where=sizes > 0.0))
    off[1] = np.maximum(off[1], typical[:, None, None] * np.abs(found[1]))
    Omega, cosines = (SAMPLES_FACTOR * (part + EPSILON * np.abs(v)) for part, v in zip(off, found, strict=True))
    return harmonics, found, (Omega, cosines)


def _series(
    form: PolynomialForm, mode: Array, square: float, orders: int, odd: bool, extra: int = 0
) -> tuple[Indices, tuple[Array, Array]]:
    """Harmonics and coefficients, with products at the fewest nodes that have no aliases, or some more."""
    n, present = mode.size, orders + (1 if odd else 2)  # harmonics of the highest order
    count = present + extra
    m, parts = (2 * np.arange(count) + 1, 4 * count) if odd else (np.arange(count), 2 * count)
    to_nodes = np.cos(np.pi / parts * (np.outer(m, 2 * np.arange(count) + 1) % (2 * parts)))
    to_cosines = (to_nodes * np.where(m == 0, 1.0, 2.0)[:, None] / count).T
    first = int(np.argmax(m == 1))

    (linear,) = (term for term in form.force if (term.power, term.degree) == (0, 1))
    (quadratic,) = (term for term in form.norm if term.degree == 2)
    J = _matrix(linear.coefficients, linear.rows, linear.factors[0], n)
    half = _matrix(quadratic.coefficients, quadratic.factors[0], quadratic.factors[1], n)
    A = half + half.T

    c, values, at_zero = (np.zeros((orders + 1, *shape)) for shape in ((n, count), (n * count,), (n,)))
    force, sigma = SumOfTerms(form.force, values, n, count), np.zeros(orders + 1)
    powers = np.eye(force.highest + 1, orders + 1)  # series of p^0, p^1, ...

    def put(k: int) -> None:
        values[k], at_zero[k] = (c[k] @ to_nodes).ravel(), c[k].sum(axis=1)
        force.order(k, powers)

    # The linear mode to rounding, by a Newton step: what is left of it would go into every order.
    residual = np.append(-square * mode - J @ mode, 0.5 * (mode @ (A @ mode)) - 1.0)
    step = _factors(J, square, 1, mode, A @ mode)(residual)
    c[0, :, first], sigma[0] = mode - step[:-1], square - step[-1]
    put(0)
    start, row = c[0, :, first], A @ c[0, :, first]
    solves = [_factors(J, sigma[0], k, *((start, row) if k == 1 else ())) for k in m[:present].tolist()]
    for k in range(1, orders + 1):
        right = force.order(k, powers) @ to_cosines
        right += m**2 * np.einsum("j,jnm->nm", sigma[k - 1 : 0 : -1], c[1:k])
        for place in range(k + 1 if odd else k + 2):
            if place != first:
                c[k, :, place] = solves[place](right[:, place])
        border = -row @ c[k].sum(axis=1) - 0.5 * np.sum((at_zero[1:k] @ A) * at_zero[k - 1 : 0 : -1])
        solution = solves[first](np.append(right[:, first], border))
        c[k, :, first], sigma[k] = solution[:-1], solution[-1]
        put(k)
    return m, (_square_root(sigma), c.swapaxes(1, 2))


def _matrix(values: Array, rows: Any, columns: Any, n: int) -> Any:
    from scipy.sparse import csc_array

    return csc_array((values, (rows, columns)), (n, n))


def _factors(J: Any, square: float, m: int, *border: Array) -> Callable[[Array], Array]:
    """Solves -m^2 square - J, of the fundamental with a `border`: the mode in a column, and a row."""
    from scipy.sparse import block_array, csc_array, eye_array
    from scipy.sparse.linalg import splu

    matrix: Any = -(m**2) * square * eye_array(J.shape[0]) - J
    if border:
        matrix = block_array([[matrix, csc_array(-border[0][:, None])], [csc_array(border[1][None]), None]])
    try:
        solve: Callable[[Array], Array] = splu(matrix.tocsc()).solve
    except RuntimeError as error:  # SuperLU: "Factor is exactly singular"
        raise SmallDivisorError(f"series: harmonic {m} of the mode has the frequency of another mode") from error
    return solve


def _square_root(squares: Array) -> Array:
    """The power series whose square has these coefficients, shape (orders + 1,)."""
    found = np.full(squares.size, np.sqrt(squares[0]))
    for k in range(1, squares.size):
        found[k] = (squares[k] - found[1:k] @ found[k - 1 : 0 : -1]) / (2.0 * found[0])
    return found
