"""The skin effect of a one-dimensional lattice: winding numbers of its ring's spectrum, generalised Brillouin zone.

The spectrum of a ring winds round omega^2 of the modes that the same lattice has between ends where these lean to one
end (Gong et al. 2018; Okuma et al. 2020). Their waves change by factors beta from cell to cell, of which the middle two
have the same size (Yao and Wang 2018; Yokomizo and Murakami 2019).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.lattice.declaration import Array
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.lattice.linear import ComplexArray, cell_matrices

FEWEST, MOST = 512, 32768  # wave numbers
RESOLVED = 0.25 * np.pi  # change of a phase from one wave number to the next
ON_CURVE = 1e-7  # of |omega^2|: nearer to the spectrum of the ring no winding number is computed


def winding_numbers(lattice: Lattice, squares: ArrayLike, parameters: Mapping[str, float] | None = None) -> Array:
    """Winding number of the spectrum of the ring round values of omega^2, as the wave number goes from 0 to 2 pi.

    Arguments:
        lattice: a lattice in one dimension whose cells are all alike.
        squares: values of omega^2, real or complex.
        parameters: values of parameters that are not the declared ones.

    Returns:
        Whole numbers, positive where waves of the open lattice grow with the number of the cell; NaN on the spectrum.

    Raises:
        ValueError: the lattice has two dimensions, or cells that differ.
    """
    _check(lattice)
    values, points = np.atleast_1d(np.asarray(squares, dtype=complex)), FEWEST
    found, undecided = np.full(values.size, np.nan), np.arange(values.size)
    while undecided.size and points <= MOST:
        k = 2.0 * np.pi * np.arange(points + 1) / points
        ring = np.linalg.eigvals(cell_matrices(lattice, np.exp(1j * k)[:, None], parameters))
        for n in undecided:
            apart = ring - values[n]
            if np.min(np.abs(apart)) <= ON_CURVE * np.max(np.abs(ring)):
                continue
            turns = np.angle(np.prod(apart[1:], axis=1) / np.prod(apart[:-1], axis=1))
            if np.max(np.abs(turns)) < RESOLVED:
                found[n] = -np.round(turns.sum() / (2.0 * np.pi))
        undecided, points = np.flatnonzero(np.isnan(found)), 4 * points
    return found + 0.0  # no -0


def brillouin_zone(lattice: Lattice, squares: ArrayLike, parameters: Mapping[str, float] | None = None) -> ComplexArray:
    """Factors beta of the two waves of middle size at values of omega^2: of those of long open lattices, of equal size.

    Arguments:
        lattice: a lattice in one dimension whose cells are all alike.
        squares: values of omega^2, real or complex.
        parameters: values of parameters that are not the declared ones.

    Returns:
        Shape (values, 2), the smaller first.

    Raises:
        ValueError: the lattice has two dimensions, or cells that differ.
    """
    _check(lattice)
    values, p = np.atleast_1d(np.asarray(squares, dtype=complex)), len(lattice.declaration.sites)
    reach = p * max((abs(bond.offset[0]) for bond in lattice.declaration.bonds), default=1)
    circle = np.exp(2j * np.pi * np.arange(2 * reach + 1) / (2 * reach + 1))
    matrices = cell_matrices(lattice, circle[:, None], parameters)
    found = np.full((values.size, 2), np.nan, complex)
    for n, value in enumerate(values):
        samples = np.linalg.det(matrices - value * np.eye(p)) * circle**reach
        coefficients = np.fft.fft(samples) / circle.size  # of beta^0, beta^1, ... in the determinant times beta^reach
        size = np.max(np.abs(coefficients))
        kept = np.flatnonzero(np.abs(coefficients) > 1e-13 * size)
        roots = np.roots(coefficients[kept[0] : kept[-1] + 1][::-1])
        roots = roots[np.argsort(np.abs(roots))]
        middle = reach - kept[0]  # roots inside: as many as there are negative powers of beta
        if 0 < middle < roots.size:
            found[n] = roots[middle - 1 : middle + 1]
    return found


def _check(lattice: Lattice) -> None:
    if len(lattice.declaration.cells) != 1:
        raise ValueError(f"lattice: given {len(lattice.declaration.cells)} dimensions; accepted: one")
    if differing := lattice.declaration.differing:
        raise ValueError(f"lattice: given cells that differ by {', '.join(differing)}; accepted: cells alike")
