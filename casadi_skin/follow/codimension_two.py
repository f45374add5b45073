"""Points of codimension two on curves of special orbits and solutions: where one condition more holds.

The coefficient of the normal form vanishes (cusp, generalized period doubling, Chenciner point, degenerate pitchfork or
transcritical point); another multiplier is 1 or -1, or another pair on the unit circle; on tori the angle is that of a
strong resonance (Kuznetsov 2004, chapter 9). Or the orbits shrink to an equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.branch_points import double_between, interpolated
from casadi_skin.follow.followed import Followed
from casadi_skin.follow.normal_forms import (
    branching_equation,
    critical_functions,
    quadratic_term,
    second_singular,
    terms_of,
)
from casadi_skin.follow.search import (
    FULL_TURN,
    TANGENT_DIFFERENCE_STEP,
    Exponents,
    Sample,
    Stretch,
    StretchSearch,
    beside_on_tangent,
    height,
    is_real,
    nearest_order,
    turned,
)
from casadi_skin.follow.shrinking import shrunk
from casadi_skin.follow.special_points import NotLocatedError, zero_between
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.kinds import (
    BRANCH_POINT,
    CUSP,
    DEGENERATE_PITCHFORK,
    DEGENERATE_TRANSCRITICAL,
    DOUBLING,
    FOLD,
    TORUS,
    Unresolved,
)
from casadi_skin.zero.problem import EPSILON, Array
from casadi_skin.zero.settings import End, Point
from casadi_skin.zero.stated_problem import PERIOD

DEGENERATE_KINDS = {FOLD: "cusp of cycles", DOUBLING: "generalized period doubling", TORUS: "chenciner"}
RESONANCE_KINDS = {
    1.0: "1:1 resonance",
    -1.0: "1:2 resonance",
    -0.5: "1:3 resonance",
    0.0: "1:4 resonance",
}  # by cosine
ANOTHER_MULTIPLIER_KINDS = {  # by the kind of the curve: another multiplier is 1, is -1; another pair is on the circle
    FOLD: ("1:1 resonance", "fold-flip", "fold-torus"),
    DOUBLING: ("fold-flip", "1:2 resonance", "flip-torus"),
    TORUS: ("fold-torus", "flip-torus", "torus-torus"),
    BRANCH_POINT: ("1:1 resonance", "fold-flip", "fold-torus"),
}
VANISHING_TEST_RATIO = 1e-2  # of its values at both ends: a test where it has a root
INTERPOLATION_ERROR = 1e-3  # of a step: an error of interpolation with which a point is named
SHRINKING_AMPLITUDE_RATIO = 0.5  # of the amplitude at the other end of a step: an orbit that is shrinking
NOISE_FACTOR = 100.0  # times what a finer level changes: a test above it has its sign
NEAR_END = 4  # divisions of a step after which a point at which a curve ends is on it
POLE_COEFFICIENT = 0.95  # of a coefficient between -1 and 1: nearly twice what it is at both ends of a step together
MEETING_DISTANCE = 0.1  # between the logarithms of two multipliers that are about to meet
Test = Callable[[Point], float]


def special_on_curve(space: Followed, before: Point, after: Point) -> Iterator[Point | Unresolved]:
    """Points of codimension two between two points of a curve, in order, and parts of it that are not resolved.

    Raises NotLocatedError.
    """
    if space.shrinks(before, after):
        end = shrunk(space, before, after)
        if end is not None:
            yield end
            return
    search = _Search(space, before, after)
    found = list(search.between(search.first, search.last))
    yield from (part for part in found if isinstance(part, Unresolved))
    yield from sorted((point for point in found if isinstance(point, Point)), key=search.sigma)


class _Search(StretchSearch[Point | Unresolved]):
    """Points of codimension two on one stretch of a curve."""

    def __init__(self, space: Followed, before: Point, after: Point) -> None:
        closes = space.periodic is not None or space.repeats
        ends = [Exponents.from_floquet(space.floquet(end)) for end in (before, after)] if closes else []
        super().__init__(space.point_solver, before, after, space.multipliers_alone, ends)
        self.space = space
        self.tests = dict(_tests(space, before, after))
        self.closes, self._samples = closes, dict[int, Sample]()

    def outside(self, point: Point) -> tuple[int, int]:
        return super().outside(point) if self.closes else (0, 0)

    def sample(self, point: Point) -> Sample:
        if id(point) not in self._samples:
            self._samples[id(point)] = self._sampled(point)
        return self._samples[id(point)]

    def _sampled(self, point: Point) -> Sample:
        own = self.own(point)
        ahead = beside_on_tangent(own, TANGENT_DIFFERENCE_STEP)
        values = [(test(own), test(ahead)) for test in self.tests.values()]
        leading = tuple((here, (there - here) / TANGENT_DIFFERENCE_STEP) for here, there in values)
        row = self.metric(point) * point.tangent
        still = np.zeros_like(point.z)
        if not self.closes:
            empty = np.empty(0, dtype=complex)
            return Sample(point, row, empty, empty, np.empty(0), still, 1.0, leading)
        here, there = self.sampler.exponents(own)
        (first, noise), (last, _) = (_others(self.space, end, e) for end, e in ((own, here), (ahead, there)))
        order = nearest_order(first, last)
        rates = turned(last[order] - first) / TANGENT_DIFFERENCE_STEP
        return Sample(point, row, first, rates, noise, still, 1.0, leading, FULL_TURN)

    def found(self, stretch: Stretch, depth: int, last: bool) -> Sequence[Point | Unresolved] | None:
        settled, changed = stretch.settled.copy(), stretch.changed[: stretch.leading]
        settled[: stretch.leading] |= self._poles(stretch)
        ends = np.array([(self.space.kind, kind) in ENDS_BY_KIND for kind in self.tests], dtype=bool)
        if self._is_beyond(stretch, ends):
            return ()
        if depth >= NEAR_END and np.any(changed & settled[: stretch.leading] & ends):
            settled[: stretch.leading] = True  # beyond it there are no such orbits, and no coefficient
        if not (last or np.all(settled)):
            return None
        passed = list(self._passed(stretch))
        if not (passed or np.all(settled)):
            return list(self.unresolved(stretch))
        before, after = (self.own(end.point) for end in (stretch.first, stretch.last))
        located = [_root(self.space, before, after, kind, test) for kind, test in passed]
        return [point for _, point in sorted((one for one in located if one is not None), key=lambda one: one[0])]

    def _is_beyond(self, stretch: Stretch, ends: NDArray[np.bool_]) -> bool:
        """Whether a part lies beyond a point at which the curve ends."""
        start, here = (
            np.array([g for g, _ in sample.leading or ()]) for sample in (self.sample(self.first), stretch.first)
        )
        return bool(np.any(ends & (start * here < 0.0)))

    def _poles(self, stretch: Stretch) -> NDArray[np.bool_]:
        """Which of the leading quantities change their sign through infinity: they are larger there than beside it."""
        ends = np.abs(stretch.quantities[0][[0, -1], : stretch.leading])
        return np.asarray(stretch.changed[: stretch.leading] & (np.min(ends, axis=0) > POLE_COEFFICIENT))

    def _passed(self, stretch: Stretch) -> Iterator[tuple[str, Test]]:
        """Kinds of the points that are passed, each with a function that changes its sign there."""
        poles = self._poles(stretch)
        for kind, changed in zip(self.tests, stretch.changed[: poles.size] & ~poles, strict=True):
            if changed and not _is_rounding(self.space, *self.ends, self.tests[kind]):
                yield kind, self.tests[kind]
        for kind, angle in self._crossings(stretch):
            test = _tracked(self.space, angle)
            if not _is_rounding(self.space, *self.ends, test):
                yield kind, test

    def _crossings(self, stretch: Stretch) -> Iterator[tuple[str, float]]:
        """Kinds of the points at which another multiplier is on the circle, with its angle."""
        plus, minus, pair = ANOTHER_MULTIPLIER_KINDS[self.space.kind]
        for k in np.flatnonzero(stretch.changed[stretch.leading :]):
            first, last = stretch.first.values[k], stretch.last.values[stretch.order[k]]
            if is_real(first) and is_real(last):
                yield (minus, np.pi) if abs(first.imag) > 1.0 else (plus, 0.0)
            elif (angle := height(first, last)) > 0.0:
                yield pair, float(angle)

    def unresolved(self, stretch: Stretch) -> Iterator[Unresolved]:
        start, end = (self.space.parameters(s.point)[self.space.parameter] for s in (stretch.first, stretch.last))
        yield Unresolved(start, end, "points of codimension two may be missing", self.space.kind, self.space.parameter)


def _tests(space: Followed, before: Point, after: Point) -> Iterator[tuple[str, Test]]:
    """Functions of a point that vanish at points of some kinds; others are found from multipliers."""
    if space.kind == BRANCH_POINT:
        yield from _branching(space, before, after)
    yield from _resonances(space)
    for kind, test in _of_normal_form(space, before):
        with suppress(RuntimeError, NotImplementedError):  # the model has no third derivatives
            size = abs(test(before)) + abs(test(after))
            if size:
                yield kind, _bounded(test, size)


def _bounded(test: Test, size: float) -> Test:
    """A test of a usual size as one between -1 and 1: coefficients have poles."""
    return lambda point: float(np.tanh(test(point) / size))


def _is_rounding(space: Followed, before: Point, after: Point, test: Test) -> bool:
    """Whether a test changes its sign because it goes to zero with the orbit, down to what a finer level changes."""
    if PERIOD not in space.statement.free:
        return False
    smaller, larger = sorted((before, after), key=space.amplitude)
    if space.amplitude(smaller) > SHRINKING_AMPLITUDE_RATIO * space.amplitude(larger) or smaller.better is None:
        return False
    return abs(test(smaller)) <= NOISE_FACTOR * abs(test(_finer(smaller)) - test(smaller))


def _branching(space: Followed, before: Point, after: Point) -> Iterator[tuple[str, Test]]:
    """The coefficient at whose zero the branching equation degenerates, with the kind of that point."""
    equations = [branching_equation(space, point) for point in (before, after)]
    try:
        symmetric = all(one.symmetric(p.error.profile) for one, p in zip(equations, (before, after), strict=True))
        size = sum(abs(equation.coefficients[int(symmetric)]) for equation in equations)
    except (RuntimeError, NotImplementedError):  # the model has no third derivatives
        return
    kind = DEGENERATE_PITCHFORK if symmetric else DEGENERATE_TRANSCRITICAL
    if size:
        yield kind, _bounded(lambda point: branching_equation(space, point).coefficients[int(symmetric)], size)


def _resonances(space: Followed) -> list[tuple[str, Test]]:
    if space.kind != TORUS:
        return []
    return [(name, lambda p, at=cosine: space.kappa(p) - at) for cosine, name in RESONANCE_KINDS.items()]  # type: ignore[misc]


def _of_normal_form(space: Followed, before: Point) -> list[tuple[str, Test]]:
    """The kind of points at which the coefficient of the normal form vanishes, where there is one."""
    if space.kind == FOLD and space.periodic is None:
        return [(CUSP, quadratic_term(space, before))]
    known = space.kind in DEGENERATE_KINDS and (space.periodic is not None or space.repeats)
    return [(DEGENERATE_KINDS[space.kind], _coefficient(space))] if known else []


def _others(space: Followed, point: Point, exponents: Exponents) -> tuple[ComplexArray, Array]:
    """Logarithms of the multipliers but the trivial and the critical ones, and their noise.

    Where another one meets a critical one at 1 or -1 the two have half the digits, and their product has all: the
    nearest other one is taken with what the critical one is off.
    """
    values, noise = exponents.values, exponents.noise
    critical = np.array([1j * np.pi if space.kind == DOUBLING else 0j])
    if space.kind == TORUS:
        angle = np.arccos(complex(space.kappa(point)))
        critical = np.array([1j * angle, -1j * angle])
    for place in critical:
        k = int(np.argmin(np.abs(turned(values - place))))
        off, values, noise = turned(values[k] - place), np.delete(values, k), np.delete(noise, k)
        if space.kind != TORUS and values.size:
            nearest = int(np.argmin(np.abs(turned(values - place))))
            joined = turned(values[nearest] + off - place)
            if abs(joined) <= MEETING_DISTANCE and abs(joined.imag) <= EPSILON:
                values[nearest] = place + joined.real
    return values, noise


def _tracked(space: Followed, angle: float) -> Test:
    """The logarithm of the modulus of the other multiplier that is nearest to a place on the circle."""

    def test(point: Point) -> float:
        values = _others(space, point, Exponents.from_floquet(space.multipliers_alone(point)))[0]
        return float(values[np.argmin(np.abs(turned(values - 1j * angle)))].real)

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
    if space.kind == BRANCH_POINT and kind == ANOTHER_MULTIPLIER_KINDS[BRANCH_POINT][0]:
        second = partial(second_singular, space)
        double = double_between(space.point_solver, before, after, test, second)
        if double is not None:
            return double
    try:
        zero, beside, size = zero_between(space.point_solver, before, after, test, kind)
    except NotLocatedError:  # another null vector makes the equations singular there
        found = interpolated(space.point_solver, before, after, test)
        if found is None or found[1].error.parameter > INTERPOLATION_ERROR * abs(after.parameter - before.parameter):
            raise
        return found[0], replace(found[1], special=kind)
    if abs(zero.value) > VANISHING_TEST_RATIO * size:
        return None
    point: Point | None = zero.point
    if zero.point.better is None:  # an end of the stretch, which is no point of the curve
        point = space.point_solver.along(before, after, zero.fraction)
    if point is None:
        raise NotLocatedError(f"a point of kind {kind} cannot be located: {space.point_solver.failure}")
    slope = (beside.value - zero.value) / (beside.fraction - zero.fraction)
    moved = _error(space, point, test, slope / _length(space, before, after))
    error = replace(point.error, parameter=moved)
    return zero.fraction, replace(point, error=error, requested=False, walked=False, special=kind)


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


ENDS_BY_KIND = {
    (TORUS, "1:1 resonance"): End.RESONANCE_ONE,
    (TORUS, "1:2 resonance"): End.RESONANCE_TWO,
    (FOLD, "generalized hopf"): End.BAUTIN,
    (TORUS, "hopf-hopf"): End.HOPF_HOPF,
    (TORUS, "zero-hopf"): End.ZERO_HOPF,
}
