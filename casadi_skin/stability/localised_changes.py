"""Every change of localised multipliers along a branch of orbits at the edge of an endless linear medium.

Where a multiplier passes an end of a gap between arcs, or 1, a real function of the orbit is zero: these are sought on
all stretches on which ends of arcs keep their order. Ends meet where Omega has values in closed form. What else changes
the numbers of multipliers, two that meet or some that leave an arc, shows in these numbers on either side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from casadi_skin.stability.continuous import ContinuousSpectrum
from casadi_skin.stability.flow import FlowError
from casadi_skin.stability.gaps import HALF, START, Layout, crossings
from casadi_skin.stability.hill import Hill
from casadi_skin.stability.localised_counts import CountError, Counts, Gap
from casadi_skin.stability.localised_diagram import (
    BAND_EDGE,
    COMPLEX,
    OVERLAP,
    REAL,
    RESONANCE,
    LocalisedChange,
    LocalisedDiagram,
)
from casadi_skin.stability.localised_meetings import MeetingError, Pair, least_under_arcs, pair_near, resonance, values
from casadi_skin.stability.localised_samples import FILLS, NARROW_GAP, EdgeBranch, Sample, functions_of
from casadi_skin.stability.tongues import Place, Unresolved

PRECISE = 1e-12  # of an interval between points: where a zero is
INSIDE = 1e-6  # of such an interval: how far from a meeting of arcs the ends of a stretch are
FINEST = 1e-7  # of an interval: stretches that are halved no further
NEAR = 0.1  # of such an interval: from where on two that meet are sought by Newton's method
BEND = 0.3  # of the smaller end: what a function may do in between without being looked at
SAFETY = 2.0
ROUNDING = 1e-13  # of a determinant relative to its size
MORE = 4  # sidebands that show the error of those left out
FILLED = "the orbit fills the tail, so that its changes depend on the length"
FAILURES = (ArithmeticError, np.linalg.LinAlgError, FlowError, RuntimeError)


@dataclass(frozen=True)
class Zero:
    """A zero of one of the functions: its coordinate with error, and the function's name."""

    coordinate: float
    error: float
    name: str


@dataclass
class _Search:
    """Orbits known so far, and what has been found."""

    branch: EdgeBranch
    known: dict[float, Sample] = field(default_factory=dict)
    found: list[LocalisedChange] = field(default_factory=list)
    gaps: list[tuple[float, float, str]] = field(default_factory=list)

    def at(self, coordinate: float) -> Sample:
        """The orbit at a coordinate, solved once."""
        if coordinate not in self.known:
            self.known[coordinate] = self.branch.sample(coordinate)
        return self.known[coordinate]

    def place(self, coordinate: float, error: float) -> Place:
        """A place with the error of S, by its slope and bend."""
        points = self.branch.coordinates
        step = max(error, 1e-5)
        ends = np.clip([coordinate - step, coordinate + step], points[0], points[-1])
        here, sides = self.at(coordinate), [self.at(float(end)) for end in ends]
        change = max(abs(side.S - here.S) for side in sides) * error / step
        return Place(coordinate, error, here.S, change, here.Omega)


def find_localised_changes(branch: EdgeBranch) -> LocalisedDiagram:
    """Find every change of localised multipliers along a branch.

    Arguments:
        branch: gives orbits at any coordinate along it.

    Returns:
        Changes, with those that do not alter stability, and what is unresolved.
    """
    search = _Search(branch)
    stretches = _stretches(search)
    looked = []
    for start, end in stretches:
        looked.append(_Stretch(search, start, end))
        try:
            looked[-1].look()
        except FAILURES as error:
            search.gaps.append((start, end, str(error)))
    for before, after in pairwise(looked):
        _across(search, before, after)
    ordered = sorted(search.found, key=lambda change: change.place.coordinate)
    unresolved = tuple(
        Unresolved(search.at(start).S, search.at(end).S, start, end, reason) for start, end, reason in search.gaps
    )
    return LocalisedDiagram(
        tuple(change for change in ordered if change.stable_before != change.stable_after),
        tuple(change for change in ordered if change.stable_before == change.stable_after),
        unresolved,
        len(search.known),
    )


