"""Special points of a branch: folds, at which the continuation parameter turns back, and others.

Turns of the continuation parameter between two points of a branch, also two within one step.

Its rate is known at both ends, and at a place between where it comes near zero or changes much. Hermite curves through
two and through three of them differ by what bounds their errors; a stretch is divided until the rate has no root within
that bound, or one that is simple.

Special points of a family, which are located after it was followed: its folds.

A special solution located to the tolerance, as a regular solution of the augmented problem of its kind.

Equilibria, orbits and solutions of boundary-value problems alike: by Newton's method, refined level by level where
there are several, and by one step more.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, pairwise
from typing import Any, ClassVar, cast

import numpy as np

from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.samples import HALF_STRETCH_PLACES, SampledStretch
from casadi_skin.follow.search import (
    TANGENT_DIFFERENCE_STEP,
    BranchStretch,
    NotLocatedError,
    Search,
    beside_on_tangent,
    monitored,
    zero_between,
)
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import SolutionSpace, corrector_of, of_last_points, precedes, snapped, target_of
from casadi_skin.model.arguments import with_error
from casadi_skin.model.result import Result
from casadi_skin.solve.levels import ExactLevels
from casadi_skin.zero.augmented import Augmented, Singularity, SingularProblem, singular_rest, singularity_of
from casadi_skin.zero.kinds import EQUILIBRIUM_CURVES, FOLD, HOPF, ORBIT_CURVES, TORUS, Unresolved, kind_of
from casadi_skin.zero.orbit import Sizes
from casadi_skin.zero.problem import EPSILON, Array, Scalar, SingularError
from casadi_skin.zero.settings import ContinuationSettings, ErrorEstimate, Point, Target
from casadi_skin.zero.stated_problem import stated
from casadi_skin.zero.statement import Statement

# Turns of the continuation parameter between two points of a branch, also two within one step -------------------------

STEADY_RATE_RATIO = 0.5  # of the largest rate on a stretch: the least one for which nothing turns back within it
STILL_RATE = 1e-9  # rate of a quantity that does not change
BESIDE_STILL = 0.05, 0.2, 0.5  # of a stretch, from a start that a branch leaves upright: beside it rates are rounding
# Of the least rate at the samples: how far the mean rate may be off. Of 40 random dips with two folds 19 are found
# without this, 27 with 0.03, 30 with 0.01, 31 with 0.003 and with 0; nine are found with none of these.
HIDDEN_TURN_RATIO = 0.003
GROWTH_ORDERS = 1.5  # change of the logarithm of a rate on a stretch from which it is looked at in place of the rate
# Of the change of the parameter: how far it may be off that by an exponential rate. Of 7,200 random dips with two folds
# within such growth 45 % are not found so, as against 75 % by the rate at half the way, 20 % of its growth off or less.
GROWTH_RATIO = 0.1
FOLD_TOLERANCE = 1e-7  # of a step: the parameter is stationary there, so that it has twice the digits


def turning(point_solver: PointSolver, before: Point, after: Point) -> list[tuple[Point, Point]]:
    """The parts of a stretch on each of which the quantity that is followed turns back once, in order."""
    curve, length = point_solver.curve(before, after)
    _, start, quadratic, cubic = curve.coefficients[:, after.problem.parameter_index]
    rates = start + length * HALF_STRETCH_PLACES * (2.0 * quadratic + 3.0 * length * HALF_STRETCH_PLACES * cubic)
    sizes, bent = np.abs(rates), 0.5 * abs(cubic) * length**2  # that, by how much their mean is off that of both ends
    least, largest = np.min(sizes), np.max(sizes)
    still = largest <= STILL_RATE and max(abs(rate(before)), abs(rate(after))) <= STILL_RATE
    steady = least >= STEADY_RATE_RATIO * largest or bent <= HIDDEN_TURN_RATIO * least
    if still or (steady and np.all(rates * rates[0] > 0.0)):
        return []
    if rate(before) == 0.0:
        before = _beside_still(point_solver, before, after, length) or before
    search = _Turns(point_solver, before, after)
    return search.on_stretch()


def _beside_still(point_solver: PointSolver, start: Point, after: Point, length: float) -> Point | None:
    """The first place beside a start that a branch leaves upright where rounding leaves digits of the rate."""
    found = None
    for fraction in BESIDE_STILL:
        found, nearer = point_solver.unrefined_along(start, after, fraction), found
        if found is None:
            return nearer
        problem, z = found.problem, found.z
        try:
            solve = point_solver.factor(problem, z, point_solver.metric(problem, z) * found.tangent)
        except SingularError:
            continue
        off = abs(float(solve(np.append(problem.evaluate(z)[0], 0.0))[problem.parameter_index]))
        if off <= HIDDEN_TURN_RATIO * abs(rate(found)) * fraction * length:
            break
    return found


def rate(point: Point) -> float:
    """Rate of the continuation parameter along the branch."""
    return float(point.tangent[point.problem.parameter_index])


@of_last_points
def rate_change(solver: PointSolver, point: Point) -> float:
    """How this rate changes along the branch: stretches on both sides of a point ask for it; 0 where it is singular."""
    ahead = beside_on_tangent(point, TANGENT_DIFFERENCE_STEP)
    try:
        solve = solver.factor(ahead.problem, ahead.z, solver.metric(point.problem, point.z) * point.tangent)
        tangent = solver.tangent(ahead.problem, ahead.z, solve)
    except SingularError:
        return 0.0
    return (rate(replace(ahead, tangent=tangent)) - rate(point)) / TANGENT_DIFFERENCE_STEP


class _Turns(Search):
    """The search for roots of the rate of the parameter."""

    def values(self, point: Point) -> Array:
        return np.array([rate(point)])

    def rates(self, point: Point, here: Array) -> Array:
        return np.full(1, rate_change(self.solver, point))

    def between(self, before: Point, after: Point, depth: int = 0) -> Iterator[Any]:
        """As above; growth along canards is seen before a point between is sought, and slopes of rates."""
        if not self._grows(before, after):
            yield from super().between(before, after, depth)

    def passes(self, ends: SampledStretch) -> bool:
        return super().passes(ends) and not self._hides(ends)

    def found(self, stretch: SampledStretch, depth: int, last: bool) -> Sequence[tuple[Point, Point]] | None:
        ends = self.own(stretch.first.point), self.own(stretch.last.point)
        one, other = map(rate, ends)
        if max(abs(one), abs(other)) <= STILL_RATE:
            return []
        if not (last or (np.all(stretch.isolates_roots) and not self._hides(stretch))):
            return None
        return [ends] if one * other < 0.0 else []

    def _grows(self, before: Point, after: Point) -> bool:
        """Whether the rate grows like an exponential, as along canards, by the change of the parameter between.

        That is the integral of the rate: of an exponential, the logarithmic mean of both ends times the length.
        """
        index = after.problem.parameter_index
        one, other = (float(point.tangent[index] / (self.row @ point.tangent)) for point in (before, after))
        if self.moving is None or not one * other > 0.0 or abs(growth := math.log(other / one)) <= GROWTH_ORDERS:
            return False
        expected = (other - one) / growth * (self.sigma(after) - self.sigma(before))
        off = abs(float(after.z[index] - before.z[index]) - expected)
        off += sum(point.error.parameter * float(point.problem.parameter_size(point.z)) for point in (before, after))
        return bool(off <= GROWTH_RATIO * abs(expected))

    def _hides(self, stretch: SampledStretch) -> bool:
        """Whether the parameter itself is off by as much as turns between the samples would make it.

        It is the integral of its rate, and so sees a dip of the rate that the rates at the samples do not.
        """
        points = [sample.point for sample in stretch.samples]
        index, length = points[0].problem.parameter_index, stretch.length
        if len(points) == 2:
            off = 0.5 * abs(stretch.curve.coefficients[-1, index]) * length**2
        else:
            off = abs(stretch.curve.at(float(stretch.sigma[1]))[index] - points[1].z[index]) / length
        least = HIDDEN_TURN_RATIO * min(abs(rate(point)) for point in points)
        if self.moving is not None:  # on meshes of their own, which leave errors of the parameter
            least = max(least, self.solver.settings.tolerance / length)
        return bool(off > least)


@dataclass(frozen=True, eq=False)
class SpecialPoint(Result):
    """A special point of a branch, with the coefficient of its normal form.

    Attributes:
        kind: "fold"; of equilibria also "branch point" and "hopf"; of boundary-value problems "branch point"; of orbits
            whose stability was computed "period doubling", "torus" and "branch point", the first two also of problems
            whose conditions close their solutions; where they end "hopf", or "homoclinic" or "heteroclinic" where their
            period grows without bound, or "bound" where a bound of the problem is met.
        parameter: name of the continuation parameter.
        parameters: values of all parameters by name, and of the continuation parameter.
        error: estimated error of the continuation parameter.
        solution: the solution there.
        mu: value of mu, 0 or -1, at which another branch leaves a family.
    """

    kind: str
    parameter: str
    parameters: Mapping[str, float]
    error: float
    solution: Any
    mu: float | None = None

    def __repr__(self) -> str:
        words = f", {self.criticality}" if self.has_criticality else ""
        words += "".join(f", loses its {what}" for what in self.lost)
        name = self.parameter
        return f"<{self.kind} at {name} = {with_error(self.parameters[name], self.error)}{words}>"

    def __str__(self) -> str:
        """One line, as `repr`, also within other words."""
        return repr(self)

    @property
    def has_curve(self) -> bool:
        """Whether points of its kind form curves in two parameters, where something keeps them."""
        curves = EQUILIBRIUM_CURVES if self.solution.is_equilibrium else ORBIT_CURVES
        return self.mu is None and self.kind in curves

    @property
    def has_criticality(self) -> bool:
        """Whether the normal form is known and decides on which side the new branch is."""
        if kind_of(self.kind).angle == 0.0 or self.mu is not None:
            return False
        space: Any = self.solution.space
        if getattr(space, "periodic", self) is not None:
            return True
        closure, point = space.closure, self.solution.point
        return closure is not None and bool(closure.goes_on(point.problem, point.z))

    follow: ClassVar[Callable[..., Any]]
    """The `Branch` that leaves here: `casadi_skin.points.switch.switch`."""
    curve: ClassVar[Callable[..., Any]]
    """This point followed in a second parameter: `casadi_skin.points.curves.curve`."""
    gradient: ClassVar[Callable[..., Any]]
    """Derivatives of the located value by all other parameters: `casadi_skin.points.gradient.gradient`."""
    spread: ClassVar[Callable[..., float]]
    """Its standard deviation to first order: `casadi_skin.points.gradient.spread`."""
    normal_form: ClassVar[Callable[..., Any]]
    """The normal form, by projection: `casadi_skin.follow.normal_forms.critical`."""
    lost_symmetries: ClassVar[Callable[..., tuple[str, ...]]]
    """The symmetries that what leaves here lacks, in words: `casadi_skin.points.lost_symmetry.lost_at`."""

    @cached_property
    def _critical(self) -> Any:
        return self.normal_form()

    @property
    def vector(self) -> Any:
        """Critical eigenvector, of orbits Floquet vector at phase zero, shape (components of the state,).

        Raises ValueError where none is defined.
        """
        return self._critical.vector

    @cached_property
    def lost(self) -> tuple[str, ...]:
        """Symmetries that orbits of the branch that leaves at a branch point lack, in words."""
        return self.lost_symmetries()

    @property
    def frequency(self) -> float:
        """Imaginary part of the critical eigenvalues or Floquet exponents; raises ValueError where none is defined.

        Where several pairs are critical that of the pair that was located, or whose curve was followed.
        """
        return float(self._critical.frequency)

    @property
    def coefficient(self) -> float:
        """Coefficient of the normal form.

        Of a Hopf point the first Lyapunov coefficient, of a fold the quadratic one, of a period doubling or a torus the
        cubic one (see `critical_orbits.normal_forms`). NaN where none is defined or known, as at a homoclinic end.
        """
        try:
            return float(self._critical.coefficient)
        except ValueError:  # of a kind without a normal form
            return math.nan

    @property
    def criticality(self) -> str:
        """Meaning of the coefficient: "supercritical", "subcritical" or "degenerate"; of a fold "quadratic".

        Empty where no normal form is known.
        """
        try:
            return str(self._critical.words)
        except ValueError:
            return ""


def check_second(point: SpecialPoint, parameter: str) -> None:
    """Raise ValueError where a special point is to be followed in the parameter that it was found in."""
    if parameter == point.parameter:
        solution = point.solution
        names = (name for name in solution.parameters if name not in (parameter, *solution.space.free))
        accepted = ", ".join(names) or "none"
        raise ValueError(f"parameter: given {parameter!r}, in which the {point.kind} was found; accepted: {accepted}")


def folds_between(point_solver: PointSolver, before: Point, after: Point) -> Iterator[Point]:
    """The points between two at which the continuation parameter turns back, in order; raises NotLocatedError."""
    yield from (fold_between(point_solver, *part) for part in turning(point_solver, before, after))


def fold_between(point_solver: PointSolver, before: Point, after: Point) -> Point:
    """The point between two at which the free parameter is stationary; raises NotLocatedError where none is found.

    It is located on one level of resolution: the errors of orbits at a held parameter, by which others are
    refined, are of no use beside a fold.
    """
    along = point_solver.unrefined_along
    root = zero_between(point_solver, before, after, rate, FOLD, FOLD_TOLERANCE, along)[0].fraction
    point = point_solver.along(before, after, root) or point_solver.coarse_along(before, after, root)
    if point is None:
        raise NotLocatedError(f"a point of kind {FOLD} cannot be located: {point_solver.failure}")
    return replace(point, special=FOLD)


# Special points of a family, which are located after it was followed: its folds --------------------------------------


def special_point(space: SolutionSpace, solution: Solution) -> SpecialPoint:
    """A solution that is marked as special, as a special point."""
    name, point = space.parameter, solution.point
    values = {**solution.parameters, name: solution.value(name)}
    return SpecialPoint(point.special, name, values, space.parameter_error(point), solution)


def folds_of_family(space: SolutionSpace, solutions: Sequence[Solution]) -> tuple[list[SpecialPoint], list[Unresolved]]:
    """Folds between the points of a family, and the stretches on which one is not located."""
    found, gaps = list[SpecialPoint](), list[Unresolved]()
    for before, after in pairwise(solutions):
        try:
            points = space.special_between(before.point, after.point, gaps)
            found += [special_point(space, space.solution(point)) for point in points]
        except NotLocatedError as error:
            ends = before.value(space.parameter), after.value(space.parameter)
            gaps.append(Unresolved(*ends, str(error), FOLD))
    return found, gaps


# A special solution located to the tolerance, as a regular solution of the augmented problem of its kind --------------

NEAR_STEP_FRACTION = 0.5  # of the longest step: how far from its approximate place a special orbit may be
ROUNDING_PROBES = 8  # changes of the equations by their rounding, of signs drawn at random
ROUNDING_DEVIATIONS = 8.0  # standard deviations of the responses: of 144 places in closed form some were off by 7.4
PUSH_RTOL = 1e-7  # of the size of a push of the equations: one by which two branches still meet


@dataclass(frozen=True, eq=False)
class Located:
    """A special solution.

    Attributes:
        singularity: what makes it special.
        point: its unknowns, the parameter that was found with it among them.
        value: of that parameter; of an equilibrium the fraction of its course.
        error: estimated absolute error of it.
    """

    singularity: Singularity
    point: Point
    value: float
    error: float

    @property
    def resting(self) -> Array:
        """The state of an equilibrium over its sizes, and the fraction of the course."""
        return np.asarray(self.point.z[: self.point.problem.first_index + 1])

    @property
    def frequency(self) -> float:
        """Imaginary part of the critical eigenvalues of a Hopf point."""
        return float(self.point.problem.frequency_of(self.point.z))


def locate_rest(space: SolutionSpace, kind: str, near: Array, pair: complex | None = None) -> Located | None:
    """The special equilibrium of a kind near (y, s); None where Newton's method finds none there.

    `pair` selects the pair of eigenvalues of a Hopf point.
    """
    try:
        problem, z = singular_rest(kind, space.problem, near, pair)
        levels = ExactLevels(problem, lambda problem: corrector_of("newton", space.tolerance, problem))
        unit = abs(space.course.at(near[-1]) / (space.course.to - space.course.start))
        return _solved(PointSolver(levels, ContinuationSettings(1.0, space.tolerance)), problem, z, unit)
    except (ArithmeticError, RuntimeError):  # the linearised equations are singular in another way
        return None


def locate(space: SolutionSpace, kind: str, near: Point, angle: float = np.pi) -> Located | None:
    """The special orbit of a kind near an orbit of a branch; None where Newton's method finds none there.

    `angle` is that of the multipliers of a torus.
    """
    if kind not in ORBIT_CURVES:
        return None
    value, problem, first = space.parameters(near)[space.parameter], stated(near.problem), space.parameter
    try:
        turn = np.zeros((0, 0)) if space.closure is None else space.closure.matrix
        autonomous = kind == TORUS and space.moves_freely(near)
        singularity = singularity_of(kind, problem, near.z, first, angle, turn, autonomous)
        unit = abs(space.to - space.statement.values[first])
        special = special_solutions(singularity, space, space.statement.with_parameters(**{first: value}), unit)
        own = cast(SingularProblem, special.levels.problem(problem.resolution).with_constants(problem.constants))
        if own.rests(near.z):
            own = cast(SingularProblem, special.levels.finer(own) or own)
        added = [np.cos(angle)] if kind == TORUS else [0.0] * singularity.added
        z = np.concatenate([problem.prolong(near.z, own)[:-1], [value], added, [0.0]])
        return _solved(special.point_solver, own, z, unit)
    except (ArithmeticError, RuntimeError):  # the linearised equations are singular in another way
        return None


def _solved(solver: PointSolver, problem: Augmented, z: Array, unit: float) -> Located | None:
    """The regular solution near z; `unit` is a usual change of the first parameter. None without one of the kind."""
    row, singularity = problem.parameter_row(), problem.singularity
    correction = solver.levels.corrector(problem).correct(z, row, 0.0)
    found = solver.refined(problem, correction, row, Scalar.PARAMETER) if correction.converged else None
    if found is None:
        return None
    assert found.better is not None
    known = correction.solve if found.problem is problem and found.better.problem is not problem else None
    problem, better, z, index = found.problem, found.better, found.z, found.problem.first_index
    solve = known or solver.factor(problem, z, problem.parameter_row())
    step, rounding = solve(np.append(problem.evaluate(z)[0], 0.0)), problem.rounding(z)
    z = z - step
    if better.problem is problem:  # of one level, whose error steps make up for
        z = z - solve(np.append(problem.evaluate(z)[0], 0.0))
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (ROUNDING_PROBES, rounding.size))
    noise = np.array([solve(np.append(one * rounding, 0.0)) for one in signs])
    value, spread = float(z[index]), np.sqrt(np.mean(noise**2, axis=0))
    apart = abs(float(better.z[better.problem.first_index]) - value)
    error = 2.0 * apart + ROUNDING_DEVIATIONS * float(spread[index]) + EPSILON * max(abs(value), unit)
    if singularity.pushes and abs(z[problem.added_index]) > PUSH_RTOL * problem.push_size(z):
        return None
    if singularity.kind == HOPF and not z[problem.added_index] > 0.0:
        return None  # a neutral saddle
    if better.problem is problem:
        profile = problem.profile_change(z, step) + problem.profile_change(z, ROUNDING_DEVIATIONS * spread)
        found = replace(found, error=ErrorEstimate(0.0, profile))
    return Located(singularity, replace(found, z=z), value, error)


def special_solutions(
    singularity: Singularity,
    orbits: SolutionSpace,
    statement: Statement,
    unit: float,
    parameter: str = "",
    to: float = 1.0,
) -> Any:
    """The space of special solutions of a statement; `unit` is a usual change of the parameter found with them."""
    scalars = np.concatenate([orbits.sizes.scalars, [unit], np.ones(singularity.added)])
    method = replace(orbits.method, corrector="newton")
    sizes = Sizes(orbits.sizes.states, scalars)
    special = replace(cast(Any, orbits), statement=statement, method=method, sizes=sizes, singularity=singularity)
    return replace(
        special, parameter=parameter, to=to, periodic=None, left=None, at=(), first=None, settings=None, leaves=False
    )


def ending(
    orbit: Point, kind: str, states: Array, values: Mapping[str, float], u: float, error: ErrorEstimate
) -> Point:
    """An orbit with other states, free parameters by name and u as a special one at which its branch ends.

    The error of the parameter is given in units of u.
    """
    problem, z = stated(orbit.problem), orbit.z.copy()
    z[: problem.states].reshape(problem.columns, -1)[:] = states
    for place, name in enumerate(problem.statement.free, start=problem.states):
        z[place] = values.get(name, z[place])
    z[-1] = u
    error = replace(error, parameter=error.parameter / problem.parameter_size(z))
    return orbit.marked(kind, z=z, error=error, better=None)


def special_orbit(space: SolutionSpace, kind: str, near: Point, angle: float = np.pi) -> Point | None:
    """The special orbit of a kind near an orbit of a branch as a point of it, with the tangent of that orbit.

    None where none is found.
    """
    located = locate(space, kind, near, angle)
    if located is None:
        return None
    special, start = located.point, space.statement.values[space.parameter]
    cosine = special.z[special.problem.added_index] if kind == TORUS else np.nan
    problem = space.levels.problem(special.problem.resolution).with_constants(special.problem.constants)
    z = np.append(special.z[: problem.size - 1], (located.value - start) / (space.to - start))
    error = replace(special.error, parameter=located.error / abs(space.to - start) / problem.parameter_size(z))
    there, tangent = (near.problem.prolong(v, problem) for v in (near.z, near.tangent))
    if space.point_solver.distance(problem, there, z) > NEAR_STEP_FRACTION * space.point_solver.settings.max_step:
        return None
    known = {"problem": problem, "z": z, "tangent": tangent, "error": error, "at_round_off": special.at_round_off}
    of_pair = float(np.arccos(np.clip(cosine, -1.0, 1.0))) if kind == TORUS else None
    return near.marked(kind, better=None, angle=of_pair, **known)


# The points of one stretch of a branch in order: requested ones, and special ones, which may be the same --------------

BESIDE_START = 1e-2  # of a stretch, from the start of a branch: where the search begins if something is special there
SAME_PLACE = 1e-2  # of a stretch: a requested point that near to a special one of the same value is that one


class StretchPoints(BranchStretch):
    """The points between `before` and `after`, which may lie beyond the end of the branch.

    `requested` are the points of the continuation on the stretch, its end among them where that comes before `after`;
    `missed` the targets that it passed without a point, also by this search; `unresolved` fills with the parts on which
    special points may be missing.
    """

    def __init__(
        self, space: SolutionSpace, before: Point, after: Point, requested: Sequence[Point], missed: Sequence[Target]
    ) -> None:
        super().__init__(space.point_solver, before, after)
        self.space, self.requested, self.missed = space, list(requested), list(missed)
        self.unresolved = list[Unresolved]()

    def special(self) -> list[Point]:
        """Special points in order, those at requested values exactly there; raises NotLocatedError."""
        targets, found = self.solver.settings.at, list[Point]()
        before, after = self._bounds()
        special = self.space.special_between(before, after, self.unresolved)
        if before is not self.ends[0]:
            special = (point for point in special if not precedes(self.space, self, point))
        for point in chain(special, monitored(self.space, *self.ends, self.unresolved)):
            target = target_of(self.space, point)
            found.append(point if target is None else snapped(point, target, target in targets))
        for target in self.missed:
            if all(point.parameter != target.value for point in found):
                found += self._at(target)
        self.missed = [target for target in self.missed if all(point.parameter != target.value for point in found)]
        return sorted(found, key=self.sigma)

    def _bounds(self) -> list[Point]:
        """The ends of the search: behind the start of a branch where rounding decides on its side of a special point.

        Beside one that the branch leaves, as it is known; a branch that comes back to such a start has it once.
        """
        bounds, beside = list(self.ends), BESIDE_START if self.space.leaves else -BESIDE_START
        for end, (point, place) in enumerate(zip(self.ends, (beside, 1.0 - BESIDE_START), strict=True)):
            if np.array_equal(point.z, self.space.start.z) and self.space.is_unclear(point, BESIDE_START * self.length):
                bounds[end] = self.solver.along(*self.ends, place) or point
        return bounds

    def _at(self, target: Target) -> Iterator[Point]:
        """The special point at a value at which no solution was found, where there is one."""
        solver, problem = self.solver, self.last.problem
        if target.held is not Scalar.PARAMETER:
            return
        curve, _ = solver.curve(*self.ends)
        index, value = target.unknown(problem)
        for sigma, _ in curve.crossings(index, [value])[:1]:
            there = curve.on(problem, sigma)
            guess = replace(
                self.last, problem=there, z=curve.at(sigma), tangent=curve.slope(sigma), better=None, special=""
            )  # fmt: skip
            point = self.space.singular_near(guess)
            if point is not None and target_of(self.space, point) == target:
                yield snapped(point, target, target in solver.settings.at)

    def beside_folds(self, special: Sequence[Point]) -> list[Point]:
        """The requested points so near to folds that the continuation passed them by."""
        if not any(point.special == FOLD for point in special):
            return []
        solver, found = self.solver, list[Point]()
        wanted = [target for target in solver.settings.at if target.held is Scalar.PARAMETER]
        ends = (self.ends[0], *special, self.ends[1])
        for one, other in pairwise(ends):
            low, high = sorted((one.parameter, other.parameter))
            start, end = self.sigma(one), self.sigma(other)
            known = {point.parameter for point in self.requested if start <= self.sigma(point) <= end}
            inside = tuple(t for t in wanted if low < t.value < high and t.value not in known)
            inside = tuple(t for t in inside if not (t.meets(one) or t.meets(other)))
            points = {target: point for target, point in solver.between(one, other, inside) if point is not None}
            found += [replace(point, requested=True) for point in points.values()]
            self.missed += [t for t in inside if t not in (*points, *self.missed)]
        return found

    def points(self) -> list[Point]:
        """All points in order but `after`, those that are no points of the continuation marked as located."""
        special = self.special()
        located = [replace(point, located=True) for point in (*special, *self.beside_folds(special))]
        near = SAME_PLACE * abs(self.length)
        own = [point for point in self.requested if not any(self._is(point, one, near) for one in special)]
        return sorted([*located, *own], key=self.sigma)

    def _is(self, point: Point, special: Point, near: float) -> bool:
        same = special.parameter == point.parameter
        return same and abs(self.sigma(special) - self.sigma(point)) <= near
