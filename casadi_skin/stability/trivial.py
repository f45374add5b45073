"""Multipliers that are 1 for every orbit, with the vectors that belong to them all along it.

Time, and each continuous symmetry, moves an orbit along itself: a right eigenvector. The gradient of each conserved
quantity is a left one (Poincare 1892). The maps between frames that have these vectors for columns are triangular in
blocks: those across what is conserved, up to what only shifts the orbit, have the other multipliers alone, so that one
of these may be 1 as well.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.conserved import directions, is_odd, quantities
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.symmetry import SymmetryClass
from casadi_skin.zero.problem import Array

SLOWEST = 1e-6  # of the fastest motion along an orbit: slower, its direction is not known well
DEPENDENT = 1e3  # tolerances: directions of norm 1 that differ by less are the same, and cosines below are 0
SMALLEST = 1e-6  # of the largest component: one that is smaller may be zero but for rounding
MOST_DEPENDENT, LEAST_DEPENDENT = 1e-4, 1e-8  # bounds on that


@dataclass(frozen=True, eq=False)
class Frames:
    """Orthogonal matrices at some of the ends of intervals, shape (places, n, n).

    Their first `right` columns span the directions in which nothing conserved changes, the next `left` what is left of
    the gradients, the others the rest. The first place is that of the last, a period later.
    """

    places: NDArray[np.int64]
    matrices: Array
    right: int
    left: int


@dataclass(frozen=True, eq=False)
class Trivial:
    """Multipliers that are 1 for every orbit.

    Attributes:
        count: their number.
        right, left: directions and gradients that are independent, at the ends of the intervals; (ends, any, n) each.
    """

    count: int
    right: Array
    left: Array

    @property
    def known(self) -> int:
        """How many have their vectors."""
        return int(self.right.shape[1] + self.left.shape[1])

    def frames(self, units: Array) -> Frames | None:
        """Frames in coordinates x / units, where the vectors have a direction; None where there are none."""
        if self.known == 0:
            return None
        right, left = self.right[:-1] / units, self.left[:-1] * units
        good = _well_directed(right) & _well_directed(left)
        if not good.any():
            return None
        vectors = np.concatenate([right[good], left[good]], axis=1)
        vectors = vectors / np.linalg.norm(vectors, axis=2, keepdims=True)
        matrices = np.linalg.qr(vectors.swapaxes(1, 2), mode="complete")[0]
        return Frames(np.flatnonzero(good), matrices, right.shape[1], left.shape[1])


def no_trivial(n: int) -> Trivial:
    """Of a forced orbit."""
    return Trivial(0, np.empty((1, 0, n)), np.empty((1, 0, n)))


def trivial_along(
    model: OdeModel, symmetry: SymmetryClass, states: Array, parameters: Array, duration: float, tolerance: float
) -> Trivial:
    """The trivial multipliers of an orbit of a model of first order through states at the ends of intervals.

    None of a forced model, one of an autonomous one, two of orbits that come in families; more where more is conserved.
    At rest, which `duration` decides, the one nearest to 1 stands for that of time.
    """
    if model.forced:
        return no_trivial(states.shape[1])
    right, left = vectors_along(model, states, parameters)
    units = units_of(states)
    rests = not float(np.max(np.abs(right[:, 0] / units))) * duration > SLOWEST
    found = trivial_of(right[:, 1:] if rests else right, left, units, tolerance)
    count = max(found.count + rests, 1)
    return replace(found, count=count + _by_reversal(model, symmetry, count))


def vectors_along(model: OdeModel, states: Array, parameters: Array) -> tuple[Array, Array]:
    """Directions, that of time first, and gradients at states (ends, n), shape (ends, any, n) each."""
    function, moved = _vectors(model)
    columns = [np.array(v) for v in function.map(len(states)).call([0.0, states.T, parameters])]
    vectors = np.array([column.T for column in columns]).swapaxes(0, 1)
    return vectors[:, :moved], vectors[:, moved:]


def trivial_of(right: Array, left: Array, units: Array, tolerance: float) -> Trivial:
    """As many as directions and gradients are independent, less the pairs of which one changes the other's quantity."""
    least = float(np.clip(DEPENDENT * tolerance, LEAST_DEPENDENT, MOST_DEPENDENT))
    right, left = _independent(right, 1.0 / units, least), _independent(left, units, least)
    right = _neutral(right, left, units, least)
    return Trivial(right.shape[1] + left.shape[1], right, left)


def units_of(states: Array) -> Array:
    """The size of each component along an orbit, no less than a part of the largest."""
    sizes = np.max(np.abs(states), axis=0)
    return np.asarray(np.maximum(sizes, SMALLEST * np.max(sizes, initial=0.0) or 1.0))


def _by_reversal(model: OdeModel, symmetry: SymmetryClass, known: int) -> int:
    """Further ones of reversible orbits, which come in families and have reciprocal multipliers in pairs."""
    if symmetry is SymmetryClass.FULL or model.hamiltonian is not None:
        return 0
    by_family = int(all(is_odd(model, name) for name in model.conserved))
    return by_family + (known + by_family) % 2


def _independent(vectors: Array, units: Array, least: float) -> Array:
    """Combinations of vectors (ends, any, n) that are independent along the orbit, times their units.

    Between vectors that the flow carries along linear relations hold all along an orbit.
    """
    vectors = vectors[:, np.any(vectors != 0.0, axis=(0, 2))]
    if vectors.shape[1] < 2:
        return vectors
    scaled = vectors * units
    sizes = np.max(np.linalg.norm(scaled, axis=2), axis=0)
    combinations, singular, _ = np.linalg.svd((scaled / sizes[:, None]).swapaxes(0, 1).reshape(sizes.size, -1))
    kept = singular > least * singular[0]
    return np.asarray((combinations[:, kept] / sizes[:, None]).T @ vectors)


def _neutral(right: Array, left: Array, units: Array, least: float) -> Array:
    """Combinations of directions in which no conserved quantity changes: how much each changes is conserved, too."""
    if not right.shape[1] or not left.shape[1]:
        return right
    a, b = right / units, left * units
    rates = np.mean(b @ a.swapaxes(1, 2), axis=0)
    sizes = np.sqrt(np.mean(b**2, axis=0).sum(axis=1)[:, None] * np.mean(a**2, axis=0).sum(axis=1))
    _, singular, combinations = np.linalg.svd(rates / sizes)
    singular = np.append(singular, np.zeros(combinations.shape[0] - singular.size))
    lengths = np.sqrt(np.mean(a**2, axis=0).sum(axis=1))
    return np.asarray((combinations[singular <= least] / lengths) @ right)


def _well_directed(vectors: Array) -> NDArray[np.bool_]:
    """At which ends the vectors, (ends, any, n), are not too small, or too nearly dependent, for their directions."""
    if vectors.shape[1] == 0:
        return np.ones(len(vectors), dtype=bool)
    smallest = np.linalg.svd(vectors, compute_uv=False)[:, -1]
    return np.asarray(smallest > SLOWEST * np.max(smallest))


@lru_cache(maxsize=16)
def _vectors(model: OdeModel) -> tuple[ca.Function, int]:
    """Function (t, x, p) -> directions of time and of symmetries, then gradients; and the number of directions."""
    moved = [model.full_rhs, *directions(model).values()]
    slopes = [ca.gradient(quantity, model.full_state) for quantity in quantities(model).values()]
    return model.function("trivial", *(ca.densify(e) for e in (*moved, *slopes))), len(moved)
