"""The search for events on a stretch of a branch: points at which real quantities g_k(sigma) vanish.

The quantities are the rate of the parameter, the real parts of eigenvalues, logarithms of multipliers, or monitors of
users. The stretch is divided until the roots of all are isolated (see `samples`).

Multipliers mu_k, k = 1 ... m, the trivial ones left out, are smooth along the branch but where two of them meet.
Where they move freely a sample holds, each of shape (m,),

    w_k = log mu_k = log |mu_k| + i arg mu_k,

whose real part vanishes on the unit circle. Where they come in pairs mu, 1/mu, as those of conservative and of
reversible orbits do, it holds, each of shape (m / 2,) and twice, for c = 2 and for c = -2,

    q_k = arsinh(tau_k - c),    tau_k = mu_k + 1 / mu_k,

which is real and vanishes where a pair passes +1 or -1; a pair is on the circle where tau_k is real and in [-2, 2].
Rates are differences to the point one small step along the tangent: it leaves the branch by the square of the step.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise, product
from typing import Any, NamedTuple, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.moving import beside
from casadi_skin.follow.point import PointSolver
from casadi_skin.follow.samples import (
    CERTAIN_SIGN_NOISE,
    SAMPLE_FRACTION,
    STILL_RATE,
    Sample,
    SampledStretch,
    assignment,
)
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import Exponents, turned
from casadi_skin.zero.kinds import STABILITY, Unresolved
from casadi_skin.zero.problem import EPSILON, Array, Indices
from casadi_skin.zero.settings import Point

# The search for special points on a stretch of a branch, which is divided until each part is resolved ----------------

DEEPEST_DIVISION = 14  # divisions of a stretch between two points of the continuation
SHORTEST_PART = 1e-11  # of a step: shorter parts are not divided
MOST_PARTS = 120  # parts that it is divided into
ROOT_XTOL = 1e-10  # of a stretch, of roots of quantities where no extended equations are solved
TRIED_PLACES = (SAMPLE_FRACTION, 0.3, 0.7)  # of a stretch, where one point after the other is tried


CLEAR_DISTANCE = (
    0.5  # of the changes of a quantity on a stretch: a distance from zero at both ends that needs no sample
)


class BranchStretch:
    """The stretch of a branch between two points of the continuation, in the unknowns of the second.

    Attributes:
        solver: of points of the branch.
        ends: both ends.
        first, last: these in the unknowns of the second, with the derivatives there where the mesh is `moving`.
        row, length: sigma = row . (z - first.z) is the place along the stretch, from 0 to its length.
    """

    def __init__(self, solver: PointSolver, before: Point, after: Point) -> None:
        self.solver, self.ends, joined = solver, (before, after), solver.joined(before, after)
        self.first = replace(before, problem=joined.problem, z=joined.z, tangent=joined.tangent, better=None)
        self.last, self.row, self.moving = after, joined.row, joined.moving
        if self.moving is not None:
            self.last = replace(after, tangent=joined.end_tangent)
        self.length = float(self.row @ (after.z - joined.z))
        self._own = {id(self.first): (self.first, before), id(self.last): (self.last, after)}

    def metric(self, point: Point) -> Array:
        """Weights of the unknowns of a point."""
        return self.solver.metric(point.problem, point.z)

    def sigma(self, point: Point) -> float:
        """The place of a point along the stretch."""
        if self.moving is not None and id(point) not in self._own:
            point = self.seen(point)
        if self.moving is not None:
            return float(self.row @ (point.z - self.first.z))
        return float(self.row @ (point.problem.prolong(point.z, self.last.problem) - self.first.z))

    def own(self, point: Point) -> Point:
        """The point at which quantities are computed: the one on its own mesh."""
        return self._own.get(id(point), (point, point))[1]

    def on_branch(self, point: Point) -> Point:
        """The same where the mesh moves: points beside one on a mesh that is held are found from it as it is."""
        return point if self.moving is None else self.own(point)

    def seen(self, point: Point) -> Point:
        """A point of the branch in the unknowns of the stretch where the mesh moves, with the derivative there."""
        if self.moving is None:
            return point
        seen, problem = self.moving.seen(point, self.moving.nearest(point)), self.last.problem
        if seen is None:
            z, tangent = (point.problem.prolong(v, problem) for v in (point.z, point.tangent))
        else:
            problem, z, tangent = seen.problem, seen.z, seen.tangent
        there = replace(point, problem=problem, z=z, tangent=tangent)
        self._own[id(there)] = there, point
        return there


class Search(BranchStretch, ABC):
    """The search for events on one stretch.

    Attributes:
        real: whether values of samples count that are real, or all by their real parts.
        parts: the number of parts that the stretch has been divided into.
        gaps: those that are not resolved.
        deepest, most_parts: how often a part may be divided, and how many there may be.
        turn: period of the imaginary parts of exponents.
        root_xtol: of a stretch, of roots of quantities where no extended equations are solved.
    """

    deepest, most_parts, turn, root_xtol = DEEPEST_DIVISION, MOST_PARTS, np.inf, ROOT_XTOL

    def __init__(self, solver: PointSolver, before: Point, after: Point, real: bool = False) -> None:
        super().__init__(solver, before, after)
        self.real, self.parts, self.gaps = real, 0, list[Unresolved]()
        self._samples = dict[int, tuple[Point, Sample]]()

    def along(self, before: Point, after: Point, fraction: float) -> Point | None:
        """The point at a fraction of the way between two points; None where it is not found."""
        point = self.solver.unrefined_along(self.on_branch(before), self.on_branch(after), fraction)
        return None if point is None else self.seen(point)

    def sample(self, point: Point) -> Sample:
        """The sample at a point, computed once."""
        if id(point) not in self._samples:
            self._samples[id(point)] = point, self.sampled(point)
        return self._samples[id(point)][1]

    def sampled(self, point: Point) -> Sample:
        """The sample at a point: its quantities with their rates, and its exponents."""
        own = self.own(point)
        here = self.values(own)
        leading = tuple(zip(here.tolist(), self.rates(own, here).tolist(), strict=True))
        row = self.row if point is self.first else self.metric(point) * point.tangent
        still = CERTAIN_SIGN_NOISE * self.noise(own)
        return Sample(point, row, *self.exponents(own), leading=leading, turn=self.turn, still=still)

    def values(self, point: Point) -> Array:
        """Quantities beside the exponents, shape (quantities,)."""
        return np.empty(0)

    def rates(self, point: Point, here: Array) -> Array:
        """Their rates along the branch, by differences from those `here`."""
        if not here.size:
            return here
        ahead = beside_on_tangent(point, TANGENT_DIFFERENCE_STEP)
        return np.asarray((self.values(ahead) - here) / TANGENT_DIFFERENCE_STEP)

    def noise(self, point: Point) -> Array:
        """Errors of these, likewise."""
        return np.full(1, STILL_RATE / CERTAIN_SIGN_NOISE)

    def exponents(self, point: Point) -> tuple[ComplexArray, ComplexArray, Array]:
        """Eigenvalues or logarithms of multipliers, their rates along the branch, and noise."""
        return np.empty(0, dtype=complex), np.empty(0, dtype=complex), np.empty(0)

    def passes(self, ends: SampledStretch) -> bool:
        """Whether every quantity stays far from zero, by its values and rates at both ends."""
        if not (self.is_clear(ends.first.point) or self.is_clear(ends.last.point)):
            return False
        g, d = ends.quantities
        moves = np.abs(g[-1] - g[0]) + ends.length * (np.abs(d[0]) + np.abs(d[-1]))
        clear = (np.sign(g[0]) == np.sign(g[-1])) & (np.min(np.abs(g), axis=0) > CLEAR_DISTANCE * moves)
        return bool(np.all(clear | np.all(g == 0.0, axis=0)))

    @abstractmethod
    def found(self, stretch: SampledStretch, depth: int, last: bool) -> Sequence[Any] | None:
        """Events on a resolved part, in order; None where it has to be divided, unless it is the last."""

    def is_clear(self, point: Point) -> bool:
        """Whether every quantity has its sign at a point, where a stretch may be divided."""
        return True

    def suspected(self, stretch: SampledStretch) -> float | None:
        """The place at which a stretch is best divided; None where any will do."""
        return stretch.suspected_double_root()

    def given_up(self, stretch: SampledStretch) -> Sequence[Any]:
        """Events that are known of a part that can be divided no further; `gaps` gets its record."""
        return ()

    def quantity(self, stretch: SampledStretch, k: int) -> Callable[[Point], float]:
        """The real part of an eigenvalue or logarithm, by its place at the first end, as a function of a point."""
        first, last = stretch.first.values[k], stretch.last.values[stretch.order[k]]
        way, start = turned(last - first, stretch.first.turn), self.sigma(stretch.first.point)

        def value(point: Point) -> float:
            expected = first + (self.sigma(point) - start) / stretch.length * way
            values = self.sample(point).values
            return float(values[int(np.argmin(stretch.first.apart(np.array([expected]), values)))].real)

        return value

    def root_of(self, stretch: SampledStretch, test: Callable[[Point], float], noise: float, kind: str) -> Point | None:
        """The point of a stretch at which a test vanishes; at a branch point, where none is alone, the nearest one."""
        before, after = (self.on_branch(end.point) for end in (stretch.first, stretch.last))

        def along(*way: Any) -> Point | None:
            return self.solver.along(*way) or self.solver.coarse_along(*way)

        if not test(before) * test(after) < 0.0:
            return None
        try:
            zero, beside, _ = zero_between(self.solver, before, after, test, kind, self.root_xtol, along, nearest=True)
        except NotLocatedError:
            return None
        root = zero.point
        others = ((beside.point, beside.value), *((end, test(end)) for end in (before, after)))
        moved = np.array([abs(point.parameter - root.parameter) for point, _ in others])
        rates = np.array([abs(value - zero.value) for _, value in others]) / np.maximum(moved, 1e-300)
        off = (abs(zero.value) + noise) / max(np.min(rates), 1e-300) / root.problem.parameter_size(root.z)
        error = float(min(off, stretch.reach(root)) + root.error.relative(1.0))
        return root.marked(kind, error=replace(root.error, parameter=error))

    def on_stretch(self) -> list[Any]:
        """Events on the stretch in order; `gaps` are the parts that are not resolved."""
        return list(self.between(self.first, self.last))

    def between(self, before: Point, after: Point, depth: int = 0) -> Iterator[Any]:
        """The same between two points of it."""
        self.parts += 1
        if self.passes(SampledStretch.of((self.sample(before), self.sample(after)), self.real)):
            return
        tried = (self.along(before, after, place) for place in TRIED_PLACES)
        middle = next((point for point in tried if point is not None), None)
        points = (before, after) if middle is None else (before, middle, after)
        stretch = SampledStretch.of(tuple(self.sample(point) for point in points), self.real)
        last = depth >= self.deepest or self.parts > self.most_parts or stretch.length <= SHORTEST_PART
        found = self.found(stretch, depth, last or middle is None)
        if found is None and not last and middle is not None:
            divided = self._dividing(before, middle, after, self.suspected(stretch))
            if self.divides(before, divided, after):
                yield from self.between(before, divided, depth + 1)
                yield from self.between(divided, after, depth + 1)
                return
            found = self.found(stretch, depth, True)
        yield from self.given_up(stretch) if found is None else found

    def divides(self, before: Point, point: Point, after: Point) -> bool:
        """Whether a stretch may be divided at a point at which it is best divided."""
        return True

    def _dividing(self, before: Point, middle: Point, after: Point, suspected: float | None) -> Point:
        """The point at which a stretch is best divided."""
        for place in (suspected, SAMPLE_FRACTION, *TRIED_PLACES[1:]):
            point = None if place is None else middle if place == SAMPLE_FRACTION else self.along(before, after, place)
            if point is not None and _apart(before, point, after) and self.is_clear(point):
                return point
        return middle


def _apart(*points: Point) -> bool:
    """Whether neighbouring points are not the same but for rounding."""
    return all(float(np.max(np.abs(one.z - other.z))) > SHORTEST_PART for one, other in pairwise(points))


# Where a function of a point vanishes between two -------------------------------------------------------------------

TEST_ZERO_XTOL = 1e-11  # of a step, to which a zero of a test is found


def gap_between(space: Any, before: Point, after: Point, reason: str, kind: str = STABILITY) -> Unresolved:
    """The record of a stretch between two points of a branch on which something may be missing."""
    start, end = (space.value(space.parameter, point) for point in (before, after))
    return Unresolved(start, end, reason, kind, space.parameter)


class NotLocatedError(ArithmeticError):
    """A special point that the branch passes cannot be located; the message gives the reason."""


class BranchLocation(NamedTuple):
    """A point on the way between two, at a fraction of it, and the value of a test there."""

    fraction: float
    point: Point
    value: float


def zero_between(
    solver: PointSolver, before: Point, after: Point, test: Callable[[Point], float], kind: str,
    xtol: float = TEST_ZERO_XTOL, along: Callable[..., Point | None] | None = None, nearest: bool = False,
) -> tuple[BranchLocation, BranchLocation, float]:  # fmt: skip
    """The zero of a test that changes its sign between two points, the place beside it, and its size at both ends.

    Arguments:
        solver: of points of the branch.
        before, after: the ends.
        test: a function of a point.
        kind: of the point that is sought, for messages.
        xtol: error of the fraction.
        along: the point at a fraction of the way between two, or None; by default refined to the tolerance.
        nearest: whether the place with the smallest value is taken where points beside the zero are missing.

    Raises NotLocatedError.
    """
    from scipy.optimize import brentq

    known = {0.0: BranchLocation(0.0, before, test(before)), 1.0: BranchLocation(1.0, after, test(after))}
    start, end = (place.value for place in known.values())

    def value(fraction: float) -> float:
        if fraction not in known:
            point = (along or solver.along)(before, after, fraction)
            if point is None:
                why = solver.failure or "the equations are singular beside it"
                raise NotLocatedError(f"a point of kind {kind} cannot be located: {why}")
            known[fraction] = BranchLocation(fraction, point, test(point))
        return known[fraction].value

    try:
        root = float(brentq(value, 0.0, 1.0, xtol=xtol))
        value(root)
    except NotLocatedError:
        inner = [place for place in known.values() if 0.0 < place.fraction < 1.0]
        if not (nearest and inner):
            raise
        root = min(inner, key=lambda place: abs(place.value)).fraction
    zero, beside = sorted(known.values(), key=lambda place: abs(place.fraction - root))[:2]
    return zero, beside, max(abs(start), abs(end))


# Floquet exponents along a branch of orbits, as samples of the search for events (see `Search`) ----------

# Of the miss of the best prediction of a logarithm by up to three before, and of its changes, or of its distance from
# zero where that is less: a distance that needs no rates. Of 9384 crossings there and back within a few steps 8880 are
# found with these and the bounds of parts in `samples`; without a prediction by three 8856, with more sets of rates.
FAR_DISTANCE, FAR_MOVES, MOST_MOVES = 36.0, 0.5, 0.8
TANGENT_DIFFERENCE_STEP = (
    1e-5  # of the metric: of differences along the tangent; rates are wrong by some 1e-5, and by rounding / 1e-5
)


class ExponentSampler:
    """Samples at points of one branch, for one stretch between two of them.

    Attributes:
        space: of the points, with the multipliers at one and beside it on its tangent, without their errors: these take
            a fraction of the time.
        ends: both ends of it with their exponents: other points take the errors that are larger there.
        length: that of the stretch.
        past: the point before the stretch, likewise; None where none is known.
        count: how many exponents every point has: of large systems leading ones, not as many everywhere.
    """

    def __init__(
        self, space: Any, *ends: tuple[Point, Exponents], length: float = 1.0, before: ExponentSampler | None = None
    ) -> None:
        """`before` is the sampler of an earlier stretch: where that ends at the start of this one rates are known."""
        self.count = min((exponents.values.size for _, exponents in ends), default=0)
        ends = tuple((point, exponents.of_size(self.count)) for point, exponents in ends)
        self.space, self.ends, self.length, self.past = space, ends, length, None
        self._ahead = dict[int, tuple[Exponents, Exponents]]()
        logs = [exponents.values for _, exponents in ends] or [np.empty(0, dtype=complex)]  # of a curve none are known
        places, courses = np.zeros(1), logs[0].real[None]
        if before is not None and before.ends[-1][0] is ends[0][0]:
            self.past, self._ahead = before.ends[0], before._ahead
            if before.count == self.count:
                places, courses = before._places[-3:] - before.length, before._courses[-3:]
        order = nearest_order(logs[-1], logs[0])
        self._places: Array = np.append(places, length)
        self._courses: Array = np.vstack([courses[:, order], logs[-1].real])
        known = ends if self.past is None else (self.past, *ends)
        self._known = {id(point): (point, exponents) for point, exponents in known}
        of_size = {place: found for place, found in self._ahead.items() if found[0].values.size == self.count}
        self._ahead = {place: found for place, found in of_size.items() if place in self._known}

    def is_far(self) -> bool:
        """Whether multipliers stay away from the circle, by their changes since points before, without any rates."""
        first, last = (exponents for _, exponents in self.ends)
        if len(self._places) < 3 or last.outside[1] or first.beyond != last.beyond:
            return False
        places, courses, length = self._places, self._courses, self.length
        slopes = np.diff(courses, axis=0) / np.diff(places)[:, None]
        was, here, then = courses[-3:]
        ahead, back = length * slopes[-1], length * slopes[-2]
        with np.errstate(all="ignore"):  # where it has passed zero it has not grown
            grown = here * (here / was) ** (length / (places[-2] - places[-3]))
        missed = np.fmin(np.abs(ahead - back), np.abs(then - grown))
        if len(places) > 3:  # by a parabola
            bend = (slopes[-2] - slopes[-3]) / (places[-2] - places[-4])
            missed = np.fmin(missed, np.abs(ahead - back - bend * length * (places[-1] - places[-3])))
        dip = 0.25 * length * np.abs(ahead - back) / (places[-1] - places[-3])  # on the stretch, of a parabola
        near = np.minimum(np.abs(here), np.abs(then)) - dip
        moves = np.minimum(FAR_MOVES * (np.abs(ahead) + np.abs(back)), MOST_MOVES * near)
        return bool(np.all((here * then > 0.0) & (near > FAR_DISTANCE * missed + moves)))

    def here(self, point: Point) -> Exponents:
        """Exponents at a point."""
        if id(point) not in self._known:
            self._known[id(point)] = point, self._alone(point)
        return self._known[id(point)][1]

    def exponents(self, point: Point) -> tuple[Exponents, Exponents]:
        """The same, and those one step along its tangent in the same order."""
        if id(point) not in self._ahead:
            here, ahead = self.here(point), self.space.multipliers_ahead(point).exponents.of_size(self.count).values
            self._ahead[id(point)] = here, Exponents(ahead[nearest_order(here.values, ahead)], here.noise)
        return self._ahead[id(point)]

    def _alone(self, point: Point) -> Exponents:
        """Exponents with the errors of the nearest ones at the ends."""
        values = self.space.multipliers_alone(point).exponents.of_size(self.count).values
        noise = [end.noise[nearest_order(values, end.values)] for _, end in self.ends]
        return Exponents(values, np.max(noise, axis=0))

    def free(self, point: Point) -> tuple[ComplexArray, ComplexArray, Array]:
        """The logarithms of multipliers that move freely, with rates and noise."""
        here, ahead = self.exponents(point)
        return here.values, turned(ahead.values - here.values) / TANGENT_DIFFERENCE_STEP, here.noise

    def paired(self, point: Point, passed: float) -> tuple[ComplexArray, ComplexArray, Array]:
        """The same of multipliers in pairs that may pass `passed`, 1 or -1."""
        here, ahead = self.exponents(point)
        pairs = here.pairs
        assert pairs is not None
        (tau, noise), (moved, _) = here.traces(pairs), ahead.traces(pairs)
        away = tau - 2.0 * passed
        scale = np.sqrt(1.0 + away**2)
        values = np.asarray(np.arcsinh(away), dtype=complex)
        return values, (moved - tau) / TANGENT_DIFFERENCE_STEP / scale, noise / np.abs(scale)


def beside_on_tangent(point: Point, step: float) -> Point:
    """The point a step along the tangent, not corrected."""
    problem, z = beside(point.problem, point.z, point.tangent, step)
    return replace(point, problem=problem, z=z, better=None)


def nearest_order(first: ComplexArray, last: ComplexArray) -> Indices:
    """For each logarithm its place among others: the assignment with the smallest changes."""
    return assignment(np.abs(turned(first[:, None] - last)))


# Monitors: real quantities of users whose zeros are events ------------------------------------------------------------


Reading: TypeAlias = tuple[float, Array, Sequence[float]]  # time, state and parameters of the model


@dataclass(frozen=True, eq=False)
class Monitor:
    """A real quantity along a branch, as `function` (t, x, p) of a state and parameters; its zeros are named `name`.

    The state is that of an equilibrium, of an orbit at phase zero, of another solution at its start.
    """

    name: str
    function: ca.Function

    def value(self, reading: Reading) -> float:
        """The quantity at a point, by what is read there."""
        return float(self.function(*reading))

    @cached_property
    def _slopes(self) -> ca.Function:
        t, x, p = self.function.mx_in()
        value = self.function(t, x, p)
        return ca.Function("slopes", [t, x, p], [ca.gradient(value, x), ca.gradient(value, p)])

    def error(self, reading: Reading, profile: float, to: float) -> float:
        """The error of the value by that of the state, `profile`, and by rounding of the largest state and parameter.

        That of larger terms, as in 1e6 + x - 1e6, shows in the fourth differences of values at states beside this one
        (Hamming 1962; More and Wild 2011), which are up to 16 times as large, the largest rarely less than 4.
        """
        t, x, p = reading
        by_x, by_p = (np.abs(np.array(slopes)).ravel() for slopes in self._slopes(t, x, p))
        largest, x = np.max(np.abs(p), initial=abs(to)), np.asarray(x, dtype=float).ravel()
        rounding = np.sum(by_x) * np.max(np.abs(x)) + np.sum(by_p) * largest
        beside = np.array(self.function(t, np.outer(x, 1.0 + STEPS_BESIDE_STATE), p)).ravel()
        of_terms = np.max(np.abs(np.diff(beside, 4))) / 4.0
        return float(by_x @ np.abs(x) * max(profile, EPSILON) + rounding * EPSILON + of_terms)


STEPS_BESIDE_STATE = 6.18e-6 * np.arange(-7.5, 8.5)  # of a state: fourth differences of smooth values are some 1e-21


class MonitorSearch(Search):
    """The search for zeros of real quantities; one at a point itself belongs to the stretch before it.

    Attributes:
        space: of the points.
        names: of the quantities, one each.
    """

    def __init__(
        self, space: Any, before: Point, after: Point, names: Sequence[str], values: Callable[[Point], Array],
        noise: Callable[[Point], Array] | None = None,
    ) -> None:  # fmt: skip
        """`values` and their errors `noise` are functions of a point, of shape (quantities,)."""
        super().__init__(space.point_solver, before, after)
        self.space, self.names, self._values = space, names, values
        self._noise = noise or (lambda point: np.full(len(names), STILL_RATE / CERTAIN_SIGN_NOISE))

    def values(self, point: Point) -> Array:
        return self._values(point)

    def noise(self, point: Point) -> Array:
        return self._noise(point)

    def _certain(self, point: Point) -> NDArray[np.bool_]:
        """Which quantities have a sign of their own at a point."""
        own = self.own(point)
        return np.asarray(np.abs(self.values(own)) > CERTAIN_SIGN_NOISE * self.noise(own))

    def is_clear(self, point: Point) -> bool:
        return bool(np.all(self._certain(point)))

    def divides(self, before: Point, point: Point, after: Point) -> bool:
        """Not where rounding decides the sign of a quantity that changes it, but for one that is rounding alone."""
        first, last, inner = (self._certain(one) for one in (before, after, point))
        changes = np.sign(self.values(self.own(before))) != np.sign(self.values(self.own(after)))
        return bool(np.all(inner | ~(changes & (first | last))))

    def found(self, stretch: SampledStretch, depth: int, last: bool) -> Sequence[Point] | None:
        if not (last or np.all(stretch.isolates_roots)):
            return None
        (first, *_, g), end, events = stretch.quantities[0], self.own(stretch.last.point), list[Point]()
        for k in np.flatnonzero((np.sign(first) != np.sign(g)) & (first != 0.0)).tolist():
            test = partial(self._value, k)
            noise = max(float(self.noise(one)[k]) for one in (self.own(stretch.first.point), end))
            event = end if g[k] == 0.0 else self.root_of(stretch, test, noise, self.names[k])
            if event is None:
                return None
            simple = min(noise / abs(first[k]), 1.0) if event is end else 0.0  # of the stretch, as where it is settled
            least = stretch.reach(event) * (simple if stretch.isolates_roots[k] else 1.0)
            error = replace(event.error, parameter=max(event.error.parameter, least))
            events.append(event.marked(self.names[k], error=error))
        return sorted(events, key=self.sigma)

    def _value(self, k: int, point: Point) -> float:
        return float(self.values(point)[k])

    def given_up(self, stretch: SampledStretch) -> Sequence[Point]:
        ends, kinds = (stretch.first.point, stretch.last.point), " or ".join(dict.fromkeys(self.names))
        self.gaps.append(gap_between(self.space, *ends, "the quantity jumps, or is not resolved", kinds))
        return ()


def monitored(space: Any, before: Point, after: Point, gaps: list[Unresolved]) -> list[Point]:
    """Zeros of the monitors of a space between two points of a branch in order; `gaps` gets parts not resolved."""
    monitors = space.monitors
    if not monitors:
        return []
    names, known = [one.name for one in monitors], (space.monitor_values, space.monitor_errors)
    search = MonitorSearch(space, before, after, names, *known)
    found = search.on_stretch()
    gaps += search.gaps
    return found


class MonitorAccount:
    """The account of monitors along one branch: each has, where its error leaves no doubt, the sign that zeros make.

    A zero may lie on stretches on which a monitor is less than its error throughout.
    """

    def __init__(self, space: Any) -> None:
        self.space = space
        self._signs = dict[str, float]()
        self._since = dict[str, list[float]]()  # of each monitor, values of the parameter since it was last certain

    def passed(self, points: Iterable[Point], named: Sequence[Unresolved] = ()) -> Iterator[Unresolved]:
        """Stretches up to points in order that no zero accounts for, but for those that are `named`."""
        for point, (k, one) in product(points, enumerate(self.space.monitors)):
            name, here = one.name, self.space.value(self.space.parameter, point)
            value, noise = (of(point)[k] for of in (self.space.monitor_values, self.space.monitor_errors))
            since = self._since.setdefault(name, [])
            since.append(here)
            if point.special == name and name in self._signs:
                self._signs[name] *= -1.0
            elif abs(value) > CERTAIN_SIGN_NOISE * noise:
                sign = float(np.sign(value))
                if self._signs.get(name, sign) != sign and not any(name in gap.kind for gap in named):
                    turn = max(since, key=lambda u: abs(u - 0.5 * (since[0] + here)))
                    words = "the quantity changes its sign where it is no larger than its error"
                    words += "" if turn in (since[0], here) else f", by way of {turn:.8g}"
                    yield Unresolved(since[0], here, words, name, self.space.parameter)
                self._signs[name], self._since[name] = sign, [here]
