"""Orbits to 50 digits, from the equations of motion in physical coordinates alone; Duffing's frequency by the AGM.

Python's decimal numbers have as many digits and as large exponents as are asked for, so that r^N neither overflows nor
underflows. The orbit: odd cosines at Fourier nodes; the residual is that of the physical equations with all digits,
and Newton's steps need their matrix in double precision only (iterative refinement: Higham 2002, chapter 12).
"""

from __future__ import annotations

import decimal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.lattice.chain import Chain
from casadi_skin.orbits.orbit import Orbit

Exact = NDArray[Any]  # of Decimal

DIGITS = 50
GUARD = 15  # digits more in the arithmetic
SETTLED = 1e-35  # of the orbit: a Newton step that is none any more
TAIL = 1e-22  # of the orbit: harmonics in the last quarter, when there are enough
LARGEST = 3_000_000  # sites times harmonics squared
ITERATIONS = 40
PHASES = 9  # of a quarter of the period, at which profiles are compared

_exactly = np.frompyfunc(Decimal, 1, 1)


class NotSolvedError(ArithmeticError):
    """No orbit to 50 digits was found."""


@contextmanager
def many_digits() -> Iterator[None]:
    """Decimal arithmetic with 50 digits and some more, and with the widest exponents."""
    wide = decimal.Context(prec=DIGITS + GUARD, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN)
    with decimal.localcontext(wide):
        yield


def exactly(values: object) -> Exact:
    """Floats, whole numbers or decimals as an array of decimals, digit by digit."""
    given = np.asarray(values)
    return np.asarray(_exactly(given if given.dtype == object else given.astype(float).astype(object)), dtype=object)


# Constants ----------------------------------------------------------------------------------------------------------


def agm(a: Decimal, b: Decimal) -> Decimal:
    """Arithmetic-geometric mean of two positive numbers."""
    while abs(a - b) > a.scaleb(-DIGITS - 5):
        a, b = (a + b) / 2, (a * b).sqrt()
    return a


@cache
def pi() -> Decimal:
    """Pi, by Gauss and Legendre's iteration."""
    with many_digits():
        a, b, t, p = Decimal(1), Decimal("0.5").sqrt(), Decimal("0.25"), 1
        while abs(a - b) > Decimal(10) ** (-DIGITS - 10):
            mean = (a + b) / 2
            a, b, t, p = mean, (a * b).sqrt(), t - p * (a - mean) ** 2, 2 * p
        return (a + b) ** 2 / (4 * t)


def cosine(angle: Decimal) -> Decimal:
    """Cosine of a small angle, by its series."""
    term = total = Decimal(1)
    k = 0
    while abs(term) > Decimal(10) ** (-DIGITS - GUARD):
        k += 2
        term *= -(angle**2) / (k * (k - 1))
        total += term
    return total


@cache
def _cosines(harmonics: int) -> Exact:
    """Symmetric matrix of cos((2k+1) theta_i); its square is H/2 times the identity."""
    with many_digits():
        c = [Decimal(1), cosine(pi() / (4 * harmonics))]
        for _ in range(8 * harmonics - 2):
            c.append(2 * c[1] * c[-1] - c[-2])
        odd = 2 * np.arange(harmonics) + 1
        return np.asarray(np.array(c, dtype=object)[np.outer(odd, odd) % (8 * harmonics)])


def exact_linear_frequency(chain: Chain, mode: int) -> Decimal:
    """Frequency of a linear mode to 50 digits."""
    with many_digits():
        gamma = Decimal(chain.gamma)
        coupling = ((1 - gamma) * (1 + gamma)).sqrt()
        whole = 2 * _cosine_of(mode, chain.sites + 1)
        return (2 + Decimal(chain.alpha) - coupling * whole).sqrt()


def _cosine_of(part: int, whole: int) -> Decimal:
    """cos(pi part/whole), 0 <= part <= whole."""
    if 2 * part > whole:
        return -_cosine_of(whole - part, whole)
    return cosine(pi() * part / whole)


def exact_duffing(omega_squared: Decimal, g: float, S: float) -> Decimal:
    """Frequency of one site with y(0)^2 = S: sqrt(k) agm(1, sqrt(1 - m)), k = omega^2 + g S, m = g S/(2 k).

    DLMF 19.8.5.
    """
    with many_digits():
        cubic = Decimal(g) * Decimal(S)
        stiffness = omega_squared + cubic
        return stiffness.sqrt() * agm(Decimal(1), (1 - cubic / (2 * stiffness)).sqrt())


# Orbits -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ExactOrbit:
    """y_n(t) = sum_k c_nk cos((2k+1) Omega t) to many digits; `left_out` is the relative tail of c."""

    coefficients: Exact
    Omega: Decimal
    left_out: float

    def displacements(self, theta: Array) -> Array:
        """y_n at phases, shape (phases, sites), rounded to double precision."""
        c = np.asarray(self.coefficients, dtype=float)
        return np.asarray(np.cos(np.outer(theta, 2 * np.arange(c.shape[1]) + 1)) @ c.T)

    def Omega_error(self, Omega: float) -> float:
        """Relative error of a frequency."""
        with many_digits():
            return float(abs(Decimal(Omega) - self.Omega) / self.Omega)

    def profile_error(self, orbit: Orbit) -> float:
        """Largest difference of displacements over sites and phases, relative to the largest displacement."""
        theta = np.linspace(0.0, 0.5 * np.pi, PHASES)
        exact, found = self.displacements(theta), orbit.evaluate(theta / orbit.Omega)
        return float(np.max(np.abs(found - exact)) / np.max(np.abs(exact)))


