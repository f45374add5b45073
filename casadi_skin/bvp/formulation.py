"""A boundary-value problem on the unit interval: the data that collocation needs, of orbits as of any problem."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.models.expressions import Expression


@dataclass(frozen=True, eq=False)
class Formulation:
    """dx/ds = field(s, x, sigma) for s in [0, 1], with rows that vanish at the ends and integrals that vanish.

    `s`, `x`, `end` and `scalars` (sigma: Omega or a duration, parameters, unfolding coefficients) are symbols of one
    kind, SX or MX. `conditions` are expressions in x at the start, in `end` and in sigma; `integrands` are expressions
    in s, x and sigma. Together they are one less than components of x and scalars: one scalar is held or followed.
    """

    s: Expression
    x: Expression
    end: Expression
    scalars: Expression
    field: Expression
    conditions: Expression
    integrands: Expression

    @cached_property
    def discretisations(self) -> dict[tuple[int, int, int], Any]:
        """Discretisations made of this formulation, by numbers of intervals, stages and increments."""
        return {}

    @property
    def states(self) -> int:
        """Number of components of x."""
        return int(self.x.numel())

    @property
    def integrals(self) -> int:
        """Number of integral conditions."""
        return int(self.integrands.numel())

    @cached_property
    def field_function(self) -> ca.Function:
        """Function (s, x, sigma) -> (F, sparse dF/dx, dense dF/dsigma)."""
        return self._along("field", self.field, sparse=True)

    @cached_property
    def component_order(self) -> NDArray[np.int64]:
        """An order of the components of x in which factors of 1 - dF/dx are sparse, by approximate minimum degree."""
        pattern = self.field_function.sparsity_out(1)
        return np.array((pattern + pattern.T + ca.Sparsity.diag(self.states)).amd(), dtype=np.int64)

    def at_stages(self, places: ca.MX, states: ca.MX, scalars: ca.MX) -> list[ca.MX]:
        """F, dF/dx and dF/dsigma at several stages, one column each.

        An SX function gives all at once. Of a program values have a function of their own: CasADi evaluates all of an
        MX function, also results that are not used.
        """
        count, function = states.size2(), self.field_function
        found = list(function.map(count)(places, states, scalars))
        if not function.is_a("SXFunction"):
            arguments = [self.s, self.x, self.scalars]
            values = ca.Function("values", arguments, [ca.densify(self.field)])
            found[0] = values.map(count)(places, states, scalars)
        return found

    @cached_property
    def integrand_function(self) -> ca.Function:
        """Function (s, x, sigma) -> (e, dense de/dx, dense de/dsigma)."""
        return self._along("integrands", self.integrands, sparse=False)

    def _along(self, name: str, values: Expression, sparse: bool) -> ca.Function:
        by_x, by_scalars = ca.jacobian(values, self.x), ca.densify(ca.jacobian(values, self.scalars))
        results = [ca.densify(values), by_x if sparse else ca.densify(by_x), by_scalars]
        return ca.Function(name, [self.s, self.x, self.scalars], results)

    @cached_property
    def condition_function(self) -> ca.Function:
        """Function (x at the start, x at the end, sigma) -> (rows, their sparse derivatives by each of the three)."""
        arguments = [self.x, self.end, self.scalars]
        derivatives = [ca.jacobian(self.conditions, symbol) for symbol in arguments]
        return ca.Function("conditions", arguments, [ca.densify(self.conditions), *derivatives])
