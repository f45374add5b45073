"""Orbits to more digits than doubles have, from the equations of motion in physical coordinates alone.

An orbit is a sum of odd cosines; its residual at the Fourier nodes is computed with all digits, and the Newton steps
need their matrix in double precision only (iterative refinement: Higham 2002, chapter 12). Numbers are long doubles, or
decimals of 50 digits, whose exponents are so large that r^N neither overflows nor underflows.
"""

from __future__ import annotations

import decimal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain

Array = NDArray[np.float64]
Exact = NDArray[Any]  # of long doubles or of decimals

DIGITS, GUARD = 50, 15  # of decimals, and digits more in their arithmetic
PI = Decimal("3.1415926535897932384626433832795028841971693993751058209749445923078164062862")
ITERATIONS = 40
FEWEST_HARMONICS = 12
TOO_FEW = 1e-3  # of the orbit in its last quarter of harmonics: Newton's method begins anew with more of them


class NotSolvedError(ArithmeticError):
    """No exact orbit was found."""


@contextmanager
def many_digits() -> Iterator[None]:
    """Decimal arithmetic with 50 digits and some more, and with the widest exponents."""
    wide = decimal.Context(prec=DIGITS + GUARD, Emax=decimal.MAX_EMAX, Emin=decimal.MIN_EMIN)
    with decimal.localcontext(wide):
        yield


def cosine(angle: Decimal) -> Decimal:
    """Cosine of an angle up to pi, by its series."""
    term = total = Decimal(1)
    k = 0
    while abs(term) > Decimal(10) ** (-DIGITS - GUARD):
        k += 2
        term *= -(angle**2) / (k * (k - 1))
        total += term
    return total


def exact_linear_frequency(chain: Chain, mode: int) -> Decimal:
    """Frequency of a linear mode to 50 digits."""
    with many_digits():
        gamma = Decimal(chain.gamma)
        coupling = ((1 - gamma) * (1 + gamma)).sqrt()
        return (2 + Decimal(chain.alpha) - 2 * coupling * cosine(PI * mode / (chain.sites + 1))).sqrt()


# Numbers ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Numbers:
    """A kind of numbers, and the operations on orbits in it.

    `convert` makes an array of floats one of these numbers, digit by digit; `cosines` gives the table cos(pi k/(4 H)),
    k = 0 .. 8 H - 1. A Newton step shorter than `converged`, relative to the orbit, is the last. There are harmonics
    enough where the last quarter of them is below `tail`, and no more where sites (2 H)^2 exceeds `largest`.
    """

    convert: Callable[[ArrayLike], Exact]
    cosines: Callable[[int], Exact]
    converged: float
    tail: float
    largest: int

    def matrix(self, harmonics: int) -> Exact:
        """Symmetric matrix of cos((2k+1) theta_i); its square is H/2 times the identity."""
        odd = 2 * np.arange(harmonics) + 1
        return np.asarray(self.cosines(harmonics)[np.outer(odd, odd) % (8 * harmonics)])


def _binary(kind: type[np.floating[Any]], *limits: Any) -> Numbers:
    def cosines(harmonics: int) -> Exact:
        return np.asarray(np.cos(np.arccos(np.longdouble(-1)) / (4 * harmonics) * np.arange(8 * harmonics)), kind)

    return Numbers(lambda values: np.asarray(values, kind), cosines, *limits)


def _decimals(values: ArrayLike) -> Exact:
    given = np.asarray(values)
    plain = given if given.dtype == object else given.astype(float).astype(object)
    return np.asarray(np.frompyfunc(Decimal, 1, 1)(plain), dtype=object)


@cache
def _decimal_cosines(harmonics: int) -> Exact:
    c = [Decimal(1), cosine(PI / (4 * harmonics))]
    for _ in range(8 * harmonics - 2):
        c.append(2 * c[1] * c[-1] - c[-2])
    return np.array(c, dtype=object)


