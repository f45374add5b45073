"""Orbits of any model found by optimisation: many starts of the boundary-value problem with an objective."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.arguments import shown
from casadi_skin.boundary.guesses import Guess
from casadi_skin.boundary.orbit import PeriodicOrbit
from casadi_skin.boundary.periodic import find_orbit
from casadi_skin.boundary.solving import BoundaryError
from casadi_skin.models.ode import OdeModel
from casadi_skin.search.result import SearchStatus
from casadi_skin.search.running import Interruption
from casadi_skin.threads import one_thread

SAME = 1e-5  # relative difference of free parameters and period below which two optima are one


@dataclass(frozen=True)
class ModelStart:
    """What became of one start: free parameters there, and the failure in words, empty where an optimum was found."""

    number: int
    free: Mapping[str, float]
    failure: str


@dataclass(frozen=True, eq=False)
class ModelOptimum:
    """A local optimum: its orbit, and the same orbit solved again as a plain problem at its parameters.

    `difference` is that of the periods, relative; `starts` are the numbers of those that led here.
    """

    orbit: PeriodicOrbit
    plain: PeriodicOrbit
    starts: tuple[int, ...]

    @property
    def objective(self) -> float:
        """What was optimised, in the sense asked for."""
        assert self.orbit.optimum is not None
        return self.orbit.optimum.objective

    @property
    def kkt(self) -> float:
        """Largest residual of stationarity and complementarity, evaluated apart from the solver."""
        assert self.orbit.optimum is not None
        return self.orbit.optimum.optimality.kkt

    @property
    def active(self) -> tuple[str, ...]:
        """Bounds that hold, in words."""
        assert self.orbit.optimum is not None
        return self.orbit.optimum.optimality.active

    @property
    def difference(self) -> float:
        """Relative difference of the period from that of the plain orbit."""
        return abs(self.orbit.period - self.plain.period) / self.plain.period


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


def search_model(
    model: OdeModel,
    guess: Guess,
    period: float | None = None,
    *,
    free: Sequence[str],
    bounds: Mapping[str, tuple[float, float]],
    parameters: Mapping[str, float] | None = None,
    starts: int = 4,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> ModelSearchResult:
    """Find the periodic orbits of a model that minimise an objective over free parameters within bounds.

    The first start has the parameters given; the others have free parameters drawn evenly within their bounds, which
    have to be finite then. From each the plain orbit is solved, and Ipopt goes on from it. Options, `objective` or
    `running` among them, are those of `find_orbit`. Ctrl-C ends the search with the best so far. Raises ValueError,
    before anything is solved, for arguments that cannot be meant.
    """
    if options.get("objective") is None and options.get("running") is None:
        raise ValueError("objective: given neither objective nor running; accepted: one of them, or both")
    if not free:
        raise ValueError(f"free: given none; accepted: one or more of {', '.join(model.parameter_names)}")
    for name, value, least in (("starts", starts, 1), ("seed", seed, 0)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise ValueError(f"{name}: given {shown(value)}; accepted: a whole number >= {least}")
    search = _ModelSearch(model, guess, period, tuple(free), dict(bounds), dict(parameters or {}), options)
    return search.run(search.sampled(starts, seed), progress)


@dataclass(frozen=True, eq=False)
class _ModelSearch:
    """What is searched for, and in which bounds."""

    model: OdeModel
    guess: Guess
    period: float | None
    free: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]]
    parameters: Mapping[str, float]
    options: Mapping[str, Any]

    def sampled(self, starts: int, seed: int) -> tuple[Mapping[str, float], ...]:
        """Free parameters at every start."""
        from casadi_skin.boundary.statement import named_values

        values = named_values(self.model.first_order(), self.parameters)
        for name in self.free:
            if name not in values:
                raise ValueError(f"free: given {shown(name)}; accepted: {', '.join(values)}")
            if starts > 1 and not np.all(np.isfinite(self.bounds.get(name, (-np.inf, np.inf)))):
                raise ValueError(f"bounds: given no finite bounds of {name}; accepted: finite ones, or starts = 1")
        generator = np.random.default_rng(seed)
        drawn = [{name: generator.uniform(*self.bounds[name]) for name in self.free} for _ in range(starts - 1)]
        return ({name: values[name] for name in self.free}, *drawn)

    def run(self, starts: Sequence[Mapping[str, float]], progress: Callable[[str], None] | None) -> ModelSearchResult:
        """Follow every start, and sort what they led to."""
        optima: list[ModelOptimum] = []
        done: list[ModelStart] = []
        interruption = Interruption()
        with interruption.listening(), one_thread():
            for k, at in enumerate(starts, start=1):
                if interruption.heard:
                    break
                if progress is not None:
                    best = f", best {min(o.objective for o in optima):.8g}" if optima else ""
                    progress(f"start {k} of {len(starts)}{best}")
                failure = ""
                try:
                    self._add(optima, k, self._optimum(at))
                except BoundaryError as error:
                    failure = str(error)
                done.append(ModelStart(k, at, failure))
        optima.sort(key=lambda optimum: optimum.objective)
        return ModelSearchResult(self.model, *self._ended(optima, done, interruption.heard), tuple(optima), tuple(done))

    def _optimum(self, at: Mapping[str, float]) -> PeriodicOrbit:
        """The optimum that the plain orbit at free parameters leads to; raises BoundaryError."""
        values = {**self.parameters, **at}
        first = self._plain(values, self.guess, self.period)
        asked = {**self.options, "free": self.free, "bounds": self.bounds, "parameters": values}
        return find_orbit(self.model, first, self._period_of(first), **asked)

    def _period_of(self, orbit: PeriodicOrbit) -> float | None:
        """The period as a guess; a forced model has its own."""
        return None if self.model.forced else orbit.period

    def _plain(self, values: Mapping[str, float], guess: Guess, period: float | None) -> PeriodicOrbit:
        plain = {key: value for key, value in self.options.items() if key not in ("objective", "running")}
        return find_orbit(self.model, guess, period, parameters=values, **plain)

    def _add(self, optima: list[ModelOptimum], number_of_start: int, orbit: PeriodicOrbit) -> None:
        """Keep an optimum, or note that a start led to one that is known."""
        for i, known in enumerate(optima):
            if self._same(known.orbit, orbit):
                optima[i] = replace(known, starts=(*known.starts, number_of_start))
                return
        values = {name: orbit.parameters[name] for name in self.model.parameter_names}
        plain = self._plain(values, orbit, self._period_of(orbit))
        optima.append(ModelOptimum(orbit, plain, (number_of_start,)))

    def _same(self, one: PeriodicOrbit, other: PeriodicOrbit) -> bool:
        pairs = [(one.period, other.period), *((one.parameters[n], other.parameters[n]) for n in self.free)]
        return all(abs(a - b) <= SAME * max(abs(a), abs(b), 1e-3) for a, b in pairs)

    def _ended(
        self, optima: Sequence[ModelOptimum], done: Sequence[ModelStart], interrupted: bool
    ) -> tuple[SearchStatus, str]:
        if interrupted:
            best = f"best so far {optima[0].objective:.10g}" if optima else "no optimum so far"
            return SearchStatus.INTERRUPTED, f"interrupted after {len(done)} starts; {best}"
        if not optima:
            unbounded = any("unbounded" in start.failure for start in done)
            infeasible = any("satisfies conditions and bounds" in start.failure for start in done)
            status = SearchStatus.UNBOUNDED if unbounded else SearchStatus.INFEASIBLE if infeasible else None
            return status or SearchStatus.FAILED, f"no start led to an optimum; the first: {done[0].failure}"
        count = f"{len(optima[0].starts)} of {len(done)} starts led to it"
        if optima[0].active:
            words = f"the best optimum sits on a bound: {', '.join(optima[0].active)}; {count}"
            return SearchStatus.ON_BOUND, words
        return SearchStatus.FOUND, f"found an optimum inside its bounds; {count}"
