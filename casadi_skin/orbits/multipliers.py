"""Multipliers of points of a family, several at a time, with the errors of the orbits in their errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from casadi_skin.bvp.problem import Array, Problem
from casadi_skin.continuation.points import Point
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.orbits.tools import FamilyTools
from casadi_skin.solvers.levels import Refinement
from casadi_skin.stability.flow import OrbitState
from casadi_skin.stability.multipliers import floquets
from casadi_skin.stability.result import Floquet
from casadi_skin.threads import one_thread


def orbit_state(point: Point) -> OrbitState:
    """A point as flow maps take it, with the better orbit that shows its error.

    Where the point has none, as one read from a journal, the state and Omega are put off by their estimated errors.
    """
    problem, z = point.problem, point.z
    if point.better is not None:
        return OrbitState(problem, z, OrbitState(point.better.problem, point.better.z))
    if not (np.isfinite(point.error.profile) and np.isfinite(point.error.Omega)):
        return OrbitState(problem, z)
    off = z.copy()
    off[: problem.states] *= 1.0 + point.error.profile
    off[problem.Omega_index] += point.error.Omega
    off[problem.parameter_index] *= 1.0 + point.error.parameter
    return OrbitState(problem, z, OrbitState(problem, off))


def on_all_sites(tools: FamilyTools, point: Point) -> Point:
    """A point of a family whose tail is eliminated as one of `tools.whole`, where every site is an unknown.

    Raises ValueError where these are too many.
    """
    layout = tools.layout
    if not isinstance(layout, CoreWithTail):
        return point

    def whole(problem: Problem, z: Array) -> Refinement:
        H = problem.resolution
        theta = (np.arange(H) + 0.5) * np.pi / (2 * H)
        positions = layout.positions(problem, z, theta)
        unknowns = np.concatenate([positions.T.ravel(), [problem.frequency(z), z[problem.parameter_index]]])
        return Refinement(tools.whole.levels.problem(H), unknowns)

    here = whole(point.problem, point.z)
    better = None if point.better is None else whole(point.better.problem, point.better.z)
    return replace(point, problem=here.problem, z=here.z, tangent=np.zeros(here.z.size), better=better)


def accelerations(tools: FamilyTools, orbits: Sequence[OrbitState]) -> Array:
    """q'' at phase zero, shape (orbits, core sites)."""
    starts = np.stack([orbit.problem.sample(orbit.z, np.zeros(1))[0] for orbit in orbits], axis=1)
    parameters = np.array([[orbit.parameter for orbit in orbits]])
    return np.array(tools.rhs.map(len(orbits))(starts, parameters)[0]).T


def floquets_of(tools: FamilyTools, points: Sequence[Point]) -> list[Floquet]:
    """Stability of several points of a family; at |gamma| = 1 without the Jordan block's algebraic growth.

    Raises FlowError where the flow map cannot reach the tolerance for any of them.
    """
    if isinstance(tools.layout, CoreWithTail):
        return floquets_of(tools.whole, [on_all_sites(tools, point) for point in points])
    states = [orbit_state(point) for point in points]
    with one_thread():
        results = floquets(tools.flow, states, lambda orbits: accelerations(tools, orbits), tools.request.tolerance)
    resting = tools.request.chain.sites - tools.core.sites
    if resting == 0:
        return results
    return [_resting(tools, point, result, resting) for point, result in zip(points, results, strict=True)]


def _resting(tools: FamilyTools, point: Point, core: Floquet, resting: int) -> Floquet:
    """At |gamma| = 1 the other sites are linear oscillators that nothing drives in the gauge."""
    phase = 0.5 * np.pi * tools.request.chain.linear_frequency(1) / point.Omega
    off = phase * point.error.Omega / point.Omega
    error = abs(np.sin(2.0 * phase)) * off + off**2 + np.finfo(float).eps
    mu = np.full(resting, -(np.sin(phase) ** 2), complex)
    return Floquet(mu, np.full(resting, error), core.trivial_deviation, core.power)
