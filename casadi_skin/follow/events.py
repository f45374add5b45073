"""Events of a branch of orbits: where multipliers cross the unit circle, with the account of their number outside.

Between two orbits of a branch the multipliers are samples of `ExponentSampler`; the stretch is divided until each
quantity has no root on it, or one simple root within the bounds of its errors (see `SampledStretch`). The orbit
at a root is the solution of the extended equations of its kind, or, where there are none, the root of the quantity.
The events account for the change in the number n_u of multipliers outside the circle,

    n_u(after) = n_u(before) + sum of the jumps of all events between,

and for whether the numbers of real multipliers above 1 and below -1 are even: folds and branch points change the one,
doublings the other, and nothing else, as complex multipliers come in twos. Changes of stability are the events at which
n_u becomes 0 or leaves it. A stretch on which the account does not balance, or that cannot be divided until it is
resolved, is named.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.normal_forms import critical_angle
from casadi_skin.follow.point import ALIGNED_COSINE
from casadi_skin.follow.samples import Crossing, Sample, SampledStretch, assignment
from casadi_skin.follow.search import BranchStretch, ExponentSampler, NotLocatedError, Search, gap_between
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import has_value, precedes, snapped, target_of
from casadi_skin.follow.special_points import STILL_RATE, rate, special_orbit
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.solve.watch import TimeLimitError
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import FULL_TURN, Exponents, turned
from casadi_skin.zero.kinds import BRANCH_POINT, CROSSING_KINDS, DOUBLING, FOLD, KREIN, TORUS, Unresolved
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point

if TYPE_CHECKING:
    from scipy.interpolate import BPoly

OUTSIDE_STRETCH = 1e-3  # of a stretch: a special orbit farther out is another one
SAME_EVENT = 1e-8  # of a stretch: events of one kind that near are one, of multipliers that a symmetry keeps together
ASIDE_FRACTIONS = (0.0, 0.03, 0.2)  # of a stretch, from a root: at a branch point itself no orbit is found
CRITICAL_LOG_MODULUS = 1e-4  # log |multiplier| of one that is on the unit circle at a requested value
SAME_MEETING = 1e-3  # of a stretch between two orbits: meetings of two pairs that near are looked at once
PLACES_NEAR_MEETING = 3  # places near a meeting at which it is looked whether the pairs have left the circle
KREIN_DEPTH = 3  # divisions before a collision is located by its discriminant


class Event(NamedTuple):
    """An orbit at which multipliers cross the unit circle, its place on a stretch, and by how many n_u grows there."""

    place: float
    solution: Solution
    kind: str
    angle: float
    jump: int


def at_requested_value(solution: Solution) -> Solution:
    """A solution at a requested value; where one of its multipliers crosses there, the special orbit in its place."""
    space, point = solution.space, solution.point
    if not space.has_ledger or point.walked or point.special or not solution.floquet().others.size:
        return solution
    others = solution.floquet().others
    nearest = complex(others[np.argmin(np.abs(solution.floquet().exponents.values.real))])
    if abs(np.log(abs(nearest))) > CRITICAL_LOG_MODULUS:
        return solution
    kind = CROSSING_KINDS[2 if nearest.imag else int(nearest.real < 0.0)]
    found = special_orbit(cast(BoundarySpace, space), kind, point, abs(float(np.angle(nearest))))
    target = None if found is None else target_of(space, found)
    if found is None or target is None or target.value != point.parameter:
        return solution
    there = replace(snapped(found, target, requested=True), along=point.along)
    critical: Solution = space.solution(there, space.floquets([there])[0])
    return critical


def events_between(space: BoundarySpace, sampler: ExponentSampler) -> tuple[list[Event], list[Unresolved]]:
    """Events between the ends of a sampler, neither of them special, in order, and stretches not resolved."""
    first, last = (exponents for _, exponents in sampler.ends)
    events, gaps = list[Event](), list[Unresolved]()
    if not first.values.size or sampler.is_far():
        return events, gaps
    kind = _Free if first.pairs is None or last.pairs is None else _Paired
    search = kind(space, sampler)
    for one in sorted(search.on_stretch(), key=lambda event: event.place):
        if events and _is_same(one, events[-1]):
            events[-1] = events[-1]._replace(jump=events[-1].jump + one.jump)
        else:
            events.append(one)
    for gap in search.gaps:
        if gaps and gaps[-1].end == gap.start:
            gaps[-1] = replace(gaps[-1], end=gap.end)
        else:
            gaps.append(gap)
    return events, gaps


def accounted(first: Exponents, last: Exponents, events: Sequence[Event | Crossing]) -> bool:
    """Whether events account for changes of the signs of det(M - 1) and det(M + 1), of multipliers that move freely."""
    if first.beyond is None or last.beyond is None or first.pairs is not None or last.pairs is not None:
        return True
    for kinds, before, after in zip(((FOLD, BRANCH_POINT), (DOUBLING,)), first.beyond, last.beyond, strict=True):
        jumps = sum(event.jump for event in events if event.kind in kinds)
        if before is not None and after is not None and (after - before - jumps) % 2:
            return False
    return True


def _agree(special: Solution, beside: Solution) -> bool:
    """Whether det(M - 1) and det(M + 1) have the signs that they have at a special orbit, but for the one that is 0."""
    signs = STEADY_SIGNS.get(special.point.special)
    one, other = (orbit.floquet().exponents for orbit in (special, beside))
    if signs is None or one.pairs is not None or other.pairs is not None:
        return True
    if one.beyond is None or other.beyond is None:
        return False
    return all(None in (one.beyond[k], other.beyond[k]) or one.beyond[k] == other.beyond[k] for k in signs)


def _is_same(one: Event, other: Event) -> bool:
    return one.kind == other.kind != KREIN and abs(one.place - other.place) <= SAME_EVENT and one.angle == other.angle


class _OrbitSearch(Search):
    """The search on one stretch between two orbits; where one was sought errors of multipliers have it `hidden`."""

    hidden = False

    def __init__(self, space: BoundarySpace, sampler: ExponentSampler) -> None:
        (before, _), (after, _) = sampler.ends
        super().__init__(space.point_solver, before, after)
        self.space, self.sampler = space, sampler

    def outside(self, point: Point) -> tuple[int, int]:
        """The number of multipliers outside the circle at a point, and how many errors leave open."""
        return self.sampler.here(self.own(point)).outside

    def is_clear(self, point: Point) -> bool:
        return self.outside(point)[1] <= min(self.outside(end)[1] for end in (self.first, self.last))

    @cached_property
    def past(self) -> Point | None:
        """The point before the stretch in the unknowns of this, where the branch goes on without a sharp turn."""
        if self.sampler.past is None:
            return None
        (past, exponents), (_, others) = self.sampler.past, self.sampler.ends[0]
        if exponents.values.size != others.values.size or (exponents.pairs is None) != (others.pairs is None):
            return None
        if self.moving is not None:
            there = self.seen(past)
            return there if there is not past and self.sigma(there) < 0.0 else None
        joined = self.solver.joined(past, self.last)
        if joined.moving is not None:
            return None
        there = replace(past, problem=self.last.problem, z=joined.z, tangent=joined.tangent, better=None)
        aligned = min(self.row @ joined.tangent, joined.row @ self.last.tangent) > ALIGNED_COSINE
        if not aligned or self.sigma(there) >= 0.0:
            return None
        self._own[id(there)] = there, past
        return there

    def passes(self, stretch: SampledStretch) -> bool:
        clear = any(self.is_clear(end.point) for end in (stretch.first, stretch.last)) and self.balanced(stretch, ())
        if clear and self.past is not None and stretch.first.point is self.first:
            three = SampledStretch.of((self.sample(self.past), *stretch.samples), self.real)
            clear = three.keeps_signs(1)
        elif clear:
            clear = super().passes(stretch)
        return clear and self.meeting(stretch) is None

    def balanced(self, stretch: SampledStretch, passages: Sequence[Crossing]) -> bool:
        """Whether passages account for the change in the numbers of multipliers outside the circle."""
        first, last = (self.sampler.here(self.own(end.point)) for end in (stretch.first, stretch.last))
        (start, open_at_start), (end, open_at_end) = first.outside, last.outside
        missing = end - start - sum(passage.jump for passage in passages)
        return abs(missing) <= min(open_at_start, open_at_end) and accounted(first, last, passages)

    def found(self, stretch: SampledStretch, depth: int, last: bool) -> Sequence[Event] | None:
        if not any(self.is_clear(sample.point) for sample in stretch.samples):
            return self.given_up(stretch)
        if not np.all(stretch.isolates_roots):
            return None
        passages = list(self.passages(stretch))
        if not self.balanced(stretch, passages):
            return self.collision(stretch, passages) if depth >= KREIN_DEPTH else None
        if not last and self.meeting(stretch) is not None:
            return None
        located = (self.located(stretch, passage) for passage in passages)
        known: list[Event] = sorted((event for event in located if event is not None), key=lambda event: event.place)
        if self.hidden and len(known) < len(passages):
            return [*known, *self.given_up(stretch)]
        twice = any(_is_same(one, other) and one.jump != other.jump for one, other in pairwise(known))
        return None if twice or len(known) < len(passages) else known

    def suspected(self, stretch: SampledStretch) -> float | None:
        return self.meeting(stretch) or super().suspected(stretch)

    def meeting(self, stretch: SampledStretch) -> float | None:
        """A place at which two pairs that pass one another on the circle have left it; None where none have."""
        return None

    def passages(self, stretch: SampledStretch) -> Iterator[Crossing]:
        """Quantities that change their sign on a stretch that is resolved."""
        raise NotImplementedError

    def collision(self, stretch: SampledStretch, passages: Sequence[Crossing]) -> Sequence[Event] | None:
        """The event that is none of a single quantity; None where there is none."""
        return None

    def given_up(self, stretch: SampledStretch) -> Sequence[Event]:
        ends = stretch.first.point, stretch.last.point
        (before, _), (after, unclear) = map(self.outside, ends)
        words = f"from {before} to {after} multipliers outside the unit circle"
        why = f"; {unclear} on it within their errors" if unclear else ""
        self.gaps.append(gap_between(self.space, *ends, words + why))
        return ()

    # Locating ---------------------------------------------------------------------------------------------------------

    def located(self, stretch: SampledStretch, passage: Crossing) -> Event | None:
        """The orbit at a passage."""
        extended = self.space.periodic is None or self.space.symmetry.value == 1.0
        if extended and passage.kind != FOLD:  # of one where the rate of the parameter is rounding they do not converge
            root = stretch.root(stretch.leading + passage.quantity) / stretch.length
            for aside in ASIDE_FRACTIONS:
                fraction = root + (aside if root < 0.5 else -aside)
                before, after = (self.on_branch(end.point) for end in (stretch.first, stretch.last))
                near = self.solver.along(before, after, fraction)
                if near is None:  # beside a branch point rounding decides; the extended equations are regular there
                    near = self.solver.guess_along(before, after, fraction)
                angle = self._angle_at(near, passage)
                event = self.event(stretch, special_orbit(self.space, passage.kind, near, angle), passage)
                if event is not None:
                    return event
        k = passage.quantity  # without extended equations the root of the quantity itself
        noise = max(stretch.first.noise[k], stretch.last.noise[stretch.order[k]])
        return self.event(
            stretch, self.root_of(stretch, self.quantity(stretch, k), float(noise), passage.kind), passage
        )

    def _angle_at(self, near: Point, passage: Crossing) -> float:
        """That of the multipliers that pass, at an orbit near the passage: between two orbits a pair may turn far."""
        if passage.kind != TORUS:
            return passage.angle
        values = self.sampler.here(near).values
        found = abs(float(values[np.argmin(np.abs(turned(values - 1j * passage.angle)))].imag))
        return found if 0.0 < found < np.pi else passage.angle

    def event(self, stretch: SampledStretch, point: Point | None, passage: Crossing) -> Event | None:
        """A special point as the event of a passage; None where it is outside the part of the stretch."""
        if point is None:
            return None
        if passage.kind == TORUS and point.angle is None:
            point = replace(point, angle=passage.angle)
        low, high, at = (self.sigma(one) for one in (stretch.first.point, stretch.last.point, point))
        if not abs(at - 0.5 * (low + high)) <= (0.5 + OUTSIDE_STRETCH) * (high - low):
            return None
        solution = self.space.solution(point, self.space.floquets([point])[0])
        return Event(at / self.length, solution, passage.kind, passage.angle, passage.jump)


class _Free(_OrbitSearch):
    """Multipliers that move freely: each crosses the circle by itself, or with its complex conjugate."""

    turn = FULL_TURN

    def exponents(self, point: Point) -> tuple[ComplexArray, ComplexArray, Array]:
        return self.sampler.free(point)

    def event(self, stretch: SampledStretch, point: Point | None, passage: Crossing) -> Event | None:
        """As above; none where errors of multipliers are as large as these: parts of the stretch have none either."""
        event = super().event(stretch, point, passage)
        self.hidden = event is not None and event.solution.floquet().exponents.beyond is None
        return None if self.hidden else event

    def passages(self, stretch: SampledStretch) -> Iterator[Crossing]:
        found = list(stretch.crossings(CROSSING_KINDS))
        turns = sum(one.kind == BRANCH_POINT for one in found) == 1 and self._turns(stretch)
        yield from (one._replace(kind=FOLD) if turns and one.kind == BRANCH_POINT else one for one in found)

    def _turns(self, stretch: SampledStretch) -> bool:
        """Whether the one multiplier that passes 1 does so at a fold where the rate of the parameter is rounding.

        There det F_x changes its sign, that of the rate times that of det [F_x F_p; row]: at a branch point the
        latter changes. On a part of the orbit that a symmetry continues neither shows what breaks the symmetry.
        """
        ends = [sample.point for sample in (stretch.first, stretch.last)]
        still = max(abs(rate(end)) for end in ends) <= STILL_RATE
        if not still or (self.space.periodic is not None and self.space.symmetry.value != 1.0):
            return False
        solver = self.solver.levels.solver(self.last.problem)
        rows = [self.metric(end) * end.tangent if self.moving is None else self.row for end in ends]
        one, other = (
            solver.orientation(end.problem.evaluate(end.z)[1], row) for end, row in zip(ends, rows, strict=True)
        )
        return one * other > 0.0


class _Paired(_OrbitSearch):
    """Multipliers in pairs mu, 1/mu: pairs leave the circle through 1 and -1, or two of them where they collide."""

    def __init__(self, space: BoundarySpace, sampler: ExponentSampler) -> None:
        super().__init__(space, sampler)
        self.real, self._tried = True, list[float]()
        # The multipliers of an orbit that is odd are squares, which touch -1 and do not pass it.
        odd = space.periodic is not None and space.symmetry is SymmetryClass.QUARTER
        self.passed = (1.0,) if odd else (1.0, -1.0)

    def exponents(self, point: Point) -> tuple[ComplexArray, ComplexArray, Array]:
        values, rates, noise = zip(*(self.sampler.paired(point, passed) for passed in self.passed), strict=True)
        return np.concatenate(values), np.concatenate(rates), np.concatenate(noise)

    def sampled(self, point: Point) -> Sample:
        found, many = super().sampled(point), len(self.passed)
        return replace(found, groups=np.repeat(np.arange(many), found.values.size // many))

    def meeting(self, stretch: SampledStretch) -> float | None:
        from scipy.interpolate import BPoly

        half, length = stretch.first.values.size // len(self.passed), stretch.length
        ends = (stretch.first, stretch.last)
        tau = np.array([2.0 + np.sinh(sample.values[:half]) for sample in ends])
        rates = np.array([sample.along(self.row)[0] * sample.rates[:half] for sample in ends]) * length
        rates = (rates * np.sqrt(1.0 + (tau - 2.0) ** 2)).real
        expected, back = tau[0] + 0.5 * rates[0], tau[1] - 0.5 * rates[1]  # those that meet go on as their rates say
        order = assignment(np.abs(expected[:, None] - back))
        tau[1], rates[1] = tau[1, order], rates[1, order]
        on_circle = np.flatnonzero(np.all((tau.imag == 0.0) & (np.abs(tau.real) < 2.0), axis=0))
        for n, k in enumerate(on_circle):
            for m in on_circle[:n]:
                gap, slope = (tau[:, k] - tau[:, m]).real, rates[:, k] - rates[:, m]
                if gap[0] * gap[1] < 0.0:
                    place = self._left_at(stretch, BPoly.from_derivatives([0.0, 1.0], np.column_stack([gap, slope])))
                    if place is not None:
                        return place
        return None

    def _left_at(self, stretch: SampledStretch, gap: BPoly) -> float | None:
        """The place near the root of a gap between two traces at which they are a complex pair; None where none is."""
        from scipy.optimize import brentq

        root = float(brentq(lambda place: float(gap(place)), 0.0, 1.0))
        sigma = self.sigma(stretch.first.point) + root * stretch.length
        if any(abs(sigma - known) <= SAME_MEETING * self.length for known in self._tried):
            return None
        self._tried.append(sigma)
        centre, expected = None, max(self.outside(end.point)[0] for end in (stretch.first, stretch.last))
        for _ in range(PLACES_NEAR_MEETING):
            point = self.along(stretch.first.point, stretch.last.point, root)
            if point is None:
                return None
            if self.outside(point)[0] > expected:
                self._tried.pop()
                return root
            tau = np.sort(self.traces(point).real)
            centre = tau[int(np.argmin(np.diff(tau)))] if centre is None else centre
            near = int(np.argmin(np.abs(tau[:-1] - centre) + np.diff(tau)))
            off = float(np.diff(tau)[near] / abs(gap.derivative()(root)))
            root = float(np.clip(root + (off if gap(min(root + off, 1.0)) * gap(root) <= 0.0 else -off), 0.0, 1.0))
        return None

    def passages(self, stretch: SampledStretch) -> Iterator[Crossing]:
        g, groups = stretch.quantities[0], stretch.first.groups
        assert groups is not None
        for k in np.flatnonzero(stretch.changed):
            passed = self.passed[groups[k]]
            jump = 1 if (g[-1, k] > 0.0) == (passed > 0.0) else -1
            kind = CROSSING_KINDS[int(passed < 0.0)]
            yield Crossing(int(k), kind, critical_angle(kind), jump)

    def traces(self, point: Point) -> ComplexArray:
        here = self.sampler.here(self.own(point))
        pairs = here.pairs
        return np.empty(0, complex) if pairs is None else np.asarray(here.traces(pairs)[0], dtype=complex)

    def collision(self, stretch: SampledStretch, passages: Sequence[Crossing]) -> Sequence[Event] | None:
        """A Krein collision: two pairs leave the circle where they meet, or come back: a root of (tau_k - tau_l)^2."""
        before, after = (self.traces(end.point) for end in (stretch.first, stretch.last))
        off = [np.flatnonzero(tau.imag > 0.0) for tau in (before, after)]
        if passages or abs(off[1].size - off[0].size) != 1:
            return None
        leaves = off[1].size > off[0].size
        there, here = (after, before) if leaves else (before, after)
        alone = off[int(leaves)]
        if alone.size > 1:  # the one that has no partner at the other end
            others = here[off[1 - int(leaves)]]
            apart = np.abs(there[alone][:, None] - others)
            alone = alone[[int(np.argmax(np.min(apart, axis=1)))]] if others.size else alone[:1]
        centre = float(there[alone[0]].real)
        near = np.sort(here.real[np.argsort(np.abs(here - centre))[:2]])
        other_centre = float(np.mean(near))

        def discriminant(point: Point) -> float:
            fraction = (self.sigma(point) - self.sigma(stretch.first.point)) / stretch.length
            share = fraction if leaves else 1.0 - fraction
            tau = self.traces(point)
            if tau.size < 2:
                raise NotLocatedError("the multipliers of an orbit are in no pairs")
            two = tau[np.argsort(np.abs(tau - (other_centre + share * (centre - other_centre))))[:2]]
            return float(((two[0] - two[1]) ** 2).real)

        noise = max(float(np.max(s.noise)) for s in (stretch.first, stretch.last)) ** 2
        angle = float(np.arccos(np.clip(0.5 * centre, -1.0, 1.0)))
        point = self.root_of(stretch, discriminant, noise, KREIN)
        event = self.event(stretch, point, Crossing(0, KREIN, angle, 2 if leaves else -2))
        return None if event is None else [event]


# The account of a branch of orbits: its events in order, and the changes of stability that follow from them -----------

SURE_SIDE = 3.0  # errors by which a multiplier has a side beside a special orbit
# Of the way from a special orbit to the next one: where its own multiplier has a side.
BESIDE_SPECIAL = 1e-2, 0.1, 0.3
NEARER_SPECIAL = 10.0 ** -np.arange(3.0, 9.0)  # of the way: where something else is nearer to a special orbit
# Of the signs of det(M - 1) and det(M + 1): those that do not change at a special orbit.
STEADY_SIGNS = {FOLD: (1,), BRANCH_POINT: (1,), DOUBLING: (0,), TORUS: (0, 1)}


@dataclass(frozen=True)
class StabilityChange:
    """A change of stability between two solutions of a branch that is no family (see `StabilityEdge`).

    Attributes:
        value: of the quantity that the branch is followed in.
        Omega: frequency there; of a boundary-value problem 2 pi over the length of its interval.
        kind: that of the instability on the unstable side, "real" or "complex".
        stable_before, stable_after: in the order of the branch.
        angle: of the multiplier that crosses the unit circle, in [0, pi]: pi where a period doubles.
        error: estimated error of `value`.
    """

    value: float
    Omega: float
    kind: str
    stable_before: bool
    stable_after: bool
    angle: float
    error: float


class Ledger:
    """The account of one branch, which is kept as its solutions come in order.

    Attributes:
        changes: changes of stability.
        unresolved: stretches on which the account does not balance.
    """

    def __init__(self, space: BoundarySpace) -> None:
        self.space = space
        self.changes: list[StabilityChange] = []
        self.unresolved: list[Unresolved] = []
        self._sampler: ExponentSampler | None = None  # of the last stretch
        self._count: int | None = None  # n_u behind the last solution; None where it is not known

    def between(self, before: Solution, after: Solution, starts: bool = False) -> Iterator[Solution]:
        """Special orbits between two solutions in order; their changes of stability are entered.

        Arguments:
            before, after: neighbours on the branch, which may be special orbits themselves.
            starts: whether the branch starts at the first of them, which it leaves where that is a special point.
        """
        try:
            yield from self._between(before, after, starts)
        except TimeLimitError as error:
            self._count = None
            self._name(before, after, str(error))

    def _between(self, before: Solution, after: Solution, starts: bool) -> Iterator[Solution]:
        """The same; raises TimeLimitError.

        Where rounding decides on which side the start of the branch is of a special orbit, from an orbit behind it.
        """
        leaving = starts and self.space.leaves
        special, ends_special = (self.space.is_critical(one.point.special) for one in (before, after))
        unclear = starts and not (special or leaving) and before.floquet().exponents.outside[1] > 0
        first = self._beside(before, after, BESIDE_SPECIAL) if special or leaving else before
        if unclear:
            first = self._beside(before, after, [-one for one in BESIDE_SPECIAL]) or before
        last = self._beside(before, after, [1.0 - one for one in BESIDE_SPECIAL]) if ends_special else after
        if first is None or last is None:
            self._count = None
            self._name(before, after, f"no orbit is found beside the special one: {self.space.point_solver.failure}")
            return
        orbits = [first, last]
        if special and not leaving:
            orbits[:1] = reversed(self._nearer(before, first, lambda part: (before.point, after.point, part)))
        if ends_special:
            orbits[-1:] = self._nearer(after, last, lambda part: (before.point, after.point, 1.0 - part))
        start, _ = orbits[0].floquet().exponents.outside
        if special and not leaving and self._count is not None:
            self._passed(before, self._count, start, critical_angle(before.point.special, before))
        self._count = start
        known = [one for one, is_special in ((before, special), (after, ends_special)) if is_special]
        for one, other in pairwise(orbits):
            yield from self._events(one, other, self._count, before if unclear else None, known)

    def _events(
        self, first: Solution, last: Solution, count: int, start: Solution | None, known: Sequence[Solution]
    ) -> Iterator[Solution]:
        """Special orbits between two that are none, behind the first of which so many multipliers are outside.

        Those before the start of the branch, where that is given, are left out, and known ones that are found again as
        errors hide the side of a multiplier beside them.
        """
        ends = [(end.point, end.floquet().exponents) for end in (first, last)]
        length = self.space.point_solver.length(first.point, last.point)
        self._sampler = ExponentSampler(self.space, *ends, length=length, before=self._sampler)
        events, gaps = events_between(self.space, self._sampler)
        self.unresolved += gaps
        stretch = None if start is None else BranchStretch(self.space.point_solver, start.point, last.point)
        hidden = 0
        for event in events:
            if any(event.kind == one.point.special and self._meets(event.solution, one) for one in known):
                hidden += event.jump
                continue
            count += event.jump
            if stretch is not None and precedes(self.space, stretch, event.solution.point):
                continue
            self._passed(event.solution, count - event.jump, count, event.angle)
            if event.kind != KREIN:
                yield event.solution
        (_, one), (_, other) = ends
        (_, open_at_start), (end, open_at_end) = one.outside, other.outside
        if not gaps and abs(end - hidden - count) > min(open_at_start, open_at_end):
            words = f"{end} multipliers are outside the unit circle where events account for {count}"
            self._name(first, last, words)
        elif not gaps and not accounted(one, other, events):
            self._name(first, last, "a multiplier that is 1 or -1 is missing: others have another sign")
        self._count = end - hidden

    def _meets(self, located: Solution, known: Solution) -> bool:
        """Whether an orbit is at the value of a known one within its error."""
        return has_value(self.space, located.point, self.space.value(self.space.parameter, known.point))

    def _nearer(self, special: Solution, beside: Solution, way: Callable[[float], Any]) -> list[Solution]:
        """An orbit beside a special one; where another is nearer to that, so is the first one behind which it lies.

        Near a homoclinic orbit multipliers change by powers of ten within a step: those far outside pass from one
        half of the real axis to the other between a doubling and a fold that are 1e-6 of a step apart.
        """
        orbits, fractions = [beside], iter(NEARER_SPECIAL)
        while not _agree(special, orbits[-1]):
            fraction = next(fractions, None)
            point = None if fraction is None else self.space.point_solver.coarse_along(*way(fraction))
            if point is None:
                words = f"a multiplier that is 1 or -1 beside the {special.point.special} is missing, or errors hide it"
                self._name(beside, special, words)
                return [beside]
            orbits.append(self.space.solution(point, self.space.floquets([point])[0]))
        return orbits[-2:]

    def _passed(self, solution: Solution, before: int, after: int, angle: float) -> None:
        """Enter the change of stability at an orbit, where there is one."""
        if (before <= 0) == (after <= 0):
            return
        start, end = solution.interval
        self.changes.append(
            StabilityChange(
                value=self.space.value(self.space.parameter, solution.point),
                Omega=float(getattr(solution, "Omega", 2.0 * np.pi / (end - start))),
                kind="real" if angle in (0.0, np.pi) else "complex",
                stable_before=before <= 0,
                stable_after=after <= 0,
                angle=angle,
                error=self.space.parameter_error(solution.point),
            )
        )

    def _beside(self, before: Solution, after: Solution, fractions: Sequence[float]) -> Solution | None:
        """The first of orbits at fractions of the way at which all multipliers have a side; the first if none is it.

        They have one by several errors, as this is where rounding decides: beside a Hopf point one was on the other.
        """
        nearest: Solution | None = None
        solver = self.space.point_solver
        for fraction in fractions:
            for along in (solver.coarse_along, solver.along):
                point = along(before.point, after.point, fraction)
                if point is None:
                    return nearest
                found: Solution = self.space.solution(point, self.space.floquets([point])[0])
                sides = found.floquet().exponents
                if not replace(sides, noise=SURE_SIDE * sides.noise).outside[1]:
                    return found
            nearest = nearest or found
        return nearest

    def _name(self, before: Solution, after: Solution, reason: str) -> None:
        self.unresolved.append(gap_between(self.space, before.point, after.point, reason))
