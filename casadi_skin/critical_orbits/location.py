"""A special orbit located to the tolerance, as a solution of the extended problem of its kind."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.bvp.problem import EPSILON, Array, Scalar, SingularError
from casadi_skin.bvp.stated_problem import PERIOD, BoundaryProblem
from casadi_skin.continuation.points import Point
from casadi_skin.critical_orbits.linearised import Linearised, Vector, null_vectors
from casadi_skin.critical_orbits.systems import Critical
from casadi_skin.orbits.boundary_space import BoundarySpace, Sizes
from casadi_skin.orbits.special_points import DOUBLING, FOLD, TORUS

NEAR = 0.5  # of the longest step: how far from its approximate place a special orbit may be
RESTS = 1e-5  # of the largest component: what a smaller one changes by is not known from its size


@dataclass(frozen=True, eq=False)
class LocatedOrbit:
    """A special orbit.

    Attributes:
        critical: what it solves.
        point: its unknowns, those of the linearisation among them.
        value: of the parameter that was found with it.
        error: estimated absolute error of that.
    """

    critical: Critical
    point: Point
    value: float
    error: float


def extended_space(
    critical: Critical,
    old: BoundarySpace,
    values: Mapping[str, float],
    unit: float,
    parameter: str = "",
    to: float = 1.0,
) -> BoundarySpace:
    """The space of solutions of an extended problem, at values of the parameters that are held."""
    statement = critical.statement()
    statement = replace(statement, parameters={**statement.parameters, **values})
    states = np.concatenate(
        [old.sizes.states, *[1e-3 * critical.sizes] * (len(statement.model.state_names) // critical.states - 1)]
    )
    scalars = np.concatenate([old.sizes.scalars, [unit], np.ones(len(critical.added))])
    method = replace(old.method, corrector="newton")
    return BoundarySpace(statement, old.tolerance, method, Sizes(states, scalars), None, parameter, to)


def started(critical: Critical, problem: BoundaryProblem, z: Array, value: float, angle: float = np.pi) -> Array:
    """Unknowns of the extended problem, on the mesh of an orbit, from the orbit's and the parameter's value."""
    n, count = critical.states, len(critical.orbit.free)
    states = z[: problem.states].reshape(-1, n)
    linear = Linearised(problem, z, critical.orbit)
    free = [*z[problem.states : problem.states + count], value]
    if critical.kind == FOLD:
        null, _ = null_vectors(linear.jacobian)
        v, w = null[: problem.states].reshape(-1, n), null[problem.states :]
        size = np.sqrt(
            _mean(problem, v / critical.sizes) + np.sum((w / [critical._size_of(f) for f in critical.orbit.free]) ** 2)
        )
        return np.concatenate([np.hstack([states, v / size]).ravel(), free, w / size, [0.0]])
    if critical.kind == DOUBLING:
        v = null_vectors(linear.twisted(-1.0 + 0.0j))[0].reshape(-1, n)
        v = v / np.sqrt(_mean(problem, v / critical.sizes))
        return np.concatenate([np.hstack([states, v]).ravel(), free, [0.0]])
    q, shift, start = critical_plane(problem, z, angle, critical.sizes)
    turn = np.exp(0.5j * np.pi - 1j * np.angle(critical.normal @ start))  # v1 is orthogonal to the normal
    along = np.real(turn * shift) * _velocities(problem, z) if critical.autonomous else 0.0
    v1, v2 = (turn * q).real - along, (turn * q * np.exp(1j * angle)).real - along
    size = np.sqrt(_mean(problem, v1 / critical.sizes))
    added = [np.cos(angle)]
    if critical.autonomous:
        added.append(float(np.real(turn * shift)) * 2.0 * (np.cos(angle) - 1.0) / size)
    return np.concatenate([np.hstack([states, v1 / size, v2 / size]).ravel(), free, added, [0.0]])


def component_sizes(values: Array) -> Array:
    """What each component of a Floquet function is measured by: the orbit's largest, or a usual one where it rests."""
    largest = np.max(np.abs(values), axis=0)
    moves = largest > RESTS * np.max(largest)
    return np.asarray(np.where(moves, largest, np.median(largest[moves])))


def critical_plane(problem: BoundaryProblem, z: Array, angle: float, sizes: Array) -> tuple[Vector, complex, Vector]:
    """The function q with q(1) = exp(i angle) q(0), shape (columns, components), and how it starts.

    Its start is a multiple of the velocity of an autonomous orbit, which is second, and what is across it, third.
    """
    twisted = Linearised(problem, z, problem.statement).twisted(complex(np.exp(1j * angle)))
    q = null_vectors(twisted)[0].reshape(problem.columns, -1)
    if PERIOD not in problem.statement.free:
        return q, 0.0, q[0]
    velocity = _velocities(problem, z)[0]
    shift = complex((velocity / sizes) @ (q[0] / sizes) / np.sum((velocity / sizes) ** 2))
    return q, shift, q[0] - shift * velocity


