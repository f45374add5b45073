"""Checks of arguments: each message names the argument, what was given and what is accepted, in one line."""

from __future__ import annotations

import difflib
import math
import reprlib
import sys
from collections.abc import Iterable
from numbers import Real
from typing import Any, cast

LONGEST = 60  # characters of a given value or name that a message shows
MANY_NODES = 1000  # of an expression that no message shows


def cut(text: str, longest: int = LONGEST) -> str:
    """The text, its end replaced by three dots where it is longer than that."""
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def short_repr(value: object) -> str:
    """A value in one line, cut where it is long."""
    return cut(" ".join(_Short().repr(value).split()))


class _Short(reprlib.Repr):
    """Text of what a message shows the beginning of, whatever it is: huge, endless, or with a fault in its own text."""

    def __init__(self) -> None:
        super().__init__()
        for name in ("maxlist", "maxtuple", "maxdict", "maxset", "maxfrozenset", "maxdeque", "maxarray"):
            setattr(self, name, LONGEST)
        self.maxstring = self.maxother = 4 * LONGEST

    def repr_int(self, value: int, level: int) -> str:
        return hex(value) if value.bit_length() > 2000 else repr(value)  # Python may refuse to write its decimals

    def repr_SX(self, value: Any, level: int) -> str:
        """CasADi writes expressions by recursion: deep ones would end the process."""
        deep = sys.modules["casadi"].n_nodes(value) > MANY_NODES
        return f"{type(value).__name__} of shape {value.shape}" if deep else str(self.repr_instance(value, level))

    repr_MX = repr_SX


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
