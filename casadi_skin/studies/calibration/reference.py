"""An orbit and its mu anew in long double, to judge error estimates by: it shares the equations alone with the package.

The orbit: odd cosines, with residuals in long double and Newton steps in double, which converges to the digits of the
residual (iterative refinement: Higham 2002, chapter 12). The transition matrix: Stoermer's rule extrapolated to order
16 (Hairer, Norsett and Wanner 1993, section II.14).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.trigonometric import TrigonometricProblem
from casadi_skin.lattice.chain import Chain
from casadi_skin.solvers.bordered import BorderedSolver

Extended = NDArray[np.longdouble]
ExtendedComplex = NDArray[np.clongdouble]

PI = np.arccos(np.longdouble(-1.0))
SMALLEST = 24  # harmonics to begin with
LARGEST = 8_000_000  # sites times harmonics squared
TAIL = 1e-17  # of the orbit: harmonics in the last quarter, when there are enough
TOO_FEW = 1e-3  # of the orbit in that quarter: it is begun anew with more of them
SETTLED = 1e-17  # of the orbit: a Newton step that is none any more
ITERATIONS = 25
COLUMNS = 8  # of an extrapolation table: order 16
AGREED = 1e-17  # difference of mu with two step numbers
REFINEMENTS = 5


class UnjudgedError(ArithmeticError):
    """No reference that can judge was found."""


@dataclass(frozen=True)
class ReferenceOrbit:
    """q(theta) = sum_k c_k cos((2k+1) theta) in the scaled gauge, at kappa; `left_out` is the relative tail of c."""

    chain: Chain
    kappa: float
    coefficients: Extended
    Omega: np.longdouble
    left_out: float

    def positions(self, theta: Extended) -> Extended:
        """Scaled gauge positions at phases, shape (len(theta), sites)."""
        odd = 2 * np.arange(self.coefficients.shape[1]) + 1
        return np.asarray(np.cos(np.outer(theta, odd)) @ self.coefficients.T)


@dataclass(frozen=True)
class _Lattice:
    """The equations q'' = -L q - kappa w q^3 of a chain in the scaled gauge, rows along sites."""

    chain: Chain

    @property
    def rho(self) -> Extended:
        """Gauge factor, shape (sites,)."""
        gamma, n = np.longdouble(self.chain.gamma), np.arange(self.chain.sites)
        distance = n[::-1] if self.chain.gamma >= 0 else n
        return np.asarray(((1 - abs(gamma)) / (1 + abs(gamma))) ** (distance / np.longdouble(2)))

    def linear(self, q: Extended) -> Extended:
        """L q, shape of q, which is (sites, ...)."""
        gamma = np.longdouble(self.chain.gamma)
        coupling = np.sqrt((1 - gamma) * (1 + gamma))
        result = (2 + np.longdouble(self.chain.alpha)) * q
        result[1:] -= coupling * q[:-1]
        result[:-1] -= coupling * q[1:]
        return np.asarray(result)


def reference_orbit(chain: Chain, kappa: float, Omega: float, sample: Callable[[Array], Array]) -> ReferenceOrbit:
    """The orbit at kappa that Newton's method finds from `sample`, positions (phases, sites) at phases, and Omega.

    Raises UnjudgedError where it does not converge.
    """
    harmonics = SMALLEST
    c, frequency = _sampled(sample, harmonics), np.longdouble(Omega)
    while True:
        c, frequency = _solved(chain, kappa, c, frequency)
        largest = float(np.max(np.abs(c @ _cosines(harmonics))))
        tail = float(np.max(np.sum(np.abs(c[:, -(harmonics // 4) :]), axis=1))) / largest
        if tail <= TAIL or chain.sites * (2 * harmonics) ** 2 > LARGEST:
            return ReferenceOrbit(chain, kappa, c, frequency, tail)
        harmonics *= 2
        if tail > TOO_FEW:
            c, frequency = _sampled(sample, harmonics), np.longdouble(Omega)
        else:
            c = np.pad(c, ((0, 0), (0, harmonics - c.shape[1])))


def _sampled(sample: Callable[[Array], Array], harmonics: int) -> Extended:
    """Coefficients of an orbit known by its positions at phases."""
    values = sample(_nodes(harmonics).astype(float)).T.astype(np.longdouble)
    return np.asarray(values @ _cosines(harmonics) * 2 / harmonics)


def _nodes(harmonics: int) -> Extended:
    return np.asarray((np.arange(harmonics) + np.longdouble(0.5)) * PI / (2 * harmonics))


def _cosines(harmonics: int) -> Extended:
    """Symmetric matrix of cos((2k+1) theta_i); its square is H/2 times the identity."""
    odd = 2 * np.arange(harmonics) + 1
    return np.asarray(np.cos(PI / (4 * harmonics) * (np.outer(odd, odd) % (8 * harmonics))))


def _solved(chain: Chain, kappa: float, c: Extended, Omega: np.longdouble) -> tuple[Extended, np.longdouble]:
    """Coefficients and frequency that satisfy the equations at the nodes; raises UnjudgedError."""
    harmonics, lattice = c.shape[1], _Lattice(chain)
    problem = TrigonometricProblem(chain.gauge_model(), harmonics)
    solver, row = BorderedSolver(problem), problem.parameter_row()
    cosines, w = _cosines(harmonics), lattice.rho[:, None] ** 2
    squares = (2 * np.arange(harmonics) + 1) ** 2
    before, solve = np.inf, None
    for _ in range(ITERATIONS):
        q = c @ cosines
        force = lattice.linear(q) + kappa * w * q**3
        residual = force / Omega**2 - (c * squares) @ cosines
        norm = np.sum(w[:, 0] * np.sum(c, axis=1) ** 2) - 1
        if solve is None or before > 1e-3:
            z = np.concatenate([q.astype(float).ravel(), [float(Omega), kappa]])
            solve = solver.factor(z, problem.evaluate(z)[1], row)
        right = np.concatenate([residual.ravel(), [norm, np.longdouble(0)]])
        scale = np.max(np.abs(right))
        if scale == 0:
            return c, Omega
        step = solve((right / scale).astype(float)) * scale
        c = c - step[: q.size].reshape(q.shape) @ cosines * 2 / harmonics
        Omega = Omega - step[q.size]
        size = max(float(np.max(np.abs(step[: q.size])) / np.max(np.abs(q))), abs(float(step[q.size] / Omega)))
        if not np.isfinite(size) or Omega <= 0:
            break
        if size <= SETTLED or (before < 1e-14 and size > 0.5 * before):
            return c, Omega
        before = size
    raise UnjudgedError(f"Newton's method for the reference stops at a step of {before:.1e}")


# Multipliers --------------------------------------------------------------------------------------------------------


def reference_mu(orbit: ReferenceOrbit) -> tuple[ExtendedComplex, float]:
    """The sites - 1 eigenvalues mu of B^T C beside the trivial one, and what another number of steps makes of them.

    B and C are blocks of the transition matrix over a quarter of the period.
    """
    lattice = _Lattice(orbit.model)
    stiffest = 4 + orbit.model.alpha + 3 * abs(orbit.kappa) * float(np.max(lattice.rho * _peaks(orbit))) ** 2
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


def paired(values: ExtendedComplex, others: ExtendedComplex) -> ExtendedComplex:
    """`others` in the order in which they belong to `values`: the sum of all distances is least."""
    from scipy.optimize import linear_sum_assignment

    distances = np.abs(values[:, None] - others[None, :]).astype(float)
    return np.asarray(others[linear_sum_assignment(distances)[1]])


def _mu(orbit: ReferenceOrbit, steps: int) -> ExtendedComplex:
    """Eigenvalues without the trivial one, of left eigenvector q''(0), which a reflection takes out."""
    matrix, q = _half_cosines(orbit, steps), orbit.positions(np.zeros(1, np.longdouble))[0]
    lattice = _Lattice(orbit.model)
    u = lattice.linear(q) + orbit.kappa * lattice.rho**2 * q**3
    u = u / np.sqrt(u @ u)
    u[0] += np.copysign(np.longdouble(1), u[0])
    u = u / np.sqrt(u @ u)
    half = matrix - 2 * np.outer(u, u @ matrix)
    return _eigenvalues((half - 2 * np.outer(half @ u, u))[1:, 1:])


def _peaks(orbit: ReferenceOrbit) -> Array:
    """Largest |q_n|, shape (sites,)."""
    theta = PI / 2 * np.arange(65) / 64
    return np.asarray(np.max(np.abs(orbit.positions(theta)), axis=0), dtype=float)


def _half_cosines(orbit: ReferenceOrbit, steps: int) -> Extended:
    """B^T C in `steps` equal steps of the phase, each by Stoermer's rule in 1 .. COLUMNS parts, extrapolated."""
    n, h = orbit.model.sites, PI / 2 / steps
    parts = np.arange(1, COLUMNS + 1)
    weights = [np.prod([p**2 / np.longdouble(p**2 - r**2) for r in parts if r != p]) for p in parts]
    x, v = np.zeros((n, 2 * n), np.longdouble), np.zeros((n, 2 * n), np.longdouble)
    x[:, :n] = v[:, n:] = np.eye(n)
    lattice, squared = _Lattice(orbit.model), orbit.Omega**2
    cubic = 3 * orbit.kappa * lattice.rho**2
    fractions = np.unique(np.concatenate([np.arange(p + 1) * 840 // p for p in parts]))  # 840: all parts divide it
    for step in range(steps):
        theta = (step + fractions / np.longdouble(840)) * h
        stiffness = dict(zip(fractions.tolist(), cubic * orbit.positions(theta) ** 2, strict=True))
        new_x, new_v = np.zeros_like(x), np.zeros_like(v)
        for p, weight in zip(parts.tolist(), weights, strict=True):
            part, dx, dv = h / p, np.zeros_like(x), np.zeros_like(v)  # of increments less is rounded away
            for i in range(p + 1):
                kick, X = (part if 0 < i < p else part / 2) / squared, x + dx
                dv -= kick * (lattice.linear(X) + stiffness[i * 840 // p][:, None] * X)
                if i < p:
                    dx += part * (v + dv)
            new_x += weight * dx
            new_v += weight * dv
        x, v = x + new_x, v + new_v
    return np.asarray(x[:, n:].T @ v[:, :n])


def _eigenvalues(matrix: Extended) -> ExtendedComplex:
    """Of a real matrix: those that LAPACK finds, improved by what its vectors leave of the off-diagonal.

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
