"""The journal of a run: every orbit as it converges, appended to one file, so that a killed run loses nothing.

Records are MessagePack behind a length of four bytes; a record that was cut off by a kill is ignored when reading.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, TypeVar

import msgspec
import numpy as np

from casadi_skin.continuation.points import End, Point
from casadi_skin.files import replacing
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.follow import Following
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.stability_changes import StabilityChange
from casadi_skin.solvers.levels import ErrorEstimate
from casadi_skin.stability.result import Floquet


class FloquetRecord(msgspec.Struct, frozen=True, tag="floquet"):
    """A stability result; arrays as bytes of little-endian doubles."""

    mu: bytes
    mu_error: bytes
    trivial_deviation: float
    power: int


class OrbitRecord(msgspec.Struct, frozen=True, tag="orbit"):
    """A converged orbit with all that the walk needs to go on from it."""

    mode: int
    resolution: int
    z: bytes
    tangent: bytes
    Omega_error: float
    profile_error: float
    step: float
    iterations: int
    requested: bool
    walked: bool
    floquet: FloquetRecord | None
    constants: bytes = b""  # of the problem: the mesh
    at_round_off: bool = False
    parameter_error: float = 0.0


class ChangeRecord(msgspec.Struct, frozen=True, tag="change"):
    """A change of stability; it lies between the orbits recorded before and after it."""

    mode: int
    change: StabilityChange


class EndRecord(msgspec.Struct, frozen=True, tag="end"):
    """The end of a family."""

    mode: int
    end: End | None
    detail: str
    missed: tuple[float, ...]
    missed_Omega: tuple[float, ...] = ()
    missed_period: tuple[float, ...] = ()


Record = OrbitRecord | ChangeRecord | EndRecord
Kind = TypeVar("Kind")


def _doubles(data: bytes, kind: str = "<f8") -> np.ndarray:
    return np.frombuffer(data, kind).copy()


def orbit_record(orbit: Orbit, with_stability: bool) -> OrbitRecord:
    """Record of an orbit."""
    point, floquet = orbit.point, None
    if with_stability:
        f = orbit.floquet()
        floquet = FloquetRecord(
            f.mu.astype("<c16").tobytes(), f.mu_error.astype("<f8").tobytes(), f.trivial_deviation, f.power
        )
    return OrbitRecord(
        mode=orbit.space.coordinates.mode_number,
        resolution=point.problem.resolution,
        z=point.z.astype("<f8").tobytes(),
        tangent=point.tangent.astype("<f8").tobytes(),
        Omega_error=point.error.Omega,
        profile_error=point.error.profile,
        step=point.step,
        iterations=point.iterations,
        requested=point.requested,
        walked=point.walked,
        floquet=floquet,
        constants=point.problem.constants.astype("<f8").tobytes(),
        at_round_off=point.at_round_off,
        parameter_error=point.error.parameter,
    )


def _orbit(record: OrbitRecord, tools: Family) -> Orbit:
    point = Point(
        problem=tools.levels.problem(record.resolution).with_constants(_doubles(record.constants)),
        z=_doubles(record.z),
        tangent=_doubles(record.tangent),
        error=ErrorEstimate(record.Omega_error, record.profile_error, parameter=record.parameter_error),
        step=record.step,
        iterations=record.iterations,
        requested=record.requested,
        walked=record.walked,
        at_round_off=record.at_round_off,
    )
    f = record.floquet
    known = None
    if f is not None:
        known = Floquet(_doubles(f.mu, "<c16"), _doubles(f.mu_error), f.trivial_deviation, f.power)
    return Orbit(tools, point, known)


class Journal:
    """An open journal; use as a context manager."""

    def __init__(self, path: Path) -> None:
        self._file: BinaryIO = path.open("ab")
        self._encoder = msgspec.msgpack.Encoder()

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def append(self, record: msgspec.Struct) -> None:
        """Write one record and hand it to the operating system at once."""
        _write(self._file, self._encoder.encode(record))
        self._file.flush()


def _write(file: BinaryIO, payload: bytes) -> None:
    file.write(struct.pack("<I", len(payload)) + payload)


def read_journal(path: Path) -> list[Record]:
    """All whole records of a journal; what a kill cut off at its end is left out."""
    return read_records(path, msgspec.msgpack.Decoder(Record))


def read_records(path: Path, decoder: msgspec.msgpack.Decoder[Kind]) -> list[Kind]:
    """All whole records of a journal, of the kind that the decoder knows."""
    data, place, records = path.read_bytes(), 0, []
    while place + 4 <= len(data):
        (length,) = struct.unpack_from("<I", data, place)
        if place + 4 + length > len(data):
            break
        records.append(decoder.decode(data[place + 4 : place + 4 + length]))
        place += 4 + length
    return records


def trim_journal(path: Path, records: Sequence[msgspec.Struct]) -> None:
    """Replace the journal by these records."""
    encoder = msgspec.msgpack.Encoder()
    with replacing(path) as temporary, temporary.open("wb") as file:
        for record in records:
            _write(file, encoder.encode(record))


def resumable(records: Sequence[Record]) -> list[Record]:
    """The records up to the last point walked of a family that has not ended.

    Points between two points walked, and changes of stability after the last one, are computed again.
    """
    last = 0
    for place, record in enumerate(records, start=1):
        if isinstance(record, EndRecord) or (isinstance(record, OrbitRecord) and record.walked):
            last = place
    return list(records[:last])


def restore(records: Sequence[Record], tools: Family, stability: bool, events: bool) -> Following | Branch:
    """The finished branch of the family of `tools`, or the walk that goes on from what the records hold of it."""
    mode = tools.request.mode
    mine = [r for r in records if r.mode == mode]
    orbits = [_orbit(r, tools) for r in mine if isinstance(r, OrbitRecord)]
    changes = [r.change for r in mine if isinstance(r, ChangeRecord)]
    walk = Following(tools, stability, events, orbits, changes)
    for record in mine:
        if isinstance(record, EndRecord):
            missed = (record.missed, record.missed_Omega, record.missed_period)
            return walk.finished(record.end, record.detail, missed)
    return walk
