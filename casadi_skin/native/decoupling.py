"""Bases that make matrices block diagonal at the nodes of intervals by the kernel decoupling.c."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native.addresses import address
from casadi_skin.native.library import library

Numbers = NDArray[Any]  # real or complex
Indices = NDArray[np.int64]
Booleans = NDArray[np.bool_]
Levels = Sequence[tuple[Indices, Indices, NDArray[np.float64]]]  # nodes known, nodes wanted, weights of these in those


class DecouplingKernel:
    """The steps of `stability.decoupling` for several intervals, of real or complex matrices."""

    def __init__(self, found: ctypes.CDLL) -> None:
        integer: Any = ctypes.c_int64
        real, pointer = ctypes.c_double, ctypes.c_void_p
        self._invariant, self._contracts = found.casadi_skin_invariant, found.casadi_skin_contracts
        self._invariant.argtypes = [integer] * 5 + [pointer] * 3 + [integer] + [pointer] * 3
        self._invariant.argtypes += [integer, real, pointer, pointer]
        self._contracts.argtypes = [integer] * 4 + [pointer] * 3 + [integer, real, real, pointer, pointer]
        self._invariant.restype = self._contracts.restype = ctypes.c_int

    def invariant(
        self, K: Numbers, same: Booleans, columns: Indices, levels: Levels, iterations: int, enough: float
    ) -> tuple[Numbers, Booleans]:
        """T at the nodes, in steps until one is no larger than `enough`, and for which intervals these are few."""
        intervals, nodes, size, _ = K.shape
        T = np.zeros((intervals, nodes, size, columns.shape[1]), dtype=K.dtype)
        done = np.zeros(intervals, dtype=bool)
        counts = np.array([[known.size, wanted.size] for known, wanted, _ in levels])
        numbers = np.concatenate([each for known, wanted, _ in levels for each in (known, wanted)])
        weights = np.concatenate([prediction.ravel() for _, _, prediction in levels])
        assert columns.dtype == counts.dtype == numbers.dtype == np.int64
        held = [*_matrices(K, same), *(np.ascontiguousarray(each) for each in (columns, counts, numbers, weights))]
        K_at, same_at, columns_at, *levels_at = (address(each) for each in held)
        shape = intervals, nodes, size, columns.shape[1], K.itemsize // 8, K_at, columns_at, same_at
        if self._invariant(*shape, len(levels), *levels_at, iterations, enough, address(T), address(done)):
            raise MemoryError(f"bases of {size} multipliers")
        return T, done

    def contracts(
        self, K: Numbers, same: Booleans, steps: int, small: float, largest: float
    ) -> tuple[Numbers, Booleans]:
        """Diagonals of the blocks at the nodes, and for which intervals steps become small."""
        intervals, nodes, size, _ = K.shape
        diagonals, done = np.zeros((intervals, nodes, size), dtype=K.dtype), np.zeros(intervals, dtype=bool)
        held = [*_matrices(K, same), np.arange(size, dtype=np.int64)]
        shape = intervals, nodes, size, K.itemsize // 8
        results = address(diagonals), address(done)
        if self._contracts(*shape, *(address(each) for each in held), steps, small, largest, *results):
            raise MemoryError(f"bases of {size} multipliers")
        return diagonals, done


def _matrices(K: Numbers, same: Booleans) -> list[NDArray[Any]]:
    assert K.dtype in (np.float64, np.complex128)
    assert same.dtype == np.bool_
    assert K.shape[2:] == same.shape[1:]
    assert len(K) == len(same)
    return [np.ascontiguousarray(K), np.ascontiguousarray(same)]


@cache
def decoupling_kernel() -> DecouplingKernel | None:
    """The kernel; None without a compiler."""
    found = library("decoupling")
    return None if found is None else DecouplingKernel(found)
