"""A design: parameters at which something located is best, with the way to it; and the best of those of several starts.

`optimise` and `search_orbit` give one, whichever engine found it: SLSQP on gradients of located solutions, or Ipopt on
the equations of one orbit. Every start ends with a design, an optimum or not.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np

from casadi_skin.model.arguments import accepted_names
from casadi_skin.model.result import Result
from casadi_skin.zero.problem import Array

ENGINE = "SLSQP on gradients of located solutions"
FEASIBLE = 1e-9  # violation of a constraint, relative to its gradient
SAME_DESIGN_RTOL = 1e-5  # of the ranges: distance of designs that are one
SAME_VALUE_RTOL = 1e-4  # of the largest on their ways: difference of their values; and of their frequencies
NAMES_IN_SCRIPTS = {"objective": "value", "orbit": "solution", "orbits": "located"}  # as they stand in older ones


class Ending(Enum):
    """How a start ended."""

    FOUND = "found an optimum"
    INFEASIBLE = "the constraints are not met"
    UNBOUNDED = "ran off without bound"
    INTERRUPTED = "interrupted"
    FAILED = "not converged"
    NOT_LOCATED = "not located at the start"
    NO_OPTIMUM = "no optimum"


@dataclass(frozen=True, eq=False)
class Design(Result):
    """The best design, with the way to it. What it has not is nan, or empty.

    Parameters and quantities of the first located solution are attributes too. `objective` is another name of `value`,
    `orbit` of `solution`, `orbits` of `located`.

    Attributes:
        quantity: what was optimised, in words; `maximise` says which way.
        value: its value, with the estimated absolute `error`.
        parameters: of the design, by name, each with its bounds in `bounds`.
        path: designs on the way, shape (designs, parameters), and `values` the quantity there.
        status: how it ended, and `reason` in a sentence, which begins with it.
        engine: how it was found.
        located: the special points, orbits and equilibria there; of a family a `CosineOrbit`.
        quantities: of each of them by name, numbers or arrays.
        conditions: values of the constraints by name.
        multipliers: derivatives of the value by bounds that hold the optimum, such as "gamma >= 0", and by what
            equalities are equal to, by the same words.
        optimality: what the conditions of first order leave of the gradient, relative to the largest on the way, by
            parameters over their ranges, or to its terms; `optimality_error` is its estimated error.
        violation: the largest one of a constraint, relative to its gradient or its terms.
        curvature: by Ipopt: the smallest eigenvalue of the Hessian of the Lagrangian (of the negative value where that
            is maximised) in the parameters that constraints leave: positive at a strict optimum, infinite where none
            is left.
        difference: by Ipopt: relative difference, of the period and the states, from the orbit without an objective.
        others: further distinct optima, of other starts, best first.
        starts: of the best of several starts the reason of each.
    """

    quantity: str
    maximise: bool
    value: float
    error: float
    parameters: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    path: Array
    values: Array
    status: Ending
    reason: str
    engine: str = ENGINE
    located: tuple[Any, ...] = ()
    quantities: tuple[Mapping[str, Any], ...] = ()
    conditions: Mapping[str, Array] = field(default_factory=dict)
    multipliers: Mapping[str, float] = field(default_factory=dict)
    optimality: float = np.nan
    optimality_error: float = np.nan
    violation: float = np.inf
    curvature: float = np.nan
    difference: float = np.nan
    others: tuple[Design, ...] = ()
    starts: tuple[str, ...] = ()

    def __repr__(self) -> str:
        named = ", ".join(f"{name} = {value:.10g}" for name, value in list(self.parameters.items())[:4])
        more = ", ..." if len(self.parameters) > 4 else ""
        return f"<Design: {self.quantity} = {self.value:.10g} at {named}{more}; {self.reason}>"

    def __getitem__(self, name: str) -> Any:
        """A parameter, or a quantity of the first located solution; raises KeyError for other names."""
        known = {**next(iter(self.quantities), {}), **self.parameters}
        if name not in known:
            raise KeyError(accepted_names(name, known))
        return known[name]

    def __getattr__(self, name: str) -> Any:
        """The same as an attribute."""
        if name in NAMES_IN_SCRIPTS:
            return getattr(self, NAMES_IN_SCRIPTS[name])
        try:
            return self[name] if "quantities" in vars(self) else vars(self)[name]
        except KeyError as error:
            raise AttributeError(f"design: given {name}; {error.args[0]}") from None

    @property
    def found(self) -> bool:
        """Whether it is an optimum."""
        return self.status is Ending.FOUND

    @property
    def active(self) -> tuple[str, ...]:
        """Bounds that hold the optimum."""
        return inequalities(self.multipliers)

    @property
    def solution(self) -> Any:
        """The first located solution; raises ValueError with the reason where there is none."""
        if not self.located:
            raise ValueError(f"design: nothing is located; {self.reason}")
        return self.located[0]

    @property
    def optima(self) -> tuple[Design, ...]:
        """Distinct optima, best first."""
        return (self, *self.others) if self.found else self.others

    @property
    def best(self) -> Design:
        """The best optimum; raises ValueError with the reason where there is none."""
        if not self.found:
            raise ValueError(f"design: no optimum; {self.reason}")
        return self

    def is_near(self, other: Design) -> bool:
        """Whether two designs are one: parameters, value and frequencies are the same."""
        low, high = np.array(list(self.bounds.values())).T
        own = np.max(np.abs(np.vstack([self.path, other.path])), axis=0)  # of the numbers on the way
        scale = np.where(np.isfinite(high - low), high - low, np.where(own > 0.0, own, 1.0))
        one, two = ([known.get("Omega", 0.0) for known in d.quantities] for d in (self, other))
        near = np.max(np.abs(self.path[-1] - other.path[-1]) / scale) <= SAME_DESIGN_RTOL
        return bool(near) and np.allclose(one, two, SAME_VALUE_RTOL, 0.0) and same_value(self, other)


def same_value(one: Any, other: Any) -> bool:
    """Whether two ends of starts, designs or points of programmes, have the same value."""
    largest = np.max(np.abs([*one.values, *other.values]))
    return bool(abs(one.values[-1] - other.values[-1]) <= SAME_VALUE_RTOL * largest)


def inequalities(multipliers: Mapping[str, float]) -> tuple[str, ...]:
    """The words of active bounds, without those of equalities."""
    return tuple(words for words in multipliers if " = " not in words)


def optimum_words(multipliers: Mapping[str, float]) -> str:
    """Where an optimum is, by its bounds."""
    active = ", ".join(inequalities(multipliers))
    return f"the optimum sits on a bound: {active}" if active else f"{Ending.FOUND.value} inside its bounds"


# The best of several starts -------------------------------------------------------------------------------------------


def grouped(ends: Sequence[Any]) -> list[list[Any]]:
    """The ends of starts, designs or points of programmes, that found an optimum; those of one optimum together."""
    groups = list[list[Any]]()
    for end in ends:
        if end.found:
            same = next((group for group in groups if group[0].is_near(end)), None)
            if same is None:
                groups.append(same := [])
            same.append(end)
    return groups


def best_of(ends: Sequence[Design], interrupted: str = "") -> Design:
    """The best of the designs of several starts, in their order; where none is an optimum, the nearest to one.

    That is one that ran off without bound, or the one that violates the constraints least.
    """
    groups, many = grouped(ends), len(ends)

    def order(one: Design) -> tuple[bool, float, float]:
        value = -one.value if one.maximise else one.value
        return one.status is not Ending.UNBOUNDED, max(one.violation, FEASIBLE), value

    groups.sort(key=lambda group: order(group[0])[-1])
    best, words = (groups[0][0] if groups else min(ends, key=order)), [interrupted] if interrupted else []
    words.append(best.reason)
    if groups and many > 1:
        words.append(f"{len(groups[0])} of {many} starts led to it")
    away = sum(end.status is Ending.UNBOUNDED for end in ends)
    if groups and away:
        words.append(f"{away} {Ending.UNBOUNDED.value}, so it is a local one")
    return replace(
        best, reason="; ".join(words), others=tuple(group[0] for group in groups[1:]),
        starts=tuple(end.reason for end in ends),
    )  # fmt: skip
