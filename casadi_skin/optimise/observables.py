"""The orbits of a search in odd cosines as CasADi expressions: their equations, and quantities by name.

An orbit of a mode's family is y_n(t) = scale_n q_n(theta), theta = Omega t, with sum_n w_n q_n(0)^2 = 1: the amplitude
is scaled out, so that the sum of y_n(0)^2 is S. q is given by its values at the nodes of the odd cosines on a quarter
of the period (bvp.trigonometric), and Omega^2 is an unknown.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import casadi as ca
import numpy as np

from casadi_skin.model.arguments import accepted_names
from casadi_skin.zero.cosines import cosine_matrix, second_derivative_matrix

# Attributes of `Observables` that are no quantities.
RESERVED = ("y0", "slope", "value", "names", "is_shared", "at_rest", "state", "nodes", "Omega_squared", "tangent",
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
        return tuple(dict.fromkeys((*orbit_quantities(self.energy is not None), *self.shared, *self.own)))


def orbit_quantities(conservative: bool) -> tuple[str, ...]:
    """Names of the quantities that every orbit has; energy and its slope where one is conserved."""
    return (
        "S",
        "Omega",
        "period",
        "participation",
        "Omega_slope",
        *(("energy", "energy_slope") if conservative else ()),
    )


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
