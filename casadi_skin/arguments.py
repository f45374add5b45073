"""Checks of arguments: each message names the argument, what was given and what is accepted, in one line."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable
from numbers import Integral, Real
from typing import Any, cast

LONGEST = 60  # characters of a given value or name that a message shows


def cut(text: str, longest: int = LONGEST) -> str:
    """The text, its end replaced by three dots where it is longer than that."""
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def short_repr(value: object) -> str:
    """A value in one line, cut where it is long."""
    huge = isinstance(value, int) and value.bit_length() > 2000  # Python may refuse to write its decimals
    return cut(" ".join((hex(value) if huge and isinstance(value, int) else repr(value)).split()))


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that is most like the given one in any case of its letters, if one is near."""
    names = {other.lower(): other for other in reversed(list(known))}
    return next((names[near] for near in difflib.get_close_matches(name[:LONGEST].lower(), names, n=1)), None)


def accepted_names(name: object, known: Iterable[str]) -> str:
    """What a message on an unknown name ends with: the nearest known name, if one is near, and all that are known."""
    names = list(known)
    near = nearest(str(name), names)
    return f"{f'did you mean {near}? ' if near else ''}accepted: {', '.join(names) or 'none'}"


def check_name(label: str, name: object, known: Iterable[str]) -> None:
    """Raises ValueError, with the nearest known name, for an unknown one."""
    names = list(known)
    if name not in names:
        raise ValueError(f"{label}: given {short_repr(name)}; {accepted_names(name, names)}")


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


def whole(name: str, value: Any, least: int, most: int | None = None) -> int:
    """The value as an int; raises ValueError where it is no whole number from `least` on, or up to `most`."""
    accepted = f">= {least}" if most is None else f"from {least} to {most}"
    given = isinstance(value, Integral) and not isinstance(value, bool)
    if not given or int(value) < least or (most is not None and int(value) > most):
        raise ValueError(f"{name}: given {short_repr(value)}; accepted: a whole number {accepted}")
    return int(value)


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
