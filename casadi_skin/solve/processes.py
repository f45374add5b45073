"""Work shared by worker processes, which report on their way and end with the process that started them.

A worker computes one task at a time, and one that ends or hangs leaves the others alone: cells of maps and starts of
searches run in them alike. Parent and worker talk over a pipe: the function, pickled, READY, the task, reports on the
way, STOP from the parent, and the outcome.
"""

from __future__ import annotations

import atexit
import ctypes
import math
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
import warnings
import weakref
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from multiprocessing import connection as connections
from multiprocessing import process, spawn
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import IO, Any

import casadi_skin
from casadi_skin.model.arguments import function_of, short_repr, whole
from casadi_skin.model.interrupts import ENDING, end_group, heeded
from casadi_skin.solve.ipopt import Monitor
from casadi_skin.solve.watch import one_thread

# The program of a worker ----------------------------------------------------------------------------------------------

PROGRAM = "from casadi_skin.solve.processes import serve; serve({})"
READY, STOP = b"ready", b"stop"
REPORT, OUTCOME, ERROR = range(3)  # kinds of messages of a worker on its task
DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG
IDLE_SECONDS = 60.0  # seconds after which a worker without a task ends; the next task starts another
KIND = getattr(connections, "PipeConnection", connections.Connection)  # of an end of a pipe: the first on Windows
Tell = Callable[[Any], None]


def serve(handle: int) -> None:
    """Compute tasks until the connection is closed, or none comes."""
    _end_with_parent()
    for number in {*ENDING} - {signal.SIGTERM}:
        signal.signal(number, signal.SIG_IGN)  # Ctrl-C, or the end of a terminal, reaches the process that waits
    connection = KIND(handle)
    main = connection.recv()
    if main is not None:
        _import_main(main)
    told_to_stop = False

    def stopped() -> bool:
        nonlocal told_to_stop
        while connection.poll():
            told_to_stop |= connection.recv_bytes() == STOP
        return told_to_stop

    with suppress(EOFError, OSError):
        while connection.poll(IDLE_SECONDS):
            data = connection.recv_bytes()
            if data == STOP:  # of a task that had ended
                continue
            function, told_to_stop = unpickled(data), False
            connection.send_bytes(READY)
            task = connection.recv()
            try:
                with one_thread(), warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # a worker would print them
                    answer = OUTCOME, function(task, lambda words: connection.send((REPORT, words)), stopped)
            except Exception as error:  # it is raised where the task came from
                answer = ERROR, error
            connection.send(answer)


