"""`certify_branch`: a stretch of a family proved to be one smooth curve of orbits, one for each S, without fold.

The stretch is divided into pieces, on each of which the theorem holds for every S about one polynomial curve. Two
pieces are parts of one curve where at the S they share the orbit of one lies where that of the other is the only one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import dct

from casadi_skin.certify import balls
from casadi_skin.certify.attempt import attempt_near, cosine_coefficients, distance, refined
from casadi_skin.certify.bounds import FiniteInverse, holds, proved_radius
from casadi_skin.certify.certificate import Constants, ProvedStretch
from casadi_skin.certify.certify import WEIGHT, best_attempt, provable, reason_of, step_of
from casadi_skin.certify.cosine_system import CosineSeries, CosineSystem
from casadi_skin.certify.model_terms import ball, exact, system_of
from casadi_skin.certify.polynomial_piece import Curve, piece_constants
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.model.arguments import number
from casadi_skin.solve.threads import one_thread
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from flint import arb

DEGREE = 10  # of the polynomials of a piece
WIDER, SHORTER = 1.6, 0.6  # widths of pieces after one that is proved, and after one that is not
SHORTEST = 1e-4  # of the end: pieces below are given up
MOST = 2000  # unknowns: the matrices at all nodes take 350 megabytes
FEWEST = 3  # harmonics
GROWTH = 1.25
WIDENING = 2.0**-50  # relative, of a stretch: it holds its ends' decimals, their doubles and the rounded square roots
ENOUGH_Z, ENOUGH_Y = 0.15, 0.02  # Z and Y W at the far end of a piece, by which harmonics are chosen
SLACK = 1e-9  # of the computed frequency of the linear mode
ACCEPTED = "a family that is followed in S and passes each S once"


@dataclass(frozen=True, eq=False)
class _Piece:
    """A curve with the bounds about it, and a radius within which there is an orbit for each parameter."""

    curve: Curve
    nu: arb
    constants: Constants
    radius: float


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Data that all pieces share: the family, its equations for positions of amplitude 1, and the norm."""

    branch: Branch
    family: Family
    system: CosineSystem
    nu: arb
    end: float  # of the parameter: S for odd cosines, sqrt(S) for all

    def parameter(self, S: float) -> arb:
        """The parameter of an S, which is the decimal that it is printed as for a family of decimals."""
        value = ball(exact(S, self.family.request.decimals))
        return value if self.system.step == 2 else value.sqrt()

    def orbit_near(self, parameter: float, harmonics: int) -> CosineSeries:
        """Coefficients of the branch's orbit at a parameter, for positions of amplitude 1."""
        from flint import arb

        size = float(np.sqrt(parameter)) if self.system.step == 2 else parameter
        orbit = self.branch.at(S=size**2)
        size *= _sign(orbit)
        columns = cosine_coefficients(orbit, self.system, harmonics).T.tolist()
        rows = [[arb(c) / d / size for c in column] for column, d in zip(columns, self.system.scale, strict=True)]
        middles = [[a.mid() for a in row] for row in rows]
        return CosineSeries(replace(self.system, parameter=arb(parameter)), arb(orbit.Omega**2), middles)

    def harmonics(self, parameter: float, fewest: int) -> int | None:
        """How many harmonics a piece needs that ends at a parameter; None where there are not enough."""
        H = fewest
        while 1 + self.system.positions * H <= MOST:
            c = attempt_near(self.orbit_near(parameter, H), self.nu).constants
            if c.Z < ENOUGH_Z and c.Y * c.W < ENOUGH_Y:
                return H
            H = int(np.ceil(GROWTH * H))
        return None

    def curve(self, start: float, end: float, harmonics: int) -> Curve:
        """Polynomials through orbits and inverses at Chebyshev nodes of an interval."""
        m = DEGREE + 1
        nodes = np.cos(np.pi * (np.arange(m) + 0.5) / m)
        found = [self._at_node(0.5 * (start + end) + 0.5 * (end - start) * x, harmonics) for x in nodes.tolist()]
        values, inverses = np.array([v for v, _ in found]), np.array([A for _, A in found])
        return Curve(self.system, start, end, _chebyshev(values), _chebyshev(inverses), _chebyshev(1.0 / values[:, 0]))

    def _at_node(self, parameter: float, harmonics: int) -> tuple[Array, Array]:
        inverse = FiniteInverse(self.orbit_near(parameter, harmonics), self.nu)
        series = refined(inverse)
        values = [float(series.square), *(float(a) for row in series.coefficients for a in row)]
        return np.array(values), FiniteInverse(series, self.nu).matrix


def _sign(orbit: Orbit) -> float:
    """The sign by which an orbit differs from the continuous choice along its family: its largest site is positive."""
    assert isinstance(orbit.space, Family)
    shown, solved = orbit.evaluate(0.0), orbit.space.positions(orbit.point, np.zeros(1))[0]
    return float(np.sign(shown @ solved))


def _chebyshev(values: Array) -> Array:
    """Chebyshev coefficients along the first axis from values at the nodes."""
    coefficients = dct(values, axis=0) / len(values)
    coefficients[0] *= 0.5
    return np.asarray(coefficients)


