"""Functions that call programs, as those of FMUs, at many places: each call of a program takes all places at once.

    F(a) = after(a, y_1, ..., y_k),    y_i = program_i(before_i(a, y_1, ..., y_(i-1)))

`before` and `after` are of elementary operations; arguments and results have one row a place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Protocol

import casadi as ca
import numpy as np

from casadi_skin.model.operations import operated
from casadi_skin.native import Array
from casadi_skin.native.places import Buffers


class Program(Protocol):
    """A function of CasADi, told by its hash, that takes many places in one call."""

    def __hash__(self) -> int: ...

    def at_places(self, given: Sequence[Array], wanted: Sequence[bool]) -> list[Array]:
        """The non-zeros of the results at places, one a row; any numbers where they are not wanted."""


@dataclass(eq=False)
class Call:
    """A call of a program with its arguments, and results as symbols; `wanted` are those in use."""

    program: Program
    arguments: list[ca.SX]
    results: list[ca.SX]
    wanted: list[bool]
    before: ca.Function


@dataclass(frozen=True, eq=False)
class Calls:
    """A function as calls of programs, one after the other, and what comes after them."""

    calls: list[Call]
    after: ca.Function

    @classmethod
    def of(cls, function: ca.Function, programs: Sequence[Program]) -> Calls | None:
        """None where it calls something else, or none of the programs."""
        known = {hash(program): program for program in programs}
        if function.is_a("SXFunction") or not known:
            return None
        try:
            function = function.expand()
        except RuntimeError:  # of a node that has no scalar operations
            return None
        symbols, calls = function.sx_in(), list[Call]()
        work = dict[int, ca.SX]()  # the expression in each place of the function's own
        found = [ca.SX(function.sparsity_out(i)) for i in range(function.n_out())]
        for k, expression in enumerate(function.instructions_sx().elements()):
            code, given, out = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
            if code == ca.OP_INPUT:
                work[out[0]] = symbols[given[0]].nz[given[1]]
            elif code == ca.OP_CONST:
                work[out[0]] = ca.SX(function.instruction_constant(k))
            elif code == ca.OP_OUTPUT:
                found[out[0]].nz[out[1]] = work[given[0]]
            elif code != ca.OP_CALL:
                work[out[0]] = operated(code, [work[place] for place in given])
            else:
                called = expression.which_function()
                if hash(called) not in known:
                    return None
                call = _call(called, known[hash(called)], [work[place] for place in given], symbols, calls)
                results = ca.vertcat(*call.results).elements()
                work.update((place, result) for place, result in zip(out, results, strict=True) if place >= 0)
                used = np.split(np.array(out) >= 0, np.cumsum([result.numel() for result in call.results])[:-1])
                call.wanted = [bool(before or np.any(now)) for before, now in zip(call.wanted, used, strict=True)]
        return cls(calls, ca.Function("after", symbols, found)) if calls else None


def _call(called: ca.Function, program: Program, given: list[ca.SX], symbols: list[ca.SX], calls: list[Call]) -> Call:
    """One of the calls, with these arguments, that is there already or goes to them, and its results to the symbols."""
    for call in calls:
        if call.program is program and all(map(ca.is_equal, call.arguments, given)):
            return call
    entries = iter(given)
    before = [ca.vertcat(*islice(entries, called.nnz_in(i))) for i in range(called.n_in())]
    results = [ca.SX.sym("y", called.nnz_out(i)) for i in range(called.n_out())]
    call = Call(program, given, results, [False] * len(results), ca.Function("before", symbols, before))
    calls.append(call)
    symbols += results
    return call


def buffers(function: ca.Function, count: int, programs: Sequence[Program]) -> Buffers:
    """A function at so many places; each of the programs that it calls takes all of them at once."""
    calls = Calls.of(function, programs)
    return Buffers(function, count) if calls is None else CallingBuffers(calls, count)


class CallingBuffers(Buffers):
    """These of a function that calls programs; for other kernels it is none of operations."""

    def __init__(self, of: Calls, count: int) -> None:
        self._calls = [(call, Buffers(call.before, count)) for call in of.calls]
        self._after, self._count, self.places = Buffers(of.after, count), count, None
        self.results = self._after.results

    def __call__(self, *arguments: Array | float) -> list[Array]:
        found = list[Array]()
        for call, before in self._calls:
            given = [part.reshape(self._count, -1) for part in before(*arguments, *found)]
            found += call.program.at_places(given, call.wanted)
        return self._after(*arguments, *found)
