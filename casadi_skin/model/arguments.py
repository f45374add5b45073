"""Checks of arguments: each message names the argument, its value and the accepted values, in one line."""

from __future__ import annotations

import math
import reprlib
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from numbers import Integral, Real
from pathlib import Path
from typing import Any, cast

LONGEST_VALUE_TEXT = 60  # characters of a value or name in a message
MOST_DIGITS = 12  # of a number with its error
MANY_NODES = 1000  # of an expression that no message shows
PAIR_WORDS = "a pair (lower, upper) of numbers, None where there is no bound"
SAME_PERIOD_RTOL = 1e-12  # relative difference of periods that are the same


def cut(text: str, longest: int = LONGEST_VALUE_TEXT) -> str:
    """The text, its end replaced by three dots where it is longer than that."""
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def short_repr(value: object) -> str:
    """A value in one line, cut where it is long."""
    return cut(" ".join(_Short().repr(value).split()))


class _Short(reprlib.Repr):
    """Beginning of the text of any object for messages, however long it is, even with a fault in its own text."""

    def __init__(self) -> None:
        super().__init__()
        for name in ("maxlist", "maxtuple", "maxdict", "maxset", "maxfrozenset", "maxdeque", "maxarray"):
            setattr(self, name, LONGEST_VALUE_TEXT)
        self.maxstring = self.maxother = 4 * LONGEST_VALUE_TEXT

    def repr_int(self, value: int, level: int) -> str:
        return hex(value) if value.bit_length() > 2000 else repr(value)  # Python may refuse to write its decimals

    def repr_SX(self, value: Any, level: int) -> str:
        """CasADi writes expressions by recursion: deep ones would end the process."""
        deep = sys.modules["casadi"].n_nodes(value) > MANY_NODES
        return f"{type(value).__name__} of shape {value.shape}" if deep else str(self.repr_instance(value, level))

    repr_MX = repr_SX


def in_words(error: BaseException) -> str:
    """The message of an error in one line; the name of its class where it has none."""
    return " ".join(str(error).split()) or type(error).__name__


