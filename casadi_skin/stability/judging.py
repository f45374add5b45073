"""The error of each multiplier, from those of a better solution: what its discretisation, and the orbit's, are off by.

Multipliers that nearly meet move by the root of an error: so do those of the better solution, of which they are away by
as much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casadi_skin.stability.closed_maps import Multipliers
from casadi_skin.stability.product_spectrum import Spectrum
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import LARGEST_LOGARITHM, FullPeriodFloquet
from casadi_skin.stability.tongues.assembly import Group
from casadi_skin.stability.tongues.interpolation import Gap
from casadi_skin.zero.problem import Array

DISTANCE_SAFETY = 2.0  # distances to the better solution are the error up to the error of that
TRIVIAL_DRIFT = (
    100.0  # tolerances by which the trivial multiplier may be off, times the size of the balanced monodromy matrix
)


def judged(found: Multipliers, better: Multipliers | None, tolerance: float, left: float = 0.0) -> FullPeriodFloquet:
    """Multipliers with the errors that better ones show, of which the part `left` is in these too; infinite without."""
    errors = np.full(found.rounding.size, np.inf)
    if better is not None:
        errors = DISTANCE_SAFETY / (1.0 - left) * _distances(found.others, better.others) + found.rounding
    near, count = found.trivial.values, found.trivial.values.size
    deviation = float(np.prod(np.abs(near - 1.0)) ** (1.0 / max(count, 1))) if count else 0.0
    return FullPeriodFloquet(
        np.concatenate([near, found.others.values]),
        found.matrix * np.exp(min(found.size, LARGEST_LOGARITHM)),
        count, deviation, errors, float(TRIVIAL_DRIFT * tolerance * found.norm),
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


# The account of a family: multipliers outside the unit circle at its orbits, each beside the tongue that it is in -----

CLEARLY_OUTSIDE_ERRORS = 4.0  # errors of a mu that it is outside by, to be in the account
LEAST_DISTANCE = 1e-9  # of such a distance: rounding of two mu that nearly meet
SAME_PLACE = 1e-13  # of a coordinate: rounding of sums
NEAR_TONGUE_DISTANCE = 1e-3  # distance of a mu at an orbit from that of its tongue there, beside ten errors
UNBALANCED_WORDS = (
    "the account does not balance: multipliers outside the unit circle at an orbit are not those of its tongues"
)


@dataclass(frozen=True)
class Entry:
    """All mu at an orbit, with their errors, and the coordinate of the orbit along the branch."""

    coordinate: float
    mu: ComplexArray
    errors: Array


def unbalanced(entries: Sequence[Entry], groups: Sequence[Group], gaps: Sequence[Gap]) -> list[Gap]:
    """Stretches around orbits whose unstable mu are not those of the groups of segments there.

    Each reaches from the last orbit before to the next one behind at which the account balances. Orbits in `gaps` are
    in no account, and neither are mu that are outside by no more than errors.
    """
    segments = [segment for group in groups for segment in group.segments]
    starts, ends = (np.array([getattr(segment, name) for segment in segments]) for name in ("start", "end"))
    found: list[Gap] = []
    balanced = True
    last = entries[0].coordinate if entries else 0.0
    for entry in entries:
        if any(gap.start <= entry.coordinate <= gap.end for gap in gaps):
            continue
        slack = SAME_PLACE * abs(entry.coordinate)
        here = np.flatnonzero((starts <= entry.coordinate + slack) & (entry.coordinate - slack <= ends))
        parts = [segments[i].block.unstable_mu(segments[i], entry.coordinate) for i in here.tolist()]
        fits = _fits(entry, np.concatenate([np.empty(0, complex), *parts]))
        if not fits and balanced:
            found.append(Gap(last, entry.coordinate, UNBALANCED_WORDS))
        elif not balanced:
            found[-1] = Gap(found[-1].start, entry.coordinate, UNBALANCED_WORDS)
        balanced, last = fits, entry.coordinate
    return found


def _fits(entry: Entry, unstable: ComplexArray) -> bool:
    """Whether all mu that are clearly outside at an orbit are near one of a tongue, and the other way round."""
    if entry.mu.size == 0:
        return True
    own, theirs = (mu.real + 1j * np.abs(mu.imag) for mu in (entry.mu, unstable))
    far = _outside(own) > CLEARLY_OUTSIDE_ERRORS * entry.errors + LEAST_DISTANCE
    if np.any(far) and unstable.size == 0:
        return False
    apart = np.abs(own[:, None] - theirs)
    if np.any(np.min(apart[far], axis=1, initial=np.inf) > NEAR_TONGUE_DISTANCE + 10.0 * entry.errors[far]):
        return False
    nearest = np.argmin(apart, axis=0)
    clear = _outside(theirs) > CLEARLY_OUTSIDE_ERRORS * entry.errors[nearest] + LEAST_DISTANCE
    return bool(np.all(_outside(own[nearest[clear]]) > 0.0))


def _outside(mu: ComplexArray) -> Array:
    """Distances from [-1, 0]; 0 inside."""
    return np.asarray(np.abs(mu - np.clip(mu.real, -1.0, 0.0)))
