"""Expressions as data: a list of elementary operations on numbers, symbols and earlier results, as text.

Symbols are numbered from 0 and each operation adds one number: "mul 3 5" is the product of numbers 3 and 5,
"const 0.5" a number. Nothing else can be written or read, so that reading them runs no code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import casadi as ca

from casadi_skin.model.arguments import short_repr

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


def interpret(
    function: ca.Function,
    argument: Callable[[int, int], Value],
    constant: Callable[[float], Value],
    apply: Callable[[int, list[Value], bool], Value],
) -> list[list[Value | None]]:
    """A function of scalar operations evaluated in values of any kind.

    Arguments:
        function: of the kind SXFunction.
        argument: the value of an entry of an argument, by the numbers of both.
        constant: that of a number.
        apply: the result of an operation of a code; its last argument is whether nothing else holds the first value.

    Returns:
        The entries of each result, None where its sparsity has none.
    """
    work: dict[int, Value] = {}
    put_out = set[int]()  # places of values that are results
    filled = [function.sparsity_out(i).find() for i in range(function.n_out())]
    results: list[list[Value | None]] = [[None] * function.numel_out(i) for i in range(function.n_out())]
    for k in range(function.n_instructions()):
        code, given, out = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if code == ca.OP_OUTPUT:
            results[out[0]][filled[out[0]][out[1]]] = work[given[0]]
            put_out.add(given[0])
            continue
        if code == ca.OP_INPUT:
            work[out[0]] = argument(given[0], given[1])
        elif code == ca.OP_CONST:
            work[out[0]] = constant(function.instruction_constant(k))
        else:
            is_free = out[0] == given[0] and given[0] not in put_out
            work[out[0]] = apply(code, [work[place] for place in given], is_free)
        put_out.discard(out[0])
    return results


def to_operations(function: ca.Function) -> tuple[list[str], list[Entries]]:
    """The operations of a function whose arguments are dense columns, and the entries of its results.

    The numbers of all arguments come first. Raises ValueError where the function does something else, in words that
    follow "its equations".
    """
    expanded = _expanded(function)
    if expanded.n_instructions() > MOST_OPERATIONS:
        raise ValueError(f"have {expanded.n_instructions()} operations; accepted: up to {MOST_OPERATIONS}")
    first = [0]
    for i in range(expanded.n_in()):
        first.append(first[-1] + expanded.numel_in(i))
    operations, depths = list[str](), [0] * first[-1]

    def add(depth: int, *words: object) -> int:
        operations.append(" ".join(map(str, words)))
        depths.append(depth)
        return len(depths) - 1

    def apply(code: int, places: list[int], _: bool) -> int:
        name = _named(code, function)
        places = places[: 1 if name in ONE_ARGUMENT else 2]
        return add(1 + max(depths[place] for place in places), name, *places)

    results = interpret(expanded, lambda i, entry: first[i] + entry, lambda value: add(0, CONSTANT, repr(value)), apply)
    if max(depths, default=0) > MOST_DEPTH:
        raise ValueError(f"have {max(depths)} operations one upon the other; accepted: up to {MOST_DEPTH}")
    return operations, results


def _expanded(function: ca.Function) -> ca.Function:
    """The function in scalar operations."""
    try:
        return function if function.is_a("SXFunction") else function.expand()
    except RuntimeError as error:
        raise ValueError(_other(function, " ".join(str(error).split())[-100:])) from error


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
