"""Motion of the linear cells of a long lattice, one cell after the other, from the amplitudes at their bonds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from casadi_skin.lattice.cell_tail import CellTail, Place
from casadi_skin.lattice.long_lattice import LongLattice
from casadi_skin.zero.problem import Array


def tail_coefficients(
    lattice: LongLattice, numbers: Sequence[int], places: Sequence[Place], ends: tuple[Array, Array], site: Array
) -> Array:
    """Coefficients of the odd cosines in cells of the tail, from the core on, shape (harmonics, cells, sites).

    Arguments:
        lattice: the lattice.
        numbers: of the cells, counted from 1 at the edge.
        places: of the harmonics.
        ends: amplitudes across the bond to the first cell, and of the core's site, up to a factor each.
        site: coefficients of the core's site.
    """
    s, p = lattice.coupling, len(lattice.sites)
    behind = [lattice.tail(n) for n in numbers] if np.isfinite(lattice.cells) else [lattice.tail(1)] * len(numbers)
    found = np.empty((len(places), len(numbers), p))
    for h, place in enumerate(places):
        matrix, right, near = np.zeros((p + 1, p + 1)), np.zeros(p + 1), float(site[h])
        matrix[:p, :p] = lattice.cell - behind[0].square(place) * np.eye(p)
        matrix[lattice.inlet, p] = -s
        for k, (across, down) in enumerate(_far_vectors(behind, place, np.array([ends[0][h], ends[1][h]]))):
            matrix[p, lattice.inlet], matrix[p, p], right[lattice.outlet] = -across, down, s * near
            motion = np.linalg.solve(matrix, right)
            found[h, k], near = motion[:p], float(motion[lattice.inlet])
    return found * (lattice.bond_sign ** (np.arange(len(numbers)) + 1.0))[None, :, None]


def _far_vectors(tails: Sequence[CellTail], place: Place, first: Array) -> Iterator[tuple[float, float]]:
    """Amplitudes across the bonds to these tails, and before them, up to factors; `first` are those one bond nearer."""
    if np.isfinite(tails[0].cells):
        yield from (tail.vector(place) for tail in tails)
    elif place.off == 0.0:  # pinned: no wave decays, and amplitudes are linear in the distance
        for vector in pinned_vectors(tails[0], place.edge, first, len(tails)):
            yield float(vector[0]), float(vector[1])
    else:
        yield from [tails[0].vector(place)] * len(tails)


def pinned_vectors(tail: CellTail, edge: int, vector: Array, count: int) -> Iterator[Array]:
    """Amplitudes across so many bonds and before them, one behind the other, at the edge of a band; of norm 1."""
    P = tail.transfer(edge)
    back = np.array([[P[1, 1], -P[0, 1]], [-P[1, 0], P[0, 0]]])
    for _ in range(count):
        vector = back @ vector
        vector /= np.linalg.norm(vector)
        yield vector


def edge_motion(lattice: LongLattice, count: int, square: float, tail_angle: float) -> Array:
    """Amplitudes of so many cells at the edge in a linear mode of a lambda; `tail_angle` is that of the tail there.

    Computed from the tail to the edge, cell by cell, so that small amplitudes keep their digits.
    """
    across, down, cells = math.sin(tail_angle), math.cos(tail_angle), []
    for _ in range(count - 1):
        found = _cell_motion(lattice, lattice.cell, square, (across, down), True)
        size = math.hypot(found[lattice.outlet], found[-1])
        cells.append(found[:-1] / size)
        across, down = found[lattice.outlet] / size, found[-1] / size
    found = _cell_motion(lattice, lattice.edge_cell, square, (across, down), False)
    motion, size = [found[:-1]], found[-1]  # `size` is of the two amplitudes at a bond
    for cell in cells[::-1]:
        size *= lattice.bond_sign
        motion.append(size * cell[:-1])
        size *= cell[-1]
    return np.concatenate(motion[::-1] if lattice.at_last else motion)


def _cell_motion(
    lattice: LongLattice, stiffness: Array, square: float, angle: tuple[float, float], inner: bool
) -> Array:
    """Amplitudes of a cell, the size of those at its bond to the tail, whose angle is known, and that of the next cell.

    The last is there for an `inner` cell alone. They solve linear equations up to a factor.
    """
    s, unit = lattice.coupling, np.eye(len(stiffness))
    inlet, outlet = unit[:, [lattice.inlet]], unit[:, [lattice.outlet]]
    above = [stiffness - square * unit, -s * angle[0] * inlet]
    below = [inlet.T, np.array([[-angle[1]]])]
    if inner:
        above.append(-s * outlet)
        below.append(np.zeros((1, 1)))
    return np.asarray(np.linalg.svd(np.block([above, below]))[2][-1])
