"""What a branch connects: solutions of one kind, as the zeros F(z) = 0 of equations with one unknown more than rows.

A space has the equations by resolution (`levels`), the solver of points on them, the start, and how unknowns are read:
as parameters, as the interval, as a solution. The kinds differ in these and in the special points that they locate:

    family       orbits that grow from a linear mode, in S: `Family`
    orbits       periodic orbits in a parameter of the model: `BoundarySpace` with conditions of periodicity
    solutions    solutions of any other boundary-value problem in a parameter: `BoundarySpace`
    equilibria   states at rest in a parameter: `EquilibriumSpace`

Special points in a second parameter are spaces of the last three whose `kind` is that of the points.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property, wraps
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias, TypeVar

import numpy as np

from casadi_skin.follow.arclength import ArclengthContinuation, Continuation
from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.search import BranchStretch, Monitor
from casadi_skin.model.result import NoQuantityError
from casadi_skin.solve.ipopt import CORRECTORS
from casadi_skin.solve.newton import Correction, Corrector, RoundedCorrector
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.family import TWO_PI
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.problem import EPSILON, Array, Indices, Problem, Scalar
from casadi_skin.zero.settings import ContinuationSettings, End, Point, Target
from casadi_skin.zero.stated_problem import stated

T = TypeVar("T")
FAMILY, ORBITS, SOLUTIONS, EQUILIBRIA = "family", "orbits", "solutions", "equilibria"
Followed: TypeAlias = Any  # a curve of special orbits: `points.curves.OrbitCurveSpace`
KEPT_POINTS = 8  # points of which what is computed is kept


class BoundaryError(ArithmeticError):
    """No solution was found: the message names condition, variable and place in one line."""


class FamilyError(BoundaryError):
    """An orbit is one of a family: the model conserves something that is not declared."""


class NotRefinedError(BoundaryError):
    """What one mesh has for a solution is none on finer meshes."""


class EquilibriumError(ArithmeticError):
    """No equilibrium was found: the message names the equation and the place in one line."""


def of_last_points(compute: Callable[[Any, Point], T]) -> Callable[[Any, Point], T]:
    """A method of a space with a point, computed once for each of the last few points."""

    @wraps(compute)
    def known(space: Any, point: Point) -> T:
        kept = vars(space).setdefault(f"_{compute.__name__}_of", deque(maxlen=KEPT_POINTS))
        for other, value in kept:
            if other is point:
                return value  # type: ignore[no-any-return]
        found = compute(space, point)
        kept.append((point, found))
        return found

    return known


def corrector_of(name: str, tolerance: float, problem: Problem) -> Corrector:
    """A corrector of equilibria by name, for a hundredth of the tolerance where rounding allows it."""
    fine = float(np.clip(1e-2 * tolerance, 1e-13, 1e-6))
    return RoundedCorrector(CORRECTORS[name](problem, fine, MOST_ITERATIONS))


MOST_ITERATIONS = 60  # of a corrector of equilibria


class SolutionSpace:
    """Solutions of one kind that a branch connects.

    Attributes:
        connects: FAMILY, ORBITS, SOLUTIONS or EQUILIBRIA.
        kind: of special points that are followed in a second parameter; empty of others.
        start_is_limit: whether `start` is a limit of the solutions and none of them.
        locates_folds: whether special points are located while the branch is followed.
        has_ledger: whether changes of stability are located between two solutions with stability.
        stability_included: whether stability is computed with every solution, requested or not.
        stability_batch: number of points whose stability is best computed together.
        closes: whether solutions have a stability: all but those of problems whose conditions do not close them.
        optimises: whether solutions have an objective, so that they are not followed.
        free: names of parameters that are solved for with the state.
        S_rate: the relative change of S per that of the free parameter.
        parameter, begins, to: name of the continuation parameter, with its values at the start and the end.
        at: values of it at which solutions are wanted.
        monitors: quantities whose zeros are special points by their names.
        reading: function of a point: time, state and parameters of the model that monitors are functions of.
        tolerance: relative error allowed in the solutions.
        model: the model that they belong to.
        levels, point_solver: discretisations from coarse to fine, and the solver of points on them.
        start: the first point.
        state_names, output_sites: names and numbers of the components in files and pictures.
        solution_class: class of the solutions.
        parameters: function of a point: values of all parameters by name.
        parameter_error: likewise, the estimated absolute error of the continuation parameter at a special point.
        frequency, S_of: functions of an orbit: Omega and S, whatever parameters of the model are called.
    """

    if TYPE_CHECKING:  # fields or properties of each kind

        def __getattr__(self, name: str) -> Any: ...
    else:
        kind, start_is_limit, locates_folds, has_ledger, stability_included = "", False, True, False, False
        stability_batch, closes, optimises, free, S_rate, at, monitors = 1, True, False, (), 1.0, (), ()

    @property
    def is_family(self) -> bool:
        """Whether the solutions are a family of orbits that grows from a linear mode: a `Family`."""
        return bool(self.connects == FAMILY)

    def is_critical(self, kind: str) -> bool:
        """Whether points of a kind are special by their linearisation; zeros of monitors are not."""
        return bool(kind) and kind not in {monitor.name for monitor in self.monitors}

    def continuation(self, history: tuple[Point, ...], reported: tuple[Point, ...] = ()) -> Continuation:
        """The continuation from its last points, the start among them, and from points reported after these."""
        return ArclengthContinuation(self.point_solver, history, reported)

    def stop(self, point: Point) -> tuple[End | None, str]:
        """End of a branch at a point, with the reason in words; None where it goes on."""
        return None, ""

    def special_between(self, before: Point, after: Point, gaps: list[Unresolved]) -> Iterator[Point]:
        """Special points between two points in order, each marked by its kind.

        `gaps` gets the parts where some may be missing. None are sought unless a kind says otherwise. Raises
        NotLocatedError.
        """
        yield from ()

    def is_unclear(self, start: Point, reach: float) -> bool:
        """Whether a start is special, or what is so may be behind it by rounding, or by a distance within `reach`."""
        return False

    def unproved(self) -> list[Unresolved]:
        """The part at the end of a branch of which it is not proved that no special point is missing."""
        return []

    def singular_near(self, guess: Point) -> Point | None:
        """The branch point near a guess that `special_between` does not find; None where there is none."""
        return None

    # The continuation parameter as u from 0, at the start, to 1 -------------------------------------------------------

    def fraction(self, value: float) -> float:
        """The u of a value of the continuation parameter."""
        return float((value - self.begins) / (self.to - self.begins))

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the quantities that `target` accepts."""
        return (self.parameter,)

    def target(self, name: str, value: float) -> Target:
        """Condition that a quantity has a value; raises ValueError for quantities that cannot be held."""
        if not name or name not in self.held_names:
            raise ValueError(f"at: given {name}; accepted: {', '.join(self.held_names)}")
        if name == self.parameter:
            return Target(Scalar.PARAMETER, self.fraction(value))
        if not 0 < value < math.inf:
            raise ValueError(f"at: given {name} = {value!r}; accepted: a finite number > 0")
        return Target(Scalar.OMEGA, value if name == "Omega" else TWO_PI / value)

    def requested_values(self) -> Mapping[str, Sequence[float]]:
        """Values at which solutions are wanted, by the name of the quantity."""
        return {self.parameter: self.at}

    def value(self, name: str, point: Point) -> float:
        """A quantity that can be held at a point; exactly the requested value at a requested point."""
        requested = {self.fraction(value): value for value in (*self.at, self.to)}
        u = point.parameter
        return float(requested[u] if u in requested else self.parameters(point)[name])

    # Monitors ---------------------------------------------------------------------------------------------------------

    @of_last_points
    def monitor_values(self, point: Point) -> Array:
        """Values of the monitors, shape (monitors,)."""
        reading = self.reading(point)
        return np.array([monitor.value(reading) for monitor in self.monitors])

    @of_last_points
    def monitor_errors(self, point: Point) -> Array:
        """Their errors."""
        reading = self.reading(point)
        return np.array([monitor.error(reading, point.error.profile, self.to) for monitor in self.monitors])

    # Solutions --------------------------------------------------------------------------------------------------------

    def interval(self, point: Point) -> tuple[float, float]:
        """Start and end of the interval, or the period from phase zero."""
        return 0.0, 0.0

    def span(self, point: Point) -> tuple[float, float]:
        """Start and end of the part of the interval that is unknown."""
        return self.interval(point)

    def times(self, point: Point) -> Array:
        """Times of the unknowns of a solution."""
        start, end = self.span(point)
        return np.asarray(start + collocation_of(point)._fractions() * (end - start))

    def states(self, point: Point) -> Array:
        """States at `times`, shape (time, component)."""
        problem = stated(point.problem)
        values = point.z[: problem.states].reshape(problem.columns, -1)
        return np.array(values[:, : len(self.state_names)])

    def free_error(self, point: Point) -> float:
        """Estimated relative error of what is solved for with the states: free parameters, of a family Omega."""
        return float(point.error.Omega) if self.free else 0.0

    def solution(self, point: Point, floquet: Floquet | None = None, exact: Mapping[str, float] | None = None) -> Any:
        """The solution of a point, with its stability where that is known and values that it has exactly."""
        if exact is None:
            exact = {self.parameter: self.value(self.parameter, point)} if self.parameter else {}
        return self.solution_class(self, point, exact, known_floquet=floquet)


