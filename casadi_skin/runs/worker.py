"""The program of a worker: `python -m casadi_skin.runs.worker FD` computes the tasks that it reads from a socket.

It ends when whoever started it ends, however that comes about: the kernel kills it on Linux, elsewhere a thread does.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection

import msgspec

READY, BEGUN = b"ready", b"begun"
LOADED = (  # before the first cell, whose time is limited
    "casadi_skin.follow.series",
    "casadi_skin.lattice.chain_coordinates",
    "casadi_skin.follow.family_tongues",
    "casadi_skin.runs.first_solution",
    "casadi_skin.solve.ipopt",
    "casadi_skin.stability.splitting",
)
DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG
IDLE = 60.0  # seconds after which a worker without a task ends; the next task starts another
WATCH = 0.5  # seconds between two looks at the parent


def end_with(parent: int) -> None:
    """End this process when its parent does."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(DEATH_SIGNAL, signal.SIGKILL)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
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

    for name in LOADED:
        import_module(name)
    known, computer = b"", None
    connection.send_bytes(READY)
    with suppress(EOFError, OSError):
        while connection.poll(IDLE):
            job, task = connection.recv_bytes(), connection.recv_bytes()
            connection.send_bytes(BEGUN)
            if computer is None or job != known:
                known, computer = job, Computer(msgspec.msgpack.decode(job, type=Job))
            result = computer.compute(msgspec.msgpack.decode(task, type=Task))
            connection.send_bytes(msgspec.msgpack.encode(result))


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
