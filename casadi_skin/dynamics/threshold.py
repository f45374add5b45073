"""The threshold of the end breather of a long chain: the amplitude at which its frequency leaves the band."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from casadi_skin.follow.family import Family
from casadi_skin.follow.settings import Point
from casadi_skin.lattice.chain import FIRST, LAST, Chain
from casadi_skin.lattice.core_with_tail import CoreWithTail
from casadi_skin.lattice.tail import EDGE_ANGLE
from casadi_skin.solve.threads import one_thread
from casadi_skin.zero.request import family_request

TOLERANCE = 1e-12
LARGEST_S = 1e4  # up to which a threshold is looked for


def threshold(chain: Chain) -> float:
    """S_c at which the end breather of the infinite chain is born: Omega leaves the band edge that it was pinned to.

    Depends on alpha, gamma and g alone. Raises ValueError where there is no such family (see `chain_coordinates`), and
    ArithmeticError where it is not found.
    """
    amplitude_max = 1.0
    while amplitude_max <= LARGEST_S:
        found = _threshold_to(chain, amplitude_max / abs(chain.g))
        if found is not None:
            return found
        amplitude_max *= 10.0
    raise ArithmeticError(f"threshold: the frequency does not leave the band up to |g| S = {LARGEST_S:g}")


def _threshold_to(chain: Chain, amplitude_max: float) -> float | None:
    """S_c, or None where it is not below `amplitude_max`."""
    infinite = replace(chain, sites=math.inf)  # type: ignore[arg-type]
    mode = infinite.mode_number(LAST if chain.g > 0 else FIRST)
    family = Family(family_request(infinite, mode, amplitude_max, tolerance=TOLERANCE, corrector="newton"))
    coordinates, last = family.coordinates, family.start
    assert isinstance(coordinates, CoreWithTail)
    born = coordinates.parameter(2).at(EDGE_ANGLE)
    with one_thread():
        for point in family.continuation((family.start,)):
            if point.walked and point.z[point.problem.Omega_index] < born:
                return _held(family, last, point, born) / chain.g
            last = point if point.walked else last
    return None


def _held(family: Family, before: Point, after: Point, u: float) -> float:
    """kappa where the tail's parameter is u, between two points; raises ArithmeticError where it is not found."""
    problem, point_solver = after.problem, family.point_solver
    curve, length = point_solver.curve(before, after)
    (place,) = curve.crossings(problem.Omega_index, u, length)
    row = np.zeros(problem.size)
    row[problem.Omega_index] = -1.0  # u falls along the family
    correction = point_solver.correct(problem, curve.at(place), row, -u, length)
    point = None if correction is None else point_solver.refined(problem, correction, row, held=None)
    if point is None:
        raise ArithmeticError("threshold: no orbit is found where the frequency leaves the band")
    return point.parameter
