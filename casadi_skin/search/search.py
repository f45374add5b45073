"""Searches near a guess: starts run in turn or in processes, distinct optima, and how the search ended."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from enum import Enum
from functools import partial
from typing import Any, cast

import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import check_options, number_within, short_repr, truth, whole
from casadi_skin.model.expressions import real_array
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import Result, in_turn
from casadi_skin.search.design_problem import DesignProblem, family_starts
from casadi_skin.search.designs import Design, best_design
from casadi_skin.search.nlp import FLAT_CURVATURE
from casadi_skin.search.orbit_search import OrbitSearch
from casadi_skin.search.search_problem import (
    FEASIBLE_VIOLATION,
    Ending,
    Optimum,
    Outcome,
    Start,
    checked_conditions,
    lost_start,
    solve_start,
)
from casadi_skin.solve.processes import Report, Runner
from casadi_skin.zero.orbit import Guess

# Result of a search: its distinct optima, best first, each with its checks, and the outcome of every start ------------


ENGINE = "Ipopt on the equations of one orbit with objective and constraints"


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
        optima: distinct optima.
        outcomes: one a start done.
        nearest: where there is no optimum, the outcome that misses the constraints least.
        seconds: wall-clock time.
        engine: how optima were found.
    """

    problem: OrbitSearch
    status: SearchStatus
    reason: str
    optima: tuple[Optimum, ...]
    outcomes: tuple[Outcome, ...]
    nearest: Outcome | None
    seconds: float
    engine: str = ENGINE

    @property
    def model(self) -> Any:
        """The model."""
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


