"""An imported FMU as an `OdeModel`: the right-hand side and its derivatives are those of its binary.

FMI 2.0 and 3.0, Model Exchange without events (https://fmi-standard.org). The equations are functions of a program, not
expressions: everything that needs no more than their values and first derivatives takes them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import casadi as ca

from casadi_skin.fmu.fmu_archive import unpack
from casadi_skin.fmu.fmu_model import FmuModel, Signal, made, signal_at
from casadi_skin.fmu.fmu_trial import check_answer
from casadi_skin.fmu.fmu_variables import FmuChoices, Variables
from casadi_skin.model.arguments import by_name, file_path, number, short_repr

TIME_LIMIT = 60.0  # seconds


def import_fmu(
    path: str | Path,
    *,
    states: Sequence[str] | None = None,
    parameters: Sequence[str] = (),
    inputs: Mapping[str, Signal] | None = None,
    forcing_period: float | None = None,
    time_limit: float = TIME_LIMIT,
) -> FmuModel:
    """The model in an FMU (FMI 2.0 or 3.0, Model Exchange without events), through its binary for this platform.

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
    if forcing_period is not None and number("forcing_period", forcing_period) <= 0:
        raise ValueError(f"forcing_period: given {forcing_period!r}; accepted: a number > 0")
    if number("time_limit", time_limit) <= 0:
        raise ValueError(f"time_limit: given {time_limit!r}; accepted: seconds > 0")
    for label, names in (("states", states), ("parameters", parameters)):
        given = () if names is None and label == "states" else names
        if not isinstance(given, list | tuple) or not all(isinstance(name, str) for name in given):
            raise ValueError(f"{label}: given {short_repr(names)}; accepted: a list of names")
    signals = by_name("inputs", inputs, "a number or a function f(t)")
    t = ca.MX.sym("t")
    first = [signal_at(name, signal, t, forcing_period) for name, signal in signals.items()]
    at_start = {name: float(ca.Function("u", [t], [u])(0.0)) for name, u in zip(signals, first, strict=True)}
    order = None if states is None else tuple(states)
    choices = FmuChoices(order, tuple(parameters), tuple(signals), forcing_period)
    unpacked = unpack(file_path("path", path))
    try:
        Variables(unpacked.path, unpacked.description, choices)  # names first: they run nothing
        check_answer(unpacked, choices, at_start, time_limit)
        return made(unpacked, choices, signals)
    except BaseException:
        unpacked.remove()
        raise
