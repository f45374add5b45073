"""Transient growth of perturbations of an orbit: singular values of the physical variational flow.

A stable orbit of a nonreciprocal chain can amplify a perturbation by about r^((N-1)/2) before it stays bounded: the
flow is far from normal in physical coordinates (Trefethen and Embree 2005, chapter 14). X = D Y D^-1, D = diag(rho,
rho), with Y the flow in the gauge. Entries of Y far from the diagonal are tiny and are computed to a relative accuracy
by the explicit splitting, so that D Y D^-1 keeps its digits; it is scaled by its largest entry in logarithms, so that
nothing overflows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from casadi_skin.model.result import Result
from casadi_skin.stability.flows import Transition
from casadi_skin.stability.multipliers import trivial_pair
from casadi_skin.zero.problem import Array


@dataclass(frozen=True, eq=False)
class TransientGrowth(Result):
    """Largest amplification of a perturbation against time, in the Euclidean norm of (positions, velocities).

    `t` has shape (times,): multiples of a quarter of the period. `log10_gain` is over all perturbations,
    `log10_bounded` over those without a component in the trivial pair (a shift of phase, and the linear growth along
    the family that it brings), `log10_trivial` over that pair alone; each (times,). `optimal` is the unit perturbation
    of the largest `log10_bounded`, `response` what becomes of it, scaled to norm 1; each (2N,).
    """

    t: Array
    log10_gain: Array
    log10_bounded: Array
    log10_trivial: Array
    optimal: Array
    response: Array
    _flows: tuple[Array, ...]
    _log_rho: Array

    def __repr__(self) -> str:
        largest = f"largest of bounded perturbations 10^{np.max(self.log10_bounded):.6g}"
        return f"<TransientGrowth: {self.t.size} times from 0 to {self.t[-1]:g}, {largest}>"

    def of(self, perturbation: Array) -> Array:
        """log10 of the amplification of one perturbation (2N,), not zero, against time, shape (times,)."""
        z = perturbation / np.linalg.norm(perturbation)
        gains = []
        for flow in self._flows:
            matrix, log_scale = _physical(flow, self._log_rho)
            gains.append(np.log10(np.linalg.norm(matrix @ z)) + log_scale / np.log(10.0))
        return np.array(gains)


def transient_growth(
    transition: Transition,
    acceleration: Array,
    log_rho: Array,
    period: float,
    quarters: int = 40,
    free_motions: Array | None = None,
) -> TransientGrowth:
    """Growth at 0, 1, ..., `quarters` quarter periods of a reversible odd orbit, from its quarter-period transition.

    `acceleration` is q'' at phase zero in the gauge, `log_rho` the logarithm of the gauge factor, each (N,);
    `free_motions`, (N, any), are columns along which no force changes, whose pairs are trivial as well. Use a
    transition of the splitting flow: others fill far entries with round-off. Raises ValueError for another fraction.
    """
    if transition.fraction != 0.25:
        raise ValueError(
            f"transient_growth: given a transition over {transition.fraction} of the period; accepted: 0.25"
        )
    A, B, C, D = transition.blocks()
    identity = np.eye(acceleration.size)
    half = np.block([[identity + 2 * B.T @ C, 2 * B.T @ D], [2 * A.T @ C, identity + 2 * C.T @ B]])
    flows: list[Array] = [np.eye(2 * acceleration.size)]
    for k in range(1, quarters + 1):
        flows.append(transition.matrix @ flows[k - 1] if k % 2 else half @ flows[k - 2])
    free = np.empty((acceleration.size, 0)) if free_motions is None else free_motions
    bounded, trivial = _subspaces([*trivial_pair(transition, acceleration), *np.kron(np.eye(2), free).T], log_rho)

    gains, vectors = [], []
    for flow in flows:
        matrix, log_scale = _physical(flow, log_rho)
        parts = [_largest(part, log_scale) for part in (matrix, matrix @ bounded, matrix @ trivial)]
        gains.append([part[0] for part in parts])
        vectors.append(parts[1][1:])
    table = np.array(gains)
    optimal, response = vectors[int(np.argmax(table[:, 1]))]
    t = np.asarray(0.25 * period * np.arange(quarters + 1), dtype=float)
    columns = (table[:, 0], table[:, 1], table[:, 2])
    return TransientGrowth(t, *columns, bounded @ optimal, response, tuple(flows), log_rho)


def _subspaces(trivial: Sequence[Array], log_rho: Array) -> tuple[Array, Array]:
    """Orthonormal physical bases of the perturbations without the trivial ones, (2N, 2N - k), and of these, (2N, k).

    The former are symplectically orthogonal to the latter, as the flow's velocity and the family direction: orthogonal,
    in physical coordinates, to D^-1 J of these.
    """
    n = log_rho.size
    normals = np.stack([_rescaled(np.concatenate([v[n:], -v[:n]]), -log_rho) for v in trivial], axis=1)
    directions = np.stack([_rescaled(v, log_rho) for v in trivial], axis=1)
    complete = np.linalg.qr(normals, mode="complete")[0]
    return complete[:, len(trivial) :], np.linalg.qr(directions)[0]


def _rescaled(vector: Array, log_factor: Array) -> Array:
    """(positions, velocities) times exp(log_factor) at each site, scaled to largest entry 1."""
    with np.errstate(divide="ignore"):
        logs = np.log(np.abs(vector)) + np.concatenate([log_factor, log_factor])
    return np.asarray(np.sign(vector) * np.exp(logs - np.max(logs)))


def _physical(matrix: Array, log_rho: Array) -> tuple[Array, float]:
    """D matrix D^-1 divided by its largest entry, and the logarithm of that entry."""
    log_d = np.concatenate([log_rho, log_rho])
    with np.errstate(divide="ignore"):
        logs = np.log(np.abs(matrix)) + log_d[:, None] - log_d
    largest = float(np.max(logs))
    return np.sign(matrix) * np.exp(logs - largest), largest


def _largest(matrix: Array, log_scale: float) -> tuple[float, Array, Array]:
    """log10 of the largest singular value of exp(log_scale) matrix, with its right and left singular vectors."""
    left, values, right = np.linalg.svd(matrix, full_matrices=False)
    return float(np.log10(values[0]) + log_scale / np.log(10.0)), right[0], left[:, 0]
