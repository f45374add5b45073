"""Files that are not what a run wrote: cut off, changed, or made by somebody else."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
