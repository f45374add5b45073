"""Where the numbers of arrays begin, for calls of kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def address(array: NDArray[Any]) -> int:
    """Where the numbers of an array begin; faster than `ctypes.data`."""
    return int(array.__array_interface__["data"][0])


def contiguous(numbers: NDArray[Any]) -> NDArray[Any]:
    """Real or complex numbers of double precision, row by row, as kernels read them."""
    assert numbers.dtype in (np.float64, np.complex128)
    return np.ascontiguousarray(numbers)
