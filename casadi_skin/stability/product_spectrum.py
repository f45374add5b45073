"""Eigenvalues of a product of matrices by their logarithms, of those beyond the largest double too.

Where the product is not too far from orthogonal, of the product itself and of that of the inverses, each of which has
digits of the eigenvalues on its side. Else by a periodic Schur form: the factors are made triangular by orthogonal
matrices, of which the first is that of the last factor too (Bojanczyk, Golub and Van Dooren 1992), in blocks whose
eigenvalues are close enough in modulus to be those of a product that keeps its digits. The orthogonal matrices come
from subspace iteration through the factors, which converges as the ratio of moduli across the gap between two blocks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.stability.result import LARGEST_LOGARITHM
from casadi_skin.zero.problem import Array

SMALL_MODULUS = 0.5  # modulus above which no eigenvalue has lost digits in a product with entries near 1
EXTREME_LOG_CONDITION = float(
    np.log(1e14)
)  # of the condition of a product: beyond it eigenvalues in the middle have lost digits
FAR_LOG_EIGENVALUE = 7.0  # logarithm of an eigenvalue of whose digits factors may have lost some
WIDE_NORM = 1e200  # norm of a product that needs no scales
LOG_MODULUS_SPREAD = float(np.log(1e4))  # of the moduli of a block
CONVERGED_LOG_GAIN = 40.0  # logarithm of the gain of subspace iteration over a gap
SUBSPACE_ROUNDS = 60  # of it


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Eigenvalues as exp(logs) times phases of modulus 1, in descending modulus; `extreme` by a periodic Schur form."""

    logs: Array
    phases: ComplexArray
    extreme: bool = False

    @classmethod
    def of(cls, values: ComplexArray) -> Spectrum:
        """Of eigenvalues that are numbers; zeros have the logarithm minus infinity."""
        moduli = np.abs(values)
        with np.errstate(divide="ignore"):
            return cls(np.log(moduli), np.where(moduli > 0.0, values / np.where(moduli > 0.0, moduli, 1.0), 1.0))

    @property
    def values(self) -> ComplexArray:
        """The eigenvalues, those beyond the largest double as that."""
        return np.asarray(np.exp(np.minimum(self.logs, LARGEST_LOGARITHM)) * self.phases)

    @property
    def far(self) -> int:
        """How many are so far from 1 that a step may have lost their digits, 0 where all but one are near."""
        return (
            int(np.count_nonzero(np.abs(self.logs) > -np.log(SMALL_MODULUS)))
            if np.any(np.abs(self.logs) > FAR_LOG_EIGENVALUE)
            else 0
        )

    def joined(self, other: Spectrum) -> Spectrum:
        """These, then those of another one."""
        logs, phases = np.concatenate([self.logs, other.logs]), np.concatenate([self.phases, other.phases])
        return Spectrum(logs, phases, self.extreme or other.extreme)

    def taken(self, chosen: NDArray[np.bool_]) -> Spectrum:
        """Some of them."""
        return Spectrum(self.logs[chosen], self.phases[chosen], self.extreme)


def scaled_product(maps: Sequence[Array] | Array) -> tuple[Array, float]:
    """Later maps times earlier ones as a matrix of norm 1 and the logarithm of a factor."""
    total, logarithm = np.eye(maps[0].shape[0]), 0.0
    with np.errstate(over="ignore", invalid="ignore"):
        plain = reduce(lambda done, matrix: matrix @ done, maps, total)
        size = float(np.linalg.norm(plain))
    if 1.0 / WIDE_NORM < size < WIDE_NORM:
        return np.asarray(plain / size), float(np.log(size))
    for matrix in maps:
        total = matrix @ total
        size = float(np.linalg.norm(total))
        if size > 0.0:
            total, logarithm = total / size, logarithm + float(np.log(size))
    return total, logarithm


def spectrum_of(maps: Array) -> Spectrum:
    """Eigenvalues of the product of maps, shape (factors, n, n)."""
    if maps.shape[1] == 0:
        return Spectrum(np.empty(0), np.empty(0, dtype=complex))
    forward, size = scaled_product(maps)
    found = _shifted(np.linalg.eigvals(forward).astype(complex), size)
    if len(maps) == 1:
        return found
    inverse = _inverse_product(maps)
    if inverse is not None and size + inverse[1] <= EXTREME_LOG_CONDITION:
        return _of_both(found, size, inverse)
    triangular = _schur(maps)
    return triangular or Spectrum(found.logs, found.phases, True)


