"""Period doublings, tori and branch points between two orbits of a branch, by root finding on their multipliers.

Solutions of a boundary-value problem that its conditions close are orbits here too: of these branch points are counted
while the branch is followed (see `branch_points`), and not sought again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin import methods
from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import Point
from casadi_skin.orbits.boundary_space import BoundarySpace
from casadi_skin.orbits.making import solution_at
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.special_points import BRANCH_POINT, DOUBLING, TORUS, turns_between
from casadi_skin.orbits.stretch_points import snapped, target_of
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet

if TYPE_CHECKING:
    from casadi_skin.orbits.orbit import Orbit

FINE = 1e-10  # of the way from one orbit to the next
NEAR = 1e-2  # of it: where the extended equations of a special orbit are solved from
CRITICAL = 1e-4  # distance from the unit circle of a multiplier that is on it at a special point
BESIDE = 1e-3  # of it: a place next to a special orbit, whose own multiplier has no side
HALVINGS = 8  # of a stretch on which several multipliers cross
FAR = 6.0  # log |multiplier| at both ends of a stretch of one that does not come to the circle within it
TINY = float(np.finfo(float).tiny)  # in place of a multiplier that is below the smallest double


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Two neighbouring orbits, with their multipliers in pairs: those of the second in the order of the first."""

    before: Solution
    after: Solution

    @cached_property
    def first(self) -> ComplexArray:
        return self.before.floquet().others

    @cached_property
    def last(self) -> ComplexArray:
        return _matched(self.first, self.after.floquet().others)

    @cached_property
    def sides(self) -> tuple[Array, Array]:
        """log |multiplier| at both ends; 0 where it is that by which an end is a special point."""
        return _sides(self.before, self.first), _sides(self.after, self.last)

    def crossings(self) -> Iterator[tuple[str, Callable[[Floquet], float], complex]]:
        """Kinds of crossings, each with a function of the multipliers that changes its sign there, and where.

        A multiplier that errors keep from having a side at both ends, as along conservative orbits, crosses nothing.
        """
        allowed = max(self.before.floquet().error, self.after.floquet().error)
        for first, last, one, other in zip(self.first, self.last, *self.sides, strict=True):
            pair = first.imag != 0.0 and last.imag != 0.0
            if not one * other < 0.0 or max(abs(one), abs(other)) <= allowed or (pair and first.imag < 0.0):
                continue
            real = last if last.imag == 0.0 else first
            if pair:
                yield TORUS, _modulus(0.5 * (first + last)), 0.5 * (first + last)
            elif real.real < 0.0:
                yield DOUBLING, _real(-1.0), -1.0
            elif not (_stated(self.before) or turns_between(self.before.point, self.after.point)):
                yield BRANCH_POINT, _real(1.0), 1.0

    def hidden(self, space: BoundarySpace) -> float | None:
        """A place at which a multiplier is on the other side of the circle than at both ends; None where none is.

        Seen on the cubic through both ends, in the middle and where the parabola through the three is stationary.
        """
        one, other = self.sides
        near = np.minimum(np.abs(one), np.abs(other)) < FAR
        if not np.any(near):
            return None
        curve, length = space.point_solver.curve(self.before.point, self.after.point)

        def inside(fraction: float) -> tuple[Array, float]:
            floquet = space.floquets([replace(self.after.point, z=curve.at(fraction * length), better=None)])[0]
            values = _matched((1.0 - fraction) * self.first + fraction * self.last, floquet.others)
            return _outwards(values), floquet.error

        same, (middle, allowed) = near & (np.sign(one) == np.sign(other)), inside(0.5)
        if np.any(same & (middle * one < 0.0) & (np.abs(middle) > allowed)):
            return 0.5
        bend, slope = 2.0 * (one + other - 2.0 * middle), other - one
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = 0.5 - slope / (2.0 * bend)  # of the parabola
            lowest = middle - slope**2 / (4.0 * bend)
        for place in np.flatnonzero(same & (turn > 0.0) & (turn < 1.0) & (lowest * one < 0.0)):
            there, allowed = inside(float(turn[place]))
            if there[place] * one[place] < 0.0 and abs(there[place]) > allowed:
                return float(turn[place])
        return None


