"""Statement of a boundary-value problem: a model, conditions at the ends and in the mean, free parameters."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property, wraps
from inspect import Parameter, signature
from numbers import Real
from typing import Any, ClassVar, TypeVar

import casadi as ca
import numpy as np

from casadi_skin.model.arguments import by_name, check_instance, check_name, number, pair, short_repr
from casadi_skin.model.expressions import Expression, expression_of, in_scalars, is_comparison, product
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import WithVerbs
from casadi_skin.zero.discretisation import Formulation
from casadi_skin.zero.problem import Array

Bounds = Mapping[str, tuple[float, float]]


Kind = TypeVar("Kind")


def arguments_once(cls: type[Kind]) -> type[Kind]:
    """The class, which refuses arguments that are given both in order and by name, and those in order that are none."""
    made: Any = cls.__init__
    names = [name for name, entry in signature(made).parameters.items() if entry.kind is not Parameter.KEYWORD_ONLY][1:]

    @wraps(made)
    def once(self: Any, *given: Any, **named: Any) -> None:
        for place, (name, value) in enumerate(zip(names, given, strict=False), start=1):
            if name in named:
                twice = f"{short_repr(value)} as argument {place} and {short_repr(named[name])} by name"
                raise TypeError(f"{name}: given twice, {twice}; accepted: once")
        if len(given) > len(names):
            more = short_repr(given[len(names)])
            raise TypeError(f"given {more} as positional argument {len(names) + 1}; accepted: {', '.join(names)}")
        made(self, *given, **named)

    setattr(cls, "__init__", once)  # noqa: B010  mypy takes no method for another
    return cls


@arguments_once
@dataclass(frozen=True, eq=False)
class Statement(WithVerbs):
    """x' = f(t, x, p) on an interval, with `conditions` and `integrals` that vanish and parameters that are `free`.

    `conditions` are expressions in `model.start(x)`, `model.end(x)` and the parameters, or a function f(start, end, p)
    that returns them; `integrals` are expressions in t, x and the parameters, or f(t, x, p), whose integrals over the
    `interval` vanish; its ends are numbers or expressions in the parameters. `parameters` are values by name, those of
    the free ones guesses; where one is left out it is the model's nominal value. Without an objective there are as many
    conditions and integrals as states and free parameters. `objective`, in ends and parameters, plus the integral of
    `running` is minimised subject to all these; `bounds` hold states (everywhere) and free parameters by name; a
    branch ends where one is met.

    Raises ValueError and TypeError, naming the argument and the accepted values, where these do not fit.
    """

    model: OdeModel
    conditions: Sequence[Expression]
    integrals: Sequence[Expression] = ()
    interval: tuple[Expression | float, Expression | float] = (0.0, 1.0)
    parameters: Mapping[str, float] = field(default_factory=dict)
    free: Sequence[str] = ()
    _: KW_ONLY
    bounds: Bounds = field(default_factory=dict)
    objective: Expression | None = None
    running: Expression | None = None
    solve: ClassVar[Callable[..., Any]]
    """The solution near a guess, with an objective or bounds the optimum: `casadi_skin.search.boundary_nlp.solve`."""

    def __post_init__(self) -> None:
        self._check_kinds()
        self._take_expressions()
        _check_names("free", self.free, self.model.parameter_names)
        if len(set(self.free)) < len(self.free):
            raise ValueError(f"free: given {short_repr(list(self.free))}; accepted: each parameter once")
        self._check_values()
        self._check_count()
        self._check_bounds()

    # Checks ---------------------------------------------------------------------------------------------------------

    def _check_kinds(self) -> None:
        check_instance("model", self.model, OdeModel)
        if not isinstance(self.free, list | tuple):
            raise TypeError(f"free: given {short_repr(self.free)}; accepted: a list of names of parameters")
        object.__setattr__(self, "parameters", by_name("parameters", self.parameters))
        object.__setattr__(self, "bounds", by_name("bounds", self.bounds, "(lower, upper)"))
        if _is_interval(self.integrals):
            accepted = "expressions in t, x and the parameters; the interval is argument 4, or interval=(start, end)"
            raise TypeError(f"integrals: given {short_repr(self.integrals)}, two numbers; accepted: {accepted}")
        if not isinstance(self.interval, list | tuple) or len(self.interval) != 2:
            raise TypeError(f"interval: given {short_repr(self.interval)}; accepted: (start, end)")
        for end in self.interval:
            if isinstance(end, ca.SX | ca.MX):
                check_expressions([("interval", end)], [self.model.parameters])
                if end.numel() != 1:
                    raise ValueError(f"interval: given an end of shape {end.shape}; accepted: scalars")
            elif isinstance(end, bool) or not isinstance(end, Real):
                raise TypeError(f"interval: given {short_repr(end)}; accepted: numbers or expressions in parameters")

    def _take_expressions(self) -> None:
        """Turn functions, lists and numbers into expressions, which are to be in the symbols of their kind alone.

        Expressions in MX become scalar operations, which files keep to the last bit.
        """
        ends = [*self.model.ends, self.model.parameters]
        along = [self._time, self.model.full_state, self.model.parameters]
        for label, summand, symbols, form in (
            ("conditions", "objective", ends, "f(start, end, p)"),
            ("integrals", "running", along, "f(t, x, p)"),
        ):
            listed = _listed(label, getattr(self, label), symbols, form)
            named = {f"{label}, number {place}": given for place, given in enumerate(listed, start=1)}
            if getattr(self, summand) is not None:
                named[summand] = expression_of(summand, getattr(self, summand), symbols, form, constants=False)
            check_expressions(list(named.items()), symbols)
            if summand in named and named[summand].numel() != 1:
                raise ValueError(f"{summand}: given shape {named[summand].shape}; accepted: a scalar expression")
            if isinstance(self.model.state, ca.MX):
                named = {place: in_scalars(symbols, given) for place, given in named.items()}
            object.__setattr__(self, summand, named.pop(summand, None))
            object.__setattr__(self, label, tuple(named.values()))

    def _check_values(self) -> None:
        """Algebraic equations of the model are met at a rate that the interval gives."""
        start, end = self.span()
        if not (np.isfinite(start) and np.isfinite(end) and end > start):
            raise ValueError(f"interval: given ({start:g}, {end:g}); accepted: finite ends, the second larger")
        object.__setattr__(self, "model", self.model.decaying(lambda _: 2.0 * np.pi / (end - start)))

    def _check_count(self) -> None:
        given = _count(self.conditions) + _count(self.integrals)
        unknown = self.model.full_size + len(self.free)
        what = f"{self.model.full_size} states and {len(self.free)} free parameters"
        if self.optimises and given > unknown:
            raise ValueError(f"conditions: given {given} with an objective; accepted: at most {unknown}, for {what}")
        if not self.optimises and given != unknown:
            kinds = f"{_count(self.conditions)} at the ends and {_count(self.integrals)} integrals"
            raise ValueError(f"conditions: given {given} ({kinds}); accepted: {unknown}, for {what}")

    def _check_bounds(self) -> None:
        _check_names("bounds", self.bounds, (*self.model.state_names, *self.free))
        pairs = {name: pair(f"bounds[{name}]", given) for name, given in self.bounds.items()}
        for name, (lower, upper) in pairs.items():
            if lower == upper:
                raise ValueError(f"bounds[{name}]: given {lower!r} twice; accepted: (lower, upper), lower < upper")
        object.__setattr__(self, "bounds", pairs)

    # Parts ------------------------------------------------------------------------------------------------------------

    @property
    def optimises(self) -> bool:
        """Whether the problem has an objective."""
        return self.objective is not None or self.running is not None

    @cached_property
    def values(self) -> dict[str, float]:
        """Value of each parameter by name, in the order of the model; guesses of the free ones."""
        return named_values(self.model, self.parameters)

    @cached_property
    def _time(self) -> Expression:
        return type(self.model.state).sym("t") if self.model.time is None else self.model.time

    def ends_at(self, parameters: Any) -> tuple[Any, Any]:
        """Start and end of the interval at parameters, numbers or expressions."""
        start, end = (
            end if isinstance(end, float) else parameters[end] if isinstance(end, int) else end(parameters)
            for end in self._ends
        )
        return start, end

    @cached_property
    def _ends(self) -> list[Any]:
        """The ends as numbers, as places among the parameters, or as functions of these."""
        found, parameters = list[Any](), self.model.parameters
        for end in self.interval:
            if not isinstance(end, ca.SX | ca.MX):
                found.append(float(end))
                continue
            places = (k for k in range(int(parameters.numel())) if ca.is_equal(end, parameters[k], 2))
            found.append(next(places, None))
            if found[-1] is None:
                found[-1] = ca.Function("t", [parameters], [end])
        return found

    def along(self, name: str, expression: Expression) -> ca.Function:
        """Function (t, x, p) of an expression in these."""
        return ca.Function(name, [self._time, self.model.full_state, self.model.parameters], [expression])

    def span(self, parameters: Iterable[float] | None = None) -> tuple[float, float]:
        """Start and end of the interval at values of all parameters, in the model's order; at its own by default."""
        if not isinstance(parameters, np.ndarray):
            parameters = self._numbers if parameters is None else np.array(list(parameters))
        start, end = self.ends_at(parameters)
        return float(start), float(end)

    @cached_property
    def switching(self) -> Array:
        """Fractions of the interval at which the equations switch by time alone: edges of every mesh."""
        return self.model.jumps.times(*self.span(), self._numbers)

    @cached_property
    def _numbers(self) -> Array:
        """Values of all parameters, in the order of the model."""
        return np.array(list(self.values.values()))

    @cached_property
    def formulations(self) -> dict[tuple[Any, ...], Formulation]:
        """Those that are made, by the free parameters and the one that walks: all with other values have them too."""
        return {}

    def formulation(self, walking: str | None = None) -> Formulation:
        """This problem on [0, 1] at any values; the last scalar u takes the parameter `walking`, if any, along.

        It is made once for all values of parameters, and keeps its discretisations: solving again builds nothing.
        """
        key = tuple(self.free), walking
        if key not in self.formulations:
            self.formulations[key] = self._formulated(walking)
        return self.formulations[key]

    def constants(self, walking: str | None = None, end: float = 1.0) -> Array:
        """Values of the formulation's constants: of all parameters; then the way of the one that walks to `end`."""
        values = self._numbers
        return values if walking is None else np.append(values, end - self.values[walking])

    def _formulated(self, walking: str | None) -> Formulation:
        """By calls of functions, as in programs nothing can be replaced."""
        model, kind = self.model, type(self.model.state)
        s, x, last = kind.sym("s"), kind.sym("x", model.full_size), kind.sym("end", model.full_size)
        scalars = kind.sym("scalars", len(self.free) + 1)
        constants = kind.sym("constants", len(self.values) + (walking is not None))
        several = bool(self.free) or walking is not None
        p = self._along(scalars, ca.vertsplit(constants), walking) if several else constants
        t0, t1 = self.ends_at(p)
        time = kind.binary(ca.OP_ADD, product(s, t1 - t0), kind(t0))
        at_ends, along = (_stacked(kind, group) for group in (self.conditions, self.integrals))
        symbols = [self._time, model.full_state, *model.ends, model.parameters]
        everything = ca.Function("stated", symbols, [model.full_rhs, at_ends, along])
        field, border, integrands = everything.call([time, x, x, last, p], True, False)
        if self.integrals:
            integrands = product(integrands, t1 - t0)
        equations = product(field, t1 - t0), border, integrands, constants
        return Formulation(s, x, (x, last), scalars, *equations, model.programs)

    def parameters_at(self, scalars: Any, walking: str | None = None, end: float = 1.0) -> Any:
        """All parameters, in the model's order, from the scalars among the unknowns."""
        if not isinstance(scalars, np.ndarray):
            return self._along(scalars, self.constants(walking, end), walking)
        names, found = self.model.parameter_names, self._numbers.copy()
        if walking is not None:
            k = names.index(walking)
            found[k] += scalars[len(self.free)] * (end - found[k])
        for name, value in zip(self.free, scalars, strict=False):
            found[names.index(name)] = value
        return found

    def _along(self, scalars: Any, constants: Any, walking: str | None) -> Any:
        """The same, from the constants of the formulation too."""
        values = dict(zip(self.values, constants, strict=False))
        known = {name: scalars[place] for place, name in enumerate(self.free)}
        if walking is not None:
            known[walking] = values[walking] + scalars[len(self.free)] * constants[-1]
        return in_order(values | known, scalars)

    def with_free(self, name: str) -> Statement:
        """The same equations with one more free parameter, which they leave open."""
        _ = self.formulations  # shared by the copy
        other = copy.copy(self)
        object.__setattr__(other, "free", (*self.free, name))
        return other

    def with_parameters(self, **values: float) -> Statement:
        """The same problem at other values of parameters; functions built for one serve all."""
        _ = self.formulations  # shared by the copy
        other = copy.copy(self)
        for name in ("values", "switching", "_numbers"):
            other.__dict__.pop(name, None)
        object.__setattr__(other, "parameters", by_name("parameters", {**self.parameters, **values}))
        other._check_values()
        return other