# Stretches on which ends of arcs keep their order ---------------------------------------------------------------------


def _stretches(search: _Search) -> list[tuple[float, float]]:
    """Coordinates between which the names of layouts are the same."""
    places = search.branch.coordinates.tolist()
    bounds = [places[0]]
    for start, end in pairwise(places):
        for before, after in _breaks(search, start, end):
            bounds += [before, after]
    bounds.append(places[-1])
    pairs = list(zip(bounds[::2], bounds[1::2], strict=True))
    pairs = [(a, b) for a, b in pairs if b > a]
    search.gaps += [(a, b, FILLED) for a, b in pairs if search.at(a).names == (FILLS,)]
    return [(a, b) for a, b in pairs if search.at(a).names not in ((FILLS,), (NARROW_GAP,))]


def _breaks(search: _Search, start: float, end: float) -> list[tuple[float, float]]:
    """Places between two points at which names change, from just before to just behind."""
    first, last = search.at(start), search.at(end)
    if first.names == last.names and not crossings(first.layout, last.layout):
        return []
    meetings = [start, *(_at_Omega(search, start, end, Omega) for Omega in crossings(first.layout, last.layout)), end]
    apart, found = INSIDE * (end - start), list[tuple[float, float]]()
    for number, (a, b) in enumerate(pairwise(meetings)):
        if number:
            found.append((a - apart, a + apart))
            a += apart
        if number < len(meetings) - 2:
            b -= apart
        found += _by_halving(search, a, b)
    return sorted(found)


def _at_Omega(search: _Search, start: float, end: float, Omega: float) -> float:
    from scipy.optimize import brentq

    return float(brentq(lambda c: search.at(float(c)).Omega - Omega, start, end, xtol=1e-14, rtol=1e-14))


def _by_halving(search: _Search, start: float, end: float) -> list[tuple[float, float]]:
    """Places at which the orbit's frequency leaves a band, or the gap beside it becomes wide enough."""
    if search.at(start).names == search.at(end).names:
        return []
    if end - start <= FINEST:
        return [(start, end)]
    middle = 0.5 * (start + end)
    return [*_by_halving(search, start, middle), *_by_halving(search, middle, end)]


def _across(search: _Search, before: _Stretch, after: _Stretch) -> None:
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
        change = LocalisedChange(place, OVERLAP, _mu(edge, here.Omega), (1, -1), one.off, one.off)
        search.found.append(change)


def _overlaps(layout: Layout) -> set[tuple[tuple[int, int], int]]:
    return {(o.bands, o.order) for o in ContinuousSpectrum(layout.Omega, layout.bands, 2).overlaps}


# One stretch ----------------------------------------------------------------------------------------------------------


