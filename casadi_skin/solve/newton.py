"""Newton's method on the bordered orbit equations.

Equations that cannot be solved: the conditions that repeat or contradict each other, and the open unknowns.

Where the linearised equations are singular, the left null vector weighs the conditions that depend on each other, and
the right null vector is what they do not determine. Both come from inverse iteration on the slightly perturbed matrix
(Golub and Van Loan 2013, section 8.2.2).
"""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum
from functools import lru_cache
from typing import Self

import numpy as np

from casadi_skin.native import Structure
from casadi_skin.native.collocation import NEWTON
from casadi_skin.solve.bordered import LONG_ROW_FACTOR, BorderedSolver, long_rows
from casadi_skin.solve.watch import check_time_limit
from casadi_skin.zero.orbit import UNFOLDING, Extended
from casadi_skin.zero.problem import Array, Problem, SingularError, Solve
from casadi_skin.zero.stated_problem import BoundaryProblem

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

    `solve` has the factors of the closed Jacobian next to z, where the corrector had them and they serve there: where
    what they leave is made up for, as in all that is `measured_by_defect`.
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
    confirms: bool = False  # whether its verdicts on solutions may be others than its own solutions

    def on(self, problem: Problem) -> Self:
        """This corrector for a problem that differs in its constants only; nothing is built again."""
        if problem is self.problem:
            return self
        other = copy.copy(self)
        other.problem = problem
        return other

    @abstractmethod
    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point near `guess` with row . z = value, or a named failure; `row` has shape (size,)."""

    def near(self, guess: Array, row: Array, value: float) -> Correction:
        """The same by what finds points near their guess alone, where a guess nearer by is to be had for less."""
        return self.correct(guess, row, value)

    def confirm_all(self, points: Sequence[HeldState]) -> list[Correction]:
        """Verdicts on solutions: each as it is where this corrector agrees; here it always does."""
        return [Correction(z, Status.CONVERGED, 0) for z, _, _ in points]


CHORD_STEP = 1e-3  # step, relative to the state, after which the factors at hand serve the next: they cost the most
# Of the step before: after a shorter one with new factors these shrink the next by about 2 FAST_STEP_RATIO^2.
FAST_STEP_RATIO = 0.05
# Times the error that the last two steps with old factors foresee: places on branches want more digits.
CHORD_SAFETY = 100.0
SLOW_STEP_RATIO = 0.1  # of the step before: a longer one with old factors needs new ones
MOST_AT_ONCE = (
    5_000  # unknowns whose correction takes a few milliseconds: the time limit is not looked at between steps
)
LEAST_DECREASE = 1e-5  # of the sum of residuals, relative, in each step that Ipopt's line search takes
NEGLIGIBLE_STEP = 1e-3  # of the tolerance: such a step need not be taken
STEP_HALVINGS = 6  # of a step


@lru_cache(maxsize=8)
def _limits(steps: int, tolerance: float, shrink: float) -> Structure:
    """The limits of Newton's method, as kernels take them."""
    ratios = NEGLIGIBLE_STEP, CHORD_STEP, FAST_STEP_RATIO, CHORD_SAFETY, SLOW_STEP_RATIO
    return Structure(NEWTON, steps, tolerance, shrink, *ratios)


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
        weights = self.problem.metric(guess, max(1.0, abs(guess[self.problem.parameter_index])))
        return self._in_one_call(guess, row, value, weights) or self._in_steps(guess, row, value, weights)

    def _in_one_call(self, guess: Array, row: Array, value: float, weights: Array) -> Correction | None:
        """The correction by a kernel; None where there is none, and where it does not factorise a matrix."""
        if self._decreasing or not self.problem.keeps_factors or self.problem.size > MOST_AT_ONCE:
            return None
        check_time_limit(f"step 1 of Newton's method, {self.problem.size} unknowns")
        limits = _limits(self.max_iterations, self.tolerance, self._shrink)
        found = self._solver.corrected(self.problem, limits, (guess, row, value), weights)
        if found is None:
            return None
        status, steps, z, solve = found
        if status == Status.CONVERGED.name:
            return Correction(z, Status.CONVERGED, steps, solve=solve if self.problem.measured_by_defect else None)
        z = guess if status == Status.DIVERGED.name else z
        return Correction(z, Status[status], steps, self.problem.describe_largest_residual(z))

    def _in_steps(self, guess: Array, row: Array, value: float, weights: Array) -> Correction:
        z = guess.copy()
        last, reuse, solve, right = np.inf, False, None, np.empty(guess.size)
        for iteration in range(1, self.max_iterations + 1):
            check_time_limit(f"step {iteration} of Newton's method, {self.problem.size} unknowns")
            try:
                residual, nonzeros = self.problem.evaluate(z)
                if solve is None or not reuse:
                    solve = None  # its memory serves the next
                    solve = self._solver.factor(z, nonzeros, row)
            except SingularError as error:
                return Correction(z, Status.SINGULAR, iteration, str(error))
            right[:-1], right[-1] = residual, row @ z - value
            step = solve(right)
            length = math.sqrt(weights @ (step * step))
            if reuse and not length <= SLOW_STEP_RATIO * last:
                reuse = False
                continue
            if length <= NEGLIGIBLE_STEP * self.tolerance:  # the equations at z are known
                return Correction(
                    z, Status.CONVERGED, iteration, solve=solve if self.problem.measured_by_defect else None
                )
            if self._decreasing and CHORD_STEP < length < np.inf:
                moved = self._lower(z, step, row, value)
                if moved is None:
                    break
                z, last = moved, length
                continue
            z = z - step
            if not np.isfinite(length) or length > max(1.0, 10.0 * last) or length > self._shrink * last:
                return Correction(guess, Status.DIVERGED, iteration, self.problem.describe_largest_residual(guess))
            # Quadratic convergence: after a step of this length the next would be about its square.
            quadratic = not reuse and length < 1e-3 and length**2 / min(last, 1.0) < 0.1 * self.tolerance
            linear = reuse and CHORD_SAFETY * length**2 / last < 0.1 * self.tolerance
            if length <= self.tolerance or quadratic or linear:
                return Correction(
                    z, Status.CONVERGED, iteration, solve=solve if self.problem.measured_by_defect else None
                )
            shrinks = length <= CHORD_STEP or length <= FAST_STEP_RATIO * min(last, 1.0)
            reuse, last = self.problem.keeps_factors and shrinks, length
        return Correction(z, Status.TOO_MANY_ITERATIONS, self.max_iterations, self.problem.describe_largest_residual(z))

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


