"""Every change of localised multipliers along a branch of orbits at the edge of an endless linear medium.

Where a multiplier passes an end of a gap between arcs, or 1, a real function of the orbit is zero: these are sought on
all stretches on which ends of arcs keep their order. Ends meet where Omega has values in closed form. What else changes
the numbers of multipliers, two that meet or some that leave an arc, shows in these numbers on either side.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.polynomial.chebyshev import chebroots

from casadi_skin.stability.flows import FlowError
from casadi_skin.stability.result import ContinuousSpectrum
from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.counts import (
    FILLED_GAP,
    NARROW_GAP,
    CountError,
    Counts,
    EdgeBranch,
    Gap,
    Sample,
    function_of,
    names_of,
    names_of_arcs,
)
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
from casadi_skin.stability.tongues.hill import HALF_END, START_END, Hill, Layout, crossings
from casadi_skin.zero.kinds import Unresolved
from casadi_skin.zero.problem import Array

ZERO_XTOL = 1e-12  # of an interval between points: where a zero is
FINEST_STRETCH = 1e-7  # of such an interval: stretches that are halved no further
ERROR_SAFETY = 2.0
DETERMINANT_ROUNDING = 1e-13  # of a determinant relative to its size
MORE_SIDEBANDS = 4  # sidebands that show the error of those left out
FAILURE_ERRORS = (ArithmeticError, np.linalg.LinAlgError, FlowError, RuntimeError)  # of orbits and linear algebra


@dataclass
class Search:
    """Orbits known so far, and what has been found."""

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

    def amplitude(self, coordinate: float) -> float:
        """S at a coordinate, to a few digits where no orbit is known there."""
        known = self.known.get(coordinate)
        return self.branch.amplitude(coordinate) if known is None else known.S

    def add(self, place: Place, kind: str, mu: float, signatures: tuple[int, ...], before: int, after: int) -> None:
        """Add a change, with the numbers of localised multipliers off the circle on either side."""
        sides = before == 0, after == 0
        self.found.append(StabilityEdge(place, kind, mu, signatures, *sides, 2, off_before=before, off_after=after))

    def place(self, coordinate: float, error: float) -> Place:
        """A place with the error of S, by its slope and bend."""
        points = self.branch.coordinates
        step = max(error, 1e-5)
        ends = np.clip([coordinate - step, coordinate + step], points[0], points[-1])
        here, sides = self.at(coordinate), [self.at(float(end)) for end in ends]
        change = max(abs(side.S - here.S) for side in sides) * error / step
        return Place(coordinate, error, here.S, change, here.Omega)


def others(sample: Sample) -> tuple[Hill, Hill]:
    """Equations that show the errors of an orbit's: those of the better orbit, and those with more sidebands."""
    return sample.better(), sample.hill.with_more(MORE_SIDEBANDS)


def layout_like(hill: Hill, sample: Sample) -> Layout:
    """Arcs for the frequency of equations like those of a sample."""
    return Layout(hill.Omega, sample.layout.bands)


def mu_of(sigma: float, Omega: float) -> float:
    """mu of an exponent: lambda + 1/lambda = 2 + 4 mu for the multiplier of half the period."""
    return -float(np.sin(0.5 * np.pi * sigma / Omega) ** 2)


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


# Places on a branch where two localised multipliers meet, or one leaves the arcs: two equations, solved by Newton -----

NEWTON_STEPS = 12
PAIR_REACH = 0.1  # to either side of a pair: where D is a series
PAIR_DEGREE = 16
INTERVAL_PARTS = 8  # of an interval, by which a pair is followed
SIGMA_DIFFERENCE = 1e-6  # of Omega, for derivatives
ARC_VALUES = 100  # values under an arc among which the smallest determinant is sought


class MeetingError(ArithmeticError):
    """No meeting is found."""


@dataclass(frozen=True)
class Pair:
    """Two zeros of a determinant in the variable of a gap: their mean and the square of half their difference."""

    mean: float
    square: float


