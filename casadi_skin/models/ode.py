"""What the toolkit needs to know of a model: states, parameters, right-hand side and declared symmetries."""

from __future__ import annotations

import copyreg
import sys
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, fields
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.models.declarations import check_declarations, declarations
from casadi_skin.models.expressions import Expression, names_of

Array = NDArray[np.float64]
Signs = tuple[int, ...]
EPSILON = sys.float_info.epsilon
ROUND_OFF = 1e-12  # of the size of the right-hand side


@dataclass(frozen=True, eq=False, repr=False)
class OdeModel:
    """An ODE in CasADi symbols, of first order x' = f(t, x, p) or second order q'' = f(t, q, p).

    `state` is x or q, `velocity` the symbol of q' (second order only), `parameters` p (none by default), `time` the
    symbol t of a model that is forced, with `forcing_period`, a number or an expression in p. `outputs` are named
    expressions in all of these. `reversal` and `half_period` are the signs R and P, one for each component of the full
    state (x, or q then q'), of a time reversal x(-t) = R x(t) and of x(t + T/2) = P x(t). `hamiltonian` is conserved.
    `conserved` are further conserved quantities by name, as a momentum; `symmetries` the directions in which continuous
    symmetries move the full state, by the names of what they conserve: found from a canonical `hamiltonian` where left
    out.
    `normalisation` is an expression that vanishes at phase zero of the wanted orbits of a family: it fixes their
    amplitude (and, where no reversal does, their phase: it is stationary there). `output_scale` are factors, one a
    component of `state`, that make of it what users see: errors are measured there as well. `nominal` are usual values
    of the parameters; components are called as their symbols unless labels are given. Where `checked`, the declared
    symmetries and the conserved quantity are evaluated at random points.

    MX expressions are accepted in models of first order whose state and parameters are one symbol each.

    Symbols may be given as a list of scalars, expressions as lists, numbers or functions f(t, x, p) of the symbols.

    Raises ValueError when the shapes, the symbols or the declarations do not fit, TypeError for other kinds of objects.
    """

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
    nominal: tuple[float, ...] | None = None
    state_labels: tuple[str, ...] | None = None
    parameter_labels: tuple[str, ...] | None = None
    checked: bool = True

    def __post_init__(self) -> None:
        for label, value in declarations(self).items():
            object.__setattr__(self, label, value)
        check_declarations(self)
        if self.checked:
            self.check_symmetries()

    def __repr__(self) -> str:
        """Without the expressions: CasADi writes them by recursion, and deep ones end the process."""
        parameters = ", ".join(self.parameter_names) or "none"
        return f"{type(self).__name__}({self.name!r}: {self.full_size} states; parameters {parameters})"

    @property
    def size(self) -> int:
        """Number of components of `state`."""
        return int(self.state.numel())

    @property
    def full_size(self) -> int:
        """Number of components of the first-order state."""
        return self.size * self.order

    @property
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

    @property
    def rounding(self) -> float:
        """Relative error of the right-hand side's values: that of doubles; models whose values are worse tell so."""
        return EPSILON

    @cached_property
    def vector_field(self) -> ca.Function:
        """Function (t, x, p) -> dense time derivative of the first-order state x."""
        return self.function("field", ca.densify(self.full_rhs))

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
    def ends(self) -> tuple[Expression, Expression]:
        """Symbols of the first-order state at the start and at the end of an interval."""
        if isinstance(self.state, ca.MX):
            return ca.MX.sym("start", self.full_size), ca.MX.sym("end", self.full_size)
        at = ("start", "end")
        first, last = (ca.vertcat(*(ca.SX.sym(f"{name}({end})") for name in self.state_names)) for end in at)
        return first, last

    def start(self, expression: Expression) -> Expression:
        """An expression in the state, taken at the start of the interval of a boundary-value problem."""
        return ca.substitute(expression, self.full_state, self.ends[0])

    def end(self, expression: Expression) -> Expression:
        """An expression in the state, taken at the end of the interval of a boundary-value problem."""
        return ca.substitute(expression, self.full_state, self.ends[1])

    def rhs_and_jacobian(self) -> ca.Function:
        """Function (state, parameters) -> (rhs, sparse d rhs/d state, d rhs/d parameters)."""
        arguments = [self.state, self.parameters]
        results = [self.rhs, ca.jacobian(self.rhs, self.state), ca.densify(ca.jacobian(self.rhs, self.parameters))]
        return ca.Function("rhs", arguments, results, ["state", "p"], ["f", "df_dstate", "df_dp"])

    def first_order(self) -> OdeModel:
        """The same model with positions and velocities as one state of first order."""
        if self.order == 1:
            return self
        return OdeModel(
            name=self.name,
            state=self.full_state,
            rhs=self.full_rhs,
            parameters=self.parameters,
            reversal=self.reversal,
            half_period=self.half_period,
            normalisation=self.normalisation,
            hamiltonian=self.hamiltonian,
            conserved=self.conserved,
            symmetries=self.symmetries,
            time=self.time,
            forcing_period=self.forcing_period,
            outputs=self.outputs,
            nominal=self.nominal,
            state_labels=self.state_labels,
            parameter_labels=self.parameter_labels,
            checked=False,  # these are the same declarations
        )

    def check_symmetries(self, trials: int = 5, seed: int = 0) -> None:
        """Evaluate the declared symmetries and the conserved quantity at random points.

        Raises ValueError naming the first declaration that does not hold.
        """
        check_symmetries(self, trials, seed)

    def with_nominal(self, nominal: tuple[float, ...]) -> OdeModel:
        """The equations and declarations with other usual values of the parameters, not checked again."""
        own = {entry.name: getattr(self, entry.name) for entry in fields(OdeModel)}
        return OdeModel(**own | {"nominal": nominal, "checked": False})

    def __reduce__(self) -> str | tuple[Any, ...]:
        """Pickled as `save_model` writes it, subclasses too, so that processes can share it."""
        return copyreg.dispatch_table[OdeModel](self)


