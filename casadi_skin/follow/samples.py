"""Samples of a branch, and whether quantities g_k(sigma) have roots on a stretch between them that are isolated.

Each is known with its derivative at both ends of a stretch and at a place between. A cubic through the ends predicts
the value in between; by how much it fails there bounds the errors of the cubics through neighbouring samples, which
have the shape 16 t^2 (1 - t)^2, 0 <= t <= 1, and the slope 32 t (1 - t) (1 - 2 t). The roots of a quantity are isolated
where none, or one that is simple, is within that bound.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.point import LocalCurve
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import FULL_TURN, turned
from casadi_skin.zero.problem import Array, Indices
from casadi_skin.zero.settings import Point

STILL_RATE = 1e-12  # rate of a parameter that does not change
CERTAIN_SIGN_NOISE = 8.0  # of a quantity's noise: its size from which its sign is its own
GROUP_DISTANCE = 1e6  # distance of values of different groups


@dataclass(frozen=True, eq=False)
class Sample:
    """A point with its eigenvalues, their rates and the second derivative of z along the branch.

    Attributes:
        point: the point.
        row: the metric times the tangent, which closes the equations there.
        values: eigenvalues of dF/dy, shape (n,).
        rates: their rates along the unit tangent.
        noise: rounding errors of the eigenvalues.
        bend: the second derivative of z by the length along the branch; None where it is not looked at.
        orientation: the sign of the determinant of the Jacobian closed by `row`.
        leading: values and rates of other quantities that matter, in place of the rate of the parameter.
        turn: period of the imaginary parts: 2 pi of logarithms of multipliers, infinite of eigenvalues.
        groups: a number for each value where only values of one group may be the same elsewhere; None where all may.
        still: sizes up to which the leading quantities, or the rate of the parameter, are zero.
    """

    point: Point
    row: Array
    values: ComplexArray
    rates: ComplexArray
    noise: Array
    bend: Array | None = None
    orientation: float = 1.0
    leading: tuple[tuple[float, float], ...] | None = None
    turn: float = np.inf
    groups: Indices | None = None
    still: Array | float = STILL_RATE

    @property
    def symmetric(self) -> bool:
        """Whether with each eigenvalue its opposite is one, as where an energy is conserved, declared or not."""
        apart = np.min(np.abs(self.values[:, None] + self.values), axis=1)
        return bool(np.all(apart <= self.noise) and np.any(self.values))

    def apart(self, values: ComplexArray, others: ComplexArray) -> Array:
        """Distances of values from others, shape (values, others)."""
        difference = turned(values[:, None] - others, self.turn)
        if self.groups is not None and difference.shape == (self.groups.size, self.groups.size):
            difference = np.where(self.groups[:, None] == self.groups, difference, GROUP_DISTANCE)
        return np.abs(difference)

    def along(self, row: Array) -> tuple[float, float, float]:
        """By sigma = row . z: that of the length along the branch, and two derivatives of the parameter."""
        rate, t = float(row @ self.point.tangent), float(self.point.tangent[-1])
        if self.bend is None:
            return 1.0 / rate, t / rate, 0.0
        return 1.0 / rate, t / rate, float((self.bend[-1] * rate - t * (row @ self.bend)) / rate**3)


SAMPLE_FRACTION = (
    0.47  # of a stretch: the place of its sample; not the middle, where symmetric functions agree by accident
)
CUBIC_ERROR_BOUND = 0.25  # of the error of a cubic between two ends: four times that of cubics of half the length
COMMON_ERROR_MARGIN = (
    0.1  # of the change of a quantity between two samples: is added, for errors that two cubics have in common
)
# Without a sample on a part: of the error of the cubic at its start, and of the change of a quantity on it, or of its
# distance from zero where that is less, as a quantity that grows by half and more comes to no more than that.
PART_ERROR_BOUND, PART_ERROR_MARGIN = 8.0, 0.8
_NEAR_ENDS = 0.5 ** np.arange(6.0, 24.0, 2.0)
HALF_STRETCH_PLACES = np.concatenate(
    [[0.0], _NEAR_ENDS[::-1], np.linspace(0.0, 1.0, 17)[1:-1], 1.0 - _NEAR_ENDS, [1.0]]
)  # of half a stretch
REAL_EIGENVALUE_RTOL = 1e-6  # of an eigenvalue: an imaginary part that is none


class _Cubics(NamedTuple):
    """Places on the parts of a stretch, values and derivatives of quantities there; each (part, place, quantity)."""

    places: Array
    values: Array
    slopes: Array


class Crossing(NamedTuple):
    """A value, or a pair, that crosses the axis on a stretch.

    Attributes:
        quantity: its place at the first end.
        kind: of the special point that it means.
        angle: its imaginary part.
        jump: by how many the number of unstable values grows.
    """

    quantity: int
    kind: str
    angle: float
    jump: int


@dataclass(frozen=True, eq=False)
class SampledStretch:
    """A stretch of branch between two ends, with a sample between them where there is one.

    Attributes:
        samples: first, middle (or not) and last.
        sigma: their places, by sigma = row . (z - z of the first).
        real: whether eigenvalues count that are real at every sample alone, or all by their real parts.
    """

    samples: tuple[Sample, ...]
    sigma: Array
    real: bool

    @classmethod
    def of(cls, samples: tuple[Sample, ...], real: bool = False) -> SampledStretch:
        """The stretch through samples in order."""
        first = samples[0]
        sigma = np.array([float(first.row @ (sample.point.z - first.point.z)) for sample in samples])
        return cls(samples, sigma, real)

    @cached_property
    def curve(self) -> LocalCurve:
        """The cubic in z through the ends."""
        first, last = self.first.point, self.last.point
        return LocalCurve.through(first.z, first.tangent, last.z, last.tangent, self.first.row)

    @property
    def first(self) -> Sample:
        return self.samples[0]

    @property
    def last(self) -> Sample:
        return self.samples[-1]

    def reach(self, point: Point) -> float:
        """The largest distance of the parameter at samples from that at a point, also where it turns between them."""
        away = max(abs(sample.point.parameter - point.parameter) for sample in self.samples)
        return float(away / point.problem.parameter_size(point.z))

    @property
    def length(self) -> float:
        return float(self.sigma[-1])

    @property
    def leading(self) -> int:
        """Number of quantities before the eigenvalues: the rate of the parameter, unless there are others."""
        return 1 if self.first.leading is None else len(self.first.leading)

    @property
    def turns(self) -> bool:
        """Whether the parameter turns back an odd number of times."""
        rates = [float(end.point.tangent[-1]) for end in (self.first, self.last)]
        return bool(_sign(rates[0]) != _sign(rates[1]) and max(np.abs(rates)) > STILL_RATE)

    @property
    def reorients(self) -> bool:
        """Whether an odd number of other branches is met."""
        return self.first.orientation * self.last.orientation < 0.0

    # Quantities -----------------------------------------------------------------------------------------------------

    @cached_property
    def orders(self) -> tuple[Indices, ...]:
        """For each eigenvalue of the first sample its place in each of the samples."""
        found = [np.arange(self.first.values.size)]
        for one, other, length in zip(self.samples, self.samples[1:], np.diff(self.sigma), strict=False):
            found.append(matched(one, other, float(length), self.first.row)[found[-1]])
        return tuple(found)

    @property
    def order(self) -> Indices:
        """For each eigenvalue of the first end its place at the last."""
        return self.orders[-1]

    @cached_property
    def quantities(self) -> tuple[Array, Array]:
        """Leading quantities, then the quantities of each eigenvalue; and derivatives; (sample, quantity)."""
        sums, rates, noisy, many = [], [], [], self.leading
        for sample, order in zip(self.samples, self.orders, strict=True):
            scale, rate, curved = sample.along(self.first.row)
            values, slopes = sample.values[order], scale * sample.rates[order]
            no = _unreal(values) if self.real else np.abs(values.real) <= sample.noise[order]
            leading = ((rate, curved),) if sample.leading is None else [(g, scale * d) for g, d in sample.leading]
            sums.append(np.concatenate([[g for g, _ in leading], values.real]))
            rates.append(np.concatenate([[d for _, d in leading], slopes.real]))
            noisy.append(np.concatenate([np.abs([g for g, _ in leading]) <= sample.still, no]))
        counts = ~(np.any(noisy, axis=0) if self.real else np.all(noisy, axis=0))
        counts[:many] = ~np.all(noisy, axis=0)[:many]
        return np.array(sums) * counts, np.array(rates) * counts

    @cached_property
    def _halves(self) -> tuple[_Cubics, Array]:
        """Cubics between neighbouring samples, and the bounds of their errors, shape (part, 1, quantity)."""
        g, d = self.quantities
        parts = [_looked_at(g[k : k + 2], d[k : k + 2] * length) for k, length in enumerate(np.diff(self.sigma))]
        cubics = _Cubics(*(np.array(part) for part in zip(*parts, strict=True)))
        return cubics, CUBIC_ERROR_BOUND * self._missed + COMMON_ERROR_MARGIN * np.ptp(
            cubics.values, axis=1, keepdims=True
        )

    @cached_property
    def _missed(self) -> Array:
        """By how much the cubics through the ends fail at the sample between them, shape (quantity,)."""
        g, d = self.quantities
        if len(self.samples) < 3:
            return np.zeros(g.shape[1])
        place = np.full((1, g.shape[1]), self.sigma[1] / self.length)
        value, slope = hermite_cubic(g[[0, -1]], d[[0, -1]] * self.length, place)
        return np.asarray(np.abs(g[1] - value[0]) + np.abs(d[1] * self.length - slope[0]) / 7.0)

    @cached_property
    def isolates_roots(self) -> NDArray[np.bool_]:
        """Whether each quantity has no root within the bounds, or a simple one that shows at the ends.

        It is simple where the quantity rises, or falls, wherever it may vanish.
        """
        g, _ = self.quantities
        cubics, bound = self._halves
        t = cubics.places
        sign = _sign(g[0])
        off, shaky = bound * 16.0 * (t * (1.0 - t)) ** 2, bound * np.abs(32.0 * t * (1.0 - t) * (1.0 - 2.0 * t))
        clear = np.all(sign * cubics.values > off, axis=(0, 1))
        steady = _sign(g[-1] - g[0]) * cubics.slopes >= shaky
        steady = np.all(steady | (np.abs(cubics.values) > off), axis=(0, 1))
        still = np.all(g == 0.0, axis=0)
        return np.asarray(still | np.where(sign != _sign(g[-1]), steady, clear))

    def keeps_signs(self, part: int) -> bool:
        """Whether no quantity vanishes on the part behind a sample, within bounds that need no sample on it."""
        g, d = self.quantities
        ends, length = slice(part, part + 2), self.sigma[part + 1] - self.sigma[part]
        t, values, _ = _looked_at(g[ends], d[ends] * length)
        towards = _sign(g[part]) * values
        bound = PART_ERROR_BOUND * self._missed + PART_ERROR_MARGIN * np.minimum(np.ptp(values, axis=0), towards)
        clear = np.all(towards > bound * 16.0 * (t * (1.0 - t)) ** 2, axis=0)
        return bool(np.all(clear & (_sign(g[part]) == _sign(g[part + 1])) | np.all(g == 0.0, axis=0)))

    @property
    def changed(self) -> NDArray[np.bool_]:
        """Whether each quantity has one sign at the first end and the other one at the last."""
        g, _ = self.quantities
        return np.asarray(_sign(g[0]) != _sign(g[-1]))

    def crossings(self, kinds: tuple[str, str, str]) -> Iterator[Crossing]:
        """Values whose real part changes its sign: each real one, at 0 or at half a turn, and one of each pair."""
        turn = self.first.turn
        for k in np.flatnonzero(self.changed[self.leading :]):
            first, last = self.first.values[k], self.last.values[self.order[k]]
            share = abs(first.real) / (abs(first.real) + abs(last.real))
            height = (1.0 - share) * first.imag + share * last.imag
            real = is_real(first, turn) and is_real(last, turn)
            if real or height > 0.0:
                outside = last if last.real > 0.0 else first  # real multipliers that change their sign pass zero inside
                angle, sign = float(abs(outside.imag) if real else height), 1 if last.real > first.real else -1
                kind = kinds[2] if not real else kinds[1] if angle else kinds[0]
                yield Crossing(int(k), kind, angle, sign if real else 2 * sign)

    def suspected_double_root(self) -> float | None:
        """A place where a quantity of one sign at the samples seems to have the other one; None where there is none."""
        g, _ = self.quantities
        towards = _sign(g[0]) * self._halves[0].values
        same = np.all(_sign(g) == _sign(g[0]), axis=0) & ~self.isolates_roots
        least = np.where(same, np.min(towards, axis=(0, 1)) / np.maximum(np.max(np.abs(g), axis=0), 1e-300), 1.0)
        if not np.any(least <= 0.0):
            return None
        quantity = int(np.argmin(least))
        return float(self._places(quantity)[np.argmin(towards[..., quantity])] / self.length)

    def root(self, quantity: int | None) -> float:
        """Where a quantity vanishes by its cubics; the first one of an eigenvalue that changes its sign where None."""
        if quantity is None:
            quantity = self.leading + int(np.argmax(self.changed[self.leading :]))
        sigma = self._places(quantity)
        order = np.argsort(sigma)
        sigma, values = sigma[order], self._halves[0].values[..., quantity].ravel()[order]
        k = int(np.argmax(_sign(values) != _sign(values[0])))
        if k == 0:
            return 0.5 * self.length
        share = values[k - 1] / (values[k - 1] - values[k])
        return float(sigma[k - 1] + share * (sigma[k] - sigma[k - 1]))

    def _places(self, quantity: int) -> Array:
        """Places, by sigma, at which the cubics of a quantity are evaluated."""
        return np.asarray(
            self.sigma[:-1, None] + self._halves[0].places[..., quantity] * np.diff(self.sigma)[:, None]
        ).ravel()


def matched(first: Sample, last: Sample, length: float, row: Array) -> Indices:
    """For each eigenvalue of one sample its place at another: the assignment with the smallest changes."""
    expected = first.values + 0.5 * length * first.along(row)[0] * first.rates
    back = last.values - 0.5 * length * last.along(row)[0] * last.rates
    direct = first.apart(first.values, last.values)
    predicted = first.apart(expected, back)
    return assignment(np.fmin(direct, predicted))  # a rate may overflow


def assignment(costs: Array) -> Indices:
    """For each row a column of its own, with the smallest sum of costs."""
    nearest = np.argmin(costs, axis=1) if costs.size else np.arange(0)
    if len(set(nearest.tolist())) == nearest.size:  # each row has its smallest
        return np.asarray(nearest)
    from scipy.optimize import linear_sum_assignment

    return np.asarray(linear_sum_assignment(costs)[1])


def _sign(values: Array | float) -> Array:
    """1 or -1, at any sample the same for a value that is zero."""
    return np.where(np.asarray(values) >= 0.0, 1.0, -1.0)


def _unreal(values: ComplexArray) -> NDArray[np.bool_]:
    return np.abs(values.imag) > REAL_EIGENVALUE_RTOL * np.abs(values)


def _looked_at(g: Array, d: Array) -> tuple[Array, Array, Array]:
    """Places on a cubic, its extrema among them, with its values and derivatives there; each (place, quantity)."""
    chord = g[1] - g[0]
    quadratic, cubic = 3.0 * chord - 2.0 * d[0] - d[1], d[0] + d[1] - 2.0 * chord
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        root = -quadratic - np.copysign(np.sqrt(quadratic**2 - 3.0 * cubic * d[0]), quadratic)
        extrema = np.array([root / (3.0 * cubic), d[0] / root])
    extrema = np.where((extrema > 0.0) & (extrema < 1.0), extrema, 0.0)
    places = np.concatenate([np.repeat(HALF_STRETCH_PLACES[:, None], g.shape[1], axis=1), extrema])
    return places, *hermite_cubic(g, d, places)


def hermite_cubic(g: Array, d: Array, t: Array) -> tuple[Array, Array]:
    """Values and derivatives at t of cubics by those at 0 and 1, shape (2, quantity)."""
    chord = g[1] - g[0]
    quadratic, cubic = 3.0 * chord - 2.0 * d[0] - d[1], d[0] + d[1] - 2.0 * chord
    values = g[0] + t * (d[0] + t * (quadratic + t * cubic))
    return values, d[0] + t * (2.0 * quadratic + 3.0 * t * cubic)


def is_real(value: complex, turn: float = FULL_TURN) -> bool:
    """Whether an eigenvalue, or the multiplier of a logarithm, is real."""
    return bool(value.imag == 0.0 or abs(value.imag) == 0.5 * turn)
