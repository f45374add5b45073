"""The orbits of a search in odd cosines as CasADi expressions: their equations, and quantities by name.

An orbit of a mode's family is y_n(t) = scale_n q_n(theta), theta = Omega t, with sum_n w_n q_n(0)^2 = 1: the amplitude
is scaled out, so that the sum of y_n(0)^2 is S. q is given by its values at the nodes of the odd cosines on a quarter
of the period (bvp.trigonometric), and Omega^2 is an unknown.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from casadi_skin.follow.follow import follow_family
from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain, check_no_parameters
from casadi_skin.model.arguments import accepted_names, short_repr
from casadi_skin.model.ode import OdeModel
from casadi_skin.zero.cosines import cosine_matrix, second_derivative_matrix
from casadi_skin.zero.family import FamilyRequest
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statement import named_values

# Attributes of `Observables` that are no quantities.
RESERVED_NAMES = ("y0", "slope", "value", "names", "is_shared", "at_rest", "state", "nodes", "Omega_squared", "tangent",
            "unknowns", "residual", "harmonics", "alpha_n")  # fmt: skip
QUANTITIES: Mapping[str, Callable[[Observables], ca.SX]] = MappingProxyType(
    {
        "S": lambda o: o._equations.S,
        "Omega": lambda o: ca.sqrt(o.Omega_squared),
        "period": lambda o: 2 * np.pi / o.Omega,
        "participation": lambda o: 1 / ca.sumsqr(o._equations.weights * o._rest**2),
        "Omega_slope": lambda o: o.slope(o.Omega),
        "energy": lambda o: o.at_rest(o._equations.energy),
        "energy_slope": lambda o: o.slope(o.energy),
    }
)


@dataclass(frozen=True)
class FreeNumber:
    """A parameter that may be free: its own value, its range where no bound is given, names of its numbers."""

    value: float
    lower: float
    upper: float
    names: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class FamilyEquations:
    """The equations of a family at an amplitude S: numbers, or symbols where parameters are free.

    Attributes:
        state: q, a symbol of shape (components, 1).
        S: total amplitude, a symbol.
        acceleration: q'' in these and the parameters, shape of `state`.
        weights: w_n, shape of `state`.
        energy: energy at rest in these, or None where nothing is conserved.
        shared: quantities of the model alone, by name.
        own: functions of the orbit's observables, by name.
    """

    state: ca.SX
    S: ca.SX
    acceleration: ca.SX
    weights: ca.SX
    energy: ca.SX | None
    shared: Mapping[str, ca.SX]
    own: Mapping[str, Callable[[Observables], ca.SX]] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all quantities."""
        every = (name for name in QUANTITIES if self.energy is not None or not name.startswith("energy"))
        return tuple(dict.fromkeys((*every, *self.shared, *self.own)))


