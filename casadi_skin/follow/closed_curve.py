"""An orbit as a closed curve in the space of states, and the distance of a state from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from casadi_skin.follow.solution import Orbit
from casadi_skin.model.conserved import SymmetryClass
from casadi_skin.zero.problem import Array

SOUGHT_PHASES = 128  # of an orbit of a family, among which the nearest is sought first
GAUSS_NEWTON_STEPS = 6  # of Gauss and Newton's refinement
HARMONICS_TRIED = (64, 128, 256, 512, 1024)  # of an orbit without the half-period symmetry
NEGLIGIBLE_COEFFICIENT = 1e-2  # of the tolerance: coefficients that a sum of cosines can do without


@dataclass(frozen=True, eq=False)
class Curve:
    """A closed curve in the space of states, as a function of the phase.

    Attributes:
        points: points and their derivatives by the phase at phases theta, shape (len(theta), components) each.
        phases: number of phases among which the nearest point is sought first.
        unit: of distances.
    """

    points: Callable[[Array], tuple[Array, Array]]
    phases: int
    unit: float

    def distances(self, states: Array) -> Array:
        """Distance of states (many, components) to the nearest point of the curve, in its unit, shape (many,).

        The nearest phase is sought among `phases` and refined by Gauss-Newton steps.
        """
        phases = 2.0 * np.pi * np.arange(self.phases) / self.phases
        coarse, _ = self.points(phases)
        theta = phases[np.argmax(states @ coarse.T - 0.5 * np.sum(coarse**2, axis=1), axis=1)]
        nearest = np.full(len(states), np.inf)
        for _ in range(GAUSS_NEWTON_STEPS):
            point, tangent = self.points(theta)
            nearest = np.minimum(nearest, np.linalg.norm(states - point, axis=1))
            move = np.sum((states - point) * tangent, axis=1) / np.sum(tangent**2, axis=1)
            theta = theta + np.clip(move, -np.pi / self.phases, np.pi / self.phases)
        return np.asarray(nearest / self.unit)


def cosine_curve(orbit: Any) -> Curve:
    """The points (y, y'/Omega) of an orbit of a family, in units of sqrt(S); a series has S and `coefficients` too."""
    if getattr(orbit, "symmetry", SymmetryClass.QUARTER) is not SymmetryClass.QUARTER:
        c = _cosines(orbit)
        order = np.arange(len(c))
    else:
        c = orbit.coefficients(orbit.harmonics)
        order = 2 * np.arange(len(c)) + 1

    def points(theta: Array) -> tuple[Array, Array]:
        cosine, sine = np.cos(np.outer(theta, order)), np.sin(np.outer(theta, order))
        y, dy, ddy = cosine @ c, -(sine * order) @ c, -(cosine * order**2) @ c
        return np.hstack([y, dy]), np.hstack([dy, ddy])

    return Curve(points, SOUGHT_PHASES, float(np.sqrt(orbit.S)))


def _cosines(orbit: Orbit) -> Array:
    """Coefficients of cos(k Omega t), k from 0, of an orbit of a family with both even and odd harmonics."""
    from scipy.fft import dct

    for harmonics in HARMONICS_TRIED:
        middles = (np.arange(harmonics) + 0.5) / (2 * harmonics)
        c = dct(orbit.evaluate(orbit.period * middles), axis=0) / harmonics
        c[0] *= 0.5
        if np.max(np.abs(c[-harmonics // 4 :])) <= NEGLIGIBLE_COEFFICIENT * orbit.space.tolerance * np.max(np.abs(c)):
            break
    return np.asarray(c)
