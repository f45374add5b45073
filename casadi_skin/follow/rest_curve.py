"""Folds, Hopf points and branch points followed in a second parameter, by extended systems that are regular there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np

from casadi_skin.follow.codimension_two import EQUILIBRIUM_CURVES, EquilibriumCurveSearch, special_on_curve
from casadi_skin.follow.equilibrium_equations import corrector_of
from casadi_skin.follow.follow import following_settings
from casadi_skin.follow.location import EXTENDED_SYSTEMS, jacobian_of
from casadi_skin.follow.rest_space import EquilibriumError, EquilibriumSpace
from casadi_skin.follow.solution import Equilibrium
from casadi_skin.follow.special_points import SpecialPoint, check_second
from casadi_skin.solve.levels import ExactLevels, Levels
from casadi_skin.zero.kinds import BRANCH_POINT, FOLD, HOPF, Unresolved
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_problem import AlgebraicProblem, Course, sizes_at
from casadi_skin.zero.settings import End, Point
from casadi_skin.zero.statics import Statics, balanced

UNFOLDING_IMPERFECTION = (
    1e-7  # of the norm of the balanced Jacobian, in a step: an imperfection that grows along a curve
)


class UnfoldingError(EquilibriumError):
    """A branch point does not stay one in a second parameter: nothing keeps both branches together."""


@dataclass(frozen=True, eq=False)
class CurveSpace(EquilibriumSpace):
    """Special points of a model in two parameters, of which one is followed and the other one free.

    Attributes:
        kind: "fold", "hopf" or "branch point".
        second: course of the free parameter: 0 at its start, 1 after a change by its usual size.
        rate: scale of omega.
    """

    kind: str = FOLD
    second: Course | None = None
    rate: float = 1.0

    @cached_property
    def problem(self) -> AlgebraicProblem:
        """The extended system, with u that follows the parameter."""
        assert self.second is not None
        system = EXTENDED_SYSTEMS[self.kind](self.statics, self.sizes, (self.second,), self.course, self.rate)
        if self.first is not None:
            return system.with_constants(self.first.problem.constants)
        return system

    @cached_property
    def levels(self) -> Levels:
        """The only level."""
        return ExactLevels(self.problem, lambda problem: corrector_of(self.corrector, self.tolerance, problem))

    @property
    def free(self) -> tuple[str, ...]:
        """The parameter that is solved for with the state."""
        return () if self.second is None else (self.second.name,)

    def special_between(self, before: Point, after: Point) -> Iterator[Point | Unresolved]:
        """Points of codimension two on the stretch between two points, in order, and parts that are not resolved."""
        yield from special_on_curve(EquilibriumCurveSearch(self, self.kind, before, after))

    def stop(self, point: Point) -> tuple[End | None, str]:
        """Beyond a Bogdanov-Takens point there are neutral saddles in place of Hopf points."""
        return EQUILIBRIUM_CURVES[self.kind].ends.get(point.special), ""


def curve_space(
    point: SpecialPoint,
    parameter: str,
    to: float,
    *,
    at: Sequence[float],
    max_points: int,
    max_step: float,
    back_to: float | None = None,
) -> CurveSpace:
    """The space of the curve of a special point of equilibria in a second parameter.

    Raises ValueError for arguments out of range and points of another kind, EquilibriumError where the curve cannot be
    started, or a branch point does not stay one.
    """
    solution = point.solution
    if not isinstance(solution, Equilibrium) or point.kind not in EXTENDED_SYSTEMS or solution.space.free:
        raise ValueError(f"curve: given a {point.kind}; accepted: a fold, Hopf point or branch point of equilibria")
    check_second(point, parameter)
    settings = following_settings(
        solution, parameter, to, at=at, max_points=max_points, max_step=max_step, back_to=back_to
    )
    return replace(_started(point, parameter, float(to), tuple(float(value) for value in at)), settings=settings)


def _started(point: SpecialPoint, parameter: str, to: float, at: tuple[float, ...]) -> CurveSpace:
    """The space of the curve through a special point; raises EquilibriumError where derivatives are not there."""
    solution = cast(Equilibrium, point.solution)
    old = cast(EquilibriumSpace, solution.space)
    statics = Statics(old.model, solution.parameters)
    x, p0, course = solution.positions, solution.parameters[point.parameter], old.course
    assert course is not None
    sizes = sizes_at(statics, x, (course, Course(parameter, solution.parameters[parameter], to)), old.sizes)
    second = Course(point.parameter, p0, p0 + (course.to - course.start))
    rate = point.frequency if point.kind == HOPF else 1.0
    space = CurveSpace(
        statics, old.tolerance, old.corrector, sizes, parameter, to, at=at, kind=point.kind, second=second, rate=rate
    )
    try:
        _ = space.problem.function
    except (RuntimeError, NotImplementedError):
        words = "the model has no second derivatives, which a curve in two parameters needs"
        raise EquilibriumError(f"{old.model.name}: {words}") from None
    z = np.concatenate([x / sizes, np.zeros(space.problem.size - x.size)])
    matrix = jacobian_of(space.problem, z)
    near = 1j * rate if point.kind == HOPF else None
    problem, z = _extended(space, matrix, x / sizes, near)
    space = replace(space, first=replace(solution.point, problem=problem, z=z, special="", walked=True))
    size = float(np.linalg.norm(balanced(matrix)[0]))
    if (
        point.kind == BRANCH_POINT and abs(space.start.tangent[problem.states + 1]) > UNFOLDING_IMPERFECTION * size
    ):  # of beta
        why = "no symmetry, and no state that stays zero, keeps both branches together"
        raise UnfoldingError(f"{old.model.name}: the branch point is none at other values of {parameter}: {why}")
    return space


def _extended(space: CurveSpace, matrix: Array, y: Array, near: complex | None) -> tuple[AlgebraicProblem, Array]:
    from casadi_skin.zero.augmented import ExtendedSystem

    return cast(ExtendedSystem, space.problem).started(matrix, y, np.zeros(1), near)
