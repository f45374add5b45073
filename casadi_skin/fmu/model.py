"""A model made of an FMU that is unpacked: the right-hand side and its derivatives are those of its binary."""

from __future__ import annotations

import os
import pickle
import signal
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq, minimize_scalar

from casadi_skin.fmu.description import FmuChoices, FmuWarning, Pattern, Unpacked, Variables, read_description, unpack
from casadi_skin.fmu.function import DIFFERENCE_STEP, Derivatives, FmuFunction
from casadi_skin.fmu.instance import FmuInstance
from casadi_skin.model.arguments import by_name, file_path, number, short_repr
from casadi_skin.model.expressions import expression_of
from casadi_skin.model.jumps import STATE, Jumps, Switch
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import in_turn, warn_caller
from casadi_skin.native import Array
from casadi_skin.native.programs import Program

Signal: TypeAlias = float | Callable[[Any], Any]
_COMPARED_TIMES = (0.0, 0.37, 1.9)  # where the equations must be the same unless the model is forced
PERIODIC_RTOL = 1e-9  # of a signal's size, between times that are a period apart


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class FmuModel(OdeModel):
    """A model whose equations are in an FMU's binary; functions made of it live as long as it does.

    `start_state` is where the FMU starts from, shape (states,), `signals` the function of the time whose values its
    inputs get. Jacobians come from the FMU where `derivatives` is
    "directional", else from "differences". The instances and their temporary folder go when the model does.
    """

    start_state: tuple[float, ...]
    instance: FmuInstance
    functions: tuple[FmuFunction, ...] = field(repr=False)
    signals: ca.Function = field(repr=False)

    @property
    def programs(self) -> tuple[Program, ...]:
        """Right-hand side and outputs with their Jacobians."""
        return tuple(f for own in self.functions for f in (own, own.jacobian_function) if f is not None)

    @property
    def derivatives(self) -> str:
        """Method for the Jacobian by the states: "directional" or "differences"."""
        return self.functions[0].derivatives.by_states

    @property
    def parameter_derivatives(self) -> str:
        """Method for the Jacobian by the parameters: "directional" or "differences"."""
        return self.functions[0].derivatives.by_parameters

    @property
    def noise(self) -> float:
        """Largest estimated error of a Jacobian so far relative to its largest entry: 0 without differences."""
        return max(f.derivatives.difference.largest_error for f in self.functions)

    @property
    def rounding(self) -> float:
        """Relative error of values, which gives differences with their step the error `noise`."""
        return max(super().rounding, DIFFERENCE_STEP * self.noise)

    @property
    def complaints(self) -> tuple[str, ...]:
        """The FMU's last messages, as where it could not compute a value, which then is NaN."""
        return tuple(self.instance.complaints)

    @cached_property
    def jumps(self) -> Jumps:
        """Its event indicators, where it has some."""
        return Indicators(self) if self.instance.variables.indicators else Jumps(self)

    def __reduce__(self) -> tuple[Any, ...]:
        """Raises ValueError: another process reads the FMU itself."""
        raise ValueError(f"{self.name}: cannot be pickled: its equations are those of a program, the FMU")

    def close(self) -> None:
        """Free the FMU and remove its folder; its functions fail afterwards."""
        self.instance.close()


class Indicators(Jumps):
    """The event indicators of an FMU, whose equations are those between events: a change of sign is as a jump."""

    model: FmuModel
    end_motion = True

    @property
    def accepted(self) -> str:
        """Solutions on one side of each."""
        return "solutions along which no event indicator changes the sign that it has at the FMU's start"

    @cached_property
    def found(self) -> list[Switch]:
        """One that the state decides, whatever their number."""
        return [Switch("EVENT", (), ca.SX(0), STATE)]

    def along(self, times: Array, states: Array, parameters: Array, by: int = STATE) -> str:
        """That an indicator changes its sign along a path, with its name and the time; empty where none does."""
        rows = np.broadcast_to(parameters, (len(times), np.shape(parameters)[-1]))
        values, positive = self._at(times, states, rows)
        if np.any(lost := ~np.all(np.isfinite(values), axis=1)):
            return f"event indicators cannot be had at t = {times[np.argmax(lost)]:.6g}"
        if np.ndim(parameters) == 1 and len(times) > 2 and np.all(np.diff(times) > 0.0):
            spline = CubicSpline(times, states)
            crossing = _crossing(times, values, positive[0], lambda t: self._at(t, spline(t), rows[:1])[0])
        else:  # of places that are not in the order of time
            changed = ((values > 0.0) != positive) | (positive != positive[0])  # or parameters decide it
            crossing = next(((times[k], j) for k, j in np.argwhere(changed)), None)
        if crossing is None:
            return ""
        t, which = crossing
        return f"event indicator {self.model.instance.variables.indicators[which]} changes its sign at t = {t:.6g}"

    def _at(self, times: Array, states: Array, rows: Array) -> tuple[Array, Pattern]:
        """Indicators at places, and which of them are positive at the start."""
        model, rows = self.model, np.broadcast_to(rows, (len(times), rows.shape[1]))
        given = np.hstack([rows, np.array(model.signals.map(len(times))(times[None])).T])
        return model.instance.indicators(times, states[:, np.argsort(model.instance.variables.order)], given)


