"""Orbits that leave a branch of orbits: of twice the period at a period doubling, others at a branch point."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace, at_rest
from casadi_skin.follow.branch_points import leaving_tangent
from casadi_skin.follow.normal_forms import critical_functions, critical_pair
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.points.ends import Left
from casadi_skin.points.lost_symmetry import lost_operations
from casadi_skin.zero import mesh
from casadi_skin.zero.kinds import DOUBLING
from casadi_skin.zero.linearised import Linearised
from casadi_skin.zero.orbit import FIRST_INTERVALS, OrbitRequest, Periodic, Sizes, boundary_method, statement_of
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest import Statics, sizes_of
from casadi_skin.zero.settings import ContinuationSettings, ErrorEstimate, Point
from casadi_skin.zero.stated_problem import PERIOD, stated

ACCEPTED_ORBITS = (
    "orbits over the whole period (symmetric=False), and of models that conserve something branch points alone"
)
RESTING_COMPONENT_RATIO, SCALE_SHARE = (
    1e-5,
    1e-2,
)  # of the largest component: a component below it rests; of a usual one: its scale


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
    old = orbit.space
    periodic = old.periodic
    assert periodic is not None
    model, period = periodic.model, orbit.period
    values = {name: orbit.parameters[name] for name in model.parameter_names}

    rotated = tuple(turns * k for k in periodic.turns)
    rotations = np.array(rotated or np.zeros(model.full_size), dtype=float)

    def guess(t: float) -> Array:
        return orbit.evaluate(t)

    conserves = model.hamiltonian is not None or bool(model.conserved)
    if periodic.symmetry is not SymmetryClass.FULL or (conserves and turns == 2):
        words = "a period doubling of" if turns == 2 else "a branch point on a part of the period of"
        raise ValueError(f"follow: given {words} {model.name}; accepted: {ACCEPTED_ORBITS}")
    if conserves:  # what selects one of a family, and what keeps the equations regular, stays
        statement = old.statement.with_parameters(**orbit.parameters)
    elif model.forced:
        cycles = round(period / model.forcing_period_at(list(values.values())))
        statement = statement_of(OrbitRequest(model, 0.0, turns * cycles, values, rotations, np.zeros(rotations.size)))
    else:
        statement = statement_of(OrbitRequest(model, turns * period, 1, values, rotations, guess))
    bounds, named = old.statement.bounds, {*statement.model.state_names, *statement.free} - {PERIOD}
    statement = replace(statement, bounds={name: pair for name, pair in bounds.items() if name in named})
    sizes = Sizes(_floors(orbit), turns * orbit.problem.scalar_floors)
    periodic = replace(periodic, turns=rotated)
    space = BoundarySpace(
        statement, old.tolerance, old.method, sizes, periodic, _left(orbit, turns),
        parameter=parameter, to=to, at=at, settings=settings, leaves=True,
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
    tangent[: problem.states] = side * _perturbation(orbit, turns * problem._fractions()).ravel()
    tangent /= np.sqrt(np.sum(space.point_solver.metric(problem, z) * tangent**2))
    return replace(space, first=replace(first, tangent=tangent))


def _floors(orbit: Orbit) -> Array:
    """Least scales of components: a share of a usual one for those that rest, as they may move soon."""
    floors, largest = orbit.problem.floors, np.max(np.abs(orbit.states), axis=0)
    rests = largest <= RESTING_COMPONENT_RATIO * np.max(largest)
    return np.asarray(np.where(rests, np.maximum(floors, SCALE_SHARE * np.median(largest[~rests])), floors))


def _left(orbit: Orbit, turns: int) -> Left | None:
    """The orbits that the leaving branch may come back to; None where no symmetry is lost."""
    space = orbit.space
    if turns == 2:
        return Left(space, 2, np.ones(orbit.model.full_size), 0.5)
    lost = next(iter(lost_operations(orbit)), None)
    return None if lost is None else Left(space, 1, *lost)


def _other(space: BoundarySpace, first: Point, orbit: Orbit, side: int) -> Array:
    """The tangent of the other branch at a branch point."""
    old, problem = orbit.space, first.problem
    along = orbit.problem.prolong(orbit.point.tangent, problem).copy()
    along[-1] *= (old.to - old.statement.values[old.parameter]) / (space.to - space.statement.values[space.parameter])
    return leaving_tangent(space.point_solver, replace(first, tangent=along), side)


def _problem(space: BoundarySpace, orbit: Orbit, turns: int) -> Any:
    """The discretisation with the mesh of the orbit once or twice."""
    resolutions = [r for r in space.levels.resolutions if r >= turns * orbit.intervals]
    resolution = resolutions[0] if resolutions else space.levels.resolutions[-1]
    lengths = np.tile(orbit.problem.constants / np.sum(orbit.problem.constants), turns) / turns
    return stated(space.levels.problem(resolution)).with_constants(mesh.resampled(lengths, resolution))


def _perturbation(orbit: Orbit, turns: Array) -> Array:
    """The Floquet function that the orbit turns to its opposite in a period, at turns from 0 to 2, (turns, states)."""
    problem = orbit.problem
    v, _ = critical_functions(DOUBLING, Linearised(problem, orbit.point.z, problem.statement), np.pi)
    second = turns > 1.0
    along = problem.sample(v, np.where(second, turns - 1.0, turns))
    return np.asarray(np.where(second, -1.0, 1.0)[:, None] * along)


# Cycles that are born at a Hopf point ---------------------------------------------------------------------------------

DEFAULT_TOLERANCE = 1e-8  # of orbits, by default


def born_at(
    statics: Statics, x: Array, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings,
    tolerance: float = DEFAULT_TOLERANCE,
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

    statement = statement_of(OrbitRequest(model, period, 1, values, np.zeros(model.full_size), guess))
    sizes = Sizes(1e-2 * size, np.array([1e-3 * period]))
    method, periodic = boundary_method({"corrector": "newton"}), Periodic(model, model, SymmetryClass.FULL)
    space = BoundarySpace(
        statement, tolerance, method, sizes, periodic,
        parameter=parameter, to=to, at=at, settings=settings, leaves=True,
    )  # fmt: skip
    problem = stated(space.levels.problem(FIRST_INTERVALS))
    z = at_rest(problem, x, period, 0.0)
    tangent = np.zeros(problem.size)
    turns = np.exp(2j * np.pi * problem._fractions())[:, None] * q
    tangent[: problem.states] = turns.real.ravel()
    tangent /= np.sqrt(np.sum(space.point_solver.metric(problem, z) * tangent**2))
    error = ErrorEstimate(1e-12 * period, 1e-12)
    return replace(space, first=Point(problem, z, tangent, error, settings.first_step, 0))


# Solutions that leave a branch of a boundary-value problem: the other branch, or those that close after two turns -----


def other_solutions(
    solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings, side: int
) -> BoundarySpace:
    """The space of the other branch at a branch point of a boundary-value problem."""
    old = solution.space
    space = old.following(solution, parameter, to, at, settings)
    problem = space.levels.problem(solution.intervals).with_constants(solution.problem.constants)
    z, along = solution.point.z.copy(), solution.point.tangent.copy()
    z[-1] = 0.0
    along[-1] *= (old.to - old.statement.values[old.parameter]) / (to - solution.parameters[parameter])
    first = replace(solution.point, problem=problem, z=z, tangent=along, special="")
    return _left_along(space, first, side)


def _left_along(space: BoundarySpace, first: Point, side: int) -> BoundarySpace:
    """The space of the branch that leaves at a point with the tangent of the other one."""
    tangent = leaving_tangent(space.point_solver, first, side)
    return replace(space, first=replace(first, tangent=tangent), leaves=True)


def doubled_solutions(
    solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings, side: int
) -> BoundarySpace:
    """The space of the solutions that close after two turns, from a period doubling of those that close after one.

    Raises BoundaryError where the field is another one in the second turn.
    """
    old, problem, z = solution.space, solution.problem, solution.point.z
    closure, p = old.closure, problem.parameters(z)
    if closure is None or not closure.goes_on(problem, z):
        why = "the field does not repeat itself after the interval, as conditions x(end) = S x(start) suppose"
        raise BoundaryError(f"{old.model.name}: no solutions of two turns leave at the period doubling: {why}")
    statement = closure.twice().with_parameters(**solution.parameters)
    sizes = Sizes(problem.floors, problem.scalar_floors)
    space = BoundarySpace(
        statement, old.tolerance, old.method, sizes,
        parameter=parameter, to=to, at=at, settings=settings, leaves=True,
    )  # fmt: skip
    resolutions = [r for r in space.levels.resolutions if r >= 2 * solution.intervals]
    resolution = resolutions[0] if resolutions else space.levels.resolutions[-1]
    lengths = mesh.resampled(np.tile(problem.constants, 2) / 2.0, resolution)
    twice = stated(space.levels.problem(resolution).with_constants(lengths))

    def over_two_turns(values: Array, shift: Array) -> Array:
        """States, or a direction, over the second turn as over the first, at the unknowns of two turns."""
        turns = 2.0 * twice._fractions()
        second = turns > 1.0
        found = problem.sample(values, np.where(second, turns - 1.0, turns))
        found[second] = found[second] @ closure.matrix.T + shift
        return found.ravel()

    states, free = over_two_turns(z, closure.shift(p)), z[problem.states : -1]
    along = over_two_turns(solution.point.tangent, np.zeros(closure.matrix.shape[0]))
    before = (old.to - old.statement.values[old.parameter]) / (to - solution.parameters[parameter])
    rates = np.append(solution.point.tangent[problem.states : -1], before * solution.point.tangent[-1])
    start = np.concatenate([states, free, [0.0]])
    first = Point(twice, start, np.append(along, rates), solution.point.error, settings.first_step, 0)
    return _left_along(space, first, side)
