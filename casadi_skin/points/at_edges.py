"""Orbits at the edges of tongues of a family."""

from __future__ import annotations

import itertools
from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.settings import Point
from casadi_skin.follow.space import SolutionSpace
from casadi_skin.stability.tongues.diagram import StabilityEdge

NEAR = 1e-6  # relative difference of Omega: the orbit of an edge
BESIDE = 1e-4  # of S: how far the orbits on both sides are, whose cubic is good to some 1e-13


class Passes(Protocol):
    """A branch that corrects orbits at any S."""

    @property
    def space(self) -> SolutionSpace: ...

    def at(self, value: float | None = None, which: int = 0, **named: float) -> Any: ...


def orbit_at_edge(branch: Passes, edge: StabilityEdge) -> Orbit:
    """The orbit at an edge; raises ArithmeticError with the reason where none is found, there or from both sides."""
    try:
        return _passing(branch, edge, edge.S, NEAR)
    except (ArithmeticError, ValueError) as error:
        reason = str(error)
    found = between(branch, edge)
    if found is None:
        raise ArithmeticError(f"no orbit is found at the edge at S = {edge.S:.10g}, nor on both sides of it: {reason}")
    return found


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
        return Orbit(branch.space, along_curve(branch.space, before, after, edge.S))
    return None


def along_curve(space: SolutionSpace, before: Point, after: Point, S: float) -> Point:
    """The orbit at S by the curve from an orbit on one side to one on the other; raises ValueError without one."""
    curve, length = space.point_solver.curve(before, after)
    (place,) = curve.crossings(*space.target("S", S).unknown(after.problem), length)
    tangent = curve.slope(place) * np.linalg.norm(after.tangent) / np.linalg.norm(curve.slope(place))
    return replace(after, z=curve.at(place), tangent=tangent, better=None)
