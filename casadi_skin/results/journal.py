"""The journal of a run: results, appended to one file and flushed to disk at once.

A record is a tagged struct of msgspec behind a header with a mark, the format, its length and a checksum of all of it:
a record that is cut off or damaged ends what is read, and what follows it is written again.
"""

from __future__ import annotations

import mmap
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Generic, Self, TypeVar

import msgspec

MARK, FORMAT = b"cskj", 3
RECORD_HEADER = struct.Struct("<4sIII")  # mark, format, length of what follows, CRC-32 of these and of what follows
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
    return RECORD_HEADER.pack(*fields, zlib.crc32(payload, zlib.crc32(RECORD_HEADER.pack(*fields, 0))))


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
    if len(data) - place < RECORD_HEADER.size:
        raise ValueError("a record that is cut off")
    mark, version, length, _ = RECORD_HEADER.unpack_from(data, place)
    if mark != MARK:
        raise ValueError("no record of a journal")
    if version != FORMAT:
        raise ValueError(f"a record of format {version}, where {FORMAT} is read,")
    payload = data[place + RECORD_HEADER.size : place + RECORD_HEADER.size + length]
    if len(payload) < length:
        raise ValueError("a record that is cut off")
    if data[place : place + RECORD_HEADER.size] != _header(payload):
        raise ValueError("a damaged record")
    try:
        return decoder.decode(payload), RECORD_HEADER.size + length
    except msgspec.DecodeError as error:
        raise ValueError("a record of another version") from error
