"""Period doublings, tori and branch points between two orbits of a branch, by root finding on their multipliers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from casadi_skin import methods
from casadi_skin.bvp.problem import Array
from casadi_skin.continuation.points import Point
from casadi_skin.orbits.boundary_space import BoundarySpace
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.special_points import BRANCH_POINT, DOUBLING, TORUS, turns_between
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Floquet

FINE = 1e-10  # of the way from one orbit to the next
NEAR = 1e-2  # of it: where the extended equations of a special orbit are solved from
CRITICAL = 1e-4  # distance from the unit circle of a multiplier that is on it at a special point


def bifurcations_between(before: Orbit, after: Orbit) -> Iterator[Orbit]:
    """Orbits between two neighbours at which one multiplier, or a pair, crosses the unit circle, in order.

    Only where multipliers are free to do so: in models that are not conservative, over the whole period.
    """
    space = before.space
    if not isinstance(space, BoundarySpace) or before.floquet().trivial > 1 or space.symmetry.value != 1.0:
        return
    found = [_located(space, before, after, *crossing) for crossing in _crossings(before, after)]
    yield from (orbit for _, orbit in sorted((one for one in found if one is not None), key=lambda one: one[0]))


def _crossings(before: Orbit, after: Orbit) -> Iterator[tuple[str, Callable[[Floquet], float], complex]]:
    """Kinds of what crosses, each with a function of the multipliers that changes its sign there, and about where."""
    from scipy.optimize import linear_sum_assignment

    a, b = before.floquet().others, after.floquet().others
    b = b[linear_sum_assignment(np.abs(a[:, None] - b))[1]]
    for first, last in zip(a, b, strict=True):
        sides = _side(before, first) * _side(after, last)
        pair = first.imag != 0.0 and last.imag != 0.0
        if not sides < 0.0 or (pair and first.imag < 0.0):
            continue
        real = last if last.imag == 0.0 else first
        if pair:
            yield TORUS, _modulus(0.5 * (first + last)), 0.5 * (first + last)
        elif real.real < 0.0:
            yield DOUBLING, _real(-1.0), -1.0
        elif not turns_between(before.point, after.point):
            yield BRANCH_POINT, _real(1.0), 1.0


def _side(orbit: Orbit, multiplier: complex) -> float:
    """On which side of the unit circle a multiplier is; 0 where it is that by which the orbit is a special point."""
    outwards = abs(multiplier) - 1.0
    return 0.0 if orbit.point.special and abs(outwards) < CRITICAL else outwards


def _real(value: float) -> Callable[[Floquet], float]:
    """Distance of the multiplier nearest to +1 or -1 from it, with its sign."""

    def test(floquet: Floquet) -> float:
        return float(_nearest(floquet.others, value).real - value)

    return test


def _modulus(near: complex) -> Callable[[Floquet], float]:
    """Distance from the unit circle, outwards, of the multiplier nearest to a place."""

    def test(floquet: Floquet) -> float:
        return abs(_nearest(floquet.others, near)) - 1.0

    return test


def _nearest(values: ComplexArray, place: complex) -> complex:
    return complex(values[np.argmin(np.abs(values - place))])


def _located(
    space: BoundarySpace, before: Orbit, after: Orbit, kind: str, test: Callable[[Floquet], float], place: complex
) -> tuple[float, Orbit] | None:
    """The orbit at which a test vanishes, with its place on the way; None where none is found."""
    from scipy.optimize import brentq

    known: dict[float, Orbit] = {0.0: before, 1.0: after}

    def value(fraction: float) -> float:
        if fraction not in known:
            point = space.point_solver.along(before.point, after.point, fraction)
            if point is None:
                raise ArithmeticError(space.point_solver.failure)
            known[fraction] = Orbit(space, point, known_floquet=space.floquets([point])[0])
        return test(known[fraction].floquet())

    if value(0.0) * value(1.0) >= 0.0:  # another multiplier was nearer
        return None
    with suppress(ArithmeticError):
        near = float(brentq(value, 0.0, 1.0, xtol=NEAR))
        value(near)
        angle = abs(float(np.angle(_nearest(known[near].floquet().others, place))))
        point = methods.TASKS["special_orbit"].load()(space, kind, known[near].point, angle)
        if point is not None:
            return near, Orbit(space, point, known_floquet=space.floquets([point])[0])
    with suppress(ArithmeticError):  # at a branch point itself no orbit is alone: the nearest one stands for it
        brentq(value, 0.0, 1.0, xtol=FINE)
    root = min(known, key=lambda fraction: abs(value(fraction)))
    if root in (0.0, 1.0):
        return None
    orbit = known[root]
    slope = (value(1.0) - value(0.0)) / (after.point.parameter - before.point.parameter)
    beside = min((f for f in known if f != root), key=lambda f: abs(f - root))
    if abs(known[beside].point.parameter - orbit.point.parameter) > 0.0 and abs(beside - root) < 0.1:
        slope = (value(beside) - value(root)) / (known[beside].point.parameter - orbit.point.parameter)
    return root, _special(orbit, kind, abs(value(root)) + orbit.floquet().error, slope)


def _special(orbit: Orbit, kind: str, uncertain: float, slope: float) -> Orbit:
    """The orbit marked, with the error of its parameter by that of its multiplier."""
    point: Point = orbit.point
    moved = uncertain / abs(slope) if slope else np.inf
    by_orbit = point.error.relative(1.0)
    error = replace(point.error, parameter=float(moved / point.problem.parameter_size(point.z) + by_orbit))
    return replace(orbit, point=replace(point, error=error, special=kind, walked=False, requested=False))


def critical_vector(orbit: Orbit, multiplier: float) -> Array:
    """The vector that the monodromy matrix multiplies by +1 or -1, of norm 1, without what moves along the orbit."""
    monodromy = np.asarray(orbit.floquet().monodromy)
    vectors = np.linalg.svd(monodromy - multiplier * np.eye(len(monodromy)))[2][::-1]
    if multiplier < 0.0 or orbit.floquet().trivial == 0:
        return np.asarray(vectors[0])
    h = 1e-5 * orbit.period
    ahead, behind = orbit.evaluate([h, orbit.period - h])
    along = (ahead - behind) / np.linalg.norm(ahead - behind)
    free = [vector - along * (along @ vector) for vector in vectors[:2]]
    longest = max(free, key=lambda vector: float(np.linalg.norm(vector)))
    return np.asarray(longest / np.linalg.norm(longest))
