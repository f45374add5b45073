"""The multipliers of a closed chain of maps, those that are 1 for every orbit apart from the others.

Eigenvalues of a product of matrices by their logarithms, of those beyond the largest double too.

Where the product is not too far from orthogonal, of the product itself and of that of the inverses, each of which has
digits of the eigenvalues on its side. Else by a periodic Schur form: the factors are made triangular by orthogonal
matrices, of which the first is that of the last factor too (Bojanczyk, Golub and Van Dooren 1992), in blocks whose
eigenvalues are close enough in modulus to be those of a product that keeps its digits. The orthogonal matrices come
from subspace iteration through the factors, which converges as the ratio of moduli across the gap between two blocks.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, reduce
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin import native
from casadi_skin.model.conserved import SymmetryClass, directions, is_odd, quantities
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.result import kept_by_first
from casadi_skin.native import MOST_STATES, kernels
from casadi_skin.native.programs import buffers
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import LARGEST_LOGARITHM
from casadi_skin.zero.problem import Array, Buffers, Indices

SMALL_MODULUS = 0.5  # modulus above which no eigenvalue has lost digits in a product with entries near 1
EXTREME_LOG_CONDITION = float(np.log(1e14))  # of a product: beyond it eigenvalues in the middle have lost digits
FAR_LOG_EIGENVALUE = 7.0  # logarithm of an eigenvalue of whose digits factors may have lost some
LOG_MODULUS_SPREAD = float(np.log(1e4))  # of the moduli of a block
CONVERGED_LOG_GAIN = 40.0  # logarithm of the gain of subspace iteration over a gap
SUBSPACE_ROUNDS, FEW_ROUNDS = 60, 8  # of it, and of many states
OPEN_FRAME_ATOL = 1e-8  # of frames at the start and the end, where the first vectors span the same


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Eigenvalues as exp(logs) times phases of modulus 1, in descending modulus; `extreme` by a periodic Schur form."""

    logs: Array
    phases: ComplexArray
    extreme: bool = False

    @classmethod
    def of(cls, values: ComplexArray) -> Spectrum:
        """Of eigenvalues that are numbers; zeros have the logarithm minus infinity."""
        moduli = np.abs(values)
        with np.errstate(divide="ignore"):
            return cls(np.log(moduli), np.where(moduli > 0.0, values / np.where(moduli > 0.0, moduli, 1.0), 1.0))

    @cached_property
    def values(self) -> ComplexArray:
        """The eigenvalues, those beyond the largest double as that."""
        return np.asarray(np.exp(np.minimum(self.logs, LARGEST_LOGARITHM)) * self.phases)

    @property
    def far(self) -> int:
        """How many are so far from 1 that a step may have lost their digits, 0 where all but one are near."""
        away = np.abs(self.logs)
        if not away.max(initial=0.0) > FAR_LOG_EIGENVALUE:
            return 0
        return int(np.count_nonzero(away > -np.log(SMALL_MODULUS)))

    def joined(self, other: Spectrum) -> Spectrum:
        """These, then those of another one."""
        logs, phases = np.concatenate([self.logs, other.logs]), np.concatenate([self.phases, other.phases])
        return Spectrum(logs, phases, self.extreme or other.extreme)

    def taken(self, chosen: NDArray[np.bool_]) -> Spectrum:
        """Some of them."""
        return Spectrum(self.logs[chosen], self.phases[chosen], self.extreme)


def _products(maps: Array) -> tuple[Array, float, Array, float]:
    """The product with its size, and its inverse from those of the maps likewise; both of norm 1.

    No finite numbers where a map is singular.
    """
    found = np.full_like(maps[0], np.nan), 0.0
    with suppress(np.linalg.LinAlgError):
        found = scaled_product(np.asarray(np.linalg.inv(maps[::-1]), dtype=float))
    return *scaled_product(maps), *found


