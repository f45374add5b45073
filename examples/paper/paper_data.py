"""The computations behind the figures and claims of arXiv:2512.17483, each done when it is first needed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casadi_skin import (
    Branch,
    Chain,
    Evolution,
    Orbit,
    TransientGrowth,
    closed_forms,
    follow_family,
    simulate_orbit,
)

SITES, ALPHA, GAMMA = 24, 1.0, 0.25
MODES = (1, 6, 10, 14, 18, 24)
AMPLITUDE_MAX = 3.0
REPRESENTATIVE_S = 0.2
TOLERANCE = 1e-9
STATED_Q = {0.25: 0.06, 0.4: 0.07, 0.55: 0.10, 0.7: 0.15}  # figure 4: of e^(-qN), by gamma
STATED_P = {24: 2.0, 32: 2.5, 42: 3.0}  # its inset: of r^-p, by N
SIZE_GAMMAS = tuple(STATED_Q)
SIZES = tuple(range(4, 101, 4))  # the paper gives no range
GAMMA_SIZES = tuple(STATED_P)
GAMMAS = tuple(np.round(np.arange(0.05, 0.801, 0.05), 2))
FINITE_DIFFERENCE_S = 0.01
KICK = 0.005
KICK_TIME = 40.0
EVOLUTION_TIME = 50.0

Array = NDArray[np.float64]
Rows = tuple[Sequence[str], Sequence[Mapping[str, object]]]


def table(**columns: ArrayLike) -> Rows:
    """Names and rows of columns of one length; a single value stands in all rows."""
    values = [column.tolist() for column in np.broadcast_arrays(*columns.values())]
    return list(columns), [dict(zip(columns, row, strict=True)) for row in zip(*values, strict=True)]


def stacked(tables: Sequence[Rows]) -> Rows:
    """Tables with the same columns, one below the other."""
    return tables[0][0], [row for _, rows in tables for row in rows]


@dataclass(frozen=True)
class Sensitivity:
    """Sensitivity factor of mode 1, g = 1: `numerical` from a two-point difference, `analytical` by multiple scales."""

    gamma: Array
    N: Array
    numerical: Array
    analytical: Array

    @property
    def cube(self) -> Array:
        """(N+1)^3."""
        return np.asarray((self.N + 1.0) ** 3)

    @property
    def cube_limit(self) -> Array:
        """Limit of (N+1)^3 times the factor for large N."""
        return np.array([sensitivity_limit(ALPHA, float(gamma), 1.0, 1) for gamma in self.gamma])

    def table(self) -> Rows:
        """All of it as columns."""
        return table(**vars(self), cube_times_analytical=self.cube * self.analytical, cube_limit=self.cube_limit)


def sensitivity(sites: int, alpha: float, gamma: float, g: float, mode: int) -> float:
    """Sensitivity factor |d((Omega - omega_j)/omega_j)/dS| (paper, equation for the sensitivity)."""
    omega = np.sqrt(closed_forms.squared_frequency(sites, alpha, gamma, mode))
    return abs(closed_forms.frequency_slope(sites, alpha, gamma, g, mode)) / float(omega)


def sensitivity_limit(alpha: float, gamma: float, g: float, mode: int) -> float:
    """Limit of (N+1)^3 times the sensitivity factor of a fixed mode as N grows, 0 < |gamma| < 1.

    Near the edge the sines become m j pi/(N+1), and the sums of m^4 r^-m and m^2 r^-m are polylogarithms, of orders -4
    and -2. Raises ValueError for another gamma.
    """
    if not 0.0 < abs(gamma) < 1.0:
        raise ValueError(f"gamma: given {gamma!r}; accepted: 0 < |gamma| < 1")
    lowest = alpha + 2.0 * gamma**2 / (1.0 + closed_forms.gauge_coupling(gamma))
    return float(0.75 * abs(g) * (np.pi * mode / gamma) ** 2 * (3.0 - 2.0 * gamma**2) / lowest)


def analytical_sensitivity(N: int, gamma: float) -> float:
    """Sensitivity factor of mode 1, g = 1, by multiple scales."""
    return sensitivity(N, ALPHA, gamma, 1.0, 1)


class PaperData:
    """The computations behind the paper; `say` takes the current computation in words.

    Parameters of the paper: N = 24, alpha = 1, gamma = 0.25, g = +1 and -1.
    """

    def __init__(self, say: Callable[[str], None] = lambda words: None) -> None:
        self._say = say

    @staticmethod
    def chain(g: float) -> Chain:
        """The paper's chain with cubic coefficient g."""
        return Chain(SITES, ALPHA, GAMMA, g)

    # Families (figures 3, 5, 7) -------------------------------------------------------------------------------------

    @cached_property
    def hardening(self) -> dict[int, Branch]:
        """Families of g = +1 by mode, with stability."""
        return {mode: self._family(+1.0, mode) for mode in MODES}

    @cached_property
    def softening(self) -> dict[int, Branch]:
        """Families of g = -1 by mode, with stability."""
        return {mode: self.end_breather if mode == 1 else self._family(-1.0, mode) for mode in MODES}

    def _family(self, g: float, mode: int) -> Branch:
        self._say(f"family j = {mode}, g = {g:+g}")
        at = (REPRESENTATIVE_S, 1.0, 2.0, 3.0)
        branch = follow_family(
            self.chain(g), mode, AMPLITUDE_MAX, at=at, stability=True, tolerance=TOLERANCE, corrector="ipopt"
        )
        if not branch.complete:
            raise ArithmeticError(f"family j = {mode}, g = {g:+g}: {branch.reason}")
        return branch

    @cached_property
    def end_breather(self) -> Branch:
        """The family of figure 5: j = 1, g = -1."""
        return self._family(-1.0, 1)

    @cached_property
    def hardening_orbit(self) -> Orbit:
        """The representative mode of figure 3(b): j = 24, g = +1, S = 0.2."""
        branch = self.hardening[24] if "hardening" in self.__dict__ else self._family(+1.0, 24)
        orbit: Orbit = branch.at(S=REPRESENTATIVE_S)
        return orbit

    @cached_property
    def softening_orbit(self) -> Orbit:
        """The representative mode of figure 3(e): j = 1, g = -1, S = 0.2."""
        orbit: Orbit = self.end_breather.at(S=REPRESENTATIVE_S)
        return orbit

    # Time evolution (figures 3 and 6) -------------------------------------------------------------------------------

    def evolution(self, orbit: Orbit) -> Evolution:
        """The unperturbed mode in time."""
        self._say("time evolution of a mode")
        return simulate_orbit(orbit, np.linspace(0.0, EVOLUTION_TIME, 501))

    def kicked(self, site: int) -> Evolution:
        """The stable softening mode with its displacement at one site, from 1, changed by KICK."""
        self._say(f"time evolution after a kick at site {site}")
        t = np.linspace(0.0, KICK_TIME, 401)
        return simulate_orbit(self.softening_orbit, t, KICK, site=site)

    @cached_property
    def growth(self) -> TransientGrowth:
        """Transient growth of perturbations of the stable softening mode."""
        self._say("transient growth")
        return self.softening_orbit.transient_growth()

    # Sensitivity (figure 4) -----------------------------------------------------------------------------------------

    @cached_property
    def sensitivity_by_size(self) -> dict[float, Sensitivity]:
        """Sensitivity against N for each gamma of figure 4."""
        return {gamma: self._sensitivity([(N, gamma) for N in SIZES]) for gamma in SIZE_GAMMAS}

    @cached_property
    def sensitivity_by_gamma(self) -> dict[int, Sensitivity]:
        """Sensitivity against gamma for each N of the inset of figure 4."""
        return {N: self._sensitivity([(N, gamma) for gamma in GAMMAS]) for N in GAMMA_SIZES}

    def _sensitivity(self, cases: list[tuple[int, float]]) -> Sensitivity:
        self._say(f"sensitivity at N = {cases[0][0]}, gamma = {cases[0][1]:g} and on")
        numerical = np.array([self._two_point_slope(Chain(N, ALPHA, gamma, 1.0)) for N, gamma in cases])
        analytical = np.array([analytical_sensitivity(N, gamma) for N, gamma in cases])
        N, gamma = zip(*cases, strict=True)
        return Sensitivity(np.array(gamma), np.array(N), numerical, analytical)

    @staticmethod
    def _two_point_slope(chain: Chain) -> float:
        """(Omega(S) - omega)/(omega S) at S = 0.01, the paper's finite difference, from the shift itself."""
        S = FINITE_DIFFERENCE_S
        branch = follow_family(chain, 1, S, at=(S,), tolerance=1e-8, corrector="newton")
        orbit: Orbit = branch.at(S=S)
        return orbit.Omega_shift / (S * chain.linear_frequency(1))