class Observables:
    """One orbit of a search; its quantities are attributes, CasADi expressions for objectives and constraints.

    Attributes:
        S: total amplitude, the sum of y_n^2 at the phase where all velocities vanish.
        Omega, period: frequency, and 2 pi/Omega.
        energy: Hamiltonian; of a chain that of the gauge.
        participation: (sum of y_n^2)^2 / sum of y_n^4 at that phase, from 1 to N.
        Omega_slope, energy_slope: derivatives by S along the family at fixed parameters.
        y0: displacements at that phase, shape (components, 1).

    Parameters of the model and its own quantities are attributes as well (of a chain those of `names.NAMED` and
    `alpha_n`, shape (sites, 1)), and `value(name)` gives the same. `slope(expression)` is its derivative by S along the
    family. Slopes bring the tangent of the family into the problem as unknowns, so that they have exact second
    derivatives; where none is used there is no tangent.
    """

    _equations: FamilyEquations
    _rest: ca.SX
    Omega_squared: ca.SX

    def __init__(self, equations: FamilyEquations, harmonics: int) -> None:
        self._equations, self.harmonics = equations, harmonics
        self.nodes = ca.SX.sym("q", equations.state.numel(), harmonics)
        self.Omega_squared = ca.SX.sym("Omega2")
        self.tangent: ca.SX | None = None
        self._rest = ca.mtimes(self.nodes, ca.DM((2.0 / harmonics) * cosine_matrix(harmonics).sum(axis=0)))

    def __getattr__(self, name: str) -> ca.SX:
        return self.value(name)

    def value(self, name: str) -> ca.SX:
        """The quantity of a name; raises AttributeError, with the nearest known name, for another."""
        equations = self.__dict__["_equations"]
        if name in equations.shared:
            return ca.SX(equations.shared[name])
        if name in equations.own:
            return equations.own[name](self)
        if name not in equations.names:
            raise AttributeError(f"observable: given {name}; {accepted_names(name, equations.names)}")
        return QUANTITIES[name](self)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities."""
        return self._equations.names

    def is_shared(self, name: str) -> bool:
        """Whether a quantity is one of the model alone, the same for all orbits of a search."""
        return name in self._equations.shared

    # Equations ------------------------------------------------------------------------------------------------------

    @property
    def state(self) -> ca.SX:
        """Unknowns (q ordered by component, then node; Omega^2), shape (components harmonics + 1, 1)."""
        return ca.vertcat(ca.vec(self.nodes.T), self.Omega_squared)

    def _residual(self) -> ca.SX:
        """Omega^2 q''(theta) less the acceleration at the nodes, and the normalisation of q; shape of `state`."""
        inertia = self.Omega_squared * ca.mtimes(self.nodes, ca.DM(second_derivative_matrix(self.harmonics)).T)
        force = ca.horzcat(*(self._at(self._equations.acceleration, self.nodes[:, k]) for k in range(self.harmonics)))
        return ca.vertcat(ca.vec((inertia - force).T), ca.dot(self._equations.weights, self._rest**2) - 1)

    def _at(self, expression: ca.SX, state: ca.SX) -> ca.SX:
        return ca.substitute(expression, self._equations.state, state)

    def at_rest(self, expression: ca.SX) -> ca.SX:
        """An expression in the equations' state, at the phase where all velocities vanish."""
        return self._at(expression, self._rest)

    @property
    def unknowns(self) -> ca.SX:
        """State and, where a slope is used, tangent (dq/dS, dOmega^2/dS)."""
        return self.state if self.tangent is None else ca.vertcat(self.state, self.tangent)

    def residual(self) -> ca.SX:
        """The orbit's equations and those of its tangent, as many as unknowns."""
        residual = self._residual()
        return residual if self.tangent is None else ca.vertcat(residual, self.slope(residual))

    def slope(self, expression: ca.SX) -> ca.SX:
        """d(expression)/dS along the family at fixed parameters; shape of the expression."""
        if self.tangent is None:
            self.tangent = ca.SX.sym("tangent", self.state.numel())
        return ca.jtimes(ca.SX(expression), ca.vertcat(self.state, self.S), ca.vertcat(self.tangent, 1))

    @property
    def y0(self) -> ca.SX:
        """Displacements at the phase where all velocities vanish, shape (components, 1)."""
        return ca.sqrt(self.S) * ca.sqrt(self._equations.weights) * self._rest


# The family of one mode, with parameters free -------------------------------------------------------------------------


@dataclass(frozen=True)
class ModelFamily:
    """One mode's family of a model of second order: its equations at any values of its parameters, and its members.

    Modes are by ascending linear frequency from 1; `values` are those of all parameters.
    """

    model: Any
    mode: int = 1
    values: Mapping[str, float] = field(default_factory=dict, hash=False)
    method: ClassVar[Mapping[str, Any]] = {"corrector": "newton"}  # of `follow_family`, for members

    @property
    def size(self) -> int:
        """Number of components."""
        return int(self.model.size)

    @property
    def columns(self) -> tuple[str, ...]:
        """Parameters that tables show."""
        return tuple(self.model.parameter_names)

    @property
    def free(self) -> Mapping[str, FreeNumber]:
        """Parameters that may be free."""
        return {name: FreeNumber(value, -math.inf, math.inf, (name,)) for name, value in self.values.items()}

    def limited(self, bounds: Mapping[str, tuple[float, float]]) -> ModelFamily:
        """The family for parameters within bounds; raises ValueError for bounds that cannot be."""
        return self

    def equations(self, values: Mapping[str, ca.SX], S: ca.SX) -> FamilyEquations:
        """The equations of an orbit; parameters that are missing have the model's own values."""
        model, q, scale = self.model, ca.SX.sym("q", self.size), ca.sqrt(S)
        parameters = ca.vertcat(*(values.get(name, ca.SX(value)) for name, value in self.values.items()))
        energy = [] if model.hamiltonian is None else [model.hamiltonian]
        function = model.function("at_rest", model.rhs, *model.outputs.values(), *energy)
        rest = ca.vertcat(scale * q, ca.SX.zeros(self.size))
        rhs, *others = function.call([0.0, rest, parameters], True, False)
        outputs = dict(zip(model.outputs, others, strict=False))
        return FamilyEquations(
            state=q,
            S=S,
            acceleration=rhs / scale,
            weights=ca.SX.ones(self.size),
            energy=others[-1] if energy else None,
            shared=dict(zip(self.values, ca.vertsplit(parameters), strict=True)) if self.values else {},
            own={name: partial(Observables.at_rest, expression=e) for name, e in outputs.items()},
        )

    def at(self, values: Mapping[str, Any]) -> Any:
        """The model with these parameters; None where it is of no kind that has families."""
        return self.model.with_nominal(tuple(float(values.get(name, value)) for name, value in self.values.items()))

    def scale(self, values: Mapping[str, Any], S: float) -> Array:
        """Factors that make displacements of q, shape (components,)."""
        return np.full(self.size, math.sqrt(S))

    def plain(self, values: Mapping[str, Any]) -> OdeModel:
        """The equations of q at these parameters, with S as the parameter that is left."""
        S, n = ca.SX.sym("S"), self.size
        equations = self.equations({name: ca.SX(value) for name, value in values.items()}, S)
        normalisation = ca.dot(equations.weights, equations.state**2) - 1
        return OdeModel(
            "orbit", equations.state, equations.acceleration, S, 2, ca.SX.sym("v", n),
            reversal=(1,) * n + (-1,) * n, half_period=(-1,) * (2 * n), normalisation=normalisation, checked=False,
        )  # fmt: skip

    def members(
        self, values: Mapping[str, Any], amplitudes: Sequence[float], options: Mapping[str, Any]
    ) -> list[Orbit] | None:
        """The orbits at amplitudes, None where `at` is None. Raises ValueError and ArithmeticError."""
        at, model = sorted(set(amplitudes)), self.at(values)
        if model is None:
            return None
        branch = follow_family(model, self.mode, at[-1], at=at, **{**self.method, **options})
        return [branch.at(S=S) for S in amplitudes]


