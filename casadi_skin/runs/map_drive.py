"""Driving a map: batches of cells, each task tried twice, every result in the journal before anything else happens."""

from __future__ import annotations

import errno
import math
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import short_repr, whole
from casadi_skin.model.interrupts import interrupts_deferred
from casadi_skin.runs.map_grid import FAILED as FAULT
from casadi_skin.runs.map_grid import LOST, Cells, Grid, Result, Task
from casadi_skin.runs.map_store import ATTEMPTS, DONE, FAILED, UNKNOWN, Store
from casadi_skin.runs.map_watch import UNKNOWN as UNLABELLED
from casadi_skin.runs.map_watch import needed
from casadi_skin.runs.pool import end_workers
from casadi_skin.runs.progress import Progress

# Engines that compute cells: threads of this process with a worker each, a dask cluster, or any executor --------------

AHEAD = 3  # tasks a worker that are handed over before they are begun
GIVEN = 64  # workers of an executor without a public number of workers
CONNECT_LIMIT = 10.0  # seconds until a scheduler answers
MOST_WORKERS = 256
ASK = 5.0  # seconds between two questions about the workers of a cluster


@dataclass(frozen=True)
class Engine:
    """An executor of tasks.

    Attributes:
        executor: the executor itself.
        workers: how many tasks it computes at the same time, queried repeatedly.
        lost: reason why it takes no more tasks; empty while it does.
        close: ends it.
    """

    executor: Executor
    workers: Callable[[], int]
    lost: Callable[[], str]
    close: Callable[[], None]

    def width(self) -> int:
        """Number of tasks handed over at the same time."""
        return max(self.workers(), 1) + AHEAD * max(self.workers(), 1)


def local_engine(workers: int) -> Engine:
    """Worker processes on this machine."""
    executor = ThreadPoolExecutor(workers, thread_name_prefix="map")

    def close() -> None:
        executor.shutdown(wait=False, cancel_futures=True)
        end_workers()
        executor.shutdown(wait=True)

    return Engine(executor, lambda: workers, lambda: "", close)


def dask_engine(address: str) -> Engine:
    """A dask cluster; raises ImportError, naming the extra, and OSError where no scheduler answers."""
    try:
        import distributed
    except ImportError as error:
        raise ImportError(
            'dask is not installed; it comes with the extra: pip install "casadi-skin[cluster]"'
        ) from error
    try:
        client: Any = distributed.Client(address, timeout=CONNECT_LIMIT, set_as_default=False)
    except OSError as error:
        words = f"no scheduler answers within {CONNECT_LIMIT:g} s ({' '.join(str(error).split())})"
        raise OSError(errno.ETIMEDOUT, words, address) from None
    known, requested = 0, -math.inf

    def workers() -> int:
        nonlocal known, requested
        if time.monotonic() - requested > ASK:
            found: dict[str, Any] = client.scheduler_info(n_workers=-1).get("workers", {})
            known, requested = sum(int(worker.get("nthreads", 1)) for worker in found.values()), time.monotonic()
        return known

    def lost() -> str:
        return "" if client.status == "running" else f"the scheduler at {address} is lost"

    return Engine(client.get_executor(pure=False), workers, lost, lambda: client.close(timeout=1.0))


def given_engine(executor: Executor) -> Engine:
    """An executor of the caller, who ends it; raises TypeError for other objects."""
    if not isinstance(executor, Executor):
        raise TypeError(f"executor: given {short_repr(executor)}; accepted: a concurrent.futures.Executor")
    count = getattr(executor, "_max_workers", None)
    workers = count if isinstance(count, int) else GIVEN

    def lost() -> str:
        return "the executor is broken" if getattr(executor, "_broken", False) else ""

    return Engine(executor, lambda: workers, lost, lambda: None)


def check_workers(name: str, workers: object) -> int:
    """The number of workers; raises ValueError for other values."""
    return whole(name, workers, 1, MOST_WORKERS)


LOOK = 1.0  # seconds between two looks at an engine
SHOW = 0.2  # seconds between two changes of the line of progress
TELL = 30.0  # seconds between two lines of progress where there is no terminal
Part = tuple[int, int]  # a share and the number of shares, the first being 1


