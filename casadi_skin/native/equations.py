"""Equations of collocation in odd cosines at several states by the kernel equations.c."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.polynomial import Program
from casadi_skin.native.addresses import address
from casadi_skin.native.library import library

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
INTEGER, POINTER = ctypes.c_int64, ctypes.c_void_p
OPERATIONS = (  # in the order of the kernel's
    "INPUT", "OUTPUT", "CONST", "ASSIGN", "ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE", "INV", "SQRT", "SIN", "COS",
    "TAN", "EXP", "LOG", "TANH", "POW", "EQ", "LE", "NOT", "IF_ELSE_ZERO",
)  # fmt: skip
CODES = {getattr(ca, f"OP_{name}"): code for code, name in enumerate(OPERATIONS)}
CODES[ca.OP_CONSTPOW] = CODES[ca.OP_POW]


class _Program(ctypes.Structure):
    _fields_ = (
        ("count", INTEGER),
        *((name, POINTER) for name in ("operations", "out", "first", "second", "constants")),
    )


class _Equations(ctypes.Structure):
    _fields_ = (
        *((name, INTEGER) for name in ("nodes", "sites", "slopes", "nonzeros")),
        *((name, POINTER) for name in ("second_derivative", "cosine", "amplitude", "at_zero", "constant")),
        *((name, POINTER) for name in ("at_slopes", "at_frequency", "at_parameter", "at_norm")),
        ("force", _Program),
        ("norm", _Program),
        *((name, POINTER) for name in ("work", "forces", "start")),
    )


@cache
def _function() -> Any | None:
    """That of the kernel; None without a compiler."""
    found = library("equations")
    if found is None:
        return None
    function = found.casadi_skin_equations
    function.argtypes, function.restype = [POINTER, INTEGER, *[POINTER] * 4], None
    return function


class EquationsKernel:
    """Residuals and Jacobians of one problem.

    Arguments:
        force: program of a force, the non-zeros of its derivative by the positions, and its derivative by the
            parameter, with its constants; arguments are positions, velocities, the parameter, and numbers.
        norm: that of the normalisation and its derivative by the positions.
        matrices: that of the second derivative, (nodes, nodes); the cosine at the nodes, weights of the nodes in its
            coefficient, and in a value at phase zero.
        constant: the part of the non-zeros that is constant.
        places: non-zeros that take the derivatives of the force by positions, (non-zeros, nodes), by the frequency and
            by the parameter, and those of the normalisation, (sites, nodes) each.
    """

    def __init__(
        self,
        force: tuple[Program, Array],
        norm: tuple[Program, Array],
        matrices: Sequence[Array],
        constant: Array,
        places: Sequence[Indices],
    ) -> None:
        function = _function()
        assert function is not None
        self._function, self._held = function, list[NDArray[Any]]()  # the structure holds addresses alone
        nodes, sites, slopes = matrices[1].size, force[0].inputs[0], force[0].outputs[1]
        self._shapes = sites * nodes + 1, constant.size
        room = max(force[0].work * nodes, norm[0].work), (2 * sites + slopes) * nodes + 1, sites
        scratch = [np.zeros(size) for size in room]
        self._equations = _Equations(
            nodes, sites, slopes, constant.size, *(self._at(array) for array in (*matrices, constant, *places)),
            self._program(*force), self._program(*norm), *(self._at(array) for array in scratch),
        )  # fmt: skip
        self._address = ctypes.addressof(self._equations)

    def _at(self, array: NDArray[Any]) -> int:
        self._held.append(np.ascontiguousarray(array))
        return address(self._held[-1])

    def _program(self, program: Program, constants: Array) -> _Program:
        """The instructions with their constants, and places of results counted through all of them."""
        first_of = np.cumsum([0, *program.outputs]).tolist()
        rows, used = [], 0
        for operation, out, into in program.instructions:
            if operation == ca.OP_OUTPUT:
                row = first_of[out[0]] + out[1], into[0], 0
            elif operation == ca.OP_CONST:
                row, used = (out[0], used, 0), used + 1
            else:
                row = out[0], into[0], into[-1]
            rows.append((CODES[operation], *row))
        columns = np.array(rows, dtype=np.int32).reshape(-1, 4).T
        return _Program(len(rows), *(self._at(column) for column in columns), self._at(constants))

    def __call__(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        """Residuals (states, unknowns - 1) and non-zeros (states, non-zeros) at states (states, unknowns)."""
        count, (equations, nonzeros) = len(z), self._shapes
        found = np.empty((count, equations)), np.empty((count, nonzeros))
        arrays = np.ascontiguousarray(z), np.ascontiguousarray(numbers), *found
        assert arrays[0].shape == (count, equations + 1)
        self._function(self._address, count, *(address(array) for array in arrays))
        return found


def has_kernel(*programs: Program) -> bool:
    """Whether there is a compiler, and all operations of these programs are among the kernel's."""
    every = {operation for program in programs for operation, _, _ in program.instructions}
    return every <= CODES.keys() and _function() is not None
