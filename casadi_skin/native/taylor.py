"""Power series of a branch by the kernel taylor.c."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native.addresses import address
from casadi_skin.native.library import library

Array = NDArray[np.float64]
Term = tuple[int, int, float, Sequence[int]]  # power of the parameter, row, coefficient, states
INTEGER, POINTER = ctypes.c_int64, ctypes.c_void_p


class _Terms(ctypes.Structure):
    _fields_ = (
        ("count", INTEGER),
        *((name, POINTER) for name in ("powers", "degrees", "rows", "first_factors", "factors", "first_products")),
        ("coefficients", POINTER),
        ("products", POINTER),
    )


class _Series(ctypes.Structure):
    _fields_ = (
        *((name, INTEGER) for name in ("nodes", "sites", "orders", "size", "highest")),
        *((name, POINTER) for name in ("second_derivative", "at_zero", "unknowns", "curvature", "start", "powers")),
        *((name, POINTER) for name in ("squared", "right")),
        ("force", _Terms),
        ("norm", _Terms),
    )


@cache
def _functions() -> tuple[Any, Any, Any] | None:
    """Those that take over an order, give the right-hand side of one, and solve all; None without a compiler."""
    found = library("taylor")
    if found is None:
        return None
    for function in (found.casadi_skin_taylor_put, found.casadi_skin_taylor_right):
        function.argtypes, function.restype = [ctypes.POINTER(_Series), INTEGER], None
    every = found.casadi_skin_taylor_series
    every.argtypes, every.restype = [ctypes.POINTER(_Series), *[POINTER] * 3], None
    return found.casadi_skin_taylor_put, found.casadi_skin_taylor_right, every


class TaylorKernel:
    """Orders of a series in turn: `unknowns` has shape (orders + 1, sites * nodes + 2), Omega and parameter last.

    Arguments:
        unknowns: the array that orders are put into.
        second_derivative: matrix of d^2/dtheta^2 on the values at the nodes.
        at_zero: weights of the values at the nodes in that at phase zero.
        force: terms of the right-hand side.
        norm: terms of the normalisation, of the states at phase zero.
    """

    def __init__(
        self,
        unknowns: Array,
        second_derivative: Array,
        at_zero: Array,
        force: Sequence[Term],
        norm: Sequence[Term],
    ) -> None:
        functions = _functions()
        assert functions is not None
        self._put, self._right, self._every = functions
        orders, size = unknowns.shape
        nodes = at_zero.size
        sites, highest = (size - 2) // nodes, max((term[0] for term in (*force, *norm)), default=0)
        shapes = ((orders, sites * nodes), (orders, sites), (max(highest, 1) + 1, orders), (orders,), (size,))
        self._held: list[NDArray[Any]] = []  # the structure holds addresses alone
        made = [np.zeros(shape) for shape in shapes]
        self.unknowns, self._right_side = unknowns, made[-1]
        arrays = [self._at(array) for array in (second_derivative, at_zero, unknowns, *made)]
        parts = self._terms(force, orders, nodes), self._terms(norm, orders, 1)
        self._series = _Series(nodes, sites, orders - 1, size, max(highest, 1), *arrays, *parts)
        self._address = ctypes.byref(self._series)

    def _at(self, array: NDArray[Any]) -> int:
        assert array.flags.c_contiguous
        self._held.append(array)
        return address(array)

    def _terms(self, terms: Sequence[Term], orders: int, length: int) -> _Terms:
        degrees = [len(term[3]) for term in terms]
        products = np.cumsum([0, *(max(degree - 1, 0) * orders * length for degree in degrees)])
        lists = (
            [term[0] for term in terms],
            degrees,
            [term[1] for term in terms],
            np.cumsum([0, *degrees])[:-1],
            [state for term in terms for state in term[3]],
            products[:-1],
        )
        integers = [self._at(np.array(values, dtype=np.int64)) for values in lists]
        coefficients = np.array([term[2] for term in terms], dtype=float)
        return _Terms(len(terms), *integers, self._at(coefficients), self._at(np.zeros(int(products[-1]))))

    def put(self, k: int, z: Array) -> None:
        """Take over order k and complete what depends on it."""
        self.unknowns[k] = z
        self._put(self._address, k)

    def right_side(self, k: int) -> Array:
        """Right-hand side of order k, shape (size,); its array is used again."""
        self._right(self._address, k)
        return self._right_side

    def solve_all(self, solve: int, layout: int, factors: int) -> None:
        """All orders beyond the first two, by a compiled solver at these addresses, see `native.bordered`."""
        self._every(self._address, solve, layout, factors)


def taylor_kernel(
    unknowns: Array, second_derivative: Array, at_zero: Array, force: Sequence[Term], norm: Sequence[Term]
) -> TaylorKernel | None:
    """A kernel, see `TaylorKernel`; None without a compiler."""
    return None if _functions() is None else TaylorKernel(unknowns, second_derivative, at_zero, force, norm)