def search(
    problem: OrbitSearch,
    starts: Sequence[Start],
    *,
    progress: Report | None = None,
    workers: int = 1,
    executor: Executor | None = None,
) -> SearchResult:
    """Run a search from its starts.

    Arguments:
        problem: the search problem.
        starts: starts of the search, as `problem.starts` makes them.
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
    began = time.perf_counter()
    with runner.listening():
        outcomes = sorted(runner.run(partial(solve_start, problem), starts), key=lambda outcome: outcome.start.number)
        optima = list[Optimum]()
        polished = [problem.polish(*one) for one in distinct(outcomes, problem.maximise)]
        for optimum in (optimum for optimum in polished if optimum is not None):
            same = next((k for k, other in enumerate(optima) if other.is_near(optimum, SAME_OPTIMUM_RTOL)), None)
            if same is None:
                optima.append(optimum)
            else:  # optima that differed on coarse discretisations
                optima[same] = replace(optima[same], starts=(*optima[same].starts, *optimum.starts))
    gone = f"interrupted after {len(outcomes)} of {len(starts)} starts" if runner.interrupted else ""
    tried = [outcome for outcome in outcomes if outcome.solution is not None and not optima]
    near = min(tried, key=lambda outcome: (max(outcome.gap, FEASIBLE_VIOLATION), outcome.objective), default=None)
    verdict = _verdict(problem, outcomes, optima, near, polished.count(None), gone)
    return SearchResult(problem, *verdict, tuple(optima), tuple(outcomes), near, time.perf_counter() - began)


def _check_pickled(problem: OrbitSearch) -> None:
    try:
        pickle.dumps(problem)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        accepted = "names, or functions at the top of a module, where starts run in other processes"
        words = f"cannot be sent to a process ({' '.join(str(error).split())[:120]})"
        raise TypeError(f"objective and constraints: {words}; accepted: {accepted}") from None


def _verdict(
    problem: OrbitSearch, outcomes: Sequence[Outcome], optima: Sequence[Optimum], near: Outcome | None,
    unconfirmed: int, interrupted: str,
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
        words = f"{problem.free[k]} = {gone[0].free[k]:.3g}, objective {gone[0].objective:.3g}"
        return SearchStatus.UNBOUNDED, f"{len(gone)} of {count} starts ran off without bound: {words}"
    if near is not None and near.ending is Ending.INFEASIBLE:
        words = f"{near.worst} is off by {near.gap:.3g} where the nearest start ended"
        return SearchStatus.INFEASIBLE, f"no start met the constraints; {words}"
    words = f"no start converged; the first: {outcomes[0].words if outcomes else 'there was no start'}"
    if unconfirmed:
        words = f"{unconfirmed} found on the first meshes, and not confirmed by more"
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


# The public entry -----------------------------------------------------------------------------------------------------

DEFAULT_STARTS = 8


@in_turn
def search_orbit(
    chain_or_model: Chain | OdeModel,
    *,
    guess: Guess | None = None,
    free: Sequence[str],
    bounds: Mapping[str, Any] | None = None,
    constraints: Sequence[Any] = (),
    maximise: bool = False,
    starts: int = DEFAULT_STARTS,
    seed: int = 0,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Report | None = None,
    **stated: Any,
) -> SearchResult | Design:
    """Find the periodic orbits that optimise an objective over free parameters, from many starts.

    Without a guess, orbits of one mode's family by `optimise`, which also takes special points. Near a guess a plain
    orbit is solved from each start, and Ipopt (Waechter and Biegler 2006) goes on from there with exact second
    derivatives, by collocation. Distinct optima are made final on finer meshes and compared with plain orbits.

    Arguments:
        chain_or_model: a `Chain` of finitely many sites, or an `OdeModel`.
        mode, S: of a family: its mode, and the total amplitude of its orbit or of the first start; with a list of S
            there is one orbit at each, and functions get the tuple of them. The objective is a name or a function of
            the orbit, as in `optimise`.
        objective: near a guess a name (of a state, an output, a parameter, "period", "Omega" or "hamiltonian") or an
            expression in states and parameters, taken at phase zero.
        running: a name or an expression whose mean over the period is added to the objective.
        free: names of the free parameters.
        bounds: (lower, upper) by name, None where there is none: of free parameters, of quantities, and of states over
            the whole period.
        constraints: each a quantity that has to vanish, or (quantity, lower, upper).
        maximise: whether the objective is maximised.
        guess, period, select, section, symmetric, cycles: the orbit that starts begin near, as in `find_orbit`.
        parameters: values of parameters by name, where they are not nominal.
        tolerance: bound of the estimated relative error by discretisation; `transcription`, `degree`, `corrector` and
            `intervals` may be given as well, as in `find_orbit`.
        starts: number of starts: the own parameters first, then a Halton sequence within the bounds.
        seed: of that sequence.
        workers, executor: near a guess, processes that share the starts. Functions then have to be at the top of a
            module.
        progress: called with a `SearchProgress` at iterations and at the end of every start; of a family with words.

    Returns:
        A `SearchResult`: distinct optima, best first, and why the search ended. Ctrl-C ends it with the best so far.
        Of a family a `Design`, which has these by the same names.

    Raises:
        ValueError, TypeError: arguments that are not accepted, before anything is solved.
    """
    truth("maximise", maximise)
    if not isinstance(chain_or_model, cast(Any, OdeModel if guess is not None else Chain | OdeModel)):
        accepted = "an OdeModel" if guess is not None else "a Chain or an OdeModel"
        raise TypeError(f"chain_or_model: given {short_repr(chain_or_model)}; accepted: {accepted}")
    if guess is None:
        given = {"free": free, "bounds": bounds, "constraints": constraints, "maximise": maximise, **stated}
        check_options("search_orbit", stated, search_orbit, _of_family)
        return _of_family(chain_or_model, starts=starts, seed=seed, progress=progress, **given)
    problem = OrbitSearch.of(
        chain_or_model, guess=guess, free=free, bounds=bounds, constraints=constraints, maximise=maximise, **stated
    )
    numbers = {name: whole(name, value, least) for name, value, least in (("starts", starts, 1), ("seed", seed, 0))}
    first = problem.starts(numbers["starts"], numbers["seed"])
    return search(problem, first, progress=progress, workers=workers, executor=executor)


def _of_family(
    chain_or_model: Chain | OdeModel, *, objective: Any = None, mode: int | str | None = None, S: Any = 1.0,
    parameters: Mapping[str, float] | None = None, tolerance: float = 1e-8, free: Sequence[str],
    bounds: Mapping[str, Any] | None, constraints: Sequence[Any], maximise: bool, starts: int, seed: int,
    progress: Callable[[Any], None] | None,
) -> Design:  # fmt: skip
    """The design of the same arguments: functions of several orbits get the tuple of them."""
    several = isinstance(S, list | tuple | np.ndarray)
    amplitudes = real_array("S", S).ravel().tolist()
    if not amplitudes or min(amplitudes) <= 0:
        raise ValueError(f"S: given {short_repr(S)}; accepted: a finite number > 0, or a list of such numbers")
    number_within("tolerance", tolerance, 1e-12, 1e-2)
    checked_conditions(constraints, (str, Callable), "a function of the orbits")
    count, seed = whole("starts", starts, 1), whole("seed", seed, 0)

    def joined(quantity: Any) -> Any:
        if several and isinstance(quantity, str):
            return f"a.{quantity}"
        return (lambda *known: quantity(known)) if several and callable(quantity) else quantity

    held = [(joined(c[0]), *c[1:]) if isinstance(c, list | tuple) else joined(c) for c in constraints]
    of = family_starts(chain_or_model, mode, amplitudes, parameters, tolerance)
    words = "objective", "free", "constraints"
    problem = DesignProblem.of(joined(objective), of, free, held, bounds, maximise, words)
    return best_design(problem, problem.places(count, seed), tolerance, progress)
