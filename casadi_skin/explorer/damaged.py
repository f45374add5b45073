"""Files that are not what a run wrote: cut off, changed, or made by somebody else."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

WRONG = (ArithmeticError, AttributeError, LookupError, MemoryError, TypeError, ValueError, csv.Error)
ACCEPTED = "accepted: a file as a run or a map writes it"


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
