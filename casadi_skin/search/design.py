"""A design: parameters at which something located is best, with the way to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.model.arguments import accepted_names
from casadi_skin.model.result import Result
from casadi_skin.zero.problem import Array

ENGINE = "SLSQP on gradients of located solutions"
SAME_DESIGN_RTOL = 1e-5  # of the ranges: distance of designs that are one


@dataclass(frozen=True, eq=False)
class Design(Result):
    """The best design, with the way to it.

    Attributes:
        quantity: what was optimised, in words; `maximise` says which way.
        value: its value, with the estimated absolute `error`.
        parameters: of the design, by name, each with its bounds in `bounds`.
        located: the special points, orbits and equilibria there; of a family a `CosineOrbit`.
        quantities: of each of them by name, numbers or arrays.
        conditions: values of the constraints by name.
        active: bounds that hold the optimum, such as "gamma >= 0".
        multipliers: derivatives of the value by these bounds and by what equalities are equal to, by the same words.
        optimality: what the conditions of first order leave of the gradient, relative to the largest on the way, by
            parameters over their ranges; `optimality_error` is its estimated error.
        path: designs on the way, shape (designs, parameters), and `values` the quantity there.
        found: whether it is an optimum; how the search ended in `reason`.
        others: further distinct optima, of other starts, best first.
        engine: how it was found.
    """

    quantity: str
    maximise: bool
    value: float
    error: float
    parameters: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]]
    located: tuple[Any, ...]
    quantities: tuple[Mapping[str, Any], ...]
    conditions: Mapping[str, Array]
    active: tuple[str, ...]
    multipliers: Mapping[str, float]
    optimality: float
    optimality_error: float
    path: Array
    values: Array
    found: bool
    reason: str
    others: tuple[Design, ...] = ()
    engine: str = ENGINE

    def __repr__(self) -> str:
        named = ", ".join(f"{name} = {value:.10g}" for name, value in list(self.parameters.items())[:4])
        more = ", ..." if len(self.parameters) > 4 else ""
        return f"<Design: {self.quantity} = {self.value:.10g} at {named}{more}; {self.reason}>"

    def __getitem__(self, name: str) -> Any:
        """A parameter, or a quantity of the first located solution; raises KeyError for other names."""
        known = {**self.quantities[0], **self.parameters}
        if name not in known:
            raise KeyError(accepted_names(name, known))
        return known[name]

    def __getattr__(self, name: str) -> Any:
        """The same as an attribute, as of an optimum of a search."""
        known = {**self.__dict__.get("quantities", ({},))[0], **self.__dict__.get("parameters", {})}
        if name not in known:
            raise AttributeError(f"design: given {name}; {accepted_names(name, known)}")
        return known[name]

    @property
    def solution(self) -> Any:
        """The first located solution."""
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

    @property
    def objective(self) -> float:
        """The value, by the name that it has in a search."""
        return self.value

    @property
    def orbit(self) -> Any:
        """The first located solution, by the name that it has in a search."""
        return self.solution

    @property
    def orbits(self) -> tuple[Any, ...]:
        """What is located, by the name that it has in a search."""
        return self.located

    def is_near(self, other: Design) -> bool:
        """Whether two designs are one."""
        low, high = np.array(list(self.bounds.values())).T
        scale = np.where(np.isfinite(high - low), high - low, np.maximum(1.0, np.abs(self.path[-1])))
        apart = np.abs(self.path[-1] - other.path[-1]) / scale
        return self.found == other.found and bool(np.max(apart) <= SAME_DESIGN_RTOL)
