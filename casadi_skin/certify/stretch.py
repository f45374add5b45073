"""`certify_branch`: a stretch of a family proved to be one smooth curve of orbits, one for each S, without fold.

The stretch is divided into pieces, on each of which the theorem holds for every S about one polynomial curve. Two
pieces are parts of one curve where at the S they share the orbit of one lies where that of the other is the only one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from casadi_skin.certify import balls
from casadi_skin.certify.balls import SUM_ROUNDING_FACTOR, above, arb, arb_mat, ball, exact, largest, rounded_up, size
from casadi_skin.certify.bounds import (
    LARGEST_RADIUS,
    FiniteInverse,
    curvature,
    holds,
    lipschitz,
    proved_radius,
    series_norms,
)
from casadi_skin.certify.certificate import Constants, ProvedStretch
from casadi_skin.certify.certify import (
    HARMONIC_WEIGHT,
    attempt_near,
    best_attempt,
    computed_series,
    cosines_of,
    distance,
    provable,
    reason_of,
    refined,
    step_of,
)
from casadi_skin.certify.system import CosineSeries, CosineSystem, system_of
from casadi_skin.follow.branch import Branch
from casadi_skin.follow.family import Family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain_coordinates import LongChain
from casadi_skin.model.arguments import number
from casadi_skin.model.result import in_turn
from casadi_skin.solve.watch import one_thread
from casadi_skin.zero.problem import Array

# The theorem for all values of a parameter at once: about a polynomial curve of series, with a polynomial operator A

MORE_NODES = 1.3  # than the degree of the bounded polynomial
LARGEST_Z = 0.9  # from which on no further node is looked at


@dataclass(frozen=True, eq=False)
class Curve:
    """Series that are polynomials of the parameter on an interval, with those that make up A.

    Attributes:
        system: the equations in positions of amplitude 1, without a value of their parameter.
        start, end: the interval of the parameter.
        centre: Chebyshev coefficients of lambda and of all a_nk, shape (degree + 1, 1 + positions * harmonics).
        inverse: those of A_f, shape (degree + 1, 1 + positions * harmonics, 1 + positions * harmonics).
        factor: those of the factor that is near 1/lambda, shape (degree + 1,).
    """

    system: CosineSystem
    start: float
    end: float
    centre: Array
    inverse: Array
    factor: Array

    @property
    def degree(self) -> int:
        return len(self.factor) - 1

    def parameter(self, x: arb) -> arb:
        """The parameter at a place of [-1, 1]."""
        return (arb(self.start) * (1 - x) + arb(self.end) * (1 + x)) / 2

    def place(self, parameter: arb) -> arb:
        """The place of [-1, 1] of a parameter."""
        return (2 * parameter - arb(self.start) - arb(self.end)) / (arb(self.end) - arb(self.start))

    def at(self, x: arb) -> CosineSeries:
        """The series at a place of [-1, 1]."""
        values = (arb_mat([self.chebyshev(x)]) * self._exact).entries()
        return CosineSeries.of(replace(self.system, parameter=self.parameter(x)), values)

    def chebyshev(self, x: arb) -> list[arb]:
        """T_0, ..., T_degree."""
        return [x.chebyshev_t(k) for k in range(self.degree + 1)]

    @cached_property
    def _exact(self) -> Any:
        return arb_mat(self.centre.tolist())

    def bounds_at(self, x: arb, nu: arb) -> Node:
        """Values at one place from which the bounds are computed."""
        T, series = self.chebyshev(x), self.at(x)
        matrix = np.tensordot(np.array([float(t) for t in T]), self.inverse, axes=1)
        bounds = FiniteInverse(series, nu, matrix, self._doubt(series, nu))
        factor = sum((arb(c) * t for c, t in zip(self.factor.tolist(), T, strict=True)), arb(0))
        finite, beyond = series.residuals()
        return Node(
            bounds.finite_columns(),
            np.array([size(value) for value in finite]),
            sum((abs(value) * nu**k / k**2 for _, k, value in beyond), arb(0)),
            bounds.norms,
            bounds.columns_below,
            float(np.max(bounds.slope.largest)),
            [bounds.derivative_norm(n) for n in range(self.system.positions)],
            abs(factor),
            abs(1 - factor * series.square),
            series_norms(series, nu),
        )

    def _doubt(self, series: CosineSeries, nu: arb) -> Array:
        """Weighted norms of the errors of A_f in doubles: sums of degree + 1 products with rounded T_k."""
        H, harmonic = series.harmonics, series.system.harmonic
        weights = np.array([1.0] + [above(nu ** harmonic(i)) for i in range(H)] * series.system.positions)
        moduli = self._moduli
        return rounded_up((self.degree + 6) * SUM_ROUNDING_FACTOR * (weights @ moduli), len(moduli))

    @cached_property
    def _moduli(self) -> Array:
        return rounded_up(np.abs(self.inverse).sum(axis=0), self.degree + 1)


@dataclass(frozen=True, eq=False)
class Node:
    """Bounds at one place of polynomials in the parameter.

    Attributes:
        finite: of the finite rows of I - A_f DF.
        residual: moduli of the finite rows of F, shape (1 + positions * harmonics,).
        tail: norm of the tail's rows of F over k^2.
        norms: of the columns of A_f.
        weights: lower bounds of the weights of its columns.
        slope: largest modulus of c_n.
        derivatives: of the forces' derivatives with respect to each position.
        factor: modulus of a number near 1/lambda; `defect` of 1 - lambda times it.
        sizes: norms of the series of each position.
    """

    finite: float
    residual: Array
    tail: arb
    norms: Array
    weights: Array
    slope: float
    derivatives: list[arb]
    factor: arb
    defect: arb
    sizes: list[arb]


def piece_constants(curve: Curve, nu: arb) -> Constants | None:
    """The bounds of the theorem for every parameter of a curve's interval; None where Z is seen to be too large."""
    forces, degree = _degrees(curve)
    count = int(np.ceil(MORE_NODES * (curve.degree + forces))) + 1
    nodes = list[Node]()
    for x in _nodes(count):
        nodes.append(curve.bounds_at(x, nu))
        if not nodes[-1].finite < LARGEST_Z:
            return None
    return _Uniform(curve, nu, nodes, count).constants(forces, degree)


