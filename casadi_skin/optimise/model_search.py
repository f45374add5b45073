"""Orbits of any model found by optimisation: many starts of the boundary-value problem with an objective."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.arguments import short_repr
from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.statement import Statement, check_expression, named_values
from casadi_skin.models.ode import OdeModel
from casadi_skin.optimise.model_result import ModelOptimum, ModelSearchResult, ModelStart
from casadi_skin.optimise.processes import Interruption, gathered, pool
from casadi_skin.optimise.result import SearchStatus
from casadi_skin.orbits.find_orbit import find_orbit
from casadi_skin.orbits.guesses import Guess, sampled
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.refined import BoundaryError
from casadi_skin.threads import one_thread

SAME = 1e-5  # relative difference of free parameters, period and objective below which two optima are one
SAMPLES = 401  # of the guess over a period
EXPRESSIONS = ("objective", "running", "select", "section")


def search_model(
    model: OdeModel,
    *,
    guess: Guess,
    free: Sequence[str],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    period: float | None = None,
    parameters: Mapping[str, float] | None = None,
    starts: int = 4,
    seed: int = 0,
    workers: int = 1,
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> ModelSearchResult:
    """Find the periodic orbits of a model that minimise an objective over free parameters within bounds.

    `guess` and `period` are those of `find_orbit`, and so are the options, `objective` or `running` among them. The
    first start has the parameters given; the others have free parameters drawn evenly within their bounds, which have
    to be finite then. From each the plain orbit is solved, and Ipopt goes on from it with exact second derivatives.
    `workers` processes or an `executor` of processes share the starts. Ctrl-C ends the search with the best so far.
    Raises ValueError and TypeError, before anything is solved, for arguments that cannot be meant.
    """
    if options.get("objective") is None and options.get("running") is None:
        raise ValueError("objective: given neither objective nor running; accepted: one of them, or both")
    if not free:
        raise ValueError(f"free: given none; accepted: one or more of {', '.join(model.parameter_names)}")
    for name, value, least in (("starts", starts, 1), ("seed", seed, 0), ("workers", workers, 1)):
        if isinstance(value, bool) or not isinstance(value, int) or value < least:
            raise ValueError(f"{name}: given {short_repr(value)}; accepted: a whole number >= {least}")
    if isinstance(executor, ThreadPoolExecutor) or not isinstance(executor, Executor | None):
        raise TypeError(f"executor: given {short_repr(executor)}; accepted: a concurrent.futures.Executor of processes")
    search = _stated(model, guess, period, tuple(free), dict(bounds or {}), dict(parameters or {}), options)
    if workers > 1 or executor is not None:
        search.model.__reduce__()  # raises ValueError for what cannot be sent to a process
    return search.run(search.starts(starts, seed), workers, executor, progress)


def _stated(
    model: OdeModel,
    guess: Guess,
    period: float | None,
    free: tuple[str, ...],
    bounds: Mapping[str, tuple[float, float]],
    parameters: Mapping[str, float],
    options: Mapping[str, Any],
) -> _ModelSearch:
    """The search with what processes can share: expressions as outputs of the model, the guess as an array."""
    first, symbolic = model.first_order(), {}
    symbols = [first.state, first.parameters, *([first.time] if model.forced else [])]
    for name in EXPRESSIONS:
        expression = options.get(name)
        if expression is not None and not isinstance(expression, str):
            check_expression(name, expression, symbols)
            if expression.numel() != 1:
                raise ValueError(f"{name}: given shape {expression.shape}; accepted: a scalar expression")
            symbolic[name] = expression
    outputs = {**model.outputs, **{f"search {name}": expression for name, expression in symbolic.items()}}
    plain = {name: value for name, value in options.items() if name not in symbolic}
    values = named_values(first, parameters)
    length = period or getattr(guess, "period", None)
    if model.forced:
        length = int(options.get("cycles", 1)) * first.forcing_period_at(list(values.values()))
    if not length or not length > 0:
        raise ValueError(f"period: given {short_repr(period)}; accepted: a number > 0")
    t = np.linspace(0.0, float(length), SAMPLES)
    statement = Statement(first, [first.end(first.state) - first.start(first.state)], parameters=values)
    return _ModelSearch(
        replace(model, outputs=outputs, checked=False), t, sampled(statement, guess, t), free, bounds, parameters,
        tuple(symbolic), plain,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class _Ended:
    """What a start led to: an optimum as arrays and numbers, or a failure in words."""

    number: int
    free: Mapping[str, float]
    failure: str = ""
    parameters: Mapping[str, float] | None = None
    t: Array | None = None
    states: Array | None = None
    period: float = 0.0
    objective: float = np.inf


@dataclass(frozen=True, eq=False)
class _ModelSearch:
    """What is searched for, and in which bounds; can be pickled where the model can."""

    model: OdeModel
    t: Array
    states: Array
    free: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]]
    parameters: Mapping[str, float]
    symbolic: tuple[str, ...]
    plain: Mapping[str, Any]

    def starts(self, count: int, seed: int) -> tuple[Mapping[str, float], ...]:
        """Free parameters at every start; raises ValueError for names and bounds that cannot be used."""
        values = named_values(self.model.first_order(), self.parameters)
        for name in self.free:
            if name not in values:
                raise ValueError(f"free: given {short_repr(name)}; accepted: {', '.join(values)}")
            low, high = self.bounds.get(name, (-np.inf, np.inf))
            if not low < high:
                raise ValueError(
                    f"bounds: given {short_repr((low, high))} for {name}; accepted: (lower, upper), lower < upper"
                )
            if count > 1 and not np.all(np.isfinite((low, high))):
                raise ValueError(f"bounds: given no finite bounds of {name}; accepted: finite ones, or starts = 1")
        generator = np.random.default_rng(seed)
        drawn = [{name: generator.uniform(*self.bounds[name]) for name in self.free} for _ in range(count - 1)]
        return ({name: values[name] for name in self.free}, *drawn)

    # One start ------------------------------------------------------------------------------------------------------

    def options(self, minimised: bool) -> dict[str, Any]:
        """Options of `find_orbit`, with the expressions in the model's own symbols."""
        made = {name: self.model.outputs[f"search {name}"] for name in self.symbolic} | dict(self.plain)
        if minimised:
            return made | {"free": self.free, "bounds": self.bounds}
        return {name: value for name, value in made.items() if name not in ("objective", "running")}

    def orbit(self, values: Mapping[str, float], t: Array, states: Array, minimised: bool) -> Orbit:
        """The orbit near states at times over a period: the plain one, or the optimum; raises BoundaryError."""
        period = None if self.model.forced else float(t[-1])
        return find_orbit(self.model, (t, states), period, parameters=values, **self.options(minimised))

    def follow(self, number: int, at: Mapping[str, float]) -> _Ended:
        """What the start at free parameters leads to."""
        values = {**self.parameters, **at}
        try:
            first = self.orbit(values, self.t, self.states, minimised=False)
            found = self.orbit(values, *_over_period(first), minimised=True)
        except BoundaryError as error:
            return _Ended(number, at, str(error))
        assert found.optimum is not None
        named = {name: found.parameters[name] for name in self.model.parameter_names}
        return _Ended(number, at, "", named, *_over_period(found), found.period, found.optimum.objective)

    def _follow_elsewhere(self, number: int, at: Mapping[str, float]) -> _Ended:
        """The same in a process of its own, which leaves Ctrl-C to the one that waits."""
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        return self.follow(number, at)

    # All starts -----------------------------------------------------------------------------------------------------

    def run(
        self,
        starts: Sequence[Mapping[str, float]],
        workers: int,
        executor: Executor | None,
        progress: Callable[[str], None] | None,
    ) -> ModelSearchResult:
        """Follow every start, and sort what they led to."""
        interruption = Interruption()
        ended: list[_Ended] = []
        with interruption.listening(), one_thread():
            for found in self._followed(starts, workers, executor, interruption):
                ended.append(found)
                best = min(e.objective for e in ended)
                if progress is not None:
                    words = f"{best:.8g}" if np.isfinite(best) else "none yet"
                    progress(f"{len(ended)} of {len(starts)} starts done; best objective {words}")
            ended.sort(key=lambda e: e.number)
            optima = sorted(self._distinct(ended), key=lambda optimum: optimum.objective)
        done = tuple(ModelStart(e.number, e.free, e.failure) for e in ended)
        status, reason = _verdict(optima, done, interruption.heard)
        return ModelSearchResult(self.model, status, reason, tuple(optima), done)

    def _followed(
        self,
        starts: Sequence[Mapping[str, float]],
        workers: int,
        executor: Executor | None,
        interruption: Interruption,
    ) -> Iterator[_Ended]:
        """What the starts led to, as they end, until an interruption."""
        jobs = list(enumerate(starts, start=1))
        if executor is None and (workers == 1 or len(jobs) == 1):
            for job in jobs:
                if interruption.heard:
                    return
                yield self.follow(*job)
            return
        own = None if executor is not None else pool(workers, len(jobs))
        try:
            futures = {(executor or own).submit(self._follow_elsewhere, *job) for job in jobs}  # type: ignore[union-attr]
            yield from gathered(futures, interruption, abandoned=executor is not None)
        finally:
            if own is not None:
                own.shutdown(cancel_futures=True)

    def _distinct(self, ended: Sequence[_Ended]) -> Iterator[ModelOptimum]:
        """One optimum for each group of starts that led to the same, solved and checked here."""
        groups: list[list[_Ended]] = []
        for found in (e for e in ended if not e.failure):
            same = next((group for group in groups if self._same(group[0], found)), None)
            if same is None:
                groups.append([found])
            else:
                same.append(found)
        for group in groups:
            first = group[0]
            assert first.parameters is not None
            assert first.t is not None
            assert first.states is not None
            at = (first.parameters, first.t, first.states)
            orbit, plain = self.orbit(*at, minimised=True), self.orbit(*at, minimised=False)
            yield ModelOptimum(orbit, plain, tuple(e.number for e in group))

    def _same(self, one: _Ended, other: _Ended) -> bool:
        assert one.parameters is not None
        assert other.parameters is not None
        pairs = [
            (one.period, other.period),
            (one.objective, other.objective),
            *((one.parameters[n], other.parameters[n]) for n in self.free),
        ]
        return all(abs(a - b) <= SAME * max(abs(a), abs(b), 1e-3) for a, b in pairs)


def _over_period(orbit: Orbit) -> tuple[Array, Array]:
    """Times over a period and the states there."""
    t = np.linspace(0.0, orbit.period, SAMPLES)
    return t, orbit.evaluate(t)


def _verdict(optima: Sequence[ModelOptimum], done: Sequence[ModelStart], interrupted: bool) -> tuple[SearchStatus, str]:
    """How the search ended, with the reason in a sentence."""
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
        return SearchStatus.ON_BOUND, f"the best optimum sits on a bound: {', '.join(optima[0].active)}; {count}"
    return SearchStatus.FOUND, f"found an optimum inside its bounds; {count}"
