"""Starts of a search one after the other or in other processes, with progress, and Ctrl-C that keeps the results."""

from __future__ import annotations

import pickle
import queue
import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from multiprocessing import get_context
from multiprocessing.managers import SyncManager
from types import FrameType
from typing import Any, Protocol, TypeVar

from casadi_skin.arguments import short_repr
from casadi_skin.optimise.iteration_callback import Monitor
from casadi_skin.threads import one_thread

POLL = 0.1  # seconds between two reports of a process
ENDED_EARLY = 'search: a process ended early; in a script, parallel searches go below if __name__ == "__main__":'


class Job(Protocol):
    """A start of a search: its number, from 1, and a name where it has one."""

    @property
    def number(self) -> int: ...

    @property
    def name(self) -> str: ...


J = TypeVar("J", bound=Job)
T = TypeVar("T")
Solve = Callable[[J, Monitor | None], T]


@dataclass(frozen=True)
class SearchProgress:
    """Where a search is: a start, its iteration of Ipopt, objective and largest violation; `done` starts have ended.

    The end of every start is reported as well, with an infinite objective where it found nothing.
    """

    start: int
    starts: int
    done: int
    iteration: int
    objective: float
    violation: float
    name: str = ""

    def __str__(self) -> str:
        name = f" ({self.name})" if self.name else ""
        return (
            f"{self.done} of {self.starts} starts done; start {self.start}{name}, iteration {self.iteration}: "
            f"objective {self.objective:.8g}, violation {self.violation:.1e}"
        )


Report = Callable[[SearchProgress], None]


class Interruption:
    """Whether SIGINT or SIGTERM came while it listens; the second one interrupts at once."""

    def __init__(self) -> None:
        self.received = False

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self.received:
            raise KeyboardInterrupt
        self.received = True

    @contextmanager
    def listening(self) -> Iterator[Interruption]:
        """Listen inside the block; signals reach the main thread alone."""
        if threading.current_thread() is not threading.main_thread():
            yield self
            return
        heeded = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) is not signal.SIG_IGN]
        before = {n: signal.signal(n, self._receive) for n in heeded}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler if handler is not None else signal.SIG_DFL)


def check_processes(workers: object, executor: object) -> None:
    """Raises TypeError or ValueError for a number of workers or an executor that cannot be used."""
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ValueError(f"workers: given {short_repr(workers)}; accepted: a whole number >= 1")
    accepted = "a concurrent.futures.Executor of processes"
    if isinstance(executor, ThreadPoolExecutor):
        accepted += " (CasADi shares no function between threads)"
    if isinstance(executor, ThreadPoolExecutor) or not isinstance(executor, Executor | None):
        raise TypeError(f"executor: given {short_repr(executor)}; accepted: {accepted}")


def run_jobs(
    solve: Solve[J, T],
    jobs: Sequence[J],
    interruption: Interruption,
    report: Report | None = None,
    workers: int = 1,
    executor: Executor | None = None,
) -> Generator[T]:
    """Results of `solve(job, monitor)` as they end; after an interruption those of jobs that had begun.

    Arguments:
        solve: in other processes a method of an object that can be pickled, or a partial of one.
        jobs: the starts.
        interruption: listens while this runs.
        report: called at iterations; `done` counts the results yielded so far.
        workers: number of processes; 1 for this one.
        executor: processes of the caller, in place of `workers`. It is not waited for after an interruption.

    Raises:
        RuntimeError: a process ends early.
    """
    if executor is None and (workers == 1 or len(jobs) < 2):
        yield from _in_this_process(solve, jobs, interruption, report)
    elif executor is not None:
        yield from _in_processes(solve, jobs, interruption, report, executor, None)
    else:
        made = ProcessPoolExecutor(min(workers, len(jobs)), mp_context=get_context("spawn"))
        with _sharing() as shared, made:
            yield from _in_processes(solve, jobs, interruption, report, made, shared)


def _monitor(
    job: Job, starts: int, done: int, report: Report | None, stop: Callable[[], bool], every: float = 0.0
) -> Monitor:
    """Reports an iteration, and returns whether to stop, once in `every` seconds."""
    last = time.monotonic()

    def monitor(iteration: int, objective: float, violation: float) -> bool:
        nonlocal last
        if time.monotonic() - last < every:
            return False
        last = time.monotonic()
        if report is not None:
            report(SearchProgress(job.number, starts, done, iteration, objective, violation, job.name))
        return stop()

    return monitor


def _in_this_process(
    solve: Solve[J, T], jobs: Sequence[J], interruption: Interruption, report: Report | None
) -> Generator[T]:
    for done, job in enumerate(jobs):
        if interruption.received:
            return
        yield solve(job, _monitor(job, len(jobs), done, report, lambda: interruption.received))


# Other processes ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Shared:
    """Proxies of what processes share: a queue of their reports, and an event that stops them."""

    reports: Any
    stop: Any


def _ignore_interrupts() -> None:
    """Leave Ctrl-C, which every process of a terminal receives, to the one that waits."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _sharing() -> Iterator[_Shared]:
    """The shared queue and event of a block; raises RuntimeError where no process can be started."""
    manager = SyncManager(ctx=get_context("spawn"))
    try:
        manager.start(_ignore_interrupts)
    except EOFError as error:
        raise RuntimeError(ENDED_EARLY) from error
    try:
        yield _Shared(manager.Queue(), manager.Event())
    finally:
        manager.shutdown()


@lru_cache(maxsize=1)
def unpickled(solve: bytes) -> Any:
    """The pickled function; kept, so that what its object builds for the first start serves the later ones."""
    return pickle.loads(solve)


def _work(solve: bytes, job: Job, starts: int, shared: _Shared | None) -> Any:
    """Solve one start in another process; None where the search was stopped before."""
    _ignore_interrupts()
    if shared is not None and shared.stop.is_set():
        return None
    monitor = None if shared is None else _monitor(job, starts, 0, shared.reports.put, shared.stop.is_set, POLL)
    with one_thread():
        return unpickled(solve)(job, monitor)


def _in_processes(
    solve: Solve[J, T],
    jobs: Sequence[J],
    interruption: Interruption,
    report: Report | None,
    executor: Executor,
    shared: _Shared | None,
) -> Generator[T]:
    data, done = pickle.dumps(solve), 0
    waiting: set[Future[T | None]] = {executor.submit(_work, data, job, len(jobs), shared) for job in jobs}
    try:
        while waiting:
            ended, waiting = wait(waiting, timeout=POLL, return_when=FIRST_COMPLETED)
            for progress in _reports(shared):
                if report is not None:
                    report(replace(progress, done=done))
            for result in (future.result() for future in ended):
                if result is not None:
                    done += 1
                    yield result
            if interruption.received:
                waiting = {future for future in waiting if not future.cancel()}
                if shared is None:
                    return
                shared.stop.set()
    except BrokenProcessPool as error:
        raise RuntimeError(ENDED_EARLY) from error
    finally:
        for future in waiting:
            future.cancel()
        if shared is not None and waiting:
            shared.stop.set()


def _reports(shared: _Shared | None) -> Iterator[SearchProgress]:
    while shared is not None:
        try:
            yield shared.reports.get_nowait()
        except queue.Empty:
            return