# Newton's method from far off an orbit that attracts ------------------------------------------------------------------

MOST_RETURNS = 40  # steps
RETURN_STEP = 0.1  # wanted length of a step, of the size of each component; twice as long it is taken back
RETURN_RATES = 1e-3, 30.0  # of holding the start: below the first one short steps are Newton's, above the other no way
SHORT_RETURN, LEAST_RATE_RATIO, RATE_GROWTH = 1e-2, 0.1, 4.0


class ReturningCorrector(Corrector):
    """Newton's method on an orbit whose start is held back: x(end) - x(start) = rate times the step of x(start).

    These are implicit Euler steps along the map over a period, 1/rate periods long, which lead to an orbit that
    attracts (pseudo-transient continuation, Kelley and Keyes 1998): from waves of oscillators whose phases hardly act
    on each other the equations are nearly singular, and steps with smaller residuals end between orbits. The rate
    follows the length of the steps down; the last ones are Newton's.
    """

    def __init__(self, problem: Problem, last: NewtonCorrector) -> None:
        self.problem, self._last = problem, last

    def _closing(self) -> Array:
        """1 for non-zeros that are derivatives by the start of conditions that close an orbit, and 0 for others."""
        problem, (rows, columns) = self.problem, self.problem.pattern
        if not isinstance(problem, BoundaryProblem) or problem.statement.free != ("period",) or problem.walking:
            return np.zeros(rows.size)
        first, places = problem.states - problem.formulation.states, rows * np.int64(2 * problem.size) + columns
        # Conditions with a derivative by the same component at the end.
        return np.asarray((rows >= first) & np.isin(places + first, places[columns < problem.states]), dtype=float)

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        z, rate, held, solver = guess.copy(), 1.0, self._closing(), BorderedSolver.of(self.problem)
        for iteration in range(1, MOST_RETURNS + 1 if held.any() else 1):
            check_time_limit(f"step {iteration} to an orbit that attracts, {self.problem.size} unknowns")
            try:
                residual, nonzeros = self.problem.evaluate(z)
                step = solver.factor(z, nonzeros * (1.0 + rate * held), row)(np.append(residual, row @ z - value))
            except (ArithmeticError, SingularError):
                break
            length = float(np.sqrt(np.sum(self.problem.metric(z, 1.0) * step**2) / np.sum(held)))
            taken = length <= 2.0 * RETURN_STEP
            z = z - step if taken else z
            if length <= SHORT_RETURN and rate <= RETURN_RATES[0]:
                return self._last.correct(z, row, value)
            rate *= max(LEAST_RATE_RATIO, length / RETURN_STEP) if taken else RATE_GROWTH
            if not rate <= RETURN_RATES[1]:
                break
        return Correction(guess, Status.DIVERGED, MOST_RETURNS)


