"""Distance of a time evolution from an orbit: to its nearest point, so that a shift of phase alone has none."""

from __future__ import annotations

import numpy as np

from casadi_skin.dynamics.evolution import Evolution
from casadi_skin.dynamics.perturbation import orbit_equations
from casadi_skin.follow.closed_curve import CosineSeries, Curve, cosine_curve
from casadi_skin.follow.family import Family
from casadi_skin.follow.orbit import Orbit
from casadi_skin.zero.problem import Array

PHASES = 2048  # of an orbit with any wave form
SMALLEST = 1e-6  # of the largest component of an orbit: the least scale of a component


def _state_curve(orbit: Orbit) -> tuple[Curve, Array]:
    """The states of an orbit of `find_orbit`, with the scale of each: half its range over the period.

    The unit is the root of the mean square distance of the orbit from its mean.
    """
    equations, count = orbit_equations(orbit), PHASES
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
