"""A special orbit located to the tolerance, as a solution of the extended problem of its kind.

A special point located to rounding, by Newton's method on the extended system of which it is a regular solution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.follow.boundary_solutions import BoundarySolutions
from casadi_skin.follow.equilibrium_equations import EquilibriumEquations, corrector_of
from casadi_skin.solve.levels import ExactLevels
from casadi_skin.zero.augmented import (
    BranchSystem,
    Critical,
    ExtendedSystem,
    FoldSystem,
    HopfSystem,
    component_sizes,
    critical_plane,
    normal_of,
    seen_push,
    started,
)
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLING, FOLD, HOPF, TORUS
from casadi_skin.zero.orbit import Sizes
from casadi_skin.zero.problem import EPSILON, Array, Scalar, SingularError
from casadi_skin.zero.rest_problem import AlgebraicProblem
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import stated
from casadi_skin.zero.statics import balanced

# A special point located to rounding, by Newton's method on the extended system of which it is a regular solution -----

EXTENDED_SYSTEMS: dict[str, type[ExtendedSystem]] = {FOLD: FoldSystem, BRANCH_POINT: BranchSystem, HOPF: HopfSystem}
IMPERFECTION_RTOL = 1e-7  # of the norm of the balanced Jacobian: an imperfection by which no two branches meet


@dataclass(frozen=True, eq=False)
class Located:
    """A special point: the state y over its sizes with its relative error `profile`, the scalar s with its error.

    `solution` holds all unknowns of the extended system `system`.
    """

    y: Array
    s: float
    error: float
    profile: float
    system: AlgebraicProblem
    solution: Array

    @property
    def frequency(self) -> float:
        """Imaginary part of the critical eigenvalues; 0 where they are real."""
        if not isinstance(self.system, HopfSystem):
            return 0.0
        return float(self.system.rate * np.sqrt(self.system.kappa(self.solution)))


def system_of(equations: EquilibriumEquations, kind: str, rate: float) -> ExtendedSystem | None:
    """The extended system for special points of a kind on a branch; None where derivatives it needs are not there."""
    known = equations.systems
    if kind not in known:
        assert equations.course is not None
        system = EXTENDED_SYSTEMS[kind](equations.statics, equations.sizes, (equations.course,), rate=rate)
        try:
            _ = system.function
        except (RuntimeError, NotImplementedError):  # the model is a black box with first derivatives alone
            known[kind] = None
        else:
            known[kind] = system
    return known[kind]


def locate_rest(
    equations: EquilibriumEquations, kind: str, y: Array, s: float, near: complex | None = None
) -> Located | None:
    """The special point of a kind near (y, s); None where Newton's method finds none there.

    `near` selects the pair of eigenvalues of a Hopf point.
    """
    matrix = jacobian_of(equations.problem, np.append(y, s))
    system = system_of(equations, kind, abs(near or 0.0) or 1.0)
    if system is None:
        return None
    try:
        problem, z = system.started(matrix, y, np.array([s]), near)
        correction = corrector_of("newton", equations.tolerance, problem).correct(z, problem.parameter_row(), 0.0)
        if not correction.converged:
            return None
        return measured(problem, correction.z, kind)
    except (SingularError, ArithmeticError):
        return None


def measured(problem: AlgebraicProblem, z: Array, kind: str) -> Located | None:
    """A solution of an extended system after one more Newton step, with its errors; None for one of another kind."""
    levels = ExactLevels(problem, lambda _: None)  # type: ignore[arg-type, return-value]
    row = problem.parameter_row()
    for _ in range(2):
        residual, nonzeros = problem.evaluate(z)
        solve = levels.solver(problem).factor(z, nonzeros, row)
        step = solve(np.append(residual, 0.0))
        z = z - step
    noise = solve(problem.rounding(z) * np.append(problem.probe, 0.0))
    place, n = problem.states, problem.statics.size
    scale = float(np.linalg.norm(balanced(jacobian_of(problem, z))[0]))  # a rate, as the imperfection is
    if kind == BRANCH_POINT and abs(z[place + len(problem.free)]) > IMPERFECTION_RTOL * scale:
        return None
    if isinstance(problem, HopfSystem) and not problem.kappa(z) > 0.0:
        return None  # a neutral saddle
    course = problem.free[0]
    floor = EPSILON * max(abs(z[place]), abs(course.at(z[place])) / abs(course.to - course.start))
    error = 2.0 * abs(float(step[place])) + abs(float(noise[place])) + floor
    profile = problem.profile_change(z, step) + problem.profile_change(z, noise)
    return Located(z[:n], float(z[place]), float(error), profile, problem, z)


def jacobian_of(problem: AlgebraicProblem, z: Array) -> Array:
    """dF/dy at a point, in units of the sizes."""
    matrix = problem.statics.jacobian(problem.state(z), problem.parameters(z))
    return np.asarray(matrix * problem.scale / problem.scale[:, None])


NEAR_STEP_FRACTION = 0.5  # of the longest step: how far from its approximate place a special orbit may be
PUSH_RTOL = 1e-7  # of the null vector: a push of the field that is none


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
    return BoundarySolutions(statement, old.tolerance, method, Sizes(states, scalars), parameter=parameter, to=to)


def critical_of(kind: str, space: BoundarySolutions, point: Point, angle: float, first: str) -> Critical:
    """Equations of a critical orbit beside those of any orbit, linearised at an orbit near it."""
    problem = stated(point.problem)
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
    value, problem = space.parameters(point)[critical.first], stated(point.problem)
    extended = extended_space(critical, space, {critical.first: value}, unit)
    finer = extended.levels.problem(problem.resolution).with_constants(problem.constants)
    z, row = started(critical, problem, point.z, value, angle), finer.parameter_row()
    correction = extended.levels.corrector(finer).correct(z, row, 0.0)
    if not correction.converged:
        return None
    found = extended.point_solver.refined(finer, correction, row, Scalar.PARAMETER)
    if found is None:
        return None
    if critical.kind == BRANCH_POINT and abs(float(found.z[-2])) > PUSH_RTOL:
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
    return found if apart <= NEAR_STEP_FRACTION * space.point_solver.settings.max_step else None
