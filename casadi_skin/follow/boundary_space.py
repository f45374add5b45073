"""A branch of solutions of one boundary-value problem: equations by resolution, special points, its end."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.follow.arclength import ArclengthContinuation
from casadi_skin.follow.boundary_solutions import BoundarySolutions
from casadi_skin.follow.bounds import margin, met_between
from casadi_skin.follow.branch_points import branch_points_between
from casadi_skin.follow.crossing_place import ONE_PLACE
from casadi_skin.follow.settings import Continuation, ContinuationSettings, End, Point
from casadi_skin.follow.shrinking import hopf_end
from casadi_skin.follow.special_points import BOUND, BRANCH_POINT, FOLD, HETEROCLINIC, HOMOCLINIC, HOPF, fold_between
from casadi_skin.follow.turns import turning
from casadi_skin.follow.unresolved import Unresolved
from casadi_skin.points.period_limit import joined_words, unbounded
from casadi_skin.solve.refined import BoundaryError, refined
from casadi_skin.zero.boundary_choices import Sizes
from casadi_skin.zero.location import special_orbit
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem

if TYPE_CHECKING:
    from casadi_skin.follow.solution import Solution

BESIDE = 1e-3  # of the way from a branch point: where the search for other special points starts


@dataclass(frozen=True, eq=False)
class BoundarySpace(BoundarySolutions):
    """The branch of solutions of a statement in one parameter (see `SolutionSpace`)."""

    start_is_limit: bool = field(default=False, init=False)
    locates_folds: bool = field(default=True, init=False)
    S_rate: float = field(default=1.0, init=False)

    # The branch -----------------------------------------------------------------------------------------------------

    @cached_property
    def start(self) -> Point:
        """The first solution as a point of the branch; raises BoundaryError where it cannot be solved again."""
        first = self.first
        assert first is not None
        assert isinstance(first.problem, BoundaryProblem)
        if self.leaves:
            return replace(first, step=self.point_solver.settings.first_step)
        problem = self.levels.problem(first.problem.resolution).with_constants(first.problem.constants)
        assert isinstance(problem, BoundaryProblem)
        z = first.z.copy()
        z[-1] = 0.0
        correction = self.levels.corrector(problem).correct(z, problem.parameter_row(), 0.0)
        if not correction.converged:
            raise BoundaryError(f"the start of the branch: {correction.status.value}; {problem.worst(correction.z)}")
        return replace(refined(self.point_solver, problem, correction), step=self.point_solver.settings.first_step)

    def continuation(self, history: tuple[Point, ...], reported: tuple[Point, ...] = ()) -> Continuation:
        """Pseudo-arclength continuation from its last points, and from points reported after these."""
        return ArclengthContinuation(self.point_solver, history, reported)

    def special_between(self, before: Point, after: Point) -> Iterator[Point | Unresolved]:
        """Folds on the stretch between two points, and the Hopf point where an orbit shrinks to an equilibrium.

        The later point itself where the period grows without bound there; where a bound is met, that point comes last.
        Of a boundary-value problem that is no orbit
        the branch points too, which are folds as well where both are one.
        """
        met = met_between(self, before, after)
        after, crossed = met or after, []
        if self.periodic is None and not (self.leaves and not np.any(before.z[-1:] != self.start.z[-1:])):
            found = branch_points_between(self.point_solver, before, after)
            crossed = [point if several else self._solved(point, before) for point, several in found]
        first: Point | None = before
        for point in crossed:
            left = None if first is None else self.point_solver.along(first, point, 1.0 - BESIDE)
            if first is not None and left is not None:
                yield from self._turns_between(first, left)
            yield point
            first = self.point_solver.along(point, after, BESIDE)
        if first is not None:
            yield from self._turns_between(first, after)
        if met is not None:
            yield met

    def singular_near(self, guess: Point) -> Point | None:
        """The solution near a guess at which branches cross: orbits there are sought by multipliers alone."""
        return special_orbit(self, BRANCH_POINT, guess)

    def _solved(self, branch_point: Point, before: Point) -> Point:
        """A branch point as a solution of its extended equations, where they have one in the same place."""
        located = special_orbit(self, BRANCH_POINT, branch_point)
        if located is None:
            return branch_point
        solver, problem = self.point_solver, located.problem
        there, start = (point.problem.prolong(point.z, problem) for point in (branch_point, before))
        reach = ONE_PLACE * solver.distance(problem, start, there)
        return located if solver.distance(problem, there, located.z) <= reach else branch_point

    def _turns_between(self, before: Point, after: Point) -> Iterator[Point]:
        """The same on a stretch without branch points."""
        unbounded = self._unbounded(before, after)
        if unbounded is not None:
            yield unbounded
            return
        parts = turning(self.point_solver, before, after)
        hopf: Point | None = None
        if parts and self.shrinks(before, after):
            hopf = hopf_end(self, before, after)
        end = hopf if self.left is None or hopf is not None else self.left.rejoined(self, before, after)
        passed = parts if end is None else parts[: len(parts) // 2]  # beyond it the same folds come again
        yield from (self._fold_between(*part) for part in passed)
        if end is not None:
            yield end

    def _fold_between(self, before: Point, after: Point) -> Point:
        """The fold between two points; of orbits as a solution of its extended equations."""
        fold = fold_between(self.point_solver, before, after)
        if self.periodic is None:
            return fold
        kinds = (FOLD, BRANCH_POINT) if self.left is None else (FOLD,)  # a branch that crosses upright turns there too
        found = (special_orbit(self, kind, fold) for kind in kinds)
        return next((point for point in found if point is not None), fold)

    def _unbounded(self, before: Point, after: Point) -> Point | None:
        """The later of two orbits where the period grows without bound there."""
        if self.periodic is None or PERIOD not in self.statement.free:
            return None
        return unbounded(self, before, after)

    def stop(self, point: Point) -> tuple[End | None, str]:
        if point.special == HOPF:
            return End.HOPF, ""
        if point.special == BRANCH_POINT and self.left is not None:
            return End.REJOINED, ""
        if point.special == BOUND:
            return End.BOUND, f"{margin(self, point)}, {point.problem.whereabouts(point.z)}"
        if point.special in (HOMOCLINIC, HETEROCLINIC):
            value, error = self.parameters(point)[self.parameter], self.parameter_error(point)
            where = f"{self.parameter} = {value:.10g} +- {error:.0e}"
            return End.UNBOUNDED, f"{joined_words(self, point)}, at {where}"
        jumps = self.jump(point)
        if jumps:
            return End.JUMP, jumps
        problem = point.problem
        assert isinstance(problem, BoundaryProblem)
        words = problem.backwards(point.z)
        return (End.NO_STEP if words else None), words

    def following(
        self, solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings
    ) -> BoundarySpace:
        """The space of the branch through one of these solutions in a parameter."""
        statement = self.statement.with_parameters(**solution.parameters)
        sizes = Sizes(solution.problem.floors, solution.problem.scalar_floors)
        return BoundarySpace(
            statement, self.tolerance, self.method, sizes, self.periodic, parameter, to, at, solution.point, settings
        )
