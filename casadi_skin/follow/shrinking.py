"""The Hopf point at which a branch of orbits ends, as they shrink to an equilibrium."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from casadi_skin.follow.boundary_solutions import BoundarySolutions
from casadi_skin.follow.settings import Point
from casadi_skin.model.ode import OdeModel
from casadi_skin.solve.estimates import ErrorEstimate
from casadi_skin.zero.equations import EquilibriumEquations
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_location import HOPF, Located, locate
from casadi_skin.zero.rest_problem import AlgebraicProblem, sizes_of
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem
from casadi_skin.zero.statics import Statics

REACH = 0.5  # of the variation of an orbit: largest distance of the equilibrium that it shrinks to


def at_rest(problem: BoundaryProblem, x: Array, period: float, u: float) -> Array:
    """Unknowns of an orbit of amplitude zero."""
    scalars = [period if name == PERIOD else problem.statement.values[name] for name in problem.statement.free]
    return np.concatenate([np.tile(x, problem.columns), scalars, [u]])


def hopf_end(space: BoundarySolutions, before: Point, after: Point) -> Point | None:
    """The Hopf point between two orbits whose amplitude passes through zero; None where there is none."""
    smaller = min((before, after), key=lambda point: _variation(space, point))
    found = _hopf_near(space, smaller)
    return None if found is None else _as_orbit(space, smaller, *found)


def _variation(space: BoundarySolutions, point: Point) -> float:
    """Variation along an orbit, relative to the sizes of its components."""
    states = point.problem.sample(point.z, np.linspace(0.0, 1.0, 65))
    return float(np.max(np.ptp(states, axis=0) / (space.sizes.states * 1e3)))


def _hopf_near(space: BoundarySolutions, orbit: Point) -> tuple[EquilibriumEquations, Located] | None:
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
    equilibria = EquilibriumEquations(statics, 1e-10, "newton", sizes, space.parameter, space.to)
    y, u = x / equilibria.sizes, orbit.parameter
    found = locate(equilibria, HOPF, y, u, 2j * np.pi / values[PERIOD])
    if found is None:
        return None
    reach = np.ptp(states, axis=0) / equilibria.sizes
    near = np.max(np.abs(found.y - y)) <= REACH * np.max(reach) and abs(found.s - u) <= max(0.1, REACH * np.max(reach))
    same_period = abs(2.0 * np.pi / found.frequency - values[PERIOD]) <= REACH * values[PERIOD]
    return (equilibria, found) if near and same_period else None


def _as_orbit(space: BoundarySolutions, orbit: Point, equilibria: EquilibriumEquations, found: Located) -> Point:
    """A Hopf point as an orbit of amplitude zero of the branch that ends there."""
    problem = orbit.problem
    assert isinstance(problem, BoundaryProblem)
    algebraic: AlgebraicProblem = equilibria.problem
    x = algebraic.state(np.append(found.y, found.s))
    z = at_rest(problem, x, 2.0 * np.pi / found.frequency, found.s)
    error = ErrorEstimate(found.profile, found.profile, parameter=found.error / problem.parameter_size(z))
    return replace(orbit, z=z, error=error, requested=False, walked=False, better=None, special=HOPF)