def normal_of(start: Vector, sizes: Array) -> Array:
    """A vector between the axes of the ellipse on which real parts of multiples of a complex one are.

    What is orthogonal to it is no eigenvector where the ellipse becomes a line, as at the resonances 1:1 and 1:2.
    """
    scaled = start / sizes
    turned = scaled * np.exp(-0.5j * np.angle(np.sum(scaled * scaled)))
    longer, shorter = (part / np.linalg.norm(part) for part in (turned.real, turned.imag))
    return np.asarray((longer - shorter) / np.sqrt(2.0) / sizes)


def _velocities(problem: BoundaryProblem, z: Array) -> Array:
    """Derivatives of the state by the fraction of the period, shape (columns, components)."""
    x = z[: problem.states].reshape(problem.columns, -1)
    scalars = np.tile(z[problem.states :, None], problem.columns)
    field = problem.formulation.field_function.map(problem.columns)(problem._fractions()[None], x.T, scalars)
    return np.array(field[0]).T


def _mean(problem: BoundaryProblem, v: Array) -> float:
    """The mean over the interval, and over the components, of the squares of v, shape (columns, components)."""
    weights = np.outer(problem.constants, problem.table.extended[-1]).ravel()
    return float(weights @ np.mean(v[problem.stages] ** 2, axis=1))


def critical_of(kind: str, space: BoundarySpace, point: Point, angle: float, first: str) -> Critical:
    """What an orbit solves beside its own equations, seen from an orbit near it."""
    problem = point.problem
    assert isinstance(problem, BoundaryProblem)
    values = point.z[: problem.states].reshape(problem.columns, -1)
    sizes = component_sizes(values)
    normal = np.zeros(values.shape[1])
    if kind == TORUS:
        normal = normal_of(critical_plane(problem, point.z, angle, sizes)[2], sizes)
    return Critical(kind, space.statement, first, sizes, normal)


def locate(space: BoundarySpace, kind: str, point: Point, angle: float = np.pi) -> LocatedOrbit | None:
    """The special orbit of a kind near an orbit of a branch; None where Newton's method finds none there.

    `angle` is that of the multipliers of a torus.
    """
    if kind not in (FOLD, DOUBLING, TORUS):
        return None
    name, value = space.parameter, space.parameters(point)[space.parameter]
    problem = point.problem
    assert isinstance(problem, BoundaryProblem)
    try:
        critical = critical_of(kind, space, point, angle, name)
        unit = abs(space.to - space.statement.values[name])
        extended = extended_space(critical, space, {name: value}, unit)
        finer = extended.levels.problem(problem.resolution).with_constants(problem.constants)
        z = started(critical, problem, point.z, value, angle)
        row = finer.parameter_row()
        correction = extended.levels.corrector(finer).correct(z, row, 0.0)
        if not correction.converged:
            return None
        found = extended.point_solver.refined(finer, correction, row, Scalar.PARAMETER)
    except (SingularError, ArithmeticError, RuntimeError, NotImplementedError):  # a black box has no second derivatives
        return None
    if found is None:
        return None
    index = found.problem.states + len(space.statement.free)
    return LocatedOrbit(critical, found, float(found.z[index]), _error(extended, found, index))


def _error(space: BoundarySpace, point: Point, index: int) -> float:
    """Estimated error of one of the unknown scalars: the difference to a finer level, rounding, and its last digit."""
    problem, better = point.problem, point.better
    assert better is not None
    value = float(point.z[index])
    apart = abs(float(better.z[better.problem.states + index - problem.states]) - value)
    solve = space.point_solver.factor(problem, point.z, problem.parameter_row())
    noise = solve(np.append(problem.rounding(point.z) * problem.probe, 0.0))
    return apart + abs(float(noise[index])) + EPSILON * abs(value)


def point_of(located: LocatedOrbit, space: BoundarySpace, near: Point, kind: str) -> Point:
    """A special orbit as a point of a branch, with the tangent of one near it."""
    extended, count = located.point, len(space.statement.free)
    problem = space.levels.problem(extended.problem.resolution).with_constants(extended.problem.constants)
    states = extended.z[: extended.problem.states].reshape(
        -1, extended.problem.states // problem.states * located.critical.states
    )
    free = extended.z[extended.problem.states :][:count]
    start = space.statement.values[space.parameter]
    u = (located.value - start) / (space.to - start)
    z = np.concatenate([states[:, : located.critical.states].ravel(), free, [u]])
    error = replace(extended.error, parameter=located.error / abs(space.to - start) / problem.parameter_size(z))
    tangent = near.problem.prolong(near.tangent, problem)
    return replace(
        near, problem=problem, z=z, tangent=tangent, error=error, better=None, special=kind, walked=False,
        requested=False, at_round_off=extended.at_round_off,
    )  # fmt: skip


def special_orbit(space: BoundarySpace, kind: str, near: Point, angle: float = np.pi) -> Point | None:
    """The special orbit of a kind near an orbit of a branch as a point of it; None where none is found."""
    located = locate(space, kind, near, angle)
    if located is None:
        return None
    found = point_of(located, space, near, kind)
    there = near.problem.prolong(near.z, found.problem)
    apart = float(np.sqrt(np.sum(space.point_solver.metric(found.problem, there) * (found.z - there) ** 2)))
    return found if apart <= NEAR * space.point_solver.settings.max_step else None
