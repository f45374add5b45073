"""What leaves a branch of orbits or solutions: of two turns at a period doubling, others at a branch point; cycles."""

from __future__ import annotations

from dataclasses import replace
from typing import cast

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.branch_points import leaving_tangent
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.points.ends import Left, fitted
from casadi_skin.points.lost_symmetry import lost_operations
from casadi_skin.zero.linearised import critical_pair
from casadi_skin.zero.orbit import OrbitRequest, Periodic, Reference, Sizes, boundary_method, statement_of
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest import Statics, sizes_of
from casadi_skin.zero.settings import ContinuationSettings, ErrorEstimate, Point
from casadi_skin.zero.stated_problem import PERIOD, stated

ACCEPTED_ORBITS = (
    "orbits over the whole period (symmetric=False), and of models that conserve something branch points alone"
)
RESTING_COMPONENT_RATIO = 1e-5  # of the largest component: a component below it rests
SCALE_SHARE = 1e-2  # of a usual component: the scale of one that rests


def leaving_solutions(
    solution: Solution, turns: int, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings,
    side: int,
) -> BoundarySpace:  # fmt: skip
    """The space of the branch that leaves: of solutions run through twice at a period doubling, once at a branch point.

    Its start is the solution itself, a branch point of what closes after so many turns, left along the other tangent.
    Raises ValueError for orbits of another kind, BoundaryError where the field is another one in the second turn.
    """
    old, known, point = solution.space, solution.problem, solution.point
    turn, shift = np.eye(known.formulation.states), np.zeros(known.formulation.states)
    if solution.is_orbit:
        space = _of_orbits(cast(Orbit, solution), turns)
        shift = 2.0 * np.pi * np.array(old.periodic.turns or shift)
    elif turns == 1:
        space = old.branch_space(solution, parameter, to, at, settings)
    else:
        closure = old.closure
        if closure is None or not closure.goes_on(known, point.z):
            why = "the field does not repeat itself after the interval, as conditions x(end) = S x(start) suppose"
            raise BoundaryError(f"{old.model.name}: no solutions of two turns leave at the period doubling: {why}")
        statement = closure.twice().with_parameters(**solution.parameters)
        space = BoundarySpace(statement, old.tolerance, old.method, Sizes(known.floors, known.scalar_floors))
        turn, shift = closure.matrix, closure.shift(known.parameters(point.z))
    space = replace(space, parameter=parameter, to=to, at=at, settings=settings, leaves=True)
    problem = fitted(space, np.tile(known.constants, turns))
    places = turns * problem._fractions()
    second = places > 1.0

    def over_turns(values: Array, shift: Array, last: float) -> Array:
        """The solution, or a direction, over the second turn as over the first, in the unknowns of the new problem."""
        states = known.sample(values, np.where(second, places - 1.0, places))
        states[second] = states[second] @ turn.T + shift
        own = dict(zip(old.statement.free, values[known.states :], strict=False))
        free = [own.get(name, 0.0) * (turns if name == PERIOD else 1) for name in space.statement.free]
        return np.concatenate([states.ravel(), free, [last]])

    way = (old.to - old.begins) / (to - solution.parameters[parameter])
    along = over_turns(point.tangent, np.zeros_like(shift), way * float(point.tangent[-1]))
    error = ErrorEstimate(point.error.Omega, point.error.profile)
    first = Point(problem, over_turns(point.z, shift, 0.0), along, error, settings.first_step, 0)
    return replace(space, first=replace(first, tangent=leaving_tangent(space.point_solver, first, side)))


def _of_orbits(orbit: Orbit, turns: int) -> BoundarySpace:
    """The space of orbits that close after one or two turns of an orbit."""
    old, period = orbit.space, orbit.period
    model, periodic = old.periodic.model, old.periodic
    values = {name: orbit.parameters[name] for name in model.parameter_names}
    rotated = tuple(turns * k for k in periodic.turns)
    rotations = np.array(rotated or np.zeros(model.full_size), dtype=float)
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
        statement = statement_of(OrbitRequest(model, turns * period, 1, values, rotations, orbit.evaluate))
    bounds, named = old.statement.bounds, {*statement.model.state_names, *statement.free} - {PERIOD}
    statement = replace(statement, bounds={name: pair for name, pair in bounds.items() if name in named})
    left = Left(old, 2, np.ones(model.full_size), 0.5) if turns == 2 else None
    lost = next(iter(lost_operations(orbit)), None) if turns == 1 else None
    left = left if lost is None else Left(old, 1, *lost)
    sizes = Sizes(_floors(orbit), turns * orbit.problem.scalar_floors)
    return BoundarySpace(statement, old.tolerance, old.method, sizes, replace(periodic, turns=rotated), left)


def _floors(orbit: Orbit) -> Array:
    """Least scales of components: a share of a usual one for those that rest, as they may move soon."""
    floors, largest = orbit.problem.floors, np.max(np.abs(orbit.states), axis=0)
    rests = largest <= RESTING_COMPONENT_RATIO * np.max(largest)
    return np.asarray(np.where(rests, np.maximum(floors, SCALE_SHARE * np.median(largest[~rests])), floors))


# Cycles that are born at a Hopf point ---------------------------------------------------------------------------------

DEFAULT_TOLERANCE = 1e-8  # of orbits, by default


def born_at(
    statics: Statics, x: Array, omega: float, parameter: str, to: float, at: tuple[float, ...],
    settings: ContinuationSettings, tolerance: float = DEFAULT_TOLERANCE,
) -> BoundarySpace:  # fmt: skip
    """The space of the cycles born at a Hopf point of a model, of frequency omega, which is the start of their branch.

    Its start is the equilibrium as an orbit of amplitude zero and period 2 pi/omega, left along the critical
    eigenvector, for which the equations are regular at any amplitude but zero.
    """
    model = statics.model
    values = dict(statics.values)
    omega, q, _ = critical_pair(statics.matrix(x, np.array(list(values.values()))), omega)
    size = sizes_of(statics, [x])
    amplitude = float(np.min(size / np.maximum(np.abs(q), 1e-300)))
    period = 2.0 * np.pi / omega

    still = np.zeros(model.full_size)
    born = Reference(amplitude * q[None], x, still)
    statement = statement_of(OrbitRequest(model, period, 1, values, still, born))
    sizes = Sizes(1e-2 * size, np.array([1e-3 * period]))
    method, periodic = boundary_method({"corrector": "newton"}), Periodic(model, model, SymmetryClass.FULL)
    space = BoundarySpace(
        statement, tolerance, method, sizes, periodic,
        parameter=parameter, to=to, at=at, settings=replace(settings, tolerance=tolerance), leaves=True,
    )  # fmt: skip
    problem = stated(space.levels.problem(int(method.intervals or 0)))  # never 0
    free = [{**problem.statement.values, PERIOD: period}[name] for name in problem.statement.free]
    z = np.concatenate([np.tile(x, problem.columns), free, [0.0]])
    tangent = np.zeros(problem.size)
    turns = np.exp(2j * np.pi * problem._fractions())[:, None] * q
    tangent[: problem.states] = turns.real.ravel()
    tangent /= np.sqrt(np.sum(space.point_solver.metric(problem, z) * tangent**2))
    error = ErrorEstimate(1e-12 * period, 1e-12)
    return replace(space, first=Point(problem, z, tangent, error, settings.first_step, 0))