def _crossing(times: Array, values: Array, positive: Pattern, at: Callable[[Array], Array]) -> tuple[float, int] | None:
    """When an indicator has another sign than at the start, `positive` or not, and which one; None where none has.

    `at` gives indicators at times between the places, where they are `values`. One that is nearest to zero at a place,
    less than half as far as beside it, may be beyond zero between: its extremum is sought.
    """
    signs = np.where(positive, 1.0, -1.0)

    def away(t: float, which: int) -> float:
        return float(signs[which] * at(np.array([t]))[0, which])

    def zero(first: float, last: float, which: int) -> float:
        ends = away(first, which), away(last, which)
        if ends[0] <= 0.0 or ends[1] >= 0.0:  # zero there but for rounding, which interpolation changes
            return first if ends[0] <= 0.0 else last
        return float(brentq(away, first, last, (which,)))

    for k, j in np.argwhere((values > 0.0) != positive):
        return (zero(times[k - 1], times[k], j) if k else times[0]), j
    before, here, after = ((signs * values)[first : len(values) - 2 + first] for first in range(3))
    for k, j in np.argwhere((here <= before) & (here <= after) & (2.0 * here < np.maximum(before, after))):
        nearest = minimize_scalar(away, (times[k], times[k + 2]), (times[k], times[k + 2]), (j,), "bounded").x
        if away(nearest, j) < 0.0:
            return zero(times[k], nearest, j), j
    return None


def made(unpacked: Unpacked, choices: FmuChoices, signals: Mapping[str, Signal]) -> FmuModel:
    """The model in an FMU that is unpacked, with values or signals of its inputs; raises ValueError as `import_fmu`."""
    instance = FmuInstance(unpacked, Variables(unpacked.path, unpacked.description, choices))
    try:
        return _model(instance, choices, signals)
    except BaseException:
        instance.close()
        raise


def _model(instance: FmuInstance, choices: FmuChoices, signals: Mapping[str, Signal]) -> FmuModel:
    variables, forced = instance.variables, choices.forcing_period is not None
    count = len(choices.parameters)
    t, x, p = ca.MX.sym("t"), ca.MX.sym("x", len(variables.states)), ca.MX.sym("p", count)
    inputs = [signal_at(name, signals[name], t, choices.forcing_period) for name in choices.inputs]
    if not forced:
        _check_autonomous(instance, [float(ca.evalf(value)) for value in inputs])
    offered = instance.unpacked.offers_derivatives

    functions = [FmuFunction("fmu_derivatives", Derivatives(instance, None, offered), forced)]
    shown = variables.outputs
    if shown:
        functions.append(FmuFunction("fmu_outputs", Derivatives(instance, shown, offered), forced))
    back = np.argsort(variables.order).tolist()
    given = ca.vertcat(p, *inputs) if inputs else p
    results = [call(t if forced else 0.0, x[back], given) for call in functions]
    return FmuModel(
        str(variables.description.modelName), x, results[0][variables.order], p, time=t if forced else None,
        forcing_period=choices.forcing_period, nominal=tuple(instance.start_given[:count].tolist()), checked=False,
        outputs={element.name: results[1][i] for i, element in enumerate(shown)},
        state_labels=tuple(variables.states[i].name for i in variables.order), parameter_labels=choices.parameters,
        start_state=tuple(instance.start[variables.order].tolist()), instance=instance, functions=tuple(functions),
        signals=ca.Function("signals", [t], [ca.vertcat(*inputs) if inputs else ca.MX(0, 1)]),
    )  # fmt: skip


def signal_at(name: str, signal: Signal, t: ca.MX, period: float | None) -> ca.MX:
    """The value of an input as an expression in the time.

    Raises ValueError for a signal without a forcing period, or that does not have that period.
    """
    expression = expression_of(f"inputs, {name}", signal, [t], "f(t)")
    if expression.numel() != 1:
        raise ValueError(f"inputs, {name}: given shape {expression.shape}; accepted: a number, or one of f(t)")
    if not ca.depends_on(expression, t):
        return expression
    if period is None:
        raise ValueError(f"inputs, {name}: given a function of time; accepted: with forcing_period=")
    values = ca.Function("u", [t], [expression])
    now, later = (np.array([float(values(s + at)) for at in _COMPARED_TIMES]) for s in (0, period))
    if not np.allclose(now, later, rtol=PERIODIC_RTOL, atol=PERIODIC_RTOL * max(1.0, float(np.abs(now).max()))):
        raise ValueError(f"inputs, {name}: given a signal that has not the period {period:g}; accepted: one that has")
    return expression


