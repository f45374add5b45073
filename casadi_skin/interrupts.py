"""Interruptions that wait for a solver to return.

CasADi catches a KeyboardInterrupt inside the callbacks of Ipopt and of the integrators and reports a failed evaluation
in its place: the interruption would be lost, and the solver's failure taken for one of the problem.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def interrupts_deferred() -> Iterator[None]:
    """Hold back SIGINT and SIGTERM inside the block, and deliver the last one when it ends."""
    if threading.current_thread() is not threading.main_thread():  # signals reach the main thread alone
        yield
        return
    received: list[tuple[int, FrameType | None]] = []
    numbers = (signal.SIGINT, signal.SIGTERM)
    handlers = {n: signal.signal(n, lambda number, frame: received.append((number, frame))) for n in numbers}
    try:
        yield
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
