"""Power series of a branch of a nonlinear core whose linear tail is eliminated, order by order.

Omega, and what the core feels of its tail, are power series of the unknown u, and u is one along the branch. So every
order of theirs is that of the series put into one another, and linear in the part of that order of u.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from casadi_skin.lattice.tail_series import TailSeries
from casadi_skin.native.tail import TailKernel, has_tail_kernel
from casadi_skin.zero.cosines import cosine_matrix
from casadi_skin.zero.problem import Array, Indices, SingularError, Solve
from casadi_skin.zero.recursion import CosineUnknowns, PolynomialForm, TaylorRecursion


class Tail(Protocol):
    """A tail, as a power series of the unknown u in place of Omega."""

    @property
    def coupling(self) -> float: ...

    def series(self, u: float, orders: int) -> TailSeries: ...


class TailedCore(CosineUnknowns, Protocol):
    """A core by itself, and the balance of its site that is attached to a tail."""

    attached: int

    @property
    def core(self) -> CosineUnknowns: ...

    @property
    def tail(self) -> Tail: ...

    @property
    def touched(self) -> Indices: ...

    @property
    def own_Omega(self) -> int: ...

    def attached_balance(self, own: Array) -> tuple[Array, Array, Array]: ...


class _Orders:
    """Orders of a branch in turn, with those of all that depends on it."""

    def __init__(self, problem: TailedCore, tail: TailSeries, z: Array) -> None:
        H, orders, place = problem.resolution, tail.Omega.size - 1, problem.Omega_index
        self._place, self._touched, self._own_Omega = place, problem.touched, problem.own_Omega
        self._first, self._rows = problem.attached * H, slice(problem.attached * H, (problem.attached + 1) * H)
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

    def kernel(self, compiled: Sequence[int]) -> TailKernel:
        """The same from order 2 on by the compiled kernel, with a compiled solver at addresses."""
        orders, size = self.found.shape
        H = self._transform.shape[0]
        sizes = 2, orders - 1, H, size, self._first, self._place, self._touched.size, self._own_Omega
        arrays = {
            "columns": self._touched, "by_u": self._by_u, "transform": self._transform, "block": self._block,
            "by_Omega": self._by_Omega, "along": self._along, "powers": self._powers, "balance": self._balance,
            "site": self._site, "found": self.found,
        }  # fmt: skip
        return TailKernel(compiled, sizes, arrays, self._bond)


class TailRecursion:
    """Coefficients of a branch of one problem with an eliminated tail, by the recursion of its core alone."""

    def __init__(self, problem: TailedCore, form: PolynomialForm, orders: int) -> None:
        self.problem, self.orders = problem, orders
        self._core = TaylorRecursion(problem.core, form, orders)
        self.end: tuple[int, float] | None = None

    def series(self, z: Array, slope: Array, solve: Solve) -> Array:
        """Coefficients z_0 = z, z_1 = slope, z_2, ..., shape (orders + 1, size); see `TaylorRecursion`.

        Raises SingularError where the tail has no series.
        """
        core, u = self._core, float(z[self.problem.Omega_index])
        try:
            tail = self.problem.tail.series(u, self.orders)
        except ArithmeticError as error:
            raise SingularError(str(error)) from error
        self.end = None if np.isnan(tail.end) else (self.problem.Omega_index, u + tail.end)
        orders = _Orders(self.problem, tail, z)
        core.put(0, orders.own)
        orders.first(slope)
        core.put(1, orders.own)
        compiled = getattr(solve, "addresses", None)
        if core.is_compiled and compiled is not None and has_tail_kernel():
            kernel = orders.kernel(compiled)  # it has to live as long as its addresses
            core.solve_all(kernel.addresses)
            return orders.found
        for k in range(2, self.orders + 1):
            orders.solved(k, core.right_side(k), solve)
            core.put(k, orders.own)
        return orders.found
