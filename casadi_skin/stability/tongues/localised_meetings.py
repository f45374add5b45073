"""Places on a branch where two localised multipliers meet, or one leaves the arcs: two equations, solved by Newton.

Two zeros c - sqrt(d), c + sqrt(d) of Hill's determinant are analytic in c and d, and d is zero where they meet, without
a square root. A complex multiplier that comes out of an arc is a zero of the limit of the determinant from above.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.polynomial.chebyshev import chebroots

from casadi_skin.stability.tongues import chebyshev
from casadi_skin.stability.tongues.hill import Hill
from casadi_skin.stability.tongues.localised_counts import Counts, Gap
from casadi_skin.stability.tongues.localised_search import PRECISE, ROUNDING, SAFETY, Search, layout_like, others
from casadi_skin.zero.problem import Array

STEPS = 12
REACH = 0.1  # to either side of a pair: where D is a series
DEGREE = 16
PARTS = 8  # of an interval, by which a pair is followed
DIFFERENCE = 1e-6  # of Omega, for derivatives
ARC = 100  # values under an arc among which the smallest determinant is sought


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
    for _ in range(STEPS):
        reach = max(REACH, 2.0 * float(np.sqrt(abs(pair.square))))
        first, last = max(pair.mean - reach, -1.0), min(pair.mean + reach, 0.0 if gap.mirrored else 1.0)
        if first >= last:
            break
        if gap.mirrored:
            last = min(last, -0.05 * REACH)
        middle, half = 0.5 * (first + last), 0.5 * (last - first)
        series = chebyshev.transform(DEGREE) @ gap.values(hill, middle + half * chebyshev.nodes(DEGREE))
        roots = middle + half * chebroots(series)
        one, other = roots[np.argsort(np.abs(roots - pair.mean))[:2]]
        found = Pair(float(np.real(0.5 * (one + other))), float(np.real(0.25 * (one - other) ** 2)))
        if abs(np.imag(one + other)) > PRECISE:
            break
        if abs(found.mean - pair.mean) <= 0.5 * reach:
            return found
        pair = found
    raise MeetingError("two multipliers that meet are not found")


def _least_under_arcs(hill: Hill, intervals: list[tuple[float, float]]) -> float:
    """The exponent under arcs at which a zero of the determinant is nearest, by |D / D'|."""
    best, where = np.inf, 0.0
    for start, end in intervals:
        sigma = 0.5 * (start + end) - 0.5 * (end - start) * np.cos(np.pi * (np.arange(ARC) + 0.5) / ARC)
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
    step, off = DIFFERENCE * hill_at(coordinate).Omega, 1e-3 * width

    def f(sigma: float, coordinate: float) -> Array:
        value = _values(hill_at(coordinate), np.array([sigma]), scale)[0]
        return np.array([value.real, np.imag(value)])

    for _ in range(STEPS):
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
        if abs(change[1]) <= 1e-9 * width or np.max(np.abs(change)) <= PRECISE:
            return sigma, coordinate, jacobian
    raise MeetingError("a multiplier that comes out of an arc is not found")


def collision(
    search: Search, a: float, before: Counts, b: float, after: Counts, gap: int
) -> tuple[float, float, float]:
    """Coordinate, error and exponent where two multipliers of a gap meet; raises MeetingError."""
    from scipy.optimize import brentq

    start, other, counts = (a, b, before) if before.off < after.off else (b, a, after)
    zeros = [_gap(search, start, gap).place(sigma) for sigma in counts.zeros[gap]]
    first, last = min(pairwise(zeros), key=lambda two: two[1] - two[0])
    pairs = {start: Pair(0.5 * (first + last), 0.25 * (last - first) ** 2)}

    def square(c: float) -> float:
        near = min(pairs, key=lambda known: abs(known - c))
        pairs[c] = _pair_near(search.at(c).hill, _gap(search, c, gap), pairs[near])
        return pairs[c].square

    for part in np.linspace(0.0, 1.0, PARTS + 1)[1:]:  # the pair, followed to the other end
        if square(start + float(part) * (other - start)) < 0.0:
            break
    else:
        raise MeetingError("two multipliers of a gap do not meet")
    end = start + float(part) * (other - start)
    at = float(brentq(lambda c: square(float(c)), start, end, xtol=PRECISE * abs(b - a), rtol=1e-15))
    here = pairs[min(pairs, key=lambda known: abs(known - at))]
    step = 1e-3 * (b - a)
    slope = abs(square(at + step) - square(at - step)) / (2.0 * step)
    sample = search.at(at)
    compared = [(hill, Gap(*layout_like(hill, sample).gaps[gap])) for hill in others(sample)]
    errors = [abs(_pair_near(hill, there, here).square - here.square) for hill, there in compared]
    sigma = float(_gap(search, at, gap).sigma(np.array([here.mean]))[0])
    return at, float((SAFETY * sum(errors) + ROUNDING) / slope) + PRECISE * (b - a), sigma


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
    moved = sum(abs(one - off[0]) for one in off[1:]) * ratio * SAFETY + ROUNDING * size
    error = float(np.linalg.norm(np.linalg.inv(jacobian)[1])) * moved
    return at, error + PRECISE * (b - a), sigma