def scaled_product(maps: Array) -> tuple[Array, float]:
    """Later maps times earlier ones as a matrix of norm 1 and the logarithm of a factor.

    By products of two neighbours, of two of these, and so on.
    """
    logarithm = 0.0
    while True:
        sizes = np.linalg.norm(maps, axis=(1, 2))
        sizes[sizes == 0.0] = 1.0
        logarithm += float(np.sum(np.log(sizes)))
        maps = maps / sizes[:, None, None]
        if len(maps) == 1:
            return maps[0], logarithm
        even = len(maps) // 2 * 2
        maps = np.concatenate([maps[1:even:2] @ maps[:even:2], maps[even:]])


def spectrum_of(maps: Array) -> Spectrum:
    """Eigenvalues of the product of maps, shape (factors, n, n)."""
    if maps.shape[1] == 0:
        return Spectrum(np.empty(0), np.empty(0, dtype=complex))
    forward, size, inverse, inverse_size = _products(maps)
    found = _shifted(np.linalg.eigvals(forward).astype(complex), size)
    if len(maps) == 1:
        return found
    known = np.all(np.isfinite(inverse)) and np.isfinite(inverse_size)
    if known and size + inverse_size <= EXTREME_LOG_CONDITION:
        return _of_both(found, size, (inverse, inverse_size))
    triangular = _schur(maps)
    return triangular or Spectrum(found.logs, found.phases, True)


def _shifted(values: ComplexArray, logarithm: float) -> Spectrum:
    found = Spectrum.of(values[np.argsort(-np.abs(values))])
    return Spectrum(found.logs + logarithm, found.phases)


def _of_both(forward: Spectrum, size: float, inverse: tuple[Array, float]) -> Spectrum:
    """Each eigenvalue from the product or from that of the inverses, whichever has more of its digits.

    Rounding is relative to the norm of either, so that each serves the eigenvalues on its own side of the modulus at
    which both are equally good.
    """
    reciprocal = _shifted(np.linalg.eigvals(inverse[0]).astype(complex), inverse[1])
    backward = Spectrum(-reciprocal.logs[::-1], reciprocal.phases[::-1].conj())
    small = (forward.logs < np.log(SMALL_MODULUS)) & (0.5 * (forward.logs + backward.logs) < 0.5 * (size - inverse[1]))
    if forward.logs.size == 1:
        small[:] = forward.logs < np.log(SMALL_MODULUS)
    logs = np.where(small, backward.logs, forward.logs)
    return Spectrum(logs, np.where(small, backward.phases, forward.phases))


# The periodic Schur form ----------------------------------------------------------------------------------------------


def _schur(maps: Array) -> Spectrum | None:
    """Eigenvalues block by block of triangular factors; None where a factor is singular."""
    n = maps.shape[1]
    frame = general_frame(n)
    edges: list[int] = []
    for turn in range(1, (SUBSPACE_ROUNDS if n <= MOST_STATES else FEW_ROUNDS) + 1):
        start = frame
        frame, factors = _triangular(maps, frame)
        diagonal = np.abs(np.diagonal(factors, axis1=1, axis2=2))
        if np.any(diagonal == 0.0):
            return None
        logs = np.sum(np.log(diagonal), axis=0)
        gaps = logs[:-1] - logs[1:]
        open_at = _below(np.abs(start.T @ frame))  # a pair that turns has gaps as well, but no frame of its own
        apart = ((turn - 1) * gaps > CONVERGED_LOG_GAIN) & (open_at <= OPEN_FRAME_ATOL)
        edges = [0, *(np.flatnonzero(apart) + 1).tolist(), n]
        if all(abs(logs[a] - logs[b - 1]) <= LOG_MODULUS_SPREAD for a, b in pairwise(edges)):
            break
    blocks = []
    for a, b in pairwise(edges):
        product, size = scaled_product(factors[:, a:b, a:b])
        closed = start[:, a:b].T @ frame[:, a:b]
        blocks.append(_shifted(np.linalg.eigvals(closed @ product).astype(complex), size))
    logs, phases = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("logs", "phases"))
    order = np.argsort(-logs, kind="stable")
    return Spectrum(logs[order], phases[order], True)


