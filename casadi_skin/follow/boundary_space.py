"""Solutions of one boundary-value problem, orbits among them, as the solutions that a branch connects."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from casadi_skin.follow.branch_points import ONE_PLACE, branch_points_between
from casadi_skin.follow.period_limit import joined_words, unbounded
from casadi_skin.follow.point import ROUND_OFF
from casadi_skin.follow.rest_space import EquilibriumSpace
from casadi_skin.follow.search import TANGENT_DIFFERENCE_STEP, MonitorSearch, beside_on_tangent
from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.follow.space import (
    ORBITS,
    SOLUTIONS,
    BoundaryError,
    FamilyError,
    NotRefinedError,
    ParameterSpace,
    of_last_points,
)
from casadi_skin.follow.special_points import Located, ending, fold_between, locate_rest, special_orbit, turning
from casadi_skin.model.amplitude import amplitude_square
from casadi_skin.model.arguments import check_name, number
from casadi_skin.model.conserved import SymmetryClass, unfolded_phases
from casadi_skin.model.integrators import IntegrationError
from casadi_skin.model.jumps import STATE, TIME, JumpError
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import NoQuantityError, kept_by_first
from casadi_skin.native.programs import buffers
from casadi_skin.solve.intervals import Intervals
from casadi_skin.solve.ipopt import CORRECTORS, ArbitratedCorrector
from casadi_skin.solve.levels import Levels
from casadi_skin.solve.newton import Correction, Corrector, RoundedCorrector, in_family, rank_deficiency
from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.full_period import FULL_PERIOD_FLOWS, Closed
from casadi_skin.stability.reduction import ComplexArray, vectors_of
from casadi_skin.stability.result import LARGEST_LOGARITHM, Floquet
from casadi_skin.zero import mesh
from casadi_skin.zero.augmented import Singularity, SingularProblem
from casadi_skin.zero.balanced import ROUNDED_COMPONENT_RATIO, Faint
from casadi_skin.zero.butcher import TABLES
from casadi_skin.zero.coordinates import numbered
from casadi_skin.zero.family import TWO_PI, Method
from casadi_skin.zero.kinds import BOUND, BRANCH_POINT, FOLD, HETEROCLINIC, HOMOCLINIC, HOPF, Unresolved, kind_of
from casadi_skin.zero.orbit import FIRST_INTERVALS, UNFOLDING, Periodic, Sizes
from casadi_skin.zero.problem import Array, Buffers, Indices, Problem, Scalar, SingularError
from casadi_skin.zero.rest import Statics, sizes_of
from casadi_skin.zero.settings import ContinuationSettings, End, ErrorEstimate, Point, Refinement
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem, Closure, closure_of, stated
from casadi_skin.zero.statement import Statement

# Bounds on states and free parameters along a branch: where the first of them is met, and which -----------------------

PLACES_WITHIN_COLUMN = 8  # places between two columns of a mesh at which a state is looked at
# Into the neighbours of the largest value: places then differ by 1e-5 of theirs, values by the square.
EXTREMUM_ZOOMS = 4
BOUND_MET_RTOL = 1e-12  # of the size of a quantity: a bound that is as near is met


@of_last_points
def margins(space: BoundarySpace, point: Point) -> list[tuple[float, str]]:
    """How far a solution is from each finite bound over the whole interval, and which bound it is, in words.

    Distances are relative to the size of the quantity, and negative beyond the bound.
    """
    values, (start, end), edges = space.parameters(point), space.interval(point), point.problem._fractions()
    if space.periodic is not None:
        part = space.periodic.symmetry.value
        edges = np.unique(np.concatenate([edges * part, 1.0 - edges * part, np.linspace(0.0, 1.0, edges.size)]))
    inner = np.linspace(0.0, 1.0, PLACES_WITHIN_COLUMN, endpoint=False)
    turns = np.append((edges[:-1, None] + np.diff(edges)[:, None] * inner).ravel(), 1.0)

    def sampled(turns: Array) -> Array:
        if space.periodic is not None:
            return space.states_at(point, TWO_PI * turns, None)
        return np.asarray(point.problem.sample(point.z, turns))

    states, found = sampled(turns), list[tuple[float, str]]()
    for name, (lower, upper) in space.statement.bounds.items():
        for sign, bound, which in ((1.0, upper, "upper"), (-1.0, lower, "lower")):
            if math.isinf(bound):
                continue
            if name in space.state_names:
                k = space.state_names.index(name)
                size, places, course = float(np.max(np.abs(states[:, k]))), turns, sign * states[:, k]
                for _ in range(EXTREMUM_ZOOMS):
                    at = int(np.argmax(course))
                    if at in (0, places.size - 1):
                        break
                    places = np.linspace(places[at - 1], places[at + 1], 4 * PLACES_WITHIN_COLUMN + 1)
                    course = sign * sampled(places)[:, k]
                at = int(np.argmax(course))
                largest, when = float(course[at]), f" at t = {start + places[at] * (end - start):.6g}"
            else:
                largest, size, when = sign * values[name], abs(values[name]), ""
            distance = (sign * bound - largest) / max(abs(bound), size, BOUND_MET_RTOL)
            found.append((distance, f"{name} comes to its {which} bound {bound:.10g}{when}"))
    return found


def met_between(space: BoundarySpace, before: Point, after: Point) -> Point | None:
    """The first point between two at which a bound is met; None where none is.

    A state that a condition holds at a bound is there all along, but for the error of the solution.
    """
    if not space.statement.bounds:
        return None

    def values(point: Point) -> Array:
        return np.array([distance for distance, _ in margins(space, point)])

    held = np.where(values(before) <= space.tolerance, space.tolerance, 0.0)
    search = MonitorSearch(space, before, after, [BOUND] * held.size, lambda point: np.asarray(values(point) + held))
    return next(iter(search.on_stretch()), None)


# The Hopf point at which a branch of orbits ends, as they shrink to an equilibrium ------------------------------------

SHRUNK_ORBIT_REACH = 0.5  # of the variation of an orbit: largest distance of the equilibrium that it shrinks to


def hopf_near(
    space: Any, before: Point, after: Point, name: str, start: float, to: float
) -> tuple[Point, Array, EquilibriumSpace, Located] | None:
    """The smaller of two orbits with its states at 256 phases, and the Hopf point near its mean and its period.

    It is one of the equilibria in a parameter, whose branch goes from a start to an end. None where there is none.
    """
    orbit = min((before, after), key=space.amplitude)
    states = np.asarray(space.states_at(orbit, np.linspace(0.0, TWO_PI, 257)[:-1], None))
    model, values, x = space.model, space.parameters(orbit), states.mean(axis=0)
    statics = Statics(model, {**{key: values[key] for key in model.parameter_names}, name: start})
    sizes = sizes_of(statics, [x, space.sizes.states[: x.size]])  # an equilibrium near zero has the size of the branch
    equilibria = EquilibriumSpace(statics, 1e-10, "newton", sizes, parameter=name, to=to)
    guess = np.append(x / sizes, (values[name] - start) / (to - start))
    found = locate_rest(equilibria, HOPF, guess, 2j * np.pi / space.interval(orbit)[1])
    return None if found is None else (orbit, states, equilibria, found)


def hopf_end(space: BoundarySpace, before: Point, after: Point) -> Point | None:
    """The Hopf point between two orbits whose amplitude passes through zero, as an orbit; None where there is none."""
    near = hopf_near(space, before, after, space.parameter, space.begins, space.to)
    if near is None:
        return None
    orbit, states, equilibria, found = near
    period, born = space.interval(orbit)[1], TWO_PI / found.frequency
    reach = SHRUNK_ORBIT_REACH * np.max(np.ptp(states, axis=0) / equilibria.sizes)
    away = np.abs(found.resting - np.append(states.mean(axis=0) / equilibria.sizes, orbit.parameter))
    if np.any(away[:-1] > reach) or away[-1] > max(0.1, reach) or abs(born - period) > SHRUNK_ORBIT_REACH * period:
        return None
    seen = np.where(np.abs(found.resting) > ROUNDED_COMPONENT_RATIO, found.resting, 0.0)
    values, profile = {**orbit.problem.statement.values, PERIOD: born}, found.point.error.profile
    error = ErrorEstimate(profile, profile, parameter=found.error)
    return ending(orbit, HOPF, equilibria.problem.state(seen), values, found.value, error)


def up_to_period(space: Any, period_max: float | None) -> Any:
    """The space of a branch that ends at a period too, where one is given; raises ValueError and TypeError."""
    if period_max is None:
        return space
    if PERIOD not in space.held_names:
        given = "given with solutions whose period is not their own"
        raise ValueError(f"period_max: {given}; accepted: orbits of a model that is not forced")
    first = space.parameters(space.start)[PERIOD]
    if not number("period_max", period_max) > first:
        raise ValueError(
            f"period_max: given {period_max!r}; accepted: a number > {first:.10g}, where the branch starts"
        )
    return replace(space, settings=replace(space.settings, Omega_end=TWO_PI / period_max))


def at_fixed_period(space: Any) -> Any:
    """The orbits of a family at the period of the first of them, in place of what `select` is; raises ValueError."""
    picked = space.connects == ORBITS and PERIOD in space.statement.free
    if picked:
        statement, whole = space.statement, space.symmetry is SymmetryClass.FULL
        place = 1 if whole else 2  # as `statement_of` has it
        unfolded = any(name.startswith(UNFOLDING) for name in statement.free)
        picked = len(statement.conditions) > place and (unfolded or not whole)
    if not picked:
        raise ValueError("fixed: given with a solution whose period is its own; accepted: an orbit that `select` picks")
    if statement.conditions[place].numel() != 1:
        raise ValueError("fixed: given with an orbit of a family of several dimensions; accepted: one of one dimension")
    model, conditions = statement.model, list(statement.conditions)
    period = model.parameters[model.parameter_names.index(PERIOD)]
    conditions[place] = period / statement.values[PERIOD] - 1
    return replace(space, statement=replace(statement, conditions=conditions))


# Solutions of a statement, and the branch of them in one parameter --------------------------------------------------

MESH_INTERVALS = (5, 8, 12, 18, 27, 40, 60, 90, 135, 200, 300, 450, 675, 1000, 1500, 2250)
PLACES = np.linspace(0.0, 1.0, 17)[:-1]  # at which an orbit is linearised to see which components are faint
OFF_EDGE = 1e-10  # of the interval: distance of a jump in time from an edge of the mesh that counts
PER_STAGE = 2  # places a stage at which a solution is looked at for jumps
MEANINGLESS_ERROR = 1e-2  # estimated error beyond which a solution is no solution, rounding or not
UNIT_MULTIPLIER_REACH = 0.1  # distance from 1 of multipliers that are 1 twice: errors of the maps enter by their root
MOST_IPOPT_ITERATIONS = 100  # of Ipopt: a guess of a boundary-value problem may be far away
# Of a stretch, from a branch point on it: where the search for folds starts. Nearer by rates are rounding.
OFFSET_FROM_BRANCH_POINT = 1e-3


@kept_by_first
def _slopes(model: OdeModel) -> tuple[Buffers, tuple[Indices, Indices]]:
    """df/dx at these places, a function of (t, x, p), and rows and columns of its entries."""
    slope = model.function("slope", ca.jacobian(model.full_rhs, model.full_state))
    rows, columns = (np.array(each, dtype=np.int64) for each in slope.sparsity_out(0).get_triplet())
    return buffers(slope, PLACES.size, model.programs), (rows, columns)


@dataclass(frozen=True, eq=False)
class BoundarySpace(ParameterSpace):
    """The solutions of a statement, or the branch of them in one parameter.

    Attributes:
        statement: the problem; values of its parameters are those at the start of a branch.
        tolerance: relative error of states and free parameters.
        method: how, with every choice made.
        sizes: least sizes by which states and free parameters are measured.
        periodic: conditions that make the solutions orbits; None where they are none.
        left: the branch that it has left, where it may come back to it: `points.ends.Left`.
        singularity: of special solutions alone, what makes them special.
    """

    statement: Statement
    tolerance: float
    method: Method
    sizes: Sizes
    periodic: Periodic | None = None
    left: Any = None
    singularity: Singularity | None = None
    error: ClassVar[type[ArithmeticError]] = BoundaryError

    @property
    def connects(self) -> str:
        return SOLUTIONS if self.periodic is None else ORBITS

    @property
    def model(self) -> OdeModel:
        """The model that the solutions belong to, of first order; of an orbit without the added parameters."""
        return self.statement.model if self.periodic is None else self.periodic.model

    @property
    def optimises(self) -> bool:
        return self.statement.optimises

    @property
    def free(self) -> Sequence[str]:
        """Parameters that are found with the states."""
        return self.statement.free

    def _corrector(self, problem: Problem) -> Corrector:
        """The corrector, for a hundredth of the tolerance where rounding allows it.

        Solutions that do not meet Ipopt's own test are put to it.

        Special solutions are solved further: their null vectors, of which points of codimension two are made, are not.
        """
        part = 1e-2 if self.singularity is None else 1e-3
        tolerance = float(np.clip(part * self.tolerance, 1e-12, 1e-6))
        name = self.method.corrector
        make = CORRECTORS[name]
        if name == "ipopt":
            make = partial(ArbitratedCorrector, always=False, far=True)
        return RoundedCorrector(make(problem, tolerance, MOST_IPOPT_ITERATIONS))

    def _faint(self) -> Faint | None:
        """Components of the first orbit that are faint, by its linearisation at both ends of the branch."""
        if self.first is None or self.singularity is not None or self.periodic is None:
            return None
        model, (problem, z) = self.model, (self.first.problem, self.first.z)
        known = dict(zip(self.statement.model.parameter_names, problem.parameters(z), strict=True))
        states, (slopes, places), sizes = problem.sample(z, PLACES), _slopes(model), np.zeros(())
        for value in (self.begins, self.to):
            p = [value if name == self.parameter else known[name] for name in model.parameter_names]
            found = slopes(PLACES[:, None], states, np.array(p))[0]
            sizes = sizes + np.abs(found.reshape(PLACES.size, -1)).sum(axis=0)
        return Faint.of(sizes, places, problem.sizes(z)[: model.full_size]) if np.isfinite(sizes).all() else None

    @cached_property
    def levels(self) -> Levels:
        """Discretisations from coarse to fine; the scalar u is held, or follows the parameter."""
        walking, special = self.parameter or None, self.singularity
        if special is None:
            formulation = self.statement.formulation(walking)
        else:
            formulation = special.formulation(self.statement, walking)
        table = TABLES[str(self.method.transcription)](self.method.degree)
        sizes, faint = self.sizes, self._faint()

        def build(intervals: int) -> Problem:
            given = self.statement, formulation, intervals, table, sizes.states, sizes.scalars, walking, self.to
            if special is not None:
                return SingularProblem(special, *given)
            problem = BoundaryProblem(*given)
            problem.faint = faint
            return problem

        first = int(self.method.intervals or FIRST_INTERVALS)
        least = (
            0 if self.periodic is None else min(first, FIRST_INTERVALS)
        )  # beside a Hopf point multipliers are 1 but for the square of the size
        above = [intervals for intervals in MESH_INTERVALS if intervals >= least]
        return Levels(build, self._corrector, tuple(sorted({*above, first})))

    def refined(self, problem: BoundaryProblem, correction: Correction) -> Point:
        """The solution of a correction on a mesh that meets the tolerance, with u held; raises BoundaryError."""
        name = problem.statement.model.name
        try:
            point = self.point_solver.refined(problem, correction, problem.parameter_row(), Scalar.PARAMETER)
        except SingularError as error:
            self._check_alone(Point(problem, correction.z, np.zeros(0), ErrorEstimate(0.0, 0.0), 0.0, 0), refined=False)
            reason = rank_deficiency(problem, correction.z) or str(error)
            raise NotRefinedError(f"{name}: the solution cannot be refined: {reason}") from error
        if point is None:
            top = self.levels.resolutions[-2]
            raise BoundaryError(f"{name}: more than {top} intervals are needed for the tolerance; try a larger one")
        backwards = point.problem.backwards(point.z)
        if backwards:
            raise BoundaryError(f"{name}: {backwards}")
        estimate = point.error.relative(1.0)
        # Of an orbit that is one of a family the period is not known; states that are zero may have any relative error.
        if estimate > MEANINGLESS_ERROR or point.error.Omega > ROUND_OFF:
            self._check_alone(point, estimate <= MEANINGLESS_ERROR)
        if estimate > MEANINGLESS_ERROR:
            reason = rank_deficiency(point.problem, point.z) or "the equations are nearly singular there"
            words = f"rounding alone leaves an error of {estimate:.1e}"
            raise NotRefinedError(f"{name}: no solution near the guess: {words}; {reason}")
        return point

    def _check_alone(self, point: Point, refined: bool) -> None:
        """Raises FamilyError for an orbit of a family: its equations are singular, and more multipliers are 1.

        The equations alone do not tell: where an orbit passes an equilibrium that repels they are as good as singular.
        Multipliers without that of the velocity do not either: nothing is said then of an orbit that is not refined.
        """
        words = in_family(point.problem, point.z)
        if words and self.closure is not None:
            away = np.abs(self.multipliers_alone(point).multipliers - 1.0)
            own = 1 + sum(name.startswith(UNFOLDING) for name in self.statement.free)
            count = np.sum(away <= UNIT_MULTIPLIER_REACH)
            words = words if count > own or (refined and count < own) else ""
        if words:
            raise FamilyError(f"{self.statement.model.name}: {words}")

    # Values ---------------------------------------------------------------------------------------------------------

    @property
    def state_names(self) -> tuple[str, ...]:
        return self.statement.model.state_names

    def parameters(self, point: Point) -> dict[str, float]:
        problem = point.problem
        return dict(zip(self.statement.model.parameter_names, map(float, problem.parameters(point.z)), strict=True))

    def interval(self, point: Point) -> tuple[float, float]:
        """Start and end; of an orbit 0 and its period."""
        start, end = self.span(point)
        return (start, end) if self.periodic is None else (0.0, (end - start) / self.periodic.symmetry.value)

    def span(self, point: Point) -> tuple[float, float]:
        """Start and end of the part that is unknown."""
        return self.statement.span(point.problem.parameters(point.z))

    @of_last_points
    def jump(self, point: Point) -> str:
        """That the equations jump along a solution, with the equation; empty where they do not.

        A jump in time alone counts where no edge of the mesh is at it: between edges its error shows nowhere.
        """
        jumps, problem = self.model.jumps, stated(point.problem)
        if not jumps.found:
            return ""
        (start, end), values = self.span(point), self.parameters(point)  # added ones too
        model = jumps.model  # without parameters that are added to make its orbits isolated
        p = np.array([values[name] for name in model.parameter_names])

        def words(fractions: Array, by: int) -> str:
            states = problem.sample(point.z, fractions)[:, : model.full_size]
            return jumps.along(start + fractions * (end - start), states, p, by)

        places, edges = problem._fractions(), mesh.edges(problem.constants)
        at = np.arange(PER_STAGE * (places.size - 1) + 1) / PER_STAGE
        found = words(np.interp(at, np.arange(places.size), places), STATE)
        off = [t for t in jumps.times(start, end, p) if np.min(np.abs(edges - t)) > OFF_EDGE]
        moved = (words(np.array([t - OFF_EDGE, t + OFF_EDGE]), TIME) for t in off)
        return found or next((f"{w}, in time beside the edges of the mesh" for w in moved if w), "")

    def parameter_error(self, point: Point) -> float:
        """Estimated error of the parameter followed at a special point."""
        if point.error.parameter:
            size = float(point.problem.parameter_size(point.z))
            return point.error.parameter * size * abs(self.to - self.statement.values[self.parameter])
        return point.error.relative(point.Omega) * abs(self.value(self.parameter, point))

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the quantities that `target` accepts."""
        unknown = self.periodic is not None and PERIOD in self.statement.free
        return (self.parameter, "Omega", PERIOD) if unknown else (self.parameter,)

    @property
    def begins(self) -> float:
        """Value of the parameter followed at the start."""
        return self.statement.values[self.parameter]

    def value(self, name: str, point: Point) -> float:
        if name == self.parameter:
            return super().value(name, point)
        period = self.parameters(point)[PERIOD]
        return period if name == PERIOD else TWO_PI / period

    def frequency(self, orbit: Orbit) -> float:
        return TWO_PI / orbit.period

    def S_of(self, orbit: Orbit) -> float:
        """S of the positions at phase zero; raises NoQuantityError for a model without positions."""
        if not self.positions:
            raise NoQuantityError("S: an orbit of a model of first order has no amplitude of positions")
        return amplitude_square(self.given).value(orbit.evaluate(0.0)[: self.positions])

    @property
    def solution_class(self) -> type[Solution]:
        """Class of the solutions."""
        return Solution if self.periodic is None else Orbit

    # Orbits ---------------------------------------------------------------------------------------------------------

    @property
    def symmetry(self) -> SymmetryClass:
        """Which part of the period was unknown."""
        return self._orbit_of().symmetry

    @property
    def given(self) -> OdeModel:
        """The model as it was given, of first or second order."""
        return self._orbit_of().given

    @property
    def positions(self) -> int:
        """Number of positions of the model as it was given; 0 for one of first order."""
        return self.given.size if self.given.order == 2 else 0

    def states_at(self, point: Point, theta: Array, sites: Indices | None) -> Array:
        """States at phases, shape (len(theta), components)."""
        periodic = self._orbit_of()
        fractions, signs = unfolded_phases(periodic.model, periodic.symmetry, theta)
        states = signs * point.problem.sample(point.z, fractions)[:, : signs.shape[1]]
        if any(periodic.turns):
            states = states + periodic.rotated(theta)
        return np.asarray(states[:, numbered(sites, states.shape[1])])

    def reading(self, point: Point) -> tuple[float, Array, list[float]]:
        """Time, state and parameters of the model at the start of the interval, of an orbit at phase zero."""
        values, model, at_start = self.parameters(point), self.model, np.zeros(1)
        orbit = self.periodic is not None
        states = self.states_at(point, at_start, None) if orbit else point.problem.sample(point.z, at_start)
        p = [values[name] for name in model.parameter_names]
        return self.interval(point)[0], states[0][: model.full_size], p

    def energy(self, point: Point) -> float:
        """The conserved quantity at phase zero; raises ValueError where none is declared."""
        model = self._orbit_of().model
        if model.hamiltonian is None:
            raise NoQuantityError(f"energy: {model.name} declares no hamiltonian")
        return float(model.function("H", ca.densify(model.hamiltonian))(*self.reading(point)))

    def floquets(self, points: Sequence[Point], by: str | None = None) -> list[Floquet]:
        """Multipliers of orbits over the full period.

        Of a solution that its conditions close too. Raises ValueError for others and for an unknown flow, FlowError
        where CVODES fails.
        """
        name = str(self.method.flow) if by is None else by
        check_name("flow", name, FULL_PERIOD_FLOWS)
        for words in filter(None, map(self.jump, points)):
            raise JumpError(self.model, f"{words}, along the orbit, where linearised equations have no multipliers")
        if self.closure is not None and by not in (None, "collocation"):
            raise ValueError(f"flow: given {by!r} with a boundary-value problem; accepted: collocation")
        try:
            return [self._floquet(point, name) for point in points]
        except IntegrationError as error:
            raise FlowError(f"{error}{self._beyond_doubles(points)}") from error

    def _beyond_doubles(self, points: Sequence[Point]) -> str:
        """That sensitivities overflow along orbits with multipliers that no double holds, in words; empty elsewhere."""
        largest = max(float(np.max(self._floquet(p, "collocation").log10_abs_multipliers)) for p in points)
        if largest < LARGEST_LOGARITHM / math.log(10.0):
            return ""
        return f"; a multiplier of 1e{largest:+.0f} exceeds the largest double; accepted: by = 'collocation'"

    def shrinks(self, before: Point, after: Point) -> bool:
        """Whether an orbit with a free period passes through amplitude zero: its variation changes sign."""
        if self.periodic is None or PERIOD not in self.statement.free:
            return False
        one, other = map(self._variation, (before, after))
        return bool(np.sum(one * other) < -0.5 * np.linalg.norm(one) * np.linalg.norm(other))

    def amplitude(self, point: Point) -> float:
        """How far an orbit goes from its mean, in the sizes of its states."""
        return float(np.max(np.abs(self._variation(point))))

    def _variation(self, point: Point) -> Array:
        states = self.states_at(point, np.linspace(0.0, TWO_PI, 65)[:-1], None)
        sizes = self.sizes.states[: states.shape[1]]
        return np.asarray((states - states.mean(axis=0)) / np.where(sizes > 0.0, sizes, 1.0))

    @cached_property
    def closure(self) -> Closure | None:
        """How conditions close solutions that are not stated as orbits; None where they do not."""
        return closure_of(self.statement) if self.periodic is None else None

    @property
    def closes(self) -> bool:
        """Whether solutions are orbits, or are closed by their conditions, so that they have multipliers."""
        return self.periodic is not None or self.closure is not None

    def moves_freely(self, point: Point) -> bool:
        """Whether a solution that closes does so from any phase: its velocity has the multiplier 1."""
        if self.closure is not None:
            return Closed.by(self.closure, stated(point.problem), point.z).moves_freely
        return PERIOD in self.statement.free

    @of_last_points
    def _better(self, point: Point) -> Refinement | None:
        """The solution of a point on a finer mesh; None where the equations are singular there, or no mesh is finer."""
        problem, known = point.problem, point.better
        if known is not None and known.problem.resolution > problem.resolution:
            return known
        values = point.z[: stated(problem).states].reshape(stated(problem).columns, -1)
        if PERIOD in self.statement.free and (values == values[0]).all():  # at rest no equation has the period
            return None
        moves = problem.own_tangent is None and bool(np.any(point.tangent))
        try:
            return self.levels.better(problem, point.z, point.tangent if moves else None)
        except SingularError:
            return None

    def multipliers_alone(self, point: Point) -> Floquet:
        """Multipliers from the mesh of a point alone, without their errors."""
        return self._floquet(point, "collocation", with_errors=False)

    @of_last_points
    def multipliers_ahead(self, point: Point) -> Floquet:
        """The same one step along its tangent: stretches of curves on both sides of a point ask for its rates."""
        return self.multipliers_alone(beside_on_tangent(point, TANGENT_DIFFERENCE_STEP))

    def _floquet(self, point: Point, by: str, with_errors: bool = True) -> Floquet:
        better = self._better(point) if with_errors else None

        def closed(problem: BoundaryProblem, z: Array) -> Closed:
            if self.closure is not None:
                return Closed.by(self.closure, problem, z)
            periodic = self._orbit_of()
            return Closed(problem, z, periodic.model, periodic.symmetry)

        finer = None if better is None else closed(stated(better.problem), better.z)
        found = FULL_PERIOD_FLOWS[by](closed(stated(point.problem), point.z), finer, self.tolerance)
        kind, whole = kind_of(point.special), self.periodic is not None and self.symmetry is SymmetryClass.FULL
        if kind.of_orbits is None or not (with_errors and whole and self.has_ledger):
            return found
        turns = self.model.forced or PERIOD in self.statement.free  # or a fold is one at a period that is held
        angle = point.angle if kind.angle is None else kind.angle
        return found if angle is None or not turns else found.passing(angle)

    def floquet_vectors(self, point: Point, floquet: Floquet) -> ComplexArray:
        """Eigenvectors of the monodromy matrix in the order of the multipliers, largest entry 1."""
        return vectors_of(self.monodromy(point, floquet), floquet.multipliers)

    def monodromy(self, point: Point, floquet: Floquet) -> Array:
        """The matrix over the full period, of large systems formed for the purpose, shape (n, n)."""
        if floquet.monodromy is not None:
            return floquet.monodromy
        problem, n = stated(point.problem), self.model.full_size
        return Intervals.by_radau(problem, point.z, n, np.ones(n)).carried(np.eye(n))

    def _orbit_of(self) -> Periodic:
        if self.periodic is None:
            accepted = "accepted: an orbit, or conditions x(end) = S x(start)"
            words = f"a solution of a boundary-value problem that is no orbit has no stability; {accepted}"
            raise NoQuantityError(words)
        return self.periodic

    # The branch in one parameter --------------------------------------------------------------------------------------

    @property
    def has_ledger(self) -> bool:
        """Whether changes of stability are located between two solutions."""
        return not self.kind

    def special_between(self, before: Point, after: Point, gaps: list[Unresolved]) -> Iterator[Point]:
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
        reach = OFFSET_FROM_BRANCH_POINT * self._way(before, after) if crossed else 0.0
        for point in crossed:
            if first is not None and reach < (way := self._way(first, point)):
                left = self.point_solver.along(first, point, 1.0 - reach / way)
                yield from self._turns_between(first, left) if left is not None else ()
            yield point
            way = self._way(after, point)
            first = self.point_solver.along(point, after, reach / way) if reach < way else None
        if first is not None:
            yield from self._turns_between(first, after)
        if met is not None:
            yield met

    def singular_near(self, guess: Point) -> Point | None:
        """The solution near a guess at which branches cross: orbits there are sought by multipliers alone."""
        return special_orbit(self, BRANCH_POINT, guess)

    def _way(self, one: Point, other: Point) -> float:
        """How far a point is from another one."""
        return self.point_solver.distance(other.problem, one.problem.prolong(one.z, other.problem), other.z)

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
        parts = turning(self.point_solver, before, after)
        if unbounded is not None:
            yield from (self._fold_between(*part) for part in parts)
            yield unbounded
            return
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
        """The later of two orbits where the period grows without bound there and none is asked for."""
        walked_on = self.point_solver.settings.Omega_end is not None  # to a period that is asked for
        if self.periodic is None or PERIOD not in self.statement.free or walked_on:
            return None
        return unbounded(self, before, after)

    def stop(self, point: Point) -> tuple[End | None, str]:
        if point.special == HOPF:
            return End.HOPF, ""
        if point.special == BRANCH_POINT and self.left is not None:
            return End.REJOINED, ""
        if point.special == BOUND:
            return End.BOUND, f"{min(margins(self, point))[1]}, {point.problem.describe_parameters(point.z)}"
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

    def branch_space(
        self, solution: Solution, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings
    ) -> BoundarySpace:
        """The space of the branch through one of these solutions in a parameter."""
        statement = self.statement.with_parameters(**solution.parameters)
        return BoundarySpace(
            statement, self.tolerance, self.method, Sizes(solution.problem.floors, solution.problem.scalar_floors),
            self.periodic, parameter=parameter, to=to, at=at, first=solution.point, settings=settings,
        )  # fmt: skip
