"""Transition matrices of the variational flow by the kernel splitting.c."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native.addresses import address
from casadi_skin.native.jacobian import Orbits
from casadi_skin.native.library import library

Array = NDArray[np.float64]
Pattern = tuple[NDArray[np.int32], NDArray[np.int32]]  # indptr and indices of the rows of J
Kernel = Callable[[Pattern, tuple[int, int], tuple[Array, Array], Array, Array, int | None], Array]
Sequences = tuple[NDArray[np.int64], Array, Array]  # numbers of kicks, all kicks and drifts, one after the other
Flows = Callable[[Orbits, Pattern, int, Sequences, Array, Array], None]
COLUMNS = 8  # that go through the stages together


@cache
def splitting_kernel() -> Kernel | None:
    """Function of the pattern of J, reaches, kicks and drifts, steps, J and a half bandwidth; None without a compiler.

    The reaches are that of one kick, J's half bandwidth, and that of all, beyond which results are zero. Steps have
    shape (points,), the non-zeros of J at the kicks (points, kicks, non-zeros); the result (points, 2n, 2n), or, where
    a half bandwidth w is given, the bands of the blocks (points, 2n, 2(2w + 1)), see `stability.banded`.
    """
    found = library("splitting")
    if found is None:
        return None
    function, integer, pointer = found.casadi_skin_splitting, ctypes.c_int64, ctypes.c_void_p
    function.argtypes = [integer] * 4 + [pointer] * 2 + [integer] + [pointer] * 4 + [integer] * 2 + [pointer]
    function.restype = ctypes.c_int

    def transitions(
        pattern: Pattern, reaches: tuple[int, int], sequence: tuple[Array, Array], steps: Array, jacobians: Array,
        band: int | None = None,
    ) -> Array:  # fmt: skip
        (indptr, indices), (kicks, drifts) = pattern, sequence
        (points, count, nonzeros), size = jacobians.shape, indptr.size - 1
        if points and not jacobians[0].flags.c_contiguous:
            jacobians = np.ascontiguousarray(jacobians)
        held: list[NDArray[Any]] = [indptr, indices, kicks, drifts, np.ascontiguousarray(steps)]
        assert (kicks.size, drifts.size, nonzeros) == (count, count - 1, indices.size)
        assert all(array.flags.c_contiguous for array in held)
        assert band is None or reaches[1] + COLUMNS - 1 <= band
        result = np.zeros((points, 2 * size, 2 * (size if band is None else 2 * band + 1)))
        at = [address(array) for array in (*held, jacobians, result)]
        stride = jacobians.strides[0] // jacobians.itemsize
        if function(points, size, *reaches, *at[:2], count, *at[2:-1], stride, -1 if band is None else band, at[-1]):
            raise MemoryError(f"the variational flow of {size} components")
        return result

    return transitions


@cache
def flows_kernel() -> Flows | None:
    """Function of orbits, the pattern of J, its half bandwidth, kicks and drifts, and steps; None without a compiler.

    Kicks and drifts are those of several numbers of steps, of which `steps`, shape (levels, points), are the lengths;
    the phases of the orbits are theirs, one after the other. The last argument takes the result, (levels, points, 2n,
    2n): some points of an array of more.
    """
    found = library("splitting")
    if found is None:
        return None
    function, integer, pointer = found.casadi_skin_flows, ctypes.c_int64, ctypes.c_void_p
    function.argtypes = [pointer, *[integer] * 3, *[pointer] * 2, integer, *[pointer] * 4, integer, pointer]
    function.restype = ctypes.c_int

    def transitions(
        orbits: Orbits, pattern: Pattern, reach: int, sequences: Sequences, steps: Array, result: Array
    ) -> None:
        (indptr, indices), (counts, kicks, drifts), (levels, points) = pattern, sequences, steps.shape
        size = indptr.size - 1
        assert orbits.phases == kicks.size == drifts.size + levels
        held: list[NDArray[Any]] = [indptr, indices, counts, kicks, drifts, np.ascontiguousarray(steps)]
        assert all(array.flags.c_contiguous for array in held)
        assert result.shape == (levels, points, 2 * size, 2 * size)
        assert result[0].flags.c_contiguous
        at, apart = [address(array) for array in held], result.strides[0] // result.itemsize
        if function(ctypes.addressof(orbits), points, size, reach, *at[:2], levels, *at[2:], apart, address(result)):
            raise MemoryError(f"the variational flow of {size} components")

    return transitions
