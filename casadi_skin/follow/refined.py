"""A solution of a boundary-value problem refined until its estimated error meets the tolerance."""

from __future__ import annotations

from casadi_skin.follow.point import PointSolver
from casadi_skin.solve.newton import Correction
from casadi_skin.solve.rank_deficiency import in_family, rank_deficiency
from casadi_skin.zero.problem import Scalar, SingularError
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import BoundaryProblem, stated

MEANINGLESS_ERROR = 1e-2  # estimated error beyond which a solution is no solution, rounding or not


class BoundaryError(ArithmeticError):
    """No solution was found: the message names condition, variable and place in one line."""


class FamilyError(BoundaryError):
    """An orbit is one of a family: the model conserves something that is not declared."""


def refined(point_solver: PointSolver, problem: BoundaryProblem, correction: Correction) -> Point:
    """The solution of a correction on a mesh that meets the tolerance, with u held; raises BoundaryError."""
    name = problem.statement.model.name
    try:
        point = point_solver.refined(problem, correction, problem.parameter_row(), Scalar.PARAMETER)
    except SingularError as error:
        family = in_family(problem, correction.z)
        if family:
            raise FamilyError(f"{name}: {family}") from error
        reason = rank_deficiency(problem, correction.z) or str(error)
        raise BoundaryError(f"{name}: the solution cannot be refined: {reason}") from error
    if point is None:
        top = point_solver.levels.resolutions[-2]
        raise BoundaryError(f"{name}: more than {top} intervals are needed for the tolerance; try a larger one")
    finer = stated(point.problem)
    backwards = finer.backwards(point.z)
    if backwards:
        raise BoundaryError(f"{name}: {backwards}")
    if point.error.relative(1.0) > MEANINGLESS_ERROR:
        family = in_family(finer, point.z)
        if family:
            raise FamilyError(f"{name}: {family}")
        reason = rank_deficiency(finer, point.z) or "the equations are nearly singular there"
        words = f"rounding alone leaves an error of {point.error.relative(1.0):.1e}"
        raise BoundaryError(f"{name}: no solution near the guess: {words}; {reason}")
    return point
