"""The linear nonreciprocal chain in closed form (paper: Eqs. for omega_j^2, u_{j,n} and v_{j,n}).

Everything is dimensionless. The gauge y_n = rho_n eta_n with rho_n = r^((n - c)/2), c the edge that the modes
lean to, makes the dynamical matrix symmetric and keeps rho_n <= 1 at every size (Hatano and Nelson 1996).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def gauge_coupling(gamma: float) -> float:
    """Coupling s = sqrt(1 - gamma^2) of neighbouring sites in the gauge, without cancellation near |gamma| = 1."""
    return float(np.sqrt((1.0 - gamma) * (1.0 + gamma)))


def log_envelope(sites: int, gamma: float) -> Array:
    """Natural logarithm of the skin envelope rho_n = r^((n-c)/2), shape (sites,); 0 at the favoured edge.

    At |gamma| = 1 every other site is at -inf: the gauge keeps the edge site alone.
    """
    n = np.arange(1, sites + 1)
    distance = (sites - n) if gamma >= 0 else (n - 1)
    if abs(gamma) == 1.0:
        return np.where(distance == 0, 0.0, -np.inf)
    return np.asarray(-distance * float(np.arctanh(abs(gamma))), dtype=float)


def standing_wave(sites: int, mode: int) -> Array:
    """Values sin(n j pi/(N+1)) for n = 1..N, shape (sites,).

    n j is reduced to the first quarter wave in integers, so that the sine keeps its digits near its zeros.
    """
    half_wave, rest = np.divmod(np.arange(1, sites + 1, dtype=np.int64) * mode, sites + 1)
    rest = np.minimum(rest, sites + 1 - rest)
    return np.asarray(np.where(half_wave % 2 == 0, 1.0, -1.0) * np.sin(np.pi * (rest / (sites + 1))))


def squared_frequency(sites: int, alpha: float, gamma: float, mode: int | NDArray[np.int64]) -> Array:
    """Squared linear frequency omega_j^2 = 2 + alpha - 2 s cos(j pi/(N+1)), shape of `mode`."""
    angle = np.pi * np.asarray(mode) / (sites + 1)
    # alpha + 2(1 - s) + 4 s sin^2(angle/2): no subtraction of equal numbers at the lower edge when alpha is small.
    s = gauge_coupling(gamma)
    return np.asarray(alpha + 2.0 * gamma**2 / (1.0 + s) + 4.0 * s * np.sin(0.5 * angle) ** 2)


def right_eigenvector(sites: int, gamma: float, mode: int) -> Array:
    """Right eigenvector u_{j,n} = r^(n/2) sin(n j pi/(N+1)) of D, scaled by r^(-c/2); shape (sites,).

    The appendix of the paper writes r^(-n/2) here; the main text's r^(n/2) is the eigenvector of D.
    """
    return np.exp(log_envelope(sites, gamma)) * standing_wave(sites, mode)


def left_eigenvector(sites: int, gamma: float, mode: int) -> Array:
    """Left eigenvector v_{j,n} = r^(-n/2) sin(n j pi/(N+1)) of D, scaled to the opposite edge, (sites,)."""
    return right_eigenvector(sites, -gamma, mode) if gamma != 0 else standing_wave(sites, mode)
