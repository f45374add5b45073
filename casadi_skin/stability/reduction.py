"""The reduced N x N problem: B^T C without its trivial eigenvalue, and its eigenvalues with left and right vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.zero.problem import Array

ComplexArray = NDArray[np.complex128]
BLOCK_COLUMNS = 128  # columns of a product of matrices of which zeros are left out


@dataclass(frozen=True)
class Reflections:
    """Householder matrices I - 2 u u^T that map given directions to multiples of the first unit vector; u (points, n).

    Their columns but the first span the orthogonal complement of the directions.
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


def stacked(matrices: Sequence[Array]) -> Array:
    """Matrices of several points in one array, without a copy of that of a single point."""
    return matrices[0][None] if len(matrices) == 1 else np.stack(matrices)


def frobenius_norms(matrices: Array) -> Array:
    """Frobenius norms, without arrays of the size of the matrices."""
    return np.asarray(np.sqrt(np.einsum("kij,kij->k", matrices, matrices)))


def blocks_of(matrices: Array) -> tuple[Array, Array, Array, Array]:
    """A, B, C, D of matrices [[A, B], [C, D]], (points, 2n, 2n) -> (points, n, n) each."""
    n = matrices.shape[-1] // 2
    return matrices[..., :n, :n], matrices[..., :n, n:], matrices[..., n:, :n], matrices[..., n:, n:]


def half_cosines(transitions: Array) -> Array:
    """B^T C of Phi = [[A, B], [C, D]], (points, 2n, 2n) -> (points, n, n)."""
    _, B, C, _ = blocks_of(transitions)
    return _transposed_product(B, C)


def half_cosine_errors(transitions: Array, errors: Array) -> Array:
    """First-order change of B^T C for changes of Phi, of one shape with it -> (points, n, n)."""
    (_, B, C, _), (_, dB, dC, _) = blocks_of(transitions), blocks_of(errors)
    return _transposed_product(dB, C) + _transposed_product(B, dC)


def with_reversed_blocks(transitions: Array, errors: Array) -> tuple[Array, Array]:
    """Phi of flows that are reversible alone with -C'^T in the place of C, C' of its inverse; and its errors likewise.

    That is Phi itself where it is symplectic.
    """
    n, inverse = transitions.shape[-1] // 2, np.asarray(np.linalg.inv(transitions), dtype=float)
    found = transitions.copy(), errors.copy()
    for each, inverted in zip(found, (inverse, -inverse @ errors @ inverse), strict=True):
        each[:, n:, :n] = -inverted[:, n:, :n].swapaxes(1, 2)
    return found


def _transposed_product(left: Array, right: Array) -> Array:
    """left^T right of blocks (points, n, n); those of long chains, zero far from the diagonal, by columns."""
    n = left.shape[1]
    if n <= BLOCK_COLUMNS:
        return np.asarray(left.swapaxes(1, 2) @ right)
    product = np.zeros((len(left), n, n))
    for start in range(0, n, BLOCK_COLUMNS):
        these = slice(start, start + BLOCK_COLUMNS)
        rows = _extent(np.any(left[:, :, these] != 0.0, axis=(0, 2)))
        columns = _extent(np.any(right[:, rows] != 0.0, axis=(0, 1)))
        product[:, these, columns] = left[:, rows, these].swapaxes(1, 2) @ right[:, rows, columns]
    return product


def _extent(chosen: NDArray[np.bool_]) -> slice:
    """From the first place that is chosen to the last."""
    places = np.flatnonzero(chosen)
    return slice(int(places[0]), int(places[-1]) + 1) if places.size else slice(0, 0)


