"""The nonreciprocal Klein-Gordon chain y_n'' = a_- y_{n-1} - 2 y_n + a_+ y_{n+1} - alpha y_n - g y_n^3 (paper, Eq. 1).

Orbits are computed in the gauge y_n = rho_n eta_n (see theory.linear), where the flow is Hamiltonian, and with the
amplitude scaled out: eta = sqrt(S) q, q'' = -L q - (g S) w q^3, w = rho^2, sum_n w_n q_n(0)^2 = 1. Then S = ||y||^2
exactly, only the product g S appears, and the linear mode is the regular start S = 0 of its family.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from casadi_skin.lattice import closed_forms as linear
from casadi_skin.lattice.closed_forms import Array
from casadi_skin.lattice.declaration import FIXED, Bond, Declaration, Site
from casadi_skin.lattice.equations import LARGEST_LOG_WEIGHT
from casadi_skin.lattice.stiffness import stiffness
from casadi_skin.model.arguments import by_name, number, short_repr
from casadi_skin.model.expressions import expression
from casadi_skin.model.ode import OdeModel
from casadi_skin.model.polynomial import NotPolynomialError, polynomial_terms
from casadi_skin.model.result import WithVerbs
from casadi_skin.zero.model_coordinates import FIRST, LAST, LinearSpectrum, number_of_mode, of_norm_one


def _is_whole(number: object) -> bool:
    return isinstance(number, int | np.integer) and not isinstance(number, bool)


def check_no_parameters(given: Mapping[str, float] | None) -> None:
    """Raises ValueError for values of parameters that are given beside a chain, which has its own."""
    if by_name("parameters", given):
        raise ValueError(f"parameters: given {short_repr(given)}; accepted: with an OdeModel alone")


class WithOwnParameters(WithVerbs):
    """What every model has, as data of one whose parameters are its own: none of them is given a value beside it."""

    parameter_names: ClassVar[tuple[str, ...]] = ()
    place: ClassVar[str] = "site"
    forced: ClassVar[bool] = False
    normalisation: ClassVar[None] = None
    declaration: ClassVar[None] = None


@dataclass(frozen=True)
class Chain(WithOwnParameters):
    """A chain of `sites` oscillators with fixed ends; a_+- = 1 -+ gamma, |gamma| <= 1; dimensionless.

    `sites` may be `math.inf`: a chain whose other end is infinitely far from the edge that its modes lean to. It has
    its edge modes, "first" and "last", and no arrays over its sites. Raises ValueError when a parameter is out of
    range or not finite, TypeError when it is no number.
    """

    sites: int
    alpha: float
    gamma: float
    g: float
    name: ClassVar[str] = "chain"

    def __post_init__(self) -> None:
        endless = isinstance(self.sites, float) and self.sites == np.inf
        if not endless and (not _is_whole(self.sites) or self.sites < 1):
            raise ValueError(f"sites: given {short_repr(self.sites)}; accepted: a whole number >= 1, or inf")
        for name in ("alpha", "gamma", "g"):
            number(name, getattr(self, name))
        if abs(self.gamma) > 1:
            raise ValueError(
                f"gamma: given {self.gamma!r}; accepted: -1 <= gamma <= 1 (frequencies are complex beyond)"
            )

    @property
    def infinite(self) -> bool:
        """Whether the far end is infinitely far."""
        return self.sites == np.inf

    def mode_number(self, mode: int | str) -> int:
        """The number of a mode that may be named "first" or "last"; in an infinite chain these are 1 and -1.

        Raises ValueError for a mode that is not there.
        """
        if self.infinite:
            if not isinstance(mode, str | int) or mode not in (FIRST, LAST, 1, -1):
                raise ValueError(f"mode: given {short_repr(mode)}; accepted in an infinite chain: {FIRST}, {LAST}")
            return 1 if mode in (FIRST, 1) else -1
        return number_of_mode(mode, self.sites)

    @property
    def parameters(self) -> dict[str, float]:
        """Values of its parameters by name."""
        return {"alpha": self.alpha, "gamma": self.gamma, "g": self.g}

    @property
    def cell(self) -> tuple[list[Site], list[Bond]]:
        """Its cell as that of a `Lattice` or a `LongLattice` with the same parameters, bonds to the next cell."""
        return [Site("a", "alpha*y + g*y^3")], [Bond("a", "a", (1,), gain=("1 - gamma", "1 + gamma"))]

    # The gauge ------------------------------------------------------------------------------------------------------

    @property
    def coupling(self) -> float:
        """Coupling s = sqrt(1 - gamma^2) in the gauge."""
        return linear.gauge_coupling(self.gamma)

    @cached_property
    def log_rho(self) -> Array:
        """Logarithm of the gauge factor rho_n, shape (sites,); raises ValueError for an infinite chain."""
        if self.infinite:
            raise ValueError("sites: an infinite chain has no array over its sites")
        return linear.log_envelope(self.sites, self.gamma)

    @cached_property
    def rho(self) -> Array:
        """Gauge factor rho_n = y_n/eta_n <= 1, shape (sites,)."""
        return np.exp(self.log_rho)

    @cached_property
    def weights(self) -> Array:
        """Weights w_n = rho_n^2 of the cubic term and of S in the gauge, shape (sites,)."""
        return np.exp(2.0 * self.log_rho)

    # The linear chain -----------------------------------------------------------------------------------------------

    def linear_frequencies(self, parameters: Mapping[str, float] | None = None) -> Array:
        """Frequencies omega_j, j = 1..N, closed form, (sites,); raises ValueError where one does not oscillate."""
        if self.infinite:
            raise ValueError("linear_frequencies: given infinitely many sites; accepted: a number of sites")
        return np.array([self.linear_frequency(j) for j in range(1, self.sites + 1)])

    def linear_frequency(self, mode: int | str) -> float:
        """Frequency omega_j of one mode; raises ValueError for a mode that is not there or does not oscillate."""
        number = self.mode_number(mode)
        square = self.alpha + stiffness(self.sites, self.gamma, number)
        if square <= 0:
            raise ValueError(
                f"mode {mode} does not oscillate: omega^2 = {square:g}; accepted: alpha > {self.alpha - square:g}"
            )
        return math.sqrt(square)

    def band(self) -> tuple[float, float]:
        """Squared cutoffs (omega_min^2, omega_max^2) of the infinite chain's band."""
        return self.alpha + stiffness(math.inf, self.gamma, 1), self.alpha + stiffness(math.inf, self.gamma, 2)

    def right_eigenvector(self, mode: int) -> Array:
        """Right eigenvector of D in closed form, largest envelope 1, shape (sites,)."""
        return linear.right_eigenvector(self.sites, self.gamma, mode)

    def left_eigenvector(self, mode: int) -> Array:
        """Left eigenvector of D in closed form, largest envelope 1, shape (sites,)."""
        return linear.left_eigenvector(self.sites, self.gamma, mode)

    def linear_spectrum(self, parameters: Mapping[str, float] | None = None) -> LinearSpectrum:
        """Squared frequencies and modes in closed form; of an infinite chain the ends of its band alone."""
        if self.infinite:
            return LinearSpectrum(np.empty(0), self.band(), lambda _: np.empty(0), self.band())
        squares = linear.squared_frequency(self.sites, self.alpha, self.gamma, np.arange(1, self.sites + 1))
        ends = float(squares[0]), float(squares[-1])
        return LinearSpectrum(squares, ends, lambda j: of_norm_one(self.right_eigenvector(j)), self.band())

    @property
    def labels(self) -> tuple[tuple[str, float], ...]:
        """Symbols in TeX and values that distinguish chains, for titles."""
        return ("N", self.sites), (r"\alpha", self.alpha), (r"\gamma", self.gamma), ("g", self.g)

    def diagonalise(self) -> tuple[Array, Array]:
        """Squared frequencies (ascending) and right eigenvectors (columns) by diagonalisation in the gauge.

        Physical D is so far from normal that its own diagonalisation loses r^((N-1)/2) of the digits.
        """
        from scipy.linalg import eigh_tridiagonal

        values, vectors = eigh_tridiagonal(
            np.full(self.sites, 2.0 + self.alpha), np.full(self.sites - 1, -self.coupling)
        )
        return np.asarray(values, dtype=float), np.asarray(self.rho[:, None] * vectors)

    family_coordinates: ClassVar[Callable[..., Any]]
    """Coordinates of the family that grows from a linear mode to S = `amplitude_max`; see `follow_family`."""
    equations_of_motion: ClassVar[Callable[..., Any]]
    """The equations of motion with their gauge; see `dynamics.evolve`. Raises ValueError for an infinite chain."""
    family_equations: ClassVar[Callable[..., Any]]
    """The equations of its families with parameters free; see `optimise`."""
    threshold: ClassVar[Callable[..., float]]
    """S at which the end breather of the infinite chain is born: `casadi_skin.dynamics.resonances.threshold`."""
    threshold_gradient: ClassVar[Callable[..., Any]]
    """Its derivatives by alpha, gamma and g: `casadi_skin.dynamics.resonances.threshold_gradient`."""

    # CasADi expressions ---------------------------------------------------------------------------------------------

    def _model(
        self, name: str, symbols: tuple[ca.SX, ca.SX, ca.SX], bonds: tuple[Any, Any], onsite: tuple[Any, Any],
        weights: ca.SX | None = None, **more: Any,
    ) -> OdeModel:  # fmt: skip
        """q_n'' = left q_{n-1} + right q_{n+1} - stiffness q_n - cubic_n q_n^3 with fixed ends.

        With weights, in which the forces are a gradient, it has an energy. The symmetries hold by construction and are
        checked by tests, not at every making.

        Arguments:
            name: of the model.
            symbols: positions q, velocities and parameters.
            bonds: left and right.
            onsite: stiffness and cubic.
            weights: a column.
            more: arguments of `OdeModel`.
        """
        (q, v, parameters), (left, right), (stiffness, cubic) = symbols, bonds, onsite
        n, padded, energy = self.sites, ca.vertcat(0, q, 0), None
        force = -stiffness * q + left * padded[:-2] + right * padded[2:] - cubic * q**3
        if weights is not None:
            energy = ca.dot(weights, v**2 / 2 + stiffness * q**2 / 2 + cubic * q**4 / 4)
            energy -= right * ca.dot(weights[:-1] * q[:-1], q[1:])
        return OdeModel(
            name, q, force, parameters, 2, v, hamiltonian=energy, reversal=(1,) * n + (-1,) * n,
            half_period=(-1,) * (2 * n), checked=False, **more,
        )  # fmt: skip

    def physical_model(self) -> OdeModel:
        """The equations of motion in physical coordinates y, parameter g (paper, Eq. 1)."""
        y, v, g = ca.SX.sym("y", self.sites), ca.SX.sym("v", self.sites), ca.SX.sym("g")
        bonds = 1 + self.gamma, 1 - self.gamma
        return self._model("physical chain", (y, v, g), bonds, (2 + self.alpha, g), nominal=(self.g,))

    def tunable_model(self) -> OdeModel:
        """The equations of motion in physical coordinates y with parameters alpha, gamma and g (paper, Eq. 1)."""
        if self.infinite:
            raise ValueError("sites: given an infinite chain; accepted: a whole number >= 1")
        y, v = (ca.vertcat(*(ca.SX.sym(f"{x}_{n}") for n in range(1, self.sites + 1))) for x in "yv")
        alpha, gamma, g = (ca.SX.sym(name) for name in self.parameters)
        weights = None
        if -2.0 * float(np.min(self.log_rho)) <= LARGEST_LOG_WEIGHT:  # 1/rho^2 of the gauge, as in a lattice's energy
            ratio = (1 + gamma) / (1 - gamma) if self.gamma >= 0 else (1 - gamma) / (1 + gamma)
            powers = [ratio**n for n in range(self.sites)]
            weights = ca.vertcat(*(powers[::-1] if self.gamma >= 0 else powers))
        symbols, nominal = (y, v, ca.vertcat(alpha, gamma, g)), tuple(self.parameters.values())
        return self._model("chain", symbols, (1 + gamma, 1 - gamma), (2 + alpha, g), weights, nominal=nominal)

    def gauge_model(self) -> OdeModel:
        """The scaled equations q'' = -L q - kappa w q^3 in the gauge, parameter kappa = g S, with their Hamiltonian."""
        q, v, kappa = ca.SX.sym("q", self.sites), ca.SX.sym("v", self.sites), ca.SX.sym("kappa")
        w, bonds = ca.SX(self.weights), (self.coupling, self.coupling)
        return self._model(
            "gauge chain", (q, v, kappa), bonds, (2 + self.alpha, kappa * w), ca.SX.ones(self.sites),
            normalisation=ca.dot(w, q**2) - 1, output_scale=tuple(self.rho),
        )  # fmt: skip

    def variational_matrix(self, coordinates: str = "physical") -> ca.Function:
        """Function (y, g) -> Z, or in the "gauge" (q, kappa) -> W, sparse (2N, 2N) (paper, appendix).

        Z and W generate x' = Z x; W is similar to Z, and W = J times a symmetric matrix, which makes its flow
        symplectic (the appendix calls W itself symplectic).
        """
        if coordinates not in ("physical", "gauge"):
            raise ValueError(f"coordinates: given {short_repr(coordinates)}; accepted: physical, gauge")
        model = self.physical_model() if coordinates == "physical" else self.gauge_model()
        matrix = ca.jacobian(model.full_rhs, model.full_state)
        return ca.Function("variational", [model.state, model.parameters], [matrix], ["y", "p"], ["Z"])

    def dynamical_matrix(self) -> Array:
        """Dense D of omega^2 u = D u, shape (sites, sites), from the symbolic equations (paper, appendix)."""
        return np.array(0.0 - ca.DM(self.variational_matrix()(0, 0)))[self.sites :, : self.sites]


