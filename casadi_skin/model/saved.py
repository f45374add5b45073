"""Models in files: names, declarations and a list of elementary operations, in JSON with a version and a checksum.

A file is data: its contents are compared with the few things that it may hold, and no code in it runs.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Annotated, Any, Literal

import casadi as ca
import msgspec

from casadi_skin.model.arguments import check_instance, cut, file_path, in_words, new_file, short_repr
from casadi_skin.model.files import replacing
from casadi_skin.model.loading import read_source
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.operations import from_operations, to_operations
from casadi_skin.model.pickled import PLAIN_FIELDS, column, equations_of, made
from casadi_skin.model.result import in_turn

MODEL_FORMAT = "casadi_skin model 2"
ACCEPTED_MODEL_FILES = f"accepted: a file of format {MODEL_FORMAT!r}, as save_model writes it"
MOST_RESULTS = 10_000  # CasADi warns of more

Sign = Literal[1, -1]


class SavedModel(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Contents of a file of a model. Symbols are numbered in the order time, states, parameters."""

    name: str
    order: Literal[1, 2]
    states: tuple[str, ...]
    parameters: tuple[str, ...]
    forced: bool
    reversal: tuple[Sign, ...] | None
    half_period: tuple[Sign, ...] | None
    output_scale: tuple[float, ...] | None
    nominal: tuple[float, ...] | None
    operations: tuple[str, ...]
    results: Annotated[dict[str, tuple[int | None, ...]], msgspec.Meta(max_length=MOST_RESULTS)]


class SavedFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A file: the checksum is that of the model."""

    format: str
    sha256: str
    model: SavedModel


class Header(msgspec.Struct, frozen=True):
    """The mark of files of any format."""

    format: str


@in_turn
def save_model(model: OdeModel, path: str | Path) -> Path:
    """Write a model to a file, from which `read_model` makes it again without the script that made it.

    The file holds names, declarations and elementary operations, and so do the equations of a model in MX, which is
    read as one in SX.

    Arguments:
        model: A model in CasADi expressions.
        path: The file, JSON text in UTF-8; an existing one is replaced.

    Returns:
        The path.

    Raises:
        ValueError: The model's equations are not made of elementary operations alone, but of a program as in an FMU, of
            tables, or of solutions of other equations; the path is a directory, or in none.
        TypeError: An argument is of another kind.
        OSError: The file cannot be written.
    """
    check_instance("model", model, OdeModel)
    target, text = new_file("path", path), dumps(model)
    with replacing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return target


def dumps(model: OdeModel) -> str:
    """A model as JSON text; raises ValueError as `save_model`."""
    labels, function = equations_of(model)
    try:
        operations, entries = to_operations(function)
    except ValueError as error:
        raise ValueError(f"{model.name}: cannot be saved: its equations {error}") from error
    declared = {key: getattr(model, key) for key in PLAIN_FIELDS}
    declared |= {"states": model.state_names, "parameters": model.parameter_names, "forced": model.forced}
    declared |= {"operations": operations, "results": dict(zip(labels, entries, strict=True))}
    plain = msgspec.to_builtins(msgspec.convert(declared, SavedModel))
    return json.dumps({"format": MODEL_FORMAT, "sha256": checksum(plain), "model": plain}, indent=0) + "\n"


def checksum(model: dict[str, Any]) -> str:
    """SHA-256 of a model's entry in a file, of its JSON text without spaces and with sorted keys."""
    text = json.dumps(model, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


@in_turn
def read_model(path: str | Path) -> OdeModel:
    """The model in a file that `save_model` wrote.

    Arguments:
        path: The file.

    Returns:
        The model, with fresh symbols of the same names.

    Raises:
        ValueError: The file cannot be read, holds no such model, or is damaged; in one line.
        TypeError: The argument is not a path.
    """
    source = file_path("path", path)
    return loads(read_source(source), str(source))


def loads(text: str, path: str = "text") -> OdeModel:
    """The model in text made by `dumps`, which is from `path`; raises ValueError as `read_model`."""
    try:
        return _model_of(_checked(text))
    except (ValueError, TypeError, RecursionError) as error:  # msgspec's and json's errors are ValueErrors
        reason = cut(in_words(error), 200)
        reason = reason if "accepted: " in reason else f"{reason}; {ACCEPTED_MODEL_FILES}"
        raise ValueError(f"{path}: not a model saved by casadi_skin: {reason}") from error


def _checked(text: str) -> SavedModel:
    """The contents of a file that is complete, has each entry once and has the checksum of its contents."""
    found = msgspec.json.decode(text, type=Header).format
    if found != MODEL_FORMAT:
        raise ValueError(f"format {short_repr(found)}; {ACCEPTED_MODEL_FILES}")
    saved = msgspec.json.decode(text, type=SavedFile)
    known = checksum(json.loads(text, object_pairs_hook=_each_once)["model"])
    if known != saved.sha256:
        raise ValueError(f"damaged: its checksum is {cut(short_repr(saved.sha256), 12)}, not {known[:8]}...")
    return saved.model


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key is in it twice")
    return found


def _model_of(saved: SavedModel) -> OdeModel:
    time, states, parameters = ([ca.SX.sym(n) for n in names] for names in (("t",), saved.states, saved.parameters))
    expressions = from_operations([*time, *states, *parameters], saved.operations, list(saved.results.values()))
    declared = {key: getattr(saved, key) for key in PLAIN_FIELDS}
    results = dict(zip(saved.results, expressions, strict=True))
    return made(OdeModel, declared, results, (time[0], column(states), column(parameters)), saved.forced)
