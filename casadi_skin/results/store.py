"""Values as data: numbers, names, arrays and the fields of known classes; nothing in them is run when they are read.

A value is written as a type of MessagePack, or as a list that begins with a word: ["array", type, shape, bytes],
["complex", real, imaginary], ["tuple", ...], ["map", {...}], ["enum", class, member], ["object", class, fields],
["point", resolution, constants, fields], and ["shared", number] for what stands in the list of models and spaces, each
of which is written once. Results are saved so (`saving`), and journals keep points, multipliers and outcomes.

The journal of a run: results, appended to one file and flushed to disk at once.

A record is a tagged struct of msgspec behind a header with a mark, the format, its length and a checksum of all of it:
a record that is cut off or damaged ends what is read, and what follows it is written again.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import singledispatch
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, Self, TypeVar
from weakref import finalize

import msgspec
import numpy as np

from casadi_skin.model.arguments import short_repr
from casadi_skin.model.files import opened_in_place
from casadi_skin.zero.settings import Point, Refinement

DAMAGED_FILE_ERRORS = (
    ValueError, TypeError, LookupError, AttributeError, ArithmeticError, AssertionError, RuntimeError,
)  # fmt: skip
ARRAY_KINDS = {"<f8", "<c16", "<i8", "|b1"}  # of arrays
SAVED_CLASSES = {  # that a file may name, by module: "other=own" where the name in files is another one
    "certify.certificate": "Certificate Constants ProvedStability ProvedStretch",
    "dynamics.evolution": "Cycle Evolution",
    "dynamics.starts": "Spreading",
    "fmu.map_orbit": "MapOrbit",
    "follow.boundary_space": "BoundarySpace",
    "follow.branch": "Branch",
    "follow.events": "StabilityChange",
    "follow.family_series": "FamilySeries",
    "follow.rest_space": "CurveSpace EquilibriumSpace",
    "follow.search": "Monitor",
    "follow.solution": "Equilibrium Optimum Orbit Solution",
    "follow.special_points": "SpecialPoint",
    "lattice.chain": "Chain",
    "lattice.declaration": "Bond Declaration Site Uniform",
    "lattice.linear": "Bands LatticeModes",
    "lattice.lattice": "LongLattice",
    "model.conserved": "SymmetryClass",
    "search.cosine_orbit": "CosineOrbit",
    "search.design": "Design Ending",
    "search.fit": "Fit",
    "search.kick": "SmallestKick",
    "search.kick_nlp": "KickOptimum",
    "search.pareto": "ParetoFront",
    "points.curves": "OrbitCurveSpace",
    "points.diagram": "Diagram",
    "points.edges": "EdgeCurve EdgePoint",
    "points.gradient": "Gradient",
    "stability.growth": "TransientGrowth",
    "stability.result": "ContinuousSpectrum CutTail Floquet",
    "stability.tongues.diagram": "Passage Place StabilityDiagram StabilityEdge StableWindow Tongue",
    "stability.tongues.interpolation": "MatrixSeries Piece",
    "zero.augmented": "Singularity",
    "zero.kinds": "Unresolved",
    "zero.orbit": "Periodic Sizes",
    "zero.problem": "Scalar",
    "zero.family": "FamilyRequest Method Targets",
    "zero.settings": "ContinuationSettings End ErrorEstimate Target",
    "zero.rest": "Course Spectrum Statics",
}
NAMES_IN_FILES = {  # in files, by module and own name
    (f"casadi_skin.{module}", word.rpartition("=")[2]): word.partition("=")[0]
    for module, words in SAVED_CLASSES.items()
    for word in words.split()
}
PLACES_OF_NAMES = {name: place for place, name in NAMES_IN_FILES.items()}


class SavedResult(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A result as data, and the models and spaces in it."""

    format: str
    version: str
    shared: list[Any]
    result: Any


# Values as data -------------------------------------------------------------------------------------------------------


class Writer:
    """Makes data of values; `once` makes those of models and spaces, which `shared` holds, and None of all others."""

    def __init__(self, once: Callable[[Any, Writer], Any] = lambda *_: None) -> None:
        self.shared, self._once = list[Any](), once
        self._kept: dict[int, tuple[int, Any]] = {}  # with the object, so that no other gets its id

    def value(self, value: Any) -> Any:
        """A value as data; raises ValueError for objects that a file cannot hold."""
        if id(value) in self._kept:
            return ["shared", self._kept[id(value)][0]]
        data = self._once(value, self)
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
    return ["object", name_of(value), writer.named_fields(value)]


@written.register(type(None))
@written.register(str)
@written.register(int)
@written.register(float)
def _plain(value: Any, _: Writer) -> Any:
    return value


@written.register
def _(value: np.ndarray, _: Writer) -> Any:
    array = np.ascontiguousarray(value)
    if array.dtype.str not in ARRAY_KINDS:
        raise _stranger(value)
    return ["array", array.dtype.str, list(value.shape), array.tobytes()]