@dataclass
class Drive:
    """A map on its way.

    Attributes:
        grid, store, engine: its cells, their results, the place of their computation.
        job: the part that all tasks share, encoded.
        cell_limit: seconds that a cell may take.
        part: the share that is computed here; None of a map that is computed here as a whole.
        workers: processes of this machine that take over from a lost engine.
    """

    grid: Grid
    store: Store
    engine: Engine
    job: bytes
    progress: Progress
    cell_limit: float | None = None
    part: Part | None = None
    workers: int = 1
    computed: int = 0
    _planned: int = 0
    _began: float = field(default_factory=time.monotonic)
    _told: float = field(default_factory=time.monotonic)
    _shown: float = -math.inf

    def run(self) -> bool:
        """Compute the missing cells; False where the share of another part is still to come."""
        seen = np.zeros(self.grid.size, dtype=bool)
        for batch in self._batches():
            seen[batch] = True
            self._planned += int(np.sum(~self.store.final(batch))) // (1 if self.part is None else self.part[1])
            self._compute(self._first(batch), 1)
            self.store.refresh()
            if np.any(self.store.attempts[batch] == 0):
                return False
            self._compute(self._again(batch, seen), ATTEMPTS)
        return True

    def _batches(self) -> Iterator[Cells]:
        """Cells to compute one batch after the other; a batch follows from the results of those before it alone."""
        if not self.grid.refined:
            yield self.grid.coarsest
            return
        shown = np.full(self.grid.shape, UNLABELLED, dtype=np.int32)
        while (batch := needed(self.grid, shown)).size:
            yield batch
            shown.flat[batch] = self.store.watch.labels.flat[batch]

    def _first(self, batch: Cells) -> Iterator[Task]:
        """Tasks of one's own share that are not computed."""
        for number, task in enumerate(self.grid.tasks(batch)):
            mine = self.part is None or number % self.part[1] == self.part[0] - 1
            if mine and self.store.attempts[task.cells[0]] == 0:
                yield task

    def _again(self, batch: Cells, seen: NDArray[np.bool_]) -> Iterator[Task]:
        """Tasks that failed once; one with a reason starts from the nearest neighbour's solution, where there is one.

        Neighbours are cells that were computed at their first attempt, so that all engines and resumed maps agree.
        """
        done = np.flatnonzero(seen & (self.store.states == DONE) & (self.store.attempts == 1))
        places = self.grid.places(done)
        for task in self.grid.tasks(batch):
            cell = task.cells[0]
            if self.store.states[cell] != FAILED or self.store.attempts[cell] >= ATTEMPTS:
                continue
            if self.store.record(cell).kind == FAULT and done.size:
                distances = np.abs(places - self.grid.places(np.array([cell]))).sum(axis=1)
                near = int(done[np.argmin(distances)])
                row = self.store.row(near)
                if row is not None and row.state:
                    task = msgspec.structs.replace(task, start=row.state, period=row.period, neighbour=near)
            yield task

    # Handing over -----------------------------------------------------------------------------------------------------

    def _compute(self, tasks: Iterable[Task], attempt: int) -> None:
        """Compute tasks, handed over a few at a time; where the engine is lost, workers of this machine take over."""
        left, waiting = iter(tasks), dict[Future[bytes], Task]()
        while True:
            for task in self._next(left, self.engine.width() - len(waiting)):
                future = self._submitted(task)
                if future is None:
                    self._keep(task, Result(kind=LOST, reason=self.engine.lost() or "no engine took it"), attempt)
                    self._take_over(waiting, attempt)
                else:
                    waiting[future] = task
            if not waiting:
                return
            ended, _ = wait(waiting, LOOK, FIRST_COMPLETED)
            for future in ended:
                self._keep(waiting.pop(future), _outcome(future, self.engine), attempt)
            if self.engine.lost():
                self._take_over(waiting, attempt)
            self._show()

    @staticmethod
    def _next(tasks: Iterator[Task], count: int) -> Iterator[Task]:
        for _ in range(count):
            task = next(tasks, None)
            if task is None:
                return
            yield task

    def _submitted(self, task: Task) -> Future[bytes] | None:
        from casadi_skin.runs.pool import compute

        limit = None if self.cell_limit is None else self.cell_limit * len(task.cells)
        try:
            return self.engine.executor.submit(compute, self.job, msgspec.msgpack.encode(task), limit)
        except Exception:  # whatever an engine that is lost raises
            if not self.engine.lost():
                raise
            return None

    def _take_over(self, waiting: dict[Future[bytes], Task], attempt: int) -> None:
        """Record the tasks under way on a lost engine, and go on with workers of this machine."""
        reason = self.engine.lost() or "the engine is lost"
        for task in waiting.values():
            self._keep(task, Result(kind=LOST, reason=reason), attempt)
        waiting.clear()
        self.progress.report(f"{reason}; {self.workers} worker(s) of this machine go on")
        with suppress(Exception):  # of an engine that is gone already
            self.engine.close()
        self.engine = local_engine(self.workers)

    def _keep(self, task: Task, result: Result, attempt: int) -> None:
        with interrupts_deferred():
            self.store.add(task, attempt, result)
        self.computed += len(task.cells)

    def _show(self) -> None:
        """The place of the map, and an estimate of the remaining time."""
        now = time.monotonic()
        if now - self._shown < SHOW:
            return
        self._shown, failed = now, int(np.sum(self.store.states == FAILED))
        left = max(self._planned - self.computed, 0)
        seconds = (now - self._began) / max(self.computed, 1)
        known = int(np.sum(self.store.states != UNKNOWN))
        of = f" of {self.grid.coarsest.size}" if not self.grid.refined else f", {left} to go before the next refinement"
        words = f"{known}{of} cells; {failed} failed; about {duration(seconds * left)} left"
        self.progress.say(words)
        if not self.progress.on_terminal and now - self._told > TELL:
            self._told = now
            self.progress.report(words)


def _outcome(future: Future[bytes], engine: Engine) -> Result:
    """The result of a task, or why the engine has none."""
    try:
        return msgspec.msgpack.decode(future.result(), type=Result)
    except BaseException as error:  # of an engine: cancelled, broken, a worker of it that was killed
        if isinstance(error, KeyboardInterrupt):
            raise
        words = " ".join(str(error).split()) or type(error).__name__
        return Result(kind=LOST, reason=engine.lost() or f"the engine lost it: {words}")


def duration(seconds: float) -> str:
    """A time in words."""
    for size, name in ((86400.0, "days"), (3600.0, "h"), (60.0, "min")):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {name}"
    return f"{seconds:.0f} s" if seconds >= 10 else f"{seconds:.2g} s"