def _check_autonomous(instance: FmuInstance, inputs: list[float]) -> None:
    """Raises ValueError where the derivatives at the start change with time alone."""
    given = np.concatenate([instance.start_given[: instance.start_given.size - len(inputs)], inputs])
    rows = np.ones((len(_COMPARED_TIMES), 1))
    values = instance.numbers(instance.points(None), np.array(_COMPARED_TIMES), rows * instance.start, rows * given)
    if not np.array_equal(values, rows * values[0], equal_nan=True):
        raise ValueError(f"{instance.path}: the equations depend on time; accepted: with forcing_period=")


# An FMU's binary in a process of its own first: where it ends that process, or never answers, it is refused -----------

_answered: set[tuple[Any, ...]] = set()  # archives and arguments that were tried in this process
_tried_models: list[Any] = []  # in the other process, where nothing is freed: that comes after the answer


def check_answer(
    unpacked: Unpacked, choices: FmuChoices, inputs: Mapping[str, float], time_limit: float,
    make: Callable[..., object], *more: Any,
) -> None:  # fmt: skip
    """Raises ValueError where a model cannot be made of an FMU, and evaluated once, within a time, in seconds.

    `make` gets the FMU that is unpacked, the choices, the inputs, and `more`.
    """
    from casadi_skin.solve.processes import Worker, WorkerEndedError

    key = unpacked.digest, choices, tuple(inputs.items()), unpacked.kind, more
    if key in _answered:
        return
    worker, words = Worker(group=True), f"{unpacked.path}: its binary"
    try:
        files = unpacked.path, unpacked.folder, unpacked.library, unpacked.kind
        task = make, files, (choices, inputs, *more)
        worker.compute(pickle.dumps(_try), task, time_limit)
    except TimeoutError:
        accepted = "accepted: one that does, or a longer time_limit"
        raise ValueError(f"{words} does not answer within {time_limit:g} s; {accepted}") from None
    except WorkerEndedError as error:
        code = worker.exit_code
        how = str(error) if code is None else signal.Signals(-code).name if code < 0 else f"exit status {code}"
        raise ValueError(f"{words} ends the process that calls it ({how}); accepted: one that comes back") from error
    finally:
        worker.end()
    _answered.add(key)


def _try(task: Any, *_: Any) -> None:
    """In the process: make the model, and evaluate it once."""
    make, (path, folder, library, kind), arguments = task
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what a binary prints is not for the reader, who may see it later
    with suppress(Exception):  # the same is raised, and reported, where the FMU is read
        description = read_description(path, folder, kind)
        model = make(Unpacked(path, folder, library, description, lambda: None, kind=kind), *arguments)
        _tried_models.append(model)
        if isinstance(model, FmuModel):
            model.function("once", model.rhs, *model.outputs.values())(0.0, model.start_state, model.nominal or ())


# Models of FMUs in files of results: the identity of the FMU and the choices of its import; never its binary ----------

SAMPLES_PER_PERIOD = 8  # times in a period at which signals are compared


class OtherModelError(ValueError):
    """The model that a reader was given is not that of the file."""


def identity(model: FmuModel) -> dict[str, Any]:
    """The identity of an FMU's model: its token, a hash of its files, and the choices of its import."""
    variables = model.instance.variables
    choices, description = variables.choices, variables.description
    token = description.guid if str(description.fmiVersion).startswith("2") else description.instantiationToken
    times = [k / SAMPLES_PER_PERIOD * (choices.forcing_period or 0.0) for k in range(SAMPLES_PER_PERIOD)]
    signals = np.array([np.array(model.signals(t)).ravel() for t in times])
    return {
        "name": model.name, "token": str(token), "hash": model.instance.unpacked.digest,
        "states": list(model.state_names), "parameters": list(model.parameter_names),
        "inputs": list(choices.inputs), "signals": signals.ravel().tolist(), "forcing_period": choices.forcing_period,
        "derivatives": [model.derivatives, model.parameter_derivatives],
    }  # fmt: skip


def noises(model: FmuModel) -> list[float]:
    """Largest errors of differences so far: tolerances depend on them."""
    return [function.derivatives.difference.largest_error for function in model.functions]


