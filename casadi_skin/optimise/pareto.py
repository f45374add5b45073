"""The Pareto front of two quantities: points where neither gets better without the other getting worse.

Epsilon constraints (Haimes, Lasdon and Wismer 1971): the first quantity is minimised with the second held below values
spread between its two ends; dominated points, which local optima may leave, are removed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.arguments import short_repr
from casadi_skin.lattice.chain import Chain
from casadi_skin.optimise.names import NAMED, nearest_name
from casadi_skin.optimise.result import Optimum, SearchResult, SearchStatus
from casadi_skin.optimise.search import search_chain
from casadi_skin.theory.linear import Array

ROOM = 1e-6  # of the range of the second quantity, left to the first at the end of the front


@dataclass(frozen=True, eq=False)
class ParetoFront:
    """Points of the front by ascending second quantity; `values` has shape (points, 2).

    `searches` are all that were made, `dominated` the number of optima removed.
    """

    points: tuple[Optimum, ...]
    values: Array
    dominated: int
    searches: tuple[SearchResult, ...]

    @property
    def complete(self) -> bool:
        """Whether every search found an optimum."""
        return all(search.found for search in self.searches)


def pareto_front(chain: Chain, first: str, second: str, *, points: int = 10, **options: Any) -> ParetoFront:
    """The front of the least `first` against the least `second`, names of quantities, in `points` points.

    `options` are those of `search_chain` but for the objective and `maximise`; constraints and bounds hold everywhere.
    Raises ValueError where a name is not known or an end of the front is not found. Ctrl-C ends it.
    """
    for name in (first, second):
        if name not in NAMED:
            raise ValueError(f"quantity: given {short_repr(name)}; {nearest_name(str(name), NAMED)}")
    if isinstance(points, bool) or not isinstance(points, int) or points < 2:
        raise ValueError(f"points: given {short_repr(points)}; accepted: a whole number >= 2")
    constraints = tuple(options.pop("constraints", ()))

    def search(objective: str, *more: tuple[str, None, float], near: Optimum | None = None) -> SearchResult:
        start, own = (chain, {}) if near is None else _beside(chain, near)
        held = (*constraints, *more)
        result = search_chain(start, objective=objective, constraints=held, **{**options, **own})
        if result.status is SearchStatus.INTERRUPTED:
            raise KeyboardInterrupt
        return result

    ends = [search(second), search(first)]
    least, most = (end.best.orbit.values[second] for end in ends)
    # Of the points with the least `second` the front has that with the least `first`; Ipopt needs some room there.
    limits = np.linspace(least + ROOM * (most - least), most, points)[:-1]
    searches, near = list[SearchResult](), ends[0].best
    for limit in limits:
        searches.append(search(first, (second, None, float(limit)), near=near))
        near = searches[-1].best if searches[-1].found else near
    return _front([*searches, ends[1]], first, second)


def _beside(chain: Chain, near: Optimum) -> tuple[Chain, dict[str, float]]:
    """The chain, and S, of which a search starts that goes on from a neighbour on the front."""
    own = replace(chain, gamma=near.gamma, g=near.g, alpha=float(np.mean(near.alpha_n)))
    return own, {"S": near.S}


def _front(searches: list[SearchResult], first: str, second: str) -> ParetoFront:
    found = [optimum for search in searches for optimum in search.optima]
    values = np.array([[o.orbit.values[first], o.orbit.values[second]] for o in found])
    kept = [k for k in range(len(found)) if not _dominated(values, k)]
    kept.sort(key=lambda k: float(values[k, 1]))
    return ParetoFront(tuple(found[k] for k in kept), values[kept], len(found) - len(kept), tuple(searches))


def _dominated(values: Array, k: int) -> bool:
    """Whether another point is no worse in both quantities and better in one, or is the same and comes first."""
    no_worse, same = np.all(values <= values[k], axis=1), np.all(values == values[k], axis=1)
    return bool(np.any(no_worse & ~same) or np.any(same[:k]))
