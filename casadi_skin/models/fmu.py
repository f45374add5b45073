"""Somebody's FMU as an `OdeModel`: the right-hand side and its derivatives are those of its binary.

FMI 2.0 and 3.0, Model Exchange without events (https://fmi-standard.org). The equations are functions of a program, not
expressions: everything that needs no more than their values and first derivatives takes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np

from casadi_skin.arguments import file_path, nearest, number, short_repr
from casadi_skin.models.fmu_archive import Unpacked, unpack
from casadi_skin.models.fmu_derivatives import STEP, Derivatives, Pattern, Value
from casadi_skin.models.fmu_function import FmuFunction
from casadi_skin.models.fmu_instance import FmuInstance
from casadi_skin.models.fmu_trial import check_answer
from casadi_skin.models.ode import OdeModel

_REAL = ("Real", "Float64")
TIME_LIMIT = 60.0  # seconds
_TIMES = (0.0, 0.37, 1.9)  # where the equations must be the same unless the model is forced


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class FmuModel(OdeModel):
    """A model whose equations are in an FMU's binary; functions made of it live as long as it does.

    `start_state` is where the FMU starts from, shape (states,). Jacobians come from the FMU where `derivatives` is
    "directional", else from "differences". The instance and its temporary folder go when the model does.
    """

    start_state: tuple[float, ...]
    instance: FmuInstance
    functions: tuple[FmuFunction, ...] = field(repr=False)

    @property
    def derivatives(self) -> str:
        """How the Jacobian by the states is computed: "directional" or "differences"."""
        return self.functions[0].derivatives.by_states

    @property
    def parameter_derivatives(self) -> str:
        """How the Jacobian by the parameters is computed: "directional" or "differences"."""
        return self.functions[0].derivatives.by_parameters

    @property
    def noise(self) -> float:
        """Largest estimated error of a Jacobian so far relative to its largest entry: 0 without differences."""
        return max(f.derivatives.difference.largest_error for f in self.functions)

    @property
    def rounding(self) -> float:
        """Relative error of values: what makes differences with their step wrong by `noise`."""
        return max(super().rounding, STEP * self.noise)

    @property
    def complaints(self) -> tuple[str, ...]:
        """The FMU's last messages, as where it could not compute a value, which then is NaN."""
        return tuple(self.instance.complaints)

    def __reduce__(self) -> tuple[Any, ...]:
        """Raises ValueError: another process reads the FMU itself."""
        raise ValueError(f"{self.name}: cannot be pickled: its equations are those of a program, the FMU")

    def close(self) -> None:
        """Free the FMU and remove its folder; its functions fail afterwards."""
        self.instance.close()


def import_fmu(
    path: str | Path,
    *,
    states: Sequence[str] | None = None,
    parameters: Sequence[str] = (),
    forcing_period: float | None = None,
    time_limit: float = TIME_LIMIT,
) -> FmuModel:
    """The model in an FMU (FMI 2.0 or 3.0, Model Exchange without events), through its binary for this platform.

    Jacobians are the FMU's where it offers them and they agree with differences, else by differences, whose estimated
    error is the model's `noise`. The binary runs with all that you may do. It is loaded and called in a process of its
    own first, once for each file, so that one that ends its process or never answers is refused; what it does later, at
    other states, happens in this process.

    Arguments:
        path: The FMU.
        states: All of its continuous states by name, in the wanted order; by default in its own.
        parameters: Its real parameters and inputs that become parameters of the model; the others keep their values.
        forcing_period: The period of a model that depends on time.
        time_limit: Seconds in which the binary must answer in the process of its own.

    Returns:
        The model, of first order.

    Raises:
        ValueError: A name is unknown; the FMU is damaged, hostile, too large, of another platform, or without Model
            Exchange; its binary does not come back; or fmpy (the extra "fmu") is not installed. In one line.
        TypeError: An argument is of another kind.
    """
    if forcing_period is not None and number("forcing_period", forcing_period) <= 0:
        raise ValueError(f"forcing_period: given {forcing_period!r}; accepted: a number > 0")
    if number("time_limit", time_limit) <= 0:
        raise ValueError(f"time_limit: given {time_limit!r}; accepted: seconds > 0")
    for label, names in (("states", states), ("parameters", parameters)):
        given = () if names is None and label == "states" else names
        if not isinstance(given, list | tuple) or not all(isinstance(name, str) for name in given):
            raise ValueError(f"{label}: given {short_repr(names)}; accepted: a list of names")
    unpacked = unpack(file_path("path", path))
    try:
        _chosen(unpacked, states, parameters)  # names first: they run nothing
        asked = {"states": states, "parameters": tuple(parameters), "forcing_period": forcing_period}
        check_answer(unpacked, asked, time_limit)
        return made(unpacked, states, parameters, forcing_period)
    except BaseException:
        unpacked.remove()
        raise


