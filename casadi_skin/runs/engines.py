"""Engines that compute cells: threads of this process with a worker each, a dask cluster, or any executor.

Every engine runs the same function, `casadi_skin.runs.workers.compute`, whose worker is a process of its own.
"""

from __future__ import annotations

import errno
import math
import time
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from casadi_skin.model.arguments import short_repr, whole
from casadi_skin.runs.workers import end_workers

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
