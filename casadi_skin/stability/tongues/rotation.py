"""Signed rotation angles of multipliers, followed along a branch from the linear modes that they begin as."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.problem import Array

Booleans = NDArray[np.bool_]
TWO_PI = 2.0 * np.pi
FASTEST_RATE_FACTOR = 4.0  # times the median rate: faster angles are those of mu about to meet, whose rates say little
CERTAIN_ANGLE_FRACTION = 0.5  # of the distance to the next angle: how far one may be from where it is expected


@dataclass(frozen=True)
class Spectrum:
    """All mu at a coordinate, shape (m,), with d mu/d coordinate and Krein signatures (0 off the circle)."""

    coordinate: float
    mu: ComplexArray
    rates: ComplexArray
    signatures: NDArray[np.int64]

    def angles(self) -> tuple[Array, Array]:
        """Signed angles and their rates, (m,) each; two complex mu have the angles that they met with."""
        on_circle = self.signatures != 0
        cosine = np.clip(1.0 + 2.0 * self.mu.real, -1.0, 1.0)
        lambdas = (np.sqrt(self.mu) + np.sqrt(1.0 + self.mu)) ** 2
        size = np.where(on_circle, np.arccos(cosine), np.abs(np.angle(lambdas)))
        sign = np.where(on_circle, self.signatures, np.where(self.mu.imag < 0.0, -1, 1))
        with np.errstate(divide="ignore", invalid="ignore"):
            rates = np.where(on_circle, -2.0 * self.rates.real / np.sqrt(1.0 - cosine**2), 0.0) * sign
        limit = FASTEST_RATE_FACTOR * float(np.median(np.abs(rates[on_circle]))) if on_circle.any() else 0.0
        return sign * size, np.where(np.abs(rates) <= limit, rates, 0.0)


@dataclass(frozen=True)
class Tracks:
    """Rotation angles along a branch, continuous, one column a linear mode, followed in two ways.

    `angles` (2, places, m) at `coordinates`: each angle goes to the nearest one, or all keep their order around the
    circle. Where two angles of one signature meet, they pass or avoid each other: what differs then is not certain.
    """

    modes: tuple[int, ...]
    coordinates: Array
    angles: Array

    def meetings(self, coordinates: Array, angles: Array, alone: Booleans) -> list[tuple[int, int, int] | None]:
        """Modes (k, n) and the order of each meeting at an angle in [0, pi]; one mode twice where it is `alone`.

        None where it is not certain which angles meet.
        """
        right = np.clip(np.searchsorted(self.coordinates, coordinates), 1, self.coordinates.size - 1)
        low, high = self.coordinates[right - 1], self.coordinates[right]
        weight = np.clip((coordinates - low) / (high - low), 0.0, 1.0)[:, None]
        here = (1.0 - weight) * self.angles[:, right - 1] + weight * self.angles[:, right]
        (first, sure), (second, sure_too) = _nearest(here, angles), _nearest(here, -angles)
        second, sure_too = np.where(alone, first, second), sure_too | alone
        sure &= sure_too & (alone | (first != second))
        each = np.take_along_axis(here, np.stack([first, second], axis=2), 2)
        orders = np.round(np.sum(each, axis=2) / TWO_PI).astype(np.int64)
        modes = np.sort(np.array(self.modes)[np.stack([first, second], axis=2)], axis=2)
        known = np.concatenate([modes, orders[..., None]], axis=2)
        certain = np.all(sure, axis=0) & np.all(known[0] == known[1], axis=1)
        return [
            (k, n, m) if sure else None for (k, n, m), sure in zip(known[0].tolist(), certain.tolist(), strict=True)
        ]


def _nearest(angles: Array, wanted: Array) -> tuple[NDArray[np.int64], Booleans]:
    """The angle nearest to each one, modulo 2 pi, and whether no other is nearly as near; angles (2, wanted, m)."""
    distance = np.abs((angles - wanted[:, None] + np.pi) % TWO_PI - np.pi)
    first = np.argmin(distance, axis=2)
    if angles.shape[2] == 1:
        return first, np.ones(first.shape, dtype=bool)
    least = np.partition(distance, 1, axis=2)
    return first, least[..., 0] <= CERTAIN_ANGLE_FRACTION * least[..., 1]


def follow_angles(
    spectra: Sequence[Spectrum], frequencies: Mapping[int, float], start: float, duration: float
) -> Tracks | None:
    """Rotation angles of linear modes along a branch.

    Arguments:
        spectra: at coordinates in ascending order.
        frequencies: of the linear modes by number, without the one that the branch begins as.
        start: coordinate of the linear modes, where the branch has zero amplitude.
        duration: time that M takes there.

    Returns:
        The angles, or None where the numbers of modes and of mu differ.
    """
    modes = tuple(frequencies)
    if not spectra or len(modes) != spectra[0].mu.size:
        return None
    first = duration * np.array([frequencies[k] for k in modes])
    places = [(spectrum.coordinate, *spectrum.angles()) for spectrum in spectra]
    courses = [_course(first, places, start, assign) for assign in (_to_the_nearest, _in_cyclic_order)]
    return Tracks(modes, np.array([start, *(spectrum.coordinate for spectrum in spectra)]), np.array(courses))


Assignment = Callable[[Array, Array, Array], NDArray[np.int64]]


def _course(first: Array, places: Sequence[tuple[float, Array, Array]], start: float, assign: Assignment) -> Array:
    """Angles from the first ones on, shape (1 + places, m), by coordinates with the angles and their rates there."""
    course, before, rates = [first], start, np.zeros(first.size)
    for coordinate, angles, slopes in places:
        step = coordinate - before
        share = 0.5 if len(course) > 1 else 0.0  # of the step by the rates before it, which linear modes have none of
        ahead, back = course[-1] + share * step * rates, angles - (1.0 - share) * step * slopes
        distance = (back[None, :] - ahead[:, None] + np.pi) % TWO_PI - np.pi
        chosen = assign(course[-1], angles, distance)
        course.append(ahead + distance[np.arange(first.size), chosen] + (angles - back)[chosen])
        before, rates = coordinate, slopes[chosen]
    return np.array(course)


def _to_the_nearest(before: Array, after: Array, distance: Array) -> NDArray[np.int64]:
    """Which angle each one goes to where the sum of distances from what rates predict is smallest."""
    moves = np.abs(distance)
    nearest = np.argmin(moves, axis=1)
    if np.unique(nearest).size == nearest.size:  # then no other sum is smaller
        return np.asarray(nearest, dtype=np.int64)
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching  # scipy.optimize takes long to load

    costs = csr_array(1.0 + moves)  # with no entry zero, which would be none
    return np.asarray(min_weight_full_bipartite_matching(costs)[1], dtype=np.int64)


def _in_cyclic_order(before: Array, after: Array, distance: Array) -> NDArray[np.int64]:
    """The same among assignments that keep the order around the circle."""
    first, second = np.argsort(before % TWO_PI), np.argsort(after % TWO_PI)
    each = np.arange(first.size)
    turned = (each - each[:, None]) % first.size  # row by row by one place more
    moves = np.sum(np.abs(distance[first, second[turned]]), axis=1)
    chosen = np.empty(first.size, dtype=np.int64)
    chosen[first] = second[turned[np.argmin(moves)]]
    return chosen