def bifurcations_between(before: Solution, after: Solution) -> Iterator[Solution]:
    """Orbits between two neighbours at which one multiplier, or a pair, crosses the unit circle, in order.

    Only where multipliers are free to do so: in models that are not conservative, over the whole period.
    """
    space = before.space
    if type(space) is not BoundarySpace or before.floquet().trivial > 1:
        return
    if _stated(before) or space.symmetry.value == 1.0:
        yield from _between(space, _Stretch(before, after), HALVINGS)


def at_requested_value(solution: Solution) -> Solution:
    """A solution at a requested value; where one of its multipliers crosses there, the special orbit in its place."""
    space, point = solution.space, solution.point
    if type(space) is not BoundarySpace or point.walked or point.special or not solution.floquet().others.size:
        return solution
    others = solution.floquet().others
    nearest = complex(others[np.argmin(np.abs(_outwards(others)))])
    if abs(np.log(abs(nearest))) > CRITICAL:
        return solution
    kind = TORUS if nearest.imag else DOUBLING if nearest.real < 0.0 else BRANCH_POINT
    found: Point | None = methods.TASKS["special_orbit"].load()(space, kind, point, abs(float(np.angle(nearest))))
    target = None if found is None else target_of(space, found)
    if found is None or target is None or target.value != point.parameter:
        return solution
    there = replace(snapped(found, target, requested=True), along=point.along)
    return solution_at(space, there, space.floquets([there])[0])


def _stated(solution: Solution) -> bool:
    """Whether a solution is one of a boundary-value problem that is stated, not made of an orbit."""
    return isinstance(solution.space, BoundarySpace) and solution.space.periodic is None


def _between(space: BoundarySpace, stretch: _Stretch, halvings: int) -> Iterator[Solution]:
    """Special orbits of a stretch, which is divided until not more than one of them is on each part."""
    crossings, fraction = list(stretch.crossings()), None
    if halvings:
        fraction = 0.5 if len(crossings) > 1 else stretch.hidden(space)
    if fraction is not None:
        point = space.point_solver.along(stretch.before.point, stretch.after.point, fraction)
        if point is not None:
            middle = solution_at(space, point, space.floquets([point])[0])
            yield from _between(space, _Stretch(stretch.before, middle), halvings - 1)
            yield from _between(space, _Stretch(middle, stretch.after), halvings - 1)
            return
    found = [_located(space, stretch.before, stretch.after, *crossing) for crossing in crossings]
    yield from (orbit for _, orbit in sorted((one for one in found if one is not None), key=lambda one: one[0]))


def _matched(first: ComplexArray, last: ComplexArray) -> ComplexArray:
    """The second multipliers in the order of the first: the assignment with the smallest changes."""
    from scipy.optimize import linear_sum_assignment

    return np.asarray(last[linear_sum_assignment(np.abs(first[:, None] - last))[1]])


def _sides(orbit: Solution, multipliers: ComplexArray) -> Array:
    outwards = _outwards(multipliers)
    if orbit.point.special and outwards.size:
        nearest = multipliers[np.argmin(np.abs(outwards))]
        critical = np.minimum(np.abs(multipliers - nearest), np.abs(multipliers - nearest.conjugate())) < CRITICAL
        outwards[critical & (np.abs(outwards) < CRITICAL)] = 0.0
    return np.asarray(outwards)


def _outwards(multipliers: ComplexArray) -> Array:
    """log |multiplier|, also of one that is below the smallest double."""
    return np.asarray(np.log(np.maximum(np.abs(multipliers), TINY)))


def _real(value: float) -> Callable[[Floquet], float]:
    """Distance of the multiplier nearest to +1 or -1 from it, with the sign of the product of all these distances.

    The product changes its sign where one crosses, whichever is the nearest to either side.
    """

    def test(floquet: Floquet) -> float:
        away = floquet.others - value
        sign = np.sign(np.prod(away / (1.0 + np.abs(floquet.others))).real)
        return float(sign * np.min(np.abs(away)))

    return test


