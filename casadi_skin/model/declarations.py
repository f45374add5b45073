"""Declarations of a model, taken in the forms that scripts use, and checked: a fault is reported in one line.

Symmetries and conserved quantities that a model declares, evaluated at random points.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import casadi as ca
import numpy as np

from casadi_skin.model.arguments import number, numbers, short_repr, state_by_name, truth
from casadi_skin.model.equations import Array, Equations
from casadi_skin.model.expressions import Expression, expression_of, names_of, symbols_of
from casadi_skin.model.implicit import mass_matrix

ACCEPTED_NAMES = "names in one line"
ACCEPTED_PERIODS = "a number > 0, or an expression in parameters"
ACCEPTED_RATES = "a number > 0, in units of 1/time"
NEEDED_FIELDS = ("rhs", "outputs", "conserved", "symmetries")  # where None is a mistake


def declarations(model: Equations) -> dict[str, Any]:
    """The fields of a model that are given as lists, functions or numbers, as symbols, expressions and tuples.

    Raises TypeError and ValueError, naming the model and the field, for what has no such meaning.
    """
    if not is_name(model.name):
        raise TypeError(f"name: given {short_repr(model.name)}; accepted: a name in one line")
    try:
        if isinstance(model.order, bool) or not isinstance(model.order, int) or model.order not in (1, 2):
            raise ValueError(f"order: given {short_repr(model.order)}; accepted: 1 or 2")
        truth("checked", model.checked)
        found = _symbols(model)
        converters = _converters(found, found["state"].numel() * model.order, model.parameter_labels)
        given = {label: getattr(model, label) for label in converters}
        return found | {
            label: converters[label](label, value)
            for label, value in given.items()
            if value is not None or label in NEEDED_FIELDS
        }
    except (TypeError, ValueError) as error:
        raise type(error)(f"{model.name}: {error}") from error


def _symbols(model: Equations) -> dict[str, Expression]:
    kind = type(state := symbols_of("state", model.state))
    found, given = {"state": state}, model.parameters
    for label in ("velocity", "time"):
        if (symbol := getattr(model, label)) is not None:
            found[label] = symbols_of(label, symbol)
    nothing = (isinstance(given, list | tuple) and not given) or (
        isinstance(given, ca.SX | ca.MX) and not given.numel()
    )
    none = ca.MX.sym("p", 0) if kind is ca.MX else ca.SX(0, 1)
    found["parameters"] = none if given is None or nothing else symbols_of("parameters", given)
    for label, symbol in found.items():
        if type(symbol) is not kind:
            raise TypeError(f"{label}: given a symbol of kind {type(symbol).__name__}; accepted: {kind.__name__}")
    if "time" in found and found["time"].numel() != 1:
        raise ValueError(f"time: given {found['time'].numel()} symbols; accepted: one")
    return found


def _converters(found: Mapping[str, Expression], size: int, labels: Any) -> dict[str, Callable[[str, Any], Any]]:
    """What becomes of each field, from its name and what is given, in a model of these symbols and so many states.

    `labels` are the names that its parameters are given.
    """
    state = found["state"]
    symbols = [found.get("time", type(state).sym("t")), state, found["parameters"]]

    def expression(label: str, given: Any) -> Expression:
        return expression_of(label, given, symbols)

    def scalar(label: str, given: Any) -> Expression:
        found = expression(label, given)
        if found.numel() != 1:
            raise ValueError(f"{label}: given shape {found.shape}; accepted: a scalar expression")
        return found

    def group(label: str, given: Any) -> dict[str, Expression]:
        if not isinstance(given, Mapping) or not all(map(is_name, given)):
            raise TypeError(f"{label}: given {short_repr(given)}; accepted: expressions by name, {ACCEPTED_NAMES}")
        one = "output" if label == "outputs" else label
        return {name: expression(f"{one} {name}", value) for name, value in given.items()}

    def period(label: str, given: Any) -> Any:
        if isinstance(given, ca.SX | ca.MX | ca.DM):
            return scalar(label, given)
        if number(label, given, ACCEPTED_PERIODS) <= 0:
            raise ValueError(f"{label}: given {given!r}; accepted: {ACCEPTED_PERIODS}")
        return given

    def usual(label: str, given: Any) -> tuple[float, ...]:
        if not isinstance(given, Mapping):
            return numbers(label, given)
        known = names_of(found["parameters"], None if labels is None else names("parameter_labels", labels))
        values = state_by_name(label, given, known)
        for name in set(known) - set(given):
            raise ValueError(f"{label}: given none for {name}; accepted: a number for each parameter")
        return tuple(values)

    def signs(label: str, given: Any) -> tuple[int, ...]:
        values = list(given) if np.iterable(given) and not isinstance(given, str | bytes) else [0]
        if not all(isinstance(v, int | float | np.integer) and v in (1, -1) for v in values):
            raise ValueError(f"{label} needs {size} signs, each +1 or -1; given {short_repr(given)}")
        return tuple(int(v) for v in values)

    def names(label: str, given: Any) -> tuple[str, ...]:
        if isinstance(given, str | bytes) or not np.iterable(given) or not all(map(is_name, given)):
            raise TypeError(f"{label}: given {short_repr(given)}; accepted: a list of {ACCEPTED_NAMES}")
        return tuple(given)

    def rate(label: str, given: Any) -> float:
        if number(label, given, ACCEPTED_RATES) <= 0:
            raise ValueError(f"{label}: given {given!r}; accepted: {ACCEPTED_RATES}")
        return float(given)

    def mass(label: str, given: Any) -> ca.SX:
        if not isinstance(state, ca.SX) or size != state.numel():
            kind = "in MX" if isinstance(state, ca.MX) else "of second order"
            raise ValueError(f"{label}: given with a model {kind}; accepted: one of first order in SX")
        return mass_matrix(given, found["parameters"], size)

    return {
        "mass": mass, "decay": rate,
        "rhs": expression, "normalisation": scalar, "hamiltonian": scalar, "outputs": group, "conserved": group,
        "symmetries": group, "forcing_period": period, "output_scale": numbers, "nominal": usual,
        "reversal": signs, "half_period": signs, "state_labels": names, "parameter_labels": names,
    }  # fmt: skip


def is_name(given: object) -> bool:
    """Whether this is text that a message can show in its line."""
    return isinstance(given, str) and bool(given) and given.isprintable()


# Shapes and symbols ---------------------------------------------------------------------------------------------------


def check_declarations(model: Equations) -> None:
    """Raises ValueError, naming the model, where shapes, names or symbols do not fit each other."""
    for fault in _faults(model):
        raise ValueError(f"{model.name}: {fault}")


def _faults(model: Equations) -> Iterator[str]:
    if model.rhs.shape != model.state.shape:
        yield f"rhs: given shape {model.rhs.shape}; accepted: {model.state.shape}, that of the state"
    if (model.velocity is None) != (model.order == 1):
        yield "a velocity symbol belongs to a model of second order, and only there"
    if model.velocity is not None and model.velocity.shape != model.state.shape:
        yield f"velocity: given shape {model.velocity.shape}; accepted: {model.state.shape}, that of the state"
    if model.order == 2 and isinstance(model.state, ca.MX):
        yield "of second order in MX; accepted: SX, or a model of first order"
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
    symbols = [model.full_state, model.parameters, *([] if model.time is None else [model.time])]
    twice = sorted(name for name, count in Counter(_entries(symbols)).items() if count > 1)
    if twice:
        yield f"the symbol {twice[0][1]} twice among state, velocity, parameters and time; accepted: different symbols"
        return
    if not all(_plain(symbol) for symbol in symbols):
        yield "state, velocity, parameters or time with expressions among them; accepted: symbols"
    yield from _names(model)
    yield from _strangers(model, symbols)
    if model.velocity is not None and ca.depends_on(model.rhs, model.velocity):
        yield "a second-order right-hand side that depends on velocity; write first order"
    if model.decay is not None and model.mass is None:
        yield "decay: given without mass; accepted: with a mass matrix that is singular"
    if model.hamiltonian is not None and model.forced:
        yield "a hamiltonian in a model that is forced; accepted: without time, where it is conserved"
    if model.conserved and model.forced:
        yield "conserved quantities in a model that is forced; accepted: without time"
    for name, quantity in model.conserved.items():
        if quantity.numel() != 1:
            yield f"conserved {name} of shape {quantity.shape}; accepted: a scalar expression"
    for name, direction in model.symmetries.items():
        if name not in model.conserved:
            yield f"symmetries {name}: {name} is not among conserved; accepted: {', '.join(model.conserved) or 'none'}"
        elif direction.numel() != model.full_size:
            yield f"symmetries {name} of shape {direction.shape}; accepted: {model.full_size} components"
    if model.forced and model.forcing_period is None:
        yield "time without forcing_period; accepted: the forcing's period, a number or an expression in parameters"
    for label, signs in (("reversal", model.reversal), ("half_period", model.half_period)):
        if signs is not None and len(signs) != model.full_size:
            yield f"{label} needs {model.full_size} signs, each +1 or -1; given {len(signs)}"


def _entries(symbols: list[Expression]) -> Iterator[tuple[int, str]]:
    """Keys of symbols, with their names; expressions among them are left out."""
    for symbol in symbols:
        for entry in symbol.elements() if isinstance(symbol, ca.SX) else [symbol]:
            if entry.numel() and entry.is_symbolic():
                yield (entry.element_hash() if isinstance(entry, ca.SX) else hash(entry)), entry.name()


def _plain(symbol: Expression) -> bool:
    """Whether this is a symbol, or in SX several; in MX several are an expression, which has no name."""
    if isinstance(symbol, ca.MX):
        return bool(symbol.is_symbolic()) or symbol.numel() == 0
    return bool(symbol.is_valid_input())


def _names(model: Equations) -> Iterator[str]:
    names = [*model.state_names, *model.parameter_names, *model.outputs]
    strange = [name for name in names if not is_name(name)]
    if strange:
        yield f"{short_repr(strange[0])} as the name of a state or parameter; accepted: {ACCEPTED_NAMES}"
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        yield f"{', '.join(twice)} named more than once among states, parameters and outputs; accepted: different names"


def _strangers(model: Equations, symbols: list[Expression]) -> Iterator[str]:
    """Expressions that depend on undeclared symbols."""
    named: dict[str, object] = {label: getattr(model, label) for label in ("rhs", "normalisation", "hamiltonian")}
    for label, group in (("output", model.outputs), ("conserved", model.conserved), ("symmetries", model.symmetries)):
        named |= {f"{label} {name}": expression for name, expression in group.items()}
    given = {label: expression for label, expression in named.items() if expression is not None}
    if not ca.Function("f", symbols, list(given.values()), {"allow_free": True}).get_free():
        given = {}
    for label, expression in given.items():
        unknown = ca.Function("f", symbols, [expression], {"allow_free": True}).get_free()
        if unknown:
            declared = ", ".join(name for _, name in _entries(symbols))
            yield f"{label}: depends on {', '.join(unknown)}, not declared; accepted: {declared}"
    if isinstance(model.forcing_period, ca.SX | ca.MX):
        period = ca.Function("T", [model.parameters], [model.forcing_period], {"allow_free": True})
        if period.get_free():
            yield f"forcing_period depends on {', '.join(period.get_free())}; accepted: parameters"


# Symmetries and conserved quantities that a model declares, evaluated at random points --------------------------------

ROUND_OFF = 1e-12  # of the size of the right-hand side


def check_symmetries(model: Any, trials: int, seed: int) -> None:
    """Raises ValueError naming the first symmetry or conserved quantity that does not hold at random points."""
    kept = {"hamiltonian": model.hamiltonian} if model.hamiltonian is not None else {}
    kept |= {f"conserved {name}": quantity for name, quantity in model.conserved.items()}
    if model.reversal is None and model.half_period is None and not kept:
        return
    x, rhs = model.full_state, model.full_rhs
    rates = [ca.densify(ca.gradient(quantity, x) * rhs) for quantity in kept.values()]
    brackets = [ca.densify(ca.jtimes(rhs, x, g) - ca.jtimes(g, x, rhs)) for g in model.symmetries.values()]
    evaluate = model.function("check", ca.densify(rhs), *rates, *brackets)
    generator = np.random.default_rng(seed)
    for _ in range(trials):
        time, point, parameter = _finite_point(model, evaluate, generator)
        point = point if model.implicit is None else model.implicit.consistent(time, point, parameter)
        value, *changes = (np.array(r).ravel() for r in evaluate.call([time, point, parameter]))
        scale = ROUND_OFF * (1.0 + np.abs(value).max())
        half = 0.5 * model.forcing_period_at(parameter)
        images = (("reversal", model.reversal, -1, -time), ("half_period", model.half_period, 1, time + half))
        for label, signs, sense, at in images:
            if signs is None:
                continue
            image = np.array(evaluate.call([at, np.array(signs) * point, parameter])[0]).ravel()
            if not np.abs(image - sense * np.array(signs) * value).max() <= scale:
                raise ValueError(f"{model.name}: the declared {label} is not a symmetry of the right-hand side")
        within = scale * (1.0 + np.abs(point).sum())
        for label, change in zip(kept, changes, strict=False):
            if not abs(np.sum(change)) <= max(within, ROUND_OFF * np.sum(np.abs(change))):
                raise ValueError(f"{model.name}: the declared {label} is not conserved")
        for label, bracket in zip(model.symmetries, changes[len(kept) :], strict=True):
            if not np.max(np.abs(bracket)) <= within:
                raise ValueError(f"{model.name}: the declared direction {label} is not that of a symmetry")


def _finite_point(
    model: Equations, evaluate: ca.Function, generator: np.random.Generator
) -> tuple[float, Array, Array]:
    """A random time, state and parameter at which all is finite: positive where roots and logarithms need it."""
    time = generator.normal()
    x, p = (generator.normal(size=count) for count in (model.full_size, model.parameters.numel()))
    for point, parameter in ((x, p), (x, np.abs(p)), (np.abs(x), np.abs(p))):
        if all(np.all(np.isfinite(np.array(r))) for r in evaluate.call([time, point, parameter])):
            return time, point, parameter
    raise ValueError(f"{model.name}: the right-hand side or the hamiltonian is not finite at a random point")


# Whether a right-hand side repeats itself after the declared period of the forcing ------------------------------------

SAME_RATE_RTOL = 1e-7  # of the largest rate
COMPARED_PLACES = 7  # places of a motion
PLACE_FRACTION = 0.382  # of the way between two places: forces like sign(sin t) jump at simple parts of the period


class Motion(Protocol):
    def evaluate(self, t: Array) -> Array: ...


def check_forcing_period(model: Equations, motion: Motion, length: float, parameters: Mapping[str, float]) -> None:
    """Compares the right-hand side along a motion with that of one period of the forcing later.

    Arguments:
        model: a model that time drives.
        motion: its first-order states at any time.
        length: the time for which it is looked at.
        parameters: numbers for all parameters, by name.

    Raises:
        ValueError: they differ.
    """
    p = [parameters[name] for name in model.parameter_names]
    period, field = model.forcing_period_at(p), model.function("field", model.full_rhs)
    times = length * (np.arange(COMPARED_PLACES) + PLACE_FRACTION) / COMPARED_PLACES
    for t, x in zip(times, motion.evaluate(times), strict=True):
        now, later = (np.array(field(at, x, p)).ravel() for at in (t, t + period))
        if np.max(np.abs(later - now)) > SAME_RATE_RTOL * (1.0 + np.max(np.abs(now))):  # not so where one is no number
            at = ", ".join(f"{name} = {parameters[name]:.6g}" for name in model.parameter_names)
            given = (
                f"forcing_period: given {period:.6g}{f' at {at}' if at else ''}, after which equations do not repeat"
            )
            accepted = "a period after which they do, an expression in the parameters that it depends on"
            raise ValueError(f"{model.name}: {given}; accepted: {accepted}")
