"""Every change of localised multipliers along a family of orbits at the edge of an endless linear medium.

Where a multiplier passes an end of a gap between arcs, or 1, a real function g_k of the orbit is zero: all roots of
these are sought, as quantities of the search for events (see `Search`), on stretches on which ends of arcs keep their
order. What else changes the numbers of multipliers, two that meet or some that leave an arc, shows in these numbers on
either side: a stretch is divided until what is found on it accounts for them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Chebyshev

from casadi_skin.follow.family import Family
from casadi_skin.follow.samples import SampledStretch
from casadi_skin.follow.search import TANGENT_DIFFERENCE_STEP, MonitorSearch, Search, beside_on_tangent
from casadi_skin.solve.watch import check_time_limit, one_thread
from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.result import ContinuousSpectrum
from casadi_skin.stability.tongues import diagram, medium
from casadi_skin.stability.tongues.diagram import Place, StabilityDiagram, StabilityEdge
from casadi_skin.stability.tongues.hill import CountError, Counts, EdgeHill, Hill, count, function_of, names_of
from casadi_skin.stability.tongues.interpolation import OrbitNotFoundError
from casadi_skin.stability.tongues.medium import HALF_END, START_END, Gap, Layout
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point, Refinement

LOCALISED_ORBIT_TOLERANCE = 1e-11  # of the orbits along the family, whatever the tolerance of its points
# Of an interval between points: stretches on which ends of arcs meet, and on which the frequency leaves a band.
MEETING_STRETCH, BAND_STRETCH = 2e-6, 1e-3
ZERO_XTOL = 1e-12  # of an interval between points: where a zero is
DEEPEST_DIVISION = 23  # divisions of an interval between points
FAR_RATIO = 0.5  # of values of a function at neighbouring points: it stays away from zero between
MEETING_DEPTH = 3  # divisions before two that meet are sought by Newton's method
ERROR_SAFETY = 2.0
ERROR_STEP = 1e-5  # of an interval between points: over which S gives its error
DETERMINANT_ROUNDING = 1e-13  # of a determinant relative to its size
MORE_SIDEBANDS = 4  # sidebands that show the error of those left out
FAILURE_ERRORS = (ArithmeticError, np.linalg.LinAlgError, FlowError, RuntimeError)  # of orbits and linear algebra
UNCOUNTED_WORDS = "localised multipliers cannot be counted"
FILLED_TAIL_WORDS = "the orbit fills the tail, so that its changes depend on the length"


def localised_changes(family: Family, points: Sequence[Point]) -> StabilityDiagram:
    """Every change of localised multipliers along a family.

    Arguments:
        family: the family, of an endless tail.
        points: of it in order, without its linear mode of zero amplitude.

    Returns:
        Changes, with those that do not alter stability, and what is unresolved.
    """
    with one_thread(), np.errstate(all="ignore"):
        return EdgeOrbits(family, points).diagram()


class EdgeOrbit:
    """One orbit: Hill's equations with their arcs and gaps, and those of the `better` orbit, which shows its error."""

    def __init__(self, hill: Hill, better: Callable[[], Hill], bands: tuple[tuple[float, float], ...]) -> None:
        self.hill, self.layout, self._better = hill, Layout(hill.Omega, bands), better
        self._functions = dict[str, float]()

    @cached_property
    def counts(self) -> Counts | None:
        """Its multipliers; None where they cannot be counted."""
        try:
            return count(self.hill, self.layout)
        except CountError:
            return None

    def function(self, name: str) -> float:
        """A function that is zero where a multiplier passes an end of a gap, computed once."""
        if name not in self._functions:
            self._functions[name] = function_of(self.hill, self.layout, name)
        return self._functions[name]

    def noise(self, value: Callable[[Hill, Layout], Any], size: float) -> float:
        """The error of a value of the equations, by those of the orbit, of sidebands, and by rounding of its `size`.

        The better orbit shows the first, equations with more sidebands the second.
        """
        here, moved = value(self.hill, self.layout), 0.0
        for hill in (self._better(), self.hill.with_more(MORE_SIDEBANDS)):
            moved += float(np.linalg.norm(value(hill, Layout(hill.Omega, self.layout.bands)) - here))
        return ERROR_SAFETY * moved + DETERMINANT_ROUNDING * size


