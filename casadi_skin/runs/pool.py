"""Processes that compute cells of a map; one that ends or hangs leaves the others alone."""

from __future__ import annotations

import atexit
import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection, Pipe
from pathlib import Path

import msgspec

import casadi_skin
from casadi_skin.runs.map_grid import DIED, LATE, Result

# The program of a worker: `python -m casadi_skin.runs.pool FD` computes the tasks that it reads from a socket -------

READY, BEGUN = b"ready", b"begun"
LOADED_MODULES = (  # before the first cell, whose time is limited
    "casadi_skin.follow.series",
    "casadi_skin.lattice.chain_coordinates",
    "casadi_skin.follow.family_tongues",
    "casadi_skin.runs.first_solution",
    "casadi_skin.solve.ipopt",
    "casadi_skin.stability.splitting",
)
DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG
IDLE_SECONDS = 60.0  # seconds after which a worker without a task ends; the next task starts another
WATCH_SECONDS = 0.5  # seconds between two looks at the parent


def end_with(parent: int) -> None:
    """End this process when its parent does."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(DEATH_SIGNAL, signal.SIGKILL)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH_SECONDS)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def main(descriptor: int, parent: int) -> None:
    """Compute tasks until the socket is closed, or none comes."""
    end_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the process that waits
    sys.stdout = sys.stderr = open(os.devnull, "w")  # noqa: SIM115  nobody reads the output of a model
    connection = Connection(descriptor)
    from casadi_skin.runs.map_cell import Computer, Job
    from casadi_skin.runs.map_grid import Task

    for name in LOADED_MODULES:
        import_module(name)
    known, computer = b"", None
    connection.send_bytes(READY)
    with suppress(EOFError, OSError):
        while connection.poll(IDLE_SECONDS):
            job, task = connection.recv_bytes(), connection.recv_bytes()
            connection.send_bytes(BEGUN)
            if computer is None or job != known:
                known, computer = job, Computer(msgspec.msgpack.decode(job, type=Job))
            result = computer.compute(msgspec.msgpack.decode(task, type=Task))
            connection.send_bytes(msgspec.msgpack.encode(result))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))


# Worker processes, one for each thread that computes cells: one that ends or hangs leaves the others alone ------------

MOST_STARTS = 3  # of a worker that ends before it has taken a task
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
        for attempt in range(MOST_STARTS):
            try:
                connection = self._connected()
                connection.send_bytes(job)
                connection.send_bytes(task)
                if connection.recv_bytes() == BEGUN:
                    return connection
            except (EOFError, OSError):
                if attempt + 1 == MOST_STARTS:
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
                [sys.executable, "-m", "casadi_skin.runs.pool", str(there.fileno()), str(os.getpid())],
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