class BoundaryValueProblem(Statement):
    __doc__ = Statement.__doc__

    def __repr__(self) -> str:
        start, end = (end if isinstance(end, int | float) else "a parameter" for end in self.interval)
        conditions, integrals = (sum(int(e.numel()) for e in group) for group in (self.conditions, self.integrals))
        counts = f"{conditions} conditions, {integrals} integrals"
        free = f"; free: {', '.join(self.free)}" if self.free else ""
        return f"<BoundaryValueProblem: {self.model.name} from {start} to {end}, {counts}{free}>"


def _is_interval(given: object) -> bool:
    """Whether this is a pair of numbers, as an interval is and no list of integrals."""
    numbers = isinstance(given, list | tuple | np.ndarray) and len(given) == 2
    return numbers and all(isinstance(end, Real) for end in given)  # type: ignore[attr-defined]


def named_values(model: OdeModel, given: Mapping[str, float] | None) -> dict[str, float]:
    """Value of each parameter of a model by name, in its order: that of the argument, or nominal.

    Raises ValueError for unknown names and where a parameter has no value, TypeError for other objects than mappings.
    """
    given = by_name("parameters", given)
    _check_names("parameters", given, model.parameter_names)
    nominal = dict(zip(model.parameter_names, model.nominal or (), strict=False))
    values = nominal | {name: number(f"parameters, {name}", value) for name, value in given.items()}
    for name in model.parameter_names:
        if name not in values:
            raise ValueError(f"parameters: given none for {name}; accepted: a number for each, or nominal values")
    return {name: values[name] for name in model.parameter_names}


