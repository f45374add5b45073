"""Starts one after the other or in parallel processes, with progress, and Ctrl-C that keeps what was found."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace

from casadi_skin.arguments import short_repr
from casadi_skin.optimise.processes import POLL, Interruption, Shared, gathered, ignore_interrupts, pool, sharing
from casadi_skin.optimise.request import SearchRequest
from casadi_skin.optimise.starts import Outcome, Start, run_start
from casadi_skin.theory.linear import Array


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


def check_executor(executor: object, workers: object, request: SearchRequest) -> None:
    """Raises TypeError or ValueError for an executor or a number of workers that cannot be used."""
    if executor is not None and not isinstance(executor, Executor):
        raise TypeError(f"executor: given {short_repr(executor)}; accepted: a concurrent.futures.Executor of processes")
    if isinstance(executor, ThreadPoolExecutor):
        raise TypeError("executor: given a ThreadPoolExecutor; accepted: one of processes (CasADi shares no function "
                        "between threads)")  # fmt: skip
    if isinstance(workers, bool) or not isinstance(workers, int) or workers < 1:
        raise ValueError(f"workers: given {short_repr(workers)}; accepted: a whole number >= 1")
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
        with sharing() as shared, pool(workers, len(jobs)) as made:
            yield from _in_executor(jobs, interruption, report, made, shared)


def _here(jobs: Sequence[Job], interruption: Interruption, report: Report | None) -> Iterator[Outcome]:
    for done, job in enumerate(jobs):
        if interruption.heard:
            return

        def monitor(iteration: int, objective: float, violation: float, job: Job = job, done: int = done) -> bool:
            if report is not None:
                report(SearchProgress(job.start.number, len(jobs), done, iteration, objective, violation))
            return interruption.heard

        yield run_start(job.request, job.start, job.harmonics, job.known, monitor)


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
    done = 0

    def hear(told: SearchProgress) -> None:
        if report is not None:
            report(replace(told, starts=len(jobs), done=done))

    futures = {executor.submit(_work, job, len(jobs), shared) for job in jobs}
    for found in gathered(futures, interruption, shared, hear, shared is None):
        done += 1
        yield found