def certify_branch(branch: Branch, start: float, end: float) -> ProvedStretch:
    """Prove that the orbits of a family from one S to another are one curve without fold or branch point.

    Arguments:
        branch: a family of a model that `certify` accepts, which passes each S of the stretch once.
        start, end: values of S, start < end, on the family; from 0 it starts at the linear mode.

    Returns:
        How far it is proved from `start`, and why no farther.

    Raises:
        ValueError: the branch is no such family, in one line.
        ImportError: python-flint (the extra "certify") is missing.
    """
    flint = balls.flint()
    if not isinstance(branch.space, Family):
        raise ValueError(f"certify: given a branch of {branch.parameter}; accepted: {ACCEPTED}")
    if not 0.0 <= number("start", start) < number("end", end) <= branch.S[-1]:
        accepted = f"0 <= start < end <= {float(branch.S[-1])!r}, where the branch ends"
        raise ValueError(f"start, end: given {start!r}, {end!r}; accepted: {accepted}")
    if np.any(np.diff(branch.S) * np.diff(branch.S)[:1] <= 0.0):
        raise ValueError(f"certify: given a branch that turns back in S; accepted: {ACCEPTED}")
    family = provable(branch.space)
    if isinstance(family.coordinates, CoreWithTail):
        raise ValueError("certify: given a chain with a tail that is no unknown; accepted: up to 500 sites")
    with flint.ctx.workprec(balls.PRECISION), one_thread():
        system = system_of(family.coordinates, 1.0, step_of(family), family.request.decimals)
        if any(() in terms for terms in system.forces):
            raise ValueError(f"certify: given {family.coordinates.model.name}; accepted: forces that vanish at rest")
        low, high = (float(x) if system.step == 2 else float(np.sqrt(x)) for x in (start, end))
        low, high = low * (1.0 - WIDENING), high * (1.0 + WIDENING)
        return _proved(_Stretch(branch, family, system, flint.arb(WEIGHT), high), start, end, low)


def _proved(stretch: _Stretch, start: float, end: float, low: float) -> ProvedStretch:
    """Pieces one after the other until the end, or until none can be joined to the last."""
    pieces = list[_Piece]()
    reached, width, harmonics, reason = low, stretch.end - low, FEWEST, ""
    while reached < stretch.end and not reason:
        far = min(reached + width, stretch.end)
        needed = stretch.harmonics(far, harmonics if far > reached + 0.5 * width else FEWEST)
        piece = None if needed is None else _piece(stretch, reached, far, needed)
        if piece is not None and (_joined(pieces[-1], piece) if pieces else not _fault(stretch, piece, start)):
            pieces.append(piece)
            reached, width = far, WIDER * width
        else:
            width *= SHORTER
            if width < SHORTEST * stretch.end:
                reason = f"no piece beyond S = {_S(stretch, reached):.9g} is proved and joined to the last"
                if needed is None:
                    reason += f": more than {MOST} unknowns would be needed"
                elif not pieces:
                    reason = _fault(stretch, piece, start) or reason
    if not reason:
        reason = _fault(stretch, pieces[-1], end)
    breaks = tuple(_S(stretch, piece.curve.end) for piece in pieces[:-1])
    last = end if reached == stretch.end else _S(stretch, reached) if pieces else start
    radius = max((piece.radius for piece in pieces), default=float("nan"))
    return ProvedStretch(start, last, len(pieces), reason, breaks, radius)


def _S(stretch: _Stretch, parameter: float) -> float:
    return parameter if stretch.system.step == 2 else parameter**2


def _piece(stretch: _Stretch, start: float, end: float, harmonics: int) -> _Piece | None:
    """The theorem on an interval of the parameter; None where it does not hold."""
    try:
        curve = stretch.curve(start, end, harmonics)
    except np.linalg.LinAlgError:  # an orbit at which the equations are singular
        return None
    constants = piece_constants(curve, stretch.nu)
    radius = None if constants is None else proved_radius(constants)
    return None if constants is None or radius is None else _Piece(curve, stretch.nu, constants, radius)


def _joined(one: _Piece, other: _Piece) -> bool:
    """Whether the orbit near the end of one curve is the only one near the start of the other."""
    from flint import arb

    here, there = one.curve.at(arb(1)), other.curve.at(arb(-1))
    return _only_one(other, balls.above(arb(distance(here, there, other.nu)) + arb(one.radius)))


def _only_one(piece: _Piece, away: float) -> bool:
    """Whether an orbit that lies within a distance of a curve is the one that is proved."""
    return any(away <= r and holds(piece.constants, r) for r in (piece.radius, away, 1.01 * away, 1.2 * away))


def _fault(stretch: _Stretch, piece: _Piece | None, S: float) -> str:
    """Why a piece does not hold the branch's orbit at an S, the linear mode at S = 0; empty where it does."""
    from flint import arb

    if piece is None:
        return ""
    centre = piece.curve.at(piece.curve.place(stretch.parameter(S)))
    if S == 0.0:
        first = centre.system.harmonic(0)
        moves = any(bool(abs(a) > piece.radius) for row in centre.coefficients for a in row[1 - first : 2 - first])
        square = (centre.square + arb(0, piece.radius)) * arb(1, SLACK)
        near = square.overlaps(arb(stretch.family.coordinates.frequency) ** 2)
        return "" if moves and near else "the curve is not proved to start at the linear mode"
    orbit = stretch.branch.at(S=S)
    _, attempt = best_attempt(orbit)
    if not attempt.proved:
        return f"the orbit at S = {S!r} is not proved: {reason_of(attempt)}"
    size = stretch.parameter(S) if stretch.system.step == 1 else stretch.parameter(S).sqrt()
    known = attempt.series
    sign = int(_sign(orbit))
    ratios = [d / (e * size) for d, e in zip(known.system.scale, stretch.system.scale, strict=True)]
    rows = [[sign * a * ratio for a in row] for row, ratio in zip(known.coefficients, ratios, strict=True)]
    moved = CosineSeries(stretch.system, known.square, rows)
    largest = arb(1)
    for ratio in ratios:
        largest = largest.max(ratio)
    away = balls.above(arb(distance(moved, centre, stretch.nu)) + arb(attempt.radius) * largest)
    return "" if _only_one(piece, away) else f"the curve is not proved to hold the branch's orbit at S = {S!r}"
