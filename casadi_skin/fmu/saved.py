"""Models of FMUs in files of results: the identity of the FMU and the choices of its import; never its binary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.fmu.fmu_model import FmuModel
from casadi_skin.model.arguments import short_repr

SAMPLES = 8  # times in a period at which signals are compared


class OtherModelError(ValueError):
    """The model that a reader was given is not that of the file."""


def identity(model: FmuModel) -> dict[str, Any]:
    """The identity of an FMU's model: its token, a hash of its files, and the choices of its import."""
    variables = model.instance.variables
    choices, description = variables.choices, variables.description
    token = description.guid if str(description.fmiVersion).startswith("2") else description.instantiationToken
    times = [k / SAMPLES * (choices.forcing_period or 0.0) for k in range(SAMPLES)]
    signals = np.array([np.array(model.signals(t)).ravel() for t in times])
    return {
        "name": model.name,
        "token": str(token),
        "hash": model.instance.digest,
        "states": list(model.state_names),
        "parameters": list(model.parameter_names),
        "inputs": list(choices.inputs),
        "signals": signals.ravel().tolist(),
        "forcing_period": choices.forcing_period,
        "derivatives": [model.derivatives, model.parameter_derivatives],
    }


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
