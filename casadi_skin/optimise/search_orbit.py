"""The public entry to searches: orbits of a chain, or of any model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import check_options, short_repr, truth, whole
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import Result
from casadi_skin.optimise.family_search import FamilySearch
from casadi_skin.optimise.optimum import Optimum
from casadi_skin.optimise.orbit_search import OrbitSearch
from casadi_skin.optimise.search import SearchResult, SearchStatus, search
from casadi_skin.optimise.search_problem import SearchProblem
from casadi_skin.solve.processes import Report
from casadi_skin.zero.problem import Array

DEFAULT_STARTS = 8


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


def stated_search(chain_or_model: Any, **stated: Any) -> SearchProblem:
    """The search of `search_orbit`'s arguments, checked but not run; raises ValueError and TypeError."""
    if isinstance(chain_or_model, OdeModel) and stated.get("guess") is not None:
        return OrbitSearch.of(chain_or_model, **stated)
    stated.pop("guess", None)
    return stated_family_search(chain_or_model, **stated)


def stated_family_search(
    chain_or_model: Any,
    *,
    mode: int | str | None = None,
    S: object = 1.0,
    parameters: Mapping[str, float] | None = None,
    **stated: Any,
) -> FamilySearch:
    """The same among the orbits of one mode's family."""
    check_options("search_orbit", stated, search_orbit, FamilySearch.of)
    if stated.get("objective") is None:
        raise ValueError("objective: given none; accepted: the name of a quantity, or a function of observables")
    if not hasattr(chain_or_model, "searched_family"):
        raise TypeError(f"chain_or_model: given {short_repr(chain_or_model)}; accepted: a Chain or an OdeModel")
    return FamilySearch.of(chain_or_model.searched_family(mode, parameters), S=S, **stated)


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
