"""The family that all programs follow, what each has to report, and the unit that carries times between machines."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin import Chain
from casadi_skin.theory.linear import standing_wave

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FamilyCase:
    """Family of mode 1 of the softening chain, from the linear mode at S = 0, with points at `at`; ends at the last."""

    sites: int = 24
    at: tuple[float, ...] = (0.2, 1.0, 3.0)

    @property
    def chain(self) -> Chain:
        """The chain of all measurements in this folder."""
        return Chain(self.sites, 1.0, 0.25, -1.0)

    @property
    def omega(self) -> float:
        """Frequency at S = 0."""
        return self.chain.linear_frequency(1)

    @property
    def start(self) -> Array:
        """Linear mode in the gauge with sum_n w_n q_n^2 = 1, shape (sites,)."""
        q = standing_wave(self.sites, 1)
        return np.asarray(q / np.sqrt(np.sum(self.chain.weights * q**2)))


@dataclass(frozen=True)
class Family:
    """What a program found at its points, in their order: S, Omega and largest |multiplier| (None: not computed)."""

    S: Array
    Omega: Array
    multiplier: Array | None = None


@dataclass(frozen=True)
class Timed:
    """A family with the wall times of all counted repeats, and of one 193 x 193 solve beside them, in seconds.

    Least times are compared: what other programs on the machine add is never negative.
    """

    family: Family
    seconds: tuple[float, ...]
    unit: float


def timed(follow: Callable[[], Family], repeats: int) -> Timed:
    """Follow the family once uncounted, then `repeats` times; the unit is timed before and after."""
    family, units, seconds = follow(), [unit_seconds()], []
    for _ in range(repeats):
        started = time.perf_counter()
        family = follow()
        seconds.append(time.perf_counter() - started)
    units.append(unit_seconds())
    return Timed(family, tuple(seconds), min(units))


def unit_seconds(repeats: int = 500) -> float:
    """Median time of one numpy.linalg.solve on a dense 193 x 193 system."""
    generator = np.random.default_rng(0)
    matrix, right = generator.normal(size=(193, 193)), generator.normal(size=193)
    seconds = []
    for _ in range(repeats):
        started = time.perf_counter()
        np.linalg.solve(matrix, right)
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds))


def largest_multiplier(quarter: Array) -> float:
    """Largest |multiplier| from the flow over a quarter of the period, shape (2N, 2N).

    With blocks [[A, B], [C, D]] the eigenvalues mu of B^T C give those of the half, z + 1/z = 2 + 4 mu.
    """
    n = len(quarter) // 2
    mu = np.linalg.eigvals(quarter[:n, n:].T @ quarter[n:, :n]).astype(complex)
    z = 1.0 + 2.0 * mu + 2.0 * np.sqrt(mu) * np.sqrt(mu + 1.0)
    return float(np.max(np.maximum(abs(z), 1.0 / abs(z))) ** 2)
