"""The equations in time by DOP853, sharing the chain's parameters alone with the package: returns and multipliers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

RELATIVE = 1e-13  # local tolerance, of a component and of the largest one


def couplings(chain: Chain, gauge: bool = False) -> tuple[float, float]:
    """Couplings to the site before and to the site behind."""
    return (chain.coupling, chain.coupling) if gauge else (1.0 + chain.gamma, 1.0 - chain.gamma)


def _coupled(force: Array, x: Array, below: float, above: float) -> Array:
    """The force with that of the neighbours; rows along sites."""
    force[1:] += below * x[:-1]
    force[:-1] += above * x[1:]
    return force


def _in_time(orbit: Orbit) -> Any:
    """The physical equations solved over one period from the orbit at phase zero."""
    from scipy.integrate import solve_ivp

    chain, n, y0 = orbit.model, orbit.model.sites, orbit.profile

    def rates(_: float, x: Array) -> Array:
        y = x[:n]
        force = _coupled(-(2.0 + chain.alpha) * y - chain.g * y**3, y, *couplings(chain))
        return np.concatenate([x[n:], force])

    atol = RELATIVE * np.max(np.abs(y0)) * np.append(np.ones(n), np.full(n, orbit.Omega))
    start = np.concatenate([y0, np.zeros(n)])
    return solve_ivp(rates, (0.0, orbit.period), start, "DOP853", rtol=RELATIVE, atol=atol, dense_output=True)


def return_error(orbit: Orbit) -> float:
    """Largest difference of positions and velocities over Omega after one period, relative to the largest position."""
    states, n = _in_time(orbit).y, orbit.model.sites
    off = np.abs(states[:, -1] - states[:, 0]) / np.max(np.abs(orbit.profile))
    return float(max(np.max(off[:n]), np.max(off[n:]) / orbit.Omega))


def physical_multipliers(orbit: Orbit) -> Complex:
    """Eigenvalues of the full-period monodromy matrix in physical coordinates, shape (2N,), largest modulus first."""
    solution, n = _in_time(orbit).sol, orbit.model.sites
    values = monodromy_eigenvalues(orbit, lambda t: solution(t)[:n], rtol=RELATIVE, atol=RELATIVE)
    return values[np.argsort(-np.abs(values))]


def monodromy_eigenvalues(
    orbit: Orbit,
    displacements: Callable[[float], Array] | None = None,
    *,
    gauge: bool = False,
    rtol: float,
    atol: float,
) -> Complex:
    """Eigenvalues of the 2N x 2N monodromy matrix over the whole period, without the use of any symmetry.

    Arguments:
        orbit: The orbit of a finite chain.
        displacements: Physical displacements at a time, shape (N,); those of the orbit unless given.
        gauge: Whether perturbations are those of the gauge coordinates.
        rtol: Relative tolerance of a step of DOP853.
        atol: Absolute tolerance of a step.

    Returns:
        The eigenvalues, shape (2N,).

    Raises:
        ArithmeticError: DOP853 fails.
    """
    from scipy.integrate import solve_ivp

    chain, n = orbit.model, orbit.model.sites
    at = displacements or orbit.evaluate

    def rates(t: float, flat: Array) -> Array:
        x, v = flat.reshape(2, n, 2 * n)
        force = -(2.0 + chain.alpha + 3.0 * chain.g * at(t)[:, None] ** 2) * x
        return np.concatenate([v.ravel(), _coupled(force, x, *couplings(chain, gauge)).ravel()])

    found = solve_ivp(rates, (0.0, orbit.period), np.eye(2 * n).ravel(), "DOP853", rtol=rtol, atol=atol)
    if not found.success:
        raise ArithmeticError(f"DOP853: {found.message}")
    return np.asarray(np.linalg.eigvals(found.y[:, -1].reshape(2 * n, 2 * n)).astype(complex))