@written.register(Mapping)
def _(value: Any, writer: Writer) -> Any:
    if is_dataclass(value):  # a result that is a mapping too
        return written.dispatch(object)(value, writer)
    return ["map", {str(name): writer.value(v) for name, v in value.items()}]


@written.register
def _(value: Point, writer: Writer) -> Any:
    return ["point", *_problem_of(value, writer), writer.named_fields(value, "problem")]


def _problem_of(value: Point | Refinement, writer: Writer) -> tuple[int, Any]:
    return value.problem.resolution, writer.value(value.problem.constants)


written.register(np.generic, lambda value, writer: writer.value(value.item()))
written.register(complex, lambda value, _: ["complex", value.real, value.imag])
written.register(Enum, lambda value, _: ["enum", name_of(value), value.name])
written.register(tuple, lambda value, writer: ["tuple", *map(writer.value, value)])
written.register(list, lambda value, writer: ["list", *map(writer.value, value)])
written.register(Refinement, lambda value, writer: ["refinement", *_problem_of(value, writer), writer.value(value.z)])


def name_of(value: object) -> str:
    """The name of its class in a file; raises ValueError for a class that may not stand there."""
    kind = type(value)
    if (kind.__module__, kind.__name__) not in NAMES_IN_FILES:
        raise _stranger(value)
    return NAMES_IN_FILES[kind.__module__, kind.__name__]


def _stranger(value: object) -> ValueError:
    what = f"what holds {short_repr(value)} ({type(value).__name__})"
    return ValueError(f"result: given {what}; accepted: results of this package, of models in expressions")


