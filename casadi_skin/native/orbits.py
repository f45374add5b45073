"""Multipliers of orbits by a compiled kernel that takes all steps at once: orbits.c."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from casadi_skin.native import LANES, Array, Indices, Structure, kernels

ORBIT = "iiiii" + 11 * "a"


class OrbitKernel:
    """Multipliers of orbits that solve collocation equations with n states on K intervals of d stages.

    Arguments:
        sizes: n, K, d, and how many numbers it is from one end of an interval to the next.
        trivial: how many multipliers are 1 by the velocity: one, or none of a forced orbit.
        equations, method: as other kernels take them.
        entries: rows and columns of the derivatives of the field.
        nodes: places of the stages in an interval.
        frame: an orthogonal matrix in general position.
    """

    def __init__(
        self,
        sizes: tuple[int, int, int, int],
        trivial: int,
        equations: Structure,
        method: Structure,
        entries: tuple[Indices, Indices],
        nodes: Array,
        frame: Array,
    ) -> None:
        n, K, d, _ = sizes
        self._n, self._d, self._nodes = n, d, nodes
        shapes = (K, d, n, n), (K, n, n), (K + 1, n), (K,), (1,), (self._room(K),)
        kept = equations, method, *entries, frame, *map(np.empty, shapes)
        self._orbit = Structure(ORBIT, *sizes, trivial, *kept)

    def _room(self, intervals: int) -> int:
        """Numbers that maps over intervals need, and their multipliers."""
        n, d = self._n, self._d
        for_maps = LANES * ((d * n) ** 2 + (3 * d + 2) * n * n) + (d * n) ** 2
        return max(for_maps, (8 * intervals + 40) * n * n + 20 * n + 4 * intervals)

    def found(
        self, z: Array, numbers: Array, with_rounding: bool, polynomials: tuple[Structure, Array], most: float
    ) -> Array | None:
        """What `native.multipliers` finds of an orbit, from maps over parts of intervals where these are too long.

        Arguments:
            z, numbers: of the equations.
            with_rounding: as there.
            polynomials: on the intervals, with the edges of these.
            most: number of parts; None is returned where more are needed.

        Raises:
            numpy.linalg.LinAlgError: eigenvalues do not converge.
        """
        n, d, found = self._n, self._d, np.empty(self._n * (self._n + 4) + 5)
        failed = kernels()["orbit_multipliers"](self._orbit, z, numbers, with_rounding, found)
        if found[-1] and not failed:
            if not found[-1] <= most:
                return None
            parts = int(found[-1])
            room = np.empty(parts * (1 + d + (d + 1) * n * n + n) + n + self._room(parts))
            data = self._orbit, *polynomials, z, numbers, self._nodes, parts, with_rounding, found, room
            failed = kernels()["orbit_multipliers_by_parts"](*data)
        if failed:
            raise np.linalg.LinAlgError("Eigenvalues did not converge")
        return found


def judged(
    n: int, found: Array, better: Array | None, safety: float, drift: float
) -> tuple[NDArray[np.complex128], Array, Array, list[float]] | None:
    """Multipliers of n states as numbers with their errors, from better ones.

    Arguments:
        n: number of states.
        found, better: what kernels have found; None without better ones.
        safety: times distances from better ones are errors.
        drift: what trivial ones may be off by, for a product of norm 1.

    Returns:
        The multipliers; their logarithms, the errors of those that are not trivial, which of these are on the circle
        and which are real, as rows of n numbers; the product of the maps; and how many are trivial, their distance from
        1, the largest error, the largest modulus, and what trivial ones may be off by. None where it is not plain which
        belongs to which.
    """
    row = np.empty(n * (n + 6) + 5)
    if kernels()["judged_multipliers"](n, found, better, safety, drift, row):
        return None
    square = row[6 * n : -5].reshape(n, n)
    return row[: 2 * n].view(np.complex128), row[2 * n : 6 * n].reshape(4, n), square, row[-5:].tolist()
