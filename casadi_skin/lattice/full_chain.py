"""Where the sites of a chain are in the unknowns of its orbits: all of them, the edge alone, or a core with a tail."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, Indices, Problem
from casadi_skin.lattice.chain import Chain
from casadi_skin.theory.linear import standing_wave


class Layout(Protocol):
    """How the scaled gauge positions of a family's `core` belong to the sites of its chain."""

    @property
    def core(self) -> Chain:
        """The chain whose equations are solved."""
        ...

    @property
    def mode(self) -> Array:
        """The linear mode at the core's sites with sum_n w_n q_n^2 = 1, shape (core sites,)."""
        ...

    @property
    def output_sites(self) -> Indices:
        """Numbers of the sites that files and pictures show."""
        ...

    def displacements(self, problem: Problem, z: Array, theta: Array, sites: Indices | None) -> Array:
        """rho_n q_n at phases theta of the sites numbered, all by default, shape (len(theta), sites)."""
        ...

    def energy(self, problem: Problem, z: Array, hamiltonian: ca.Function) -> float:
        """Energy of the scaled gauge positions at phase zero, where all velocities vanish."""
        ...

    def Omega_shift(self, problem: Problem, z: Array) -> float:
        """Omega - omega_j, formed without subtraction where the shift is small."""
        ...


def unit_mode(core: Chain, q: Array) -> Array:
    """q scaled to sum_n w_n q_n^2 = 1, largest displacement positive."""
    q = q / np.sqrt(np.sum(core.weights * q**2))
    return np.asarray(q * np.sign(q[np.argmax(np.abs(core.rho * q))]))


def _numbered(sites: Indices | None, count: int) -> Indices:
    """Indices of sites numbered from 1; raises ValueError for sites that are not there."""
    if sites is None:
        return np.arange(count)
    if sites.size and (sites.min() < 1 or sites.max() > count):
        raise ValueError(f"sites: given {sites.min()} to {sites.max()}; accepted: 1 to {count}")
    return np.asarray(sites - 1, dtype=np.int64)


def projected(problem: Problem, z: Array, core: Chain, phi: Array) -> tuple[float, float, float]:
    """Fundamental of the cubic term and of the positions projected on a mode at the core, and the latter's size.

    In the equations of the fundamental their ratio is (Omega^2 - omega_j^2)/kappa, with no cancellation.
    """
    nodes = max(32, 2 * problem.resolution)
    theta = (np.arange(nodes) + 0.5) * np.pi / (2 * nodes)
    q, cosine = problem.sample(z, theta), np.cos(theta)
    fundamental = (2.0 / nodes) * (cosine @ q)
    cubic = (2.0 / nodes) * float(cosine @ (core.weights * q**3) @ phi)
    return cubic, float(fundamental @ phi), float(np.linalg.norm(fundamental) * np.linalg.norm(phi))


@dataclass(frozen=True)
class FullChain:
    """Every site is an unknown."""

    core: Chain
    mode_number: int

    @property
    def mode(self) -> Array:
        return unit_mode(self.core, standing_wave(self.core.sites, self.mode_number))

    @property
    def output_sites(self) -> Indices:
        return np.arange(1, self.core.sites + 1)

    def displacements(self, problem: Problem, z: Array, theta: Array, sites: Indices | None) -> Array:
        chosen = _numbered(sites, self.core.sites)
        return np.asarray((self.core.rho * problem.sample(z, theta))[:, chosen])

    def energy(self, problem: Problem, z: Array, hamiltonian: ca.Function) -> float:
        q = problem.sample(z, np.zeros(1))[0]
        return float(hamiltonian(q, np.zeros(q.size), z[problem.parameter_index]))

    def Omega_shift(self, problem: Problem, z: Array) -> float:
        Omega, omega = problem.frequency(z), self.core.linear_frequency(self.mode_number)
        cubic, overlap, size = projected(problem, z, self.core, standing_wave(self.core.sites, self.mode_number))
        by_projection = float(z[problem.parameter_index]) * cubic / overlap / (Omega + omega)
        subtraction_is_better = 100.0 * size / abs(overlap) * abs(by_projection) > omega
        return Omega - omega if subtraction_is_better else by_projection


@dataclass(frozen=True)
class EdgeSite(FullChain):
    """At |gamma| = 1 the edge site moves by itself, and the others rest."""

    chain: Chain

    @property
    def output_sites(self) -> Indices:
        return np.arange(1, self.chain.sites + 1)

    @property
    def edge(self) -> int:
        """Index of the site that moves."""
        return self.chain.sites - 1 if self.chain.gamma > 0 else 0

    def displacements(self, problem: Problem, z: Array, theta: Array, sites: Indices | None) -> Array:
        chosen = _numbered(sites, self.chain.sites)
        everywhere = np.zeros((theta.size, chosen.size))
        everywhere[:, chosen == self.edge] = self.core.rho * problem.sample(z, theta)
        return everywhere
