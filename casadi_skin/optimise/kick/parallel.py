"""Starts of the smallest kick in other processes: what they are sent, and what they tell while they last."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import lru_cache

import numpy as np

from casadi_skin.optimise.kick.search import Ended, KickProgress, KickSearch, StopRequestError
from casadi_skin.optimise.processes import POLL, Interruption, Shared, gathered, ignore_interrupts, pool, sharing
from casadi_skin.theory.linear import Array
from casadi_skin.threads import one_thread


def in_processes(
    search: KickSearch, named: Sequence[tuple[str, Array]], workers: int, executor: Executor | None
) -> Generator[Ended]:
    """What the directions lead to, as they end; after an interruption those that had begun, then KeyboardInterrupt.

    An executor of the user's is not waited for then: it ends by itself what it has begun.
    """
    interruption = Interruption()
    with interruption.listening():
        if executor is not None:
            yield from _submitted(search, named, executor, interruption, None)
        else:
            with sharing() as shared, pool(workers, len(named)) as made:
                yield from _submitted(search, named, made, interruption, shared)
    if interruption.heard:
        raise KeyboardInterrupt


def sent(search: KickSearch) -> bytes:
    """A search in arrays and numbers, pickled once for all its starts."""
    return pickle.dumps((search.flow, search.distance, search.basis, search.scale, search.starts))


@lru_cache(maxsize=1)
def received(search: bytes) -> KickSearch:
    """The search in another process, which builds its programme for the first start and keeps it for later ones."""
    flow, distance, basis, scale, starts = pickle.loads(search)
    return KickSearch(flow, distance, basis, scale, starts, None)


def _work(search: bytes, number: int, name: str, direction: Array, shared: Shared | None) -> Ended | None:
    """Follow one start; None where the search was stopped before."""
    ignore_interrupts()
    if shared is not None and shared.stop.is_set():
        return None
    here = received(search)
    here.progress = None if shared is None else _monitor(shared)
    with one_thread():
        return here.follow(number, name, direction)


def _monitor(shared: Shared) -> Callable[[KickProgress], None]:
    """Tells of iterations now and then, and hears whether the search is to stop."""
    told = time.monotonic()

    def monitor(progress: KickProgress) -> None:
        nonlocal told
        if time.monotonic() - told >= POLL:
            told = time.monotonic()
            shared.told.put(progress)
            if shared.stop.is_set():
                raise StopRequestError

    return monitor


def _submitted(
    search: KickSearch,
    named: Sequence[tuple[str, Array]],
    executor: Executor,
    interruption: Interruption,
    shared: Shared | None,
) -> Iterator[Ended]:
    whole = sent(search)
    futures = {executor.submit(_work, whole, n, name, d, shared) for n, (name, d) in enumerate(named, start=1)}
    for one in gathered(futures, interruption, shared, lambda progress: _report(search, progress), shared is None):
        if one is not None:
            search.tried += 1
            yield one
            _report(search, _end_of(one, search))


def _report(search: KickSearch, progress: KickProgress) -> None:
    if search.progress is not None:
        search.progress(replace(progress, done=search.done))


def _end_of(one: Ended, search: KickSearch) -> KickProgress:
    """What is told at the end of a start."""
    last = one.start if one.found is None else one.found
    norm, violation, iterations = np.inf, np.inf, 0
    if last is not None:
        norm, violation, iterations = float(np.sqrt(search.flow.orbit.S)) * last.norm, last.violation, last.iterations
    return KickProgress(one.number, search.starts, one.name, iterations, norm, violation, search.done)