@lru_cache(maxsize=MOST_STATES)
def general_frame(n: int) -> Array:
    """An orthogonal matrix in general position, which is not to be written to."""
    return np.linalg.qr(np.random.default_rng(0).normal(size=(n, n)))[0]


def _below(sizes: Array) -> Array:
    """The largest entry below and left of each place between two neighbours on the diagonal."""
    columns = np.maximum.accumulate(sizes[::-1], axis=0)[::-1]
    return np.diagonal(np.maximum.accumulate(columns, axis=1), -1)


def _triangular(maps: Array, frame: Array) -> tuple[Array, Array]:
    """The frame after all maps, from that before, and the factors between frames."""
    factors = np.empty_like(maps)
    for k, matrix in enumerate(maps):
        frame, factors[k] = np.linalg.qr(matrix @ frame)
    return frame, factors


# Liouville's formula --------------------------------------------------------------------------------------------------


def by_liouville(spectrum: Spectrum, rounding: Array, sign: float, log: float, count: int) -> tuple[Spectrum, Array]:
    """The eigenvalues, a single one that is tiny, or huge where none is tiny, from their product sign exp(log).

    Where there is but one, that tells whether it is. What rounding makes of it is relative then, where that of the
    product of so many maps is as large as it is.
    """
    index = _single(spectrum.logs if spectrum.logs.size > 1 else np.full(spectrum.logs.size, log))
    if index is None:
        return spectrum, rounding
    is_other, logs, phases = np.arange(spectrum.logs.size) != index, spectrum.logs.copy(), spectrum.phases.copy()
    logs[index] = log - float(np.sum(logs[is_other]))
    phases[index] = np.sign(sign * np.prod(phases[is_other]).real) or 1.0
    found = Spectrum(logs, phases, spectrum.extreme)
    sizes = np.maximum(np.abs(found.values), np.finfo(float).tiny)
    relative = MAP_ENTRY_ROUNDING * MACHINE_EPSILON * count + np.sum((rounding / sizes)[is_other])
    return found, np.where(is_other | (rounding <= sizes), rounding, relative * sizes)


def _single(logs: Array) -> int | None:
    """Place of the single eigenvalue that is tiny, or huge where none is tiny; None where there are more, or none."""
    small, large = logs < np.log(SMALL_MODULUS), logs > -np.log(SMALL_MODULUS)
    if np.count_nonzero(small) == 1:
        return logs.size - 1
    return 0 if np.count_nonzero(large) == 1 and not small.any() else None


# Multipliers that are 1 for every orbit, with the vectors that belong to them all along it ----------------------------

SLOWEST_MOTION_RATIO = 1e-6  # of the fastest motion along an orbit: slower, its direction is not known well
DEPENDENT_DIRECTIONS = 1e3  # tolerances: directions of norm 1 that differ by less are the same, and cosines below are 0
SMALLEST_COMPONENT_RATIO = 1e-6  # of the largest component: one that is smaller may be zero but for rounding
MOST_DEPENDENT, LEAST_DEPENDENT = 1e-4, 1e-8  # bounds on that


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

    def vectors(self, units: Array) -> tuple[Indices, Array] | None:
        """Directions, then gradients, of length 1, (places, any, n), in coordinates x / units, where they have one.

        The first place is that of the last, a period later. None where there are none.
        """
        right, left = self.right[:-1] / units, self.left[:-1] * units
        good = _well_directed(right) & _well_directed(left)
        vectors = np.concatenate([right[good], left[good]], axis=1)
        if not vectors.size:
            return None
        return np.flatnonzero(good), vectors / np.linalg.norm(vectors, axis=2, keepdims=True)

    def carried(self, maps: Array, counts: Indices) -> Trivial:
        """The same at the ends of so many parts of each interval, as maps over these carry the vectors.

        Inside of intervals an orbit is less accurate than at their ends, and so are its velocities.
        """
        if not self.right.shape[1] + self.left.shape[1]:
            return self
        first = np.cumsum(counts) - counts
        right, left = (np.repeat(vectors[:1], len(maps), axis=0) for vectors in (self.right, self.left))
        right[first], left[first] = self.right[: first.size], self.left[: first.size]
        right, left = (
            np.concatenate(each) for each in ((right, self.right[first.size :]), (left, self.left[first.size :]))
        )
        most = int(np.max(counts))
        for turn in range(1, most if right.shape[1] else 1):
            there = first[counts > turn] + turn
            right[there] = right[there - 1] @ maps[there - 1].swapaxes(1, 2)
        for turn in range(most - 1 if left.shape[1] else 0, 0, -1):
            there = first[counts > turn] + turn
            left[there] = left[there + 1] @ maps[there]
        return replace(self, right=right, left=left)


