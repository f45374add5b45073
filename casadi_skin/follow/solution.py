"""A solution of a boundary-value problem, with its errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.space import SolutionSpace
from casadi_skin.model.expressions import at_instants, instants
from casadi_skin.model.ode import OdeModel, centred_model
from casadi_skin.model.result import NoQuantityError, Result
from casadi_skin.stability.result import Floquet
from casadi_skin.zero import mesh
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_problem import AlgebraicProblem
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import BoundaryProblem, stated
from casadi_skin.zero.statement import Statement
from casadi_skin.zero.statics import ComplexArray, Spectrum

# The objective of a boundary-value problem at its solution, and how well the optimality conditions hold ---------------


@dataclass(frozen=True)
class Optimality:
    """The Karush-Kuhn-Tucker conditions of a solution, evaluated apart from the solver.

    `kkt` is the largest of stationarity and complementarity relative to the largest gradient or multiplier, `violation`
    that of equations and bounds, and `active` are the bounds with a multiplier, in words. `curved` is true where the
    curvature is that of a minimum; it is not known where the model holds a program, such as an FMU.
    """

    kkt: float
    violation: float
    active: tuple[str, ...]
    curved: bool

    def holds_states(self, names: Sequence[str]) -> bool:
        """Whether bounds on any of the states named are active."""
        return any(words.split()[0] in names for words in self.active)


@dataclass(frozen=True)
class Optimum:
    """The smallest value of the objective, with its estimated error, and the optimality conditions there."""

    objective: float
    objective_error: float
    optimality: Optimality


PARAMETERS_SHOWN = 6  # parameters in a line


@dataclass(frozen=True, eq=False)
class Solution(Result):
    """States over the interval and values of all parameters, with estimated errors.

    Attributes:
        space: the solution space: equations and discretisations.
        point: its unknowns, in the discretisation that meets the tolerance.
        exact: requested values at this solution, by name, which its unknowns may meet only to round-off.
        optimum: the objective, and the optimality conditions; None without an objective.
        found_by: the method, where the first one failed: "Newton's method", or the continuation in a parameter.
        known_floquet: its stability if computed before: in a run that is resumed, or with its neighbours.
    """

    space: SolutionSpace
    point: Point
    exact: Mapping[str, float] = field(default_factory=dict)
    optimum: Optimum | None = None
    known_floquet: Floquet | None = None
    found_by: str = ""

    def __repr__(self) -> str:
        values = "".join(f", {name} = {value:.6g}" for name, value in list(self.parameters.items())[:PARAMETERS_SHOWN])
        name = getattr(self.model, "name", None) or repr(self.model)
        return f"<{type(self).__name__} of {name}{values}; error {self.error:.1e}>"

    @property
    def model(self) -> Any:
        """The model of the solution."""
        return self.space.model

    @cached_property
    def parameters(self) -> dict[str, float]:
        """All parameters by name."""
        values = self.space.parameters(self.point)
        return values | {name: value for name, value in self.exact.items() if name in values}

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Start and end."""
        return self.space.interval(self.point)

    def evaluate(self, t: ArrayLike) -> Array:
        """States at times in the interval, shape (time, component), or at one, shape (component,).

        Raises ValueError for other times, TypeError for values that are not numbers.
        """
        times = instants(t)
        start, end = self.interval
        slack = 1e-9 * (end - start)
        if not np.all((times >= start - slack) & (times <= end + slack)):
            raise ValueError(f"t: given {times.min():g} to {times.max():g}; accepted: {start:g} to {end:g}")
        states = self.point.problem.sample(self.point.z, np.clip((times - start) / (end - start), 0.0, 1.0))
        return at_instants(t, states[:, : len(self.space.state_names)])

    def __getitem__(self, name: str) -> float | Array:
        """The value of a parameter, or the values of a state at `t`; raises KeyError for other names."""
        names = self.space.state_names
        if name in self.parameters:
            return self.parameters[name]
        if name not in names:
            raise KeyError(f"{name}; known: {', '.join((*names, *self.parameters))}")
        return self.states[:, names.index(name)]

    def value(self, name: str) -> float:
        """A quantity that the branch can be corrected at; exactly the requested value at a requested solution."""
        return self.exact[name] if name in self.exact else self.space.value(name, self.point)

    # The discretisation -----------------------------------------------------------------------------------------------

    @property
    def problem(self) -> BoundaryProblem:
        """The stated equations on their mesh; raises NoQuantityError for an orbit of a family and an equilibrium."""
        return stated(self.point.problem)

    @property
    def _collocation(self) -> CollocationEquations:
        problem = self.point.problem
        if not isinstance(problem, CollocationEquations):
            raise NoQuantityError("mesh: the solution is not one of collocation; accepted: evaluate(t)")
        return problem

    @property
    def statement(self) -> Statement:
        """The boundary-value problem that is solved."""
        return self.problem.statement

    @cached_property
    def t(self) -> Array:
        """Times of the unknowns: ends and stages of the intervals."""
        start, end = self.space.span(self.point)
        return np.asarray(start + self._collocation._fractions() * (end - start))

    @cached_property
    def states(self) -> Array:
        """States at `t`, shape (time, component)."""
        values = self.point.z[: self.problem.states].reshape(self.problem.columns, -1)
        return np.array(values[:, : len(self.space.state_names)])

    @property
    def mesh(self) -> Array:
        """Ends of the intervals of the part that was unknown, shape (intervals + 1,).

        Raises NoQuantityError, as `intervals`, where there are none: for an orbit in cosines or by shooting, and an
        equilibrium.
        """
        start, end = self.space.span(self.point)
        return np.asarray(start + mesh.edges(self._collocation.constants) * (end - start))

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return self._collocation.resolution

    # Errors -----------------------------------------------------------------------------------------------------------

    @property
    def error(self) -> float:
        """Estimated error of the states, relative to the largest value of each.

        The largest value of a state counts as no less than a millionth of that of all states, nor than a thousandth of
        that of the guess.
        """
        return self.point.error.profile

    @property
    def parameter_error(self) -> float:
        """Estimated relative error of the free parameters; 0 where there are none.

        Values count as no less than a thousandth of their guess, or than 1 where that is 0.
        """
        return self.point.error.Omega if self.statement.free else 0.0

    @property
    def at_round_off(self) -> bool:
        """Whether rounding keeps the estimated errors above the tolerance: no mesh makes them smaller."""
        return self.point.at_round_off

    @cached_property
    def residual(self) -> float:
        """Largest residual of the equations relative to their largest term."""
        return self.point.problem.relative_residual(self.point.z)

    # Stability ------------------------------------------------------------------------------------------------------

    def floquet(self, by: str | None = None) -> Floquet:
        """Linear stability: multipliers, and the kind of an instability.

        Arguments:
            by: name of the flow map; that of the branch by default. Of an orbit of a family one of
                `methods.FLOWS`, of another "collocation" or "cvodes".

        Returns:
            Multipliers with their errors, from the N x N problem where the symmetries allow it, else over the full
            period; at |gamma| = 1 of a chain without the algebraic growth of its Jordan block. Of a boundary-value
            problem with x(end) = S x(start) those of S^-1 times the flow.

        Raises:
            FlowError: the flow map cannot reach the tolerance.
            ValueError: there is no such flow map, or the solution does not close.
        """
        if by is not None:
            found = self.space.floquets([self.point], by)[0]
            found.warn()
            return found
        return self._floquet

    @cached_property
    def _floquet(self) -> Floquet:
        if self.known_floquet is not None:
            return self.known_floquet
        found = self.space.floquets([self.point])[0]
        found.warn()
        return found

    @property
    def stable(self) -> bool:
        """Whether no multiplier lies outside the unit circle, within estimated errors; raises as `floquet`."""
        return self.floquet().stable

    # Optima -----------------------------------------------------------------------------------------------------------

    @property
    def objective(self) -> float:
        """Value of the objective; raises ValueError without an objective."""
        return self._known_optimum().objective

    @property
    def status(self) -> str:
        """The outcome of the optimisation, in a sentence; raises ValueError without an objective."""
        optimality, error = self._known_optimum().optimality, max(self.error, self.parameter_error)
        active = ", ".join(optimality.active)
        kind = "a local optimum" if optimality.curved else "a stationary point"
        words = f"{kind}{f' on the bounds {active}' if active else ''}"
        if error > self.space.tolerance:
            words += f", to {error:.1e}: bounds hold states at the mesh's points only"
        return words

    def _known_optimum(self) -> Optimum:
        if self.optimum is None:
            raise NoQuantityError("objective: nothing was minimised")
        return self.optimum

    # Branches ---------------------------------------------------------------------------------------------------------

    follow: ClassVar[Callable[..., Any]]
    """The `Branch` of solutions through this one: `casadi_skin.follow.follow.follow`."""

    def follow_all(self, parameter: str, to: float, depth: int = 3, limit: int = 30, **options: Any) -> Any:
        """The branch through this solution, with all that leave it; options are those of `follow`."""
        return self.follow(parameter, to, **options).follow_all(depth=depth, limit=limit)