# A corrector that takes residuals of the size of their rounding for converged -----------------------------------------

TO_ROUNDING = "to rounding"
ROUNDING_FACTOR = 4.0  # times the rounding of the largest term


class RoundedCorrector(Corrector):
    """Another corrector, whose tolerance may lie below the rounding errors of residuals with large terms.

    Where it stops at residuals that are rounding alone the equations are solved: the estimated error of the point
    includes rounding and shows its accuracy.
    """

    def __init__(self, inner: Corrector) -> None:
        self.inner, self.problem, self.confirms = inner, inner.problem, inner.confirms

    def on(self, problem: Problem) -> RoundedCorrector:
        return self if problem is self.problem else RoundedCorrector(self.inner.on(problem))

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        return self._rounded(self.inner.correct(guess, row, value), row, value)

    def near(self, guess: Array, row: Array, value: float) -> Correction:
        return self._rounded(self.inner.near(guess, row, value), row, value)

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


# Equations that cannot be solved: the conditions that repeat or contradict each other, and the open unknowns ----------

# Smallest singular value of the scaled matrix that counts as zero: solvers stop near such points.
ZERO_SINGULAR_VALUE = 1e-6
PERTURBATION_RTOL = 1e-13
ITERATION_ROUNDS = 4
ADDED_PARAMETERS = ("period", UNFOLDING)  # parameters that are not the model's
RESTING_STATE_RATIO = 1e-2  # of the sizes that states are measured by at least, a thousandth of the guess
SHRUNK_ORBIT_FACTOR = 100.0  # of the same: an orbit within a tenth of the guess's size nears an equilibrium
MOVING_STATE_FACTOR = 100.0  # of the same: a state that changes by more in the guessed period does not rest
GENERAL_POSITION_DISTANCE = 0.1  # of the sizes of unknowns: how far off z a point in general position is
NAMED_CONDITION_WEIGHT = 0.05  # of the largest weight of a condition


def rank_deficiency(problem: BoundaryProblem, z: Array, everywhere: bool = False) -> str:
    """Which conditions leave which variable undetermined, and where; empty where the equations at z are regular.

    An orbit that rests is reported instead: any period closes it.
    With `everywhere` also where they are singular at z alone: what has not been reached is then at fault, and not the
    problem.
    """
    if "period" in problem.statement.free and _rests(problem, z):
        return equilibrium_words(problem, z)
    found = _null_vectors(problem, z)
    if found is None:
        return ""
    if everywhere:
        noise = np.random.default_rng(1).normal(size=z.size - 1)
        if (
            _null_vectors(problem, np.append(z[:-1] + GENERAL_POSITION_DISTANCE * problem.sizes(z)[:-1] * noise, z[-1]))
            is None
        ):
            return ""
    left, right = found
    first = problem.states - problem.formulation.states  # of the equations that are conditions and integrals
    weights = np.abs(left[first:])
    if not np.max(weights, initial=0.0) > NAMED_CONDITION_WEIGHT * np.max(np.abs(left)) / np.sqrt(left.size):
        return f"the equations are singular and leave {_variable(problem, z, right)} undetermined"
    rows = first + np.flatnonzero(weights > NAMED_CONDITION_WEIGHT * np.max(weights))
    names = " and ".join(problem.place(int(row)) for row in rows)
    if len(rows) == 1:
        return f"{names} leaves {_variable(problem, z, right)} undetermined"
    return f"{names} repeat or contradict each other and leave {_variable(problem, z, right)} undetermined"


def in_family(problem: BoundaryProblem, z: Array) -> str:
    """That an orbit is one of many that only a conserved quantity tells apart; empty where the equations are regular.

    At a solution of an orbit's equations alone: the conditions at its ends and its phase fix all else. Beside a Hopf
    point the equations are singular as well, for amplitudes near 0 alone: of an orbit that has shrunk nothing is said.
    """
    model = problem.statement.model
    orbit = "period" in problem.statement.free and isinstance(model, Extended)
    if not orbit or _rests(problem, z, SHRUNK_ORBIT_FACTOR) or _null_vectors(problem, z) is None:
        return ""
    more = "more than is declared" if any(name.startswith(UNFOLDING) for name in model.parameter_names) else "something"
    declare = "accepted: what is conserved declared, as hamiltonian= or in conserved=, with select= to pick an orbit"
    return f"orbits come in a family there, for the model seems to conserve {more}; {declare}"


