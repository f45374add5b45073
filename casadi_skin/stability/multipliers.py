"""Floquet multipliers from the N x N problem of a reversible Hamiltonian orbit.

Let Phi = [[A, B], [C, D]] be the symplectic transition matrix over a quarter (half) of the period of an orbit that is
reversible and odd (reversible). The map over twice that time is M = R Phi^-1 R Phi, R = diag(I, -I), and since M is
reversible too, (M + M^-1)/2 = I + 2 diag(B^T C, C^T B). With mu the eigenvalues of B^T C: lambda(M) + 1/lambda(M) =
2 + 4 mu, and the multipliers over the period are lambda(M)^2 (lambda(M)). The orbit is stable if and only if every
mu is real and in [-1, 0]. The velocity of the flow, (0, a_0) at phase zero, is a left eigenvector of B^T C with the
trivial eigenvalue: it is taken out exactly by a reflection, so that no other eigenvalue that comes near it mixes
with it.

Where the equations are reversible but not Hamiltonian, Phi is not symplectic, and (M + M^-1)/2 is block diagonal all
the same: -C'^T, with C' the lower left block of Phi^-1, takes the place of C.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from casadi_skin.stability.flow import FlowMap, OrbitState, Transition
from casadi_skin.stability.perturbation import eigenvalue_errors
from casadi_skin.stability.reduction import (
    ComplexArray,
    Eigensystems,
    Reflections,
    eigensystems,
    frobenius_norms,
    half_cosine_errors,
    half_cosines,
    stacked,
)
from casadi_skin.stability.relative import complement
from casadi_skin.stability.result import ReversibleFloquet
from casadi_skin.zero.problem import Array

ORBIT_SAFETY = 2.0
ROUND_OFF = 4e-16  # of a transition matrix, relative to its norm, as it shows in mu
NORM_PER_MU = 30.0  # norm of a flow's error over its part in mu: measured, 7 to 1000 for nine of ten random orbits
COARSEST = 1e-2  # error of a transition matrix above which its estimate means little
RETRIES = 2


def power_of(transition: Transition) -> int:
    """The power of lambda(M) that multipliers over the period are."""
    return {0.25: 2, 0.5: 1}[transition.fraction]


@dataclass(frozen=True)
class _Solved:
    """Results, with the part of the errors of mu that the flow makes, relative to max(1, |mu|), of each orbit."""

    results: list[ReversibleFloquet]
    flow_errors: Array
    reflections: Reflections
    systems: Eigensystems


def floquet(transition: Transition, acceleration: Array) -> ReversibleFloquet:
    """Multipliers of a reversible orbit from its transition matrix over a quarter (odd orbits) or half of the period.

    `acceleration` is q'' at phase zero, shape (n,), which gives the trivial pair. The errors are those of the flow.
    """
    return _solve([transition], acceleration[None, :], acceleration[None, :]).results[0]


def floquets(
    flow: FlowMap,
    orbits: Sequence[OrbitState],
    accelerations: Callable[[Sequence[OrbitState]], Array],
    tolerance: float,
    symplectic: bool = True,
) -> list[ReversibleFloquet]:
    """Multipliers of several orbits of one model, with the errors of the flow and of the orbits in those of mu.

    The flow's part is brought below `tolerance`, relative to max(1, |mu|), where mu is not near a defective pair.
    `accelerations` gives q'' at phase zero, shape (orbits, n); `symplectic` is true where the equations are Hamiltonian
    in positions and velocities. Raises FlowError.
    """

    def solve(found: Sequence[Transition], places: NDArray[np.int64]) -> _Solved:
        those = found if symplectic else [with_reversed_block(transition) for transition in found]
        return _solve(those, starts[places], better[places])

    starts, better = np.split(accelerations([*orbits, *(orbit.better or orbit for orbit in orbits)]), 2)
    transitions = flow.transitions(orbits, min(NORM_PER_MU * tolerance, COARSEST), banded=symplectic)
    waiting = np.arange(len(orbits))
    solved = solve(transitions, waiting)
    results, flow_errors = solved.results, solved.flow_errors
    for _ in range(RETRIES):
        over = flow_errors > tolerance
        if not over.any():
            break
        waiting = waiting[over]
        norms = np.array([transitions[i].error for i in waiting.tolist()])
        shares = np.exp2(np.floor(np.log2(np.maximum(0.5 * norms / flow_errors[over], 1e-3))))
        flow_errors = np.empty(waiting.size)
        for share in np.unique(shares).tolist():  # an orbit's own errors decide, not those of its batch
            those = np.flatnonzero(shares == share)
            again = flow.transitions([orbits[i] for i in waiting[those].tolist()], share * tolerance, banded=symplectic)
            solved = solve(again, waiting[those])
            flow_errors[those] = solved.flow_errors
            for i, transition, result in zip(waiting[those].tolist(), again, solved.results, strict=True):
                transitions[i], results[i] = transition, result
    return results


def _solve(transitions: Sequence[Transition], accelerations: Array, better_accelerations: Array) -> _Solved:
    power = power_of(transitions[0])
    trivial = -1.0 if power == 2 else 0.0
    matrices = stacked([t.matrix for t in transitions])
    reflections = Reflections.of(accelerations)
    similar = reflections.similar(half_cosines(matrices))
    # (0, a_0) is a left eigenvector, so the first row is (trivial, 0, ..., 0) but for the errors of flow and orbit.
    similar[:, 0, 0] -= trivial
    deviations = np.max(np.abs(similar[:, 0]), axis=1)
    systems = eigensystems(similar[:, 1:, 1:])
    if systems.values.shape[1] == 0:
        errors, flow_errors = np.zeros(systems.values.shape), np.zeros(len(transitions))
    else:
        flow_part = flow_part_of(transitions, matrices, reflections)
        orbit_part = orbit_part_of(transitions, reflections, Reflections.of(better_accelerations))
        norms = frobenius_norms(flow_part) + frobenius_norms(orbit_part)
        parts, round_off = (flow_part, orbit_part), round_off_of(transitions, matrices)
        errors, first = eigenvalue_errors(systems, parts, norms, round_off)
        flow_errors = np.max(first / np.maximum(1.0, np.abs(systems.values)), axis=1)
    results = [
        ReversibleFloquet(mu, error, float(deviation), power)
        for mu, error, deviation in zip(systems.values, errors, deviations, strict=True)
    ]
    return _Solved(results, flow_errors, reflections, systems)


def with_reversed_block(transition: Transition) -> Transition:
    """A transition of a flow that is reversible alone, with -C'^T in the place of C, C' of its inverse."""
    inverse = np.asarray(np.linalg.inv(transition.matrix), dtype=float)

    def replaced(matrix: Array, inverted: Array) -> Array:
        n, total = matrix.shape[0] // 2, matrix.copy()
        total[n:, :n] = -inverted[n:, :n].T
        return total

    truncation, pair = transition.truncation, transition.pair
    if truncation is not None:
        truncation = replaced(truncation, -inverse @ truncation @ inverse)
    if pair is not None:
        along, better = (np.asarray(np.linalg.inv(matrix), dtype=float) for matrix in pair)
        pair = (replaced(pair[0], along), replaced(pair[1], better))
    return replace(transition, matrix=replaced(transition.matrix, inverse), truncation=truncation, pair=pair)


def flow_part_of(transitions: Sequence[Transition], matrices: Array, reflections: Reflections | None) -> Array:
    """Part of the reduced matrices, or of B^T C without reflections, that is due to the truncation of the flow."""
    truncations = [np.zeros_like(t.matrix) if t.truncation is None else t.truncation for t in transitions]
    errors = half_cosine_errors(matrices, stacked(truncations))
    return errors if reflections is None else reflections.similar(errors)[:, 1:, 1:]


def orbit_part_of(
    transitions: Sequence[Transition], reflections: Reflections | None, better_reflections: Reflections | None
) -> Array:
    """Differences of the reduced matrices along the better orbits and along the orbits, with a safety factor."""
    pairs = [(t.matrix, t.matrix) if t.pair is None else t.pair for t in transitions]
    along, better = (half_cosines(stacked(side)) for side in zip(*pairs, strict=True))
    if reflections is None or better_reflections is None:
        return np.asarray(ORBIT_SAFETY * (better - along))
    difference = better_reflections.similar(better) - reflections.similar(along)
    return np.asarray(ORBIT_SAFETY * difference[:, 1:, 1:])


def round_off_of(transitions: Sequence[Transition], matrices: Array) -> Array:
    """Norm of the errors of B^T C from round-off, and from a flow without a matrix of its errors; shape (orbits,)."""
    n, columns = matrices.shape[1] // 2, matrices.shape[2] // 2
    norms = frobenius_norms(matrices[:, :n, columns:]) + frobenius_norms(matrices[:, n:, :columns])
    unknown = ROUND_OFF * frobenius_norms(matrices)
    for i, transition in enumerate(transitions):
        if transition.truncation is None:
            unknown[i] = transition.error
    return np.asarray(unknown * norms)


def trivial_pair(transition: Transition, acceleration: Array) -> tuple[Array, Array]:
    """Velocity of the flow and direction along the family at phase zero, (positions, velocities) in the gauge, (2n,).

    The second is the right eigenvector of B^T C for the trivial mu: bordered with the left one, the matrix is regular.
    """
    _, B, C, _ = transition.blocks()
    n, trivial = acceleration.size, -1.0 if power_of(transition) == 2 else 0.0
    left = acceleration / np.linalg.norm(acceleration)
    bordered = np.block([[B.T @ C - trivial * np.eye(n), left[:, None]], [left[None, :], np.zeros((1, 1))]])
    family = np.linalg.lstsq(bordered, np.append(np.zeros(n), 1.0), rcond=None)[0][:n]
    zero = np.zeros(n)
    return np.concatenate([zero, acceleration]), np.concatenate([family, zero])


def floquet_vectors(
    transition: Transition, acceleration: Array, rho: Array, frame: Array | None = None
) -> ComplexArray:
    """Floquet vectors (positions, velocities) at phase zero, physical coordinates, shape (2n, 2n).

    Columns go with `Floquet.multipliers` and are scaled to largest entry 1; of the trivial pair the first is the
    velocity of the flow, the second the direction along the family. For an eigenvector x of B^T C the velocities
    follow from the second row of M: (lambda - 1 - 2 mu) v = 2 A^T C x. Where transition and acceleration are those of
    relative positions, with the columns of a `frame`, pairs of a displacement and a velocity of what the frame leaves
    out come next.
    """
    solved = _solve([transition], acceleration[None, :], acceleration[None, :])
    (result,), reflections, systems = solved.results, solved.reflections, solved.systems
    A, _, C, _ = transition.blocks()
    columns = [vector.astype(complex) for vector in trivial_pair(transition, acceleration)]
    for mu, root, reduced in zip(result.mu, result.root, systems.right[0].T, strict=True):
        x = reflections.vector(reduced)
        velocity = 2.0 * A.T @ (C @ x)
        for value in (root**2, root**-2):
            columns.append(np.concatenate([x * (value - 1.0 - 2.0 * mu), velocity]))
    vectors = np.stack(columns, axis=1)
    if frame is not None:
        lifted = np.concatenate([frame @ half for half in np.split(vectors, 2)])
        free = np.kron(np.eye(2), complement(frame))
        vectors = np.concatenate([lifted[:, :2], free, lifted[:, 2:]], axis=1)
    vectors = np.concatenate([rho, rho])[:, None] * vectors
    return np.asarray(vectors / np.max(np.abs(vectors), axis=0))


def vectors_of_map(transition: Transition, multipliers: ComplexArray, scale: Array) -> ComplexArray:
    """Floquet vectors at phase zero of a flow that is reversible alone, from the map M itself; shape (2n, 2n).

    Columns go with `multipliers`, those of the double eigenvalue of the trivial pair as they come; positions and
    velocities are multiplied by `scale` and columns scaled to largest entry 1.
    """
    from scipy.optimize import linear_sum_assignment

    n = transition.matrix.shape[0] // 2
    reversal = np.diag(np.repeat([1.0, -1.0], n))
    half = reversal @ np.linalg.inv(transition.matrix) @ reversal @ transition.matrix
    values, vectors = np.linalg.eig(half.astype(complex))
    _, order = linear_sum_assignment(np.abs(multipliers[:, None] - values[None, :] ** power_of(transition)))
    vectors = np.concatenate([scale, scale])[:, None] * vectors[:, order]
    return np.asarray(vectors / np.max(np.abs(vectors), axis=0))
