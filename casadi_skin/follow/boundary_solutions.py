"""Solutions of one boundary-value problem, orbits among them: how unknowns are read, and multipliers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import ClassVar, Protocol

import casadi as ca
import numpy as np

from casadi_skin.follow.solution import Orbit, Solution
from casadi_skin.follow.space import ORBITS, SOLUTIONS, ParameterSpace
from casadi_skin.model.arguments import check_name
from casadi_skin.model.conserved import SymmetryClass, unfolded_phases
from casadi_skin.model.integrators import IntegrationError
from casadi_skin.model.jumps import STATE, TIME, JumpError
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import NoQuantityError
from casadi_skin.solve.ipopt import CORRECTORS, ArbitratedCorrector
from casadi_skin.solve.levels import Levels
from casadi_skin.solve.newton import Correction, Corrector, RoundedCorrector, in_family, rank_deficiency
from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.full_period import FULL_PERIOD_FLOWS, Closed, Returned
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import LARGEST_LOGARITHM, Floquet
from casadi_skin.zero import mesh
from casadi_skin.zero.augmented import Singularity, SingularProblem
from casadi_skin.zero.butcher import TABLES
from casadi_skin.zero.closure import Closure, closure_of
from casadi_skin.zero.family import TWO_PI, Method, numbered
from casadi_skin.zero.orbit import FIRST_INTERVALS, Periodic, Sizes
from casadi_skin.zero.problem import Array, Indices, Problem, Scalar, SingularError
from casadi_skin.zero.settings import Point, Refinement, Target
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem, stated
from casadi_skin.zero.statement import Statement

MESH_INTERVALS = (5, 8, 12, 18, 27, 40, 60, 90, 135, 200, 300, 450, 675, 1000, 1500, 2250)
OFF_EDGE = 1e-10  # of the interval: distance of a jump in time from an edge of the mesh that counts
PER_STAGE = 2  # places a stage at which a solution is looked at for jumps
MEANINGLESS_ERROR = 1e-2  # estimated error beyond which a solution is no solution, rounding or not
MOST_IPOPT_ITERATIONS = 100  # of Ipopt: a guess of a boundary-value problem may be far away


class BoundaryError(ArithmeticError):
    """No solution was found: the message names condition, variable and place in one line."""


class FamilyError(BoundaryError):
    """An orbit is one of a family: the model conserves something that is not declared."""


class ParentBranch(Protocol):
    """The branch that a branch of orbits has left."""

    def rejoined(self, own: BoundarySolutions, before: Point, after: Point) -> Point | None:
        """The orbit of the parent between two of the branch; None where there is none."""


@dataclass(frozen=True, eq=False)
class BoundarySolutions(ParameterSpace):
    """Solutions of a statement by their unknowns.

    Attributes:
        statement: the problem; values of its parameters are those at the start of a branch.
        tolerance: relative error of states and free parameters.
        method: how, with every choice made.
        sizes: least sizes by which states and free parameters are measured.
        periodic: conditions that make the solutions orbits; None where they are none.
        left: the orbits that it left there, where it may come back to them.
        singularity: of special solutions alone, what makes them special.
    """

    statement: Statement
    tolerance: float
    method: Method
    sizes: Sizes
    periodic: Periodic | None = None
    left: ParentBranch | None = None
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
        """The corrector, for a hundredth of the tolerance where rounding allows it; every orbit is put to Ipopt.

        Special solutions are solved further: their null vectors, of which points of codimension two are made, are not.
        """
        part = 1e-2 if self.singularity is None else 1e-3
        tolerance = float(np.clip(part * self.tolerance, 1e-12, 1e-6))
        name = self.method.corrector
        make = CORRECTORS[name]
        if name == "ipopt":
            make = partial(ArbitratedCorrector, always=self.statement.always_confirmed, far=True)
        return RoundedCorrector(make(problem, tolerance, MOST_IPOPT_ITERATIONS))

    @cached_property
    def levels(self) -> Levels:
        """Discretisations from coarse to fine; the scalar u is held, or follows the parameter."""
        walking, special = self.parameter or None, self.singularity
        if special is None:
            formulation = self.statement.formulation(walking)
        else:
            formulation = special.formulation(self.statement, walking)
        table = TABLES[str(self.method.transcription)](self.method.degree)
        sizes = self.sizes

        def build(intervals: int) -> Problem:
            given = self.statement, formulation, intervals, table, sizes.states, sizes.scalars, walking, self.to
            return BoundaryProblem(*given) if special is None else SingularProblem(special, *given)

        return Levels(
            build, self._corrector, tuple(sorted({*MESH_INTERVALS, int(self.method.intervals or FIRST_INTERVALS)}))
        )

    def refined(self, problem: BoundaryProblem, correction: Correction) -> Point:
        """The solution of a correction on a mesh that meets the tolerance, with u held; raises BoundaryError."""
        name = problem.statement.model.name
        try:
            point = self.point_solver.refined(problem, correction, problem.parameter_row(), Scalar.PARAMETER)
        except SingularError as error:
            family = in_family(problem, correction.z)
            if family:
                raise FamilyError(f"{name}: {family}") from error
            reason = rank_deficiency(problem, correction.z) or str(error)
            raise BoundaryError(f"{name}: the solution cannot be refined: {reason}") from error
        if point is None:
            top = self.levels.resolutions[-2]
            raise BoundaryError(f"{name}: more than {top} intervals are needed for the tolerance; try a larger one")
        backwards = point.problem.backwards(point.z)
        if backwards:
            raise BoundaryError(f"{name}: {backwards}")
        if point.error.relative(1.0) > MEANINGLESS_ERROR:
            family = in_family(point.problem, point.z)
            if family:
                raise FamilyError(f"{name}: {family}")
            reason = rank_deficiency(point.problem, point.z) or "the equations are nearly singular there"
            words = f"rounding alone leaves an error of {point.error.relative(1.0):.1e}"
            raise BoundaryError(f"{name}: no solution near the guess: {words}; {reason}")
        return point

    # Values ---------------------------------------------------------------------------------------------------------

    @property
    def state_names(self) -> tuple[str, ...]:
        return self.statement.model.state_names

    @property
    def output_sites(self) -> Indices:
        """Numbers of the states, from 1."""
        return np.arange(1, len(self.state_names) + 1)

    def parameters(self, point: Point) -> dict[str, float]:
        problem = point.problem
        return dict(zip(self.statement.model.parameter_names, map(float, problem.parameters(point.z)), strict=True))

    def interval(self, point: Point) -> tuple[float, float]:
        """Start and end; of an orbit 0 and its period."""
        start, end = self.span(point)
        return (start, end) if self.periodic is None else (0.0, (end - start) / self.periodic.symmetry.value)

    def span(self, point: Point) -> tuple[float, float]:
        """Start and end of the part that is unknown."""
        return self.statement.span(self.parameters(point).values())

    def jump(self, point: Point) -> str:
        """That the equations jump along a solution, with the equation; empty where they do not.

        A jump in time alone counts where no edge of the mesh is at it: between edges its error shows nowhere.
        """
        jumps, problem = self.model.jumps, stated(point.problem)
        if not jumps.found:
            return ""
        (start, end), values = self.span(point), BoundarySolutions.parameters(self, point)  # added ones too
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

    def target(self, name: str, value: float) -> Target:
        """Condition that the continuation parameter, or an unknown period or frequency, has a value."""
        if name == self.parameter or name not in self.held_names:
            return super().target(name, value)
        if not 0 < value < math.inf:
            raise ValueError(f"at: given {name} = {value!r}; accepted: a finite number > 0")
        return Target(Scalar.OMEGA, value if name == "Omega" else TWO_PI / value)

    @property
    def begins(self) -> float:
        """Value of the parameter followed at the start."""
        return self.statement.values[self.parameter]

    def value(self, name: str, point: Point) -> float:
        if name == self.parameter:
            return super().value(name, point)
        period = self.parameters(point)[PERIOD]
        return period if name == PERIOD else TWO_PI / period

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

    def energy(self, point: Point) -> float:
        """The conserved quantity at phase zero; raises ValueError where none is declared."""
        model = self._orbit_of().model
        if model.hamiltonian is None:
            raise NoQuantityError(f"energy: {model.name} declares no hamiltonian")
        values = self.parameters(point)
        p = [values[name] for name in model.parameter_names]
        start = self.states_at(point, np.zeros(1), None)[0]
        return float(model.function("H", ca.densify(model.hamiltonian))(0.0, start, p))

    def floquets(self, points: Sequence[Point], by: str | None = None) -> list[Floquet]:
        """Multipliers of orbits over the full period.

        Of a solution that its conditions close too. Raises ValueError for others and for an unknown flow, FlowError
        where CVODES fails.
        """
        name = str(self.method.flow) if by is None else by
        check_name("by", name, FULL_PERIOD_FLOWS)
        for words in filter(None, map(self.jump, points)):
            raise JumpError(
                self.model.name, f"{words}, along the orbit, where linearised equations have no multipliers"
            )
        if self.closure is not None and by not in (None, "collocation"):
            raise ValueError(f"by: given {by!r} with a boundary-value problem; accepted: collocation")
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
        varying = [point.problem.sample(point.z, np.linspace(0.0, 1.0, 65)[:-1]) for point in (before, after)]
        sizes = np.where(self.sizes.states > 0.0, self.sizes.states, 1.0)
        one, other = ((x - x.mean(axis=0)) / sizes for x in varying)
        return bool(np.sum(one * other) < -0.5 * np.linalg.norm(one) * np.linalg.norm(other))

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
            return Returned(stated(point.problem), point.z, self.closure).moves_freely
        return PERIOD in self.statement.free

    def _better(self, point: Point) -> Refinement | None:
        """The solution of a point on a finer mesh; None where the equations are singular there, or no mesh is finer."""
        problem, known = point.problem, point.better
        if known is not None and known.problem.resolution > problem.resolution:
            return known
        moves = problem.own_tangent is None and bool(np.any(point.tangent))
        try:
            return self.levels.refined(problem, point.z, point.tangent if moves else None)[1]
        except SingularError:
            return None

    def multipliers_alone(self, point: Point) -> Floquet:
        """Multipliers from the mesh of a point alone, without their errors."""
        return self._floquet(point, "collocation", with_errors=False)

    def _floquet(self, point: Point, by: str, with_errors: bool = True) -> Floquet:
        better = self._better(point) if with_errors else None

        def closed(problem: BoundaryProblem, z: Array) -> Closed | Returned:
            if self.closure is not None:
                return Returned(problem, z, self.closure)
            periodic, period = self._orbit_of(), self.interval(replace(point, problem=problem, z=z))[1]
            return Closed(problem, z, periodic.model, periodic.symmetry, period)

        finer = None if better is None else closed(stated(better.problem), better.z)
        found: Floquet = FULL_PERIOD_FLOWS[by](closed(stated(point.problem), point.z), finer, self.tolerance)
        return found

    def floquet_vectors(self, point: Point, floquet: Floquet) -> ComplexArray:
        """Eigenvectors of the monodromy matrix in the order of the multipliers, largest entry 1."""
        from scipy.optimize import linear_sum_assignment

        values, vectors = np.linalg.eig(np.asarray(floquet.monodromy).astype(complex))
        _, order = linear_sum_assignment(np.abs(floquet.multipliers[:, None] - values))
        vectors = vectors[:, order]
        return np.asarray(vectors / np.max(np.abs(vectors), axis=0))

    def _orbit_of(self) -> Periodic:
        if self.periodic is None:
            accepted = "accepted: an orbit, or conditions x(end) = S x(start)"
            words = f"a solution of a boundary-value problem that is no orbit has no stability; {accepted}"
            raise NoQuantityError(words)
        return self.periodic
