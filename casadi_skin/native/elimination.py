"""Cells of a row eliminated from its free end on by the kernel elimination.c."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native.addresses import address
from casadi_skin.native.library import library

Array = NDArray[np.float64]


class _Row(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("cells", "size", "parts", "sites", "from_", "to")),
        *((name, ctypes.c_void_p) for name in ("blocks", "springs")),
    )


def eliminated(blocks: Array, springs: Array, ends: tuple[int, int], sites: int, squares: Any) -> Any:
    """All cells but the first, for several squares of frequencies.

    Arguments:
        blocks: stiffness of all sidebands, shape (cells, size, size), at least two cells.
        springs: of the bond from each cell to the next, shape (cells - 1,).
        ends: sites of a cell and of the next one that a bond joins.
        sites: number of sites of a cell.
        squares: real or complex, shape (values, size).

    Returns:
        The inverse at the second cell, shape (values, size, size), and logarithms and phases of the product of all
        determinants; None without a compiler.

    Raises:
        numpy.linalg.LinAlgError: a pivot vanishes.
    """
    function = _function()
    if function is None:
        return None
    values, size = squares.shape
    is_complex = np.iscomplexobj(squares)
    parts = 2 if is_complex else 1
    assert blocks.shape[1:] == (size, size)
    assert springs.shape == (len(blocks) - 1,)
    assert len(blocks) > 1
    held = [np.ascontiguousarray(each, dtype=np.float64) for each in (blocks, springs)]
    row = _Row(len(blocks), size, parts, sites, *ends, *(address(each) for each in held))
    split = np.stack([squares.real, squares.imag], axis=1) if is_complex else np.ascontiguousarray(squares[:, None])
    inverse, logs, phases = np.empty((values, parts, size, size)), np.empty(values), np.empty((values, 2))
    memory, exchanges = np.empty(parts * size * size), np.empty(size, dtype=np.int64)
    results = (split, inverse, logs, phases, memory, exchanges)
    function(ctypes.byref(row), values, *(address(each) for each in results))
    if not np.all(np.isfinite(logs)):
        raise np.linalg.LinAlgError("Singular matrix")
    if is_complex:
        return inverse[:, 0] + 1j * inverse[:, 1], logs, phases[:, 0] + 1j * phases[:, 1]
    return inverse[:, 0], logs, phases[:, 0]


@cache
def _function() -> Any:
    found = library("elimination")
    if found is None:
        return None
    function: Any = found.casadi_skin_eliminated
    function.argtypes = [ctypes.c_void_p, ctypes.c_int64, *([ctypes.c_void_p] * 6)]
    function.restype = None
    return function
