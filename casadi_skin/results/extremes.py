"""Smallest and largest values of the states of a solution, beyond the resolution of samples."""

from __future__ import annotations

import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.solution import Solution
from casadi_skin.zero.problem import Array

FINE = 16  # places an interval in which extremes are looked for


def extremes(solution: Solution) -> tuple[Array, Array]:
    """Smallest and largest value of each state over the interval or the period.

    The extremes of fine samples are moved to the vertex of the parabola through their neighbours and evaluated there.
    """
    t = _fine_times(solution)
    x = solution.evaluate(t)
    found = []
    for sign in (-1.0, 1.0):
        place = np.argmax(sign * x, axis=0)
        times = np.array([_vertex(t, x[:, i], k) for i, k in enumerate(place)])
        moved = np.diagonal(solution.evaluate(times))
        found.append(sign * np.maximum(sign * moved, sign * np.diagonal(x[place])))
    return found[0], found[1]


def _fine_times(solution: Solution) -> Array:
    edges = solution.mesh
    inner = edges[:-1, None] + np.diff(edges)[:, None] * np.arange(FINE) / FINE
    t = np.append(inner.ravel(), edges[-1])
    if not isinstance(solution, Orbit):
        return t
    copies = round(1.0 / solution.symmetry.value)  # the part that was unknown, mirrored or repeated over the period
    part = t[-1]
    whole = [k * part + (t if k % 2 == 0 else part - t[::-1]) for k in range(copies)]
    return np.unique(np.concatenate(whole))


def _vertex(t: Array, x: Array, k: int) -> float:
    """The vertex of the parabola through three samples; the sample itself at an end or on a line."""
    if k in (0, t.size - 1):
        return float(t[k])
    left, right = t[k - 1] - t[k], t[k + 1] - t[k]
    a, b = (x[k - 1] - x[k]) / left, (x[k + 1] - x[k]) / right
    curvature = (b - a) / (right - left)
    if curvature == 0.0:
        return float(t[k])
    slope = a - curvature * left
    return float(np.clip(t[k] - 0.5 * slope / curvature, t[k - 1], t[k + 1]))