def no_trivial(n: int) -> Trivial:
    """Of a forced orbit."""
    return Trivial(0, np.empty((1, 0, n)), np.empty((1, 0, n)))


def trivial_along(
    model: OdeModel, symmetry: SymmetryClass, states: Array, units: Array, parameters: Array, duration: float,
    tolerance: float,
) -> Trivial:  # fmt: skip
    """The trivial multipliers of an orbit of an autonomous model through states, of sizes `units`, at all ends.

    One, two of orbits that come in families; more where more is conserved. At rest, which `duration` decides, the one
    nearest to 1 stands for that of time.
    """
    right, left = vectors_along(model, states, parameters)
    rests = not float(np.abs(right[:, 0] / units).max()) * duration > SLOWEST_MOTION_RATIO
    right = right[:, int(rests) :]
    alone = right.shape[1] < 2 and not left.shape[1]
    found = Trivial(right.shape[1], right, left) if alone else trivial_of(right, left, units, tolerance)
    count = max(found.count + rests, 1)
    return Trivial(count + _by_reversal(model, symmetry, count), found.right, found.left)


def vectors_along(model: OdeModel, states: Array, parameters: Array) -> tuple[Array, Array]:
    """Directions, that of time first, and gradients at states (ends, n), shape (ends, any, n) each."""
    function, moved = _vectors(model, len(states))
    found = function(np.zeros(1), states, parameters)
    vectors = np.stack([each.reshape(states.shape) for each in found], axis=1)
    return vectors[:, :moved], vectors[:, moved:]


def trivial_of(right: Array, left: Array, units: Array, tolerance: float) -> Trivial:
    """As many as directions and gradients are independent, less the pairs of which one changes the other's quantity."""
    least = float(np.clip(DEPENDENT_DIRECTIONS * tolerance, LEAST_DEPENDENT, MOST_DEPENDENT))
    right, left = _independent(right, 1.0 / units, least), _independent(left, units, least)
    right = _neutral(right, left, units, least)
    return Trivial(right.shape[1] + left.shape[1], right, left)


def units_of(states: Array) -> Array:
    """The size of each component along an orbit, no less than a part of the largest."""
    sizes = np.abs(states).max(axis=0)
    return np.asarray(np.maximum(sizes, SMALLEST_COMPONENT_RATIO * sizes.max(initial=0.0) or 1.0))


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
    one = vectors.shape[1] == 1
    smallest = np.linalg.norm(vectors[:, 0], axis=1) if one else np.linalg.svd(vectors, compute_uv=False)[:, -1]
    return np.asarray(smallest > SLOWEST_MOTION_RATIO * np.max(smallest))


@kept_by_first
def _vectors(model: OdeModel, places: int) -> tuple[Buffers, int]:
    """Function (t, x, p) -> directions of time and of symmetries, then gradients; and the number of directions."""
    moved = [model.full_rhs, *directions(model).values()]
    slopes = [ca.gradient(quantity, model.full_state) for quantity in quantities(model).values()]
    function = model.function("trivial", *(ca.densify(e) for e in (*moved, *slopes)))
    return buffers(function, places, model.programs), len(moved)


