"""Newton steps from places of a stretch of series: one by one, or all those of a stretch in arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.point_solver import PointSolver
from casadi_skin.follow.settings import Target
from casadi_skin.follow.taylor import Stretch
from casadi_skin.solve.estimates import Measured
from casadi_skin.solve.stacked import StackedSolver, Steps
from casadi_skin.zero.orbit_problem import OrbitProblem
from casadi_skin.zero.problem import Array, Problem

FAINT = 1e-7  # of the largest state: its square is round-off
STACKED = 1000  # unknowns up to which arrays over the places of a stretch stay in the cache of a core


@dataclass(frozen=True)
class Guesses:
    """Places of a stretch, (places, unknowns) each, with what is held there, and the metric.

    In the series small components, as those in the tail of a breather, have the absolute precision of large ones. They
    are left out of the guess, so that the step solves for them and finds them accurate relative to themselves. They are
    small in the output too: amplitudes that grow into a tail in the gauge are no reason to leave out the edge.
    """

    z: Array
    weights: Array
    rows: Array
    values: Array
    targets: Sequence[Target | None]

    @classmethod
    def of(
        cls,
        point_solver: PointSolver,
        problem: Problem,
        stretch: Stretch,
        taus: Sequence[float],
        targets: Sequence[Target | None],
    ) -> Guesses:
        """Those at places `taus` of a stretch: at a target its value is held, else the place along the tangent."""
        z, slopes = stretch.at_each(np.array(taus))
        weights = point_solver.metrics(problem, z)
        rows = weights * slopes / np.sqrt(np.sum(weights * slopes**2, axis=1))[:, None]
        values = np.einsum("ij,ij->i", rows, z)
        for i, target in enumerate(targets):
            if target is not None:
                index, wanted = target.unknown(problem)
                rows[i] = problem.row_of(target.held) * float(np.sign(slopes[i, index]))
                values[i] = wanted * rows[i, index]
        states = z[:, : problem.states]  # a view
        faint, scale = _is_faint(states), problem.output_scale if isinstance(problem, OrbitProblem) else None
        states[faint if scale is None else faint & _is_faint(scale * states)] = 0.0
        return cls(z, weights, rows, values, targets)


def _is_faint(states: Array) -> NDArray[np.bool_]:
    sizes = np.abs(states)
    return np.asarray(sizes < FAINT * np.max(sizes, axis=1)[:, None])


@dataclass(frozen=True)
class Polished:
    """A place after a Newton step of length `step`, with its unit tangent and the sign of the determinant.

    `row` and `value` are what was held; `measured` is the error where that has been estimated.
    """

    z: Array
    tangent: Array
    orientation: float
    step: float
    row: Array
    value: float
    measured: Measured | None = None


def polished(point_solver: PointSolver, problem: Problem, guesses: Guesses) -> Polished:
    """The first place after a Newton step; raises SingularError."""
    guess, weights, row, value = guesses.z[0], guesses.weights[0], guesses.rows[0], float(guesses.values[0])
    residual, nonzeros = problem.evaluate(guess)
    solve = point_solver.levels.solver(problem).factor(guess, nonzeros, row)
    step = solve(np.append(residual, row @ guess - value))
    length, tangent = float(np.sqrt(np.sum(weights * step**2))), point_solver.tangent(problem, guess, solve)
    return Polished(guess - step, tangent, solve.orientation, length, row, value)


def all_polished(point_solver: PointSolver, problem: Problem, guesses: Guesses) -> list[Polished] | None:
    """All places after a Newton step, with their errors; None where they have to be polished one by one."""
    stack = StackedSolver.of(problem) if problem.size <= STACKED else None
    if stack is None:
        return None
    try:
        residuals, nonzeros = problem.evaluate_all(guesses.z)
        defects = np.einsum("ij,ij->i", guesses.rows, guesses.z) - guesses.values
        steps = stack.steps(guesses.z, np.column_stack([residuals, defects]), nonzeros, guesses.rows)
        return None if steps is None else _after(point_solver, problem, guesses, steps)
    except (ArithmeticError, RuntimeError):  # at a place that the walk may not come to; if it does, they come again
        return None


def _after(point_solver: PointSolver, problem: Problem, guesses: Guesses, steps: Steps) -> list[Polished]:
    """The places after their steps, with their errors."""
    z = guesses.z - steps.newton
    lengths = np.sqrt(np.sum(guesses.weights * steps.newton**2, axis=1))
    tangents = steps.along / np.sqrt(np.sum(guesses.weights * steps.along**2, axis=1))[:, None]
    for one, target in zip(z, guesses.targets, strict=True):
        if target is not None:
            index, wanted = target.unknown(problem)
            one[index] = wanted  # equal but for round-off of the held row
    held = [None if target is None else target.held for target in guesses.targets]
    measured = point_solver.levels.all_refined(problem, z, tangents, held)
    known = measured if measured is not None else [None] * len(z)
    columns = z, tangents, steps.orientation.tolist(), lengths.tolist(), guesses.rows, guesses.values.tolist(), known
    return [Polished(*place) for place in zip(*columns, strict=True)]
