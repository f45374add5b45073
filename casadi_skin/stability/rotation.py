"""Signed rotation angles of multipliers, followed along a branch from the linear modes that they begin as.

lambda(M) = exp(i p) on the unit circle has p = signature times arccos(1 + 2 mu), and at small amplitude mode k has
p = omega_k t, t the time that M takes. Angles of one signature keep their cyclic order; where p_k + p_l is a multiple
of 2 pi, multipliers of opposite signatures meet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.stability.reduction import ComplexArray

TWO_PI = 2.0 * np.pi
FASTEST = 4.0  # times the median rate: faster angles are those of mu about to meet, whose rates say little
CERTAIN = 0.5  # of the distance to the next angle: how far one may be from where it is expected


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
        limit = FASTEST * float(np.median(np.abs(rates[on_circle]))) if on_circle.any() else 0.0
        return sign * size, np.where(np.abs(rates) <= limit, rates, 0.0)


@dataclass(frozen=True)
class Tracks:
    """Rotation angles along a branch: `angles` (places, m) at `coordinates`, continuous, one column a linear mode."""

    modes: tuple[int, ...]
    coordinates: Array
    angles: Array

    def meeting(self, coordinate: float, angle: float, alone: bool) -> tuple[int, int, int] | None:
        """Modes (k, l) and the order of a meeting at `angle` in [0, pi]; one mode twice where it is `alone`.

        None where it is not certain which angles meet.
        """
        here = np.array([np.interp(coordinate, self.coordinates, column) for column in self.angles.T])
        first = _nearest(here, angle)
        second = first if alone else _nearest(here, -angle)
        if first is None or second is None or (not alone and first == second):
            return None
        order = round(float(here[first] + here[second]) / TWO_PI)
        low, high = sorted((self.modes[first], self.modes[second]))
        return low, high, order


def _nearest(angles: Array, wanted: float) -> int | None:
    """The angle nearest to one, modulo 2 pi; None where another one is nearly as near."""
    distance = np.abs((angles - wanted + np.pi) % TWO_PI - np.pi)
    order = np.argsort(distance)
    if distance.size > 1 and distance[order[0]] > CERTAIN * distance[order[1]]:
        return None
    return int(order[0])


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
    from scipy.optimize import linear_sum_assignment

    modes = tuple(frequencies)
    if not spectra or len(modes) != spectra[0].mu.size:
        return None
    course, coordinates = [duration * np.array([frequencies[k] for k in modes])], [start]
    rates = np.zeros(len(modes))
    for spectrum in spectra:
        angles, slopes = spectrum.angles()
        step = spectrum.coordinate - coordinates[-1]
        if coordinates[-1] == start and len(course) == 1:
            rates = np.zeros(len(modes))
        ahead, back = course[-1] + 0.5 * step * rates, angles - 0.5 * step * slopes
        if len(course) == 1:
            back = angles - step * slopes
        distance = (back[None, :] - ahead[:, None] + np.pi) % TWO_PI - np.pi
        _, chosen = linear_sum_assignment(np.abs(distance))
        moved = ahead + distance[np.arange(len(modes)), chosen] + (angles - back)[chosen]
        course.append(moved)
        coordinates.append(spectrum.coordinate)
        rates = slopes[chosen]
    return Tracks(modes, np.array(coordinates), np.array(course))
