"""Models in files: CasADi's serialised functions with names and declarations around them, in JSON."""

from __future__ import annotations

import copyreg
import json
from pathlib import Path
from typing import Any

import casadi as ca

from casadi_skin.files import replacing
from casadi_skin.models.expressions import Expression
from casadi_skin.models.ode import OdeModel

Symbols = tuple[Expression, Expression, Expression | None, Expression]
FORMAT = "casadi_skin model 1"
PROGRAMS = ("CallbackInternal", "GenericExternal", "External")  # CasADi's classes of functions that are not symbolic
PLAIN = ("name", "order", "reversal", "half_period", "output_scale", "nominal")
OPTIONAL = ("normalisation", "hamiltonian")


def save_model(model: OdeModel, path: str | Path) -> Path:
    """Write a model to a file, from which `read_model` makes it again without the script that made it.

    Arguments:
        model: A model in CasADi expressions.
        path: The file, JSON text in UTF-8; one that is there is replaced.

    Returns:
        The path.

    Raises:
        ValueError: The model's equations are those of a program, as of an FMU, and no expressions.
        OSError: The file cannot be written.
    """
    text = dumps(model)
    with replacing(Path(path)) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(path)


def dumps(model: OdeModel) -> str:
    """A model as JSON text; raises ValueError where its equations are those of a program, as of an FMU."""
    expressions = {"rhs": model.rhs} | {k: v for k in OPTIONAL if (v := getattr(model, k)) is not None}
    expressions |= {f"output {name}": output for name, output in model.outputs.items()}
    if model.forcing_period is not None:
        expressions["forcing_period"] = type(model.state)(model.forcing_period)
    function = model.function("model", *expressions.values())
    programs = programs_in(function)
    if programs:  # CasADi writes their names alone
        raise ValueError(f"{model.name}: cannot be saved: its equations are those of a program, {', '.join(programs)}")
    equations = function.serialize()
    declared: dict[str, Any] = {key: getattr(model, key) for key in PLAIN}
    kind = "MX" if isinstance(model.state, ca.MX) else "SX"
    declared |= {"state_labels": model.state_names, "parameter_labels": model.parameter_names}
    declared |= {"format": FORMAT, "kind": kind, "forced": model.forced, "results": list(expressions)}
    return json.dumps(declared | {"equations": equations}, indent=1)


def programs_in(function: ca.Function) -> list[str]:
    """Names of the functions inside that are programs, as those of an FMU, and no expressions."""
    return [inner.name() for inner in function.find_functions() if inner.class_name() in PROGRAMS]


def read_model(path: str | Path) -> OdeModel:
    """The model in a file that `save_model` wrote.

    Arguments:
        path: The file.

    Returns:
        The model, with fresh symbols of the same names.

    Raises:
        ValueError: The file cannot be read, holds no such model, or is damaged; in one line.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as a saved model: {error}") from error
    return loads(text, str(path))


def loads(text: str, path: str = "text") -> OdeModel:
    """The model in text made by `dumps`, which is from `path`; raises ValueError as `read_model`."""
    refused = f"{path}: not a model saved by casadi_skin"
    try:
        given = json.loads(text)
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}: cannot be read as a saved model: {error}") from error
    if not isinstance(given, dict) or given.get("format") != FORMAT:
        raise ValueError(f"{refused}; accepted: a file with format {FORMAT!r}")
    try:
        function = ca.Function.deserialize(given["equations"])
        symbols = _symbols(given)
        if not isinstance(given["name"], str):
            raise TypeError("a name that is no string")
        results = dict(zip(given["results"], _results(function, symbols), strict=True))
    except (KeyError, RuntimeError, TypeError, ValueError) as error:
        raise ValueError(f"{refused}: its equations are damaged") from error
    time, state, velocity, parameters = symbols
    keys = (*PLAIN, "state_labels", "parameter_labels")
    plain: dict[str, Any] = {key: tuple(value) if isinstance(value := given.get(key), list) else value for key in keys}
    outputs = {k.removeprefix("output "): v for k, v in results.items() if k.startswith("output ")}
    rest = {k: v for k, v in results.items() if not k.startswith("output ")}
    symbolic = {"state": state, "velocity": velocity, "parameters": parameters}
    return OdeModel(**plain, **symbolic, **rest, outputs=outputs, time=time if given["forced"] else None)


def _symbols(given: dict[str, Any]) -> Symbols:
    """Time, state, velocity and parameters as fresh symbols with the names that the model had."""
    names, parameter_names = given["state_labels"], given["parameter_labels"]
    if given["kind"] == "MX":
        x, p = ca.MX.sym("x", len(names)), ca.MX.sym("p", len(parameter_names))
        return ca.MX.sym("t"), x, None, p
    full = ca.vertcat(*map(ca.SX.sym, names))
    parameters = ca.vertcat(*map(ca.SX.sym, parameter_names)) if parameter_names else ca.SX(0, 1)
    if given["order"] == 1:
        return ca.SX.sym("t"), full, None, parameters
    n = len(names) // 2
    return ca.SX.sym("t"), full[:n], full[n:], parameters


def _results(function: ca.Function, symbols: Symbols) -> tuple[Expression, ...]:
    time, state, velocity, parameters = symbols
    full = state if velocity is None else ca.vertcat(state, velocity)
    return tuple(function.call([time, full, parameters], True, False))


def _reduced(model: OdeModel) -> tuple[Any, ...]:
    """What pickle keeps of a model; raises ValueError where it cannot be saved."""
    return loads, (dumps(model),)


copyreg.pickle(OdeModel, _reduced)
