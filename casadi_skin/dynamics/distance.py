"""Distance of a time evolution from an orbit: to its nearest point, so that a shift of phase alone has none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.dynamics.perturbation import orbit_equations
from casadi_skin.orbits.family import Family
from casadi_skin.orbits.orbit import Orbit

STEPS = 6  # of Gauss and Newton's refinement
HARMONICS = (64, 128, 256, 512, 1024)  # of an orbit without the half-period symmetry
NEGLIGIBLE = 1e-2  # of the tolerance: coefficients that a sum of cosines can do without
SMALLEST = 1e-6  # of the largest component of an orbit: what a component is measured by at least


class CosineSeries(Protocol):
    """What a distance from an orbit asks of it, as an `Orbit` has it, or what was kept of one."""

    @property
    def S(self) -> float: ...
    @property
    def Omega(self) -> float: ...
    @property
    def harmonics(self) -> int: ...
    def coefficients(self, harmonics: int) -> Array: ...


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
        for _ in range(STEPS):
            point, tangent = self.points(theta)
            nearest = np.minimum(nearest, np.linalg.norm(states - point, axis=1))
            move = np.sum((states - point) * tangent, axis=1) / np.sum(tangent**2, axis=1)
            theta = theta + np.clip(move, -np.pi / self.phases, np.pi / self.phases)
        return np.asarray(nearest / self.unit)


def cosine_curve(orbit: CosineSeries) -> Curve:
    """The points (y, y'/Omega) of an orbit of a family, in units of sqrt(S)."""
    if isinstance(orbit, Orbit) and orbit.symmetry is not SymmetryClass.QUARTER:
        c = _cosines(orbit)
        order = np.arange(len(c))
    else:
        c = orbit.coefficients(orbit.harmonics)
        order = 2 * np.arange(len(c)) + 1

    def points(theta: Array) -> tuple[Array, Array]:
        cosine, sine = np.cos(np.outer(theta, order)), np.sin(np.outer(theta, order))
        y, dy, ddy = cosine @ c, -(sine * order) @ c, -(cosine * order**2) @ c
        return np.hstack([y, dy]), np.hstack([dy, ddy])

    return Curve(points, 128, float(np.sqrt(orbit.S)))


def _cosines(orbit: Orbit) -> Array:
    """Coefficients of cos(k Omega t), k from 0, of an orbit of a family with both even and odd harmonics."""
    from scipy.fft import dct

    for harmonics in HARMONICS:
        middles = (np.arange(harmonics) + 0.5) / (2 * harmonics)
        c = dct(orbit.evaluate(orbit.period * middles), axis=0) / harmonics
        c[0] *= 0.5
        if np.max(np.abs(c[-harmonics // 4 :])) <= NEGLIGIBLE * orbit.space.tolerance * np.max(np.abs(c)):
            break
    return np.asarray(c)


def _state_curve(orbit: Orbit) -> tuple[Curve, Array]:
    """The states of an orbit of `find_orbit`, with what each is measured by: half its range over the period.

    The unit is the root of the mean square distance of the orbit from its mean.
    """
    equations, count = orbit_equations(orbit), 2048
    field = equations.physical.vector_field
    x = orbit.evaluate(orbit.period * np.arange(count) / count)
    half = 0.5 * np.ptp(x, axis=0)
    sizes = np.maximum(half, SMALLEST * np.max(half))

    def points(theta: Array) -> tuple[Array, Array]:
        t = np.mod(theta / orbit.Omega, orbit.period)
        states = orbit.evaluate(t)
        values = np.tile(equations.values[:, None], t.size)
        rates = np.array(field.map(t.size)(t[None], states.T, values)).T
        return states / sizes, rates / (sizes * orbit.Omega)

    unit = float(np.sqrt(np.mean(np.sum(((x - x.mean(axis=0)) / sizes) ** 2, axis=1))))
    return Curve(points, count, unit), sizes


def distance_from_orbit(orbit: CosineSeries, evolution: Evolution) -> Array:
    """Distance of a time evolution from an orbit at each time.

    Arguments:
        orbit: any orbit.
        evolution: of the same model.

    Returns:
        Shape (time,): of an orbit of a family the distance of (y, y'/Omega) to its nearest point over sqrt(S).
        Of another orbit each state is measured by half its range over the period, and the distance relative to the root
        of the mean square distance of the orbit from its mean. In a forced model it is the distance to the point that
        the orbit has at the same time, in others to the nearest: a shift of phase alone has no distance.
    """
    if isinstance(orbit, Orbit) and not isinstance(orbit.space, Family):
        curve, sizes = _state_curve(orbit)
        states = evolution.states / sizes
        if not evolution.equations.physical.forced:
            return curve.distances(states)
        at_the_time, _ = curve.points(orbit.Omega * evolution.t)
        return np.asarray(np.linalg.norm(states - at_the_time, axis=1) / curve.unit)
    return cosine_curve(orbit).distances(np.hstack([evolution.displacements, evolution.velocities / orbit.Omega]))
