"""A result as it is shown: its lines of words, its table, and how it is drawn; and the words of numbers.

`show` finds by the class of a result the one function that shows it, in `solutions` or in `analyses`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch
from typing import Any

import numpy as np

from casadi_skin.zero.kinds import count_in_words

MOST_NAMED = 6  # special points, parameters or states that are named
Rows = list[tuple[str, str]]
Columns = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Shown:
    """A result as it is shown.

    Attributes:
        title, rows: its lines, each value in words.
        draw: draws it into axes, with options, and returns the number of columns of the legend, None of one.
        meaning: of its table; empty of branches, whose table is that of their quantities, and of diagrams.
        columns: makes the table, along its first column.
    """

    title: str
    rows: Rows
    draw: Callable[..., int | None]
    meaning: str = ""
    columns: Callable[[], Columns] = dict


@singledispatch
def show(result: Any) -> Shown:
    """A result as it is shown; raises TypeError for other objects."""
    raise TypeError(f"no result: {type(result).__name__}")


def model_words(model: Any) -> str:
    """A model in a few words."""
    return str(getattr(model, "name", repr(model)))


def listed(items: Any) -> str:
    """Items, the first of many, and how many there are."""
    texts = [str(item) for item in items]
    more = f", ... ({len(texts)} in all)" if len(texts) > MOST_NAMED else ""
    return (", ".join(texts[:MOST_NAMED]) + more) or "none"


def named(values: Mapping[str, float]) -> str:
    """Values by name, the first of many."""
    return listed([f"{name} = {value:.8g}" for name, value in values.items()])


def parameters(values: Mapping[str, float], without: str = "period") -> Rows:
    """The row of parameters; none where there are none."""
    shown = {name: value for name, value in values.items() if name not in ("period", without)}
    return [("parameters", named(shown))] if shown else []


def found(entries: Sequence[str], unresolved: Collection[object]) -> str:
    """What is found on a branch, one after the other: with its count as the least where something is unresolved."""
    if not unresolved:
        return listed(entries)
    return f"{count_in_words(len(entries), unresolved)}: {listed(entries)}" if entries else "none found; see unresolved"


def complex_numbers(values: Iterable[complex]) -> str:
    """Complex numbers in six digits."""
    return listed([f"{v.real:.6g}" if v.imag == 0 else f"{v.real:.6g}{v.imag:+.6g}i" for v in values])


def range_of(values: Any, digits: int = 8) -> str:
    """Smallest and largest value."""
    return f"{np.min(values):.{digits}g} to {np.max(values):.{digits}g}"


def ranges(pairs: Iterable[tuple[float, float]]) -> str:
    """Pairs of ends."""
    return listed([f"{a:.6g} to {b:.6g}" for a, b in pairs])


def course(values: Any) -> str:
    """First and last value, and all between which a branch has."""
    return f"{values[0]:.8g} to {values[-1]:.8g}, within {range_of(values)}"


def samples(t: Any) -> tuple[str, str]:
    return "times", f"{t.size}, from {t[0]:g} to {t[-1]:g}"


def special_points(points: Iterable[Any]) -> str:
    return listed([f"{p.kind} at {p.parameters[p.parameter]:.8g}" for p in points])


def changes(changes: Iterable[Any]) -> list[str]:
    return [f"{change.kind} at {change.S:.8g}" for change in changes]


def stretches(unresolved: Iterable[Any]) -> tuple[str, str]:
    return "unresolved", ranges((u.S_start, u.S_end) for u in unresolved)
