"""Result of a search: its distinct optima, best first, each with its checks, and the outcome of every start."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

from casadi_skin.model.result import Result
from casadi_skin.optimise.optimum import Optimum
from casadi_skin.optimise.search_problem import Outcome, SearchProblem


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