DOUBLES = _binary(np.float64, 1e-12, 1e-16, 8_000_000)
LONG_DOUBLES = _binary(np.longdouble, 1e-17, 1e-17, 8_000_000)
DECIMALS = Numbers(_decimals, _decimal_cosines, 1e-35, 1e-22, 3_000_000)


# Orbits -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ExactOrbit:
    """y_n(t) = scale_n sum_k c_nk cos((2k+1) Omega t); `left_out` is the relative size of the last harmonics.

    `scaled` holds c, shape (sites, harmonics), and `scale` sqrt(S) rho_n with the factors rho_n of the gauge. `sites`
    are the numbers of the sites in the chain of the orbit where these are not all.
    """

    chain: Chain
    sites: list[int] | None
    scaled: Exact
    scale: Exact
    Omega: Any
    left_out: float

    @property
    def coefficients(self) -> Exact:
        """Coefficients of the displacements, shape (sites, harmonics)."""
        return np.asarray(self.scale[:, None] * self.scaled)

    def Omega_error(self, Omega: float) -> float:
        """Absolute error of a frequency."""
        with many_digits():
            return float(abs(type(self.Omega)(Omega) - self.Omega))

    def profile_error(self, orbit: Orbit, phases: int = 9) -> float:
        """Largest difference of displacements over sites and phases of a quarter period, relative to the largest."""
        theta = np.linspace(0.0, 0.5 * np.pi, phases)
        c = np.asarray(self.coefficients, dtype=np.longdouble)
        exact = np.cos(np.outer(theta.astype(np.longdouble), 2 * np.arange(c.shape[1]) + 1)) @ c.T
        found = orbit.evaluate(theta / orbit.Omega, self.sites)
        return float(np.max(np.abs(found - exact)) / np.max(np.abs(exact)))


class CosineEquations:
    """The equations of motion at H Fourier nodes, for coefficients of scaled unknowns q_n = y_n/scale_n, and S.

    The residual is in exact numbers, the Newton matrix in double precision.
    """

    def __init__(self, chain: Chain, S: float, scale: Exact, harmonics: int, numbers: Numbers) -> None:
        self.chain, self.scale, self.H, self.numbers = chain, scale, harmonics, numbers
        self.S, self.alpha, self.gamma, self.g = numbers.convert((S, chain.alpha, chain.gamma, chain.g))
        self.V, self.squares = numbers.matrix(harmonics), numbers.convert((2 * np.arange(harmonics) + 1) ** 2)

    def residual(self, c: Exact, Omega: Any) -> Exact:
        """Of y'' = (1+gamma) y_{n-1} - (2+alpha) y_n + (1-gamma) y_{n+1} - g y_n^3, scaled, and of sum y_n(0)^2 = S."""
        y = self.scale[:, None] * (c @ self.V)
        force = -(2 + self.alpha) * y - self.g * y**3
        force[1:] += (1 + self.gamma) * y[:-1]
        force[:-1] += (1 - self.gamma) * y[1:]
        start = self.scale * c.sum(axis=1)
        rest = -(Omega**2) * ((c * self.squares) @ self.V) - force / self.scale[:, None]
        return np.append(rest.ravel(), (start @ start) / self.S - 1)

    def factor(self, c: Array, Omega: float) -> Any:
        """LU factors of the Newton matrix for node values and Omega."""
        from scipy import sparse as scipy_sparse
        from scipy.sparse.linalg import splu

        sparse: Any = scipy_sparse  # whose stubs refuse much of its documented use
        V, n, H = np.asarray(self.V, dtype=float), self.chain.sites, self.H
        second = -(2.0 / H) * (V * np.asarray(self.squares, dtype=float)) @ V
        q, w = c @ V, np.asarray(self.scale**2, dtype=float)
        ratio = np.asarray(self.scale[:-1] / self.scale[1:], dtype=float)
        beside = (
            -(1.0 + self.chain.gamma) * ratio,
            np.full(n, 2.0 + self.chain.alpha),
            (self.chain.gamma - 1.0) / ratio,
        )
        lattice = sparse.diags_array(beside, offsets=[-1, 0, 1])
        stiffness = sparse.diags_array([(3.0 * self.chain.g * w[:, None] * q**2).ravel()], offsets=[0])
        J = sparse.kron(sparse.eye_array(n), Omega**2 * second) + sparse.kron(lattice, sparse.eye_array(H)) + stiffness
        start = (w / float(self.S)) * c.sum(axis=1)
        column = sparse.csc_array((2.0 * Omega * (q @ second.T)).reshape(-1, 1))
        row = sparse.csc_array((2.0 * np.outer(start, (2.0 / H) * V.sum(axis=1))).reshape(1, -1))
        return splu(sparse.csc_array(sparse.block_array([[J, column], [row, None]])))

    def solve(self, c: Exact, Omega: Any) -> tuple[Exact, Any]:
        """Coefficients, shape (sites, H), and frequency by Newton's method from a guess; raises NotSolvedError."""
        before, factors = np.inf, None
        for _ in range(ITERATIONS):
            right = self.residual(c, Omega)
            if factors is None or before > 1e-3:
                factors = self.factor(np.asarray(c, dtype=float), float(Omega))
            size = np.max(np.abs(right))
            if size == 0:
                return c, Omega
            step = self.numbers.convert(factors.solve(np.asarray(right / size, dtype=float))) * size
            c = c - (step[:-1].reshape(c.shape) @ self.V) * 2 / self.H
            Omega = Omega - step[-1]
            moved = float(max(np.max(np.abs(step[:-1])) / np.max(np.abs(c)), abs(step[-1])))
            if not np.isfinite(moved) or Omega <= 0:
                break
            if moved <= self.numbers.converged or (before < 1e-14 and moved > 0.5 * before):  # rounding is left
                return c, Omega
            before = moved
        raise NotSolvedError(f"Newton's method for the exact orbit stops at a step of {before:.1e}")


