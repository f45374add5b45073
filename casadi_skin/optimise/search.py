"""Orbits found by optimisation: an objective, bounds and free parameters added to the orbit problem."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np

from casadi_skin.arguments import short_repr
from casadi_skin.lattice.chain import Chain
from casadi_skin.optimise.polish import finished
from casadi_skin.optimise.processes import Interruption
from casadi_skin.optimise.request import Quantity, SearchRequest, search_request
from casadi_skin.optimise.result import Optimum, SearchResult, SearchStatus
from casadi_skin.optimise.running import Job, Report, SearchProgress, check_executor, run_jobs
from casadi_skin.optimise.search_nlp import VIOLATION, programme
from casadi_skin.optimise.starts import (
    Ending,
    Outcome,
    Start,
    family_orbits,
    first_harmonics,
    outcome,
    packed,
    same_place,
    sample_starts,
)
from casadi_skin.threads import one_thread

NEAREST = 4  # starts from which the orbit nearest to the constraints is looked for
STARTS = 8


def search_chain(
    chain: Chain,
    *,
    objective: Quantity,
    free: Sequence[str],
    bounds: Mapping[str, Any] | None = None,
    constraints: Sequence[Any] = (),
    maximise: bool = False,
    mode: int | str | None = None,
    S: float | Sequence[float] = 1.0,
    starts: int = STARTS,
    seed: int = 0,
    tolerance: float = 1e-8,
    deflate: bool = False,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Report | None = None,
) -> SearchResult:
    """Find the orbits of one mode's family that optimise an objective over free parameters within bounds.

    `objective` is the name of a quantity (see `names.NAMED`) or a function of `Observables` that returns a scalar
    CasADi expression; `free` are among S, gamma, alpha, g, alpha_n (one stiffness a site). `bounds` maps names that are
    free, or of quantities, to (lower, upper). Each constraint is a function that is to vanish, or (name or function,
    lower, upper). `mode` is by default the end breather: last for g > 0, first for g < 0. Where `S` is a list there is
    one orbit at each, all share the parameters, and functions get the tuple of their observables.

    From `starts` points, the chain's own first, orbits of the family are computed and Ipopt goes on with exact second
    derivatives; with `deflate` starts that led to a known optimum are used once more, away from it. `workers` processes
    or an `executor` of processes share the starts; `progress` is called with where the search is. Ctrl-C ends it with
    the best so far. `tolerance` bounds the estimated relative error of objective and Omega by discretisation.

    Raises ValueError and TypeError, before anything is solved, for arguments that cannot be meant; a search that finds
    nothing returns its reason. Method: full discretisation in odd cosines, interior point (Waechter and Biegler 2006).
    """
    request = search_request(
        chain, mode, S, objective, maximise, free, bounds if bounds is not None else {}, constraints, tolerance
    )
    for name, value, least in (("starts", starts, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
            raise ValueError(f"{name}: given {short_repr(value)}; accepted: a whole number >= {least}")
    check_executor(executor, workers, request)
    search = Search(request, sample_starts(request, int(starts), int(seed)), deflate)
    return search.run(progress, workers, executor)


class Search:
    """A search in the doing: outcomes of its starts, and of those that deflation used again."""

    def __init__(
        self, request: SearchRequest, starts: tuple[Start, ...], deflate: bool = False, known: Sequence[Outcome] = ()
    ) -> None:
        self.request, self.starts, self.deflate = request, starts, deflate
        self.outcomes, self.again = list(known), list[Outcome]()
        self.interruption = Interruption()
        self.harmonics = self.unconfirmed = 0

    def run(
        self,
        progress: Report | None = None,
        workers: int = 1,
        executor: Executor | None = None,
        keep: Callable[[Outcome], None] | None = None,
    ) -> SearchResult:
        """Run every start that has no outcome yet; `keep` is called with each outcome."""
        started = time.perf_counter()
        with self.interruption.listening(), one_thread():
            self.harmonics = first_harmonics(self.request, self.starts[0])
            done = {o.start.number for o in self.outcomes}
            jobs = [Job(self.request, start, self.harmonics) for start in self.starts if start.number not in done]
            for found in run_jobs(jobs, self.interruption, progress, workers, executor):
                self.outcomes.append(found)
                if keep is not None:
                    keep(found)
            self.outcomes.sort(key=lambda found: found.start.number)
            if self.deflate and not self.interruption.heard:
                self._deflate(progress, workers, executor)
            nlp = programme(self.request, self.harmonics)
            made = [(found, finished(nlp, found, numbers)) for found, numbers in self._distinct()]
            self.unconfirmed = sum(optimum is None for _, optimum in made)
            optima = [optimum for _, optimum in made if optimum is not None]
            return self._result(optima, time.perf_counter() - started)

    def _deflate(self, progress: Report | None, workers: int, executor: Executor | None) -> None:
        """Use starts that led to an optimum that another found first once more, away from the optima known."""
        distinct = self._distinct()
        repeated = {number for _, numbers in distinct for number in numbers[1:]}
        if not repeated:
            return
        nlp = programme(self.request, self.harmonics)
        known = tuple(nlp.place(found.solution.x) for found, _ in distinct if found.solution is not None)
        jobs = [Job(self.request, s, self.harmonics, known) for s in self.starts if s.number in repeated]
        self.again += run_jobs(jobs, self.interruption, progress, workers, executor)

    def _distinct(self) -> list[tuple[Outcome, tuple[int, ...]]]:
        """One outcome for each optimum, best first, with the numbers of the starts that led to it."""
        nlp, groups = programme(self.request, self.harmonics), list[list[Outcome]]()
        for found in (*self.outcomes, *self.again):
            if found.ending is not Ending.CONVERGED or found.solution is None:
                continue
            for group in groups:
                if group[0].solution is not None and same_place(nlp, group[0].solution.x, found.solution.x):
                    group.append(found)
                    break
            else:
                groups.append([found])
        groups.sort(key=lambda group: self._rank(group[0]))
        return [(group[0], tuple(dict.fromkeys(o.start.number for o in group))) for group in groups]

    def _rank(self, found: Outcome) -> float:
        value = found.solution.objective if found.solution is not None else np.inf
        return -value if self.request.maximise else value

    # Result ---------------------------------------------------------------------------------------------------------

    def _result(self, found: list[Optimum], seconds: float) -> SearchResult:
        optima = tuple(o for o in found if o.on_family is not False)
        others = tuple(o for o in found if o.on_family is False)
        nearest = None if optima else self._nearest()
        status, reason = self._status(optima, others, nearest)
        outcomes = (*self.outcomes, *self.again)
        return SearchResult(
            self.request.chain, self.request.mode, status, reason, optima, others, outcomes, nearest, seconds
        )

    def _nearest(self) -> Outcome | None:
        """The orbit that misses the conditions least, from a few starts; else what came nearest."""
        nlp = programme(self.request, self.harmonics)
        tried = [o for o in self.outcomes if o.solution is not None]
        missed = [o for o in tried if o.ending in (Ending.INFEASIBLE, Ending.FAILED) and not o.feasible]
        found = []
        if any(o.ending is Ending.INFEASIBLE for o in missed) and self.request.conditions:
            for start in [o.start for o in missed[:NEAREST]]:
                solution = nlp.nearest(packed(nlp, start, family_orbits(self.request, start.free)))
                if solution is not None:
                    found.append(replace(outcome(nlp, start, solution), ending=Ending.INFEASIBLE))
        return min(found or tried, key=lambda o: (max(o.gap, VIOLATION), self._rank(o)), default=None)

    def _status(
        self, optima: tuple[Optimum, ...], others: tuple[Optimum, ...], nearest: Outcome | None
    ) -> tuple[SearchStatus, str]:
        endings = [found.ending for found in self.outcomes]
        count = f"{len(endings)} of {len(self.starts)} starts"
        away = endings.count(Ending.UNBOUNDED)
        if self.interruption.heard:
            words = f"best so far {optima[0].objective:.10g}" if optima else "no optimum so far"
            return SearchStatus.INTERRUPTED, f"interrupted after {count}; {words}"
        if optima:
            best, many = optima[0], f"{len(optima[0].starts)} of {len(endings)} starts led to it"
            words = f"; {away} ran off without bound, so it is a local one" if away else ""
            if best.active:
                return (
                    SearchStatus.ON_BOUND,
                    f"the best optimum sits on a bound: {', '.join(best.active)}; {many}{words}",
                )
            return SearchStatus.FOUND, f"found an optimum inside its bounds; {many}{words}"
        if away:
            return SearchStatus.UNBOUNDED, f"{away} of {len(endings)} starts ran off without bound: {self._runaway()}"
        if others:
            number = f"{len(others)} optim{'um' if len(others) == 1 else 'a'}"
            return SearchStatus.FAILED, f"{number} found, but none on the family of mode {self.request.mode}"
        if nearest is not None and nearest.ending is Ending.INFEASIBLE:
            words = f"{nearest.worst} is off by {nearest.gap:.3g} at the nearest orbit found"
            return SearchStatus.INFEASIBLE, f"no start met the constraints; {words}"
        if self.unconfirmed:
            return SearchStatus.FAILED, f"{self.unconfirmed} found on the first harmonics, and not confirmed by more"
        failed = self.outcomes[0].words if self.outcomes else "there was no start"
        return SearchStatus.FAILED, f"no start converged; the first: {failed}"

    def _runaway(self) -> str:
        """The free number that ran off the farthest."""
        nlp = programme(self.request, self.harmonics)
        gone = next(o for o in self.outcomes if o.ending is Ending.UNBOUNDED)
        assert gone.solution is not None
        free = nlp.free_of(gone.solution.x)
        k = int(np.argmax(np.abs(free)))
        return f"{self.request.free_names[k]} = {free[k]:.3g}, objective {gone.solution.objective:.3g}"


__all__ = ["Search", "SearchProgress", "search_chain"]
