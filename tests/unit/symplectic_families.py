"""Families of transition matrices with instabilities at prescribed places, as `find_changes` takes a branch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm

from casadi_skin.stability.tongues.interpolation import Samples

Array = np.ndarray
Entries = Callable[[float], Array]


def cubic(*coefficients: float) -> Callable[[float], float]:
    """A polynomial in the coordinate, constant term first."""
    return lambda s: float(np.polynomial.polynomial.polyval(s, coefficients))


def collision(distance: Callable[[float], float], coupling: float, square: float = 1.5) -> Entries:
    """Two modes of opposite signatures, complex where their squared frequencies are less than 2 coupling apart.

    H = p.B.p/2 + q.A.q/2 with B = diag(1, -1); squared frequencies are the eigenvalues of B A, and `distance` apart
    without the coupling. Returns (A, B).
    """

    def entries(s: float) -> Array:
        d = 0.5 * distance(s)
        a, b = square + d, square - d
        return np.array([[[a, coupling], [coupling, -b]], [[1.0, 0.0], [0.0, -1.0]]])

    return entries


def passage(distance: Callable[[float], float], coupling: float = 0.0, square: float = 1.5) -> Entries:
    """Two modes of one signature whose squared frequencies meet, or avoid each other, where `distance` is zero."""

    def entries(s: float) -> Array:
        d = 0.5 * distance(s)
        return np.array([[[square + d, coupling], [coupling, square - d]], np.eye(2)])

    return entries


def real(stiffness: Callable[[float], float], mobility: Callable[[float], float] = lambda s: 1.0) -> Entries:
    """One mode whose squared frequency is stiffness times mobility: real instability where that is negative."""
    return lambda s: np.array([[[stiffness(s)]], [[mobility(s)]]])


def cluster(squares: Sequence[Callable[[float], float]], signs: Sequence[int], couplings: Array) -> Entries:
    """Several modes with signatures `signs` and squared frequencies, coupled by a symmetric matrix."""

    def entries(s: float) -> Array:
        A = np.diag([sign * square(s) for sign, square in zip(signs, squares, strict=True)]) + couplings
        return np.array([A, np.diag(np.array(signs, dtype=float))])

    return entries


@dataclass
class SymplecticFamily:
    """Blocks side by side, mixed by a change of coordinates that turns along the branch.

    M = exp(J diag(A, B)) for each s, from Phi = exp(J diag(A, B)/2). `swapped` multiplies Phi by a matrix that makes M
    into -M: what happened at mu = 0 then happens at mu = -1. `error` is what the flow says of its errors, `noise` what
    they are: entries that differ from one coordinate to the next without any order. `bias` of what the flow says of its
    errors is in the matrices everywhere.
    """

    blocks: Sequence[Entries]
    swapped: bool = False
    S: Callable[[Array], Array] = field(default=lambda s: s)
    error: float = 0.0
    noise: float = 0.0
    bias: float = 0.0
    sections: Sequence[tuple[float, float]] = ((0.0, 1.0),)
    fraction: float = 0.25
    symplectic: bool = True

    def transition(self, s: float) -> Array:
        """Phi at a coordinate."""
        blocks = [block(s) for block in self.blocks]
        ends = np.cumsum([0, *(block.shape[1] for block in blocks)])
        n = int(ends[-1])
        generator, mixed = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, 2 * n))
        for (A, B), first, last in zip(blocks, ends[:-1], ends[1:], strict=True):
            generator[first:last, n + first : n + last] = B
            generator[n + first : n + last, first:last] = -A
        Phi = expm(0.5 * generator)
        if self.swapped:
            Phi = np.concatenate([Phi[n:], -Phi[:n]])
        k = np.arange(n)
        turn = expm(0.3 * (1.0 + s) * np.cos(1.0 + np.add.outer(k**2, 3.0 * k)) / n)
        mixed[:n, :n], mixed[n:, n:] = np.linalg.inv(turn), turn.T
        if not self.noise:
            return Phi @ mixed
        return Phi @ mixed + self.noise * np.random.default_rng(hash(s) % 2**32).uniform(-1.0, 1.0, Phi.shape)

    def sample(self, coordinates: Array) -> Samples:
        """Samples at coordinates."""
        transitions = np.array([self.transition(s) for s in coordinates.tolist()])
        errors = self.error * np.cos(np.arange(transitions[0].size)).reshape(transitions[0].shape)
        transitions += self.bias * errors
        S = self.S(coordinates)
        return Samples(transitions, np.tile(errors, (len(S), 1, 1)), None, S, np.ones_like(S))

    def amplitude(self, coordinate: float) -> float:
        """S at a coordinate."""
        return float(self.S(np.array([coordinate]))[0])


@dataclass
class ReversibleFamily:
    """q'' = -W(s) q with W not symmetric: reversible, not symplectic; M over time 1."""

    entries: Callable[[float], Array]
    sections: Sequence[tuple[float, float]] = ((0.0, 1.0),)
    fraction: float = 0.25
    symplectic: bool = False

    def sample(self, coordinates: Array) -> Samples:
        """Samples at coordinates."""
        transitions = []
        for s in coordinates.tolist():
            W = self.entries(s)
            zero = np.zeros_like(W)
            transitions.append(expm(0.5 * np.block([[zero, np.eye(len(W))], [-W, zero]])))
        S = np.array(coordinates)
        return Samples(np.array(transitions), np.zeros_like(transitions), None, S, np.ones_like(S))

    def amplitude(self, coordinate: float) -> float:
        """S at a coordinate."""
        return coordinate
