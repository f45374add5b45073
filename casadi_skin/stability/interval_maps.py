"""Transition matrices over the intervals of a collocated solution, or over parts of these where it changes fast.

Over an interval in which a perturbation grows or decays by many factors of e the collocation equations have lost the
factor, however well they know the solution itself. Parts of intervals are then taken, in each of which nothing changes
by much more than a factor of e, with the states that the polynomials of the solution have there.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.stated_problem import BoundaryProblem

SLOWEST = 1e-6  # of the fastest motion along an orbit: slower, its direction is not known well
RESOLVED = 2.0  # logarithm of the factor that a perturbation may change by in an interval
WITHIN_PART = 1.0  # the same in a part
MOST_PARTS = 20_000
MOST_WORK = 1e10  # of the linear systems of all parts: their number times the third power of their size


def stage_places(problem: BoundaryProblem, lengths: Array) -> Array:
    """Fractions of the whole at the stages of intervals of these lengths."""
    starts = np.cumsum(lengths) - lengths
    return np.asarray((starts[:, None] + lengths[:, None] * problem.table.nodes).ravel())


def stage_jacobians(problem: BoundaryProblem, z: Array) -> Array:
    """Derivatives of the field, for an interval of unit length, at all stages, shape (intervals * degree, n, n)."""
    values = z[: problem.states].reshape(problem.columns, problem.formulation.states)
    return jacobians_at(problem, z, stage_places(problem, problem.constants), values[problem.stages])


def jacobians_at(problem: BoundaryProblem, z: Array, places: Array, states: Array) -> Array:
    """The same at other places with the states there."""
    n, count = problem.formulation.states, places.size
    field = problem.formulation.field_function
    arguments = field.sx_in() if field.is_a("SXFunction") else field.mx_in()
    by_states = ca.Function("J", arguments, [ca.densify(field.call(arguments, True, False)[1])])
    blocks = np.array(by_states.map(count)(places[None], states.T, *problem.repeated(z, count)))
    return np.asarray(blocks.reshape(n, count, n).transpose(1, 0, 2))


def interval_maps(problem: BoundaryProblem, jacobians: Array, lengths: Array | None = None) -> Array:
    """Transition matrices over the intervals, or over parts of other lengths, in order of time, shape (any, n, n)."""
    n, d, extended = jacobians.shape[1], problem.degree, problem.table.extended
    h = problem.constants if lengths is None else lengths
    maps = np.empty((h.size, n, n))
    for k in range(h.size):
        blocks = jacobians[k * d : (k + 1) * d]
        system = np.eye(n * d) - h[k] * np.einsum("ij,jab->iajb", extended[:d], blocks).reshape(n * d, n * d)
        stages = np.linalg.solve(system, np.tile(np.eye(n), (d, 1))).reshape(d, n, n)
        maps[k] = np.eye(n) + h[k] * np.einsum("j,jab,jbc->ac", extended[-1], blocks, stages)
    return maps


@dataclass(frozen=True, eq=False)
class Parts:
    """Parts of the intervals of a solution, of whose states the first n are taken.

    Attributes:
        problem, z: the solution.
        jacobians: of these states at the stages, as `stage_jacobians` gives them.
        back: a map that follows those over the intervals; None where there is none.
    """

    problem: BoundaryProblem
    z: Array
    jacobians: Array
    back: Array | None = None

    @cached_property
    def _counts(self) -> Array:
        """The number of parts that each interval needs."""
        rates = np.max(np.abs(np.linalg.eigvals(self.jacobians)), axis=1).reshape(self.problem.resolution, -1)
        found = np.ceil(self.problem.constants * np.max(rates, axis=1) / WITHIN_PART)
        return np.asarray(np.maximum(found, 1.0))

    @property
    def needed(self) -> bool:
        """Whether an interval is too long for the changes in it."""
        return bool(np.max(self._counts) * WITHIN_PART > RESOLVED)

    def maps(self) -> tuple[Array, Array | None] | None:
        """Maps over the parts, and velocities at their ends where it moves; None where there are too many parts."""
        problem, n = self.problem, self.jacobians.shape[1]
        if not np.sum(self._counts) <= min(MOST_PARTS, MOST_WORK / (problem.degree * n) ** 3):
            return None
        counts = self._counts.astype(int)
        lengths = np.repeat(problem.constants / counts, counts)
        places, ends = stage_places(problem, lengths), np.append(0.0, np.cumsum(lengths))
        ends[-1] = 1.0
        finer = jacobians_at(problem, self.z, places, problem.sample(self.z, places))[:, :n, :n]
        found = interval_maps(problem, finer, lengths)
        if self.back is not None:
            return np.concatenate([found, self.back[None]]), None
        return found, velocities_at(problem, self.z, n, ends)


def velocities_at(problem: BoundaryProblem, z: Array, n: int, places: Array | None = None) -> Array | None:
    """Derivatives of the first n states at places, or at the ends of the intervals, one a row; None where one rests."""
    if places is None:
        columns = np.arange(problem.resolution + 1) * problem.table.ends.size
        places, x = problem._fractions()[columns], z[: problem.states].reshape(problem.columns, -1)[columns]
    else:
        x = problem.sample(z, places)
    mapped = problem.formulation.field_function.map(places.size)
    field = mapped(places[None], x.T, *problem.repeated(z, places.size))
    return moving(np.array(field[0]).T[:, :n], x[:, :n])


def moving(along: Array, x: Array) -> Array | None:
    """Derivatives along an orbit over its states, where it moves at all of them."""
    speeds = np.linalg.norm(along, axis=1)
    moves = np.min(speeds) > SLOWEST * np.max(speeds) and np.max(speeds) > SLOWEST * np.max(np.abs(x))
    return along if moves else None
