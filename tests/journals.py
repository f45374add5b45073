"""Journals made of records, each of which follows the one before."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import msgspec

from casadi_skin.results.store import checksum, framed


def journal_of(records: Iterable[Any]) -> bytes:
    """The bytes of a journal with these records."""
    data, last = b"", 0
    for record in records:
        one = framed(msgspec.msgpack.encode(record), last)
        data, last = data + one, checksum(one)
    return data
