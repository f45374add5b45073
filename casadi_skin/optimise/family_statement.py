"""Statement of a search among the orbits of one mode's family, in odd cosines, of a chain or of a model."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import casadi as ca
import numpy as np

from casadi_skin.model.arguments import accepted_names, number, short_repr
from casadi_skin.model.arrays import real_array
from casadi_skin.model.expressions import is_comparison
from casadi_skin.optimise.chain_family import ChainFamily
from casadi_skin.optimise.model_family import ModelFamily
from casadi_skin.optimise.observables import FreeNumber, Observables
from casadi_skin.optimise.search_arguments import Condition, checked_bounds, checked_conditions, free_names
from casadi_skin.zero.problem import Array

Family = ChainFamily | ModelFamily
Quantity = str | Callable[..., Any]  # a name, or a function of Observables (of several orbits: a tuple of them)

FAINTEST = 1e-6  # S where no lower bound is given


@dataclass(frozen=True)
class FamilyStatement:
    """Search among the orbits of a family at the amplitudes S, which share the parameters.

    Where "S" is free, `amplitudes` has that of the first start; `several` is true where S is a list.
    """

    family: Family
    amplitudes: tuple[float, ...]
    several: bool
    objective: Quantity
    maximise: bool
    free: tuple[str, ...]
    bounds: tuple[tuple[float, float], ...]
    conditions: tuple[Condition, ...]
    tolerance: float = 1e-8

    @classmethod
    def of(
        cls,
        family: Family,
        *,
        S: object,
        objective: Quantity,
        free: Sequence[str],
        bounds: Mapping[str, Any] | None = None,
        constraints: Sequence[Any] = (),
        maximise: bool = False,
        tolerance: float = 1e-8,
    ) -> Self:
        """From the arguments of `search_orbit`; raises ValueError and TypeError for values that are not accepted."""
        several = isinstance(S, list | tuple | np.ndarray)
        amplitudes = tuple(real_array("S", S).ravel().tolist()) if several else (number("S", S, "a finite number > 0"),)
        if not amplitudes or min(amplitudes) <= 0:
            raise ValueError(f"S: given {short_repr(S)}; accepted: a finite number > 0, or a list of such numbers")
        known = {"S": (FAINTEST, math.inf)} | {name: (f.lower, f.upper) for name, f in family.free.items()}
        names = free_names(free, known)
        if several and "S" in names:
            raise ValueError("free: given S with a list of S; accepted: S free with one number as its start")
        fixed, quantities = [name for name in known if name not in names], family.equations({}, ca.SX.sym("S")).names
        limits, more = checked_bounds(bounds, {name: known[name] for name in names}, fixed, quantities)
        if "S" in names:
            low, high = limits["S"]
            if low < 0 or high <= 0:
                raise ValueError(f"bounds[S]: given {short_repr([low, high])}; accepted: bounds within 0 to inf")
            limits["S"] = max(low, FAINTEST), high
        if not 1e-12 <= number("tolerance", tolerance) <= 1e-2:
            raise ValueError(f"tolerance: given {tolerance!r}; accepted: 1e-12 to 1e-2")
        conditions = (*checked_conditions(constraints, (Callable,), "a function of the observables"), *more)
        search = cls(
            family.limited({name: limits[name] for name in names if name != "S"}), amplitudes, several, objective,
            bool(maximise), names, tuple(limits[name] for name in names), conditions, float(tolerance),
        )  # fmt: skip
        search._check_expressions()
        return search

    # The statement ----------------------------------------------------------------------------------------------------

    @property
    def model(self) -> Any:
        return self.family.model

    @property
    def _numbers(self) -> dict[str, FreeNumber]:
        known = {"S": FreeNumber(self.amplitudes[0], FAINTEST, math.inf, ("S",)), **self.family.free}
        return {name: known[name] for name in self.free}

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of the free numbers, one each."""
        return tuple(name for number in self._numbers.values() for name in number.names)

    @property
    def limits(self) -> tuple[tuple[float, float], ...]:
        """Bounds of the free numbers, one pair each."""
        pairs = zip(self.bounds, self._numbers.values(), strict=True)
        return tuple(pair for pair, number in pairs for _ in number.names)

    def symbols(self, harmonics: int) -> tuple[ca.SX, tuple[Observables, ...]]:
        """The free numbers as symbols, shape (free numbers, 1), and the orbits made of them."""
        symbols = {name: ca.SX.sym(name, len(number.names)) for name, number in self._numbers.items()}
        values = {name: symbol for name, symbol in symbols.items() if name != "S"}
        amplitudes = [symbols.get("S", ca.SX.sym("S")) for _ in self.amplitudes]
        orbits = tuple(Observables(self.family.equations(values, S), harmonics) for S in amplitudes)
        return ca.vertcat(*symbols.values()), orbits

    def evaluated(self, quantity: Quantity, orbits: tuple[Observables, ...]) -> Any:
        """A quantity of these orbits."""
        if isinstance(quantity, str):
            return orbits[0].value(quantity)
        return quantity(orbits if self.several else orbits[0])

    def values(self, free: Sequence[float] | Array) -> dict[str, Any]:
        """Free numbers by name: numbers, or arrays where every component has one."""
        places, found = iter(np.asarray(free, dtype=float)), dict[str, Any]()
        for name, free_number in self._numbers.items():
            values = np.array([next(places) for _ in free_number.names])
            found[name] = float(values[0]) if free_number.names == (name,) else values
        return found

    # Checks ---------------------------------------------------------------------------------------------------------

    def _check_expressions(self) -> None:
        """Make every expression once, on two harmonics: names, kinds and shapes are refused here, before any solve."""
        free, orbits = self.symbols(harmonics=2)
        objective = self._expression("objective", self.objective, orbits)
        if objective.is_constant():
            raise ValueError(f"objective: given the constant {objective}; accepted: a quantity of the orbit")
        if objective.shape != (1, 1):
            raise ValueError(f"objective: given an expression of shape {objective.shape}; accepted: a scalar")
        equalities = 0
        for condition in self.conditions:
            rows = self._expression(f"constraints, {condition.name}", condition.quantity, orbits)
            equalities += rows.numel() if condition.equality else 0
        if equalities > free.numel():
            words = f"given {equalities} equalities with {free.numel()} free ({', '.join(self.free)})"
            raise ValueError(f"constraints: {words}; accepted: no more equalities than free numbers")

    def _expression(self, place: str, quantity: Quantity, orbits: tuple[Observables, ...]) -> ca.SX:
        if isinstance(quantity, str):
            if quantity not in orbits[0].names:
                raise ValueError(f"{place}: given {short_repr(quantity)}; {accepted_names(quantity, orbits[0].names)}")
            if self.several and not orbits[0].is_shared(quantity):
                given = f"{short_repr(quantity)} with a list of S"
                raise ValueError(f"{place}: given {given}; accepted: a function of the orbits")
        elif not callable(quantity):
            raise TypeError(f"{place}: given {short_repr(quantity)}; accepted: a name or a function of the observables")
        try:
            made = self.evaluated(quantity, orbits)
        except AttributeError as error:
            raise ValueError(f"{place}: {str(error).removeprefix('observable: ')}") from None
        except (TypeError, ValueError, NotImplementedError, RuntimeError, IndexError) as error:
            raise TypeError(f"{place}: the function given fails: {' '.join(str(error).split())[:200]}") from None
        if isinstance(made, bool) or not isinstance(made, int | float | ca.SX | ca.DM):
            raise TypeError(f"{place}: given a function that returns {short_repr(made)}; accepted: a CasADi expression")
        expression = ca.SX(made)
        if is_comparison(expression):
            given = f"a comparison, {short_repr(made)}"
            raise ValueError(f"{place}: given {given}; accepted: a difference, x - 1 for x == 1")
        if not (expression.is_column() and expression.numel() > 0):
            given = f"an expression of shape {expression.shape}"
            raise ValueError(f"{place}: given {given}; accepted: a scalar or a column")
        return expression
