"""Worker processes, one for each thread that computes cells: one that ends or hangs leaves the others alone.

The same on every engine: a cell is computed in a process of its own kind, with one thread of linear algebra, so that
its numbers do not depend on what started it.
"""

from __future__ import annotations

import atexit
import os
import subprocess
import sys
import threading
import time
import weakref
from multiprocessing.connection import Connection, Pipe
from pathlib import Path

import msgspec

import casadi_skin
from casadi_skin.runs.map_records import DIED, LATE, Result
from casadi_skin.runs.worker import BEGUN, READY

STARTS = 3  # of a worker that ends before it has taken a task
START_LIMIT = 120.0  # seconds until a worker is there
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

_here = threading.local()
_all: weakref.WeakSet[Worker] = weakref.WeakSet()


class Worker:
    """A process that computes one task at a time, started with the first one."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection | None = None
        _all.add(self)

    def compute(self, job: bytes, task: bytes, limit: float | None) -> bytes:
        """The encoded result of a task; of one that ends its process or takes longer than the limit the reason."""
        started = time.perf_counter()
        try:
            connection = self._given(job, task)
            if not connection.poll(limit):
                self.end()
                return _fault(LATE, f"took longer than {limit:g} s", started)
            return connection.recv_bytes()
        except (EOFError, OSError) as error:
            return _fault(DIED, self._how_it_ended(error), started)

    def _given(self, job: bytes, task: bytes) -> Connection:
        """The connection to a worker that has taken the task; raises EOFError or OSError where none does."""
        for attempt in range(STARTS):
            try:
                connection = self._connected()
                connection.send_bytes(job)
                connection.send_bytes(task)
                if connection.recv_bytes() == BEGUN:
                    return connection
            except (EOFError, OSError):
                if attempt + 1 == STARTS:
                    raise
                self.end()
        raise EOFError

    def _connected(self) -> Connection:
        if self._connection is not None:
            return self._connection
        here, there = Pipe()
        package = str(Path(casadi_skin.__file__).parents[1])
        paths = [package, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
        with there:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "casadi_skin.runs.worker", str(there.fileno()), str(os.getpid())],
                pass_fds=(there.fileno(),), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE, env={**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(paths)},
            )  # fmt: skip
        if not here.poll(START_LIMIT) or here.recv_bytes() != READY:
            raise EOFError
        self._connection = here
        return here

    def _how_it_ended(self, error: BaseException) -> str:
        """Reason why there is no result, in words; the rest of the process ends."""
        process = self._process
        if process is None:
            return f"no worker could be started ({error})"
        try:
            code = process.wait(1.0)
            said = process.stderr.read().decode(errors="replace").split("\n") if process.stderr is not None else []
        except subprocess.TimeoutExpired:
            code, said = None, []
        self.end()
        last = next((line.strip() for line in reversed(said) if line.strip()), "")
        how = "" if code is None else f" by signal {-code}" if code < 0 else f" with status {code}"
        return f"its worker ended{how}{': ' + last if last else ''}"

    def end(self) -> None:
        """End the process; the next task starts another."""
        process, connection, self._process, self._connection = self._process, self._connection, None, None
        if process is not None:
            process.kill()
            process.wait()
            if process.stderr is not None:
                process.stderr.close()
        if connection is not None:
            connection.close()


def compute(job: bytes, task: bytes, limit: float | None) -> bytes:
    """The encoded result of a task, computed by the worker of this thread: the function that every engine runs."""
    worker = getattr(_here, "worker", None)
    if worker is None:
        worker = _here.worker = Worker()
    found: bytes = worker.compute(job, task, limit)
    return found


def end_workers() -> None:
    """End the workers of all threads of this process."""
    for worker in list(_all):
        worker.end()


atexit.register(end_workers)


def _fault(kind: str, reason: str, started: float) -> bytes:
    return msgspec.msgpack.encode(Result(kind=kind, reason=reason, seconds=time.perf_counter() - started))