def _shifted(values: ComplexArray, logarithm: float) -> Spectrum:
    found = Spectrum.of(values[np.argsort(-np.abs(values))])
    return Spectrum(found.logs + logarithm, found.phases)


def _of_both(forward: Spectrum, size: float, inverse: tuple[Array, float]) -> Spectrum:
    """Each eigenvalue from the product or from that of the inverses, whichever has more of its digits.

    Rounding is relative to the norm of either, so that each serves the eigenvalues on its own side of the modulus at
    which both are equally good.
    """
    reciprocal = _shifted(np.linalg.eigvals(inverse[0]).astype(complex), inverse[1])
    backward = Spectrum(-reciprocal.logs[::-1], reciprocal.phases[::-1].conj())
    small = (forward.logs < np.log(SMALL_MODULUS)) & (0.5 * (forward.logs + backward.logs) < 0.5 * (size - inverse[1]))
    if forward.logs.size == 1:
        small[:] = forward.logs < np.log(SMALL_MODULUS)
    logs = np.where(small, backward.logs, forward.logs)
    return Spectrum(logs, np.where(small, backward.phases, forward.phases))


def _inverse_product(maps: Array) -> tuple[Array, float] | None:
    """The inverse of the product, from those of the maps, scaled; None where it has no finite entries."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            inverse, size = scaled_product(np.asarray(np.linalg.inv(maps[::-1]), dtype=float))
    except np.linalg.LinAlgError:
        return None
    return (inverse, size) if np.all(np.isfinite(inverse)) and np.isfinite(size) else None


# The periodic Schur form ----------------------------------------------------------------------------------------------


def _schur(maps: Array) -> Spectrum | None:
    """Eigenvalues block by block of triangular factors; None where a factor is singular."""
    n = maps.shape[1]
    frame = np.linalg.qr(np.random.default_rng(0).normal(size=(n, n)))[0]
    edges: list[int] = []
    for turn in range(1, SUBSPACE_ROUNDS + 1):
        start, factors = frame, np.empty_like(maps)
        for k, matrix in enumerate(maps):
            frame, factors[k] = np.linalg.qr(matrix @ frame)
        diagonal = np.abs(np.diagonal(factors, axis1=1, axis2=2))
        if np.any(diagonal == 0.0):
            return None
        logs = np.sum(np.log(diagonal), axis=0)
        gaps = logs[:-1] - logs[1:]
        edges = [0, *(np.flatnonzero(turn * gaps > CONVERGED_LOG_GAIN) + 1).tolist(), n]
        if turn > 1 and all(abs(logs[a] - logs[b - 1]) <= LOG_MODULUS_SPREAD for a, b in pairwise(edges)):
            break
    blocks = []
    for a, b in pairwise(edges):
        product, size = scaled_product(factors[:, a:b, a:b])
        closed = start[:, a:b].T @ frame[:, a:b]
        blocks.append(_shifted(np.linalg.eigvals(closed @ product).astype(complex), size))
    logs, phases = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("logs", "phases"))
    order = np.argsort(-logs, kind="stable")
    return Spectrum(logs[order], phases[order], True)


# Liouville's formula --------------------------------------------------------------------------------------------------


def by_liouville(spectrum: Spectrum, maps: Array, contraction: float) -> Spectrum:
    """The eigenvalues, a single one that is tiny, or huge where none is tiny, from their product exp(contraction)."""
    index = _single(spectrum)
    if index is None:
        return spectrum
    others = np.delete(spectrum.logs, index)
    logs, phases = spectrum.logs.copy(), spectrum.phases.copy()
    logs[index] = contraction - float(np.sum(others))
    sign = np.prod(np.linalg.slogdet(maps)[0]) * np.prod(np.delete(phases, index)).real
    phases[index] = np.sign(sign) or 1.0
    return Spectrum(logs, phases, spectrum.extreme)


def _single(spectrum: Spectrum) -> int | None:
    """Place of the single eigenvalue that is tiny, or huge where none is tiny; None where there are more, or none."""
    small, large = spectrum.logs < np.log(SMALL_MODULUS), spectrum.logs > -np.log(SMALL_MODULUS)
    if np.count_nonzero(small) == 1:
        return spectrum.logs.size - 1
    return 0 if np.count_nonzero(large) == 1 and not small.any() else None
