"""The statement of a design: a quantity of located solutions, over parameters, within bounds and constraints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import in_words, short_repr
from casadi_skin.model.expressions import expression, is_comparison
from casadi_skin.model.formula import FormulaError, parse_formula
from casadi_skin.search.conditions import Condition, checked_bounds, checked_conditions, free_names, sampled_starts
from casadi_skin.search.families import SMALLEST_S, FamilyStart, FreeNumber, check_chain
from casadi_skin.search.located import LocatedThing, SolutionStart, start_of
from casadi_skin.zero.family import FamilyRequest
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statement import named_values

Quantity = str | Callable[..., Any]
# Objective and constraints, shape (rows,), and their derivatives by the free numbers, shape (rows, over).
Rows = tuple[Array, Array]


@dataclass(frozen=True, eq=False)
class DesignProblem:
    """What is optimised, over what, within what.

    Attributes:
        starts, expressions: what is located at first, and quantities of each.
        over: names of the free numbers.
        named: names of the free parameters, of which each has a number of `counts`, with `values` at the start and
            `limits`.
        conditions: the constraints, whose expressions follow the objective's in `function`.
        function: of the numbers of all things: objective and constraints, a column, and its derivative.
    """

    starts: tuple[SolutionStart | FamilyStart, ...]
    expressions: tuple[Any, ...]
    over: tuple[str, ...]
    named: tuple[str, ...]
    values: tuple[float, ...]
    limits: tuple[tuple[float, float], ...]
    counts: tuple[int, ...]
    quantity: str
    maximise: bool
    conditions: tuple[Condition, ...]
    sizes: tuple[int, ...]
    function: ca.Function

    @classmethod
    def of(
        cls, quantity: Quantity, of: Any, over: Sequence[str], subject_to: Sequence[Any],
        bounds: Mapping[str, Any] | None, maximise: bool,
        words: tuple[str, str, str] = ("quantity", "over", "subject_to"),
    ) -> DesignProblem:  # fmt: skip
        """From the arguments of `optimise`; raises ValueError and TypeError, which call three of them by `words`."""
        of_quantity, of_over, of_conditions = words
        starts, known = _by_name(of), dict[str, FreeNumber]()
        for one in starts.values():
            known = one.free | known
        named = free_names(over, known, of_over)
        families = [one for one in starts.values() if isinstance(one, FamilyStart)]
        if "S" in named and len(families) > 1:
            raise ValueError(f"{of_over}: given S with several orbits; accepted: S with one orbit")
        names = tuple(single for name in named for single in known[name].several or (name,))
        expressions = {name: one.expressions(names) for name, one in starts.items()}
        quantities = next(iter(expressions.values())).names if len(starts) == 1 else ()
        wide = {name: (known[name].lower, known[name].upper) for name in named}
        limits, more = checked_bounds(bounds, wide, [name for name in known if name not in named], quantities)
        for one in families:
            if isinstance(one.model, Chain):
                check_chain(one.model, named, limits)
        if families and "S" in limits:
            low, high = limits["S"]
            if low < 0 or high <= 0:
                raise ValueError(f"bounds[S]: given {short_repr([low, high])}; accepted: bounds within 0 to inf")
            limits["S"] = low or SMALLEST_S * min(known["S"].value, high), high
        conditions = (
            *checked_conditions(subject_to, (str, Callable), "a function of what is located", of_conditions),
            *more,
        )
        columns = [_column(of_quantity, quantity, expressions)]
        columns += [_column(f"{of_conditions}, {c.name}", c.quantity, expressions) for c in conditions]
        if columns[0].shape != (1, 1):
            raise ValueError(f"{of_quantity}: given an expression of shape {columns[0].shape}; accepted: a scalar")
        symbols = ca.vertcat(*(one.symbols for one in expressions.values()))
        column = ca.densify(ca.vertcat(*columns))
        if not ca.depends_on(columns[0], symbols):
            raise ValueError(f"{of_quantity}: given the constant {columns[0]}; accepted: a quantity of what is located")
        equal = sum(c.numel() for c, condition in zip(columns[1:], conditions, strict=True) if condition.equality)
        if equal > len(names):
            given = f"given {equal} equalities over {len(names)} parameters ({', '.join(names)})"
            raise ValueError(f"{of_conditions}: {given}; accepted: no more equalities than parameters")
        label = quantity if isinstance(quantity, str) else getattr(quantity, "__name__", "objective")
        return cls(
            tuple(starts.values()), tuple(expressions.values()), names, named,
            tuple(known[name].value for name in named), tuple(limits[name] for name in named),
            tuple(len(known[name].several) or 1 for name in named),
            label.replace("<lambda>", "objective"), maximise, conditions, tuple(c.numel() for c in columns[1:]),
            ca.Function("design", [symbols], [column, ca.densify(ca.jacobian(column, symbols))]),
        )  # fmt: skip

    @cached_property
    def things(self) -> tuple[LocatedThing, ...]:
        """The located solutions at the start, those of other parameters moved there; raises ArithmeticError."""
        at, found = dict(zip(self.named, self.values, strict=True)), list[LocatedThing]()
        for start, expressions in zip(self.starts, self.expressions, strict=True):
            thing, free = start.located(expressions, self.over), start.free
            if any(name in free and free[name].value != value for name, value in at.items()):
                near = thing.near(dict(zip(self.over, np.repeat(self.values, self.counts).tolist(), strict=True)))
                if near is None:
                    raise ArithmeticError(f"{short_repr(thing.solution)} is not located at the parameters of the first")
                thing = near
            found.append(thing)
        return tuple(found)

    def places(self, count: int, seed: int) -> list[Array]:
        """Free numbers of starts: the own ones, then a Halton sequence."""
        rows = sampled_starts(self.values, self.limits, count, seed)
        return [np.clip(np.repeat(row, self.counts), *self.ends) for row in (self.values, *rows[1:])]

    @cached_property
    def ends(self) -> Array:
        """Lower and upper bounds, shape (2, over)."""
        return np.repeat(np.array(self.limits), self.counts, axis=0).T

    @cached_property
    def scales(self) -> Array:
        """Ranges of the free numbers, or their own sizes, shape (over,); of a 0 without range the size for which its
        derivative of the objective is as large as those by the others, or as the objective, where there is one."""
        (low, high), own = self.ends, np.repeat(np.abs(self.values), self.counts)
        found = np.where(np.isfinite(high - low), high - low, own)
        if np.any(found == 0.0):
            rows, slopes = self.evaluated(self.things)
            size, by = np.max(np.abs(slopes[0] * found)) or abs(rows[0]), np.abs(slopes[0])
            found = np.where(found > 0.0, found, np.divide(size, by, out=np.ones_like(by), where=by * size != 0.0))
        return found

    @cached_property
    def rows(self) -> list[tuple[str, float, float]]:
        """Of the constraints each scalar, with its bounds."""
        return [
            (c.name if size == 1 else f"{c.name} ({k})", c.lower, c.upper)
            for c, size in zip(self.conditions, self.sizes, strict=True) for k in range(1, size + 1)
        ]  # fmt: skip

    def evaluated(self, things: Sequence[LocatedThing]) -> tuple[Array, Array]:
        """Objective and constraints, shape (rows,), and their derivatives by `over`, shape (rows, over)."""
        numbers = np.concatenate([thing.numbers for thing in things])
        rows, by_numbers = self.function(numbers)
        by_over = np.vstack([thing.derivatives for thing in things])
        return np.array(rows).ravel(), np.array(by_numbers) @ by_over

    def errors(self, things: Sequence[LocatedThing]) -> tuple[Array, Array]:
        """Estimated errors of both, from those of what is located; by slopes that vanish too, as at an optimum."""
        numbers = np.concatenate([thing.numbers for thing in things])
        errors, derivatives = zip(*(thing.errors for thing in things), strict=True)
        own, (rows, by_numbers) = np.concatenate(errors), map(np.array, self.function(numbers))
        parts = np.abs(by_numbers) * own
        if np.any(own):
            sides = np.hstack([np.diag(own), -np.diag(own)])
            moved = np.abs(np.array(self.function(numbers[:, None] + sides)[0]) - rows)
            parts = np.fmax(parts, np.max(moved.reshape(len(rows), 2, -1), axis=1))
        return np.sum(parts, axis=1), np.abs(by_numbers) @ np.vstack(derivatives)


def family_starts(
    model: Any, mode: int | str | None, amplitudes: Sequence[float], parameters: Mapping[str, float] | None,
    tolerance: float,
) -> list[FamilyStart]:  # fmt: skip
    """Orbits of a mode's family at these S, computed when they are needed; raises ValueError for a mode or a model."""
    chain = isinstance(model, Chain)
    if chain and model.infinite:
        raise ValueError("chain: given an infinite chain; accepted: a whole number of sites")
    mode = ("last" if model.g > 0 else "first") if mode is None and chain else mode or 1
    number = model.mode_number(mode) if chain else FamilyRequest(model, mode, 1.0, parameters=parameters).mode
    values = model.parameters if chain else named_values(model, parameters)
    own: dict[str, Any] = {"tail": "full"} if chain else {"parameters": values, "corrector": "newton"}

    @cache
    def branch() -> Branch:
        return follow_family(model, number, max(amplitudes), at=sorted(set(amplitudes)), tolerance=tolerance, **own)

    return [FamilyStart(model, S, values, partial(branch_at, branch, S)) for S in amplitudes]