class Reader:
    """Makes values of data, with models and spaces of those of `Writer.shared`; `model` is that of an FMU.

    `words` are further words at the begin of data: each a function of a reader, the space of points, and the rest.
    """

    def __init__(
        self, shared: Sequence[Any] = (), model: Any = None, words: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        self.model, self.shared, self._words = model, list[Any](), {**READERS, **words}
        for data in shared:
            self.shared.append(self.value(data))

    def value(self, data: Any, space: Any = None) -> Any:
        """A value of data, points among it those of a space; raises one of `DAMAGED` for other data."""
        if not isinstance(data, list):
            if not (data is None or isinstance(data, bool | str | int | float)):
                raise ValueError(f"a value {short_repr(data)}")
            return data
        word, *rest = data
        if not isinstance(word, str) or word not in self._words:
            raise ValueError(f"a value of kind {short_repr(word)}")
        return self._words[word](self, space, *rest)

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


def class_named(name: object) -> Any:
    """The class of a name in a file; raises ValueError for any other."""
    if not isinstance(name, str) or name not in PLACES_OF_NAMES:
        raise ValueError(f"a thing of kind {short_repr(name)}, which no result holds")
    module, own = PLACES_OF_NAMES[name]
    return getattr(import_module(module), own)


def _array(_: Reader, __: Any, kind: str, shape: Sequence[int], data: bytes) -> np.ndarray[Any, Any]:
    if kind not in ARRAY_KINDS:
        raise ValueError(f"an array of {short_repr(kind)}")
    return np.frombuffer(data, kind).reshape(shape).copy()


def _object(reader: Reader, space: Any, name: str, data: Mapping[str, Any]) -> Any:
    inner = reader.value(data["space"]) if "space" in data else space
    return class_named(name)(**reader.named(data, inner))


def _point(reader: Reader, space: Any, resolution: int, constants: Any, data: Mapping[str, Any]) -> Point:
    return Point(problem=reader.problem(space, resolution, constants), **reader.named(data, space))


def _one_shared(reader: Reader, _: Any, place: int) -> Any:
    if not 0 <= place < len(reader.shared):
        raise ValueError(f"a reference to {short_repr(place)}, of {len(reader.shared)}")
    return reader.shared[place]


READERS: Mapping[str, Callable[..., Any]] = {  # what each word begins, from a reader, the space of points, and the rest
    "array": _array,
    "complex": lambda _, __, real, imaginary: complex(real, imaginary),
    "enum": lambda _, __, name, member: class_named(name)[member],
    "list": lambda reader, space, *items: [reader.value(item, space) for item in items],
    "map": lambda reader, space, items: reader.named(items, space),
    "object": _object,
    "point": _point,
    "refinement": lambda reader, space, r, constants, z: Refinement(
        reader.problem(space, r, constants), reader.value(z)
    ),
    "shared": _one_shared,
    "tuple": lambda reader, space, *items: tuple(reader.value(item, space) for item in items),
}


# The journal of a run: results, appended to one file and flushed to disk at once --------------------------------------

MARK, FORMAT = b"cskj", 6
# Mark, format, length of what follows, CRC-32 of the record before, or 0, and CRC-32 of these and of what follows.
RECORD_HEADER = struct.Struct("<4sIIII")
Record = TypeVar("Record")
Data = bytes | mmap.mmap


class Journal(Generic[Record]):
    """An open journal, made where there is none; use as a context manager.

    Attributes:
        path: its file.
        records: those in it when it is opened; none where `each` is called with them, and their places, instead.
        end: its length in bytes.
        fault: why its tail was dropped then, in words; empty where it was whole.
    """

    def __init__(
        self, path: Path, decoder: msgspec.msgpack.Decoder[Record], each: Callable[[int, Record], None] | None = None
    ) -> None:
        self.path, self._encoder, self.records = path, msgspec.msgpack.Encoder(), list[Record]()
        self._last = 0

        def keep(place: int, record: Record) -> None:
            self._last = checksum(data, place)
            if each is None:
                self.records.append(record)
            else:
                each(place, record)

        with mapped(path) as data:
            self.end, self.fault = scan(data, decoder, keep)
        self._file = os.fdopen(opened_in_place(path), "r+b", buffering=0)
        self._close = finalize(self, self._file.close)  # also where an interruption comes before __exit__ closes it
        self._file.truncate(self.end)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._close()

    def append(self, record: msgspec.Struct) -> None:
        """Write one record and wait until it is on the disk; raises OSError, with the journal as it was."""
        payload = self._encoder.encode(record)
        data = framed(payload, self._last)
        self._file.seek(self.end)
        try:
            written = 0
            while written < len(data):
                written += self._file.write(data[written:]) or 0
            os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(self.end)
            raise
        self.end, self._last = self.end + len(data), checksum(data)


def framed(payload: bytes, before: int = 0) -> bytes:
    """A record behind its header, which follows one with the checksum `before`."""
    return _header(payload, before) + payload


def checksum(data: Data, place: int = 0) -> int:
    """That of the record at a place."""
    return int(RECORD_HEADER.unpack_from(data, place)[-1])


def _header(payload: bytes, before: int) -> bytes:
    fields = MARK, FORMAT, len(payload), before
    return RECORD_HEADER.pack(*fields, zlib.crc32(payload, zlib.crc32(RECORD_HEADER.pack(*fields, 0))))


@contextmanager
def mapped(path: Path) -> Iterator[Data]:
    """The bytes of a file, read as they are looked at; none where there is no file."""
    if not path.exists() or path.stat().st_size == 0:
        yield b""
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        yield data


def read_records(data: Data, decoder: msgspec.msgpack.Decoder[Record]) -> tuple[list[Record], int, str]:
    """The records of a journal up to the first that is not whole, the length of these, and the fault of the next.

    The last is empty where all of `data` is records of this format.
    """
    records = list[Record]()
    return records, *scan(data, decoder, lambda _, record: records.append(record))


def scan(
    data: Data, decoder: msgspec.msgpack.Decoder[Record], each: Callable[[int, Record], None], start: int = 0
) -> tuple[int, str]:
    """Call `each` with place and record of every record from a place on, up to the first that is not whole.

    A record that does not follow the one before it ends them, too, before that one: which was changed is not known.
    Returns the place where they end, and the fault there; empty where the data end.
    """
    place, fault, held = start, "", list[tuple[int, Record]]()
    while place < len(data):
        try:
            record, length = record_at(data, place, decoder)
        except ValueError as error:
            fault = f"{error} at byte {place}"
            break
        before = checksum(data, held[0][0]) if held else 0
        if (held or not start) and RECORD_HEADER.unpack_from(data, place)[-2] != before:
            place = held.pop()[0] if held else place
            fault = f"a record that is not the one before the next at byte {place}"
            break
        for one in held:
            each(*one)
        held, place = [(place, record)], place + length
    for one in held:
        each(*one)
    return place, fault


def record_at(data: Data, place: int, decoder: msgspec.msgpack.Decoder[Record]) -> tuple[Record, int]:
    """The record at a place and its length in bytes; raises ValueError, in words, where there is none."""
    if len(data) - place < RECORD_HEADER.size:
        raise ValueError("a record that is cut off")
    mark, version, length, before, _ = RECORD_HEADER.unpack_from(data, place)
    if mark != MARK:
        raise ValueError("no record of a journal")
    if version != FORMAT:
        raise ValueError(f"a record of format {version}, where {FORMAT} is read,")
    payload = data[place + RECORD_HEADER.size : place + RECORD_HEADER.size + length]
    if len(payload) < length:
        raise ValueError("a record that is cut off")
    if data[place : place + RECORD_HEADER.size] != _header(payload, before):
        raise ValueError("a damaged record")
    try:
        return decoder.decode(payload), RECORD_HEADER.size + length
    except msgspec.DecodeError as error:
        raise ValueError("a record of another version") from error
