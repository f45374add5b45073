"""A model for the toolkit: states, parameters, right-hand side and declared symmetries."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, ClassVar

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from casadi_skin.model.arguments import short_repr
from casadi_skin.model.declarations import check_declarations, check_symmetries, declarations
from casadi_skin.model.equations import Equations
from casadi_skin.model.expressions import Expression
from casadi_skin.model.implicit import Implicit
from casadi_skin.model.jumps import Jumps
from casadi_skin.model.pickled import reduced
from casadi_skin.model.polynomial import NotPolynomialError, homogeneous_parts
from casadi_skin.model.result import WithVerbs
from casadi_skin.native.programs import Program

EPSILON = sys.float_info.epsilon


@dataclass(frozen=True, eq=False, repr=False)
class OdeModel(Equations, WithVerbs):
    """An ODE in CasADi symbols, of first order x' = f(t, x, p) or second order q'' = f(t, q, p).

    `state` is x or q, `velocity` the symbol of q' (second order only), `parameters` p (none by default), `time` the
    symbol t of a model that is forced, with `forcing_period`, a number or an expression in p. `outputs` are named
    expressions in all of these. `reversal` and `half_period` are the signs R and P, one for each component of the full
    state (x, or q then q'), of a time reversal x(-t) = R x(t) and of x(t + T/2) = P x(t). `hamiltonian` is conserved.
    `conserved` are further conserved quantities by name, as a momentum; `symmetries` the directions in which continuous
    symmetries move the full state, by the names of what they conserve: from a canonical `hamiltonian` where left
    out.
    `normalisation` is an expression that vanishes at phase zero of the wanted orbits of a family: it fixes their
    amplitude (and, where no reversal does, their phase: it is stationary there). `output_scale` are factors, one a
    component of `state`, for the values that users see: errors are measured there too. `nominal` are usual values
    of the parameters, in their order or by name; components are called as their symbols unless labels are given. Where
    `checked`, the declared symmetries and the conserved quantity are evaluated at random points.

    `mass` is M of a model of first order M x' = f(t, x, p): n x n numbers, or expressions in parameters, with a row
    for each entry of `rhs`. It may be singular; no equilibrium, orbit, eigenvalue or multiplier depends then on
    `decay`, the rate in 1/time at which states come to meet what is algebraic. Left out, it is a rate of the model.

    MX expressions are accepted in models of first order whose state and parameters are one symbol each.

    Symbols may be given as a list of scalars, expressions as lists, numbers or functions f(t, x, p) of the symbols.

    Raises ValueError when the shapes, the symbols or the declarations do not fit, TypeError for other kinds of objects.
    """

    def __post_init__(self) -> None:
        for label, value in declarations(self).items():
            object.__setattr__(self, label, value)
        check_declarations(self)
        if self.mass is not None:
            implicit = Implicit.of(self, self.mass)
            object.__setattr__(self, "implicit", implicit)
            object.__setattr__(self, "rhs", implicit.rhs)
        if self.checked:
            self.check_symmetries()

    def __repr__(self) -> str:
        """Without the expressions: CasADi writes them by recursion, and deep ones end the process."""
        parameters = ", ".join(self.parameter_names) or "none"
        return f"{type(self).__name__}({self.name!r}: {self.full_size} states; parameters {parameters})"

    implicit: ClassVar[Implicit | None] = None
    """M x' = f of a model with a mass matrix."""
    infinite: ClassVar[bool] = False
    """Whether it has infinitely many positions."""
    labels: ClassVar[tuple[tuple[str, float], ...]] = ()
    """Symbols in TeX and values for titles, of a model that has them in place of a name."""
    place: ClassVar[str] = "position"
    """Name of the places along axes."""
    declaration: ClassVar[Any] = None
    """Of a lattice."""
    equations_of_motion: ClassVar[Callable[..., Any]]
    """Its equations of motion at values of its parameters; see `dynamics.evolve`."""
    family_coordinates: ClassVar[Callable[..., Any]]
    """Coordinates of the family that grows from a linear mode; see `follow_family`."""
    linear_frequencies: ClassVar[Callable[..., Any]]
    """Frequencies of its linear modes; see `zero.model_coordinates`."""
    linear_spectrum: ClassVar[Callable[..., Any]]
    """Its linear modes; see `zero.model_coordinates`."""

    family_equations: ClassVar[Callable[..., Any]]
    """The equations of its families with parameters free; see `optimise`."""

    def tunable_model(self) -> OdeModel:
        """The model with its parameters as symbols, as every other model hands it in: itself."""
        return self

    @property
    def rounding(self) -> float:
        """Relative error of the right-hand side's values: that of doubles, unless a model declares a larger one."""
        return EPSILON

    @property
    def programs(self) -> tuple[Program, ...]:
        """Functions in its equations that are no expressions, and take many places in one call."""
        return ()

    @cached_property
    def jumps(self) -> Jumps:
        """Where the right-hand side jumps."""
        return Jumps(self)

    def field_at(self, time: Any, state: Any, parameters: Any) -> Expression:
        """The vector field at expressions, written out: derivatives that are not used do not enter a program."""
        return self.vector_field.call([time, state, parameters], True, False)[0]

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
        return self._at_end(0, expression)

    def end(self, expression: Expression) -> Expression:
        """An expression in the state, taken at the end of the interval of a boundary-value problem."""
        return self._at_end(1, expression)

    def _at_end(self, which: int, expression: Expression) -> Expression:
        if isinstance(expression, ca.SX) and expression.is_scalar() and expression.is_symbolic():  # as most are
            return self._at_ends.get(expression.element_hash(), (expression, expression))[which]
        return ca.substitute(expression, self.full_state, self.ends[which])

    @cached_property
    def _at_ends(self) -> dict[int, tuple[ca.SX, ca.SX]]:
        """Symbols of each component of the state at the start and at the end, by the key of its own."""
        keys = (entry.element_hash() for entry in self.full_state.elements())
        return dict(zip(keys, zip(*(end.elements() for end in self.ends), strict=True), strict=True))

    def rhs_and_jacobian(self) -> ca.Function:
        """Function (state, parameters) -> (rhs, sparse d rhs/d state, d rhs/d parameters)."""
        arguments = [self.state, self.parameters]
        results = [self.rhs, ca.jacobian(self.rhs, self.state), ca.densify(ca.jacobian(self.rhs, self.parameters))]
        return ca.Function("rhs", arguments, results, ["state", "p"], ["f", "df_dstate", "df_dp"])

    def first_order(self) -> OdeModel:
        """The same model with positions and velocities as one state of first order."""
        if self.order == 1:
            return self
        return self._changed(state=self.full_state, rhs=self.full_rhs, order=1, velocity=None, output_scale=None)

    def _changed(self, **changes: Any) -> OdeModel:
        """The equations and declarations with other fields, not checked again."""
        own = {entry.name: getattr(self, entry.name) for entry in fields(OdeModel)} | {"rhs": self.given_rhs}
        return OdeModel(**own | changes | {"checked": False})

    @property
    def given_rhs(self) -> Expression:
        """The right-hand side f of x' = f or M x' = f."""
        return self.rhs if self.implicit is None else self.implicit.right

    def decaying(self, rate: Callable[[Implicit], float]) -> OdeModel:
        """The model whose algebraic equations, where it has some, are met at a rate unless it has one of its own."""
        if self.implicit is None or not self.implicit.conditions or self.decay is not None:
            return self
        changed = self._changed(decay=rate(self.implicit))
        changed.__dict__["ends"] = self.ends  # in which conditions of boundary-value problems are written
        return changed

    def with_parameter(self, name: str, expression: Expression) -> tuple[OdeModel, Expression]:
        """A plain model with one more parameter, its last, that picks an orbit; and the expression in its symbols."""
        count = int(self.parameters.numel())
        p = type(self.state).sym("p", count + 1)

        def moved(value: Any) -> Any:
            if isinstance(value, Mapping):
                return {key: moved(each) for key, each in value.items()}
            return None if value is None else ca.substitute(value, self.parameters, p[:count])

        fields_in_p = ("outputs", "conserved", "symmetries", "hamiltonian", "mass")
        changes = {field: moved(getattr(self, field)) for field in fields_in_p} | {"rhs": moved(self.given_rhs)}
        changes |= {"parameters": p, "parameter_labels": (*self.parameter_names, name)}
        return self._changed(**changes, normalisation=None, nominal=None), moved(expression)

    def check_symmetries(self, trials: int = 5, seed: int = 0) -> None:
        """Evaluate the declared symmetries and the conserved quantity at random points.

        Raises ValueError naming the first declaration that does not hold.
        """
        check_symmetries(self, trials, seed)

    def with_nominal(self, nominal: tuple[float, ...]) -> OdeModel:
        """The equations and declarations with other usual values of the parameters, not checked again."""
        return self._changed(nominal=nominal)

    def __reduce__(self) -> str | tuple[Any, ...]:
        """Pickled as `save_model` writes it, subclasses too, so that processes can share it."""
        return reduced(self, OdeModel)


# A model of second order in displacements from a state at which it rests ----------------------------------------------

GAUSS_NODES = 4  # of Gauss and Legendre's formula: right to rounding for displacements below SMALL_DISPLACEMENT
SMALL_DISPLACEMENT = 0.05  # above it a difference of forces keeps its digits
NEWTON_STEPS = 3  # of Newton's method from a state that is known well


def centred_model(model: OdeModel, rest: NDArray[np.float64], parameters: Mapping[str, float]) -> OdeModel:
    """The model about rest at other positions than 0.

    Arguments:
        model: of second order, not forced.
        rest: positions at which it rests, shape (positions,); rounding is all that is left of an error of 1e-5.
        parameters: values of all its parameters.

    Returns:
        A model without parameters whose positions are the displacements from `rest`.

    Raises:
        ValueError: the model is of first order, or forced.
    """
    if model.order != 2 or model.forced:
        kind = "is forced" if model.forced else "is of first order"
        raise ValueError(f"model: given {model.name}, which {kind}; accepted: one of second order, without time")
    values = ca.DM([parameters[name] for name in model.parameter_names])
    force = ca.Function("f", [model.state], [ca.substitute(model.rhs, model.parameters, values)])
    slope = force.jacobian()
    y = np.asarray(rest, dtype=float)
    for _ in range(NEWTON_STEPS):
        y = y - np.linalg.lstsq(np.array(slope(y, 0)), np.array(force(y)).ravel(), rcond=1e-12)[0]
    moved = ca.DM(y) + model.state
    keeps = model.reversal == (1,) * model.size + (-1,) * model.size
    energy = None
    if model.hamiltonian is not None:
        energy = ca.substitute(model.hamiltonian, ca.vertcat(model.state, model.parameters), ca.vertcat(moved, values))
    return OdeModel(
        f"{model.name} about rest", model.state, _displaced(force, y, model.state), order=2, velocity=model.velocity,
        reversal=model.reversal if keeps else None, hamiltonian=energy, state_labels=model.state_labels, checked=False,
    )  # fmt: skip


def _displaced(force: ca.Function, rest: NDArray[np.float64], u: ca.SX) -> ca.SX:
    """f(rest + u) - f(rest) without cancellation at small u: by homogeneous parts, or the mean of its slope times u."""
    there = force(ca.DM(rest) + u)
    try:
        parts = homogeneous_parts(there, u)
        return ca.SX(sum((part for degree, part in parts.items() if degree), ca.SX.zeros(u.numel())))
    except NotPolynomialError:
        pass
    nodes, weights = np.polynomial.legendre.leggauss(GAUSS_NODES)
    y = ca.SX.sym("y", u.numel())
    along = ca.Function("along", [y, u], [ca.jtimes(force(y), y, u)])
    terms = (w / 2 * along(ca.DM(rest) + (s + 1) / 2 * u, u) for s, w in zip(nodes, weights, strict=True))
    mean = sum(terms, ca.SX.zeros(u.numel()))
    return ca.SX(ca.if_else(ca.mmax(ca.fabs(u)) < SMALL_DISPLACEMENT, mean, there - force(ca.DM(rest))))


def model_of(given: Any) -> OdeModel:
    """The equations of a model with its parameters as symbols; raises TypeError for what is no model."""
    tunable = None if isinstance(given, type) else getattr(given, "tunable_model", None)
    model = given if tunable is None else tunable()
    if not isinstance(model, OdeModel):
        raise TypeError(f"model: given {short_repr(given)}; accepted: an OdeModel or a Chain")
    return model
