"""A limit on the time of long work and words on how far it is: stated around the work, heeded by the solvers within."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


class TimeLimitError(ArithmeticError):
    """The time allowed is over."""


@dataclass(frozen=True)
class _Watch:
    allowed: float | None
    end: float
    report: Callable[[str], object] | None


_WATCH: ContextVar[_Watch | None] = ContextVar("watch", default=None)


@contextmanager
def watched(seconds: float | None = None, report: Callable[[str], object] | None = None) -> Iterator[None]:
    """Let solvers in the block end with TimeLimitError after so many seconds, and report how far they are."""
    end = float("inf") if seconds is None else time.monotonic() + seconds
    token = _WATCH.set(_Watch(seconds, end, report))
    try:
        yield
    finally:
        _WATCH.reset(token)


def is_over() -> bool:
    """Whether the time allowed is over."""
    watch = _WATCH.get()
    return watch is not None and time.monotonic() > watch.end


def heed(words: str) -> None:
    """Tell how far the work is; raises TimeLimitError where its time is over."""
    watch = _WATCH.get()
    if watch is None:
        return
    if watch.report is not None:
        watch.report(words)
    if is_over():
        raise TimeLimitError(f"the time allowed, {watch.allowed:g} s, is over, at {words}")
