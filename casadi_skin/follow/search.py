"""The search for special points on a stretch of a branch, which is divided until each part is resolved.

Floquet exponents along a branch of orbits, as samples of the search for events (see `Search`).

Multipliers mu_k, k = 1 ... m, the trivial ones left out, are smooth along the branch but where two of them meet.
Where they move freely the sample holds, each of shape (m,),

    w_k = log mu_k = log |mu_k| + i arg mu_k,

whose real part vanishes on the unit circle. Where they come in pairs mu, 1/mu, as those of conservative and of
reversible orbits do, it holds, each of shape (m / 2,) and twice, for c = 2 and for c = -2,

    q_k = arsinh(tau_k - c),    tau_k = mu_k + 1 / mu_k,

which is real and vanishes where a pair passes +1 or -1; a pair is on the circle where tau_k is real and in [-2, 2].
Rates are differences to the point one small step along the tangent: it leaves the branch by the square of the step.

The search for events between two points of a branch of orbits, on the mesh of the second one.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Generic, TypeVar

import numpy as np

from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.stretch import SAMPLE_FRACTION, Sample, Signs, Stretch
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet
from casadi_skin.zero.problem import Array, Indices
from casadi_skin.zero.settings import Point
from casadi_skin.zero.unresolved import Unresolved

DEEPEST_DIVISION = 20  # divisions of a stretch between two points of the continuation
SHORTEST_PART = 1e-11  # of a step: shorter parts are not divided
MOST = 400  # parts that it is divided into
TRIED_PLACES = (SAMPLE_FRACTION, 0.3, 0.7)  # of a stretch, where one point after the other is tried


Event = TypeVar("Event")


class Search(ABC, Generic[Event]):
    """The search on one stretch of the continuation; `parts` counts the parts that it has been divided into.

    `deepest` is how often a part may be divided, `most_parts` how many there may be.
    """

    deepest, most_parts = DEEPEST_DIVISION, MOST

    def __init__(self, signs: Signs) -> None:
        self.signs, self.parts = signs, 0

    @abstractmethod
    def sample(self, point: Point) -> Sample:
        """The sample at a point."""

    @abstractmethod
    def along(self, before: Point, after: Point, fraction: float) -> Point | None:
        """The point at a fraction of the way between two points; None where it is not found."""

    def passes(self, ends: Stretch) -> bool:
        """Whether a part has no special points by its ends alone."""
        return False

    @abstractmethod
    def found(self, stretch: Stretch, depth: int, last: bool) -> Sequence[Event] | None:
        """Special points on a resolved part, in order; None where it has to be divided, unless it is the last."""

    def is_clear(self, point: Point) -> bool:
        """Whether every quantity has its sign at a point, where a stretch may be divided."""
        return True

    def suspected(self, stretch: Stretch) -> float | None:
        """The place at which a stretch is best divided; None where any will do."""
        return stretch.dip()

    @abstractmethod
    def unresolved(self, stretch: Stretch) -> Iterator[Event | Unresolved]:
        """What is known of a part that can be divided no further, and its record."""

    def between(self, before: Point, after: Point, depth: int = 0) -> Iterator[Event | Unresolved]:
        """Special points between two points in order, and the parts that are not resolved."""
        self.parts += 1
        if self.passes(Stretch.of((self.sample(before), self.sample(after)), self.signs)):
            return
        tried = (self.along(before, after, place) for place in TRIED_PLACES)
        middle = next((point for point in tried if point is not None), None)
        points = (before, after) if middle is None else (before, middle, after)
        stretch = Stretch.of(tuple(self.sample(point) for point in points), self.signs)
        last = depth >= self.deepest or self.parts > self.most_parts or stretch.length <= SHORTEST_PART
        found = self.found(stretch, depth, last or middle is None)
        if found is not None:
            yield from found
            return
        if last or middle is None:
            yield from self.unresolved(stretch)
            return
        divided = self._dividing(before, middle, after, self.suspected(stretch))
        yield from self.between(before, divided, depth + 1)
        yield from self.between(divided, after, depth + 1)

    def _dividing(self, before: Point, middle: Point, after: Point, dip: float | None) -> Point:
        """The point at which a stretch is divided."""
        for place in (dip, SAMPLE_FRACTION, *TRIED_PLACES[1:]):
            point = None if place is None else middle if place == SAMPLE_FRACTION else self.along(before, after, place)
            if point is not None and _apart(before, point, after) and self.is_clear(point):
                return point
        return middle


def _apart(*points: Point) -> bool:
    """Whether neighbouring points are not the same but for rounding."""
    return all(float(np.max(np.abs(one.z - other.z))) > SHORTEST_PART for one, other in pairwise(points))


# Floquet exponents along a branch of orbits, as samples of the search for events (see `Search`) ----------

TANGENT_DIFFERENCE_STEP = (
    1e-5  # of the metric: of differences along the tangent; rates are wrong by some 1e-5, and by rounding / 1e-5
)
SMALLEST_LOGARITHM = float(np.log(np.finfo(float).tiny))  # of multipliers that are below the smallest double
RECIPROCAL_RTOL = 1e-7  # of a product mu_k mu_l that is 1 by a symmetry; dissipation within a period is seldom less
RECIPROCAL_NOISE = 1e-3  # largest error of a logarithm with which that product may be off
FULL_TURN = 2.0 * np.pi


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
    return np.asarray(logarithms - 1j * FULL_TURN * np.round(logarithms.imag / FULL_TURN))


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
            ahead = Exponents.from_floquet(self.alone(beside_on_tangent(point, TANGENT_DIFFERENCE_STEP))).values
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
        rates = turned(ahead.values - here.values) / TANGENT_DIFFERENCE_STEP
        return self._sample(own, here.values, rates, here.noise, FULL_TURN)

    def paired(self, point: Point, own: Point, passed: float) -> Sample:
        """The sample of multipliers in pairs that may pass `passed`, 1 or -1."""
        here, ahead = self.exponents(point)
        pairs = here.pairs
        assert pairs is not None
        (tau, noise), (moved, _) = here.traces(pairs), ahead.traces(pairs)
        away = tau - 2.0 * passed
        scale = np.sqrt(1.0 + away**2)
        values = np.asarray(np.arcsinh(away), dtype=complex)
        return self._sample(own, values, (moved - tau) / TANGENT_DIFFERENCE_STEP / scale, noise / np.abs(scale), np.inf)

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


# The search for events between two points of a branch of orbits, on the mesh of the second one ------------------------

DEEPEST_OF_ORBITS = 14  # divisions of a stretch between two orbits
MOST_PARTS = 120  # that such a stretch is divided into
CLEAR_DISTANCE = (
    0.5  # of the changes of a quantity on a stretch: a distance from zero at both ends that needs no sample between
)


class StretchSearch(Search[Event]):
    """The search on one stretch between two points.

    Attributes:
        ends: both ends.
        first, last: these in the unknowns of the second.
        row, length: sigma = row . (z - first.z) is the place along the stretch, from 0 to its length.
        sampler: multipliers at its points.
    """

    deepest, most_parts = DEEPEST_OF_ORBITS, MOST_PARTS

    def __init__(
        self, solver: PointSolver, before: Point, after: Point, alone: Callable[[Point], Floquet],
        exponents: Sequence[Exponents] = (),
    ) -> None:  # fmt: skip
        super().__init__("real parts")
        self.solver, self.ends = solver, (before, after)
        problem = after.problem
        z, tangent = (before.problem.prolong(v, problem) for v in (before.z, before.tangent))
        self.first = replace(before, problem=problem, z=z, tangent=tangent, better=None)
        self.last = after
        self.row = self.metric(self.first) * tangent
        self.length = float(self.row @ (after.z - z))
        self.sampler = ExponentSampler(alone, self.metric, tuple(zip(self.ends, exponents, strict=False)))

    def metric(self, point: Point) -> Array:
        """Weights of the unknowns of a point."""
        return self.solver.metric(point.problem, point.z)

    def own(self, point: Point) -> Point:
        """The point at which multipliers are computed: the first end on its own mesh."""
        return self.ends[0] if point is self.first else point

    def along(self, before: Point, after: Point, fraction: float) -> Point | None:
        correction, tangent = self.solver.corrected_along(before, after, fraction)
        if correction is None or tangent is None:
            return None
        return replace(self.last, z=correction.z, tangent=tangent, better=None, special="", walked=False)

    def passes(self, ends: Stretch) -> bool:
        """Whether every quantity stays far from zero, by its values and rates at both ends."""
        if not (self.is_clear(ends.first.point) or self.is_clear(ends.last.point)):
            return False
        g, d = ends.quantities
        moves = np.abs(g[-1] - g[0]) + ends.length * (np.abs(d[0]) + np.abs(d[-1]))
        clear = (np.sign(g[0]) == np.sign(g[-1])) & (np.min(np.abs(g), axis=0) > CLEAR_DISTANCE * moves)
        return bool(np.all(clear | np.all(g == 0.0, axis=0)))

    def sigma(self, point: Point) -> float:
        """The place of a point along the stretch."""
        return float(self.row @ (point.problem.prolong(point.z, self.last.problem) - self.first.z))

    def outside(self, point: Point) -> tuple[int, int]:
        """The number of multipliers outside the circle at a point, and how many errors leave open."""
        return self.sampler.exponents(self.own(point))[0].outside

    def is_clear(self, point: Point) -> bool:
        return self.outside(point)[1] <= min(self.outside(end)[1] for end in (self.first, self.last))
