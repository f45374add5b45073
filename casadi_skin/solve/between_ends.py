"""One Newton step on a finer mesh by collocation equations between the ends of intervals alone.

Within an interval all changes X_i of values follow from that of its start x_k, of the scalars s and from residuals,

    X_i = P_i x_k + G_i s + g_i,   and so   x_(k+1) = M_k x_k + C_k s + c_k,

which is found for several intervals at a time (`condense` in interval_maps.c). What is left, with conditions, integrals
and the closing row in the same unknowns, are collocation equations with nothing between ends, (K + 1) n + m of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from casadi_skin.native import LANES, METHOD, MOST_STATES, Structure, give_back, kernels, memory_of
from casadi_skin.native.collocation import CollocationKernel
from casadi_skin.solve.bordered import ACCURATE_RESIDUAL, SINGULAR_GROWTH
from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.problem import Array, Indices

MOST_SUMS = 64  # integrals times scalars that the kernel has room for


@lru_cache(maxsize=16)
def method_of(table: CollocationTable) -> Structure | None:
    """A method whose stages are the values behind the start, for compiled kernels; None of another one."""
    if table.stages != tuple(range(1, table.degree + 1)):
        return None
    return Structure(METHOD, table.degree, *map(np.ascontiguousarray, (table.matrix, table.extended[-1])))


@dataclass(frozen=True, eq=False)
class _BetweenEnds:
    """The equations between ends.

    Attributes:
        kernel: their factors.
        order: which of the non-zeros by columns is each of those by intervals, then of conditions and of integrals.
        room: numbers that a step needs beside the factors.
    """

    kernel: CollocationKernel
    order: Indices
    room: int

    @classmethod
    def of(cls, problem: CollocationEquations) -> _BetweenEnds | None:
        """None of equations that kernels do not take."""
        of, n, K, d = problem.formulation, problem.formulation.states, problem.resolution, problem.degree
        own, m = of.integrals, problem.size - problem.states
        conditions, w = int(of.conditions.numel()), n + m + 1
        if n > MOST_STATES or own * m > MOST_SUMS or problem.equations != problem.size - 1:
            return None
        scalars, (k, i, j) = (K + 1) * n, np.indices((K, n, w))
        columns = np.where(j == 0, (k + 1) * n + i, np.where(j <= n, k * n + j - 1, scalars + j - 1 - n))
        parts: list[tuple[Indices, Indices]] = [(k * n + i, columns)]
        for (those, there), first in zip(of.patterns[1], (0, K * n, scalars), strict=True):
            parts.append((K * n + np.array(those, dtype=int), first + np.array(there, dtype=int)))
        k, i, j = np.indices((K, own, n))
        parts.append((K * n + conditions + i, k * n + j))
        i, j = np.indices((own, m))
        parts.append((K * n + conditions + i, scalars + j))
        rows, columns = (np.concatenate([each.ravel() for each in both]) for both in zip(*parts, strict=True))
        by_columns = np.lexsort((rows, columns))
        order = np.empty(rows.size, dtype=np.int64)
        order[by_columns] = np.arange(rows.size)
        pattern, size = (rows[by_columns], columns[by_columns]), scalars + m
        counts, limits = (conditions, own), (SINGULAR_GROWTH, ACCURATE_RESIDUAL)
        kernel = CollocationKernel((n, K, 1, m), counts, pattern, limits, problem.probe[: size - 1])
        found = 2 * problem.size + problem.equations + K * n * (d * n + (1 + d) * w) + rows.size + 5 * size
        of_intervals = LANES * (d * n * (d * n + n + m + 2 * w) + 2 * n * w) + (d * n) ** 2
        return cls(kernel, order, found + max(of_intervals, size))


def step_on_finer(
    problem: CollocationEquations, finer: CollocationEquations, z: Array, tangent: Array | None, least: float
) -> Array | None:
    """The solution on a finer mesh after one Newton step from z on a coarser one.

    Arguments:
        problem, finer: the coarser and the finer equations.
        z: the solution of the coarser ones.
        tangent: the way of the branch there, along which the step is brought back to the parameter; None where that is
            held.
        least: a change of the parameter on the way that is that of a fold, from which nothing is brought back.

    Returns:
        The unknowns; None where kernels do not take the equations, or find them singular.
    """
    method, equations = method_of(finer.table), finer.discretisation
    alike = problem.table is finer.table and problem.size - problem.states == finer.size - finer.states
    if not (kernels() and alike) or method is None or equations.checks is None:
        return None
    short: _BetweenEnds | None = finer.kept("between ends", lambda: _BetweenEnds.of(finer))
    if short is None:
        return None
    n, ends, weights = finer.formulation.states, finer.resolution + 1, problem.metric(z, 1.0)
    weights = np.concatenate([weights[:n] * (problem.columns / ends), weights[problem.states :]])
    given = z[None] if tangent is None else np.array([z, tangent])
    found, memory, at = np.empty(finer.size), memory_of(short.kernel.room), finer.mesh.places
    by = method, short.kernel.layout, short.order, short.order.size
    data = given, len(given), z.size, weights, least, finer.numbers, at.size, at, *finer.formulation.entries, *by
    results = memory, found, np.empty(short.room)
    failed = kernels()["collocation_newton"](equations.compiled, *problem.polynomials, *data, *results)
    give_back(memory)
    return None if failed else found
