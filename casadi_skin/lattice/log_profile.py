"""Displacements far below the smallest double, as logarithms.

Where the gauge runs out of numbers its sites are linear, each odd harmonic k is by itself, s (a_(d-1) + a_(d+1)) =
(2 + alpha - k^2 Omega^2) a_d with a_0 = 0, and it goes on in closed form: a_d ~ sin(d theta) in the band and
sinh(d kappa) beside it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from casadi_skin.lattice.chain import Chain
from casadi_skin.zero.cosines import cosine_matrix
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point
from casadi_skin.zero.trigonometric import TrigonometricProblem

SMALLEST = 1e-250  # of the largest state: below it doubles run out
LINEAR = 1e-16  # of the coupling: a stiffness of the cubic term that is round-off
KEPT = 1e-9  # of the largest harmonic at a site: below it a harmonic is what the others leave of it
GAUSS_HARMONICS = 32


def continued_logarithms(core: Chain, point: Point, z: Array, smallest: float) -> tuple[Array, Array]:
    """Natural logarithms of |q_n| at t = 0 in the gauge, and the signs, each (core sites,); -inf and 0 where q_n = 0.

    Sites below `smallest` times the largest are computed in closed form from those above.
    """
    problem = point.problem
    harmonics = problem.resolution if isinstance(problem, TrigonometricProblem) else GAUSS_HARMONICS
    theta = (np.arange(harmonics) + 0.5) * np.pi / (2 * harmonics)
    start, values = np.split(problem.sample(z, np.concatenate([[0.0], theta])), [1])
    with np.errstate(divide="ignore"):
        logs, signs = np.log(np.abs(start[0])), np.sign(start[0])
    if core.coupling == 0.0 or core.sites == 1:
        return logs, signs
    # Sites counted from the end that the modes lean away from.
    order = slice(None) if core.gamma >= 0 else slice(None, None, -1)
    sizes = np.max(np.abs(values), axis=0)[order]
    stiffness = abs(point.parameter) * np.max(sizes) ** 2
    if smallest > SMALLEST and stiffness > 0.0:
        smallest = min(smallest, np.sqrt(LINEAR * core.coupling / stiffness))
    tail = int(np.searchsorted(np.maximum.accumulate(sizes), smallest * np.max(sizes)))
    if tail == 0:
        return logs, signs
    with np.errstate(under="ignore"):
        coefficients = (2.0 / harmonics) * cosine_matrix(harmonics) @ values[:, order][:, tail]
    logs[order][:tail], signs[order][:tail] = _continued(coefficients, point.Omega, core.alpha, core.coupling, tail)
    return logs, signs


def _continued(coefficients: Array, Omega: float, alpha: float, coupling: float, tail: int) -> tuple[Array, Array]:
    """Logarithms and signs of the sum of harmonics at sites 1..tail, from their coefficients at site tail + 1."""
    harmonics = np.flatnonzero(np.abs(coefficients) > KEPT * np.max(np.abs(coefficients)))
    parts = [
        _log_wave(np.arange(1, tail + 2, dtype=np.int64), 2 * k + 1, Omega, alpha, coupling) for k in harmonics.tolist()
    ]
    logs = np.stack([log[:-1] - log[-1] for log, _ in parts]) + np.log(np.abs(coefficients[harmonics]))[:, None]
    signs = np.stack([s[:-1] * s[-1] for _, s in parts]) * np.sign(coefficients[harmonics])[:, None]
    largest = np.max(logs, axis=0)
    total = np.sum(signs * np.exp(logs - largest), axis=0)
    with np.errstate(divide="ignore"):
        return largest + np.log(np.abs(total)), np.sign(total)


def _log_wave(d: NDArray[np.int64], k: int, Omega: float, alpha: float, coupling: float) -> tuple[Array, Array]:
    """Logarithm and sign of the wave of harmonic k at distances d from the fixed end."""
    low = (2.0 + alpha - 2.0 * coupling - (k * Omega) ** 2) / (4.0 * coupling)  # > 0 below the band
    if -1.0 <= low <= 0.0:
        wave = np.sin(2.0 * d * np.arcsin(np.sqrt(-low)))
        with np.errstate(divide="ignore"):
            return np.log(np.abs(wave)), np.sign(wave)
    beyond = low if low > 0.0 else -1.0 - low
    kappa = 2.0 * np.arcsinh(np.sqrt(beyond))
    signs = np.ones(d.size) if low > 0.0 else np.where(d % 2 == 0, 1.0, -1.0)
    return d * kappa + np.log1p(-np.exp(-2.0 * d * kappa)), signs