def checked(saved: Mapping[str, Any], noise: list[float], model: Any) -> FmuModel:
    """The model that a reader was given, where it is the one that was saved; raises OtherModelError in a line."""
    words = f"its model is the FMU {short_repr(saved['name'])} with token {short_repr(saved['token'])}"
    if model is None:
        why = f"{words}, and reading runs no binary"
        raise OtherModelError(f"{why}; accepted: read_result(path, model=import_fmu(...)) of that FMU")
    if not isinstance(model, FmuModel):
        raise OtherModelError(f"model: given {short_repr(model)}; accepted: a model of import_fmu, as {words}")
    here = identity(model)
    for label, there in saved.items():
        if here[label] != there:
            names = f"given one with {label} {short_repr(here[label])}; accepted: {label} {short_repr(there)}"
            raise OtherModelError(f"model: {names}, as {words}")
    for function, largest in zip(model.functions, noise, strict=True):
        difference = function.derivatives.difference
        difference.largest_error = max(difference.largest_error, largest)
    return model


def at_symbols(columns: list[ca.SX], before: list[ca.SX], symbols: list[Any]) -> list[Any]:
    """Expressions in SX symbols as those in the symbols of a model, which are in MX where it is a program."""
    if isinstance(symbols[0], ca.SX):
        return columns
    found = []
    for column in columns:
        used = [k for k, block in enumerate(before) if ca.depends_on(column, block)]
        function = ca.Function("statement", [before[k] for k in used], [column])
        found.append(function(*(symbols[k] for k in used)) if used else ca.MX(ca.DM(column)))
    return found


# An imported FMU as an `OdeModel`: the right-hand side and its derivatives are those of its binary --------------------

TIME_LIMIT = 60.0  # seconds


def checked_choices(
    states: object, parameters: object, inputs: Mapping[str, Signal] | None, forcing_period: float | None,
    time_limit: float,
) -> tuple[FmuChoices, Mapping[str, Signal], dict[str, float]]:  # fmt: skip
    """The choices of a script, its signals, and their values at time 0; raises as `import_fmu` does."""
    if forcing_period is not None and number("forcing_period", forcing_period) <= 0:
        raise ValueError(f"forcing_period: given {forcing_period!r}; accepted: a number > 0")
    if number("time_limit", time_limit) <= 0:
        raise ValueError(f"time_limit: given {time_limit!r}; accepted: seconds > 0")
    listed: list[tuple[str, ...]] = []
    for label, names in (("states", () if states is None else states), ("parameters", parameters)):
        if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
            raise ValueError(f"{label}: given {short_repr(names)}; accepted: a list of names")
        listed.append(tuple(names))
    signals = by_name("inputs", inputs, "a number or a function f(t)")
    t = ca.MX.sym("t")
    first = [signal_at(name, signal, t, forcing_period) for name, signal in signals.items()]
    at_start = {name: float(ca.Function("u", [t], [u])(0.0)) for name, u in zip(signals, first, strict=True)}
    order = None if states is None else listed[0]
    return FmuChoices(order, listed[1], tuple(signals), forcing_period), signals, at_start


@in_turn
def import_fmu(
    path: str | Path,
    *,
    states: Sequence[str] | None = None,
    parameters: Sequence[str] = (),
    inputs: Mapping[str, Signal] | None = None,
    forcing_period: float | None = None,
    time_limit: float = TIME_LIMIT,
) -> FmuModel:
    """The model in an FMU (FMI 2.0 or 3.0, Model Exchange, between events), through its binary for this platform.

    Jacobians are the FMU's where it offers them and they agree with differences, else by differences, whose estimated
    error is the model's `noise`. The binary runs with your permissions. It is loaded and called in a process of its
    own first, once for each file, so that one that ends its process or never answers is refused; its later calls, at
    other states, run in this process.

    Arguments:
        path: The FMU.
        states: All of its continuous states by name, in the wanted order; by default in its own.
        parameters: Its real parameters and inputs that become parameters of the model; the others keep their values.
        inputs: Values of its inputs by name, or signals: functions f(t) of CasADi's time with the forcing's period. The
            others keep their start values. Entries of arrays are called u[1], A[1,2].
        forcing_period: The period of a model that depends on time.
        time_limit: Seconds in which the binary must answer in the process of its own.

    Returns:
        The model, of first order.

    Raises:
        ValueError: A name is unknown; the FMU is damaged, hostile, too large, of another platform, or without Model
            Exchange; its binary does not come back; or fmpy (the extra "fmu") is not installed. In one line.
        TypeError: An argument is of another kind.
    """
    choices, signals, at_start = checked_choices(states, parameters, inputs, forcing_period, time_limit)
    unpacked = unpack(file_path("path", path))
    try:
        variables = Variables(unpacked.path, unpacked.description, choices)  # names first: they run nothing
        check_answer(unpacked, choices, at_start, time_limit, made)
        model = made(unpacked, choices, signals)
        if variables.indicators:
            words = "it is followed between events, and refused along a solution where one of them changes its sign"
            many = f"{path}: event indicators, {len(variables.indicators)} of them"
            warn_caller(f"{many}: {words}", FmuWarning)
        return model
    except BaseException:
        unpacked.remove()
        raise