class _Equations:
    """Residual in decimals and Newton matrix in double, for scaled unknowns q_n = y_n/(rho_n sqrt(S)) at H nodes.

    The scales rho_n may be anything: they are the gauge's, so that unknowns are of one size.
    """

    def __init__(self, chain: Chain, S: float, harmonics: int) -> None:
        self.chain, self.S, self.H = chain, S, harmonics
        gamma, away = Decimal(chain.gamma), Decimal(abs(chain.gamma))
        distance = np.arange(chain.sites)
        step = ((1 - away) / (1 + away)).sqrt()
        powers = np.array([step**n for n in range(chain.sites)], dtype=object)
        self.scale = Decimal(S).sqrt() * powers[distance[::-1] if chain.gamma >= 0 else distance]
        self.left, self.right = 1 + gamma, 1 - gamma
        self.V = _cosines(harmonics)
        self.squares = exactly((2 * np.arange(harmonics) + 1) ** 2)

    def residual(self, c: Exact, Omega: Decimal) -> tuple[Exact, Decimal]:
        """Of y'' = (1+gamma) y_{n-1} - (2+alpha) y_n + (1-gamma) y_{n+1} - g y_n^3, scaled, and of sum y_n(0)^2 = S."""
        y = self.scale[:, None] * (c @ self.V)
        force = -(2 + Decimal(self.chain.alpha)) * y - Decimal(self.chain.g) * y**3
        force[1:] += self.left * y[:-1]
        force[:-1] += self.right * y[1:]
        start = self.scale * c.sum(axis=1)
        norm = (start @ start) / Decimal(self.S) - 1
        return -(Omega**2) * ((c * self.squares) @ self.V) - force / self.scale[:, None], norm

    def factor(self, c: Array, Omega: float) -> Any:
        """LU factors of the Newton matrix for node values and Omega."""
        from scipy import sparse as scipy_sparse
        from scipy.sparse.linalg import splu

        sparse: Any = scipy_sparse  # whose stubs refuse much of its documented use
        V, n = np.asarray(self.V, dtype=float), self.chain.sites
        second = -(2.0 / self.H) * (V * np.asarray(self.squares, dtype=float)) @ V
        q, w = c @ V, np.asarray(self.scale**2, dtype=float)
        s = float(np.sqrt((1 - self.chain.gamma) * (1 + self.chain.gamma)))
        beside = np.full(n - 1, -s)
        lattice = sparse.diags_array([beside, np.full(n, 2.0 + self.chain.alpha), beside], offsets=[-1, 0, 1])
        stiffness = sparse.diags_array([(3.0 * self.chain.g * w[:, None] * q**2).ravel()], offsets=[0])
        J = sparse.kron(sparse.eye_array(n), Omega**2 * second) + sparse.kron(lattice, sparse.eye_array(self.H))
        start = (w / self.S) * c.sum(axis=1)
        at_zero = (2.0 / self.H) * V.sum(axis=1)
        column = sparse.csc_array((2.0 * Omega * (q @ second.T)).reshape(-1, 1))
        row = sparse.csc_array((2.0 * np.outer(start, at_zero)).reshape(1, -1))
        return splu(sparse.csc_array(sparse.block_array([[J + stiffness, column], [row, None]])))


def _solved(equations: _Equations, c: Exact, Omega: Decimal) -> tuple[Exact, Decimal]:
    before, factors, back = np.inf, None, exactly(np.full(1, 2.0))[0] / equations.H
    for _ in range(ITERATIONS):
        residual, norm = equations.residual(c, Omega)
        if factors is None or before > 1e-3:
            factors = equations.factor(np.asarray(c, dtype=float), float(Omega))
        right = np.append(residual.ravel(), exactly([norm]))
        size = max(abs(value) for value in right)
        if size == 0:
            return c, Omega
        step = exactly(factors.solve(np.asarray(right / size, dtype=float))) * size
        c = c - (step[:-1].reshape(c.shape) @ equations.V) * back
        Omega = Omega - step[-1]
        largest = max(abs(value) for value in c.ravel())
        moved = float(max(*(abs(value) / largest for value in step[:-1]), abs(step[-1])))
        if not np.isfinite(moved) or Omega <= 0:
            break
        if moved <= SETTLED:
            return c, Omega
        before = moved
    raise NotSolvedError(f"Newton's method with 50 digits stops at a step of {before:.1e}")


def exact_orbit(orbit: Orbit) -> ExactOrbit:
    """The orbit that Newton's method finds from `orbit` at its S; |gamma| < 1. Raises NotSolvedError."""
    chain, S, harmonics = orbit.model, orbit.S, max(12, orbit.harmonics)
    with many_digits():
        equations = _Equations(chain, S, harmonics)
        c = exactly(orbit.coefficients(harmonics).T) / equations.scale[:, None]
        Omega = Decimal(orbit.Omega)
        while True:
            c, Omega = _solved(equations, c, Omega)
            last = np.max(np.abs(np.asarray(c[:, -(harmonics // 4) :], dtype=float)))
            tail = float(last / np.max(np.abs(np.asarray(c, dtype=float))))
            if tail <= TAIL or chain.sites * (2 * harmonics) ** 2 > LARGEST:
                return ExactOrbit(equations.scale[:, None] * c, Omega, tail)
            more = harmonics // 2
            c = np.concatenate([c, exactly(np.zeros((chain.sites, more)))], axis=1)
            harmonics += more
            equations = _Equations(chain, S, harmonics)
