"""Interruptions that wait for a solver to return.

CasADi catches a KeyboardInterrupt inside the callbacks of Ipopt and of the integrators and reports a failed evaluation
in its place: the interruption would be lost, and the solver's failure taken for one of the problem. One that comes
while arguments are converted ends in a TypeError instead.
"""

from __future__ import annotations

import _thread
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from types import FrameType
from typing import Any, ParamSpec, Protocol, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
SECONDS_TO_AGAIN = 0.01  # seconds after which a block that goes on is ended again
NAMES = ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")  # the last is that of a window that is closed on Windows
ENDING = tuple(getattr(signal, name) for name in NAMES if hasattr(signal, name))


def heeded() -> list[signal.Signals]:
    """The signals that end this process, those left out that it was told to ignore; none but in the main thread."""
    if threading.current_thread() is not threading.main_thread():  # signals reach that one alone
        return []
    return [number for number in ENDING if signal.getsignal(number) is not signal.SIG_IGN]


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """End the block with KeyboardInterrupt at a signal of `ENDING`, again where it goes on: one may be lost."""
    before = {number: signal.signal(number, _end) for number in heeded()}
    try:
        yield
    finally:
        if before:
            _alarm.stop()
        for number, handler in before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def _end(number: int, frame: FrameType | None) -> None:
    _alarm.ring(SECONDS_TO_AGAIN, partial(signal.raise_signal, number))
    raised = sys.exc_info()[1]
    while raised is not None and not isinstance(raised, KeyboardInterrupt):
        raised = raised.__context__
    if raised is None:  # it is not on its way through blocks that clean up
        raise KeyboardInterrupt


class _Alarm:
    """Calls one function in so many seconds, in the main thread and also while a solver computes.

    Without timers of the system another thread calls it, which waits until the solver comes back to Python.
    """

    _waiting: threading.Lock | None = None

    def ring(self, seconds: float, act: Callable[[], object]) -> None:
        self.stop()
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGALRM, lambda *_: act())
            signal.setitimer(signal.ITIMER_REAL, seconds)
            return
        waiting = self._waiting = threading.Lock()
        waiting.acquire()
        # No threading.Timer: a handler of signals must not wait for locks of `threading`.
        _thread.start_new_thread(lambda: waiting.acquire(timeout=seconds) or act(), ())

    def stop(self) -> None:
        """Call nothing."""
        if hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        elif self._waiting is not None:
            with suppress(RuntimeError):  # a handler of signals did it in between
                self._waiting.release()
            self._waiting = None


_alarm = _Alarm()


@dataclass
class TimeLimit:
    """A limit in seconds, if any; whether it `is_over`, which may be asked after the block that it ended."""

    seconds: float | None
    is_over: bool = False

    def __str__(self) -> str:
        return f"time_limit: {self.seconds:g} s are over"


@contextmanager
def time_limited(limit: TimeLimit) -> Iterator[None]:
    """End the block as SIGTERM ends it, once it has taken as long as it may; in the main thread."""

    def end() -> None:
        limit.is_over = True
        signal.raise_signal(signal.SIGTERM)

    if limit.seconds is not None:
        _alarm.ring(limit.seconds, end)
    try:
        yield
    finally:
        _alarm.stop()  # also what ends the block again


@contextmanager
def interrupts_deferred(end_solver: bool = False) -> Iterator[None]:
    """Hold back the signals of `ENDING` inside the block, and deliver the last one when it ends.

    With `end_solver` a signal makes the running callback fail, so that a long integration ends at once; without
    it the second one does. What the solver raises after a signal is raised only where the signal's own handler returns.
    """
    received: list[tuple[int, FrameType | None]] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        received.append((number, frame))
        if end_solver or len(received) > 1:
            raise KeyboardInterrupt

    handlers = {n: signal.signal(n, on_signal) for n in heeded()}
    failure: BaseException | None = None
    try:
        yield
    except (RuntimeError, KeyboardInterrupt) as error:
        if not received:
            raise
        failure = error
    finally:
        for n, handler in handlers.items():
            signal.signal(n, handler if handler is not None else signal.SIG_DFL)
    if received:
        number, frame = received[-1]
        handler = handlers[signal.Signals(number)]
        if callable(handler):
            handler(number, frame)
        elif handler is signal.SIG_DFL:
            signal.raise_signal(number)
    if failure is not None:
        raise failure


class Lock(Protocol):
    """A lock of `threading`, of either kind."""

    def acquire(self, blocking: bool = True) -> bool: ...
    def release(self) -> None: ...


def holding(lock: Lock, function: Callable[P, T], *arguments: P.args, **options: P.kwargs) -> T:
    """What a function returns that is called while this thread has a lock.

    From Python 3.14 on `with` may be interrupted when it has the lock already and not yet begun its block, and the lock
    would not be given back. Here the lock is taken and noted by one call that nothing interrupts in between.
    """
    held = list[bool]()
    try:
        held.extend(map(lock.acquire, (True,)))
        return function(*arguments, **options)
    finally:
        if held:
            lock.release()


def end_group(process: subprocess.Popen[Any]) -> None:
    """End a process that was started with `process_group=0`, and what it has started where the system has groups."""
    process.kill()
    if hasattr(os, "killpg"):
        with suppress(ProcessLookupError):  # none is left
            os.killpg(process.pid, signal.SIGKILL)