def _values(hill: Hill, sigma: Array, scale: float) -> Array:
    """D over exp(scale) at values of sigma."""
    logs, phases = hill.determinant(sigma)
    return np.asarray(phases * np.exp(logs - scale))


def _pair_near(hill: Hill, gap: Gap, pair: Pair) -> Pair:
    """The pair of zeros near another, real or conjugate; raises MeetingError."""
    for _ in range(NEWTON_STEPS):
        reach = max(PAIR_REACH, 2.0 * float(np.sqrt(abs(pair.square))))
        first, last = max(pair.mean - reach, -1.0), min(pair.mean + reach, 0.0 if gap.mirrored else 1.0)
        if first >= last:
            break
        if gap.mirrored:
            last = min(last, -0.05 * PAIR_REACH)
        middle, half = 0.5 * (first + last), 0.5 * (last - first)
        series = chebyshev.transform(PAIR_DEGREE) @ gap.values(hill, middle + half * chebyshev.nodes(PAIR_DEGREE))
        roots = middle + half * chebroots(series)
        one, other = roots[np.argsort(np.abs(roots - pair.mean))[:2]]
        found = Pair(float(np.real(0.5 * (one + other))), float(np.real(0.25 * (one - other) ** 2)))
        if abs(np.imag(one + other)) > ZERO_XTOL:
            break
        if abs(found.mean - pair.mean) <= 0.5 * reach:
            return found
        pair = found
    raise MeetingError("two multipliers that meet are not found")


def _least_under_arcs(hill: Hill, intervals: list[tuple[float, float]]) -> float:
    """The exponent under arcs at which a zero of the determinant is nearest, by |D / D'|."""
    best, where = np.inf, 0.0
    for start, end in intervals:
        sigma = 0.5 * (start + end) - 0.5 * (end - start) * np.cos(np.pi * (np.arange(ARC_VALUES) + 0.5) / ARC_VALUES)
        logs, phases = hill.determinant(sigma)
        D = np.asarray(phases) * np.exp(logs - np.max(logs))
        slope = np.gradient(D, sigma)
        away = np.abs(D / slope)
        if np.min(away) < best:
            best, where = float(np.min(away)), float(sigma[np.argmin(away)])
    return where


def _zero_under_arc(
    hill_at: Callable[[float], Hill], sigma: float, coordinate: float, width: float
) -> tuple[float, float, Array]:
    """Exponent and coordinate where the determinant has a zero under an arc, with the Jacobian; raises MeetingError."""
    start, scale = coordinate, float(hill_at(coordinate).determinant(np.array([sigma]))[0][0])
    step, off = SIGMA_DIFFERENCE * hill_at(coordinate).Omega, 1e-3 * width

    def f(sigma: float, coordinate: float) -> Array:
        value = _values(hill_at(coordinate), np.array([sigma]), scale)[0]
        return np.array([value.real, np.imag(value)])

    for _ in range(NEWTON_STEPS):
        here = f(sigma, coordinate)
        jacobian = np.column_stack(
            [
                (f(sigma + step, coordinate) - f(sigma - step, coordinate)) / (2.0 * step),
                (f(sigma, coordinate + off) - f(sigma, coordinate - off)) / (2.0 * off),
            ]
        )
        change = np.linalg.solve(jacobian, here)
        sigma, coordinate = sigma - float(change[0]), coordinate - float(change[1])
        if abs(coordinate - start) > 4.0 * width:
            break
        if abs(change[1]) <= 1e-9 * width or np.max(np.abs(change)) <= ZERO_XTOL:
            return sigma, coordinate, jacobian
    raise MeetingError("a multiplier that comes out of an arc is not found")


