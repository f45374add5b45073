"""The family that all programs follow, what each has to report, and the unit that carries times between machines."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin import Chain
from casadi_skin.lattice.closed_forms import standing_wave

Array = NDArray[np.float64]


@dataclass(frozen=True)
class FamilyCase:
    """Family of mode 1 of the softening chain, from the linear mode at S = 0, with points at `at`; ends at the last."""

    sites: int = 24
    at: tuple[float, ...] = (0.2, 1.0, 3.0)
    gamma: float = 0.25

    @property
    def chain(self) -> Chain:
        """The chain of all measurements in this folder."""
        return Chain(self.sites, 1.0, self.gamma, -1.0)

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
    """A family with the times of all counted repeats, and of a 193 x 193 solve beside each of them, in seconds."""

    family: Family
    seconds: Array
    units: Array

    @property
    def solves(self) -> Array:
        """Times as multiples of the solve measured beside them."""
        return self.seconds / self.units


def timed(follow: Callable[[], Family], repeats: int) -> Timed:
    """Follow the family once uncounted, then `repeats` times, each between two measurements of the unit."""
    family, units, seconds = follow(), [unit_seconds()], []
    for _ in range(repeats):
        started = processor_seconds()
        family = follow()
        seconds.append(processor_seconds() - started)
        units.append(unit_seconds())
    beside = 0.5 * (np.array(units[1:]) + np.array(units[:-1]))
    return Timed(family, np.array(seconds), beside)


def processor_seconds() -> float:
    """Time of a processor spent by this process and by children that have ended; others do not stretch it."""
    used = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


def unit_seconds(repeats: int = 300) -> float:
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