# Symmetries -----------------------------------------------------------------------------------------------------------


def check_symmetries(model: OdeModel, trials: int, seed: int) -> None:
    """Raises ValueError naming the first symmetry or conserved quantity that does not hold at random points."""
    kept = {"hamiltonian": model.hamiltonian} if model.hamiltonian is not None else {}
    kept |= {f"conserved {name}": quantity for name, quantity in model.conserved.items()}
    if model.reversal is None and model.half_period is None and not kept:
        return
    x, rhs = model.full_state, model.full_rhs
    rates = [ca.densify(ca.gradient(quantity, x) * rhs) for quantity in kept.values()]
    brackets = [ca.densify(ca.jtimes(rhs, x, g) - ca.jtimes(g, x, rhs)) for g in model.symmetries.values()]
    evaluate = model.function("check", ca.densify(rhs), *rates, *brackets)
    generator = np.random.default_rng(seed)
    for _ in range(trials):
        time, point, parameter = _finite_point(model, evaluate, generator)
        value, *changes = (np.array(r).ravel() for r in _all(evaluate(time, point, parameter)))
        scale = ROUND_OFF * (1.0 + np.abs(value).max())
        half = 0.5 * model.forcing_period_at(parameter)
        images = (("reversal", model.reversal, -1, -time), ("half_period", model.half_period, 1, time + half))
        for label, signs, sense, at in images:
            if signs is None:
                continue
            image = np.array(_all(evaluate(at, np.array(signs) * point, parameter))[0]).ravel()
            if not np.abs(image - sense * np.array(signs) * value).max() <= scale:
                raise ValueError(f"{model.name}: the declared {label} is not a symmetry of the right-hand side")
        within = scale * (1.0 + np.abs(point).sum())
        for label, change in zip(kept, changes, strict=False):
            if not abs(np.sum(change)) <= max(within, ROUND_OFF * np.sum(np.abs(change))):
                raise ValueError(f"{model.name}: the declared {label} is not conserved")
        for label, bracket in zip(model.symmetries, changes[len(kept) :], strict=True):
            if not np.max(np.abs(bracket)) <= within:
                raise ValueError(f"{model.name}: the declared direction {label} is not that of a symmetry")


def _all(results: Any) -> tuple[Any, ...]:
    """All results of a function, also where it has one."""
    return results if isinstance(results, tuple) else (results,)


def _finite_point(model: OdeModel, evaluate: ca.Function, generator: np.random.Generator) -> tuple[float, Array, Array]:
    """A random time, state and parameter at which all is finite: positive where roots and logarithms need it."""
    time = generator.normal()
    x, p = (generator.normal(size=count) for count in (model.full_size, model.parameters.numel()))
    for point, parameter in ((x, p), (x, np.abs(p)), (np.abs(x), np.abs(p))):
        if all(np.all(np.isfinite(np.array(r))) for r in _all(evaluate(time, point, parameter))):
            return time, point, parameter
    raise ValueError(f"{model.name}: the right-hand side or the hamiltonian is not finite at a random point")
