"""Results in files: saved as data with a checksum, and read back bit for bit, to be continued."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import singledispatch
from pathlib import Path
from typing import Any

import casadi as ca
import msgspec

from casadi_skin._version import __version__
from casadi_skin.dynamics.evolution import EquationsOfMotion, equations_of_motion
from casadi_skin.fmu.model import FmuModel, OtherModelError, at_symbols, checked, identity, noises
from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.family import Family
from casadi_skin.follow.rest_space import EquilibriumSpace
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.lattice import Lattice, LongLattice
from casadi_skin.model.arguments import cut, file_path, in_words, new_file, short_repr
from casadi_skin.model.files import replacing
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.operations import from_operations, to_operations
from casadi_skin.model.pickled import programs_in
from casadi_skin.model.result import in_turn
from casadi_skin.model.saved import dumps, loads
from casadi_skin.results.store import (
    DAMAGED_FILE_ERRORS,
    Reader,
    SavedResult,
    Writer,
    class_named,
    framed,
    mapped,
    name_of,
    read_records,
    written,
)
from casadi_skin.zero.orbit import Extended, extended
from casadi_skin.zero.statement import Statement

FORMAT = "casadi_skin result 4"
ACCEPTED_RESULTS = "accepted: a file that save_result wrote"


@in_turn
def save_result(result: Any, path: str | Path) -> Path:
    """Write a result to a file, from which `read_result` makes it again.

    Arguments:
        result: an orbit, an equilibrium, a solution, a branch or a special point of one, multipliers, eigenvalues, a
            certificate, a curve of edges, a time evolution, a search, or the smallest kick. A map is in its directory:
            see `read_map`. Of the model of an FMU the token, a hash and the choices of its import are written.
        path: the file; an existing one is replaced.

    Returns:
        The path.

    Raises:
        ValueError: the model of the result is a program but no FMU, or the result is of another kind; the path is a
            directory, or its directory does not exist.
        TypeError: the argument is not a path.
        OSError: the file cannot be written.
    """
    target, payload = new_file("path", path), msgspec.msgpack.encode(saved(result))
    with replacing(target) as temporary:
        temporary.write_bytes(framed(payload))
    return target


def saved(result: Any) -> SavedResult:
    """A result as data; raises ValueError as `save_result` does."""
    writer = Writer(written_once)
    try:
        data = writer.value(result)
    except RecursionError:
        data = None
    if not (isinstance(data, list) and data[0] == "object"):
        raise ValueError(f"result: given {short_repr(result)}; accepted: a result of this package")
    return SavedResult(FORMAT, __version__, writer.shared, data)


def restored(data: SavedResult, model: Any = None) -> Any:
    """The result of data, with the model of its FMU where it has one; raises one of `DAMAGED` where they are none."""
    if data.format != FORMAT:
        raise ValueError(f"format {short_repr(data.format)}")
    if model is not None and not any(isinstance(held, list) and held[:1] == ["fmu"] for held in data.shared):
        raise OtherModelError(f"model: given {short_repr(model)}; accepted: none, the model is in the file")
    return Reader(data.shared, model, MADE_OF_WORDS).value(data.result)


@in_turn
def read_result(path: str | Path, *, model: Any = None) -> Any:
    """The result in a file of `save_result`; numbers computed from it equal those of the original, bit for bit.

    Arguments:
        path: the file.
        model: of a result of an FMU, the model that `import_fmu` makes of the same file with the same choices: reading
            runs no binary.

    Returns:
        An object of the class that was saved, whose branch can be continued.

    Raises:
        ValueError: the file cannot be read, holds no result, or is damaged; the model is another one, is missing, or
            the file has its own; in one line.
        TypeError: the argument is not a path.
    """
    source = file_path("path", path)
    try:
        if not source.is_file():
            raise ValueError("no such file")
        with mapped(source) as data:  # of a file of 10 GB no more is read than its first record
            records, _, fault = read_records(data, msgspec.msgpack.Decoder(SavedResult))
        if fault or len(records) != 1:
            raise ValueError(fault or f"{len(records)} records")
        return restored(records[0], model)
    except OtherModelError as error:
        raise ValueError(f"{source}: {error}") from None
    except OSError as error:
        raise ValueError(f"{source}: cannot be read: {error.strerror}; {ACCEPTED_RESULTS}") from None
    except DAMAGED_FILE_ERRORS as error:
        reason = cut(in_words(error), 200)
        raise ValueError(f"{source}: not a result saved by casadi_skin: {reason}; {ACCEPTED_RESULTS}") from error


# Models, spaces and statements, of which a file holds each once -------------------------------------------------------


@singledispatch
def written_once(value: Any, _: Writer) -> Any:
    """The data of a model, a space or a statement; None for all others."""
    return None


@written_once.register
def _(value: OdeModel, _: Writer) -> Any:
    return ["model", dumps(value)]


@written_once.register
def _(value: Lattice, writer: Writer) -> Any:
    if not value.equations.reversible:
        return ["model", dumps(value)]
    return ["lattice", value.name, writer.value(value.declaration)]


@written_once.register
def _(value: Extended, writer: Writer) -> Any:
    if not isinstance(value.inner, FmuModel):
        return ["model", dumps(value)]
    place = value.inner.parameters.numel()
    return ["extended", writer.value(value.inner), value.nominal[place] if value.nominal else 1.0]


@written_once.register
def _(value: ca.Function, _: Writer) -> Any:
    """A function of scalars and columns, as a monitor is."""
    sizes = [value.numel_in(i) for i in range(value.n_in())]
    return ["function", value.name(), sizes, *to_operations(value)]


def _function(_: Reader, __: Any, name: str, sizes: list[int], operations: list[str], entries: Any) -> ca.Function:
    symbols = [ca.SX.sym("s", size) for size in sizes]
    columns = from_operations([s for block in symbols for s in ca.vertsplit(block)], operations, entries)
    return ca.Function(name, symbols, columns)


@written_once.register(BoundarySpace)
@written_once.register(EquilibriumSpace)
def _of_space(value: Any, writer: Writer) -> Any:
    return ["space", name_of(value), writer.named_fields(value, "first"), writer.value(value.first)]


@written_once.register
def _(value: EquationsOfMotion, writer: Writer) -> Any:
    values = {name: value.parameters[name] for name in value.model.parameter_names if name in value.parameters}
    return ["motion", writer.value(value.model), values]


written_once.register(Chain, written.dispatch(object))  # as other dataclasses
written_once.register(LongLattice, written.dispatch(object))
written_once.register(FmuModel, lambda value, _: ["fmu", identity(value), noises(value)])
written_once.register(Family, lambda value, writer: ["family", writer.value(value.request)])


@written_once.register
def _(statement: Statement, writer: Writer) -> Any:
    """Its model, its expressions as operations on ends, time, states and parameters, and its numbers."""
    model, kind = statement.model, type(statement.model.state)
    columns: dict[str, list[Any]] = {
        "conditions": [*statement.conditions],
        "integrals": [*statement.integrals],
        "interval": [kind(end) for end in statement.interval],
        "objective": [] if statement.objective is None else [statement.objective],
        "running": [] if statement.running is None else [statement.running],
    }
    symbols = [*model.ends, statement._time, model.full_state, model.parameters]
    results = [ca.vec(expression) for expressions in columns.values() for expression in expressions]
    function = ca.Function("statement", symbols, results)
    if programs_in(function):
        raise ValueError(f"{model.name}: cannot be saved: its conditions are those of a program")
    try:
        operations, entries = to_operations(function)
    except ValueError as error:
        raise ValueError(f"{model.name}: cannot be saved: its conditions {error}") from error
    counts = {name: len(expressions) for name, expressions in columns.items()}
    numbers = {name: writer.value(getattr(statement, name)) for name in ("parameters", "free", "bounds")}
    plain = [not isinstance(end, ca.SX | ca.MX) for end in statement.interval]
    return ["statement", writer.value(model), operations, entries, counts, numbers, plain]


def _statement(
    reader: Reader, _: Any, model_data: Any, operations: list[str], entries: list[list[int | None]],
    counts: dict[str, int], numbers: dict[str, Any], plain: list[bool],
) -> Statement:  # fmt: skip
    model = reader.value(model_data)
    time = type(model.state).sym("t") if model.time is None else model.time
    symbols = [*model.ends, time, model.full_state, model.parameters]
    scalars = [ca.SX.sym("s", block.numel()) if isinstance(block, ca.MX) else block for block in symbols]
    columns = from_operations([s for block in scalars for s in ca.vertsplit(block)], operations, entries)
    taken = iter(at_symbols(columns, scalars, symbols))
    parts = {name: [next(taken) for _ in range(count)] for name, count in counts.items()}
    ends: list[Any] = [float(end) if is_plain else end for end, is_plain in zip(parts["interval"], plain, strict=True)]
    conditions, integrals, interval = tuple(parts["conditions"]), tuple(parts["integrals"]), (ends[0], ends[1])
    costs: dict[str, Any] = {name: next(iter(parts[name]), None) for name in ("objective", "running")}
    statement = Statement(model, conditions, integrals, interval, **reader.named(numbers), **costs)
    vars(statement)["_time"] = time  # the symbol that the integrals are written in
    return statement


def _space(reader: Reader, _: Any, name: str, data: Mapping[str, Any], first: Any) -> Any:
    space = class_named(name)(**reader.named(data))
    found = reader.value(first, space)
    return space if found is None else replace(space, first=found)


def _lattice(reader: Reader, _: Any, name: str, declaration: Any) -> Lattice:
    d = reader.value(declaration)
    return Lattice(d.cells, d.sites, d.bonds, d.boundary, d.parameters, name)


MADE_OF_WORDS: Mapping[str, Callable[..., Any]] = {  # of the words that they begin with
    "extended": lambda reader, _, inner, nominal: extended(reader.value(inner), nominal, {}),
    "family": lambda reader, _, request: Family(reader.value(request)),
    "fmu": lambda reader, _, token, noise: checked(token, noise, reader.model),
    "function": _function,
    "lattice": _lattice,
    "model": lambda _, __, data: loads(data),
    "motion": lambda reader, _, model, values: equations_of_motion(reader.value(model), values),
    "space": _space,
    "statement": _statement,
}
