"""Orbits of one section of a branch by Newton's method, with row . z held: one by one, or several in arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.series import STACKED_UNKNOWNS
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.stability.tongues.interpolation import OrbitNotFoundError
from casadi_skin.zero.problem import Array, Problem, SingularError, Solve

NEWTON_STEPS = 6  # of Newton's method
SOLVED_STEP = 1e-8  # a step of Newton's method whose square is round-off


@dataclass(frozen=True)
class SectionOrbit:
    """An orbit z, its derivative `along` by row . z, and its `response` to residuals of size 1 in general position."""

    z: Array
    along: Array
    response: Array

    @classmethod
    def of(cls, problem: Problem, z: Array, solve: Solve) -> SectionOrbit:
        """By the solver closed by the row."""
        columns = np.zeros((problem.size, 2))
        columns[-1, 0], columns[:-1, 1] = 1.0, problem.probe
        return cls(z, *np.ascontiguousarray(solve(columns).T))


def find_one(
    point_solver: PointSolver, problem: Problem, guess: Array, row: Array, allowed: float = np.inf
) -> tuple[Array, Solve]:
    """The orbit near a guess that has row . z in common with it, and the solver there.

    Raises OrbitNotFoundError where there is none within `allowed`, in the metric.
    """
    z, value = guess.copy(), float(row @ guess)
    weights = point_solver.metric(problem, guess)
    try:
        for _ in range(NEWTON_STEPS):
            residual, nonzeros = problem.evaluate(z)
            solve = point_solver.levels.solver(problem).factor(z, nonzeros, row)
            step = solve(np.append(residual, row @ z - value))
            z = z - step
            size = float(np.sqrt(np.sum(weights * step**2)))
            if size <= SOLVED_STEP:
                break
            if not size <= 1.0:
                raise OrbitNotFoundError(f"no orbit is found near {problem.whereabouts(guess)}")
    except SingularError as error:
        raise OrbitNotFoundError(str(error)) from error
    moved = float(np.sqrt(np.sum(weights * (z - guess) ** 2)))
    if size > SOLVED_STEP or moved > allowed:
        raise OrbitNotFoundError(f"no orbit is found near {problem.whereabouts(guess)}")
    return z, solve


def find_all(
    point_solver: PointSolver, problem: Problem, guesses: Array, row: Array, allowed: Array
) -> list[SectionOrbit | None]:
    """As `find_one` from several guesses, (guesses, unknowns); None where one has to be sought by itself."""
    found: list[SectionOrbit | None] = [None] * len(guesses)
    solver = BorderedSolver.of(problem)
    if problem.size > STACKED_UNKNOWNS or not solver.takes_several:
        return found
    z, values, active = guesses.copy(), guesses @ row, np.arange(len(guesses))
    weights = point_solver.metrics(problem, guesses)
    for _ in range(NEWTON_STEPS):
        here, rows = z[active], np.tile(row, (active.size, 1))
        try:
            residuals, nonzeros = problem.evaluate_all(here)
        except (ArithmeticError, RuntimeError):  # those that fail do so again by themselves
            return found
        steps = solver.steps(here, np.column_stack([residuals, here @ row - values[active]]), nonzeros, rows)
        if steps is None:
            return found
        z[active] = here - steps.newton
        sizes = np.sqrt(np.sum(weights[active] * steps.newton**2, axis=1))
        moved = np.sqrt(np.sum(weights[active] * (z[active] - guesses[active]) ** 2, axis=1))
        for n in np.flatnonzero((sizes <= SOLVED_STEP) & (moved <= allowed[active])).tolist():
            i = int(active[n])
            found[i] = SectionOrbit(z[i], steps.along[n], steps.response[n])
        active = active[(sizes > SOLVED_STEP) & (sizes <= 1.0)]
        if not active.size:
            break
    return found