MACHINE_EPSILON = float(np.finfo(float).eps)
MAP_ENTRY_ROUNDING = 64.0  # units in the last place by which entries of a map over an interval are off: measured
BACKWARD_ERROR_UNITS = 4.0  # the same of a matrix, relative to its norm, whose eigenvalues LAPACK finds
COUPLED_ENTRY_RATIO = 1e-8  # of a product's largest diagonal entry: entries that units are chosen by are no smaller


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Trivial multipliers and the others, with what rounding makes of these, shape of the others.

    `matrix` times exp(`size`) is the product of the maps, None where it is not formed, and `norm` its size in balanced
    units, no less than 1; `lost` is whether maps have lost digits of multipliers far from 1. No multiplier is left out
    whose modulus is above `beyond`.
    """

    trivial: Spectrum
    others: Spectrum
    rounding: Array
    matrix: Array | None
    size: float
    norm: float
    lost: bool = False
    beyond: float = 0.0

    def but(self, others: Multipliers, chosen: NDArray[np.bool_]) -> Multipliers:
        """These with some of the others taken from other maps."""
        logs = np.where(chosen, others.others.logs, self.others.logs)
        phases = np.where(chosen, others.others.phases, self.others.phases)
        rounding = np.where(chosen, others.rounding, self.rounding)
        return replace(self, others=Spectrum(logs, phases, self.others.extreme), rounding=rounding)


def multipliers_along(
    maps: Array, trivial: Trivial, units: Array, product: tuple[float, float] | None = None, with_rounding: bool = True
) -> Multipliers:
    """Multipliers of the product of maps, later ones times earlier ones.

    Arguments:
        maps: from each end of an interval to the next, the last one back to the first, shape (intervals, n, n).
        trivial: multipliers that are 1, with vectors at all ends.
        units: sizes of the components.
        product: sign and logarithm of the determinant of their product; None where it is not known.
        with_rounding: whether what rounding makes of them is wanted; zeros where not.
    """
    if maps.shape[1] <= MOST_STATES and kernels():
        return _compiled(maps, trivial, units, product, with_rounding)
    matrix, size = scaled_product(maps)
    scaled = matrix * units / units[:, None]
    coupled = np.abs(scaled) + COUPLED_ENTRY_RATIO * (np.max(np.abs(np.diagonal(scaled)), initial=0.0) or 1.0)
    scales = balancing(coupled)  # no entry is large by its units
    units = units * scales
    maps = maps * (units / units[:, None])
    vectors = trivial.vectors(units)
    near, across, sizes = _apart(maps, trivial, vectors)
    found = spectrum_of(across)
    rounding = _rounding(across, sizes, found) if with_rounding else np.zeros(found.logs.size)
    is_other = np.ones(found.logs.size, dtype=bool)
    is_other[np.argsort(np.abs(found.values - 1.0), kind="stable")[: trivial.count - near.logs.size]] = False
    near, others, rounding = near.joined(found.taken(~is_other)), found.taken(is_other), rounding[is_other]
    if product is not None:  # at rest the one nearest to 1, which stands for the trivial one, may be far off
        left = product[1] - (0.0 if vectors else float(np.sum(near.logs)))
        others, rounding = by_liouville(others, rounding, product[0], left, len(maps))
    norm = float(np.linalg.norm(scaled * scales / scales[:, None], 2))
    return Multipliers(near, others, rounding, matrix, size, max(1.0, norm * np.exp(min(size, 700.0))))


def _compiled(
    maps: Array, trivial: Trivial, units: Array, product: tuple[float, float] | None, with_rounding: bool
) -> Multipliers:
    """The same by the kernel."""
    maps, right, left = map(np.ascontiguousarray, (maps, trivial.right, trivial.left))
    n, determinant = maps.shape[1], product or (1.0, np.nan)
    known = trivial.count, right, left
    found = native.multipliers(maps, known, units, determinant, with_rounding, general_frame(n))
    logs, re, im, rounding = found[: 4 * n].reshape(4, n)
    first, size, norm, extreme = found[-4:].tolist()
    first, phases, matrix = int(first), re + 1j * im, found[4 * n : -4].reshape(n, n)
    others = Spectrum(logs[first:], phases[first:], bool(extreme))
    return Multipliers(Spectrum(logs[:first], phases[:first]), others, rounding[: n - first], matrix, size, norm)


def balancing(matrix: Array) -> Array:
    """Units, powers of 2, in which rows and columns of a matrix are of one size."""
    from scipy.linalg.lapack import dgebal

    return np.asarray(dgebal(matrix, scale=1, permute=0)[3])


def _apart(maps: Array, trivial: Trivial, vectors: tuple[Indices, Array] | None) -> tuple[Spectrum, Array, Array]:
    """The multipliers of what the vectors take out, the maps across that, and the sizes of their entries' terms."""
    if vectors is None:
        return Spectrum.of(np.empty(0, dtype=complex)), maps, np.abs(maps)
    places, known = vectors
    if len(places) < len(maps):
        parts = np.split(np.roll(maps, -places[0], axis=0), (places - places[0])[1:])
        maps = np.array([reduce(lambda done, following: following @ done, part) for part in parts])
    *blocks, across, sizes = _turned(maps, known, trivial.right.shape[1])
    values = []
    for block in blocks:
        if block.size:
            product, size = scaled_product(block)
            values.append(np.linalg.eigvals(product * np.exp(size)).astype(complex))
    return Spectrum.of(np.concatenate(values)), across, sizes


