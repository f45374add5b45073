"""A model made of an FMU that is unpacked: the right-hand side and its derivatives are those of its binary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeAlias
from xml.etree import ElementTree as ET

import casadi as ca
import numpy as np

from casadi_skin.fmu.fmu_archive import DESCRIPTION, Unpacked
from casadi_skin.fmu.fmu_derivatives import STEP, Derivatives
from casadi_skin.fmu.fmu_function import FmuFunction
from casadi_skin.fmu.fmu_instance import FmuInstance
from casadi_skin.fmu.fmu_variables import FmuChoices, Variables
from casadi_skin.model.expressions import expression_of
from casadi_skin.model.ode import OdeModel

Signal: TypeAlias = float | Callable[[Any], Any]
_TIMES = (0.0, 0.37, 1.9)  # where the equations must be the same unless the model is forced
PERIODIC = 1e-9  # of a signal's size, between times that are a period apart


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
    offered = _offers_derivatives(instance)

    functions = [FmuFunction("fmu_derivatives", Derivatives(instance, None, offered), forced)]
    shown = variables.outputs
    if shown:
        functions.append(FmuFunction("fmu_outputs", Derivatives(instance, shown, offered), forced))
    back = np.argsort(variables.order).tolist()
    given = ca.vertcat(p, *inputs) if inputs else p
    results = [call(t if forced else 0.0, x[back], given) for call in functions]
    return FmuModel(
        name=str(variables.description.modelName),
        state=x,
        rhs=results[0][variables.order],
        parameters=p,
        time=t if forced else None,
        forcing_period=choices.forcing_period,
        outputs={element.name: results[1][i] for i, element in enumerate(shown)},
        nominal=tuple(float(v) for v in instance.start_given[:count]),
        state_labels=tuple(variables.states[i].name for i in variables.order),
        parameter_labels=choices.parameters,
        checked=False,
        start_state=tuple(float(instance.start[i]) for i in variables.order),
        instance=instance,
        functions=tuple(functions),
        signals=ca.Function("signals", [t], [ca.vertcat(*inputs) if inputs else ca.MX(0, 1)]),
    )


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
    now, later = (np.array([float(ca.Function("u", [t], [expression])(s + at)) for at in _TIMES]) for s in (0, period))
    if not np.allclose(now, later, rtol=PERIODIC, atol=PERIODIC * max(1.0, float(np.abs(now).max()))):
        raise ValueError(f"inputs, {name}: given a signal that has not the period {period:g}; accepted: one that has")
    return expression


def _offers_derivatives(instance: FmuInstance) -> bool:
    """Whether the FMU says so; fmpy does not keep that flag of FMI 3.0."""
    exchange = ET.parse(instance.folder / DESCRIPTION).getroot().find("ModelExchange")
    flags = ("providesDirectionalDerivatives", "providesDirectionalDerivative")
    return exchange is not None and any(exchange.get(flag) in ("true", "1") for flag in flags)


def _check_autonomous(instance: FmuInstance, inputs: list[float]) -> None:
    """Raises ValueError where the derivatives at the start change with time alone."""
    given = np.concatenate([instance.start_given[: instance.start_given.size - len(inputs)], inputs])
    rows = np.ones((len(_TIMES), 1))
    values = instance.at(None, _TIMES, rows * instance.start, rows * given)
    if not np.array_equal(values, rows * values[0], equal_nan=True):
        raise ValueError(f"{instance.path}: the equations depend on time; accepted: with forcing_period=")
