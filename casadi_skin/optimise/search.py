"""The engine of every search: starts run in turn or in processes, distinct optima, and how the search ended.

The public entry to searches: orbits of a chain, or of any model.
"""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import Any

import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import check_options, truth, whole
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import Result, in_turn
from casadi_skin.optimise.family_search import FamilySearch
from casadi_skin.optimise.nlp import FLAT_CURVATURE
from casadi_skin.optimise.orbit_search import OrbitSearch
from casadi_skin.optimise.search_problem import (
    FEASIBLE_VIOLATION,
    Ending,
    Optimum,
    Outcome,
    Start,
    lost_start,
    nearest,
    solve_start,
)
from casadi_skin.solve.processes import Report, Runner
from casadi_skin.zero.problem import Array

# Both have:
# model: the chain or the model; maximise: whether the objective is maximised;
# free_names: names of the free numbers, one each; columns: names of the quantities that tables show;
# of_family: whether its orbits are those of a family, sums of cosines;
# resolution_name: name of the unit in which the resolution of an optimum is counted;
# wanted: where optima have to be, in words, such as on which family; hint: possible reason where none is found, or "";
# starts(count, seed, first): starts of a seed; the first has the model's own parameters, or the free numbers `first`;
# prepared(first): the search with the choices that all starts share, made for the first of them;
# nlp_at(start), as `solve_start` needs it;
# polish(outcome, starts): the optimum at the tolerance, checked; None where finer discretisations do not confirm it.
SearchProblem = FamilySearch | OrbitSearch

# Result of a search: its distinct optima, best first, each with its checks, and the outcome of every start ------------


class SearchStatus(Enum):
    """End of a search."""

    FOUND = "found an optimum inside its bounds"
    ON_BOUND = "the best optimum sits on a bound"
    INFEASIBLE = "no start met the constraints"
    UNBOUNDED = "the objective is unbounded"
    INTERRUPTED = "interrupted"
    FAILED = "no start converged"


@dataclass(frozen=True, eq=False)
class SearchResult(Result):
    """Distinct optima, best first.

    Attributes:
        problem: the search problem.
        status, reason: how the search ended; `reason` is a sentence.
        optima: optima on the requested family.
        others: optima on orbits that are not of this family.
        outcomes: one a start done, and another for each start that was used again by deflation.
        nearest: where there is no optimum, the outcome that comes nearest; of an infeasible search the orbit that
            misses the constraints least.
        seconds: wall-clock time.
    """

    problem: SearchProblem
    status: SearchStatus
    reason: str
    optima: tuple[Optimum, ...]
    others: tuple[Optimum, ...]
    outcomes: tuple[Outcome, ...]
    nearest: Outcome | None
    seconds: float

    @property
    def model(self) -> Any:
        """The chain or the model."""
        return self.problem.model

    @property
    def best(self) -> Optimum:
        """The best optimum; raises ValueError with the reason where there is none."""
        if not self.optima:
            raise ValueError(f"search: no optimum; {self.reason}")
        return self.optima[0]

    @property
    def found(self) -> bool:
        """Whether there is an optimum."""
        return bool(self.optima)

    def __repr__(self) -> str:
        return f"<SearchResult: {len(self.optima)} optima; {self.reason}>"


SAME_OPTIMUM_RTOL = 1e-4  # distance of places, and relative difference of objectives, below which two optima are one
NEAREST_STARTS = 4  # starts of the search for the orbit nearest to the constraints


