"""Flow maps of the variational system: an orbit in, its transition matrix over a part of the period out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from casadi_skin.bvp.problem import Array, OrbitProblem


@dataclass(frozen=True)
class Transition:
    """Transition matrix Phi of (positions, velocities) over `fraction` of the period, and the flow's estimated error.

    `error` bounds the Frobenius norm of the error of Phi that the integration makes; errors of the orbit itself, which
    leave Phi symplectic, are not in it.
    """

    matrix: Array
    fraction: float
    error: float

    def blocks(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D of Phi = [[A, B], [C, D]], each (n, n)."""
        n = self.matrix.shape[0] // 2
        m = self.matrix
        return m[:n, :n], m[:n, n:], m[n:, :n], m[n:, n:]


class FlowMap(Protocol):
    """Computes transition matrices of the variational system along orbits of one model."""

    def transition(self, problem: OrbitProblem, z: Array) -> Transition:
        """Transition matrix along the orbit z of `problem`; raises FlowError where the tolerance is out of reach."""
        ...


class FlowError(ArithmeticError):
    """A flow map cannot reach its tolerance."""
