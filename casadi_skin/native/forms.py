"""Matrices between bases on blocks of mu by the kernel forms.c."""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native.addresses import address, contiguous
from casadi_skin.native.library import library

Array = NDArray[np.float64]
Numbers = NDArray[Any]  # real or complex
Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]


class FormsKernel:
    """The last step of `stability.decoupling` for several intervals, of real or complex matrices."""

    def __init__(self, found: ctypes.CDLL) -> None:
        integer: Any = ctypes.c_int64
        pointer = ctypes.c_void_p
        self._forms = found.casadi_skin_forms
        self._forms.argtypes = [integer] * 5 + [pointer] * 6 + [integer] + [pointer] * 3 + [integer] + [pointer] * 5
        self._forms.restype = ctypes.c_int

    def __call__(
        self,
        matrices: Array,
        errors: Array | None,
        numbers: Indices,
        coordinates: tuple[Numbers, Numbers],
        same: Booleans,
        columns: Indices,
        special: Booleans,
        bases: tuple[Numbers, Numbers],
        found: Booleans,
    ) -> tuple[Numbers, Numbers, Array, Booleans]:
        """As `stability.decoupling.Forms` has them, from the vectors and their inverse, and right and left bases."""
        T, count, intervals = bases[0], columns.shape[1], len(columns)
        _, nodes, forms, size, _ = matrices.shape
        shape = intervals, nodes, forms, count, count
        values, changes = np.zeros(shape, T.dtype), np.zeros(shape if errors is not None else 0, T.dtype)
        squares, found = np.zeros((intervals, 2, count)), found.copy()
        assert columns.dtype == numbers.dtype == np.int64
        assert np.all((numbers >= 0) & (numbers < len(matrices)))
        assert same.dtype == special.dtype == np.bool_
        assert all(each.dtype == T.dtype for each in (*coordinates, *bases))
        held = [contiguous(each) for each in (matrices, *coordinates, *bases)]
        others = [np.ascontiguousarray(each) for each in (same, columns, special, numbers)]
        held_errors = None if errors is None else contiguous(errors)
        matrices_at, vectors_at, inverse_at, T_at, S_at = (address(each) for each in held)
        same_at, columns_at, special_at, numbers_at = (address(each) for each in others)
        errors_at = None if held_errors is None else address(held_errors)
        inputs = (
            matrices_at,
            errors_at,
            numbers_at,
            vectors_at,
            inverse_at,
            same_at,
            count,
            columns_at,
            special_at,
            T_at,
        )
        results = (address(each) for each in (values, changes, squares, found))
        parts = T.itemsize // 8
        if self._forms(intervals, nodes, forms, size, parts, *inputs, bases[1].shape[3], S_at, *results):
            raise MemoryError(f"blocks of {size} multipliers")
        return values, changes, squares, found


@cache
def forms_kernel() -> FormsKernel | None:
    """The kernel; None without a compiler."""
    found = library("forms")
    return None if found is None else FormsKernel(found)