@dataclass(frozen=True)
class Eigensystems:
    """Eigenvalues (points, m) in ascending order, conjugate ones in pairs, that below the real axis first.

    Right vectors of norm 1 are the columns of `right`, left ones the rows of `left`: times the right ones they give the
    identity; at a defective eigenvalue they are infinite. Both are real where all eigenvalues of all points are. Of a
    pair a +- i b the real `basis` has a and b: with these large matrices are multiplied in a quarter of the time.
    """

    values: ComplexArray
    basis: Array
    left: NDArray[Any]

    @classmethod
    def groups(cls, matrices: Array) -> list[tuple[NDArray[np.int64], Eigensystems]]:
        """Of those matrices all of whose eigenvalues are real, and of the others, if any, with their numbers.

        Digits of one then do not depend on the others.
        """
        values, vectors = np.linalg.eig(matrices)
        is_complex = np.any(values.imag != 0.0, axis=1)
        those = [chosen for chosen in (np.flatnonzero(~is_complex), np.flatnonzero(is_complex)) if chosen.size]
        return [(chosen, cls._ordered(matrices[chosen], values[chosen], vectors[chosen])) for chosen in those]

    @classmethod
    def _ordered(cls, matrices: Array, values: NDArray[Any], vectors: NDArray[Any]) -> Eigensystems:
        order = _ascending(values)
        basis = np.where((values.imag > 0.0)[:, None, :], -vectors.imag, vectors.real)
        basis = np.take_along_axis(basis, order[:, None, :], 2)
        values = np.take_along_axis(values, order, 1).astype(complex)
        try:
            left = _of_pairs(np.linalg.inv(basis).swapaxes(1, 2), values).swapaxes(1, 2)
            left = np.where((values.imag != 0.0)[:, :, None], 0.5 * left.conj(), left)
        except np.linalg.LinAlgError:
            left = np.stack([_left_vectors(matrix) for matrix in matrices])
            left = left if np.any(values.imag != 0.0) else left.real
        return cls(values, basis, left)

    @property
    def right(self) -> NDArray[Any]:
        """Right vectors as columns."""
        return _of_pairs(self.basis, self.values)

    def images(self, matrices: Array) -> NDArray[Any]:
        """Real matrices times the right vectors."""
        return _of_pairs(matrices @ self.basis, self.values)


def _of_pairs(columns: Array, values: ComplexArray) -> NDArray[Any]:
    """Columns a, b of pairs of conjugate eigenvalues as a + i b and a - i b."""
    points, a = np.nonzero(values.imag < 0.0)
    if a.size == 0:
        return columns
    found = columns.astype(complex)
    found[points, :, a] += 1j * columns[points, :, a + 1]
    found[points, :, a + 1] = found[points, :, a].conj()
    return found


def _ascending(values: ComplexArray) -> NDArray[np.intp]:
    """Order by real parts in which conjugate ones stay neighbours, as LAPACK has them, that below the axis first."""
    backwards = values[..., ::-1]
    return np.asarray(values.shape[-1] - 1 - np.lexsort((np.abs(backwards.imag), backwards.real)))


def _left_vectors(matrix: Array) -> NDArray[Any]:
    """Left vectors where right ones may be linearly dependent; infinite where an eigenvalue is defective."""
    from scipy.linalg import eig

    # The same LAPACK routine finds the same eigenvalues in the same order.
    values, left, right = eig(matrix, left=True, right=True, check_finite=False)  # type: ignore[misc]
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = (left.conj().T / np.sum(left.conj() * right, axis=0)[:, None])[_ascending(values)]
    return np.where(np.isfinite(rows), rows, np.inf)


def vectors_of(matrix: Array, values: ComplexArray, power: int = 1, scale: Array | float = 1.0) -> ComplexArray:
    """Eigenvectors times `scale` as columns in the order of given `values`, those of the matrix to a power.

    Their largest entries are 1.
    """
    from scipy.optimize import linear_sum_assignment

    own, vectors = np.linalg.eig(matrix.astype(complex))
    _, order = linear_sum_assignment(np.abs(values[:, None] - own**power))
    vectors = np.asarray(scale).reshape(-1, 1) * vectors[:, order]
    return np.asarray(vectors / np.max(np.abs(vectors), axis=0))
