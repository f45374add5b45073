"""Special points on a stretch of a branch of equilibria: distinguished by their eigenvalues, then located one by one.

The parameter turns back at a fold; the Jacobian closed by the tangent changes the sign of its determinant at a branch
point; a pair of complex eigenvalues crosses the imaginary axis at a Hopf point. A stretch is sampled in between, and
halved until each of these quantities has no root on it, or one simple root within the errors of the cubics through
the samples (see `stretch`). Neutral saddles have no eigenvalue on the axis, and are not seen.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from casadi_skin.follow.equilibrium_equations import EquilibriumEquations
from casadi_skin.follow.equilibrium_ledger import counted
from casadi_skin.follow.equilibrium_search import EquilibriumSearch
from casadi_skin.follow.rest_location import BRANCH_POINT, FOLD, HOPF, Located, locate
from casadi_skin.follow.stretch import Signs, Stretch, crossings, height
from casadi_skin.zero.settings import ErrorEstimate, Point
from casadi_skin.zero.unresolved import Unresolved

TOGETHER = 4  # divisions after which a fold and a branch point that cannot be separated are one
BISECTIONS = 40
SHARP = 0.5  # cosine of the turn between two points: a step turns by less
RECOUNTS = 3  # divisions of a stretch where special points do not account for eigenvalues
SAME = 1e-9  # of a step or of a frequency
BESIDE = 0.7  # of a stretch: how far from where it is expected a special point may be found


@dataclass(frozen=True, eq=False)
class Found:
    """A special point with its place along a stretch and its frequency, 0 where it has none."""

    along: float
    frequency: float
    point: Point


def special_between(equations: EquilibriumEquations, before: Point, after: Point) -> Iterator[Point | Unresolved]:
    """Special points between two points of a branch in order, each marked by its kind, and parts not resolved.

    Where several lie too near to each other to be separated, they are all at the start of the part that is named. The
    stretch is divided where the number of unstable eigenvalues differs along it, or the special points do not account
    for it; what stays is named.
    """
    search = _Search(equations, before, after)
    counts = counted(equations, before, after) if search.free else None
    if counts is None:
        yield from search.between(before, after)
        if search.free:
            yield _gap(equations, before.parameter, after.parameter, "the branch is not found between two points")
        return
    places = counts.cuts
    for _ in range(RECOUNTS):
        parts = pairwise((before, *counts.points(equations, places), after))
        found = [one for ends in parts for one in _between(equations, *ends)]
        events = [point for point in found if isinstance(point, Point)]
        missing = None if len(events) < len(found) else counts.violation(events)
        if missing is None:
            break
        places = sorted({*places, *missing})
    yield from found
    if missing is not None:
        numbers = " to ".join(str(counts.least[k]) for k in missing)
        words = f"the number of unstable eigenvalues goes from {numbers}, and no special point accounts for it"
        start, end = (float(counts.unknowns[k, -1]) for k in missing)
        yield _gap(equations, start, end, words)


def _between(equations: EquilibriumEquations, before: Point, after: Point) -> Iterator[Point | Unresolved]:
    """Special points of a part; it is named where the branch turns by so much that no curve through its ends is it."""
    if float(equations.sample(before).row @ after.tangent) < SHARP:
        yield _gap(equations, before.parameter, after.parameter, "the branch turns sharply between two points")
        return
    yield from _Search(equations, before, after).between(before, after)


def _gap(equations: EquilibriumEquations, start: float, end: float, words: str) -> Unresolved:
    """The record of a stretch by its places along the course of the parameter."""
    assert equations.course is not None
    low, high = (float(equations.course.at(u)) for u in (start, end))
    return Unresolved(low, high, words, "special points", equations.parameter)


class _Search(EquilibriumSearch):
    """Folds, branch points and Hopf points on one stretch of a branch."""

    def __init__(self, equations: EquilibriumEquations, before: Point, after: Point) -> None:
        conserves = equations.model.order == 1 and all(equations.sample(end).symmetric for end in (before, after))
        self.free = equations.statics.oscillates and not conserves  # whether pairs may cross the axis one by one
        signs: Signs = "real parts" if self.free else "real" if equations.model.order == 2 else "squares"
        super().__init__(equations, signs)

    def found(self, stretch: Stretch, depth: int, last: bool) -> Sequence[Point] | None:
        reals, pairs = crossings(stretch) if self.free else ([], [])
        expected = [FOLD] * stretch.turns + [BRANCH_POINT] * stretch.reorients
        one = set(expected) == {FOLD, BRANCH_POINT} and not reals and (depth >= TOGETHER or last)
        if one:  # where a branch leaves another one to one side
            expected, reals = [BRANCH_POINT], [0]
        if not (one or last or np.all(stretch.settled)):
            return None
        if not (expected or reals or pairs):
            return ()
        return self._each(stretch, expected, reals, pairs)

    def unresolved(self, stretch: Stretch) -> Iterator[Point | Unresolved]:
        reals, pairs = crossings(stretch) if self.free else ([], [])
        several = len(reals) > 1 and not (stretch.turns or stretch.reorients)  # at once, as where a symmetry keeps them
        kinds = [FOLD] * stretch.turns + [BRANCH_POINT] * (stretch.reorients or several) + [HOPF] * len(pairs)
        yield from _unresolved(self.equations, stretch, kinds)

    def _each(self, stretch: Stretch, expected: list[str], reals: list[int], pairs: list[int]) -> list[Point] | None:
        """The special points that the ends indicate, each located; None where one cannot be."""
        if len(expected) > 1 or not (expected or pairs) or (self.free and len(reals) != len(expected)):
            return None
        requested = [(kind, (reals or [0])[0]) for kind in expected] + [(HOPF, place) for place in pairs]
        found = [_located(self.equations, stretch, kind, place) for kind, place in requested]
        those = sorted((one for one in found if one is not None), key=lambda one: one.along)
        return [one.point for one in those] if len(those) == len(requested) and _differ(those) else None


def _differ(found: list[Found]) -> bool:
    """Whether special points differ in place or frequency, so that none is located twice."""
    return not any(
        abs(one.along - other.along) <= SAME and abs(one.frequency - other.frequency) <= SAME * one.frequency
        for i, one in enumerate(found)
        for other in found[:i]
    )


# Locating -------------------------------------------------------------------------------------------------------------


def _located(equations: EquilibriumEquations, stretch: Stretch, kind: str, place: int) -> Found | None:
    """The special point of a kind at which an eigenvalue crosses, with its place along; None where there is none."""
    guess = stretch.curve.at(stretch.root(None if kind == BRANCH_POINT else 0 if kind == FOLD else place + 1))
    ends = stretch.first.values[place], stretch.last.values[stretch.order[place]]
    near = 1j * abs(height(*ends)) if kind == HOPF else None
    found = locate(equations, kind, guess[:-1], float(guess[-1]), near)
    if found is None:
        point = _by_bisection(equations, stretch, kind) if not equations.systems.get(kind, True) else None
        return None if point is None else Found(0.0, 0.0, point)
    z = np.append(found.y, found.s)
    apart = float(np.sqrt(np.sum(equations.point_solver.metric(equations.problem, guess) * (z - guess) ** 2)))
    start = stretch.first.point
    row = equations.point_solver.metric(equations.problem, start.z) * start.tangent
    along = float(row @ (z - start.z))
    inside = -1e-6 * stretch.length <= along <= (1.0 + 1e-6) * stretch.length
    if apart > BESIDE * stretch.length or not inside:
        return None
    return Found(along, found.frequency, _point(equations, stretch, kind, found, along))


def _point(equations: EquilibriumEquations, stretch: Stretch, kind: str, found: Located, sigma: float) -> Point:
    """The special point as one of the branch, with the slope of the stretch there for its tangent."""
    z = np.append(found.y, found.s)
    slope = stretch.curve.slope(float(np.clip(sigma, 0.0, stretch.length)))
    tangent = slope / np.sqrt(np.sum(equations.point_solver.metric(equations.problem, z) * slope**2))
    error = ErrorEstimate(0.0, found.profile, parameter=found.error)
    step = equations.point_solver.settings.first_step
    return Point(equations.problem, z, np.asarray(tangent), error, step, 0, walked=False, special=kind)


def _by_bisection(equations: EquilibriumEquations, stretch: Stretch, kind: str) -> Point | None:
    """The special point by bisection of the stretch, for models without second derivatives."""
    before, after = stretch.first.point, stretch.last.point

    def side(point: Point) -> float:
        if kind == FOLD:
            return float(point.tangent[-1])
        here = equations.sample(point)
        return here.orientation if kind == BRANCH_POINT else float(np.sum(here.values.real > 0.0)) - 0.5 - threshold

    threshold = 0.0
    if kind == HOPF:
        counts = [float(np.sum(end.values.real > 0.0)) for end in (stretch.first, stretch.last)]
        threshold = 0.5 * sum(counts) - 0.5
    low, high, known = 0.0, 1.0, before
    start, last = side(before), after
    for _ in range(BISECTIONS):
        middle = equations.point_solver.along(before, after, 0.5 * (low + high))
        if middle is None:
            break
        if side(middle) * start > 0.0:
            low, known = 0.5 * (low + high), middle
        else:
            high, last = 0.5 * (low + high), middle
    width = abs(float(last.z[-1] - known.z[-1]))
    profile = equations.problem.profile_change(known.z, last.z - known.z)
    error = ErrorEstimate(0.0, profile, parameter=width + known.error.relative(1.0))
    return replace(known, error=error, walked=False, special=kind)


def _unresolved(equations: EquilibriumEquations, stretch: Stretch, kinds: list[str]) -> Iterator[Point | Unresolved]:
    """Special points of a stretch that cannot be halved, at its start, with the record of it."""
    assert equations.course is not None
    low, high = (float(equations.course.at(end.point.z[-1])) for end in (stretch.first, stretch.last))
    if not kinds:
        return  # an eigenvalue that was matched to another one
    words = " and ".join(dict.fromkeys(kinds)) + (f", {len(kinds)} in all" if len(kinds) > 1 else "")
    yield Unresolved(low, high, f"more than can be distinguished: {words}", kinds[0], equations.parameter)
    width = abs(float(stretch.last.point.z[-1] - stretch.first.point.z[-1]))
    for kind in kinds:
        point = stretch.first.point
        yield replace(point, error=replace(point.error, parameter=width), walked=False, requested=False, special=kind)
