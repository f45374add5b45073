"""The journal of a run: every solution as it converges, appended to one file, so that a killed run loses nothing.

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
from casadi_skin.orbits.follow import Following
from casadi_skin.orbits.making import solution_at
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.space import SolutionSpace
from casadi_skin.orbits.stability_changes import StabilityChange
from casadi_skin.solvers.levels import ErrorEstimate
from casadi_skin.stability.result import Floquet, FullPeriodFloquet, ReversibleFloquet


class ReversibleRecord(msgspec.Struct, frozen=True, tag="reversible"):
    """Stability by the N x N problem; arrays as bytes of little-endian doubles."""

    mu: bytes
    mu_error: bytes
    trivial_deviation: float
    power: int


class FullPeriodRecord(msgspec.Struct, frozen=True, tag="full period"):
    """Stability by the monodromy matrix."""

    multipliers: bytes
    monodromy: bytes
    trivial: int
    trivial_deviation: float
    allowed: float


class SolutionRecord(msgspec.Struct, frozen=True, tag="solution"):
    """A converged solution with all that the continuation needs to go on from it."""

    branch: str
    resolution: int
    z: bytes
    tangent: bytes
    Omega_error: float
    profile_error: float
    step: float
    iterations: int
    requested: bool
    walked: bool
    floquet: ReversibleRecord | FullPeriodRecord | None
    constants: bytes  # of the problem: the mesh
    at_round_off: bool
    parameter_error: float
    special: str


class ChangeRecord(msgspec.Struct, frozen=True, tag="change"):
    """A change of stability; it lies between the solutions recorded before and after it."""

    branch: str
    change: StabilityChange


class EndRecord(msgspec.Struct, frozen=True, tag="end"):
    """The end of a branch."""

    branch: str
    end: End | None
    detail: str
    misses: dict[str, tuple[float, ...]]


Record = SolutionRecord | ChangeRecord | EndRecord
Kind = TypeVar("Kind")


def _doubles(data: bytes, kind: str = "<f8") -> np.ndarray:
    return np.frombuffer(data, kind).copy()


def _bytes(values: np.ndarray, kind: str = "<f8") -> bytes:
    return values.astype(kind).tobytes()


def solution_record(branch: str, solution: Solution, with_stability: bool) -> SolutionRecord:
    """Record of a solution of the branch of that name."""
    point = solution.point
    floquet = solution.floquet() if with_stability and isinstance(solution, Orbit) else None
    return SolutionRecord(
        branch=branch,
        resolution=point.problem.resolution,
        z=_bytes(point.z),
        tangent=_bytes(point.tangent),
        Omega_error=point.error.Omega,
        profile_error=point.error.profile,
        step=point.step,
        iterations=point.iterations,
        requested=point.requested,
        walked=point.walked,
        floquet=None if floquet is None else _floquet_record(floquet),
        constants=_bytes(point.problem.constants),
        at_round_off=point.at_round_off,
        parameter_error=point.error.parameter,
        special=point.special,
    )


def _floquet_record(floquet: Floquet) -> ReversibleRecord | FullPeriodRecord:
    if isinstance(floquet, ReversibleFloquet):
        mu, errors = _bytes(floquet.mu, "<c16"), _bytes(floquet.mu_error)
        return ReversibleRecord(mu, errors, floquet.trivial_deviation, floquet.power)
    assert isinstance(floquet, FullPeriodFloquet)
    multipliers, monodromy = _bytes(floquet.multipliers, "<c16"), _bytes(floquet.monodromy)
    return FullPeriodRecord(multipliers, monodromy, floquet.trivial, floquet.trivial_deviation, floquet.allowed)


def _floquet(record: ReversibleRecord | FullPeriodRecord) -> Floquet:
    if isinstance(record, ReversibleRecord):
        mu, errors = _doubles(record.mu, "<c16"), _doubles(record.mu_error)
        return ReversibleFloquet(mu, errors, record.trivial_deviation, record.power)
    multipliers = _doubles(record.multipliers, "<c16")
    monodromy = _doubles(record.monodromy).reshape(multipliers.size, multipliers.size)
    return FullPeriodFloquet(multipliers, monodromy, record.trivial, record.trivial_deviation, record.allowed)


def _solution(record: SolutionRecord, space: SolutionSpace) -> Solution:
    point = Point(
        problem=space.levels.problem(record.resolution).with_constants(_doubles(record.constants)),
        z=_doubles(record.z),
        tangent=_doubles(record.tangent),
        error=ErrorEstimate(record.Omega_error, record.profile_error, parameter=record.parameter_error),
        step=record.step,
        iterations=record.iterations,
        requested=record.requested,
        walked=record.walked,
        at_round_off=record.at_round_off,
        special=record.special,
    )
    return solution_at(space, point, None if record.floquet is None else _floquet(record.floquet))


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
    """All whole records of a journal; what a kill cut off at its end is left out.

    Raises ValueError, in one line, for a journal that this version did not write.
    """
    try:
        return read_records(path, msgspec.msgpack.Decoder(Record))
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: is no journal of this version; accepted: --overwrite") from error


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
    """The records up to the last point of a continuation, or to the end of a branch.

    Points between two points of a continuation, and changes of stability after the last one, are computed again.
    """
    last = 0
    for place, record in enumerate(records, start=1):
        if isinstance(record, EndRecord) or (isinstance(record, SolutionRecord) and record.walked):
            last = place
    return list(records[:last])


def restore(
    records: Sequence[Record], branch: str, space: SolutionSpace, stability: bool, events: bool
) -> Following | Branch:
    """The finished branch of that name, or what goes on from what the records hold of it."""
    mine = [r for r in records if r.branch == branch]
    solutions = [_solution(r, space) for r in mine if isinstance(r, SolutionRecord)]
    changes = [r.change for r in mine if isinstance(r, ChangeRecord)]
    following = Following(space, stability, events, solutions, changes)
    for record in mine:
        if isinstance(record, EndRecord):
            return following.finished(record.end, record.detail, record.misses)
    return following
