"""Zeros, along a branch, of the functions that vanish where a localised multiplier passes an end of a gap."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from casadi_skin.stability.localised_samples import functions_of
from casadi_skin.stability.localised_search import FINEST, PRECISE, ROUNDING, SAFETY, Search, layout_like, others

BEND = 0.3  # of the smaller end: what a function may do in between without being looked at


@dataclass(frozen=True)
class Zero:
    """A zero of one of the functions: its coordinate with error, and the function's name."""

    coordinate: float
    error: float
    name: str


def zeros_along(search: Search, places: Sequence[float]) -> list[Zero]:
    """All zeros of the functions of `Sample` on a stretch on which ends of arcs keep their order, ascending."""
    names = list(search.at(places[len(places) // 2]).functions)
    found = []
    for name in names:
        for a, b in pairwise(places):
            found += [_zero(search, name, *ends) for ends in _brackets(search, name, a, b)]
    return sorted(found, key=lambda zero: zero.coordinate)


def _value(search: Search, name: str, coordinate: float) -> float:
    return search.at(coordinate).functions[name]


def _brackets(search: Search, name: str, a: float, b: float) -> list[tuple[float, float]]:
    """Intervals at whose ends a function has opposite signs, after halving where it may come near zero."""
    first, last = _value(search, name, a), _value(search, name, b)
    if first * last < 0.0:
        return [(a, b)]
    if b - a <= FINEST or min(abs(first), abs(last)) > 0.5 * max(abs(first), abs(last)) > 0.0:
        return []
    middle = 0.5 * (a + b)
    bend = abs(first + last - 2.0 * _value(search, name, middle))
    if bend <= BEND * min(abs(first), abs(last)):
        return []
    return [*_brackets(search, name, a, middle), *_brackets(search, name, middle, b)]


def _zero(search: Search, name: str, a: float, b: float) -> Zero:
    from scipy.optimize import brentq

    at = float(brentq(lambda c: _value(search, name, float(c)), a, b, xtol=PRECISE * (b - a), rtol=4e-16 * 4))
    sample = search.at(at)
    step = 1e-3 * (b - a)
    sides = np.clip([at - step, at + step], a, b)
    slope = abs(_value(search, name, float(sides[1])) - _value(search, name, float(sides[0]))) / (sides[1] - sides[0])
    size = max(abs(_value(search, name, a)), abs(_value(search, name, b)))
    values = [functions_of(hill, layout_like(hill, sample))[name] for hill in others(sample)]
    error = SAFETY * sum(abs(other - sample.functions[name]) for other in values) + ROUNDING * size
    return Zero(at, float(error / slope) + PRECISE * (b - a), name)
