"""Transition matrices of q'' = f(q) by DOP853, with derivatives by complex steps: nothing of the package is in them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.integrate import solve_ivp

Array = np.ndarray


def integrated(
    force: Callable[[Array], Array], start: Array, times: Sequence[float], rtol: float = 1e-12, atol: float = 1e-14
) -> tuple[Array, Array]:
    """States (times, 2n) and transition matrices (times, 2n, 2n) from rest at `start`, (n,), at time 0."""
    n = start.size

    def rates(_: float, x: Array) -> Array:
        y, v, X = x[:n], x[n : 2 * n], x[2 * n :].reshape(2 * n, 2 * n)
        J = np.stack([force(y + 1e-30j * unit).imag / 1e-30 for unit in np.eye(n)], axis=1)
        return np.concatenate([v, force(y), X[n:].ravel(), (J @ X[:n]).ravel()])

    first = np.concatenate([start, np.zeros(n), np.eye(2 * n).ravel()])
    path = solve_ivp(rates, (0.0, times[-1]), first, "DOP853", rtol=rtol, atol=atol, t_eval=times).y.T
    return path[:, : 2 * n], path[:, 2 * n :].reshape(-1, 2 * n, 2 * n)