def _degrees(curve: Curve) -> tuple[int, int]:
    """Degrees in the parameter of the derivative of the equations, and of the equations."""
    system, m = curve.system, curve.degree
    degrees = {len(factors) for terms in system.forces for factors in terms} | {1}
    derivative = max(m, *((p - 1) * m + (p - 1) // system.step for p in degrees))
    return derivative, max(2 * m, *(p * m + (p - 1) // system.step for p in degrees))


def _nodes(count: int) -> Iterator[arb]:
    """Chebyshev nodes from the ends to the middle, where bounds fail last."""
    for i in sorted(range(count), key=lambda i: min(i, count - 1 - i)):
        yield (arb.pi() * (2 * i + 1) / (2 * count)).cos()


@dataclass(frozen=True, eq=False)
class _Uniform:
    """Bounds for the whole interval from those at `count` nodes."""

    curve: Curve
    nu: arb
    nodes: Sequence[Node]
    count: int

    def between(self, degree: int) -> arb:
        """How much larger than at the nodes the norm of a polynomial may be anywhere."""
        if degree >= self.count:
            raise ArithmeticError(f"a polynomial of degree {degree} is not bounded by {self.count} values")
        return 1 / (arb.pi() * degree / (2 * self.count)).cos()

    def largest(self, values: Sequence[arb], degree: int) -> arb:
        """Bound of a polynomial's norm from those at the nodes."""
        return largest(values) * self.between(degree)

    def rows(self, values: Sequence[Array], degree: int) -> Array:
        """The same for each entry of an array."""
        return np.asarray(np.max(values, axis=0) * above(self.between(degree)) * (1.0 + SUM_ROUNDING_FACTOR))

    def constants(self, derivative: int, equations: int) -> Constants:
        """Y, Z and W from the degrees of DF and F."""
        curve, nodes, m = self.curve, self.nodes, self.curve.degree
        system, nu = curve.system, self.nu
        n = system.positions
        tail = system.harmonic((nodes[0].norms.size - 1) // n)
        norms = self.rows([node.norms for node in nodes], m)
        slope = self.largest([arb(node.slope) for node in nodes], m)
        factor = self.largest([node.factor for node in nodes], m)
        beyond = 1 + arb(float(norms[0])) * slope / nu**tail
        # Y
        finite = self.rows([node.residual for node in nodes], equations)
        outside = factor * self.largest([node.tail for node in nodes], equations)
        Y = above(arb(float(rounded_up(norms @ finite, norms.size))) + beyond * outside)
        # Z
        inside = self.largest([arb(node.finite) for node in nodes], m + derivative)
        defect = self.largest([node.defect for node in nodes], 2 * m)
        rows = [self.largest([node.derivatives[i] for node in nodes], derivative) for i in range(n)]
        Z = above(inside + beyond * (defect + factor * largest(rows) / tail**2))
        # W
        sizes = [self.largest([node.sizes[i] for node in nodes], m) for i in range(n)]
        reach = LARGEST_RADIUS * max(size(value) for value in sizes)
        strongest = replace(system, parameter=arb(max(abs(curve.start), abs(curve.end))))
        curved = curvature(strongest, sizes, reach)
        return Constants(Y, Z, lipschitz(system, nu, curved, norms, nodes[0].weights, beyond, factor), reach)


PIECE_DEGREE = 10  # of the polynomials of a piece
WIDTH_GROWTH, WIDTH_DECREASE = 1.6, 0.6  # widths of pieces after one that is proved, and after one that is not
SHORTEST_PIECE = 1e-4  # of the end: pieces below are given up
MOST_UNKNOWNS = 2000  # unknowns: the matrices at all nodes take 350 megabytes
FEWEST_HARMONICS = 3  # harmonics
HARMONICS_GROWTH = 1.25
END_WIDENING = 2.0**-50  # of a stretch: it holds its ends' decimals, their doubles and the rounded square roots
ENOUGH_Z, ENOUGH_Y = 0.15, 0.02  # Z and Y W at the far end of a piece, by which harmonics are chosen
MODE_FREQUENCY_SLACK = 1e-9  # of the computed frequency of the linear mode
ACCEPTED_FAMILIES = "a family that is followed in S and passes each S once"


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
        size = float(np.sqrt(parameter)) if self.system.step == 2 else parameter
        orbit = self.branch.at(S=size**2)
        size *= _sign(orbit)
        known = computed_series(orbit, self.system, harmonics)
        middles = [[(a / size).mid() for a in row[:harmonics]] for row in known.coefficients]
        return CosineSeries(replace(self.system, parameter=arb(parameter)), known.square.mid(), middles)

    def harmonics(self, parameter: float, fewest: int) -> int | None:
        """How many harmonics a piece needs that ends at a parameter; None where there are not enough."""
        H = fewest
        while 1 + self.system.positions * H <= MOST_UNKNOWNS:
            c = attempt_near(self.orbit_near(parameter, H), self.nu).constants
            if c.Z < ENOUGH_Z and c.Y * c.W < ENOUGH_Y:
                return H
            H = int(np.ceil(HARMONICS_GROWTH * H))
        return None

    def curve(self, start: float, end: float, harmonics: int) -> Curve:
        """Polynomials, as Chebyshev series, through orbits and inverses at the nodes of an interval."""
        m = PIECE_DEGREE + 1
        nodes = np.cos(np.pi * (np.arange(m) + 0.5) / m)
        found = [self._at_node(0.5 * (start + end) + 0.5 * (end - start) * x, harmonics) for x in nodes.tolist()]
        values, inverses = np.array([v for v, _ in found]), np.array([A for _, A in found])
        return Curve(self.system, start, end, *map(cosines_of, (values, inverses, 1.0 / values[:, 0])))

    def _at_node(self, parameter: float, harmonics: int) -> tuple[Array, Array]:
        inverse = FiniteInverse(self.orbit_near(parameter, harmonics), self.nu)
        series = refined(inverse)
        return np.array([float(z) for z in series.unknowns]), FiniteInverse(series, self.nu).matrix


def _sign(orbit: Orbit) -> float:
    """The sign by which an orbit differs from the continuous choice along its family: its largest site is positive."""
    shown, solved = orbit.evaluate(0.0), orbit.space.positions(orbit.point, np.zeros(1))[0]
    return float(np.sign(shown @ solved))


@in_turn
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
    if not branch.space.is_family:
        raise ValueError(f"certify: given a branch of {branch.parameter}; accepted: {ACCEPTED_FAMILIES}")
    if not 0.0 <= number("start", start) < number("end", end) <= branch.S[-1]:
        accepted = f"0 <= start < end <= {float(branch.S[-1])!r}, where the branch ends"
        raise ValueError(f"start, end: given {start!r}, {end!r}; accepted: {accepted}")
    if np.any(np.diff(branch.S) * np.diff(branch.S)[:1] <= 0.0):
        raise ValueError(f"certify: given a branch that turns back in S; accepted: {ACCEPTED_FAMILIES}")
    family = provable(branch.space)
    if isinstance(family.coordinates, LongChain):
        raise ValueError("certify: given a chain with a tail that is no unknown; accepted: up to 500 sites")
    with flint.ctx.workprec(balls.BALL_PRECISION_BITS), one_thread():
        system = system_of(family.coordinates, 1.0, step_of(family), family.request.decimals)
        if any(() in terms for terms in system.forces):
            raise ValueError(f"certify: given {family.coordinates.model.name}; accepted: forces that vanish at rest")
        low, high = (float(x) if system.step == 2 else float(np.sqrt(x)) for x in (start, end))
        low, high = low * (1.0 - END_WIDENING), high * (1.0 + END_WIDENING)
        return _proved(_Stretch(branch, family, system, flint.arb(HARMONIC_WEIGHT), high), start, end, low)


def _proved(stretch: _Stretch, start: float, end: float, low: float) -> ProvedStretch:
    """Pieces one after the other until the end, or until none can be joined to the last."""
    pieces = list[_Piece]()
    reached, width, harmonics, reason = low, stretch.end - low, FEWEST_HARMONICS, ""
    while reached < stretch.end and not reason:
        far = min(reached + width, stretch.end)
        needed = stretch.harmonics(far, harmonics if far > reached + 0.5 * width else FEWEST_HARMONICS)
        piece = None if needed is None else _piece(stretch, reached, far, needed)
        if piece is not None and (_joined(pieces[-1], piece) if pieces else not _fault(stretch, piece, start)):
            pieces.append(piece)
            reached, width = far, WIDTH_GROWTH * width
        else:
            width *= WIDTH_DECREASE
            if width < SHORTEST_PIECE * stretch.end:
                reason = f"no piece beyond S = {_S(stretch, reached):.9g} is proved and joined to the last"
                if needed is None:
                    reason += f": more than {MOST_UNKNOWNS} unknowns would be needed"
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
    here, there = one.curve.at(arb(1)), other.curve.at(arb(-1))
    return _only_one(other, balls.above(arb(distance(here, there, other.nu)) + arb(one.radius)))


def _only_one(piece: _Piece, away: float) -> bool:
    """Whether an orbit that lies within a distance of a curve is the one that is proved."""
    return any(away <= r and holds(piece.constants, r) for r in (piece.radius, away, 1.01 * away, 1.2 * away))


def _fault(stretch: _Stretch, piece: _Piece | None, S: float) -> str:
    """Why a piece does not hold the branch's orbit at an S, the linear mode at S = 0; empty where it does."""
    if piece is None:
        return ""
    centre = piece.curve.at(piece.curve.place(stretch.parameter(S)))
    if S == 0.0:
        first = centre.system.harmonic(0)
        moves = any(bool(abs(a) > piece.radius) for row in centre.coefficients for a in row[1 - first : 2 - first])
        square = (centre.square + arb(0, piece.radius)) * arb(1, MODE_FREQUENCY_SLACK)
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
    away = balls.above(arb(distance(moved, centre, stretch.nu)) + arb(attempt.radius) * largest([arb(1), *ratios]))
    return "" if _only_one(piece, away) else f"the curve is not proved to hold the branch's orbit at S = {S!r}"
