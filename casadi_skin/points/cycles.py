"""Cycles that are born at a Hopf point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace, at_rest
from casadi_skin.follow.find import closed_statement
from casadi_skin.follow.settings import ContinuationSettings, Point
from casadi_skin.model.symmetry import SymmetryClass
from casadi_skin.solve.estimates import ErrorEstimate
from casadi_skin.zero.boundary_choices import FIRST, Periodic, Sizes, boundary_method
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_normal_forms import critical_pair
from casadi_skin.zero.rest_problem import sizes_of
from casadi_skin.zero.stated_problem import BoundaryProblem
from casadi_skin.zero.statics import Statics

TOLERANCE = 1e-8  # of orbits, by default


def born_at(
    statics: Statics, x: Array, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings,
    tolerance: float = TOLERANCE,
) -> BoundarySpace:  # fmt: skip
    """The space of the cycles born at a Hopf point of a model, which is the start of their branch.

    Its start is the equilibrium as an orbit of amplitude zero and period 2 pi/omega, left along the critical
    eigenvector, for which the equations are regular at any amplitude but zero.
    """
    model = statics.model
    values = dict(statics.values)
    omega, q, _ = critical_pair(statics.jacobian(x, np.array(list(values.values()))))
    size = sizes_of([x])
    amplitude = float(np.min(size / np.maximum(np.abs(q), 1e-300)))
    period = 2.0 * np.pi / omega

    def guess(t: float) -> Array:
        return np.asarray(x + amplitude * (q * np.exp(1j * omega * t)).real)

    statement = closed_statement(model, guess, period, values)
    sizes = Sizes(1e-2 * size, np.array([1e-3 * period]))
    method, periodic = boundary_method({"corrector": "newton"}), Periodic(model, model, SymmetryClass.FULL)
    space = BoundarySpace(
        statement, tolerance, method, sizes, periodic, parameter, to, at, None, settings, leaves=True
    )  # fmt: skip
    problem = space.levels.problem(FIRST)
    assert isinstance(problem, BoundaryProblem)
    z = at_rest(problem, x, period, 0.0)
    tangent = np.zeros(problem.size)
    turns = np.exp(2j * np.pi * problem._fractions())[:, None] * q
    tangent[: problem.states] = turns.real.ravel()
    tangent /= np.sqrt(np.sum(space.point_solver.metric(problem, z) * tangent**2))
    error = ErrorEstimate(1e-12 * period, 1e-12)
    return replace(space, first=Point(problem, z, tangent, error, settings.first_step, 0))
