"""Scalar equations as C with loops over sites, where rows repeat with the indices of their numbers moved.

Every result is a list of rows, r[i] = f(t, x, p), each a small expression. Rows that are the same but for constants and
for indices that go on by the same strides become one loop; constants that differ become a table. Rows and loops are
joined in the same way: a line of cells of a plane, its inner cells and those at its ends, repeats from line to line. An
index in loops i, j, k is first + a i + b j + c k. What does not change in a loop is computed before it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from typing import TypeAlias

import casadi as ca

from casadi_skin.export.codegen import DECLARATIONS, Call, Part, Size, filled

LONGEST_PERIOD = 80  # rows or loops that repeat together, as those of the sites of one cell
LOOP_VARIABLES = "ijklmno"  # from the outermost loop inwards; more than seven need LEAST_REPEATS**8 rows
LEAST_REPEATS = 5  # fewer are written one by one
MOST_STATEMENTS = 1500  # beyond, a compiler takes its time: CasADi's code is cut into parts,
MOST_STATEMENTS_IN_LOOPS, LOOPS_SHORTEN = 10000, 10  # but for these, where loops have as many times fewer
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
Numbers: TypeAlias = tuple[float, ...]
Leaf = tuple[int, Numbers]  # an argument and the index in it; CONSTANT and its values in the order of the loops around
Step = tuple[int, tuple[int, ...]]  # an operation on earlier results, which are numbered after the leaves
CONSTANT, RESULT = -1, -2


@dataclass(frozen=True)
class Row:
    """A scalar expression: the place of the result, leaves in the order in which they are met, then operations.

    The last operation gives its value. Rows that are `exact` are only joined with those of the same constants.
    """

    leaves: tuple[Leaf, ...]
    steps: tuple[Step, ...]
    exact: bool = False

    @cached_property
    def shape(self) -> tuple[object, ...]:
        """The common part of the rows of one loop: all but the indices, and the constants unless they are exact."""
        return tuple(leaf if self.exact and leaf[0] == CONSTANT else leaf[0] for leaf in self.leaves), self.steps

    @property
    def cost(self) -> int:
        """Statements."""
        return len(self.steps) + 1


@dataclass(frozen=True)
class Loop:
    """Rows and loops that repeat: `leaves` are those of all of them the first time, `strides` go to the next time."""

    repeats: int
    body: tuple[Row | Loop, ...]
    leaves: tuple[Leaf, ...]
    strides: tuple[int, ...]

    @cached_property
    def shape(self) -> tuple[object, ...]:
        """The common part of the loops of one loop."""
        return self.repeats, self.strides, tuple(item.shape for item in self.body)

    @property
    def cost(self) -> int:
        """Statements."""
        return sum(item.cost for item in self.body)


def called(title: str, call: Call, size: str, *more: Size) -> Part:
    """The part that is one function: with loops over sites where it can be, else one that CasADi generates."""
    text, functions, work = definition(call)
    sizes = (*more, Size(size, work, "doubles of work"))
    return Part(title, sizes, (DECLARATIONS[call.name],), (text,), functions)


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
    nests = [_nest(rows) for rows in results]
    statements, apart = (sum(item.cost for rows in every for item in rows) for every in (nests, results))
    if statements > min(MOST_STATEMENTS_IN_LOOPS, max(MOST_STATEMENTS, apart // LOOPS_SHORTEN)):
        return None
    writer = Writer(call.arguments, call.function.name(), tables)
    for name, nest in zip(call.results, nests, strict=True):
        body = writer.text(name, nest)
        lines += body if len(call.results) == 1 else [f"    if ({name}) {{", *(f"    {line}" for line in body), "    }"]
    used = {index for rows in results for row in rows for index, _ in row.leaves}
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
            work[to[0]] = node(("leaf", CONSTANT, function.instruction_constant(k)))
        elif operation == ca.OP_OUTPUT:
            places[to[0]][to[1]] = work[given[0]]
        elif operation in C_UNARY:
            work[to[0]] = node((operation, work[given[0]]))
        elif operation in C_BINARY:
            work[to[0]] = node((operation, work[given[0]], work[given[1]]))
        else:
            return None
    return [[_row(nodes, root, place) for place, root in enumerate(entries)] for entries in places]


def _row(nodes: Sequence[tuple[object, ...]], root: int, place: int) -> Row:
    """Operations and leaves of one result, in the order of a walk from its root."""
    if root < 0:
        return Row(((RESULT, (place,)), (CONSTANT, (0.0,))), ())
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
    met = ((int(nodes[at][1]), (nodes[at][2],)) for at in leaves)  # type: ignore[call-overload]
    return Row(((RESULT, (place,)), *met), steps)  # type: ignore[arg-type]


# Loops ----------------------------------------------------------------------------------------------------------------


def _nest(rows: Sequence[Row]) -> list[Row | Loop]:
    """The rows in order as loops, in loops: with constants that differ in tables, or apart where that is shorter."""
    found = []
    for exact in (False, True):
        items: list[Row | Loop] = [replace(row, exact=exact) for row in rows]
        before = len(items) + 1
        while len(items) < before:  # lines of a plane are joined when they are loops
            before = len(items)
            for period in range(1, LONGEST_PERIOD + 1):
                items = list(_joined(items, period))
        entries = sum(len(values) for item in items for _, values in item.leaves if len(set(values)) > 1)
        found.append((sum(item.cost for item in items) + entries, items))
    return min(found, key=lambda choice: choice[0])[1]


def _joined(items: Sequence[Row | Loop], period: int) -> Iterator[Row | Loop]:
    """The items in order, as loops where so many of them repeat.

    Copies are taken two at a time: of one at a time gcc makes `rep movs`, which takes longer to begin than to copy.
    """
    known: dict[object, int] = {}
    shapes = [known.setdefault(item.shape, len(known)) for item in items]
    at = 0
    while at < len(items):
        repeats = 1 if period == 1 and items[at].cost == 1 else _repeats(items, shapes, at, period)
        taken = period * repeats if repeats >= LEAST_REPEATS else 1
        yield items[at] if taken == 1 else _loop(items[at : at + taken], repeats)
        at += taken


def _repeats(items: Sequence[Row | Loop], shapes: Sequence[int], at: int, period: int) -> int:
    """How often the items from a place on repeat with this period, indices going on by the same strides."""
    count = 1
    while shapes[at : at + period] == shapes[(to := at + count * period) : to + period] and all(
        count == 1 or _goes_on([items[at + k * period + j] for k in (0, 1, count - 1, count)]) for j in range(period)
    ):
        count += 1
    return count


def _goes_on(items: Sequence[Row | Loop]) -> bool:
    """Whether of items of one shape the last follows the one before it as the second follows the first."""
    return all(
        a[0] == CONSTANT or d[1][0] - c[1][0] == b[1][0] - a[1][0]
        for a, b, c, d in zip(*(item.leaves for item in items), strict=True)
    )


def _loop(items: Sequence[Row | Loop], repeats: int) -> Loop:
    period = len(items) // repeats
    times = [[leaf for item in items[k * period : (k + 1) * period] for leaf in item.leaves] for k in range(repeats)]
    leaves, strides = list[Leaf](), list[int]()
    for argument, first, *rest in ((each[0][0], *(values for _, values in each)) for each in zip(*times, strict=True)):
        constant = argument == CONSTANT
        leaves.append((argument, sum(rest, first) if constant else first))
        strides.append(0 if constant else int(rest[0][0] - first[0]))
    return Loop(repeats, tuple(items[:period]), tuple(leaves), tuple(strides))


class Writer:
    """Rows and loops as lines of C, with tables of the constants that change; names are unique in a function."""

    def __init__(self, arguments: Sequence[str], prefix: str, tables: list[str]) -> None:
        self.arguments, self.prefix, self.tables = arguments, prefix, tables
        self.rows, self.before = 0, list[str]()

    def text(self, result: str, items: Sequence[Row | Loop]) -> list[str]:
        """The lines that compute one result."""
        lines = list[str]()
        for item in items:
            self.before = []  # what does not change in the loop
            body = self._lines(result, item, item.leaves, [()] * len(item.leaves), ())
            lines += [f"    {line}" for line in (*self.before, *body)]
        return lines

    def _lines(
        self, result: str, item: Row | Loop, leaves: Sequence[Leaf], strides: Sequence[tuple[int, ...]],
        around: tuple[int, ...],
    ) -> list[str]:  # fmt: skip
        """An item in loops with so many repeats each; its leaves with the strides of each of them."""
        if isinstance(item, Row):
            words = [self._word(result, leaf, each, around) for leaf, each in zip(leaves, strides, strict=True)]
            return self._row(item, words, around)
        inside, at, i = list[str](), 0, LOOP_VARIABLES[len(around)]
        within = [(*each, stride) for each, stride in zip(strides, item.strides, strict=True)]
        for part in item.body:
            to = at + len(part.leaves)
            inside += self._lines(result, part, leaves[at:to], within[at:to], (*around, item.repeats))
            at = to
        return [f"for (int {i} = 0; {i} < {item.repeats}; {i}++) {{", *(f"    {line}" for line in inside), "}"]

    def _row(self, row: Row, words: Sequence[tuple[str, bool]], around: tuple[int, ...]) -> list[str]:
        """Statements of a row from its leaves in C, each with whether it is the same each time."""
        (place, _), *known = words
        lines, number = list[str](), self.rows
        self.rows += 1
        for k, (operation, of) in enumerate(row.steps):
            form = (C_UNARY | C_BINARY)[operation].format(*(known[i][0] for i in of))
            constant = bool(around) and all(known[i][1] for i in of)
            name = f"{'h' if constant else 'v'}{number}_{k}"
            (self.before if constant else lines).append(f"const double {name} = {form};")
            known.append((name, constant))
        return [*lines, f"{place} = {known[-1][0]};"]

    def _word(self, result: str, leaf: Leaf, strides: tuple[int, ...], around: tuple[int, ...]) -> tuple[str, bool]:
        """A number in C, and whether it is the same each time."""
        argument, values = leaf
        if argument == CONSTANT and len(set(map(repr, values))) == 1:
            return _number(values[0]), True
        if argument == CONSTANT:
            name = f"{self.prefix}_c{len(self.tables)}"
            self.tables.append(f"static const double {name}[{len(values)}] = {{\n{filled(map(_number, values))}}};\n")
            inner = list(accumulate(around[:0:-1], lambda a, b: a * b, initial=1))
            return f"{name}[{_index(0, inner[::-1])}]", False
        array = result if argument == RESULT else self.arguments[argument]
        if array == "0":
            return "0.0", True
        if array.startswith("&"):
            return array[1:], True
        return f"{array}[{_index(int(values[0]), strides)}]", not any(strides)


def _index(first: int, strides: Sequence[int]) -> str:
    pairs = zip(strides, LOOP_VARIABLES, strict=False)
    terms = [i if stride == 1 else f"{stride} * {i}" for stride, i in pairs if stride]
    return " + ".join([*terms, *([str(first)] if first or not terms else [])])


def _number(value: float) -> str:
    text = repr(float(value))
    return {"inf": "HUGE_VAL", "-inf": "-HUGE_VAL", "nan": "NAN"}.get(text, f"({text})" if value < 0 else text)
