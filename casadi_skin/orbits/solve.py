"""Solving a stated boundary-value problem: a mesh that adapts until the estimated error meets the tolerance."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from casadi_skin.arguments import number, short_repr
from casadi_skin.bvp.butcher import gauss_table, radau_table
from casadi_skin.bvp.problem import Array, Problem, Scalar
from casadi_skin.bvp.stated_problem import BoundaryProblem
from casadi_skin.bvp.statement import BoundaryValueProblem, check_name
from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import ContinuationSettings, Point
from casadi_skin.orbits.converged_mesh import converged_mesh
from casadi_skin.orbits.guesses import Guess, sampled
from casadi_skin.orbits.rank_deficiency import rank_deficiency
from casadi_skin.orbits.solution import BoundarySolution
from casadi_skin.solvers.bordered import SingularError
from casadi_skin.solvers.corrector import Correction, Corrector
from casadi_skin.solvers.ipopt import IpoptCorrector
from casadi_skin.solvers.levels import Levels
from casadi_skin.solvers.newton import NewtonCorrector
from casadi_skin.solvers.rounding import RoundedCorrector

INTERVALS = (5, 8, 12, 18, 27, 40, 60, 90, 135, 200, 300, 450, 675, 1000, 1500, 2250)
TABLES = {"gauss": gauss_table, "radau": radau_table}
CORRECTORS = ("ipopt", "newton")
DEGREES = range(1, 13)
TOLERANCES = (1e-13, 1e-1)
ITERATIONS = 100  # of Ipopt: a guess of a boundary-value problem may be far away
TRIES = 6  # resolutions on which a first solution is sought
FIRST = 12  # intervals
UNSOLVED = 1e-6  # relative change by a Newton step of what is solved as far as its corrector can see
MEANINGLESS = 1e-2  # estimated error of what is called solved but for rounding, and is not


class BoundaryError(ArithmeticError):
    """No solution was found: the message names condition, variable and place in one line."""


@dataclass(frozen=True)
class Method:
    """How a boundary-value problem is discretised and solved; raises ValueError for what is not accepted."""

    tolerance: float = 1e-8
    transcription: str = "gauss"
    degree: int = 6
    corrector: str = "ipopt"
    intervals: int = FIRST

    def __post_init__(self) -> None:
        for name, given, accepted in (
            ("transcription", self.transcription, tuple(TABLES)),
            ("corrector", self.corrector, CORRECTORS),
        ):
            if given not in accepted:
                raise ValueError(f"{name}: given {short_repr(given)}; accepted: {', '.join(accepted)}")
        for name, whole, highest in (
            ("degree", self.degree, DEGREES[-1]),
            ("intervals", self.intervals, INTERVALS[-2]),
        ):
            if isinstance(whole, bool) or not isinstance(whole, int) or not 1 <= whole <= highest:
                raise ValueError(f"{name}: given {short_repr(whole)}; accepted: a whole number from 1 to {highest}")
        low, high = TOLERANCES
        if not low <= number("tolerance", self.tolerance) <= high:
            raise ValueError(f"tolerance: given {self.tolerance!r}; accepted: {low:g} to {high:g}")

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Method:
        """From options by name; raises ValueError for what is not accepted, unknown names among it."""
        known = [field.name for field in fields(cls)]
        for name in options:
            check_name("options", name, known)
        return cls(**options)

    def build_corrector(self, problem: Problem) -> Corrector:
        """The corrector, asked for a hundredth of the tolerance where rounding allows it."""
        tolerance = float(np.clip(1e-2 * self.tolerance, 1e-12, 1e-6))
        kind = NewtonCorrector if self.corrector == "newton" else IpoptCorrector
        return RoundedCorrector(kind(problem, tolerance, ITERATIONS))


@dataclass(frozen=True)
class Sizes:
    """What components of the state and free parameters are measured by at least."""

    states: Array
    scalars: Array

    @classmethod
    def of(cls, statement: BoundaryValueProblem, guess: Array) -> Sizes:
        """A thousandth of what each component of the guess has, as components have units; 1 for a guess of zeros."""
        states = 1e-3 * np.max(np.abs(guess), axis=0) if np.any(guess) else np.ones(guess.shape[1])
        values = np.array([statement.values[name] for name in statement.free])
        return cls(states, np.where(values == 0.0, 1.0, 1e-3 * np.abs(values)))


def build_levels(
    statement: BoundaryValueProblem, method: Method, sizes: Sizes, walking: str | None = None, end: float = 1.0
) -> Levels:
    """Discretisations of the problem from coarse to fine; the scalar u is held, or follows the parameter `walking`."""
    formulation, table = statement.formulation(walking, end), TABLES[method.transcription](method.degree)

    def build(intervals: int) -> Problem:
        return BoundaryProblem(statement, formulation, intervals, table, sizes.states, sizes.scalars, walking, end)

    resolutions = tuple(sorted({*INTERVALS, method.intervals}))
    return Levels(build, method.build_corrector, resolutions)


def solve(statement: BoundaryValueProblem, guess: Guess, **options: Any) -> BoundarySolution:
    """The solution of a boundary-value problem near a guess.

    `guess` gives the states: numbers, one a state; a function of t; numbers or functions by state name; (t, x) with x
    of shape (times, states); a simulation; another solution. Options are those of `Method`: `tolerance` bounds the
    estimated error of each state relative to its largest value and of each free parameter; `transcription` is "gauss"
    or "radau" with `degree` stages; `corrector` "ipopt" or "newton"; `intervals` the first mesh. Raises ValueError for
    arguments out of range and BoundaryError where no solution is found to the tolerance.
    """
    method = Method.of(options)
    times = np.linspace(*statement.span(np.array(list(statement.values.values()))), 201)
    levels = build_levels(statement, method, Sizes.of(statement, sampled(statement, guess, times)))
    point_solver = PointSolver(levels, ContinuationSettings(1.0, method.tolerance))
    return BoundarySolution(statement, method, first_point(point_solver, statement, guess, method))


def first_point(point_solver: PointSolver, statement: BoundaryValueProblem, guess: Guess, method: Method) -> Point:
    """The solution near a guess with u = 0 held, refined to the tolerance; raises BoundaryError."""
    resolutions = [r for r in point_solver.levels.resolutions if r >= method.intervals][:TRIES]
    failures = []
    for problem in _first_problems(point_solver.levels, resolutions, guess):
        z = packed(problem, guess)
        correction = _corrected(point_solver.levels.corrector(problem), z, problem)
        backwards = problem.backwards(correction.z) if correction.converged else ""
        if backwards:
            failures.append(backwards)
            continue
        if correction.converged:
            correction = _sized(point_solver.levels, problem, correction, not np.any(z[: problem.states]))
            resolved = converged_mesh(point_solver.levels, problem, correction.z)
            return refined(point_solver, *(resolved or (problem, correction)))
        words = f"{correction.status.value}; {problem.worst(correction.z)}", rank_deficiency(problem, correction.z)
        failures.append("; there ".join(filter(None, words)))
    raise BoundaryError(f"{statement.model.name}: no solution near the guess: {failures[0]}")


def _sized(levels: Levels, problem: BoundaryProblem, correction: Correction, unmeasured: bool) -> Correction:
    """The correction, solved to its own size: Ipopt's tolerance is absolute where states are below 1.

    Where the guess of zeros left states `unmeasured`, they are measured by where a Newton step leads.
    """
    z, row = correction.z, problem.parameter_row()
    residual, nonzeros = problem.evaluate(z)
    try:
        step = levels.solver(problem).factor(z, nonzeros, row)(np.append(residual, 0.0))
    except SingularError:  # which condition is at fault is told where the solution is refined
        return correction
    if unmeasured:
        problem.measure_by(z - step)
    if problem.profile_change(z - step, step) <= UNSOLVED:
        return correction
    finished = NewtonCorrector(problem).correct(z, row, 0.0)
    return finished if finished.converged else correction


def _first_problems(levels: Levels, resolutions: Sequence[int], guess: Guess) -> Iterator[BoundaryProblem]:
    """Problems on which a first solution is sought: on the mesh of a guess that has one, then placed for the guess."""
    if isinstance(guess, BoundarySolution) and guess.intervals in levels.resolutions:
        problem = levels.problem(guess.intervals).with_constants(guess.problem.constants)
        assert isinstance(problem, BoundaryProblem)
        yield problem
    for resolution in resolutions:
        problem = levels.problem(resolution)
        assert isinstance(problem, BoundaryProblem)
        z = packed(problem, guess)
        placed = problem.placed(z, problem) if problem.imbalance(z) > 1.0 else problem
        assert isinstance(placed, BoundaryProblem)
        yield placed


def refined(point_solver: PointSolver, problem: Problem, correction: Correction) -> Point:
    """The solution of a correction on a mesh that meets the tolerance, with u held; raises BoundaryError."""
    assert isinstance(problem, BoundaryProblem)
    name = problem.statement.model.name
    try:
        point = point_solver.refined(problem, correction, problem.parameter_row(), Scalar.PARAMETER)
    except SingularError as error:
        reason = rank_deficiency(problem, correction.z) or str(error)
        raise BoundaryError(f"{name}: the solution cannot be refined: {reason}") from error
    if point is None:
        top = point_solver.levels.resolutions[-2]
        raise BoundaryError(f"{name}: more than {top} intervals are needed for the tolerance; try a larger one")
    assert isinstance(point.problem, BoundaryProblem)
    backwards = point.problem.backwards(point.z)
    if backwards:
        raise BoundaryError(f"{name}: {backwards}")
    if point.error.relative(1.0) > MEANINGLESS:
        reason = rank_deficiency(point.problem, point.z) or "the equations are nearly singular there"
        words = f"rounding alone leaves an error of {point.error.relative(1.0):.1e}"
        raise BoundaryError(f"{name}: no solution near the guess: {words}; {reason}")
    return point


def packed(problem: BoundaryProblem, guess: Guess) -> Array:
    """Unknowns at a guess, with u = 0."""
    statement = problem.statement
    start, end = statement.span(np.array(list(statement.values.values())))
    states = sampled(statement, guess, start + problem._fractions() * (end - start))
    scalars = [statement.values[name] for name in statement.free]
    return np.concatenate([states.ravel(), scalars, [0.0]])


def _corrected(corrector: Corrector, z: Array, problem: Problem) -> Correction:
    return corrector.correct(z, problem.parameter_row(), 0.0)
