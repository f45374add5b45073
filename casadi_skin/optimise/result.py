"""Result of a search: its distinct optima, best first, each with its checks, and the outcome of every start."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

from casadi_skin import methods
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
class SearchResult:
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

    def save(self, path: str | Path) -> Path:
        """Write the result to a file of data, from which `casadi_skin.read_result` makes it again, bit for bit.

        Raises ValueError for parts that are no data: a function of the caller's, a model that is a program.
        """
        saved: Path = methods.TASKS["save"].load()(self, path)
        return saved

    def __repr__(self) -> str:
        lines = [f"SearchResult: {self.reason}"]
        for optimum in self.optima:
            free = ", ".join(f"{name} = {value:.10g}" for name, value in list(optimum.parameters.items())[:4])
            lines.append(
                f"  objective {optimum.objective:.10g} at {free}{', ...' if len(optimum.parameters) > 4 else ''}"
            )
        return "\n".join(lines)
