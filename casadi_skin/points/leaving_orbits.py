"""Orbits that leave a branch of orbits: of twice the period at a period doubling, others at a branch point."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch_points import leaving_tangent
from casadi_skin.follow.find import closed_statement, forced_statement
from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.settings import ContinuationSettings, Point
from casadi_skin.model.symmetry import SymmetryClass
from casadi_skin.points.lost_symmetry import critical_vector, lost_operations
from casadi_skin.points.rejoining import Left
from casadi_skin.solve.estimates import ErrorEstimate
from casadi_skin.zero import mesh
from casadi_skin.zero.boundary_choices import Sizes
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem

ACCEPTED = "orbits over the whole period (symmetric=False), and of models that conserve something branch points alone"
RESTS, SHARE = 1e-5, 1e-2  # of the largest component: a component below it rests; of a usual one: its scale


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

    Twice at a period doubling, whose critical multiplier is -1; once at a branch point, where it is 1.
    """
    old = orbit._boundary_space()
    periodic = old.periodic
    assert periodic is not None
    model, period = periodic.model, orbit.period
    values = {name: orbit.parameters[name] for name in model.parameter_names}

    rotated = tuple(turns * k for k in periodic.turns)

    def guess(t: float) -> Array:
        return orbit.evaluate(t)

    conserves = model.hamiltonian is not None or bool(model.conserved)
    if periodic.symmetry is not SymmetryClass.FULL or (conserves and turns == 2):
        words = "a period doubling of" if turns == 2 else "a branch point on a part of the period of"
        raise ValueError(f"follow: given {words} {model.name}; accepted: {ACCEPTED}")
    if conserves:  # what selects one of a family, and what keeps the equations regular, stays
        statement = old.statement.with_parameters(**orbit.parameters)
    elif model.forced:
        cycles = round(period / model.forcing_period_at(list(values.values())))
        statement = forced_statement(model, turns * cycles, values, rotated)
    else:
        statement = closed_statement(model, guess, turns * period, values, rotated)
    bounds, named = old.statement.bounds, {*statement.model.state_names, *statement.free} - {PERIOD}
    statement = replace(statement, bounds={name: pair for name, pair in bounds.items() if name in named})
    sizes = Sizes(_floors(orbit), turns * orbit.problem.scalar_floors)
    periodic = replace(periodic, turns=rotated)
    space = BoundarySpace(
        statement, old.tolerance, old.method, sizes, periodic, parameter, to, at, None, settings, leaves=True,
        left=_left(orbit, turns),
    )  # fmt: skip
    problem = _problem(space, orbit, turns)
    t = turns * period * problem._fractions()
    states = orbit.evaluate(t)
    free = [turns * period if name == PERIOD else statement.values[name] for name in statement.free]
    z = np.concatenate([states.ravel(), free, [0.0]])
    error = ErrorEstimate(orbit.point.error.Omega, orbit.point.error.profile)
    first = Point(problem, z, np.zeros(problem.size), error, settings.first_step, 0)
    if turns == 1:
        return replace(space, first=replace(first, tangent=_other(space, first, orbit, side)))
    tangent = np.zeros(problem.size)
    tangent[: problem.states] = side * _perturbation(orbit, values, t).ravel()
    tangent /= np.sqrt(np.sum(space.point_solver.metric(problem, z) * tangent**2))
    return replace(space, first=replace(first, tangent=tangent))


def _floors(orbit: Orbit) -> Array:
    """Least scales of components: a share of a usual one for those that rest, as they may move soon."""
    floors, largest = orbit.problem.floors, np.max(np.abs(orbit.states), axis=0)
    rests = largest <= RESTS * np.max(largest)
    return np.asarray(np.where(rests, np.maximum(floors, SHARE * np.median(largest[~rests])), floors))


def _left(orbit: Orbit, turns: int) -> Left | None:
    """The orbits that the leaving branch may come back to; None where no symmetry is lost."""
    space = orbit._boundary_space()
    if turns == 2:
        return Left(space, 2, np.ones(orbit.model.full_size), 0.5)
    lost = next(iter(lost_operations(orbit)), None)
    return None if lost is None else Left(space, 1, *lost)


def _other(space: BoundarySpace, first: Point, orbit: Orbit, side: int) -> Array:
    """The tangent of the other branch at a branch point."""
    old, problem = orbit._boundary_space(), first.problem
    along = orbit.problem.prolong(orbit.point.tangent, problem).copy()
    along[-1] *= (old.to - old.statement.values[old.parameter]) / (space.to - space.statement.values[space.parameter])
    return leaving_tangent(space.point_solver, replace(first, tangent=along), side)


def _problem(space: BoundarySpace, orbit: Orbit, turns: int) -> BoundaryProblem:
    """The discretisation with the mesh of the orbit once or twice."""
    resolutions = [r for r in space.levels.resolutions if r >= turns * orbit.intervals]
    resolution = resolutions[0] if resolutions else space.levels.resolutions[-1]
    lengths = np.tile(orbit.problem.constants / np.sum(orbit.problem.constants), turns) / turns
    problem = space.levels.problem(resolution).with_constants(mesh.resampled(lengths, resolution))
    assert isinstance(problem, BoundaryProblem)
    return problem


def _perturbation(orbit: Orbit, values: dict[str, float], t: Array) -> Array:
    """The perturbation that the orbit turns to its opposite in a period; shape (time, component)."""
    from scipy.integrate import solve_ivp

    model = orbit._boundary_space().model
    time = type(model.state).sym("t") if model.time is None else model.time
    rhs = model.vector_field(time, model.full_state, model.parameters)
    jacobian = model.function("J", ca.densify(ca.jacobian(rhs, model.full_state)))
    p = np.array(list(values.values()))

    def rate(at: float, w: Array) -> Array:
        x = orbit.evaluate(at % orbit.period)
        return np.asarray(np.array(jacobian(at, x, p)) @ w)

    turn = np.floor(t / orbit.period * (1.0 + 1e-14)).astype(int)
    within = np.clip(t - turn * orbit.period, 0.0, orbit.period)  # np.mod may be on the other side by rounding
    times = np.unique(within)
    found = solve_ivp(rate, (0.0, orbit.period), critical_vector(orbit, -1.0), "LSODA", times, rtol=1e-6, atol=1e-9)
    along = np.array([np.interp(within, times, column) for column in found.y]).T
    return np.asarray(np.where(turn % 2 == 0, 1.0, -1.0)[:, None] * along)
