"""What a search among the orbits of any model found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from casadi_skin.models.ode import OdeModel
from casadi_skin.optimise.result import SearchStatus
from casadi_skin.orbits.optimum import Optimum
from casadi_skin.orbits.orbit import Orbit


@dataclass(frozen=True)
class ModelStart:
    """What became of one start: free parameters there, and the failure in words, empty where an optimum was found."""

    number: int
    free: Mapping[str, float]
    failure: str


@dataclass(frozen=True, eq=False)
class ModelOptimum:
    """A local optimum: its orbit, and the same orbit solved again as a plain problem at its parameters.

    `starts` are the numbers of those that led here.
    """

    orbit: Orbit
    plain: Orbit
    starts: tuple[int, ...]

    @property
    def _optimum(self) -> Optimum:
        assert self.orbit.optimum is not None
        return self.orbit.optimum

    @property
    def objective(self) -> float:
        """What is minimised."""
        return self._optimum.objective

    @property
    def kkt(self) -> float:
        """Largest residual of stationarity and complementarity, evaluated apart from the solver."""
        return self._optimum.optimality.kkt

    @property
    def active(self) -> tuple[str, ...]:
        """Bounds that hold, in words."""
        return self._optimum.optimality.active

    @property
    def difference(self) -> float:
        """Difference from the plain orbit, the larger of those of the period and of the states, both relative.

        States are compared at the phases of 200 times, each component relative to its largest value and no less than a
        millionth of the largest of all.
        """
        fractions = np.arange(200) / 200
        one, other = (found.evaluate(fractions * found.period) for found in (self.orbit, self.plain))
        largest = np.max(np.abs(other), axis=0)
        by_states = np.max(np.abs(one - other) / np.maximum(largest, 1e-6 * np.max(largest)))
        return max(abs(self.orbit.period - self.plain.period) / self.plain.period, float(by_states))


@dataclass(frozen=True, eq=False)
class ModelSearchResult:
    """Distinct optima, best first; `status` and the sentence `reason` tell how the search ended."""

    model: OdeModel
    status: SearchStatus
    reason: str
    optima: tuple[ModelOptimum, ...]
    starts: tuple[ModelStart, ...]

    @property
    def found(self) -> bool:
        """Whether there is an optimum."""
        return bool(self.optima)

    @property
    def best(self) -> ModelOptimum:
        """The best optimum; raises ValueError with the reason where there is none."""
        if not self.optima:
            raise ValueError(f"search: no optimum; {self.reason}")
        return self.optima[0]