@dataclass(frozen=True, eq=False)
class ParameterSpace(SolutionSpace):
    """Solutions of a model that are followed in one of its parameters.

    Attributes:
        parameter: the parameter that is followed, from its value to `to`; empty where none is.
        at: values of it at which solutions are wanted.
        first: the start of the branch.
        settings: of the continuation.
        leaves: whether `first` is a special point that the branch leaves along the tangent of `first`.
        monitors: whose zeros are special points by their names.
    """

    _: KW_ONLY
    parameter: str = ""
    to: float = 1.0
    at: tuple[float, ...] = ()
    first: Point | None = None
    settings: ContinuationSettings | None = None
    leaves: bool = False
    monitors: tuple[Monitor, ...] = ()
    error: ClassVar[type[ArithmeticError]] = ArithmeticError

    @property
    def output_sites(self) -> Indices:
        """Numbers of the components of the state, from 1."""
        return np.arange(1, len(self.state_names) + 1)

    @cached_property
    def point_solver(self) -> PointSolver:
        """The solver of points at the tolerance."""
        return PointSolver(self.levels, self.settings or ContinuationSettings(1.0, self.tolerance))

    @cached_property
    def start(self) -> Point:
        """The first solution as a point of the branch; raises `error` where it cannot be solved again."""
        first, step = self.first, self.point_solver.settings.first_step
        assert first is not None
        if self.leaves:
            return replace(first, step=step)
        problem, z = self.problem_at(first), np.append(first.z[:-1], 0.0)
        correction = self.levels.corrector(problem).correct(z, problem.parameter_row(), 0.0)
        if not correction.converged:
            words = f"{correction.status.value}; {problem.describe_largest_residual(correction.z)}"
            raise self.error(f"the start of the branch: {words}")
        return replace(self.refined(problem, correction), step=step)

    def problem_at(self, first: Point) -> Any:
        """The equations in which the start of a branch is solved again."""
        return self.levels.problem(first.problem.resolution).with_constants(first.problem.constants)

    def refined(self, problem: Any, correction: Correction) -> Point:
        """The solution of a correction with u held, at the tolerance; raises `error` where it is not regular."""
        raise NotImplementedError


