"""A boundary-value problem on the unit interval: the data that collocation needs, of orbits as of any problem."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.expressions import Expression
from casadi_skin.zero.butcher import CollocationTable
from casadi_skin.zero.problem import Buffers

Pattern = tuple[tuple[int, ...], ...]  # rows and columns of non-zeros, by columns


@dataclass(frozen=True, eq=False)
class Formulation:
    """dx/ds = field(s, x, sigma) for s in [0, 1], with rows that vanish at the ends and integrals that vanish.

    `s`, `x`, `ends` (x at the start and at the end) and `scalars` (sigma: Omega or a duration, parameters, unfolding
    coefficients) are symbols of one kind, SX or MX, and so are the `constants`, whose values may change without
    anything being built again: all expressions may have them in. `conditions` are expressions in `ends` and in sigma;
    `integrands` are expressions in s, x and sigma. Together they are one less than components of x and scalars: one
    scalar is held or followed.
    """

    s: Expression
    x: Expression
    ends: tuple[Expression, Expression]
    scalars: Expression
    field: Expression
    conditions: Expression
    integrands: Expression
    constants: Expression

    @cached_property
    def discretisations(self) -> dict[tuple[int, CollocationTable], Any]:
        """Discretisations made of this formulation, by the number of intervals and the table of the method."""
        return {}

    @cached_property
    def states(self) -> int:
        """Number of components of x."""
        return int(self.x.numel())

    @cached_property
    def integrals(self) -> int:
        """Number of integral conditions."""
        return int(self.integrands.numel())

    @cached_property
    def field_function(self) -> ca.Function:
        """Function (s, x, sigma, constants) -> (F, sparse dF/dx, dense dF/dsigma)."""
        return self._along("field", self.field, sparse=True)

    @cached_property
    def jacobian_function(self) -> ca.Function:
        """Function (s, x, sigma, constants) -> dense dF/dx."""
        by_x = self.field_function.call(self._arguments, True, False)[1]
        return ca.Function("jacobian", self._arguments, [_dense(by_x)])

    @cached_property
    def component_order(self) -> NDArray[np.int64]:
        """An order of the components of x in which factors of 1 - dF/dx are sparse, by approximate minimum degree."""
        pattern = self.field_function.sparsity_out(1)
        return np.array((pattern + pattern.T + ca.Sparsity.diag(self.states)).amd(), dtype=np.int64)

    def at_stages(self, *arguments: ca.MX) -> list[ca.MX]:
        """F, dF/dx and dF/dsigma at several stages, one column of (s, x, sigma, constants) each.

        An SX function gives all at once. Of a program values have a function of their own: CasADi evaluates all of an
        MX function, also results that are not used.
        """
        count, function = arguments[0].size2(), self.field_function
        found = list(function.map(count)(*arguments))
        if not function.is_a("SXFunction"):
            values = ca.Function("values", self._arguments, [ca.densify(self.field)])
            found[0] = values.map(count)(*arguments)
        return found

    @cached_property
    def integrand_function(self) -> ca.Function:
        """Function (s, x, sigma, constants) -> (e, dense de/dx, dense de/dsigma)."""
        return self._along("integrands", self.integrands, sparse=False)

    def _along(self, name: str, values: Expression, sparse: bool) -> ca.Function:
        by_x, by_scalars = ca.jacobian(values, self.x), _dense(ca.jacobian(values, self.scalars))
        results = [_dense(values), by_x if sparse else _dense(by_x), by_scalars]
        return ca.Function(name, self._arguments, results)

    @property
    def _arguments(self) -> list[Expression]:
        return [self.s, self.x, self.scalars, self.constants]

    @cached_property
    def condition_function(self) -> ca.Function:
        """Function (x at start, x at end, sigma, constants) -> (rows, sparse derivatives by the first three)."""
        derivatives = [
            *(ca.jacobian(self.conditions, end) for end in self.ends),
            ca.jacobian(self.conditions, self.scalars),
        ]
        results = [_dense(self.conditions), *derivatives]
        return ca.Function("conditions", [*self.ends, self.scalars, self.constants], results)

    @cached_property
    def condition_buffers(self) -> Buffers:
        """The same, called with arrays."""
        return Buffers(self.condition_function)

    @cached_property
    def patterns(self) -> tuple[Pattern, tuple[Pattern, ...]]:
        """Non-zeros of dF/dx, and of the conditions' derivatives by x at the start, x at the end and sigma."""
        found = [self.field_function.sparsity_out(1), *(self.condition_function.sparsity_out(i) for i in (1, 2, 3))]
        along, *by_ends = (tuple(map(tuple, sparsity.get_triplet())) for sparsity in found)
        return along, tuple(by_ends)


def _dense(values: Expression) -> Expression:
    if values.is_dense():
        return values
    return ca.densify(values) if values.nnz() else type(values).zeros(*values.shape)
