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

from casadi_skin.stability.flows import FlowMap, OrbitState, Transition, complement
from casadi_skin.stability.reduction import (
    ComplexArray,
    Eigensystems,
    Reflections,
    blocks_of,
    frobenius_norms,
    half_cosine_errors,
    half_cosines,
    stacked,
    vectors_of,
    with_reversed_blocks,
)
from casadi_skin.stability.result import (
    ContinuousSpectrum,
    CutTail,
    Floquet,
    reversible_floquet,
    reversible_floquets,
    root_of,
)
from casadi_skin.zero.problem import Array, Indices

MACHINE_EPSILON = float(np.finfo(float).eps)
ERROR_FLOOR = 0.1  # of the largest error in an orbit: W_ii can vanish where the error that it stands for does not


def eigenvalue_errors(
    systems: Eigensystems, parts: Sequence[Array], norms: Array, round_off: Array
) -> tuple[Array, Array]:
    """Estimated absolute errors of the eigenvalues, and |W_ii| of the first part alone, each (points, m).

    Arguments:
        systems: eigenvalues with their vectors.
        parts: matrices like the errors of the matrices, each (points, m, m), whose moduli of W are added.
        norms: Frobenius norms of all parts together, shape (points,).
        round_off: norms of errors of which nothing more is known, shape (points,).
    """
    values, left = systems.values, systems.left
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        each, sizes = [np.abs(left @ systems.images(part)) for part in parts], np.linalg.norm(left, axis=2)
        alone, by_rounding = np.diagonal(each[0], axis1=1, axis2=2), round_off[:, None] * sizes
        W = sum(each) + by_rounding[:, :, None]
        first = np.diagonal(W, axis1=1, axis2=2)
        product, distances = W * W.swapaxes(1, 2), np.abs(values[:, :, None] - values[:, None, :])
        pairs = np.minimum(product / np.maximum(distances, MACHINE_EPSILON), np.sqrt(product))
        np.einsum("pii->pi", pairs)[:] = 0.0
        found = first + ERROR_FLOOR * np.max(first, axis=1, keepdims=True) + np.max(pairs, axis=2, initial=0.0)
    # A pair moves by the root of the matrix's error at most, when it is defective; W is infinite there.
    return np.asarray(np.fmin(found, np.sqrt(norms + round_off)[:, None])), alone


ORBIT_SAFETY = 2.0
ROUND_OFF = 4e-16  # of a transition matrix, relative to its norm, as it shows in mu
NORM_PER_MU = 30.0  # norm of a flow's error over its part in mu: measured, 7 to 1000 for nine of ten random orbits
COARSEST_ERROR = 1e-2  # error of a transition matrix above which its estimate means little
MOST_RETRIES = 2
POWERS_BY_FRACTION = {0.25: 2, 0.5: 1}  # of lambda(M) that give multipliers, by that of the period for Phi


@dataclass(frozen=True)
class _Solved:
    """Results, with the part of the errors of mu that the flow makes, relative to max(1, |mu|), of each orbit."""

    results: list[Floquet]
    flow_errors: Array
    reflections: Reflections | None
    systems: Eigensystems
    similar: Array


def floquet(transition: Transition, acceleration: Array) -> Floquet:
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
    pairs: int = 1,
) -> list[Floquet]:
    """Multipliers of several orbits of one model, with the errors of the flow and of the orbits in those of mu.

    The flow's part is brought below `tolerance`, relative to max(1, |mu|), where mu is not near a defective pair.
    `accelerations` gives q'' at phase zero, shape (orbits, n); `symplectic` is true where the equations are Hamiltonian
    in positions and velocities, `pairs` the number of pairs of trivial multipliers. Raises FlowError.
    """

    def solve(found: Sequence[Transition], places: Indices) -> _Solved:
        return _solve(found, starts[places], better[places], symplectic, pairs)

    starts, better = np.split(accelerations([*orbits, *(orbit.better or orbit for orbit in orbits)]), 2)
    transitions = flow.transitions(orbits, min(NORM_PER_MU * tolerance, COARSEST_ERROR))
    solved = solve(transitions, np.arange(len(orbits)))
    results, flow_errors = solved.results, solved.flow_errors
    for _ in range(MOST_RETRIES):
        waiting = np.flatnonzero(flow_errors > tolerance)
        norms = np.array([transitions[i].error for i in waiting.tolist()])
        shares = np.exp2(np.floor(np.log2(np.maximum(0.5 * norms / flow_errors[waiting], 1e-3))))
        for share in np.unique(shares).tolist():  # an orbit's own errors decide, not those of its batch
            those = waiting[shares == share]
            again = flow.transitions([orbits[i] for i in those.tolist()], share * tolerance)
            solved = solve(again, those)
            flow_errors[those] = solved.flow_errors
            for i, transition, result in zip(those.tolist(), again, solved.results, strict=True):
                transitions[i], results[i] = transition, result
    return results


