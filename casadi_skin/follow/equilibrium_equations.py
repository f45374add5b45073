"""The equations of a branch of equilibria, with their corrector and the samples at its points."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.search import Sample
from casadi_skin.follow.space import ParameterSpace
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.ipopt import CORRECTORS
from casadi_skin.solve.levels import ExactLevels, Levels
from casadi_skin.solve.newton import Corrector, RoundedCorrector
from casadi_skin.zero.augmented import ExtendedSystem
from casadi_skin.zero.problem import EPSILON, Array, Problem
from casadi_skin.zero.rest_problem import AlgebraicProblem, Course
from casadi_skin.zero.settings import ContinuationSettings, Point
from casadi_skin.zero.statics import DERIVATIVE_ROUNDING, BalancedMatrix, Statics

# Samples of a branch of equilibria: eigenvalues and their rates, and the curvature of the branch ----------------------


def sample_of(point: Point, weights: Array) -> Sample:
    """The sample at a point; derivatives along the branch by differences of the Jacobian."""
    from scipy.linalg import LinAlgWarning, lu_factor, lu_solve

    problem, z, t = point.problem, point.z, point.tangent
    n, rounding = problem.statics.size, max(EPSILON, problem.statics.model.rounding)
    h = rounding ** (1.0 / 3.0) / max(1e-300, float(np.max(np.abs(t))))
    change = (problem.jacobian(z + h * t) - problem.jacobian(z - h * t)) / (2.0 * h)
    A, row = problem.jacobian(z)[:n, :n], weights * t
    linear = BalancedMatrix(A, rounding)
    bent = np.append(-change @ t, 0.0)
    full = np.vstack([problem.jacobian(z), row])
    scale = np.maximum(np.max(np.abs(full), axis=1), 1e-300)
    with warnings.catch_warnings():  # a branch point is singular
        warnings.simplefilter("ignore", LinAlgWarning)
        factors, pivots = lu_factor(full / scale[:, None], check_finite=False)
    swaps = np.sum(pivots != np.arange(pivots.size))
    orientation = np.prod(np.sign(np.diag(factors))) * (-1.0) ** swaps
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        bend = lu_solve((factors, pivots), bent / scale, check_finite=False)
        terms = np.abs(full) @ np.abs(t) + np.append(np.abs(change) @ problem.units_of_all(z), 0.0)
        shaken = DERIVATIVE_ROUNDING * rounding * terms / scale * np.append(problem.probe, 1.0)
        unsure = abs(float(lu_solve((factors, pivots), shaken, check_finite=False)[-1]))
    return Sample(
        point, row, linear.eigensystem[0], linear.rates(change[:n, :n]), linear.errors(),
        np.where(np.isfinite(bend), bend, 0.0), float(orientation), blurred=not unsure < abs(float(t[-1])),
    )  # fmt: skip


MOST_ITERATIONS = 60
LONGEST_STEP = (
    1.0 / 30.0
)  # of the range of the parameter: longest step, so that eigenvalues do not come and go within it
KEPT_SAMPLES = 8  # samples that are kept


def corrector_of(name: str, tolerance: float, problem: Problem) -> Corrector:
    """A corrector by name, for a hundredth of the tolerance where rounding allows it."""
    fine = float(np.clip(1e-2 * tolerance, 1e-13, 1e-6))
    return RoundedCorrector(CORRECTORS[name](problem, fine, MOST_ITERATIONS))


@dataclass(frozen=True, eq=False)
class EquilibriumEquations(ParameterSpace):
    """Equilibria of a model; where `parameter` is named they are followed in it from a start.

    Attributes:
        statics: the model at rest; values of its parameters are those at the start of a branch.
        tolerance: relative error of the state.
        corrector: name of the corrector.
        sizes: scales of the components of the state.
    """

    statics: Statics
    tolerance: float
    corrector: str
    sizes: Array

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
        return PointSolver(self.levels, replace(settings, max_parameter_step=LONGEST_STEP))

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
        self._samples[:] = [*self._samples[-(KEPT_SAMPLES - 1) :], found]
        return found

    @cached_property
    def _samples(self) -> list[Sample]:
        return []
