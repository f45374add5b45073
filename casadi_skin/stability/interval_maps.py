"""Transition matrices over the intervals of a collocated solution, or over parts of these where it changes fast.

Over an interval in which a perturbation grows or decays by many factors of e the collocation equations have lost the
factor, however well they know the solution itself. Parts of intervals are then taken, in each of which nothing changes
by much more than a factor of e, with the states that the polynomials of the solution have there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import BoundaryProblem

RESOLVED = 2.0  # logarithm of the factor that a perturbation may change by in an interval
WITHIN_PART = 1.0  # the same in a part
MOST_PARTS = 20_000
MOST_WORK = 1e10  # of the linear systems of all parts: their number times the third power of their size
LARGEST_STACK = 4_000_000  # entries of the matrices that are factored in one call


def stage_places(problem: BoundaryProblem, lengths: Array) -> Array:
    """Fractions of the whole at the stages of intervals of these lengths."""
    starts = np.cumsum(lengths) - lengths
    return np.asarray((starts[:, None] + lengths[:, None] * problem.table.nodes).ravel())


def stage_jacobians(problem: BoundaryProblem, z: Array) -> Array:
    """Derivatives of the field, for an interval of unit length, at all stages, shape (intervals * degree, n, n)."""
    return problem.discretisation.jacobians(z, problem.numbers)


def jacobians_at(problem: BoundaryProblem, z: Array, places: Array, states: Array) -> Array:
    """The same at any places with the states there."""
    n, count = problem.formulation.states, places.size
    mapped = problem.formulation.jacobian_function.map(count)
    blocks = np.array(mapped(places[None], states.T, *problem.repeated(z, count)))
    return np.asarray(blocks.reshape(n, count, n).transpose(1, 0, 2))


def interval_maps(jacobians: Array, lengths: Array, table: CollocationTable) -> Array:
    """Transition matrices over intervals from derivatives at their stages, in order of time, shape (any, n, n)."""
    n, d = jacobians.shape[1], table.degree
    by_interval, maps = jacobians.reshape(-1, d, n, n), np.empty((lengths.size, n, n))
    for these in _batches(lengths.size, n * d):
        A, h = by_interval[these], lengths[these, None, None]
        stages = np.linalg.solve(_stage_systems(A, h, table), np.tile(np.eye(n), (d, 1)))
        weighted = h * (table.extended[-1][:, None, None] * A).swapaxes(1, 2).reshape(len(A), n, d * n)
        maps[these] = np.eye(n) + weighted @ stages
    return maps


def _stage_systems(A: Array, h: Array, table: CollocationTable) -> Array:
    """The matrices 1 - h a_ij A_j of the stages of several intervals, shape (intervals, d n, d n)."""
    K, d, n = A.shape[:3]
    weights = -h * table.extended[:d]
    systems = weights[:, :, None, :, None] * A.transpose(0, 2, 1, 3)[:, None]
    systems = systems.reshape(K, d * n, d * n)
    systems[:, np.arange(d * n), np.arange(d * n)] += 1.0
    return np.asarray(systems)


def _batches(intervals: int, size: int) -> Iterator[slice]:
    """Intervals of whose matrices of a size as many are made at once as memory should hold."""
    some = max(1, LARGEST_STACK // size**2)
    return (slice(k, k + some) for k in range(0, intervals, some))


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of the intervals of a solution, of whose states the first n are taken.

    Attributes:
        problem, z: the solution.
        jacobians: of these states at the stages, as `stage_jacobians` gives them.
    """

    problem: BoundaryProblem
    z: Array
    jacobians: Array

    @cached_property
    def _counts(self) -> Array:
        """The number of parts that each interval needs."""
        found = np.ceil(self._changes(np.max(np.abs(np.linalg.eigvals(self.jacobians)), axis=1)) / WITHIN_PART)
        return np.asarray(np.maximum(found, 1.0))

    @property
    def needed(self) -> bool:
        """Whether an interval is too long for the changes in it."""
        entries = np.abs(self.jacobians)
        bounds = np.minimum(np.max(np.sum(entries, axis=1), axis=1), np.max(np.sum(entries, axis=2), axis=1))
        if np.max(self._changes(bounds)) <= RESOLVED:  # of eigenvalues, which take far longer
            return False
        return bool(np.max(self._counts) * WITHIN_PART > RESOLVED)

    def _changes(self, rates: Array) -> Array:
        """Logarithms of the factors by which rates at the stages may change something in each interval."""
        return np.asarray(self.problem.constants * np.max(rates.reshape(self.problem.resolution, -1), axis=1))

    def maps(self) -> tuple[Array, Array] | None:
        """Maps over the parts, and states at their ends; None where there are too many parts."""
        problem, n = self.problem, self.jacobians.shape[1]
        if not np.sum(self._counts) <= min(MOST_PARTS, MOST_WORK / (problem.degree * n) ** 3):
            return None
        counts = self._counts.astype(int)
        lengths = np.repeat(problem.constants / counts, counts)
        places, ends = stage_places(problem, lengths), np.append(0.0, np.cumsum(lengths))
        ends[-1] = 1.0
        finer = jacobians_at(problem, self.z, places, problem.sample(self.z, places))[:, :n, :n]
        return interval_maps(finer, lengths, problem.table), problem.sample(self.z, ends)[:, :n]
