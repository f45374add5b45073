"""A, DF and F of cosine series on many harmonics in doubles: what bounds of proofs are compared with."""

import numpy as np


def explicit(bounds, harmonics, shift=None, factor=None):
    """A DF on many harmonics in doubles, with products by quadrature: independent of the blocks of the bounds.

    `shift` is added to the coefficients, shape (1 + positions * harmonics,). `factor` is what A has for 1/lambda.
    """
    series, chain = bounds.series, bounds.series.system
    n, H, J = chain.positions, series.harmonics, harmonics
    odd, theta = chain.step * np.arange(1.0, J + 1.0) - 1.0, (np.arange(8 * J) + 0.5) * np.pi / (8 * J)
    cosines = np.cos(np.outer(theta, odd))
    mean = np.where(odd > 0.0, 2.0, 1.0)[:, None] / theta.size
    a = np.zeros((n, J))
    a[:, :H] = [[float(x) for x in row] for row in series.coefficients]
    square, scale = float(series.square), np.array([float(d) for d in chain.scale])
    c0 = 2.0 * scale**2 * a.sum(axis=1)
    if shift is not None:
        square, a = square + shift[0], a + shift[1:].reshape(n, J)
    q = a @ cosines.T
    DF = np.zeros((1 + n * J, 1 + n * J))
    DF[0, 1:] = np.repeat(2.0 * scale**2 * a.sum(axis=1), J)
    DF[1:, 0] = (odd**2 * a).ravel()
    for m in range(n):
        for k in range(n):
            slope = np.zeros(theta.size)
            for factors, coefficient in chain.scaled(m):
                for place, index in enumerate(factors):
                    if index == k:
                        others = [q[i] for i in factors[:place] + factors[place + 1 :]]
                        slope += float(coefficient) * np.prod([np.ones(theta.size), *others], axis=0)
            block = mean * (cosines.T @ (slope[:, None] * cosines))
            DF[1 + m * J : 1 + (m + 1) * J, 1 + k * J : 1 + (k + 1) * J] += block
    DF[np.arange(1, 1 + n * J), np.arange(1, 1 + n * J)] += square * np.tile(odd**2, n)
    finite = np.concatenate([[0], *(1 + m * J + np.arange(H) for m in range(n))])
    tail = np.setdiff1d(np.arange(1 + n * J), finite)
    A = np.zeros_like(DF)
    A[np.ix_(finite, finite)] = bounds.matrix
    inertia = np.tile(odd**2, n)[tail - 1] * (float(series.square) if factor is None else 1.0 / factor)
    A[tail, tail] = 1.0 / inertia
    A[np.ix_(finite, tail)] = -np.outer(bounds.matrix[:, 0], np.repeat(c0, J)[tail - 1] / inertia)
    weights = np.concatenate([[1.0], np.tile(float(bounds.nu) ** odd, n)])
    return A, DF, weights


def norm(matrix, weights):
    return float(np.max(weights @ np.abs(matrix) / weights))


def explicit_residual(series, harmonics):
    """The equations on many harmonics in doubles, with products by quadrature."""
    chain, H = series.system, series.harmonics
    numbers = chain.step * np.arange(1.0, harmonics + 1.0) - 1.0
    theta = (np.arange(8 * harmonics) + 0.5) * np.pi / (8 * harmonics)
    cosines = np.cos(np.outer(theta, numbers))
    a = np.zeros((chain.positions, harmonics))
    a[:, :H] = [[float(x) for x in row] for row in series.coefficients]
    q, scale = a @ cosines.T, np.array([float(d) for d in chain.scale])
    force = np.zeros_like(q)
    for n in range(chain.positions):
        for factors, coefficient in chain.scaled(n):
            force[n] += float(coefficient) * np.prod([q[i] for i in factors], axis=0)
    rows = float(series.square) * numbers**2 * a + np.where(numbers > 0.0, 2.0, 1.0) * (force @ cosines) / theta.size
    return np.concatenate([[np.sum((scale * a.sum(axis=1)) ** 2) - float(chain.S)], rows.ravel()])
