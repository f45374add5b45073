"""Pieces of C text: arrays, strings, comments, plain functions around generated ones, and the parts of an export."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from textwrap import wrap

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

WIDTH = 120
MOST_ENTRIES = 2**31 - 1  # sizes and indices are ints of C
BY_COLUMNS, BY_ROWS = ("colptr", "row"), ("rowptr", "column")


def plain(words: str) -> str:
    """Words of a user that may stand in a comment or a string of C: printable ASCII that ends neither.

    Other characters are written as their numbers, as (U+03B1), so that names stay different.
    """
    shown = "".join(char if " " <= char <= "~" else f"(U+{ord(char):04X})" for char in words)
    return shown.replace("\\", "/").replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").replace("@", "(at)")


def string(words: str) -> str:
    """A C string: the words in UTF-8, in octal where they are not ASCII."""
    inside = words.replace("\\", "/").replace('"', '\\"').replace("??", "? ?").replace("@", "\\100")
    return '"' + "".join(c if " " <= c <= "~" else "".join(f"\\{b:03o}" for b in c.encode()) for c in inside) + '"'


def comment(words: str) -> str:
    """A block comment, wrapped; `words` are our own but for what went through `plain`."""
    lines = wrap(words, WIDTH - 6)
    return "/* " + "\n * ".join(lines) + " */"


def filled(values: Iterable[str]) -> str:
    """Words in lines, with commas between."""
    return "\n".join(wrap(", ".join(values), WIDTH, initial_indent="    ", subsequent_indent="    ",
                          break_long_words=False, break_on_hyphens=False))  # fmt: skip


def doubles(name: str, values: ArrayLike) -> str:
    """Definition of an array of doubles with 17 significant digits; raises ValueError for one that is not finite."""
    array = np.asarray(values, dtype=float).ravel()
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name}: holds a number that is not finite; accepted: finite numbers")
    entries = [f"{value:.17g}" for value in array.tolist()] or ["0.0"]
    return f"const double {name}[{len(entries)}] = {{\n{filled(entries)}}};"


def integers(name: str, values: Sequence[int]) -> str:
    """Definition of an array of ints."""
    entries = [str(value) for value in values] or ["0"]
    return f"const int {name}[{len(entries)}] = {{\n{filled(entries)}}};"


def strings(name: str, values: Sequence[str]) -> str:
    """Definition of an array of strings."""
    entries = [string(value) for value in values] or ['""']
    lines, line = list[str](), "   "
    for entry in entries:  # strings are not cut
        if len(line) + len(entry) + 2 > WIDTH and line.strip():
            lines, line = [*lines, line], "   "
        line += f" {entry},"
    body = "\n".join([*lines, line])
    return f"const char *const {name}[{len(entries)}] = {{\n{body}\n}};"


def pattern(name: str, sparsity: ca.Sparsity, names: tuple[str, str] = BY_COLUMNS) -> tuple[str, str]:
    """Definitions and declarations of the pattern of a sparse matrix by columns (of its transpose by rows), from 0."""
    indices = dict(zip(names, (sparsity.colind(), sparsity.row()), strict=True))
    definitions = "\n\n".join(integers(f"{name}_{kind}", values) for kind, values in indices.items())
    lengths = {kind: max(1, len(values)) for kind, values in indices.items()}
    return definitions, "\n".join(f"extern const int {name}_{kind}[{length}];" for kind, length in lengths.items())


@dataclass(frozen=True)
class Call:
    """A plain C function around a generated one: its prototype, and its own arguments and results."""

    prototype: str
    function: ca.Function
    arguments: tuple[str, ...]
    results: tuple[str, ...]

    @property
    def work(self) -> int:
        """Doubles that its work array needs."""
        return max(1, int(self.function.sz_w()))

    def text(self) -> str:
        """Its definition."""
        f = self.function
        lines = [
            f"{self.prototype}\n{{",
            f"    const double *arg[{max(1, f.sz_arg())}];",
            f"    double *res[{max(1, f.sz_res())}];",
            f"    long long int iw[{max(1, f.sz_iw())}];\n",
            *(f"    arg[{i}] = {given};" for i, given in enumerate(self.arguments)),
            *(f"    res[{i}] = {wanted};" for i, wanted in enumerate(self.results)),
            f"    return {f.name()}(arg, res, iw, work, 0);\n}}",
        ]
        return "\n".join(lines)


@dataclass(frozen=True)
class Size:
    """A constant of the header: NAME_`suffix`, and its meaning in words."""

    suffix: str
    value: int
    words: str


@dataclass(frozen=True)
class Part:
    """A part of an export: constants, declarations, definitions, generated functions and names of C files.

    In texts `@p` stands for the prefix of functions and arrays, `@P` for that of constants.
    """

    title: str
    sizes: tuple[Size, ...] = ()
    declarations: tuple[str, ...] = ()
    definitions: tuple[str, ...] = ()
    functions: tuple[ca.Function, ...] = ()
    files: tuple[str, ...] = ()

    def plus(
        self,
        definition: str = "",
        declaration: str = "",
        sizes: tuple[Size, ...] = (),
        functions: tuple[ca.Function, ...] = (),
        files: tuple[str, ...] = (),
    ) -> Part:
        """The part with more: a definition, a declaration, entries of its other fields."""
        declarations = (*self.declarations, *([declaration] if declaration else []))
        definitions = (*self.definitions, *([definition] if definition else []))
        rest = ((*self.functions, *functions), (*self.files, *files))
        return Part(self.title, (*self.sizes, *sizes), declarations, definitions, *rest)


def declared(prototype: str, words: str) -> str:
    """A declaration with its comment."""
    return f"{comment(words)}\n{prototype};"


def constants(prefix: str, values: Mapping[str, tuple[float, str]]) -> tuple[str, str]:
    """Definitions and declarations of doubles by name, each with its meaning."""
    definitions = "\n".join(f"const double {prefix}_{name} = {value:.17g};" for name, (value, _) in values.items())
    declarations = (f"extern const double {prefix}_{name}; {comment(words)}" for name, (_, words) in values.items())
    return definitions, "\n".join(declarations)


def arrays(prefix: str, values: Mapping[str, ArrayLike], words: str) -> tuple[str, str]:
    """Definitions and declarations of arrays of doubles by name, with one comment."""
    definitions = "\n\n".join(doubles(f"{prefix}_{name}", array) for name, array in values.items())
    declarations = [f"extern const double {prefix}_{name}[{max(1, np.size(array))}];" for name, array in values.items()]
    return definitions, "\n".join([comment(words), *declarations])
