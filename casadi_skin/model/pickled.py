"""A model as one function of CasADi with names for its results: the form in which it is saved and pickled."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import casadi as ca

from casadi_skin.model.arguments import short_repr
from casadi_skin.model.equations import Equations
from casadi_skin.model.expressions import Expression

# CasADi's classes of functions that are not symbolic.
PROGRAM_CLASSES = ("CallbackInternal", "GenericExternal", "External")
OPTIONAL_RESULTS = ("normalisation", "hamiltonian")
# Before names among the results.
RESULT_GROUPS = {"outputs": "output ", "conserved": "conserved ", "symmetries": "symmetry "}
PLAIN_FIELDS = ("name", "order", "reversal", "half_period", "output_scale", "nominal")

Model = TypeVar("Model", bound=Equations)


def programs_in(function: ca.Function) -> list[str]:
    """Names of the functions inside that are programs, as those of an FMU, and no expressions."""
    return [inner.name() for inner in function.find_functions() if inner.class_name() in PROGRAM_CLASSES]


def column(symbols: Sequence[ca.SX]) -> ca.SX:
    return ca.vertcat(*symbols) if symbols else ca.SX(0, 1)


def equations_of(model: Equations) -> tuple[list[str], ca.Function]:
    """A model's equations by name as one function (t, x, p); raises ValueError where they are those of a program."""
    expressions = {"rhs": getattr(model, "given_rhs", model.rhs)} | {
        k: v for k in OPTIONAL_RESULTS if (v := getattr(model, k)) is not None
    }
    for group, before in RESULT_GROUPS.items():
        expressions |= {f"{before}{name}": expression for name, expression in getattr(model, group).items()}
    if model.forcing_period is not None:
        expressions["forcing_period"] = type(model.state)(model.forcing_period)
    if model.mass is not None:
        expressions["mass"] = ca.vec(model.mass)
    if model.decay is not None:
        expressions["decay"] = ca.SX(model.decay)
    function = model.function("model", *expressions.values())
    programs = programs_in(function)
    if programs:
        raise ValueError(f"{model.name}: cannot be saved: its equations are those of a program, {', '.join(programs)}")
    return list(expressions), function


def made(
    kind: type[Model],
    declared: dict[str, Any],
    results: dict[str, Expression],
    symbols: tuple[Expression, Expression, Expression],
    forced: bool,
) -> Model:
    """A model from its declarations, equations by name, and the symbols of time, full state and parameters."""
    time, full, parameters = symbols
    rest: dict[str, Any] = dict(results)
    groups: dict[str, Any] = {}
    for group, before in RESULT_GROUPS.items():
        groups[group] = {k.removeprefix(before): rest.pop(k) for k in list(rest) if k.startswith(before)}
    unknown = sorted(set(rest) - {"rhs", "forcing_period", "mass", "decay", *OPTIONAL_RESULTS})
    if unknown or "rhs" not in rest:
        raise ValueError(f"results: given {short_repr(unknown)}" if unknown else "results: no right-hand side")
    state = full
    if declared["order"] == 2:
        half = full.numel() // 2
        state, rest["velocity"] = full[:half], full[half:]
    if "mass" in rest:
        rest["mass"] = ca.reshape(rest["mass"], full.numel(), full.numel())
    if "decay" in rest:
        rest["decay"] = float(ca.evalf(rest["decay"]))
    rest |= {"state": state, "parameters": parameters, "time": time if forced else None}
    return kind(**declared, **rest, **groups)


def reduced(model: Equations, kind: type[Equations]) -> tuple[Any, ...]:
    """Pickled form of a model: CasADi's own function, of any kind but programs."""
    labels, function = equations_of(model)
    declared = {key: getattr(model, key) for key in (*PLAIN_FIELDS, "state_labels", "parameter_labels")}
    names = model.state_names, model.parameter_names
    return _unpickled, (kind, declared, labels, function, isinstance(model.state, ca.MX), names, model.forced)


def _unpickled(
    kind: type[Model],
    declared: dict[str, Any],
    labels: list[str],
    function: ca.Function,
    matrix: bool,
    names: tuple[Sequence[str], Sequence[str]],
    forced: bool,
) -> Model:
    states, parameters = names
    symbols: tuple[Expression, Expression, Expression] = tuple(
        column([ca.SX.sym(name) for name in names]) for names in (("t",), states, parameters)
    )
    if matrix:
        symbols = ca.MX.sym("t"), ca.MX.sym("x", len(states)), ca.MX.sym("p", len(parameters))
        declared = declared | {"state_labels": states, "parameter_labels": parameters}
    results = dict(zip(labels, function.call(list(symbols), True, False), strict=True))
    return made(kind, declared, results, symbols, forced)
