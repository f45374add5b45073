"""What an objective or a constraint of a search may be made of: named quantities of an orbit, as CasADi expressions.

Orbits are written in the gauge with the amplitude scaled out, as in models.chain, by values q_ni of site n at the nodes
of the odd cosines (bvp.trigonometric), with lambda = Omega^2, and with gamma, alpha and g as symbols. The weights
w_n = ((1 - |gamma|)/(1 + |gamma|))^m, m sites from the edge, are at most 1 for every chain.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.bvp.trigonometric import cosine_matrix, second_derivative_matrix
from casadi_skin.optimise.names import NAMED, nearest_name


@dataclass(frozen=True)
class ChainSymbols:
    """Parameters of the chain in a search: symbols where they are free, numbers elsewhere.

    `alpha_n` has shape (sites, 1); `mirrored` tells that modes lean to the first site (gamma <= 0).
    """

    sites: int
    gamma: ca.SX
    alpha_n: ca.SX
    g: ca.SX
    mirrored: bool

    @property
    def coupling(self) -> ca.SX:
        """s = sqrt(1 - gamma^2)."""
        return ca.sqrt((1 - self.gamma) * (1 + self.gamma))

    @property
    def log_amplification(self) -> ca.SX:
        """(N - 1)/2 log r, with r = (1 + |gamma|)/(1 - |gamma|)."""
        return (self.sites - 1) * ca.atanh(-self.gamma if self.mirrored else self.gamma)

    @property
    def weights(self) -> ca.SX:
        """w_n, shape (sites, 1)."""
        size = -self.gamma if self.mirrored else self.gamma
        ratio = (1 - size) / (1 + size)
        powers = [ratio**m for m in range(self.sites)]
        return ca.vertcat(*(powers if self.mirrored else reversed(powers)))


class Observables:
    """One orbit of a search. Its attributes are CasADi expressions, for objectives and constraints.

    The names of `names.NAMED` are attributes, `value(name)` gives the same. `alpha_n` (sites, 1), `y0` (displacements
    at the phase where all velocities vanish, (sites, 1)) and `slope(expression)` (its derivative by S along the family
    at fixed parameters) may be used as well. Slopes bring the tangent of the family into the problem as unknowns, so
    that they have exact second derivatives; where none is asked for there is no tangent.
    """

    def __init__(self, chain: ChainSymbols, harmonics: int) -> None:
        self.chain, self.harmonics = chain, harmonics
        self.S = ca.SX.sym("S")
        self.q = ca.SX.sym("q", chain.sites, harmonics)
        self.square = ca.SX.sym("Omega2")
        self.tangent: ca.SX | None = None
        self._rest = ca.DM((2.0 / harmonics) * cosine_matrix(harmonics).sum(axis=0))  # from nodes to theta = 0

    def __getattr__(self, name: str) -> ca.SX:
        raise AttributeError(f"observable: given {name}; {nearest_name(name, NAMED)}")

    # Equations ------------------------------------------------------------------------------------------------------

    @property
    def state(self) -> ca.SX:
        """Unknowns (q ordered by site, then node; lambda), shape (sites harmonics + 1, 1)."""
        return ca.vertcat(ca.vec(self.q.T), self.square)

    @property
    def _residual(self) -> ca.SX:
        """Omega^2 q'' + L q + g S w q^3 at the nodes, and the normalisation of q; shape of `state`."""
        chain, H, q = self.chain, self.harmonics, self.q
        zero, each = ca.SX.zeros(1, H), ca.DM.ones(1, H)
        beside = ca.vertcat(zero, q[:-1, :]) + ca.vertcat(q[1:, :], zero) if chain.sites > 1 else ca.SX.zeros(1, H)
        inertia = self.square * ca.mtimes(q, ca.DM(second_derivative_matrix(H)).T)
        linear = ca.mtimes(2 + chain.alpha_n, each) * q - chain.coupling * beside
        force = inertia + linear + chain.g * self.S * ca.mtimes(chain.weights, each) * q**3
        return ca.vertcat(ca.vec(force.T), ca.dot(chain.weights, self._at_rest**2) - 1)

    @property
    def unknowns(self) -> ca.SX:
        """State and, where a slope has been asked for, tangent (dq/dS, dlambda/dS)."""
        return self.state if self.tangent is None else ca.vertcat(self.state, self.tangent)

    @property
    def equations(self) -> ca.SX:
        """The orbit's equations and those of its tangent, as many as unknowns."""
        residual = self._residual
        return residual if self.tangent is None else ca.vertcat(residual, self.slope(residual))

    # Quantities -----------------------------------------------------------------------------------------------------

    def value(self, name: str) -> ca.SX:
        """The quantity of a name in `NAMED`; raises AttributeError for another."""
        if name not in NAMED:
            raise AttributeError(f"observable: given {name}; {nearest_name(name, NAMED)}")
        return getattr(self, name)

    def slope(self, expression: ca.SX) -> ca.SX:
        """d(expression)/dS along the family at fixed parameters; shape of the expression."""
        if self.tangent is None:
            self.tangent = ca.SX.sym("tangent", self.state.numel())
        return ca.jtimes(ca.SX(expression), ca.vertcat(self.state, self.S), ca.vertcat(self.tangent, 1))

    @property
    def _at_rest(self) -> ca.SX:
        """q_n at theta = 0, shape (sites, 1)."""
        return ca.mtimes(self.q, self._rest)

    @property
    def y0(self) -> ca.SX:
        """Displacements at the phase where all velocities vanish, shape (sites, 1)."""
        return ca.sqrt(self.S) * ca.sqrt(self.chain.weights) * self._at_rest

    @property
    def gamma(self) -> ca.SX:
        return self.chain.gamma

    @property
    def g(self) -> ca.SX:
        return self.chain.g

    @property
    def alpha_n(self) -> ca.SX:
        return self.chain.alpha_n

    @property
    def alpha(self) -> ca.SX:
        return ca.sum1(self.chain.alpha_n) / self.chain.sites

    @property
    def roughness(self) -> ca.SX:
        return ca.sumsqr(self.alpha_n[1:] - self.alpha_n[:-1])

    @property
    def Omega(self) -> ca.SX:
        return ca.sqrt(self.square)

    @property
    def period(self) -> ca.SX:
        return 2 * np.pi / self.Omega

    @property
    def energy(self) -> ca.SX:
        chain, q = self.chain, self._at_rest
        elastic = ca.dot(q, (2 + chain.alpha_n) * q) / 2 - chain.coupling * ca.dot(q[1:], q[:-1])
        return self.S * (elastic + chain.g * self.S * ca.dot(chain.weights, q**4) / 4)

    @property
    def participation(self) -> ca.SX:
        return 1 / ca.sumsqr(self.chain.weights * self._at_rest**2)

    @property
    def Omega_slope(self) -> ca.SX:
        return self.slope(self.Omega)

    @property
    def energy_slope(self) -> ca.SX:
        return self.slope(self.energy)

    @property
    def upper_cutoff(self) -> ca.SX:
        return ca.sqrt(2 + self.alpha + 2 * self.chain.coupling)

    @property
    def lower_cutoff(self) -> ca.SX:
        s = self.chain.coupling
        return ca.sqrt(self.alpha + 2 * self.chain.gamma**2 / (1 + s))

    @property
    def above_band(self) -> ca.SX:
        return self.Omega - self.upper_cutoff

    @property
    def below_band(self) -> ca.SX:
        return self.lower_cutoff - self.Omega

    @property
    def log_amplification(self) -> ca.SX:
        return self.chain.log_amplification

    @property
    def amplification(self) -> ca.SX:
        return ca.exp(self.chain.log_amplification)
