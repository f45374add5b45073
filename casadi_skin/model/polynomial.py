"""A CasADi expression as a polynomial: its terms, for power series of a branch, and its homogeneous parts."""

from __future__ import annotations

import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.operations import NAMES, Program, operated, read

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
_Polynomial = dict[Any, Any]  # coefficient of each key: a product of variables by ascending indices, or a degree

MAX_TERMS = 64  # of a product that is multiplied out: with more, the polynomial is cheaper left as it is
MAX_POWER = 16  # that is multiplied out


class NotPolynomialError(ValueError):
    """The expression is no polynomial of its variables."""


@dataclass(frozen=True)
class Monomials:
    """Terms coefficient * parameter^power * product of `degree` states, each added to a component of the result.

    `rows` and `coefficients` have shape (terms,), `factors`, the indices of the states, (degree, terms).
    """

    power: int
    rows: Indices
    coefficients: Array
    factors: Indices

    @property
    def degree(self) -> int:
        """Number of states in each product."""
        return int(self.factors.shape[0])


def polynomial_terms(expression: ca.SX, state: ca.SX, parameter: ca.SX) -> tuple[Monomials, ...]:
    """Terms of a column of polynomials in `state` and one `parameter`, grouped by their powers.

    Raises NotPolynomialError naming the operation that is none.
    """
    read_in = read(ca.Function("polynomial", [state, parameter], [ca.densify(expression)]))
    return terms_of_results(*read_in, state.numel())[0]


def terms_of_results(program: Program, numbers: Sequence[float], states: int) -> list[tuple[Monomials, ...]]:
    """The same of all results of a program of `states` and one parameter, its last argument."""
    found = _Ring((), _product, float, MAX_TERMS).polynomials(program, numbers, lambda k: {(k,): 1.0})
    return [_grouped(components, states) for components in found]


def _grouped(components: Iterable[_Polynomial], last: int) -> tuple[Monomials, ...]:
    groups: dict[tuple[int, int], list[tuple[int, float, tuple[int, ...]]]] = defaultdict(list)
    for row, terms in enumerate(components):
        for variables, coefficient in terms.items():
            states = tuple(v for v in variables if v < last)
            groups[len(variables) - len(states), len(states)].append((row, coefficient, states))
    result = []
    for (power, degree), members in sorted(groups.items()):
        rows, coefficients, factors = zip(*members, strict=True)
        shaped: Indices = np.array(factors, dtype=np.int64).reshape(len(rows), degree).T.copy()
        result.append(Monomials(power, np.array(rows, dtype=np.int64), np.array(coefficients), shaped))
    return tuple(result)


def exact_terms(
    expression: ca.SX, variables: ca.SX, fixed: ca.SX, values: Sequence[float | Fraction | None]
) -> list[dict[tuple[int, ...], Fraction]]:
    """Terms of a column of polynomials with exact coefficients: a double is a fraction, and nothing is rounded.

    Arguments:
        expression: column of expressions in `variables` and `fixed`.
        variables: symbols of the polynomials.
        fixed: symbols that have `values`.
        values: one a symbol, None for one that is no fraction.

    Returns:
        For each component the coefficient of each product of variables, named by ascending indices.

    Raises:
        NotPolynomialError: an operation is not one of a polynomial, or a number no fraction; the message names it.
    """
    last = variables.numel()

    def variable(k: int) -> _Polynomial:
        if k < last:
            return {(k,): Fraction(1)}
        value = values[k - last]
        if value is None:
            raise NotPolynomialError(f"{fixed[k - last].name()} is in the expression, which is no fraction")
        return {(): Fraction(value)} if value else {}

    return _Ring((), _product, Fraction, MAX_TERMS).of_column(expression, [variables, fixed], variable)


def constants(expression: ca.SX, inputs: list[ca.SX]) -> set[float]:
    """The numbers in a column of expressions."""
    function = ca.Function("constants", inputs, [ca.densify(expression)])
    places = [k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CONST]
    return {float(function.instruction_constant(k)) for k in places}


def homogeneous_parts(expression: ca.SX, state: ca.SX, fixed: ca.SX | None = None) -> dict[int, ca.SX]:
    """Split a column of polynomials of `state` into homogeneous parts, without multiplying products out.

    Arguments:
        expression: column of expressions in `state` and `fixed`.
        state: symbols, one a variable.
        fixed: symbols that are constants.

    Returns:
        For each degree that occurs a column of the shape of `expression`; their sum is `expression`.

    Raises:
        NotPolynomialError: an operation is not one of a polynomial; the message names it.
    """
    constants = ca.SX(0, 1) if fixed is None else fixed
    n, symbols = state.numel(), ca.vertcat(state, constants)
    ring = _Ring(0, int.__add__, ca.SX)
    entries = ring.of_column(expression, [state, constants], lambda k: {int(k < n): symbols[k]})
    degrees = sorted({degree for entry in entries for degree in entry})
    parts = {d: ca.vertcat(*(entry.get(d, ca.SX(0)) for entry in entries)) for d in degrees}
    return {d: part for d, part in parts.items() if not part.is_zero()}