def _solve(
    transitions: Sequence[Transition],
    accelerations: Array | None,
    better: Array | None,
    symplectic: bool = True,
    pairs: int = 1,
) -> _Solved:
    """With the trivial direction that accelerations give taken out; of all mu, with no trivial one, where without."""
    power, matrices = POWERS_BY_FRACTION[transitions[0].fraction], stacked([t.matrix for t in transitions])
    truncations = stacked([np.zeros_like(t.matrix) if t.truncation is None else t.truncation for t in transitions])
    sides = [
        stacked(side)
        for side in zip(*((t.matrix, t.matrix) if t.pair is None else t.pair for t in transitions), strict=True)
    ]
    if not symplectic:
        matrices, truncations = with_reversed_blocks(matrices, truncations)
        sides = [with_reversed_blocks(side, np.zeros_like(side))[0] for side in sides]
    own, others = (None if each is None else Reflections.of(each) for each in (accelerations, better))
    similar, deviations = half_cosines(matrices), np.zeros(len(transitions))
    reduced, parts = similar, [half_cosine_errors(matrices, truncations), *map(half_cosines, sides)]
    if own is not None and others is not None:
        similar = own.similar(similar)
        # (0, a_0) is a left eigenvector: the first row is (trivial, 0, ..., 0) but for the errors of flow and orbit.
        similar[:, 0, 0] -= -1.0 if power == 2 else 0.0
        deviations, reduced = np.max(np.abs(similar[:, 0]), axis=1), similar[:, 1:, 1:]
        parts = [each.similar(part)[:, 1:, 1:] for each, part in zip((own, own, others), parts, strict=True)]
    parts = [parts[0], ORBIT_SAFETY * (parts[2] - parts[1])]
    mu, errors = np.zeros(reduced.shape[:2], dtype=complex), np.zeros(reduced.shape[:2])
    flow_errors, systems = np.zeros(len(transitions)), Eigensystems(mu, reduced, reduced)
    if mu.size:
        norms, round_off = frobenius_norms(parts[0]) + frobenius_norms(parts[1]), _round_off(transitions, matrices)
        for those, systems in Eigensystems.groups(reduced):
            of_those = [part[those] for part in parts], norms[those], round_off[those]
            mu[those] = systems.values
            errors[those], first = eigenvalue_errors(systems, *of_those)
            flow_errors[those] = np.max(first / np.maximum(1.0, np.abs(systems.values)), axis=1)
    results = reversible_floquets(mu, errors, deviations.tolist(), power, pairs)
    return _Solved(results, flow_errors, own, systems, similar)


def _round_off(transitions: Sequence[Transition], matrices: Array) -> Array:
    """Norm of the errors of B^T C from round-off, and from a flow without a matrix of its errors; shape (orbits,)."""
    _, B, C, _ = blocks_of(matrices)
    unknown = ROUND_OFF * frobenius_norms(matrices)
    without = [i for i, transition in enumerate(transitions) if transition.truncation is None]
    unknown[without] = [transitions[i].error for i in without]
    return np.asarray(unknown * (frobenius_norms(B) + frobenius_norms(C)))