# One equilibrium with its eigenvalues and its error -------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Equilibrium(Solution):
    """A state at which a model rests; dimensionless, or in the units of its model."""

    def __repr__(self) -> str:
        named = [f"{name} = {value:.6g}" for name, value in zip(self.space.state_names, self.positions, strict=True)]
        values = [f"{name} = {value:.6g}" for name, value in self.parameters.items()]
        words = f"; {', '.join(values)}" if values else ""
        shown = ", ".join(named[:6]) + (", ..." if len(named) > 6 else "")
        return f"<Equilibrium of {self.model.name}: {shown}{words}; {'stable' if self.stable else 'unstable'}>"

    @property
    def _equations(self) -> AlgebraicProblem:
        return cast(AlgebraicProblem, self.point.problem)

    @property
    def positions(self) -> Array:
        """The unknowns: the state, of a model of second order its positions, shape (state,)."""
        return self._equations.state(self.point.z)

    @property
    def state(self) -> Array:
        """The first-order state: of a model of second order positions and velocities, which vanish."""
        at_rest = np.zeros(self.model.full_size - self.model.size)
        return np.concatenate([self.positions, at_rest])

    def evaluate(self, t: ArrayLike) -> Array:
        """The state at any times, shape (time, component), or at one, shape (component,): it is the same at all."""
        return at_instants(t, np.tile(self.state, (instants(t).size, 1)))

    def __getitem__(self, name: str) -> float | Array:
        """The value of a parameter or of a state; raises KeyError for other names."""
        if name in self.parameters:
            return self.parameters[name]
        names = self.model.state_names
        if name not in names:
            raise KeyError(f"{name}; known: {', '.join((*names, *self.parameters))}")
        return float(self.state[names.index(name)])

    def centred_model(self) -> OdeModel:
        """The model in displacements from this state, which rests at 0: families grow from its linear modes.

        Its parameters have the values that they have here. A reversal that keeps the positions is kept.

        Returns:
            A model of second order, with the names of the states of this one.

        Raises:
            ValueError: the model is of first order, or forced.
        """
        return centred_model(self.model, self.positions, self.parameters)

    # Stability ------------------------------------------------------------------------------------------------------

    @property
    def spectrum(self) -> Spectrum:
        """Eigenvalues with their errors."""
        found: Spectrum = cast(Any, self.space).spectrum(self.point)
        return found

    @property
    def eigenvalues(self) -> ComplexArray:
        """Eigenvalues of the linearisation by descending real part, shape (components of the first-order state,)."""
        return self.spectrum.values

    @property
    def eigenvalue_error(self) -> float:
        """Largest estimated absolute error of the eigenvalues."""
        return float(np.max(self.spectrum.errors))

    @property
    def stable(self) -> bool:
        """Whether no eigenvalue has a positive real part, within estimated errors."""
        return self.spectrum.stable

    @property
    def unstable(self) -> int:
        """Number of eigenvalues with a positive real part, by more than estimated errors."""
        return int(np.sum(self.spectrum.values.real > self.spectrum.errors))

    @property
    def parameter_error(self) -> float:
        """0: no parameter is found with the state."""
        return 0.0
