"""Coordinates of a long chain's edge mode: the nonlinear core at its edge, and the linear tail in closed form."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from casadi_skin.lattice import closed_forms as multiple_scales
from casadi_skin.lattice.chain import FIRST, LAST, Chain
from casadi_skin.lattice.full_chain import ChainCoordinates, continued_logarithms
from casadi_skin.lattice.tail import Tail
from casadi_skin.lattice.tail_parameter import Regime, TailParameter
from casadi_skin.lattice.tail_problem import CoreWithTailProblem
from casadi_skin.zero.family import Localised, normalised
from casadi_skin.zero.problem import Array, Indices, Problem
from casadi_skin.zero.settings import Point

FARTHEST_LOG_SCALE = 745.0  # of -log rho: beyond it displacements are below the smallest double
LONGEST_WHOLE = 5000  # sites of a chain all of which are unknowns where they are asked for
BESIDE_CORE = 100  # sites beside the core on which stability is computed at first
SITE_DOUBLINGS = 2  # of the sites, where multipliers that decay into the tail are not decided


class CoreWithTail(ChainCoordinates):
    """A core of nonlinear sites at the edge that the modes lean to; the rest is linear and eliminated.

    Unknowns are those of the chain seen from its other end where gamma < 0. Sites are numbered from 1; those of an
    infinite chain with gamma >= 0 end with site 0. `edge` is that of the band: +1 for the lowest mode, -1 for the
    highest.
    """

    def __init__(self, chain: Chain, core_sites: int, mode: int, stability_sites: int | None = None) -> None:
        super().__init__(chain, replace(chain, sites=core_sites, gamma=abs(chain.gamma)), mode)
        self.edge = -1 if chain.g > 0 else 1
        self._stability_sites = stability_sites

    @property
    def tail(self) -> Tail:
        """The tail, up to the first site of the core."""
        return Tail(self.chain.sites - self.core.sites + 1, self.chain.alpha, self.chain.coupling)

    def parameter(self, harmonics: int) -> TailParameter:
        """The unknown in place of Omega."""
        return TailParameter(self.tail, self.edge, harmonics)

    def transcription(self, resolution: int) -> Problem:
        return CoreWithTailProblem(self.scaled, resolution, self.parameter(resolution))

    @property
    def is_whole(self) -> bool:
        return False

    @property
    def localised(self) -> Localised | None:
        if self._stability_sites is None and self.chain.sites <= LONGEST_WHOLE:
            return None
        sites = (self._stability_sites,) if self._stability_sites is not None else self._as_many_as_decide
        low, high = self.chain.band()
        bands, stiffness = ((math.sqrt(low), math.sqrt(high)),), np.array([[2.0 + self.chain.alpha]])
        return Localised(sites, bands, self.chain.gamma >= 0, stiffness, self.chain.coupling)

    @property
    def _as_many_as_decide(self) -> tuple[int, ...]:
        first = self.core.sites + BESIDE_CORE
        return tuple(int(min(first * 2**k, self.chain.sites)) for k in range(SITE_DOUBLINGS + 1))

    def cut(self, sites: int) -> tuple[Chain, str]:
        return replace(self.chain, sites=sites), LAST if self.chain.g > 0 else FIRST

    def on_cut_sites(self, problem: Problem, z: Array, sites: int) -> Array:
        m = np.arange(sites)
        return self._unknowns(problem, z, m[::-1] if self.chain.gamma >= 0 else m)

    def check_whole(self, purpose: str = "what is asked for") -> None:
        """Raises ValueError where the sites are too many to be unknowns."""
        if self.chain.sites > LONGEST_WHOLE:
            raise ValueError(
                f"sites: given {self.chain.sites}; {purpose} is that of all sites, accepted: up to {LONGEST_WHOLE}"
            )

    def on_all_sites(self, problem: Problem, z: Array) -> Array:
        """The unknowns of the same orbit with odd cosines at every site of a finite chain."""
        return self._unknowns(problem, z, self.distances(None))

    def _unknowns(self, problem: Problem, z: Array, distances: Indices) -> Array:
        theta = (np.arange(problem.resolution) + 0.5) * np.pi / (2 * problem.resolution)
        positions = self._positions(problem, z, theta, distances)
        return np.concatenate([positions.T.ravel(), [problem.frequency(z), z[problem.parameter_index]]])

    @property
    def description(self) -> str:
        sites = f"{self.core.sites} sites at the edge, where the cubic term is felt"
        return f"the gauge; unknown are {sites}, and the linear tail is eliminated exactly"

    def regime(self, point: Point) -> Regime:
        """Whether Omega, or three times it, is pinned to the band."""
        assert isinstance(point.problem, CoreWithTailProblem)
        return point.problem.regime(point.z)

    @cached_property
    def threshold(self) -> float:
        """S at which the end breather of the infinite chain is born."""
        return float(self.chain.threshold())

    @cached_property
    def _signs(self) -> Array:
        """Of the band edge's mode: e^m at distance m from the edge, first site of the core first."""
        return np.where(np.arange(self.core.sites)[::-1] % 2 == 0, 1.0, float(self.edge))

    @cached_property
    def mode(self) -> Array:
        m = np.arange(self.core.sites, 0, -1)
        finite = np.isfinite(self.chain.sites)
        q = np.sin(m * np.pi / (self.chain.sites + 1)) if finite else m.astype(float)
        return normalised(self._signs * q, self.core.rho)

    @property
    def linear_profile(self) -> tuple[Array, Array]:
        u = self.core.rho * self.mode
        u = u if self.chain.gamma >= 0 else u[::-1]
        u = u * np.sign(u[np.argmax(np.abs(u))])
        return np.log10(np.abs(u) / np.linalg.norm(u)), np.sign(u)

    @property
    def frequency(self) -> float:
        return self.chain.linear_frequency(self.mode_number)

    @property
    def start_unknown(self) -> float:
        m = float(self.core.sites)
        if not np.isfinite(self.chain.sites):
            return self.parameter(2).at(float(np.arctan2(m + 1.0, m)))
        theta = np.pi / (self.chain.sites + 1)
        return self.parameter(2).at(float(np.arctan2(np.sin((m + 1.0) * theta), np.sin(m * theta))))

    def first_order_frequency(self, S: Array) -> Array | None:
        chain = self.chain
        if chain.infinite:
            return None
        parameters = (chain.sites, chain.alpha, chain.gamma, chain.g, self.mode_number)
        return np.asarray(multiple_scales.frequency(*parameters, S))

    @property
    def output_sites(self) -> Indices:
        core, N = np.arange(1, self.core.sites + 1), self.chain.sites
        if self.chain.gamma < 0:
            return core
        return np.asarray(core - self.core.sites + (N if np.isfinite(N) else 0), dtype=np.int64)

    @property
    def position_names(self) -> tuple[str, ...]:
        return tuple(f"y_{n}" for n in self.output_sites)

    # Sites ----------------------------------------------------------------------------------------------------------

    def distances(self, sites: Indices | None) -> Indices:
        """Distances of sites from the edge that the modes lean to; raises ValueError for sites that are not there."""
        N, towards_last = self.chain.sites, self.chain.gamma >= 0
        if sites is None:
            sites = np.arange(1, N + 1) if np.isfinite(N) else self.output_sites
        last = N if np.isfinite(N) else 0
        distances = np.asarray(last - sites if towards_last else sites - 1, dtype=np.int64)
        if distances.size and (distances.min() < 0 or distances.max() >= N):
            known = (
                f"1 to {N}" if np.isfinite(N) else "whole numbers up to 0" if towards_last else "whole numbers from 1"
            )
            raise ValueError(f"sites: given {sites.min()} to {sites.max()}; accepted: {known}")
        return distances

    def displacements(self, problem: Problem, z: Array, theta: Array, sites: Indices | None) -> Array:
        m = self.distances(sites)
        decay = m * np.arctanh(abs(self.chain.gamma))
        seen = decay < FARTHEST_LOG_SCALE
        y = np.zeros((theta.size, m.size))
        y[:, seen] = self._positions(problem, z, theta, m[seen]) * np.exp(-decay[seen])
        return y

    def positions(self, problem: Problem, z: Array, theta: Array) -> Array:
        """Gauge positions of all sites of a finite chain, shape (len(theta), sites)."""
        return self._positions(problem, z, theta, self.distances(None))

    def _positions(self, problem: Problem, z: Array, theta: Array, m: Indices) -> Array:
        q = np.empty((theta.size, m.size))
        inside = m < self.core.sites
        q[:, inside] = problem.sample(z, theta)[:, self.core.sites - 1 - m[inside]]
        harmonics = np.cos(np.outer(theta, 2 * np.arange(problem.resolution) + 1))
        q[:, ~inside] = harmonics @ self.tail_coefficients(problem, z, m[~inside] - self.core.sites + 1)
        return q

    def _log_tail(self, problem: Problem, z: Array, m: Indices) -> tuple[Array, Array]:
        """Natural logarithms of |q_n| at phase zero at distances m from the edge, and signs; -inf and 0 in the core."""
        steps = m[m >= self.core.sites] - self.core.sites + 1
        logs, signs = np.full(m.size, -np.inf), np.zeros(m.size)
        if steps.size:
            by_harmonic, their_signs = self._tail_logs(problem, z, steps)
            largest = np.max(by_harmonic, axis=0)
            total = np.sum(their_signs * np.exp(by_harmonic - largest), axis=0)
            with np.errstate(divide="ignore"):
                logs[m >= self.core.sites] = largest + np.log(np.abs(total))
            signs[m >= self.core.sites] = np.sign(total)
        return logs, signs

    def log_solved(self, point: Point, z: Array, smallest: float) -> tuple[Array, Array]:
        return continued_logarithms(self.core, point, z, smallest)

    def log_displacements(
        self, point: Point, solved: tuple[Array, Array], sites: Indices | None
    ) -> tuple[Array, Array]:
        m = self.distances(sites)
        inside, place = m < self.core.sites, self.core.sites - 1 - m
        logs, signs = self._log_tail(point.problem, point.z, m)
        logs[inside], signs[inside] = solved[0][place[inside]], solved[1][place[inside]]
        return logs - np.arctanh(abs(self.chain.gamma)) * m, signs

    def tail_coefficients(self, problem: Problem, z: Array, steps: Indices) -> Array:
        """Coefficients of cos((2 h + 1) theta), `steps` sites beyond the core's first, shape (harmonics, steps)."""
        logs, signs = self._tail_logs(problem, z, steps)
        return signs * np.exp(logs)

    def _tail_logs(self, problem: Problem, z: Array, steps: Indices) -> tuple[Array, Array]:
        """Natural logarithms and signs of `tail_coefficients`."""
        assert isinstance(problem, CoreWithTailProblem)
        values, first = problem.values(z), problem.coefficients(z)[0]
        c, d = self.tail.sites, np.asarray(steps, dtype=float)
        logs, signs = np.empty((problem.resolution, d.size)), np.empty((problem.resolution, d.size))
        for h, psi in enumerate(values.psi):
            wave, sign = self.tail.wave(float(psi)), self.edge if h == 0 else -1
            decay, ratio = -wave.kappa * d, np.ones(d.size)
            if wave.kappa > 0.0:
                if np.isfinite(c):
                    ratio = np.expm1(-2.0 * (c - d) * wave.kappa) / np.expm1(-2.0 * c * wave.kappa)
            elif wave.theta > 0.0:
                ratio = np.sin((c - d) * wave.theta) / np.sin(c * wave.theta)
            else:  # at the edge of the band of an infinite chain
                ratio = 1.0 + d * (np.tan(psi) - 1.0)
            ratio = first[h] * ratio * np.where(d % 2 == 0, 1.0, sign)
            with np.errstate(divide="ignore"):
                logs[h], signs[h] = decay + np.log(np.abs(ratio)), np.sign(ratio)
        return logs, signs

    # Sums over all sites --------------------------------------------------------------------------------------------

    def energy(self, problem: Problem, z: Array) -> float:
        """Infinite where an infinite tail moves along, as below the threshold.

        In the tail L a_k = (k Omega)^2 a_k: products of two harmonics add up to a term at its end (Green's identity).
        """
        assert isinstance(problem, CoreWithTailProblem)
        q, values = problem.sample(z, np.zeros(1))[0], problem.values(z)
        core = float(self._hamiltonian(q, np.zeros(q.size), z[problem.parameter_index]))
        s, first = self.chain.coupling, problem.coefficients(z)[0]
        beside = first * values.across / values.down
        squares = ((2.0 * np.arange(problem.resolution) + 1.0) * values.Omega) ** 2
        apart = squares[None, :] - squares[:, None]
        np.fill_diagonal(apart, 1.0)
        products = -s * (np.outer(beside, first) - np.outer(first, beside)) / apart
        waves = (self.tail.wave(float(psi)) for psi in values.psi)
        np.fill_diagonal(products, [f**2 * self.tail.squares(wave) for f, wave in zip(first, waves, strict=True)])
        return core - 0.5 * s * float(q[0] * np.sum(beside)) + 0.5 * float(np.sum(products @ squares))

    def Omega_shift(self, problem: Problem, z: Array) -> float:
        """Beside the band from its edge; in the band by projection, as for a chain of unknown sites alone."""
        assert isinstance(problem, CoreWithTailProblem)
        values = problem.values(z)
        wave, s, N = self.tail.wave(float(values.psi[0])), self.chain.coupling, self.chain.sites
        finite = bool(np.isfinite(N))
        theta = float(np.pi / (N + 1)) if finite else 0.0
        omega = float(np.sqrt(self.tail.edge_squared(self.edge) + 4.0 * self.edge * s * np.sin(0.5 * theta) ** 2))
        if wave.kappa > 0.0:
            below = self.tail.outside(wave) + np.sin(0.5 * theta) ** 2
            return float(-4.0 * self.edge * s * below / (values.Omega + omega))
        if not finite:
            return 0.0
        m = np.arange(self.core.sites, 0, -1)
        phi = self._signs * np.sin(m * theta)
        cubic, overlap, _ = self.projected(problem, z, phi)
        first = problem.coefficients(z)[0, 0] * self._signs[0] / np.sin(self.tail.sites * wave.theta)
        overlap += float(first) * _product_sum(int(self.tail.sites) - 1, wave.theta, theta)
        return float(float(z[problem.parameter_index]) * cubic / overlap / (values.Omega + omega))


def _product_sum(count: int, a: float, b: float) -> float:
    """sum over n = 1 .. count of sin(n a) sin(n b)."""

    def kernel(x: float) -> float:
        return float(np.sin((count + 0.5) * x) / (2.0 * np.sin(0.5 * x))) if abs(x) * count > 1e-8 else count + 0.5

    return 0.5 * (kernel(a - b) - kernel(a + b))
