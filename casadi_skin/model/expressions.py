"""CasADi's expressions of either kind, of which models are made, and the names of their symbols."""

from __future__ import annotations

import operator
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import cut, number, short_repr
from casadi_skin.model.formula import FUNCTIONS, Formula, Name, Number, Operation, Tree, evaluate
from casadi_skin.model.polynomial import NotPolynomialError, homogeneous_parts

Expression: TypeAlias = ca.SX | ca.MX


def names_of(symbols: Expression, given: tuple[str, ...] | None) -> tuple[str, ...]:
    """The names given, or those of the symbols; numbered from 0 where one MX symbol has several components."""
    if given is not None or symbols.numel() == 0:
        return tuple(given or ())
    if isinstance(symbols, ca.SX):
        return tuple(s.name() for s in symbols.elements())
    name, count = symbols.name(), symbols.numel()
    return (name,) if count == 1 else tuple(f"{name}_{i}" for i in range(count))


def is_comparison(expression: Expression) -> bool:
    """Whether an entry is true or false, such as x == 1: where an expression is to vanish, x - 1 is meant."""
    truths = (ca.OP_EQ, ca.OP_NE, ca.OP_LT, ca.OP_LE, ca.OP_AND, ca.OP_OR, ca.OP_NOT)
    several = isinstance(expression, ca.SX) and expression.numel() != 1
    entries = ca.vertsplit(ca.vec(expression)) if several else [expression]
    return any(not entry.is_constant() and not entry.is_symbolic() and entry.op() in truths for entry in entries)


def product(one: Expression, other: Expression | float) -> Expression:
    """The product: CasADi's operators try every kind for their operands, at ten times the cost."""
    return type(one).binary(ca.OP_MUL, one, type(one)(other))


def in_scalars(symbols: Sequence[ca.MX], expression: ca.MX) -> ca.MX:
    """An expression in MX as a function of scalar operations; as it is where a program or a table is part of it."""
    function = ca.Function("scalars", list(symbols), [expression])
    try:
        return function.expand()(*symbols)
    except RuntimeError:  # a part of it has no operations
        return expression


# Expressions of scripts -----------------------------------------------------------------------------------------------


def symbols_of(label: str, given: Any) -> Expression:
    """A column of symbols: one CasADi symbol, or a list of scalar SX symbols.

    Raises TypeError and ValueError for anything else.
    """
    if isinstance(given, list | tuple | np.ndarray):
        entries = _entries(label, given)
        if entries and all(isinstance(entry, ca.SX) for entry in entries):
            given = ca.vertcat(*entries)
    if not isinstance(given, ca.SX | ca.MX):
        raise TypeError(f"{label}: given {short_repr(given)}; accepted: a CasADi symbol, or a list of SX symbols")
    if given.numel() == 0 or given.size2() != 1 or not given.is_dense():
        raise ValueError(f"{label}: given shape {given.shape}; accepted: a column of one symbol or more")
    return given


def expression_of(
    label: str, given: Any, symbols: Sequence[Expression], form: str = "f(t, x, p)", constants: bool = True
) -> Expression:
    """An expression of the kind of the symbols: itself, a number, a list of these, or a function of the symbols.

    Arguments:
        label: Its name in messages.
        given: The value from the script.
        symbols: The arguments of a function.
        form: How that function is called.
        constants: Whether numbers are accepted.

    Raises:
        TypeError: It is none of these, or the function cannot be called so.
        ValueError: Its entries do not make a column of finite numbers and expressions.
    """
    kind = type(symbols[-1])
    if isinstance(given, kind):
        return given
    if callable(given) and not isinstance(given, type):
        given = _called(label, given, symbols, form)
    accepted = f"a CasADi expression of kind {kind.__name__}, a list of them, or a function {form} that returns either"
    if not isinstance(given, list | tuple | np.ndarray):
        return _single(label, given, kind, accepted, constants)
    entries = [_single(label, entry, kind, accepted, constants) for entry in _entries(label, given)]
    if any(entry.size2() != 1 for entry in entries):
        raise ValueError(f"{label}: given a list with a matrix in it; accepted: scalars or columns")
    return ca.vertcat(*entries) if entries else kind(0, 1)


def _single(label: str, given: Any, kind: type[Expression], accepted: str, constants: bool) -> Expression:
    if isinstance(given, kind):
        return given
    if not constants:
        raise TypeError(f"{label}: given {short_repr(given)}; accepted: {accepted}")
    return kind(given if isinstance(given, ca.DM) else number(label, given, accepted))


def _entries(label: str, given: Any) -> list[Any]:
    """Entries of a list or of an array of one column."""
    if not isinstance(given, np.ndarray):
        return list(given)
    if given.ndim > 2 or (given.ndim == 2 and given.shape[1] != 1):
        raise ValueError(f"{label}: given an array of shape {given.shape}; accepted: one column")
    return list(given.ravel())  # of one without dimensions too


