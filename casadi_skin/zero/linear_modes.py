"""Linear modes of a model of second order about rest, in positions scaled so that its couplings are symmetric."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from casadi_skin.zero.problem import Array

SYMMETRY_RTOL = 1e-12  # relative difference of entries that are the same but for rounding
REST_FORCE_RTOL = 1e-12  # force at 0 of a model that rests there, relative to its stiffness
NODE_AMPLITUDE_RTOL = 1e-12  # of the largest amplitude: rounding at sites where a mode rests
SMALL_MODE_AMPLITUDE = 1e-7  # of the largest amplitude of a mode: below it rounding would show where displacements lean


@dataclass(frozen=True)
class LinearModes:
    """Modes of q'' = -K q with y = D q: squares of frequencies ascending, and modes as columns in q.

    `left` holds the left eigenvectors as rows, the modes themselves where K is symmetric. `log_scale` is log D, and
    `stiffness` is K in q, exactly symmetric where it can be made so.
    """

    squares: Array
    modes: Array
    left: Array
    log_scale: Array
    stiffness: Array
    symmetric: bool


def linear_modes(force: ca.SX, state: ca.SX, name: str) -> LinearModes:
    """Modes of the linearised equations about rest, in coordinates that make them symmetric where there are such.

    Arguments:
        force: accelerations, a column of expressions in `state` alone.
        state: positions.
        name: the model's, for messages.

    Returns:
        Modes in ascending order of their squared frequencies.

    Raises:
        ValueError: the model does not rest at 0, is not finite or smooth there, or a frequency is complex.
    """
    K, at_rest = _at_rest(force, state, name)
    if np.max(np.abs(at_rest)) > REST_FORCE_RTOL * max(1.0, float(np.max(np.abs(K)))):
        raise ValueError(f"{name}: its families grow from rest at 0; accepted: forces that are finite and vanish there")
    log_scale = scale_of_couplings(K, force, state)
    if log_scale is not None:
        scale = np.exp(log_scale)
        K = K / scale[:, None] * scale
        K = 0.5 * (K + K.T)
        squares, modes = np.linalg.eigh(K)
        return LinearModes(squares, modes, modes.T, log_scale, K, True)
    from scipy.linalg import eig

    values, vectors = eig(K)
    if np.max(np.abs(values.imag)) > np.sqrt(SYMMETRY_RTOL) * np.max(np.abs(values)):
        worst = values[np.argmax(np.abs(values.imag))]
        raise ValueError(f"{name}: omega^2 = {worst:.6g} of a linear mode is complex; accepted: real ones")
    order = np.argsort(values.real)
    modes = vectors.real[:, order]
    return LinearModes(values.real[order], modes, np.linalg.inv(modes), np.zeros(len(K)), K, False)


def _at_rest(force: ca.SX, state: ca.SX, name: str) -> tuple[Array, Array]:
    """Stiffness and force at 0; raises ValueError, naming the force, where one of them is not finite.

    They are computed in numbers, as a family computes them: an expression simplifies 0 * inf and 0 / 0 away.
    """
    columns = [ca.densify(force), ca.densify(ca.jacobian(force, state))]
    at_rest, slopes = (np.array(v) for v in ca.Function("rest", [state], columns)(ca.DM.zeros(state.numel())))
    if np.all(np.isfinite(at_rest)) and np.all(np.isfinite(slopes)):
        return -slopes, at_rest
    bad = int(np.argmax(~np.isfinite(np.hstack([at_rest, slopes])).all(axis=1)))
    place = f"{name}: the force on {state[bad].name()}"
    if not np.isfinite(at_rest[bad, 0]):
        raise ValueError(f"{place} is not finite at rest; accepted: forces that are finite and vanish there")
    by = state[int(np.argmax(~np.isfinite(slopes[bad])))].name()
    accepted = "families grow from rest; accepted: forces with finite derivatives there"
    raise ValueError(f"{place} is not smooth at rest: its derivative by {by} is not finite; {accepted}")


def with_small_amplitudes(mode: Array, stiffness: Array, square: float) -> Array:
    """A mode whose amplitudes below SMALL of the largest are right relative to themselves, from those above."""
    small = np.abs(mode) < SMALL_MODE_AMPLITUDE * np.max(np.abs(mode))
    if not small.any():
        return mode
    from scipy.linalg import solve
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    found, indices = mode.copy(), np.flatnonzero(small)
    inside = stiffness[np.ix_(small, small)] - square * np.eye(indices.size)
    count, part = connected_components(csr_array(inside))
    for k in range(count):
        here = part == k
        block = inside[np.ix_(here, here)]
        if np.min(np.abs(np.linalg.eigvalsh(block))) > SMALL_MODE_AMPLITUDE * np.max(np.abs(stiffness)):
            found[indices[here]] = solve(block, -stiffness[indices[here]][:, ~small] @ mode[~small])
        elif np.max(np.abs(mode[indices[here]])) < NODE_AMPLITUDE_RTOL * np.max(
            np.abs(mode)
        ):  # sites of a node, which rest
            found[indices[here]] = 0.0
    return found


def scale_of_couplings(K: Array, force: ca.SX, state: ca.SX) -> Array | None:
    """The scale that makes the stiffness K at rest symmetric, and the couplings that there are none of at rest too.

    Couplings without a linear part show at a random state; where no scale serves both, that of the linear ones is
    found.
    """
    derivative = ca.jacobian(force, state)
    coupled = derivative.sparsity().nnz() > np.count_nonzero(K) + np.count_nonzero(np.diag(K) == 0.0)
    if coupled:
        random = np.random.default_rng(0).normal(size=len(K))
        J = np.array(ca.Function("J", [state], [ca.densify(derivative)])(random))
        log_scale = symmetrising_scale(-J) if np.all(np.isfinite(J)) else None
        if log_scale is not None:
            S = K / np.exp(log_scale)[:, None] * np.exp(log_scale)
            if np.max(np.abs(S - S.T)) <= SYMMETRY_RTOL * len(K) * np.max(np.abs(S)):
                return log_scale
    return symmetrising_scale(K)


def symmetrising_scale(K: Array) -> Array | None:
    """Logarithms of factors D with D^-1 K D symmetric and largest factor 1 in each connected part; None without any.

    There are such factors where the products of opposite couplings are positive and agree around every loop
    (Kolmogorov's criterion): a walk over the couplings finds them, and every coupling is checked.
    """
    if np.any((K != 0.0) != (K.T != 0.0)) or np.any(K * K.T < 0.0):
        return None
    log_scale, part, pairs = np.zeros(len(K)), np.arange(len(K)), np.argwhere(np.triu(K, 1))
    for _, i, j, _ in tree_of(len(K), pairs.tolist(), range(len(K))):  # d_i^2 / d_j^2 = K_ij / K_ji
        log_scale[j], part[j] = log_scale[i] - 0.5 * np.log(K[i, j] / K[j, i]), part[i]
    for first in np.unique(part):
        log_scale[part == first] -= np.max(log_scale[part == first])
    rows, columns = np.nonzero(K)
    ratios = np.log(K[rows, columns] / K[columns, rows])
    mismatch = 2.0 * (log_scale[rows] - log_scale[columns]) - ratios
    return log_scale if np.max(np.abs(mismatch), initial=0.0) <= SYMMETRY_RTOL * len(K) else None


def tree_of(size: int, pairs: Sequence[Sequence[int]], firsts: Iterable[int]) -> Iterator[tuple[int, int, int, bool]]:
    """Pairs of a tree through each connected part of a graph, breadth first.

    Arguments:
        size: number of places.
        pairs: of places that are joined.
        firsts: places, in whose order parts are gone through, each from the first of these in it.

    Returns:
        Of each pair of the trees its number, the place from which and that to which it is gone along, and whether
        these are in its order.
    """
    touching: list[list[tuple[int, int, bool]]] = [[] for _ in range(size)]
    for k, (i, j) in enumerate(pairs):
        touching[i].append((k, j, True))
        touching[j].append((k, i, False))
    seen = [False] * size
    for first in firsts:
        queue = deque([] if seen[first] else [first])
        seen[first] = True
        while queue:
            here = queue.popleft()
            for k, there, forwards in touching[here]:
                if not seen[there]:
                    seen[there] = True
                    queue.append(there)
                    yield k, here, there, forwards
