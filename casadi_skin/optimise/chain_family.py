"""The family of one mode of a chain, in the gauge, with gamma, alpha, g or the stiffness of every site free.

The weights w_n = ((1 - |gamma|)/(1 + |gamma|))^m, m sites from the edge that the modes lean to, are at most 1 for every
chain; they are polynomials in a ratio, so that gamma may be a symbol.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import short_repr
from casadi_skin.model.ode import OdeModel
from casadi_skin.optimise.observables import FamilyEquations, FreeNumber
from casadi_skin.zero.problem import Array

STEEPEST = 0.99  # |gamma| where no bound is given: beyond it the band is nearly a point


@dataclass(frozen=True)
class ChainFamily:
    """One mode's family of a chain; `mirrored` says that modes lean to the first site (gamma <= 0)."""

    model: Chain
    mode: int
    mirrored: bool = False

    @classmethod
    def of(cls, chain: Chain, mode: int | str | None) -> ChainFamily:
        """Of the end breather's mode unless one is given; raises ValueError for a chain that a search does not take."""
        if chain.infinite:
            raise ValueError("chain: given an infinite chain; accepted: a whole number of sites")
        if chain.g == 0:
            raise ValueError("g: given 0; accepted: not 0 (every orbit would be a linear mode)")
        return cls(chain, chain.mode_number(mode if mode is not None else "last" if chain.g > 0 else "first"))

    @property
    def size(self) -> int:
        """Number of components."""
        return self.model.sites

    @property
    def columns(self) -> tuple[str, ...]:
        """Parameters that tables show."""
        return ("gamma", "alpha", "g")

    @property
    def free(self) -> Mapping[str, FreeNumber]:
        """Parameters that may be free."""
        chain = self.model
        gammas = (0.0, STEEPEST) if chain.gamma >= 0 else (-STEEPEST, 0.0)
        signs = (0.0, math.inf) if chain.g > 0 else (-math.inf, 0.0)
        each = tuple(f"alpha_{n}" for n in range(1, chain.sites + 1))
        return {
            "gamma": FreeNumber(chain.gamma, *gammas, ("gamma",)),
            "alpha": FreeNumber(chain.alpha, -math.inf, math.inf, ("alpha",)),
            "g": FreeNumber(chain.g, *signs, ("g",)),
            "alpha_n": FreeNumber(chain.alpha, -math.inf, math.inf, each),
        }

    def limited(self, bounds: Mapping[str, tuple[float, float]]) -> ChainFamily:
        """The family for parameters within bounds; raises ValueError for bounds that cannot be."""
        if "alpha" in bounds and "alpha_n" in bounds:
            raise ValueError("free: given alpha and alpha_n; accepted: one of them")
        lower, upper = bounds.get("gamma", (self.model.gamma, self.model.gamma))
        if max(abs(lower), abs(upper)) >= 1:
            raise ValueError(f"gamma: given {short_repr([lower, upper])}; accepted in a search: |gamma| < 1")
        if lower < 0 < upper:
            given, reason = short_repr([lower, upper]), "a mirrored chain has -gamma, and its gauge is another"
            raise ValueError(f"bounds[gamma]: given {given}; accepted: bounds on one side of 0 ({reason})")
        low, high = bounds.get("g", (self.model.g, self.model.g))
        if not (low >= 0 and high > 0 if self.model.g > 0 else low < 0 and high <= 0):
            side = ">= 0" if self.model.g > 0 else "<= 0"
            raise ValueError(f"bounds[g]: given {short_repr([low, high])}; accepted: bounds {side}, as the chain's g")
        return replace(self, mirrored=upper <= 0 if "gamma" in bounds else self.model.gamma < 0)

    # Expressions ----------------------------------------------------------------------------------------------------

    def equations(self, values: Mapping[str, ca.SX], S: ca.SX) -> FamilyEquations:
        """The equations of an orbit; parameters that are missing have the chain's own values."""
        chain, N = self.model, self.model.sites
        gamma, g = values.get("gamma", ca.SX(chain.gamma)), values.get("g", ca.SX(chain.g))
        alpha_n = values.get("alpha_n", ca.repmat(values.get("alpha", ca.SX(chain.alpha)), N, 1))
        alpha, coupling = ca.sum1(alpha_n) / N, ca.sqrt((1 - gamma) * (1 + gamma))
        size = -gamma if self.mirrored else gamma
        powers = [((1 - size) / (1 + size)) ** m for m in range(N)]
        w, q = ca.vertcat(*(powers if self.mirrored else reversed(powers))), ca.SX.sym("q", N)
        zero = ca.SX.zeros(1)
        beside = ca.vertcat(zero, q[:-1]) + ca.vertcat(q[1:], zero) if N > 1 else zero
        elastic = ca.dot(q, (2 + alpha_n) * q) / 2 - coupling * ca.dot(q[1:], q[:-1])
        log_amplification = (N - 1) * ca.atanh(size)
        upper, lower = ca.sqrt(2 + alpha + 2 * coupling), ca.sqrt(alpha + 2 * gamma**2 / (1 + coupling))
        shared = {
            "gamma": gamma,
            "alpha": alpha,
            "g": g,
            "alpha_n": alpha_n,
            "upper_cutoff": upper,
            "lower_cutoff": lower,
            "amplification": ca.exp(log_amplification),
            "log_amplification": log_amplification,
            "roughness": ca.sumsqr(alpha_n[1:] - alpha_n[:-1]),
        }
        return FamilyEquations(
            state=q,
            S=S,
            acceleration=-(2 + alpha_n) * q + coupling * beside - g * S * w * q**3,
            weights=w,
            energy=S * (elastic + g * S * ca.dot(w, q**4) / 4),
            shared=shared,
            own={"above_band": lambda o: o.Omega - upper, "below_band": lambda o: lower - o.Omega},
        )

    # Numbers --------------------------------------------------------------------------------------------------------

    def at(self, values: Mapping[str, Any]) -> Chain | None:
        """The chain of these parameters; None of a nonuniform one."""
        uniform = len(set(np.atleast_1d(values.get("alpha_n", 0.0)).tolist())) == 1
        return self._mean(values) if uniform else None

    def _mean(self, values: Mapping[str, Any]) -> Chain:
        """The chain with the mean stiffness."""
        alpha = float(np.mean(values.get("alpha_n", values.get("alpha", self.model.alpha))))
        gamma, g = (float(values.get(name, getattr(self.model, name))) for name in ("gamma", "g"))
        return replace(self.model, alpha=alpha, gamma=gamma, g=g)

    def scale(self, values: Mapping[str, Any], S: float) -> Array:
        """Factors that make displacements of q, shape (components,)."""
        return np.asarray(np.sqrt(S) * self._mean(values).rho)

    def plain(self, values: Mapping[str, Any], S: float) -> tuple[OdeModel, float]:
        """The equations of q as a model with one parameter, and the value of that at S."""
        chain = self._mean(values)
        model = chain.gauge_model()
        if "alpha_n" in values:
            uneven = ca.SX(np.asarray(values["alpha_n"]) - chain.alpha)
            model = replace(model, rhs=model.rhs - uneven * model.state, hamiltonian=None)
        return model, chain.g * S

    def members(self, values: Mapping[str, Any], amplitudes: Sequence[float], tolerance: float) -> list[Orbit] | None:
        """The orbits at amplitudes; None of a nonuniform chain. Raises ValueError and ArithmeticError."""
        at, chain = sorted(set(amplitudes)), self.at(values)
        if chain is None:
            return None
        branch = follow_family(chain, self.mode, at[-1], at=at, tolerance=tolerance, tail="full")
        return [branch.at(S=S) for S in amplitudes]

    def nodes(self, orbit: Orbit, theta: Array) -> Array:
        """q of a member at phases, shape (components, phases)."""
        return orbit.point.problem.sample(orbit.point.z, theta).T
