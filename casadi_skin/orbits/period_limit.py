"""The limit of a branch of orbits whose period grows without bound: an orbit that joins equilibria.

Near a homoclinic orbit to a saddle the parameter comes to its limit as exp(-lambda T), near one to a saddle-node as a
power of T (Kuznetsov 2004, sections 6.2 and 7.1). Both are a power law of T locally: from the rates dp/dT at two orbits
follows how far the limit is. The branch ends where that is nearer than the tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array, Scalar
from casadi_skin.bvp.stated_problem import BoundaryProblem
from casadi_skin.bvp.symmetry import SymmetryClass
from casadi_skin.continuation.points import Point
from casadi_skin.models.ode import OdeModel
from casadi_skin.orbits.method import TWO_PI
from casadi_skin.orbits.special_points import HETEROCLINIC, HOMOCLINIC

PLACES = 2001  # along an orbit at which its speed is looked at
SMALLEST = 1e-9  # of the largest component: smaller ones are reported as 0
GROWN = 3.0  # times the period at the start of the branch
SLOW = 1e-2  # of the largest speed along the orbit: it passes an equilibrium there
STILL = 1e-15  # of it: a parameter that does not change
NEAREST = 1e-9  # of the way that is followed: nearer to its limit the parameter does not separate orbits
SAFETY = 3.0  # between an estimated distance and the reported error
STEPS, CONVERGED = 30, 1e-10  # of Newton's method for the equilibrium
NEAR = 0.2  # of the orbit's extent: how far from its slowest place an equilibrium may be


def limit_between(start: Point, before: Point, after: Point, tolerance: float) -> float | None:
    """Distance of the parameter from its limit at the later of two orbits, where the period grows without bound.

    Arguments:
        start: of the branch.
        before, after: neighbours on the branch.
        tolerance: how near to its limit the parameter has to be, relative to the way that is followed.

    Returns:
        A bound of the distance; None where the branch goes on.
    """
    first, one, other = (_period(point) for point in (start, before, after))
    if not (other[0] > one[0] and other[0] > GROWN * first[0]):
        return None
    left = _distance(before, after)
    return SAFETY * left if left <= max(tolerance, NEAREST) * after.problem.parameter_size(after.z) else None


def _period(point: Point) -> tuple[float, float]:
    """The unknown period and its rate along the branch."""
    place = point.problem.index_of(Scalar.OMEGA)
    return float(point.z[place]), float(point.tangent[place])


def _distance(before: Point, after: Point) -> float:
    """Distance of the parameter from its limit by a power law; infinite where there is none at a finite distance."""
    (one, first), (other, last) = _period(before), _period(after)
    moved = abs(after.parameter - before.parameter)
    moves = [float(point.tangent[point.problem.parameter_index]) for point in (before, after)]
    rates = [abs(moves[0] / first), abs(moves[1] / last)]
    if moved <= STILL * after.problem.parameter_size(after.z) or 0.0 in rates:
        return moved
    power = np.log(rates[0] / rates[1]) / np.log(other / one)
    return float(rates[1] * other / (power - 1.0)) if power > 1.0 else np.inf


def resting_places(model: OdeModel, states: Array, p: Array, turns: Sequence[int]) -> list[Array]:
    """Different equilibria that an orbit passes slowly, in the order of time.

    Arguments:
        model: of first order, autonomous.
        states: along the orbit, shape (places, components).
        p: parameters of the model.
        turns: of the states in a period; those that turn are reported modulo 2 pi.
    """
    field = model.vector_field.map(len(states))
    speeds = np.linalg.norm(np.array(field(0.0, states.T, np.tile(p[:, None], len(states)))), axis=0)
    slow = speeds < SLOW * np.max(speeds)
    reach = NEAR * np.ptp(states, axis=0)
    found: list[Array] = []
    for stretch in np.split(np.arange(len(states)), np.flatnonzero(np.diff(slow.astype(int))) + 1):
        if not slow[stretch[0]]:
            continue
        x = _equilibrium(model, states[stretch[np.argmin(speeds[stretch])]], p)
        if x is None or np.any(np.abs(x - states[stretch[np.argmin(speeds[stretch])]]) > reach):
            continue
        if not any(_same(x, other, reach, turns) for other in found):
            found.append(x)
    return found


def _same(x: Array, other: Array, reach: Array, turns: Sequence[int]) -> bool:
    away = x - other
    if any(turns):
        away = np.where(np.array(turns) != 0, away - 2.0 * np.pi * np.round(away / (2.0 * np.pi)), away)
    return bool(np.all(np.abs(away) <= 0.1 * reach))


def _equilibrium(model: OdeModel, x: Array, p: Array) -> Array | None:
    """The equilibrium near a state by Newton's method, where the Jacobian is singular too; None where none is."""
    slope = model.function(
        "slope",
        model.vector_field(0.0, model.full_state, model.parameters),
        ca.densify(ca.jacobian(model.full_rhs, model.full_state)),
    )
    size = np.max(np.abs(x)) + 1.0
    for _ in range(STEPS):
        rate, jacobian = (np.array(value) for value in slope(0.0, x, p))
        step = np.linalg.lstsq(jacobian, rate.ravel(), rcond=1e-10)[0]
        x = x - step
        if not np.all(np.isfinite(x)):
            return None
        if np.max(np.abs(step)) < CONVERGED * size:
            return np.asarray(x)
    return np.asarray(x) if np.max(np.abs(step)) < 1e-4 * size else None  # a double one is come to slowly


def unbounded(orbit: Point, left: float, places: Sequence[Array]) -> Point | None:
    """An orbit marked as the end of its branch, a distance from the limit; None where it rests nowhere nearly."""
    if not places:
        return None
    error = replace(orbit.error, parameter=left / orbit.problem.parameter_size(orbit.z) + orbit.error.relative(1.0))
    kind = HOMOCLINIC if len(places) == 1 else HETEROCLINIC
    return replace(orbit, error=error, special=kind, walked=False, requested=False)


def resting_phases(problem: BoundaryProblem, symmetry: SymmetryClass) -> Array:
    """Phases at which it is looked at how fast an orbit moves: even ones, and those of the mesh."""
    parts = np.concatenate([np.linspace(0.0, 1.0, PLACES), symmetry.value * problem._fractions()])
    return np.asarray(TWO_PI * np.unique(parts))


def joined_words(orbit: Point, places: Sequence[Array], model: OdeModel) -> str:
    """Which equilibria an orbit with a period without bound joins."""
    found = []
    for x in places:
        x = np.where(np.abs(x) < SMALLEST * np.max(np.abs(x)), 0.0, x)
        state = ", ".join(f"{name} = {value:.6g}" for name, value in zip(model.state_names, x, strict=True))
        found.append(f"({state})")
    return f"orbits come to one that is {orbit.special} to {' and '.join(found)}"