def made(
    unpacked: Unpacked, states: Sequence[str] | None, parameters: Sequence[str], forcing_period: float | None
) -> FmuModel:
    """The model in an FMU that is unpacked; raises ValueError as `import_fmu`."""
    instance = FmuInstance(unpacked, _chosen(unpacked, states, parameters))
    try:
        return _model(instance, states, forcing_period)
    except BaseException:
        instance.close()
        raise


def _chosen(unpacked: Unpacked, states: Sequence[str] | None, parameters: Sequence[str]) -> list[Any]:
    """fmpy's variables of the parameters; raises ValueError for these and for states that there are not."""
    variables = unpacked.description.modelVariables
    known = {v.name: v for v in variables if v.causality in ("parameter", "input") and v.type in _REAL}
    chosen = [_parameter(name, known) for name in parameters]
    if len(set(parameters)) < len(chosen):
        raise ValueError(f"parameters: given {', '.join(parameters)}; accepted: each one once")
    _check_description(unpacked.path, unpacked.description, states)
    return chosen


def _model(instance: FmuInstance, states: Sequence[str] | None, forcing_period: float | None) -> FmuModel:
    description, forced = instance.description, forcing_period is not None
    entries = list(description.derivatives)
    variables = [entry.variable.derivative for entry in entries]
    names = [variable.name for variable in variables]
    order = [names.index(name) for name in states] if states is not None else list(range(len(names)))
    if not forced:
        _check_autonomous(instance)
    known = tuple(int(variable.valueReference) for variable in variables)
    scale = np.array([_size(v, start) for v, start in zip(variables, instance.start, strict=True)])
    offered = _offers_derivatives(instance)

    def function(name: str, unknowns: list[Any], value: Value) -> FmuFunction:
        references = tuple(int(entry.variable.valueReference) for entry in unknowns)
        pattern = _declared(unknowns, variables)
        return FmuFunction(name, Derivatives(instance, references, known, scale, value, pattern, offered), forced)

    functions = [function("fmu_derivatives", entries, instance.derivatives)]
    taken = {*names, *(variable.name for variable in instance.parameters)}
    shown = [e for e in description.outputs if e.variable.type in _REAL and e.variable.name not in taken]
    if shown:
        asked = tuple(int(entry.variable.valueReference) for entry in shown)
        functions.append(function("fmu_outputs", shown, lambda t, x, p: instance.outputs(asked, t, x, p)))
    t, x, p = ca.MX.sym("t"), ca.MX.sym("x", len(names)), ca.MX.sym("p", len(instance.parameters))
    back = np.argsort(order).tolist()
    results = [call(t if forced else 0.0, x[back], p) for call in functions]
    return FmuModel(
        name=str(description.modelName),
        state=x,
        rhs=results[0][order],
        parameters=p,
        time=t if forced else None,
        forcing_period=forcing_period,
        outputs={entry.variable.name: results[1][i] for i, entry in enumerate(shown)},
        nominal=tuple(float(v) for v in instance.start_parameters),
        state_labels=tuple(names[i] for i in order),
        parameter_labels=tuple(variable.name for variable in instance.parameters),
        checked=False,
        start_state=tuple(float(instance.start[i]) for i in order),
        instance=instance,
        functions=tuple(functions),
    )


def _offers_derivatives(instance: FmuInstance) -> bool:
    """Whether the FMU says so; fmpy does not keep that flag of FMI 3.0."""
    exchange = ET.parse(instance.folder / "modelDescription.xml").getroot().find("ModelExchange")
    flags = ("providesDirectionalDerivatives", "providesDirectionalDerivative")
    return exchange is not None and any(exchange.get(flag) in ("true", "1") for flag in flags)


