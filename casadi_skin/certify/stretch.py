"""`certify_branch`: a stretch of a family proved to be one smooth curve of orbits, one for each S, without fold.

The theorem holds for all S of an interval at once when S in the amplitude's equation is the ball around it: one orbit
for each S within a radius of a centre, a smooth function of S because the derivative is invertible there. Neighbouring
pieces are parts of one curve where at an S of both the orbit of one lies where that of the other is the only one.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import count
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.arguments import number
from casadi_skin.certify import balls
from casadi_skin.certify.bounds import holds, proved_radius
from casadi_skin.certify.certify import WEIGHT, Attempt, attempt_near, best_attempt, reason_of
from casadi_skin.certify.model_terms import system_of
from casadi_skin.certify.odd_system import OddSeries
from casadi_skin.orbits.branch import Branch
from casadi_skin.orbits.certificate import Constants, ProvedStretch
from casadi_skin.orbits.family import Family
from casadi_skin.threads import one_thread

if TYPE_CHECKING:
    from flint import arb

PART = 0.9  # of the widest interval of S that the bounds allow
STEP = 0.8  # of the sum of the half-widths of neighbours: how far apart their centres are tried
SHORTER = 0.7
RICH = 0.25  # Z above which more harmonics are taken
GROWTH = 1.2
TRIALS = 12
ACCEPTED = "a family that is followed in S and passes each S once"


@dataclass(frozen=True, eq=False)
class _Piece:
    """The theorem about one centre for every S within `half` of S."""

    S: float
    attempt: Attempt
    slope: float  # what Y grows by per unit of S
    half: float

    def constants(self, distance: float) -> Constants:
        """The bounds for every S within a distance."""
        known = self.attempt.constants
        Y = balls.above(_ball(known.Y) + _ball(self.slope) * _ball(distance))
        return Constants(Y, known.Z, known.W, known.reach)


def certify_branch(branch: Branch, start: float, end: float) -> ProvedStretch:
    """Prove that the orbits of a family from one S to another are one curve without fold or branch point.

    Arguments:
        branch: a family of a model that `certify` accepts, which passes each S of the stretch once.
        start, end: values of S, start < end, on the family.

    Returns:
        How far it is proved from `start`, and why no farther.

    Raises:
        ValueError: the branch is no such family, in one line.
        ImportError: python-flint (the extra "certify") is missing.
    """
    flint = balls.flint()
    if not isinstance(branch.space, Family):
        raise ValueError(f"certify: given a branch of {branch.parameter}; accepted: {ACCEPTED}")
    if not 0.0 < number("start", start) < number("end", end):
        raise ValueError(f"start, end: given {start!r}, {end!r}; accepted: 0 < start < end")
    if np.any(np.diff(branch.S) * np.diff(branch.S)[:1] <= 0.0):
        raise ValueError(f"certify: given a branch that turns back in S; accepted: {ACCEPTED}")
    with flint.ctx.workprec(balls.PRECISION), one_thread():
        _, first = best_attempt(branch.at(S=start))
        if not first.proved:
            return ProvedStretch(start, start, 0, reason_of(first))
        return _walk(branch, start, end, first)


def _walk(branch: Branch, start: float, end: float, first: Attempt) -> ProvedStretch:
    """Pieces one after the other until the end, or until none can be joined to the last."""
    piece: _Piece | None = _piece(start, first)
    for pieces in count(1):
        assert piece is not None
        if piece.S + piece.half >= end:
            _, last = best_attempt(branch.at(S=end))
            if not last.proved or not _holds_there(piece, end - piece.S, _distance(last, piece.attempt, last.radius)):
                return ProvedStretch(start, end, pieces, "the curve is not proved to end at the orbit of the branch")
            return ProvedStretch(start, end, pieces)
        reached = piece.S + piece.half
        piece = _next(branch, piece, end)
        if piece is None:
            return ProvedStretch(start, reached, pieces, f"no piece beyond S = {reached:.9g} can be joined to the last")
    raise AssertionError


def _next(branch: Branch, piece: _Piece, end: float) -> _Piece | None:
    """The piece beyond one, joined to it; None where none is found."""
    harmonics, step = piece.attempt.series.harmonics, 2.0 * STEP * piece.half
    for _ in range(TRIALS):
        S = min(piece.S + step, end)
        attempt = _continued(branch, piece, S, harmonics)
        if not attempt.constants.Z <= RICH:
            harmonics = int(np.ceil(GROWTH * harmonics))
            continue
        following = _piece(S, attempt)
        if attempt.proved and _joined(piece, following):
            return following
        step *= SHORTER
    return None


def _continued(branch: Branch, piece: _Piece, S: float, harmonics: int) -> Attempt:
    """The bounds at another S, from a piece's centre moved along the family's tangent."""
    from flint import arb

    assert isinstance(branch.space, Family)
    known, tangent = piece.attempt.series, piece.attempt.tangent
    assert tangent is not None
    system = system_of(branch.space.whole.coordinates, S)
    change = (S - piece.S) * tangent
    rows = change[1:].reshape(known.system.positions, -1).tolist()
    coefficients = []
    for row, moved, d, e in zip(known.coefficients, rows, known.system.scale, system.scale, strict=True):
        series = [((a + arb(c)) * d / e).mid() for a, c in zip(row, moved, strict=True)]
        coefficients.append(series + [arb(0)] * (harmonics - len(series)))
    return attempt_near(OddSeries(system, (known.square + arb(float(change[0]))).mid(), coefficients), WEIGHT)


def _piece(S: float, attempt: Attempt) -> _Piece:
    """The widest interval of S about a proved orbit, or nearly."""
    c = attempt.constants
    if not attempt.proved:
        return _Piece(S, attempt, float("nan"), 0.0)
    slope = attempt.per_amplitude
    half = PART * (0.5 * (1.0 - c.Z) ** 2 / c.W - c.Y) / slope
    piece = _Piece(S, attempt, slope, half)
    while half > 0.0 and proved_radius(piece.constants(half)) is None:
        half *= SHORTER
        piece = _Piece(S, attempt, slope, half if half > 1e-12 * S else 0.0)
    return piece


def _joined(one: _Piece, other: _Piece) -> bool:
    """Whether at an S of both intervals the orbit near one centre is the only one near the other."""
    gap = other.S - one.S
    if not one.half + other.half > gap:
        return False
    shared = gap * one.half / (one.half + other.half)  # beyond the first centre
    radius = proved_radius(one.constants(shared * (1.0 + 1e-9)))
    if radius is None:
        return False
    return _holds_there(other, gap - shared, _distance(one.attempt, other.attempt, radius))


def _holds_there(piece: _Piece, away: float, distance: float) -> bool:
    """Whether the only orbit within a distance of a centre, at an S away from it, is the one that is proved."""
    constants = piece.constants(away * (1.0 + 1e-9))
    smallest = proved_radius(constants)
    if smallest is None:
        return False
    radii = (smallest, distance, 1.01 * distance, 1.2 * distance)
    return any(distance <= r and holds(constants, r) for r in radii)


def _distance(one: Attempt, other: Attempt, radius: float) -> float:
    """Upper bound, in the other's norm, of the distance of its centre from what lies within a radius of one's."""
    from flint import arb

    a, b, nu = one.series, other.series, arb(WEIGHT)
    ratios = [d / e for d, e in zip(a.system.scale, b.system.scale, strict=True)]
    total = abs(a.square - b.square)
    for row, line, ratio in zip(a.coefficients, b.coefficients, ratios, strict=True):
        for i in range(max(len(row), len(line))):
            here = row[i] * ratio if i < len(row) else arb(0)
            there = line[i] if i < len(line) else arb(0)
            total += abs(here - there) * nu ** (2 * i + 1)
    largest = max((ratio for ratio in ratios), key=float).max(arb(1))
    return balls.above(total + _ball(radius) * largest)


def _ball(value: float) -> arb:
    from flint import arb

    return arb(value)
