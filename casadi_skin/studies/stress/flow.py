"""The physical equations in time by DOP853: how an orbit returns, and its multipliers from the whole period.

Nothing is shared with the package but the parameters of the chain: no gauge, no symmetry, no collocation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.orbit import Orbit
from casadi_skin.stability.reduction import ComplexArray

RELATIVE = 1e-13  # local tolerance, of a component and of the largest one


def _force(chain: Chain, y: Array) -> Array:
    """y'' of displacements, shape of y, which is (sites, ...)."""
    force = -(2.0 + chain.alpha) * y - chain.g * y**3
    force[1:] += (1.0 + chain.gamma) * y[:-1]
    force[:-1] += (1.0 - chain.gamma) * y[1:]
    return np.asarray(force)


def _stiffness(chain: Chain, y: Array, dy: Array) -> Array:
    """Derivative of the force at y (sites,) along the columns of dy (sites, columns)."""
    change = -(2.0 + chain.alpha + 3.0 * chain.g * y[:, None] ** 2) * dy
    change[1:] += (1.0 + chain.gamma) * dy[:-1]
    change[:-1] += (1.0 - chain.gamma) * dy[1:]
    return np.asarray(change)


def return_error(orbit: Orbit) -> float:
    """Largest difference of positions and velocities over Omega after one period, relative to the largest position."""
    from scipy.integrate import solve_ivp

    chain, n, y0 = orbit.model, orbit.model.sites, orbit.profile
    largest = float(np.max(np.abs(y0)))

    def rates(_: float, x: Array) -> Array:
        return np.concatenate([x[n:], _force(chain, x[:n])])

    start = np.concatenate([y0, np.zeros(n)])
    atol = RELATIVE * largest * np.append(np.ones(n), np.full(n, orbit.Omega))
    found = solve_ivp(rates, (0.0, orbit.period), start, "DOP853", rtol=RELATIVE, atol=atol)
    off = np.abs(found.y[:, -1] - start) / largest
    return float(max(np.max(off[:n]), np.max(off[n:]) / orbit.Omega))


def physical_multipliers(orbit: Orbit) -> ComplexArray:
    """Eigenvalues of the full-period monodromy matrix in physical coordinates, shape (2N,), largest modulus first."""
    from scipy.integrate import solve_ivp

    chain, n = orbit.model, orbit.model.sites

    def rates(_: float, x: Array) -> Array:
        y, v = x[:n], x[n : 2 * n]
        dy, dv = x[2 * n :].reshape(2, n, 2 * n)
        return np.concatenate([v, _force(chain, y), dv.ravel(), _stiffness(chain, y, dy).ravel()])

    start = np.concatenate([orbit.profile, np.zeros(n), np.eye(2 * n).ravel()])
    found = solve_ivp(rates, (0.0, orbit.period), start, "DOP853", rtol=RELATIVE, atol=RELATIVE)
    values = np.linalg.eigvals(found.y[2 * n :, -1].reshape(2 * n, 2 * n)).astype(complex)
    return np.asarray(values[np.argsort(-np.abs(values))])


def farthest(values: ComplexArray, others: ComplexArray) -> NDArray[np.float64]:
    """Distance of each value from its partner among the others, relative to max(1, |value|), all distances least."""
    from scipy.optimize import linear_sum_assignment

    distances = np.abs(values[:, None] - others[None, :]) / np.maximum(1.0, np.abs(values))[:, None]
    rows, columns = linear_sum_assignment(distances)
    return np.asarray(distances[rows, columns])
