"""A whole diagram: all branches that leave a branch at its special points, and those that leave these, each once."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.follow import BranchRun
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import EQUILIBRIA
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.arguments import whole
from casadi_skin.model.result import Result, in_turn
from casadi_skin.points.leaving import DEFAULT_TOLERANCE
from casadi_skin.points.switch import leaving_space
from casadi_skin.zero.kinds import HOPF, KINDS
from casadi_skin.zero.orbit import UNFOLDING
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import End, Point
from casadi_skin.zero.stated_problem import PERIOD

LEAVING_KINDS = tuple(word for word, kind in KINDS.items() if kind.sides)
SAME_POINT_RTOL = 1e-6  # relative distance of special points that are one
EXTREMA_SAMPLES = 257  # of an orbit, whose extrema distinguish it
EXTREMUM_RTOL = 1e-3  # relative error of such an extremum


@dataclass(frozen=True, eq=False)
class Diagram(Result):
    """Branches in one parameter that are connected by special points.

    Attributes:
        branches: the first one, and all that leave it or each other, in the order of their computation.
        origins: for each branch the special point at which it leaves; None for the first one.
        names: for each branch the path to it: numbers of special points, from 1; "b" marks the second half.
        failures: reasons why a branch that leaves could not be started, in a line each.
        complete: whether no branch was left out because of the limit on their number.
    """

    branches: tuple[Branch, ...]
    origins: tuple[SpecialPoint | None, ...]
    names: tuple[str, ...]
    failures: tuple[str, ...]
    complete: bool

    def __len__(self) -> int:
        return len(self.branches)

    def __iter__(self) -> Iterator[Branch]:
        return iter(self.branches)

    def __repr__(self) -> str:
        points = self.special_points
        kinds = [point.kind for point in points]
        special = "".join(f", {kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
        return f"<Diagram: {len(self)} branches in {self.branches[0].parameter}{special}>"

    @property
    def special_points(self) -> tuple[SpecialPoint, ...]:
        """Special points of all branches, each once."""
        found, units = list[SpecialPoint](), Units()
        for branch in self.branches:
            units.add(branch)
        for point in (point for branch in self.branches for point in points_of(branch)):
            if not any(units.is_same(point, other) for other in found):
                found.append(point)
        return tuple(found)


@in_turn
def follow_all(
    branch: Branch,
    *,
    depth: int = 3,
    limit: int = 30,
    stability: bool = True,
    max_points: int = 500,
    max_step: float = 0.2,
    tolerance: float = DEFAULT_TOLERANCE,
) -> Diagram:
    """Follow all branches that leave a branch of equilibria, orbits or solutions, and those that leave these.

    Cycles at Hopf points of equilibria, and equilibria where cycles shrink to one; both halves of the other branch at
    branch points, orbits of twice the period at period doublings, within the values of the parameter that the branch
    was followed in. No branch is followed twice.

    Arguments:
        branch: where the diagram starts.
        depth: largest number of special points between the branch and another one.
        limit: largest number of branches, the first one among them.
        stability: whether multipliers of orbits are computed; without them no branch is found that leaves orbits.
        max_points, max_step: of each branch, as in `follow`.
        tolerance: of cycles, as in `find_orbit`.

    Returns:
        The diagram.

    Raises:
        ValueError: an argument is out of range, or the branch is a family or a curve in two parameters.
    """
    whole("depth", depth, 0)
    whole("limit", limit, 1)
    if branch.space.is_family or not branch.parameter or branch.space.kind:
        what = "a family" if branch.space.is_family else "another one"
        raise ValueError(f"follow_all: given {what}; accepted: a branch in one parameter")
    further = Further(
        branch, LEAVING_KINDS, depth, {"max_points": max_points, "max_step": max_step, "tolerance": tolerance}
    )
    names, origins, complete = [""], list[SpecialPoint | None]([None]), True
    for name, point, space in further:
        if len(names) == limit:
            complete = False
            break
        closes = space.closes
        with_stability = stability and closes and not space.stability_included
        further.add(BranchRun(space, with_stability).to_end(), space, point)
        names.append(name)
        origins.append(point)
    return Diagram(tuple(further.branches), tuple(origins), tuple(names), tuple(further.failures), complete)


@dataclass(eq=False)
class _Met:
    """A special point with the directions followed from it, and whether the branches that leave it were followed.

    `shrunk` is whether cycles that were followed shrink to an equilibrium there.
    """

    point: SpecialPoint
    shrunk: bool = False
    directions: list[Array] = field(default_factory=list)
    left: bool = False


class Further:
    """Iterates over the branches that leave a branch, and over those that leave these: name, special point, space.

    Each branch that was followed for them is passed to `add` before the next step of the iteration.

    Attributes:
        branches: all branches, the first one among them.
        reached: the special points that were met, each once, with the numbers that lead to them.
        failures: reasons why a branch could not be started, in a line each.
    """

    def __init__(
        self, branch: Branch, kinds: Collection[str], depth: float, options: dict[str, Any], halves: int = 2
    ) -> None:
        self.branches, self.failures = [branch], list[str]()
        self.reached = list[tuple[str, SpecialPoint]]()
        self._kinds, self._depth, self._options, self._halves = kinds, depth, options, halves
        self._met, self._units = list[_Met](), Units()
        self._units.add(branch)
        self._meet(branch)

    def __iter__(self) -> Iterator[tuple[str, SpecialPoint, Any]]:
        waiting = [("", self.branches[0], 0)]
        while waiting:
            prefix, branch, depth = waiting.pop(0)
            for number, point in enumerate(points_of(branch), start=1):
                met = self._of(point)
                if met.left:
                    continue
                met.left = True
                self.reached.append((f"{prefix}_{number}", point))
                if point.kind not in self._kinds or depth >= self._depth:
                    continue
                for suffix, space in zip(("", "b"), self._leaving(point, met), strict=False):
                    name = f"{prefix}_{number}{suffix}"
                    yield name, point, space
                    waiting.append((name, self.branches[-1], depth + 1))

    def add(self, branch: Branch, space: Any, point: SpecialPoint) -> None:
        """Keep a branch that leaves at a special point."""
        self.branches.append(branch)
        self._units.add(branch)
        if space.connects == EQUILIBRIA and space.first is not None:
            direction = _direction(space, space.first)
            closed = branch.end is End.CLOSED
            self._of(point).directions += [direction, -direction] if closed else [direction]
        if branch.end is End.REJOINED:
            self._reach(point.kind, branch)
        self._meet(branch)

    def _reach(self, kind: str, branch: Branch) -> None:
        """Close a special point at which a branch has come back to the orbits that it left: no other leaves there."""
        end = replace(branch.special_points[-1], kind=kind)
        for met in self._met:
            met.left = met.left or self._units.is_same(met.point, end)

    def _meet(self, branch: Branch) -> None:
        """Record the special points that a branch passes, and its directions there."""
        for point in points_of(branch):
            met = self._of(point)
            if point.solution.is_equilibrium:
                along = _direction(branch.space, point.solution.point)
                met.directions += [along, -along]
            else:
                met.shrunk = met.shrunk or point.kind == HOPF

    def _of(self, point: SpecialPoint) -> _Met:
        known = next((met for met in self._met if self._units.is_same(met.point, point)), None)
        if known is None:
            known = _Met(point)
            self._met.append(known)
        return known

    def _leaving(self, point: SpecialPoint, met: _Met) -> Iterator[Any]:
        """Branches that leave at a special point in directions that were not followed before."""
        of_equilibria = point.solution.is_equilibrium
        if point.kind == HOPF and (met.shrunk if of_equilibria else met.directions):  # followed before
            return
        first = self.branches[0]
        course = (first.solutions[0].parameters[first.parameter], first.space.to)
        reasons, started, here = list[str](), 0, met.point.parameters[first.parameter]
        ends: list[tuple[float, float | None]]
        ends = [(to, back) for back, to in (course, course[::-1]) if (to - here) * (back - here) < 0.0]
        ends = ends or [(to, None) for to in course[::-1] if to != here]
        done = list[Array]()
        for to, back in ends if of_equilibria != (point.kind == HOPF) else ends[:1]:
            for side in KINDS[point.kind].sides:
                if started == self._halves:
                    return
                try:
                    space = leaving_space(point, first.parameter, to, side=side, at=(), back_to=back, **self._options)
                except (ValueError, ArithmeticError) as error:
                    reasons.append(str(error))
                    continue
                if space.connects == EQUILIBRIA and space.leaves and space.first is not None:
                    direction = _direction(space, space.first)
                    along = _direction(point.solution.space, point.solution.point)
                    if any(_is_along(known, direction, along) for known in (*met.directions, *done)):
                        started += not done  # followed before
                        continue
                    done.append(direction)
                started += 1
                yield space
        if not started:
            self.failures.append(f"{point.kind} at {first.parameter} = {here:.8g}: {reasons[0]}")


def points_of(branch: Branch) -> tuple[SpecialPoint, ...]:
    """Special points of a branch, but for its end where it has come back to a solution that it left."""
    return branch.special_points[: -1 if branch.end is End.REJOINED else None]


def _direction(space: Any, point: Point) -> Array:
    """The tangent at a point of equilibria in the units of the model, of norm 1 over the sizes of the state."""
    course, n = space.course, space.statics.size
    assert course is not None
    return np.append(space.sizes * point.tangent[:n], point.tangent[-1] * (course.to - course.start))


def _is_along(known: Array, direction: Array, other: Array) -> bool:
    """Whether a direction agrees with this one of two that cross, and not with the other one or its opposite."""
    size = np.maximum(np.maximum(np.abs(direction), np.abs(other)), 1e-300)
    a, b, c = (vector / size / np.linalg.norm(vector / size) for vector in (known, direction, other))
    return bool(abs(a @ b) > abs(a @ c) and a @ b > 0.0)


@dataclass
class Units:
    """The largest state and parameters on branches, by their number: units in which special points are one."""

    states: dict[int, float] = field(default_factory=dict)
    parameters: dict[int, Array] = field(default_factory=dict)

    def add(self, branch: Branch) -> None:
        """Take in all solutions of a branch: it may leave zero and come back to it."""
        for solution in branch.solutions:
            known: Any = solution
            states, p = known.positions if known.is_equilibrium else known.states, _parameters(solution)
            count = 2 * states.shape[-1]
            self.states[count] = max(self.states.get(count, 0.0), float(np.max(np.abs(states))))
            self.parameters[p.size] = np.maximum(self.parameters.get(p.size, 0.0), np.abs(p))

    def is_same(self, one: SpecialPoint, other: SpecialPoint) -> bool:
        """Whether two special points are one, met on two branches."""
        x, y, p, q = (of(point.solution) for of in (_extent, _parameters) for point in (one, other))
        if one.kind != other.kind or x.shape != y.shape or p.shape != q.shape:
            return False
        exact = all(point.solution.is_equilibrium or point.kind == HOPF for point in (one, other))
        error = SAME_POINT_RTOL if exact else EXTREMUM_RTOL
        near = np.max(np.abs(x - y)) <= error * self.states[x.size]
        return bool(near) and bool(np.all(np.abs(p - q) <= error * self.parameters[p.size]))


def _parameters(solution: Solution) -> Array:
    """Of the model: neither the period nor what unfolds a family, which is 0 but for rounding."""
    return np.array([v for name, v in solution.parameters.items() if name != PERIOD and not name.startswith(UNFOLDING)])


def _extent(solution: Any) -> Array:
    """Smallest and largest value of each component."""
    if solution.is_equilibrium:
        return np.tile(solution.positions, 2)
    start, end = solution.interval
    states = solution.evaluate(np.linspace(start, end, EXTREMA_SAMPLES))
    return np.concatenate([states.min(axis=0), states.max(axis=0)])