def _as_it_is(orbit: Orbit, numbers: Numbers, harmonics: int) -> ExactOrbit:
    """An orbit of a finite chain with its own errors, scaled by the gauge so that all coefficients are of one size."""
    chain, sites = orbit.model, None
    if abs(chain.gamma) == 1.0:
        chain, sites = replace(chain, sites=1, gamma=0.0), [chain.sites if chain.gamma > 0 else 1]
    S, away = numbers.convert((orbit.S, abs(chain.gamma)))
    step = np.sqrt((1 - away) / (1 + away))
    rho = np.array([step**n for n in range(chain.sites)])
    scale = np.sqrt(S) * (rho[::-1] if chain.gamma >= 0 else rho)
    c = numbers.convert(orbit.coefficients(harmonics, sites).T) / scale[:, None]
    return ExactOrbit(chain, sites, c, scale, numbers.convert(orbit.Omega)[()], np.inf)


def exact_orbit(orbit: Orbit, numbers: Numbers = DECIMALS) -> ExactOrbit:
    """The exact orbit at the S of an orbit of a finite chain, by Newton's method from it.

    Where |gamma| = 1 it is that of the edge site, which alone moves.

    Raises:
        NotSolvedError: Newton's method does not converge.
    """
    harmonics, found = max(FEWEST_HARMONICS, orbit.harmonics), None
    with many_digits():
        while True:
            exact = _as_it_is(orbit, numbers, harmonics) if found is None else found
            chain, scale, c = exact.chain, exact.scale, exact.scaled
            more = numbers.convert(np.zeros((chain.sites, harmonics - c.shape[1])))
            equations = CosineEquations(chain, orbit.S, scale, harmonics, numbers)
            c, Omega = equations.solve(np.concatenate([c, more], axis=1), exact.Omega)
            size = np.abs(np.asarray(c, dtype=float))
            tail = float(np.max(size[:, -(harmonics // 4) :]) / np.max(size))
            found = replace(exact, scaled=c, Omega=Omega, left_out=tail)
            if tail <= numbers.tail or chain.sites * (2 * harmonics) ** 2 > numbers.largest:
                return found
            harmonics += harmonics // 2
            found = found if tail <= TOO_FEW else None
