"""Results as data: numbers, names, arrays and the fields of known classes; nothing in them is run when they are read.

A value is written as a type of MessagePack, or as a list that begins with a word: ["array", type, shape, bytes],
["complex", real, imaginary], ["tuple", ...], ["map", {...}], ["enum", class, member], ["object", class, fields],
["point", resolution, constants, fields], and ["shared", number] for what stands in the list of models and spaces, each
of which is written once.
"""

from __future__ import annotations

import csv
import mmap
import os
import struct
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import msgspec
import numpy as np

from casadi_skin.model.arguments import short_repr
from casadi_skin.zero.settings import Point, Refinement

KINDS = {"<f8", "<c16", "<i8", "|b1"}  # of arrays
PLACES = {  # of every class that a file may name, with its own name where that is another one
    "Bands": "lattice.linear",
    "Bond": "lattice.declaration",
    "BoundarySpace": "follow.boundary_space",
    "Branch": "follow.branch",
    "Certificate": "certify.certificate",
    "Chain": "lattice.chain",
    "ChainFamily": "optimise.families",
    "Condition": "optimise.search_arguments",
    "Constants": "certify.certificate",
    "ContinuationSettings": "zero.settings",
    "ContinuousSpectrum": "stability.result",
    "CosineOrbit": "optimise.optimum",
    "Course": "zero.rest_problem",
    "Critical": "zero.augmented",
    "CurveSpace": "follow.rest_curve",
    "Cycle": "dynamics.evolution",
    "Declaration": "lattice.declaration",
    "Diagram": "points.diagram",
    "EdgeCurve": "points.edge_curve",
    "EdgePoint": "points.edge_curve",
    "End": "zero.settings",
    "Ending": "optimise.search_problem",
    "Equilibrium": "follow.solution",
    "EquilibriumSpace": "follow.rest_space",
    "ErrorEstimate": "zero.settings",
    "Evolution": "dynamics.evolution",
    "FamilyRequest": "zero.request",
    "FamilySearch": "optimise.family_search",
    "FullPeriodFloquet": "stability.result",
    "KickOptimum": "optimise.kick_nlp",
    "Kkt": "optimise.nlp",
    "LatticeModes": "lattice.linear",
    "LocalisedChange": "stability.tongues.diagram",
    "LocalisedDiagram": "stability.tongues.diagram",
    "LocalisedFloquet": "stability.localised",
    "LongLattice": "lattice.long_lattice",
    "MatrixSeries": "stability.tongues.interpolation",
    "Method": "zero.family",
    "ModelFamily": "optimise.families",
    "NlpSolution": "optimise.nlp:Solution",
    "Optimality": "follow.solution",
    "Optimum": "follow.solution",
    "Orbit": "follow.orbit",
    "OrbitCurveSpace": "points.curves",
    "OrbitSearch": "optimise.orbit_search",
    "Outcome": "optimise.search_problem",
    "ParetoFront": "optimise.search_orbit",
    "Passage": "stability.tongues.diagram",
    "Periodic": "zero.orbit",
    "Piece": "stability.tongues.interpolation",
    "Place": "stability.tongues.diagram",
    "PlainCheck": "optimise.optimum",
    "ProvedStability": "certify.certificate",
    "ProvedStretch": "certify.certificate",
    "ReversibleFloquet": "stability.result",
    "Scalar": "zero.problem",
    "SearchOptimum": "optimise.optimum:Optimum",
    "SearchResult": "optimise.search",
    "SearchStatus": "optimise.search",
    "Site": "lattice.declaration",
    "Sizes": "zero.orbit",
    "SmallestKick": "optimise.kick",
    "Solution": "follow.solution",
    "SpecialPoint": "follow.special_points",
    "Spectrum": "zero.statics",
    "Spreading": "dynamics.starts",
    "StabilityChange": "follow.ledger",
    "StabilityDiagram": "stability.tongues.diagram",
    "StabilityEdge": "stability.tongues.diagram",
    "StableWindow": "stability.tongues.diagram",
    "Start": "optimise.search_problem",
    "Statics": "zero.statics",
    "SymmetryClass": "model.conserved",
    "Target": "zero.settings",
    "Targets": "zero.family",
    "Tongue": "stability.tongues.diagram",
    "TransientGrowth": "stability.growth",
    "Uniform": "lattice.declaration",
    "Unresolved": "zero.unresolved",
}


