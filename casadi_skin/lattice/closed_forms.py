"""Weakly nonlinear skin breathing modes by multiple scales (paper: Eqs. for y_n(t), Omega_j and the sensitivity)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from casadi_skin.lattice.uniform_chain import (
    Array,
    gauge_coupling,
    log_envelope,
    right_eigenvector,
    squared_frequency,
    standing_wave,
)


def frequency_slope(sites: int, alpha: float, gamma: float, g: float, mode: int) -> float:
    """Slope dOmega_j/dS at S = 0 (paper, equation for Omega_j): 3g/(4(N+1)omega_j) times the ratio of sums of r^n."""
    weight = np.exp(2.0 * log_envelope(sites, gamma))
    sine2 = standing_wave(sites, mode) ** 2
    omega = np.sqrt(squared_frequency(sites, alpha, gamma, mode))
    ratio = np.sum(weight * sine2**2) / np.sum(weight * sine2)
    return float(3.0 * g * ratio / (4.0 * (sites + 1) * omega))


def frequency(sites: int, alpha: float, gamma: float, g: float, mode: int, S: ArrayLike) -> Array:
    """Nonlinear frequency Omega_j(S) to first order in S = ||y||^2; shape of `S`."""
    omega = np.sqrt(squared_frequency(sites, alpha, gamma, mode))
    return np.asarray(omega + frequency_slope(sites, alpha, gamma, g, mode) * np.asarray(S, dtype=float))


def displacement(sites: int, alpha: float, gamma: float, g: float, mode: int, S: float, t: ArrayLike) -> Array:
    """Displacements y_n(t) = sqrt(S) u_n/||u|| cos(Omega t), shape (time, sites), physical coordinates."""
    u = right_eigenvector(sites, gamma, mode)
    omega = frequency(sites, alpha, gamma, g, mode, S)
    return np.asarray(np.sqrt(S) * np.outer(np.cos(omega * np.atleast_1d(t)), u / np.linalg.norm(u)))


def sensitivity(sites: int, alpha: float, gamma: float, g: float, mode: int) -> float:
    """Sensitivity factor |d((Omega - omega_j)/omega_j)/dS| (paper, equation for the sensitivity)."""
    omega = np.sqrt(squared_frequency(sites, alpha, gamma, mode))
    return abs(frequency_slope(sites, alpha, gamma, g, mode)) / float(omega)


def sensitivity_limit(alpha: float, gamma: float, g: float, mode: int) -> float:
    """Limit of (N+1)^3 times the sensitivity factor of a fixed mode as N grows, 0 < |gamma| < 1.

    Near the edge the sines become m j pi/(N+1), and the sums of m^4 r^-m and m^2 r^-m are polylogarithms, of orders -4
    and -2. Raises ValueError for another gamma.
    """
    if not 0.0 < abs(gamma) < 1.0:
        raise ValueError(f"gamma: given {gamma!r}; accepted: 0 < |gamma| < 1")
    lowest = alpha + 2.0 * gamma**2 / (1.0 + gauge_coupling(gamma))
    return float(0.75 * abs(g) * (np.pi * mode / gamma) ** 2 * (3.0 - 2.0 * gamma**2) / lowest)


# The chain of one site: y'' + omega^2 y + g y^3 = 0, solved by Jacobi elliptic functions (DLMF 22.2, 19.2) ------------


def duffing_frequency(omega_squared: float, g: float, amplitude: float) -> float:
    """Exact frequency of the orbit with y(0) = amplitude, y'(0) = 0.

    Raises ValueError where no oscillation about y = 0 with this amplitude exists.
    """
    stiffness = omega_squared + g * amplitude**2
    if omega_squared <= 0 and omega_squared + stiffness <= 0:
        where = f": it must exceed {-2.0 * omega_squared / g:g}" if g > 0 else " with this stiffness"
        raise ValueError(f"no orbit at amplitude^2 = {amplitude**2:g}{where}")
    if stiffness <= 0:
        raise ValueError(f"no orbit at amplitude^2 = {amplitude**2:g}: it must stay below {omega_squared / -g:g}")
    from scipy.special import ellipk

    m = g * amplitude**2 / (2.0 * stiffness)
    return float(np.pi * np.sqrt(stiffness) / (2.0 * ellipk(m)))


def duffing_displacement(omega_squared: float, g: float, amplitude: float, t: ArrayLike) -> Array:
    """Exact displacement y(t), shape of `t`: amplitude cn(p t) for g >= 0, amplitude cd(p t) for g < 0."""
    from scipy.special import ellipj

    time = np.asarray(t, dtype=float)
    duffing_frequency(omega_squared, g, amplitude)  # refuses amplitudes at which nothing oscillates
    cubic = g * amplitude**2
    if g >= 0:
        stiffness = omega_squared + cubic
        _, cn, _, _ = ellipj(np.sqrt(stiffness) * time, cubic / (2.0 * stiffness))
        return np.asarray(amplitude * cn)
    stiffness = omega_squared + 0.5 * cubic
    _, cn, dn, _ = ellipj(np.sqrt(stiffness) * time, -cubic / (2.0 * stiffness))
    return np.asarray(amplitude * cn / dn)
