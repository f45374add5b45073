"""A solution of a boundary-value problem, with its errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.space import collocation_of
from casadi_skin.model.arguments import check_name, check_way, number, whole
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.declarations import check_forcing_period
from casadi_skin.model.expressions import at_instants, instants, site_numbers
from casadi_skin.model.ode import OdeModel, centred_model
from casadi_skin.model.result import NoQuantityError, Result, renamed
from casadi_skin.stability.growth import TransientGrowth, transient_growth
from casadi_skin.stability.result import Floquet
from casadi_skin.zero import mesh
from casadi_skin.zero.balanced import ComplexArray
from casadi_skin.zero.coordinates import LOG10
from casadi_skin.zero.cosines import cosine_matrix, quarter_phases
from casadi_skin.zero.problem import Array, Indices, Scalar
from casadi_skin.zero.rest import Spectrum
from casadi_skin.zero.settings import ContinuationSettings, Point, Target
from casadi_skin.zero.stated_problem import BoundaryProblem, stated
from casadi_skin.zero.statement import Statement

# The objective of a boundary-value problem at its solution, and how well the optimality conditions hold ---------------


@dataclass(frozen=True)
class Optimum:
    """The smallest value of the objective, and the Karush-Kuhn-Tucker conditions, evaluated apart from the solver.

    `kkt` is the largest of stationarity and complementarity relative to the largest gradient or multiplier, `violation`
    that of equations and bounds, and `active` are the bounds with a multiplier, in words. `curved` is true where the
    curvature is that of a minimum; it is not known where the model holds a program, such as an FMU.
    """

    objective: float
    objective_error: float
    kkt: float
    violation: float
    active: tuple[str, ...]
    curved: bool


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

    space: Any
    point: Point
    exact: Mapping[str, float] = field(default_factory=dict)
    optimum: Optimum | None = None
    known_floquet: Floquet | None = None
    found_by: str = ""
    is_orbit: ClassVar[bool] = False
    is_equilibrium: ClassVar[bool] = False

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
        values: dict[str, float] = self.space.parameters(self.point)
        return values | {name: value for name, value in self.exact.items() if name in values}

    @cached_property
    def interval(self) -> tuple[float, float]:
        """Start and end."""
        start, end = self.space.interval(self.point)
        return start, end

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
        """The value of a parameter, or of a state: at `t`, of an equilibrium one; raises KeyError for other names."""
        known = self._named_states | self.parameters
        if name not in known:
            raise KeyError(f"{name}; known: {', '.join(known)}")
        found: float | Array = known[name]
        return found

    @property
    def _named_states(self) -> dict[str, Any]:
        return dict(zip(self.space.state_names, self.states.T, strict=True))

    def value(self, name: str) -> float:
        """A quantity that the branch can be corrected at; exactly the requested value at a requested solution."""
        return float(self.exact[name] if name in self.exact else self.space.value(name, self.point))

    # The discretisation -----------------------------------------------------------------------------------------------

    @property
    def problem(self) -> BoundaryProblem:
        """The stated equations on their mesh; raises NoQuantityError for an orbit of a family and an equilibrium."""
        return stated(self.point.problem)

    @property
    def statement(self) -> Statement:
        """The boundary-value problem that is solved."""
        return self.problem.statement

    @cached_property
    def t(self) -> Array:
        """Times of the unknowns: ends and stages of the intervals; of a family the phases of its equations."""
        return np.asarray(self.space.times(self.point))

    @cached_property
    def states(self) -> Array:
        """States at `t`, shape (time, component); of an orbit of a family displacements at `output_sites`."""
        return np.asarray(self.space.states(self.point))

    @property
    def mesh(self) -> Array:
        """Ends of the intervals of the part that was unknown, shape (intervals + 1,).

        Raises NoQuantityError, as `intervals`, where there are none: for an orbit in cosines or by shooting, and an
        equilibrium.
        """
        start, end = self.space.span(self.point)
        return np.asarray(start + mesh.edges(collocation_of(self.point).constants) * (end - start))

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return collocation_of(self.point).resolution

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
        return float(self.space.free_error(self.point))

    @property
    def at_round_off(self) -> bool:
        """Whether rounding keeps the estimated errors above the tolerance: no mesh makes them smaller."""
        return self.point.at_round_off

    @cached_property
    def residual(self) -> float:
        """Largest residual of the equations relative to their largest term."""
        return float(self.point.problem.relative_residual(self.point.z))

    # Stability ------------------------------------------------------------------------------------------------------

    @renamed(by="flow")
    def floquet(self, flow: str | None = None) -> Floquet:
        """Linear stability: multipliers, and the kind of an instability.

        Arguments:
            flow: name of the flow map; that of the branch by default. Of an orbit of a family one of
                `methods.FLOWS`, of another "collocation" or "cvodes".

        Returns:
            Multipliers with their errors, from the N x N problem where the symmetries allow it, else over the full
            period; at |gamma| = 1 of a chain without the algebraic growth of its Jordan block. Of a boundary-value
            problem with x(end) = S x(start) those of S^-1 times the flow.

        Raises:
            FlowError: the flow map cannot reach the tolerance.
            ValueError: there is no such flow map, or the solution does not close.
        """
        if flow is not None:
            return self._computed(flow)
        return self._floquet

    @cached_property
    def _floquet(self) -> Floquet:
        if self.known_floquet is not None:
            return self.known_floquet
        return self._computed()

    def _computed(self, by: str | None = None) -> Floquet:
        found: Floquet = self.space.floquets([self.point], by)[0]
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
        optimum, error = self._known_optimum(), max(self.error, self.parameter_error)
        active = ", ".join(optimum.active)
        kind = "a local optimum" if optimum.curved else "a stationary point"
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

    is_equilibrium = True

    def __repr__(self) -> str:
        named = [f"{name} = {value:.6g}" for name, value in zip(self.space.state_names, self.positions, strict=True)]
        values = [f"{name} = {value:.6g}" for name, value in self.parameters.items()]
        words = f"; {', '.join(values)}" if values else ""
        shown = ", ".join(named[:6]) + (", ..." if len(named) > 6 else "")
        return f"<Equilibrium of {self.model.name}: {shown}{words}; {'stable' if self.stable else 'unstable'}>"

    @property
    def positions(self) -> Array:
        """The unknowns: the state, of a model of second order its positions, shape (state,)."""
        return np.asarray(self.point.problem.state(self.point.z))

    @property
    def state(self) -> Array:
        """The first-order state: of a model of second order positions and velocities, which vanish."""
        at_rest = np.zeros(self.model.full_size - self.model.size)
        return np.concatenate([self.positions, at_rest])

    def evaluate(self, t: ArrayLike) -> Array:
        """The state at any times, shape (time, component), or at one, shape (component,): it is the same at all."""
        return at_instants(t, np.tile(self.state, (instants(t).size, 1)))

    @property
    def _named_states(self) -> dict[str, Any]:
        return dict(zip(self.model.state_names, map(float, self.state), strict=True))

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
        found: Spectrum = self.space.spectrum(self.point)
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
        return self.unstable == 0

    @property
    def unstable(self) -> int:
        """Number of eigenvalues with a positive real part, by more than estimated errors."""
        return int(self.space.unstable_at(self.point))


# One periodic orbit of any model in the coordinates of the model, with its stability on demand ------------------------

MOST_QUARTERS = 10_000  # periods are followed as products of matrices
MOST_HARMONICS = 4096  # of coefficients


@dataclass(frozen=True, eq=False)
class Orbit(Solution):
    """A converged periodic orbit; dimensionless, or in the units of its model.

    An orbit of a family has all velocities zero at t = 0, and its states are displacements; an orbit of `find_orbit`
    has the states of the first-order model.
    """

    is_orbit = True

    def __repr__(self) -> str:
        name = getattr(self.model, "name", None) or repr(self.model)
        S = f"S = {self.S:.6g}, " if self.space.is_family else ""
        return f"<Orbit of {name}: {S}Omega = {self.Omega:.10g}, period = {self.period:.10g}; error {self.error:.1e}>"

    @property
    def symmetry(self) -> SymmetryClass:
        """The part of the period that was unknown, by the symmetries."""
        return SymmetryClass(self.space.symmetry)

    @property
    def Omega(self) -> float:
        """Frequency."""
        return float(self.space.frequency(self))

    @property
    def period(self) -> float:
        """Period; in a forced model that of the forcing or a multiple."""
        if "period" in self.exact:
            return self.exact["period"]
        start, end = self.interval
        return end - start

    @property
    def Omega_error(self) -> float:
        """Estimated absolute error of Omega."""
        return self.parameter_error * self.Omega

    @property
    def period_error(self) -> float:
        """Estimated absolute error of the period; 0 in a forced model."""
        return self.Omega_error / self.Omega * self.period

    @property
    def S_error(self) -> float:
        """Estimated absolute error of S: 0 where the other errors are those at the S that the orbit has.

        Not 0 for an orbit requested by its Omega or period, which has these exactly, and where S hardly changes along
        the family: near its folds, and where S has come to a limit that the period has not.
        """
        return self.point.error.parameter * float(self.space.S_rate) * self.S

    @property
    def profile_error(self) -> float:
        """Estimated error of the state relative to its largest component."""
        return self.point.error.profile

    @property
    def unfolding(self) -> float:
        """Coefficient of the unfolding terms, the largest of several: zero but for errors in a conservative model."""
        known = [value for name, value in self.parameters.items() if name.startswith("unfolding")]
        return max(known, key=abs, default=0.0)

    @property
    def model_parameters(self) -> Array:
        """Parameters of the model itself, in its order."""
        return np.array([self.parameters[name] for name in self.model.parameter_names])

    # Shape ----------------------------------------------------------------------------------------------------------

    def evaluate(self, t: ArrayLike, sites: ArrayLike | None = None) -> Array:
        """States at any times.

        Arguments:
            t: times, shape (times,), or one.
            sites: numbers of the components, from 1; all by default. In an infinite chain they are 0, -1, -2, ... from
                the edge for gamma > 0 and 1, 2, 3, ... for gamma < 0, by default those of the nonlinear core.

        Returns:
            Shape (times, components), of one time (components,): displacements of an orbit of a family, whose largest
            is positive at t = 0 where the model is odd; all states of another orbit.

        Raises:
            ValueError: times that are not numbers, components that do not exist.
        """
        return at_instants(t, self._at_phases(2.0 * np.pi / self.period * instants(t), sites))

    def _at_phases(self, theta: Array, sites: ArrayLike | None = None) -> Array:
        return np.asarray(self.space.states_at(self.point, theta, site_numbers(sites)))

    @cached_property
    def S(self) -> float:
        """Total amplitude: the sum of squares of the positions at t = 0, where all velocities vanish.

        A model with a normalisation has the S of that in its place. Raises ValueError for an orbit of a model
        without positions.
        """
        return float(self.space.S_of(self))

    @property
    def output_sites(self) -> Indices:
        """Numbers of the components in files and pictures: all, or those of the nonlinear core of a long chain."""
        return np.asarray(self.space.output_sites)

    @property
    def harmonics(self) -> int:
        """Number of odd harmonics that carry the orbit at its tolerance."""
        return self.point.problem.cosines or 64

    def coefficients(self, harmonics: int, sites: ArrayLike | None = None) -> Array:
        """Coefficients c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), shape (harmonics, sites); see `evaluate`.

        Raises ValueError for an orbit without the symmetries of odd cosines.
        """
        if self.symmetry is not SymmetryClass.QUARTER:
            raise ValueError("coefficients: the orbit is no sum of odd cosines: its symmetries do not leave a quarter")
        whole("harmonics", harmonics, 1, MOST_HARMONICS)
        to_coefficients = (2.0 / harmonics) * cosine_matrix(harmonics)
        return np.asarray(to_coefficients @ self._at_phases(quarter_phases(harmonics), sites))

    @cached_property
    def profile(self) -> Array:
        """States at t = 0: of an orbit of a family displacements, where all velocities vanish; shape (components,)."""
        start: Array = self.evaluate(0.0)
        return start

    def log10_displacements(self, sites: ArrayLike | None = None) -> tuple[Array, Array]:
        """log10 |y_n(0)| and the signs of y_n(0), each (sites,): right far below the smallest double.

        A site at rest has -inf and sign 0; `sites` are those of `evaluate`. Raises ValueError for an orbit that is not
        one of a family.
        """
        logs, signs = self._family().log_displacements(self.point, sites)
        return logs / LOG10, signs

    @cached_property
    def log10_profile(self) -> Array:
        """log10 |y_n(0)|, shape (sites,): right far below the smallest double; -inf where a site rests."""
        return self.log10_displacements()[0]

    @cached_property
    def profile_sign(self) -> Array:
        """Signs of y_n(0), shape (sites,), for `log10_profile`; 0 where a site rests."""
        return self.log10_displacements()[1]

    @cached_property
    def energy(self) -> float:
        """The conserved quantity that the model declares; raises ValueError where it declares none.

        For a chain that of its gauge, with rho = 1 at the edge that the modes lean to; infinite where an infinite tail
        moves along.
        """
        return float(self.space.energy(self.point))

    @cached_property
    def Omega_shift(self) -> float:
        """Omega minus the linear frequency of an orbit of a family, without subtraction where the shift is small.

        The fundamental harmonic of the equations projected on the linear mode gives Omega^2 - omega^2 as a ratio of
        sums over the nonlinear terms, with no cancellation.
        """
        return float(self._family().coordinates.Omega_shift(self.point.problem, self.point.z))

    certify: ClassVar[Callable[..., Any]]
    """A proof that the orbit exists, with enclosures: `casadi_skin.certify.certify.certify`."""
    certify_stability: ClassVar[Callable[..., Any]]
    """A proof that the orbit is stable, or is not: `casadi_skin.certify.stability.certify_stability`."""

    @cached_property
    def certificate(self) -> Any:
        """The proof that `certify` makes without options, kept."""
        return _proof(self.certify)

    @cached_property
    def proved_stability(self) -> Any:
        """The proof that `certify_stability` makes, kept."""
        return _proof(self.certify_stability)

    # Stability ------------------------------------------------------------------------------------------------------

    @property
    def multiplier_error(self) -> float:
        """Estimated absolute error of mu and, for an unstable orbit, of the largest modulus of a multiplier."""
        return self.floquet().error

    def floquet_vectors(self) -> ComplexArray:
        """Floquet vectors at t = 0 in the coordinates of the model, one a column, as `floquet().multipliers` goes.

        Returns:
            Shape (2n, 2n): positions, then velocities; each column scaled to largest entry 1.

        Raises:
            ValueError: at |gamma| = 1 of a chain, where the gauge has no image of them.
        """
        return np.asarray(self.space.floquet_vectors(self.point, self.floquet()))

    def transient_growth(self, quarters: int = 40) -> TransientGrowth:
        """Largest amplification of perturbations at multiples of a quarter period, in the coordinates of the model.

        Raises ValueError without the splitting flow, without a Hamiltonian flow on a quarter of the period, and where
        the gauge has no image of perturbations.
        """
        family = self._family()
        coordinates = family.whole.coordinates
        splitting = family.request.method.flow == "splitting"
        if coordinates.without_vectors or not (splitting and coordinates.symplectic):
            raise ValueError("transient_growth: needs |gamma| < 1 and the splitting flow")
        whole("quarters", quarters, 1, MOST_QUARTERS)
        transition, acceleration = family.transition(self.point, relative=False)
        free = coordinates.free_motions
        return transient_growth(transition, acceleration, coordinates.log_scale, self.period, quarters, free)

    def _family(self) -> Any:
        if not self.space.is_family:
            raise NoQuantityError("this quantity is that of an orbit of a family that grows from a linear mode")
        return self.space


def _proof(certify: Callable[[], Any]) -> Any:
    try:
        return certify()
    except ValueError as error:
        raise NoQuantityError(str(error)) from error


def following_settings(
    solution: Any, parameter: str, to: float, *, at: Sequence[float], max_points: int, max_step: float,
    back_to: float | None = None,
) -> ContinuationSettings:  # fmt: skip
    """Settings of a branch from a solution in a parameter, checked; raises ValueError as `follow` does."""
    check_name("parameter", parameter, [name for name in solution.parameters if name not in solution.space.free])
    start = solution.parameters[parameter]
    end, back, values = check_way(start, to, back_to, at)
    whole("max_points", max_points, 2)
    if not number("max_step", max_step) > 0.0:
        raise ValueError(f"max_step: given {max_step!r}; accepted: a number > 0")
    wanted = tuple(Target(Scalar.PARAMETER, (value - start) / (end - start)) for value in values)
    model = solution.model
    if solution.is_orbit and model.forced:
        check_forcing_period(model, solution, solution.period, {**solution.parameters, parameter: end})
    return ContinuationSettings(
        1.0, solution.space.tolerance, wanted, max_step=float(max_step), max_points=max_points, tiny_first=False,
        max_parameter_step=0.2, parameter_min=(back - start) / (end - start),
        closing=back_to is None and (solution.space.stability_included or model.forced),  # an isola of responses
    )  # fmt: skip
