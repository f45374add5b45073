"""Start of Newton's method on the extended problem of a special orbit: an orbit near it, and its null vectors."""

from __future__ import annotations

import numpy as np

from casadi_skin.follow.special_points import BRANCH_POINT, DOUBLING, FOLD, TORUS
from casadi_skin.zero.linearised import Linearised, Vector, null_vectors, velocities
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import ZERO, BoundaryProblem
from casadi_skin.zero.statement import Statement
from casadi_skin.zero.systems import Critical

UNSEEN = 1e-9  # of what a left null vector sees of the conditions: less of the field is rounding
RESTS = 1e-5  # of the largest component: what a smaller one changes by is not known from its size


def started(critical: Critical, problem: BoundaryProblem, z: Array, value: float, angle: float = np.pi) -> Array:
    """Unknowns of the extended problem, on the mesh of an orbit, from the orbit's and the parameter's value."""
    n, count = critical.states, len(critical.orbit.free)
    linear = Linearised(problem, z, critical.orbit)
    if critical.kind == FOLD:
        v, added, size = _of_fold(critical, problem, null_vectors(linear.jacobian)[0])
    elif critical.kind == BRANCH_POINT:
        v, added, size = _of_branch_point(critical, linear)
    elif critical.kind == DOUBLING:
        v, added = null_vectors(linear.twisted(-1.0 + 0.0j, critical.turn))[0].reshape(-1, n), np.zeros(0)
        size = np.sqrt(_mean(problem, v / critical.sizes))
    else:
        v, added, size = _of_torus(critical, problem, z, angle)
    added = np.append(np.cos(angle), added[1:] / size) if critical.kind == TORUS else added / size
    states = np.hstack([z[: problem.states].reshape(-1, n), v / size])
    return np.concatenate([states.ravel(), z[problem.states : problem.states + count], [value], added, [0.0]])


def _of_fold(critical: Critical, problem: BoundaryProblem, null: Array) -> tuple[Array, Array, float]:
    """A null vector in states, in changes of the free parameters, and its size."""
    v, added = null[: problem.states].reshape(-1, critical.states), null[problem.states :]
    changes = np.sum((added / [critical.size_of(name) for name in critical.orbit.free]) ** 2)
    return v, added, float(np.sqrt(_mean(problem, v / critical.sizes) + changes))


def _of_branch_point(critical: Critical, linear: Linearised) -> tuple[Array, Array, float]:
    """v1 and v2 side by side, their changes of free parameters and the push; the size of v1."""
    from scipy.sparse import bmat, csc_matrix
    from scipy.sparse.linalg import splu

    problem, matrix = linear.problem, linear.jacobian
    right, left = null_vectors(matrix)
    v, added, size = _of_fold(critical, problem, right)
    closed = bmat([[matrix, csc_matrix(left[:, None])], [csc_matrix(right[None, :]), None]]).tocsc()
    slope = linear.slope * critical.size_of(critical.first)
    second = np.asarray(splu(closed).solve(np.append(-slope, 0.0))[:-1])
    w, changes = second[: problem.states].reshape(v.shape), second[problem.states :]
    return np.hstack([v, size * w]), np.concatenate([added, size * changes, [0.0]]), size


def _of_torus(critical: Critical, problem: BoundaryProblem, z: Array, angle: float) -> tuple[Array, Array, float]:
    """v1 and v2 side by side; the cosine and the shift; the size of v1."""
    q, shift, start = critical_plane(problem, z, angle, critical.sizes, critical.turn, critical.autonomous)
    turn = np.exp(0.5j * np.pi - 1j * np.angle(critical.normal @ start))  # v1 is orthogonal to the normal
    along = np.real(turn * shift) * velocities(problem, z) if critical.autonomous else 0.0
    v1, v2 = (turn * q).real - along, (turn * q * np.exp(1j * angle)).real - along
    added = [np.cos(angle)]
    if critical.autonomous:
        added.append(float(np.real(turn * shift)) * 2.0 * (np.cos(angle) - 1.0))
    return np.hstack([v1, v2]), np.array(added), float(np.sqrt(_mean(problem, v1 / critical.sizes)))


def component_sizes(values: Array) -> Array:
    """Scale of each component of a Floquet function: the orbit's largest, or a usual one where it rests; 1 of zeros."""
    largest = np.max(np.abs(values), axis=0)
    moves = largest > RESTS * np.max(largest)
    if np.max(largest) <= ZERO:
        return np.ones(largest.size)
    return np.asarray(np.where(moves, largest, np.median(largest[moves])))


def critical_plane(
    problem: BoundaryProblem, z: Array, angle: float, sizes: Array, turn: Array, autonomous: bool
) -> tuple[Vector, complex, Vector]:
    """The function q with q(1) = exp(i angle) turn q(0), shape (columns, components), and how it starts.

    Its start is a multiple of the velocity of an autonomous orbit, which is second; the part across it is third.
    """
    twisted = Linearised(problem, z, problem.statement).twisted(complex(np.exp(1j * angle)), turn)
    q = null_vectors(twisted)[0].reshape(problem.columns, -1)
    if not autonomous:
        return q, 0.0, q[0]
    velocity = velocities(problem, z)[0]
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


def seen_push(problem: BoundaryProblem, z: Array, statement: Statement, sizes: Array) -> tuple[Array, Array]:
    """The matrix of norm 1 that turns the null vector at a branch point to the largest product with its left one.

    Where conditions alone decide, which that vector sees and not the field, the changes of these instead, of norm 1.
    """
    linear = Linearised(problem, z, statement)
    v, psi = null_vectors(linear.jacobian)
    seen = linear.products(psi, v) * np.outer(sizes, 1.0 / sizes)
    conditions = psi[linear.inner :][: problem.formulation.conditions.numel()]
    if np.linalg.norm(seen) > UNSEEN * np.linalg.norm(conditions):
        return np.asarray(seen / np.linalg.norm(seen) * np.outer(sizes, 1.0 / sizes)), np.zeros(0)
    return np.zeros_like(seen), np.asarray(conditions / np.linalg.norm(conditions))


def _mean(problem: BoundaryProblem, v: Array) -> float:
    """The mean over the interval, and over the components, of the squares of v, shape (columns, components)."""
    weights = np.outer(problem.constants, problem.table.extended[-1]).ravel()
    return float(weights @ np.mean(v[problem.stages] ** 2, axis=1))
