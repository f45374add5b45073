"""The multipliers of a closed chain of maps, those that are 1 for every orbit apart from the others."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, reduce
from itertools import pairwise

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.conserved import SymmetryClass, directions, is_odd, quantities
from casadi_skin.model.ode import OdeModel
from casadi_skin.stability.product_spectrum import Spectrum, by_liouville, scaled_product, spectrum_of
from casadi_skin.stability.tongues.interpolation import MatrixSeries
from casadi_skin.zero.problem import Array

# Multipliers that are 1 for every orbit, with the vectors that belong to them all along it ----------------------------

SLOWEST_MOTION_RATIO = 1e-6  # of the fastest motion along an orbit: slower, its direction is not known well
DEPENDENT_DIRECTIONS = 1e3  # tolerances: directions of norm 1 that differ by less are the same, and cosines below are 0
SMALLEST_COMPONENT_RATIO = 1e-6  # of the largest component: one that is smaller may be zero but for rounding
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
    rests = not float(np.max(np.abs(right[:, 0] / units))) * duration > SLOWEST_MOTION_RATIO
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
    least = float(np.clip(DEPENDENT_DIRECTIONS * tolerance, LEAST_DEPENDENT, MOST_DEPENDENT))
    right, left = _independent(right, 1.0 / units, least), _independent(left, units, least)
    right = _neutral(right, left, units, least)
    return Trivial(right.shape[1] + left.shape[1], right, left)


def units_of(states: Array) -> Array:
    """The size of each component along an orbit, no less than a part of the largest."""
    sizes = np.max(np.abs(states), axis=0)
    return np.asarray(np.maximum(sizes, SMALLEST_COMPONENT_RATIO * np.max(sizes, initial=0.0) or 1.0))


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
    return np.asarray(smallest > SLOWEST_MOTION_RATIO * np.max(smallest))


@lru_cache(maxsize=16)
def _vectors(model: OdeModel) -> tuple[ca.Function, int]:
    """Function (t, x, p) -> directions of time and of symmetries, then gradients; and the number of directions."""
    moved = [model.full_rhs, *directions(model).values()]
    slopes = [ca.gradient(quantity, model.full_state) for quantity in quantities(model).values()]
    return model.function("trivial", *(ca.densify(e) for e in (*moved, *slopes))), len(moved)


MACHINE_EPSILON = float(np.finfo(float).eps)
MAP_ENTRY_ROUNDING = 64.0  # units in the last place by which entries of a map over an interval are off: measured
BACKWARD_ERROR_UNITS = 4.0  # the same of a matrix, relative to its norm, whose eigenvalues LAPACK finds
COUPLED_ENTRY_RATIO = (
    1e-8  # of the largest diagonal entry of a product: entries that units are chosen by are no smaller
)


@dataclass(frozen=True, eq=False)
class MapsAlong:
    """Maps from each end of an interval to the next, the last one back to the first.

    Attributes:
        maps: shape (intervals, n, n).
        trivial: multipliers that are 1, with vectors at all ends.
        units: sizes of the components.
        contraction: the logarithm of the determinant of the product; None where it is not known.
    """

    maps: Array
    trivial: Trivial
    units: Array
    contraction: float | None = None


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Trivial multipliers and the others, with what rounding makes of these, shape of the others.

    `matrix` times exp(`size`) is the product of the maps, and `norm` its size in balanced units, no less than 1; `lost`
    is whether maps have lost digits of multipliers far from 1.
    """

    trivial: Spectrum
    others: Spectrum
    rounding: Array
    matrix: Array
    size: float
    norm: float
    lost: bool = False


def multipliers_along(along: MapsAlong, resolved: Callable[[], MapsAlong | None] | None = None) -> Multipliers:
    """Multipliers of the product of maps, later ones times earlier ones.

    `resolved` gives maps over parts of the intervals where these are too long for the changes in them, None where there
    are too many: they are taken where several multipliers are so far from 1 that maps may have lost their digits.
    """
    found = _found(along)
    if resolved is None or found.others.far < 2:
        return found
    finer = resolved()
    if finer is None:
        return replace(found, lost=True)
    return found if finer is along else _found(finer)


