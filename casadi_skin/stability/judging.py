"""The error of each multiplier, from those of a better solution: what its discretisation, and the orbit's, are off by.

Multipliers that nearly meet move by the root of an error: so do those of the better solution, of which they are away by
as much.
"""

from __future__ import annotations

import numpy as np

from casadi_skin.stability.closed_maps import Multipliers
from casadi_skin.stability.product_spectrum import Spectrum
from casadi_skin.stability.result import LARGEST_LOGARITHM, FullPeriodFloquet
from casadi_skin.zero.problem import Array

SAFETY = 2.0  # distances to the better solution are the error up to the error of that
DRIFT = 100.0  # tolerances by which the trivial multiplier may be off, times the size of the balanced monodromy matrix


def judged(found: Multipliers, better: Multipliers | None, tolerance: float, left: float = 0.0) -> FullPeriodFloquet:
    """Multipliers with the errors that better ones show, of which the part `left` is in these too; infinite without."""
    errors = np.full(found.rounding.size, np.inf)
    if better is not None:
        errors = SAFETY / (1.0 - left) * _distances(found.others, better.others) + found.rounding
    near, count = found.trivial.values, found.trivial.values.size
    deviation = float(np.prod(np.abs(near - 1.0)) ** (1.0 / max(count, 1))) if count else 0.0
    return FullPeriodFloquet(
        np.concatenate([near, found.others.values]),
        found.matrix * np.exp(min(found.size, LARGEST_LOGARITHM)),
        count, deviation, errors, float(DRIFT * tolerance * found.norm),
        np.concatenate([found.trivial.logs, found.others.logs]), found.lost,
    )  # fmt: skip


def _distances(found: Spectrum, better: Spectrum) -> Array:
    """Of each eigenvalue from the one that it is paired with; infinite without one."""
    from scipy.optimize import linear_sum_assignment

    values, others = found.values, better.values
    with np.errstate(invalid="ignore", over="ignore"):
        sizes = np.maximum(1.0, np.maximum(np.abs(values)[:, None], np.abs(others)))
        apart = np.abs(values[:, None] / sizes - others / sizes)
    rows, columns = linear_sum_assignment(apart)
    distances = np.full(values.size, np.inf)
    with np.errstate(over="ignore"):
        distances[rows] = apart[rows, columns] * sizes[rows, columns]
    if not values.size:
        return distances
    partners = np.argmin(np.abs(values[:, None].conj() - values), axis=1)
    return np.asarray(np.maximum(distances, distances[partners]))