def search(
    problem: SearchProblem,
    starts: Sequence[Start],
    *,
    deflate: bool = False,
    known: Sequence[Outcome] = (),
    keep: Callable[[Outcome], None] | None = None,
    progress: Report | None = None,
    workers: int = 1,
    executor: Executor | None = None,
) -> SearchResult:
    """Run a search from its starts.

    Arguments:
        problem: the search problem, as `stated_search` makes it.
        starts: starts of the search, as `problem.starts` makes them.
        deflate: whether starts that led to a known optimum are used once more, away from it.
        known: outcomes of an earlier run; their starts are not run again.
        keep: called with each new outcome as it ends, such as to write it to a journal.
        progress: called at iterations of Ipopt and at the end of every start.
        workers: number of processes that share the starts.
        executor: processes of the caller in place of `workers`.

    Returns:
        The result. Ctrl-C ends the search with the best so far.

    Raises:
        ValueError, TypeError: processes that cannot be used, or a problem that cannot be sent to them.
    """
    runner = Runner(progress, workers, executor, lost_start)
    if executor is not None or workers > 1:
        _check_pickled(problem)
    outcomes, again, began = list(known), list[Outcome](), time.perf_counter()
    done = {outcome.start.number for outcome in outcomes}
    with runner.listening():
        problem = problem.prepared(starts[0])
        left = [start for start in starts if start.number not in done]
        for outcome in runner.run(partial(solve_start, problem), left):
            outcomes.append(outcome)
            if keep is not None:
                keep(outcome)
        outcomes.sort(key=lambda outcome: outcome.start.number)
        if deflate and not runner.interrupted:
            known_optima = distinct(outcomes, problem.maximise)
            repeated = {number for _, numbers in known_optima for number in numbers[1:]}
            away = partial(solve_start, problem, known=tuple(outcome.place for outcome, _ in known_optima))
            again += runner.run(away, [start for start in starts if start.number in repeated])
        polished = [problem.polish(*one) for one in distinct((*outcomes, *again), problem.maximise)]
        final = list[Optimum]()
        for optimum in (optimum for optimum in polished if optimum is not None):
            same = next((k for k, other in enumerate(final) if other.is_near(optimum, SAME_OPTIMUM_RTOL)), None)
            if same is None:
                final.append(optimum)
            else:  # optima that differed on coarse discretisations
                final[same] = replace(final[same], starts=(*final[same].starts, *optimum.starts))
        optima, others = (tuple(o for o in final if (o.on_family is False) is off) for off in (False, True))
        near = None if optima else _nearest(problem, outcomes)
    gone = f"interrupted after {len(outcomes)} of {len(starts)} starts" if runner.interrupted else ""
    verdict = _verdict(problem, outcomes, optima, others, near, polished.count(None), gone)
    seconds = time.perf_counter() - began
    return SearchResult(problem, *verdict, optima, others, (*outcomes, *again), near, seconds)


def _check_pickled(problem: SearchProblem) -> None:
    try:
        pickle.dumps(problem)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        accepted = "names, or functions at the top of a module, where starts run in other processes"
        words = f"cannot be sent to a process ({' '.join(str(error).split())[:120]})"
        raise TypeError(f"objective and constraints: {words}; accepted: {accepted}") from None


def _nearest(problem: SearchProblem, outcomes: Sequence[Outcome]) -> Outcome | None:
    """The orbit that misses the conditions least, from a few starts; else the nearest outcome."""
    tried = [o for o in outcomes if o.solution is not None]
    missed = [o for o in tried if o.ending in (Ending.INFEASIBLE, Ending.FAILED) and not o.feasible]
    found = list[Outcome | None]()
    if any(o.ending is Ending.INFEASIBLE for o in missed):
        found = [nearest(problem, outcome.start) for outcome in missed[:NEAREST_STARTS]]
    chosen = [outcome for outcome in found if outcome is not None] or tried
    sign = -1.0 if problem.maximise else 1.0
    return min(chosen, key=lambda o: (max(o.gap, FEASIBLE_VIOLATION), sign * o.objective), default=None)


def _verdict(
    problem: SearchProblem, outcomes: Sequence[Outcome], optima: Sequence[Optimum], others: Sequence[Optimum],
    near: Outcome | None, unconfirmed: int, interrupted: str,
) -> tuple[SearchStatus, str]:  # fmt: skip
    """The status, with the reason in a sentence; `unconfirmed` optima are those of first discretisations alone."""
    gone, count = [o for o in outcomes if o.ending is Ending.UNBOUNDED], len(outcomes)
    if interrupted:
        words = f"best so far {optima[0].objective:.10g}" if optima else "no optimum so far"
        return SearchStatus.INTERRUPTED, f"{interrupted}; {words}"
    if optima:
        words = f"{len(optima[0].starts)} of {count} starts led to it"
        words += f"; {len(gone)} ran off without bound, so it is a local one" if gone else ""
        if optima[0].curvature < FLAT_CURVATURE:
            words += "; it is flat: neighbours along some direction of the free numbers do as well"
        if optima[0].active:
            sits = f"the best optimum sits on a bound: {', '.join(optima[0].active)}"
            return SearchStatus.ON_BOUND, f"{sits}; {words}"
        return SearchStatus.FOUND, f"found an optimum inside its bounds; {words}"
    if gone:
        k = int(np.argmax(np.abs(gone[0].free)))  # the free number that ran off the farthest
        words = f"{problem.free_names[k]} = {gone[0].free[k]:.3g}, objective {gone[0].objective:.3g}"
        return SearchStatus.UNBOUNDED, f"{len(gone)} of {count} starts ran off without bound: {words}"
    if others:
        number = f"{len(others)} optim{'um' if len(others) == 1 else 'a'}"
        return SearchStatus.FAILED, f"{number} found, but none {problem.wanted}"
    if near is not None and near.ending is Ending.INFEASIBLE:
        words = f"{near.worst} is off by {near.gap:.3g} at the nearest orbit found"
        return SearchStatus.INFEASIBLE, f"no start met the constraints; {words}"
    words = f"no start converged; the first: {outcomes[0].words if outcomes else 'there was no start'}"
    if unconfirmed:
        words = f"{unconfirmed} found on the first {problem.resolution_name}, and not confirmed by more"
    return SearchStatus.FAILED, words + (f"; {problem.hint}" if problem.hint else "")


