"""Coordinates of the families of a chain in its gauge: all of its sites, or at |gamma| = 1 the edge site alone."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.lattice import closed_forms as multiple_scales
from casadi_skin.lattice.chain import Chain
from casadi_skin.lattice.closed_forms import standing_wave
from casadi_skin.lattice.tail import Tail
from casadi_skin.model.methods import EVERY_SITE
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.cosines import cosine_matrix, quarter_phases
from casadi_skin.zero.family import Coordinates, normalised, numbered, shift_by_projection
from casadi_skin.zero.problem import Array, Indices, Problem
from casadi_skin.zero.settings import Point
from casadi_skin.zero.trigonometric import TrigonometricProblem

if TYPE_CHECKING:
    from casadi_skin.lattice.lattice import Lattice


# Displacements far below the smallest double, as logarithms -----------------------------------------------------------

SMALLEST_STATE_RATIO = 1e-250  # of the largest state: below it doubles run out
LINEAR_STIFFNESS_RATIO = 1e-16  # of the coupling: a stiffness of the cubic term that is round-off
KEPT_HARMONIC_RATIO = 1e-9  # of the largest harmonic at a site: below it a harmonic is what the others leave of it
GAUSS_HARMONICS = 32


def continued_logarithms(core: Chain, point: Point, z: Array, smallest: float) -> tuple[Array, Array]:
    """Natural logarithms of |q_n| at t = 0 in the gauge, and the signs, each (core sites,); -inf and 0 where q_n = 0.

    Sites below `smallest` times the largest are computed in closed form from those above.
    """
    problem = point.problem
    harmonics = problem.resolution if isinstance(problem, TrigonometricProblem) else GAUSS_HARMONICS
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


def _continued(coefficients: Array, Omega: float, alpha: float, coupling: float, count: int) -> tuple[Array, Array]:
    """Logarithms and signs of the sum of harmonics at sites 1..count, from their coefficients at site count + 1."""
    tail, logs, parts = Tail(count, np.array([[2.0 + alpha]]), coupling), list[Array](), list[Array]()
    for k in np.flatnonzero(np.abs(coefficients) > KEPT_HARMONIC_RATIO * np.max(np.abs(coefficients))).tolist():
        place = tail.anywhere(((2 * k + 1) * Omega) ** 2)
        phi = tail.angle(place)
        factor, part = tail.motion(place, phi, np.arange(count, 0, -1))
        logs.append(factor)
        parts.append(part[:, 0] * coefficients[k] / np.cos(phi))
    largest = np.max(logs, axis=0)
    total = np.sum(np.array(parts) * np.exp(np.array(logs) - largest), axis=0)
    with np.errstate(divide="ignore"):
        return largest + np.log(np.abs(total)), np.sign(total)


class ChainCoordinates(Coordinates):
    """Base of all coordinates of a chain: the gauge of a `core`, whose equations are solved, and kappa = g S.

    `declared` is the lattice that declares the chain, with values of its parameters, where there is one.
    """

    def __init__(self, chain: Chain, core: Chain, mode: int) -> None:
        self.chain, self.core, self.mode_number = chain, core, mode
        self.declared: tuple[Lattice, Mapping[str, float]] | None = None

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

    @cached_property
    def model(self) -> OdeModel:
        return self.chain.tunable_model() if self.declared is None else self.declared[0]

    @property
    def parameters(self) -> Mapping[str, float]:
        return self.chain.parameters if self.declared is None else self.declared[1]

    @property
    def description(self) -> str:
        return EVERY_SITE

    @property
    def attributes(self) -> Mapping[str, float]:
        return {"sites": self.chain.sites, **self.parameters} if self.declared is None else self.parameters

    def band(self) -> tuple[float, float]:
        return self.chain.band()

    def projected(self, problem: Problem, z: Array, phi: Array) -> tuple[float, float, float]:
        """Fundamental of the cubic term and of the positions projected on a mode at the core, and the latter's size.

        In the equations of the fundamental their ratio is (Omega^2 - omega_j^2)/kappa, with no cancellation.
        """
        nodes = max(32, 2 * problem.resolution)
        theta = quarter_phases(nodes)
        q, cosine = problem.sample(z, theta), np.cos(theta)
        fundamental = (2.0 / nodes) * (cosine @ q)
        cubic = (2.0 / nodes) * float(cosine @ (self.core.weights * q**3) @ phi)
        return cubic, float(fundamental @ phi), float(np.linalg.norm(fundamental) * np.linalg.norm(phi))


class FullChain(ChainCoordinates):
    """Every site is an unknown."""

    def __init__(self, chain: Chain, mode: int) -> None:
        super().__init__(chain, chain, mode)

    @cached_property
    def mode(self) -> Array:
        return normalised(standing_wave(self.core.sites, self.mode_number), self.core.rho)

    @property
    def linear_profile(self) -> tuple[Array, Array]:
        wave = standing_wave(self.chain.sites, self.mode_number)
        sizes = np.where(np.abs(wave) > 1e-13, np.abs(wave), 0.0)
        with np.errstate(divide="ignore"):
            logs = (np.log(sizes) + self.chain.log_rho) / np.log(10.0)
        signs = np.sign(wave) * np.sign(self.mode[np.argmax(np.abs(wave))] * wave[np.argmax(np.abs(wave))])
        return logs - np.log10(np.linalg.norm(self.chain.right_eigenvector(self.mode_number))), signs

    @cached_property
    def frequency(self) -> float:
        return self.core.linear_frequency(self.mode_number)

    def first_order_frequency(self, S: Array) -> Array:
        chain = self.chain
        parameters = (chain.sites, chain.alpha, chain.gamma, chain.g, self.mode_number)
        return np.asarray(multiple_scales.frequency(*parameters, S))

    def log_solved(self, point: Point, z: Array, smallest: float) -> tuple[Array, Array]:
        return continued_logarithms(self.core, point, z, smallest)

    def Omega_shift(self, problem: Problem, z: Array) -> float:
        phi = standing_wave(self.core.sites, self.mode_number)
        cubic, overlap, size = self.projected(problem, z, phi)
        nonlinear = float(z[problem.parameter_index]) * cubic
        return shift_by_projection(problem.frequency(z), self.frequency, nonlinear, overlap, size)


class EdgeSite(ChainCoordinates):
    """At |gamma| = 1 the edge site moves by itself, and the others rest."""

    def __init__(self, chain: Chain, mode: int) -> None:
        super().__init__(chain, Chain(1, chain.alpha, 0.0, chain.g), mode)
        self._alone = FullChain(self.core, 1)

    @property
    def mode(self) -> Array:
        return self._alone.mode

    @property
    def linear_profile(self) -> tuple[Array, Array]:
        logs, signs = np.full(self.chain.sites, -np.inf), np.zeros(self.chain.sites)
        logs[self.edge], signs[self.edge] = 0.0, 1.0
        return logs, signs

    @property
    def frequency(self) -> float:
        return self._alone.frequency

    def first_order_frequency(self, S: Array) -> Array:
        return self._alone.first_order_frequency(S)

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

    def Omega_shift(self, problem: Problem, z: Array) -> float:
        return self._alone.Omega_shift(problem, z)

    @property
    def resting(self) -> tuple[int, float]:
        """Linear oscillators that nothing drives in the gauge: without the growth of the Jordan block."""
        return self.chain.sites - 1, self.chain.linear_frequency(1)

    @property
    def without_vectors(self) -> str:
        return "at |gamma| = 1 the vectors form Jordan chains that the gauge does not have"
