"""Flow maps across the free motions of a model: what a conserved momentum makes trivial is taken out of every map.

Where forces do not change along a direction w, Phi (w, 0) = (w, 0) and Phi (0, w) = (t w, w): the two span an invariant
subspace with a pair of multipliers 1. The flow on the quotient, F^T Phi F with columns F of an orthonormal complement
of w, is that of relative positions; it has all other multipliers, and is symplectic where the forces have a potential.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from casadi_skin.stability.stepping import FlowMap, OrbitState, Transition
from casadi_skin.zero.problem import Array, Problem


def complement(directions: Array) -> Array:
    """Orthonormal columns that span what is orthogonal to the columns of (n, m), m < n."""
    return np.asarray(np.linalg.qr(directions, mode="complete")[0][:, directions.shape[1] :])


def relative(transition: Transition, frame: Array) -> Transition:
    """A transition matrix with all that estimates its errors, across what the columns of a frame leave out."""

    def across(matrix: Array) -> Array:
        n, size = frame.shape
        blocks = matrix.reshape(2, n, 2, n).swapaxes(1, 2)
        return np.asarray((frame.T @ blocks @ frame).swapaxes(1, 2).reshape(2 * size, 2 * size))

    pair, truncation = transition.pair, transition.truncation
    return replace(
        transition,
        matrix=across(transition.matrix),
        truncation=None if truncation is None else across(truncation),
        pair=None if pair is None else (across(pair[0]), across(pair[1])),
    )


@dataclass(frozen=True)
class RelativeFlow:
    """A flow map of relative positions, the `frame` of which has orthonormal columns; see `FlowMap`."""

    flow: FlowMap
    frame: Array

    @property
    def batch(self) -> int:
        return self.flow.batch

    def transition(self, problem: Problem, z: Array) -> Transition:
        return relative(self.flow.transition(problem, z), self.frame)

    def transitions(
        self, orbits: Sequence[OrbitState], tolerance: float | None = None, banded: bool = False, alike: bool = False
    ) -> list[Transition]:
        found = self.flow.transitions(orbits, tolerance, alike=alike)
        return [relative(transition, self.frame) for transition in found]
