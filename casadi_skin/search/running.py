"""Starts one after the other or in parallel processes, with progress, and Ctrl-C that keeps what was found."""

from __future__ import annotations

import multiprocessing
import pickle
import queue
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.managers import SyncManager
from types import FrameType
from typing import Any

from casadi_skin.arguments import shown
from casadi_skin.search.request import SearchRequest
from casadi_skin.search.starts import Outcome, Start, run_start
from casadi_skin.theory.linear import Array

POLL = 0.1  # seconds between two looks at what processes tell
ENDED_EARLY = 'search: a process ended early; in a script, parallel searches go below if __name__ == "__main__":'


@dataclass(frozen=True)
class SearchProgress:
    """Where a search is: start, its iteration, objective and largest violation; `done` of `starts` have ended."""

    start: int
    starts: int
    done: int
    iteration: int
    objective: float
    violation: float

    def __str__(self) -> str:
        return (
            f"start {self.start} of {self.starts} ({self.done} done), iteration {self.iteration}: "
            f"objective {self.objective:.8g}, violation {self.violation:.1e}"
        )


Report = Callable[[SearchProgress], None]


@dataclass(frozen=True)
class Job:
    """One start to be run: all that a process needs."""

    request: SearchRequest
    start: Start
    harmonics: int
    known: tuple[Array, ...] = ()


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


def check_executor(executor: object, workers: object, request: SearchRequest) -> None:
    """Raises TypeError or ValueError for an executor or a number of workers that cannot be used."""
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError(f"executor: given {shown(executor)}; accepted: a concurrent.futures.Executor of processes")
    if isinstance(executor, ThreadPoolExecutor):
        raise TypeError("executor: given a ThreadPoolExecutor; accepted: one of processes (CasADi shares no function "
                        "between threads)")  # fmt: skip
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ValueError(f"workers: given {shown(workers)}; accepted: a whole number >= 1")
    if executor is not None or workers > 1:
        try:
            pickle.dumps(request)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            words = " ".join(str(error).split())[:120]
            accepted = "names, or functions at the top of a module, where starts run in other processes"
            raise TypeError(f"objective and constraints: cannot be sent to a process ({words}); accepted: {accepted}"
                            ) from None  # fmt: skip


def run_jobs(
    jobs: Sequence[Job], interruption: Interruption, report: Report | None, workers: int, executor: Executor | None
) -> Iterator[Outcome]:
    """Outcomes of the jobs as they end; after an interruption those that had begun."""
    if executor is not None:
        yield from _in_executor(jobs, interruption, report, executor, None)
    elif workers == 1 or len(jobs) < 2:
        yield from _here(jobs, interruption, report)
    else:
        with sharing() as shared:
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(min(workers, len(jobs)), mp_context=context) as pool:
                yield from _in_executor(jobs, interruption, report, pool, shared)


def _here(jobs: Sequence[Job], interruption: Interruption, report: Report | None) -> Iterator[Outcome]:
    for done, job in enumerate(jobs):
        if interruption.heard:
            return

        def monitor(iteration: int, objective: float, violation: float, job: Job = job, done: int = done) -> bool:
            if report is not None:
                report(SearchProgress(job.start.number, len(jobs), done, iteration, objective, violation))
            return interruption.heard

        yield run_start(job.request, job.start, job.harmonics, job.known, monitor)


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
    manager = SyncManager(ctx=multiprocessing.get_context("spawn"))
    try:
        manager.start(ignore_interrupts)
    except EOFError as error:
        raise RuntimeError(ENDED_EARLY) from error
    try:
        yield Shared(manager.Queue(), manager.Event())
    finally:
        manager.shutdown()


def _work(job: Job, starts: int, shared: Shared | None) -> Outcome:
    """Run one start in a process of its own, which leaves Ctrl-C to the one that waits."""
    ignore_interrupts()
    if shared is None:
        return run_start(job.request, job.start, job.harmonics, job.known)
    told = time.monotonic()

    def monitor(iteration: int, objective: float, violation: float) -> bool:
        nonlocal told
        if time.monotonic() - told < POLL:
            return False
        told = time.monotonic()
        shared.told.put(SearchProgress(job.start.number, starts, 0, iteration, objective, violation))
        return bool(shared.stop.is_set())

    return run_start(job.request, job.start, job.harmonics, job.known, monitor)


def _in_executor(
    jobs: Sequence[Job], interruption: Interruption, report: Report | None, executor: Executor, shared: Shared | None
) -> Iterator[Outcome]:
    waiting: set[Future[Outcome]] = {executor.submit(_work, job, len(jobs), shared) for job in jobs}
    done = 0
    try:
        while waiting:
            ended, waiting = wait(waiting, timeout=POLL, return_when=FIRST_COMPLETED)
            for future in ended:
                done += 1
                yield future.result()
            if report is not None:
                for progress in _told(shared):
                    report(SearchProgress(progress.start, len(jobs), done, progress.iteration, progress.objective,
                                          progress.violation))  # fmt: skip
            if interruption.heard:
                waiting = {future for future in waiting if not future.cancel()}
                if shared is None:
                    return  # an executor of the user's ends what it has begun without us
                shared.stop.set()
    except BrokenProcessPool as error:
        raise RuntimeError(ENDED_EARLY) from error
    finally:
        for future in waiting:
            future.cancel()
        if shared is not None and waiting:
            shared.stop.set()


def _told(shared: Shared | None) -> Iterator[SearchProgress]:
    while shared is not None:
        try:
            yield shared.told.get_nowait()
        except queue.Empty:
            return