def collision(
    search: Search, a: float, before: Counts, b: float, after: Counts, gap: int
) -> tuple[float, float, float]:
    """Coordinate, error and exponent where two multipliers of a gap meet; raises MeetingError."""
    start, other, counts = (a, b, before) if before.off < after.off else (b, a, after)
    zeros = [_gap(search, start, gap).place(sigma) for sigma in counts.zeros[gap]]
    first, last = min(pairwise(zeros), key=lambda two: two[1] - two[0])
    pairs = {start: Pair(0.5 * (first + last), 0.25 * (last - first) ** 2)}

    def square(c: float) -> float:
        near = min(pairs, key=lambda known: abs(known - c))
        pairs[c] = _pair_near(search.at(c).hill, _gap(search, c, gap), pairs[near])
        return pairs[c].square

    for part in np.linspace(0.0, 1.0, INTERVAL_PARTS + 1)[1:]:  # the pair, followed to the other end
        if square(start + float(part) * (other - start)) < 0.0:
            break
    else:
        raise MeetingError("two multipliers of a gap do not meet")
    end = start + float(part) * (other - start)

    def moved(c: float) -> float:
        here, sample = pairs[c], search.at(c)
        compared = [(hill, Gap(*layout_like(hill, sample).gaps[gap])) for hill in others(sample)]
        return sum(abs(_pair_near(hill, there, here).square - here.square) for hill, there in compared)

    at, error = zero_between(square, moved, min(start, end), max(start, end), 1.0)
    return at, error, float(_gap(search, at, gap).sigma(np.array([pairs[at].mean]))[0])


def _gap(search: Search, coordinate: float, number: int) -> Gap:
    return Gap(*search.at(coordinate).layout.gaps[number])


def resonance(search: Search, a: float, b: float) -> tuple[float, float, float]:
    """Coordinate, error and exponent where multipliers leave an arc; raises MeetingError."""
    middle = search.at(0.5 * (a + b))
    covered = [(s.sigma, e.sigma) for s, e, is_covered in middle.layout.intervals if is_covered]
    sigma = _least_under_arcs(middle.hill, covered)
    sigma, at, jacobian = _zero_under_arc(lambda c: search.at(c).hill, sigma, middle.coordinate, b - a)
    sample = search.at(at)
    size = float(np.max(np.abs(jacobian)))
    reference = sample.hill
    log = float(reference.determinant(np.array([sigma * (1.0 + 1e-3)]))[0][0])
    off = [_values(hill, np.array([sigma]), log)[0] for hill in (reference, *others(sample))]
    slope = _values(reference, np.array([sigma * (1.0 + 1e-6)]), log)[0] - off[0]
    per_sigma = abs(slope) / (sigma * 1e-6)
    ratio = float(np.linalg.norm(jacobian[:, 0])) / per_sigma  # of the two scales
    moved = sum(abs(one - off[0]) for one in off[1:]) * ratio * ERROR_SAFETY + DETERMINANT_ROUNDING * size
    error = float(np.linalg.norm(np.linalg.inv(jacobian)[1])) * moved
    return at, error + ZERO_XTOL * (b - a), sigma


# Stretches of a branch on which ends of the arcs of its continuous spectrum keep their order --------------------------

BAND_STRETCH_DISTANCE = 1e-3  # of an interval between points: where the frequency leaves a band, between two stretches
INSIDE_MEETING = 1e-6  # of an interval between points: how far from a meeting of arcs the ends of a stretch are
FILLED_TAIL_WORDS = "the orbit fills the tail, so that its changes depend on the length"


def stretches(search: Search) -> list[tuple[float, float]]:
    """Coordinates between which the names of layouts are the same."""
    places = search.branch.coordinates.tolist()
    bounds = [places[0]]
    for start, end in pairwise(places):
        try:
            found = _breaks(search, start, end)
        except FAILURE_ERRORS as error:
            found = [(start, end)]
            search.gaps.append((start, end, str(error)))
        for before, after in found:
            bounds += [before, after]
    bounds.append(places[-1])
    pairs = zip(bounds[::2], bounds[1::2], strict=True)
    return [(a, b) for a, b in pairs if b > a and _sought(search, a, b)]


