"""A branch of orbits on a mesh that moves with their layers.

At places that are held a layer that passes turns the tangent, and makes any step short. On intervals of the lengths
L(sigma) = L_0 + sigma V + sigma^2 A / 2 the unknowns, at places that move by v, change by

    dz/dsigma = c t + x' v,

with the tangent t at places that are held, the derivative x' in time, and c, the length along the branch by sigma. The
velocity v is linear on each interval, and has the least |t + x' v|^2 + STRETCH_WEIGHT mean |dv/ds|^2: layers are
followed, and what is between them is stretched (moving finite elements: Miller and Miller 1981). sigma is
row . (z - z_0), where the row is orthogonal to x' v at the start, so that c = 1 / (row . t) there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from casadi_skin.native import Structure, kernels
from casadi_skin.native.collocation import LAYERS
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import MOVING_SPEED_RATIO, Point

STRETCH_WEIGHT = 0.1  # of a stretch of an interval by its own length, beside a change of the states by their size
SHORTEST_LENGTH = 0.2  # of that at the start: down to which the mesh moves
PLACE_ATOL, PLACE_ROUNDS = 1e-9, 10  # of another point's sigma, which depends on the mesh there: Newton's method
LEAST_SCALARS = 1e-3  # of the length along the branch: changes of the scalars that another orbit is found by
LEAST_ALIGNED = 0.5  # cosine of the turn from one orbit to another


class Seen(NamedTuple):
    """A point of the branch on the mesh that moves: its place sigma, z there, dz/dsigma, c, and the equations there."""

    sigma: float
    z: Array
    slope: Array
    scale: float
    problem: Any

    @property
    def tangent(self) -> Array:
        """The derivative by the length along the branch."""
        return np.asarray(self.slope / self.scale)


@dataclass(frozen=True, eq=False)
class Moving:
    """The mesh that moves from that of an orbit.

    Attributes:
        problem: the equations on the mesh of the orbit.
        row: that of sigma.
        start: the orbit, at sigma = 0.
        change, bend: V and A, shape (intervals,).
        past: another orbit of the branch, from which A is known; None where none is.
    """

    problem: Any
    row: Array
    start: Seen
    change: Array
    bend: Array
    past: Seen | None = None

    @classmethod
    def of(cls, problem: Any, z: Array, tangent: Array, weights: Array, other: Point) -> Moving | None:
        """The mesh that moves from that of an orbit with its unit tangent, as it does on the way from or to another."""
        change, moved = _drift(problem, z, tangent, weights)
        slope = tangent + moved
        size = float(weights @ moved**2)
        row = weights * (slope - moved * (float(weights @ (moved * slope)) / size) if size > 0.0 else slope)
        row = row / np.sqrt(float(row @ (row / weights)))
        across = float(row @ tangent)
        if not across > 0.0:
            return None
        start = Seen(0.0, z, slope / across, 1.0 / across, problem)
        found = cls(problem, row, start, change / across, np.zeros(change.size))
        sigma, bend = found._towards(other, tangent, weights)
        for one in (replace(found, bend=bend), found) if sigma else (found,):
            past = one.seen(other, sigma)
            if past is not None and past.sigma != 0.0:
                slopes = np.array([start.slope, past.slope])
                (own, both), (_, others) = (weights * slopes) @ slopes.T
                if both > LEAST_ALIGNED * np.sqrt(own * others):
                    return replace(one, past=past)
        return found

    def _towards(self, other: Point, tangent: Array, weights: Array) -> tuple[float, Array]:
        """The sigma of another orbit by its scalars, 0 where these are still, and A by its own velocity."""
        problem, count = other.problem, self.problem.size - self.problem.states
        own = problem.metric(other.z, weights[-1] ** -0.5)
        unit = other.tangent / np.sqrt(float(own @ other.tangent**2))
        change, moved = _drift(problem, other.z, unit, own)
        scale = 1.0 / np.sqrt(float(own @ (unit + moved) ** 2))
        rates, moves = 0.5 * (tangent[-count:] + unit[-count:]), other.z[-count:] - self.start.z[-count:]
        size = float(weights[-count:] @ rates**2)
        if not size > LEAST_SCALARS**2:
            return 0.0, np.zeros(self.change.size)
        sigma = float(weights[-count:] @ (rates * moves)) / size / (0.5 * (scale + self.start.scale))
        v, there = np.append(0.0, np.cumsum(self.change)), np.append(0.0, np.cumsum(change)) * scale
        places = self.problem.mesh.edges + sigma * v
        for _ in range(2):
            found = np.interp(places, problem.mesh.edges, there)
            places = self.problem.mesh.edges + 0.5 * sigma * (v + found)
        return sigma, np.asarray((np.diff(found) - self.change) / sigma if sigma else np.zeros(v.size - 1))

    def on(self, sigma: float) -> Any:
        """The equations on the mesh there; None where it has not moved so far."""
        before, lengths = self.problem.constants, self._lengths(sigma)
        return None if np.any(lengths < SHORTEST_LENGTH * before) else self.problem.with_constants(lengths)

    def _lengths(self, sigma: float) -> Array:
        return np.asarray(self.problem.constants + sigma * (self.change + 0.5 * sigma * self.bend))

    def slope(self, problem: Any, z: Array, tangent: Array, sigma: float) -> tuple[Array, float]:
        """dz/dsigma of a solution on the mesh at sigma, with its tangent of either sign, and c with that sign."""
        moved = _shifted(problem, z, self.change + sigma * self.bend)
        scale = (1.0 - float(self.row @ moved)) / float(self.row @ tangent)
        return scale * tangent + moved, scale

    def nearest(self, point: Point) -> float:
        """The place between the start and the past where another point is by its scalars, about."""
        if self.past is None:
            return 0.0
        count = self.problem.size - self.problem.states
        there, start, past = (v[-count:] for v in (point.z, self.start.z, self.past.z))
        by = (past - start) / np.maximum(start**2 + past**2, 1e-300)
        way = float(by @ (past - start))
        return self.past.sigma * float(np.clip(by @ (there - start) / way, 0.0, 1.0)) if way > 0.0 else 0.0

    def seen(self, point: Point, near: float = 0.0) -> Seen | None:
        """Another point of the branch on the mesh that moves, sought from a place; None where the mesh is not there."""
        sigma = near
        for _ in range(PLACE_ROUNDS):
            on = self.on(sigma)
            if on is None:
                return None
            z = point.problem.prolong(point.z, on)
            moved = _shifted(on, z, self.change + sigma * self.bend)
            off = (float(self.row @ (z - self.start.z)) - sigma) / (1.0 - float(self.row @ moved))
            if abs(off) <= PLACE_ATOL:
                break
            sigma += off
        else:
            return None
        tangent = point.problem.prolong(point.tangent, on)
        scale = (1.0 - float(self.row @ moved)) / float(self.row @ tangent)
        return Seen(sigma, z, scale * tangent + moved, scale, on) if scale > 0.0 else None


def beside(problem: Any, z: Array, tangent: Array, step: float) -> tuple[Any, Array]:
    """The equations and the unknowns a small step along the branch, on a mesh that moves by it where layers do.

    At places that are held what a layer leaves of the second derivative outweighs such a step.
    """
    if not (problem.may_move and problem.speed_ratio(z) > MOVING_SPEED_RATIO):
        return problem, z + step * tangent
    change, moved = _drift(problem, z, tangent, problem.metric(z, 1.0))
    return problem.with_constants(problem.constants + step * change), z + step * (tangent + moved)


def _drift(problem: Any, z: Array, tangent: Array, weights: Array) -> tuple[Array, Array]:
    """The change of lengths by the velocity v of the places with the least |t + x' v|, and x' v, shape (size,).

    v at the edges solves tridiagonal equations; it is 0 at both ends of the interval.
    """
    K, n = problem.resolution, problem.formulation.states
    if kernels():
        change, found, data = np.empty(K), np.zeros(problem.size), (problem.constants, z, weights, tangent)
        kernels()["drift"](_layers(problem), *data, STRETCH_WEIGHT, change, found, np.empty(3 * K + 3))
        return change, found
    from scipy.linalg import solveh_banded

    slopes, (after, before) = _slopes(problem, z), _shares(problem)
    w, t = (values[: problem.states].reshape(-1, n) for values in (weights, tangent))
    own, with_t = (np.einsum("ij,ij,ij->i", w, slopes, other)[:-1].reshape(K, -1) for other in (slopes, t))
    stiff = STRETCH_WEIGHT / K / problem.constants**2
    diagonal = np.append(own @ after**2 + stiff, 0.0)
    diagonal[1:] += own @ before**2 + stiff
    right = -np.append(with_t @ after, 0.0)
    right[1:] -= with_t @ before
    v = np.zeros(K + 1)
    if K > 1:
        bands = np.array([np.append(0.0, (own @ (after * before) - stiff)[1:-1]), diagonal[1:-1]])
        v[1:-1] = solveh_banded(bands, right[1:-1])
    return np.diff(v), _shifted(problem, z, np.diff(v))


def _layers(problem: Any) -> Structure:
    """The intervals as kernels take them."""
    n, K, table = problem.formulation.states, problem.resolution, problem.table
    data = n, K, table.ends.size, problem.degree, table.ends, np.ascontiguousarray(table.slopes)
    found: Structure = problem.kept("layers", lambda: Structure(LAYERS, *data))
    return found


def _shares(problem: Any) -> tuple[Array, Array]:
    """The parts that the edges before and after it have in the velocity of each place of an interval but its end."""
    within = np.append(0.0, problem.table.ends[:-1])
    return 1.0 - within, within


def _slopes(problem: Any, z: Array) -> Array:
    """x' at all places, in fractions of the interval, shape (columns, states)."""
    values, R = z[: problem.states].reshape(problem.columns, -1), problem.table.ends.size
    starts = problem.discretisation.structure.start[:, None]
    rises = values[starts + np.arange(problem.degree + 1)] - values[starts]
    found, slopes = np.empty(values.shape), problem.table.slopes @ (rises / problem.constants[:, None, None])
    found[:-1], found[-1] = slopes[:, :R].reshape(-1, values.shape[1]), slopes[-1, -1]
    return found


def _shifted(problem: Any, z: Array, change: Array) -> Array:
    """x' v for the velocity that changes the lengths so, shape (size,)."""
    found = np.zeros(problem.size)
    if kernels():
        kernels()["shifted"](_layers(problem), problem.constants, z, change, found)
        return found
    after, before = _shares(problem)
    v = np.append(0.0, np.cumsum(change))
    places = np.append(v[:-1, None] * after + v[1:, None] * before, v[-1])
    found[: problem.states] = (_slopes(problem, z) * places[:, None]).ravel()
    return found
