"""Stretches of a branch on which ends of the arcs of its continuous spectrum keep their order.

Ends meet where Omega has values in closed form; a branch is divided there, and where its frequency leaves a band.
"""

from __future__ import annotations

from itertools import pairwise

from casadi_skin.stability.tongues.gaps import crossings
from casadi_skin.stability.tongues.localised_samples import FILLS, NARROW_GAP, names_of_arcs
from casadi_skin.stability.tongues.localised_search import FAILURES, Search

APART = 1e-3  # of an interval between points: where the frequency leaves a band, between two stretches
INSIDE = 1e-6  # of an interval between points: how far from a meeting of arcs the ends of a stretch are
FILLED = "the orbit fills the tail, so that its changes depend on the length"


def stretches(search: Search) -> list[tuple[float, float]]:
    """Coordinates between which the names of layouts are the same."""
    places = search.branch.coordinates.tolist()
    bounds = [places[0]]
    for start, end in pairwise(places):
        try:
            found = _breaks(search, start, end)
        except FAILURES as error:
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
    except FAILURES as error:
        search.gaps.append((start, end, str(error)))
        return False
    if names == (FILLS,):
        search.gaps.append((start, end, FILLED))
    return names not in ((FILLS,), (NARROW_GAP,))


def _breaks(search: Search, start: float, end: float) -> list[tuple[float, float]]:
    """Places between two points at which names change, from just before to just behind."""
    first, last = search.layout(start), search.layout(end)
    if names_of_arcs(first) == names_of_arcs(last) and not crossings(first, last):
        return []
    meetings = [start, *(_at_Omega(search, start, end, Omega) for Omega in crossings(first, last)), end]
    apart, found = INSIDE * (end - start), list[tuple[float, float]]()
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
    if end - start <= APART:
        return [(start, end)]
    middle = 0.5 * (start + end)
    return [*_by_halving(search, start, middle), *_by_halving(search, middle, end)]