def _sought(search: Search, start: float, end: float) -> bool:
    """Whether changes are sought on a stretch; one that is filled, or whose arcs are not found, is a gap."""
    try:
        names = names_of_arcs(search.layout(start))
    except FAILURE_ERRORS as error:
        search.gaps.append((start, end, str(error)))
        return False
    if names == (FILLED_GAP,):
        search.gaps.append((start, end, FILLED_TAIL_WORDS))
    return names not in ((FILLED_GAP,), (NARROW_GAP,))


def _breaks(search: Search, start: float, end: float) -> list[tuple[float, float]]:
    """Places between two points at which names change, from just before to just behind."""
    first, last = search.layout(start), search.layout(end)
    if names_of_arcs(first) == names_of_arcs(last) and not crossings(first, last):
        return []
    meetings = [start, *(_at_Omega(search, start, end, Omega) for Omega in crossings(first, last)), end]
    apart, found = INSIDE_MEETING * (end - start), list[tuple[float, float]]()
    for number, (a, b) in enumerate(pairwise(meetings)):
        if number:
            found.append((a - apart, a + apart))
            a += apart
        if number < len(meetings) - 2:
            b -= apart
        found += _by_halving(search, a, b)
    return sorted(found)


def _at_Omega(search: Search, start: float, end: float, Omega: float) -> float:
    from scipy.optimize import brentq

    return float(brentq(lambda c: search.layout(float(c)).Omega - Omega, start, end, xtol=1e-14, rtol=1e-14))


def _by_halving(search: Search, start: float, end: float) -> list[tuple[float, float]]:
    """Places at which the orbit's frequency leaves a band, or the gap beside it becomes wide enough."""
    if names_of_arcs(search.layout(start)) == names_of_arcs(search.layout(end)):
        return []
    if end - start <= BAND_STRETCH_DISTANCE:
        return [(start, end)]
    middle = 0.5 * (start + end)
    return [*_by_halving(search, start, middle), *_by_halving(search, middle, end)]


# Zeros, along a branch, of the functions that vanish where a localised multiplier passes an end of a gap --------------

LARGEST_BEND = 0.3  # of the smaller end: what a function may do in between without being looked at


@dataclass(frozen=True)
class Zero:
    """A zero of one of the functions: its coordinate with error, and the function's name."""

    coordinate: float
    error: float
    name: str