class EdgeOrbits:
    """Orbits anywhere between points of a family, by coordinates that count points, and what changes along it.

    `gaps` are stretches of coordinates with the reason why what changes there is not known.
    """

    def __init__(self, family: Family, points: Sequence[Point]) -> None:
        tolerance = min(LOCALISED_ORBIT_TOLERANCE, family.tolerance)
        self.family = Family(replace(family.request, tolerance=tolerance))
        self.solver, levels = self.family.point_solver, self.family.levels
        self.points = [replace(point, problem=levels.problem(point.problem.resolution)) for point in points]
        self.coordinates = np.arange(len(points), dtype=float).tolist()
        self._equations, self._known = EdgeHill(self.family.coordinates), dict[int, tuple[Point, EdgeOrbit]]()
        self._at = dict[tuple[float, bool], Point]()
        localised = self.family.coordinates.localised
        assert localised is not None
        self.bands = localised.bands
        self.found, self.gaps = list[StabilityEdge](), list[Unresolved]()

    def orbit(self, point: Point) -> EdgeOrbit:
        """Equations of a point, made once: of one that has a better orbit beside it these show its error."""
        if id(point) not in self._known:
            check_time_limit("orbits between the points of a family")
            own, better = Refinement(point.problem, point.z), point.better
            if better is not None and any(point is one for one in self.points):  # as precise as the others
                own, better = better, own
            rest = better or own
            equations = EdgeOrbit(self._hill(own), lambda: self._hill(rest), self.bands)
            self._known[id(point)] = point, equations
        return self._known[id(point)][1]

    def _hill(self, orbit: Refinement) -> Hill:
        return self._equations.hill(orbit.problem, orbit.z)

    def S(self, point: Point) -> float:
        """Amplitude of a point."""
        return self.family.value("S", point)

    # Orbits at coordinates --------------------------------------------------------------------------------------------

    def at(self, coordinate: float, refined: bool = True) -> Point:
        """The point of the branch there, or one that is solved for, once; raises OrbitNotFoundError.

        One that is not `refined` is on the level of the next point of the branch, whatever its error.
        """
        k = int(coordinate)
        if coordinate == k and (self.points[k].better is not None or not refined):
            return self.points[k]
        if (coordinate, refined) not in self._at:
            first = min(k, len(self.points) - 2)
            along = self.solver.along if refined else self.solver.unrefined_along
            point = along(self.points[first], self.points[first + 1], coordinate - first)
            if point is None:
                S = self.S(self.points[first])
                raise OrbitNotFoundError(f"no orbit is found near S = {S:g}: {self.solver.failure}")
            self._at[coordinate, refined] = point
        return self._at[coordinate, refined]

    def names(self, coordinate: float) -> tuple[str, ...]:
        """Names of the arcs there."""
        return medium.names_of_arcs(Layout(self.at(coordinate, refined=False).Omega, self.bands))

    @contextmanager
    def gap_where_it_fails(self, start: float, end: float) -> Iterator[None]:
        """Make the stretch a gap where orbits or linear algebra fail."""
        try:
            yield
        except FAILURE_ERRORS as error:
            self.gap(start, end, str(error))

    def gap(self, start: float, end: float, reason: str) -> None:
        """Name a stretch on which it is not known what changes: its S is right to a few digits, without an orbit."""
        if self.gaps and (self.gaps[-1].coordinates[1], self.gaps[-1].reason) == (start, reason):  # it goes on
            start = self.gaps.pop().coordinates[0]
        at = [float(np.interp(c, self.coordinates, [self.S(point) for point in self.points])) for c in (start, end)]
        self.gaps.append(Unresolved(at[0], at[1], reason, coordinates=(start, end)))

    # Stretches on which ends of arcs keep their order -----------------------------------------------------------------

    def diagram(self) -> StabilityDiagram:
        """All changes in order, and what is unresolved."""
        looked = [(start, end, self._look(start, end)) for start, end in self._stretches()]
        for (_, end, before), (start, _, after) in pairwise(looked):
            if (end, start) not in {gap.coordinates for gap in self.gaps}:
                with self.gap_where_it_fails(end, start):
                    self._across(end, before, start, after)
        ordered = sorted(self.found, key=lambda change: change.place.coordinate)
        return StabilityDiagram(tuple(ordered), tuple(self.gaps), len(self._known), localised=True)

    def _look(self, start: float, end: float) -> list[tuple[float, Counts]]:
        """Find everything that changes on a stretch; places on it with the numbers of multipliers there."""
        inside = [c for c in self.coordinates if start < c < end]
        places = [start, *inside, end] if inside else np.linspace(start, end, 5).tolist()
        counted = list[tuple[float, Counts]]()
        with self.gap_where_it_fails(start, end):
            counted = [(c, counts) for c in places if (counts := self.orbit(self.at(c)).counts) is not None]
            if 2 * len(counted) < len(places):
                self.gap(start, end, UNCOUNTED_WORDS)
            names = names_of(self.orbit(self.at(places[len(places) // 2])).layout)
            for (a, one), (b, other) in pairwise(counted):
                with self.gap_where_it_fails(a, b):
                    near = self._near_zero(a, b, names)
                    if near or one.numbers != other.numbers:
                        self.found += EdgeSearch(self, (a, b), near).on_stretch()
        return counted

    def _near_zero(self, start: float, end: float, names: Sequence[str]) -> list[str]:
        """Names of the functions that do not stay away from zero between two places, by values at these alone."""
        first, last = (self.orbit(self.at(c)) for c in (start, end))
        ratios = [first.function(name) / (last.function(name) or np.inf) for name in names]
        return [name for name, ratio in zip(names, ratios, strict=True) if not FAR_RATIO < ratio < 1.0 / FAR_RATIO]

    def _stretches(self) -> list[tuple[float, float]]:
        """Coordinates between which the names of layouts are the same, where changes are sought."""
        bounds = [self.coordinates[0]]
        for start, end in pairwise(self.coordinates):
            found = [(start, end)]
            with self.gap_where_it_fails(start, end):
                found = self._breaks(start, end)
            bounds += [place for each in found for place in each]
        bounds.append(self.coordinates[-1])
        pairs = zip(bounds[::2], bounds[1::2], strict=True)
        return [(a, b) for a, b in pairs if b > a and self._sought(a, b)]

    def _sought(self, start: float, end: float) -> bool:
        """Whether changes are sought on a stretch; one that is filled, or whose arcs are not found, is a gap."""
        names: tuple[str, ...] = (medium.NARROW_GAP,)
        with self.gap_where_it_fails(start, end):
            names = self.names(start)
        if names == (medium.FILLED_GAP,):
            self.gap(start, end, FILLED_TAIL_WORDS)
        return names not in ((medium.FILLED_GAP,), (medium.NARROW_GAP,))

    def _breaks(self, start: float, end: float) -> list[tuple[float, float]]:
        """Short stretches on which names change: ends of arcs meet there, or the orbit's frequency leaves a band."""
        sides = {self.names(start), self.names(end)}
        if len(sides) == 1:
            return []
        if end - start <= (
            MEETING_STRETCH if sides.isdisjoint(((medium.FILLED_GAP,), (medium.NARROW_GAP,))) else BAND_STRETCH
        ):
            return [(start, end)]
        middle = 0.5 * (start + end)
        return [*self._breaks(start, middle), *self._breaks(middle, end)]

    def _across(
        self, end: float, before: Sequence[tuple[float, Counts]], start: float, after: Sequence[tuple[float, Counts]]
    ) -> None:
        """What changes where ends of arcs meet: an overlap begins or ends; numbers of multipliers must not change."""
        if not before or not after:
            self.gap(end, start, UNCOUNTED_WORDS)
            return
        (a, one), (b, other) = before[-1], after[0]
        if (one.off, sum(one.inside)) != (other.off, sum(other.inside)):
            self.gap(a, b, "numbers of localised multipliers change where ends of arcs meet")
        middle, sides = 0.5 * (end + start), [self.at(end), self.at(start)]
        point, (first, last) = self.at(middle), [_overlaps(self.orbit(side).layout) for side in sides]
        here, reach = self.orbit(point).layout, max(abs(self.S(side) - self.S(point)) for side in sides)
        for bands, order in sorted(first ^ last):
            edges = [(here.bands[bands[0]][k], here.bands[bands[1]][k]) for k in (0, 1)]
            edge = min(edges, key=lambda two: abs(sum(two) - 2.0 * order * here.Omega))[0]
            place = Place(middle, 0.5 * (start - end), self.S(point), reach, here.Omega)
            self.found.append(change_at(place, diagram.OVERLAP, edge, (1, -1), (one.off, one.off)))


def change_at(
    place: Place, kind: str, sigma: float, signatures: tuple[int, ...], sides: tuple[int, int]
) -> StabilityEdge:
    """A change where multipliers have an exponent, with the numbers of localised ones off the circle on its `sides`.

    lambda + 1/lambda = 2 + 4 mu for the multiplier of half the period.
    """
    mu, (before, after) = -float(np.sin(0.5 * np.pi * sigma / place.Omega) ** 2), sides
    return StabilityEdge(place, kind, mu, signatures, before == 0, after == 0, 2, off_before=before, off_after=after)


def _overlaps(layout: Layout) -> set[tuple[tuple[int, int], int]]:
    return {(o.bands, o.order) for o in ContinuousSpectrum(layout.Omega, layout.bands, 2).overlaps}


# What changes the numbers of multipliers between two orbits -----------------------------------------------------------


class Zero(NamedTuple):
    """A zero of the function of a name, its place along a stretch, and on the branch."""

    sigma: float
    name: str
    place: Place


class EdgeSearch(Search):
    """The account between two orbits between which ends of arcs keep their order.

    A part is resolved where what is found on it accounts for the change of the numbers of multipliers, in each gap and
    off the circle: a zero of one of the functions of the `names`, or two multipliers that meet. Others
    are gaps of the `orbits`.
    """

    deepest, root_xtol = DEEPEST_DIVISION, ZERO_XTOL

    def __init__(self, orbits: EdgeOrbits, span: tuple[float, float], names: Sequence[str]) -> None:
        super().__init__(orbits.solver, orbits.at(span[0]), orbits.at(span[1]))
        self.orbits, self.span, self.names = orbits, span, names

    def orbit(self, point: Point) -> EdgeOrbit:
        """Equations at a point."""
        return self.orbits.orbit(self.own(point))

    def is_clear(self, point: Point) -> bool:
        return self.orbit(point).counts is not None

    def coordinate(self, point: Point) -> float:
        """The coordinate of a point, between those of the ends."""
        start, end = self.span
        return start + (end - start) * self.sigma(point) / self.length

    # Zeros of functions -----------------------------------------------------------------------------------------------

    @cached_property
    def zeros(self) -> list[Zero]:
        """All zeros of the functions, in order."""
        if not self.names:
            return []

        def values(point: Point) -> Array:
            return np.array([self.orbit(point).function(name) for name in self.names])

        search, found = MonitorSearch(self.orbits.family, *self.ends, self.names, values), list[Zero]()
        search.root_xtol = ZERO_XTOL
        for point in search.on_stretch():
            name = point.special
            size = max(abs(self.orbit(end).function(name)) for end in self.ends)
            place = self.place(point, partial(function_of, name=name), size)
            found.append(Zero(self.sigma(point), name, place))
        for gap in search.gaps:
            self.orbits.gap(*self.span, gap.reason)
        return found

    def place(self, point: Point, value: Callable[[Hill, Layout], float], size: float) -> Place:
        """The place of a point where a function of the equations of that `size` vanishes, with its error."""
        orbit = self.orbit(point)
        ahead = self.orbits.orbit(beside_on_tangent(point, TANGENT_DIFFERENCE_STEP))
        here, then = (value(one.hill, one.layout) for one in (orbit, ahead))
        along = abs(self.row @ point.problem.prolong(point.tangent, self.last.problem))
        off = (abs(here) + orbit.noise(value, size)) * TANGENT_DIFFERENCE_STEP / abs(then - here) * along
        return self.place_within(point, float(off))

    def place_within(self, point: Point, off: float) -> Place:
        """The place of a point that may be `off` along the stretch by so much: S moves by its slope and bend there."""
        off += ZERO_XTOL * self.length
        (curve, _), index = self.solver.curve(*self.ends), self.last.problem.parameter_index
        step, S_of = max(off, ERROR_STEP * self.length), self.orbits.family.request.S_of
        here, *beside = (S_of(float(curve.at(self.sigma(point) + side)[index])) for side in (0.0, -step, step))
        error, along = max(abs(S - here) for S in beside) * off / step, float(np.ptp(self.span)) * off / self.length
        return Place(self.coordinate(point), along, self.orbits.S(point), error, self.orbit(point).layout.Omega)

    # The account ------------------------------------------------------------------------------------------------------

    def zeros_on(self, stretch: SampledStretch) -> list[Zero]:
        """Those on a part."""
        start, end = (self.sigma(one.point) for one in (stretch.first, stretch.last))
        return [zero for zero in self.zeros if start <= zero.sigma < end]

    def numbers(self, stretch: SampledStretch) -> tuple[Counts, Counts] | None:
        """Numbers of multipliers at both ends; None where they cannot be counted."""
        before, after = (self.orbit(end.point).counts for end in (stretch.first, stretch.last))
        return None if before is None or after is None else (before, after)

    def passes(self, ends: SampledStretch) -> bool:
        numbers = self.numbers(ends)
        return numbers is not None and numbers[0].numbers == numbers[1].numbers and not self.zeros_on(ends)

    def suspected(self, stretch: SampledStretch) -> float | None:
        """The middle between two zeros."""
        zeros = self.zeros_on(stretch)
        if len(zeros) < 2:
            return None
        return (0.5 * (zeros[0].sigma + zeros[1].sigma) - self.sigma(stretch.first.point)) / stretch.length

    def found(self, stretch: SampledStretch, depth: int, last: bool) -> Sequence[StabilityEdge] | None:
        numbers, zeros, event = self.numbers(stretch), self.zeros_on(stretch), None
        if numbers is None:
            return self.given_up(stretch)
        if len(zeros) == 1 and self.explains(zeros[0].name, *numbers):
            return [self.change(zeros[0], *numbers)]
        if not zeros and depth >= MEETING_DEPTH:
            event = self.meeting(stretch, *numbers)
        if event is not None:
            return [event]
        return self.given_up(stretch) if last else None

    def given_up(self, stretch: SampledStretch) -> Sequence[StabilityEdge]:
        """Zeros on a part that do not account for the numbers at its ends, which is named."""
        start, end = (self.coordinate(one.point) for one in (stretch.first, stretch.last))
        numbers, words = self.numbers(stretch), UNCOUNTED_WORDS
        if numbers is not None:
            before, after = numbers
            words = f"localised multipliers off the circle change from {before.off} to {after.off}"
            words += f", in gaps by {sum(after.inside) - sum(before.inside)}"
        self.orbits.gap(start, end, words)
        return [] if numbers is None else [self.change(zero, *numbers) for zero in self.zeros_on(stretch)]

    def explains(self, name: str, before: Counts, after: Counts) -> bool:
        """Whether a zero changes the numbers by what they change."""
        moved, inside = after.off - before.off, np.subtract(after.inside, before.inside)
        if not name.startswith((START_END, HALF_END)):
            return moved == 0 and int(np.sum(np.abs(inside))) == 1
        expected, pinned = np.zeros_like(inside), self.orbit(self.first).layout.pinned
        if name != START_END and not (name.startswith(HALF_END) and pinned):  # it comes from the gap at that end
            expected[0 if name.startswith(START_END) else -1] = -moved
        return abs(moved) == 1 and np.array_equal(inside, expected)

    def change(self, zero: Zero, before: Counts, after: Counts) -> StabilityEdge:
        """The change at a zero of a function."""
        Omega, sides = zero.place.Omega, (before.off, after.off)
        if zero.name.startswith((START_END, HALF_END)):
            return change_at(zero.place, diagram.REAL, 0.0 if zero.name.startswith(START_END) else Omega, (), sides)
        (end,) = (end for end in Layout(Omega, self.orbits.bands).ends if end.name == zero.name)
        return change_at(zero.place, diagram.BAND_EDGE, end.sigma, (1 if end.turns % 2 == 0 else -1,), sides)

    # Two that meet ----------------------------------------------------------------------------------------------------

    def meeting(self, stretch: SampledStretch, before: Counts, after: Counts) -> StabilityEdge | None:
        """A collision in a gap, or multipliers that leave an arc; None where it is not found on the stretch."""
        moved, inside = after.off - before.off, np.subtract(after.inside, before.inside)
        gaps = np.flatnonzero(inside).tolist()
        if abs(moved) != 2 or (gaps and (len(gaps) > 1 or inside[gaps[0]] != -moved)):
            return None
        try:
            if gaps:
                kind, found = diagram.COMPLEX, self.collision(stretch, before, after, gaps[0])
            else:
                kind, found = diagram.RESONANCE, self.resonance(stretch)
        except (MeetingError, np.linalg.LinAlgError):
            return None
        low, high = (self.coordinate(end.point) for end in (stretch.first, stretch.last))
        if found is None or not low <= found[0].coordinate <= high:
            return None
        return change_at(found[0], kind, found[1], (1, -1), (before.off, after.off))

    def collision(
        self, stretch: SampledStretch, before: Counts, after: Counts, number: int
    ) -> tuple[Place, float] | None:
        """The place where two multipliers of a gap meet, and the exponent there; raises MeetingError.

        The square of half their distance is zero there. They are known at the end at which they are in the gap; at
        any other orbit they are those nearest to the ones of the known orbit whose Omega is nearest.
        """
        start, counts = (stretch.first, before) if before.off < after.off else (stretch.last, after)
        orbit = self.orbit(start.point)
        zeros = [orbit.layout.gaps[number].place(sigma) for sigma in counts.zeros[number]]
        one, other = min(pairwise(zeros), key=lambda two: two[1] - two[0])
        pairs = {orbit.layout.Omega: (0.5 * (one + other), 0.25 * (other - one) ** 2)}

        def square(hill: Hill, layout: Layout) -> float:
            near = min(pairs, key=lambda Omega: abs(Omega - hill.Omega))
            pairs[hill.Omega] = _pair_near(hill, layout.gaps[number], *pairs[near])
            return pairs[hill.Omega][1]

        root = self.root_of(
            stretch, lambda point: square(self.orbit(point).hill, self.orbit(point).layout), 0.0, diagram.COMPLEX
        )
        if root is None:
            return None
        place = self.place(root, square, 1.0)
        mean, _ = pairs[min(pairs, key=lambda Omega: abs(Omega - place.Omega))]
        gap = Layout(place.Omega, self.orbits.bands).gaps[number]
        return place, float(gap.sigma(np.array([mean]))[0])

    def resonance(self, stretch: SampledStretch) -> tuple[Place, float]:
        """The place where multipliers leave an arc, and their exponent, a zero of D under it; raises MeetingError.

        Unknowns are the exponent over Omega, and the place on the stretch from its middle, over its length.
        """
        from scipy.optimize import root

        first, last = (self.on_branch(end.point) for end in (stretch.first, stretch.last))
        known = dict[float, Point]()

        def point_at(fraction: float) -> Point:
            if fraction not in known:
                point = self.solver.along(first, last, 0.5 + fraction) if abs(fraction) <= FARTHEST_MEETING else None
                if point is None:
                    raise MeetingError("a multiplier that comes out of an arc is not found")
                known[fraction] = point
            return known[fraction]

        middle = self.orbit(point_at(0.0))
        Omega, covered = middle.layout.Omega, [(s.sigma, e.sigma) for s, e, under in middle.layout.intervals if under]
        begin = _least_under_arcs(middle.hill, covered)
        scale = float(middle.hill.determinant(np.array([begin]))[0][0])

        def value(hill: Hill, x: Array) -> Array:
            logs, phases = hill.determinant(np.array([x[0] * Omega]))
            D = complex(phases[0] * np.exp(logs[0] - scale))
            return np.array([D.real, D.imag])

        def values(x: Array) -> Array:
            return value(self.orbit(point_at(float(x[1]))).hill, x)

        def slopes(x: Array) -> Array:
            steps = np.diag([DIFFERENCE, COORDINATE_DIFFERENCE])
            return np.stack([0.5 * (values(x + h) - values(x - h)) / np.sum(h) for h in steps], axis=1)

        x = root(values, [begin / Omega, 0.0], jac=slopes, tol=ZERO_XTOL).x
        point, jacobian = point_at(float(x[1])), slopes(x)
        if not np.linalg.norm(np.linalg.solve(jacobian, values(x))) <= SOLVED_STEP:
            raise MeetingError("a multiplier that comes out of an arc is not found")
        noise = self.orbit(point).noise(lambda hill, _: value(hill, x), float(np.max(np.abs(jacobian))))
        off = float(np.linalg.norm(np.linalg.inv(jacobian)[1])) * noise
        return self.place_within(point, off * stretch.length), float(x[0]) * Omega


# Two localised multipliers that meet, or leave the arcs ---------------------------------------------------------------

PAIR_STEPS = 12
PAIR_REACH = 0.1  # to either side of a pair: where D is a series
PAIR_DEGREE = 16
DIFFERENCE = 1e-6  # of Omega, for derivatives by an exponent
COORDINATE_DIFFERENCE = 1e-3  # of the stretch, for derivatives along the branch
ARC_VALUES = 100  # values under an arc among which the smallest determinant is sought
SOLVED_STEP = 1e-9  # of Omega and of the stretch: a last step of Newton's method
FARTHEST_MEETING = 4.0  # of a stretch, from its middle


class MeetingError(ArithmeticError):
    """No meeting is found."""


def _pair_near(hill: Hill, gap: Gap, mean: float, square: float) -> tuple[float, float]:
    """The pair of zeros near another, real or conjugate: mean, and square of half the difference, as x of the gap.

    Raises MeetingError.
    """
    for _ in range(PAIR_STEPS):
        reach = max(PAIR_REACH, 2.0 * float(np.sqrt(abs(square))))
        first, last = max(mean - reach, -1.0), min(mean + reach, -0.05 * PAIR_REACH if gap.mirrored else 1.0)
        if first >= last:
            break
        series = Chebyshev.interpolate(partial(hill.within, gap), PAIR_DEGREE, [first, last])
        roots = np.asarray(series.roots(), dtype=complex)
        one, other = roots[np.argsort(np.abs(roots - mean))[:2]]
        before, mean, square = mean, float(np.real(0.5 * (one + other))), float(np.real(0.25 * (one - other) ** 2))
        if abs(np.imag(one + other)) > ZERO_XTOL:
            break
        if abs(mean - before) <= 0.5 * reach:
            return mean, square
    raise MeetingError("two multipliers that meet are not found")


def _least_under_arcs(hill: Hill, intervals: Sequence[tuple[float, float]]) -> float:
    """The exponent under arcs at which a zero of the determinant is nearest, by |D / D'|."""
    best, where = np.inf, 0.0
    for start, end in intervals:
        sigma = 0.5 * (start + end) - 0.5 * (end - start) * np.cos(np.pi * (np.arange(ARC_VALUES) + 0.5) / ARC_VALUES)
        logs, phases = hill.determinant(sigma)
        D = np.asarray(phases) * np.exp(logs - np.max(logs))
        away = np.abs(D / np.gradient(D, sigma))
        if np.min(away) < best:
            best, where = float(np.min(away)), float(sigma[np.argmin(away)])
    return where