def _turned(maps: Array, vectors: Array, r: int) -> tuple[Array, Array, Array, Array]:
    """Maps in frames whose first columns span vectors (maps, v, n): of the first r, of the others, and across all.

    The last has sizes of the terms of its entries. The directions come first, in which nothing conserved changes, then
    what is left of the gradients.
    """
    first, v = np.linalg.qr(vectors.swapaxes(1, 2), mode="complete")[0], vectors.shape[1]
    last = np.roll(first, -1, axis=0).swapaxes(1, 2)
    turned, sizes = last @ maps @ first, np.abs(last[:, v:]) @ np.abs(maps) @ np.abs(first[:, :, v:])
    return turned[:, :r, :r], turned[:, r:v, r:v], turned[:, v:, v:], sizes


def _rounding(maps: Array, sizes: Array, found: Spectrum) -> Array:
    """What errors of the maps by rounding make of each multiplier, at first order, or of a pair that nearly meets."""
    K, n = maps.shape[:2]
    own = np.asarray(MAP_ENTRY_ROUNDING * MACHINE_EPSILON * K * np.abs(found.values))
    if n == 0 or found.extreme:
        return own
    product, size = scaled_product(maps)
    values, right = np.linalg.eig(product)
    order = np.argsort(-np.abs(values))
    right = right[:, order]
    with np.errstate(all="ignore"):  # of defective ones the condition is infinite, and so is the error
        try:
            left = np.linalg.inv(right)
        except np.linalg.LinAlgError:  # exactly defective
            left = np.full_like(right, np.inf)
        moved, whole = _moved(maps, sizes, left, right)
        conditions = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0) * np.exp(size)
        moved = MACHINE_EPSILON * (MAP_ENTRY_ROUNDING * moved + BACKWARD_ERROR_UNITS * conditions)
        bound = np.sqrt(MAP_ENTRY_ROUNDING * MACHINE_EPSILON * whole)
    return np.asarray(np.fmin(np.maximum(moved, MACHINE_EPSILON * np.abs(found.values)), bound))


def _moved(maps: Array, sizes: Array, left: NDArray[Any], right: NDArray[Any]) -> tuple[Array, float]:
    """How much all entries of all maps, changed by parts of `sizes`, move each eigenvalue, and the whole product."""
    one = np.eye(len(left))[None]
    there = np.concatenate([one, _running(maps)[:-1]])
    back = np.concatenate([one, _running(maps[:0:-1].swapaxes(1, 2)).swapaxes(1, 2)])[::-1]
    terms = (np.abs(left @ back) @ sizes) * np.abs(there @ right).swapaxes(1, 2)
    return np.sum(terms, axis=(0, 2)), float(np.sum(np.abs(back) @ sizes @ np.abs(there)))


def _running(maps: Array) -> Array:
    """Products of the first maps, of 1, of 2, and so on."""
    return np.array(list(accumulate(maps, lambda done, matrix: matrix @ done))).reshape(maps.shape)