# The operations of an expression on polynomials -----------------------------------------------------------------------


def _product(left: tuple[int, ...], right: tuple[int, ...]) -> tuple[int, ...]:
    """The product of two products of variables."""
    return tuple(sorted(left + right))


@dataclass(frozen=True)
class _Ring:
    """Arithmetic of polynomials as coefficients by keys.

    Attributes:
        unit: the key of constants.
        joined: the key of the product of what two keys stand for.
        number: makes a coefficient of a number: a float, a fraction where nothing may be rounded, an expression.
        most: number of coefficients of a product.
    """

    unit: Any
    joined: Callable[[Any, Any], Any]
    number: Callable[[Any], Any]
    most: int = sys.maxsize

    def of_column(
        self, expression: ca.SX, inputs: list[ca.SX], variable: Callable[[int], _Polynomial]
    ) -> list[_Polynomial]:
        """The components of a column; variables are numbered through all inputs."""
        return self.polynomials(*read(ca.Function("polynomial", inputs, [ca.densify(expression)])), variable)[0]

    def polynomials(
        self, program: Program, numbers: Sequence[float], variable: Callable[[int], _Polynomial]
    ) -> list[list[_Polynomial]]:
        """The entries of the results of a program without coefficients 0."""
        results = program.evaluated(variable, map(self._constant, numbers), self._apply)
        return [[{k: c for k, c in (e or {}).items() if isinstance(c, ca.SX) or c != 0} for e in r] for r in results]

    def _constant(self, value: Any) -> _Polynomial:
        return {self.unit: self.number(value)} if value else {}

    def _value(self, a: _Polynomial) -> Any:
        """The value of a polynomial that is a number; None of another."""
        if not set(a) <= {self.unit}:
            return None
        value = a.get(self.unit, 0)
        if not isinstance(value, ca.SX):
            return value
        return float(value) if value.is_constant() else None

    def _multiply(self, a: _Polynomial, b: _Polynomial) -> _Polynomial:
        total: _Polynomial = {}
        for left, c in a.items():
            for right, d in b.items():
                key, coefficient = self.joined(left, right), _of_coefficients(ca.OP_MUL, c, d)
                total[key] = _of_coefficients(ca.OP_ADD, total[key], coefficient) if key in total else coefficient
        if len(total) > self.most:
            raise NotPolynomialError(f"a product has more than {self.most} terms when multiplied out")
        return total

    def _apply(self, operation: int, arguments: list[_Polynomial], is_free: bool) -> _Polynomial:
        """The result of one operation; a running sum that is free grows in place, or N terms cost N^2."""
        a, b = arguments[0], arguments[-1]
        if operation in (ca.OP_ADD, ca.OP_SUB):
            return _sum(a if is_free else dict(a), b, -1 if operation == ca.OP_SUB else 1)
        if operation in (ca.OP_MUL, ca.OP_SQ):
            return self._multiply(a, b)
        if operation in SCALINGS:
            return _sum({}, a, SCALINGS[operation])
        value = self._value(b)
        if operation == ca.OP_DIV and value:
            return _sum({}, a, 1 / value)
        if operation == ca.OP_INV and value:
            return self._constant(1 / value)
        powers = (ca.OP_POW, ca.OP_CONSTPOW)
        if operation in powers and value is not None and value == int(value) and 0 <= value <= MAX_POWER:
            power = self._constant(1.0)
            for _ in range(int(value)):
                power = self._multiply(power, a)
            return power
        constants = [polynomial.get(self.unit, ca.SX(0)) for polynomial in arguments if set(polynomial) <= {self.unit}]
        if self.number is ca.SX and len(constants) == len(arguments):  # expressions in what is fixed
            return {self.unit: operated(operation, constants)}
        names = dict.fromkeys((ca.OP_DIV, ca.OP_INV), "a division by a variable") | dict.fromkeys(powers, "a power")
        name = names.get(operation, NAMES.get(operation, f"operation {operation} of CasADi"))
        raise NotPolynomialError(f"{name} is in the expression")


SCALINGS = {ca.OP_NEG: -1, ca.OP_TWICE: 2, ca.OP_ASSIGN: 1}  # operations that are multiples


def _sum(total: _Polynomial, terms: _Polynomial, factor: Any) -> _Polynomial:
    """The first polynomial, to which a multiple of the second is added."""
    for key, coefficient in list(terms.items()):
        scaled = coefficient
        if factor != 1:
            scaled = _of_coefficients(ca.OP_MUL, type(coefficient)(factor), coefficient)
        total[key] = _of_coefficients(ca.OP_ADD, total[key], scaled) if key in total else scaled
    return total


def _of_coefficients(operation: int, a: Any, b: Any) -> Any:
    """A sum or a product: of expressions by one operation, as Python's operators take ten times as long to find it."""
    if isinstance(a, ca.SX):
        return ca.SX.binary(operation, a, b)
    return a + b if operation == ca.OP_ADD else a * b
