"""Equilibria of one model as the solutions that a branch connects (see `SolutionSpace`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np

from casadi_skin.follow.codimension_two import EQUILIBRIUM_CURVES, EquilibriumCurveSearch, special_on_curve
from casadi_skin.follow.equilibrium_equations import EquilibriumEquations, corrector_of
from casadi_skin.follow.location import EXTENDED_SYSTEMS, jacobian_of
from casadi_skin.follow.rest_events import special_between
from casadi_skin.follow.solution import Equilibrium, Solution, following_settings
from casadi_skin.follow.space import EQUILIBRIA
from casadi_skin.follow.special_points import SpecialPoint, check_second
from casadi_skin.model.jumps import PARAMETER, STATE
from casadi_skin.solve.levels import ExactLevels, Levels
from casadi_skin.solve.newton import Correction
from casadi_skin.zero.kinds import BRANCH_POINT, FOLD, HOPF, Unresolved
from casadi_skin.zero.problem import Array, Indices, Scalar, SingularError
from casadi_skin.zero.rest_problem import AlgebraicProblem, Course, sizes_at
from casadi_skin.zero.settings import ContinuationSettings, End, ErrorEstimate, Point
from casadi_skin.zero.statics import Spectrum, Statics, balanced

AT_JUMP = 1e-6  # of the sizes of states: distance of an equilibrium from a jump at which it counts as on it
OFFSET_FROM_SPECIAL_POINT = 0.01  # of a step from a special point: where the search for other ones starts


class EquilibriumError(ArithmeticError):
    """No equilibrium was found: the message names the equation and the place in one line."""


@dataclass(frozen=True, eq=False)
class EquilibriumSpace(EquilibriumEquations):
    """Equilibria of a model; where `parameter` is named they are followed in it from a start."""

    connects = EQUILIBRIA
    stability_included = True
    solution_class = Equilibrium
    error = EquilibriumError

    def refined(self, problem: Any, correction: Correction) -> Point:
        """The equilibrium of a correction with u held; raises EquilibriumError where it is not regular."""
        name = self.model.name
        deficiency = problem.deficiency(correction.z)
        if deficiency:
            why = "the equilibrium is not alone there, as with a conserved quantity, or lies at a fold"
            raise EquilibriumError(f"{name}: {deficiency}: {why}")
        try:
            point = self.point_solver.refined(problem, correction, problem.parameter_row(), Scalar.PARAMETER)
        except SingularError as error:
            raise EquilibriumError(f"{name}: the equilibrium cannot be refined: {error}") from error
        if point is None:
            raise EquilibriumError(f"{name}: the equilibrium cannot be refined to the tolerance; try a larger one")
        return point

    def problem_at(self, first: Point) -> Any:
        """The only equations that there are."""
        return self.problem

    # The branch -----------------------------------------------------------------------------------------------------

    def following(
        self, solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings
    ) -> EquilibriumSpace:
        """The space of the branch through one of these equilibria in a parameter."""
        x, statics = solution.point.problem.state(solution.point.z), Statics(self.model, solution.parameters)
        sizes = sizes_at(statics, x, (Course(parameter, solution.parameters[parameter], to),), self.sizes)
        first = replace(solution.point, z=np.append(x / sizes, 0.0))
        return EquilibriumSpace(
            statics, self.tolerance, self.corrector, sizes,
            parameter=parameter, to=to, settings=settings, at=at, first=first,
        )  # fmt: skip

    def special_between(self, before: Point, after: Point) -> Iterator[Point | Unresolved]:
        """Special points on the stretch between two points, in order, and parts of it that are not resolved."""
        for place, point in ((OFFSET_FROM_SPECIAL_POINT, before), (1.0 - OFFSET_FROM_SPECIAL_POINT, after)):
            if self.leaves and not np.any(point.z != self.start.z):  # a special point itself, which is known
                beside = self.point_solver.along(before, after, place)
                if beside is None:
                    return
                before, after = (beside, after) if point is before else (before, beside)
        yield from special_between(self, before, after)

    @property
    def begins(self) -> float:
        """Value of the parameter followed at the start."""
        return self.statics.values[self.parameter]

    def stop(self, point: Point) -> tuple[End | None, str]:
        """JUMP where the equations jump at the point, or between the start of the branch and the point."""
        jumps = self.model.jumps
        if not jumps.found:
            return None, ""
        (x, p), (y, q) = map(self._place, (self.start, point))
        words = self.jump(point) or jumps.along(np.zeros(2), np.array([x, y]), np.array([p, q]), STATE | PARAMETER)
        return (End.JUMP if words else None), words

    def jump(self, point: Point) -> str:
        """That the equations jump at an equilibrium, with the equation; empty where they do not."""
        x, p = self._place(point)
        sizes = np.resize(self.sizes, x.size)  # those of velocities are not known: the positions' stand for them
        return self.model.jumps.beside(x, p, AT_JUMP * np.maximum(np.abs(x), sizes))

    def _place(self, point: Point) -> tuple[Array, Array]:
        """The state of first order and the parameters of a point."""
        y = point.problem.state(point.z)
        return np.concatenate([y, np.zeros(self.model.full_size - y.size)]), point.problem.parameters(point.z)

    # Values ---------------------------------------------------------------------------------------------------------

    @property
    def state_names(self) -> tuple[str, ...]:
        return self.statics.names

    @property
    def output_sites(self) -> Indices:
        """Numbers of the unknowns, from 1."""
        return np.arange(1, self.statics.size + 1)

    def parameters(self, point: Point) -> dict[str, float]:
        return dict(point.problem.named(point.z))

    def parameter_error(self, point: Point) -> float:
        """Estimated absolute error of the parameter followed at a special point."""
        return abs(point.error.parameter * (self.to - self.statics.values[self.parameter])) if self.parameter else 0.0

    def spectrum(self, point: Point) -> Spectrum:
        """Eigenvalues at a point, computed once for the last few points."""
        for known, found in self._spectra:
            if known is point:
                return found
        z = point.z
        moved = self.sizes * np.maximum(np.abs(z[: self.statics.size]), 1e-3) * _finite(point.error)
        found = self.statics.spectrum(point.problem.state(z), point.problem.parameters(z), moved)
        self._spectra[:] = [*self._spectra[-7:], (point, found)]
        return found

    @cached_property
    def _spectra(self) -> list[tuple[Point, Spectrum]]:
        return []


def _finite(error: ErrorEstimate) -> float:
    return error.profile if np.isfinite(error.profile) else 0.0


# Folds, Hopf points and branch points followed in a second parameter, by extended systems that are regular there ------

# Of the norm of the balanced Jacobian, in a step: an imperfection that grows along a curve.
UNFOLDING_IMPERFECTION = 1e-7


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
    if not solution.is_equilibrium or point.kind not in EXTENDED_SYSTEMS or solution.space.free:
        raise ValueError(f"curve: given a {point.kind}; accepted: a fold, Hopf point or branch point of equilibria")
    check_second(point, parameter)
    settings = following_settings(
        solution, parameter, to, at=at, max_points=max_points, max_step=max_step, back_to=back_to
    )
    return replace(_started(point, parameter, float(to), tuple(float(value) for value in at)), settings=settings)


def _started(point: SpecialPoint, parameter: str, to: float, at: tuple[float, ...]) -> CurveSpace:
    """The space of the curve through a special point; raises EquilibriumError where derivatives are not there."""
    solution = point.solution
    old = solution.space
    statics = Statics(old.model, solution.parameters)
    x, p0, course = solution.positions, solution.parameters[point.parameter], old.course
    assert course is not None
    sizes = sizes_at(statics, x, (course, Course(parameter, solution.parameters[parameter], to)), old.sizes)
    second = Course(point.parameter, p0, p0 + (course.to - course.start))
    rate = point.frequency if point.kind == HOPF else 1.0
    space = CurveSpace(
        statics, old.tolerance, old.corrector, sizes, point.kind, second, rate, parameter=parameter, to=to, at=at
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
