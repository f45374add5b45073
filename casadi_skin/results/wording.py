"""Words for results: their title and rows of a name and a value, which modules register by class."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import singledispatch
from typing import Any

from casadi_skin.follow.unresolved import count_in_words

MOST = 6  # special points, parameters or states that are named
Rows = list[tuple[str, str]]


@singledispatch
def words(result: Any) -> tuple[str, Rows]:
    """Title of a result, and its rows; raises TypeError for other objects."""
    raise TypeError(f"no result: {type(result).__name__}")


def model_name(model: Any) -> str:
    """A model in a few words."""
    return str(model.name) if hasattr(model, "name") else repr(model)


def with_error(value: float, error: float) -> str:
    """A number with its error."""
    return f"{value:.12g} +- {error:.1e}"


def parameter_rows(values: Mapping[str, float]) -> Rows:
    """The row of parameters; none where there are none."""
    shown = {name: value for name, value in values.items() if name != "period"}
    return [("parameters", named(shown))] if shown else []


def named(values: Mapping[str, float]) -> str:
    """Values by name, the first of many."""
    return listed([f"{name} = {value:.8g}" for name, value in values.items()])


def found(entries: Sequence[str], unresolved: Collection[object]) -> str:
    """What is found on a branch, one after the other: with its count as the least where something is unresolved."""
    if not unresolved:
        return listed(entries)
    return f"{count_in_words(len(entries), unresolved)}: {listed(entries)}" if entries else "none found; see unresolved"


def listed(items: Any) -> str:
    """Items, the first of many, and how many there are."""
    texts = [str(item) for item in items]
    more = f", ... ({len(texts)} in all)" if len(texts) > MOST else ""
    return (", ".join(texts[:MOST]) + more) or "none"


def complex_words(value: complex) -> str:
    """A complex number in six digits."""
    return f"{value.real:.6g}" if value.imag == 0 else f"{value.real:.6g}{value.imag:+.6g}i"
