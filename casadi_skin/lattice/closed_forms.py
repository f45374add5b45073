"""The linear chain, its frequency to first order in S (paper, multiple scales), and one site, in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casadi_skin.lattice.stiffness import stiffness

# The linear nonreciprocal chain in closed form (paper: Eqs. for omega_j^2, u_{j,n} and v_{j,n}) -----------------------

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
    return np.asarray(alpha + np.vectorize(stiffness, otypes=[float])(sites, gamma, mode))


def right_eigenvector(sites: int, gamma: float, mode: int) -> Array:
    """Right eigenvector u_{j,n} = r^(n/2) sin(n j pi/(N+1)) of D, scaled by r^(-c/2); shape (sites,).

    The appendix of the paper writes r^(-n/2) here; the main text's r^(n/2) is the eigenvector of D.
    """
    return np.exp(log_envelope(sites, gamma)) * standing_wave(sites, mode)


def left_eigenvector(sites: int, gamma: float, mode: int) -> Array:
    """Left eigenvector v_{j,n} = r^(-n/2) sin(n j pi/(N+1)) of D, scaled to the opposite edge, (sites,)."""
    return right_eigenvector(sites, -gamma, mode) if gamma != 0 else standing_wave(sites, mode)


def frequency_slope(sites: int, alpha: float, gamma: float, g: float, mode: int) -> float:
    """Slope dOmega_j/dS at S = 0 (paper, equation for Omega_j): 3g/(4(N+1)omega_j) times the ratio of sums of r^n."""
    weight = np.exp(2.0 * log_envelope(sites, gamma))
    sine2 = standing_wave(sites, mode) ** 2
    omega = np.sqrt(squared_frequency(sites, alpha, gamma, mode))
    ratio = np.sum(weight * sine2**2) / np.sum(weight * sine2)
    return float(3.0 * g * ratio / (4.0 * (sites + 1) * omega))


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