def class_named(name: object) -> Any:
    """The class of a name in a file; raises ValueError for any other."""
    if not isinstance(name, str) or name not in PLACES:
        raise ValueError(f"a thing of kind {short_repr(name)}, which no result holds")
    place, _, other = PLACES[name].partition(":")
    return getattr(import_module(f"casadi_skin.{place}"), other or name)


def name_of(kind: type) -> str:
    """The name of a class in a file; empty for one that may not stand there."""
    return next((name for name, place in PLACES.items() if _is_at(kind, name, place)), "")


def _is_at(kind: type, name: str, place: str) -> bool:
    module, _, other = place.partition(":")
    return (kind.__module__, kind.__name__) == (f"casadi_skin.{module}", other or name)


class Writer:
    """Makes data of values; `shared` holds models and spaces, each of which `write_shared` makes data of once."""

    def __init__(self, write_shared: Callable[[Writer, Any], Any | None]) -> None:
        self.shared: list[Any] = []
        self._write_shared = write_shared
        self._places: dict[int, int] = {}
        self._kept: list[Any] = []  # so that no other object gets the id of one of these

    def value(self, value: Any) -> Any:
        """A value as data; raises ValueError for objects that a file cannot hold."""
        if value is None or isinstance(value, bool | str):
            return value
        if isinstance(value, Enum):
            if not name_of(type(value)):
                raise _stranger(value)
            return ["enum", name_of(type(value)), value.name]
        if isinstance(value, np.generic):
            return self.value(value.item())
        if isinstance(value, int | float):
            return value
        if isinstance(value, complex):
            return ["complex", value.real, value.imag]
        if isinstance(value, np.ndarray):
            array = np.ascontiguousarray(value)
            if array.dtype.str not in KINDS:
                raise _stranger(value)
            return ["array", array.dtype.str, list(value.shape), array.tobytes()]
        if isinstance(value, tuple | list):
            return ["tuple" if isinstance(value, tuple) else "list", *(self.value(item) for item in value)]
        if isinstance(value, Mapping):
            return ["map", {str(name): self.value(item) for name, item in value.items()}]
        return self._object(value)

    def _object(self, value: Any) -> Any:
        if id(value) in self._places:
            return ["shared", self._places[id(value)]]
        data = self._write_shared(self, value)
        if data is not None:
            self.shared.append(data)
            self._kept.append(value)
            self._places[id(value)] = len(self.shared) - 1
            return ["shared", len(self.shared) - 1]
        if isinstance(value, Point):
            constants = self.value(value.problem.constants)
            return ["point", value.problem.resolution, constants, self.named_fields(value, ("problem",))]
        if isinstance(value, Refinement):
            return ["refinement", value.problem.resolution, self.value(value.problem.constants), self.value(value.z)]
        if is_dataclass(value) and name_of(type(value)):
            return ["object", name_of(type(value)), self.named_fields(value)]
        raise _stranger(value)

    def named_fields(self, value: Any, without: Sequence[str] = ()) -> dict[str, Any]:
        """Fields by name, those that every object of the class makes itself left out."""
        names = [field.name for field in fields(value) if field.init and field.name not in without]
        return {name: self.value(known_now(value, name)) for name in names}


def _stranger(value: object) -> ValueError:
    what = f"what holds {short_repr(value)} ({type(value).__name__})"
    return ValueError(f"result: given {what}; accepted: results of this package, of models in expressions")


