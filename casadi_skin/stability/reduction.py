"""The reduced N x N problem: B^T C without its trivial eigenvalue, and its eigenvalues with left and right vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
    """Eigenvalues (points, m) in ascending order, conjugate ones in pairs; vectors by a real basis, as its columns.

    Of a pair a +- i b the basis has a and b: real arithmetic takes a quarter of the time. Rows of `inverse` times
    columns of `basis` give the identity; at a defective eigenvalue they are infinite. `first` marks the first of pairs,
    that below the real axis.
    """

    values: ComplexArray
    basis: Array
    inverse: Array
    first: NDArray[np.bool_]

    @property
    def right(self) -> Array | ComplexArray:
        """Right vectors as columns, of norm 1."""
        return self._by_columns(self.basis)

    @property
    def left(self) -> Array | ComplexArray:
        """Left vectors as rows: times `right` they give the identity."""
        return self._by_rows(self.inverse)

    def of(self, chosen: NDArray[np.bool_]) -> Eigensystems:
        """Those of some eigenvalues, which include whole pairs, shape (m,)."""
        if chosen.all():
            return self
        parts = self.values[:, chosen], self.basis[:, :, chosen], self.inverse[:, chosen], self.first[:, chosen]
        return Eigensystems(*parts)

    def whole_pairs(self, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Eigenvalues chosen, shape (m,), with the other of each pair of any point."""
        before = np.zeros_like(chosen)
        firsts = np.any(self.first, axis=0)
        while not np.array_equal(before, chosen):
            before = chosen.copy()
            chosen[1:] |= chosen[:-1] & firsts[:-1]
            chosen[:-1] |= chosen[1:] & firsts[:-1]
        return chosen

    def couplings(self, images: Array) -> Array:
        """|left E right| from E times `basis`, shape (points, n, m); not finite at a defective eigenvalue."""
        products = self.inverse @ images
        found, complex_ = np.abs(products), np.any(self.first, axis=1)
        if complex_.any():
            some = self.at(complex_)
            found[complex_] = np.abs(some._by_rows(some._by_columns(products[complex_])))
        return found

    @property
    def distances(self) -> Array:
        """Distances between eigenvalues of one point, shape (points, m, m)."""
        real, complex_ = self.values.real, np.any(self.first, axis=1)
        found = np.abs(real[:, :, None] - real[:, None, :])
        some = self.values[complex_]
        found[complex_] = np.abs(some[:, :, None] - some[:, None, :])
        return found

    def at(self, points: NDArray[np.bool_]) -> Eigensystems:
        """Those of some points, shape (points,)."""
        return Eigensystems(self.values[points], self.basis[points], self.inverse[points], self.first[points])

    def expectations(self, images: Array) -> Array:
        """Diagonals of `couplings` alone, shape (points, m)."""
        found: Array = np.abs(np.einsum("pij,pji->pi", self.inverse, images))
        points, a = np.nonzero(self.first)
        if a.size:
            left = self.inverse[points, a] - 1j * self.inverse[points, a + 1]
            both = np.sum(left * (images[points, :, a] + 1j * images[points, :, a + 1]), axis=1)
            found[points, a] = found[points, a + 1] = 0.5 * np.abs(both)
        return found

    def sizes(self, images: Array) -> Array:
        """Norms of E times right vectors, from E times `basis`, shape (points, m)."""
        return np.asarray(np.sqrt(self._of_pairs(np.einsum("pij,pij->pj", images, images))))

    @property
    def left_sizes(self) -> Array:
        """Norms of the left vectors, shape (points, m)."""
        factors = np.where(self.first | np.roll(self.first, 1, axis=1), 0.5, 1.0)
        squares = np.einsum("pij,pij->pi", self.inverse, self.inverse)
        return np.asarray(factors * np.sqrt(self._of_pairs(squares)))

    def _of_pairs(self, squares: Array) -> Array:
        """Squares (points, m) of real and imaginary parts, added for both of each pair."""
        points, a = np.nonzero(self.first)
        squares[points, a] += squares[points, a + 1]
        squares[points, a + 1] = squares[points, a]
        return squares

    def _by_columns(self, matrices: Array) -> Array | ComplexArray:
        """Columns a, b of pairs as a + i b and a - i b."""
        points, a = np.nonzero(self.first)
        if a.size == 0:
            return matrices
        found = matrices.astype(complex)
        found[points, :, a] += 1j * matrices[points, :, a + 1]
        found[points, :, a + 1] = found[points, :, a].conj()
        return found

    def _by_rows(self, matrices: Array | ComplexArray) -> Array | ComplexArray:
        """Rows of pairs that belong to such columns: (a - i b) / 2 and (a + i b) / 2."""
        points, a = np.nonzero(self.first)
        if a.size == 0:
            return matrices
        found = matrices.astype(complex)
        found[points, a] = 0.5 * (matrices[points, a] - 1j * matrices[points, a + 1])
        found[points, a + 1] = 0.5 * (matrices[points, a] + 1j * matrices[points, a + 1])
        return found


def eigensystems(matrices: Array) -> Eigensystems:
    """Of real matrices, shape (points, m, m)."""
    values, vectors = np.linalg.eig(matrices)
    order = _ascending(values)
    second = (values.imag > 0.0)[:, None, :]
    basis = np.where(second, -vectors.imag, vectors.real) if second.any() else vectors.real
    basis = np.take_along_axis(basis, order[:, None, :], 2)
    values = np.take_along_axis(values, order, 1).astype(complex)
    first = values.imag < 0.0
    try:
        inverse = np.linalg.inv(basis)
    except np.linalg.LinAlgError:
        inverse = np.stack([_inverse(*point) for point in zip(matrices, basis, strict=True)])
    return Eigensystems(values, basis, np.asarray(inverse), first)


def _ascending(values: ComplexArray) -> NDArray[np.intp]:
    """Order by real parts in which conjugate ones stay neighbours, as LAPACK has them, that below the axis first."""
    backwards = values[..., ::-1]
    return np.asarray(values.shape[-1] - 1 - np.lexsort((np.abs(backwards.imag), backwards.real)))


def _inverse(matrix: Array, basis: Array) -> Array:
    """The inverse of a basis whose vectors may be linearly dependent; infinite where an eigenvalue is defective."""
    try:
        return np.asarray(np.linalg.inv(basis), dtype=float)
    except np.linalg.LinAlgError:
        from scipy.linalg import eig

        # The same LAPACK routine finds the same eigenvalues in the same order.
        values, left, right = eig(matrix, left=True, right=True, check_finite=False)  # type: ignore[misc]
        overlap = np.sum(left.conj() * right, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            rows = left.conj().T / overlap[:, None]
        order = _ascending(values)
        rows, imaginary = rows[order], values[order].imag
        factor = np.where(imaginary == 0.0, 1.0, 2.0)[:, None]
        real = factor * np.where((imaginary > 0.0)[:, None], np.roll(-rows.imag, 1, axis=0), rows.real)
        real[~np.isfinite(real)] = np.inf
        return np.asarray(real)
