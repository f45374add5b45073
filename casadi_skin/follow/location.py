"""A special solution located to the tolerance, as a regular solution of the augmented problem of its kind.

Equilibria, orbits and solutions of boundary-value problems alike: by Newton's method, refined level by level where
there are several, and by one step more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.space import SolutionSpace, corrector_of
from casadi_skin.solve.levels import ExactLevels
from casadi_skin.zero.augmented import Augmented, Singularity, SingularProblem, singular_rest, singularity_of
from casadi_skin.zero.kinds import BRANCH_POINT, DOUBLING, FOLD, HOPF, TORUS
from casadi_skin.zero.orbit import Sizes
from casadi_skin.zero.problem import EPSILON, Array, Scalar
from casadi_skin.zero.settings import ContinuationSettings, ErrorEstimate, Point
from casadi_skin.zero.stated_problem import stated
from casadi_skin.zero.statement import Statement

REST_KINDS = (FOLD, BRANCH_POINT, HOPF)  # of equilibria
ORBIT_KINDS = (FOLD, DOUBLING, TORUS, BRANCH_POINT)  # of orbits and of solutions of boundary-value problems
NEAR_STEP_FRACTION = 0.5  # of the longest step: how far from its approximate place a special orbit may be
ROUNDING_PROBES = 8  # changes of the equations by their rounding, of signs drawn at random
ROUNDING_DEVIATIONS = 4.0  # standard deviations of the responses: that to one probe alone was up to 5 times too small
PUSH_RTOL = 1e-7  # of the size of a push of the equations: one by which two branches still meet


@dataclass(frozen=True, eq=False)
class Located:
    """A special solution.

    Attributes:
        singularity: what makes it special.
        point: its unknowns, the parameter that was found with it among them.
        value: of that parameter; of an equilibrium the fraction of its course.
        error: estimated absolute error of it.
    """

    singularity: Singularity
    point: Point
    value: float
    error: float

    @property
    def resting(self) -> Array:
        """The state of an equilibrium over its sizes, and the fraction of the course."""
        return np.asarray(self.point.z[: self.point.problem.first_index + 1])

    @property
    def frequency(self) -> float:
        """Imaginary part of the critical eigenvalues of a Hopf point."""
        return float(self.singularity.rate * np.sqrt(self.point.z[self.point.problem.added_index]))


def locate_rest(space: SolutionSpace, kind: str, near: Array, pair: complex | None = None) -> Located | None:
    """The special equilibrium of a kind near (y, s); None where Newton's method finds none there.

    `pair` selects the pair of eigenvalues of a Hopf point.
    """
    try:
        problem, z = singular_rest(kind, space.problem, near, pair)
        levels = ExactLevels(problem, lambda problem: corrector_of("newton", space.tolerance, problem))
        unit = abs(space.course.at(near[-1]) / (space.course.to - space.course.start))
        return _solved(PointSolver(levels, ContinuationSettings(1.0, space.tolerance)), problem, z, unit)
    except (ArithmeticError, RuntimeError):  # the linearised equations are singular in another way
        return None


def locate(space: SolutionSpace, kind: str, near: Point, angle: float = np.pi) -> Located | None:
    """The special orbit of a kind near an orbit of a branch; None where Newton's method finds none there.

    `angle` is that of the multipliers of a torus.
    """
    if kind not in ORBIT_KINDS:
        return None
    value, problem, first = space.parameters(near)[space.parameter], stated(near.problem), space.parameter
    try:
        turn = np.zeros((0, 0)) if space.closure is None else space.closure.matrix
        autonomous = kind == TORUS and space.moves_freely(near)
        singularity = singularity_of(kind, problem, near.z, first, angle, turn, autonomous)
        unit = abs(space.to - space.statement.values[first])
        special = special_solutions(singularity, space, space.statement.with_parameters(**{first: value}), unit)
        own = cast(SingularProblem, special.levels.problem(problem.resolution).with_constants(problem.constants))
        if own.rests(near.z):
            own = cast(SingularProblem, special.levels.finer(own) or own)
        added = [np.cos(angle)] if kind == TORUS else [0.0] * singularity.added
        z = np.concatenate([problem.prolong(near.z, own)[:-1], [value], added, [0.0]])
        return _solved(special.point_solver, own, z, unit)
    except (ArithmeticError, RuntimeError):  # the linearised equations are singular in another way
        return None


def _solved(solver: PointSolver, problem: Augmented, z: Array, unit: float) -> Located | None:
    """The regular solution near z; `unit` is a usual change of the first parameter. None without one of the kind."""
    row, singularity = problem.parameter_row(), problem.singularity
    correction = solver.levels.corrector(problem).correct(z, row, 0.0)
    found = solver.refined(problem, correction, row, Scalar.PARAMETER) if correction.converged else None
    if found is None:
        return None
    problem, better, z = found.problem, found.better, found.z
    assert better is not None
    solve, index = solver.factor(problem, z, problem.parameter_row()), problem.first_index
    step, rounding = solve(np.append(problem.evaluate(z)[0], 0.0)), problem.rounding(z)
    z = z - step
    if better.problem is problem:  # of one level, whose error steps make up for
        z = z - solve(np.append(problem.evaluate(z)[0], 0.0))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (ROUNDING_PROBES, rounding.size))
    noise = np.array([solve(np.append(one * rounding, 0.0)) for one in signs])
    value, spread = float(z[index]), np.sqrt(np.mean(noise**2, axis=0))
    apart = abs(float(better.z[better.problem.first_index]) - value)
    error = 2.0 * apart + ROUNDING_DEVIATIONS * float(spread[index]) + EPSILON * max(abs(value), unit)
    if singularity.kind == BRANCH_POINT and abs(z[problem.added_index]) > PUSH_RTOL * problem.push_size(z):
        return None
    if singularity.kind == HOPF and not z[problem.added_index] > 0.0:
        return None  # a neutral saddle
    if better.problem is problem:
        profile = problem.profile_change(z, step) + problem.profile_change(z, ROUNDING_DEVIATIONS * spread)
        found = replace(found, error=ErrorEstimate(0.0, profile))
    return Located(singularity, replace(found, z=z), value, error)


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