def known_now(value: Any, name: str) -> Any:
    """A field; of an orbit the stability too that was computed since."""
    found = getattr(value, name)
    return vars(value).get("_floquet") if name == "known_floquet" and found is None else found


class Reader:
    """Makes values of data; `read_shared` makes those of models and spaces."""

    def __init__(self, shared: Sequence[Any], read_shared: Callable[[Reader, Any], Any]) -> None:
        self._shared: list[Any] = []
        for data in shared:
            self._shared.append(read_shared(self, data))

    def value(self, data: Any, space: Any = None) -> Any:
        """A value of data, points among it those of a space; raises ValueError and others for other data."""
        if not isinstance(data, list):
            if not (data is None or isinstance(data, bool | str | int | float)):
                raise ValueError(f"a value {short_repr(data)}")
            return data
        word, *rest = data
        if word in ("tuple", "list"):
            items = [self.value(item, space) for item in rest]
            return tuple(items) if word == "tuple" else items
        if word == "complex":
            return complex(*rest)
        if word == "map":
            return {name: self.value(item, space) for name, item in rest[0].items()}
        if word == "array":
            return _array(*rest)
        if word == "enum":
            return class_named(rest[0])[rest[1]]
        if word == "shared":
            return self._shared[_place(rest[0], len(self._shared))]
        if word == "point":
            resolution, constants, named = rest
            problem = self._problem(space, resolution, constants)
            return Point(problem=problem, **self.named(named, space))
        if word == "refinement":
            return Refinement(self._problem(space, rest[0], rest[1]), self.value(rest[2]))
        if word == "object":
            return self._object(class_named(rest[0]), rest[1])
        raise ValueError(f"a value of kind {short_repr(word)}")

    def named(self, data: Mapping[str, Any], space: Any = None) -> dict[str, Any]:
        """Values by name."""
        return {name: self.value(item, space) for name, item in data.items()}

    def _object(self, kind: Any, data: Mapping[str, Any]) -> Any:
        space = self.value(data["space"]) if "space" in data else None
        return kind(**self.named(data, space))

    def _problem(self, space: Any, resolution: int, constants: Any) -> Any:
        if resolution not in space.levels.resolutions:
            raise ValueError(f"a resolution {short_repr(resolution)}; accepted: {space.levels.resolutions}")
        problem = space.levels.problem(resolution)
        found = self.value(constants)
        if found.shape != problem.constants.shape:
            raise ValueError("a point of another discretisation")
        return problem.with_constants(found)


def _array(kind: str, shape: Sequence[int], data: bytes) -> np.ndarray[Any, Any]:
    if kind not in KINDS:
        raise ValueError(f"an array of {short_repr(kind)}")
    return np.frombuffer(data, kind).reshape(shape).copy()


def _place(place: int, count: int) -> int:
    if not 0 <= place < count:
        raise ValueError(f"a reference to {short_repr(place)}, of {count}")
    return place


# Files that are not what a run wrote: cut off, changed, or made by somebody else --------------------------------------

WRONG = (ArithmeticError, AttributeError, LookupError, MemoryError, TypeError, ValueError, csv.Error)
ACCEPTED = "accepted: a file as a run or a map writes it"


