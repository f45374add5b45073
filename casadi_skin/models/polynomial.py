"""A CasADi expression as a polynomial: the terms that power series of a branch are computed from."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
_Terms = dict[tuple[int, ...], float]  # coefficient of each product of variables, named by ascending indices

MAX_TERMS = 64  # of a product that is multiplied out: with more, the polynomial is cheaper left as it is


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
    components = _expand(expression, state, parameter)
    groups: dict[tuple[int, int], list[tuple[int, float, tuple[int, ...]]]] = defaultdict(list)
    last = state.numel()
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


def _expand(expression: ca.SX, state: ca.SX, parameter: ca.SX) -> list[_Terms]:
    """Terms of each component, by running the instructions of the expression on polynomials."""
    function = ca.Function("polynomial", [state, parameter], [ca.densify(expression)])
    offsets = (0, state.numel())
    work: list[_Terms] = [{} for _ in range(function.sz_w())]
    result: list[_Terms] = [{} for _ in range(expression.numel())]
    for k in range(function.n_instructions()):
        operation, out, into = (
            function.instruction_id(k),
            function.instruction_output(k),
            function.instruction_input(k),
        )
        if operation == ca.OP_INPUT:
            work[out[0]] = {(offsets[into[0]] + into[1],): 1.0}
        elif operation == ca.OP_CONST:
            work[out[0]] = {(): float(function.instruction_constant(k))}
        elif operation == ca.OP_OUTPUT:
            result[out[1]] = {v: c for v, c in work[into[0]].items() if c != 0.0}
        elif operation == ca.OP_ADD and out[0] == into[0]:  # a running sum grows in place, or N terms cost N^2
            _add(work[out[0]], work[into[1]], 1.0)
        else:
            work[out[0]] = _apply(operation, [work[i] for i in into])
    return result


def _apply(operation: int, arguments: list[_Terms]) -> _Terms:
    """The result of one instruction on polynomials."""
    a = arguments[0]
    b = arguments[-1]
    if operation in (ca.OP_ADD, ca.OP_SUB):
        return _sum(a, b, -1.0 if operation == ca.OP_SUB else 1.0)
    if operation == ca.OP_MUL:
        return _product(a, b)
    if operation == ca.OP_SQ:
        return _product(a, a)
    if operation in (ca.OP_NEG, ca.OP_TWICE):
        return _sum({}, a, -1.0 if operation == ca.OP_NEG else 2.0)
    if operation == ca.OP_ASSIGN:
        return dict(a)
    if operation == ca.OP_DIV and set(b) == {()}:
        return _sum({}, a, 1.0 / b[()])
    if operation in (ca.OP_POW, ca.OP_CONSTPOW) and set(b) <= {()}:
        exponent = b.get((), 0.0)
        if exponent == int(exponent) and 0 <= exponent <= 16:
            power: _Terms = {(): 1.0}
            for _ in range(int(exponent)):
                power = _product(power, a)
            return power
    names = {ca.OP_DIV: "a division by a variable", ca.OP_POW: "a power", ca.OP_CONSTPOW: "a power"}
    raise NotPolynomialError(f"{names.get(operation, f'operation {operation} of CasADi')} is in the expression")


def _sum(a: _Terms, b: _Terms, factor: float) -> _Terms:
    total = dict(a)
    _add(total, b, factor)
    return total


def _add(total: _Terms, terms: _Terms, factor: float) -> None:
    for variables, coefficient in list(terms.items()):
        total[variables] = total.get(variables, 0.0) + factor * coefficient


def _product(a: _Terms, b: _Terms) -> _Terms:
    total: _Terms = {}
    for left, c in a.items():
        for right, d in b.items():
            variables = tuple(sorted(left + right))
            total[variables] = total.get(variables, 0.0) + c * d
    if len(total) > MAX_TERMS:
        raise NotPolynomialError(f"a product has more than {MAX_TERMS} terms when multiplied out")
    return total
