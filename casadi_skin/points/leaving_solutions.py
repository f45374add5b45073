"""Solutions that leave a branch of a boundary-value problem: the other branch, or those that close after two turns."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch_points import leaving_tangent
from casadi_skin.follow.settings import ContinuationSettings, Point
from casadi_skin.follow.solution import Solution
from casadi_skin.solve.refined import BoundaryError
from casadi_skin.zero import mesh
from casadi_skin.zero.boundary_choices import Sizes
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import BoundaryProblem


def other_solutions(
    solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings, side: int
) -> BoundarySpace:
    """The space of the other branch at a branch point of a boundary-value problem."""
    old = cast(BoundarySpace, solution.space)
    space = old.following(solution, parameter, to, at, settings)
    problem = space.levels.problem(solution.intervals).with_constants(solution.problem.constants)
    z, along = solution.point.z.copy(), solution.point.tangent.copy()
    z[-1] = 0.0
    along[-1] *= (old.to - old.statement.values[old.parameter]) / (to - solution.parameters[parameter])
    first = replace(solution.point, problem=problem, z=z, tangent=along, special="")
    return _left_along(space, first, side)


def _left_along(space: BoundarySpace, first: Point, side: int) -> BoundarySpace:
    """The space of the branch that leaves at a point with the tangent of the other one."""
    tangent = leaving_tangent(space.point_solver, first, side)
    return replace(space, first=replace(first, tangent=tangent), leaves=True)


def doubled_solutions(
    solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings, side: int
) -> BoundarySpace:
    """The space of the solutions that close after two turns, from a period doubling of those that close after one.

    Raises BoundaryError where the field is another one in the second turn.
    """
    old, problem, z = cast(BoundarySpace, solution.space), solution.problem, solution.point.z
    closure, p = old.closure, problem.parameters(z)
    if closure is None or not closure.goes_on(problem, z):
        why = "the field does not repeat itself after the interval, as conditions x(end) = S x(start) suppose"
        raise BoundaryError(f"{old.model.name}: no solutions of two turns leave at the period doubling: {why}")
    statement = closure.twice().with_parameters(**solution.parameters)
    sizes = Sizes(problem.floors, problem.scalar_floors)
    space = BoundarySpace(statement, old.tolerance, old.method, sizes, None, parameter, to, at, None, settings, True)
    resolutions = [r for r in space.levels.resolutions if r >= 2 * solution.intervals]
    resolution = resolutions[0] if resolutions else space.levels.resolutions[-1]
    lengths = mesh.resampled(np.tile(problem.constants, 2) / 2.0, resolution)
    twice = cast(BoundaryProblem, space.levels.problem(resolution).with_constants(lengths))

    def over_two_turns(values: Array, shift: Array) -> Array:
        """States, or a direction, over the second turn as over the first, at the unknowns of two turns."""
        turns = 2.0 * twice._fractions()
        second = turns > 1.0
        found = problem.sample(values, np.where(second, turns - 1.0, turns))
        found[second] = found[second] @ closure.matrix.T + shift
        return found.ravel()

    states, free = over_two_turns(z, closure.shift(p)), z[problem.states : -1]
    along = over_two_turns(solution.point.tangent, np.zeros(closure.matrix.shape[0]))
    before = (old.to - old.statement.values[old.parameter]) / (to - solution.parameters[parameter])
    rates = np.append(solution.point.tangent[problem.states : -1], before * solution.point.tangent[-1])
    start = np.concatenate([states, free, [0.0]])
    first = Point(twice, start, np.append(along, rates), solution.point.error, settings.first_step, 0)
    return _left_along(space, first, side)
