"""Interface between a search and a discretisation: starts, their outcomes, and optima made final.

An optimum of a search: free numbers, orbits, and its checks.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.solution import Orbit
from casadi_skin.model.arguments import accepted_names, number, short_repr
from casadi_skin.search.nlp import STOPPED_STATUS, Kkt, Nlp, Optimality, Solution, Stated, optimality
from casadi_skin.solve.ipopt import Monitor
from casadi_skin.zero.cosines import cosine_matrix
from casadi_skin.zero.problem import Array

CONVERGED = 1e-7  # residual of an optimum, whatever Ipopt says of it
FEASIBLE_VIOLATION = 1e-9  # violation of a constraint, relative to its terms
START_RANGE_MARGIN = 0.02  # of a range, which starts keep from its ends


class Ending(Enum):
    """End of one start."""

    CONVERGED = "an optimum"
    INFEASIBLE = "nothing near the start meets the constraints"
    UNBOUNDED = "ran off without bound"
    INTERRUPTED = "interrupted"
    FAILED = "not converged in the iterations allowed"
    NO_ORBIT = "no orbit to start from"
    NO_OPTIMUM = "stationary, but no optimum"


SEARCH_ENDINGS: Mapping[str, Ending] = {
    STOPPED_STATUS: Ending.INTERRUPTED,
    "Diverging_Iterates": Ending.UNBOUNDED,
    "Infeasible_Problem_Detected": Ending.INFEASIBLE,
    "Restoration_Failed": Ending.INFEASIBLE,
}


@dataclass(frozen=True)
class Start:
    """A start: its number from 1, and the free numbers that it starts from."""

    number: int
    free: tuple[float, ...]
    name: str = ""


def _empty() -> Array:
    return np.zeros(0)


@dataclass(frozen=True, eq=False)
class Outcome:
    """Outcome of a start.

    Attributes:
        start: the start.
        ending: how it ended.
        words: the reason: Ipopt's return status, or why there was no orbit.
        solution: where Ipopt ended; None where there was no orbit to start from.
        free: the free numbers of the solution.
        place: the same with frequencies, scaled: optima at a distance below 1e-4 are one.
        times: of the states in the solution of a boundary-value problem; empty for odd cosines.
        violation: the largest violation of a constraint relative to its terms.
        worst: the constraint with the largest violation, and `gap` that violation in its own units.
    """

    start: Start
    ending: Ending
    words: str
    solution: Solution | None = None
    free: Array = field(default_factory=_empty)
    place: Array = field(default_factory=_empty)
    times: Array = field(default_factory=_empty)
    violation: float = np.inf
    worst: str = ""
    gap: float = np.inf

    @property
    def last(self) -> tuple[int, float, float]:
        """Iterations, objective and largest violation."""
        return (0, np.inf, self.gap) if self.solution is None else (self.solution.iterations, self.objective, self.gap)

    @property
    def objective(self) -> float:
        """Objective of the solution; infinite where there is none."""
        return np.inf if self.solution is None else self.solution.objective

    @property
    def feasible(self) -> bool:
        """Whether every constraint is met."""
        return self.violation <= FEASIBLE_VIOLATION


class Startable(Protocol):
    """A search as one start needs it."""

    def nlp_at(self, start: Start) -> tuple[Nlp, Array]:
        """The nonlinear programme of a start, and an orbit at its parameters as a point of it.

        Raises ArithmeticError where there is no orbit.
        """


def lost_start(start: Start, words: str) -> Outcome:
    """Outcome of a start whose processes were ended, in words; it may be run again."""
    return Outcome(start, Ending.INTERRUPTED, words)


def solve_start(problem: Startable, start: Start, monitor: Monitor | None = None) -> Outcome:
    """Outcome of a start: an orbit there, then Ipopt."""
    try:
        nlp, x = problem.nlp_at(start)
    except ArithmeticError as error:
        return Outcome(start, Ending.NO_ORBIT, " ".join(str(error).split()))
    return judged(nlp, start, nlp.solve(x, monitor))


def judged(nlp: Nlp, start: Start, solution: Solution) -> Outcome:
    """The outcome of a solution: an optimum where our own conditions of optimality say so."""
    ending, x = SEARCH_ENDINGS.get(solution.words, Ending.FAILED), solution.x
    if not np.all(np.isfinite(x)):
        return Outcome(start, ending, solution.words, solution)
    gaps, found = nlp.violations(nlp.residual(x)), optimality(nlp, solution)
    worst, words = int(np.argmax(gaps)), solution.words
    if ending in (Ending.FAILED, Ending.INFEASIBLE) and max(found.kkt.largest, gaps[worst]) <= CONVERGED:
        words = nlp.fault(x) or (f"curvature {found.negative:.1e} of the largest" if found.negative < 0 else words)
        ending = Ending.CONVERGED if words == solution.words else Ending.NO_OPTIMUM
    return Outcome(
        start=start,
        ending=ending,
        words=words,
        solution=solution,
        free=x[nlp.measured],
        place=nlp.place_of(x),
        times=nlp.times(x),
        violation=found.kkt.violation,
        worst=nlp.row_name(worst, x),
        gap=float(gaps[worst]),
    )


def sampled_starts(
    values: Sequence[float], limits: Sequence[tuple[float, float]], count: int, seed: int
) -> list[tuple[float, ...]]:
    """Free numbers of starts: the own values first, then a Halton sequence (Halton 1960; Owen 2017) in the limits.

    Where a limit is missing the range is from half to twice the own value. All are moved within their ranges, which end
    a little inside of the limits.
    """
    ranges = []
    for value, (low, high) in zip(values, limits, strict=True):
        span = sorted((0.5 * value, 2.0 * value)) if value != 0 else [-1.0, 1.0]
        width = span[1] - span[0]
        least = low if np.isfinite(low) and np.isfinite(high) else max(low, min(span[0], high - width))
        most = high if np.isfinite(high) else max(span[1], least + width)
        inside = START_RANGE_MARGIN * (most - least)
        ranges.append((least + inside, most - inside))
    lows, highs = np.array(ranges).T
    rows = [np.clip(values, lows, highs)]
    if count > 1:
        from scipy.stats import qmc

        drawn = qmc.Halton(len(ranges), scramble=True, seed=np.random.default_rng(seed)).random(count - 1)
        rows += [*(lows + drawn * (highs - lows))]
    return [tuple(row.tolist()) for row in rows]


# Arguments of a search, checked before anything is solved: free names, bounds, conditions -----------------------------

PAIR_WORDS = "a pair (lower, upper) of numbers, None where there is no bound"
CONDITION_WORDS = "what is to vanish, or (quantity, lower, upper); a quantity is a name or {}"


@dataclass(frozen=True)
class Condition:
    """lower <= quantity <= upper; an equality where the two are equal."""

    quantity: Any
    lower: float
    upper: float
    name: str

    @property
    def equality(self) -> bool:
        """Whether the two bounds are equal."""
        return self.lower == self.upper


def named(conditions: Sequence[Condition], columns: Sequence[Any]) -> dict[str, Stated]:
    """The columns of conditions, as an `Nlp` takes them; a name that comes again has its item beside it."""
    found = dict[str, Stated]()
    for item, (condition, column) in enumerate(zip(conditions, columns, strict=True), start=1):
        name = condition.name if condition.name not in found else f"{condition.name} ({item})"
        found[name] = column, condition.lower, condition.upper
    return found


def free_names(free: Sequence[str] | str, known: Iterable[str], label: str = "free") -> tuple[str, ...]:
    """The names of free numbers; raises ValueError for unknown names, for none, and for one that comes twice."""
    accepted = tuple(known)
    if not isinstance(free, str | list | tuple):
        raise TypeError(f"{label}: given {short_repr(free)}; accepted: a list of {', '.join(accepted)}")
    names = (free,) if isinstance(free, str) else tuple(free)
    for name in names:
        if not isinstance(name, str) or name not in accepted:
            raise ValueError(f"{label}: given {short_repr(name)}; {accepted_names(name, accepted)}")
    if not names or len(set(names)) < len(names):
        given = short_repr(list(names)) if names else "none"
        raise ValueError(f"{label}: given {given}; accepted: one or more of {', '.join(accepted)}, each once")
    return names


def pair(place: str, given: object) -> tuple[float, float]:
    """Two bounds; raises TypeError and ValueError unless they are a pair of ascending numbers."""
    ends = tuple(given) if isinstance(given, list | tuple) else ()
    if len(ends) != 2:
        raise TypeError(f"{place}: given {short_repr(given)}; accepted: {PAIR_WORDS}")
    lower, upper = (
        absent if value is None or (isinstance(value, float) and value == absent) else number(place, value, PAIR_WORDS)
        for value, absent in zip(ends, (-math.inf, math.inf), strict=True)
    )
    if lower > upper:
        raise ValueError(f"{place}: given {short_repr(given)}; accepted: (lower, upper), lower <= upper")
    return lower, upper


def checked_bounds(
    bounds: Mapping[str, object] | None,
    free: Mapping[str, tuple[float, float]],
    fixed: Iterable[str],
    quantities: Iterable[str],
) -> tuple[dict[str, tuple[float, float]], tuple[Condition, ...]]:
    """Limits of the free numbers, and conditions from the bounds on quantities.

    Arguments:
        bounds: pairs by name.
        free: default ranges of the free numbers.
        fixed: parameters that are not free: they take no bounds.
        quantities: other names that may have bounds.

    Raises:
        ValueError, TypeError: names and pairs that cannot be used.
    """
    if not isinstance(bounds, Mapping | None):
        raise TypeError(f"bounds: given {short_repr(bounds)}; accepted: a mapping of names to pairs (lower, upper)")
    limits, conditions, held = dict(free), list[Condition](), tuple(fixed)
    known = tuple(dict.fromkeys((*free, *held, *quantities)))
    for name, given in (bounds or {}).items():
        place = f"bounds[{name}]"
        if not isinstance(name, str) or name not in known:
            raise ValueError(f"bounds: given {short_repr(name)}; {accepted_names(name, known)}")
        lower, upper = pair(place, given)
        if name in free:
            if lower == upper:
                raise ValueError(f"{place}: given {short_repr(given)}; accepted: different bounds, or {name} not free")
            least, most = free[name]
            limits[name] = (lower if lower > -math.inf else least, upper if upper < math.inf else most)
        elif name in held:
            accepted = f"{', '.join(free)}, or quantities of the orbit"
            raise ValueError(f"{place}: given a bound on {name}, which is not free; accepted: {accepted}")
        else:
            conditions.append(Condition(name, lower, upper, name))
    return limits, tuple(conditions)


def checked_conditions(
    constraints: Sequence[object], kinds: tuple[Any, ...], what: str, label: str = "constraints"
) -> tuple[Condition, ...]:
    """Conditions from a list of items, each a quantity that has to vanish or one with its bounds.

    A quantity is a name or of one of `kinds`, which error messages call `what`.
    """
    accepted = CONDITION_WORDS.format(what)
    if not isinstance(constraints, list | tuple):
        raise TypeError(f"{label}: given {short_repr(constraints)}; accepted: a list of items, each {accepted}")
    found = []
    for item, given in enumerate(constraints, start=1):
        place, (quantity, lower, upper) = f"{label}, item {item}", (given, 0.0, 0.0)
        if not isinstance(given, kinds):
            if not isinstance(given, tuple | list) or len(given) != 3:
                raise TypeError(f"{place}: given {short_repr(given)}; accepted: {accepted}")
            quantity, (lower, upper) = given[0], pair(place, given[1:])
        if not isinstance(quantity, (str, *kinds)):
            raise TypeError(f"{place}: given {short_repr(quantity)}; accepted: {accepted}")
        name = quantity if isinstance(quantity, str) else getattr(quantity, "__name__", "<lambda>")
        found.append(Condition(quantity, lower, upper, name if name != "<lambda>" else f"constraint {item}"))
    return tuple(found)


# An orbit in arrays and numbers: a sum of odd cosines, without the equations that it came from ------------------------


@dataclass(frozen=True, eq=False)
class CosineOrbit:
    """An orbit y_n(t) = sum_k c_kn cos((2k+1) Omega t), all velocities zero at t = 0; it can be sent to a process.

    Attributes:
        model: the chain or the model, with the parameters of the orbit; None of a nonuniform chain.
        S: total amplitude, the sum of y_n(0)^2.
        Omega: frequency.
        cosines: c_kn, shape (harmonics, components).
    """

    model: Any
    S: float
    Omega: float
    cosines: Array

    @classmethod
    def of(cls, orbit: Orbit) -> CosineOrbit:
        """The arrays and numbers of an orbit."""
        return cls(orbit.model, orbit.S, orbit.Omega, orbit.coefficients(orbit.harmonics))

    @classmethod
    def at_nodes(cls, model: Any, S: float, Omega: float, values: Array) -> CosineOrbit:
        """From displacements at the nodes, (components, harmonics); the largest at t = 0 becomes positive."""
        harmonics = values.shape[1]
        found = (2.0 / harmonics) * cosine_matrix(harmonics) @ values.T
        start = found.sum(axis=0)
        return cls(model, S, Omega, np.asarray(found * np.sign(start[np.argmax(np.abs(start))])))

    @property
    def period(self) -> float:
        """2 pi/Omega."""
        return 2.0 * np.pi / self.Omega

    @property
    def harmonics(self) -> int:
        """Number of odd harmonics."""
        return len(self.cosines)

    def coefficients(self, harmonics: int) -> Array:
        """The first coefficients c_kn, shape (harmonics, components); 0 beyond those that the orbit has."""
        kept = self.cosines[:harmonics]
        return np.pad(kept, ((0, harmonics - len(kept)), (0, 0)))

    def evaluate(self, t: ArrayLike) -> Array:
        """Displacements y_n(t), shape (time, component)."""
        odd = 2 * np.arange(self.harmonics) + 1
        times = np.atleast_1d(np.asarray(t, dtype=float))
        return np.asarray(np.cos(np.outer(self.Omega * times, odd)) @ self.cosines)

    @cached_property
    def profile(self) -> Array:
        """Displacements at t = 0, shape (components,)."""
        return np.asarray(self.cosines.sum(axis=0))


@dataclass(frozen=True)
class PlainCheck:
    """An orbit of a search beside the plain orbit problem at its parameters, solved without objective.

    Attributes:
        converged: whether the plain problem was solved.
        Omega_difference: its Omega less that of the optimum, absolute.
        difference: the larger of those of the period and of the states, both relative.
        residual: of the plain problem's equations, relative to their largest term.
        resolution: harmonics or intervals of the plain problem.
    """

    converged: bool
    Omega_difference: float
    difference: float
    residual: float
    resolution: int


@dataclass(frozen=True, eq=False)
class Optimum:
    """A local optimum: free numbers, the orbit, and its check. Every quantity of the orbit is an attribute too.

    Attributes:
        objective: value of the objective.
        parameters: the free numbers by name.
        orbit: the orbit.
        quantities: its quantities by name: parameters, period, Omega, and further ones of its problem.
        check: the orbit beside a plain solution.
        conditions: values of the conditions by name.
        active: bounds that are active, such as "gamma >= 0".
        kkt: residuals of the conditions of first order, from multipliers and derivatives.
        curvature: the smallest eigenvalue of the Hessian of the Lagrangian (of the negative objective where that is
            maximised) in the free numbers that the constraints leave: positive at a strict optimum, infinite where
            no number is left, nan where it is not computed.
        errors: estimated absolute errors of the objective, Omega or the period, and free numbers by discretisation.
        resolution: harmonics, or intervals of the mesh.
        starts: numbers of the starts that led here.
    """

    objective: float
    parameters: Mapping[str, float]
    orbit: Orbit
    quantities: Mapping[str, Any]
    check: PlainCheck
    conditions: Mapping[str, Array]
    active: tuple[str, ...]
    kkt: Kkt
    curvature: float
    errors: Mapping[str, float]
    resolution: int
    starts: tuple[int, ...]

    def __repr__(self) -> str:
        free = ", ".join(f"{name} = {value:.10g}" for name, value in list(self.parameters.items())[:4])
        return f"<Optimum: objective {self.objective:.10g} at {free}{', ...' if len(self.parameters) > 4 else ''}>"

    @classmethod
    def of(cls, nlp: Nlp, solution: Solution, found: Optimality, free_names: Sequence[str], **known: Any) -> Optimum:
        """The optimum at the end of Ipopt, with the conditions of optimality there and all else by name."""
        residual, free = nlp.residual(solution.x), solution.x[nlp.measured].tolist()
        return cls(
            objective=solution.objective, parameters=dict(zip(free_names, free, strict=True)), kkt=found.kkt,
            conditions={name: residual[rows] for name, rows in nlp.conditions.items()}, active=found.active,
            curvature=found.curvature, **known,
        )  # fmt: skip

    def __getattr__(self, name: str) -> Any:
        quantities = self.__dict__.get("quantities", {})
        if name not in quantities:
            raise AttributeError(f"optimum: given {name}; {accepted_names(name, quantities)}")
        return quantities[name]

    def is_near(self, other: Optimum, tolerance: float) -> bool:
        """Whether objective, free numbers and frequencies are those of another optimum, relative to them or to 1."""
        one, two = (np.array([o.objective, *o.parameters.values(), o.quantities["Omega"]]) for o in (self, other))
        return bool(np.all(np.abs(one - two) <= tolerance * np.maximum(1.0, np.abs(one))))
