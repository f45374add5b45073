"""Zeros, along a branch, of the functions that vanish where a localised multiplier passes an end of a gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from casadi_skin.stability.tongues.localised_counts import function_of, names_of
from casadi_skin.stability.tongues.localised_search import (
    FINEST,
    PRECISE,
    ROUNDING,
    SAFETY,
    Search,
    layout_like,
    others,
)

BEND = 0.3  # of the smaller end: what a function may do in between without being looked at


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
    if b - a <= FINEST or min(abs(first), abs(last)) > 0.5 * max(abs(first), abs(last)) > 0.0:
        return []
    middle = 0.5 * (a + b)
    bend = abs(first + last - 2.0 * search.at(middle).function(name))
    if bend <= BEND * min(abs(first), abs(last)):
        return []
    return [*_brackets(search, name, a, middle), *_brackets(search, name, middle, b)]


def _zero(search: Search, name: str, a: float, b: float) -> Zero:
    """The zero between two places with values of opposite signs."""
    from scipy.optimize import brentq

    def value(c: float) -> float:
        return search.at(c).function(name)

    ends = [value(a), value(b)]
    at = float(brentq(lambda c: value(float(c)), a, b, xtol=PRECISE * (b - a), rtol=4e-16 * 4))
    sample, step = search.at(at), 1e-3 * (b - a)
    low, high = np.clip([at - step, at + step], a, b).tolist()
    slope = abs(value(high) - value(low)) / (high - low)
    away = sum(abs(function_of(hill, layout_like(hill, sample), name) - value(at)) for hill in others(sample))
    error = SAFETY * away + abs(value(at)) + ROUNDING * max(map(abs, ends))
    return Zero(at, float(error / slope) + PRECISE * (b - a), name)
