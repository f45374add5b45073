"""A special point located to rounding, by Newton's method on the extended system of which it is a regular solution."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.follow.equilibrium_equations import EquilibriumEquations, corrector_of
from casadi_skin.solve.levels import ExactLevels
from casadi_skin.zero.problem import EPSILON, Array, SingularError
from casadi_skin.zero.rest_problem import AlgebraicProblem
from casadi_skin.zero.rest_systems import BranchSystem, ExtendedSystem, FoldSystem, HopfSystem
from casadi_skin.zero.statics import balanced

FOLD, BRANCH_POINT, HOPF = "fold", "branch point", "hopf"
SYSTEMS: dict[str, type[ExtendedSystem]] = {FOLD: FoldSystem, BRANCH_POINT: BranchSystem, HOPF: HopfSystem}
IMPERFECT = 1e-7  # of the norm of the balanced Jacobian: an imperfection by which no two branches meet


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
        system = SYSTEMS[kind](equations.statics, equations.sizes, (equations.course,), rate=rate)
        try:
            _ = system.function
        except (RuntimeError, NotImplementedError):  # the model is a black box with first derivatives alone
            known[kind] = None
        else:
            known[kind] = system
    return known[kind]


def locate(
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
    if kind == BRANCH_POINT and abs(z[place + len(problem.free)]) > IMPERFECT * scale:
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