def in_order(values: Mapping[str, Any], like: Any) -> Any:
    """Values of parameters as an array, or as a column of expressions of the kind of `like`."""
    if isinstance(like, np.ndarray):
        return np.array(list(values.values()), dtype=float)
    return ca.vertcat(*values.values()) if values else type(like)(0, 1)


def _listed(label: str, given: Any, symbols: Sequence[Expression], form: str) -> tuple[Expression, ...]:
    """Expressions of a list, or of a function of the symbols, or one that stands alone."""
    if isinstance(given, ca.SX | ca.MX) or callable(given):
        return (expression_of(label, given, symbols, form, constants=False),)
    if not isinstance(given, list | tuple) and not (isinstance(given, np.ndarray) and given.ndim):
        accepted = f"a list of expressions, or a function {form} that returns them"
        raise TypeError(f"{label}: given {short_repr(given)}; accepted: {accepted}")
    numbered = ((f"{label}, number {k}", entry) for k, entry in enumerate(given, start=1))
    return tuple(expression_of(place, entry, symbols, form, constants=False) for place, entry in numbered)


def _count(expressions: Iterable[Expression]) -> int:
    return sum(int(expression.numel()) for expression in expressions)


def _stacked(kind: Any, expressions: Sequence[Expression]) -> Expression:
    columns = [e if e.is_column() else ca.vec(e) for e in expressions]
    return ca.vertcat(*columns) if columns else kind(0, 1)


def _check_names(label: str, given: Iterable[str], known: Sequence[str]) -> None:
    for name in given:
        check_name(label, name, known)


def check_expressions(named: Sequence[tuple[str, Any]], symbols: list[Expression]) -> None:
    """Raises TypeError for other objects than such expressions, ValueError where one depends on other symbols."""
    kind = type(symbols[0])
    for label, expression in named:
        if not isinstance(expression, kind):
            accepted = f"a CasADi expression of kind {kind.__name__}"
            raise TypeError(f"{label}: given {short_repr(expression)}; accepted: {accepted}")
        if is_comparison(expression):
            raise ValueError(
                f"{label}: given a comparison, {short_repr(expression)}; accepted: an expression, x - 1 for x == 1"
            )
        if stranger := ca.Function("f", symbols, [expression], {"allow_free": True}).get_free():
            known = [symbol.name() for block in symbols for symbol in ca.symvar(block)]
            other = " of another model" if set(stranger) <= set(known) else ""
            accepted = ", ".join(known) or "numbers"
            raise ValueError(f"{label}: depends on {', '.join(stranger)}{other}; accepted: {accepted}")
