"""Base of every result and declaration with verbs: methods whose functions stand above it in the package.

A verb is a method as `orbit.certify(...)`: the function `certify(orbit, ...)` of another module, which is imported when
the verb is first used. The one table of them is in `casadi_skin/__init__.py`; nothing below looks a function up.

Threads take turns: results share levels, solvers and work arrays with those they come from, and a call that lets other
threads run, as one of CasADi does, would find them changed. Whatever is public holds the one lock of the process.
"""

from __future__ import annotations

import functools
import os
import sys
import threading
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from types import FunctionType
from typing import Any, ClassVar, cast

from casadi_skin.model.arguments import check_options
from casadi_skin.model.interrupts import P, T, holding


class NoQuantityError(ValueError, AttributeError):
    """A quantity that a result of this kind has not: a ValueError for who asks for it, and `hasattr` is False."""


TURN = threading.RLock()
PACKAGE = __name__.partition(".")[0]
if hasattr(os, "register_at_fork"):  # a fork waits for its turn: no array of the child is half computed
    os.register_at_fork(before=TURN.acquire, after_in_parent=TURN.release, after_in_child=TURN.release)


def in_turn(function: Callable[P, T]) -> Callable[P, T]:
    """The function, for one thread at a time."""

    @functools.wraps(function)
    def alone(*arguments: P.args, **options: P.kwargs) -> T:
        return holding(TURN, function, *arguments, **options)

    return alone


def kept_by_first(function: Callable[P, T]) -> Callable[P, T]:
    """The function with results that its first argument keeps while it is there: a cache would hold on to it, too."""

    @functools.wraps(function)
    def found(*arguments: P.args, **options: P.kwargs) -> T:
        known = vars(arguments[0]).setdefault(f"{function.__module__}.{function.__name__}", {})
        key = (*arguments[1:], *options.items())
        if key not in known:
            known[key] = function(*arguments, **options)
        return cast(T, known[key])

    return found


def warn_caller(words: str, category: type[Warning]) -> None:
    """Warn of a line outside of the package: the one that called it, by however many functions."""
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and frame.f_globals["__name__"].partition(".")[0] == PACKAGE:
        frame, level = frame.f_back, level + 1
    warnings.warn(words, category, stacklevel=level)


def renamed(**older: str) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """A function that takes arguments by their older names too, older = new, with a warning, until version 0.4."""

    def taking(function: Callable[P, T]) -> Callable[P, T]:
        @functools.wraps(function)
        def called(*arguments: P.args, **options: P.kwargs) -> T:
            for old, new in older.items():
                if old in options and new not in options:
                    words = f"{function.__name__}: the argument {old} is called {new}; {old} is taken until version 0.4"
                    warn_caller(words, DeprecationWarning)
                    options[new] = options.pop(old)
            return function(*arguments, **options)

        return called

    return taking


class _KeptInTurn(functools.cached_property[Any]):
    # Each such property of Python 3.11 has a lock, which has to be taken after that of the process.

    __get__ = in_turn(functools.cached_property.__get__)


class Verb:
    # A method that is a function of another module, with its signature and docstring: `place` is "module:function"
    # within the package, and the function's first argument is the object. Nothing is imported until it is used.

    def __init__(self, name: str, place: str) -> None:
        self.__name__, self.place = name, place

    def __get__(self, instance: object, owner: type) -> Any:
        return self if instance is None else self.method.__get__(instance, owner)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        return self.method(*arguments, **options)

    @property
    def __doc__(self) -> str | None:  # type: ignore[override]
        words: str | None = self.method.__doc__
        return words

    @property
    def __signature__(self) -> Any:
        import inspect  # here: it takes long to load

        return inspect.signature(self.method)

    @functools.cached_property
    def method(self) -> Any:
        """The function, which refuses options that it has not, with the nearest name."""
        module, name = self.place.split(":")
        function = getattr(import_module(f"casadi_skin.{module}"), name)

        @functools.wraps(function)
        def method(*arguments: Any, **options: Any) -> Any:
            check_options(self.__name__, options, function)
            return function(*arguments, **options)

        return in_turn(method)


class WithVerbs:
    """A class whose verbs stand in the table of the package, by the names of classes."""

    _verbs: ClassVar[dict[str, Mapping[str, str]]] = {}

    @classmethod
    def bind(cls, verbs: Mapping[str, Mapping[str, str]]) -> None:
        """State the verbs of classes, most of which are not imported yet: name of the class, verb, its place."""
        WithVerbs._verbs.update(verbs)
        cls._take_verbs()

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        for name, member in list(vars(cls).items()):
            if name.startswith("_") and name != "__getitem__":
                continue
            if isinstance(member, FunctionType):
                setattr(cls, name, in_turn(member))
            elif isinstance(member, property) and member.fget is not None:
                setattr(cls, name, property(in_turn(member.fget)))
            elif isinstance(member, functools.cached_property):
                setattr(cls, name, kept := _KeptInTurn(member.func))
                kept.__set_name__(cls, name)
        cls._take_verbs()

    @classmethod
    def _take_verbs(cls) -> None:
        for name, place in WithVerbs._verbs.get(cls.__name__, {}).items():
            setattr(cls, name, Verb(name, place))


class Result(WithVerbs):
    """A result that prints as a few lines, draws itself, becomes tables and is saved; libraries load on first use."""

    plot: ClassVar[Callable[..., Any]]
    """Draw the result into matplotlib axes: `casadi_skin.results.present.plot`."""
    to_dataframe: ClassVar[Callable[..., Any]]
    """A pandas DataFrame: `casadi_skin.results.present.to_dataframe`; needs the extra `pandas`."""
    to_xarray: ClassVar[Callable[..., Any]]
    """An xarray Dataset: `casadi_skin.results.present.to_dataset`; needs the extra `xarray`."""
    save: ClassVar[Callable[..., Any]]
    """Write the result to a file of data: `casadi_skin.results.saving.save_result`."""
