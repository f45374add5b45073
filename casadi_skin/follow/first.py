"""Other ways to a first solution where the correctors do not reach it from the guess.

Newton's method first, where it has not been tried; then a short continuation: the problem is solved at an easier value
of one of its parameters, ten or a hundred times as large or as small, and followed from there to the requested values.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np

from casadi_skin.follow.boundary_solutions import BoundaryError
from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.solution import Solution
from casadi_skin.model.arguments import check_name, duration, number, short_repr
from casadi_skin.model.jumps import JumpError
from casadi_skin.solve.levels import Levels, converged_mesh
from casadi_skin.solve.newton import Correction, Corrector, NewtonCorrector, not_finite, rank_deficiency
from casadi_skin.solve.watch import TimeLimitError, watched
from casadi_skin.zero.family import Method
from casadi_skin.zero.guesses import Guess, along_the_guess, is_straight, sampled
from casadi_skin.zero.orbit import Sizes, boundary_method
from casadi_skin.zero.problem import Array, Problem, SingularError
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem, stated
from casadi_skin.zero.statement import Statement

EASIER_PARAMETER_FACTORS = (10.0, 0.1)  # of a parameter, and their squares, at which the problem may be easier
MOST_PARAMETERS = 3  # that are tried
MOST_POINTS = 60  # of a continuation

First = Callable[[BoundarySpace, Guess], Point]


def other_ways(space: BoundarySpace, guess: Guess, first: First) -> tuple[Solution | None, str]:
    """A solution by another way with its description, or None with the ways that failed, in words.

    Arguments:
        space: of the solution that is sought.
        guess: where it was sought.
        first: makes the first point of a space near a guess, quickly; raises BoundaryError.
    """
    tried = []
    by_newton = replace(space, method=replace(space.method, corrector="newton"))
    if space.method.corrector != "newton":
        tried.append("Newton's method")
        found = _found(by_newton, guess, first)
        if found is not None:
            return replace(found, found_by=tried[-1]), tried[-1]
    for name, value in _parameters(space):
        starts = []
        for factor in EASIER_PARAMETER_FACTORS:
            for easier_value in (factor * value, factor**2 * value):
                starts.append(f"{easier_value:g}")
                easier = _found(_at(by_newton, name, easier_value), guess, first)
                if easier is None:
                    continue
                reached = _followed(easier, name, value)
                found = None if reached is None else _found(by_newton, reached, first)
                if found is not None:
                    words = f"{name} followed from {easier_value:g} to {value:g}"
                    return replace(found, found_by=words), words
                break  # the branch does not come here: nor does it from farther off
        tried.append(f"{name} followed from {', '.join(starts)}")
    names = " or ".join(name for name, _ in _parameters(space))
    hint = f"; not tried: {names} by arclength past folds, with follow from a solution at another value"
    return None, "; ".join(tried) + (hint if names else "")


def _parameters(space: BoundarySpace) -> Iterator[tuple[str, float]]:
    """Parameters that may be followed to their values."""
    statement = space.statement
    fixed = [(name, value) for name, value in statement.values.items() if name not in statement.free and value]
    yield from fixed if len(fixed) <= MOST_PARAMETERS else ()


def _at(space: BoundarySpace, name: str, value: float) -> BoundarySpace:
    return replace(space, statement=space.statement.with_parameters(**{name: value}))


def _found(space: BoundarySpace, guess: Guess, first: First) -> Solution | None:
    try:
        return Solution(space, first(space, guess))
    except BoundaryError:
        return None


def _followed(easier: Solution, name: str, value: float) -> Solution | None:
    try:
        branch = easier.follow(name, value, max_points=MOST_POINTS, until=_turns)
    except BoundaryError:
        return None
    reached: Solution = branch.solutions[-1]
    return reached if reached.parameters[name] == value else None


def _turns(solution: Solution) -> bool:
    """Whether the branch turns back here: it does not come to the value."""
    return bool(solution.point.special)


# Solving a stated boundary-value problem: a mesh that adapts until the estimated error meets the tolerance ------------

NOT_METHODS = ("tolerance", "time_limit", "progress")
METHODS = ("transcription", "degree", "corrector", "intervals", "flow", "walker")
FIRST_SOLUTION_OPTIONS = (NOT_METHODS[0], *METHODS, *NOT_METHODS[1:])
RESOLUTIONS_TRIED = 6  # resolutions on which a first solution is sought
GUESS_SAMPLES = 2001  # of a guess that is looked at for jumps
QUICK_TRIES = 1  # the same by another way
JUMP_RESOLUTIONS = (90, 200, 450)  # the same where the guess has jumps, on a mesh that follows its length
STEEP_INTERVAL_RATIO = 0.02  # of the mean interval: a shorter one on such a mesh is in a jump
TOLERANCE_RANGE = (1e-13, 1e-1)
UNSOLVED_CHANGE = 1e-6  # relative change by a Newton step of a solution that its corrector accepts


def accuracy_of(options: Mapping[str, Any]) -> tuple[float, Method]:
    """Tolerance and methods; raises ValueError for options that are unknown or out of range."""
    for name in options:
        check_name("options", name, FIRST_SOLUTION_OPTIONS)
    low, high = TOLERANCE_RANGE
    tolerance = number("tolerance", options.get("tolerance", 1e-8))
    if not low <= tolerance <= high:
        raise ValueError(f"tolerance: given {tolerance!r}; accepted: {low:g} to {high:g}")
    return tolerance, boundary_method({k: v for k, v in options.items() if k in METHODS and v is not None})


def space_of(statement: Statement, guess: Guess, options: Mapping[str, Any]) -> BoundarySpace:
    """The space of solutions of a statement, measured by a guess; raises ValueError for options out of range."""
    tolerance, method = accuracy_of(options)
    times = np.linspace(*statement.span(), 201)
    return BoundarySpace(statement, tolerance, method, Sizes.of(statement, sampled(statement, guess, times)))


def limits_of(options: Mapping[str, Any]) -> tuple[float | None, Callable[[str], None] | None]:
    """`time_limit` and `progress` of options; raises ValueError and TypeError."""
    limit, report = options.get("time_limit"), options.get("progress")
    duration("time_limit", limit)
    if report is not None and not callable(report):
        raise TypeError(f"progress: given {short_repr(report)}; accepted: a function of words")
    return limit, report


def solve(statement: Statement, guess: Guess, **options: Any) -> Solution:
    """The solution of a boundary-value problem without objective and bounds near a guess.

    Arguments and what is raised are those of `casadi_skin.optimise.boundary_nlp.solve`.
    """
    limit, report = limits_of(options)
    space = space_of(statement, guess, options)
    watch = (
        watched(limit, report) if limit is not None or report is not None else nullcontext()
    )  # or that of the caller
    try:
        with watch, np.errstate(all="ignore"):  # no corrector takes a residual that is not finite
            return solution_near(space, guess)
    except TimeLimitError as error:
        advice = "try a guess nearer by, or a larger tolerance"
        raise BoundaryError(f"{statement.model.name}: {error}; {advice}") from None


def _jump_along(space: BoundarySpace, guess: Guess) -> str:
    """That the equations jump along a guess, with the equation; empty where they do not."""
    jumps, values = space.model.jumps, space.statement.values
    if not jumps.found:
        return ""
    t = np.linspace(*space.statement.span(), GUESS_SAMPLES)
    p = np.array([values[name] for name in jumps.model.parameter_names])
    return jumps.along(t, sampled(space.statement, guess, t)[:, : jumps.model.full_size], p)


class NotReachedError(BoundaryError):
    """The corrector does not converge from the guess; another method may find a solution."""


def solution_near(space: BoundarySpace, guess: Guess) -> Solution:
    """The solution near a guess, by `other_ways` where the corrector does not reach it; raises BoundaryError."""
    try:
        point = first_point(space, guess)
        jumps = space.jump(point)
        if jumps:
            raise JumpError(space.model.name, f"{jumps}, along the solution")
        return Solution(space, point)
    except BoundaryError as error:
        jumps = _jump_along(space, guess)
        if jumps:
            raise JumpError(space.model.name, f"{jumps}, along the guess, near which no solution was found") from error
        if not isinstance(error, NotReachedError) or PERIOD in space.statement.values:  # an orbit's guess is a cycle
            raise
        found, words = other_ways(space, guess, lambda other, near: first_point(other, near, QUICK_TRIES))
        if found is None:
            raise BoundaryError(f"{error}; tried as well: {words}" if words else str(error)) from error
        return found


def first_point(space: BoundarySpace, guess: Guess, tries: int | None = None) -> Point:
    """The solution near a guess with u = 0 held, refined to the tolerance; raises BoundaryError.

    `tries` is the largest number of resolutions.
    """
    statement, point_solver = space.statement, space.point_solver
    resolutions = [r for r in point_solver.levels.resolutions if r >= int(space.method.intervals or 1)][
        :RESOLUTIONS_TRIED
    ]
    failures = []
    undetermined = ""
    for problem, z in itertools.islice(_first_problems(statement, point_solver.levels, resolutions, guess), tries):
        correction = _corrected(point_solver.levels.corrector(problem), z, problem)
        if (
            not correction.converged and problem.resolution in JUMP_RESOLUTIONS
        ):  # Ipopt's scaling suffers from steep jumps
            correction = _corrected(NewtonCorrector(problem), z, problem)
        backwards = problem.backwards(correction.z) if correction.converged else ""
        if backwards:
            failures.append(backwards)
            continue
        if correction.converged:
            correction = _sized(point_solver.levels, problem, correction, not np.any(z[: problem.states]))
            resolved = converged_mesh(point_solver.levels, problem, correction)
            try:
                return space.refined(*(resolved or (problem, correction)))
            except BoundaryError as error:
                if problem.resolution not in JUMP_RESOLUTIONS:
                    raise
                failures.append(str(error))
                continue
        undetermined = rank_deficiency(problem, correction.z, everywhere=True)
        words = (f"{correction.status.value}; {problem.worst(correction.z)}", undetermined)
        failures.append(not_finite(problem, z) or "; there ".join(filter(None, words)))
    kind = BoundaryError if undetermined else NotReachedError
    raise kind(f"{statement.model.name}: no solution near the guess: {failures[0]}")


def _sized(levels: Levels, problem: BoundaryProblem, correction: Correction, unmeasured: bool) -> Correction:
    """The correction, solved to its own size: Ipopt's tolerance is absolute where states are below 1.

    Where the guess of zeros left states `unmeasured`, their scales follow from a Newton step.
    """
    z, row = correction.z, problem.parameter_row()
    residual, nonzeros = problem.evaluate(z)
    try:
        step = (correction.solve or levels.solver(problem).factor(z, nonzeros, row))(np.append(residual, 0.0))
    except SingularError:  # the refinement of the solution names the condition at fault
        return correction
    if unmeasured:
        problem.measure_by(z - step)
    if problem.profile_change(z - step, step) <= UNSOLVED_CHANGE:
        return correction
    finished = NewtonCorrector(problem).correct(z, row, 0.0)
    return finished if finished.converged else correction


def _first_problems(
    statement: Statement, levels: Levels, resolutions: Sequence[int], guess: Guess
) -> Iterator[tuple[BoundaryProblem, Array]]:
    """Problems on which a first solution is sought, and unknowns at the guess: on its own mesh, then placed for it.

    A guess with jumps, which a uniform mesh would miss, gets a mesh along its length before.
    """
    if (
        isinstance(guess, Solution)
        and isinstance(guess.point.problem, BoundaryProblem)
        and guess.intervals in levels.resolutions
    ):
        problem = stated(levels.problem(guess.intervals).with_constants(guess.problem.constants))
        yield problem, packed(problem, guess)
    for resolution, lengths in zip(JUMP_RESOLUTIONS, along_the_guess(statement, guess, JUMP_RESOLUTIONS), strict=False):
        if np.min(lengths) < STEEP_INTERVAL_RATIO / resolution:
            problem = stated(levels.problem(resolution))
            steep = problem.with_constants(lengths)
            yield steep, packed(steep, guess)
    for resolution in resolutions:
        problem = stated(levels.problem(resolution))
        z = packed(problem, guess)
        if not is_straight(guess) and problem.imbalance(z) > 1.0:
            problem = problem.placed(z, problem)
            z = packed(problem, guess)
        yield problem, z


def packed(problem: BoundaryProblem, guess: Guess) -> Array:
    """Unknowns at a guess, with u = 0."""
    statement = problem.statement
    start, end = statement.span()
    states = sampled(statement, guess, start + problem._fractions() * (end - start))
    scalars = [statement.values[name] for name in statement.free]
    return np.concatenate([states.ravel(), scalars, [0.0]])


def _corrected(corrector: Corrector, z: Array, problem: Problem) -> Correction:
    return corrector.correct(z, problem.parameter_row(), 0.0)
