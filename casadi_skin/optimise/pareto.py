"""The Pareto front of two quantities: points where neither improves unless the other worsens.

Epsilon constraints (Haimes, Lasdon and Wismer 1971): the first quantity is minimised with the second held below values
spread between its two ends; dominated points, which local optima may leave, are removed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import whole
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import Result
from casadi_skin.optimise.optimum import Optimum
from casadi_skin.optimise.result import SearchResult, SearchStatus
from casadi_skin.optimise.search import search
from casadi_skin.optimise.search_orbit import STARTS, stated_search
from casadi_skin.zero.problem import Array

ROOM = 1e-6  # of the range of the second quantity, left to the first at the end of the front


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
    starts: int = STARTS,
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
    limits = np.linspace(low + ROOM * (high - low), high, points)[:-1]
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
