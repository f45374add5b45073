"""Points of codimension two on curves of special points: where one condition more holds.

Of equilibria and of orbits alike, on a curve of folds, Hopf points, branch points, period doublings or tori,

    the coefficient of the normal form vanishes: g(z) = 0;
    another eigenvalue lambda, or exponent log mu, is critical: Re lambda = 0 or log |mu| = 0;
    those that are critical meet: kappa(z) = 0, or the angle of a torus is that of a strong resonance

(Kuznetsov 2004, chapters 8 and 9). `zero.kinds` names what each of these is. Where two eigenvalues of a branch point
are zero, each with an eigenvector of its own, it is a double one. One search serves all curves; it reads equilibria
in one way, orbits and solutions of boundary-value problems in another.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.branch_points import double_between, interpolated
from casadi_skin.follow.normal_forms import branching_terms, quadratic_term, second_singular
from casadi_skin.follow.samples import SampledStretch
from casadi_skin.follow.search import (
    TANGENT_DIFFERENCE_STEP,
    TEST_ZERO_XTOL,
    ExponentSampler,
    NotLocatedError,
    Search,
    beside_on_tangent,
    gap_between,
    nearest_order,
    zero_between,
)
from casadi_skin.follow.space import ORBITS, Followed
from casadi_skin.model.arguments import in_words
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import FULL_TURN, turned
from casadi_skin.zero.augmented import Augmented
from casadi_skin.zero.balanced import dense
from casadi_skin.zero.kinds import (
    BRANCH_POINT,
    CUSP,
    DEGENERATE_PITCHFORK,
    DEGENERATE_TRANSCRITICAL,
    EQUILIBRIUM_CURVES,
    FOLD,
    HOPF,
    KINDS,
    ORBIT_CURVES,
    CurveKind,
    Unresolved,
)
from casadi_skin.zero.linearised import LinearisedEquations
from casadi_skin.zero.problem import EPSILON, Array
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import PERIOD

# What a curve of special points may meet ------------------------------------------------------------------------------

VANISHING_TEST_RATIO = 1e-2  # of its values at both ends: a test where it has a root, and not a pole
INTERPOLATION_ERROR = 1e-3  # of a step: an error of interpolation with which a point is named
SHRINKING_AMPLITUDE_RATIO = 0.5  # of the amplitude at the other end of a step: an orbit that is shrinking
ROUNDING_SAFETY = 4.0  # times the response to one disturbance by rounding: that to any
NOISE_FACTOR = 100.0  # times what a finer level changes: a test above it has its sign
NEAR_END = 5  # divisions of a step after which a point at which a curve ends is on it
POLE_COEFFICIENT = 0.95  # of a coefficient between -1 and 1: nearly twice what it is at both ends of a step together
MEETING_DISTANCE = 0.1  # between exponents, of usual size, of two that are about to meet
SYMMETRIC_TERM_RATIO = 1e-6  # of all terms: a quadratic coefficient that a symmetry makes zero
Test = Callable[[Point], float]


def special_on_curve(search: CurveSearch, gaps: list[Unresolved]) -> list[Point]:
    """Points of codimension two between two points of a curve, in order; `gaps` gets parts that are not resolved.

    Raises NotLocatedError.
    """
    found = [*search.on_stretch(), *search.found_by_ends()]
    gaps += search.gaps
    return sorted(found, key=search.sigma)


class CurveSearch(Search):
    """Points of codimension two on one stretch of a curve.

    Attributes:
        space: of the curve.
        kind: of the special points that it connects.
        kinds: of the points that it may meet.
        has_coefficient: whether the coefficient of the normal form is known beside that of a fold.
        meeting_distance: between another exponent and the critical one that are about to meet.
        tests: functions of a point that vanish at points of some kinds.
    """

    def __init__(self, space: Followed, kinds: Mapping[str, CurveKind], before: Point, after: Point) -> None:
        super().__init__(space.point_solver, before, after)
        self.space, self.kind, self.kinds = space, space.kind, kinds[space.kind]
        self.has_coefficient, self.meeting_distance = False, np.inf

    @cached_property
    def tests(self) -> dict[str, Test]:
        found: dict[str, Test] = {
            name: lambda point, at=at: kappa(point) - at  # type: ignore[misc]
            for at, name in self.kinds.meetings.items()
        }
        try:
            found |= self.branching_tests() if self.kind == BRANCH_POINT else self.coefficient_tests()
        except (RuntimeError, NotImplementedError) as error:  # of derivatives that the model does not have
            words = f"the coefficient of the normal form is not computed: {in_words(error)}"
            self.gaps.append(gap_between(self.space, *self.ends, words, self.kinds.degenerate or CUSP))
        return found

    def coefficient_tests(self) -> dict[str, Test]:
        """That of the coefficient of the normal form; raises RuntimeError without derivatives."""
        if self.kind == FOLD and self.space.connects != ORBITS:
            return self.bounded(CUSP, quadratic_term(self.space, self.ends[0]))
        return self.bounded(self.kinds.degenerate, self.space.coefficient) if self.has_coefficient else {}

    def branching_terms(self, point: Point) -> tuple[Array, Array]:
        """Terms of the quadratic and of the cubic coefficient of the branching equation; raises RuntimeError."""
        return branching_terms(self.space.linearised(point), self._reference)

    @cached_property
    def _reference(self) -> LinearisedEquations:
        found: LinearisedEquations = self.space.linearised(self.ends[0])
        return found

    def branching_tests(self) -> dict[str, Test]:
        """That of the coefficient at whose zero the branching equation degenerates: cubic where a symmetry is lost."""
        known = [self.branching_terms(end) for end in self.ends]
        symmetric = int(all(
            abs(np.sum(quadratic)) <= self.symmetric_ratio(end) * (np.sum(np.abs(quadratic)) + np.sum(np.abs(cubic)))
            for end, (quadratic, cubic) in zip(self.ends, known, strict=True)
        ))  # fmt: skip
        kind = DEGENERATE_PITCHFORK if symmetric else DEGENERATE_TRANSCRITICAL
        return self.bounded(kind, lambda point: float(np.sum(self.branching_terms(point)[symmetric])))

    def bounded(self, kind: str, test: Test) -> dict[str, Test]:
        """A test as one between -1 and 1, by its values at both ends: coefficients have poles."""
        size = sum(abs(value) for end in self.ends if np.isfinite(value := test(end)))
        return {kind: lambda point: float(np.tanh(test(point) / size))} if size else {}

    def symmetric_ratio(self, point: Point) -> float:
        """Largest ratio of a quadratic coefficient to all terms that a symmetry and errors of the point leave."""
        return SYMMETRIC_TERM_RATIO

    @abstractmethod
    def frequency(self, point: Point) -> complex:
        """Of the critical pair of a Hopf point, or the angle of a torus."""

    def without_critical(self, point: Point, values: ComplexArray, *more: NDArray[Any]) -> tuple[NDArray[Any], ...]:
        """Exponents but the critical ones, and the same of `more` arrays.

        Where another one meets a single critical one the two have half the digits, and their sum has all: the nearest
        other one is taken with what the critical one is off.
        """
        angle, arrays = KINDS[self.kind].angle, [values, *more]
        frequency = self.frequency(point) if angle is None else angle
        for place in 1j * frequency * np.array([1.0, -1.0] if angle is None else [1.0]):
            k = int(np.argmin(np.abs(turned(arrays[0] - place, self.turn))))
            off = turned(arrays[0][k] - place, self.turn)
            arrays = [np.delete(one, k) for one in arrays]
            others = arrays[0]
            if angle is not None and others.size:
                nearest = int(np.argmin(np.abs(turned(others - place, self.turn))))
                joined = turned(others[nearest] + off - place, self.turn)
                if abs(joined) <= self.meeting_distance and abs(joined.imag) <= EPSILON:
                    others[nearest] = place + joined.real
        return tuple(arrays)

    @abstractmethod
    def others(self, point: Point) -> ComplexArray:
        """Eigenvalues, or logarithms of multipliers, but the critical ones."""

    def tracked(self, at: complex) -> Test:
        """The real part of the value that is nearest to a place on the axis."""

        def test(point: Point) -> float:
            values = self.others(point)
            return float(values[np.argmin(np.abs(turned(values - at, self.turn)))].real)

        return test

    def second_singular(self, point: Point) -> float:
        """The second smallest singular value of the Jacobian at a branch point."""
        return second_singular(self.space.linearised(point))

    def is_rounding(self, test: Test) -> bool:
        """Whether a test changes its sign as it goes to zero with the orbit, down to what a finer level changes."""
        return False

    @abstractmethod
    def error(self, point: Point, test: Test, slope: float, width: float) -> float:
        """Estimated relative error of the parameter where a test vanishes, by its slope, within a width."""

    def found_by_ends(self) -> Iterator[Point]:
        """Points that the signs of noisy coefficients at both ends show."""
        yield from ()

    def values(self, point: Point) -> Array:
        return np.array([test(point) for test in self.tests.values()])

    def found(self, stretch: SampledStretch, depth: int, last: bool) -> Sequence[Point] | None:
        if self._is_beyond(stretch):
            return ()
        settled = stretch.isolates_roots.copy()
        settled[: stretch.leading] |= self._poles(stretch)
        ending = self._changed(stretch) & settled[: stretch.leading] & self._ends
        if depth >= NEAR_END and np.any(ending):
            settled[: stretch.leading] = True  # beyond it there are no such points, and no coefficient
        if not (last or np.all(settled)):
            return None
        passed = list(self._passed(stretch))
        if not (passed or np.all(settled)):
            return self.given_up(stretch)
        before, after = (self.own(end.point) for end in (stretch.first, stretch.last))
        located = [self.root(before, after, kind, test) for kind, test in passed]
        return [point for _, point in sorted((one for one in located if one is not None), key=lambda one: one[0])]

    @property
    def _ends(self) -> NDArray[np.bool_]:
        """Which of the tests vanish where the curve ends."""
        return np.array([kind in self.kinds.ends for kind in self.tests], dtype=bool)

    def _is_beyond(self, stretch: SampledStretch) -> bool:
        """Whether a part lies beyond a point at which the curve ends."""
        start, here = (
            np.array([g for g, _ in sample.leading or ()]) for sample in (self.sample(self.first), stretch.first)
        )
        return bool(np.any(self._ends & (start * here < 0.0)))

    def _poles(self, stretch: SampledStretch) -> NDArray[np.bool_]:
        """Which of the leading quantities change their sign through infinity: they are larger there than beside it."""
        ends = np.abs(stretch.quantities[0][[0, -1], : stretch.leading])
        return np.asarray(stretch.changed[: stretch.leading] & (np.min(ends, axis=0) > POLE_COEFFICIENT))

    def _changed(self, stretch: SampledStretch) -> NDArray[np.bool_]:
        return stretch.changed[: stretch.leading] & ~self._poles(stretch)

    def _passed(self, stretch: SampledStretch) -> Iterator[tuple[str, Test]]:
        """Kinds of the points that are passed, each with a function that changes its sign there."""
        changed = self._changed(stretch)
        if np.any(changed & self._ends):
            changed &= self._ends
        passed = [(kind, test) for (kind, test), one in zip(self.tests.items(), changed, strict=True) if one]
        passed += [(one.kind, self.tracked(1j * one.angle)) for one in stretch.crossings(self.kinds.another)]
        yield from (one for one in passed if not self.is_rounding(one[1]))

    # Locating ---------------------------------------------------------------------------------------------------------

    def root(self, before: Point, after: Point, kind: str, test: Test) -> tuple[float, Point] | None:
        """The point between two where a test vanishes, with its place; None where it has a pole in place of a root.

        Raises NotLocatedError.
        """
        if self.kind == BRANCH_POINT and kind == self.kinds.another[0]:
            double = double_between(self.solver, before, after, test, self.second_singular)
            if double is not None:
                return double
        try:
            zero, beside, size = zero_between(self.solver, before, after, test, kind)
        except NotLocatedError:  # another null vector makes the equations singular there
            found = interpolated(self.solver, before, after, test)
            if found is None or found[1].error.parameter > INTERPOLATION_ERROR * abs(
                after.parameter - before.parameter
            ):
                raise
            return found[0], replace(found[1], special=kind)
        if abs(zero.value) > VANISHING_TEST_RATIO * size:
            return None
        point = zero.point if 0.0 < zero.fraction < 1.0 else self.solver.along(before, after, zero.fraction)
        if point is None:
            raise NotLocatedError(f"a point of kind {kind} cannot be located: {self.solver.failure}")
        slope = (beside.value - zero.value) / (beside.fraction - zero.fraction)
        length = self.solver.curve(before, after)[1]
        width = length * min(abs(beside.fraction - zero.fraction), 10.0 * TEST_ZERO_XTOL)
        moved = self.error(point, test, slope / length, width)
        return zero.fraction, point.marked(kind, error=replace(point.error, parameter=moved))


# Curves of equilibria -------------------------------------------------------------------------------------------------


class EquilibriumCurveSearch(CurveSearch):
    """Of folds, Hopf points and branch points of equilibria."""

    def __init__(self, space: Followed, before: Point, after: Point) -> None:
        super().__init__(space, EQUILIBRIUM_CURVES, before, after)
        self.has_coefficient = bool(space.statics.exact)  # noise of differences has roots of its own

    def branching_tests(self) -> dict[str, Test]:
        return super().branching_tests() if self.has_coefficient else {}

    def exponents(self, point: Point) -> tuple[ComplexArray, ComplexArray, Array]:
        sample = self.space.sample(point)
        values, rates, noise = self.without_critical(point, sample.values, sample.rates, sample.noise)
        return values, rates, noise

    def frequency(self, point: Point) -> complex:
        return complex(point.problem.singularity.rate * np.sqrt(complex(kappa(point))))

    def others(self, point: Point) -> ComplexArray:
        values = np.asarray(np.linalg.eigvals(dense(point.problem.rates(point.z))), dtype=np.complex128)
        return self.without_critical(point, values)[0]

    def error(self, point: Point, test: Test, slope: float, width: float) -> float:
        return float(width * abs(point.tangent[-1]) + point.error.relative(1.0))

    def found_by_ends(self) -> Iterator[Point]:
        """The generalized Hopf point between two of a program, whose higher derivatives are differences.

        None is sought where l1 at both ends is smaller than what twice the steps of differences change.
        """
        if self.kind != HOPF or self.has_coefficient or kappa(self.ends[1]) <= 0.0:
            return
        l1 = [self.space.coefficient(end) for end in self.ends]

        def noise(point: Point) -> float:
            return float(abs(self.space.coefficient(point, 2.0) - self.space.coefficient(point)))

        larger = self.ends[int(np.argmax(np.abs(l1)))]
        if not l1[0] * l1[1] < 0.0 or max(np.abs(l1)) <= noise(larger):
            return
        located = self.root(*self.ends, self.kinds.degenerate, self.space.coefficient)
        if located is not None:
            slope = (l1[1] - l1[0]) / (self.ends[1].parameter - self.ends[0].parameter)
            moved = abs((noise(located[1]) + abs(self.space.coefficient(located[1]))) / slope)
            error = located[1].error
            yield replace(located[1], error=replace(error, parameter=error.parameter + float(moved)))


def kappa(point: Point) -> float:
    """How far apart the critical pair of a Hopf point or a torus is (see `augmented`)."""
    return float(point.z[cast(Augmented, point.problem).added_index])


# Curves of orbits, and of solutions of boundary-value problems --------------------------------------------------------


class OrbitCurveSearch(CurveSearch):
    """Of folds, branch points, period doublings and tori."""

    turn = FULL_TURN

    def __init__(self, space: Followed, before: Point, after: Point) -> None:
        super().__init__(space, ORBIT_CURVES, before, after)
        self.has_coefficient, self.meeting_distance = space.stability_included, MEETING_DISTANCE
        if self.has_coefficient:
            self.sampler = ExponentSampler(space, *((end, space.floquet(end).exponents) for end in self.ends))

    def symmetric_ratio(self, point: Point) -> float:
        return max(SYMMETRIC_TERM_RATIO, 100.0 * point.error.profile)

    def exponents(self, point: Point) -> tuple[ComplexArray, ComplexArray, Array]:
        if not self.has_coefficient:
            return super().exponents(point)
        (here, there), ahead = self.sampler.exponents(point), beside_on_tangent(point, TANGENT_DIFFERENCE_STEP)
        first, noise = self.without_critical(point, here.values, here.noise)
        last = self.without_critical(ahead, there.values)[0]
        return first, turned(last[nearest_order(first, last)] - first) / TANGENT_DIFFERENCE_STEP, noise

    def frequency(self, point: Point) -> complex:
        return complex(np.arccos(complex(kappa(point))))

    def others(self, point: Point) -> ComplexArray:
        return self.without_critical(point, self.space.multipliers_alone(point).exponents.values)[0]

    def is_rounding(self, test: Test) -> bool:
        if PERIOD not in self.space.statement.free:
            return False
        smaller, larger = sorted(self.ends, key=self.space.amplitude)
        if self.space.amplitude(smaller) > SHRINKING_AMPLITUDE_RATIO * self.space.amplitude(larger):
            return False
        return smaller.better is not None and abs(test(smaller)) <= NOISE_FACTOR * abs(
            test(_finer(smaller)) - test(smaller)
        )

    def error(self, point: Point, test: Test, slope: float, width: float) -> float:
        """From the value of the test on a finer level, and after a disturbance by rounding."""
        finer, problem = _finer(point), point.problem
        solve = self.solver.factor(problem, point.z, self.metric(point) * point.tangent)
        noise = ROUNDING_SAFETY * solve(np.append(problem.rounding(point.z) * problem.probe, 0.0))
        shaken = abs(test(replace(point, z=point.z + noise)) - test(point))
        along = (abs(test(finer)) + abs(test(point)) + shaken) / abs(slope) if slope else 0.0
        moved = abs(finer.parameter - point.parameter) + along * abs(float(point.tangent[-1])) + abs(float(noise[-1]))
        moved += 4.0 * EPSILON  # of the way between both values of the parameter, which it is computed from
        return float(moved / point.problem.parameter_size(point.z) + EPSILON)

    def given_up(self, stretch: SampledStretch) -> Sequence[Point]:
        ends = stretch.first.point, stretch.last.point
        self.gaps.append(gap_between(self.space, *ends, "points of codimension two may be missing", self.kind))
        return ()


def _finer(point: Point) -> Point:
    """The point on its finer level."""
    better = point.better
    assert better is not None
    return replace(point, problem=better.problem, z=better.z, better=None)