def _called(label: str, function: Callable[..., Any], symbols: Sequence[Expression], form: str) -> Any:
    try:
        return function(*symbols)
    except Exception as error:  # of the user's function
        words = cut(" ".join(f"{type(error).__name__}: {error}".split()), 200)
        raise TypeError(f"{label}: the function fails at CasADi symbols: {words}; accepted: {form}") from error


# Formulas as CasADi expressions: values, and antiderivatives where there is a rule for them ---------------------------

FORMULA_OPERATIONS: Mapping[str, Callable[..., Any]] = {
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
    found: ca.SX = evaluate(formula.tree if isinstance(formula, Formula) else formula, values, FORMULA_OPERATIONS)
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
    value = expression(tree, values)
    try:
        parts = homogeneous_parts(value, x, ca.vertcat(*(other for other in values.values() if other is not x)))
        # A division by a double that is exact: proofs read the energy's coefficients as fractions.
        return sum((part * x / (degree + 1) for degree, part in parts.items()), ca.SX(0))
    except NotPolynomialError:
        pass
    if isinstance(tree, Number | Name):
        return None
    arguments = [expression(part, values) for part in tree.parts]
    if tree.kind in ("+", "-", "neg"):
        integrals = [_integral(part, x, values) for part in tree.parts]
        return None if None in integrals else FORMULA_OPERATIONS[tree.kind](*integrals)
    if tree.kind in ("*", "/"):
        return _multiple(tree, arguments, x, values)
    base = _integral_of_function(tree.kind, arguments, x)
    slope = _slope(arguments[0], x)
    return None if base is None or slope is None else base / slope


def _multiple(tree: Operation, parts: list[ca.SX], x: ca.SX, values: Mapping[str, ca.SX]) -> ca.SX | None:
    """The integral of a product or quotient of which one part does not depend on the name."""
    constant = [not ca.depends_on(part, x) for part in parts]
    if constant[1]:
        inner = _integral(tree.parts[0], x, values)
        return None if inner is None else FORMULA_OPERATIONS[tree.kind](inner, parts[1])
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


# Checks of arguments that are arrays of numbers, as in `arguments` ----------------------------------------------------


def real_array(name: str, value: Any, accepted: str = "finite numbers", finite: bool = True) -> NDArray[np.float64]:
    """The value as an array of floats; raises TypeError where it is none, ValueError where one is not `finite`.

    A matrix of CasADi's numbers (DM) is an array, and one of one column a vector.
    """
    full = value
    try:
        if isinstance(value, np.ndarray):
            found = value
        else:
            with warnings.catch_warnings():
                warnings.simplefilter("error")  # of CasADi, where numpy meets expressions
                full = value.full() if type(value).__name__ == "DM" else value
                found = np.asarray(full)
    except Exception:  # of the object's own conversion to numbers
        raise TypeError(_refused(name, value, accepted)) from None
    if found.dtype.kind not in "iuf" and found.size:  # text, truths, complex numbers and objects are none
        raise TypeError(_refused(name, value, accepted))
    found = found.astype(float)
    if finite and not np.all(np.isfinite(found)):
        raise ValueError(_refused(name, value, accepted))
    return found.ravel() if full is not value and found.ndim == 2 and found.shape[1] == 1 else found


def _refused(name: str, value: Any, accepted: str) -> str:
    return f"{name}: given {short_repr(value)}; accepted: {accepted}"


def instants(t: Any) -> NDArray[np.float64]:
    """Times as an array of one dimension; raises TypeError and ValueError for values that are not numbers."""
    found = np.atleast_1d(real_array("t", t, "numbers"))
    if found.ndim != 1:
        raise ValueError(f"t: given shape {found.shape}; accepted: numbers, shape (times,)")
    return found


def at_instants(t: Any, states: NDArray[np.float64]) -> NDArray[np.float64]:
    """States of the instants of t, one row each: of a single number its row alone, as functions of scipy have it."""
    return np.asarray(states[0] if real_array("t", t, "numbers").ndim == 0 else states)


def site_numbers(value: Any) -> NDArray[np.int64] | None:
    """Numbers of sites or components, shape (sites,); None for all. Raises TypeError, ValueError for other values."""
    if value is None:
        return None
    accepted = "whole numbers, each that of a site"
    found = np.atleast_1d(real_array("sites", value, accepted))
    if found.ndim != 1 or not np.all((found == np.round(found)) & (np.abs(found) < 2.0**53)):
        raise ValueError(f"sites: given {short_repr(value)}; accepted: {accepted}")
    return found.astype(np.int64)