def zeros_along(search: Search, places: Sequence[float]) -> list[Zero]:
    """All zeros of the functions on a stretch on which ends of arcs keep their order, ascending."""
    found = []
    for name in names_of(search.at(places[len(places) // 2]).layout):
        for a, b in pairwise(places):
            found += [_zero(search, name, *ends) for ends in _brackets(search, name, a, b)]
    return sorted(found, key=lambda zero: zero.coordinate)


def _brackets(search: Search, name: str, a: float, b: float) -> list[tuple[float, float]]:
    """Intervals at whose ends a function has opposite signs, after halving where it may come near zero."""
    first, last = (search.at(c).function(name) for c in (a, b))
    if first * last < 0.0:
        return [(a, b)]
    if b - a <= FINEST_STRETCH or min(abs(first), abs(last)) > 0.5 * max(abs(first), abs(last)) > 0.0:
        return []
    middle = 0.5 * (a + b)
    bend = abs(first + last - 2.0 * search.at(middle).function(name))
    if bend <= LARGEST_BEND * min(abs(first), abs(last)):
        return []
    return [*_brackets(search, name, a, middle), *_brackets(search, name, middle, b)]


def _zero(search: Search, name: str, a: float, b: float) -> Zero:
    """The zero between two places with values of opposite signs."""

    def value(c: float) -> float:
        return search.at(c).function(name)

    def moved(c: float) -> float:
        sample = search.at(c)
        return sum(abs(function_of(hill, layout_like(hill, sample), name) - value(c)) for hill in others(sample))

    return Zero(*zero_between(value, moved, a, b, max(abs(value(a)), abs(value(b)))), name)


# Every change of localised multipliers along a branch of orbits at the edge of an endless linear medium ---------------

NEAR_MEETING = 0.1  # of an interval between points: from where on two that meet are sought by Newton's method


def find_localised_changes(branch: EdgeBranch) -> StabilityDiagram:
    """Find every change of localised multipliers along a branch.

    Arguments:
        branch: gives orbits at any coordinate along it.

    Returns:
        Changes, with those that do not alter stability, and what is unresolved.
    """
    search = Search(branch)
    divided = stretches(search)
    looked = []
    for start, end in divided:
        looked.append(_Stretch(search, start, end))
        try:
            looked[-1].look()
        except FAILURE_ERRORS as error:
            search.gaps.append((start, end, str(error)))
    for before, after in pairwise(looked):
        missing = (before.end, after.start)
        if missing in {(a, b) for a, b, _ in search.gaps}:
            continue
        try:
            _across(search, before, after)
        except FAILURE_ERRORS as error:
            search.gaps.append((*missing, str(error)))
    ordered = tuple(sorted(search.found, key=lambda change: change.place.coordinate))
    unresolved = tuple(
        Unresolved(search.amplitude(start), search.amplitude(end), reason, coordinates=(start, end))
        for start, end, reason in search.gaps
    )
    return StabilityDiagram(ordered, unresolved, len(search.known), localised=True)


def _across(search: Search, before: _Stretch, after: _Stretch) -> None:
    """What changes where ends of arcs meet: an overlap begins or ends; numbers of multipliers must not change."""
    if not before.counted or not after.counted:
        search.gaps.append((before.end, after.start, "localised multipliers cannot be counted"))
        return
    (start, one), (end, other) = before.counted[-1], after.counted[0]
    if (one.off, sum(one.inside)) != (other.off, sum(other.inside)):
        search.gaps.append((start, end, "numbers of localised multipliers change where ends of arcs meet"))
    sides = [_overlaps(search.at(c).layout) for c in (before.end, after.start)]
    here = search.at(0.5 * (before.end + after.start))
    for bands, order in sorted(sides[0] ^ sides[1]):
        edges = [(here.layout.bands[bands[0]][k], here.layout.bands[bands[1]][k]) for k in (0, 1)]
        edge = min(edges, key=lambda two: abs(sum(two) - 2.0 * order * here.Omega))[0]
        place = search.place(here.coordinate, 0.5 * (after.start - before.end))
        search.add(place, OVERLAP, mu_of(edge, here.Omega), (1, -1), one.off, one.off)


def _overlaps(layout: Layout) -> set[tuple[tuple[int, int], int]]:
    return {(o.bands, o.order) for o in ContinuousSpectrum(layout.Omega, layout.bands, 2).overlaps}


# One stretch ----------------------------------------------------------------------------------------------------------


class _Stretch:
    """A stretch of branch on which ends of arcs keep their order."""

    def __init__(self, search: Search, start: float, end: float) -> None:
        self.search, self.start, self.end = search, start, end
        inside = [c for c in search.branch.coordinates.tolist() if start < c < end]
        self.places = [start, *inside, end]
        self.counted = list[tuple[float, Counts]]()
        if len(self.places) == 2:
            self.places = np.linspace(start, end, 5).tolist()

    def look(self) -> None:
        """Find everything that changes."""
        zeros = zeros_along(self.search, self.places)
        checks = sorted({*self.places, *(0.5 * (a.coordinate + b.coordinate) for a, b in pairwise(zeros))})
        near = {zero.coordinate for zero in zeros}
        checks = [c for c in checks if c not in near]
        self.counted = [(c, counts) for c in checks if (counts := self._counts(c)) is not None]
        if 2 * len(self.counted) < len(checks):
            self.search.gaps.append((self.start, self.end, "localised multipliers cannot be counted"))
        for (a, before), (b, after) in pairwise(self.counted):
            self._between(a, before, b, after, [zero for zero in zeros if a < zero.coordinate < b])

    def _counts(self, coordinate: float) -> Counts | None:
        try:
            return self.search.at(coordinate).counts
        except CountError:
            return None

    # Numbers of multipliers -------------------------------------------------------------------------------------------

    def _between(self, a: float, before: Counts, b: float, after: Counts, zeros: Sequence[Zero]) -> None:
        """What changes the numbers between two places."""
        moved = after.off - before.off
        inside = [n - m for m, n in zip(before.inside, after.inside, strict=True)]
        if not zeros and moved == 0 and not any(inside):
            return
        if len(zeros) == 1 and self._explains(zeros[0], moved, inside):
            self._add(zeros[0], before.off, after.off)
            return
        two = not zeros and b - a <= NEAR_MEETING and abs(moved) == 2 and sum(map(abs, inside)) in (0, 2)
        if two and self._meeting(a, before, b, after, inside):
            return
        if b - a <= FINEST_STRETCH:
            words = f"localised multipliers off the circle change from {before.off} to {after.off}"
            self.search.gaps.append((a, b, f"{words}, in gaps by {sum(inside)}"))
            for zero in zeros:
                self._add(zero, before.off, after.off)
            return
        middle = self._middle(a, b, zeros)
        half = self._counts(middle)
        if half is None:
            self.search.gaps.append((a, b, "localised multipliers cannot be counted"))
            return
        self._between(a, before, middle, half, [zero for zero in zeros if zero.coordinate < middle])
        self._between(middle, half, b, after, [zero for zero in zeros if zero.coordinate >= middle])

    def _middle(self, a: float, b: float, zeros: Sequence[Zero]) -> float:
        """A place between, away from zeros."""
        middle = 0.5 * (a + b)
        near = [zero for zero in zeros if abs(zero.coordinate - middle) < 0.01 * (b - a)]
        return middle + 0.05 * (b - a) if near else middle

    def _explains(self, zero: Zero, moved: int, inside: Sequence[int]) -> bool:
        """Whether a zero changes the numbers by what they change."""
        layout = self.search.at(zero.coordinate).layout
        changed = [number for number, change in enumerate(inside) if change]
        if zero.name.startswith((START_END, HALF_END)):
            gap = 0 if zero.name.startswith(START_END) else len(layout.gaps) - 1
            if zero.name == START_END or (zero.name.startswith(HALF_END) and layout.pinned):
                return abs(moved) == 1 and not changed
            return abs(moved) == 1 and changed == [gap] and inside[gap] == -moved
        return moved == 0 and len(changed) == 1 and abs(inside[changed[0]]) == 1

    def _add(self, zero: Zero, before: int, after: int) -> None:
        layout = self.search.at(zero.coordinate).layout
        if zero.name.startswith((START_END, HALF_END)):
            mu, kind, signs = (0.0 if zero.name.startswith(START_END) else -1.0), REAL, tuple[int, ...]()
        else:
            (end,) = (end for end in layout.ends if end.name == zero.name)
            mu, kind = mu_of(end.sigma, layout.Omega), BAND_EDGE
            signs = (1 if end.turns % 2 == 0 else -1,)
        place = self.search.place(zero.coordinate, zero.error)
        self.search.add(place, kind, mu, signs, before, after)

    def _meeting(self, a: float, before: Counts, b: float, after: Counts, inside: Sequence[int]) -> bool:
        """A collision in a gap, or multipliers that leave an arc, located; false where the interval is too long."""
        try:
            if any(inside):
                gap = next(number for number, change in enumerate(inside) if change)
                if inside[gap] != before.off - after.off:
                    return False
                kind, (coordinate, error, sigma) = COMPLEX, collision(self.search, a, before, b, after, gap)
            else:
                kind, (coordinate, error, sigma) = RESONANCE, resonance(self.search, a, b)
        except (MeetingError, np.linalg.LinAlgError):
            return False
        if not a <= coordinate <= b:
            return False
        mu = mu_of(sigma, self.search.at(coordinate).Omega)
        place = self.search.place(coordinate, error)
        self.search.add(place, kind, mu, (1, -1), before.off, after.off)
        return True
