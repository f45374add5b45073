"""Expressions as data: a list of elementary operations on numbers, symbols and earlier results, as text.

Symbols are numbered from 0 and each operation adds one number: "mul 3 5" is the product of numbers 3 and 5,
"const 0.5" a number. Nothing else can be written or read, so that reading them runs no code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import casadi as ca

from casadi_skin.model.arguments import in_words, short_repr

MOST_OPERATIONS = 1_000_000
MOST_DEPTH = 5_000  # operations on operations; CasADi prints by recursion, and ends the process from 13,000 on
CONSTANT = "const"
ONE_ARGUMENT = (
    "neg", "exp", "log", "sqrt", "sq", "twice", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh",
    "asinh", "acosh", "atanh", "floor", "ceil", "fabs", "sign", "erf", "erfinv", "inv", "not", "log1p", "expm1",
)  # fmt: skip
TWO_ARGUMENTS = (
    "add", "sub", "mul", "div", "pow", "constpow", "lt", "le", "eq", "ne", "and", "or", "fmod", "remainder", "copysign",
    "if_else_zero", "fmin", "fmax", "atan2", "hypot",
)  # fmt: skip
CODES = {name: int(getattr(ca, f"OP_{name.upper()}")) for name in (*ONE_ARGUMENT, *TWO_ARGUMENTS)}
NAMES = {code: name for name, code in CODES.items()}
ALL_OPERATION_NAMES = {int(getattr(ca, name)): name for name in dir(ca) if name.startswith("OP_")}

Entries = list[int | None]  # of a column of expressions: the numbers that they have, None where it is empty
Value = TypeVar("Value")


@dataclass(frozen=True)
class Program:
    """The operations of a function of scalars, without the numbers in it.

    Values are numbered: the entries of all arguments, then one an operation, which is its code with the numbers of its
    arguments; of CONST the next number is the result. `results` has the entries of each, None where its sparsity has
    none.
    """

    inputs: tuple[int, ...]
    operations: tuple[tuple[int, ...], ...]
    results: tuple[tuple[int | None, ...], ...]

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Taken once: operations are many."""
        return hash((self.inputs, self.operations, self.results))

    @cached_property
    def _last_uses(self) -> dict[int, int]:
        """The operation that uses a value last; of results none is."""
        uses = {place: k for k, (_, *places) in enumerate(self.operations) for place in places}
        for place in (entry for entries in self.results for entry in entries if entry is not None):
            uses[place] = len(self.operations)
        return uses

    def evaluated(
        self,
        argument: Callable[[int], Value],
        numbers: Iterable[Value],
        apply: Callable[[int, list[Value], bool], Value],
    ) -> list[list[Value | None]]:
        """The entries of the results in values of any kind.

        Arguments:
            argument: the value of an entry of an argument, asked for where it is used.
            numbers: values of the numbers.
            apply: the result of an operation of a code; last it is told whether nothing else holds the first value.
        """
        first, following, values = sum(self.inputs), iter(numbers), dict[int, Value]()

        def value(place: int) -> Value:
            if place < first and place not in values:
                values[place] = argument(place)
            return values[place]

        uses = self._last_uses
        for k, (code, *places) in enumerate(self.operations):
            if code == ca.OP_CONST:
                values[first + k] = next(following)
                continue
            is_free = places[0] >= first and uses[places[0]] == k and places[0] not in places[1:]
            values[first + k] = apply(code, [value(place) for place in places], is_free)
            for place in places:
                if uses[place] == k and place >= first:
                    values.pop(place, None)
        return [[None if entry is None else value(entry) for entry in entries] for entries in self.results]

    def expressions(self, inputs: Sequence[ca.SX], numbers: ca.SX) -> list[ca.SX]:
        """The results as columns of expressions in arguments, and in symbols that stand for the numbers."""
        symbols = ca.vertcat(*inputs).elements()
        found = self.evaluated(symbols.__getitem__, numbers.elements(), lambda code, values, _: operated(code, values))
        return [ca.vertcat(*(ca.SX(0) if entry is None else entry for entry in entries)) for entries in found]


def operated(code: int, values: Sequence[ca.SX]) -> ca.SX:
    """The expression of an operation of expressions."""
    return ca.SX.unary(code, values[0]) if len(values) == 1 else ca.SX.binary(code, values[0], values[1])


def read(function: ca.Function) -> tuple[Program, list[float]]:
    """The program of a function of the kind SXFunction, and its numbers."""
    first, work = [0], dict[int, int]()  # the value in each place of the function's own
    for i in range(function.n_in()):
        first.append(first[-1] + function.nnz_in(i))
    operations, numbers = list[tuple[int, ...]](), list[float]()
    filled = [function.sparsity_out(i).find() for i in range(function.n_out())]
    results: list[list[int | None]] = [[None] * function.numel_out(i) for i in range(function.n_out())]
    for k in range(function.n_instructions()):
        code, out = function.instruction_id(k), function.instruction_output(k)
        if code == ca.OP_CONST:
            numbers.append(function.instruction_constant(k))
            given = []
        else:
            given = function.instruction_input(k)
        if code == ca.OP_INPUT:
            work[out[0]] = first[given[0]] + given[1]
        elif code == ca.OP_OUTPUT:
            results[out[0]][filled[out[0]][out[1]]] = work[given[0]]
        else:
            operations.append((code, *(work[place] for place in given)))
            work[out[0]] = first[-1] + len(operations) - 1
    inputs = tuple(function.nnz_in(i) for i in range(function.n_in()))
    return Program(inputs, tuple(operations), tuple(map(tuple, results))), numbers


