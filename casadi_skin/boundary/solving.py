"""Solving a stated boundary-value problem: a mesh that adapts until the estimated error meets the tolerance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.arguments import number, shown
from casadi_skin.boundary.discrete import BoundaryProblem
from casadi_skin.boundary.guesses import Guess, sampled
from casadi_skin.boundary.solution import BoundarySolution
from casadi_skin.boundary.statement import BoundaryValueProblem
from casadi_skin.bvp.butcher import gauss_table, radau_table
from casadi_skin.bvp.problem import Array, Problem, Scalar
from casadi_skin.continuation.locating import Locator
from casadi_skin.continuation.points import Point, WalkSettings
from casadi_skin.correctors.base import Correction, Corrector
from casadi_skin.correctors.bordered import SingularError
from casadi_skin.correctors.ipopt import IpoptCorrector
from casadi_skin.correctors.ladder import Ladder
from casadi_skin.correctors.newton import NewtonCorrector

INTERVALS = (5, 8, 12, 18, 27, 40, 60, 90, 135, 200, 300, 450, 675, 1000, 1500, 2250)
TABLES = {"gauss": gauss_table, "radau": radau_table}
CORRECTORS = ("ipopt", "newton")
DEGREES = range(1, 13)
TOLERANCES = (1e-13, 1e-1)
ITERATIONS = 100  # of Ipopt: a guess of a boundary-value problem may be far away
TRIES = 6  # rungs on which a first solution is sought
FIRST = 12  # intervals


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
                raise ValueError(f"{name}: given {shown(given)}; accepted: {', '.join(accepted)}")
        if self.degree not in DEGREES:
            raise ValueError(f"degree: given {shown(self.degree)}; accepted: {DEGREES[0]} to {DEGREES[-1]}")
        low, high = TOLERANCES
        if not low <= number("tolerance", self.tolerance) <= high:
            raise ValueError(f"tolerance: given {self.tolerance!r}; accepted: {low:g} to {high:g}")
        if not 1 <= self.intervals <= INTERVALS[-2]:
            raise ValueError(f"intervals: given {shown(self.intervals)}; accepted: 1 to {INTERVALS[-2]}")

    def build_corrector(self, problem: Problem) -> Corrector:
        """The corrector, asked for a hundredth of the tolerance where rounding allows it."""
        tolerance = float(np.clip(1e-2 * self.tolerance, 1e-12, 1e-6))
        if self.corrector == "newton":
            return NewtonCorrector(problem, tolerance, ITERATIONS)
        return IpoptCorrector(problem, tolerance, ITERATIONS)


@dataclass(frozen=True)
class Sizes:
    """What components of the state and free parameters are measured by at least."""

    states: Array
    scalars: Array

    @classmethod
    def of(cls, statement: BoundaryValueProblem, guess: Array) -> Sizes:
        """A thousandth of what the guess has; 1 where it has nothing."""
        largest = float(np.max(np.abs(guess)))
        states = np.full(guess.shape[1], 1e-3 * largest if largest > 0 else 1.0)
        values = np.array([statement.values[name] for name in statement.free])
        return cls(states, np.where(values == 0.0, 1.0, 1e-3 * np.abs(values)))


def build_ladder(
    statement: BoundaryValueProblem, method: Method, sizes: Sizes, walking: str | None = None, end: float = 1.0
) -> Ladder:
    """Discretisations of the problem from coarse to fine; the scalar u is held, or follows the parameter `walking`."""
    formulation, table = statement.formulation(walking, end), TABLES[method.transcription](method.degree)

    def build(intervals: int) -> Problem:
        return BoundaryProblem(statement, formulation, intervals, table, sizes.states, sizes.scalars, walking, end)

    rungs = tuple(sorted({*INTERVALS, method.intervals}))
    return Ladder(build, method.build_corrector, rungs)


def solve(statement: BoundaryValueProblem, guess: Guess, **options: Any) -> BoundarySolution:
    """The solution of a boundary-value problem near a guess.

    `guess` gives the states: numbers, one a state; a function of t; numbers or functions by state name; (t, x) with x
    of shape (times, states); a simulation; another solution. Options are those of `Method`: `tolerance` bounds the
    estimated error of each state relative to its largest value and of each free parameter; `transcription` is "gauss"
    or "radau" with `degree` stages; `corrector` "ipopt" or "newton"; `intervals` the first mesh. Raises ValueError for
    arguments out of range and BoundaryError where no solution is found to the tolerance.
    """
    method = Method(**options)
    if statement.optimises or statement.bounds:
        from casadi_skin.boundary.programme import optimise

        return optimise(statement, guess, method)
    times = np.linspace(*statement.span(np.array(list(statement.values.values()))), 201)
    ladder = build_ladder(statement, method, Sizes.of(statement, sampled(statement, guess, times)))
    locator = Locator(ladder, WalkSettings(1.0, method.tolerance))
    return BoundarySolution(statement, method, first_point(locator, statement, guess, method))


def first_point(locator: Locator, statement: BoundaryValueProblem, guess: Guess, method: Method) -> Point:
    """The solution near a guess with u = 0 held, refined to the tolerance; raises BoundaryError."""
    rungs = [r for r in locator.ladder.rungs if r >= method.intervals][:TRIES]
    failure = ""
    for resolution in rungs:
        problem = locator.ladder.problem(resolution)
        assert isinstance(problem, BoundaryProblem)
        z = packed(problem, guess)
        if problem.imbalance(z) > 1.0:
            problem = problem.placed(z, problem)
            assert isinstance(problem, BoundaryProblem)
            z = packed(problem, guess)
        correction = _corrected(locator.ladder.corrector(problem), z, problem)
        if not correction.converged:
            failure = f"{correction.status.value}; {problem.worst(correction.z)}"
            continue
        return refined(locator, problem, correction)
    raise BoundaryError(f"{statement.model.name}: no solution near the guess: {failure}")


def refined(locator: Locator, problem: Problem, correction: Correction) -> Point:
    """The solution of a correction on a mesh that meets the tolerance, with u held; raises BoundaryError."""
    name = problem.statement.model.name if isinstance(problem, BoundaryProblem) else ""
    try:
        point = locator.refined(problem, correction, problem.parameter_row(), Scalar.PARAMETER)
    except SingularError as error:
        raise BoundaryError(f"{name}: the solution cannot be refined: {error}") from error
    if point is None:
        top = locator.ladder.rungs[-2]
        raise BoundaryError(f"{name}: more than {top} intervals are needed for the tolerance; try a larger one")
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
