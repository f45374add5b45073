"""Results as data in a file with a checksum, read back bit for bit, to be continued; nothing in it is run when read.

A value is written as a type of MessagePack, or as a list that begins with a word: ["array", type, shape, bytes],
["complex", real, imaginary], ["tuple", ...], ["map", {...}], ["enum", class, member], ["object", class, fields],
["point", resolution, constants, fields], and ["shared", number] for what stands in the list of models and spaces, each
of which is written once. Journals of runs keep their points, multipliers and outcomes in the same way.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import singledispatch
from importlib import import_module
from pathlib import Path
from typing import Any

import casadi as ca
import msgspec
import numpy as np

from casadi_skin._version import __version__
from casadi_skin.fmu.model import FmuModel, OtherModelError, at_symbols, checked, identity, noises
from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.family import Family
from casadi_skin.follow.rest_space import EquilibriumSpace
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.long_lattice import LongLattice
from casadi_skin.lattice.motion import EquationsOfMotion, equations_of_motion
from casadi_skin.model.arguments import cut, file_path, short_repr
from casadi_skin.model.files import replacing
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.operations import from_operations, to_operations
from casadi_skin.model.pickled import programs_in
from casadi_skin.model.saved import dumps, loads
from casadi_skin.results.journal import framed, read_records
from casadi_skin.zero.orbit import Extended, extended
from casadi_skin.zero.settings import Point, Refinement
from casadi_skin.zero.statement import Statement

FORMAT = "casadi_skin result 2"
ACCEPTED = "accepted: a file that save_result wrote"
DAMAGED = (ValueError, TypeError, KeyError, IndexError, AttributeError, ArithmeticError, AssertionError, RuntimeError,
           RecursionError)  # fmt: skip
KINDS = {"<f8", "<c16", "<i8", "|b1"}  # of arrays
CLASSES = {  # that a file may name, by module: "other=own" where the name in files is another one
    "certify.certificate": "Certificate Constants ProvedStability ProvedStretch",
    "dynamics.evolution": "Cycle Evolution",
    "dynamics.starts": "Spreading",
    "follow.boundary_space": "BoundarySpace",
    "follow.branch": "Branch",
    "follow.ledger": "StabilityChange",
    "follow.orbit": "Orbit",
    "follow.rest_curve": "CurveSpace",
    "follow.rest_space": "EquilibriumSpace",
    "follow.solution": "Equilibrium Optimality Optimum Solution",
    "follow.special_points": "SpecialPoint",
    "lattice.chain": "Chain",
    "lattice.declaration": "Bond Declaration Site Uniform",
    "lattice.linear": "Bands LatticeModes",
    "lattice.long_lattice": "LongLattice",
    "model.conserved": "SymmetryClass",
    "optimise.families": "ChainFamily ModelFamily",
    "optimise.family_search": "FamilySearch",
    "optimise.kick": "SmallestKick",
    "optimise.kick_nlp": "KickOptimum",
    "optimise.nlp": "Kkt NlpSolution=Solution",
    "optimise.optimum": "CosineOrbit PlainCheck SearchOptimum=Optimum",
    "optimise.orbit_search": "OrbitSearch",
    "optimise.search": "SearchResult SearchStatus",
    "optimise.search_arguments": "Condition",
    "optimise.search_orbit": "ParetoFront",
    "optimise.search_problem": "Ending Outcome Start",
    "points.curves": "OrbitCurveSpace",
    "points.diagram": "Diagram",
    "points.edge_curve": "EdgeCurve EdgePoint",
    "stability.growth": "TransientGrowth",
    "stability.localised": "LocalisedFloquet",
    "stability.result": "ContinuousSpectrum FullPeriodFloquet ReversibleFloquet",
    "stability.tongues.diagram": "LocalisedChange LocalisedDiagram Passage Place StabilityDiagram StabilityEdge "
    "StableWindow Tongue",
    "stability.tongues.interpolation": "MatrixSeries Piece",
    "zero.augmented": "Critical",
    "zero.family": "Method Targets",
    "zero.orbit": "Periodic Sizes",
    "zero.problem": "Scalar",
    "zero.request": "FamilyRequest",
    "zero.rest_problem": "Course",
    "zero.settings": "ContinuationSettings End ErrorEstimate Target",
    "zero.statics": "Spectrum Statics",
    "zero.unresolved": "Unresolved",
}
NAMES = {  # in files, by module and own name
    (f"casadi_skin.{module}", word.rpartition("=")[2]): word.partition("=")[0]
    for module, words in CLASSES.items()
    for word in words.split()
}
PLACES = {name: place for place, name in NAMES.items()}


class SavedResult(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Contents of a file."""

    format: str
    version: str
    shared: list[Any]
    result: Any


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
    target = file_path("path", path)
    if target.is_dir():
        raise ValueError(f"path: given {target}, which is a directory; accepted: the path of a file")
    if not target.parent.is_dir():
        raise ValueError(f"path: given {target}, in no directory; accepted: a file in a directory that is there")
    payload = msgspec.msgpack.encode(saved(result))
    with replacing(target) as temporary:
        temporary.write_bytes(framed(payload))
    return target


