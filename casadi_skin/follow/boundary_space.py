"""A branch of solutions of one boundary-value problem: equations by resolution, special points, its end."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.follow.boundary_solutions import BoundarySolutions
from casadi_skin.follow.branch_points import ONE_PLACE, branch_points_between
from casadi_skin.follow.equilibrium_equations import EquilibriumEquations
from casadi_skin.follow.location import Located, locate_rest, special_orbit
from casadi_skin.follow.period_limit import joined_words, unbounded
from casadi_skin.follow.search import TEST_ZERO_XTOL, NotLocatedError
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.special_points import fold_between, turning
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.family import TWO_PI
from casadi_skin.zero.kinds import BOUND, BRANCH_POINT, FOLD, HETEROCLINIC, HOMOCLINIC, HOPF, Unresolved
from casadi_skin.zero.orbit import Sizes
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_problem import AlgebraicProblem, sizes_of
from casadi_skin.zero.settings import ContinuationSettings, End, ErrorEstimate, Point
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem
from casadi_skin.zero.statics import Statics

if TYPE_CHECKING:
    from casadi_skin.follow.boundary_solutions import BoundarySolutions
    from casadi_skin.follow.solution import Solution


# Bounds on states and free parameters along a branch: where the first of them is met, and which -----------------------

PLACES_WITHIN_COLUMN = 8  # places between two columns of a mesh at which a state is looked at
# Into the neighbours of the largest value: places then differ by 1e-5 of theirs, values by the square.
EXTREMUM_ZOOMS = 4
BOUND_PREDICTION_PLACES = np.linspace(0.0, 1.0, 17)[1:]  # of a stretch, at which it is predicted whether a bound is met
BOUND_MET_RTOL = 1e-12  # of the size of a quantity: a bound that is as near is met


@dataclass(frozen=True)
class Margin:
    """How far a solution is from one bound, relative to the size of the quantity, and where it is nearest."""

    value: float
    name: str
    bound: str
    time: float | None

    def __str__(self) -> str:
        """Which bound it is, in words."""
        when = "" if self.time is None else f" at t = {self.time:.6g}"
        return f"{self.name} comes to its {self.bound}{when}"


def margin(space: BoundarySolutions, point: Point) -> Margin:
    """The least margin of a solution, over the whole interval; negative beyond a bound."""
    return min(margins(space, point), key=lambda one: one.value)


def margins(space: BoundarySolutions, point: Point) -> list[Margin]:
    """The margins of all finite bounds."""
    problem, names, values = point.problem, space.state_names, space.parameters(point)
    turns = _turns(space, problem)
    states = _states(space, point, turns)
    start, end = space.interval(point)
    found = list[Margin]()
    for name, limits in space.statement.bounds.items():
        for sign, bound, words in ((1.0, limits[1], "upper"), (-1.0, limits[0], "lower")):
            if math.isinf(bound):
                continue
            time, value, size = None, sign * values.get(name, 0.0), abs(values.get(name, 0.0))
            if name in names:
                component = names.index(name)
                size = float(np.max(np.abs(states[:, component])))
                turn, value = _largest(space, point, turns, sign * states[:, component], component, sign)
                time = start + turn * (end - start)
            size = max(abs(bound), size, BOUND_MET_RTOL)
            found.append(Margin((sign * bound - value) / size, name, f"{words} bound {bound:.10g}", time))
    return found


def _turns(space: BoundarySolutions, problem: BoundaryProblem) -> Array:
    """Places in the interval, or in the whole period, on the mesh and between."""
    edges = problem._fractions()
    if space.periodic is not None:
        part = space.periodic.symmetry.value
        edges = np.unique(np.concatenate([edges * part, 1.0 - edges * part, np.linspace(0.0, 1.0, edges.size)]))
    inner = np.linspace(0.0, 1.0, PLACES_WITHIN_COLUMN, endpoint=False)
    return np.append((edges[:-1, None] + np.diff(edges)[:, None] * inner).ravel(), 1.0)


def _states(space: BoundarySolutions, point: Point, turns: Array) -> Array:
    if space.periodic is not None:
        return space.states_at(point, TWO_PI * turns, None)
    return np.asarray(point.problem.sample(point.z, turns))


def _largest(
    space: BoundarySolutions, point: Point, turns: Array, values: Array, component: int, sign: float
) -> tuple[float, float]:
    """Where a state times a sign is largest, and its value there, between the places that it is known at too."""
    for _ in range(EXTREMUM_ZOOMS):
        at = int(np.argmax(values))
        if at in (0, turns.size - 1):
            break
        turns = np.linspace(turns[at - 1], turns[at + 1], 4 * PLACES_WITHIN_COLUMN + 1)
        values = sign * _states(space, point, turns)[:, component]
    at = int(np.argmax(values))
    return float(turns[at]), float(values[at])


def met_between(space: BoundarySolutions, before: Point, after: Point) -> Point | None:
    """The first point between two at which a bound is met; None where none is. Raises NotLocatedError.

    A state that a condition holds at a bound is there all along, but for the error of the solution.
    """
    from scipy.optimize import brentq

    if not space.statement.bounds:
        return None
    solver = space.point_solver
    known: dict[float, Point] = {0.0: before, 1.0: after}

    def values(fraction: float) -> Array:
        if fraction not in known:
            point = solver.along(before, after, fraction)
            if point is None:
                raise NotLocatedError(f"a bound is met at a point that cannot be located: {solver.failure}")
            known[fraction] = point
        return slack + [one.value for one in margins(space, known[fraction])]

    def value(number: int, fraction: float) -> float:
        return float(values(fraction)[number])

    slack = np.zeros(len(margins(space, before)))
    slack = np.where(values(0.0) > space.tolerance, 0.0, space.tolerance)
    curve, length = solver.curve(before, after)
    for place in BOUND_PREDICTION_PLACES:
        predicted = after if place == 1.0 else replace(after, z=curve.at(place * length))
        passed = slack + [one.value for one in margins(space, predicted)] < 0.0
        passed &= values(place) < 0.0 if np.any(passed) else passed
        if np.any(passed):
            numbers = np.flatnonzero(passed).tolist()
            roots = [brentq(partial(value, number), 0.0, place, xtol=TEST_ZERO_XTOL) for number in numbers]
            first = float(min(roots))
            values(first)
            return replace(known[first], special=BOUND, walked=False, requested=False)
    return None


# The Hopf point at which a branch of orbits ends, as they shrink to an equilibrium ------------------------------------

SHRUNK_ORBIT_REACH = 0.5  # of the variation of an orbit: largest distance of the equilibrium that it shrinks to


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
    equilibria = EquilibriumEquations(statics, 1e-10, "newton", sizes, parameter=space.parameter, to=space.to)
    y, u = x / equilibria.sizes, orbit.parameter
    found = locate_rest(equilibria, HOPF, y, u, 2j * np.pi / values[PERIOD])
    if found is None:
        return None
    reach = np.ptp(states, axis=0) / equilibria.sizes
    near = np.max(np.abs(found.y - y)) <= SHRUNK_ORBIT_REACH * np.max(reach) and abs(found.s - u) <= max(
        0.1, SHRUNK_ORBIT_REACH * np.max(reach)
    )
    same_period = abs(2.0 * np.pi / found.frequency - values[PERIOD]) <= SHRUNK_ORBIT_REACH * values[PERIOD]
    return (equilibria, found) if near and same_period else None


def _as_orbit(space: BoundarySolutions, orbit: Point, equilibria: EquilibriumEquations, found: Located) -> Point:
    """A Hopf point as an orbit of amplitude zero of the branch that ends there."""
    problem = orbit.problem
    algebraic: AlgebraicProblem = equilibria.problem
    x = algebraic.state(np.append(found.y, found.s))
    z = at_rest(problem, x, 2.0 * np.pi / found.frequency, found.s)
    error = ErrorEstimate(found.profile, found.profile, parameter=found.error / problem.parameter_size(z))
    return replace(orbit, z=z, error=error, requested=False, walked=False, better=None, special=HOPF)


OFFSET_FROM_BRANCH_POINT = 1e-3  # of the way from a branch point: where the search for other special points starts


@dataclass(frozen=True, eq=False)
class BoundarySpace(BoundarySolutions):
    """The branch of solutions of a statement in one parameter (see `SolutionSpace`)."""

    @property
    def has_ledger(self) -> bool:
        """Whether changes of stability are located between two solutions."""
        return not self.kind

    def special_between(self, before: Point, after: Point) -> Iterator[Point | Unresolved]:
        """Folds on the stretch between two points, and the Hopf point where an orbit shrinks to an equilibrium.

        The later point itself where the period grows without bound there; where a bound is met, that point comes last.
        Of a boundary-value problem that is no orbit
        the branch points too, which are folds as well where both are one.
        """
        met = met_between(self, before, after)
        after, crossed = met or after, []
        if self.periodic is None and not (self.leaves and not np.any(before.z[-1:] != self.start.z[-1:])):
            found = branch_points_between(self.point_solver, before, after)
            crossed = [point if several else self._solved(point, before) for point, several in found]
        first: Point | None = before
        for point in crossed:
            left = None if first is None else self.point_solver.along(first, point, 1.0 - OFFSET_FROM_BRANCH_POINT)
            if first is not None and left is not None:
                yield from self._turns_between(first, left)
            yield point
            first = self.point_solver.along(point, after, OFFSET_FROM_BRANCH_POINT)
        if first is not None:
            yield from self._turns_between(first, after)
        if met is not None:
            yield met

    def singular_near(self, guess: Point) -> Point | None:
        """The solution near a guess at which branches cross: orbits there are sought by multipliers alone."""
        return special_orbit(self, BRANCH_POINT, guess)

    def _solved(self, branch_point: Point, before: Point) -> Point:
        """A branch point as a solution of its extended equations, where they have one in the same place."""
        located = special_orbit(self, BRANCH_POINT, branch_point)
        if located is None:
            return branch_point
        solver, problem = self.point_solver, located.problem
        there, start = (point.problem.prolong(point.z, problem) for point in (branch_point, before))
        reach = ONE_PLACE * solver.distance(problem, start, there)
        return located if solver.distance(problem, there, located.z) <= reach else branch_point

    def _turns_between(self, before: Point, after: Point) -> Iterator[Point]:
        """The same on a stretch without branch points."""
        unbounded = self._unbounded(before, after)
        if unbounded is not None:
            yield unbounded
            return
        parts = turning(self.point_solver, before, after)
        hopf: Point | None = None
        if parts and self.shrinks(before, after):
            hopf = hopf_end(self, before, after)
        end = hopf if self.left is None or hopf is not None else self.left.rejoined(self, before, after)
        passed = parts if end is None else parts[: len(parts) // 2]  # beyond it the same folds come again
        yield from (self._fold_between(*part) for part in passed)
        if end is not None:
            yield end

    def _fold_between(self, before: Point, after: Point) -> Point:
        """The fold between two points; of orbits as a solution of its extended equations."""
        fold = fold_between(self.point_solver, before, after)
        if self.periodic is None:
            return fold
        kinds = (FOLD, BRANCH_POINT) if self.left is None else (FOLD,)  # a branch that crosses upright turns there too
        found = (special_orbit(self, kind, fold) for kind in kinds)
        return next((point for point in found if point is not None), fold)

    def _unbounded(self, before: Point, after: Point) -> Point | None:
        """The later of two orbits where the period grows without bound there."""
        if self.periodic is None or PERIOD not in self.statement.free:
            return None
        return unbounded(self, before, after)

    def stop(self, point: Point) -> tuple[End | None, str]:
        if point.special == HOPF:
            return End.HOPF, ""
        if point.special == BRANCH_POINT and self.left is not None:
            return End.REJOINED, ""
        if point.special == BOUND:
            return End.BOUND, f"{margin(self, point)}, {point.problem.whereabouts(point.z)}"
        if point.special in (HOMOCLINIC, HETEROCLINIC):
            value, error = self.parameters(point)[self.parameter], self.parameter_error(point)
            where = f"{self.parameter} = {value:.10g} +- {error:.0e}"
            return End.UNBOUNDED, f"{joined_words(self, point)}, at {where}"
        jumps = self.jump(point)
        if jumps:
            return End.JUMP, jumps
        problem = point.problem
        words = problem.backwards(point.z)
        return (End.NO_STEP if words else None), words

    def following(
        self, solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings
    ) -> BoundarySpace:
        """The space of the branch through one of these solutions in a parameter."""
        statement = self.statement.with_parameters(**solution.parameters)
        return BoundarySpace(
            statement, self.tolerance, self.method, Sizes(solution.problem.floors, solution.problem.scalar_floors),
            self.periodic, parameter=parameter, to=to, at=at, first=solution.point, settings=settings,
        )  # fmt: skip
