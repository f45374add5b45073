"""A special orbit located to the tolerance, as a solution of the extended problem of its kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.follow.boundary_solutions import BoundarySolutions
from casadi_skin.follow.special_points import BRANCH_POINT, DOUBLING, FOLD, TORUS
from casadi_skin.zero.augmented import Critical, component_sizes, critical_plane, normal_of, seen_push, started
from casadi_skin.zero.orbit import Sizes
from casadi_skin.zero.problem import EPSILON, Scalar
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import BoundaryProblem

NEAR = 0.5  # of the longest step: how far from its approximate place a special orbit may be
PUSHED = 1e-7  # of the null vector: a push of the field that is none


@dataclass(frozen=True, eq=False)
class LocatedOrbit:
    """A special orbit.

    Attributes:
        critical: the extended system that it solves.
        point: its unknowns, those of the linearisation among them.
        value: of the parameter that was found with it.
        error: estimated absolute error of that.
    """

    critical: Critical
    point: Point
    value: float
    error: float


def extended_space(
    critical: Critical,
    old: BoundarySolutions,
    values: Mapping[str, float],
    unit: float,
    parameter: str = "",
    to: float = 1.0,
) -> BoundarySolutions:
    """The space of solutions of an extended problem, at values of the parameters that are held."""
    statement = critical.statement()
    statement = replace(statement, parameters={**statement.parameters, **values})
    states = np.concatenate(
        [old.sizes.states, *[1e-3 * critical.sizes] * (len(statement.model.state_names) // critical.states - 1)]
    )
    scalars = np.concatenate([old.sizes.scalars, [unit], np.ones(len(critical.added))])
    method = replace(old.method, corrector="newton")
    return BoundarySolutions(statement, old.tolerance, method, Sizes(states, scalars), None, parameter, to)


def critical_of(kind: str, space: BoundarySolutions, point: Point, angle: float, first: str) -> Critical:
    """Equations of a critical orbit beside those of any orbit, linearised at an orbit near it."""
    problem = point.problem
    assert isinstance(problem, BoundaryProblem)
    values = point.z[: problem.states].reshape(problem.columns, -1)
    sizes = component_sizes(values)
    normal, turn = np.zeros(values.shape[1]), np.zeros((0, 0))
    if kind in (DOUBLING, TORUS) and space.closure is not None:
        turn = space.closure.matrix
    autonomous = kind == TORUS and space.moves_freely(point)
    if kind == TORUS:
        normal = normal_of(critical_plane(problem, point.z, angle, sizes, turn, autonomous)[2], sizes)
    push, push_ends = np.zeros((0, 0)), np.zeros(0)
    if kind == BRANCH_POINT:
        push, push_ends = seen_push(problem, point.z, space.statement, sizes)
    return Critical(kind, space.statement, first, sizes, normal, turn, autonomous, push, push_ends)


def locate(space: BoundarySolutions, kind: str, point: Point, angle: float = np.pi) -> LocatedOrbit | None:
    """The special orbit of a kind near an orbit of a branch; None where Newton's method finds none there.

    `angle` is that of the multipliers of a torus.
    """
    if kind not in (FOLD, DOUBLING, TORUS, BRANCH_POINT):
        return None
    unit = abs(space.to - space.statement.values[space.parameter])
    try:
        critical = critical_of(kind, space, point, angle, space.parameter)
        return solved(space, critical, point, unit, angle)
    except (ArithmeticError, RuntimeError, NotImplementedError):  # a black box has no second derivatives
        return None


def solved(
    space: BoundarySolutions, critical: Critical, point: Point, unit: float, angle: float = np.pi
) -> LocatedOrbit | None:
    """The solution of an extended problem near an orbit; `unit` is a usual change of the parameter found with it."""
    value, problem = space.parameters(point)[critical.first], point.problem
    assert isinstance(problem, BoundaryProblem)
    extended = extended_space(critical, space, {critical.first: value}, unit)
    finer = extended.levels.problem(problem.resolution).with_constants(problem.constants)
    z, row = started(critical, problem, point.z, value, angle), finer.parameter_row()
    correction = extended.levels.corrector(finer).correct(z, row, 0.0)
    if not correction.converged:
        return None
    found = extended.point_solver.refined(finer, correction, row, Scalar.PARAMETER)
    if found is None:
        return None
    if critical.kind == BRANCH_POINT and abs(float(found.z[-2])) > PUSHED:
        return None
    index = found.problem.states + len(space.statement.free)
    return LocatedOrbit(critical, found, float(found.z[index]), _error(extended, found, index))


def _error(space: BoundarySolutions, point: Point, index: int) -> float:
    """Estimated error of one of the unknown scalars: the difference to a finer level, rounding, and its last digit."""
    problem, better = point.problem, point.better
    assert better is not None
    value = float(point.z[index])
    apart = abs(float(better.z[better.problem.states + index - problem.states]) - value)
    solve = space.point_solver.factor(problem, point.z, problem.parameter_row())
    noise = solve(np.append(problem.rounding(point.z) * problem.probe, 0.0))
    return 2.0 * apart + abs(float(noise[index])) + EPSILON * abs(value)


def point_of(located: LocatedOrbit, space: BoundarySolutions, near: Point, kind: str) -> Point:
    """A special orbit as a point of a branch, with the tangent of one near it."""
    extended, count = located.point, len(space.statement.free)
    problem = space.levels.problem(extended.problem.resolution).with_constants(extended.problem.constants)
    states = extended.z[: extended.problem.states].reshape(
        -1, extended.problem.states // problem.states * located.critical.states
    )
    free = extended.z[extended.problem.states :][:count]
    start = space.statement.values[space.parameter]
    u = (located.value - start) / (space.to - start)
    z = np.concatenate([states[:, : located.critical.states].ravel(), free, [u]])
    error = replace(extended.error, parameter=located.error / abs(space.to - start) / problem.parameter_size(z))
    tangent = near.problem.prolong(near.tangent, problem)
    return replace(
        near, problem=problem, z=z, tangent=tangent, error=error, better=None, special=kind, walked=False,
        requested=False, at_round_off=extended.at_round_off,
    )  # fmt: skip


def special_orbit(space: BoundarySolutions, kind: str, near: Point, angle: float = np.pi) -> Point | None:
    """The special orbit of a kind near an orbit of a branch as a point of it; None where none is found."""
    located = locate(space, kind, near, angle)
    if located is None:
        return None
    found = point_of(located, space, near, kind)
    there = near.problem.prolong(near.z, found.problem)
    apart = float(np.sqrt(np.sum(space.point_solver.metric(found.problem, there) * (found.z - there) ** 2)))
    return found if apart <= NEAR * space.point_solver.settings.max_step else None
