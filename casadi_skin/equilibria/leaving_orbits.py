"""Orbits that leave a branch of orbits: of twice the period at a period doubling, others at a branch point."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from casadi_skin.bvp import mesh
from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.stated_problem import PERIOD, BoundaryProblem
from casadi_skin.continuation.points import ContinuationSettings, Point
from casadi_skin.orbits.bifurcations import critical_vector
from casadi_skin.orbits.boundary_choices import Sizes
from casadi_skin.orbits.boundary_space import BoundarySpace
from casadi_skin.orbits.find_orbit import closed_statement, forced_statement
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.solvers.levels import ErrorEstimate

EVEN = 512  # places along an orbit at which the mean over the period is taken


def leaving_orbits(
    orbit: Orbit,
    turns: int,
    parameter: str,
    to: float,
    at: tuple[float, ...],
    settings: ContinuationSettings,
    side: int,
) -> BoundarySpace:
    """The space of the orbits that leave, from the orbit run through once or twice along its critical Floquet vector.

    Twice at a period doubling, whose critical multiplier is -1; once at a branch point, where it is 1 and the branch
    leaves to both sides of the other one, as where a symmetry is lost.
    """
    old = orbit._boundary_space()
    periodic = old.periodic
    assert periodic is not None
    model, period = periodic.model, orbit.period
    values = {name: orbit.parameters[name] for name in model.parameter_names}

    rotated = tuple(turns * k for k in periodic.turns)

    def guess(t: float) -> Array:
        return np.asarray(orbit.evaluate(t)[0])

    if model.forced:
        cycles = round(period / model.forcing_period_at(list(values.values())))
        statement = forced_statement(model, turns * cycles, values, rotated)
    else:
        statement = closed_statement(model, guess, turns * period, values, rotated)
    sizes = Sizes(orbit.problem.floors, turns * orbit.problem.scalar_floors)
    periodic = replace(periodic, turns=rotated)
    space = BoundarySpace(
        statement, old.tolerance, old.method, sizes, periodic, parameter, to, at, None, settings, leaves=True
    )
    problem = _problem(space, orbit, turns)
    t = turns * period * problem._fractions()
    states = orbit.evaluate(t)
    free = [turns * period if name == PERIOD else statement.values[name] for name in statement.free]
    z = np.concatenate([states.ravel(), free, [0.0]])
    tangent = np.zeros(problem.size)
    tangent[: problem.states] = side * _perturbation(orbit, turns, values, t).ravel()
    tangent /= np.sqrt(np.sum(space.point_solver.metric(problem, z) * tangent**2))
    error = ErrorEstimate(orbit.point.error.Omega, orbit.point.error.profile)
    return replace(space, first=Point(problem, z, tangent, error, settings.first_step, 0))


def _problem(space: BoundarySpace, orbit: Orbit, turns: int) -> BoundaryProblem:
    """The discretisation with the mesh of the orbit once or twice."""
    resolutions = [r for r in space.levels.resolutions if r >= turns * orbit.intervals]
    resolution = resolutions[0] if resolutions else space.levels.resolutions[-1]
    lengths = np.tile(orbit.problem.constants / np.sum(orbit.problem.constants), turns) / turns
    problem = space.levels.problem(resolution).with_constants(mesh.resampled(lengths, resolution))
    assert isinstance(problem, BoundaryProblem)
    return problem


def _perturbation(orbit: Orbit, turns: int, values: dict[str, float], t: Array) -> Array:
    """The perturbation that the orbit gives back, or turns to its opposite, in a period; shape (time, component)."""
    from scipy.integrate import solve_ivp

    model = orbit._boundary_space().model
    time = type(model.state).sym("t") if model.time is None else model.time
    rhs = model.vector_field(time, model.full_state, model.parameters)
    jacobian = model.function("J", ca.densify(ca.jacobian(rhs, model.full_state)))
    p = np.array(list(values.values()))

    def rate(at: float, w: Array) -> Array:
        x = orbit.evaluate(at % orbit.period)[0]
        return np.asarray(np.array(jacobian(at, x, p)) @ w)

    start = critical_vector(orbit, 1.0 if turns == 1 else -1.0)
    times = np.unique(np.mod(t, orbit.period))
    found = solve_ivp(rate, (0.0, orbit.period), start, "LSODA", times, rtol=1e-6, atol=1e-9)
    turn = np.floor(t / orbit.period * (1.0 + 1e-14)).astype(int)
    along = np.array([np.interp(np.mod(t, orbit.period), times, column) for column in found.y]).T
    if turns == 2 or model.forced:
        return np.asarray(np.where((turn % 2 == 0) | (turns == 1), 1.0, -1.0)[:, None] * along)
    even = orbit.period * np.arange(EVEN) / EVEN  # without what only shifts the phase
    velocity = np.array([np.array(model.vector_field(0.0, x, p)).ravel() for x in orbit.evaluate(even)])
    moved = np.array([np.interp(even, times, column) for column in found.y]).T
    shift = float(np.sum(velocity * moved) / np.sum(velocity**2))
    here = np.array([np.array(model.vector_field(0.0, x, p)).ravel() for x in orbit.evaluate(np.mod(t, orbit.period))])
    return np.asarray(along - shift * here)
