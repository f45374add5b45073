"""Extended systems whose regular solutions are folds, Hopf points and branch points of equilibria.

Fold: F = 0, F_y v = 0, v W v = 1 (Moore and Spence 1980). Hopf point: F = 0, F_y v = w, F_y w + kappa v = 0, v W v = 1,
d v = 0, with kappa = omega^2 (Roose and Hlavacek 1985), which stays regular where kappa goes through zero. Branch
point: F + beta c = 0, psi F_y = 0, psi F_p = 0, c psi = 1 with beta = 0 (Griewank and Reddien 1984). W, c and d are
constants that measure null vectors by the units of the state where the system is started.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from casadi_skin.model.expressions import Expression
from casadi_skin.zero.problem import Array
from casadi_skin.zero.rest_problem import AlgebraicProblem, Course
from casadi_skin.zero.statics import ComplexArray, Linearised, NullSpace, Statics, upper_pair


class ExtendedSystem(AlgebraicProblem):
    """Base of extended systems: their unknowns start from an approximate point, which sets their constants."""

    def __init__(
        self, statics: Statics, sizes: Array, free: Sequence[Course], walking: Course | None = None, rate: float = 1.0
    ) -> None:
        super().__init__(statics, sizes, free, walking)
        n = statics.size
        self.rate = float(2.0 ** np.round(np.log2(rate)))  # of time: the scale of omega
        self.others, self.added = self.shape(n)
        self.states = n + self.others
        self.constants = np.zeros(self.constant_count(n))

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        """Unknowns beside the state, and added scalars."""
        raise NotImplementedError

    @staticmethod
    def constant_count(n: int) -> int:
        """Number of constants."""
        return n

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        """The system with its constants, and its unknowns, from dF/dy at an approximate point; u is 0.

        `near` selects the pair of eigenvalues, by default that nearest to the imaginary axis.
        """
        raise NotImplementedError

    def _units_near(self, y: Array, scalars: Array) -> Array:
        """Units of the state at an approximate point."""
        return self.units(
            np.concatenate([y, np.zeros(self.others), scalars, np.zeros(self.size - self.states - scalars.size)])
        )

    def units_beside(self, units: Array) -> Array:
        return np.tile(units, self.others // units.size)


class FoldSystem(ExtendedSystem):
    """Folds, with the null vector v of F_y."""

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        return n, 0

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        F = self.force(y, self.parameters_at(scalars))
        return ca.vertcat(F, ca.jtimes(F, y, others), ca.dot(others, c * others) - 1)

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        units = self._units_near(y, scalars)
        v = NullSpace.of_rates(matrix, units).right[:, -1]
        return self.with_constants(units**-2.0), np.concatenate([y, v, scalars, [0.0]])


class BranchSystem(ExtendedSystem):
    """Branch points, with the left null vector psi of (F_y, F_p) and the imperfection beta, which is zero."""

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        return n, 1

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        F, beta = self.force(y, self.parameters_at(scalars)), scalars[1]
        by_y, by_p = ca.jtimes(F, y, others, True), ca.dot(ca.jacobian(F, scalars)[:, 0], others)
        return ca.vertcat(F + beta * c, by_y, by_p, ca.dot(c, others) - 1)

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        units = self._units_near(y, scalars)
        psi = NullSpace.of_rates(matrix, units).left[:, -1]
        c = psi * units**2 / np.linalg.norm(psi * units)
        return self.with_constants(c), np.concatenate([y, psi / (c @ psi), scalars, [0.0, 0.0]])

    def units_beside(self, units: Array) -> Array:
        return np.asarray(1.0 / units)


class HopfSystem(ExtendedSystem):
    """Hopf points, with v and w = F_y v / rate in the critical plane, and kappa = (omega/rate)^2."""

    @staticmethod
    def shape(n: int) -> tuple[int, int]:
        return 2 * n, 1

    def _residual(self, y: Expression, others: Expression, scalars: Expression, c: Expression) -> Expression:
        n, rate, kappa = self.statics.size, self.rate, scalars[len(self.free)]
        F = self.force(y, self.parameters_at(scalars))
        v, w = others[:n], others[n:]
        turned, back = ca.jtimes(F, y, v) / rate - w, ca.jtimes(F, y, w) / rate + kappa * v
        return ca.vertcat(F, turned, back, ca.dot(v, c[n:] * v) - 1, ca.dot(c[:n], v))

    @staticmethod
    def constant_count(n: int) -> int:
        return 2 * n

    def started(
        self, matrix: Array, y: Array, scalars: Array, near: complex | None = None
    ) -> tuple[AlgebraicProblem, Array]:
        linear, units = Linearised(matrix), self._units_near(y, scalars)
        values = linear.eigensystem[0]
        k = upper_pair(values, near)
        v, d = plane(linear.vectors(k)[0] / units)
        v, constants = v * units, np.concatenate([d / units, units**-2.0])
        w = matrix @ v / self.rate
        kappa = (values[k].imag / self.rate) ** 2
        return self.with_constants(constants), np.concatenate([y, v, w, scalars, [kappa, 0.0]])

    def kappa(self, z: Array) -> float:
        """(omega/rate)^2 of a solution; negative where the eigenvalues are real with sum zero."""
        return float(z[self.states + len(self.free)])


def plane(q: ComplexArray) -> tuple[Array, Array]:
    """An orthonormal basis of the plane of the real and imaginary parts of a vector, which may be turned freely."""
    turned = q * np.exp(-0.5j * np.angle(np.sum(q * q)))  # real and imaginary parts are orthogonal now
    v = turned.real / np.linalg.norm(turned.real)
    size = np.linalg.norm(turned.imag)
    if size > 1e-12:
        return v, turned.imag / size
    d = np.zeros_like(v)
    d[np.argmin(np.abs(v))] = 1.0
    d -= v * (v @ d)
    return v, d / np.linalg.norm(d)
