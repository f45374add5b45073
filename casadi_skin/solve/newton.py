"""Newton's method on the bordered orbit equations."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Self

import numpy as np

from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.solve.watch import heed
from casadi_skin.zero.problem import Array, Problem, SingularError, Solve

# The interface of correctors ------------------------------------------------------------------------------------------


class Status(Enum):
    """The end of a correction, in a readable sentence."""

    CONVERGED = "converged"
    TOO_MANY_ITERATIONS = "the iteration did not converge in the steps allowed"
    DIVERGED = "the iteration left the neighbourhood of its guess"
    SINGULAR = "the equations with their held condition are singular"
    INFEASIBLE = "no point near the guess satisfies the equations"


@dataclass(frozen=True)
class Correction:
    """A corrected point z, or where the corrector stopped; `message` adds the solver's own words.

    `solve` has the factors of the closed Jacobian next to z, where the corrector had them.
    """

    z: Array
    status: Status
    iterations: int
    message: str = ""
    solve: Solve | None = None

    @property
    def converged(self) -> bool:
        """Whether z satisfies the equations and the held condition."""
        return self.status is Status.CONVERGED


HeldState = tuple[Array, Array, float]  # unknowns z, and a row with the value of row . z


class Corrector(ABC):
    """Solves R(z) = 0 together with one held linear condition row . z = value."""

    problem: Problem
    together: int = 1  # number of solutions that it confirms at a time

    def on(self, problem: Problem) -> Self:
        """This corrector for a problem that differs in its constants only; nothing is built again."""
        other = copy.copy(self)
        other.problem = problem
        return other

    @abstractmethod
    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point near `guess` with row . z = value, or a named failure; `row` has shape (size,)."""

    def confirm_all(self, points: Sequence[HeldState]) -> list[Correction]:
        """The last word on solutions: each as it is where the corrector agrees, or has no other word."""
        return [Correction(z, Status.CONVERGED, 0) for z, _, _ in points]


CHORD_STEP = 1e-3  # step, relative to the state, after which the factors at hand serve the next: they cost the most
FAST_STEP_RATIO = (
    0.05  # of the step before: after a shorter one with new factors these shrink the next by about 2 FAST_STEP_RATIO^2
)
CHORD_SAFETY = (
    100.0  # times the error that the last two steps with old factors foresee: places on branches want more digits
)
SLOW_STEP_RATIO = 0.1  # of the step before: a longer one with old factors needs new ones
LEAST_DECREASE = 1e-5  # of the sum of residuals, relative, in each step that Ipopt's line search takes
NEGLIGIBLE_STEP = 1e-3  # of the tolerance: such a step need not be taken
STEP_HALVINGS = 6  # of a step


