"""A limit on the time of long work, and reports on how far it is: set around the work, checked by the solvers in it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import cache

from threadpoolctl import ThreadpoolController


class TimeLimitError(ArithmeticError):
    """The time allowed is over."""


@dataclass(frozen=True)
class _Watch:
    allowed: float | None
    end: float
    report: Callable[[str], object] | None


_WATCH: ContextVar[_Watch | None] = ContextVar("watch", default=None)


@contextmanager
def watched(
    seconds: float | None = None, report: Callable[[str], object] | None = None, allowed: float | None = None
) -> Iterator[None]:
    """Let solvers in the block end with TimeLimitError after so many seconds, and report how far they are.

    Within another such block the earlier end holds, and its report where none is given. `allowed` is the time that
    the message names: the whole of which `seconds` are left.
    """
    outer = _WATCH.get()
    end = float("inf") if seconds is None else time.monotonic() + seconds
    watch = _Watch(seconds if allowed is None else allowed, end, report)
    if outer is not None:
        watch = replace(watch if end <= outer.end else outer, report=report or outer.report)
    token = _WATCH.set(watch)
    try:
        yield
    finally:
        _WATCH.reset(token)


@dataclass
class Budget:
    """Seconds of a time limit that are left for work in several parts."""

    allowed: float = float("inf")
    left: float = float("inf")

    @contextmanager
    def spent(self) -> Iterator[None]:
        """Let solvers in the block end with TimeLimitError when nothing is left."""
        if self.left == float("inf"):
            yield
            return
        start = time.monotonic()
        try:
            with watched(self.left, allowed=self.allowed):
                yield
        finally:
            self.left = max(self.left - (time.monotonic() - start), 0.0)


def is_over() -> bool:
    """Whether the time allowed is over."""
    watch = _WATCH.get()
    return watch is not None and time.monotonic() > watch.end


def check_time_limit(words: str) -> None:
    """Report how far the work is; raises TimeLimitError where its time is over."""
    watch = _WATCH.get()
    if watch is None:
        return
    if watch.report is not None:
        watch.report(words)
    if is_over():
        raise TimeLimitError(f"the time allowed, {watch.allowed:g} s, is over, at {words}")


# Linear algebra on one thread: the matrices of an orbit are small, and threads that wait for each other cost more -----


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  has a BLAS of its own, which has to be loaded to be found

    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """While it lasts, BLAS and OpenMP of this process use one thread; then as many as before.

    Families of N = 24 took 1.3 times as long with two threads on two idle cores, and 10 times on busy ones.
    """
    pools = _controller()
    if all(pool.num_threads == 1 for pool in pools.lib_controllers):  # inside of another such block
        return nullcontext()
    limited: AbstractContextManager[object] = pools.limit(limits=1)
    return limited
