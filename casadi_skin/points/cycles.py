"""Cycles at a Hopf point: the branch of orbits that is born there, and the end of one that shrinks to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.find_orbit import closed_statement
from casadi_skin.follow.rest_space import EquilibriumSpace
from casadi_skin.follow.settings import ContinuationSettings, Point
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.symmetry import SymmetryClass
from casadi_skin.solve.estimates import ErrorEstimate
from casadi_skin.zero.boundary_choices import FIRST, Periodic, Sizes, boundary_method
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_location import HOPF, Located, locate
from casadi_skin.zero.rest_normal_forms import critical_pair
from casadi_skin.zero.rest_problem import AlgebraicProblem, sizes_of
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem
from casadi_skin.zero.statics import Statics

TOLERANCE = 1e-8  # of orbits, by default
REACH = 0.5  # of the variation of an orbit: largest distance of the equilibrium that it shrinks to


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


def at_rest(problem: BoundaryProblem, x: Array, period: float, u: float) -> Array:
    """Unknowns of an orbit of amplitude zero."""
    scalars = [period if name == PERIOD else problem.statement.values[name] for name in problem.statement.free]
    return np.concatenate([np.tile(x, problem.columns), scalars, [u]])


def hopf_end(space: BoundarySpace, before: Point, after: Point) -> Point | None:
    """The Hopf point between two orbits whose amplitude passes through zero; None where there is none."""
    smaller = min((before, after), key=lambda point: _variation(space, point))
    found = _hopf_near(space, smaller)
    return None if found is None else _as_orbit(space, smaller, *found)


def _variation(space: BoundarySpace, point: Point) -> float:
    """Variation along an orbit, relative to the sizes of its components."""
    states = point.problem.sample(point.z, np.linspace(0.0, 1.0, 65))
    return float(np.max(np.ptp(states, axis=0) / (space.sizes.states * 1e3)))


def _hopf_near(space: BoundarySpace, orbit: Point) -> tuple[EquilibriumSpace, Located] | None:
    """The Hopf point near an orbit of small amplitude, from its mean, its parameters and its period."""
    periodic = space.periodic
    assert periodic is not None
    model: OdeModel = periodic.model
    states = orbit.problem.sample(orbit.z, np.linspace(0.0, 1.0, 257)[:-1])
    x, values = states.mean(axis=0), space.parameters(orbit)
    known: Mapping[str, float] = {name: values[name] for name in model.parameter_names}
    start = space.statement.values[space.parameter]
    statics = Statics(model, {**known, space.parameter: start})
    sizes = sizes_of([x, space.sizes.states[: x.size]])  # an equilibrium near zero has the size of the branch
    equilibria = EquilibriumSpace(statics, 1e-10, "newton", sizes, space.parameter, space.to)
    y, u = x / equilibria.sizes, orbit.parameter
    found = locate(equilibria, HOPF, y, u, 2j * np.pi / values[PERIOD])
    if found is None:
        return None
    reach = np.ptp(states, axis=0) / equilibria.sizes
    near = np.max(np.abs(found.y - y)) <= REACH * np.max(reach) and abs(found.s - u) <= max(0.1, REACH * np.max(reach))
    same_period = abs(2.0 * np.pi / found.frequency - values[PERIOD]) <= REACH * values[PERIOD]
    return (equilibria, found) if near and same_period else None


def _as_orbit(space: BoundarySpace, orbit: Point, equilibria: EquilibriumSpace, found: Located) -> Point:
    """A Hopf point as an orbit of amplitude zero of the branch that ends there."""
    problem = orbit.problem
    assert isinstance(problem, BoundaryProblem)
    algebraic: AlgebraicProblem = equilibria.problem
    x = algebraic.state(np.append(found.y, found.s))
    z = at_rest(problem, x, 2.0 * np.pi / found.frequency, found.s)
    error = ErrorEstimate(found.profile, found.profile, parameter=found.error / problem.parameter_size(z))
    return replace(orbit, z=z, error=error, requested=False, walked=False, better=None, special=HOPF)
