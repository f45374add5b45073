"""netCDF 3 files by scipy: names and texts in UTF-8, numbers of attributes in double precision, CF-1.8."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin._version import __version__
from casadi_skin.model.files import replacing

if TYPE_CHECKING:
    from scipy.io import netcdf_file

EMPTY = 9.969209968386869e36  # the fill value of netCDF for doubles
OF_ALL = {"Conventions": "CF-1.8", "history": f"written by casadi_skin {__version__}"}


@contextmanager
def new_file(path: Path, attributes: Mapping[str, Any]) -> Iterator[netcdf_file]:
    """A file with 64-bit offsets and these attributes, which takes the place of `path` when it is whole."""
    from scipy.io import netcdf_file

    with replacing(path) as temporary, netcdf_file(temporary, "w", version=2) as file:
        put_attributes(file, {**OF_ALL, **attributes})
        yield file


def put_attributes(target: Any, attributes: Mapping[str, Any]) -> None:
    """Set attributes of a file or a variable; an empty text is "untitled", as netCDF has none."""
    for name, value in attributes.items():
        if isinstance(value, str):
            value = (value or "untitled").encode()
        elif isinstance(value, float):
            value = np.float64(value)  # scipy writes Python's in single precision
        setattr(target, stored_name(name), value)


def stored_name(name: str) -> str:
    """A name as scipy is to have it, which writes a character a byte: the bytes are those of UTF-8."""
    return name.encode().decode("latin-1")


def read_name(name: str) -> str:
    """A name as it was before `stored_name`."""
    return name.encode("latin-1").decode(errors="replace")


def characters(texts: Sequence[str]) -> NDArray[np.bytes_]:
    """Texts as bytes of one length, filled with blanks: netCDF 3's convention; shape (texts, length)."""
    encoded = [text.encode() for text in texts]
    width = max([1, *map(len, encoded)])
    return np.frombuffer(b"".join(text.ljust(width) for text in encoded), "S1").reshape(len(texts), width)
