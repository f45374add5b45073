"""Checks of what a caller gives from Python: each refusal names the argument, what was given and what is accepted."""

from __future__ import annotations

import math
from collections.abc import Iterable
from numbers import Real
from typing import cast

SHOWN = 60  # characters of a given value that a message shows


def short_repr(value: object) -> str:
    """A value in one line, cut where it is long."""
    huge = isinstance(value, int) and value.bit_length() > 2000  # Python may refuse to write its decimals
    words = " ".join((hex(value) if huge and isinstance(value, int) else repr(value)).split())
    return words if len(words) <= SHOWN else f"{words[: SHOWN - 3]}..."


def number(name: str, value: object, accepted: str = "a finite number") -> float:
    """The value as a float; raises TypeError where it is no real number and ValueError where it is not finite."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name}: given {short_repr(value)}; accepted: {accepted}")
    try:
        found = float(value)
    except OverflowError:
        found = math.inf
    if not math.isfinite(found):
        raise ValueError(f"{name}: given {short_repr(value)}; accepted: {accepted}")
    return found


def numbers(name: str, values: object) -> tuple[float, ...]:
    """The values as a tuple of floats; raises TypeError and ValueError as `number` does."""
    accepted = "a list of finite numbers"
    if isinstance(values, str | bytes | dict):
        raise TypeError(f"{name}: given {short_repr(values)}; accepted: {accepted}")
    try:
        given = tuple(cast(Iterable[object], values))
    except TypeError:
        raise TypeError(f"{name}: given {short_repr(values)}; accepted: {accepted}") from None
    return tuple(number(name, value, accepted) for value in given)
