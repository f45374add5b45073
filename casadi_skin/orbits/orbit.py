"""One nonlinear mode: a periodic orbit of the chain in physical coordinates, with its stability when asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.bvp.problem import Array, Indices
from casadi_skin.bvp.trigonometric import TrigonometricProblem, cosine_matrix
from casadi_skin.continuation.points import Point
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.lattice.full_chain import EdgeSite
from casadi_skin.lattice.log_profile import log_positions
from casadi_skin.lattice.tail_problem import CoreWithTailProblem, Regime
from casadi_skin.orbits.multipliers import accelerations, floquets_of, on_all_sites, orbit_state
from casadi_skin.orbits.tools import FamilyTools
from casadi_skin.stability.flow import Transition
from casadi_skin.stability.growth import TransientGrowth, transient_growth
from casadi_skin.stability.multipliers import floquet_vectors
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet

TIE = 1e-10  # relative difference of displacements that count as equal


@dataclass(frozen=True, eq=False)
class Orbit:
    """A converged orbit y_n(t) of period 2 pi/Omega with all velocities zero at t = 0; dimensionless."""

    tools: FamilyTools
    point: Point
    known_floquet: Floquet | None = None  # computed before: in a run that is resumed, or with its neighbours
    asked_S: float | None = None  # the S that the orbit was asked for at, which kappa/g need not give back exactly
    asked_period: float | None = None  # likewise, which 2 pi/Omega need not give back exactly

    @property
    def chain(self) -> Chain:
        """The chain that the orbit belongs to."""
        return self.tools.request.chain

    @property
    def S(self) -> float:
        """Total amplitude ||y||^2, the sum of y_n^2 at t = 0."""
        return self.tools.request.S_of(self.point.parameter) if self.asked_S is None else self.asked_S

    @property
    def Omega(self) -> float:
        """Frequency."""
        return self.point.Omega

    @property
    def period(self) -> float:
        """Period 2 pi/Omega."""
        return self.tools.request.period_of(self.Omega) if self.asked_period is None else self.asked_period

    @property
    def Omega_error(self) -> float:
        """Estimated absolute error of Omega."""
        return self.point.error.Omega

    @property
    def S_error(self) -> float:
        """Estimated absolute error of S: 0 where the other errors are those at the S that it has.

        Not 0 for an orbit asked for by its Omega or period, which has these exactly, and where S hardly changes along
        the family: near its folds, and where S has come to a limit that the period has not.
        """
        return self.point.error.parameter * self.S

    @property
    def profile_error(self) -> float:
        """Estimated error of the state relative to its largest component."""
        return self.point.error.profile

    @property
    def at_round_off(self) -> bool:
        """Whether round-off keeps the errors from falling to the tolerance asked for."""
        return self.point.at_round_off

    @cached_property
    def residual(self) -> float:
        """Largest residual of the collocation equations relative to their largest term."""
        return self.point.problem.relative_residual(self.point.z)

    # Shape ----------------------------------------------------------------------------------------------------------

    def _gauge(self, theta: Array) -> Array:
        """Scaled gauge positions q at phases theta, shape (len(theta), core sites)."""
        return self.point.problem.sample(self.point.z, theta)

    def evaluate(self, t: ArrayLike, sites: ArrayLike | None = None) -> Array:
        """Displacements y_n(t), shape (time, site), in physical coordinates; the largest at t = 0 is positive.

        `sites` are numbers from 1 to N, all by default. In an infinite chain they are 0, -1, -2, ... from the edge for
        gamma > 0 and 1, 2, 3, ... for gamma < 0, by default those of the nonlinear core. Raises ValueError for others.
        """
        return self._displacements(self.Omega * np.atleast_1d(np.asarray(t, dtype=float)), sites)

    def _displacements(self, theta: Array, sites: ArrayLike | None = None) -> Array:
        numbers = None if sites is None else np.atleast_1d(np.asarray(sites, dtype=np.int64))
        return self._scale * self.tools.layout.displacements(self.point.problem, self.point.z, theta, numbers)

    @cached_property
    def _scale(self) -> float:
        """sqrt(S) with the sign that makes the largest displacement at t = 0 positive; the site can change in a family.

        Of sites that tie, as in a reciprocal chain, the last one decides. What the corrector left of the normalisation
        sum_n w_n q_n(0)^2 = 1 is divided out, so that ||y||^2 is S to round-off.
        """
        start = self.tools.core.rho * self._gauge(np.zeros(1))[0]
        tied = np.flatnonzero(np.abs(start) >= (1.0 - TIE) * np.max(np.abs(start)))
        return float(np.sign(start[tied[-1]]) * np.sqrt(self.S) / np.linalg.norm(start))

    @property
    def output_sites(self) -> Indices:
        """Numbers of the sites in files and pictures: all, or those of the nonlinear core of a long chain."""
        return self.tools.layout.output_sites

    @property
    def harmonics(self) -> int:
        """Number of odd harmonics that carry the orbit at its tolerance."""
        problem = self.point.problem
        return problem.resolution if isinstance(problem, TrigonometricProblem) else 64

    def coefficients(self, harmonics: int, sites: ArrayLike | None = None) -> Array:
        """Coefficients c_kn of y_n(t) = sum_k c_kn cos((2k+1) Omega t), shape (harmonics, sites); see `evaluate`."""
        theta = (np.arange(harmonics) + 0.5) * np.pi / (2 * harmonics)
        to_coefficients = (2.0 / harmonics) * cosine_matrix(harmonics)
        return np.asarray(to_coefficients @ self._displacements(theta, sites))

    @cached_property
    def profile(self) -> Array:
        """Displacements at t = 0, where all velocities vanish, shape (sites,)."""
        start: Array = self.evaluate(0.0)[0]
        return start

    @cached_property
    def _core_logs(self) -> tuple[Array, Array]:
        return log_positions(self.tools, self.point)

    def log10_displacements(self, sites: ArrayLike | None = None) -> tuple[Array, Array]:
        """log10 |y_n(0)| and the signs of y_n(0), each (sites,): right far below the smallest double.

        A site at rest has -inf and sign 0; `sites` are those of `evaluate`.
        """
        layout = self.tools.layout
        logs, signs = self._core_logs
        numbers = layout.output_sites if self.chain.infinite else np.arange(1, self.chain.sites + 1)
        numbers = numbers if sites is None else np.atleast_1d(np.asarray(sites, dtype=np.int64))
        if isinstance(layout, CoreWithTail):
            m = layout.distances(numbers)
            inside, place = m < layout.core.sites, layout.core.sites - 1 - m
            (logs, signs), core = layout.log_positions(self.point.problem, self.point.z, m), (logs, signs)
            logs[inside], signs[inside] = core[0][place[inside]], core[1][place[inside]]
            logs = logs - np.arctanh(abs(self.chain.gamma)) * m
        elif isinstance(layout, EdgeSite):
            moves = numbers - 1 == layout.edge
            logs, signs = np.where(moves, logs[0], -np.inf), np.where(moves, signs[0], 0.0)
        else:
            logs, signs = (logs + layout.core.log_rho)[numbers - 1], signs[numbers - 1]
        return (logs + np.log(abs(self._scale))) / np.log(10.0), signs * np.sign(self._scale)

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
        """Hamiltonian of the gauge with rho = 1 at the edge that the modes lean to; of an infinite tail, infinite."""
        return self.S * self.tools.layout.energy(self.point.problem, self.point.z, self.tools.hamiltonian)

    @cached_property
    def Omega_shift(self) -> float:
        """Omega - omega_j, formed without subtraction where the shift is small.

        The fundamental harmonic of the equations projected on the linear mode gives Omega^2 - omega_j^2 as a ratio
        of sums over the cubic term, with no cancellation.
        """
        return self.tools.layout.Omega_shift(self.point.problem, self.point.z)

    @property
    def regime(self) -> Regime | None:
        """Whether Omega, or three times it, is pinned to the band; None where the tail is not eliminated."""
        problem = self.point.problem
        return problem.regime(self.point.z) if isinstance(problem, CoreWithTailProblem) else None

    # Stability ------------------------------------------------------------------------------------------------------

    def _transition(self) -> tuple[Transition, Array]:
        """Transition matrix of all sites, and q'' at phase zero."""
        tools, point = self.tools, on_all_sites(self.tools, self.point)
        tools = tools.whole if isinstance(tools.layout, CoreWithTail) else tools
        acceleration = accelerations(tools, [orbit_state(point)])[0]
        return tools.flow.transition(point.problem, point.z), np.asarray(acceleration)

    def floquet(self) -> Floquet:
        """Multipliers and the kind of instability; at |gamma| = 1 without the Jordan block's algebraic growth.

        Raises FlowError where the flow map cannot reach the tolerance.
        """
        return self._floquet

    @cached_property
    def _floquet(self) -> Floquet:
        return floquets_of(self.tools, [self.point])[0] if self.known_floquet is None else self.known_floquet

    @property
    def multiplier_error(self) -> float:
        """Estimated absolute error of mu and, for an unstable orbit, of the largest modulus of a multiplier."""
        return self.floquet().error

    def floquet_vectors(self) -> ComplexArray:
        """Floquet vectors (positions, velocities) at t = 0 in physical coordinates, shape (2N, 2N), one a column.

        Columns go with `floquet().multipliers`. Raises ValueError at |gamma| = 1, where the gauge has no image of them.
        """
        if abs(self.chain.gamma) == 1.0:
            raise ValueError(
                "floquet_vectors: at |gamma| = 1 the vectors form Jordan chains that the gauge does not have"
            )
        return floquet_vectors(*self._transition(), self.chain.rho)

    def transient_growth(self, quarters: int = 40) -> TransientGrowth:
        """Largest amplification of perturbations at multiples of a quarter period, in physical coordinates.

        Raises ValueError at |gamma| = 1 or without the splitting flow.
        """
        if abs(self.chain.gamma) == 1.0 or self.tools.request.flow != "splitting":
            raise ValueError("transient_growth: needs |gamma| < 1 and the splitting flow")
        return transient_growth(*self._transition(), self.chain.log_rho, self.period, quarters)
