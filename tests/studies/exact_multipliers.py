"""The mu of an exact orbit in long double, to judge those of the package by, with which it shares the equations alone.

The transition matrix: Stoermer's rule extrapolated to order 16 (Hairer, Norsett and Wanner 1993, section II.14).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from casadi_skin.runs.tradeoff import paired
from tests.studies.exact import ExactOrbit

Extended = NDArray[np.longdouble]
Complex = NDArray[np.complexfloating]

PI = np.arccos(np.longdouble(-1))
COLUMNS = 8  # of an extrapolation table: order 16
PARTS = np.arange(1, COLUMNS + 1)
MULTIPLE = 840  # of all numbers of parts
AGREED = 1e-17  # difference of mu with two numbers of steps
REFINEMENTS = 5


def exact_mu(orbit: ExactOrbit) -> tuple[Complex, float]:
    """The eigenvalues mu of B^T C without the trivial one, with B and C blocks of the transition matrix over T/4.

    Arguments:
        orbit: An exact orbit in long doubles.

    Returns:
        The values, shape (sites - 1,), and those by another number of steps.
    """
    theta = PI / 2 * np.arange(65) / 64
    largest = np.max(np.abs(orbit.scale * _positions(orbit, theta)))
    stiffest = 4 + orbit.chain.alpha + 3 * abs(orbit.chain.g) * float(largest) ** 2
    steps = int(np.ceil(0.5 * np.pi * np.sqrt(stiffest) / float(orbit.Omega))) + 2
    mu, difference = _mu(orbit, steps), np.inf
    for _ in range(REFINEMENTS):
        steps = round(1.5 * steps)
        finer = _mu(orbit, steps)
        before, difference = difference, float(np.max(np.abs(paired(finer, mu) - finer), initial=0.0))
        mu = finer
        if difference <= AGREED or 0.5 * before < difference < 1e-12:
            break
    return mu, difference


def _positions(orbit: ExactOrbit, theta: Extended) -> Extended:
    """Scaled positions in the gauge at phases, shape (len(theta), sites)."""
    odd = 2 * np.arange(orbit.scaled.shape[1]) + 1
    return np.asarray(np.cos(np.outer(theta, odd)) @ orbit.scaled.T)


def _linear(orbit: ExactOrbit, q: Extended) -> Extended:
    """The linear restoring force L q in the gauge, shape of q, which is (sites, ...)."""
    gamma = np.longdouble(orbit.chain.gamma)
    coupling = np.sqrt((1 - gamma) * (1 + gamma))
    result = (2 + np.longdouble(orbit.chain.alpha)) * q
    result[1:] -= coupling * q[:-1]
    result[:-1] -= coupling * q[1:]
    return np.asarray(result)


def _mu(orbit: ExactOrbit, steps: int) -> Complex:
    """Eigenvalues without the trivial one, of left eigenvector q''(0), which a reflection takes out."""
    matrix, q = _half_cosines(orbit, steps), _positions(orbit, np.zeros(1, np.longdouble))[0]
    u = _linear(orbit, q) + orbit.chain.g * orbit.scale**2 * q**3
    u = u / np.sqrt(u @ u)
    u[0] += np.copysign(np.longdouble(1), u[0])
    u = u / np.sqrt(u @ u)
    half = matrix - 2 * np.outer(u, u @ matrix)
    return _eigenvalues((half - 2 * np.outer(half @ u, u))[1:, 1:])


def _half_cosines(orbit: ExactOrbit, steps: int) -> Extended:
    """B^T C in `steps` equal steps of the phase, each by Stoermer's rule in 1 .. COLUMNS parts, extrapolated."""
    n, h = orbit.chain.sites, PI / 2 / steps
    weights = [np.prod([p**2 / np.longdouble(p**2 - r**2) for r in PARTS if r != p]) for p in PARTS]
    x, v = np.zeros((n, 2 * n), np.longdouble), np.zeros((n, 2 * n), np.longdouble)
    x[:, :n] = v[:, n:] = np.eye(n)
    squared, cubic = orbit.Omega**2, 3 * orbit.chain.g * orbit.scale**2
    fractions = np.unique(np.concatenate([np.arange(p + 1) * MULTIPLE // p for p in PARTS]))
    for step in range(steps):
        theta = (step + fractions / np.longdouble(MULTIPLE)) * h
        stiffness = dict(zip(fractions.tolist(), cubic * _positions(orbit, theta) ** 2, strict=True))
        new_x, new_v = np.zeros_like(x), np.zeros_like(v)
        for p, weight in zip(PARTS.tolist(), weights, strict=True):
            part, dx, dv = h / p, np.zeros_like(x), np.zeros_like(v)  # of increments less is rounded away
            for i in range(p + 1):
                kick, X = (part if 0 < i < p else part / 2) / squared, x + dx
                dv -= kick * (_linear(orbit, X) + stiffness[i * MULTIPLE // p][:, None] * X)
                if i < p:
                    dx += part * (v + dv)
            new_x += weight * dx
            new_v += weight * dv
        x, v = x + new_x, v + new_v
    return np.asarray(x[:, n:].T @ v[:, :n])


def _eigenvalues(matrix: Extended) -> Complex:
    """Of a real matrix: those that LAPACK finds, improved by the off-diagonal part that its vectors leave.

    A pair that nearly meets is that of its own 2 x 2 matrix.
    """
    values, right = np.linalg.eig(matrix.astype(float))
    try:
        X, Y = right.astype(np.clongdouble), np.linalg.inv(right).astype(np.clongdouble)
    except np.linalg.LinAlgError:  # a defective eigenvalue: known to the root of the round-off
        return np.asarray(values, dtype=np.clongdouble)
    for _ in range(2):
        Y = 2 * Y - Y @ (X @ Y)
    T = Y @ (matrix @ X)
    if T.size == 0 or not np.all(np.isfinite(T)):
        return np.asarray(values, dtype=np.clongdouble)
    improved = np.diagonal(T).copy()
    coupled = T * T.T
    half = (improved[:, None] - improved[None, :]) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        root = half * np.sqrt(1 + coupled / half**2)
    shift = np.where(half == 0, np.sqrt(coupled), root - half)
    np.fill_diagonal(shift, 0)
    largest = np.argmax(np.abs(shift), axis=1)
    return np.asarray(improved + shift[np.arange(improved.size), largest])