def _size(variable: Any, start: float) -> float:
    """Usual size of a state: its nominal value where it has one that can be."""
    nominal = abs(float(variable.nominal or 0.0))
    return nominal if 0.0 < nominal < np.inf else max(1.0, abs(start))


def _declared(unknowns: list[Any], states: list[Any]) -> Pattern:
    """Which unknowns depend on which states as ModelStructure tells it; on all where it says nothing."""
    places = {variable.name: k for k, variable in enumerate(states)}
    pattern = np.zeros((len(unknowns), len(states)), dtype=bool)
    for row, entry in enumerate(unknowns):
        if entry.dependencies is None:
            pattern[row] = True
        else:
            pattern[row, [places[v.name] for v in entry.dependencies if v.name in places]] = True
    return pattern


# Refusals -------------------------------------------------------------------------------------------------------------


def _check_description(path: str | Path, description: Any, states: Sequence[str] | None) -> None:
    """Raises ValueError for a model without states, with events, or other states than those named."""
    strange = [entry.variable.name for entry in description.derivatives if entry.variable.derivative is None]
    if strange:
        raise ValueError(f"{path}: {strange[0]} is listed as a derivative, but of no state; accepted: derivatives")
    names = [entry.variable.derivative.name for entry in description.derivatives]
    if not names:
        raise ValueError(f"{path}: no continuous states; accepted: a model with some")
    for variable in description.modelVariables:
        _check_numbers(path, variable)
    arrays = [e.variable.derivative.name for e in description.derivatives if getattr(e.variable, "dimensions", None)]
    if arrays:
        raise ValueError(f"{path}: states that are arrays, {', '.join(arrays)}; accepted: scalar states")
    indicators = max(int(description.numberOfEventIndicators or 0), len(description.eventIndicators or ()))
    if indicators:
        raise ValueError(f"{path}: event indicators, {indicators} of them; accepted: a model without events")
    if states is None:
        return
    for name in states:
        if name not in names:
            raise ValueError(f"states: given {name!r}; accepted: {_nearest(name, names)}")
    missing = [name for name in names if name not in states]
    if missing or len(set(states)) < len(states):
        words = ", ".join(missing or sorted({name for name in states if list(states).count(name) > 1}))
        raise ValueError(f"states: {'left out' if missing else 'twice'}: {words}; accepted: each of the FMU's once")


def _check_numbers(path: str | Path, variable: Any) -> None:
    """Raises ValueError where the start or the nominal value of a real scalar is no number."""
    if variable.type not in _REAL or getattr(variable, "dimensions", None):
        return
    for label, text in (("start", variable.start), ("nominal", variable.nominal)):
        try:
            float(text or 0.0)
        except ValueError:
            given = f"{label} value {short_repr(text)} of {variable.name}"
            raise ValueError(f"{path}: {given}; accepted: a number") from None


def _parameter(name: str, known: Mapping[str, Any]) -> Any:
    """fmpy's variable of a parameter or an input; raises ValueError for another one, with the nearest name."""
    if name not in known:
        raise ValueError(f"parameters: given {name!r}; accepted: {_nearest(name, list(known))}")
    if getattr(known[name], "dimensions", None):
        raise ValueError(f"parameters: {name!r} is an array; accepted: scalars")
    return known[name]


def _nearest(name: str, names: list[str]) -> str:
    """The names that there are, the nearest first, few of many."""
    if not names:
        return "none, the FMU has no such variables"
    near = nearest(name, names)
    listed = sorted(names, key=lambda other: other != near)
    return ", ".join(listed[:8]) + (f" and {len(listed) - 8} more" if len(listed) > 8 else "")


def _check_autonomous(instance: FmuInstance) -> None:
    """Raises ValueError where the derivatives at the start change with time alone."""
    first, *later = (instance.derivatives(t, instance.start, instance.start_parameters) for t in _TIMES)
    if any(not np.array_equal(first, other, equal_nan=True) for other in later):
        raise ValueError(f"{instance.path}: the equations depend on time; accepted: with forcing_period=")