def saved(result: Any) -> SavedResult:
    """A result as data; raises ValueError as `save_result` does."""
    writer = Writer()
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
    return Reader(data.shared, model).value(data.result)


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
        records, _, fault = read_records(source.read_bytes(), msgspec.msgpack.Decoder(SavedResult))
        if fault or len(records) != 1:
            raise ValueError(fault or f"{len(records)} records")
        return restored(records[0], model)
    except OtherModelError as error:
        raise ValueError(f"{source}: {error}") from None
    except OSError as error:
        raise ValueError(f"{source}: cannot be read: {error.strerror}; {ACCEPTED}") from None
    except DAMAGED as error:
        reason = cut(" ".join(str(error).split()) or type(error).__name__, 200)
        raise ValueError(f"{source}: not a result saved by casadi_skin: {reason}; {ACCEPTED}") from error


# Values as data -------------------------------------------------------------------------------------------------------


class Writer:
    """Makes data of values; `shared` holds those of models and spaces, each made once."""

    def __init__(self) -> None:
        self.shared: list[Any] = []
        self._kept: dict[int, tuple[int, Any]] = {}  # with the object, so that no other gets its id

    def value(self, value: Any) -> Any:
        """A value as data; raises ValueError for objects that a file cannot hold."""
        if id(value) in self._kept:
            return ["shared", self._kept[id(value)][0]]
        data = written_once(value, self)
        if data is None:
            return written(value, self)
        self.shared.append(data)
        self._kept[id(value)] = len(self.shared) - 1, value
        return ["shared", len(self.shared) - 1]

    def named_fields(self, value: Any, *without: str) -> dict[str, Any]:
        """Fields by name, those that every object of the class makes itself left out."""
        names = [field.name for field in fields(value) if field.init and field.name not in without]
        return {name: self.value(_known_now(value, name)) for name in names}


def _known_now(value: Any, name: str) -> Any:
    """A field; of an orbit the stability too that was computed since."""
    found = getattr(value, name)
    return vars(value).get("_floquet") if name == "known_floquet" and found is None else found


@singledispatch
def written(value: Any, writer: Writer) -> Any:
    """The data of a value that is no model and no space; those of all dataclasses are alike."""
    if not is_dataclass(value):
        raise _stranger(value)
    return ["object", _name_of(value), writer.named_fields(value)]


@written.register(type(None))
@written.register(str)
@written.register(int)
@written.register(float)
def _plain(value: Any, _: Writer) -> Any:
    return value


@written.register
def _(value: np.ndarray, _: Writer) -> Any:
    array = np.ascontiguousarray(value)
    if array.dtype.str not in KINDS:
        raise _stranger(value)
    return ["array", array.dtype.str, list(value.shape), array.tobytes()]


@written.register
def _(value: Point, writer: Writer) -> Any:
    return ["point", *_problem_of(value, writer), writer.named_fields(value, "problem")]


def _problem_of(value: Point | Refinement, writer: Writer) -> tuple[int, Any]:
    return value.problem.resolution, writer.value(value.problem.constants)


written.register(np.generic, lambda value, writer: writer.value(value.item()))
written.register(complex, lambda value, _: ["complex", value.real, value.imag])
written.register(Enum, lambda value, _: ["enum", _name_of(value), value.name])
written.register(tuple, lambda value, writer: ["tuple", *map(writer.value, value)])
written.register(list, lambda value, writer: ["list", *map(writer.value, value)])
written.register(Mapping, lambda value, writer: ["map", {str(name): writer.value(v) for name, v in value.items()}])
written.register(Refinement, lambda value, writer: ["refinement", *_problem_of(value, writer), writer.value(value.z)])


def _name_of(value: object) -> str:
    """The name of its class in a file; raises ValueError for a class that may not stand there."""
    kind = type(value)
    if (kind.__module__, kind.__name__) not in NAMES:
        raise _stranger(value)
    return NAMES[kind.__module__, kind.__name__]


def _stranger(value: object) -> ValueError:
    what = f"what holds {short_repr(value)} ({type(value).__name__})"
    return ValueError(f"result: given {what}; accepted: results of this package, of models in expressions")


class Reader:
    """Makes values of data, with models and spaces of those of `Writer.shared`; `model` is that of an FMU."""

    def __init__(self, shared: Sequence[Any] = (), model: Any = None) -> None:
        self.model, self.shared = model, list[Any]()
        for data in shared:
            self.shared.append(self.value(data))

    def value(self, data: Any, space: Any = None) -> Any:
        """A value of data, points among it those of a space; raises one of `DAMAGED` for other data."""
        if not isinstance(data, list):
            if not (data is None or isinstance(data, bool | str | int | float)):
                raise ValueError(f"a value {short_repr(data)}")
            return data
        word, *rest = data
        if not isinstance(word, str) or word not in READ:
            raise ValueError(f"a value of kind {short_repr(word)}")
        return READ[word](self, space, *rest)

    def named(self, data: Mapping[str, Any], space: Any = None) -> dict[str, Any]:
        """Values by name."""
        return {name: self.value(item, space) for name, item in data.items()}

    def problem(self, space: Any, resolution: int, constants: Any) -> Any:
        """The problem of a space in which a point is stated."""
        if resolution not in space.levels.resolutions:
            raise ValueError(f"a resolution {short_repr(resolution)}; accepted: {space.levels.resolutions}")
        problem = space.levels.problem(resolution)
        found = self.value(constants)
        if found.shape != problem.constants.shape:
            raise ValueError("a point of another discretisation")
        return problem.with_constants(found)


