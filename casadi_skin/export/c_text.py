"""Pieces of C text: arrays, strings, comments, and calls of generated functions behind plain prototypes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from textwrap import wrap

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

WIDTH = 120
BY_COLUMNS, BY_ROWS = ("colptr", "row"), ("rowptr", "column")


def plain(words: str) -> str:
    """Words of a user that may stand in a comment or a string of C: printable ASCII that ends neither."""
    shown = "".join(char if " " <= char <= "~" else "?" for char in words)
    return shown.replace("\\", "/").replace("*/", "* /").replace("/*", "/ *").replace("??", "? ?").replace("@", "(at)")


def string(words: str) -> str:
    """A C string."""
    return '"' + plain(words).replace('"', '\\"') + '"'


def comment(words: str) -> str:
    """A block comment, wrapped; `words` are our own but for what went through `plain`."""
    lines = wrap(words, WIDTH - 6)
    return "/* " + "\n * ".join(lines) + " */"


def _filled(values: Iterable[str]) -> str:
    return "\n".join(wrap(", ".join(values), WIDTH, initial_indent="    ", subsequent_indent="    ",
                          break_long_words=False, break_on_hyphens=False))  # fmt: skip


def doubles(name: str, values: ArrayLike) -> str:
    """Definition of an array of doubles with 17 significant digits; raises ValueError for one that is not finite."""
    array = np.asarray(values, dtype=float).ravel()
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name}: holds a number that is not finite; accepted: finite numbers")
    entries = [f"{value:.17g}" for value in array.tolist()] or ["0.0"]
    return f"const double {name}[{len(entries)}] = {{\n{_filled(entries)}}};"


def integers(name: str, values: Sequence[int]) -> str:
    """Definition of an array of ints."""
    entries = [str(value) for value in values] or ["0"]
    return f"const int {name}[{len(entries)}] = {{\n{_filled(entries)}}};"


def strings(name: str, values: Sequence[str]) -> str:
    """Definition of an array of strings."""
    entries = [string(value) for value in values] or ['""']
    body = "".join(f"    {entry},\n" for entry in entries)
    return f"const char *const {name}[{len(entries)}] = {{\n{body}}};"


def pattern(name: str, sparsity: ca.Sparsity, names: tuple[str, str] = BY_COLUMNS) -> str:
    """Definitions of the pattern of a sparse matrix by columns (or of its transpose by rows), counted from 0."""
    starts, places = names
    return f"{integers(f'{name}_{starts}', sparsity.colind())}\n\n{integers(f'{name}_{places}', sparsity.row())}"


@dataclass(frozen=True)
class Call:
    """A plain C function around a generated one: its prototype, and what goes to the arguments and results."""

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
