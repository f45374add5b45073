"""What a branch connects: solutions of one kind, as the zeros F(z) = 0 of equations with one unknown more than rows.

A space has the equations by resolution (`levels`), the solver of points on them, the start, and how unknowns are read:
as parameters, as the interval, as a solution. The kinds differ in these and in the special points that they locate:

    family       orbits that grow from a linear mode, in S: `Family`
    orbits       periodic orbits in a parameter of the model: `BoundarySpace` with conditions of periodicity
    solutions    solutions of any other boundary-value problem in a parameter: `BoundarySpace`
    equilibria   states at rest in a parameter: `EquilibriumSpace`

Special points in a second parameter are spaces of the last three whose `kind` is that of the points. What a kind does
not state for itself is that of solutions without a period: they have no multipliers and no energy.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

from casadi_skin.follow.arclength import ArclengthContinuation
from casadi_skin.follow.point import PointSolver
from casadi_skin.model.result import NoQuantityError
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.problem import EPSILON, Scalar
from casadi_skin.zero.settings import Continuation, ContinuationSettings, End, Point, Target

if TYPE_CHECKING:
    from casadi_skin.follow.point import PointSolver
    from casadi_skin.solve.levels import Levels
    from casadi_skin.solve.newton import Correction
    from casadi_skin.stability.reduction import ComplexArray
    from casadi_skin.stability.result import Floquet
    from casadi_skin.zero.problem import Indices

FAMILY, ORBITS, SOLUTIONS, EQUILIBRIA = "family", "orbits", "solutions", "equilibria"
Followed: TypeAlias = Any  # a curve of special orbits: `points.curves.OrbitCurveSpace`
NO_ORBIT = "an equilibrium is no orbit: it has eigenvalues in place of multipliers, and no period"


class SolutionSpace:
    """Solutions of one kind that a branch connects.

    Attributes:
        connects: FAMILY, ORBITS, SOLUTIONS or EQUILIBRIA.
        kind: of special points that are followed in a second parameter; empty of others.
        start_is_limit: whether `start` is a limit of the solutions and none of them.
        locates_folds: whether special points are located while the branch is followed.
        parameter: name of the continuation parameter.
        to: value of `parameter` at which the branch ends.
        tolerance: relative error allowed in the solutions.
        model: the model that they belong to.
        levels, point_solver: discretisations from coarse to fine, and the solver of points on them.
        start: the first point.
        state_names, output_sites: names and numbers of the components in files and pictures.
        solution_class: class of the solutions.
    """

    kind: str = ""
    start_is_limit: bool = False
    locates_folds: bool = True

    if TYPE_CHECKING:  # fields of data or properties of each kind

        @property
        def connects(self) -> str: ...
        @property
        def parameter(self) -> str: ...
        @property
        def to(self) -> float: ...
        @property
        def tolerance(self) -> float: ...
        @property
        def model(self) -> Any: ...
        @property
        def levels(self) -> Levels: ...
        @property
        def point_solver(self) -> PointSolver: ...
        @property
        def start(self) -> Point: ...
        @property
        def state_names(self) -> tuple[str, ...]: ...
        @property
        def output_sites(self) -> Indices: ...
        @property
        def solution_class(self) -> Any: ...

    # What most kinds have in common -----------------------------------------------------------------------------------

    @property
    def is_family(self) -> bool:
        """Whether the solutions are a family of orbits that grows from a linear mode: a `Family`."""
        return self.connects == FAMILY

    @property
    def has_ledger(self) -> bool:
        """Whether changes of stability are located between two solutions, where stability is computed beside them."""
        return False

    @property
    def stability_included(self) -> bool:
        """Whether stability is computed with every solution, requested or not."""
        return False

    @property
    def stability_batch(self) -> int:
        """Number of points whose stability is best computed together."""
        return 1

    @property
    def closes(self) -> bool:
        """Whether solutions have a stability: all but those of boundary-value problems that do not close them."""
        return True

    @property
    def optimises(self) -> bool:
        """Whether solutions have an objective, so that they are not followed."""
        return False

    @property
    def free(self) -> Sequence[str]:
        """Names of parameters that are solved for with the state."""
        return ()

    @property
    def S_rate(self) -> float:
        """The relative change of S per that of the free parameter."""
        return 1.0

    def continuation(self, history: tuple[Point, ...], reported: tuple[Point, ...] = ()) -> Continuation:
        """The continuation from its last points, the start among them, and from points reported after these."""
        return ArclengthContinuation(self.point_solver, history, reported)

    def stop(self, point: Point) -> tuple[End | None, str]:
        """End of a branch at a point, with the reason in words; None where it goes on."""
        return None, ""

    def special_between(self, before: Point, after: Point) -> Iterator[Point | Unresolved]:
        """Special points between two points in order, each marked by its kind, and parts where some may be missing.

        None are sought unless a kind says otherwise. Raises NotLocatedError.
        """
        yield from ()

    def singular_near(self, guess: Point) -> Point | None:
        """The branch point near a guess that `special_between` does not find; None where there is none."""
        return None

    # The continuation parameter as u from 0, at the start, to 1 -------------------------------------------------------

    @property
    def at(self) -> Sequence[float]:
        """Values of the continuation parameter at which solutions are wanted."""
        return ()

    @property
    def begins(self) -> float:
        """Value of the continuation parameter at the start."""
        raise NotImplementedError

    def fraction(self, value: float) -> float:
        """The u of a value of the continuation parameter."""
        return (value - self.begins) / (self.to - self.begins)

    @property
    def held_names(self) -> tuple[str, ...]:
        """Names of the quantities that `target` accepts."""
        return (self.parameter,)

    def target(self, name: str, value: float) -> Target:
        """Condition that a quantity has a value; raises ValueError for quantities that cannot be held."""
        if name != self.parameter or not name:
            raise ValueError(f"at: given {name}; accepted: {', '.join(self.held_names)}")
        return Target(Scalar.PARAMETER, self.fraction(value))

    def requested_values(self) -> Mapping[str, Sequence[float]]:
        """Values at which solutions are wanted, by the name of the quantity."""
        return {self.parameter: self.at}

    def value(self, name: str, point: Point) -> float:
        """A quantity that can be held at a point; exactly the requested value at a requested point."""
        requested = {self.fraction(value): value for value in (*self.at, self.to)}
        u = point.parameter
        return requested[u] if u in requested else float(self.parameters(point)[name])

    # Values -----------------------------------------------------------------------------------------------------------

    def parameters(self, point: Point) -> dict[str, float]:
        """Values of all parameters by name."""
        raise NotImplementedError

    def interval(self, point: Point) -> tuple[float, float]:
        """Start and end of the interval, or the period from phase zero."""
        return 0.0, 0.0

    def span(self, point: Point) -> tuple[float, float]:
        """Start and end of the part of the interval that is unknown."""
        return self.interval(point)

    def parameter_error(self, point: Point) -> float:
        """Estimated absolute error of the continuation parameter at a special point."""
        raise NotImplementedError

    def solution(self, point: Point, floquet: Floquet | None = None, exact: Mapping[str, float] | None = None) -> Any:
        """The solution of a point, with its stability where that is known and values that it has exactly."""
        if exact is None:
            exact = {self.parameter: self.value(self.parameter, point)} if self.parameter else {}
        return self.solution_class(self, point, exact, known_floquet=floquet)

    def energy(self, point: Point) -> float:
        """The conserved quantity of an orbit; raises NoQuantityError where the model declares none."""
        raise NoQuantityError(NO_ORBIT)

    def floquets(self, points: Sequence[Point], by: str | None = None) -> list[Floquet]:
        """Stability of several points; raises FlowError, and ValueError where the solutions are no orbits."""
        raise NoQuantityError(NO_ORBIT)

    def floquet_vectors(self, point: Point, floquet: Floquet) -> ComplexArray:
        """Floquet vectors at phase zero, one a column in the order of the multipliers."""
        raise NoQuantityError(NO_ORBIT)

    def following(
        self, solution: Any, parameter: str, to: float, at: tuple[float, ...], settings: ContinuationSettings
    ) -> SolutionSpace:
        """The space of the branch through one of the solutions in a parameter; raises ValueError without one."""
        raise ValueError(f"follow: given one of a {self.connects}; accepted: an orbit that was restated")


@dataclass(frozen=True, eq=False)
class ParameterSpace(SolutionSpace):
    """Solutions of a model that are followed in one of its parameters.

    Attributes:
        parameter: the parameter that is followed, from its value to `to`; empty where none is.
        at: values of it at which solutions are wanted.
        first: the start of the branch.
        settings: of the continuation.
        leaves: whether `first` is a special point that the branch leaves along the tangent of `first`.
    """

    _: KW_ONLY
    parameter: str = ""
    to: float = 1.0
    at: tuple[float, ...] = ()
    first: Point | None = None
    settings: ContinuationSettings | None = None
    leaves: bool = False
    error: ClassVar[type[ArithmeticError]] = ArithmeticError

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
        problem = self.problem_at(first)
        z = first.z.copy()
        z[-1] = 0.0
        correction = self.levels.corrector(problem).correct(z, problem.parameter_row(), 0.0)
        if not correction.converged:
            raise self.error(f"the start of the branch: {correction.status.value}; {problem.worst(correction.z)}")
        return replace(self.refined(problem, correction), step=step)

    def problem_at(self, first: Point) -> Any:
        """The equations in which the start of a branch is solved again."""
        return self.levels.problem(first.problem.resolution).with_constants(first.problem.constants)

    def refined(self, problem: Any, correction: Correction) -> Point:
        """The solution of a correction with u held, at the tolerance; raises `error` where it is not regular."""
        raise NotImplementedError


REQUESTED_VALUE_RTOL = 4.0 * EPSILON  # relative difference of a value that is the requested one


def target_of(space: SolutionSpace, special: Point) -> Target | None:
    """The target whose value a special point has within its error; None where there is none."""
    settings, name = space.point_solver.settings, space.parameter
    value, error = space.parameters(special)[name], space.parameter_error(special)
    for target in (*settings.at, *settings.ends):
        if target.held is Scalar.PARAMETER:
            wanted = space.value(name, snapped(special, target))
            if abs(value - wanted) <= max(error, REQUESTED_VALUE_RTOL * abs(wanted)):
                return target
    return None


def snapped(special: Point, target: Target, requested: bool = False) -> Point:
    """A special point with its value exactly the one that it has within its error."""
    z = special.z.copy()
    z[special.problem.parameter_index] = target.value
    return replace(special, z=z, requested=requested)
