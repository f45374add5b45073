"""The multipliers of a closed chain of maps, those that are 1 for every orbit apart from the others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from casadi_skin.stability.product_spectrum import Spectrum, by_liouville, scaled_product, spectrum_of
from casadi_skin.stability.trivial import Frames, Trivial
from casadi_skin.zero.problem import Array

MACHINE = float(np.finfo(float).eps)
ROUNDING = 64.0  # units in the last place by which entries of a map over an interval are off: measured
BACKWARD = 4.0  # the same of a matrix, relative to its norm, whose eigenvalues LAPACK finds
COUPLED = 1e-8  # of the largest diagonal entry of a product: entries that units are chosen by are no smaller


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
    coupled = np.abs(scaled) + COUPLED * (np.max(np.abs(np.diagonal(scaled)), initial=0.0) or 1.0)
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
    own = np.asarray(ROUNDING * MACHINE * K * np.abs(found.values))
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
        moved = ROUNDING * MACHINE * np.sum(terms, axis=(0, 2))
        conditions = np.linalg.norm(left, axis=1) * np.linalg.norm(right, axis=0) * np.linalg.norm(there[K])
        moved += BACKWARD * MACHINE * conditions
        whole = ROUNDING * MACHINE * float(np.sum(np.abs(back[1:]) @ sizes @ np.abs(there[:-1])))
    return np.asarray(np.fmin(np.maximum(moved, MACHINE * np.abs(found.values)), np.sqrt(whole)))