# The family of one mode of a chain, in the gauge, with gamma, alpha, g or the stiffness of every site free ------------

STEEPEST_GAMMA = 0.99  # |gamma| where no bound is given: beyond it the band is nearly a point


@dataclass(frozen=True)
class ChainFamily(ModelFamily):
    """One mode's family of a chain; `mirrored` says that modes lean to the first site (gamma <= 0)."""

    model: Chain
    mirrored: bool = False
    method: ClassVar[Mapping[str, Any]] = {"tail": "full"}

    @property
    def size(self) -> int:
        return self.model.sites

    @property
    def columns(self) -> tuple[str, ...]:
        return ("gamma", "alpha", "g")

    @property
    def free(self) -> Mapping[str, FreeNumber]:
        chain = self.model
        gammas = (0.0, STEEPEST_GAMMA) if chain.gamma >= 0 else (-STEEPEST_GAMMA, 0.0)
        signs = (0.0, math.inf) if chain.g > 0 else (-math.inf, 0.0)
        each = tuple(f"alpha_{n}" for n in range(1, chain.sites + 1))
        return {
            "gamma": FreeNumber(chain.gamma, *gammas, ("gamma",)),
            "alpha": FreeNumber(chain.alpha, -math.inf, math.inf, ("alpha",)),
            "g": FreeNumber(chain.g, *signs, ("g",)),
            "alpha_n": FreeNumber(chain.alpha, -math.inf, math.inf, each),
        }

    def limited(self, bounds: Mapping[str, tuple[float, float]]) -> ChainFamily:
        if "alpha" in bounds and "alpha_n" in bounds:
            raise ValueError("free: given alpha and alpha_n; accepted: one of them")
        lower, upper = bounds.get("gamma", (self.model.gamma, self.model.gamma))
        if max(abs(lower), abs(upper)) >= 1:
            raise ValueError(f"gamma: given {short_repr([lower, upper])}; accepted in a search: |gamma| < 1")
        if lower < 0 < upper:
            given, reason = short_repr([lower, upper]), "a mirrored chain has -gamma, and its gauge is another"
            raise ValueError(f"bounds[gamma]: given {given}; accepted: bounds on one side of 0 ({reason})")
        low, high = bounds.get("g", (self.model.g, self.model.g))
        if not (low >= 0 and high > 0 if self.model.g > 0 else low < 0 and high <= 0):
            side = ">= 0" if self.model.g > 0 else "<= 0"
            raise ValueError(f"bounds[g]: given {short_repr([low, high])}; accepted: bounds {side}, as the chain's g")
        return replace(self, mirrored=upper <= 0 if "gamma" in bounds else self.model.gamma < 0)

    def equations(self, values: Mapping[str, ca.SX], S: ca.SX) -> FamilyEquations:
        chain, N = self.model, self.model.sites
        gamma, g = values.get("gamma", ca.SX(chain.gamma)), values.get("g", ca.SX(chain.g))
        alpha_n = values.get("alpha_n", ca.repmat(values.get("alpha", ca.SX(chain.alpha)), N, 1))
        alpha, coupling = ca.sum1(alpha_n) / N, ca.sqrt((1 - gamma) * (1 + gamma))
        size = -gamma if self.mirrored else gamma
        powers = ca.DM([*(range(N) if self.mirrored else reversed(range(N)))])
        w, q = ((1 - size) / (1 + size)) ** powers, ca.SX.sym("q", N)
        zero = ca.SX.zeros(1)
        beside = ca.vertcat(zero, q[:-1]) + ca.vertcat(q[1:], zero) if N > 1 else zero
        elastic = ca.dot(q, (2 + alpha_n) * q) / 2 - coupling * ca.dot(q[1:], q[:-1])
        log_amplification = (N - 1) * ca.atanh(size)
        upper, lower = ca.sqrt(2 + alpha + 2 * coupling), ca.sqrt(alpha + 2 * gamma**2 / (1 + coupling))
        shared = {
            "gamma": gamma,
            "alpha": alpha,
            "g": g,
            "alpha_n": alpha_n,
            "upper_cutoff": upper,
            "lower_cutoff": lower,
            "amplification": ca.exp(log_amplification),
            "log_amplification": log_amplification,
            "roughness": ca.sumsqr(alpha_n[1:] - alpha_n[:-1]),
        }
        return FamilyEquations(
            state=q,
            S=S,
            acceleration=-(2 + alpha_n) * q + coupling * beside - g * S * w * q**3,
            weights=w,
            energy=S * (elastic + g * S * ca.dot(w, q**4) / 4),
            shared=shared,
            own={"above_band": lambda o: o.Omega - upper, "below_band": lambda o: lower - o.Omega},
        )

    def at(self, values: Mapping[str, Any]) -> Chain | None:
        uniform = len(set(np.atleast_1d(values.get("alpha_n", 0.0)).tolist())) == 1
        return self._mean(values) if uniform else None

    def _mean(self, values: Mapping[str, Any]) -> Chain:
        """The chain with the mean stiffness."""
        alpha = float(np.mean(values.get("alpha_n", values.get("alpha", self.model.alpha))))
        gamma, g = (float(values.get(name, getattr(self.model, name))) for name in ("gamma", "g"))
        return replace(self.model, alpha=alpha, gamma=gamma, g=g)

    def scale(self, values: Mapping[str, Any], S: float) -> Array:
        return np.asarray(np.sqrt(S) * self._mean(values).rho)


