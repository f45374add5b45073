"""Special points on a stretch of a branch of equilibria: told apart by their eigenvalues, then located one by one.

The parameter turns back at a fold; the Jacobian bordered by the tangent changes the sign of its determinant at a
branch point; a pair of complex eigenvalues crosses the imaginary axis at a Hopf point. Eigenvalues of the two ends are
matched, and a stretch is halved until each crossing has its own point; cubics through both ends show what comes back to
the axis in between. Neutral saddles have no eigenvalue on the axis, and are not seen.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import Point
from casadi_skin.equilibria.crossings import Stretch, crossings, end_of, height, matched, stretch_between
from casadi_skin.equilibria.location import BRANCH_POINT, FOLD, HOPF, Located, locate
from casadi_skin.solvers.levels import ErrorEstimate

if TYPE_CHECKING:
    from casadi_skin.equilibria.space import EquilibriumSpace

DEEPEST = 14  # halvings of a stretch in which several eigenvalues cross
SUSPECTED = 10  # halvings where they only seem to come back to the axis
TOGETHER = 4  # halvings after which a fold and a branch point that are not told apart are one
MARGIN = 0.2  # of what a cubic changes by on a stretch: how far it may be from what it stands for
BISECTIONS = 40
SAME = 1e-9  # of a step or of a frequency
BESIDE_FOUND = 1e-3  # of the way from a special point to an end: where the search for further ones begins
BESIDE = 0.7  # of a stretch: how far from where it is expected a special point may be found


@dataclass(frozen=True, eq=False)
class Found:
    """A special point with its place along a stretch and its frequency, 0 where it has none."""

    along: float
    frequency: float
    point: Point


class UnresolvedWarning(UserWarning):
    """Several eigenvalues cross the imaginary axis on a stretch of a branch that is too short to tell them apart."""


def special_between(space: EquilibriumSpace, before: Point, after: Point) -> Iterator[Point]:
    """Special points between two points of a branch, in order, each marked by its kind.

    Warns with UnresolvedWarning where several lie too near to each other to be told apart.
    """
    yield from _search(space, before, after, 0)


def _search(space: EquilibriumSpace, before: Point, after: Point, depth: int) -> Iterator[Point]:
    stretch = stretch_between(space.point_solver, before, after)
    order = matched(stretch)
    reals, pairs = crossings(stretch, order) if space.statics.oscillates else ([], [])
    expected = [FOLD] * stretch.turns + [BRANCH_POINT] * stretch.reorients
    if not (expected or reals or pairs) and not (depth < SUSPECTED and _returns(space, stretch, order)):
        return
    if set(expected) == {FOLD, BRANCH_POINT} and not reals and depth >= TOGETHER:
        expected, reals = [BRANCH_POINT], reals or [0]  # they are one, where a branch leaves another one to one side
    alone = len(reals) == len(expected) or not space.statics.oscillates
    if len(expected) <= 1 and alone and (expected or pairs):
        asked = [(kind, (reals or [0])[0]) for kind in expected] + [(HOPF, place) for place in pairs]
        found = [_located(space, stretch, kind, place, order) for kind, place in asked]
        those = sorted((one for one in found if one is not None), key=lambda one: one.along)
        if len(those) == len(asked) and _differ(those):
            points = [one.point for one in those]
            yield from _beside(space, before, points[0], 1.0 - BESIDE_FOUND, depth)
            yield from points
            yield from _beside(space, points[-1], after, BESIDE_FOUND, depth)
            return
    middle = space.point_solver.along(before, after, 0.5) if depth < DEEPEST else None
    if middle is not None:
        yield from _search(space, before, middle, depth + 1)
        yield from _search(space, middle, after, depth + 1)
        return
    yield from _unresolved(space, stretch, expected + [HOPF] * len(pairs))


def _beside(space: EquilibriumSpace, first: Point, last: Point, fraction: float, depth: int) -> Iterator[Point]:
    """Special points between an end of a stretch and one that was found on it, but for what is next to that."""
    if depth >= SUSPECTED:
        return
    try:
        beside = space.point_solver.along(first, last, fraction)
    except ArithmeticError:  # the point that was found lies at the end
        return
    if beside is not None:
        ends = (first, beside) if last.special else (beside, last)
        yield from _search(space, *ends, depth + 1)


def _differ(found: list[Found]) -> bool:
    """Whether special points are not the same one found twice: their places or frequencies are not the same."""
    return not any(
        abs(one.along - other.along) <= SAME and abs(one.frequency - other.frequency) <= SAME * one.frequency
        for i, one in enumerate(found)
        for other in found[:i]
    )


# What happens on a stretch --------------------------------------------------------------------------------------------


def _returns(space: EquilibriumSpace, stretch: Stretch, order: Array) -> bool:
    """Whether a cubic through both ends brings an eigenvalue to the axis and back, or the parameter to turn twice."""
    length, first, last = stretch.length, stretch.first, stretch.last
    u = [stretch.curve.t0[-1], 2.0 * stretch.curve.quadratic[-1], 3.0 * stretch.curve.cubic[-1]]
    if not stretch.turns and _nearly_vanishes(u, length):
        return True
    if not space.statics.oscillates:
        return False
    a, b = first.values.real, last.values[order].real
    da, db = first.rates.real, last.rates[order].real
    for place in np.flatnonzero(a * b > 0.0).tolist():
        chord = (b[place] - a[place]) / length
        quadratic = (3.0 * chord - 2.0 * da[place] - db[place]) / length
        cubic = (da[place] + db[place] - 2.0 * chord) / length**2
        if _nearly_vanishes([a[place], da[place], quadratic, cubic], length):
            return True
    return False


def _nearly_vanishes(ascending: list[float], length: float) -> bool:
    """Whether a polynomial of one sign at 0 and at a length turns back at zero in between, or just before it.

    The margin is a share of what the polynomial changes by, so that it shrinks with the square of the stretch.
    """
    polynomial = np.polynomial.Polynomial(ascending)
    turns = polynomial.deriv().roots()
    inside = turns.real[(np.abs(turns.imag) <= 1e-9 * length) & (turns.real > 0.0) & (turns.real < length)]
    if not inside.size:
        return False
    values = np.append(polynomial(inside), [polynomial(0.0), polynomial(length)])
    sign = float(np.sign(values[-1]))
    return bool(np.min(sign * values) < MARGIN * float(np.ptp(values)))


# Locating -------------------------------------------------------------------------------------------------------------


def _located(space: EquilibriumSpace, stretch: Stretch, kind: str, place: int, order: Array) -> Found | None:
    """The special point of a kind at which an eigenvalue crosses, with its place along; None where it is not found."""
    a, b = stretch.first.values[place], stretch.last.values[order][place]
    if kind == FOLD:
        a, b = (complex(end.point.tangent[-1]) for end in (stretch.first, stretch.last))
    sums = abs(a.real) + abs(b.real)
    share = abs(a.real) / sums if a.real * b.real < 0.0 and sums > 0.0 else 0.5
    guess = stretch.curve.at(share * stretch.length)
    near = 1j * abs(height(a, b)) if kind == HOPF else None
    found = locate(space, kind, guess[:-1], float(guess[-1]), near)
    if found is None:
        point = _by_bisection(space, stretch, kind) if not space.systems.get(kind, True) else None
        return None if point is None else Found(0.0, 0.0, point)
    z = np.append(found.y, found.s)
    apart = float(np.sqrt(np.sum(space.point_solver.metric(space.problem, guess) * (z - guess) ** 2)))
    start = stretch.first.point
    row = space.point_solver.metric(space.problem, start.z) * start.tangent
    along = float(row @ (z - start.z))
    inside = -1e-6 * stretch.length <= along <= (1.0 + 1e-6) * stretch.length
    if apart > BESIDE * stretch.length or not inside:
        return None
    return Found(along, found.frequency, _point(space, stretch, kind, found, along))


def _point(space: EquilibriumSpace, stretch: Stretch, kind: str, found: Located, sigma: float) -> Point:
    """The special point as one of the branch, with the slope of the stretch there for its tangent."""
    z = np.append(found.y, found.s)
    slope = stretch.curve.slope(float(np.clip(sigma, 0.0, stretch.length)))
    tangent = slope / np.sqrt(np.sum(space.point_solver.metric(space.problem, z) * slope**2))
    error = ErrorEstimate(0.0, found.profile, parameter=found.error)
    step = space.point_solver.settings.first_step
    return Point(space.problem, z, np.asarray(tangent), error, step, 0, walked=False, special=kind)


def _by_bisection(space: EquilibriumSpace, stretch: Stretch, kind: str) -> Point | None:
    """The special point by halving the stretch, for models whose second derivatives are not there."""
    before, after = stretch.first.point, stretch.last.point

    def side(point: Point) -> float:
        if kind == FOLD:
            return float(point.tangent[-1])
        here = end_of(point, point.tangent)
        return here.orientation if kind == BRANCH_POINT else float(np.sum(here.values.real > 0.0)) - 0.5 - threshold

    threshold = 0.0
    if kind == HOPF:
        counts = [float(np.sum(end.values.real > 0.0)) for end in (stretch.first, stretch.last)]
        threshold = 0.5 * sum(counts) - 0.5
    low, high, known = 0.0, 1.0, before
    start, last = side(before), after
    for _ in range(BISECTIONS):
        middle = space.point_solver.along(before, after, 0.5 * (low + high))
        if middle is None:
            break
        if side(middle) * start > 0.0:
            low, known = 0.5 * (low + high), middle
        else:
            high, last = 0.5 * (low + high), middle
    width = abs(float(last.z[-1] - known.z[-1]))
    profile = space.problem.profile_change(known.z, last.z - known.z)
    error = ErrorEstimate(0.0, profile, parameter=width + known.error.relative(1.0))
    return replace(known, error=error, walked=False, special=kind)


def _unresolved(space: EquilibriumSpace, stretch: Stretch, kinds: list[str]) -> Iterator[Point]:
    """What is known of a stretch that cannot be halved: its special points at its start, and a warning."""
    assert space.course is not None
    low, high = (float(space.course.at(end.point.z[-1])) for end in (stretch.first, stretch.last))
    if not kinds:
        return  # an eigenvalue that was matched to another one
    words = " and ".join(dict.fromkeys(kinds)) + (f", {len(kinds)} in all" if len(kinds) > 1 else "")
    name = space.parameter
    told = f"between {name} = {low:.12g} and {high:.12g} there is more than can be told apart: {words}"
    warnings.warn(told, UnresolvedWarning, stacklevel=2)
    width = abs(float(stretch.last.point.z[-1] - stretch.first.point.z[-1]))
    for kind in kinds:
        point = stretch.first.point
        yield replace(point, error=replace(point.error, parameter=width), walked=False, requested=False, special=kind)
