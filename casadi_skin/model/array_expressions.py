"""Formulas as CasADi expressions: values, and antiderivatives where there is a rule for them."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca

from casadi_skin.model.formula import FUNCTIONS, Formula, Name, Number, Operation, Tree, evaluate

HIGHEST_DEGREE = 20  # of polynomials that are integrated
OPERATIONS: Mapping[str, Callable[..., Any]] = {
    "number": ca.SX, "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "^": operator.pow,
    "neg": operator.neg, **{name: getattr(ca, "fabs" if name == "abs" else name) for name in FUNCTIONS},
}  # fmt: skip
# Antiderivatives F of f(u) du, which keep their digits near u = 0 where they can.
ANTIDERIVATIVES: Mapping[str, Callable[[ca.SX], ca.SX]] = {
    "sin": lambda u: 2.0 * ca.sin(u / 2) ** 2, "cos": ca.sin, "exp": ca.expm1, "cosh": ca.sinh,
    "sinh": lambda u: 2.0 * ca.sinh(u / 2) ** 2, "tan": lambda u: -ca.log1p(-(ca.sin(u) ** 2)) / 2,
    "tanh": lambda u: ca.log(ca.cosh(u)), "sqrt": lambda u: u**1.5 / 1.5,
    "atan": lambda u: u * ca.atan(u) - ca.log(1 + u**2) / 2, "abs": lambda u: u * ca.fabs(u) / 2,
    "log": lambda u: u * ca.log(u) - u, "asin": lambda u: u * ca.asin(u) + ca.sqrt(1 - u**2),
    "acos": lambda u: u * ca.acos(u) - ca.sqrt(1 - u**2),
}  # fmt: skip


def expression(formula: Formula | Tree, values: Mapping[str, ca.SX]) -> ca.SX:
    """A formula, or a part of one, as a CasADi expression, where names stand for these expressions."""
    found: ca.SX = evaluate(formula.tree if isinstance(formula, Formula) else formula, values, OPERATIONS)
    return found


def antiderivative(formula: Formula, name: str) -> ca.Function | None:
    """The integral of a formula over one of its names, from 0; None where no rule fits.

    There are rules for polynomials, for functions and powers of terms that are linear in the name, and for sums and
    multiples of these.

    Arguments:
        formula: the integrand.
        name: over which name.

    Returns:
        Function of the name and then of the other names in `formula.names`, in their order.
    """
    x, others = ca.SX.sym(name), {other: ca.SX.sym(other) for other in formula.names if other != name}
    found = _integral(formula.tree, x, others | {name: x})
    if found is None:
        return None
    return ca.Function("W", [x, *others.values()], [found - ca.substitute(found, x, 0)])


def _integral(tree: Tree, x: ca.SX, values: Mapping[str, ca.SX]) -> ca.SX | None:
    if _is_polynomial(tree, x, values):
        return _integral_of_polynomial(expression(tree, values), x)
    if isinstance(tree, Number | Name):
        return None
    parts = [expression(part, values) for part in tree.parts]
    if tree.kind in ("+", "-", "neg"):
        integrals = [_integral(part, x, values) for part in tree.parts]
        return None if None in integrals else OPERATIONS[tree.kind](*integrals)
    if tree.kind in ("*", "/"):
        return _multiple(tree, parts, x, values)
    base = _integral_of_function(tree.kind, parts, x)
    slope = _slope(parts[0], x)
    return None if base is None or slope is None else base / slope


def _is_polynomial(tree: Tree, x: ca.SX, values: Mapping[str, ca.SX]) -> bool:
    if isinstance(tree, Number | Name) or not ca.depends_on(expression(tree, values), x):
        return True
    kind, last = tree.kind, tree.parts[-1]
    if kind == "^":
        whole = isinstance(last, Number) and last.value in range(HIGHEST_DEGREE + 1)
        return whole and _is_polynomial(tree.parts[0], x, values)
    if kind == "/" and ca.depends_on(expression(last, values), x):
        return False
    return kind in ("+", "-", "*", "/", "neg") and all(_is_polynomial(part, x, values) for part in tree.parts)


def _integral_of_polynomial(value: ca.SX, x: ca.SX) -> ca.SX | None:
    """From its derivatives at 0."""
    total = ca.SX(0)
    for degree in range(HIGHEST_DEGREE + 1):
        # A division by a double that is exact: proofs read the energy's coefficients as fractions.
        total += ca.substitute(value, x, 0) * x ** (degree + 1) / math.factorial(degree + 1)
        value = ca.jacobian(value, x)
        if value.is_zero():
            return total
    return None


def _multiple(tree: Operation, parts: list[ca.SX], x: ca.SX, values: Mapping[str, ca.SX]) -> ca.SX | None:
    """The integral of a product or quotient of which one part does not depend on the name."""
    constant = [not ca.depends_on(part, x) for part in parts]
    if constant[1]:
        inner = _integral(tree.parts[0], x, values)
        return None if inner is None else OPERATIONS[tree.kind](inner, parts[1])
    if constant[0] and tree.kind == "*":
        inner = _integral(tree.parts[1], x, values)
        return None if inner is None else parts[0] * inner
    slope = _slope(parts[1], x)
    return parts[0] * ca.log(parts[1]) / slope if constant[0] and slope is not None else None


def _integral_of_function(kind: str, parts: list[ca.SX], x: ca.SX) -> ca.SX | None:
    """The integral over the argument of a function or a power."""
    if kind != "^":
        return ANTIDERIVATIVES[kind](parts[0])
    if ca.depends_on(parts[1], x) or (parts[1].is_constant() and float(parts[1]) == -1.0):
        return None
    return parts[0] ** (parts[1] + 1) / (parts[1] + 1)


def _slope(argument: ca.SX, x: ca.SX) -> ca.SX | None:
    """The derivative of an expression linear in x; None for others."""
    slope = ca.jacobian(argument, x)
    return None if ca.depends_on(slope, x) or slope.is_zero() else slope
