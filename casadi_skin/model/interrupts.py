"""Interruptions that wait for a solver to return.

CasADi catches a KeyboardInterrupt inside the callbacks of Ipopt and of the integrators and reports a failed evaluation
in its place: the interruption would be lost, and the solver's failure taken for one of the problem. One that comes
while arguments are converted ends in a TypeError instead.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType

SECONDS_TO_AGAIN = 0.01  # seconds after which a block that goes on is ended again
ENDING = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


def heeded() -> list[signal.Signals]:
    """The signals that end this process, those left out that it was told to ignore; none but in the main thread."""
    if threading.current_thread() is not threading.main_thread():  # signals reach that one alone
        return []
    return [number for number in ENDING if signal.getsignal(number) is not signal.SIG_IGN]


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """End the block with KeyboardInterrupt at SIGINT, SIGTERM or SIGHUP, again where it goes on: one may be lost."""
    before = {number: signal.signal(number, _end) for number in heeded()}
    try:
        yield
    finally:
        if before:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in before.items():
            signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def _end(number: int, frame: FrameType | None) -> None:
    signal.signal(signal.SIGALRM, lambda *_: signal.raise_signal(number))
    signal.setitimer(signal.ITIMER_REAL, SECONDS_TO_AGAIN)
    raised = sys.exc_info()[1]
    while raised is not None and not isinstance(raised, KeyboardInterrupt):
        raised = raised.__context__
    if raised is None:  # it is not on its way through blocks that clean up
        raise KeyboardInterrupt


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

    def on_alarm(number: int, frame: FrameType | None) -> None:
        limit.is_over = True
        signal.raise_signal(signal.SIGTERM)

    before = signal.signal(signal.SIGALRM, on_alarm)
    try:
        signal.setitimer(signal.ITIMER_REAL, limit.seconds or 0.0)
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


@contextmanager
def interrupts_deferred(end_solver: bool = False) -> Iterator[None]:
    """Hold back SIGINT, SIGTERM and SIGHUP inside the block, and deliver the last one when it ends.

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
