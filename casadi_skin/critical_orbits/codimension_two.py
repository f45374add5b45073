"""Points of codimension two on curves of special orbits and solutions: where one condition more holds.

The coefficient of the normal form vanishes (cusp, generalized period doubling, Chenciner point, degenerate pitchfork or
transcritical point); another multiplier is 1 or -1, or another pair on the unit circle; on tori the angle is that of a
strong resonance (Kuznetsov 2004, chapter 9). Or the orbits shrink to an equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from casadi_skin.bvp.problem import EPSILON
from casadi_skin.bvp.stated_problem import PERIOD
from casadi_skin.continuation.points import End, Point
from casadi_skin.critical_orbits.bend import quadratic_term
from casadi_skin.critical_orbits.branch_forms import branching_equation, second_singular
from casadi_skin.critical_orbits.followed import Followed
from casadi_skin.critical_orbits.normal_forms import critical_functions, terms_of
from casadi_skin.critical_orbits.shrinking import shrunk
from casadi_skin.equilibria.codimension_two import CUSP, DEGENERATE_PITCHFORK, DEGENERATE_TRANSCRITICAL
from casadi_skin.equilibria.double_points import double_between, interpolated
from casadi_skin.orbits.special_points import BRANCH_POINT, DOUBLING, FOLD, TORUS, NotLocatedError, zero_between
from casadi_skin.stability.reduction import ComplexArray

DEGENERATE = {FOLD: "cusp of cycles", DOUBLING: "generalized period doubling", TORUS: "chenciner"}
RESONANCES = {1.0: "1:1 resonance", -1.0: "1:2 resonance", -0.5: "1:3 resonance", 0.0: "1:4 resonance"}  # by cosine
ANOTHER = {  # by the kind of the curve: another multiplier is 1, is -1; another pair is on the circle
    FOLD: ("1:1 resonance", "fold-flip", "fold-torus"),
    DOUBLING: ("fold-flip", "1:2 resonance", "flip-torus"),
    TORUS: ("fold-torus", "flip-torus", "torus-torus"),
    BRANCH_POINT: ("1:1 resonance", "fold-flip", "fold-torus"),
}
VANISHES = 1e-2  # of its values at both ends: a test where it has a root
INTERPOLATED = 1e-3  # of a step: an error of interpolation with which a point is named
SMALL = 0.5  # of the amplitude at the other end of a step: an orbit that is shrinking
NOISE = 100.0  # times what a finer level changes: a test above it has its sign
NEUTRAL = 1e-6  # imaginary part of a pair that is one
Test = Callable[[Point], float]


def special_on_curve(space: Followed, before: Point, after: Point) -> Iterator[Point]:
    """Points of codimension two between two points of a curve, in order; raises NotLocatedError."""
    if space.shrinks(before, after):
        end = shrunk(space, before, after)
        if end is not None:
            yield end
            return
    found = [_root(space, before, after, kind, test) for kind, test in _tests(space, before, after)]
    yield from (point for _, point in sorted((one for one in found if one is not None), key=lambda entry: entry[0]))


def _tests(space: Followed, before: Point, after: Point) -> Iterator[tuple[str, Test]]:
    """Kinds of the points that are passed, each with a function that changes its sign there."""
    if space.kind == BRANCH_POINT:
        yield from _branching(space, before, after)
    for kind, test in [*_resonances(space), *_of_multipliers(space), *_of_normal_form(space, before)]:
        try:
            if test(before) * test(after) < 0.0 and not _is_rounding(space, before, after, test):
                yield kind, test
        except (RuntimeError, NotImplementedError):  # the model has no third derivatives
            continue


def _is_rounding(space: Followed, before: Point, after: Point, test: Test) -> bool:
    """Whether a test changes its sign because it goes to zero with the orbit, down to what a finer level changes."""
    if PERIOD not in space.statement.free:
        return False
    smaller, larger = sorted((before, after), key=space.amplitude)
    if space.amplitude(smaller) > SMALL * space.amplitude(larger) or smaller.better is None:
        return False
    return abs(test(smaller)) <= NOISE * abs(test(_finer(smaller)) - test(smaller))


def _branching(space: Followed, before: Point, after: Point) -> Iterator[tuple[str, Test]]:
    """The kind of the point at which the branching equation degenerates, where it does, with its coefficient."""
    equations = [branching_equation(space, point) for point in (before, after)]
    try:
        symmetric = all(one.symmetric(p.error.profile) for one, p in zip(equations, (before, after), strict=True))
        values = [equation.coefficients[int(symmetric)] for equation in equations]
    except (RuntimeError, NotImplementedError):  # the model has no third derivatives
        return
    if values[0] * values[1] < 0.0:
        kind = DEGENERATE_PITCHFORK if symmetric else DEGENERATE_TRANSCRITICAL
        yield kind, lambda point: branching_equation(space, point).coefficients[int(symmetric)]


def _resonances(space: Followed) -> list[tuple[str, Test]]:
    if space.kind != TORUS:
        return []
    return [(name, lambda p, at=cosine: space.kappa(p) - at) for cosine, name in RESONANCES.items()]  # type: ignore[misc]


def _of_multipliers(space: Followed) -> list[tuple[str, Test]]:
    """Kinds of points at which another multiplier is on the unit circle, of orbits and of solutions that close."""
    if space.periodic is None and not space.repeats:
        return []
    plus, minus, pair = ANOTHER[space.kind]
    return [(plus, _real(space, 1.0)), (minus, _real(space, -1.0)), (pair, _pairs(space))]


def _of_normal_form(space: Followed, before: Point) -> list[tuple[str, Test]]:
    """The kind of points at which the coefficient of the normal form vanishes, where there is one."""
    if space.kind == FOLD and space.periodic is None:
        return [(CUSP, quadratic_term(space, before))]
    known = space.kind in DEGENERATE and (space.periodic is not None or space.repeats)
    return [(DEGENERATE[space.kind], _coefficient(space))] if known else []


def others(space: Followed, point: Point) -> ComplexArray:
    """Multipliers but the trivial and the critical ones."""
    values = space.multipliers(point)
    roots = [-1.0 if space.kind == DOUBLING else 1.0]
    if space.kind == TORUS:
        kappa = space.kappa(point)
        width = np.sqrt(complex(kappa**2 - 1.0))
        roots = [kappa + width, kappa - width]
    for root in roots:
        values = np.delete(values, np.argmin(np.abs(values - root)))
    return values


def _real(space: Followed, value: float) -> Test:
    """The product over other multipliers of their distances from 1 or -1, which changes its sign as one passes it.

    Where the critical one is there too, the nearest other comes with it: of two that meet the sum alone has its digits.
    """
    meets = {FOLD: 1.0, BRANCH_POINT: 1.0, DOUBLING: -1.0}.get(space.kind) == value

    def test(point: Point) -> float:
        found = others(space, point)
        distances = found - value
        if meets and found.size:
            every = space.multipliers(point)
            nearest = np.argmin(np.abs(distances))
            distances[nearest] = np.sum(every - value) - np.sum(np.delete(distances, nearest))
        return float(np.prod(distances / (1.0 + np.abs(found))).real)

    return test


def _pairs(space: Followed) -> Test:
    """The product over pairs of other multipliers of 1 minus their product."""

    def test(point: Point) -> float:
        found = others(space, point)
        i, j = np.triu_indices(found.size, 1)
        products = found[i] * found[j]
        return float(np.prod((1.0 - products) / (1.0 + np.abs(products))).real) if products.size else 1.0

    return test


def _coefficient(space: Followed) -> Test:
    """The coefficient of the normal form, computed once for the last few points."""

    def test(point: Point) -> float:
        for known, found in space.coefficients:
            if known is point:
                return found
        linear = space.linearised(point)
        angle = float(np.arccos(np.clip(space.kappa(point), -1.0, 1.0))) if space.kind == TORUS else 0.0
        assert space.critical is not None
        turn = space.critical.turn if space.critical.turn.size else None
        found_there = critical_functions(space.kind, linear, angle, turn)
        terms = terms_of(space.kind, linear, angle, *found_there, turn)
        space.coefficients[:] = [*space.coefficients[-7:], (point, float(np.sum(terms)))]
        return float(np.sum(terms))

    return test


def _root(space: Followed, before: Point, after: Point, kind: str, test: Test) -> tuple[float, Point] | None:
    """The point between two where a test vanishes, with its place; None where it has a pole in place of a root.

    Raises NotLocatedError.
    """
    if space.kind == BRANCH_POINT and kind == ANOTHER[BRANCH_POINT][0]:
        second = partial(second_singular, space)
        double = double_between(space.point_solver, before, after, test, second)
        if double is not None:
            return double
    try:
        zero, beside, size = zero_between(space.point_solver, before, after, test, kind)
    except NotLocatedError:  # another null vector makes the equations singular there
        found = interpolated(space.point_solver, before, after, test)
        if found is None or found[1].error.parameter > INTERPOLATED * abs(after.parameter - before.parameter):
            raise
        return (found[0], replace(found[1], special=kind)) if _is_pair(space, found[1], kind) else None
    if abs(zero.value) > VANISHES * size or not _is_pair(space, zero.point, kind):
        return None
    slope = (beside.value - zero.value) / (beside.fraction - zero.fraction)
    moved = _error(space, zero.point, test, slope / _length(space, before, after))
    error = replace(zero.point.error, parameter=moved)
    return zero.fraction, replace(zero.point, error=error, requested=False, walked=False, special=kind)


def _is_pair(space: Followed, point: Point, kind: str) -> bool:
    """Whether a pair on the unit circle is one, and not two real multipliers with product 1."""
    if kind != ANOTHER[space.kind][2]:
        return True
    found = others(space, point)
    i, j = np.triu_indices(found.size, 1)
    nearest = np.argmin(np.abs(1.0 - found[i] * found[j]))
    return bool(abs(found[i[nearest]].imag) > NEUTRAL)


def _length(space: Followed, before: Point, after: Point) -> float:
    return space.point_solver.curve(before, after)[1]


def _error(space: Followed, point: Point, test: Test, slope: float) -> float:
    """Estimated relative error of the parameter where a test vanishes, from its value on a finer level."""
    along = (abs(test(_finer(point))) + abs(test(point))) / abs(slope) if slope else 0.0
    moved = abs(_finer(point).parameter - point.parameter) + along * abs(float(point.tangent[-1]))
    return float(moved / point.problem.parameter_size(point.z) + EPSILON)


def _finer(point: Point) -> Point:
    """The point on its finer level."""
    better = point.better
    assert better is not None
    return replace(point, problem=better.problem, z=better.z, better=None)


ENDS = {
    (TORUS, "1:1 resonance"): End.RESONANCE_ONE,
    (TORUS, "1:2 resonance"): End.RESONANCE_TWO,
    (FOLD, "generalized hopf"): End.BAUTIN,
    (TORUS, "hopf-hopf"): End.HOPF_HOPF,
    (TORUS, "zero-hopf"): End.ZERO_HOPF,
}
