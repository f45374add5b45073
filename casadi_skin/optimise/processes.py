"""Work shared between processes: what they tell meanwhile, and Ctrl-C that leaves what has been done."""

from __future__ import annotations

import queue
import signal
import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.managers import SyncManager
from types import FrameType
from typing import Any, TypeVar

T = TypeVar("T")

POLL = 0.1  # seconds between two looks at what processes tell
ENDED_EARLY = 'search: a process ended early; in a script, parallel searches go below if __name__ == "__main__":'


class Interruption:
    """Hears SIGINT and SIGTERM while it lasts; the second one interrupts at once."""

    def __init__(self) -> None:
        self.heard = False

    def _hear(self, number: int, frame: FrameType | None) -> None:
        if self.heard:
            raise KeyboardInterrupt
        self.heard = True

    @contextmanager
    def listening(self) -> Iterator[Interruption]:
        """Listen inside the block; signals reach the main thread alone."""
        if threading.current_thread() is not threading.main_thread():
            yield self
            return
        heeded = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) is not signal.SIG_IGN]
        before = {n: signal.signal(n, self._hear) for n in heeded}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler if handler is not None else signal.SIG_DFL)


@dataclass(frozen=True)
class Shared:
    """What processes share with the one that waits for them: what they tell, and whether they are to stop."""

    told: Any  # proxies of a manager, which have no types
    stop: Any


def ignore_interrupts() -> None:
    """Leave Ctrl-C, which every process of a terminal hears, to the one that waits."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def sharing() -> Iterator[Shared]:
    """What processes share, for as long as the block lasts; raises RuntimeError where no process can be started."""
    manager = SyncManager(ctx=get_context("spawn"))
    try:
        manager.start(ignore_interrupts)
    except EOFError as error:
        raise RuntimeError(ENDED_EARLY) from error
    try:
        yield Shared(manager.Queue(), manager.Event())
    finally:
        manager.shutdown()


def pool(workers: int, jobs: int) -> ProcessPoolExecutor:
    """Fresh processes, no more than there are jobs."""
    return ProcessPoolExecutor(min(workers, jobs), mp_context=get_context("spawn"))


def gathered(
    waiting: set[Future[T]],
    interruption: Interruption,
    shared: Shared | None = None,
    hear: Callable[[Any], None] | None = None,
    abandoned: bool = False,
) -> Generator[T]:
    """Results of futures as they end; `hear` is called with what processes tell through `shared`.

    After an interruption only what had begun is waited for; where it is `abandoned`, as in an executor of the user's,
    not even that. Raises RuntimeError where a process ends early.
    """
    try:
        while waiting:
            ended, waiting = wait(waiting, timeout=POLL, return_when=FIRST_COMPLETED)
            for told in _told(shared):
                if hear is not None:
                    hear(told)
            for future in ended:
                yield future.result()
            if interruption.heard:
                waiting = {future for future in waiting if not future.cancel()}
                if abandoned:
                    return
                if shared is not None:
                    shared.stop.set()
    except BrokenProcessPool as error:
        raise RuntimeError(ENDED_EARLY) from error
    finally:
        for future in waiting:
            future.cancel()
        if shared is not None and waiting:
            shared.stop.set()


def _told(shared: Shared | None) -> Iterator[Any]:
    while shared is not None:
        try:
            yield shared.told.get_nowait()
        except queue.Empty:
            return
