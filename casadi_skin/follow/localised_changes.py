"""Every change of localised multipliers along a branch of orbits at the edge of an endless linear medium.

Where a multiplier passes an end of a gap between arcs, or 1, a real function of the orbit is zero: these are sought on
all stretches on which ends of arcs keep their order. Ends meet where Omega has values in closed form. What else changes
the numbers of multipliers, two that meet or some that leave an arc, shows in these numbers on either side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.polynomial.chebyshev import chebroots

from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.result import ContinuousSpectrum
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.diagram import (
    BAND_EDGE,
    COMPLEX,
    OVERLAP,
    REAL,
    RESONANCE,
    Place,
    StabilityDiagram,
    StabilityEdge,
)
from casadi_skin.stability.tongues.hill import CountError, Counts, EdgeBranch, Hill, Sample, function_of, names_of
from casadi_skin.stability.tongues.medium import (
    FILLED_GAP,
    HALF_END,
    NARROW_GAP,
    START_END,
    Gap,
    Layout,
    crossings,
    names_of_arcs,
)
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.problem import Array

BAND_STRETCH_DISTANCE = 1e-3  # of an interval between points: where the frequency leaves a band, between two stretches
INSIDE_MEETING = 1e-6  # of an interval between points: how far from a meeting of arcs the ends of a stretch are
ZERO_XTOL = 1e-12  # of an interval between points: where a zero is
FINEST_STRETCH = 1e-7  # of such an interval: stretches that are halved no further
NEAR_MEETING = 0.1  # of an interval between points: from where on two that meet are sought by Newton's method
LARGEST_BEND = 0.3  # of the smaller end: what a function may do in between without being looked at
ERROR_SAFETY = 2.0
DETERMINANT_ROUNDING = 1e-13  # of a determinant relative to its size
MORE_SIDEBANDS = 4  # sidebands that show the error of those left out
FAILURE_ERRORS = (ArithmeticError, np.linalg.LinAlgError, FlowError, RuntimeError)  # of orbits and linear algebra
UNCOUNTED_WORDS = "localised multipliers cannot be counted"
FILLED_TAIL_WORDS = "the orbit fills the tail, so that its changes depend on the length"


def find_localised_changes(branch: EdgeBranch) -> StabilityDiagram:
    """Find every change of localised multipliers along a branch.

    Arguments:
        branch: gives orbits at any coordinate along it.

    Returns:
        Changes, with those that do not alter stability, and what is unresolved.
    """
    search = Search(branch)
    looked = [(start, end, search.look(start, end)) for start, end in search.stretches()]
    for (_, end, before), (start, _, after) in pairwise(looked):
        if (end, start) not in {(a, b) for a, b, _ in search.gaps}:
            with search.gap_where_it_fails(end, start):
                search.across(end, before, start, after)
    ordered = tuple(sorted(search.found, key=lambda change: change.place.coordinate))
    unresolved = tuple(
        Unresolved(search.amplitude(start), search.amplitude(end), reason, coordinates=(start, end))
        for start, end, reason in search.gaps
    )
    return StabilityDiagram(ordered, unresolved, len(search.known), localised=True)


def mu_of(sigma: float, Omega: float) -> float:
    """mu of an exponent: lambda + 1/lambda = 2 + 4 mu for the multiplier of half the period."""
    return -float(np.sin(0.5 * np.pi * sigma / Omega) ** 2)


def others(sample: Sample) -> tuple[Hill, Hill]:
    """Equations that show the errors of an orbit's: those of the better orbit, and those with more sidebands."""
    return sample.better(), sample.hill.with_more(MORE_SIDEBANDS)


def layout_like(hill: Hill, sample: Sample) -> Layout:
    """Arcs for the frequency of equations like those of a sample."""
    return Layout(hill.Omega, sample.layout.bands)


@dataclass(frozen=True)
class Zero:
    """A zero of one of the functions: its coordinate with error, and the function's name."""

    coordinate: float
    error: float
    name: str


