"""Floquet multipliers from the N x N problem of a reversible Hamiltonian orbit.

Let Phi = [[A, B], [C, D]] be the symplectic transition matrix over a quarter (half) of the period of an orbit that is
reversible and odd (reversible). The map over twice that time is M = R Phi^-1 R Phi, R = diag(I, -I), and since M is
reversible too, (M + M^-1)/2 = I + 2 diag(B^T C, C^T B). With mu the eigenvalues of B^T C: lambda(M) + 1/lambda(M) =
2 + 4 mu, and the multipliers over the period are lambda(M)^2 (lambda(M)). The orbit is stable if and only if every
mu is real and in [-1, 0]. The velocity of the flow, (0, a_0) at phase zero, is a left eigenvector of B^T C with the
trivial eigenvalue: it is taken out exactly by a reflection, so that no other eigenvalue that comes near it mixes
with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.stability.flow import Transition

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Floquet:
    """Linear stability of one orbit with n positions: n - 1 values of mu beside the trivial one.

    `mu` and `mu_error`, its errors estimated from the flow's, have shape (n - 1,); `trivial_deviation` is how far the
    trivial eigenvalue is from its exact value. `power` of lambda(M) gives the multipliers over the period.
    """

    mu: ComplexArray
    mu_error: Array
    trivial_deviation: float
    power: int

    @cached_property
    def is_real(self) -> NDArray[np.bool_]:
        """Which mu are real within their estimated errors."""
        return np.abs(self.mu.imag) <= self.mu_error

    @cached_property
    def is_inside(self) -> NDArray[np.bool_]:
        """Which mu are real and in [-1, 0] within their estimated errors."""
        inside = (self.mu.real >= -1.0 - self.mu_error) & (self.mu.real <= self.mu_error)
        return self.is_real & inside

    @property
    def stable(self) -> bool:
        """Whether every mu lies in [-1, 0] within the flow's estimated error."""
        return bool(np.all(self.is_inside))

    @property
    def unstable_real(self) -> int:
        """Number of multipliers outside the unit circle on the real axis."""
        return int(np.count_nonzero(self.is_real & ~self.is_inside))

    @property
    def unstable_complex(self) -> int:
        """Number of multipliers outside the unit circle off the real axis; a complex pair counts two."""
        return int(np.count_nonzero(~self.is_real))

    @cached_property
    def root(self) -> ComplexArray:
        """sqrt(mu) + sqrt(1 + mu) with modulus >= 1, whose square is lambda(M); on the unit circle for a stable mu."""
        stable = np.where(self.is_inside, np.clip(self.mu.real, -1.0, 0.0), 0.0)
        on_circle = np.sqrt(1.0 + stable) + 1j * np.sqrt(-stable)
        mu = np.where(self.is_real, self.mu.real + 0j, self.mu)
        off_circle = np.sqrt(mu) + np.sqrt(1.0 + mu)
        off_circle = np.where(np.abs(off_circle) < 1.0, 1.0 / off_circle, off_circle)
        return np.where(self.is_inside, on_circle, off_circle)

    @cached_property
    def multipliers(self) -> ComplexArray:
        """All 2n multipliers over the period, shape (2n,): the trivial pair, exactly 1, then each lambda, 1/lambda."""
        outer = self.root ** (2 * self.power)
        return np.concatenate([np.ones(2, complex), np.stack([outer, 1.0 / outer], axis=1).ravel()])

    @property
    def max_abs_multiplier(self) -> float:
        """Largest modulus of a multiplier, the trivial pair left out; exactly 1 for a stable orbit."""
        return float(np.max(np.abs(self.root[~self.is_inside]) ** (2 * self.power), initial=1.0))


def _reflection(direction: Array) -> Array:
    """Householder matrix that maps `direction` to a multiple of the first unit vector."""
    u = direction / np.linalg.norm(direction)
    u[0] += np.copysign(1.0, u[0])
    return np.asarray(np.eye(u.size) - 2.0 * np.outer(u, u) / (u @ u))


