"""Power series of a branch of polynomial collocation equations, order by order.

Along z(tau) = sum_k z_k tau^k every order solves the same linear system, with a right-hand side that the lower orders
give through Cauchy products: the asymptotic numerical method (Damil and Potier-Ferry 1990; Cochelin and Vergez 2009).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import Monomials, polynomial_terms
from casadi_skin.native import Structure, TaylorKernel, kernels
from casadi_skin.zero.problem import Array, Indices, Solve


@dataclass(frozen=True, eq=False)
class _Terms:
    """Terms coefficient * p^power * product of states of one power and degree, and series of the products in them.

    Attributes:
        power: of the parameter.
        places: columns of the states' series that are the factors, one a term and node.
        products: series of x_a, x_a x_b, ..., shape (orders + 1, terms * nodes) each.
        scatter: adds values of terms, (terms, nodes), to the components that they belong to.
    """

    power: int
    places: list[Indices]
    products: list[Array]
    scatter: Any

    @classmethod
    def of(cls, monomials: Monomials, components: int, nodes: int, orders: int) -> _Terms:
        """Those of monomials, at every node."""
        from scipy.sparse import csr_matrix

        count, every = monomials.rows.size, np.arange(nodes)
        places = [(factor[:, None] * nodes + every).ravel() for factor in monomials.factors]
        entries = (monomials.coefficients, (monomials.rows, np.arange(count)))
        products = [np.zeros((orders + 1, count * nodes)) for _ in places]
        return cls(monomials.power, places, products, csr_matrix(entries, (components, count)))


class _Sum:
    """Series of a sum of terms, by component; states are (order, all)."""

    def __init__(self, terms: Sequence[Monomials], series: Array, components: int, nodes: int) -> None:
        # Of terms that are linear nothing is left when the order sought is taken out.
        kept = [m for m in terms if m.power + m.degree > 1]
        self._series, self._shape = series, (components, nodes)
        self._terms = [_Terms.of(m, components, nodes, len(series) - 1) for m in kept]
        self.highest = max((m.power for m in kept), default=0)

    def order(self, k: int, powers: Array) -> Array:
        """Order k of the sum, shape (components, nodes); `powers`, (power, order), are series of powers of p."""
        total = np.zeros(self._shape)
        for terms in self._terms:
            value = np.full(terms.scatter.shape[1] * self._shape[1], powers[terms.power, k])
            for level, place in enumerate(terms.places):
                factor, product = self._series[: k + 1, place], terms.products[level]
                left = terms.products[level - 1][: k + 1]
                product[k] = np.einsum("jm,jm->m", left, factor[::-1]) if level else factor[k]
                value = powers[terms.power, k::-1] @ product[: k + 1] if terms.power else product[k]
            total += terms.scatter @ value.reshape(terms.scatter.shape[1], -1)
        return total


@dataclass(frozen=True)
class PolynomialForm:
    """Right-hand side and normalisation of a model as polynomials of its state and parameter."""

    force: tuple[Monomials, ...]
    norm: tuple[Monomials, ...]

    @classmethod
    def of(cls, model: OdeModel) -> PolynomialForm:
        """The form of a model; raises NotPolynomialError where there is none."""
        return _form(model)


@lru_cache(maxsize=8)
def _form(model: OdeModel) -> PolynomialForm:
    force, norm = (polynomial_terms(e, model.state, model.parameters) for e in (model.rhs, model.normalisation))
    return PolynomialForm(force, norm)


class Recursion(Protocol):
    """Power series of the branch through a point."""

    def series(self, z: Array, slope: Array, solve: Solve) -> Array:
        """Coefficients of the branch from z with first coefficient `slope`, shape (orders + 1, unknowns)."""
        ...

    @property
    def end(self) -> tuple[int, float] | None:
        """An unknown and its value up to which the last series holds; None where the equations are analytic."""
        ...


class CosineUnknowns(Protocol):
    """Where the unknowns of a problem in odd cosines stand: states by site, then node, and then the scalars."""

    model: OdeModel
    resolution: int
    states: int
    second_derivative: Array  # matrix of d^2/dtheta^2 on the values at the nodes
    at_zero: Array  # weights of the values at the nodes in that at phase zero

    @property
    def size(self) -> int: ...

    @property
    def Omega_index(self) -> int: ...

    @property
    def parameter_index(self) -> int: ...


class TaylorRecursion:
    """Coefficients z_k of a branch of one trigonometric problem; buffers are made once and used again."""

    end: tuple[int, float] | None = None  # equations are analytic everywhere

    def __init__(self, problem: CosineUnknowns, form: PolynomialForm, orders: int) -> None:
        H, N = problem.resolution, problem.model.size
        self.problem, self.orders = problem, orders
        self._coefficients = np.zeros((orders + 1, problem.size))
        states = self._coefficients[:, : problem.states]
        D2, at_zero = problem.second_derivative, problem.at_zero
        self.put, self.right_side, self._kernel = self._put, self._right_side, None
        if kernels():
            self._kernel = TaylorKernel(self._coefficients, D2, at_zero, form.force, form.norm)
            self.put, self.right_side = self._kernel.put, self._kernel.right_side
            return
        self._start = np.zeros((orders + 1, N))  # the state at phase zero, which the normalisation is about
        self._curvature = np.zeros((orders + 1, N * H))
        self._D2, self._at_zero = D2, at_zero
        self._by_site = states.reshape(orders + 1, N, H)
        self._force = _Sum(form.force, states, N, H)
        self._norm = _Sum(form.norm, self._start, 1, 1)
        self._powers = np.zeros((max(self._force.highest, self._norm.highest, 1) + 1, orders + 1))
        self._squared = np.zeros(orders + 1)  # Omega^2

    def _put(self, k: int, z: Array) -> None:
        """Take over order k and complete what depends on it."""
        problem = self.problem
        self._coefficients[k] = z
        Omega, p = self._coefficients[:, problem.Omega_index], self._coefficients[:, problem.parameter_index]
        states = self._by_site[k]
        np.matmul(states, self._D2.T, out=self._curvature[k].reshape(states.shape))
        np.matmul(states, self._at_zero, out=self._start[k])
        self._squared[k] = Omega[: k + 1] @ Omega[k::-1]
        self._powers[0, k] = float(k == 0)
        for power in range(1, self._powers.shape[0]):
            self._powers[power, k] = self._powers[power - 1, : k + 1] @ p[k::-1]
        self._force.order(k, self._powers)
        self._norm.order(k, self._powers)

    def _right_side(self, k: int) -> Array:
        """Right-hand side of order k: minus the equations with no part of order k in z, shape (size,)."""
        problem = self.problem
        self._coefficients[k] = self._start[k] = 0.0
        Omega, p = self._coefficients[:, problem.Omega_index], self._coefficients[:, problem.parameter_index]
        self._squared[k] = Omega[1:k] @ Omega[k - 1 : 0 : -1]
        for power in range(1, self._powers.shape[0]):
            self._powers[power, k] = self._powers[power - 1, : k + 1] @ p[k::-1]
        right = np.zeros(problem.size)
        inertia = self._squared[k:0:-1] @ self._curvature[:k]
        force = self._force.order(k, self._powers)
        right[: problem.states] = (force.ravel() - inertia) / self._squared[0]
        right[problem.states] = -self._norm.order(k, self._powers)[0, 0]
        return right

    def series(self, z: Array, slope: Array, solve: Solve) -> NDArray[np.float64]:
        """Coefficients z_0 = z, z_1 = slope, z_2, ..., shape (orders + 1, size).

        `solve` belongs to the Jacobian at z closed by a row; the higher orders have no component along that row.
        """
        self.put(0, z)
        self.put(1, slope)
        if not self.solve_all(solve):
            for k in range(2, self.orders + 1):
                self.put(k, solve(self.right_side(k)))
        return self._coefficients.copy()

    def solve_all(self, solve: Solve, tail: Callable[[], Structure] | None = None) -> bool:
        """All orders beyond the first two by the compiled kernel; False where it or the solver is not there."""
        compiled = getattr(solve, "compiled", None)
        if self._kernel is None or compiled is None:
            return False
        layout, factors = compiled
        self._kernel.solve_all(layout, factors, None if tail is None else tail())
        return True