def _found(along: MapsAlong) -> Multipliers:
    from scipy.linalg import matrix_balance

    trivial = along.trivial
    matrix, size = scaled_product(along.maps)
    scaled = matrix * along.units / along.units[:, None]
    coupled = np.abs(scaled) + COUPLED_ENTRY_RATIO * (np.max(np.abs(np.diagonal(scaled)), initial=0.0) or 1.0)
    _, (scales, _) = matrix_balance(coupled, permute=False, separate=True)  # no entry is large by its units
    units = along.units * scales
    maps = along.maps * units / units[:, None]
    frames = trivial.frames(units)
    near, across, sizes = _apart(maps, frames)
    found = spectrum_of(across)
    rounding = _rounding(across, sizes, found)
    is_other = np.ones(found.logs.size, dtype=bool)
    is_other[np.argsort(np.abs(found.values - 1.0), kind="stable")[: trivial.count - near.logs.size]] = False
    near, others = near.joined(found.taken(~is_other)), found.taken(is_other)
    if along.contraction is not None:  # at rest the one nearest to 1, which stands for the trivial one, may be far off
        others = by_liouville(others, maps, along.contraction - (0.0 if frames else float(np.sum(near.logs))))
    norm = float(np.linalg.norm(scaled * scales / scales[:, None], 2))
    return Multipliers(near, others, rounding[is_other], matrix, size, max(1.0, norm * np.exp(min(size, 700.0))))


def _apart(maps: Array, frames: Frames | None) -> tuple[Spectrum, Array, Array]:
    """The multipliers of what the frames take out, the maps across that, and the sizes of their entries' terms."""
    if frames is None:
        return Spectrum.of(np.empty(0, dtype=complex)), maps, np.abs(maps)
    if len(frames.places) < len(maps):
        rolled = np.roll(maps, -frames.places[0], axis=0)
        cuts = (frames.places - frames.places[0])[1:]
        maps = np.array([reduce(_after, part) for part in np.split(rolled, cuts)])
    first, last = frames.matrices, np.roll(frames.matrices, -1, axis=0).swapaxes(1, 2)
    turned = last @ maps @ first
    r, known = frames.right, frames.right + frames.left
    blocks = (turned[:, :r, :r], turned[:, r:known, r:known])
    values = [np.linalg.eigvals(_plain_product(block)).astype(complex) for block in blocks if block.size]
    sizes = np.abs(last[:, known:]) @ np.abs(maps) @ np.abs(first[:, :, known:])
    return Spectrum.of(np.concatenate(values)), turned[:, known:, known:], sizes


def _after(done: Array, following: Array) -> Array:
    return np.asarray(following @ done)


def _plain_product(maps: Array) -> Array:
    product, size = scaled_product(maps)
    return np.asarray(product * np.exp(size))


def _rounding(maps: Array, sizes: Array, found: Spectrum) -> Array:
    """What errors of the maps by rounding make of each multiplier, at first order, or of a pair that nearly meets."""
    K, n = maps.shape[:2]
    own = np.asarray(MAP_ENTRY_ROUNDING * MACHINE_EPSILON * K * np.abs(found.values))
    if n == 0 or found.extreme:
        return own
    there, back = np.empty((K + 1, n, n)), np.empty((K + 1, n, n))
    there[0] = back[K] = np.eye(n)
    for k in range(K):
        there[k + 1] = maps[k] @ there[k]
        back[K - 1 - k] = back[K - k] @ maps[K - 1 - k]
    values, right = np.linalg.eig(there[K])
    order = np.argsort(-np.abs(values))
    right = right[:, order]
    with np.errstate(all="ignore"):
        try:
            left = np.linalg.inv(right)
        except np.linalg.LinAlgError:  # exactly defective
            left = np.full_like(right, np.inf)
        after, before = left @ back[1:], there[:-1] @ right
        terms = (np.abs(after) @ sizes) * np.abs(before).swapaxes(1, 2)
        moved = MAP_ENTRY_ROUNDING * MACHINE_EPSILON * np.sum(terms, axis=(0, 2))
        conditions = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0) * np.linalg.norm(there[K])
        moved += BACKWARD_ERROR_UNITS * MACHINE_EPSILON * conditions
        whole = MAP_ENTRY_ROUNDING * MACHINE_EPSILON * float(np.sum(np.abs(back[1:]) @ sizes @ np.abs(there[:-1])))
    return np.asarray(np.fmin(np.maximum(moved, MACHINE_EPSILON * np.abs(found.values)), np.sqrt(whole)))


# Matrices along a branch that a symmetry of its orbits makes copies of smaller ones: each of these once ---------------

RANDOM_COMBINATIONS = 4  # random ones, that couple what any of the matrices couples
EQUAL_EIGENVALUES_RTOL = 1e-7  # distance of eigenvalues that are one, relative to the largest
COPY_PLACES = np.array([0.21, 0.5, 0.83])  # of the series
COPIES_COUPLED = 1e-10  # entries relative to the largest: smaller ones are noise
ALIKE_COPIES_RTOL = 1e-9  # difference of copies, relative to the largest entries: noise of orbits and flows


