"""A special orbit located to the tolerance, as a solution of the extended problem of its kind.

A special point located to rounding, by Newton's method on the extended system of which it is a regular solution.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from casadi_skin.follow.space import SolutionSpace, corrector_of
from casadi_skin.solve.levels import ExactLevels
from casadi_skin.zero.augmented import (
    BranchSystem,
    ExtendedSystem,
    FoldSystem,
    HopfSystem,
    Singularity,
    SingularProblem,
    singularity_of,
)
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLING, FOLD, HOPF, TORUS
from casadi_skin.zero.orbit import Sizes
from casadi_skin.zero.problem import EPSILON, Array, Scalar, SingularError
from casadi_skin.zero.rest import AlgebraicProblem, balanced
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import stated
from casadi_skin.zero.statement import Statement

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


def system_of(equations: SolutionSpace, kind: str, rate: float) -> ExtendedSystem | None:
    """The extended system for special points of a kind on a branch; None where derivatives it needs are not there."""
    known: dict[str, ExtendedSystem | None] = equations.systems
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


def locate_rest(equations: SolutionSpace, kind: str, y: Array, s: float, near: complex | None = None) -> Located | None:
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
ROUNDING_PROBES = 8  # changes of the equations by their rounding, of signs drawn at random
ROUNDING_DEVIATIONS = 4.0  # standard deviations of the responses: that to one probe alone was up to 5 times too small
PUSH_RTOL = 1e-7  # of the terms of the equations: a push of the field that is none


@dataclass(frozen=True, eq=False)
class LocatedOrbit:
    """A special orbit.

    Attributes:
        singularity: what makes it special.
        point: its unknowns, the parameter that was found with it among them.
        value: of that parameter.
        error: estimated absolute error of it.
    """

    singularity: Singularity
    point: Point
    value: float
    error: float


def special_solutions(
    singularity: Singularity,
    orbits: SolutionSpace,
    statement: Statement,
    unit: float,
    parameter: str = "",
    to: float = 1.0,
) -> Any:
    """The space of special solutions of a statement; `unit` is a usual change of the parameter found with them."""
    scalars = np.concatenate([orbits.sizes.scalars, [unit], np.ones(singularity.added)])
    method = replace(orbits.method, corrector="newton")
    sizes = Sizes(orbits.sizes.states, scalars)
    special = replace(cast(Any, orbits), statement=statement, method=method, sizes=sizes, singularity=singularity)
    return replace(
        special, parameter=parameter, to=to, periodic=None, left=None, at=(), first=None, settings=None, leaves=False
    )


def locate(space: SolutionSpace, kind: str, near: Point, angle: float = np.pi) -> LocatedOrbit | None:
    """The special orbit of a kind near an orbit of a branch; None where Newton's method finds none there.

    `angle` is that of the multipliers of a torus.
    """
    if kind not in (FOLD, DOUBLING, TORUS, BRANCH_POINT):
        return None
    try:
        return _located(space, kind, near, angle)
    except (ArithmeticError, RuntimeError):  # the linearised equations are singular in another way
        return None


def _located(space: SolutionSpace, kind: str, near: Point, angle: float) -> LocatedOrbit | None:
    value, problem, first = space.parameters(near)[space.parameter], stated(near.problem), space.parameter
    turn = np.zeros((0, 0)) if space.closure is None else space.closure.matrix
    autonomous = kind == TORUS and space.moves_freely(near)
    singularity = singularity_of(kind, problem, near.z, first, angle, turn, autonomous)
    unit = abs(space.to - space.statement.values[first])
    special = special_solutions(singularity, space, space.statement.with_parameters(**{first: value}), unit)
    own = cast(SingularProblem, special.levels.problem(problem.resolution).with_constants(problem.constants))
    if own.rests(near.z):
        own = cast(SingularProblem, special.levels.finer(own) or own)
    added = [np.cos(angle)] if kind == TORUS else [0.0] * singularity.added
    z, row = np.concatenate([problem.prolong(near.z, own)[:-1], [value], added, [0.0]]), own.parameter_row()
    correction = special.levels.corrector(own).correct(z, row, 0.0)
    found = special.point_solver.refined(own, correction, row, Scalar.PARAMETER) if correction.converged else None
    if found is None or (kind == BRANCH_POINT and abs(float(found.z[-2])) > PUSH_RTOL):
        return None
    problem, better, index = stated(found.problem), found.better, len(space.statement.free)
    assert better is not None
    residual, rounding = problem.evaluate(found.z)[0], problem.rounding(found.z)
    solve = special.point_solver.factor(problem, found.z, problem.parameter_row())
    step, z = solve(np.append(residual, 0.0)), found.z
    z, index = z - step, problem.states + index
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (ROUNDING_PROBES, rounding.size))
    noise = [float(solve(np.append(one * rounding, 0.0))[index]) for one in signs]
    value = float(z[index])
    apart = abs(float(better.z[better.problem.states + index - problem.states]) - value)
    by_rounding = ROUNDING_DEVIATIONS * float(np.sqrt(np.mean(np.square(noise)))) + EPSILON * max(abs(value), unit)
    error = 2.0 * apart + by_rounding
    return LocatedOrbit(singularity, replace(found, z=z), value, error)


def special_orbit(space: SolutionSpace, kind: str, near: Point, angle: float = np.pi) -> Point | None:
    """The special orbit of a kind near an orbit of a branch as a point of it, with the tangent of that orbit.

    None where none is found.
    """
    located = locate(space, kind, near, angle)
    if located is None:
        return None
    special, start = located.point, space.statement.values[space.parameter]
    problem = space.levels.problem(special.problem.resolution).with_constants(special.problem.constants)
    z = np.append(special.z[: problem.size - 1], (located.value - start) / (space.to - start))
    error = located.error / abs(space.to - start) / problem.parameter_size(z)
    there, tangent = (near.problem.prolong(v, problem) for v in (near.z, near.tangent))
    if space.point_solver.distance(problem, there, z) > NEAR_STEP_FRACTION * space.point_solver.settings.max_step:
        return None
    return replace(
        near, problem=problem, z=z, tangent=tangent, error=replace(special.error, parameter=error), better=None,
        special=kind, walked=False, requested=False, at_round_off=special.at_round_off,
    )  # fmt: skip
