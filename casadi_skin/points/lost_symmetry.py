"""Symmetries that an orbit has and the branch that leaves at its branch point has not.

A symmetry S of the equations that changes signs of states may hold of an orbit at each instant, S x(t) = x(t), or
after half of the period, S x(t) = x(t + T/2). It is lost on a branch that leaves along a Floquet vector which S, or S
and half a period, turn to its opposite (Golubitsky, Stewart and Schaeffer 1988).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import cast

import casadi as ca
import numpy as np

from casadi_skin.follow.orbit import Orbit
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.model.ode import OdeModel
from casadi_skin.points.breaking import breaking_of
from casadi_skin.zero.kinds import BRANCH_POINT
from casadi_skin.zero.problem import Array

MOST = 10  # states of a model all of whose changes of sign are tried
TRIALS, SAME = 3, 1e-9  # random points at which fields are compared, and their relative difference
HELD = 1e-5  # of an orbit's extent: how far off a symmetry may be that it has
PLACES = 64  # along the orbit


def lost_at(point: SpecialPoint) -> tuple[str, ...]:
    """Symmetries that orbits of the branch that leaves at a special point lack, in words; empty without any."""
    if point.mu is not None:
        breaking = breaking_of(cast(Orbit, point.solution), point.mu)
        return () if breaking is None else breaking.lost
    if point.kind != BRANCH_POINT or getattr(point.solution.space, "periodic", None) is None:
        return ()
    return lost_symmetries(cast(Orbit, point.solution))


def lost_symmetries(orbit: Orbit) -> tuple[str, ...]:
    """Symmetries lost at a branch point, in words, as "half-period symmetry in x, y"; empty without a known one.

    Arguments:
        orbit: at the branch point, over its whole period.
    """
    found = []
    for signs, shift in lost_operations(orbit):
        changed = ", ".join(name for name, sign in zip(orbit.model.state_names, signs, strict=True) if sign < 0)
        found.append(f"{'half-period' if shift else 'mirror'} symmetry in {changed}")
    return tuple(dict.fromkeys(found))


def lost_operations(orbit: Orbit) -> Iterator[tuple[Array, float]]:
    """Signs of the components, and the share of the period, of each symmetry that is lost at a branch point."""
    model = orbit.model
    times = orbit.period * np.arange(PLACES) / PLACES
    states, later = orbit.evaluate(times), orbit.evaluate(times + 0.5 * orbit.period)
    within = HELD * np.ptp(states)
    vector = critical_vector(orbit, 1.0)
    after: Array | None = None
    for signs in sign_symmetries(model, orbit.model_parameters):
        at_once = not model.forced and bool(np.max(np.abs(signs * states - states)) < within)
        if at_once and np.linalg.norm(signs * vector + vector) < np.linalg.norm(signs * vector - vector):
            yield signs, 0.0
        if np.max(np.abs(signs * states - later)) < within:
            after = _half_a_period_on(orbit, vector) if after is None else after
            image = _across(orbit, signs * vector)
            if np.linalg.norm(after + image) < np.linalg.norm(after - image):
                yield signs, 0.5


def sign_symmetries(model: OdeModel, parameters: Array) -> list[Array]:
    """Changes of signs of states under which the equations stay the same; of a forced model half a period later."""
    n = model.full_size
    if n <= MOST:
        choices = [np.array(signs) for signs in itertools.product((1.0, -1.0), repeat=n)][1:]
    else:
        declared = [] if model.half_period is None else [np.array(model.half_period, dtype=float)]
        choices = [-np.ones(n), *declared]
    generator, shift = np.random.default_rng(3), 0.5 * model.forcing_period_at(parameters)
    points = np.abs(generator.normal(size=(TRIALS, n)))
    here = [np.array(model.vector_field(0.3, x, parameters)).ravel() for x in points]

    def holds(signs: Array) -> bool:
        there = [np.array(model.vector_field(0.3 + shift, signs * x, parameters)).ravel() for x in points]
        return all(
            bool(np.max(np.abs(b - signs * a)) <= SAME * (1.0 + np.max(np.abs(a))))
            for a, b in zip(here, there, strict=True)
        )

    return [signs for signs in choices if holds(signs)]


def _half_a_period_on(orbit: Orbit, vector: Array) -> Array:
    """A perturbation at phase zero half a period later, across the orbit."""
    from scipy.integrate import solve_ivp

    model, p = orbit.model, orbit.model_parameters
    jacobian = model.function("J", ca.densify(ca.jacobian(model.full_rhs, model.full_state)))

    def rate(t: float, w: Array) -> Array:
        return np.asarray(np.array(jacobian(t, orbit.evaluate(t), p)) @ w)

    found = solve_ivp(rate, (0.0, 0.5 * orbit.period), vector, "LSODA", rtol=1e-6, atol=1e-9)
    return _across(orbit, found.y[:, -1])


def _across(orbit: Orbit, vector: Array) -> Array:
    """A vector at half of the period without its part along the orbit."""
    model, t = orbit.model, 0.5 * orbit.period
    if model.forced:
        return vector
    along = np.array(model.vector_field(0.0, orbit.evaluate(t), orbit.model_parameters)).ravel()
    return np.asarray(vector - along * (along @ vector) / (along @ along))


def critical_vector(orbit: Orbit, multiplier: float) -> Array:
    """The vector of norm 1 that the monodromy matrix multiplies by +1 or -1, across the motion along the orbit."""
    monodromy = np.asarray(orbit.floquet().monodromy)
    vectors = np.linalg.svd(monodromy - multiplier * np.eye(len(monodromy)))[2][::-1]
    if multiplier < 0.0 or orbit.floquet().trivial == 0:
        return np.asarray(vectors[0])
    h = 1e-5 * orbit.period
    ahead, behind = orbit.evaluate([h, -h])
    along = (ahead - behind) / np.linalg.norm(ahead - behind)
    free = [vector - along * (along @ vector) for vector in vectors[:2]]
    longest = max(free, key=lambda vector: float(np.linalg.norm(vector)))
    return np.asarray(longest / np.linalg.norm(longest))
