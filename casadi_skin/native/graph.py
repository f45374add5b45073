"""Which mu stay in one block, and whether blocks stay apart, by the kernel graph.c."""

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
Booleans = NDArray[np.bool_]
MOST_PROBES = 16  # as in graph.c


class GraphKernel:
    """Two steps of `stability.blocks` and `stability.decoupling` for several intervals, of real or complex numbers."""

    def __init__(self, found: ctypes.CDLL) -> None:
        integer: Any = ctypes.c_int64
        real, pointer = ctypes.c_double, ctypes.c_void_p
        self._joined, self._apart = found.casadi_skin_graph, found.casadi_skin_apart
        self._joined.argtypes = [integer] * 4 + [pointer] * 2 + [real] * 3 + [integer] + [pointer] * 2
        self._apart.argtypes = [integer] * 4 + [pointer] * 2 + [integer, pointer, real, pointer]
        self._joined.restype, self._apart.restype = ctypes.c_int, None

    def joined(
        self, K: Numbers, glued: Booleans, apart: float, coupled: float, resolved: float
    ) -> tuple[Booleans, Array]:
        """Which mu stay in one block, (intervals, m, m), and what the others move each by, (intervals, m)."""
        intervals, nodes, size, _ = K.shape
        same, shifts = np.zeros((intervals, size, size), dtype=bool), np.empty((intervals, size))
        held = contiguous(K), np.ascontiguousarray(glued)
        assert glued.dtype == np.bool_
        shape = intervals, nodes, size, K.itemsize // 8
        limits = apart, coupled, resolved, nodes - 1
        if self._joined(*shape, *(address(each) for each in held), *limits, address(same), address(shifts)):
            raise MemoryError(f"blocks of {size} multipliers")
        return same, shifts

    def apart(self, values: Numbers, same: Booleans, weights: Array, nearer: float) -> Booleans:
        """Whether numbers of different blocks, (intervals, probes, m), stay apart; `weights` (between, probes)."""
        intervals, probes, size = values.shape
        assert same.dtype == np.bool_
        assert probes <= MOST_PROBES
        held = contiguous(values), np.ascontiguousarray(same), contiguous(weights)
        values_at, same_at, weights_at = (address(each) for each in held)
        found = np.zeros(intervals, dtype=bool)
        shape = intervals, probes, size, values.itemsize // 8
        self._apart(*shape, values_at, same_at, len(weights), weights_at, nearer, address(found))
        return found


@cache
def graph_kernel() -> GraphKernel | None:
    """The kernel; None without a compiler."""
    found = library("graph")
    return None if found is None else GraphKernel(found)
