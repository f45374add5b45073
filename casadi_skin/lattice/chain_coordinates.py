"""Coordinates of the families of a chain: which ones, and why others are refused; all of its sites in its gauge.

At |gamma| = 1 the edge site alone is an unknown, and of a long chain the nonlinear core at its edge (`core_with_tail`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.lattice.chain import Chain, check_no_parameters
from casadi_skin.lattice.closed_forms import standing_wave
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.lattice.declaration import FIXED
from casadi_skin.lattice.lattice import Core, LongLattice, nonlinear_cells
from casadi_skin.lattice.stiffness import square_of_family
from casadi_skin.lattice.tail import Tail
from casadi_skin.model.methods import EVERY_SITE, PAYS_FROM, TRIGONOMETRIC
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.coordinates import Coordinates, Localised, normalised, numbered
from casadi_skin.zero.cosines import cosine_matrix
from casadi_skin.zero.model_coordinates import FIRST, LAST, check_harmonics
from casadi_skin.zero.problem import Array, Indices, Problem
from casadi_skin.zero.settings import Point

if TYPE_CHECKING:
    from casadi_skin.lattice.lattice import Lattice
    from casadi_skin.zero.family import Method


TAIL_PAYS_FACTOR = 8  # times the core's sites from which on the elimination of the tail is cheaper
LONGEST_CORE = 5000


def chain_coordinates(
    chain: Chain, mode: int | str, amplitude_max: float, method: Method, parameters: Mapping[str, float] | None = None
) -> Coordinates:
    """Coordinates of the family that grows from a linear mode to S = `amplitude_max`.

    Every site is an unknown; at |gamma| = 1 the edge site alone; and of a long chain the nonlinear core at its edge
    where the elimination of its linear tail is requested, or pays and `method.tail` leaves it open. Raises
    ValueError, naming the argument, for a chain or a mode without such a family.
    """
    check_no_parameters(parameters)
    number = chain.mode_number(mode)
    square_of_family(chain.sites, **chain.parameters, mode=number)
    if abs(chain.gamma) == 1.0:
        if chain.infinite:
            raise ValueError(
                "sites: given an infinite chain; accepted: with |gamma| = 1 a finite one, whose edge site moves"
            )
        return EdgeSite(chain, number)
    sites = core_sites(chain, amplitude_max)
    obstacle = _obstacle(chain, number, sites, method)
    if obstacle and (method.tail == "eliminated" or chain.infinite):
        given = "an infinite chain" if chain.infinite else '"eliminated"'
        raise ValueError(f"{'sites' if chain.infinite else 'tail'}: given {given}; accepted: {obstacle}")
    if method.tail == "full" and chain.infinite:
        raise ValueError('tail: given "full" with an infinite chain; accepted: eliminated')
    cut = method.stability_sites
    if cut is not None and (obstacle or not sites <= cut <= chain.sites):
        within = f"{sites} to {chain.sites}: so many sites are nonlinear, and so many there are"
        raise ValueError(f"stability_sites: given {cut}; accepted: {f'with {obstacle}' if obstacle else within}")
    eliminated = method.tail == "eliminated" or chain.infinite or cut is not None
    pays = method.tail is None and not obstacle and chain.sites >= max(PAYS_FROM, TAIL_PAYS_FACTOR * sites)
    if not (eliminated or pays):
        check_harmonics(chain.linear_spectrum().squares, number, repr(chain), odd=True)
        return FullChain(chain, number)
    return LongChain(chain, sites, number, amplitude_max, cut)


def core_sites(chain: Chain, amplitude_max: float) -> int:
    """Number of sites at the edge outside of which the cubic term is below round-off, counted to LONGEST_CORE."""
    rate = 2.0 * math.atanh(min(abs(chain.gamma), 1.0 - 1e-16))
    return nonlinear_cells(rate, max(1.0, abs(chain.g) * amplitude_max), LONGEST_CORE)


def _obstacle(chain: Chain, number: int, sites: int, method: Method) -> str:
    """Condition that keeps the tail from being eliminated; empty where it can be."""
    if number != chain.mode_number(LAST if chain.g > 0 else FIRST):
        return "the highest mode with g > 0, or the lowest with g < 0 (others have no limit for long chains)"
    if not 0.0 < abs(chain.gamma) < 1.0:
        return "0 < |gamma| < 1, where a tail exists and is linear"
    if method.transcription not in (None, TRIGONOMETRIC):
        return "transcription trigonometric"
    if sites > LONGEST_CORE:
        return f"a gamma at which fewer than {LONGEST_CORE} sites are nonlinear"
    if sites + 2 > chain.sites:
        return f"more than {sites + 2} sites: so many are nonlinear at this gamma"
    if chain.g < 0 and 9.0 * chain.band()[0] <= chain.band()[1]:
        return "an alpha so large that three times the lowest frequency lies above the band"
    return ""


# Displacements far below the smallest double, as logarithms -----------------------------------------------------------

SMALLEST_STATE_RATIO = 1e-250  # of the largest state: below it doubles run out
LINEAR_STIFFNESS_RATIO = 1e-16  # of the coupling: a stiffness of the cubic term that is round-off
KEPT_HARMONIC_RATIO = 1e-9  # of the largest harmonic at a site: below it a harmonic is what the others leave of it
GAUSS_HARMONICS = 32


def _continued(coefficients: Array, Omega: float, alpha: float, coupling: float, count: int) -> tuple[Array, Array]:
    """Logarithms and signs of the sum of harmonics at sites 1..count, from their coefficients at site count + 1."""
    from scipy.special import logsumexp

    tail = Tail(count, np.array([[2.0 + alpha]]), coupling)
    kept = np.flatnonzero(np.abs(coefficients) > KEPT_HARMONIC_RATIO * np.max(np.abs(coefficients)))
    places = [tail.anywhere(((2 * k + 1) * Omega) ** 2) for k in kept.tolist()]
    phi = np.array([tail.angle(place) for place in places])
    logs, parts = tail.motions(places, phi, coefficients[kept], np.arange(count, 0, -1))
    return logsumexp(logs, axis=0, b=parts[:, :, 0], return_sign=True)


class OfChain:
    """The model of a chain's family: the chain, or the lattice that declares it with values of its parameters."""

    chain: Chain
    mode_number: int
    declared: tuple[Lattice, Mapping[str, float]] | None = None

    @cached_property
    def model(self) -> OdeModel:
        return self.chain.tunable_model() if self.declared is None else self.declared[0]

    @property
    def parameters(self) -> Mapping[str, float]:
        return self.chain.parameters if self.declared is None else self.declared[1]

    @property
    def attributes(self) -> Mapping[str, float]:
        return {"sites": self.chain.sites, **self.parameters} if self.declared is None else self.parameters

    @cached_property
    def frequency(self) -> float:
        return self.chain.linear_frequency(self.mode_number)


