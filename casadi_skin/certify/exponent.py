"""One Floquet exponent and its vector, enclosed by the theorem of the orbits: off the real axis there is no stability.

Unknowns x = (sigma, w) complex, F = (c w - 1, lambda (sigma + m)^2 w_m + sum over p of G_p w_(m-p)), m a multiple of
the step, in the norm |sigma| + sum of |w_nm|. The operator A is an approximate inverse of the finite part |m| <= M, and
beyond it 1/(lambda (sigma + m)^2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from casadi_skin.certify.balls import ROUNDING, above, below, rounded_up
from casadi_skin.certify.bounds import proved_radius
from casadi_skin.certify.certificate import Constants
from casadi_skin.certify.eigenpair import Eigenpair
from casadi_skin.certify.linearised import Linearised
from casadi_skin.stability.reduction import ComplexArray
from casadi_skin.zero.problem import Array

if TYPE_CHECKING:
    from flint import acb

LARGEST = 2500  # rows of the finite part
FIRST = 8
GROWTH = 1.5
STEPS = 8
REACH = 0.1  # largest radius that W is a bound for; 1 is the norm of w in the Euclidean sense


def enclosed_exponent(problem: Linearised, sigma: complex) -> tuple[complex, float] | None:
    """An exponent near `sigma` with a proved radius; None where no finite part of up to LARGEST rows proves one."""
    highest, last = FIRST, Constants(np.inf, np.inf, np.inf, REACH)
    while problem.harmonics(highest).size * problem.positions <= LARGEST:
        pair = _Pair.near(problem, sigma, highest)
        if pair is not None:
            constants = pair.constants()
            radius = proved_radius(constants)
            if radius is not None:
                return pair.sigma, above(pair.exact.rounding(pair.sigma) + radius)
            small = constants.Z < 0.5
            if (0.5 * last.Y < constants.Y) if small else (0.8 * last.Z < constants.Z):
                return None  # it is rounding, or another exponent is too near
            last = constants if small else replace(constants, Y=np.inf)
        highest = problem.grown(highest, GROWTH)
    return None


@dataclass(frozen=True, eq=False)
class _Pair:
    """An approximate eigenpair with |m| <= highest, and the bounds of the theorem about it."""

    problem: Linearised
    highest: int
    exact: Eigenpair
    sigma: complex  # the double nearest
    w: ComplexArray  # doubles nearest, shape (harmonics, positions)
    inverse: ComplexArray

    @classmethod
    def near(cls, problem: Linearised, sigma: complex, highest: int) -> _Pair | None:
        """Newton's method from the null vector of the finite part; None where its matrices are singular."""
        G, square = _toeplitz(problem, highest, highest), float(problem.square.mid())
        m = problem.harmonics(highest)
        try:
            L = G + np.diag(np.repeat(square * (sigma + m) ** 2, problem.positions))
            w = np.asarray(np.linalg.svd(L)[2][-1].conj(), dtype=complex)
            for _ in range(STEPS):
                J, residual = _bordered(G, square, sigma, w, m, w.conj())
                step = np.linalg.solve(J, residual)
                sigma, w = complex(sigma - step[0]), w - step[1:]
                if np.sum(np.abs(step)) < 1e-15:
                    break
            inverse = np.linalg.inv(_bordered(G, square, sigma, w, m, w.conj())[0])
        except np.linalg.LinAlgError:
            return None
        if not (np.isfinite(sigma) and np.all(np.isfinite(inverse))):
            return None
        exact = Eigenpair.refined(problem, sigma, w.reshape(-1, problem.positions), np.asarray(inverse, dtype=complex))
        return cls(problem, highest, exact, *exact.doubles(), np.asarray(inverse, dtype=complex))

    @cached_property
    def shifts(self) -> ComplexArray:
        """sigma + m for each finite unknown of w."""
        return np.repeat(self.sigma + self.problem.harmonics(self.highest), self.problem.positions)

    @cached_property
    def norms(self) -> Array:
        """Upper bounds of the norms of the columns of the inverse."""
        return rounded_up(np.abs(self.inverse).sum(axis=0), len(self.inverse))

    @cached_property
    def tail(self) -> float:
        """Upper bound of 1/|lambda (sigma + m)^2| beyond the finite part."""
        nearest = self.highest + self.problem.step - abs(self.sigma)
        return float("inf") if nearest <= 0 else (1.0 + 16 * ROUNDING) / (below(self.problem.square) * nearest**2)

    @cached_property
    def size(self) -> float:
        """Upper bound of |A| on residuals but the first."""
        return max(float(np.max(self.norms[1:])), self.tail)

    def _image(self, rows: slice, block: Array | ComplexArray, radius: Array) -> Array:
        """Norms of the columns of A's finite part times a block given by its rows, in modulus within `radius`."""
        count = 2 * block.shape[0] + 4
        product = self.inverse[:, rows] @ block
        lost = self.norms[rows] @ (count * ROUNDING * np.abs(block) + radius)
        return rounded_up(np.abs(product).sum(axis=0) + rounded_up(lost, count), len(self.inverse))

    def finite_part(self, G: Array, square: float) -> tuple[ComplexArray, Array]:
        """The finite part of DF in doubles, and bounds of its rounding."""
        w = self.w.ravel()
        J, _ = _bordered(G, square, self.sigma, w, self.problem.harmonics(self.highest), w.conj())
        unsure = 16 * ROUNDING * np.abs(J)
        places = np.arange(1, len(J))  # of sums of G_0 and of what may be much larger than they are
        unsure[places, places] += 32 * ROUNDING * square * np.abs(self.shifts**2)
        return J, unsure

    def constants(self) -> Constants:
        """The three bounds about the true linearised equations."""
        if not np.isfinite(self.tail):
            return Constants(np.inf, np.inf, np.inf, REACH)
        return Constants(self._Y(), self._Z(), self._W(), REACH)

    def _Y(self) -> float:
        """Upper bound of |A F|."""
        problem, n, total = self.problem, self.problem.positions, len(self.inverse)
        finite, outside = self.exact.residual(problem, self.w.conj())
        middle = np.array([complex(value.mid()) for value in finite])
        radius = np.array([above(abs(value - m)) for value, m in zip(finite, _balls(middle), strict=True)])
        image = self._image(slice(None), middle[:, None], radius[:, None])[0]
        beyond = sum(above(abs(value)) for value in outside)
        length = float(rounded_up(np.abs(self.w).sum(), self.w.size + 4))
        return float(rounded_up(np.asarray(image + self.tail * beyond + self.size * problem.moved * length), total + n))

    @cached_property
    def _doubt(self) -> float:
        """Upper bound of the distance of lambda from the double in its middle."""
        from flint import arb

        return above(abs(self.problem.square - arb(float(self.problem.square.mid()))))

    def _Z(self) -> float:
        """Upper bound of |I - A DF|."""
        problem, n, w = self.problem, self.problem.positions, self.w.ravel()
        square = float(problem.square.mid())
        reach = problem.step * (len(problem.blocks) - 1)
        G = _toeplitz(problem, self.highest, self.highest)
        J, unsure = self.finite_part(G, square)
        identity = np.eye(len(J))
        product = self.inverse @ J
        count = 2 * len(J) + 4
        lost = self.norms @ (count * ROUNDING * np.abs(J) + unsure)
        inside = rounded_up(np.abs(identity - product).sum(axis=0) + rounded_up(lost, count), len(J))
        outer = _toeplitz(problem, self.highest, self.highest + reach)
        edge = reach // problem.step * n
        outer = np.delete(outer, np.arange(edge, outer.shape[1] - edge), axis=1)
        across = self._image(slice(1, None), outer, np.zeros(outer.shape)) if outer.size else np.zeros(1)
        sizes = problem.sizes
        rows = self.tail * float(rounded_up(sizes[0] + 2.0 * sizes[1:].sum(), sizes.size))
        squares = max(float(np.max(self.norms[1:] * np.abs(self.shifts) ** 2)), 1.0 / below(problem.square))
        along = self.size * float(rounded_up(2.0 * np.abs(self.shifts * w).sum(), w.size))
        moved = problem.radius * self.size + self._doubt * max(squares, along)
        return float(rounded_up(np.asarray(max(np.max(inside), np.max(across)) + rows + moved), 32))

    def _W(self) -> float:
        """Lipschitz constant of A DF within REACH."""
        length = float(rounded_up(np.abs(self.w).sum(), self.w.size))
        beyond = np.sqrt(self.tail / below(self.problem.square)) * (1.0 + 8 * ROUNDING)
        linear = max(float(np.max(self.norms[1:] * np.abs(self.shifts))), float(beyond))
        total = above(self.problem.square) * (2.0 * linear + self.size * (REACH + 2.0 * (length + REACH)))
        return float(rounded_up(np.asarray(total), 32))