def chain_family(chain: Chain, mode: int | str | None, parameters: Mapping[str, float] | None = None) -> ChainFamily:
    """Of the end breather's mode unless one is given; raises ValueError for a chain that a search does not take."""
    check_no_parameters(parameters)
    if chain.infinite:
        raise ValueError("chain: given an infinite chain; accepted: a whole number of sites")
    if chain.g == 0:
        raise ValueError("g: given 0; accepted: not 0 (every orbit would be a linear mode)")
    return ChainFamily(chain, chain.mode_number(mode if mode is not None else "last" if chain.g > 0 else "first"))


def model_family(model: OdeModel, mode: int | str | None, parameters: Mapping[str, float] | None) -> ModelFamily:
    """Of the first mode unless one is given; raises ValueError for a model without such families, or without it."""
    even = model.reversal == (1,) * model.size + (-1,) * model.size
    if model.order != 2 or not even or model.half_period != (-1,) * model.full_size or model.forced:
        accepted = "a guess of an orbit, or a model of second order that declares reversal with even positions and "
        raise ValueError(f"guess: given none for {model.name}; accepted: {accepted}half_period with all signs -1")
    if model.normalisation is not None:
        accepted = "a model without: S is the sum of squares"
        raise ValueError(f"normalisation: given with {model.name}; accepted in a search: {accepted}")
    reserved = {*QUANTITIES, *RESERVED_NAMES} - ({"energy", "energy_slope"} if model.hamiltonian is None else set())
    for name in (*model.parameter_names, *model.outputs):
        if name in reserved:
            raise ValueError(f"{model.name}: given a parameter or output called {name}; accepted: other names")
    values = named_values(model, parameters)
    number = FamilyRequest(model, 1 if mode is None else mode, 1.0, parameters=values).mode
    return ModelFamily(model, int(number), values)