class FullChain(OfChain, Coordinates):
    """Every site is an unknown: the equations are those of a `core`, here the chain, in its gauge, with kappa = g S."""

    def __init__(self, chain: Chain, mode: int) -> None:
        self.chain, self.mode_number = chain, mode
        self.core, self._core_mode = chain, mode

    @cached_property
    def scaled(self) -> OdeModel:
        return self.core.gauge_model()

    @property
    def log_scale(self) -> Array:
        return self.core.log_rho

    def parameter_of(self, S: float) -> float:
        return self.chain.g * S

    def S_of(self, parameter: float) -> float:
        return parameter / self.chain.g

    @property
    def description(self) -> str:
        return EVERY_SITE

    def band(self) -> tuple[float, float]:
        return self.chain.band()

    @cached_property
    def mode(self) -> Array:
        return normalised(standing_wave(self.core.sites, self._core_mode), self.core.rho)

    def log_solved(self, point: Point, z: Array, smallest: float) -> tuple[Array, Array]:
        """As those of other coordinates; below `smallest` sites are computed in closed form from those above."""
        core = self.core
        problem = point.problem
        harmonics = problem.cosines or GAUSS_HARMONICS
        theta = (np.arange(harmonics) + 0.5) * np.pi / (2 * harmonics)
        start, values = np.split(problem.sample(z, np.concatenate([[0.0], theta])), [1])
        with np.errstate(divide="ignore"):
            logs, signs = np.log(np.abs(start[0])), np.sign(start[0])
        if core.coupling == 0.0 or core.sites == 1:
            return logs, signs
        # Sites counted from the end that the modes lean away from.
        order = slice(None) if core.gamma >= 0 else slice(None, None, -1)
        sizes = np.max(np.abs(values), axis=0)[order]
        stiffness = abs(point.parameter) * np.max(sizes) ** 2
        if smallest > SMALLEST_STATE_RATIO and stiffness > 0.0:
            smallest = min(smallest, np.sqrt(LINEAR_STIFFNESS_RATIO * core.coupling / stiffness))
        tail = int(np.searchsorted(np.maximum.accumulate(sizes), smallest * np.max(sizes)))
        if tail == 0:
            return logs, signs
        with np.errstate(under="ignore"):
            coefficients = (2.0 / harmonics) * cosine_matrix(harmonics) @ values[:, order][:, tail]
        logs[order][:tail], signs[order][:tail] = _continued(coefficients, point.Omega, core.alpha, core.coupling, tail)
        return logs, signs

    def nonlinear_forces(self, q: Array, parameter: float) -> Array:
        return -parameter * self.core.weights * q**3


