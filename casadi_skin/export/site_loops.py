"""Scalar equations as C with loops over sites, where rows repeat with the indices of their numbers moved.

Every result is a list of rows, each a small expression of time, states and parameters. Rows that are the same but for
constants and for indices that go on by the same steps become one loop; constants that differ become a table. What
does not change in a loop is computed before it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from casadi_skin.export.codegen import Call, Part, Size, declared, filled

LONGEST_PERIOD = 12  # rows that repeat together, as those of the sites of one cell
LEAST_REPEATS = 5  # fewer are written one by one
MOST_STATEMENTS = 1500  # beyond, a compiler takes its time: CasADi's code is cut into parts
C_UNARY = {
    ca.OP_ASSIGN: "{0}", ca.OP_NEG: "-{0}", ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {0}", ca.OP_INV: "1.0 / {0}",
    ca.OP_NOT: "!({0} != 0.0)", ca.OP_SIGN: "(double)(({0} > 0.0) - ({0} < 0.0))",
} | {
    getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}})"
    for name in ("exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh",
                 "acosh", "atanh", "floor", "ceil", "fabs", "erf", "log1p", "expm1")
}  # fmt: skip
C_BINARY = {
    ca.OP_ADD: "{0} + {1}", ca.OP_SUB: "{0} - {1}", ca.OP_MUL: "{0} * {1}", ca.OP_DIV: "{0} / {1}",
    ca.OP_LT: "{0} < {1}", ca.OP_LE: "{0} <= {1}", ca.OP_EQ: "{0} == {1}", ca.OP_NE: "{0} != {1}",
    ca.OP_AND: "{0} != 0.0 && {1} != 0.0", ca.OP_OR: "{0} != 0.0 || {1} != 0.0",
    ca.OP_IF_ELSE_ZERO: "{0} != 0.0 ? {1} : 0.0", ca.OP_CONSTPOW: "pow({0}, {1})",
} | {
    getattr(ca, f"OP_{name.upper()}"): f"{name}({{0}}, {{1}})"
    for name in ("pow", "fmod", "copysign", "fmin", "fmax", "atan2", "hypot", "remainder")
}  # fmt: skip
Leaf = tuple[int, float]  # number of the argument and index in it; or CONSTANT_PLACE and the value
Step = tuple[int, tuple[int, ...]]  # an operation on earlier results, which are numbered after the leaves
CONSTANT_PLACE = -1


@dataclass(frozen=True)
class Row:
    """A scalar expression: leaves in the order in which they are met, then operations; the last one is its value."""

    leaves: tuple[Leaf, ...]
    steps: tuple[Step, ...]

    @cached_property
    def shape(self) -> tuple[object, ...]:
        """The common part of the rows of one loop: all but the indices and the constants."""
        return tuple(argument for argument, _ in self.leaves), self.steps


def called(title: str, call: Call, size: str, words: str, *more: Size) -> Part:
    """The part that is one function: with loops over sites where it can be, else one that CasADi generates."""
    text, functions, work = definition(call)
    sizes = (*more, Size(size, work, "doubles of work"))
    return Part(title, sizes, (declared(call.prototype, words),), (text,), functions)


def definition(call: Call) -> tuple[str, tuple[ca.Function, ...], int]:
    """The text of a C function, the functions that CasADi generates for it, and the doubles in its work array."""
    text = with_loops(call)
    return (call.text(), (call.function,), call.work) if text is None else (text, (), 1)


def with_loops(call: Call) -> str | None:
    """The function in C with loops, None where it is no scalar expression, or too long for a compiler."""
    results = None if not call.function.is_a("SXFunction") else _results(call.function)
    if results is None:
        return None
    lines, tables = [f"{call.prototype}\n{{"], list[str]()
    written = 0
    for name, rows in zip(call.results, results, strict=True):
        body: list[str] = []
        for segment in _segments(rows):
            prefix = f"{call.function.name()}_{len(tables)}"
            body += segment.text(name, call.arguments, prefix, tables)
            written += sum(len(row.steps) + 1 for row in segment.rows)
        if written > MOST_STATEMENTS:
            return None
        lines += body if len(call.results) == 1 else [f"    if ({name}) {{", *(f"    {line}" for line in body), "    }"]
    used = {index for rows in results for row in rows for index, _ in row.leaves if index != CONSTANT_PLACE}
    idle = sorted(set(range(len(call.arguments))) - used)
    unused = [f"    (void){call.arguments[i].lstrip('&')};" for i in idle if call.arguments[i] != "0"]
    return "\n".join([*tables, *lines[:1], *unused, "    (void)work;", *lines[1:], "    return 0;\n}"])


# Expressions ----------------------------------------------------------------------------------------------------------


def _results(function: ca.Function) -> list[list[Row]] | None:
    """The rows of every result; None where an operation has no C here."""
    nodes: list[tuple[object, ...]] = []  # ("leaf", argument, index or value) or (operation, arguments)
    known: dict[tuple[object, ...], int] = {}
    work: dict[int, int] = {}
    places = [[-1] * function.nnz_out(i) for i in range(function.n_out())]

    def node(content: tuple[object, ...]) -> int:
        if content not in known:
            known[content] = len(nodes)
            nodes.append(content)
        return known[content]

    for k in range(function.n_instructions()):
        operation, given, to = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_INPUT:
            work[to[0]] = node(("leaf", given[0], given[1]))
        elif operation == ca.OP_CONST:
            work[to[0]] = node(("leaf", CONSTANT_PLACE, function.instruction_constant(k)))
        elif operation == ca.OP_OUTPUT:
            places[to[0]][to[1]] = work[given[0]]
        elif operation in C_UNARY:
            work[to[0]] = node((operation, work[given[0]]))
        elif operation in C_BINARY:
            work[to[0]] = node((operation, work[given[0]], work[given[1]]))
        else:
            return None
    return [[_row(nodes, place) for place in entries] for entries in places]


def _row(nodes: Sequence[tuple[object, ...]], root: int) -> Row:
    """Operations and leaves of one result, in the order of a walk from its root."""
    if root < 0:
        return Row(((CONSTANT_PLACE, 0.0),), ())
    order: list[int] = []
    seen, stack = set[int](), [(root, False)]
    while stack:
        at, done = stack.pop()
        if done:
            order.append(at)
        elif at not in seen:
            seen.add(at)
            stack.append((at, True))
            if nodes[at][0] != "leaf":
                stack += [(int(child), False) for child in reversed(nodes[at][1:])]  # type: ignore[call-overload]
    leaves = [at for at in order if nodes[at][0] == "leaf"]
    places = {at: k for k, at in enumerate([*leaves, *(at for at in order if nodes[at][0] != "leaf")])}
    steps = tuple(
        (int(nodes[at][0]), tuple(places[int(child)] for child in nodes[at][1:]))  # type: ignore[call-overload]
        for at in order if nodes[at][0] != "leaf"
    )  # fmt: skip
    return Row(tuple((int(nodes[at][1]), nodes[at][2]) for at in leaves), steps)  # type: ignore[call-overload, misc]


# Loops ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Segment:
    """Rows `first` on that repeat: `rows` are those of the first time, `indices` what the leaves are each time.

    An index is (first, step) of an argument's entries; of constants it is the list of values.
    """

    first: int
    repeats: int
    rows: tuple[Row, ...]
    values: tuple[tuple[tuple[float, ...], ...], ...]  # of each row, of each leaf, each time

    def text(self, result: str, arguments: Sequence[str], prefix: str, tables: list[str]) -> list[str]:
        """Lines of C, with tables of the constants that change."""
        before, inside, stores = list[str](), list[str](), list[str]()
        for j, (row, values) in enumerate(zip(self.rows, self.values, strict=True)):
            names, fixed = list[str](), list[bool]()
            for (argument, _), each in zip(row.leaves, values, strict=True):
                word, constant = self._leaf(argument, each, arguments, prefix, tables)
                if constant and "[" in word and self.repeats > 1:  # for the compiler, a result might change it
                    before.append(f"const double h{j}_{len(names)}_ = {word};")
                    word = f"h{j}_{len(names)}_"
                names.append(word)
                fixed.append(constant)
            for k, (operation, of) in enumerate(row.steps):
                form = (C_UNARY | C_BINARY)[operation].format(*(names[i] for i in of))
                constant = self.repeats > 1 and all(fixed[i] for i in of)
                name = f"{'h' if constant else 'v'}{j}_{k}"
                (before if constant else inside).append(f"const double {name} = {form};")
                names.append(name)
                fixed.append(constant)
            place = self.first + j
            where = f"{len(self.rows)} * i + {place}" if len(self.rows) > 1 else f"i + {place}" if place else "i"
            stores.append(f"{result}[{where if self.repeats > 1 else place}] = {names[-1]};")
        if self.repeats == 1 and not inside:
            return [f"    {line}" for line in stores]
        if self.repeats == 1:
            return ["    {", *(f"        {line}" for line in (*inside, *stores)), "    }"]
        loop = [f"for (i = 0; i < {self.repeats}; i++) {{", *(f"    {line}" for line in (*inside, *stores)), "}"]
        return ["    {", *(f"        {line}" for line in (*before, "int i;", *loop)), "    }"]

    def _leaf(
        self, argument: int, values: tuple[float, ...], arguments: Sequence[str], prefix: str, tables: list[str]
    ) -> tuple[str, bool]:
        """A number in C, and whether it is the same each time."""
        if argument == CONSTANT_PLACE:
            if all(value == values[0] for value in values):
                return _number(values[0]), True
            name = f"{prefix}_c{len(tables)}"
            tables.append(f"static const double {name}[{len(values)}] = {{\n{filled(map(_number, values))}}};\n")
            return f"{name}[i]", False
        array = arguments[argument]
        if array == "0":
            return "0.0", True
        if array.startswith("&"):
            return array[1:], True
        first = int(values[0])
        step = int(values[1]) - first if self.repeats > 1 else 0
        if step == 0:
            return f"{array}[{first}]", True
        factor = "i" if step == 1 else f"{step} * i"
        return f"{array}[{factor} + {first}]" if first else f"{array}[{factor}]", False


def _segments(rows: Sequence[Row]) -> Iterator[Segment]:
    """The rows in order, as loops where they repeat."""
    at = 0
    while at < len(rows):
        best = 1, 1
        for period in range(1, LONGEST_PERIOD + 1):
            repeats = _repeats(rows, at, period)
            if repeats >= LEAST_REPEATS and repeats * period > best[0] * best[1]:
                best = period, repeats
        period, repeats = best
        shown = tuple(rows[at : at + period])
        values = tuple(
            tuple(tuple(rows[at + j + k * period].leaves[i][1] for k in range(repeats)) for i in range(len(row.leaves)))
            for j, row in enumerate(shown)
        )
        yield Segment(at, repeats, shown, values)
        at += period * repeats


def _repeats(rows: Sequence[Row], at: int, period: int) -> int:
    """How often the rows from a place on repeat with this period, indices going on by the same steps."""
    count = 1
    while at + (count + 1) * period <= len(rows) and all(
        _goes_on([rows[at + k * period + j] for k in sorted({0, 1, count - 1, count})]) for j in range(period)
    ):
        count += 1
    return count


def _goes_on(rows: list[Row]) -> bool:
    """Whether the last of rows number 0, 1, ..., k - 1 and k goes on as the others."""
    first, last = rows[0], rows[-1]
    if first.shape != last.shape:
        return False
    if len(rows) == 2:
        return True
    second, before = rows[1], rows[-2]
    return all(
        a[0] == CONSTANT_PLACE or d[1] - c[1] == b[1] - a[1]
        for a, b, c, d in zip(first.leaves, second.leaves, before.leaves, last.leaves, strict=True)
    )


def _number(value: float) -> str:
    text = repr(float(value))
    return {"inf": "HUGE_VAL", "-inf": "-HUGE_VAL", "nan": "NAN"}.get(text, f"({text})" if value < 0 else text)