def _end_with_parent() -> None:
    """End this process when its parent does, which holds the other end of what is its standard input until here."""
    with suppress(OSError, AttributeError, TypeError):  # TypeError: on Windows
        ctypes.CDLL(None).prctl(DEATH_SIGNAL, signal.SIGKILL)
    held, nothing = os.dup(0), os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)

    def watch() -> None:
        os.read(held, 1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _import_main(data: dict[str, Any]) -> None:
    """Import the script of the parent, of which a task may have functions; it starts no workers meanwhile."""
    this: Any = process.current_process()
    this._inheriting = True
    try:
        spawn.prepare(data)
    finally:
        del this._inheriting


@lru_cache(maxsize=1)
def unpickled(function: bytes) -> Any:
    """The pickled function; kept, so that later tasks use the functions that its object built for the first one."""
    return pickle.loads(function)


# Workers --------------------------------------------------------------------------------------------------------------

MOST_STARTS = 3  # of a worker that ends before it has taken a task
START_LIMIT = 120.0  # seconds until a worker is there
POLL_SECONDS = 0.1  # seconds between two looks at what stops a task, and between two of its reports
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_here = threading.local()
_all: weakref.WeakSet[Worker] = weakref.WeakSet()


class WorkerEndedError(RuntimeError):
    """A worker ended, or none could be started: the message says how."""


class Worker:
    """A process that computes one task at a time, started with the first one.

    With `main` it imports the script of this process, of which tasks may have functions then. With `group` those that a
    task forks end with it, too, but it is not suspended with this process.
    """

    def __init__(self, main: bool = False, group: bool = False) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self._connection: connections.Connection | None = None
        self._stderr: IO[bytes] | None = None
        self._main, self._group = main, group
        self.exit_code: int | None = None  # of a process that ended by itself
        self._closed, self._starting = False, threading.Lock()
        _all.add(self)

    def compute(
        self,
        function: bytes,
        task: Any,
        limit: float | None = None,
        report: Tell | None = None,
        stop: threading.Event | None = None,
    ) -> Any:
        """The outcome of the pickled `function(task, tell, stopped)` of a task.

        Raises WorkerEndedError where it ends its process, TimeoutError where it takes longer than the limit, and what
        the function raises.
        """
        try:
            self._given(function, task)
            kind, value = self._answer(limit, report, stop)
        except BaseException as error:
            if isinstance(error, EOFError | OSError) and not isinstance(error, TimeoutError):
                raise WorkerEndedError(self._how_it_ended(error)) from error
            self.end()  # too late, interrupted, or a task that cannot be pickled: the process awaits something else
            raise
        if kind == ERROR:
            raise value
        return value

    def _answer(self, limit: float | None, report: Tell | None, stop: threading.Event | None) -> tuple[int, Any]:
        """The outcome of a task that was taken, or what it raised."""
        connection = self._connected()
        end = math.inf if limit is None else time.monotonic() + limit
        while True:
            left = max(end - time.monotonic(), 0.0)
            if connection.poll(None if stop is None and limit is None else min(left, POLL_SECONDS)):
                kind, value = connection.recv()
                if kind != REPORT:
                    return kind, value
                if report is not None:
                    report(value)
            elif left == 0.0:
                raise TimeoutError(f"took longer than {limit:g} s")
            elif stop is not None and stop.is_set():
                connection.send_bytes(STOP)
                stop = None

    def _given(self, function: bytes, task: Any) -> None:
        """Hand a task to the process; raises EOFError or OSError where none takes it."""
        for attempt in range(MOST_STARTS):
            try:
                connection = self._connected()
                connection.send_bytes(function)
                if not connection.poll(START_LIMIT) or connection.recv_bytes() != READY:
                    raise EOFError
                connection.send(task)
                return
            except (EOFError, OSError):
                if self._closed or attempt + 1 == MOST_STARTS:
                    raise
                self.end()

    def _connected(self) -> connections.Connection:
        if self._connection is not None:
            return self._connection
        here, there = connections.Pipe()
        package = str(Path(casadi_skin.__file__).parents[1])
        paths = [package, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
        main = None
        if self._main:
            main = {k: v for k, v in spawn.get_preparation_data("worker").items() if k != "authkey"}
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115  closed by `end`
        with there, self._starting:
            if self._closed:
                raise EOFError("its pool is closed")
            self.process = subprocess.Popen(
                [sys.executable, "-c", PROGRAM.format(there.fileno())], stdin=subprocess.PIPE, stderr=self._stderr,
                process_group=0 if self._group else None, **_inherited(there.fileno()),
                env={**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(paths)},
            )  # fmt: skip
        here.send(main)
        self._connection = here
        return here

    def _how_it_ended(self, error: BaseException) -> str:
        """Reason why there is no result, in words; the rest of the process ends."""
        if self.process is None or self._stderr is None:
            return f"no worker could be started ({error})"
        code, last = None, ""
        with suppress(subprocess.TimeoutExpired):
            code = self.exit_code = self.process.wait(1.0)
            self._stderr.seek(0)
            said = self._stderr.read().decode(errors="replace").split("\n")
            last = next((line.strip() for line in reversed(said) if line.strip()), "")
        self.end()
        how = "" if code is None else f" by signal {-code}" if code < 0 else f" with status {code}"
        return f"its worker ended{how}{': ' + last if last else ''}"

    def close(self) -> None:
        """End the process from any thread: its task raises WorkerEndedError, and no other process is started.

        The connection is left to the thread that reads it: a poll of one that is closed elsewhere may wake nobody.
        """
        with self._starting:
            self._closed = True
            if (process := self.process) is not None:
                process.kill()

    def end(self) -> None:
        """End the process, in the thread that gives it tasks; the next task starts another."""
        ended, self.process = self.process, None
        if ended is not None:
            assert ended.stdin is not None
            ended.stdin.close()
            end_group(ended) if self._group else ended.kill()
            ended.wait()
        for held in (self._connection, self._stderr):
            if held is not None:
                held.close()
        self._connection = self._stderr = None


def _inherited(handle: int) -> dict[str, Any]:
    """What gives a new process an end of a pipe too."""
    if sys.platform == "win32":
        os.set_handle_inheritable(handle, True)
        return {"startupinfo": subprocess.STARTUPINFO(lpAttributeList={"handle_list": [handle]})}
    return {"pass_fds": (handle,)}


def in_worker(function: bytes, task: Any, *options: Any) -> Any:
    """The outcome of a task, computed by the worker of this thread; see `Worker.compute`."""
    worker = getattr(_here, "worker", None)
    if worker is None:
        worker = _here.worker = Worker()
    return worker.compute(function, task, *options)


@atexit.register
def end_workers() -> None:
    """End the workers of all threads of this process."""
    for worker in list(_all):
        worker.close()
        worker.end()


class Pool(ThreadPoolExecutor):
    """Worker processes on this machine, one for each thread, in which tasks call `in_worker`."""

    def __init__(self, workers: int, main: bool = False) -> None:
        self._workers = list[Worker]()

        def begin() -> None:
            _here.worker = Worker(main)
            self._workers.append(_here.worker)

        super().__init__(workers, "casadi_skin", begin)

    def close(self) -> None:
        """End all workers, and what they compute."""
        self.shutdown(wait=False, cancel_futures=True)
        for worker in self._workers:
            worker.close()
        self.shutdown(wait=True)
        for worker in self._workers:
            worker.end()


# Searches: starts shared by workers -----------------------------------------------------------------------------------

ENDED_EARLY = "search: a process ended early ({}); in a script, parallel searches go below if __name__ == '__main__':"


@dataclass(frozen=True)
class SearchProgress:
    """Where a search is: a start, its iteration, objective and largest violation; `done` starts have ended.

    An iteration is one of Ipopt, where the end of every start is reported as well, with an infinite objective where it
    found nothing; or a design, whose parameters are in `name`.
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

    `interrupted` is true after SIGINT, SIGTERM or SIGHUP; the second one interrupts at once. Raises TypeError or
    ValueError for processes that cannot be used. A start that ends two workers by a signal has the outcome `lost` of
    itself and of how they ended; without `lost` it ends the search.
    """

    def __init__(
        self,
        report: Report | None = None,
        workers: int = 1,
        executor: Executor | None = None,
        lost: Callable[[Any, str], Any] | None = None,
    ) -> None:
        whole("workers", workers, 1)
        if isinstance(executor, ThreadPoolExecutor) or not isinstance(executor, Executor | None):
            accepted = "a concurrent.futures.Executor of processes (CasADi shares no function between threads)"
            raise TypeError(f"executor: given {short_repr(executor)}; accepted: {accepted}")
        function_of("progress", report, "a SearchProgress")
        self.report, self.workers, self.executor, self.interrupted = report, workers, executor, False
        self._lost = lost

    def _receive(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted:
            raise KeyboardInterrupt
        self.interrupted = True

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Listen for signals inside the block, in the main thread, and keep linear algebra on one thread."""
        before = {n: signal.signal(n, self._receive) for n in heeded()}
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
        An executor of the caller is not waited for after an interruption. Raises WorkerEndedError if one ends early.
        """
        for done, ended in enumerate(self._ended(solve, jobs), start=1):
            yield ended
            if self.report is not None and not self.interrupted:
                iteration, objective, violation = ended.last
                where = (ended.start.number, len(jobs), done, iteration, objective, violation, ended.start.name)
                self.report(SearchProgress(*where))

    def _ended(self, solve: Solve, jobs: Sequence[Any]) -> Generator[Any]:
        function, many = partial(_solved, solve, len(jobs)), len(jobs)
        if self.executor is not None:
            data = pickle.dumps(function)
            yield from self._elsewhere({self.executor.submit(_in_executor, data, job) for job in jobs})
        elif self.workers > 1 and many > 1:
            data, reports, stop = pickle.dumps(function), SimpleQueue[SearchProgress](), threading.Event()
            pool = Pool(min(self.workers, many), main=True)
            try:
                waiting = {pool.submit(_in_pool, data, job, self._lost, reports.put, stop) for job in jobs}
                yield from self._elsewhere(waiting, reports, stop)
            finally:
                pool.close()
        else:
            for done, job in enumerate(jobs):
                if self.interrupted:
                    return
                yield function(job, self.report, lambda: self.interrupted, done, 0.0)

    def _elsewhere(
        self,
        waiting: set[Future[Any]],
        reports: SimpleQueue[SearchProgress] | None = None,
        stop: threading.Event | None = None,
    ) -> Generator[Any]:
        """Outcomes of starts in other processes, which report and can be stopped where these are of our own."""
        done = 0
        try:
            while waiting:
                ended, waiting = wait(waiting, timeout=POLL_SECONDS, return_when=FIRST_COMPLETED)
                with suppress(Empty):
                    while reports is not None:
                        progress = replace(reports.get_nowait(), done=done)
                        if self.report is not None:
                            self.report(progress)
                for result in (future.result() for future in ended):
                    if result is not None:
                        done += 1
                        yield result
                if self.interrupted:
                    waiting = {future for future in waiting if not future.cancel()}
                    if stop is None:
                        return
                    stop.set()
        except (BrokenProcessPool, WorkerEndedError) as error:
            raise WorkerEndedError(ENDED_EARLY.format(error)) from error
        finally:
            for future in waiting:
                future.cancel()


def _solved(
    solve: Solve, starts: int, job: Any, tell: Tell | None, stopped: Callable[[], bool], done: int = 0,
    every: float = POLL_SECONDS,
) -> Any:  # fmt: skip
    """Solve a start; its iterations are reported, and stopped, once in `every` seconds."""
    last = time.monotonic()

    def monitor(iteration: int, objective: float, violation: float) -> bool:
        nonlocal last
        if time.monotonic() - last < every:
            return False
        last = time.monotonic()
        if tell is not None:
            tell(SearchProgress(job.number, starts, done, iteration, objective, violation, job.name))
        return stopped()

    return solve(job, monitor)


def _in_pool(
    function: bytes, job: Any, lost: Callable[[Any, str], Any] | None, report: Tell, stop: threading.Event
) -> Any:
    """Solve one start in the worker of this thread; None where the search was stopped before.

    One whose worker ends by a signal, as where memory is short, is solved once more.
    """
    words, attempts = "", 2
    while attempts and not stop.is_set():
        try:
            return in_worker(function, job, None, report, stop)
        except WorkerEndedError as error:
            if (_here.worker.exit_code or 0) >= 0 or lost is None:
                raise
            words, attempts = str(error), attempts - 1
    return lost(job, words) if lost is not None and words else None


def _in_executor(function: bytes, job: Any) -> Any:
    """Solve one start in a process of the caller's."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with one_thread(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return unpickled(function)(job, None, bool)