def trivial_pair(transition: Transition, acceleration: Array) -> tuple[Array, Array]:
    """Velocity of the flow and direction along the family at phase zero, (positions, velocities) in the gauge, (2n,).

    The second is the right eigenvector of B^T C for the trivial mu: bordered with the left one, the matrix is regular.
    """
    _, B, C, _ = transition.blocks()
    n, trivial = acceleration.size, -1.0 if POWERS_BY_FRACTION[transition.fraction] == 2 else 0.0
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
    assert reflections is not None
    A, _, C, _ = transition.blocks()
    columns = [vector.astype(complex) for vector in trivial_pair(transition, acceleration)]
    for mu, root, reduced in zip(result.mu, root_of(result.mu, result.mu_error)[0], systems.right[0].T, strict=True):
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
    reversal = np.diag(np.repeat([1.0, -1.0], transition.matrix.shape[0] // 2))
    half = reversal @ np.linalg.inv(transition.matrix) @ reversal @ transition.matrix
    return vectors_of(half, multipliers, POWERS_BY_FRACTION[transition.fraction], np.concatenate([scale, scale]))


# The matrices that decide stability, from transition matrices over half of the time that M takes ----------------------


def reduced_matrices(
    transitions: Array, errors: Array, directions: Array | None, symplectic: bool
) -> tuple[Array, Array]:
    """(K, P, Q), or K alone, without the trivial direction, and matrices like their errors; (points, 3 or 1, m, m).

    K = B^T C, P = A^T C and Q = B^T D, with the first-order changes that errors make.

    Arguments:
        transitions: Phi, shape (points, 2n, 2n).
        errors: matrices like their errors, of one shape with them.
        directions: q'' at phase zero, shape (points, n); None where no direction is trivial.
        symplectic: whether Phi is.
    """
    if not symplectic:
        transitions, errors = with_reversed_blocks(transitions, errors)
    values, changes = half_cosines(transitions)[:, None], half_cosine_errors(transitions, errors)[:, None]
    if symplectic:
        (A, B, C, D), (dA, dB, dC, dD) = (
            [block.swapaxes(1, 2) if i < 2 else block for i, block in enumerate(blocks_of(each))]
            for each in (transitions, errors)
        )
        forms = np.stack([A @ C, B @ D], axis=1), np.stack([dA @ C + A @ dC, dB @ D + B @ dD], axis=1)
        values, changes = (
            np.concatenate([each, 0.5 * (form + form.swapaxes(2, 3))], axis=1)
            for each, form in zip((values, changes), forms, strict=True)
        )
    if directions is None:
        return values, changes
    frame = orthogonal_complements(directions)[:, None]
    across = frame.swapaxes(2, 3)
    return np.asarray(across @ values @ frame), np.asarray(across @ changes @ frame)


def orthogonal_complements(directions: Array) -> Array:
    """Orthonormal bases of the orthogonal complement of each direction, smooth along them; to (points, n, n - 1).

    A reflection maps each direction to that of the middle one, whose complement is the same for all.
    """
    n = directions.shape[1]
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    middle = unit[len(unit) // 2]
    fixed = np.linalg.qr(np.column_stack([middle, np.eye(n)]))[0][:, 1:]
    u = unit + middle
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    return np.asarray(fixed - 2.0 * u[:, :, None] * (u @ fixed)[:, None, :])


# Localised multipliers of an orbit at the edge of a long linear tail, from a variational problem that is cut ----------

CORNER_CELLS = 4  # at the cut, where B^T C is not that of a longer chain: farther in it differs by less than their size
ERROR_SAFETY = 2.0
WAVE_CHANGE = 1e-3  # what the cut may change of a mu that belongs to a wave: measured 0.03 to 0.5, falling as 1/sites


def localised_floquet(
    transition: Transition,
    accelerations: tuple[Array, Array],
    tolerance: float,
    bands: tuple[tuple[float, float], ...],
    Omega: float,
    cut_first: bool,
    cell: int = 1,
) -> Floquet:
    """Localised multipliers of a symplectic transition matrix of a cut variational problem.

    Arguments:
        transition: over a quarter or half of the period, of n sites at the edge.
        accelerations: q'' at phase zero of the orbit and of the better one that shows its error, each (n,).
        tolerance: largest change of a localised mu by the cut, relative to max(1, |mu|).
        bands: lowest and highest frequency of each band of the tail.
        Omega: frequency of the orbit.
        cut_first: whether the cut is at the first site; else it is at the last.
        cell: sites of a cell of the tail.

    Returns:
        The multipliers, with errors of flow, orbit, rounding and cut.
    """
    solved, n = _solve([transition], accelerations[0][None], accelerations[1][None]), accelerations[0].size
    (found,) = solved.results
    power, trivial = found.power, -1.0 if found.power == 2 else 0.0
    bound = found.trivial_deviation <= tolerance
    if not bound:  # the velocity of the flow fills the tail: the cut problem has no such vector
        solved = _solve([transition], None, None)
    systems, errors = solved.systems, solved.results[0].mu_error
    if bound:
        errors = errors + _by_deviation(systems, solved.similar[0], trivial)
    corner = slice(0, CORNER_CELLS * cell) if cut_first else slice(-CORNER_CELLS * cell, n)
    cut = _by_cut(systems, None if solved.reflections is None else solved.reflections.u[0], corner)
    mu, local = systems.values[0], cut <= tolerance * np.maximum(1.0, np.abs(systems.values[0]))
    if not bound:  # the velocity of the flow may decay enough to be localised all the same
        local &= np.abs(mu - trivial) > errors + cut
    off = ~root_of(mu, errors)[1] & ~local
    waves, undecided = mu[off & (cut > WAVE_CHANGE)], mu[off & (cut <= WAVE_CHANGE)]
    tail = CutTail(ContinuousSpectrum(Omega, bands, power), n, waves, undecided)
    deviation = found.trivial_deviation if bound else 0.0
    return replace(reversible_floquet(mu[local], (errors + cut)[local], deviation, power), tail=tail)


def _by_deviation(systems: Eigensystems, similar: Array, trivial: float) -> Array:
    """The shift of each mu by the rest of the trivial direction's row, by way of the trivial one."""
    along = np.abs(systems.left[0] @ similar[1:, 0]) * np.abs(similar[0, 1:] @ systems.right[0])
    distance = np.maximum(np.abs(systems.values[0] - trivial), np.finfo(float).eps)
    return np.asarray(np.minimum(along / distance, np.sqrt(along)))


def _by_cut(systems: Eigensystems, u: Array | None, corner: slice) -> Array:
    """The shift of each mu by the sites beyond the cut: its right vector there times its left one."""
    right, left = systems.right[0], systems.left[0]
    if u is not None:
        right = np.vstack([np.zeros(right.shape[1]), right]) - 2.0 * np.outer(u, u[1:] @ right)
        left = np.column_stack([np.zeros(left.shape[0]), left]) - 2.0 * np.outer(left @ u[1:], u)
    sizes = np.linalg.norm(right[corner], axis=0) * np.linalg.norm(left[:, corner], axis=1)
    return np.asarray(ERROR_SAFETY * np.maximum(1.0, np.abs(systems.values[0])) * sizes)