class EdgeSite(FullChain):
    """At |gamma| = 1 the edge site moves by itself, and the others rest."""

    def __init__(self, chain: Chain, mode: int) -> None:
        super().__init__(chain, mode)
        self.core, self._core_mode = Chain(1, chain.alpha, 0.0, chain.g), 1

    @property
    def linear_profile(self) -> tuple[Array, Array]:
        logs, signs = np.full(self.chain.sites, -np.inf), np.zeros(self.chain.sites)
        logs[self.edge], signs[self.edge] = 0.0, 1.0
        return logs, signs

    @property
    def output_sites(self) -> Indices:
        return np.arange(1, self.chain.sites + 1)

    @property
    def description(self) -> str:
        return "the edge site alone: at |gamma| = 1 no other site moves in the gauge"

    @property
    def edge(self) -> int:
        """Index of the site that moves."""
        return self.chain.sites - 1 if self.chain.gamma > 0 else 0

    def displacements(self, problem: Problem, z: Array, theta: Array, sites: Indices | None) -> Array:
        chosen = numbered(sites, self.chain.sites)
        everywhere = np.zeros((theta.size, chosen.size))
        everywhere[:, chosen == self.edge] = self.core.rho * problem.sample(z, theta)
        return everywhere

    def log_displacements(
        self, point: Point, solved: tuple[Array, Array], sites: Indices | None
    ) -> tuple[Array, Array]:
        moves = numbered(sites, self.chain.sites) == self.edge
        return np.where(moves, solved[0][0], -np.inf), np.where(moves, solved[1][0], 0.0)

    @property
    def resting(self) -> tuple[int, float]:
        """Linear oscillators that nothing drives in the gauge: without the growth of the Jordan block."""
        return self.chain.sites - 1, self.chain.linear_frequency(1)

    @property
    def without_vectors(self) -> str:
        return "at |gamma| = 1 the vectors form Jordan chains that the gauge does not have"


# A long chain: the nonlinear sites at its edge, and its linear tail eliminated ----------------------------------------

LONGEST_WHOLE = 5000  # sites of a chain all of which are unknowns where they are asked for


def as_long_lattice(chain: Chain) -> LongLattice:
    """A long or infinite chain as the lattice that it is."""
    edge = LAST if chain.gamma >= 0 else FIRST
    return LongLattice(chain.sites, *chain.cell, FIXED, chain.parameters, edge, "chain")


class LongChain(OfChain, CoreWithTail):
    """The edge mode of a long chain."""

    symplectic = True

    def __init__(
        self, chain: Chain, core_sites: int, mode: int, amplitude_max: float, stability_sites: int | None = None
    ) -> None:
        self.chain = chain
        lattice, core = as_long_lattice(chain), Core(core_sites, 0.0)
        edge_mode = lattice.modes[-1 if chain.g > 0 else 0]
        super().__init__(lattice, core, edge_mode, mode, amplitude_max, stability_sites)

    @cached_property
    def threshold(self) -> float:
        """S at which the end breather of the infinite chain is born."""
        return float(self.chain.threshold())

    @cached_property
    def localised(self) -> Localised | None:
        whole = self._stability_sites is None and self.chain.sites <= LONGEST_WHOLE
        return None if whole else super().localised

    def check_whole(self, purpose: str = "what is asked for") -> None:
        """Raises ValueError where the sites are too many to be unknowns."""
        if self.chain.sites > LONGEST_WHOLE:
            raise ValueError(
                f"sites: given {self.chain.sites}; {purpose} is that of all sites, accepted: up to {LONGEST_WHOLE}"
            )

    def on_all_sites(self, problem: Problem, z: Array) -> Array:
        """The unknowns of the same orbit with odd cosines at every site of a finite chain."""
        unit = self.scale[-1 if self.lattice.at_last else 0]
        positions, S = self._on_cells(problem, z, self.chain.sites), self.S_of(float(z[problem.parameter_index]))
        return np.concatenate([unit * positions.ravel(), [problem.frequency(z), self.chain.g * S]])

    def _where(self, sites: Indices | None) -> tuple[Indices, Indices]:
        """Of a finite chain all sites unless they are given."""
        every = None if self.chain.infinite else np.arange(1, self.chain.sites + 1)
        return super()._where(every if sites is None else sites)
