"""One periodic orbit of any model in the coordinates of the model, with its stability on demand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import FAMILY
from casadi_skin.model.amplitude import amplitude_square
from casadi_skin.model.arguments import whole
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.model.expressions import at_instants, instants, site_numbers
from casadi_skin.model.result import NoQuantityError
from casadi_skin.stability.growth import TransientGrowth, transient_growth
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.cosines import cosine_matrix, quarter_phases
from casadi_skin.zero.family import LOG10
from casadi_skin.zero.problem import Array, Indices, OrbitProblem

MOST_QUARTERS = 10_000  # periods are followed as products of matrices
MOST_HARMONICS = 4096  # of coefficients
TIE_RTOL = 1e-10  # relative difference of displacements that count as equal


@dataclass(frozen=True, eq=False)
class Orbit(Solution):
    """A converged periodic orbit; dimensionless, or in the units of its model.

    An orbit of a family has all velocities zero at t = 0, and its states are displacements; an orbit of `find_orbit`
    has the states of the first-order model.
    """

    def __repr__(self) -> str:
        name = getattr(self.model, "name", None) or repr(self.model)
        S = f"S = {self.S:.6g}, " if self._grown else ""
        return f"<Orbit of {name}: {S}Omega = {self.Omega:.10g}, period = {self.period:.10g}; error {self.error:.1e}>"

    @property
    def symmetry(self) -> SymmetryClass:
        """The part of the period that was unknown, by the symmetries."""
        return self.space.symmetry

    @property
    def Omega(self) -> float:
        """Frequency."""
        return self.point.Omega if self._grown else 2.0 * np.pi / self.period

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
        return self.point.error.Omega if self._grown else self.parameter_error * self.Omega

    @property
    def period_error(self) -> float:
        """Estimated absolute error of the period; 0 in a forced model."""
        return self.Omega_error / self.Omega * self.period

    @property
    def parameter_error(self) -> float:
        if self._grown:
            return self.point.error.Omega / self.point.Omega
        return super().parameter_error

    @property
    def S_error(self) -> float:
        """Estimated absolute error of S: 0 where the other errors are those at the S that the orbit has.

        Not 0 for an orbit requested by its Omega or period, which has these exactly, and where S hardly changes along
        the family: near its folds, and where S has come to a limit that the period has not.
        """
        return self.point.error.parameter * self.space.S_rate * self.S

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

    @cached_property
    def t(self) -> Array:
        """Times of the unknowns: of an orbit of a family those of the phases at which its equations are solved."""
        return cast(OrbitProblem, self.point.problem).phases() / self.Omega if self._grown else super().t

    @cached_property
    def states(self) -> Array:
        """States at `t`, shape (time, component); of an orbit of a family displacements at `output_sites`."""
        return self.evaluate(self.t, self.output_sites) if self._grown else super().states

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
        numbers = site_numbers(sites)
        if self._grown:
            return np.asarray(self._scale * self._family().positions(self.point, theta, numbers))
        return np.asarray(self._boundary_space.states_at(self.point, theta, numbers))

    @cached_property
    def _scale(self) -> float:
        """sqrt(S) with the sign that makes the largest displacement at t = 0 positive; the site can change in a family.

        Of sites that tie, as in a reciprocal chain, the last one decides; an orbit whose model is not odd has no image
        of the other sign. The corrector's residual of the normalisation is divided out, so that the amplitude is
        sqrt(S) to round-off.
        """
        coordinates = self._family().coordinates
        start = coordinates.scale * self.point.problem.sample(self.point.z, np.zeros(1))[0]
        if coordinates.scaled.half_period is None:
            return float(np.sqrt(self.S) / coordinates.amplitude(start))
        tied = np.flatnonzero(np.abs(start) >= (1.0 - TIE_RTOL) * np.max(np.abs(start)))
        return float(np.sign(start[tied[-1]]) * np.sqrt(self.S) / coordinates.amplitude(start))

    @cached_property
    def S(self) -> float:
        """Total amplitude: the sum of squares of the positions at t = 0, where all velocities vanish.

        A model with a normalisation has the S of that in its place. Raises ValueError for an orbit of a model
        without positions.
        """
        if self._grown:
            return self.exact["S"] if "S" in self.exact else self.space.value("S", self.point)
        space = self._boundary_space
        positions = space.positions
        if not positions:
            raise NoQuantityError("S: an orbit of a model of first order has no amplitude of positions")
        return amplitude_square(space.given).value(self.evaluate(0.0)[:positions])

    @property
    def output_sites(self) -> Indices:
        """Numbers of the components in files and pictures: all, or those of the nonlinear core of a long chain."""
        return self.space.output_sites

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
        return (logs + np.log(abs(self._scale))) / LOG10, signs * np.sign(self._scale)

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
        return self.space.energy(self.point)

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
        try:
            return self.certify()
        except ValueError as error:
            raise NoQuantityError(str(error)) from error

    @cached_property
    def proved_stability(self) -> Any:
        """The proof that `certify_stability` makes, kept."""
        try:
            return self.certify_stability()
        except ValueError as error:
            raise NoQuantityError(str(error)) from error

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
        return self.space.floquet_vectors(self.point, self.floquet())

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
        transition, acceleration = family.transition_of_all(self.point)
        free = coordinates.free_motions
        return transient_growth(transition, acceleration, coordinates.log_scale, self.period, quarters, free)

    @property
    def _grown(self) -> bool:
        """Whether the orbit is one of a family that grows from a linear mode."""
        return self.space.connects == FAMILY

    def _family(self) -> Any:
        if not self._grown:
            raise NoQuantityError("this quantity is that of an orbit of a family that grows from a linear mode")
        return self.space

    @property
    def _boundary_space(self) -> Any:
        return self.space


# An orbit as a closed curve in the space of states, and the distance of a state from it -------------------------------

SOUGHT_PHASES = 128  # of an orbit of a family, among which the nearest is sought first
GAUSS_NEWTON_STEPS = 6  # of Gauss and Newton's refinement
HARMONICS_TRIED = (64, 128, 256, 512, 1024)  # of an orbit without the half-period symmetry
NEGLIGIBLE_COEFFICIENT = 1e-2  # of the tolerance: coefficients that a sum of cosines can do without


class CosineSeries(Protocol):
    """Interface of an orbit for distances from it, as an `Orbit` or a stored orbit has it."""

    @property
    def S(self) -> float: ...
    @property
    def Omega(self) -> float: ...
    @property
    def harmonics(self) -> int: ...
    def coefficients(self, harmonics: int) -> Array: ...


@dataclass(frozen=True, eq=False)
class Curve:
    """A closed curve in the space of states, as a function of the phase.

    Attributes:
        points: points and their derivatives by the phase at phases theta, shape (len(theta), components) each.
        phases: number of phases among which the nearest point is sought first.
        unit: of distances.
    """

    points: Callable[[Array], tuple[Array, Array]]
    phases: int
    unit: float

    def distances(self, states: Array) -> Array:
        """Distance of states (many, components) to the nearest point of the curve, in its unit, shape (many,).

        The nearest phase is sought among `phases` and refined by Gauss-Newton steps.
        """
        phases = 2.0 * np.pi * np.arange(self.phases) / self.phases
        coarse, _ = self.points(phases)
        theta = phases[np.argmax(states @ coarse.T - 0.5 * np.sum(coarse**2, axis=1), axis=1)]
        nearest = np.full(len(states), np.inf)
        for _ in range(GAUSS_NEWTON_STEPS):
            point, tangent = self.points(theta)
            nearest = np.minimum(nearest, np.linalg.norm(states - point, axis=1))
            move = np.sum((states - point) * tangent, axis=1) / np.sum(tangent**2, axis=1)
            theta = theta + np.clip(move, -np.pi / self.phases, np.pi / self.phases)
        return np.asarray(nearest / self.unit)


def cosine_curve(orbit: CosineSeries) -> Curve:
    """The points (y, y'/Omega) of an orbit of a family, in units of sqrt(S)."""
    if isinstance(orbit, Orbit) and orbit.symmetry is not SymmetryClass.QUARTER:
        c = _cosines(orbit)
        order = np.arange(len(c))
    else:
        c = orbit.coefficients(orbit.harmonics)
        order = 2 * np.arange(len(c)) + 1

    def points(theta: Array) -> tuple[Array, Array]:
        cosine, sine = np.cos(np.outer(theta, order)), np.sin(np.outer(theta, order))
        y, dy, ddy = cosine @ c, -(sine * order) @ c, -(cosine * order**2) @ c
        return np.hstack([y, dy]), np.hstack([dy, ddy])

    return Curve(points, SOUGHT_PHASES, float(np.sqrt(orbit.S)))


def _cosines(orbit: Orbit) -> Array:
    """Coefficients of cos(k Omega t), k from 0, of an orbit of a family with both even and odd harmonics."""
    from scipy.fft import dct

    for harmonics in HARMONICS_TRIED:
        middles = (np.arange(harmonics) + 0.5) / (2 * harmonics)
        c = dct(orbit.evaluate(orbit.period * middles), axis=0) / harmonics
        c[0] *= 0.5
        if np.max(np.abs(c[-harmonics // 4 :])) <= NEGLIGIBLE_COEFFICIENT * orbit.space.tolerance * np.max(np.abs(c)):
            break
    return np.asarray(c)