def not_finite(problem: BoundaryProblem, z: Array) -> str:
    """The equation that is not finite at z, where, and the state there; empty where all are finite."""
    try:
        residual, nonzeros = problem.evaluate(z)
    except ArithmeticError as error:
        return str(error)
    rows = np.flatnonzero(~np.isfinite(residual))
    what = "not finite"
    if not rows.size:
        rows, what = problem.pattern[0][~np.isfinite(nonzeros)], "a derivative is not finite"
    if not rows.size:
        return ""
    n, row = problem.formulation.states, int(rows[0])
    column = min(row // n + 1, problem.columns - 1)
    states = z[: problem.states].reshape(-1, n)[column]
    at = ", ".join(f"{k} = {x:.6g}" for k, x in zip(problem.statement.model.state_names, states, strict=True))
    return f"{what} at {problem.place(row)}, where {at} at the guess"


def equilibrium_words(problem: BoundaryProblem, z: Array) -> str:
    """That an orbit has come to rest, and where; or that it is a point alone, after no time."""
    model, p = problem.statement.model, problem.parameters(z)
    start = z[: problem.formulation.states]
    state = ", ".join(f"{name} = {value:.6g}" for name, value in zip(model.state_names, start, strict=True))
    values = zip(model.parameter_names, p, strict=True)
    at = ", ".join(f"{name} = {value:.6g}" for name, value in values if not name.startswith(ADDED_PARAMETERS))
    place = f"({state}{f', at {at}' if at else ''})"
    guessed = problem.statement.values.get(ADDED_PARAMETERS[0], 1.0)
    moves = np.abs(np.array(model.vector_field(0.0, start, p)).ravel()) * guessed
    if np.any(moves > MOVING_STATE_FACTOR * problem.floors):
        period = dict(zip(model.parameter_names, p, strict=True)).get(ADDED_PARAMETERS[0], 0.0)
        return f"the orbit has shrunk to a point at which the model does not rest {place}, its period to {period:.2g}"
    return f"this is an equilibrium: the orbit has shrunk to it {place}"


def _rests(problem: BoundaryProblem, z: Array, most: float = RESTING_STATE_RATIO) -> bool:
    """Whether states move by less than so much of what the guess's own sizes distinguish."""
    states = z[: problem.states].reshape(-1, problem.formulation.states)
    return bool(np.all(np.ptp(states, axis=0) <= most * problem.floors))


def _null_vectors(problem: BoundaryProblem, z: Array) -> tuple[Array, Array] | None:
    """Left and right null vectors, relative to sizes of equations and unknowns; None where there are none."""
    from scipy.sparse import csc_matrix, diags
    from scipy.sparse.linalg import splu

    try:
        _, nonzeros = problem.evaluate(z)
    except ArithmeticError:
        return None
    if not np.all(np.isfinite(nonzeros)) or problem.equations != problem.size - 1:
        return None
    rows, columns = problem.pattern
    inside = columns < problem.size - 1  # u is held
    sizes = problem.sizes(z)[:-1]
    entries = nonzeros[inside] * sizes[columns[inside]]
    largest = np.zeros(problem.size - 1)
    np.maximum.at(largest, rows[inside], np.abs(entries))
    largest[largest == 0.0] = 1.0
    largest[long_rows(rows, problem.size)] /= LONG_ROW_FACTOR
    n = problem.size - 1
    matrix = csc_matrix((entries / largest[rows[inside]], (rows[inside], columns[inside])), shape=(n, n))
    generator = np.random.default_rng(0)
    order = problem.elimination_order[:-1]  # u is the last
    perturbed = (matrix + diags(PERTURBATION_RTOL * (1.0 + generator.random(n)))).tocsc()[:, order]
    try:
        factors = splu(perturbed, permc_spec="NATURAL")
    except RuntimeError:  # "Factor is exactly singular": numbers of 1e200 leave nothing of the others
        return None
    right: Array = generator.normal(size=n)
    for _ in range(ITERATION_ROUNDS):
        scaled = right[order] / np.linalg.norm(right)
        left = np.asarray(factors.solve(scaled, trans="T"))  # type: ignore[call-overload]
        right[order] = factors.solve(np.asarray(left / np.linalg.norm(left), dtype=float))
    if not (np.all(np.isfinite(left)) and np.all(np.isfinite(right))):
        return None
    left, right = left / np.linalg.norm(left), right / np.linalg.norm(right)
    return (left, right) if np.linalg.norm(np.asarray(matrix @ right)) < ZERO_SINGULAR_VALUE else None


def _variable(problem: BoundaryProblem, z: Array, right: Array) -> str:
    """The unknown with the largest entry, and where it is."""
    k, n = int(np.argmax(np.abs(right))), problem.formulation.states
    if k >= problem.states:
        return problem.statement.free[k - problem.states]
    return f"{problem.statement.model.state_names[k % n]} (most at t = {problem.time(z, k // n):.6g})"
