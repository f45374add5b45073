"""Values of odd cosines at the nodes theta_i = (i + 1/2) pi/(2H): transform, prolongation, second derivative."""

from __future__ import annotations

from functools import cache

import numpy as np

from casadi_skin.zero.problem import Array


def quarter_phases(nodes: int) -> Array:
    """Midpoints of `nodes` equal parts of a quarter of the period."""
    return (np.arange(nodes) + 0.5) * np.pi / (2 * nodes)


@cache
def cosine_matrix(harmonics: int) -> Array:
    """Symmetric matrix V with V_ik = cos((2k+1) theta_i); V V = (H/2) I, shape (H, H)."""
    i = np.arange(harmonics)
    phase = np.outer(2 * i + 1, 2 * i + 1) % (8 * harmonics)
    matrix = np.cos(np.pi * phase / (4 * harmonics))
    matrix.flags.writeable = False  # kept and shared
    return matrix


@cache
def prolongation_matrix(harmonics: int, others: int) -> Array:
    """Matrix from node values of `harmonics` odd cosines to those of `others`, shape (harmonics, others)."""
    kept = min(harmonics, others)
    return (2.0 / harmonics) * cosine_matrix(harmonics)[:, :kept] @ cosine_matrix(others)[:kept]


@cache
def second_derivative_matrix(harmonics: int) -> Array:
    """Matrix of d^2/dtheta^2 on node values, shape (H, H).

    Entries are of size H^2, and what rounding makes of -cos(theta) goes into every frequency. The diagonal is chosen so
    that the rounded matrix is right for cos(theta) (Baltensperger and Trummer 2003), where long double has more digits.
    """
    i = np.arange(harmonics)
    angle = (np.outer(2 * i + 1, 2 * i + 1) % (8 * harmonics)).astype(np.longdouble) / (4 * harmonics)
    V = np.cos(np.arccos(np.longdouble(-1.0)) * angle)
    exact = -((V * (2 * i + 1) ** 2) @ V) * 2 / harmonics
    rounded = exact.astype(np.float64)
    fundamental = V[:, 0]
    missing = -(fundamental + rounded @ fundamental) / fundamental
    rounded[i, i] = (rounded[i, i] + missing).astype(np.float64)
    rounded.flags.writeable = False  # kept and shared
    return np.asarray(rounded)