def without_copies(series: MatrixSeries) -> list[MatrixSeries]:
    """A series, or where symmetries repeat its multipliers smaller ones with each of these once."""
    if series.size < 2:
        return [series]
    sizes = np.max(np.abs(series.coefficients), axis=(0, 2, 3))
    matrices = (series.coefficients / np.maximum(sizes, np.finfo(float).tiny)[:, None, None]).reshape(
        -1, series.size, series.size
    )
    weights = np.random.default_rng(0).normal(size=(RANDOM_COMBINATIONS, len(matrices)))
    combined = np.tensordot(weights, matrices, 1)
    values, vectors = np.linalg.eigh(combined[0] + combined[0].T)
    apart = np.flatnonzero(np.diff(values) > EQUAL_EIGENVALUES_RTOL * np.max(np.abs(values))) + 1
    if apart.size == series.size - 1 and not _repeats(series):
        return [series]
    spaces = [slice(a, b) for a, b in pairwise([0, *apart.tolist(), series.size])]
    entries = vectors.T @ np.concatenate([combined, combined.swapaxes(1, 2)]) @ vectors
    found: list[MatrixSeries] = []
    for group in _coupled(entries, spaces):
        copies = _copies(entries, group)
        once = None if copies is None else _restricted(series, [vectors @ basis for basis in copies])
        every = np.hstack([vectors[:, space] for space in group])
        found.append(once or _restricted(series, [every], np.inf) or series)
    return found


def _repeats(series: MatrixSeries) -> bool:
    """Whether two mu are equal at several places: symmetries in time as well as space do that without copies."""
    mu = np.linalg.eigvals(series.at(series.start + COPY_PLACES * (series.end - series.start), 1)[:, 0]).astype(complex)
    apart = np.abs(mu[:, :, None] - mu[:, None, :]) + np.eye(series.size)
    return bool(np.all(np.min(apart, axis=(1, 2)) <= EQUAL_EIGENVALUES_RTOL))


def _coupled(entries: Array, spaces: Sequence[slice]) -> Iterator[list[slice]]:
    """The eigenspaces in groups that nothing couples to each other; `entries` are those of matrices in their basis."""
    starts = [space.start for space in spaces]
    blocks = np.maximum.reduceat(np.maximum.reduceat(np.max(np.abs(entries), axis=0), starts, 0), starts, 1)
    from scipy.sparse.csgraph import connected_components

    count, part = connected_components(blocks > COPIES_COUPLED * np.max(blocks))
    for k in range(count):
        yield [spaces[i] for i in np.flatnonzero(part == k).tolist()]


def _copies(entries: Array, group: Sequence[slice]) -> list[Array] | None:
    """The bases of the copies that a group of eigenspaces of one size is, as columns; None where there is one.

    Each eigenspace is turned so that the largest block that couples it to those before is a multiple of the identity.
    """
    count = group[0].stop - group[0].start
    if count == 1 or any(space.stop - space.start != count for space in group):
        return None
    turned = {0: np.eye(count)}
    while len(turned) < len(group):
        blocks = [
            (turned[i].T @ entries[:, group[i], space], j)
            for i in turned
            for j, space in enumerate(group)
            if j not in turned
        ]
        block, j = max(
            ((max(each, key=lambda one: float(np.linalg.norm(one))), j) for each, j in blocks),
            key=lambda pair: float(np.linalg.norm(pair[0])),
        )
        left, _, right = np.linalg.svd(block)
        turned[j] = (left @ right).T
    bases = np.zeros((count, entries.shape[1], len(group)))
    for j, turn in turned.items():
        bases[:, group[j], j] = turn.T
    return list(bases)


def _restricted(series: MatrixSeries, copies: Sequence[Array], alike: float = ALIKE_COPIES_RTOL) -> MatrixSeries | None:
    """The mean of the copies, with what they differ by as noise; None where they are not `alike`."""
    parts = [basis.T @ series.coefficients @ basis for basis in copies]
    mean = np.mean(parts, axis=0)
    rest = np.zeros_like(series.noise)
    for basis in copies:
        right = np.linalg.norm(series.coefficients @ basis - basis @ mean, axis=(2, 3))
        left = np.linalg.norm(basis.T @ series.coefficients - mean @ basis.T, axis=(2, 3))
        rest = np.maximum(rest, np.sum(np.maximum(right, left), axis=0))
    if np.any(rest > alike * np.max(np.abs(series.coefficients), axis=(0, 2, 3))):
        return None
    errors = copies[0].T @ series.errors @ copies[0]
    return MatrixSeries(series.start, series.end, mean, errors, series.noise + rest)