def _power(transition: Transition) -> int:
    return {0.25: 2, 0.5: 1}[transition.fraction]


def floquet(transition: Transition, acceleration: Array) -> Floquet:
    """Multipliers of a reversible orbit from its transition matrix over a quarter (odd orbits) or half of the period.

    `acceleration` is q'' at phase zero, shape (n,), which gives the trivial pair.
    """
    return _reduced(transition, acceleration)[0]


def _reduced(transition: Transition, acceleration: Array) -> tuple[Floquet, Array, ComplexArray]:
    """The result, the reflection, and the right eigenvectors of the reduced matrix."""
    from scipy.linalg import eig

    power = _power(transition)
    trivial = -1.0 if power == 2 else 0.0
    _, B, C, _ = transition.blocks()
    reflection = _reflection(acceleration.copy())
    matrix = reflection @ (B.T @ C) @ reflection
    # (0, a_0) is a left eigenvector, so the first row is (trivial, 0, ..., 0) but for the errors of flow and orbit.
    first = matrix[0].copy()
    first[0] -= trivial
    deviation = float(np.max(np.abs(first)))
    rest = matrix[1:, 1:]
    if rest.size == 0:
        empty = np.zeros(0)
        return Floquet(empty.astype(complex), empty, deviation, power), reflection, np.zeros((0, 0), complex)
    mu, left, right = eig(rest, left=True, right=True, check_finite=False)  # type: ignore[misc]
    overlap = np.abs(np.sum(left.conj() * right, axis=0))
    error = transition.error * float(np.linalg.norm(B) + np.linalg.norm(C))
    order = np.lexsort((mu.imag, mu.real))
    with np.errstate(divide="ignore"):
        mu_error = np.minimum(error / overlap, np.sqrt(error))  # a defective pair moves by the root of the error
    return Floquet(mu[order].astype(complex), mu_error[order], deviation, power), reflection, right[:, order]


def trivial_pair(transition: Transition, acceleration: Array) -> tuple[Array, Array]:
    """Velocity of the flow and direction along the family at phase zero, (positions, velocities) in the gauge, (2n,).

    The second is the right eigenvector of B^T C for the trivial mu: bordered with the left one, the matrix is regular.
    """
    _, B, C, _ = transition.blocks()
    n, trivial = acceleration.size, -1.0 if _power(transition) == 2 else 0.0
    left = acceleration / np.linalg.norm(acceleration)
    bordered = np.block([[B.T @ C - trivial * np.eye(n), left[:, None]], [left[None, :], np.zeros((1, 1))]])
    family = np.linalg.lstsq(bordered, np.append(np.zeros(n), 1.0), rcond=None)[0][:n]
    zero = np.zeros(n)
    return np.concatenate([zero, acceleration]), np.concatenate([family, zero])


def floquet_vectors(transition: Transition, acceleration: Array, rho: Array) -> ComplexArray:
    """Floquet vectors (positions, velocities) at phase zero, physical coordinates, shape (2n, 2n).

    Columns go with `Floquet.multipliers` and are scaled to largest entry 1; of the trivial pair the first is the
    velocity of the flow, the second the direction along the family. For an eigenvector x of B^T C the velocities
    follow from the second row of M: (lambda - 1 - 2 mu) v = 2 A^T C x.
    """
    result, reflection, right = _reduced(transition, acceleration)
    A, _, C, _ = transition.blocks()
    columns = [vector.astype(complex) for vector in trivial_pair(transition, acceleration)]
    for mu, root, reduced in zip(result.mu, result.root, right.T, strict=True):
        x = reflection @ np.concatenate([[0.0], reduced])
        velocity = 2.0 * A.T @ (C @ x)
        for value in (root**2, root**-2):
            columns.append(np.concatenate([x * (value - 1.0 - 2.0 * mu), velocity]))
    vectors = np.concatenate([rho, rho])[:, None] * np.stack(columns, axis=1)
    return np.asarray(vectors / np.max(np.abs(vectors), axis=0))