def _class_named(name: object) -> Any:
    """The class of a name in a file; raises ValueError for any other."""
    if not isinstance(name, str) or name not in PLACES:
        raise ValueError(f"a thing of kind {short_repr(name)}, which no result holds")
    module, own = PLACES[name]
    return getattr(import_module(module), own)


def _array(_: Reader, __: Any, kind: str, shape: Sequence[int], data: bytes) -> np.ndarray[Any, Any]:
    if kind not in KINDS:
        raise ValueError(f"an array of {short_repr(kind)}")
    return np.frombuffer(data, kind).reshape(shape).copy()


def _object(reader: Reader, space: Any, name: str, data: Mapping[str, Any]) -> Any:
    inner = reader.value(data["space"]) if "space" in data else space
    return _class_named(name)(**reader.named(data, inner))


def _point(reader: Reader, space: Any, resolution: int, constants: Any, data: Mapping[str, Any]) -> Point:
    return Point(problem=reader.problem(space, resolution, constants), **reader.named(data, space))


def _one_shared(reader: Reader, _: Any, place: int) -> Any:
    if not 0 <= place < len(reader.shared):
        raise ValueError(f"a reference to {short_repr(place)}, of {len(reader.shared)}")
    return reader.shared[place]


def _space(reader: Reader, _: Any, name: str, data: Mapping[str, Any], first: Any) -> Any:
    space = _class_named(name)(**reader.named(data))
    found = reader.value(first, space)
    return space if found is None else replace(space, first=found)


def _lattice(reader: Reader, _: Any, name: str, declaration: Any) -> Lattice:
    d = reader.value(declaration)
    return Lattice(d.cells, d.sites, d.bonds, d.boundary, d.parameters, name)


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
    if not value.equations.autonomous:
        return ["model", dumps(value)]
    return ["lattice", value.name, writer.value(value.declaration)]


@written_once.register
def _(value: Extended, writer: Writer) -> Any:
    if not isinstance(value.inner, FmuModel):
        return ["model", dumps(value)]
    place = value.inner.parameters.numel()
    return ["extended", writer.value(value.inner), value.nominal[place] if value.nominal else 1.0]


@written_once.register(BoundarySpace)
@written_once.register(EquilibriumSpace)
def _of_space(value: Any, writer: Writer) -> Any:
    return ["space", _name_of(value), writer.named_fields(value, "first"), writer.value(value.first)]


@written_once.register
def _(value: EquationsOfMotion, writer: Writer) -> Any:
    values = dict(value.parameters) if isinstance(value.model, OdeModel) else None
    return ["motion", writer.value(value.model), values]


@written_once.register(Chain)
@written_once.register(LongLattice)
def _of_chain(value: Any, writer: Writer) -> Any:
    return ["object", _name_of(value), writer.named_fields(value)]


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
    statement = Statement(
        model,
        tuple(parts["conditions"]),
        tuple(parts["integrals"]),
        (ends[0], ends[1]),
        **reader.named(numbers),
        objective=next(iter(parts["objective"]), None),
        running=next(iter(parts["running"]), None),
    )
    vars(statement)["_time"] = time  # the symbol that the integrals are written in
    return statement


READ: Mapping[str, Callable[..., Any]] = {  # what each word begins, from a reader, the space of points, and the rest
    "array": _array,
    "complex": lambda _, __, real, imaginary: complex(real, imaginary),
    "enum": lambda _, __, name, member: _class_named(name)[member],
    "list": lambda reader, space, *items: [reader.value(item, space) for item in items],
    "map": lambda reader, space, items: reader.named(items, space),
    "object": _object,
    "point": _point,
    "refinement": lambda reader, space, r, constants, z: Refinement(
        reader.problem(space, r, constants), reader.value(z)
    ),
    "shared": _one_shared,
    "tuple": lambda reader, space, *items: tuple(reader.value(item, space) for item in items),
    "extended": lambda reader, _, inner, nominal: extended(reader.value(inner), nominal, {}),
    "family": lambda reader, _, request: Family(reader.value(request)),
    "fmu": lambda reader, _, token, noise: checked(token, noise, reader.model),
    "lattice": _lattice,
    "model": lambda _, __, data: loads(data),
    "motion": lambda reader, _, model, values: equations_of_motion(reader.value(model), values),
    "space": _space,
    "statement": _statement,
}
