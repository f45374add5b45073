"""A point of a branch with the quantities whose zeros are events: eigenvalues, or logarithms of multipliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from casadi_skin.zero.problem import Array, Indices
from casadi_skin.zero.settings import Point

ComplexArray = NDArray[np.complex128]
APART = 1e6  # distance of values of different groups


@dataclass(frozen=True, eq=False)
class Sample:
    """A point with its eigenvalues, their rates and the second derivative of z along the branch.

    Attributes:
        point: the point.
        row: the metric times the tangent, which closes the equations there.
        values: eigenvalues of dF/dy, shape (n,).
        rates: their rates along the unit tangent.
        noise: rounding errors of the eigenvalues.
        bend: the second derivative of z by the length along the branch.
        orientation: the sign of the determinant of the Jacobian closed by `row`.
        leading: values and rates of other quantities that matter, in place of the rate of the parameter.
        turn: period of the imaginary parts: 2 pi of logarithms of multipliers, infinite of eigenvalues.
        groups: a number for each value where only values of one group may be the same elsewhere; None where all may.
        blurred: whether rounding decides the sign of the rate of the parameter, as at a branch point itself.
    """

    point: Point
    row: Array
    values: ComplexArray
    rates: ComplexArray
    noise: Array
    bend: Array
    orientation: float
    leading: tuple[tuple[float, float], ...] | None = None
    turn: float = np.inf
    groups: Indices | None = None
    blurred: bool = False

    @property
    def symmetric(self) -> bool:
        """Whether with each eigenvalue its opposite is one, as where an energy is conserved, declared or not."""
        apart = np.min(np.abs(self.values[:, None] + self.values), axis=1)
        return bool(np.all(apart <= self.noise) and np.any(self.values))

    def apart(self, values: ComplexArray, others: ComplexArray) -> Array:
        """Distances of values from others, shape (values, others)."""
        difference = values[:, None] - others
        if np.isfinite(self.turn):
            difference -= 1j * self.turn * np.round(difference.imag / self.turn)
        if self.groups is not None and difference.shape == (self.groups.size, self.groups.size):
            difference = np.where(self.groups[:, None] == self.groups, difference, APART)
        return np.abs(difference)

    def along(self, row: Array) -> tuple[float, float, float]:
        """By sigma = row . z: that of the length along the branch, and two derivatives of the parameter."""
        rate, bend = float(row @ self.point.tangent), float(row @ self.bend)
        t, b = self.point.tangent[-1], self.bend[-1]
        return 1.0 / rate, float(t / rate), float((b * rate - t * bend) / rate**3)