def distinct(outcomes: Iterable[Outcome], maximise: bool = False) -> list[tuple[Outcome, tuple[int, ...]]]:
    """One outcome for each optimum, best first, with the numbers of the starts that led to it."""
    groups = list[list[Outcome]]()
    for outcome in outcomes:
        if outcome.ending is Ending.CONVERGED:
            same = next((group for group in groups if same_optimum(group[0], outcome)), None)
            if same is None:
                groups.append(same := [])
            same.append(outcome)
    groups.sort(key=lambda group: -group[0].objective if maximise else group[0].objective)
    return [(group[0], tuple(dict.fromkeys(o.start.number for o in group))) for group in groups]


def same_optimum(one: Outcome, other: Outcome) -> bool:
    """Whether two outcomes are one optimum: the same place, and the same value of the objective."""
    near = np.max(np.abs(one.place - other.place)) <= SAME_OPTIMUM_RTOL
    return bool(near and abs(one.objective - other.objective) <= SAME_OPTIMUM_RTOL * max(1.0, abs(one.objective)))


# The public entry to searches: orbits of a chain, or of any model -----------------------------------------------------

DEFAULT_STARTS = 8


@in_turn
def search_orbit(
    chain_or_model: Chain | OdeModel,
    *,
    free: Sequence[str],
    bounds: Mapping[str, Any] | None = None,
    constraints: Sequence[Any] = (),
    maximise: bool = False,
    starts: int = DEFAULT_STARTS,
    seed: int = 0,
    deflate: bool = False,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Report | None = None,
    **stated: Any,
) -> SearchResult:
    """Find the orbits that optimise an objective over free parameters within bounds, from many starts.

    Of a chain, and of a model without a `guess`, orbits of one mode's family are searched, in odd cosines on a quarter
    of the period; the model is then of second order, odd, and reversible with even positions. With a `guess` periodic
    orbits of any model are searched near it, by collocation.

    From each start a plain orbit is solved, and Ipopt (Waechter and Biegler 2006) goes on from there with exact second
    derivatives. Distinct optima are made final on finer discretisations and compared with plain orbits.

    Arguments:
        chain_or_model: a `Chain` of finitely many sites, or an `OdeModel`.
        objective: of a family the name of a quantity, or a function of its `Observables` that returns a scalar CasADi
            expression. Near a guess a name (of a state, an output, a parameter, "period", "Omega" or "hamiltonian") or
            an expression in states and parameters, taken at phase zero.
        running: near a guess: a name or an expression whose mean over the period is added to the objective.
        free: names of the free numbers: of a chain S, gamma, alpha, g, alpha_n (one stiffness a site); of a model its
            parameters and, in a family, S.
        bounds: (lower, upper) by name, None where there is none: of free numbers, of quantities, and near a guess of
            states over the whole period.
        constraints: each a quantity that has to vanish, or (quantity, lower, upper).
        maximise: whether the objective is maximised.
        mode: of a family: the linear mode it grows from, a number from 1, "first" or "last"; by default that of the
            end breather of a chain, the first of a model.
        S: of a family: the total amplitude, sum of y_n^2 at rest, of the orbit or of the first start. With a list there
            is one orbit at each, all share the parameters, and functions get the tuple of their observables.
        guess, period, select, section, symmetric, cycles: the orbit that starts begin near, as in `find_orbit`.
        parameters: values of a model's parameters by name, where they are not nominal.
        tolerance: bound of the estimated relative error by discretisation; near a guess `transcription`, `degree`,
            `corrector` and `intervals` may be given as well, as in `find_orbit`.
        starts: number of starts: the own parameters first, then a Halton sequence within the bounds.
        seed: of that sequence.
        deflate: whether starts that led to a known optimum are used once more, away from it.
        workers, executor: processes that share the starts. Functions then have to be at the top of a module.
        progress: called with a `SearchProgress` at iterations and at the end of every start.

    Returns:
        A `SearchResult`: distinct optima, best first, and why the search ended. Ctrl-C ends it with the best so far.

    Raises:
        ValueError, TypeError: arguments that are not accepted, before anything is solved.
    """
    truth("maximise", maximise)
    truth("deflate", deflate)
    problem = stated_search(
        chain_or_model, free=free, bounds=bounds, constraints=constraints, maximise=maximise, **stated
    )
    numbers = {name: whole(name, value, least) for name, value, least in (("starts", starts, 1), ("seed", seed, 0))}
    first = problem.starts(numbers["starts"], numbers["seed"])
    return search(problem, first, deflate=deflate, progress=progress, workers=workers, executor=executor)