class NewtonCorrector(Corrector):
    """Full Newton steps until the step, relative to the state, is below `tolerance` and no longer shrinks fast.

    A step longer than `shrink` times the one before ends them where it is given: they may lead anywhere then. With
    `decreasing` steps may be of any length, and are halved until the sum of the residuals falls, as those of Ipopt are.
    """

    def __init__(
        self,
        problem: Problem,
        tolerance: float = 1e-12,
        max_iterations: int = 10,
        shrink: float | None = None,
        decreasing: bool = False,
    ) -> None:
        self.problem, self.tolerance, self.max_iterations = problem, tolerance, max_iterations
        self._shrink, self._decreasing = np.inf if shrink is None else shrink, decreasing
        self._solver = BorderedSolver.of(problem)

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        if self.problem.frequency(guess) <= 0:
            return Correction(guess, Status.DIVERGED, 0, "the guess has no positive frequency")
        z, weights = guess.copy(), self.problem.metric(guess, max(1.0, abs(guess[self.problem.parameter_index])))
        last, reuse, solve = np.inf, False, None
        for iteration in range(1, self.max_iterations + 1):
            heed(f"step {iteration} of Newton's method, {self.problem.size} unknowns")
            try:
                residual, nonzeros = self.problem.evaluate(z)
                if solve is None or not reuse:
                    solve = self._solver.factor(z, nonzeros, row)
            except SingularError as error:
                return Correction(z, Status.SINGULAR, iteration, str(error))
            step = solve(np.append(residual, row @ z - value))
            length = float(np.sqrt(np.sum(weights * step**2)))
            if reuse and not length <= SLOW_STEP_RATIO * last:
                reuse = False
                continue
            if length <= NEGLIGIBLE_STEP * self.tolerance:  # the equations at z are known
                return Correction(z, Status.CONVERGED, iteration, solve=solve)
            if self._decreasing and CHORD_STEP < length < np.inf:
                moved = self._lower(z, step, row, value)
                if moved is None:
                    break
                z, last = moved, length
                continue
            z = z - step
            if not np.isfinite(length) or length > max(1.0, 10.0 * last) or length > self._shrink * last:
                return Correction(guess, Status.DIVERGED, iteration, self.problem.worst(guess))
            # Quadratic convergence: after a step of this length the next would be about its square.
            quadratic = not reuse and length < 1e-3 and length**2 / min(last, 1.0) < 0.1 * self.tolerance
            linear = reuse and CHORD_SAFETY * length**2 / last < 0.1 * self.tolerance
            if length <= self.tolerance or quadratic or linear:
                return Correction(z, Status.CONVERGED, iteration, solve=solve)
            shrinks = length <= CHORD_STEP or length <= FAST_STEP_RATIO * min(last, 1.0)
            reuse, last = self.problem.in_order and shrinks, length
        return Correction(z, Status.TOO_MANY_ITERATIONS, self.max_iterations, self.problem.worst(z))

    def _lower(self, z: Array, step: Array, row: Array, value: float) -> Array | None:
        """The point of the longest of the halved steps that makes the residuals smaller; None where none does."""
        before = self._total(z, row, value)
        trials = (z - 0.5**k * step for k in range(STEP_HALVINGS))
        return next((x for x in trials if self._total(x, row, value) <= (1.0 - LEAST_DECREASE) * before), None)

    def _total(self, z: Array, row: Array, value: float) -> float:
        """The sum of the residuals at z, not finite where the model is not."""
        try:
            return float(np.sum(np.abs(self.problem.evaluate(z)[0])) + abs(row @ z - value))
        except ArithmeticError:
            return np.inf


# A corrector that takes residuals of the size of their rounding for converged -----------------------------------------

TO_ROUNDING = "to rounding"
ROUNDING_FACTOR = 4.0  # times the rounding of the largest term


class RoundedCorrector(Corrector):
    """Another corrector, whose tolerance may lie below the rounding errors of residuals with large terms.

    Where it stops at residuals that are rounding alone the equations are solved: the estimated error of the point
    includes rounding and shows its accuracy.
    """

    def __init__(self, inner: Corrector) -> None:
        self.inner, self.problem = inner, inner.problem

    def on(self, problem: Problem) -> RoundedCorrector:
        return RoundedCorrector(self.inner.on(problem))

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        return self._rounded(self.inner.correct(guess, row, value), row, value)

    def confirm_all(self, points: Sequence[HeldState]) -> list[Correction]:
        found = list[Correction]()
        for (z, row, value), verdict in zip(points, self.inner.confirm_all(points), strict=True):
            rounded = self._rounded(verdict, row, value)
            found.append(replace(rounded, z=z) if rounded.message == TO_ROUNDING else rounded)
        return found

    def _rounded(self, correction: Correction, row: Array, value: float) -> Correction:
        if correction.converged or correction.status is Status.SINGULAR:
            return correction
        z = correction.z
        try:
            residual = np.abs(self.problem.evaluate(z)[0])
        except ArithmeticError:
            return correction
        held = abs(float(row @ z) - value) <= ROUNDING_FACTOR * np.finfo(float).eps * max(
            1.0, float(np.abs(row) @ np.abs(z))
        )
        if held and np.all(residual <= ROUNDING_FACTOR * self.problem.rounding(z)):
            return replace(correction, status=Status.CONVERGED, message=TO_ROUNDING)
        return correction