def with_error(value: float, error: float) -> str:
    """A number to the second digit of its error, or to 12 digits, and the error with two."""
    digits = MOST_DIGITS
    if value and 0.0 < error < abs(value):
        digits = min(digits, math.floor(math.log10(abs(value))) - math.floor(math.log10(error)) + 2)
    return f"{value:.{digits}g} +- {error:.1e}"


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that is most like a name in any case of its letters, if one is near."""
    names = {other.lower(): other for other in reversed(list(known))}
    import difflib  # here: few commands fail

    return next(
        (names[near] for near in difflib.get_close_matches(name[:LONGEST_VALUE_TEXT].lower(), names, n=1)), None
    )


def did_you_mean(near: str | None, accepted: str) -> str:
    """End of a message: the nearest known name, if one is near, and what is accepted in words."""
    return f"{f'did you mean {near}? ' if near else ''}accepted: {accepted}"


def accepted_names(name: object, known: Iterable[str]) -> str:
    """End of a message about an unknown name: the nearest known name, if one is near, and all known names."""
    names = list(known)
    near = nearest(name if isinstance(name, str) else short_repr(name), names)
    return did_you_mean(near, ", ".join(names) or "none")


def check_instance(name: str, value: object, *kinds: type) -> None:
    """Raises TypeError where the value is of none of these classes."""
    if not isinstance(value, kinds):
        accepted = " or ".join(f"{'an' if kind.__name__[0] in 'AEIOU' else 'a'} {kind.__name__}" for kind in kinds)
        raise TypeError(f"{name}: given {short_repr(value)}; accepted: {accepted}")


def check_name(label: str, name: object, known: Iterable[str]) -> None:
    """Raises ValueError, with the nearest known name, for an unknown one."""
    names = list(known)
    if not isinstance(name, str) or name not in names:
        raise ValueError(f"{label}: given {short_repr(name)}; {accepted_names(name, names)}")


def state_by_name(label: str, given: Mapping[str, Any], names: Sequence[str]) -> list[float]:
    """One number a state from numbers by name, where those left out are 0; raises ValueError and TypeError."""
    for name in given:
        check_name(label, name, names)
    return [number(f"{label}, {name}", given.get(name, 0.0)) for name in names]


def check_options(label: str, given: Iterable[str], *functions: Callable[..., Any]) -> None:
    """Raises TypeError, with the nearest accepted name, for an option that no function or class of these takes."""
    if not given:
        return
    import inspect  # here: it takes long to load

    known, options = set[str](), dict[str, None]()
    for function in functions:
        for name, parameter in inspect.signature(function).parameters.items():
            if parameter.kind is inspect.Parameter.VAR_KEYWORD and len(functions) == 1:
                return  # which the function checks
            known.add(name)
            if parameter.kind is inspect.Parameter.KEYWORD_ONLY or parameter.default is not inspect.Parameter.empty:
                options[name] = None
    for name in given:
        if name not in known:
            raise TypeError(f"{label}: given the option {name!r}; {accepted_names(name, options)}")


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


def number_within(name: str, value: object, low: float, high: float) -> float:
    """The value as a float from `low` to `high`; raises TypeError and ValueError as `number` does for others."""
    accepted = f"{low:g} to {high:g}"
    found = number(name, value, accepted)
    if not low <= found <= high:
        raise ValueError(f"{name}: given {value!r}; accepted: {accepted}")
    return found


def duration(name: str, value: object) -> float:
    """Seconds, infinite for None; raises TypeError and ValueError as `number` does, and ValueError unless > 0."""
    accepted = "a number of seconds > 0"
    if value is None:
        return math.inf
    if not number(name, value, accepted) > 0.0:
        raise ValueError(f"{name}: given {short_repr(value)}; accepted: {accepted}")
    return float(cast(float, value))


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


def pair(place: str, given: object) -> tuple[float, float]:
    """Two bounds; raises TypeError and ValueError unless they are a pair of ascending numbers."""
    ends = tuple(given) if isinstance(given, list | tuple) else ()
    if len(ends) != 2:
        raise TypeError(f"{place}: given {short_repr(given)}; accepted: {PAIR_WORDS}")
    lower, upper = (
        absent if value is None or (isinstance(value, float) and value == absent) else number(place, value, PAIR_WORDS)
        for value, absent in zip(ends, (-math.inf, math.inf), strict=True)
    )
    if lower > upper:
        raise ValueError(f"{place}: given {short_repr(given)}; accepted: (lower, upper), lower <= upper")
    return lower, upper


def truth(name: str, value: object) -> bool:
    """The value; raises TypeError where it is neither True nor False."""
    if not isinstance(value, bool) and type(value).__name__ not in ("bool_", "bool"):  # numpy's
        raise TypeError(f"{name}: given {short_repr(value)}; accepted: True or False")
    return bool(value)


def function_of(name: str, value: object, argument: str) -> None:
    """Raises TypeError where the value is neither None nor can be called."""
    if value is not None and not callable(value):
        raise TypeError(f"{name}: given {short_repr(value)}; accepted: a function of {argument}")


def by_name(name: str, value: object, what: str = "numbers") -> Mapping[str, Any]:
    """The value, nothing for None; raises TypeError where it is no mapping from names."""
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise TypeError(f"{name}: given {short_repr(value)}; accepted: {what} by name")
    return value


@contextmanager
def needs_extra(package: str, extra: str) -> Iterator[None]:
    """An import of a package that comes with an extra; raises ImportError, naming the extra, where it fails."""
    try:
        yield
    except ImportError as error:
        words = f'it comes with the extra: pip install "casadi-skin[{extra}]"'
        raise ImportError(f"{package} is not installed; {words}") from error


def file_path(name: str, value: object) -> Path:
    """The value as a path; raises TypeError and ValueError where it cannot name a file."""
    if not isinstance(value, str | Path):
        raise TypeError(f"{name}: given {short_repr(value)}; accepted: a path")
    if not str(value).isprintable() or not str(value):
        raise ValueError(f"{name}: given {short_repr(str(value))}; accepted: a path in one line")
    return Path(value)


def new_file(name: str, value: object, suffix: str = "") -> Path:
    """The value as the path of a file to be written; raises TypeError and ValueError where there can be none."""
    target = file_path(name, value)
    if suffix and target.suffix != suffix:
        raise ValueError(f"{name}: given {target}; accepted: a name that ends in {suffix}")
    if target.is_dir():
        raise ValueError(f"{name}: given {target}, which is a directory; accepted: the path of a file")
    if not target.parent.is_dir():
        raise ValueError(f"{name}: given {target}, in no directory; accepted: a file in a directory that is there")
    return target


def check_way(
    start: float, to: object, back_to: object = None, at: object = ()
) -> tuple[float, float, tuple[float, ...]]:
    """Ends of a branch from a value of its parameter and the values wanted on it, as numbers: `to`, `back_to`, `at`.

    A branch that comes back ends at `back_to`, at its start for None. Raises TypeError and ValueError for others.
    """
    end, back, wanted = number("to", to), start if back_to is None else number("back_to", back_to), numbers("at", at)
    if end == start:
        raise ValueError(f"to: given {end!r}, where the branch starts; accepted: another number")
    if back_to is not None and not (back - start) * (end - start) < 0.0:
        side = "below" if end > start else "above"
        raise ValueError(f"back_to: given {back!r}; accepted: a number {side} {start!r}, where it starts")
    low, high = sorted((back, end))
    for item, value in enumerate(wanted, start=1):
        if not low <= value <= high:
            raise ValueError(f"at: given {value!r} as item {item}; accepted: numbers from {low!r} to {high!r}")
    return end, back, wanted


def check_places(given: Any, amplitude_max: float, linear_period: float, mode: int) -> None:
    """Raises ValueError for places where orbits are wanted, and a last period, that a family does not come to.

    `given` has them as `at`, `at_Omega`, `at_period` and `period_max`; the family begins at the period of its mode.
    """
    longest = math.inf if given.period_max is None else given.period_max
    if given.period_max is not None and not linear_period * (1.0 + SAME_PERIOD_RTOL) < longest < math.inf:
        accepted = f"a finite number > {linear_period:.12g} (the period of linear mode {mode})"
        raise ValueError(f"period_max: given {longest!r}; accepted: {accepted}")
    slowest = 2.0 * math.pi / longest
    for name, low, high, accepted in (
        ("at", 0.0, amplitude_max, f"numbers <= amplitude_max = {amplitude_max!r}"),
        ("at_Omega", slowest, math.inf, f"numbers >= 2 pi/period_max = {slowest:.12g}"),
        ("at_period", 0.0, longest, f"numbers <= period_max = {longest!r}"),
    ):
        values = getattr(given, name)
        for i, value in enumerate(values):
            place = f"{name}: given {value!r} as item {i + 1}"
            if not 0.0 < value < math.inf:
                raise ValueError(f"{place}; accepted: finite numbers > 0")
            if not low <= value <= high:
                raise ValueError(f"{place}; accepted: {accepted}")
            if name == "at" and i and value <= values[i - 1]:
                raise ValueError(f"{place} after {values[i - 1]!r}; accepted: numbers in strictly ascending order")
            if value in values[:i]:
                raise ValueError(f"{place} again; accepted: each number once")
