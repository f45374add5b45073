"""Linear modes of a lattice with where they live, and the bands of its periodic cell; dimensionless."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casadi_skin.lattice.declaration import Array
from casadi_skin.lattice.lattice import Lattice
from casadi_skin.model.arguments import check_instance, truth, whole
from casadi_skin.model.expressions import real_array
from casadi_skin.model.result import Result, in_turn
from casadi_skin.zero.model_coordinates import eigenmodes, symmetrising_scale

ComplexArray = NDArray[np.complex128]
HALF_ZONE_WAVE_NUMBERS = 41  # wave numbers along each direction of half a zone, its corners among them
# Of the largest |omega^2|, below which an imaginary part may be rounding: eigenvalues split by its root.
REAL_SQUARE_RTOL = 1e-6


@dataclass(frozen=True, eq=False)
class LatticeModes(Result):
    """Linear modes of a lattice about rest, by ascending real part of omega^2.

    Attributes:
        squares: omega^2, shape (modes,).
        right: displacements of the modes, of norm 1, shape (sites, modes).
        left: left modes, of norm 1: what a mode is excited by; shape (sites, modes).
        participation: participation ratio 1 / sum |u|^4 of the right modes: about the number of sites that move.
        left_participation: the same of the left modes.
        centre: mean cell of |u|^2 along each direction, from 1, shape (modes, directions).
        decay: mean change of ln |u| a cell along each direction, shape (modes, directions).
    """

    squares: ComplexArray
    right: ComplexArray
    left: ComplexArray
    participation: Array
    left_participation: Array
    centre: Array
    decay: Array

    def __repr__(self) -> str:
        return f"<LatticeModes: {self.squares.size} modes of {len(self.right)} sites>"

    @property
    def frequencies(self) -> ComplexArray:
        """omega with real part >= 0, and imaginary part > 0 where the mode grows."""
        roots = np.sqrt(self.squares)
        return np.where(roots.imag < 0, np.conj(roots), roots)

    @property
    def real(self) -> bool:
        """Whether every omega^2 is real, to rounding."""
        return bool(np.max(np.abs(self.squares.imag)) <= REAL_SQUARE_RTOL * np.max(np.abs(self.squares)))


@in_turn
def lattice_modes(lattice: Lattice, parameters: Mapping[str, float] | None = None) -> LatticeModes:
    """Linear modes of a lattice, left and right, from the symmetric problem of its gauge where there is one.

    Arguments:
        lattice: the lattice; damping and drives are left out.
        parameters: values of parameters that are not the declared ones.

    Returns:
        The modes; their frequencies may be complex where the lattice has no gauge.

    Raises:
        ValueError: unknown parameters.
    """
    check_instance("lattice", lattice, Lattice)
    K, declaration = lattice.stiffness(parameters), lattice.declaration
    found = eigenmodes(K, symmetrising_scale(K))
    scale = np.exp(found.log_scale)[:, None]
    squares, right, left = found.squares, scale * found.modes, found.left.T / scale
    right, left = (modes / np.linalg.norm(modes, axis=0) for modes in (right, left))
    density = np.abs(right.T.reshape(-1, *declaration.cells, len(declaration.sites))) ** 2
    directions = range(len(declaration.cells))
    return LatticeModes(
        squares.astype(complex), right.astype(complex), left.astype(complex),
        1.0 / np.sum(np.abs(right) ** 4, axis=0), 1.0 / np.sum(np.abs(left) ** 4, axis=0),
        np.stack([_centre(density, k) for k in directions], axis=1),
        np.stack([_decay(density, k) for k in directions], axis=1),
    )  # fmt: skip


def _along(density: Array, direction: int) -> Array:
    """Sums of |u|^2 of every mode over all but the cells along one direction, shape (modes, cells)."""
    others = tuple(axis for axis in range(1, density.ndim) if axis != direction + 1)
    return np.asarray(density.sum(axis=others))


def _centre(density: Array, direction: int) -> Array:
    along = _along(density, direction)
    return np.asarray(along @ np.arange(1, along.shape[1] + 1))


def _decay(density: Array, direction: int) -> Array:
    """Slope of a line through the logarithms of |u|, of two cells at a time so that a node does not count alone."""
    along = _along(density, direction)
    if along.shape[1] < 3:
        return np.zeros(along.shape[0])
    logs = 0.5 * np.log(np.maximum(along[:, 1:] + along[:, :-1], np.finfo(float).tiny))
    cells = np.arange(logs.shape[1]) - 0.5 * (logs.shape[1] - 1)
    return np.asarray(logs @ cells / (cells @ cells))


# Bands ----------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Bands(Result):
    """Squared frequencies of the waves e^(i k n) |beta|^n of an infinite lattice of the same cells.

    Attributes:
        wave_numbers: shape (points, directions): one direction from -pi to pi, or (0, 0), (pi, 0), (pi, pi), (0, 0).
        squares: ascending by real part, shape (points, sites of a cell).
        beta: |beta| along each direction: of the open lattice's waves in the gauge (the generalised Brillouin zone is
            this circle), 1 without one.
    """

    wave_numbers: Array
    squares: ComplexArray
    beta: tuple[float, ...]

    def __repr__(self) -> str:
        return f"<Bands: {self.squares.shape[1]} bands at {len(self.wave_numbers)} wave numbers>"

    @property
    def gaps(self) -> list[tuple[float, float]]:
        """Ends of the gaps between bands in omega^2, where all are real."""
        low, high = self.squares.real.min(axis=0), self.squares.real.max(axis=0)
        return [(float(a), float(b)) for a, b in zip(high[:-1], low[1:], strict=True) if b > a]


@in_turn
def bands(
    lattice: Lattice, parameters: Mapping[str, float] | None = None, points: int = 201, open_ends: bool = True
) -> Bands:
    """Bands of the infinite lattice made of the cell of a lattice.

    Arguments:
        lattice: a lattice whose cells are all alike.
        parameters: values of parameters that are not the declared ones.
        points: number of wave numbers.
        open_ends: the bands that a long lattice with ends has, in its gauge; without, those of a ring.

    Returns:
        The bands.

    Raises:
        ValueError: the cells differ.
    """
    check_instance("lattice", lattice, Lattice)
    waves = _wave_numbers(len(lattice.declaration.cells), whole("points", points, 1, MOST_WAVE_NUMBERS))
    squares, beta = _squares(lattice, parameters, truth("open_ends", open_ends), waves)
    return Bands(waves, squares, tuple(beta.tolist()))


def _squares(
    lattice: Lattice, parameters: Mapping[str, float] | None, open_ends: bool, waves: Array
) -> tuple[ComplexArray, Array]:
    """omega^2 of waves, ascending by real part, shape (waves, sites of a cell); and |beta| along each direction."""
    beta = _beta(lattice, parameters) if open_ends else np.ones(len(lattice.declaration.cells))
    squares = np.linalg.eigvals(cell_matrices(lattice, beta * np.exp(1j * waves), parameters)).astype(complex)
    return np.take_along_axis(squares, np.argsort(squares.real, axis=1), axis=1), beta


def band_edges(lattice: Lattice, parameters: Mapping[str, float] | None = None) -> list[tuple[float, float]]:
    """Lowest and highest omega^2 of each band over all wave numbers, ascending; bands that overlap are one.

    Raises ValueError where the cells differ.
    """
    directions = len(lattice.declaration.cells)
    if directions == 1:
        squares = bands(lattice, parameters).squares.real
    else:
        along = np.linspace(0.0, np.pi, HALF_ZONE_WAVE_NUMBERS)
        waves = np.stack(
            np.meshgrid(along, np.linspace(-np.pi, np.pi, 2 * HALF_ZONE_WAVE_NUMBERS - 1), indexing="ij"), axis=-1
        )
        squares = _squares(lattice, parameters, True, waves.reshape(-1, 2))[0].real
    found = list[tuple[float, float]]()
    for low, high in sorted(zip(squares.min(axis=0).tolist(), squares.max(axis=0).tolist(), strict=True)):
        joined = bool(found) and low <= found[-1][1]
        found[-1:] = [(found[-1][0], max(high, found[-1][1]))] if joined else [*found[-1:], (low, high)]
    return found


def cell_matrices(lattice: Lattice, betas: ComplexArray, parameters: Mapping[str, float] | None = None) -> ComplexArray:
    """Matrices whose eigenvalues are omega^2 of waves that change by a factor beta from cell to cell.

    Arguments:
        lattice: a lattice whose cells are all alike.
        betas: factors along each direction, shape (many, directions).
        parameters: values of parameters that are not the declared ones.

    Returns:
        Shape (many, sites of a cell, sites of a cell).

    Raises:
        ValueError: the cells differ.
    """
    if differing := lattice.declaration.differing:
        raise ValueError(f"lattice: given cells that differ by {', '.join(differing)}; accepted: cells alike")
    sites, directions = len(lattice.declaration.sites), len(lattice.declaration.cells)
    reach = [max((abs(bond.offset[k]) for bond in lattice.declaration.bonds), default=0) for k in range(directions)]
    around = [2 * r + 1 for r in reach]  # cells: the middle one has all of its bonds, whatever the boundary
    middle = int(np.ravel_multi_index(reach, around)) * sites
    K = lattice.of_cells(around).stiffness(parameters)[middle : middle + sites].reshape(sites, -1, sites)
    offsets = np.indices(around).reshape(directions, -1) - np.array(reach)[:, None]
    factors = np.prod(betas[:, :, None] ** offsets.astype(float), axis=1)
    return np.asarray(np.einsum("bc,icj->bij", factors, K))


def _beta(lattice: Lattice, parameters: Mapping[str, float] | None) -> Array:
    """Decay of displacements per cell along each direction: the ratio of gauge factors of neighbouring cells."""
    logs, declaration = symmetrising_scale(lattice.stiffness(parameters)), lattice.declaration
    if logs is None:
        return np.ones(len(declaration.cells))
    shaped = logs.reshape(*declaration.cells, len(declaration.sites))
    found = [np.mean(np.diff(shaped, axis=k)) if count > 1 else 0.0 for k, count in enumerate(declaration.cells)]
    return np.asarray(np.exp(np.array(found, dtype=float)))


def _wave_numbers(directions: int, points: int) -> Array:
    if directions == 1:
        return np.linspace(-np.pi, np.pi, points)[:, None]
    corners = np.pi * np.array([[0, 0], [1, 0], [1, 1], [0, 0]])
    along = np.linspace(0.0, 3.0, points)
    return np.stack([np.interp(along, np.arange(4), corners[:, k]) for k in range(2)], axis=1)


# The skin effect of a one-dimensional lattice: winding numbers of its ring's spectrum, generalised Brillouin zone -----

FEWEST_WAVE_NUMBERS, MOST_WAVE_NUMBERS = 512, 32768  # wave numbers
RESOLVED_PHASE_CHANGE = 0.25 * np.pi  # change of a phase from one wave number to the next
ON_CURVE = 1e-7  # of |omega^2|: nearer to the spectrum of the ring no winding number is computed


@in_turn
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
    values, points = _given_squares(lattice, squares), FEWEST_WAVE_NUMBERS
    found, undecided = np.full(values.size, np.nan), np.arange(values.size)
    while undecided.size and points <= MOST_WAVE_NUMBERS:
        k = 2.0 * np.pi * np.arange(points + 1) / points
        ring = np.linalg.eigvals(cell_matrices(lattice, np.exp(1j * k)[:, None], parameters))
        for n in undecided:
            apart = ring - values[n]
            if np.min(np.abs(apart)) <= ON_CURVE * np.max(np.abs(ring)):
                continue
            turns = np.angle(np.prod(apart[1:], axis=1) / np.prod(apart[:-1], axis=1))
            if np.max(np.abs(turns)) < RESOLVED_PHASE_CHANGE:
                found[n] = -np.round(turns.sum() / (2.0 * np.pi))
        undecided, points = np.flatnonzero(np.isnan(found)), 4 * points
    return found + 0.0  # no -0


@in_turn
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
    values, p = _given_squares(lattice, squares), len(lattice.declaration.sites)
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


def _given_squares(lattice: Lattice, squares: ArrayLike) -> ComplexArray:
    """Values of omega^2 as an array, shape (values,); raises ValueError and TypeError, for the lattice as well."""
    check_instance("lattice", lattice, Lattice)
    if len(lattice.declaration.cells) != 1:
        raise ValueError(f"lattice: given {len(lattice.declaration.cells)} dimensions; accepted: one")
    # Rows of different lengths, and expressions, are refused below.
    with suppress(ValueError, FutureWarning), warnings.catch_warnings():
        warnings.simplefilter("error", FutureWarning)
        if np.iscomplexobj(squares):
            return np.atleast_1d(np.asarray(squares, dtype=complex))
    return np.atleast_1d(real_array("squares", squares)).astype(complex)
