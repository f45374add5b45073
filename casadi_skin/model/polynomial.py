"""A CasADi expression as a polynomial: its terms, for power series of a branch, and its homogeneous parts."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, Generic, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.operations import NAMES, interpret

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
_Terms = dict[tuple[int, ...], Any]  # coefficient of each product of variables, named by ascending indices
_Parts = dict[int, ca.SX]  # homogeneous part by degree
_Element = TypeVar("_Element")

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

    def variable(k: int) -> _Terms:
        if k < last:
            return {(k,): Fraction(1)}
        value = values[k - last]
        if value is None:
            raise NotPolynomialError(f"{fixed[k - last].name()} is in the expression, which is no fraction")
        return {(): Fraction(value)} if value else {}

    ring: _Ring[_Terms] = _Ring(
        _sum, _product, lambda value: {(): Fraction(value)}, lambda a: a.get((), 0) if set(a) <= {()} else None, _add
    )
    expanded = _evaluate(expression, [variables, fixed], ring, variable)
    return [{v: c for v, c in terms.items() if c != 0} for terms in expanded]


def constants(expression: ca.SX, inputs: list[ca.SX]) -> set[float]:
    """The numbers in a column of expressions."""
    function = ca.Function("constants", inputs, [ca.densify(expression)])
    places = [k for k in range(function.n_instructions()) if function.instruction_id(k) == ca.OP_CONST]
    return {float(function.instruction_constant(k)) for k in places}


def homogeneous_parts(expression: ca.SX, state: ca.SX) -> dict[int, ca.SX]:
    """Split a column of polynomials of `state` into homogeneous parts, without multiplying products out.

    Arguments:
        expression: column of expressions in `state` alone.
        state: symbols, one a variable.

    Returns:
        For each degree that occurs a column of the shape of `expression`; their sum is `expression`.

    Raises:
        NotPolynomialError: an operation is not one of a polynomial; the message names it.
    """

    def add(a: _Parts, b: _Parts, factor: float) -> _Parts:
        total = dict(a)
        for d, part in b.items():
            scaled = part if factor == 1.0 else factor * part
            total[d] = total[d] + scaled if d in total else scaled
        return total

    def multiply(a: _Parts, b: _Parts) -> _Parts:
        total: _Parts = {}
        for i, left in a.items():
            for j, right in b.items():
                product = left * right
                total[i + j] = total[i + j] + product if i + j in total else product
        return total

    def constant(a: _Parts) -> float | None:
        if set(a) <= {0}:
            value = a.get(0, ca.SX(0))
            return float(value) if value.is_constant() else None
        return None

    def of_constant(value: float) -> _Parts:
        return {0: ca.SX(value)} if value else {}

    ring = _Ring(add, multiply, of_constant, constant)
    entries = _evaluate(expression, [state], ring, lambda k: {1: state[k]})
    degrees = sorted({degree for entry in entries for degree in entry})
    parts = {d: ca.vertcat(*(entry.get(d, ca.SX(0)) for entry in entries)) for d in degrees}
    return {d: part for d, part in parts.items() if not part.is_zero()}


# Polynomials by their terms -------------------------------------------------------------------------------------------


def _expand(expression: ca.SX, state: ca.SX, parameter: ca.SX) -> list[_Terms]:
    """Terms of each component of a column."""
    ring: _Ring[_Terms] = _Ring(
        _sum, _product, lambda value: {(): value}, lambda a: a.get((), 0.0) if set(a) <= {()} else None, _add
    )
    expanded = _evaluate(expression, [state, parameter], ring, lambda k: {(k,): 1.0})
    return [{v: c for v, c in terms.items() if c != 0.0} for terms in expanded]


def _sum(a: _Terms, b: _Terms, factor: Any) -> _Terms:
    total = dict(a)
    _add(total, b, factor)
    return total


def _add(total: _Terms, terms: _Terms, factor: Any) -> None:
    for variables, coefficient in list(terms.items()):
        total[variables] = total.get(variables, 0) + factor * coefficient


def _product(a: _Terms, b: _Terms) -> _Terms:
    total: _Terms = {}
    for left, c in a.items():
        for right, d in b.items():
            variables = tuple(sorted(left + right))
            total[variables] = total.get(variables, 0) + c * d
    if len(total) > MAX_TERMS:
        raise NotPolynomialError(f"a product has more than {MAX_TERMS} terms when multiplied out")
    return total


# The instructions of an expression in any ring ------------------------------------------------------------------------


@dataclass(frozen=True)
class _Ring(Generic[_Element]):
    """Arithmetic of polynomials in some form: a + factor b, a b, a constant, and the value of one that is constant.

    Factors and values are floats, or fractions where nothing may be rounded.
    """

    add: Callable[[_Element, _Element, Any], _Element]
    multiply: Callable[[_Element, _Element], _Element]
    of_constant: Callable[[Any], _Element]
    constant: Callable[[_Element], Any]
    add_in_place: Callable[[_Element, _Element, Any], None] | None = None


def _evaluate(
    expression: ca.SX, inputs: list[ca.SX], ring: _Ring[_Element], variable: Callable[[int], _Element]
) -> list[_Element]:
    """The components of a column as elements of the ring; variables are numbered through all inputs."""
    function = ca.Function("polynomial", inputs, [ca.densify(expression)])
    offsets = np.concatenate([[0], np.cumsum([symbol.numel() for symbol in inputs])]).tolist()

    def apply(operation: int, arguments: list[_Element], is_free: bool) -> _Element:
        if operation == ca.OP_ADD and is_free and ring.add_in_place is not None:
            # A running sum grows in place, or N terms cost N^2.
            ring.add_in_place(arguments[0], arguments[1], 1)
            return arguments[0]
        return _apply(ring, operation, arguments)

    (entries,) = interpret(function, lambda i, entry: variable(offsets[i] + entry), ring.of_constant, apply)
    zero = ring.of_constant(0.0)
    return [zero if entry is None else entry for entry in entries]


def _apply(ring: _Ring[_Element], operation: int, arguments: list[_Element]) -> _Element:
    """The result of one instruction."""
    a, b, zero = arguments[0], arguments[-1], ring.of_constant(0.0)
    if operation in (ca.OP_ADD, ca.OP_SUB):
        return ring.add(a, b, -1 if operation == ca.OP_SUB else 1)
    if operation == ca.OP_MUL:
        return ring.multiply(a, b)
    if operation == ca.OP_SQ:
        return ring.multiply(a, a)
    if operation in (ca.OP_NEG, ca.OP_TWICE):
        return ring.add(zero, a, -1 if operation == ca.OP_NEG else 2)
    if operation == ca.OP_ASSIGN:
        return ring.add(zero, a, 1)
    value = ring.constant(b)
    if operation == ca.OP_DIV and value:
        return ring.add(zero, a, 1 / value)
    if operation == ca.OP_INV and value:
        return ring.of_constant(1 / value)
    if operation in (ca.OP_POW, ca.OP_CONSTPOW) and value is not None and value == int(value) and 0 <= value <= 16:
        power = ring.of_constant(1.0)
        for _ in range(int(value)):
            power = ring.multiply(power, a)
        return power
    division = dict.fromkeys((ca.OP_DIV, ca.OP_INV), "a division by a variable")
    names = {**division, **dict.fromkeys((ca.OP_POW, ca.OP_CONSTPOW), "a power")}
    name = names.get(operation, NAMES.get(operation, f"operation {operation} of CasADi"))
    raise NotPolynomialError(f"{name} is in the expression")


# Expressions with their numbers as symbols: models that differ in numbers alone share functions -----------------------

Instruction = tuple[int, tuple[int, ...], tuple[int, ...]]  # operation, outputs, inputs


@dataclass(frozen=True)
class Program:
    """The instructions of a function of scalars, without the numbers in it.

    `inputs` and `outputs` count the elements of each argument and result, `numbers` those that were taken out, and
    `work` the places for values in between.
    """

    inputs: tuple[int, ...]
    numbers: int
    outputs: tuple[int, ...]
    work: int
    instructions: tuple[Instruction, ...]

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Taken once: instructions are many."""
        return hash((self.inputs, self.numbers, self.outputs, self.work, self.instructions))

    def expressions(self, inputs: Sequence[ca.SX], numbers: ca.SX) -> list[ca.SX]:
        """The results as columns of expressions in arguments, and in symbols that stand for the numbers."""
        work: list[ca.SX] = [ca.SX(0)] * self.work
        results = [[ca.SX(0)] * count for count in self.outputs]
        used = 0
        for operation, out, into in self.instructions:
            if operation == ca.OP_INPUT:
                work[out[0]] = inputs[into[0]][into[1]]
            elif operation == ca.OP_OUTPUT:
                results[out[0]][out[1]] = work[into[0]]
            elif operation == ca.OP_CONST:
                work[out[0]] = numbers[used]
                used += 1
            elif len(into) == 1:
                work[out[0]] = ca.SX.unary(operation, work[into[0]])
            else:
                work[out[0]] = ca.SX.binary(operation, work[into[0]], work[into[1]])
        return [ca.vertcat(*entries) for entries in results]


def lifted(inputs: Sequence[ca.SX], results: Sequence[ca.SX], most: int) -> tuple[Program, Array] | None:
    """The program of dense columns, and its numbers; None where it has more than `most` instructions."""
    function = ca.Function("lifted", list(inputs), [ca.densify(result) for result in results])
    if function.n_instructions() > most:
        return None
    instructions: list[Instruction] = []
    numbers: list[float] = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        if operation == ca.OP_CONST:
            numbers.append(function.instruction_constant(k))
            into: tuple[int, ...] = ()
        else:
            into = tuple(function.instruction_input(k))
        instructions.append((operation, tuple(function.instruction_output(k)), into))
    sizes = tuple(function.nnz_in(i) for i in range(len(inputs))), len(numbers), tuple(int(r.numel()) for r in results)
    return Program(*sizes, int(function.sz_w()), tuple(instructions)), np.array(numbers)
