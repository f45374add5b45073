"""The equations and declarations of a model as data: symbols, expressions, signs and names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.expressions import Expression, names_of

Array = NDArray[np.float64]
Signs = tuple[int, ...]


@dataclass(frozen=True, eq=False, repr=False)
class Equations:
    """Fields of an `OdeModel`, not checked; see there for the meaning of each."""

    name: str
    state: Expression
    rhs: Expression
    parameters: Expression = field(default_factory=lambda: ca.SX(0, 1))
    order: int = 1
    velocity: ca.SX | None = None
    _: KW_ONLY
    reversal: Signs | None = None
    half_period: Signs | None = None
    normalisation: Expression | None = None
    hamiltonian: Expression | None = None
    conserved: Mapping[str, Expression] = field(default_factory=dict)
    symmetries: Mapping[str, Expression] = field(default_factory=dict)
    output_scale: tuple[float, ...] | None = None
    time: Expression | None = None
    forcing_period: Expression | float | None = None
    outputs: Mapping[str, Expression] = field(default_factory=dict)
    nominal: tuple[float, ...] | Any = None
    state_labels: tuple[str, ...] | None = None
    parameter_labels: tuple[str, ...] | None = None
    checked: bool = True
    mass: Any = None
    decay: float | None = None

    @property
    def size(self) -> int:
        """Number of components of `state`."""
        return int(self.state.numel())

    @property
    def full_size(self) -> int:
        """Number of components of the first-order state."""
        return self.size * self.order

    @cached_property
    def full_state(self) -> Expression:
        """The first-order state: x, or positions then velocities."""
        return self.state if self.velocity is None else ca.vertcat(self.state, self.velocity)

    @property
    def full_rhs(self) -> Expression:
        """Time derivative of `full_state`."""
        return self.rhs if self.velocity is None else ca.vertcat(self.velocity, self.rhs)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Names of the components of the first-order state."""
        return names_of(self.full_state, self.state_labels)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return names_of(self.parameters, self.parameter_labels)

    @property
    def forced(self) -> bool:
        """Whether time enters the right-hand side by itself."""
        return self.time is not None

    def forcing_period_at(self, parameters: Any) -> float:
        """The period of the forcing at numbers for all parameters; 0 in a model that is not forced."""
        if not isinstance(self.forcing_period, ca.SX | ca.MX):
            return float(self.forcing_period or 0.0)
        return float(ca.Function("T", [self.parameters], [self.forcing_period])(parameters))

    def function(self, name: str, *results: Expression) -> ca.Function:
        """Function (t, x, p) of the first-order state x with the given expressions as results."""
        time = type(self.state).sym("t") if self.time is None else self.time
        return ca.Function(name, [time, self.full_state, self.parameters], list(results))

    @cached_property
    def vector_field(self) -> ca.Function:
        """Function (t, x, p) -> dense time derivative of the first-order state x."""
        return self.function("field", ca.densify(self.full_rhs))