# Declared lattices that are the chain of the paper: they are solved in its coordinates, to the last digit alike -------


def declared_chain(declaration: Declaration, reversible: bool, values: Mapping[str, float]) -> Chain | None:
    """The chain that a lattice is at some values of its parameters.

    Arguments:
        declaration: of any lattice.
        reversible: whether it has neither damping nor drive.
        values: of all its parameters, by name.

    Returns:
        The chain with the same forces; None for any other lattice.

    Raises:
        ValueError: a formula is not finite at these values.
    """
    one = len(declaration.sites) == len(declaration.bonds) == 1 and declaration.boundary == (FIXED,)
    if not one or not reversible or declaration.differing:
        return None
    fields = ("site", "mass"), ("site", "onsite"), ("bond", "force"), ("bond", "gain 1"), ("bond", "gain 2")
    mass, onsite, force, *gains = (_powers(declaration, values, *field) for field in fields)
    along = declaration.bonds[0].offset[0]
    if mass != {0: 1.0} or force != {1: 1.0} or not set(onsite) <= {1, 3} or abs(along) != 1:
        return None
    right, left = (gain.get(0, 0.0) for gain in gains[::along])
    tried = (*values.values(), *(-value for value in values.values()), 0.5 * (left - right))
    gamma = next((value for value in tried if (1 - value, 1 + value) == (right, left)), None)  # none is rounded
    if gamma is None or not abs(gamma) < 1:
        return None
    return Chain(declaration.size, onsite.get(1, 0.0), gamma, onsite.get(3, 0.0))


def _powers(declaration: Declaration, values: Mapping[str, float], kind: str, field: str) -> dict[int, float]:
    """Coefficients of a formula by the power of its variable; {-1: nan} where it is no polynomial."""
    x = ca.SX.sym("x")
    known = {name: ca.SX(value) for name, value in values.items()} | {"y": x, "d": x}
    try:
        terms = polynomial_terms(expression(declaration.formulas[kind, 0, field], known), x, ca.SX.sym("p"))
    except NotPolynomialError:
        return {-1: float("nan")}
    found = {term.degree: float(term.coefficients[0]) for term in terms}
    if not all(map(math.isfinite, found.values())):
        text = declaration.formulas[kind, 0, field].text
        given = f'{kind} 1 {field}: given "{text}", in which a value is not finite'
        raise ValueError(f"{given}; accepted: formulas and values of parameters that are finite")
    return found
