"""The bounds of the theorem at one number of harmonics, about the zero near a computed orbit; series of orbits."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import dct

from casadi_skin.certify import balls
from casadi_skin.certify.bounds import FiniteInverse, proved_radius
from casadi_skin.certify.certificate import Constants
from casadi_skin.certify.cosine_system import CosineSeries, CosineSystem
from casadi_skin.follow.orbit import Orbit
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from flint import arb

LARGEST = 6000  # finite unknowns: the inverse takes a minute and a gigabyte
STEPS = 12  # of the iteration that refines the coefficients
SAMPLES = 128  # in half a period, of orbits that need all cosines


@dataclass(frozen=True, eq=False)
class Attempt:
    """The bounds at one number of harmonics about refined coefficients, with the distance of the computed orbit."""

    series: CosineSeries
    nu: arb
    constants: Constants
    radius: float  # about the refined coefficients; nan without a proof
    distance: float
    size: float
    fault: str = ""  # why there are no bounds

    @property
    def proved(self) -> bool:
        """Whether the theorem holds."""
        return bool(self.radius < np.inf)

    def better_than(self, other: Attempt) -> bool:
        """Whether this one proves more, or comes nearer to a proof."""
        if self.proved and other.proved:
            return self.radius < other.radius
        return self.proved or (not other.proved and self.constants.Z < other.constants.Z)


def attempt_of(orbit: Orbit, system: CosineSystem, harmonics: int, weight: float) -> Attempt:
    from flint import arb

    computed = computed_series(orbit, system, harmonics)
    coefficients = [[a.mid() for a in row[:harmonics]] for row in computed.coefficients]
    return attempt_near(CosineSeries(system, computed.square.mid(), coefficients), arb(weight), computed)


def computed_series(orbit: Orbit, system: CosineSystem, harmonics: int) -> CosineSeries:
    """The doubles of an orbit as balls: its frequency, and at least so many of its coefficients and all it has."""
    from flint import arb

    count = max(harmonics, carrying(orbit, system))
    columns = cosine_coefficients(orbit, system, count).T.tolist()
    rows = [[arb(c) / d for c in column] for column, d in zip(columns, system.scale, strict=True)]
    return CosineSeries(system, arb(orbit.Omega) ** 2, rows)


def cosine_coefficients(orbit: Orbit, system: CosineSystem, count: int) -> Array:
    """Coefficients of the harmonics of an orbit in doubles, shape (count, positions)."""
    sites = np.arange(system.positions) + (1 if system.tail is None else system.tail.first_site)
    if system.step == 2:
        return orbit.coefficients(count, sites)
    samples = max(count, SAMPLES)
    phases = (np.arange(samples) + 0.5) * np.pi / samples
    coefficients = dct(orbit.evaluate(phases / orbit.Omega, sites), axis=0) / samples
    coefficients[0] *= 0.5
    return np.asarray(coefficients[:count])


def carrying(orbit: Orbit, system: CosineSystem) -> int:
    """How many harmonics carry an orbit at its tolerance."""
    if system.step == 2:
        return orbit.harmonics
    sizes = np.max(np.abs(cosine_coefficients(orbit, system, SAMPLES)), axis=1)
    return int(np.flatnonzero(sizes > orbit.space.tolerance * np.max(sizes))[-1]) + 1


def attempt_near(start: CosineSeries, nu: arb, computed: CosineSeries | None = None) -> Attempt:
    """The bounds about the zero that Newton's method finds near a series, and its distance from the computed orbit."""
    try:
        _check_size(start.system, start.harmonics)
        inverse = FiniteInverse(start, nu)
        series = refined(inverse)
        constants = FiniteInverse(series, nu, inverse.matrix).constants()
    except ValueError as error:  # too many unknowns, a singular matrix, or a tail in the band
        nan = float("nan")
        return Attempt(start, nu, Constants(nan, nan, nan, nan), nan, nan, nan, fault=str(error))
    radius = proved_radius(constants)
    away = distance(start if computed is None else computed, series, nu)
    size = balls.above(norm(series, nu))
    return Attempt(series, nu, constants, float("nan") if radius is None else radius, away, size)


def _check_size(system: CosineSystem, harmonics: int) -> None:
    """Raises ValueError where the finite part has too many unknowns."""
    unknowns = 1 + system.positions * harmonics
    if unknowns > LARGEST:
        words = f"{unknowns} unknowns of {system.positions} positions and {harmonics} harmonics"
        raise ValueError(f"{words}, accepted: up to {LARGEST}")


def refined(inverse: FiniteInverse) -> CosineSeries:
    """Coefficients after steps of Newton's method with a fixed inverse, as numbers of more digits than doubles have."""
    from flint import arb

    series, last = inverse.series, np.inf
    for _ in range(STEPS):
        residual = np.array([float(value) for value in inverse.residual(series)[0]])
        step = inverse.matrix @ residual
        largest = float(np.max(np.abs(step)))
        if not largest < 0.5 * last:
            break
        last = largest
        changes = step[1:].reshape(series.system.positions, -1).tolist()
        coefficients = [
            [(a - arb(change)).mid() for a, change in zip(row, changed, strict=True)]
            for row, changed in zip(series.coefficients, changes, strict=True)
        ]
        series = CosineSeries(series.system, (series.square - arb(float(step[0]))).mid(), coefficients)
    return series


def norm(series: CosineSeries, nu: arb) -> arb:
    harmonic, total = series.system.harmonic, abs(series.square)
    for row in series.coefficients:
        for i, a in enumerate(row):
            total += abs(a) * nu ** harmonic(i)
    return total


def distance(one: CosineSeries, other: CosineSeries, nu: arb) -> float:
    """Upper bound of the norm of a difference; terms that only one series has count."""
    from flint import arb

    nothing = arb(0)
    pairs = zip(one.coefficients, other.coefficients, strict=True)
    rows = [[a - b for a, b in zip_longest(*pair, fillvalue=nothing)] for pair in pairs]
    return balls.above(norm(CosineSeries(one.system, one.square - other.square, rows), nu))
