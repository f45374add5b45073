"""Transition matrices of long chains stored by the bands of their blocks, and products of these.

A perturbation of a site reaches few others within a quarter of the period: in Phi = [[A, B], [C, D]] entries far from
the diagonals of the blocks are below rounding. Of each block with n rows the band of half bandwidth w is stored as an
array (n, 2w + 1), row i from column i - w on: Phi is an array (2n, 2(2w + 1)), and sums of matrices and their Frobenius
norms are those of such arrays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from casadi_skin.zero.problem import Array

BLOCK = 128  # columns of a product of which zeros are left out


def half_width(block: Array) -> int | None:
    """Half bandwidth of a block that is stored by its band, shape (..., n, 2w + 1); None of a full one."""
    return None if block.shape[-1] == block.shape[-2] else (block.shape[-1] - 1) // 2


def rows_of(band: Array, start: int, end: int) -> Array:
    """Rows of a block from its band, columns start - w to end + w: (points, n, 2w + 1) -> (points, rows, rows + 2w)."""
    count, width = end - start, band.shape[2]
    buffer = np.zeros((len(band), count, count + width))  # one column more: entry (i, i + t) is at i * width + t
    view = np.lib.stride_tricks.as_strided(
        buffer,
        (len(band), count, width),
        (buffer.strides[0], buffer.strides[1] + buffer.itemsize, buffer.itemsize),
    )
    view[:] = band[:, start:end]
    return buffer[:, :, :-1]


def transposed_product(left: Array, right: Array) -> Array:
    """left^T right of blocks (points, n, n) or of their bands, without the zeros far from the diagonal; full."""
    n, width = left.shape[1], half_width(left)
    if n <= BLOCK:
        return np.asarray(left.swapaxes(1, 2) @ right)
    product = np.zeros((len(left), n, n))
    for start in range(0, n, BLOCK):
        end = min(n, start + BLOCK)
        if width is None:
            rows = _extent(np.any(left[:, :, start:end] != 0.0, axis=(0, 2)))
            others = _extent(np.any(right[:, rows] != 0.0, axis=(0, 1)))
            product[:, start:end, others] = left[:, rows, start:end].swapaxes(1, 2) @ right[:, rows, others]
            continue
        first, last = max(0, start - width), min(n, end + width)
        low, high = max(0, first - width), min(n, last + width)
        columns = rows_of(left, first, last)[:, :, start - first + width : end - first + width]
        others_ = rows_of(right, first, last)[:, :, low - first + width : high - first + width]
        product[:, start:end, low:high] = columns.swapaxes(1, 2) @ others_
    return product


def _extent(chosen: NDArray[np.bool_]) -> slice:
    """From the first place that is chosen to the last."""
    places = np.flatnonzero(chosen)
    return slice(int(places[0]), int(places[-1]) + 1) if places.size else slice(0, 0)