def check_whole(path: Path) -> None:
    """Raises ValueError, naming the file, where a netCDF file or a table of a run was cut off or cannot be read."""
    with readable(path):
        if path.suffix == ".csv":
            if not path.read_bytes().endswith(b"\n"):
                raise ValueError("its last row is cut off")
            return
        from scipy.io import netcdf_file

        with netcdf_file(path, "r", mmap=False) as file:  # all variables are read
            if not file.variables:
                raise ValueError("it has no variables")


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Raises ValueError, naming the file, where its contents cannot be read or do not fit together."""
    try:
        yield
    except OSError as error:  # also of a place in the file that is none
        raise ValueError(f"{path}: cannot be read: {error.strerror}; {ACCEPTED}") from error
    except WRONG as error:
        why = f"damaged: {type(error).__name__}: {' '.join(str(error).split())}".rstrip(": ")
        raise ValueError(f"{path}: {why}; {ACCEPTED}") from error


# The journal of a run: results, appended to one file and flushed to disk at once --------------------------------------

MARK, FORMAT = b"cskj", 2
HEADER = struct.Struct("<4sIII")  # mark, format, length of what follows, CRC-32 of these and of what follows
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
        self,
        path: Path,
        decoder: msgspec.msgpack.Decoder[Record],
        each: Callable[[int, Record], None] | None = None,
    ) -> None:
        self.path, self._encoder, self.records = path, msgspec.msgpack.Encoder(), list[Record]()
        keep = each or (lambda _, record: self.records.append(record))
        with mapped(path) as data:
            self.end, self.fault = scan(data, decoder, keep)
        self._file = path.open("r+b" if path.exists() else "x+b", buffering=0)
        self._file.truncate(self.end)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def append(self, record: msgspec.Struct) -> None:
        """Write one record and wait until it is on the disk; raises OSError, with the journal as it was."""
        payload = self._encoder.encode(record)
        data = framed(payload)
        self._file.seek(self.end)
        try:
            written = 0
            while written < len(data):
                written += self._file.write(data[written:]) or 0
            os.fsync(self._file.fileno())
        except OSError:
            self._file.truncate(self.end)
            raise
        self.end += len(data)


def framed(payload: bytes) -> bytes:
    """A record behind its header."""
    return _header(payload) + payload


def _header(payload: bytes) -> bytes:
    fields = MARK, FORMAT, len(payload)
    return HEADER.pack(*fields, zlib.crc32(payload, zlib.crc32(HEADER.pack(*fields, 0))))


@contextmanager
def mapped(path: Path) -> Iterator[Data]:
    """The bytes of a file, read as they are looked at; none where there is no file."""
    if not path.exists() or path.stat().st_size == 0:
        yield b""
        return
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        yield data


def read_records(data: bytes, decoder: msgspec.msgpack.Decoder[Record]) -> tuple[list[Record], int, str]:
    """The records of a journal up to the first that is not whole, the length of these, and the fault of the next.

    The last is empty where all of `data` is records of this format.
    """
    records = list[Record]()
    return records, *scan(data, decoder, lambda _, record: records.append(record))


def scan(
    data: Data, decoder: msgspec.msgpack.Decoder[Record], each: Callable[[int, Record], None], start: int = 0
) -> tuple[int, str]:
    """Call `each` with place and record of every record from a place on, up to the first that is not whole.

    Returns the place where these end, and the fault there; empty where the data end.
    """
    place = start
    while place < len(data):
        try:
            record, length = record_at(data, place, decoder)
        except ValueError as error:
            return place, f"{error} at byte {place}"
        each(place, record)
        place += length
    return place, ""


def record_at(data: Data, place: int, decoder: msgspec.msgpack.Decoder[Record]) -> tuple[Record, int]:
    """The record at a place and its length in bytes; raises ValueError, in words, where there is none."""
    if len(data) - place < HEADER.size:
        raise ValueError("a record that is cut off")
    mark, version, length, _ = HEADER.unpack_from(data, place)
    if mark != MARK:
        raise ValueError("no record of a journal")
    if version != FORMAT:
        raise ValueError(f"a record of format {version}, where {FORMAT} is read,")
    payload = data[place + HEADER.size : place + HEADER.size + length]
    if len(payload) < length:
        raise ValueError("a record that is cut off")
    if data[place : place + HEADER.size] != _header(payload):
        raise ValueError("a damaged record")
    try:
        return decoder.decode(payload), HEADER.size + length
    except msgspec.DecodeError as error:
        raise ValueError("a record of another version") from error
