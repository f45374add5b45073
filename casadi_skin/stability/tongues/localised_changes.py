"""Every change of localised multipliers along a branch of orbits at the edge of an endless linear medium.

Where a multiplier passes an end of a gap between arcs, or 1, a real function of the orbit is zero: these are sought on
all stretches on which ends of arcs keep their order. Ends meet where Omega has values in closed form. What else changes
the numbers of multipliers, two that meet or some that leave an arc, shows in these numbers on either side.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from casadi_skin.stability.result import ContinuousSpectrum
from casadi_skin.stability.tongues.diagram import (
    BAND_EDGE,
    COMPLEX,
    OVERLAP,
    REAL,
    RESONANCE,
    LocalisedChange,
    LocalisedDiagram,
)
from casadi_skin.stability.tongues.hill import HALF_END, START_END, Layout
from casadi_skin.stability.tongues.localised_counts import CountError, Counts
from casadi_skin.stability.tongues.localised_samples import EdgeBranch
from casadi_skin.stability.tongues.localised_search import (
    FAILURE_ERRORS,
    FINEST_STRETCH,
    MeetingError,
    Search,
    Zero,
    collision,
    mu_of,
    resonance,
    stretches,
    zeros_along,
)
from casadi_skin.zero.unresolved import Unresolved

NEAR_MEETING_FRACTION = 0.1  # of an interval between points: from where on two that meet are sought by Newton's method


def find_localised_changes(branch: EdgeBranch) -> LocalisedDiagram:
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
    ordered = sorted(search.found, key=lambda change: change.place.coordinate)
    unresolved = tuple(
        Unresolved(search.amplitude(start), search.amplitude(end), reason, coordinates=(start, end))
        for start, end, reason in search.gaps
    )
    return LocalisedDiagram(
        tuple(change for change in ordered if change.stable_before != change.stable_after),
        tuple(change for change in ordered if change.stable_before == change.stable_after),
        unresolved,
        len(search.known),
    )


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
        change = LocalisedChange(place, OVERLAP, mu_of(edge, here.Omega), (1, -1), one.off, one.off)
        search.found.append(change)


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
        two = not zeros and b - a <= NEAR_MEETING_FRACTION and abs(moved) == 2 and sum(map(abs, inside)) in (0, 2)
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
        self.search.found.append(LocalisedChange(place, kind, mu, signs, before, after))

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
        self.search.found.append(LocalisedChange(place, kind, mu, (1, -1), before.off, after.off))
        return True