class _Stretch:
    """A stretch of branch on which ends of arcs keep their order."""

    def __init__(self, search: _Search, start: float, end: float) -> None:
        self.search, self.start, self.end = search, start, end
        inside = [c for c in search.branch.coordinates.tolist() if start < c < end]
        self.places = [start, *inside, end]
        self.counted = list[tuple[float, Counts]]()
        if len(self.places) == 2:
            self.places = np.linspace(start, end, 5).tolist()

    def look(self) -> None:
        """Find everything that changes."""
        zeros = sorted(self._zeros(), key=lambda zero: zero.coordinate)
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

    # Zeros of functions -----------------------------------------------------------------------------------------------

    def _zeros(self) -> list[Zero]:
        """All zeros of the functions of `Sample`."""
        names = list(self.search.at(self.places[len(self.places) // 2]).functions)
        found = []
        for name in names:
            for a, b in pairwise(self.places):
                found += [self._zero(name, *ends) for ends in self._brackets(name, a, b)]
        return found

    def _value(self, name: str, coordinate: float) -> float:
        return self.search.at(coordinate).functions[name]

    def _brackets(self, name: str, a: float, b: float) -> list[tuple[float, float]]:
        """Intervals at whose ends a function has opposite signs, after halving where it may come near zero."""
        first, last = self._value(name, a), self._value(name, b)
        if first * last < 0.0:
            return [(a, b)]
        if b - a <= FINEST or min(abs(first), abs(last)) > 0.5 * max(abs(first), abs(last)) > 0.0:
            return []
        middle = 0.5 * (a + b)
        bend = abs(first + last - 2.0 * self._value(name, middle))
        if bend <= BEND * min(abs(first), abs(last)):
            return []
        return [*self._brackets(name, a, middle), *self._brackets(name, middle, b)]

    def _zero(self, name: str, a: float, b: float) -> Zero:
        from scipy.optimize import brentq

        at = float(brentq(lambda c: self._value(name, float(c)), a, b, xtol=PRECISE * (b - a), rtol=4e-16 * 4))
        sample = self.search.at(at)
        step = 1e-3 * (b - a)
        sides = np.clip([at - step, at + step], a, b)
        slope = abs(self._value(name, float(sides[1])) - self._value(name, float(sides[0]))) / (sides[1] - sides[0])
        size = max(abs(self._value(name, a)), abs(self._value(name, b)))
        others = [functions_of(hill, _layout(hill, sample))[name] for hill in _others(sample)]
        error = SAFETY * sum(abs(other - sample.functions[name]) for other in others) + ROUNDING * size
        return Zero(at, float(error / slope) + PRECISE * (b - a), name)

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
        two = not zeros and b - a <= NEAR and abs(moved) == 2 and sum(map(abs, inside)) in (0, 2)
        if two and self._meeting(a, before, b, after, inside):
            return
        if b - a <= FINEST:
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
        if zero.name.startswith((START, HALF)):
            gap = 0 if zero.name.startswith(START) else len(layout.gaps) - 1
            if zero.name == START or (zero.name.startswith(HALF) and layout.pinned):
                return abs(moved) == 1 and not changed
            return abs(moved) == 1 and changed == [gap] and inside[gap] == -moved
        return moved == 0 and len(changed) == 1 and abs(inside[changed[0]]) == 1

    def _add(self, zero: Zero, before: int, after: int) -> None:
        layout = self.search.at(zero.coordinate).layout
        if zero.name.startswith((START, HALF)):
            mu, kind, signs = (0.0 if zero.name.startswith(START) else -1.0), REAL, tuple[int, ...]()
        else:
            (end,) = (end for end in layout.ends if end.name == zero.name)
            mu, kind = _mu(end.sigma, layout.Omega), BAND_EDGE
            signs = (1 if end.turns % 2 == 0 else -1,)
        place = self.search.place(zero.coordinate, zero.error)
        self.search.found.append(LocalisedChange(place, kind, mu, signs, before, after))

    def _meeting(self, a: float, before: Counts, b: float, after: Counts, inside: Sequence[int]) -> bool:
        """A collision in a gap, or multipliers that leave an arc, located; false where the interval is too long."""
        try:
            if any(inside):
                gap = next(number for number, change in enumerate(inside) if change)
                if inside[gap] != before.off - after.off:
                    return False
                kind, (coordinate, error, sigma) = COMPLEX, self._collision(a, before, b, after, gap)
            else:
                kind, (coordinate, error, sigma) = RESONANCE, self._resonance(a, before, b, after)
        except (MeetingError, np.linalg.LinAlgError):
            return False
        if not a <= coordinate <= b:
            return False
        mu = _mu(sigma, self.search.at(coordinate).Omega)
        place = self.search.place(coordinate, error)
        self.search.found.append(LocalisedChange(place, kind, mu, (1, -1), before.off, after.off))
        return True

    def _collision(self, a: float, before: Counts, b: float, after: Counts, gap: int) -> tuple[float, float, float]:
        """Coordinate, error and exponent where two multipliers of a gap meet."""
        from scipy.optimize import brentq

        start, other, counts = (a, b, before) if before.off < after.off else (b, a, after)
        zeros = [self._gap(start, gap).place(sigma) for sigma in counts.zeros[gap]]
        first, last = min(pairwise(zeros), key=lambda two: two[1] - two[0])
        pairs = {start: Pair(0.5 * (first + last), 0.25 * (last - first) ** 2)}

        def square(c: float) -> float:
            near = min(pairs, key=lambda known: abs(known - c))
            pairs[c] = pair_near(self.search.at(c).hill, self._gap(c, gap), pairs[near])
            return pairs[c].square

        for part in np.linspace(0.0, 1.0, 9)[1:]:  # the pair, followed to the other end
            if square(start + float(part) * (other - start)) < 0.0:
                break
        else:
            raise MeetingError("two multipliers of a gap do not meet")
        end = start + float(part) * (other - start)
        at = float(brentq(lambda c: square(float(c)), start, end, xtol=PRECISE * abs(b - a), rtol=1e-15))
        here = pairs[min(pairs, key=lambda known: abs(known - at))]
        step = 1e-3 * (b - a)
        slope = abs(square(at + step) - square(at - step)) / (2.0 * step)
        sample = self.search.at(at)
        others = [(hill, Gap(*_layout(hill, sample).gaps[gap])) for hill in _others(sample)]
        errors = [abs(pair_near(hill, there, here).square - here.square) for hill, there in others]
        sigma = float(self._gap(at, gap).sigma(np.array([here.mean]))[0])
        return at, float((SAFETY * sum(errors) + ROUNDING) / slope) + PRECISE * (b - a), sigma

    def _gap(self, coordinate: float, number: int) -> Gap:
        return Gap(*self.search.at(coordinate).layout.gaps[number])

    def _resonance(self, a: float, before: Counts, b: float, after: Counts) -> tuple[float, float, float]:
        """Coordinate, error and exponent where multipliers leave an arc."""
        middle = self.search.at(0.5 * (a + b))
        covered = [(s.sigma, e.sigma) for s, e, is_covered in middle.layout.intervals if is_covered]
        sigma = least_under_arcs(middle.hill, covered)
        sigma, at, jacobian = resonance(lambda c: self.search.at(c).hill, sigma, middle.coordinate, b - a)
        sample = self.search.at(at)
        scale = float(sample.hill.determinant(np.array([sigma]))[0][0])
        size = float(np.max(np.abs(jacobian)))
        missed = np.array([0.0 + 0.0j])
        del scale, missed
        reference = sample.hill
        log = float(reference.determinant(np.array([sigma * (1.0 + 1e-3)]))[0][0])
        off = [values(hill, np.array([sigma]), log)[0] for hill in (reference, *_others(sample))]
        slope = values(reference, np.array([sigma * (1.0 + 1e-6)]), log)[0] - off[0]
        per_sigma = abs(slope) / (sigma * 1e-6)
        ratio = float(np.linalg.norm(jacobian[:, 0])) / per_sigma  # of the two scales
        moved = sum(abs(one - off[0]) for one in off[1:]) * ratio * SAFETY + ROUNDING * size
        error = float(np.linalg.norm(np.linalg.inv(jacobian)[1])) * moved
        return at, error + PRECISE * (b - a), sigma


def _others(sample: Sample) -> tuple[Hill, Hill]:
    """Equations that show the errors of an orbit's: those of the better orbit, and those with more sidebands."""
    return sample.better(), sample.hill.with_more(MORE)


def _layout(hill: Hill, sample: Sample) -> Layout:
    """Arcs for the frequency of equations like those of a sample."""
    return Layout(hill.Omega, sample.layout.bands)


def _mu(sigma: float, Omega: float) -> float:
    return -float(np.sin(0.5 * np.pi * sigma / Omega) ** 2)
