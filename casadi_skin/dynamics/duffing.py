"""The chain of one site: y'' + omega^2 y + g y^3 = 0, solved by Jacobi elliptic functions (DLMF 22.2, 19.2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ellipj, ellipk

from casadi_skin.lattice.uniform_chain import Array


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
    m = g * amplitude**2 / (2.0 * stiffness)
    return float(np.pi * np.sqrt(stiffness) / (2.0 * ellipk(m)))


def duffing_displacement(omega_squared: float, g: float, amplitude: float, t: ArrayLike) -> Array:
    """Exact displacement y(t), shape of `t`: amplitude cn(p t) for g >= 0, amplitude cd(p t) for g < 0."""
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
