"""Models read as polynomials: the terms give the values of the expression, and what is none is refused by name."""

from __future__ import annotations

from fractions import Fraction

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray

from casadi_skin.model.polynomial import (
    Monomials,
    NotPolynomialError,
    exact_terms,
    homogeneous_parts,
    polynomial_terms,
)


def value(terms: tuple[Monomials, ...], x: NDArray[np.float64], p: float, size: int) -> NDArray[np.float64]:
    total = np.zeros(size)
    for m in terms:
        np.add.at(total, m.rows, m.coefficients * p**m.power * np.prod(x[m.factors], axis=0))
    return total


def test_every_operation_that_keeps_a_polynomial() -> None:
    x, p = ca.SX.sym("x", 3), ca.SX.sym("p")
    expression = ca.vertcat(
        (x[0] - 2 * x[1]) ** 3 * p**2 - x[2] / 4,
        -((x[0] + x[1] * p) ** 2) + 5,
        ca.dot(x, x) * x[1] + p,
        (x[0] + 1) ** 5 - x[0] * p * x[1],
    )
    point, parameter = np.array([0.3, -1.1, 0.7]), 1.7
    exact = np.array(ca.Function("f", [x, p], [expression])(point, parameter)).ravel()
    assert value(polynomial_terms(expression, x, p), point, parameter, 4) == pytest.approx(exact, rel=1e-13)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda x, p: ca.sin(x[0]), "sin is in"),
        (lambda x, p: x[0] / x[1], "division"),
        (lambda x, p: ca.sqrt(x[0] * p), "sqrt is in"),
        (lambda x, p: x[0] ** x[1], "power"),
        (lambda x, p: ca.sum1(x) ** 8, "more than 64 terms"),
    ],
)
def test_what_is_no_polynomial_is_refused(make, words: str) -> None:  # type: ignore[no-untyped-def]
    x, p = ca.SX.sym("x", 6), ca.SX.sym("p")
    with pytest.raises(NotPolynomialError, match=words):
        polynomial_terms(make(x, p), x, p)


# Homogeneous parts ----------------------------------------------------------------------------------------------------


def test_homogeneous_parts_scale_by_their_degree_and_sum_up_to_the_whole() -> None:
    x = ca.SX.sym("x", 3)
    expression = ca.vertcat(
        (x[0] - 2 * x[1]) ** 3 + x[2] / 4 - 7,
        (1 + x[0]) ** 4 - x[1] * x[2],
        x[0] * x[1] * x[2] * ca.dot(x, x) / 2,
    )
    parts = homogeneous_parts(expression, x)
    assert set(parts) == {0, 1, 2, 3, 4, 5}
    point = np.array([0.3, -1.1, 0.7])

    def at(part: ca.SX, here: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.array(ca.Function("f", [x], [ca.densify(part)])(here)).ravel()

    np.testing.assert_allclose(sum(at(p, point) for p in parts.values()), at(expression, point), rtol=1e-14)
    for degree, part in parts.items():
        assert part.shape == (3, 1)
        np.testing.assert_allclose(at(part, 2 * point), 2.0**degree * at(part, point), rtol=1e-14)
    np.testing.assert_allclose(at(parts[3], point), [(0.3 + 2.2) ** 3, 4 * 0.3**3, 0.0], rtol=1e-14)


@pytest.mark.parametrize("sites", [200, pytest.param(1000, marks=pytest.mark.slow)])
def test_homogeneous_parts_of_a_lattice_are_not_multiplied_out(sites: int) -> None:
    """Cubes of differences of many sites: as many operations in each part as in the whole, but for a factor."""
    x = ca.SX.sym("x", sites)
    d = ca.vertcat(x, 0) - ca.vertcat(0, x)
    whole = ca.vertcat(d[1:] - d[:-1] + d[1:] ** 3 - d[:-1] ** 3 - x)
    parts = homogeneous_parts(whole, x)
    assert set(parts) == {1, 3}
    operations = [ca.Function("f", [x], [p]).n_instructions() for p in (whole, *parts.values())]
    assert max(operations[1:]) < 3 * operations[0]


@pytest.mark.parametrize("make", [lambda x: ca.sin(x), lambda x: 1 / x, lambda x: x**0.5, lambda x: ca.fabs(x)])
def test_what_has_no_homogeneous_parts_is_refused(make) -> None:  # type: ignore[no-untyped-def]
    x = ca.SX.sym("x", 2)
    with pytest.raises(NotPolynomialError, match=r"is in the expression$"):
        homogeneous_parts(make(x), x)


def test_exact_terms_round_nothing() -> None:
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p", 2)
    expression = ca.vertcat((1 + p[0]) * x[0] / p[1] - 0.1 * x[1] ** 3, x[0] * (1 / p[1]) * (x[1] - x[0]) ** 2 * 2)
    a, b = Fraction(0.1), Fraction(3.0)
    first, second = exact_terms(expression, x, p, [0.1, 3.0])
    assert first == {(0,): (1 + a) / b, (1, 1, 1): -a}
    assert second == {(0, 0, 0): 2 / b, (0, 0, 1): -4 / b, (0, 1, 1): 2 / b}
    with pytest.raises(NotPolynomialError, match="division by a variable"):
        exact_terms(1 / x[0], x, p, [0.1, 3.0])
