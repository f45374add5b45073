"""What the toolkit needs to know of a model: states, parameters, right-hand side and declared symmetries."""

from __future__ import annotations

import copyreg
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.models.expressions import Expression, names_of

Array = NDArray[np.float64]
Signs = tuple[int, ...]
EPSILON = sys.float_info.epsilon
ROUND_OFF = 1e-12  # of the size of the right-hand side


@dataclass(frozen=True, eq=False)
class OdeModel:
    """An ODE in CasADi symbols, of first order x' = f(t, x, p) or second order q'' = f(t, q, p).

    `state` is x or q, `velocity` the symbol of q' (second order only), `parameters` p (none by default), `time` the
    symbol t of a model that is forced, with `forcing_period`, a number or an expression in p. `outputs` are named
    expressions in all of these. `reversal` and `half_period` are the signs R and P, one for each component of the full
    state (x, or q then q'), of a time reversal x(-t) = R x(t) and of x(t + T/2) = P x(t). `hamiltonian` is conserved.
    `normalisation` is an expression that vanishes at phase zero of the wanted orbits of a family: it fixes their
    amplitude (and, where no reversal does, their phase: it is stationary there). `output_scale` are factors, one a
    component of `state`, that make of it what users see: errors are measured there as well. `nominal` are usual values
    of the parameters; components are called as their symbols unless labels are given. Where `checked`, the declared
    symmetries and the conserved quantity are evaluated at random points.

    MX expressions are accepted in models of first order whose state and parameters are one symbol each.

    Raises ValueError when the shapes, the symbols or the declarations do not fit.
    """

    name: str
    state: Expression
    rhs: Expression
    parameters: Expression = field(default_factory=lambda: ca.SX(0, 1))
    order: int = 1
    velocity: ca.SX | None = None
    reversal: Signs | None = None
    half_period: Signs | None = None
    normalisation: Expression | None = None
    hamiltonian: Expression | None = None
    output_scale: tuple[float, ...] | None = None
    time: Expression | None = None
    forcing_period: Expression | float | None = None
    outputs: Mapping[str, Expression] = field(default_factory=dict)
    nominal: tuple[float, ...] | None = None
    state_labels: tuple[str, ...] | None = None
    parameter_labels: tuple[str, ...] | None = None
    checked: bool = True

    def __post_init__(self) -> None:
        if isinstance(self.state, ca.MX) and self.parameters.numel() == 0:
            object.__setattr__(self, "parameters", ca.MX.sym("p", 0))
        check_declarations(self)
        if self.checked:
            self.check_symmetries()

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

    def __reduce__(self) -> str | tuple[Any, ...]:
        """Pickled as `save_model` writes it, subclasses too, so that processes can share it."""
        return copyreg.dispatch_table[OdeModel](self)


# Shapes and symbols ---------------------------------------------------------------------------------------------------


def check_declarations(model: OdeModel) -> None:
    """Raises ValueError, naming the model, where shapes, names or symbols do not fit each other."""
    for fault in _faults(model):
        raise ValueError(f"{model.name}: {fault}")


def _faults(model: OdeModel) -> Iterator[str]:
    if model.order not in (1, 2):
        yield f"order {model.order}; accepted: 1 or 2"
    if model.rhs.shape != model.state.shape:
        yield f"right-hand side of shape {model.rhs.shape}, state {model.state.shape}"
    if (model.velocity is None) != (model.order == 1):
        yield "a velocity symbol belongs to a model of second order, and only there"
    if model.velocity is not None and model.velocity.shape != model.state.shape:
        yield f"velocity of shape {model.velocity.shape}, state {model.state.shape}"
    if model.order == 2 and isinstance(model.state, ca.MX):
        yield "of second order in MX; accepted: SX, or a model of first order"
    yield from _numbers(model)
    symbols = [model.full_state, model.parameters, *([] if model.time is None else [model.time])]
    if not all(_plain(symbol) for symbol in symbols):
        yield "state, velocity, parameters or time with expressions among them; accepted: symbols"
    yield from _names(model)
    yield from _strangers(model, symbols)
    if model.velocity is not None and ca.depends_on(model.rhs, model.velocity):
        yield "a second-order right-hand side that depends on velocity; write first order"
    if model.hamiltonian is not None and model.forced:
        yield "a hamiltonian in a model that is forced; accepted: without time, where it is conserved"
    if model.forced and model.forcing_period is None:
        yield "time without forcing_period; accepted: the forcing's period, a number or an expression in parameters"
    for label, signs in (("reversal", model.reversal), ("half_period", model.half_period)):
        if signs is not None and (len(signs) != model.full_size or set(signs) - {1, -1}):
            yield f"{label} needs {model.full_size} signs, each +1 or -1"


