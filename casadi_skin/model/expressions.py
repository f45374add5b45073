"""CasADi's expressions of either kind, of which models are made, and the names of their symbols."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from casadi_skin.model.arguments import cut, number, short_repr

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


def product(one: ca.SX, other: ca.SX | float) -> ca.SX:
    """The product: CasADi's operators try every kind for their operands, at ten times the cost."""
    return ca.SX.binary(ca.OP_MUL, one, ca.SX(other))


def total(one: ca.SX, other: ca.SX | float) -> ca.SX:
    """The sum, likewise."""
    return ca.SX.binary(ca.OP_ADD, one, ca.SX(other))


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
