"""The stability of one orbit as numbers: mu with its errors, the multipliers that follow, and what kind they are."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from casadi_skin.bvp.problem import Array
from casadi_skin.stability.reduction import ComplexArray

DIRECTIONS = np.exp(0.25j * np.pi * np.arange(8))  # in which a mu off the real axis may be wrong


@dataclass(frozen=True)
class Floquet:
    """Linear stability of one orbit with n positions: n - 1 values of mu beside the trivial one.

    `mu` and `mu_error`, its estimated errors, have shape (n - 1,); `trivial_deviation` is how far the trivial
    eigenvalue is from its exact value. `power` of lambda(M) gives the multipliers over the period.
    """

    mu: ComplexArray
    mu_error: Array
    trivial_deviation: float
    power: int

    @cached_property
    def is_real(self) -> NDArray[np.bool_]:
        """Which mu are real within their estimated errors."""
        return np.abs(self.mu.imag) <= self.mu_error

    @cached_property
    def is_inside(self) -> NDArray[np.bool_]:
        """Which mu are real and in [-1, 0] within their estimated errors."""
        inside = (self.mu.real >= -1.0 - self.mu_error) & (self.mu.real <= self.mu_error)
        return self.is_real & inside

    @property
    def stable(self) -> bool:
        """Whether every mu lies in [-1, 0] within its estimated error."""
        return bool(np.all(self.is_inside))

    @property
    def unstable_real(self) -> int:
        """Number of multipliers outside the unit circle on the real axis."""
        return int(np.count_nonzero(self.is_real & ~self.is_inside))

    @property
    def unstable_complex(self) -> int:
        """Number of multipliers outside the unit circle off the real axis; a complex pair counts two."""
        return int(np.count_nonzero(~self.is_real))

    @cached_property
    def root(self) -> ComplexArray:
        """sqrt(mu) + sqrt(1 + mu) with modulus >= 1, whose square is lambda(M); on the unit circle for a stable mu."""
        stable = np.where(self.is_inside, np.clip(self.mu.real, -1.0, 0.0), 0.0)
        on_circle = np.sqrt(1.0 + stable) + 1j * np.sqrt(-stable)
        mu = np.where(self.is_real, self.mu.real + 0j, self.mu)
        off_circle = np.sqrt(mu) + np.sqrt(1.0 + mu)
        off_circle = np.where(np.abs(off_circle) < 1.0, 1.0 / off_circle, off_circle)
        return np.where(self.is_inside, on_circle, off_circle)

    @cached_property
    def multipliers(self) -> ComplexArray:
        """All 2n multipliers over the period, shape (2n,): the trivial pair, exactly 1, then each lambda, 1/lambda."""
        outer = self.root ** (2 * self.power)
        return np.concatenate([np.ones(2, complex), np.stack([outer, 1.0 / outer], axis=1).ravel()])

    @property
    def max_abs_multiplier(self) -> float:
        """Largest modulus of a multiplier, the trivial pair left out; exactly 1 for a stable orbit."""
        return float(np.max(np.abs(self.root[~self.is_inside]) ** (2 * self.power), initial=1.0))

    @cached_property
    def error(self) -> float:
        """Estimated absolute error: the largest of any mu and, for an unstable orbit, of `max_abs_multiplier`.

        The latter from the multipliers at mu changed by its error: near the circle they go with the root of mu.
        """
        largest = float(np.max(self.mu_error, initial=0.0))
        if self.stable:
            return largest
        outside = ~self.is_inside
        real = self.is_real[outside]
        mu = np.where(real, self.mu.real[outside], self.mu[outside])
        directions = np.where(real, np.sign(DIRECTIONS.real)[:, None], DIRECTIONS[:, None])
        moduli = _modulus(mu + self.mu_error[outside] * directions) ** (2 * self.power)
        with np.errstate(invalid="ignore"):
            above = np.max(moduli) - self.max_abs_multiplier
            below = self.max_abs_multiplier - np.max(np.min(moduli, axis=0))
        return max(largest, float(above), float(below))


def _modulus(mu: ComplexArray) -> Array:
    """|sqrt(mu) + sqrt(1 + mu)| or its inverse, whichever is not below 1."""
    root = np.abs(np.sqrt(mu + 0j) + np.sqrt(1.0 + mu + 0j))
    return np.asarray(np.maximum(root, 1.0 / root))
