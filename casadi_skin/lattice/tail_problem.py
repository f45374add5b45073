"""Odd cosines on the nonlinear core of a long lattice, whose linear tail is eliminated exactly."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from casadi_skin.lattice.tail_parameter import Regime, TailParameter, TailSeries, TailValues
from casadi_skin.model.ode import OdeModel
from casadi_skin.native import TAIL, Structure
from casadi_skin.zero.cosines import TrigonometricProblem, cosine_matrix
from casadi_skin.zero.problem import FREQUENCY_WEIGHT, Array, Indices, Problem, Scalar, SingularError, Solve
from casadi_skin.zero.recursion import PolynomialForm, TaylorRecursion


class CoreWithTailProblem(TrigonometricProblem):
    """Unknowns are the core's positions at the nodes, u in place of Omega, and the free parameter.

    The model is that of the core by itself; its site `attached` is next to the tail, and lacks the bond to it.
    Equations of that site are those of its harmonics, times cos(psi): regular where the tail resonates.
    """

    def __init__(self, model: OdeModel, harmonics: int, tail: TailParameter, attached: int = 0) -> None:
        super().__init__(model, harmonics)
        self.tail, self.attached = tail, attached
        if model.size > 1:
            self.half_bandwidth = (self.half_bandwidth or 0) + harmonics - 1

    def values(self, z: Array) -> TailValues:
        """The tail at z; raises ArithmeticError where a harmonic that should be bound is in the band."""
        return self.tail.values(float(z[self.Omega_index]))

    def frequency(self, z: Array) -> float:
        """Omega of z; NaN, as are the equations, where there is none."""
        try:
            return self.values(z).Omega
        except ArithmeticError:
            return float("nan")

    def frequency_step(self, z: Array, step: Array) -> float:
        return float(self.values(z).Omega_slope * step[self.Omega_index])

    def unknown_at(self, scalar: Scalar, value: float) -> float:
        return self.tail.of_frequency(value) if scalar is Scalar.OMEGA else value

    def regime(self, z: Array) -> Regime:
        """Regime of the tail at z."""
        return self.tail.regime(self.values(z))

    @cached_property
    def core(self) -> TrigonometricProblem:
        """The same core, without the bond to the tail."""
        return TrigonometricProblem(self.model, self.resolution)

    @cached_property
    def _places(self) -> tuple[tuple[Indices, Indices], Indices, Indices, Indices, Indices]:
        """Of dR/dz, in terms of that of the core by itself, of which the rows of the attached site are a dense block.

        Rows and columns of the non-zeros; the unknowns that the block is `touched` by; which of the core's non-zeros
        are entries of the block, and which of it; the numbers of all among the core's, with the block's behind them;
        and which are the core's by Omega.
        """
        H, (rows, columns) = self.resolution, self.core.pattern
        own = np.arange(self.attached * H, (self.attached + 1) * H)
        inside = (rows >= own[0]) & (rows <= own[-1])
        of_block, others = np.flatnonzero(inside), np.flatnonzero(~inside)
        touched = np.unique(np.concatenate([columns[of_block], own, [self.Omega_index]]))
        block = (rows[of_block] - own[0]) * touched.size + np.searchsorted(touched, columns[of_block])
        all_rows = np.concatenate([rows[others], np.repeat(own, touched.size)])
        all_columns = np.concatenate([columns[others], np.tile(touched, H)])
        order = np.lexsort((all_rows, all_columns))
        source = np.concatenate([others, rows.size + np.arange(H * touched.size)])[order]
        pattern, by_Omega = (all_rows[order], all_columns[order]), (all_columns[order] == self.Omega_index)
        return pattern, touched, np.stack([of_block, block]), source, np.flatnonzero(by_Omega & (source < rows.size))

    @property
    def touched(self) -> Indices:
        """Unknowns in the equations of the attached site by itself."""
        return self._places[1]

    @property
    def rows(self) -> slice:
        """Equations, and unknown positions, of the attached site."""
        return slice(self.attached * self.resolution, (self.attached + 1) * self.resolution)

    @cached_property
    def own_Omega(self) -> int:
        """Place of Omega among those `touched`."""
        return int(np.searchsorted(self.touched, self.Omega_index))

    def attached_balance(self, own: Array) -> tuple[Array, Array, Array]:
        """The core's equations of the attached site by harmonic, their derivatives, and those of all by Omega.

        `own` are unknowns of the core by itself. Derivatives are by those `touched`, of the equations times Omega^2 and
        over its value: a bond to the tail balances them.
        """
        H, (rows, columns), (of_block, places) = self.resolution, self.core.pattern, self._places[2]
        residual, nonzeros = self.core.evaluate(own)
        by_Omega, chosen = np.zeros(self.size - 1), columns == self.Omega_index
        by_Omega[rows[chosen]] = nonzeros[chosen]
        block, balance = np.zeros((H, self.touched.size)), residual[self.rows]
        block.ravel()[places] = nonzeros[of_block]
        block[:, self.own_Omega] += 2.0 / own[self.Omega_index] * balance
        return self._to_coefficients @ balance, self._to_coefficients @ block, by_Omega

    def recursion(self, form: PolynomialForm, orders: int) -> TailRecursion:
        """Power series of branches."""
        return TailRecursion(self, form, orders)

    @property
    def pattern(self) -> tuple[Indices, Indices]:
        return self._places[0]

    @property
    def numbers(self) -> Array:
        return self.constants

    @property
    def shared(self) -> dict[Any, Any]:
        return self._shared

    def evaluate(self, z: Array) -> tuple[Array, Array]:
        """As that of other problems; not a number where a harmonic that should be bound is in the band."""
        residuals, nonzeros = self.evaluate_all(z[None])
        return residuals[0], nonzeros[0]

    def evaluate_all(self, z: Array) -> tuple[Array, Array]:
        try:
            tails = [self.values(one) for one in z]
        except ArithmeticError:
            if len(z) > 1:
                return Problem.evaluate_all(self, z)
            return np.full((1, self.size - 1), np.nan), np.full((1, self._places[3].size), np.nan)
        place, H, (_, touched, (of_block, places), source, by_Omega) = self.Omega_index, self.resolution, self._places
        columns = [(v.Omega, v.Omega_slope, v.across, v.across_slope, v.down, v.down_slope) for v in tails]
        Omega, Omega_slope, across, across_slope, down, down_slope = (np.array(v) for v in zip(*columns, strict=True))
        own = z.copy()
        own[:, place] = Omega
        residuals, nonzeros = self.core.evaluate_all(own)
        T, bond = self._to_coefficients, (self.tail.coupling / Omega**2)[:, None]  # T is symmetric
        # One product a state: the last bit of a larger one depends on how many there are.
        balance, a = ((values[:, None, self.rows] @ T)[:, 0] for values in (residuals, z))
        from_tail = bond * across * a  # the force that the core's own equations lack, over Omega^2
        residuals[:, self.rows] = down * balance - from_tail

        block = np.zeros((len(z), H, touched.size))
        block.reshape(len(z), -1)[:, places] = nonzeros[:, of_block]
        block = down[:, :, None] * (T @ block)
        first = int(np.searchsorted(touched, self.rows.start))
        block[:, :, first : first + H] -= (bond * across)[:, :, None] * T
        relative = (Omega_slope / Omega)[:, None]
        block[:, :, self.own_Omega] *= Omega_slope[:, None]
        block[:, :, self.own_Omega] += down_slope * balance - bond * across_slope * a + 2.0 * relative * from_tail
        found = np.take(np.concatenate([nonzeros, block.reshape(len(z), -1)], axis=1), source, axis=1)
        found[:, by_Omega] *= Omega_slope[:, None]
        return residuals, found

    def by_itself(self, z: Array) -> tuple[TrigonometricProblem, Array]:
        own = z.copy()
        own[self.Omega_index] = self.frequency(z)
        return self.core, own

    def eliminated(self, z: Array) -> tuple[Array, slice, int]:
        H, values = self.resolution, self.values(z)
        bonds = self.tail.coupling / values.Omega**2 * values.across / values.down
        block = -(cosine_matrix(H) * bonds) @ self._to_coefficients
        return block, self.rows, -self.tail.passed(values)

    def rounding(self, z: Array) -> float:
        """That of the core by itself, whose equations have the largest terms."""
        core, own = self.by_itself(z)
        return core.rounding(own)

    def evaluated(self, z: Array, numbers: Array) -> tuple[Array, Array]:
        return self.evaluate_all(z)

    def metrics(self, z: Array, parameter_scale: float) -> Array:
        """A change of u by 1 counts as much as a wholly new profile, and the change of Omega that it makes besides."""
        weights: Array = super().metrics(z, parameter_scale)
        for weight, one in zip(weights, z, strict=True):
            weight[self.Omega_index] = 1.0
            try:
                values = self.values(one)
            except ArithmeticError:  # a guess that is none
                continue
            weight[self.Omega_index] += (FREQUENCY_WEIGHT * values.Omega_slope / values.Omega) ** 2
        return weights


# Power series of a branch of the core with its tail, order by order ---------------------------------------------------


class TailRecursion:
    """Coefficients of a branch of one problem with an eliminated tail, by the recursion of its core alone."""

    def __init__(self, problem: CoreWithTailProblem, form: PolynomialForm, orders: int) -> None:
        self.problem, self.orders = problem, orders
        self._core = TaylorRecursion(problem.core, form, orders)
        self.end: tuple[int, float] | None = None

    def series(self, z: Array, slope: Array, solve: Solve) -> Array:
        """Coefficients z_0 = z, z_1 = slope, z_2, ..., shape (orders + 1, size); see `TaylorRecursion`.

        Raises SingularError where the tail has no series.
        """
        place = self.problem.Omega_index
        try:
            tail = self.problem.tail.series(float(z[place]), self.orders)
        except ArithmeticError as error:
            raise SingularError(str(error)) from error
        self.end = None if np.isnan(tail.end) else (place, float(z[place]) + tail.end)
        orders = _Orders(self.problem, tail, z)
        self._core.put(0, orders.own)
        orders.first(slope)
        self._core.put(1, orders.own)
        if not self._core.solve_all(solve, orders.structure):
            for k in range(2, self.orders + 1):
                orders.solved(k, self._core.right_side(k), solve)
                self._core.put(k, orders.own)
        return orders.found


class _Orders:
    """Orders of a branch in turn, with those of all that depends on it."""

    def __init__(self, problem: CoreWithTailProblem, tail: TailSeries, z: Array) -> None:
        H, orders, place = problem.resolution, tail.Omega.size - 1, problem.Omega_index
        self._place, self._touched, self._own_Omega, self._rows = (
            place,
            problem.touched,
            problem.own_Omega,
            problem.rows,
        )
        self._transform, self._bond = (2.0 / H) * cosine_matrix(H), problem.tail.coupling / tail.Omega[0] ** 2
        self._by_u = np.column_stack([tail.Omega, tail.across, tail.down])  # by powers of u
        self._along, self._powers = np.zeros(self._by_u.shape), np.zeros((orders + 1, orders + 1))
        self._across, self._down = self._along[:, 1 : 1 + H], self._along[:, 1 + H :]
        self.found, self._balance, self._site = (np.zeros((orders + 1, size)) for size in (problem.size, H, H))
        self.own = z.copy()  # of the core: Omega in the place of u
        self.own[place] = tail.Omega[0]
        self._along[0], self.found[0] = self._by_u[0], z
        self._balance[0], self._block, self._by_Omega = problem.attached_balance(self.own)
        self._site[0] = self._transform @ z[self._rows]

    def first(self, slope: Array) -> None:
        """The first order."""
        self._put(1, slope, np.zeros(self._by_u.shape[1]), np.zeros(self._transform.shape[0]))

    def solved(self, k: int, right: Array, solve: Solve) -> None:
        """Order k from the right-hand side of the core by itself."""
        H, u, powers = self._transform.shape[0], self._powers[1], self._powers
        powers[2 : k + 1, k] = powers[1:k, k - 1 : 0 : -1] @ u[1:k]
        without = powers[2 : k + 1, k] @ self._by_u[2 : k + 1]  # as if u had no part of order k
        known = self._block[:, self._own_Omega] * without[0] - self._transform @ right[self._rows]
        right[:-1] -= self._by_Omega * without[0]
        lower = np.einsum("jh,jh->h", self._down[1:k], self._balance[k - 1 : 0 : -1])
        lower -= self._bond * np.einsum("jh,jh->h", self._across[1:k], self._site[k - 1 : 0 : -1])
        lower += without[1 + H :] * self._balance[0] - self._bond * without[1 : 1 + H] * self._site[0]
        right[self._rows] = -self._down[0] * known - lower
        self._put(k, solve(right), without, known)

    def _put(self, k: int, z: Array, without: Array, known: Array) -> None:
        """Take over order k, and complete what depends on it."""
        u = float(z[self._place])
        self.found[k], self.own, self._powers[1, k] = z, z.copy(), u
        self._along[k] = without + u * self._by_u[1]
        self._site[k] = self._transform @ z[self._rows]
        self.own[self._place] = u * self._by_u[1, 0]
        self._balance[k] = known + self._block @ self.own[self._touched]
        self.own[self._place] = self._along[k, 0]

    def structure(self) -> Structure:
        """What the compiled kernel needs for the same from order 2 on."""
        orders, size = self.found.shape
        return Structure(
            TAIL, orders - 1, self._transform.shape[0], size, self._rows.start, self._place, self._touched.size,
            self._own_Omega, self._touched, self._by_u, self._transform, self._block, self._by_Omega, self._along,
            self._powers, self._balance, self._site, self.found, self._bond,
        )  # fmt: skip