def branch_at(branch: Callable[[], Branch], S: float) -> Orbit:
    """The orbit of a branch at S."""
    orbit: Orbit = branch().at(S=S)
    return orbit


def _by_name(of: Any) -> dict[str, SolutionStart | FamilyStart]:
    """What is located, by name; raises TypeError for what a design does not take."""
    if isinstance(of, list | tuple) and of:
        of = {chr(ord("a") + k): item for k, item in enumerate(of)}
    items = of if isinstance(of, Mapping) and of else {"a": of}
    for name in items:
        if not (isinstance(name, str) and name.isidentifier()):
            accepted = "letters, digits and _ as of a variable, and at most 26 without names"
            raise ValueError(f"of: given the name {short_repr(name)}; accepted: {accepted}")
    return {name: start_of(item) for name, item in items.items()}


def _column(place: str, quantity: Quantity, known: Mapping[str, Any]) -> ca.SX:
    """The expression of a quantity; raises ValueError and TypeError, naming the place."""
    if not (isinstance(quantity, str) or callable(quantity)):
        raise TypeError(f"{place}: given {short_repr(quantity)}; accepted: a name, a formula or a function")
    try:
        made = _of_text(quantity, known) if isinstance(quantity, str) else quantity(*known.values())
    except (AttributeError, FormulaError) as error:
        raise ValueError(f"{place}: {str(error).removeprefix('quantity: ')}") from None
    except (TypeError, ValueError, NotImplementedError, RuntimeError, IndexError, ZeroDivisionError) as error:
        raise TypeError(f"{place}: the function given fails: {in_words(error)[:200]}") from None
    if isinstance(made, bool) or not isinstance(made, int | float | ca.SX | ca.DM):
        raise TypeError(f"{place}: given a function that returns {short_repr(made)}; accepted: a CasADi expression")
    found = ca.SX(made)
    if is_comparison(found):
        raise ValueError(f"{place}: given a comparison, {short_repr(made)}; accepted: a difference, x - 1 for x == 1")
    if not (found.is_column() and found.numel()):
        raise ValueError(f"{place}: given an expression of shape {found.shape}; accepted: a scalar or a column")
    return found


def _of_text(text: str, known: Mapping[str, Any]) -> ca.SX:
    """A name, or a formula in names; of several each has the name of what it belongs to, and a dot, before it."""
    if len(known) == 1:
        (one,) = known.values()
        formula = parse_formula(text)
        return expression(formula, {name: one.value(name) for name in formula.names})
    joined = text
    for name in known:
        joined = joined.replace(f"{name}.", f"{name}__")
    formula, values = parse_formula(joined), dict[str, ca.SX]()
    for name in formula.names:
        of, _, quantity = name.partition("__")
        if of not in known or not quantity:
            raise AttributeError(f"given {name!r}; accepted: NAME.QUANTITY, with a name of {', '.join(known)}")
        values[name] = known[of].value(quantity)
    return expression(formula, values)
