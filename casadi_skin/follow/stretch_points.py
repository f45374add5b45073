"""The points of one stretch of a branch in order: requested ones, and special ones, which may be the same.

At a fold or a branch point the equations at a held parameter are singular: a requested value that lies there has no
solution of its own, or one that rounding decides. The special point itself is the solution there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

from casadi_skin.follow.settings import Point, Target
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.follow.special_points import FOLD
from casadi_skin.follow.unresolved import Unresolved
from casadi_skin.zero.problem import EPSILON, Scalar

SAME_PLACE = 1e-2  # of a stretch: a requested point that near to a special one of the same value is that one
DIGITS = 4.0 * EPSILON  # relative difference of a value that is the requested one


def target_of(space: SolutionSpace, special: Point) -> Target | None:
    """The target whose value a special point has within its error; None where there is none."""
    settings, name = space.point_solver.settings, space.parameter
    value, error = space.parameters(special)[name], space.parameter_error(special)
    for target in (*settings.at, *settings.ends):
        if target.held is Scalar.PARAMETER:
            wanted = space.value(name, snapped(special, target))
            if abs(value - wanted) <= max(error, DIGITS * abs(wanted)):
                return target
    return None


def snapped(special: Point, target: Target, requested: bool = False) -> Point:
    """A special point with its value exactly the one that it has within its error."""
    z = special.z.copy()
    z[special.problem.parameter_index] = target.value
    return replace(special, z=z, requested=requested)


class StretchPoints:
    """The points between `before` and `after`, which may lie beyond the end of the branch.

    `requested` are the points of the continuation on the stretch, its end among them where that comes before `after`;
    `missed` the targets that it passed without a point, also by this search; `unresolved` fills with the parts on which
    special points may be missing.
    """

    def __init__(
        self, space: SolutionSpace, before: Point, after: Point, requested: Sequence[Point], missed: Sequence[Target]
    ) -> None:
        self.space, self.before, self.after = space, before, after
        self.requested, self.missed, self.unresolved = list(requested), list(missed), list[Unresolved]()
        self._z, t = (before.problem.prolong(v, after.problem) for v in (before.z, before.tangent))
        self._row = space.point_solver.metric(after.problem, self._z) * t

    def place(self, point: Point) -> float:
        """How far from its start along the stretch a point is."""
        return float(self._row @ (point.problem.prolong(point.z, self.after.problem) - self._z))

    def special(self) -> list[Point]:
        """Special points in order, those at requested values exactly there; raises NotLocatedError."""
        targets, found = self.space.point_solver.settings.at, list[Point]()
        for point in self.space.special_between(self.before, self.after):
            if isinstance(point, Unresolved):
                self.unresolved.append(point)
                continue
            target = target_of(self.space, point)
            found.append(point if target is None else snapped(point, target, target in targets))
        for target in self.missed:
            if all(point.parameter != target.value for point in found):
                found += self._at(target)
        self.missed = [target for target in self.missed if all(point.parameter != target.value for point in found)]
        return sorted(found, key=self.place)

    def _at(self, target: Target) -> Iterator[Point]:
        """The special point at a value at which no solution was found, where there is one."""
        solver, problem = self.space.point_solver, self.after.problem
        if target.held is not Scalar.PARAMETER:
            return
        curve, length = solver.curve(self.before, self.after)
        for sigma in curve.crossings(*target.unknown(problem), length)[:1]:
            guess = replace(self.after, z=curve.at(sigma), tangent=curve.slope(sigma), better=None, special="")
            point = self.space.singular_near(guess)
            if point is not None and target_of(self.space, point) == target:
                yield snapped(point, target, target in solver.settings.at)

    def beside_folds(self, special: Sequence[Point]) -> list[Point]:
        """The requested points so near to folds that the continuation passed them by."""
        if not any(point.special == FOLD for point in special):
            return []
        solver, found = self.space.point_solver, list[Point]()
        wanted = [target for target in solver.settings.at if target.held is Scalar.PARAMETER]
        ends = (self.before, *special, self.after)
        for one, other in pairwise(ends):
            low, high = sorted((one.parameter, other.parameter))
            start, end = self.place(one), self.place(other)
            known = {point.parameter for point in self.requested if start <= self.place(point) <= end}
            inside = tuple(t for t in wanted if low < t.value < high and t.value not in known)
            inside = tuple(t for t in inside if not (t.meets(one) or t.meets(other)))
            points = {target: point for target, point in solver.between(one, other, inside) if point is not None}
            found += [replace(point, requested=True) for point in points.values()]
            self.missed += [t for t in inside if t not in (*points, *self.missed)]
        return found

    def points(self) -> list[Point]:
        """All points in order but `after`, those that are no points of the continuation marked as located."""
        special = self.special()
        located = [replace(point, located=True) for point in (*special, *self.beside_folds(special))]
        near = SAME_PLACE * abs(self.place(self.after))
        own = [point for point in self.requested if not any(self._is(point, one, near) for one in special)]
        return sorted([*located, *own], key=self.place)

    def _is(self, point: Point, special: Point, near: float) -> bool:
        same = special.parameter == point.parameter
        return same and abs(self.place(special) - self.place(point)) <= near