def stated_search(chain_or_model: Any, *, guess: Any = None, **stated: Any) -> OrbitSearch | FamilySearch:
    """The search of `search_orbit`'s arguments, checked but not run; raises ValueError and TypeError."""
    if isinstance(chain_or_model, OdeModel) and guess is not None:
        return OrbitSearch.of(chain_or_model, guess=guess, **stated)
    check_options("search_orbit", stated, search_orbit, FamilySearch.of)
    return FamilySearch.of(chain_or_model, **stated)


# The Pareto front of two quantities: points where neither improves unless the other worsens ---------------------------

FRONT_END_ROOM = 1e-6  # of the range of the second quantity, left to the first at the end of the front


@dataclass(frozen=True, eq=False)
class ParetoFront(Result):
    """Points of the front by ascending second quantity.

    Attributes:
        points: the optima.
        values: of both quantities, shape (points, 2).
        dominated: number of optima removed.
        searches: all searches that were run.
        names: of both quantities.
    """

    points: tuple[Optimum, ...]
    values: Array
    dominated: int
    searches: tuple[SearchResult, ...]
    names: tuple[str, str] = ("first", "second")

    def __repr__(self) -> str:
        return f"<ParetoFront: {len(self.points)} points of {self.names[0]} against {self.names[1]}>"

    @property
    def complete(self) -> bool:
        """Whether every search found an optimum."""
        return all(search.found for search in self.searches)


@in_turn
def pareto_front(
    chain_or_model: Chain | OdeModel,
    first: str,
    second: str,
    *,
    points: int = 10,
    starts: int = DEFAULT_STARTS,
    seed: int = 0,
    deflate: bool = False,
    workers: int = 1,
    constraints: Sequence[Any] = (),
    **stated: Any,
) -> ParetoFront:
    """The front of the least `first` against the least `second` quantity.

    Arguments:
        chain_or_model: as in `search_orbit`.
        first, second: names of quantities.
        points: number of points.
        starts, seed, deflate, workers, constraints, stated: as in `search_orbit`, but for the objective and `maximise`;
            constraints and bounds hold everywhere.

    Raises:
        ValueError, TypeError: arguments that are not accepted, or an end of the front without a solution.
        KeyboardInterrupt: after an interruption.
    """
    whole("points", points, 2)

    def least(objective: str, *more: tuple[str, None, float], near: Optimum | None = None) -> SearchResult:
        held = (*constraints, *more)
        problem = stated_search(chain_or_model, objective=objective, constraints=held, **stated)
        beside = None if near is None else tuple(near.parameters.values())
        first = problem.starts(whole("starts", starts, 1), whole("seed", seed, 0), beside)
        result = search(problem, first, deflate=deflate, workers=workers)
        if result.status is SearchStatus.INTERRUPTED:
            raise KeyboardInterrupt
        return result

    ends = [least(second), least(first)]
    low, high = (getattr(end.best, second) for end in ends)
    # Of the points with the least `second` the front has that with the least `first`; Ipopt needs some room there.
    limits = np.linspace(low + FRONT_END_ROOM * (high - low), high, points)[:-1]
    searches, near = list[SearchResult](), ends[0].best
    for limit in limits:
        searches.append(least(first, (second, None, float(limit)), near=near))
        near = searches[-1].best if searches[-1].found else near
    return _front([*searches, ends[1]], first, second)


def _front(searches: list[SearchResult], first: str, second: str) -> ParetoFront:
    found = [optimum for search in searches for optimum in search.optima]
    values = np.array([[getattr(optimum, name) for name in (first, second)] for optimum in found])
    kept = [k for k in range(len(found)) if not _dominated(values, k)]
    kept.sort(key=lambda k: float(values[k, 1]))
    return ParetoFront(
        tuple(found[k] for k in kept), values[kept], len(found) - len(kept), tuple(searches), (first, second)
    )


def _dominated(values: Array, k: int) -> bool:
    """Whether another point is no worse in both quantities and better in one, or is the same and comes first."""
    no_worse, same = np.all(values <= values[k], axis=1), np.all(values == values[k], axis=1)
    return bool(np.any(no_worse & ~same) or np.any(same[:k]))