def _balls(values: ComplexArray) -> list[acb]:
    from flint import acb

    return [acb(value.real, value.imag) for value in values.ravel().tolist()]


def _toeplitz(problem: Linearised, highest_row: int, highest_column: int) -> Array:
    """The blocks G_(m - j) for |m| and |j| up to two numbers."""
    blocks, n = problem.blocks, problem.positions
    rows, columns = problem.harmonics(highest_row), problem.harmonics(highest_column)
    distance = np.abs(rows[:, None] - columns).astype(int) // problem.step
    padded = np.concatenate([blocks, np.zeros((1, n, n))])
    matrix = padded[np.minimum(distance, len(blocks))]
    return np.asarray(matrix.transpose(0, 2, 1, 3).reshape(rows.size * n, columns.size * n))


def _bordered(
    G: Array, square: float, sigma: complex, w: ComplexArray, harmonics: Array, c: ComplexArray
) -> tuple[ComplexArray, ComplexArray]:
    """The finite part of DF and of F at (sigma, w)."""
    shifts = np.repeat(sigma + harmonics, w.size // harmonics.size)
    J = np.zeros((w.size + 1, w.size + 1), dtype=complex)
    J[0, 1:], J[1:, 0] = c, 2.0 * square * shifts * w
    J[1:, 1:] = G + np.diag(square * shifts**2)
    return J, np.concatenate([[c @ w - 1.0], J[1:, 1:] @ w])
