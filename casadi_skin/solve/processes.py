"""Work shared by processes, which report on their way and end with the one that started them."""

from __future__ import annotations

import os
import pickle
import queue
import signal
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from multiprocessing import get_context, parent_process
from multiprocessing.managers import SyncManager
from types import FrameType
from typing import Any

from casadi_skin.model.arguments import function_of, short_repr, whole
from casadi_skin.solve.ipopt import Monitor
from casadi_skin.solve.watch import one_thread

POLL_SECONDS = 0.1  # seconds between two reports of a process
ENDED_EARLY = 'search: a process ended early; in a script, parallel searches go below if __name__ == "__main__":'


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
        where = f"{self.done} of {self.starts} starts done; start {self.start}{name}, iteration {self.iteration}"
        return f"{where}: objective {self.objective:.8g}, violation {self.violation:.1e}"


Report = Callable[[SearchProgress], None]
Solve = Callable[[Any, Monitor | None], Any]  # (start, monitor) -> outcome


class Runner:
    """Runs starts with `workers` processes or an `executor` of processes, and reports where it is.

    `interrupted` is true after SIGINT or SIGTERM; the second one interrupts at once. Raises TypeError or ValueError for
    processes that cannot be used.
    """

    def __init__(self, report: Report | None = None, workers: int = 1, executor: Executor | None = None) -> None:
        whole("workers", workers, 1)
        if isinstance(executor, ThreadPoolExecutor) or not isinstance(executor, Executor | None):
            accepted = "a concurrent.futures.Executor of processes (CasADi shares no function between threads)"
            raise TypeError(f"executor: given {short_repr(executor)}; accepted: {accepted}")
        function_of("progress", report, "a SearchProgress")
        self.report, self.workers, self.executor, self.interrupted = report, workers, executor, False

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Listen for signals inside the block, in the main thread, and keep linear algebra on one thread."""
        heeded = [n for n in (signal.SIGINT, signal.SIGTERM) if signal.getsignal(n) is not signal.SIG_IGN]
        main = threading.current_thread() is threading.main_thread()
        before = {n: signal.signal(n, self._receive) for n in heeded if main}
        try:
            with one_thread():
                yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler if handler is not None else signal.SIG_DFL)

    def run(self, solve: Solve, jobs: Sequence[Any]) -> Generator[Any]:
        """Outcomes of `solve(job, monitor)` as they end; after an interruption those of jobs that had begun.

        A job has a `number` and a `name`, an outcome its `start` and `last`: iterations, objective and violation.
        For other processes `solve` is a method of an object that can be pickled, or a partial of a function with one.
        An executor of the caller is not waited for after an interruption. Raises RuntimeError if a process ends early.
        """
        for done, ended in enumerate(self._ended(solve, jobs), start=1):
            yield ended
            if self.report is not None and not self.interrupted:
                iteration, objective, violation = ended.last
                where = (ended.start.number, len(jobs), done, iteration, objective, violation, ended.start.name)
                self.report(SearchProgress(*where))

    def _ended(self, solve: Solve, jobs: Sequence[Any]) -> Generator[Any]:
        if self.executor is not None:
            yield from self._elsewhere(solve, jobs, self.executor, None)
        elif self.workers > 1 and len(jobs) > 1:
            count = min(self.workers, len(jobs))
            made = ProcessPoolExecutor(count, mp_context=get_context("spawn"), initializer=_begin_process)
            with _sharing() as shared, made:
                yield from self._elsewhere(solve, jobs, made, shared)
        else:
            for done, job in enumerate(jobs):
                if self.interrupted:
                    return
                where = partial(SearchProgress, job.number, len(jobs), done, name=job.name)
                yield solve(job, _monitor(where, self.report, lambda: self.interrupted))

    def _elsewhere(
        self, solve: Solve, jobs: Sequence[Any], executor: Executor, shared: _Shared | None
    ) -> Generator[Any]:
        data, done = pickle.dumps(solve), 0
        waiting: set[Future[Any]] = {executor.submit(_work, data, job, len(jobs), shared) for job in jobs}
        try:
            while waiting:
                ended, waiting = wait(waiting, timeout=POLL_SECONDS, return_when=FIRST_COMPLETED)
                for progress in _reports(shared):
                    if self.report is not None:
                        self.report(replace(progress, done=done))
                for result in (future.result() for future in ended):
                    if result is not None:
                        done += 1
                        yield result
                if self.interrupted:
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


def _monitor(
    where: Callable[..., SearchProgress], report: Report | None, stop: Callable[[], bool], every: float = 0.0
) -> Monitor:
    """Reports an iteration, and returns whether to stop, once in `every` seconds."""
    last = time.monotonic()

    def monitor(iteration: int, objective: float, violation: float) -> bool:
        nonlocal last
        if time.monotonic() - last < every:
            return False
        last = time.monotonic()
        if report is not None:
            report(where(iteration, objective, violation))
        return stop()

    return monitor


# Other processes ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Shared:
    """Proxies that processes share: a queue of their reports, and an event that stops them."""

    reports: Any
    stop: Any


def _begin_process() -> None:
    """Prepare a new process: it ends with its parent, also where that is killed."""
    _ignore_interrupts()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _ignore_interrupts() -> None:
    """Leave Ctrl-C, which every process of a terminal receives, to the one that waits."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _sharing() -> Iterator[_Shared]:
    """The shared queue and event of a block; raises RuntimeError where no process can be started."""
    manager = SyncManager(ctx=get_context("spawn"))
    try:
        manager.start(_begin_process)
    except EOFError as error:
        raise RuntimeError(ENDED_EARLY) from error
    with manager:
        yield _Shared(manager.Queue(), manager.Event())


@lru_cache(maxsize=1)
def unpickled(solve: bytes) -> Any:
    """The pickled function; kept, so that later starts use the functions that its object built for the first one."""
    return pickle.loads(solve)


def _work(solve: bytes, job: Any, starts: int, shared: _Shared | None) -> Any:
    """Solve one start in another process; None where the search was stopped before."""
    _ignore_interrupts()
    if shared is not None and shared.stop.is_set():
        return None
    where = partial(SearchProgress, job.number, starts, 0, name=job.name)
    monitor = None if shared is None else _monitor(where, shared.reports.put, shared.stop.is_set, POLL_SECONDS)
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # they would be printed by a worker process
        return unpickled(solve)(job, monitor)


def _reports(shared: _Shared | None) -> Iterator[SearchProgress]:
    while shared is not None:
        try:
            yield shared.reports.get_nowait()
        except queue.Empty:
            return