def collocation_of(point: Point) -> CollocationEquations:
    """The equations of a solution by collocation; raises NoQuantityError for others."""
    if not isinstance(point.problem, CollocationEquations):
        raise NoQuantityError("mesh: the solution is not one of collocation; accepted: evaluate(t)")
    return point.problem


REQUESTED_VALUE_RTOL = 4.0 * EPSILON  # relative difference of a value that is the requested one


def target_of(space: SolutionSpace, special: Point) -> Target | None:
    """The target whose value a special point has within its error; None where there is none."""
    settings, name = space.point_solver.settings, space.parameter
    for target in (*settings.at, *settings.ends):
        if target.held is Scalar.PARAMETER and has_value(space, special, space.value(name, snapped(special, target))):
            return target  # type: ignore[no-any-return]
    return None


def has_value(space: SolutionSpace, special: Point, value: float) -> bool:
    """Whether a special point has a value of the continuation parameter within its error."""
    off = abs(space.parameters(special)[space.parameter] - value)
    return bool(off <= max(space.parameter_error(special), REQUESTED_VALUE_RTOL * abs(value)))


def precedes(space: SolutionSpace, stretch: BranchStretch, special: Point) -> bool:
    """Whether a special point is before the first stretch of a branch, by more than its error."""
    return stretch.sigma(special) < 0.0 and not has_value(space, special, space.begins)


def snapped(special: Point, target: Target, requested: bool = False) -> Point:
    """A special point with its value exactly the one that it has within its error."""
    z = special.z.copy()
    z[special.problem.parameter_index] = target.value
    return replace(special, z=z, requested=requested)