def _plain(symbol: Expression) -> bool:
    """Whether this is a symbol, or in SX several; in MX several are an expression, which has no name."""
    if isinstance(symbol, ca.MX):
        return bool(symbol.is_symbolic()) or symbol.numel() == 0
    return bool(symbol.is_valid_input())


def _numbers(model: OdeModel) -> Iterator[str]:
    """What has one entry a component."""
    parameters = int(model.parameters.numel())
    for label, given, count, entries in (
        ("output_scale", model.output_scale, model.size, "factors"),
        ("nominal", model.nominal, parameters, "values"),
        ("state_labels", model.state_labels, model.full_size, "names"),
        ("parameter_labels", model.parameter_labels, parameters, "names"),
    ):
        if given is not None and len(given) != count:
            yield f"{label} needs {count} {entries}, given {len(given)}"
    if any(output.numel() != 1 for output in model.outputs.values()):
        yield "outputs with several components; accepted: one scalar expression a name"


def _names(model: OdeModel) -> Iterator[str]:
    names = [*model.state_names, *model.parameter_names, *model.outputs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice and model.outputs:
        yield f"{', '.join(twice)} named more than once among states, parameters and outputs"


def _strangers(model: OdeModel, symbols: list[Expression]) -> Iterator[str]:
    """Expressions that depend on what is not declared."""
    named: dict[str, object] = {label: getattr(model, label) for label in ("rhs", "normalisation", "hamiltonian")}
    named |= {f"output {name}": output for name, output in model.outputs.items()}
    for label, expression in named.items():
        if expression is None:
            continue
        unknown = ca.Function("f", symbols, [expression], {"allow_free": True}).get_free()
        if unknown:
            yield f"{label} depends on {', '.join(unknown)}, which is not declared"
    if isinstance(model.forcing_period, ca.SX | ca.MX):
        period = ca.Function("T", [model.parameters], [model.forcing_period], {"allow_free": True})
        if period.get_free():
            yield f"forcing_period depends on {', '.join(period.get_free())}; accepted: parameters"


# Symmetries -----------------------------------------------------------------------------------------------------------


def check_symmetries(model: OdeModel, trials: int, seed: int) -> None:
    """Raises ValueError naming the first symmetry or conserved quantity that does not hold at random points."""
    if model.reversal is None and model.half_period is None and model.hamiltonian is None:
        return
    rate = 0.0 if model.hamiltonian is None else ca.jacobian(model.hamiltonian, model.full_state) @ model.full_rhs
    evaluate = model.function("check", ca.densify(model.full_rhs), ca.densify(rate))
    generator = np.random.default_rng(seed)
    for _ in range(trials):
        time, point, parameter = _finite_point(model, evaluate, generator)
        value, change = (np.array(r).ravel() for r in evaluate(time, point, parameter))
        scale = ROUND_OFF * (1.0 + np.abs(value).max())
        half = 0.5 * model.forcing_period_at(parameter)
        images = (("reversal", model.reversal, -1, -time), ("half_period", model.half_period, 1, time + half))
        for label, signs, sense, at in images:
            if signs is None:
                continue
            image = np.array(evaluate(at, np.array(signs) * point, parameter)[0]).ravel()
            if not np.abs(image - sense * np.array(signs) * value).max() <= scale:
                raise ValueError(f"{model.name}: the declared {label} is not a symmetry of the right-hand side")
        if abs(change[0]) > scale * (1.0 + np.abs(point).sum()):
            raise ValueError(f"{model.name}: the declared hamiltonian is not conserved")


def _finite_point(model: OdeModel, evaluate: ca.Function, generator: np.random.Generator) -> tuple[float, Array, Array]:
    """A random time, state and parameter at which all is finite: positive where roots and logarithms need it."""
    time = generator.normal()
    x, p = (generator.normal(size=count) for count in (model.full_size, model.parameters.numel()))
    for point, parameter in ((x, p), (x, np.abs(p)), (np.abs(x), np.abs(p))):
        if all(np.all(np.isfinite(np.array(r))) for r in evaluate(time, point, parameter)):
            return time, point, parameter
    raise ValueError(f"{model.name}: the right-hand side or the hamiltonian is not finite at a random point")
