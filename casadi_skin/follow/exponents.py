"""Floquet exponents along a branch of orbits, as samples of the search for events (see `continuation.search`).

Multipliers mu_k, k = 1 ... m, the trivial ones left out, are smooth along the branch but where two of them meet.
Where they move freely the sample holds, each of shape (m,),

    w_k = log mu_k = log |mu_k| + i arg mu_k,

whose real part vanishes on the unit circle. Where they come in pairs mu, 1/mu, as those of conservative and of
reversible orbits do, it holds, each of shape (m / 2,) and twice, for c = 2 and for c = -2,

    q_k = arsinh(tau_k - c),    tau_k = mu_k + 1 / mu_k,

which is real and vanishes where a pair passes +1 or -1; a pair is on the circle where tau_k is real and in [-2, 2].
Rates are differences to the point one small step along the tangent: it leaves the branch by the square of the step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from casadi_skin.follow.sample import Sample
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.problem import Array, Indices
from casadi_skin.zero.settings import Point

STEP = 1e-5  # of the metric: of differences along the tangent; rates are wrong by some 1e-5, and by rounding / 1e-5
SMALLEST_LOGARITHM = float(np.log(np.finfo(float).tiny))  # of multipliers that are below the smallest double
RECIPROCAL_RTOL = 1e-7  # of a product mu_k mu_l that is 1 by a symmetry; dissipation within a period is seldom less
RECIPROCAL_NOISE = 1e-3  # largest error of a logarithm with which that product may be off
TURN = 2.0 * np.pi


@dataclass(frozen=True, eq=False)
class Exponents:
    """Multipliers of one orbit by their logarithms.

    Attributes:
        values: log mu, shape (m,).
        noise: estimated errors of these, shape (m,).
    """

    values: ComplexArray
    noise: Array

    @classmethod
    def from_floquet(cls, floquet: Floquet) -> Exponents:
        """Those of the multipliers but the trivial ones."""
        moduli = np.log(10.0) * np.asarray(floquet.log10_abs_multipliers)[floquet.trivial :]
        moduli = np.maximum(moduli, SMALLEST_LOGARITHM)
        with np.errstate(over="ignore"):
            noise = np.log1p(floquet.other_errors * np.exp(-moduli))
        return cls(moduli + 1j * np.angle(floquet.others), noise)

    @property
    def pairs(self) -> Indices | None:
        """Places of mu and of 1/mu, shape (m / 2, 2); None where multipliers are not such pairs."""
        left, found = list(range(self.values.size)), []
        if len(left) % 2:
            return None
        while left:
            k = max(left, key=lambda place: abs(self.values[place].real))
            left.remove(k)
            sums = np.abs(turned(self.values[k] + self.values[left]))
            nearest = left[int(np.argmin(sums))]
            if np.min(sums) > RECIPROCAL_RTOL + min(self.noise[k] + self.noise[nearest], RECIPROCAL_NOISE):
                return None
            left.remove(nearest)
            found.append((k, nearest))
        return np.array(found, dtype=int).reshape(-1, 2)

    @property
    def outside(self) -> tuple[int, int]:
        """The number of multipliers outside the circle by their values, and how many may be on either side of it."""
        pairs = self.pairs
        if pairs is None:
            away, noise = self.values.real, self.noise
        else:
            tau, noise = self.traces(pairs)
            away = np.where(tau.imag != 0.0, np.inf, np.abs(tau.real) - 2.0)
        return int(np.count_nonzero(away > 0.0)), int(np.count_nonzero(np.abs(away) <= noise))

    def traces(self, pairs: Indices) -> tuple[ComplexArray, Array]:
        """tau of each pair, mu + 1/mu, and its error."""
        one, other = np.clip(self.values.real[pairs], -300.0, 300.0).T + 1j * self.values.imag[pairs].T
        tau = np.cosh(one) + np.cosh(other)
        slope = np.abs(np.sinh(one)) + np.abs(np.sinh(other))
        noise = np.minimum(self.noise[pairs].max(axis=1), 1.0)
        on_axis = np.abs(tau.imag) <= 0.5 * slope * noise + noise**2
        return np.where(on_axis, tau.real, tau), slope * noise + noise**2


def turned(logarithms: ComplexArray) -> ComplexArray:
    """Logarithms with imaginary parts in [-pi, pi]."""
    return np.asarray(logarithms - 1j * TURN * np.round(logarithms.imag / TURN))


@dataclass(frozen=True, eq=False)
class ExponentSampler:
    """Samples at points of one branch, for one stretch between two of them.

    Attributes:
        alone: the multipliers at a point without their errors, which takes a fraction of the time.
        metric: weights of the unknowns of a point, shape (unknowns,).
        ends: both ends of the stretch with their exponents: other points take the errors that are larger there.
        known: exponents and their rates that have been computed, by the unknowns of their points.
    """

    alone: Callable[[Point], Floquet]
    metric: Callable[[Point], Array]
    ends: Sequence[tuple[Point, Exponents]]
    known: dict[int, tuple[Point, Exponents, Exponents]] = field(default_factory=dict)

    def exponents(self, point: Point) -> tuple[Exponents, Exponents]:
        """Those at a point, and those one step along its tangent in the same order."""
        place = id(point)
        if place not in self.known:
            here = next((exponents for end, exponents in self.ends if end is point), None) or self._alone(point)
            ahead = Exponents.from_floquet(self.alone(beside_on_tangent(point, STEP))).values
            ahead = ahead[nearest_order(here.values, ahead)]
            self.known[place] = point, here, Exponents(ahead, here.noise)
        return self.known[place][1:]

    def _alone(self, point: Point) -> Exponents:
        """Exponents with the errors of the nearest ones at the ends."""
        values = Exponents.from_floquet(self.alone(point)).values
        noise = [end.noise[nearest_order(values, end.values)] for _, end in self.ends]
        return Exponents(values, np.max(noise, axis=0))

    def free(self, point: Point, own: Point) -> Sample:
        """The sample of multipliers that move freely, at a point that `own` has in the unknowns of the stretch."""
        here, ahead = self.exponents(point)
        rates = turned(ahead.values - here.values) / STEP
        return self._sample(own, here.values, rates, here.noise, TURN)

    def paired(self, point: Point, own: Point, passed: float) -> Sample:
        """The sample of multipliers in pairs that may pass `passed`, 1 or -1."""
        here, ahead = self.exponents(point)
        pairs = here.pairs
        assert pairs is not None
        (tau, noise), (moved, _) = here.traces(pairs), ahead.traces(pairs)
        away = tau - 2.0 * passed
        scale = np.sqrt(1.0 + away**2)
        values = np.asarray(np.arcsinh(away), dtype=complex)
        return self._sample(own, values, (moved - tau) / STEP / scale, noise / np.abs(scale), np.inf)

    def _sample(self, own: Point, values: ComplexArray, rates: ComplexArray, noise: Array, turn: float) -> Sample:
        row = self.metric(own) * own.tangent
        return Sample(own, row, values, rates, noise, np.zeros_like(own.z), 1.0, (), turn)


def beside_on_tangent(point: Point, step: float) -> Point:
    """The point a step along the tangent, not corrected."""
    return replace(point, z=point.z + step * point.tangent, better=None)


def nearest_order(first: ComplexArray, last: ComplexArray) -> Indices:
    """For each logarithm its place among others: the assignment with the smallest changes."""
    from scipy.optimize import linear_sum_assignment

    return np.asarray(linear_sum_assignment(np.abs(turned(first[:, None] - last)))[1])


def is_real(logarithm: complex) -> bool:
    """Whether a logarithm is that of a real multiplier."""
    return logarithm.imag == 0.0 or abs(logarithm.imag) == np.pi
