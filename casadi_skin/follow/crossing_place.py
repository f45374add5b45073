"""The place where k branches cross at once: the Jacobian bordered by the tangent has a kernel of dimension k there.

Bordered by k columns and k rows more it is regular, and the k x k corner G of the inverse vanishes where the kernel is
(Govaerts 2000, chapter 3). The branch itself cannot be corrected there: its points and G are interpolated from places
on both sides. The inverse of the slope of G times G has one eigenvalue for each branch that crosses: how far before
the place it does. Their mean gives the place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.follow.crossed_branches import closed
from casadi_skin.zero.problem import EPSILON, Array, Problem, SingularError

ONE_PLACE = 1e-3  # of a step: several branches that cross within it do so in one place
WINDOWS = (0.1, 0.02, 0.004)  # of a step, to both sides; the widest in which interpolation is accurate is taken
COUNT = 12  # places in it; an even number has none in its middle
LEAST = 8  # places without which nothing is interpolated
ROUNDS = 4  # of inverse iteration, and of Newton's method
BESIDE = 1e-2  # of the window: nearer to the place points are not corrected
SHIFT = 1e-11  # of the largest entry of a matrix that is nearly singular


@dataclass(frozen=True, eq=False)
class CrossingPlace:
    """Unknowns where several branches cross, and their slope along the branch.

    Attributes:
        z: unknowns.
        slope: their derivative by the fraction of the way.
        error: of the fraction: of the interpolation, of rounding, and how far from it single branches cross.
    """

    z: Array
    slope: Array
    error: float


def crossing_places(
    problem: Problem, at: Callable[[float], tuple[Array, Array] | None], near: float, count: int, apart: float
) -> list[CrossingPlace]:
    """The places near a fraction of the way where `count` branches cross: one, or each where all are further apart.

    `at` gives the corrected unknowns at a fraction and the row that closes their equations. Empty where points beside
    the place are missing, and where no such place is so near.
    """
    for window in WINDOWS:
        found = _within(window, problem, at, near, count, apart)
        if found and all(one.error <= apart for one in found):
            return found
    return _within(WINDOWS[-1], problem, at, near, count, float("inf"))


def _within(
    window: float,
    problem: Problem,
    at: Callable[[float], tuple[Array, Array] | None],
    near: float,
    count: int,
    apart: float,
) -> list[CrossingPlace]:
    """As `crossing_places`, from points in a window."""
    from scipy.interpolate import KroghInterpolator

    nodes = np.clip(near, window, 1.0 - window) - window * np.cos(np.pi * (np.arange(COUNT) + 0.5) / COUNT)
    nodes = nodes[np.abs(nodes - near) > BESIDE * window]
    known = [(float(f), *there) for f in nodes if (there := at(float(f))) is not None]
    if len(known) < LEAST:
        return []
    try:
        polished = [(f, _polished(problem, z, row), row) for f, z, row in known]
        nearest = min(polished, key=lambda one: abs(one[0] - near))
        matrix = closed(problem, problem.evaluate(nearest[1])[1], nearest[2])
        right, left = _kernels(matrix, count)
        corners = [_corner(closed(problem, problem.evaluate(z)[1], row), right, left) for _, z, row in polished]
    except (RuntimeError, SingularError):  # of SuperLU: exactly singular
        return []
    places, values = np.array([f for f, _, _ in polished]), np.array(corners)
    whole, fewer = (_zeros(places[k], values[k], near, apart) for k in (slice(None), slice(1, -1)))
    if len(whole) != len(fewer) or any(abs(zero.place - near) > ONE_PLACE for zero in whole):
        return []
    noise = EPSILON * float(np.linalg.norm(np.abs(left.T) @ (abs(matrix) @ np.abs(right))))
    unknowns, found = KroghInterpolator(places, np.array([z for _, z, _ in polished])), list[CrossingPlace]()
    for zero, other in zip(whole, fewer, strict=True):
        z, slope = np.asarray(unknowns(zero.place)), np.asarray(unknowns.derivative(zero.place))
        error = abs(zero.place - other.place) + noise * zero.steepness
        found.append(CrossingPlace(z, slope, error + zero.spread))
    return found


def _polished(problem: Problem, z: Array, row: Array) -> Array:
    """Unknowns after one Newton step more: beside a singular place the corrector's last one counts."""
    from scipy.sparse.linalg import splu

    residual, nonzeros = problem.evaluate(z)
    return np.asarray(z - splu(closed(problem, nonzeros, row)).solve(np.append(residual, 0.0)))


def _kernels(matrix: Any, count: int) -> tuple[Array, Array]:
    """Orthonormal vectors that a nearly singular matrix nearly annihilates, from the right and from the left."""
    from scipy.sparse import eye
    from scipy.sparse.linalg import splu

    shift = SHIFT * float(np.max(np.abs(matrix.data)))
    factors: Any = splu((matrix + shift * eye(matrix.shape[0], format="csc")).tocsc())
    right: Array = np.random.default_rng(0).normal(size=(matrix.shape[0], count))
    for _ in range(ROUNDS):
        left = np.linalg.qr(factors.solve(right, trans="T"))[0]
        right = np.linalg.qr(factors.solve(left))[0]
    return right, left


def _corner(matrix: Any, right: Array, left: Array) -> Array:
    """The corner of the inverse of a matrix bordered by vectors, which is zero where these are its kernels."""
    from scipy.sparse import bmat, csc_matrix
    from scipy.sparse.linalg import splu

    size, count = right.shape
    bordered = bmat([[matrix, csc_matrix(left)], [csc_matrix(right.T), None]]).tocsc()
    return np.asarray(splu(bordered).solve(np.vstack([np.zeros((size, count)), np.eye(count)]))[size:])


@dataclass(frozen=True)
class _Zero:
    """Where matrices vanish, how far from there their eigenvalues do, and how far a change of 1 moves it."""

    place: float
    spread: float
    steepness: float


def _zeros(places: Array, corners: Array, near: float, apart: float) -> list[_Zero]:
    """The zeros near a place of eigenvalues of interpolated matrices: their mean, or each where all are further apart.

    Empty where there is none among the places of the matrices.
    """
    from scipy.interpolate import KroghInterpolator

    polynomial = KroghInterpolator(places, corners)

    def moves(place: float) -> Array:
        return np.asarray(-np.linalg.eigvals(np.linalg.solve(polynomial.derivative(place), polynomial(place))))

    try:
        for _ in range(ROUNDS):
            near += float(np.mean(moves(near).real))
            if not places[0] < near < places[-1]:
                return []
        found = moves(near)
        steepness = float(np.linalg.norm(np.linalg.inv(polynomial.derivative(near)), 2))
        if np.any(found.imag) or np.any(np.diff(np.sort(found.real)) <= apart):
            return [_Zero(near, float(np.max(np.abs(found))), steepness)]
        zeros = near + np.sort(found.real)
        for _ in range(ROUNDS):
            zeros = np.array([zero + min(moves(zero), key=abs).real for zero in zeros])
    except np.linalg.LinAlgError:
        return []
    return [_Zero(float(zero), 0.0, steepness) for zero in zeros]
