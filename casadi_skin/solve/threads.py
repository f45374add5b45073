"""Linear algebra on one thread: the matrices of an orbit are small, and threads that wait for each other cost more."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from functools import cache

from threadpoolctl import ThreadpoolController


@cache
def _controller() -> ThreadpoolController:
    import scipy.linalg  # noqa: F401  has a BLAS of its own, which has to be loaded to be found

    return ThreadpoolController()


def one_thread() -> AbstractContextManager[object]:
    """While it lasts, BLAS and OpenMP of this process use one thread; then as many as before.

    Families of N = 24 took 1.3 times as long with two threads on two idle cores, and 10 times on busy ones.
    """
    pools = _controller()
    if all(pool.num_threads == 1 for pool in pools.lib_controllers):  # inside of another such block
        return nullcontext()
    limited: AbstractContextManager[object] = pools.limit(limits=1)
    return limited
