"""Continuation of a boundary-value problem in one of its parameters, through folds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from casadi_skin.arguments import number, numbers, short_repr
from casadi_skin.bvp.problem import Array, Scalar
from casadi_skin.bvp.stated_problem import BoundaryProblem
from casadi_skin.bvp.statement import check_name
from casadi_skin.continuation.arclength import ArclengthContinuation
from casadi_skin.continuation.point_solver import PointSolver
from casadi_skin.continuation.points import ContinuationSettings, End, Point, Target
from casadi_skin.orbits.solution import BoundarySolution
from casadi_skin.orbits.solve import BoundaryError, Sizes, build_levels, refined

FOLD_TOLERANCE = 1e-7  # of a step: the parameter is stationary there, so that it has twice the digits
WORDS = {End.RETURNED: "the branch came back to the value of the parameter that it started from"}


@dataclass(frozen=True, eq=False)
class BoundaryBranch:
    """Solutions in arclength order; `folds` are those at which the parameter turns back.

    `complete` tells whether the end asked for was reached, `reason` why not. `missed` are values asked for at which no
    solution was found where the branch passes them.
    """

    parameter: str
    solutions: tuple[BoundarySolution, ...]
    folds: tuple[BoundarySolution, ...]
    complete: bool
    reason: str
    missed: tuple[float, ...] = ()

    def __len__(self) -> int:
        return len(self.solutions)

    def __getitem__(self, name: str) -> Array:
        """Values of a parameter along the branch, shape (solutions,)."""
        return np.array([solution.parameters[name] for solution in self.solutions])

    @property
    def values(self) -> Array:
        """Values of the parameter followed, shape (solutions,)."""
        return self[self.parameter]

    def at(self, value: float, which: int = 0) -> BoundarySolution:
        """The solution at a value that was asked for, on the `which`-th passage; raises ValueError for others."""
        found = [s for s in self.solutions if s.parameters[self.parameter] == value]
        if which >= len(found):
            raise ValueError(f"at: given {value!r}, passage {which}; the branch has {len(found)} solutions there")
        return found[which]


def follow(
    solution: BoundarySolution,
    parameter: str,
    end: float,
    *,
    at: Sequence[float] = (),
    max_points: int = 500,
    max_step: float = 0.2,
    until: Callable[[BoundarySolution], bool] | None = None,
    progress: Callable[[BoundarySolution], None] | None = None,
) -> BoundaryBranch:
    """The branch through a solution in the direction of `end`, by pseudo-arclength continuation (Keller 1977).

    It goes round folds and ends at `end`, where it comes back to the value that it started from, after `max_points`
    points, or at the first solution for which `until` is true. Points lie exactly at the values `at`, as often as the
    branch passes them. `max_step` is the longest step, 1 being a change of the states by their own size. Raises
    ValueError for arguments out of range and BoundaryError where not even the start can be solved.
    """
    statement = solution.statement
    if statement.optimises:
        raise ValueError("follow: given a solution with an objective; accepted: one without")
    check_name("parameter", parameter, [n for n in statement.model.parameter_names if n not in statement.free])
    start, end = solution.parameters[parameter], number("end", end)
    if end == start:
        raise ValueError(f"end: given {end!r}, where the branch starts; accepted: another value")
    for value in numbers("at", at):
        if not min(start, end) <= value <= max(start, end):
            raise ValueError(f"at: given {value:g}; accepted: values from {start:g} to {end:g}")
    if isinstance(max_points, bool) or not isinstance(max_points, int) or max_points < 2:
        raise ValueError(f"max_points: given {short_repr(max_points)}; accepted: a whole number >= 2")
    if not number("max_step", max_step) > 0.0:
        raise ValueError(f"max_step: given {max_step!r}; accepted: a number > 0")
    wanted = tuple(Target(Scalar.PARAMETER, (value - start) / (end - start)) for value in at)
    settings = ContinuationSettings(
        1.0, solution.method.tolerance, wanted, max_step=number("max_step", max_step), max_points=max_points,
        tiny_first=False, max_parameter_step=0.2,
    )  # fmt: skip
    walk = _Following(solution, parameter, end, settings)
    return walk.followed(dict(zip((t.value for t in wanted), at, strict=True)), until, progress)


class _Following:
    """A walk along the branch and what it has found."""

    def __init__(self, solution: BoundarySolution, parameter: str, end: float, settings: ContinuationSettings) -> None:
        values = {**solution.statement.parameters, **solution.parameters}
        self.statement = replace(solution.statement, parameters=values)
        self.solution, self.parameter = solution, parameter
        sizes = Sizes(solution.problem.floors, solution.problem.scalar_floors)
        self.point_solver = PointSolver(build_levels(self.statement, solution.method, sizes, parameter, end), settings)
        self.points: list[Point] = []
        self.folds: list[Point] = []

    def _start(self) -> Point:
        problem = self.point_solver.levels.problem(self.solution.intervals)
        problem = problem.with_constants(self.solution.problem.constants)
        z = self.solution.point.z.copy()
        z[-1] = 0.0
        correction = self.point_solver.levels.corrector(problem).correct(z, problem.parameter_row(), 0.0)
        if not correction.converged:
            raise BoundaryError(f"the start of the branch: {correction.status.value}; {problem.worst(correction.z)}")
        return replace(refined(self.point_solver, problem, correction), step=self.point_solver.settings.first_step)

    def followed(
        self,
        asked: dict[float, float],
        until: Callable[[BoundarySolution], bool] | None,
        progress: Callable[[BoundarySolution], None] | None,
    ) -> BoundaryBranch:
        start = self._start()
        walk = ArclengthContinuation(self.point_solver, (start,))
        stopped, broken = False, ""
        solutions: list[BoundarySolution] = []
        for point in self._with_folds(start, walk):
            if isinstance(point, str):
                broken = point
                break
            solutions.append(self._solution(point, asked))
            if progress is not None:
                progress(solutions[-1])
            if until is not None and until(solutions[-1]):
                stopped = True
                break
        if walk.end is End.REACHED and any(target in self.point_solver.settings.ends for target in walk.missed):
            broken = f"the branch passes the end, and no solution was found there: {walk.detail}"
        complete = stopped or (walk.end is End.REACHED and not broken)
        reason = "" if complete or walk.end is None else WORDS.get(walk.end, f"{walk.end.value}: {walk.detail}")
        reason = broken or reason
        missed = tuple(asked[t.value] for t in walk.missed if t.value in asked)
        folds = tuple(self._solution(point, {}) for point in self.folds)
        return BoundaryBranch(self.parameter, tuple(solutions), folds, complete, reason, missed)

    def _with_folds(self, start: Point, walk: ArclengthContinuation) -> Iterator[Point | str]:
        """Points of the walk with the folds between them; last, why the branch cannot go on, in words."""
        yield start
        last = start
        for point in walk:
            assert isinstance(point.problem, BoundaryProblem)
            if backwards := point.problem.backwards(point.z):
                yield backwards
                return
            if _slope(last) * _slope(point) < 0.0:
                try:
                    self.folds.append(self._fold(last, point))
                except BoundaryError as error:
                    yield f"{error}, {last.problem.whereabouts(last.z)}"
                    return
                yield self.folds[-1]
            yield point
            last = point

    def _fold(self, before: Point, after: Point) -> Point:
        """The point between two at which the parameter is stationary; raises BoundaryError where none is found."""
        from scipy.optimize import brentq

        found: dict[float, Point] = {0.0: before, 1.0: after}

        def slope(fraction: float) -> float:
            point = found.get(fraction) or self.point_solver.along(before, after, fraction)
            if point is None:
                why = self.point_solver.failure or "the equations are singular beside it"
                raise BoundaryError(f"the parameter turns back at a point that cannot be located: {why}")
            found[fraction] = point
            return _slope(point)

        root = float(brentq(slope, 0.0, 1.0, xtol=FOLD_TOLERANCE))
        slope(root)
        return found[root]

    def _solution(self, point: Point, asked: dict[float, float]) -> BoundarySolution:
        problem = point.problem
        assert isinstance(problem, BoundaryProblem)
        solution = type(self.solution)(self.statement, self.solution.method, point, **self._kept())
        value = asked.get(float(point.z[-1]))
        if value is not None:  # exactly what was asked for, which start + u (end - start) need not give back
            solution.parameters[self.parameter] = value
        return solution

    def _kept(self) -> dict[str, Any]:
        """What a kind of solution knows beyond its point."""
        return self.solution.kept()


def _slope(point: Point) -> float:
    """Rate of the parameter along the branch."""
    return float(point.tangent[point.problem.parameter_index])