def to_operations(function: ca.Function) -> tuple[list[str], list[Entries]]:
    """The operations of a function whose arguments are dense columns, and the entries of its results.

    The numbers of all arguments come first. Raises ValueError where the function does something else, in words that
    follow "its equations".
    """
    expanded = _expanded(function)
    if expanded.n_instructions() > MOST_OPERATIONS:
        raise ValueError(f"have {expanded.n_instructions()} operations; accepted: up to {MOST_OPERATIONS}")
    program, numbers = read(expanded)
    count, following = sum(program.inputs), iter(numbers)
    operations, depths = list[str](), [0] * count
    for code, *places in program.operations:
        if code == ca.OP_CONST:
            operations.append(f"{CONSTANT} {next(following)!r}")
            depths.append(0)
        else:
            name = _named(code, function)
            places = places[: 1 if name in ONE_ARGUMENT else 2]
            operations.append(" ".join(map(str, (name, *places))))
            depths.append(1 + max(depths[place] for place in places))
    if max(depths, default=0) > MOST_DEPTH:
        raise ValueError(f"have {max(depths)} operations one upon the other; accepted: up to {MOST_DEPTH}")
    return operations, [list(entries) for entries in program.results]


def _expanded(function: ca.Function) -> ca.Function:
    """The function in scalar operations."""
    try:
        return function if function.is_a("SXFunction") else function.expand()
    except RuntimeError as error:
        raise ValueError(_other(function, in_words(error)[-100:])) from error


def _named(code: int, function: ca.Function) -> str:
    if code not in NAMES:
        raise ValueError(_other(function, ALL_OPERATION_NAMES[code]))
    return NAMES[code]


def _other(function: ca.Function, operation: str) -> str:
    inner = ", ".join(f.name() for f in function.find_functions())
    return f"are not made of elementary operations alone: {inner or operation}"


def from_operations(
    symbols: Sequence[ca.SX], operations: Sequence[str], results: Sequence[Sequence[int | None]]
) -> list[ca.SX]:
    """Columns of expressions in scalar symbols, as they were written, operation by operation.

    Raises ValueError, naming the first operation or entry that is none.
    """
    if len(operations) > MOST_OPERATIONS:
        raise ValueError(f"{len(operations)} operations; accepted: up to {MOST_OPERATIONS}")
    known, depths = list(symbols), [0] * len(symbols)
    with _as_written():
        for text in operations:
            name, value, places = _parsed(text, len(known))
            depths.append(1 + max((depths[place] for place in places), default=-1))
            if depths[-1] > MOST_DEPTH:
                raise ValueError(f"{depths[-1]} operations one upon the other; accepted: up to {MOST_DEPTH}")
            made = {0: ca.SX, 1: ca.SX.unary, 2: ca.SX.binary}[len(places)]
            ca.GlobalOptions.setSimplificationOnTheFly(name == "twice")  # else it would be a product with 2
            known.append(made(CODES[name], *(known[place] for place in places)) if places else made(value))
    for entry in (entry for entries in results for entry in entries):
        if entry is not None and not 0 <= entry < len(known):
            raise ValueError(f"entry {short_repr(entry)} of a result; accepted: 0 to {len(known) - 1}")
    empty = ca.SX(1, 1)
    return [ca.vertcat(*(empty if e is None else known[e] for e in entries)) for entries in results]


def _parsed(text: str, known: int) -> tuple[str, float, list[int]]:
    """Name, constant and arguments of an operation; raises ValueError unless it is written as it would be here."""
    name, *words = text.split(" ")
    try:
        if name == CONSTANT:
            value = float(words[0])
            if [repr(value)] == words:
                return name, value, []
        elif name in CODES:
            places = [int(word) for word in words]
            count = 1 if name in ONE_ARGUMENT else 2
            if [*map(str, places)] == words and len(words) == count and all(0 <= p < known for p in places):
                return name, 0.0, places
    except (ValueError, IndexError):  # words that are no numbers
        pass
    raise ValueError(f"operation {short_repr(text)}; accepted: a known one of earlier results, up to {known - 1}")


@contextmanager
def _as_written() -> Iterator[None]:
    """Without the simplifications that CasADi makes: a value that is read has the same round-off."""
    before = ca.GlobalOptions.getSimplificationOnTheFly()
    ca.GlobalOptions.setSimplificationOnTheFly(False)
    try:
        yield
    finally:
        ca.GlobalOptions.setSimplificationOnTheFly(before)
