"""The intervals of a collocation mesh: equidistribution of a monitor of the solution.

With polynomials of degree d on intervals of length h the error between mesh points is proportional to h^(d+1) times
the derivative of order d + 1. That derivative is estimated from the differences of the constant derivatives of order d
of neighbouring intervals, and its root of order d + 1 is spread evenly (de Boor 1973; Ascher, Mattheij and Russell
1995, section 9.1). Lengths are relative to the whole: they sum to 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from casadi_skin.zero.problem import Array

DENSITY_FLOOR = 0.2  # of the mean density: no interval is longer than 1/DENSITY_FLOOR mean ones
ON_EDGE = 1e-14  # of the whole: distance of a place from an edge that is rounding
NEIGHBOUR_LENGTH_RATIO = 2.0  # largest ratio of the lengths of neighbouring intervals, about


def uniform(intervals: int) -> Array:
    """Equal lengths, shape (intervals,)."""
    return np.full(intervals, 1.0 / intervals)


def graded(intervals: int, smallest: float) -> Array:
    """Lengths that grow by a factor from `smallest` at both ends up to a quarter, between which they are equal."""
    outer = intervals // 3
    left = np.geomspace(smallest, 0.25, outer)
    inner = np.linspace(0.25, 0.75, intervals - 2 * outer + 1)[1:-1]
    return np.diff(np.concatenate([[0.0], left, inner, 1.0 - left[::-1], [1.0]]))


def edges(lengths: Array) -> Array:
    """Ends of the intervals from 0 to 1, shape (intervals + 1,)."""
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    return np.asarray(ends / ends[-1])


@dataclass(frozen=True, eq=False)
class Mesh:
    """Lengths of intervals, each with values at its start and at `ends` of it, and what is made of them, once."""

    lengths: Array
    ends: Array

    @cached_property
    def key(self) -> bytes:
        """Equal for meshes of equal lengths."""
        return self.lengths.tobytes()

    @cached_property
    def edges(self) -> Array:
        """Ends of the intervals from 0 to 1, shape (intervals + 1,)."""
        return edges(self.lengths)

    @cached_property
    def places(self) -> Array:
        """Places of all values in [0, 1], shape (intervals * ends + 1,)."""
        inner = self.edges[:-1, None] + self.lengths[:, None] * self.ends
        return np.concatenate([[0.0], inner.ravel()])

    @cached_property
    def gaps(self) -> Array:
        """Distances between these."""
        return np.asarray(self.places[1:] - self.places[:-1])


def density(lengths: Array, leading: Array, degree: int, noise: float = 0.0) -> Array:
    """Wanted number of intervals per unit of length, up to a factor, in each interval; shape (intervals,).

    `leading` holds the coefficient of s^degree of each interval's polynomial in its own coordinate s in [0, 1], shape
    (intervals, components); `noise` is the size of its round-off. The density is smoothed, has a floor, and varies
    slowly enough for neighbouring intervals to be of similar length (Kautsky and Nichols 1980).
    """
    K = lengths.size
    if K == 1:
        return np.ones(1)
    scale = lengths**-degree
    jumps = np.max(np.abs(np.diff(leading * scale[:, None], axis=0)), axis=1)
    rounding = noise * (scale[1:] + scale[:-1])
    if not np.any(jumps > rounding):
        return np.ones(K)
    jumps = np.where(jumps > 2.0 * rounding, jumps - rounding, np.min(rounding))  # noise draws none
    slopes = jumps / (0.5 * (lengths[1:] + lengths[:-1]))
    wanted = np.concatenate([slopes[:1], 0.5 * (slopes[1:] + slopes[:-1]), slopes[-1:]]) ** (1.0 / (degree + 1))
    return _slowly_varying(lengths, wanted)


def _slowly_varying(lengths: Array, wanted: Array) -> Array:
    """The smallest density above `wanted` and the floor whose inverse changes no faster than NEIGHBOURS allows."""
    middles = edges(lengths)[1:] - 0.5 * lengths
    padded = wanted
    for _ in range(3):  # floor and rate depend on the mean of the result
        mean = float(lengths @ padded)
        rate = np.log(NEIGHBOUR_LENGTH_RATIO) * lengths.size / mean
        inverse = 1.0 / np.maximum(wanted, DENSITY_FLOOR * mean)
        forward = rate * middles + np.minimum.accumulate(inverse - rate * middles)
        backward = np.minimum.accumulate((inverse + rate * middles)[::-1])[::-1] - rate * middles
        padded = 1.0 / np.minimum(forward, backward)
    return np.asarray(padded)


def equidistributed(lengths: Array, wanted: Array, intervals: int) -> Array:
    """Lengths of `intervals` intervals that hold equal parts of the density `wanted` on the mesh of `lengths`."""
    total = np.concatenate([[0.0], np.cumsum(lengths * wanted)])
    return np.diff(np.interp(np.linspace(0.0, total[-1], intervals + 1), total, edges(lengths)))


def imbalance(lengths: Array, wanted: Array) -> float:
    """Largest over mean part of the density that an interval holds; 1 where it is spread evenly."""
    parts = lengths * wanted
    return float(parts.max() * parts.size / parts.sum())


def with_edges(lengths: Array, places: Array) -> Array:
    """The mesh moved so that an edge is at each of the places, in ascending order between 0 and 1.

    As it is where they are edges already, or are more than there are edges between the intervals.
    """
    inner = lengths.size - 1
    if places.size > inner or not places.size:
        return lengths
    ends = edges(lengths)
    nearest = np.interp(places, ends, np.arange(ends.size))
    if np.all(np.abs(ends[np.round(nearest).astype(int)] - places) < ON_EDGE):
        return lengths
    order = np.arange(places.size)
    chosen = np.maximum.accumulate(np.round(nearest) - order) + order  # each place its own edge
    last = inner - places.size + 1 + order
    chosen = np.clip(np.minimum(chosen, last), 1 + order, last).astype(int)
    fixed = np.concatenate([[0], chosen, [lengths.size]])
    return np.diff(np.interp(ends, ends[fixed], np.concatenate([[0.0], places, [1.0]])))


def resampled(lengths: Array, intervals: int) -> Array:
    """A mesh of another number of intervals placed alike: a multiple of the number divides each interval evenly."""
    return equidistributed(lengths, 1.0 / lengths, intervals)
