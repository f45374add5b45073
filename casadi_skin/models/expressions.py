"""What models are written in: CasADi's expressions, of either kind, and the names of their symbols."""

from __future__ import annotations

from typing import TypeAlias

import casadi as ca

Expression: TypeAlias = ca.SX | ca.MX


def names_of(symbols: Expression, given: tuple[str, ...] | None) -> tuple[str, ...]:
    """The names given, or those of the symbols; numbered from 0 where one MX symbol has several components."""
    if given is not None or symbols.numel() == 0:
        return tuple(given or ())
    if isinstance(symbols, ca.SX):
        return tuple(s.name() for s in ca.vertsplit(symbols))
    name, count = symbols.name(), symbols.numel()
    return (name,) if count == 1 else tuple(f"{name}_{i}" for i in range(count))


def is_comparison(expression: Expression) -> bool:
    """Whether an entry is true or false, such as x == 1: where an expression is to vanish, x - 1 is meant."""
    truths = (ca.OP_EQ, ca.OP_NE, ca.OP_LT, ca.OP_LE, ca.OP_AND, ca.OP_OR, ca.OP_NOT)
    entries = ca.vertsplit(ca.vec(expression)) if isinstance(expression, ca.SX) else [expression]
    return any(not entry.is_constant() and not entry.is_symbolic() and entry.op() in truths for entry in entries)
