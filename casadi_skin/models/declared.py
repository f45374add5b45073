"""What a model declares of itself, checked: shapes and symbols, and symmetries at random points."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from casadi_skin.models.ode import OdeModel

Array = NDArray[np.float64]
Expression: TypeAlias = ca.SX | ca.MX

ROUND_OFF = 1e-12  # of the size of the right-hand side


def names_of(symbols: Expression, given: tuple[str, ...] | None) -> tuple[str, ...]:
    """The names given, or those of the symbols; numbered from 0 where one MX symbol has several components."""
    if given is not None or symbols.numel() == 0:
        return tuple(given or ())
    if isinstance(symbols, ca.SX):
        return tuple(s.name() for s in ca.vertsplit(symbols))
    name, count = symbols.name(), symbols.numel()
    return (name,) if count == 1 else tuple(f"{name}_{i}" for i in range(count))


def is_comparison(expression: Expression) -> bool:
    """Whether an entry is true or false, such as x == 1: where an expression is to vanish, x - 1 is meant."""
    truths = (ca.OP_EQ, ca.OP_NE, ca.OP_LT, ca.OP_LE, ca.OP_AND, ca.OP_OR, ca.OP_NOT)
    entries = ca.vertsplit(ca.vec(expression)) if isinstance(expression, ca.SX) else [expression]
    return any(not entry.is_constant() and not entry.is_symbolic() and entry.op() in truths for entry in entries)


# Shapes and symbols ---------------------------------------------------------------------------------------------------


def check_declarations(model: OdeModel) -> None:
    """Raises ValueError, naming the model, where shapes, names or symbols do not fit each other."""
    for fault in _faults(model):
        raise ValueError(f"{model.name}: {fault}")


def _faults(model: OdeModel) -> Iterator[str]:
    if model.order not in (1, 2):
        yield f"order {model.order}; accepted: 1 or 2"
    if model.rhs.shape != model.state.shape:
        yield f"right-hand side of shape {model.rhs.shape}, state {model.state.shape}"
    if (model.velocity is None) != (model.order == 1):
        yield "a velocity symbol belongs to a model of second order, and only there"
    if model.velocity is not None and model.velocity.shape != model.state.shape:
        yield f"velocity of shape {model.velocity.shape}, state {model.state.shape}"
    if model.order == 2 and isinstance(model.state, ca.MX):
        yield "of second order in MX; accepted: SX, or a model of first order"
    yield from _numbers(model)
    symbols = [model.full_state, model.parameters, *([] if model.time is None else [model.time])]
    if not all(_plain(symbol) for symbol in symbols):
        yield "state, velocity, parameters or time with expressions among them; accepted: symbols"
    yield from _names(model)
    yield from _strangers(model, symbols)
    if model.velocity is not None and ca.depends_on(model.rhs, model.velocity):
        yield "a second-order right-hand side that depends on velocity; write first order"
    if model.hamiltonian is not None and model.forced:
        yield "a hamiltonian in a model that is forced; accepted: without time, where it is conserved"
    if model.forced and model.forcing_period is None:
        yield "time without forcing_period; accepted: the forcing's period, a number or an expression in parameters"
    for label, signs in (("reversal", model.reversal), ("half_period", model.half_period)):
        if signs is not None and (len(signs) != model.full_size or set(signs) - {1, -1}):
            yield f"{label} needs {model.full_size} signs, each +1 or -1"


def _plain(symbol: Expression) -> bool:
    """Whether this is a symbol, or in SX several; in MX several are an expression, which has no name."""
    if isinstance(symbol, ca.MX):
        return bool(symbol.is_symbolic()) or symbol.numel() == 0
    return bool(symbol.is_valid_input())


def _numbers(model: OdeModel) -> Iterator[str]:
    """What has one entry a component."""
    parameters = int(model.parameters.numel())
    for label, given, count, entries in (
        ("output_scale", model.output_scale, model.size, "factors"),
        ("nominal", model.nominal, parameters, "values"),
        ("state_labels", model.state_labels, model.full_size, "names"),
        ("parameter_labels", model.parameter_labels, parameters, "names"),
    ):
        if given is not None and len(given) != count:
            yield f"{label} needs {count} {entries}, given {len(given)}"
    if any(output.numel() != 1 for output in model.outputs.values()):
        yield "outputs with several components; accepted: one scalar expression a name"


def _names(model: OdeModel) -> Iterator[str]:
    names = [*model.state_names, *model.parameter_names, *model.outputs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice and model.outputs:
        yield f"{', '.join(twice)} named more than once among states, parameters and outputs"


def _strangers(model: OdeModel, symbols: list[Expression]) -> Iterator[str]:
    """Expressions that depend on what is not declared."""
    named: dict[str, object] = {label: getattr(model, label) for label in ("rhs", "normalisation", "hamiltonian")}
    named |= {f"output {name}": output for name, output in model.outputs.items()}
    for label, expression in named.items():
        if expression is None:
            continue
        unknown = ca.Function("f", symbols, [expression], {"allow_free": True}).get_free()
        if unknown:
            yield f"{label} depends on {', '.join(unknown)}, which is not declared"
    if isinstance(model.forcing_period, ca.SX | ca.MX):
        period = ca.Function("T", [model.parameters], [model.forcing_period], {"allow_free": True})
        if period.get_free():
            yield f"forcing_period depends on {', '.join(period.get_free())}; accepted: parameters"


# Symmetries -----------------------------------------------------------------------------------------------------------


def check_symmetries(model: OdeModel, trials: int, seed: int) -> None:
    """Raises ValueError naming the first symmetry or conserved quantity that does not hold at random points."""
    if model.reversal is None and model.half_period is None and model.hamiltonian is None:
        return
    rate = 0.0 if model.hamiltonian is None else ca.jacobian(model.hamiltonian, model.full_state) @ model.full_rhs
    evaluate = model.function("check", ca.densify(model.full_rhs), ca.densify(rate))
    generator = np.random.default_rng(seed)
    for _ in range(trials):
        time, point, parameter = _finite_point(model, evaluate, generator)
        value, change = (np.array(r).ravel() for r in evaluate(time, point, parameter))
        scale = ROUND_OFF * (1.0 + np.abs(value).max())
        half = 0.5 * model.forcing_period_at(parameter)
        images = (("reversal", model.reversal, -1, -time), ("half_period", model.half_period, 1, time + half))
        for label, signs, sense, at in images:
            if signs is None:
                continue
            image = np.array(evaluate(at, np.array(signs) * point, parameter)[0]).ravel()
            if not np.abs(image - sense * np.array(signs) * value).max() <= scale:
                raise ValueError(f"{model.name}: the declared {label} is not a symmetry of the right-hand side")
        if abs(change[0]) > scale * (1.0 + np.abs(point).sum()):
            raise ValueError(f"{model.name}: the declared hamiltonian is not conserved")


def _finite_point(model: OdeModel, evaluate: ca.Function, generator: np.random.Generator) -> tuple[float, Array, Array]:
    """A random time, state and parameter at which all is finite: positive where roots and logarithms need it."""
    time = generator.normal()
    x, p = (generator.normal(size=count) for count in (model.full_size, model.parameters.numel()))
    for point, parameter in ((x, p), (x, np.abs(p)), (np.abs(x), np.abs(p))):
        if all(np.all(np.isfinite(np.array(r))) for r in evaluate(time, point, parameter)):
            return time, point, parameter
    raise ValueError(f"{model.name}: the right-hand side or the hamiltonian is not finite at a random point")
