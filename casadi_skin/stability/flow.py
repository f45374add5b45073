"""Flow maps of the variational system: an orbit in, its transition matrix over a part of the period out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from casadi_skin.zero.problem import Array, Problem


@dataclass(frozen=True)
class OrbitState:
    """An orbit as a flow map takes it: unknowns z of a problem, and the same orbit better known where there is one.

    The difference between transition matrices along the orbit and along `better` is the error that the orbit makes.
    """

    problem: Problem
    z: Array
    better: OrbitState | None = None

    @property
    def Omega(self) -> float:
        """Frequency."""
        return self.problem.frequency(self.z)

    @property
    def parameter(self) -> float:
        """Value of the free parameter."""
        return float(self.z[self.problem.parameter_index])


@dataclass(frozen=True)
class Transition:
    """Transition matrix Phi of (positions, velocities) over `fraction` of the period, with its estimated errors.

    `error` estimates the Frobenius norm of the error of Phi that the integration makes; `truncation` is a matrix
    like that error but for its sign, without round-off. Errors of the orbit itself, which leave Phi symplectic, are in
    neither: `pair` holds Phi along the orbit and along the better one, computed with the same steps, where it is known.
    All of these matrices may be stored by the bands of their blocks, see `stability.banded`. `steps` is the number of
    equal steps, 0 of flows without such.
    """

    matrix: Array
    fraction: float
    error: float
    truncation: Array | None = None
    pair: tuple[Array, Array] | None = None
    steps: int = 0

    def blocks(self) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D of Phi = [[A, B], [C, D]], each (n, n)."""
        n = self.matrix.shape[0] // 2
        m = self.matrix
        return m[:n, :n], m[:n, n:], m[n:, :n], m[n:, n:]


class FlowMap(Protocol):
    """Computes transition matrices of the variational system along orbits of one model.

    `batch` is the number of orbits that are best given together: more cost no less each.
    """

    @property
    def batch(self) -> int: ...

    def transition(self, problem: Problem, z: Array) -> Transition:
        """Transition matrix along the orbit z of `problem`; raises FlowError where the tolerance is out of reach."""
        ...

    def transitions(
        self,
        orbits: Sequence[OrbitState],
        tolerance: float | None = None,
        banded: bool = False,
        alike: bool = False,
    ) -> list[Transition]:
        """Transition matrices along several orbits, to `tolerance` where it is not the flow's own.

        Where `banded`, those of long chains may be stored by the bands of their blocks, see `stability.banded`. Where
        `alike`, all are computed in one number of steps: their errors are smooth along a branch then. Raises FlowError
        where the tolerance is out of reach for any of them.
        """
        ...


class FlowError(ArithmeticError):
    """A flow map cannot reach its tolerance."""


def duration(orbit: OrbitState, fraction: float) -> float:
    """Time that a fraction of the orbit's period takes."""
    return 2.0 * np.pi * fraction / orbit.Omega