@dataclass
class Search:
    """Orbits known so far, and what has been found.

    `known` and `layouts` are orbits, and arcs with gaps, by coordinate; `gaps` are stretches with the reason why what
    changes there is not known.
    """

    branch: EdgeBranch
    known: dict[float, Sample] = field(default_factory=dict)
    layouts: dict[float, Layout] = field(default_factory=dict)
    found: list[StabilityEdge] = field(default_factory=list)
    gaps: list[tuple[float, float, str]] = field(default_factory=list)

    def at(self, coordinate: float) -> Sample:
        """The orbit at a coordinate, solved once."""
        if coordinate not in self.known:
            self.known[coordinate] = self.branch.sample(coordinate)
        return self.known[coordinate]

    def layout(self, coordinate: float) -> Layout:
        """Arcs and gaps at a coordinate."""
        if coordinate in self.known:
            return self.known[coordinate].layout
        if coordinate not in self.layouts:
            self.layouts[coordinate] = self.branch.layout(coordinate)
        return self.layouts[coordinate]

    def names(self, coordinate: float) -> tuple[str, ...]:
        """Names of the arcs there."""
        return names_of_arcs(self.layout(coordinate))

    def counts(self, coordinate: float) -> Counts | None:
        """Numbers of multipliers there; None where they cannot be counted."""
        try:
            return self.at(coordinate).counts
        except CountError:
            return None

    def amplitude(self, coordinate: float) -> float:
        """S at a coordinate, to a few digits where no orbit is known there."""
        known = self.known.get(coordinate)
        return self.branch.amplitude(coordinate) if known is None else known.S

    @contextmanager
    def gap_where_it_fails(self, start: float, end: float) -> Iterator[None]:
        """Make the stretch a gap where orbits or linear algebra fail."""
        try:
            yield
        except FAILURE_ERRORS as error:
            self.gaps.append((start, end, str(error)))

    def add(
        self, coordinate: float, error: float, kind: str, mu: float, signs: tuple[int, ...], sides: tuple[int, int]
    ) -> None:
        """Add a change, with the numbers of localised multipliers off the circle on its `sides`.

        The error of S is by its slope and bend.
        """
        points = self.branch.coordinates
        step = max(error, 1e-5)
        ends = np.clip([coordinate - step, coordinate + step], points[0], points[-1])
        here, beside = self.at(coordinate), [self.at(float(end)) for end in ends]
        change = max(abs(side.S - here.S) for side in beside) * error / step
        place, (before, after) = Place(coordinate, error, here.S, change, here.Omega), sides
        stable = before == 0, after == 0
        self.found.append(StabilityEdge(place, kind, mu, signs, *stable, 2, off_before=before, off_after=after))

    # Stretches on which ends of arcs keep their order -----------------------------------------------------------------

    def stretches(self) -> list[tuple[float, float]]:
        """Coordinates between which the names of layouts are the same, where changes are sought."""
        places = self.branch.coordinates.tolist()
        bounds = [places[0]]
        for start, end in pairwise(places):
            found = [(start, end)]
            with self.gap_where_it_fails(start, end):
                found = self._breaks(start, end)
            bounds += [place for each in found for place in each]
        bounds.append(places[-1])
        pairs = zip(bounds[::2], bounds[1::2], strict=True)
        return [(a, b) for a, b in pairs if b > a and self._sought(a, b)]

    def _sought(self, start: float, end: float) -> bool:
        """Whether changes are sought on a stretch; one that is filled, or whose arcs are not found, is a gap."""
        names: tuple[str, ...] = (NARROW_GAP,)
        with self.gap_where_it_fails(start, end):
            names = self.names(start)
        if names == (FILLED_GAP,):
            self.gaps.append((start, end, FILLED_TAIL_WORDS))
        return names not in ((FILLED_GAP,), (NARROW_GAP,))

    def _breaks(self, start: float, end: float) -> list[tuple[float, float]]:
        """Places between two points at which names change, from just before to just behind."""
        from scipy.optimize import brentq

        first, last = self.layout(start), self.layout(end)
        meetings = crossings(first, last)
        if names_of_arcs(first) == names_of_arcs(last) and not meetings:
            return []
        at = [
            float(brentq(lambda c, at=Omega: self.layout(float(c)).Omega - at, start, end, xtol=1e-14, rtol=1e-14))
            for Omega in meetings
        ]
        apart = INSIDE_MEETING * (end - start)
        found = [(c - apart, c + apart) for c in at]
        stops = [start, *(place for each in found for place in each), end]
        for a, b in zip(stops[::2], stops[1::2], strict=True):
            found += self._by_halving(a, b)
        return sorted(found)

    def _by_halving(self, start: float, end: float) -> list[tuple[float, float]]:
        """Places at which the orbit's frequency leaves a band, or the gap beside it becomes wide enough."""
        if self.names(start) == self.names(end):
            return []
        if end - start <= BAND_STRETCH_DISTANCE:
            return [(start, end)]
        middle = 0.5 * (start + end)
        return [*self._by_halving(start, middle), *self._by_halving(middle, end)]

    def across(
        self, end: float, before: Sequence[tuple[float, Counts]], start: float, after: Sequence[tuple[float, Counts]]
    ) -> None:
        """What changes where ends of arcs meet: an overlap begins or ends; numbers of multipliers must not change."""
        if not before or not after:
            self.gaps.append((end, start, UNCOUNTED_WORDS))
            return
        (a, one), (b, other) = before[-1], after[0]
        if (one.off, sum(one.inside)) != (other.off, sum(other.inside)):
            self.gaps.append((a, b, "numbers of localised multipliers change where ends of arcs meet"))
        sides, here = [_overlaps(self.at(c).layout) for c in (end, start)], self.at(0.5 * (end + start))
        for bands, order in sorted(sides[0] ^ sides[1]):
            edges = [(here.layout.bands[bands[0]][k], here.layout.bands[bands[1]][k]) for k in (0, 1)]
            edge = min(edges, key=lambda two: abs(sum(two) - 2.0 * order * here.Omega))[0]
            error = 0.5 * (start - end)
            self.add(here.coordinate, error, OVERLAP, mu_of(edge, here.Omega), (1, -1), (one.off, one.off))

    # Zeros of the functions that vanish where a localised multiplier passes an end of a gap ---------------------------

    def zeros(self, places: Sequence[float]) -> list[Zero]:
        """All zeros of the functions on a stretch on which ends of arcs keep their order, ascending."""
        found = []
        for name in names_of(self.at(places[len(places) // 2]).layout):
            for a, b in pairwise(places):
                found += [self._zero(name, *ends) for ends in self._brackets(name, a, b)]
        return sorted(found, key=lambda zero: zero.coordinate)

    def _brackets(self, name: str, a: float, b: float) -> list[tuple[float, float]]:
        """Intervals at whose ends a function has opposite signs, after halving where it may come near zero."""
        first, last = (self.at(c).function(name) for c in (a, b))
        if first * last < 0.0:
            return [(a, b)]
        if b - a <= FINEST_STRETCH or min(abs(first), abs(last)) > 0.5 * max(abs(first), abs(last)) > 0.0:
            return []
        middle = 0.5 * (a + b)
        bend = abs(first + last - 2.0 * self.at(middle).function(name))
        if bend <= LARGEST_BEND * min(abs(first), abs(last)):
            return []
        return [*self._brackets(name, a, middle), *self._brackets(name, middle, b)]

    def _zero(self, name: str, a: float, b: float) -> Zero:
        """The zero between two places with values of opposite signs."""

        def value(c: float) -> float:
            return self.at(c).function(name)

        def moved(c: float) -> float:
            sample = self.at(c)
            return sum(abs(function_of(hill, layout_like(hill, sample), name) - value(c)) for hill in others(sample))

        return Zero(*zero_between(value, moved, a, b, max(abs(value(a)), abs(value(b)))), name)

    # Numbers of multipliers -------------------------------------------------------------------------------------------

    def look(self, start: float, end: float) -> list[tuple[float, Counts]]:
        """Find everything that changes on a stretch; places on it with the numbers of multipliers there."""
        inside = [c for c in self.branch.coordinates.tolist() if start < c < end]
        places = [start, *inside, end] if inside else np.linspace(start, end, 5).tolist()
        counted = list[tuple[float, Counts]]()
        with self.gap_where_it_fails(start, end):
            zeros = self.zeros(places)
            checks = {*places, *(0.5 * (a.coordinate + b.coordinate) for a, b in pairwise(zeros))}
            checks -= {zero.coordinate for zero in zeros}
            counted = [(c, counts) for c in sorted(checks) if (counts := self.counts(c)) is not None]
            if 2 * len(counted) < len(checks):
                self.gaps.append((start, end, UNCOUNTED_WORDS))
            for (a, before), (b, after) in pairwise(counted):
                self._between(a, before, b, after, [zero for zero in zeros if a < zero.coordinate < b])
        return counted

    def _between(self, a: float, before: Counts, b: float, after: Counts, zeros: Sequence[Zero]) -> None:
        """What changes the numbers between two places."""
        moved, sides = after.off - before.off, (before.off, after.off)
        inside = [n - m for m, n in zip(before.inside, after.inside, strict=True)]
        if not zeros and moved == 0 and not any(inside):
            return
        if len(zeros) == 1 and self._explains(zeros[0], moved, inside):
            self._add_zero(zeros[0], sides)
            return
        two = not zeros and b - a <= NEAR_MEETING and abs(moved) == 2 and sum(map(abs, inside)) in (0, 2)
        if two and self._meeting(a, before, b, after, inside):
            return
        if b - a <= FINEST_STRETCH:
            words = f"localised multipliers off the circle change from {before.off} to {after.off}"
            self.gaps.append((a, b, f"{words}, in gaps by {sum(inside)}"))
            for zero in zeros:
                self._add_zero(zero, sides)
            return
        middle = 0.5 * (a + b)
        if any(abs(zero.coordinate - middle) < 0.01 * (b - a) for zero in zeros):
            middle += 0.05 * (b - a)
        half = self.counts(middle)
        if half is None:
            self.gaps.append((a, b, UNCOUNTED_WORDS))
            return
        self._between(a, before, middle, half, [zero for zero in zeros if zero.coordinate < middle])
        self._between(middle, half, b, after, [zero for zero in zeros if zero.coordinate >= middle])

    def _explains(self, zero: Zero, moved: int, inside: Sequence[int]) -> bool:
        """Whether a zero changes the numbers by what they change."""
        layout = self.at(zero.coordinate).layout
        changed = [number for number, change in enumerate(inside) if change]
        if not zero.name.startswith((START_END, HALF_END)):
            return moved == 0 and len(changed) == 1 and abs(inside[changed[0]]) == 1
        gap = 0 if zero.name.startswith(START_END) else len(layout.gaps) - 1
        if zero.name == START_END or (zero.name.startswith(HALF_END) and layout.pinned):
            return abs(moved) == 1 and not changed
        return abs(moved) == 1 and changed == [gap] and inside[gap] == -moved

    def _add_zero(self, zero: Zero, sides: tuple[int, int]) -> None:
        if zero.name.startswith((START_END, HALF_END)):
            mu, kind, signs = (0.0 if zero.name.startswith(START_END) else -1.0), REAL, tuple[int, ...]()
        else:
            layout = self.at(zero.coordinate).layout
            (end,) = (end for end in layout.ends if end.name == zero.name)
            mu, kind = mu_of(end.sigma, layout.Omega), BAND_EDGE
            signs = (1 if end.turns % 2 == 0 else -1,)
        self.add(zero.coordinate, zero.error, kind, mu, signs, sides)

    def _meeting(self, a: float, before: Counts, b: float, after: Counts, inside: Sequence[int]) -> bool:
        """A collision in a gap, or multipliers that leave an arc, located; false where the interval is too long."""
        try:
            if any(inside):
                gap = next(number for number, change in enumerate(inside) if change)
                if inside[gap] != before.off - after.off:
                    return False
                kind, (coordinate, error, sigma) = COMPLEX, collision(self, a, before, b, after, gap)
            else:
                kind, (coordinate, error, sigma) = RESONANCE, resonance(self, a, b)
        except (MeetingError, np.linalg.LinAlgError):
            return False
        if not a <= coordinate <= b:
            return False
        mu = mu_of(sigma, self.at(coordinate).Omega)
        self.add(coordinate, error, kind, mu, (1, -1), (before.off, after.off))
        return True


def _overlaps(layout: Layout) -> set[tuple[tuple[int, int], int]]:
    return {(o.bands, o.order) for o in ContinuousSpectrum(layout.Omega, layout.bands, 2).overlaps}


def zero_between(
    value: Callable[[float], float], moved: Callable[[float], float], a: float, b: float, size: float
) -> tuple[float, float]:
    """The zero of a function of `size` between places where it has opposite signs, and its error.

    `moved` is by how much equations that show the errors of an orbit's change the function there.
    """
    from scipy.optimize import brentq

    at = float(brentq(lambda c: value(float(c)), a, b, xtol=ZERO_XTOL * (b - a), rtol=4e-16 * 4))
    low, high = np.clip([at - 1e-3 * (b - a), at + 1e-3 * (b - a)], a, b).tolist()
    slope = abs(value(high) - value(low)) / (high - low)
    error = abs(value(at)) + ERROR_SAFETY * moved(at) + DETERMINANT_ROUNDING * size
    return at, float(error / slope) + ZERO_XTOL * (b - a)


# Places on a branch where two localised multipliers meet, or one leaves the arcs: two equations -----------------------

PAIR_STEPS = 12
PAIR_REACH = 0.1  # to either side of a pair: where D is a series
PAIR_DEGREE = 16
INTERVAL_PARTS = 8  # of an interval, by which a pair is followed
DIFFERENCE = 1e-6  # of Omega, for derivatives by an exponent
COORDINATE_DIFFERENCE = 1e-3  # of the interval, for derivatives along the branch
ARC_VALUES = 100  # values under an arc among which the smallest determinant is sought
SOLVED_STEP = 1e-9  # of Omega and of the interval: a last step of Newton's method
FARTHEST_MEETING = 4.0  # intervals from the middle of one


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
        middle, half = 0.5 * (first + last), 0.5 * (last - first)
        series = chebyshev.transform(PAIR_DEGREE) @ hill.within(gap, middle + half * chebyshev.nodes(PAIR_DEGREE))
        roots = middle + half * chebroots(series)
        one, other = roots[np.argsort(np.abs(roots - mean))[:2]]
        before, mean, square = mean, float(np.real(0.5 * (one + other))), float(np.real(0.25 * (one - other) ** 2))
        if abs(np.imag(one + other)) > ZERO_XTOL:
            break
        if abs(mean - before) <= 0.5 * reach:
            return mean, square
    raise MeetingError("two multipliers that meet are not found")


def collision(
    search: Search, a: float, before: Counts, b: float, after: Counts, gap: int
) -> tuple[float, float, float]:
    """Coordinate, error and exponent where two multipliers of a gap meet; raises MeetingError."""
    start, other, counts = (a, b, before) if before.off < after.off else (b, a, after)
    zeros = [search.at(start).layout.gaps[gap].place(sigma) for sigma in counts.zeros[gap]]
    first, last = min(pairwise(zeros), key=lambda two: two[1] - two[0])
    pairs = {start: (0.5 * (first + last), 0.25 * (last - first) ** 2)}

    def square(c: float) -> float:
        near = min(pairs, key=lambda known: abs(known - c))
        pairs[c] = _pair_near(search.at(c).hill, search.at(c).layout.gaps[gap], *pairs[near])
        return pairs[c][1]

    parts = (start + float(part) * (other - start) for part in np.linspace(0.0, 1.0, INTERVAL_PARTS + 1)[1:])
    end = next((c for c in parts if square(c) < 0.0), None)  # the pair, followed to the other end
    if end is None:
        raise MeetingError("two multipliers of a gap do not meet")

    def moved(c: float) -> float:
        sample = search.at(c)
        pairs_there = (_pair_near(hill, layout_like(hill, sample).gaps[gap], *pairs[c]) for hill in others(sample))
        return sum(abs(moved[1] - pairs[c][1]) for moved in pairs_there)

    at, error = zero_between(square, moved, min(start, end), max(start, end), 1.0)
    return at, error, float(search.at(at).layout.gaps[gap].sigma(np.array([pairs[at][0]]))[0])


def resonance(search: Search, a: float, b: float) -> tuple[float, float, float]:
    """Coordinate, error and exponent where multipliers leave an arc, a zero of D under it; raises MeetingError."""
    from scipy.optimize import root

    middle, width = search.at(0.5 * (a + b)), b - a
    begin = _least_under_arcs(middle.hill, [(s.sigma, e.sigma) for s, e, covered in middle.layout.intervals if covered])
    scale = float(middle.hill.determinant(np.array([begin]))[0][0])

    def value(hill: Hill, x: Array) -> Array:
        logs, phases = hill.determinant(np.array([x[0] * middle.Omega]))
        D = complex(phases[0] * np.exp(logs[0] - scale))
        return np.array([D.real, D.imag])

    def hill_at(x: Array) -> Hill:
        if not abs(x[1]) <= FARTHEST_MEETING:
            raise MeetingError("a multiplier that comes out of an arc is not found")
        return search.at(middle.coordinate + float(x[1]) * width).hill

    def slopes(x: Array) -> Array:
        steps = np.diag([DIFFERENCE, COORDINATE_DIFFERENCE])
        ends = [[value(hill_at(x + side * step), x + side * step) for side in (1.0, -1.0)] for step in steps]
        return np.stack([0.5 * (up - down) / np.sum(h) for (up, down), h in zip(ends, steps, strict=True)], axis=1)

    def values(x: Array) -> Array:
        return value(hill_at(x), x)

    solved = root(values, [begin / middle.Omega, 0.0], jac=slopes, tol=ZERO_XTOL)
    at = middle.coordinate + float(solved.x[1]) * width
    sample, jacobian = search.at(at), slopes(solved.x)
    here = value(sample.hill, solved.x)
    if not np.linalg.norm(np.linalg.solve(jacobian, here)) <= SOLVED_STEP:
        raise MeetingError("a multiplier that comes out of an arc is not found")
    moved = ERROR_SAFETY * sum(float(np.linalg.norm(value(hill, solved.x) - here)) for hill in others(sample))
    moved += DETERMINANT_ROUNDING * float(np.max(np.abs(jacobian)))
    error = float(np.linalg.norm(np.linalg.inv(jacobian)[1])) * moved
    return at, (error + ZERO_XTOL) * width, float(solved.x[0]) * middle.Omega


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