def _modulus(near: complex) -> Callable[[Floquet], float]:
    """Distance from the unit circle, outwards, of the multiplier nearest to a place."""

    def test(floquet: Floquet) -> float:
        return abs(_nearest(floquet.others, near)) - 1.0

    return test


def _nearest(values: ComplexArray, place: complex) -> complex:
    return complex(values[np.argmin(np.abs(values - place))])


def _located(
    space: BoundarySpace, before: Solution, after: Solution, kind: str, test: Callable[[Floquet], float], place: complex
) -> tuple[float, Solution] | None:
    """The orbit at which a test vanishes, with its place on the way; None where none is found."""
    from scipy.optimize import brentq

    known: dict[float, Solution] = {0.0: before, 1.0: after}

    def value(fraction: float) -> float:
        if fraction not in known:
            point = space.point_solver.along(before.point, after.point, fraction)
            if point is None:
                raise ArithmeticError(space.point_solver.failure)
            known[fraction] = solution_at(space, point, space.floquets([point])[0])
        return test(known[fraction].floquet())

    low = BESIDE if before.point.special else 0.0
    high = 1.0 - BESIDE if after.point.special else 1.0
    try:
        if value(low) * value(high) >= 0.0:
            return None
    except ArithmeticError:
        return None
    with suppress(ArithmeticError):
        near = float(brentq(value, low, high, xtol=NEAR))
        value(near)
        angle = abs(float(np.angle(_nearest(known[near].floquet().others, place))))
        point = methods.TASKS["special_orbit"].load()(space, kind, known[near].point, angle)
        if point is not None:
            return near, solution_at(space, point, space.floquets([point])[0])
    with suppress(ArithmeticError):  # at a branch point itself no orbit is alone: the nearest one stands for it
        brentq(value, low, high, xtol=FINE)
    root = min(known, key=lambda fraction: abs(value(fraction)))
    if root in (low, high):
        return None
    orbit = known[root]
    slope = (value(high) - value(low)) / (after.point.parameter - before.point.parameter)
    beside = min((f for f in known if f != root), key=lambda f: abs(f - root))
    if abs(known[beside].point.parameter - orbit.point.parameter) > 0.0 and abs(beside - root) < 0.1:
        slope = (value(beside) - value(root)) / (known[beside].point.parameter - orbit.point.parameter)
    return root, _special(orbit, kind, abs(value(root)) + orbit.floquet().error, slope)


def _special(orbit: Solution, kind: str, uncertain: float, slope: float) -> Solution:
    """The orbit marked, with the error of its parameter by that of its multiplier."""
    point: Point = orbit.point
    moved = uncertain / abs(slope) if slope else np.inf
    by_orbit = point.error.relative(1.0)
    error = replace(point.error, parameter=float(moved / point.problem.parameter_size(point.z) + by_orbit))
    return replace(orbit, point=replace(point, error=error, special=kind, walked=False, requested=False))


def critical_vector(orbit: Orbit, multiplier: float) -> Array:
    """The vector of norm 1 that the monodromy matrix multiplies by +1 or -1, across the motion along the orbit."""
    monodromy = np.asarray(orbit.floquet().monodromy)
    vectors = np.linalg.svd(monodromy - multiplier * np.eye(len(monodromy)))[2][::-1]
    if multiplier < 0.0 or orbit.floquet().trivial == 0:
        return np.asarray(vectors[0])
    h = 1e-5 * orbit.period
    ahead, behind = orbit.evaluate([h, -h])
    along = (ahead - behind) / np.linalg.norm(ahead - behind)
    free = [vector - along * (along @ vector) for vector in vectors[:2]]
    longest = max(free, key=lambda vector: float(np.linalg.norm(vector)))
    return np.asarray(longest / np.linalg.norm(longest))
