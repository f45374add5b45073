"""Functions at many places by the compiled kernel, each operation on a list of numbers: places.c, program.c."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache, partial

import casadi as ca
import numpy as np

from casadi_skin.model.operations import read
from casadi_skin.native import KINDS, PROGRAM, Array, Indices, Structure, address, kernels

PLACES = "iiii" + "aaaaa"
RESTS = "ii" + "aaaa"
TOGETHER = 32  # places whose numbers go through all operations together: of a hundred operations they stay in a cache


@lru_cache(maxsize=64)
def _listed(function: ca.Function, together: int) -> tuple[Indices, Indices, Array] | None:
    """Operations on lists, where the results are, and first values; None where an operation is not among KINDS."""
    if not function.is_a("SXFunction"):
        return None
    program, numbers = read(function)
    first, values = sum(program.inputs), np.zeros((sum(program.inputs) + len(program.operations), together))
    results = [entry for entries in program.results for entry in entries if entry is not None]
    if any(code not in KINDS for code, *_ in program.operations):
        return None
    lists, following = list[tuple[int, ...]](), iter(numbers)
    for k, (code, *places) in enumerate(program.operations, start=first):
        if code == ca.OP_CONST:
            values[k] = next(following)
        else:
            at, one, other = (together * place for place in (k, places[0], places[-1]))
            lists.append((KINDS[code], together, at, one, 1, other, 1))
    return np.array(lists, dtype=np.int64).reshape(-1, 7), together * np.array(results, dtype=np.int64), values


def rests(function: Structure, states: int, pattern: tuple[Indices, Indices]) -> Structure:
    """Equations of a model at rest, a `function` at several places, as rests.c takes them.

    `pattern` is that of the derivatives by the states and the parameter.
    """
    return Structure(RESTS, states, pattern[0].size, function, *pattern, np.empty(2 * (states + 1) * (states + 8)))


def at_places(
    function: ca.Function, arguments: Sequence[Array], results: Sequence[Array], count: int
) -> Structure | None:
    """The function at `count` places, as kernels take it; None without them, and of one that is not of operations.

    Arguments and results are arrays that it reads and writes, shape (count, entries) each.
    """
    together = min(count, TOGETHER)
    listed = _listed(function, together) if kernels() else None
    if listed is None:
        return None
    sizes = [np.array([array.size // count for array in arrays], dtype=np.int64) for arrays in (arguments, results)]
    if listed[1].size != np.sum(sizes[1]):
        return None
    addresses = [np.array([address(array) for array in arrays], dtype=np.int64) for arrays in (arguments, results)]
    program = Structure(PROGRAM, 0, 0, len(listed[0]), *listed)
    return Structure(PLACES, count, together, len(arguments), len(results), program, *sizes, *addresses)


class Buffers:
    """Calls of a compiled function without conversions: arguments and results live in arrays given to it once.

    At several places, `count` of them, every argument has a row for each, or one for all of them, and results follow
    one another. The arrays of the `results` are the same for all calls. `places` is the function as other kernels take
    it, asked for where there are several places, or by `listed`; None where there are none or it is not of operations.
    """

    def __init__(self, function: ca.Function, count: int = 1, listed: bool = False) -> None:
        self._arguments = [np.zeros((count, function.nnz_in(i))) for i in range(function.n_in())]
        self.results = [np.zeros(count * function.nnz_out(i)) for i in range(function.n_out())]
        asked = listed or count > 1
        self.places = at_places(function, self._arguments, self.results, count) if asked else None
        if self.places is not None:
            self._trigger = partial(kernels()["at_places"], self.places)
            return
        self._buffer, self._trigger = (function.map(count) if count > 1 else function).buffer()
        for i, argument in enumerate(self._arguments):
            self._buffer.set_arg(i, argument.data)
        for i, result in enumerate(self.results):
            self._buffer.set_res(i, result.data)

    def __call__(self, *arguments: Array | float) -> list[Array]:
        """The results, non-zeros by columns; they are overwritten by the next call."""
        for own, given in zip(self._arguments, arguments, strict=True):
            own[:] = given
        self._trigger()
        return self.results
