"""Power series of a branch whose linear tail is eliminated by the kernel tail.c, as a solver for that of its core."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from numpy.typing import NDArray

from casadi_skin.native.addresses import address
from casadi_skin.native.library import library

INTEGER, POINTER = ctypes.c_int64, ctypes.c_void_p
SIZES = ("order", "orders", "nodes", "size", "first", "place", "touched", "own_Omega")
ARRAYS = ("columns", "by_u", "transform", "block", "by_Omega", "along", "powers", "balance", "site", "found")


class _Tail(ctypes.Structure):
    _fields_ = (
        *((name, POINTER) for name in ("solve", "layout")),
        *((name, INTEGER) for name in SIZES),
        *((name, POINTER) for name in ARRAYS),
        ("bond", ctypes.c_double),
    )


@cache
def _function() -> Any:
    """The solver; None without a compiler."""
    found = library("tail")
    return None if found is None else found.casadi_skin_tail_solve


class TailKernel:
    """A solver for the orders of a core in turn, by one for the equations with the tail at addresses `compiled`.

    Arguments:
        compiled: addresses of that solver, its layout and its factors.
        sizes: the first order to be solved, the highest, numbers of nodes and of unknowns, the first row of the
            attached site, the place of u, the number of columns of the block, and the place of Omega among these.
        arrays: by name as in tail.c; those by order are written to.
        bond: strength of the bond to the tail over Omega^2.
    """

    def __init__(
        self, compiled: Sequence[int], sizes: Sequence[int], arrays: Mapping[str, NDArray[Any]], bond: float
    ) -> None:
        self._held = [arrays[name] for name in ARRAYS]  # the structure holds addresses alone
        assert all(array.flags.c_contiguous for array in self._held)
        at = [address(array) for array in self._held]
        self._structure = _Tail(*compiled[:2], *sizes, *at, bond)
        solve = int(ctypes.cast(_function(), POINTER).value or 0)
        self.addresses = solve, ctypes.addressof(self._structure), compiled[2]


def has_tail_kernel() -> bool:
    """Whether there is a kernel: there is none without a compiler."""
    return _function() is not None
