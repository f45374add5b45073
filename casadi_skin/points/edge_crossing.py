"""Edges that coincide where a family crosses one of an m-th of its period, followed as its resonance.

The orbit there is one of the shorter period, run through m times. Two of its multipliers are m-th roots of 1, or of -1,
so that their m-th powers coincide: one tongue closes where the next one opens, and the window between has no width (for
m = 3 see Meyer 1970). This is so on a whole curve, on which a multiplier of the shorter orbit has one value: a simple
zero, where edges of the longer orbit are a double one and its equations are singular.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np

from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.points.breaking import turns_of
from casadi_skin.points.edge_curve import FINE, WELL, EdgePoint, EdgeWalk
from casadi_skin.points.edge_fold import multipliers_of
from casadi_skin.points.edge_orbits import orbit_at
from casadi_skin.stability.tongues.diagram import Place, StabilityEdge
from casadi_skin.stability.tongues.find_changes import POWERS
from casadi_skin.zero.orbit import FirstOrderProblem
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point
from casadi_skin.zero.trigonometric import TrigonometricProblem

AGREE = 1e-6  # of S: within which the crossing that a curve starts from is found again
BESIDE = 1e-4  # of S: the second place of the secant method
SOLVED = 1e-13  # of S
LONGEST = 0.02  # of S: how far a crossing may be from where it is expected
REAL = 1e-9  # imaginary part of a mu that is real
INSTANT = 1e-5  # of a phase, for velocities


class CrossingWalk(EdgeWalk):
    """Iterates over the orbits of the shorter period whose multipliers are roots of 1 or -1, along a parameter."""

    def __init__(self, orbit: Orbit, *arguments: Any) -> None:
        self._turns, self._target = turns_of(orbit), np.nan
        super().__init__(orbit, *arguments)

    def _guess(self, orbit: Orbit) -> Point:
        """The orbit of the shorter period; the multiplier that decides is the one nearest to a root."""
        family = cast(Family, orbit.space).whole
        point = orbit_at(family, orbit.S, shortened(super()._guess(orbit), self._turns))
        mu = multipliers_of(family, point)
        angles = np.arccos(1.0 + 2.0 * np.clip(mu[np.abs(mu.imag) <= REAL].real, -1.0, 0.0))
        roots = np.pi * np.arange(1, self._turns) / self._turns
        nearest = roots[np.argmin(np.min(np.abs(roots[:, None] - angles), axis=1, initial=np.inf))]
        self._target = -(float(np.sin(0.5 * nearest)) ** 2)
        return point

    def _found(self, value: float, S: float, guess: Point, mu: float | None) -> EdgePoint:
        """The crossing near S at a value of the parameter; raises ArithmeticError where none is found for certain."""
        from scipy.optimize import newton

        fine, near = self.at_value(value, S, FINE), guess

        def off(at: float) -> float:
            nonlocal near
            near = orbit_at(fine, float(at), near)
            return self._off(fine, near)

        if not S > 0.0:
            raise ArithmeticError("S comes to 0")
        beside = S * (1.0 + BESIDE)
        slope = (off(beside) - off(S)) / (beside - S)
        found = float(newton(off, S, x1=beside, tol=SOLVED * S))
        if not abs(found - S) <= (AGREE if mu is None else LONGEST) * S:
            raise ArithmeticError("the crossing is farther from where it is expected than the step allows")
        self._missed = WELL if mu is None else abs(found - S) / S
        orbit = Orbit(fine, orbit_at(fine, found, near))
        error = abs(self._off(fine, orbit.point, moved=True) / slope) + SOLVED * found
        place = Place(0.0, 0.0, found, float(error), orbit.Omega)
        kind, power = f"1:{self._turns} resonance", POWERS[fine.symmetry.value]
        edge = StabilityEdge(place, kind, self._target, (), False, False, -1, 0.0, power)
        return EdgePoint(orbit, edge, {**fine.parameters(orbit.point), "S": found})

    def _off(self, family: Family, point: Point, moved: bool = False) -> float:
        """Difference of the nearest mu to the one of the resonance."""
        away = multipliers_of(family, point, moved) - self._target
        nearest = away[np.argmin(np.abs(away))]
        if abs(nearest.imag) > REAL:
            raise ArithmeticError("the multipliers of the resonance leave the unit circle")
        return float(nearest.real)


def shortened(point: Point, turns: int) -> Point:
    """A guess of the orbit of a shorter period that an orbit of a family runs through several times."""
    problem, z = point.problem, point.z.copy()
    if isinstance(problem, TrigonometricProblem):
        phases = (np.arange(problem.resolution) + 0.5) * np.pi / (2 * problem.resolution)
        states: Array = problem.sample(z, phases / turns).T
    elif isinstance(problem, FirstOrderProblem):
        phases = problem.phases() / turns
        states = problem.sample(z, phases)
        if problem.model.order == 2:
            ends = [problem.sample(z, phases + side * INSTANT) for side in (-1.0, 1.0)]
            states = np.hstack([states, problem.frequency(z) * (ends[1] - ends[0]) / (2.0 * INSTANT)])
    else:
        raise ArithmeticError(f"the orbit of the shorter period is not known to {type(problem).__name__}")
    z[: problem.states] = states.ravel()
    z[problem.Omega_index] *= turns
    return replace(point, z=z, better=None)
