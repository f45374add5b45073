"""Expressions with their numbers as symbols: models that differ in numbers alone share functions.

A scan of a parameter solves the same equations with other numbers in them. Their instructions, without the numbers, are
the key under which compiled functions and solvers are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Instruction = tuple[int, tuple[int, ...], tuple[int, ...]]  # operation, outputs, inputs


@dataclass(frozen=True)
class Program:
    """The instructions of a function of scalars, without the numbers in it.

    `inputs` and `outputs` count the elements of each argument and result, `numbers` those that were taken out, and
    `work` the places for values in between.
    """

    inputs: tuple[int, ...]
    numbers: int
    outputs: tuple[int, ...]
    work: int
    instructions: tuple[Instruction, ...]

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Taken once: instructions are many."""
        return hash((self.inputs, self.numbers, self.outputs, self.work, self.instructions))

    def expressions(self, inputs: Sequence[ca.SX], numbers: ca.SX) -> list[ca.SX]:
        """The results as columns of expressions in arguments, and in symbols that stand for the numbers."""
        work: list[ca.SX] = [ca.SX(0)] * self.work
        results = [[ca.SX(0)] * count for count in self.outputs]
        used = 0
        for operation, out, into in self.instructions:
            if operation == ca.OP_INPUT:
                work[out[0]] = inputs[into[0]][into[1]]
            elif operation == ca.OP_OUTPUT:
                results[out[0]][out[1]] = work[into[0]]
            elif operation == ca.OP_CONST:
                work[out[0]] = numbers[used]
                used += 1
            elif len(into) == 1:
                work[out[0]] = ca.SX.unary(operation, work[into[0]])
            else:
                work[out[0]] = ca.SX.binary(operation, work[into[0]], work[into[1]])
        return [ca.vertcat(*entries) for entries in results]


def lifted(inputs: Sequence[ca.SX], results: Sequence[ca.SX], most: int) -> tuple[Program, Array] | None:
    """The program of dense columns, and its numbers; None where it has more than `most` instructions."""
    function = ca.Function("lifted", list(inputs), [ca.densify(result) for result in results])
    if function.n_instructions() > most:
        return None
    instructions: list[Instruction] = []
    numbers: list[float] = []
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        if operation == ca.OP_CONST:
            numbers.append(function.instruction_constant(k))
            into: tuple[int, ...] = ()
        else:
            into = tuple(function.instruction_input(k))
        instructions.append((operation, tuple(function.instruction_output(k)), into))
    sizes = tuple(function.nnz_in(i) for i in range(len(inputs))), len(numbers), tuple(int(r.numel()) for r in results)
    return Program(*sizes, int(function.sz_w()), tuple(instructions)), np.array(numbers)
