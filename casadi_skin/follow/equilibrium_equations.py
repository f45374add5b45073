"""The equations of a branch of equilibria, with their corrector and the samples at its points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.sample import Sample
from casadi_skin.follow.samples import sample_of
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.ipopt import CORRECTORS
from casadi_skin.solve.levels import ExactLevels, Levels
from casadi_skin.solve.newton import Corrector, RoundedCorrector
from casadi_skin.zero.problem import Array, Problem
from casadi_skin.zero.rest_problem import AlgebraicProblem, Course
from casadi_skin.zero.rest_systems import ExtendedSystem
from casadi_skin.zero.settings import ContinuationSettings, Point
from casadi_skin.zero.statics import Statics

ITERATIONS = 60
LONGEST = 1.0 / 30.0  # of the range of the parameter: longest step, so that eigenvalues do not come and go within it
KEPT = 8  # samples that are kept


def corrector_of(name: str, tolerance: float, problem: Problem) -> Corrector:
    """A corrector by name, for a hundredth of the tolerance where rounding allows it."""
    fine = float(np.clip(1e-2 * tolerance, 1e-13, 1e-6))
    return RoundedCorrector(CORRECTORS[name](problem, fine, ITERATIONS))


@dataclass(frozen=True, eq=False)
class EquilibriumEquations:
    """Equilibria of a model; where `parameter` is named they are followed in it from a start.

    Attributes:
        statics: the model at rest; values of its parameters are those at the start of a branch.
        tolerance: relative error of the state.
        corrector: name of the corrector.
        sizes: scales of the components of the state.
        parameter: the parameter that is followed, from its value to `to`; empty where none is.
        settings: of the continuation.
    """

    statics: Statics
    tolerance: float
    corrector: str
    sizes: Array
    parameter: str = ""
    to: float = 1.0
    settings: ContinuationSettings | None = None

    @property
    def model(self) -> OdeModel:
        """The model in its own coordinates."""
        return self.statics.model

    @property
    def course(self) -> Course | None:
        """Course of the parameter that is followed; None where none is."""
        return Course(self.parameter, self.statics.values[self.parameter], self.to) if self.parameter else None

    @cached_property
    def problem(self) -> AlgebraicProblem:
        """The equations, with u that follows the parameter."""
        return AlgebraicProblem(self.statics, self.sizes, (), self.course)

    @cached_property
    def levels(self) -> Levels:
        """The one level that there is."""
        return ExactLevels(self.problem, lambda problem: corrector_of(self.corrector, self.tolerance, problem))

    @cached_property
    def point_solver(self) -> PointSolver:
        """The solver of points at the tolerance."""
        settings = self.settings or ContinuationSettings(1.0, self.tolerance)
        return PointSolver(self.levels, replace(settings, max_parameter_step=LONGEST))

    @cached_property
    def systems(self) -> dict[str, ExtendedSystem | None]:
        """Extended systems that have been built, by kind; None where derivatives that they need are not there."""
        return {}

    def sample(self, point: Point) -> Sample:
        """Eigenvalues and rates at a point, computed once for the last few points."""
        for known in self._samples:
            if known.point is point:
                return known
        found = sample_of(point, self.point_solver.metric(point.problem, point.z))
        self._samples[:] = [*self._samples[-(KEPT - 1) :], found]
        return found

    @cached_property
    def _samples(self) -> list[Sample]:
        return []
