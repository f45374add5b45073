"""The shares of harmonics in an orbit, and the place along a family where the third takes over from the first.

Where 3 Omega reaches the band of a softening family, the family turns into a third harmonic of a linear mode that
fills the lattice: an internal resonance.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from casadi_skin.follow.branch import Branch
from casadi_skin.follow.orbit import Orbit
from casadi_skin.model.arguments import short_repr
from casadi_skin.zero.problem import Array

NEAREST_TAKEOVER = 1e-10  # of the way from one orbit to the next, at which a takeover is looked for


def harmonic_shares(orbit: Orbit, coordinates: str = "gauge") -> Array:
    """Shares of the odd harmonics 1, 3, 5, ... in the mean over time of sum_n x_n^2, shape (harmonics,), of sum 1.

    x is the displacement in the "gauge", where no site is favoured, or "physical". Raises ValueError for other words.
    """
    if coordinates not in ("gauge", "physical"):
        raise ValueError(f"coordinates: given {short_repr(coordinates)}; accepted: gauge, physical")
    count = max(4, orbit.harmonics)
    if coordinates == "physical":
        c = orbit.coefficients(count)
    else:
        theta = (np.arange(count) + 0.5) * np.pi / (2 * count)
        c = np.cos(np.outer(2 * np.arange(count) + 1, theta)) @ orbit.point.problem.sample(orbit.point.z, theta)
    squares = np.sum(c**2, axis=1)
    return np.asarray(squares / np.sum(squares))


def third_harmonic_leads(branch: Branch, coordinates: str = "gauge") -> Orbit | None:
    """The orbit at which the third harmonic first becomes as large as the fundamental, or None where it never does.

    Where no orbit is found between two of the branch, the first of the branch in which it is larger.
    """
    from scipy.optimize import brentq

    def lead(orbit: Orbit) -> float:
        shares = harmonic_shares(orbit, coordinates)
        return float(shares[1] - shares[0])

    leading = next((k for k, orbit in enumerate(branch.orbits) if lead(orbit) >= 0), None)
    if leading is None:
        return None
    after = branch.orbits[leading]
    if leading == 0:
        return after
    before, nearest = branch.orbits[leading - 1], [after]

    def gap(fraction: float) -> float:
        if fraction in (0.0, 1.0):
            return lead(after if fraction else before)
        point = branch.space.point_solver.along(before.point, after.point, fraction)
        if point is None:
            raise ArithmeticError("no orbit between two of the branch")
        nearest.append(Orbit(branch.space, point))
        return lead(nearest[-1])

    with suppress(ArithmeticError):
        brentq(gap, 0.0, 1.0, xtol=NEAREST_TAKEOVER)
    return min(nearest, key=lambda orbit: abs(lead(orbit)))
