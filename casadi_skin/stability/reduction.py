"""The reduced N x N problem: B^T C without its trivial eigenvalue, and its eigenvalues with left and right vectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Reflections:
    """Householder matrices I - 2 u u^T that map given directions to multiples of the first unit vector; u (points, n).

    Their columns but the first span what is orthogonal to the directions.
    """

    u: Array

    @classmethod
    def of(cls, directions: Array) -> Reflections:
        """From directions, shape (points, n), none of them zero."""
        u = directions / np.linalg.norm(directions, axis=1, keepdims=True)
        u[:, 0] += np.copysign(1.0, u[:, 0])
        return cls(u / np.linalg.norm(u, axis=1, keepdims=True))

    def similar(self, matrices: Array) -> Array:
        """H M H for each point, shape (points, n, n), by two updates of rank one."""
        u, twice = self.u, 2.0 * self.u
        half = matrices - twice[:, :, None] * (u[:, None, :] @ matrices)
        return np.asarray(half - (half @ u[:, :, None]) * twice[:, None, :])

    def vector(self, reduced: ComplexArray) -> ComplexArray:
        """H (0, x) of the first point, shape (n - 1,) -> (n,)."""
        u = self.u[0]
        return np.asarray(np.append(0.0, reduced) - 2.0 * u * (u[1:] @ reduced))


def half_cosines(transitions: Array) -> Array:
    """B^T C of Phi = [[A, B], [C, D]], shape (points, 2n, 2n) -> (points, n, n)."""
    n = transitions.shape[1] // 2
    return np.asarray(transitions[:, :n, n:].swapaxes(1, 2) @ transitions[:, n:, :n])


def half_cosine_errors(transitions: Array, errors: Array) -> Array:
    """First-order change of B^T C for changes of Phi, (points, 2n, 2n) -> (points, n, n)."""
    n = transitions.shape[1] // 2
    B, C = transitions[:, :n, n:], transitions[:, n:, :n]
    dB, dC = errors[:, :n, n:], errors[:, n:, :n]
    return np.asarray(dB.swapaxes(1, 2) @ C + B.swapaxes(1, 2) @ dC)


@dataclass(frozen=True)
class Eigensystems:
    """Eigenvalues (points, m) in ascending order; right vectors as columns, of norm 1; left ones as rows.

    Rows of `left` times columns of `right` give the identity; at a defective eigenvalue they are infinite.
    """

    values: ComplexArray
    right: ComplexArray
    left: ComplexArray


def eigensystems(matrices: Array) -> Eigensystems:
    """Of real matrices, shape (points, m, m)."""
    values, right = (np.asarray(part, dtype=complex) for part in np.linalg.eig(matrices))
    try:
        left = np.linalg.inv(right)
    except np.linalg.LinAlgError:
        left = np.stack([_left_vectors(matrix, vectors) for matrix, vectors in zip(matrices, right, strict=True)])
    order = np.lexsort((values.imag, values.real))
    return Eigensystems(
        np.take_along_axis(values, order, 1),
        np.take_along_axis(right, order[:, None, :], 2),
        np.take_along_axis(left, order[:, :, None], 1),
    )


def _left_vectors(matrix: Array, right: ComplexArray) -> ComplexArray:
    """Left eigenvectors where the right ones may be linearly dependent; infinite where an eigenvalue is defective."""
    try:
        return np.asarray(np.linalg.inv(right), dtype=complex)
    except np.linalg.LinAlgError:
        from scipy.linalg import eig

        # The same LAPACK routine finds the same eigenvalues in the same order.
        _, left, again = eig(matrix, left=True, right=True, check_finite=False)  # type: ignore[misc]
        overlap = np.sum(left.conj() * again, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            rows = left.conj().T / overlap[:, None]
        rows[~np.isfinite(rows)] = np.inf
        return np.asarray(rows, dtype=complex)
