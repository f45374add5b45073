"""Jacobians of polynomial right-hand sides along orbits by the kernel jacobian.c."""

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
Term = tuple[int, int, float, Sequence[int]]  # power of the parameter, non-zero, coefficient, states
INTEGER, POINTER = ctypes.c_int64, ctypes.c_void_p


class _Terms(ctypes.Structure):
    _fields_ = (
        ("count", INTEGER),
        *((name, POINTER) for name in ("powers", "degrees", "places", "first_factors", "factors")),
        ("coefficients", POINTER),
    )


@cache
def _function() -> Any | None:
    """That of the kernel; None without a compiler."""
    found = library("jacobian")
    if found is None:
        return None
    function = found.casadi_skin_jacobians
    integers, pointers = [INTEGER] * 4, [POINTER] * 5
    function.argtypes = [*integers, POINTER, INTEGER, POINTER, POINTER, INTEGER, *pointers]
    function.restype = None
    return function


class Orbits(ctypes.Structure):
    """The kernel's arguments for one orbit at a time, as other kernels take them."""

    _fields_ = (
        ("function", POINTER),
        *((name, INTEGER) for name in ("sites", "nodes", "phases", "stride")),
        *((name, POINTER) for name in ("values", "weights", "parameters", "constant", "terms")),
        *((name, POINTER) for name in ("states", "products", "found")),
    )
    held: tuple[NDArray[Any], ...]  # the structure holds addresses alone


class JacobianKernel:
    """Non-zeros of J, `constant` and the terms that depend on states and parameter."""

    def __init__(self, constant: Array, terms: Sequence[Term]) -> None:
        function = _function()
        assert function is not None
        self._function = function
        self._function_address = int(ctypes.cast(function, POINTER).value or 0)
        degrees = [len(term[3]) for term in terms]
        lists = (
            [term[0] for term in terms],
            degrees,
            [term[1] for term in terms],
            np.cumsum([0, *degrees])[:-1],
            [state for term in terms for state in term[3]],
        )
        # The structure holds addresses alone.
        self._held: list[NDArray[Any]] = [np.array(values, dtype=np.int64) for values in lists]
        self._held += [np.array([term[2] for term in terms], dtype=float), np.ascontiguousarray(constant)]
        self._terms = _Terms(len(terms), *(address(array) for array in self._held[:-1]))

    def __call__(self, sites: int, values: Array, weights: Array, parameters: Array, result: Array) -> None:
        """Fill (orbits, phases, non-zeros) from values at nodes, (orbits, sites * nodes or more), times `weights`.

        These have shape (nodes, phases); `parameters` has the parameter of each orbit.
        """
        nodes, phases = weights.shape
        values, parameters = np.ascontiguousarray(values), np.ascontiguousarray(parameters)
        assert weights.flags.c_contiguous
        assert result.flags.c_contiguous
        assert result.shape == (len(values), phases, self._held[-1].size)
        assert values.shape[1] >= sites * nodes
        assert parameters.shape == (len(values),)
        scratch = np.empty((sites + 1) * phases)
        data = [address(array) for array in (values, weights, parameters, self._held[-1], scratch, result)]
        self._function(
            len(values), sites, nodes, phases, data[0], values.shape[1], data[1], data[2], self._held[-1].size,
            data[3], ctypes.addressof(self._terms), data[4], data[4] + 8 * sites * phases, data[5],
        )  # fmt: skip

    def orbits(self, sites: int, values: Array, weights: Array, parameters: Array) -> Orbits:
        """Arguments of a call for each of several orbits, see `__call__`, with room for one result."""
        (nodes, phases), constant = weights.shape, self._held[-1]
        room = np.empty((sites + 1 + constant.size) * phases)
        held = np.ascontiguousarray(values), weights, np.ascontiguousarray(parameters), constant
        assert weights.flags.c_contiguous
        assert values.shape[1] >= sites * nodes
        assert parameters.shape == (len(values),)
        *at, first = (address(array) for array in (*held, room))
        places = first, first + 8 * sites * phases, first + 8 * (sites + 1) * phases
        found = Orbits(
            self._function_address, sites, nodes, phases, values.shape[1], *at,
            ctypes.addressof(self._terms), *places,
        )  # fmt: skip
        found.held = (*held, room)
        return found


def jacobian_kernel(constant: Array, terms: Sequence[Term]) -> JacobianKernel | None:
    """A kernel, see `JacobianKernel`; None without a compiler."""
    return None if _function() is None else JacobianKernel(constant, terms)
