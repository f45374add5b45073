"""Formulas in scenes: numbers, names, + - * / ^ and elementary functions, read as data and never run as code.

A power binds tighter than the sign before it (-x^2 is -(x^2)) and to the right (x^2^3 is x^(2^3)). The module loads no
numerics, so that a scene is checked without them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeAlias

from casadi_skin.model.arguments import cut, nearest

FUNCTIONS = (
    "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "sqrt", "abs",
)  # fmt: skip
CONSTANTS = {"pi": math.pi}
LONGEST_FORMULA, DEEPEST_FORMULA = 2000, 50  # characters, and brackets, signs and powers inside one another
FORMULA_TOKEN = re.compile(
    r"\s*(?:((?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|([A-Za-z_][A-Za-z_0-9]*)|(.))", re.DOTALL | re.ASCII
)


class FormulaError(ValueError):
    """A text is no formula: one line with the column, the text there and the accepted values."""

    def __init__(self, column: int, given: str, accepted: str) -> None:
        super().__init__(f"column {column}: given {given}; accepted: {accepted}")


@dataclass(frozen=True)
class Number:
    """A number as it is written, its double and the fraction that the decimal is."""

    text: str

    @property
    def value(self) -> float:
        return float(self.text)

    @property
    def exact(self) -> Fraction:
        return Fraction(self.text)


@dataclass(frozen=True)
class Name:
    """A name and where it first stands, counted from 1."""

    name: str
    column: int


@dataclass(frozen=True)
class Operation:
    """An operation on one or two parts: one of + - * / ^, "neg", or a function."""

    kind: str
    parts: tuple[Tree, ...]


Tree: TypeAlias = Number | Name | Operation


@dataclass(frozen=True)
class Formula:
    """A formula as it was written, with its tree."""

    text: str
    tree: Tree

    @cached_property
    def names(self) -> dict[str, int]:
        """Names in it but for constants, with the columns where they first stand."""
        found: dict[str, int] = {}
        for node in walk(self.tree):
            if isinstance(node, Name) and node.name not in CONSTANTS:
                found.setdefault(node.name, node.column)
        return found

    def check_names(self, known: Sequence[str]) -> None:
        """Raises FormulaError for a name that is not among the known ones."""
        for name, column in self.names.items():
            if name not in known:
                near = nearest(name, known)
                hint = f"{', '.join(known)}, pi" + (f" (did you mean {near}?)" if near else "")
                raise FormulaError(column, f'the name "{cut(name)}"', hint)


def walk(tree: Tree) -> Iterator[Tree]:
    """All parts of a tree, from left to right."""
    yield tree
    for part in tree.parts if isinstance(tree, Operation) else ():
        yield from walk(part)


def evaluate(tree: Tree, values: Mapping[str, Any], operations: Mapping[str, Callable[..., Any]]) -> Any:
    """The value where names have these values; "number" among the operations makes what numbers become."""
    if isinstance(tree, Number):
        return operations["number"](tree.value)
    if isinstance(tree, Name):
        return values[tree.name] if tree.name in values else operations["number"](CONSTANTS[tree.name])
    return operations[tree.kind](*(evaluate(part, values, operations) for part in tree.parts))


def with_names_of_numbers(tree: Tree) -> Tree:
    """The tree with every number but for exponents as a name, which is the text of the number."""
    if isinstance(tree, Number):
        return Name(tree.text, 0)
    if isinstance(tree, Name):
        return tree
    exponent = tree.parts[1:] if tree.kind == "^" and isinstance(tree.parts[1], Number) else ()
    named = tree.parts[:1] if exponent else tree.parts
    return Operation(tree.kind, (*map(with_names_of_numbers, named), *exponent))


def parse_formula(text: str) -> Formula:
    """Read a formula.

    Arguments:
        text: a formula such as "alpha*y + g*y^3".

    Returns:
        The formula with its tree.

    Raises:
        FormulaError: the text is no formula; in one line with the column.
    """
    if len(text) > LONGEST_FORMULA:
        raise FormulaError(LONGEST_FORMULA + 1, f"a formula of {len(text)} characters", f"{LONGEST_FORMULA} characters")
    return Formula(text, _Parser(text).whole())


class _Parser:
    """A recursive descent over the tokens of a text."""

    def __init__(self, text: str) -> None:
        self._tokens: list[tuple[int, str, int]] = list(_tokens(text))
        self._tokens.append((0, "", len(text.rstrip()) + 1))
        self._at, self._depth = 0, 0

    def whole(self) -> Tree:
        tree = self._sum()
        if self._tokens[self._at][0] != 0:
            raise self._error("an operator (+ - * / ^), or the end of the formula")
        return tree

    def _error(self, accepted: str) -> FormulaError:
        kind, token, column = self._tokens[self._at]
        given = f'"{ascii(token)[1:-1] if not token.isprintable() else cut(token)}"' if kind else "the end"
        return FormulaError(column, given, accepted)

    def _take(self, *symbols: str) -> str | None:
        kind, token, _ = self._tokens[self._at]
        if kind != 3 or token not in symbols:
            return None
        self._at += 1
        return token

    def _sum(self) -> Tree:
        tree = self._product()
        while symbol := self._take("+", "-"):
            tree = Operation(symbol, (tree, self._product()))
        return tree

    def _product(self) -> Tree:
        tree = self._signed()
        while symbol := self._take("*", "/"):
            tree = Operation(symbol, (tree, self._signed()))
        return tree

    def _signed(self) -> Tree:
        self._depth += 1
        if self._depth > DEEPEST_FORMULA:
            raise self._error(f"at most {DEEPEST_FORMULA} brackets, signs and powers inside one another")
        if sign := self._take("+", "-"):
            part = self._signed()
            tree = part if sign == "+" else Operation("neg", (part,))
        else:
            tree = self._atom()
            if self._take("^"):
                tree = Operation("^", (tree, self._signed()))
        self._depth -= 1
        return tree

    def _atom(self) -> Tree:
        kind, token, column = self._tokens[self._at]
        if self._take("("):
            return self._closed()
        if kind == 1 and math.isfinite(float(token)):
            if not float(token) and token.lower().partition("e")[0].strip("0."):
                raise self._error("0, or a number that is not 0 as a double")
            self._at += 1
            return Number(token)
        if kind != 2:
            if token == "*" and self._tokens[self._at - 1][1] == "*":
                raise self._error("^ for powers")
            raise self._error("a finite number, a name, a function or a bracket")
        self._at += 1
        if self._take("("):
            if token not in FUNCTIONS:
                raise FormulaError(column, f'the function "{cut(token)}"', ", ".join(FUNCTIONS))
            return Operation(token, (self._closed(),))
        if token in FUNCTIONS:
            raise FormulaError(column, f'"{token}"', f"{token}(...), for this is the name of a function")
        return Name(token, column)

    def _closed(self) -> Tree:
        """The expression inside an open bracket."""
        tree = self._sum()
        if not self._take(")"):
            raise self._error("an operator (+ - * / ^) or )")
        return tree


def _tokens(text: str) -> Iterator[tuple[int, str, int]]:
    """Numbers (1), names (2) and other characters (3), with their columns."""
    for match in FORMULA_TOKEN.finditer(text.rstrip()):
        kind = match.lastindex or 0
        yield kind, match[kind], match.start(kind) + 1
