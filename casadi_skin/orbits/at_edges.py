"""Orbits at the edges of tongues of a family, and edges that are one within their errors."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from casadi_skin.orbits.orbit import Orbit
from casadi_skin.orbits.space import SolutionSpace
from casadi_skin.stability.tongues import StabilityEdge

NEAR = 1e-6  # relative difference of Omega: the orbit of an edge
BESIDE = 1e-4  # of S: how far the orbits on both sides are, whose cubic is good to some 1e-13


class Passes(Protocol):
    """A branch that corrects orbits at any S."""

    @property
    def space(self) -> SolutionSpace: ...

    def at(self, value: float | None = None, which: int = 0, **named: float) -> Any: ...


def separate(edges: Iterable[StabilityEdge]) -> list[StabilityEdge]:
    """Edges in order of the branch; of those that follow one another at one mu within their errors, the most exact.

    Two multipliers that a symmetry makes equal cross at one place; and where a family crosses one whose period is a
    third of its own, tongues touch, and the window between them has no width (Meyer 1970).
    """
    groups: list[list[StabilityEdge]] = []
    for edge in sorted(edges, key=lambda edge: edge.place.coordinate):
        last = groups[-1][-1] if groups else None
        if last is not None and last.mu == edge.mu and not _apart(last, edge):
            groups[-1].append(edge)
        else:
            groups.append([edge])
    return [min(group, key=lambda edge: edge.error) for group in groups]


def _apart(one: StabilityEdge, other: StabilityEdge) -> bool:
    errors = one.place.coordinate_error + other.place.coordinate_error
    return abs(one.place.coordinate - other.place.coordinate) > errors


def orbit_at_edge(branch: Passes, edge: StabilityEdge) -> Orbit | None:
    """The orbit at an edge; None where the continuation did not come by."""
    with suppress(ArithmeticError, ValueError):
        return _passing(branch, edge, edge.S, NEAR)
    return between(branch, edge)


def _passing(branch: Passes, edge: StabilityEdge, S: float, near: float) -> Orbit:
    """The orbit at an S on the part of a branch that an edge is on; raises ValueError or ArithmeticError without."""
    for which in itertools.count():
        found: Orbit = branch.at(S, which)
        if abs(found.Omega - edge.Omega) <= near * edge.Omega:
            return found
    raise AssertionError


def between(branch: Passes, edge: StabilityEdge) -> Orbit | None:
    """The orbit at an edge where its equations are singular, by the curve of the family from one side to the other."""
    with suppress(ArithmeticError, ValueError):
        before, after = (_passing(branch, edge, edge.S * (1.0 + h), 2.0 * BESIDE).point for h in (-BESIDE, BESIDE))
        curve, length = branch.space.point_solver.curve(before, after)
        (place,) = curve.crossings(*branch.space.target("S", edge.S).unknown(after.problem), length)
        tangent = curve.slope(place) * np.linalg.norm(after.tangent) / np.linalg.norm(curve.slope(place))
        return Orbit(branch.space, replace(after, z=curve.at(place), tangent=tangent, better=None))
    return None
