"""One mode's family with its parameters free: its equations, quantities by name, and an orbit with its derivatives.

An orbit of a mode's family is y_n(t) = scale_n q_n(theta), theta = Omega t, with sum_n w_n q_n(0)^2 = 1: the amplitude
is scaled out, so that the sum of y_n(0)^2 is S. Unknowns z = (q at the nodes of H odd cosines, Omega, S) solve

    R(z; p) = (q'' - f(q; S, p)/Omega^2, sum_n w_n q_n(0)^2 - 1) = 0,    p the parameters of the model.

With J = dR/dz closed by the row that holds S, derivatives along the family and by a parameter are

    J z_S = (0, 1),    J z_p = -(R_p, 0),    J z_Sp = -(D^2 R [(z_S, 0), (z_p, 1)], 0),

one matrix for all of them: the derivative by p of a slope dQ/dS is the slope of dQ/dp.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import casadi as ca
import numpy as np

from casadi_skin.follow.solution import Orbit
from casadi_skin.lattice.chain import Chain
from casadi_skin.model.arguments import accepted_names, short_repr
from casadi_skin.model.ode import OdeModel
from casadi_skin.search.cosine_orbit import CosineOrbit
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.cosines import CosineEquations, TrigonometricProblem, quarter_phases
from casadi_skin.zero.problem import Array, Buffers, Solve

HARMONICS_OFFERED = (6, 8, 10, 12, 15, 18, 24, 32, 48, 64, 96)
SMALLEST_S = 1e-6  # of that of the start, where no lower bound is given
STEEPEST_GAMMA = 0.99  # |gamma| where no bound is given: beyond it the band is nearly a point
# Attributes that are no quantities.
RESERVED_NAMES = ("y0", "slope", "value", "names", "symbols", "has_slopes", "equations")
NEWTON_SHRINK = 0.5  # of a step, to the next: a design that needs more is too far from the last one
LARGEST_MOVE = 0.5  # of q and Omega, relative, from one design to the next: beyond it may be another family


# The equations of a family, of a chain and of a model of second order -------------------------------------------------


@dataclass(frozen=True, eq=False)
class FamilyEquations:
    """The equations of a family and its quantities in symbols.

    Attributes:
        model: the chain or the model.
        q, Omega, S: symbols; q of shape (components, 1), in quantities at the phase where all velocities vanish.
        parameters: symbols by name.
        force: Omega^2 q'' in these, shape of `q`.
        weights: w_n, shape of `q`.
        quantities: of the orbit, by name; arrays among them.
    """

    model: Any
    q: ca.SX
    Omega: ca.SX
    S: ca.SX
    parameters: Mapping[str, ca.SX]
    force: ca.SX
    weights: ca.SX
    quantities: Mapping[str, ca.SX]

    @property
    def numbers(self) -> ca.SX:
        """The parameters, a column."""
        return ca.vertcat(ca.SX(0, 1), *self.parameters.values())

    @cached_property
    def y0(self) -> ca.SX:
        """Displacements at the phase where all velocities vanish, shape of `q`."""
        return ca.sqrt(self.S * self.weights) * self.q

    def at(self, values: Mapping[str, float]) -> Any:
        """The chain or the model at other parameters; None of a chain whose sites differ."""
        if not isinstance(self.model, Chain):
            return self.model.with_nominal(tuple(values[name] for name in self.model.parameter_names))
        gamma, g, *alphas = values.values()
        return replace(self.model, gamma=gamma, g=g, alpha=alphas[0]) if len(set(alphas)) == 1 else None

    def scale(self, S: float, numbers: Array) -> Array:
        """Factors that make displacements of q, shape (components,)."""
        scale = ca.sqrt(self.S * self.weights)
        return np.array(ca.Function("scale", [self.S, self.numbers], [ca.densify(scale)])(S, numbers)).ravel()

    @cached_property
    def forms(self) -> tuple[ca.Function, ca.Function]:
        """Of force and sum of w q^2, functions of (q, (S, p)) and two directions: value, D u, D v and D^2 [u, v]."""
        here, found = [self.q, ca.vertcat(self.S, self.numbers)], list[ca.Function]()
        at = ca.vertcat(*here)
        for result in (self.force, ca.dot(self.weights, self.q**2)):
            u, v = ([ca.SX.sym(name, place.numel()) for place in here] for name in "uv")
            one, other = (ca.jtimes(result, at, ca.vertcat(*way)) for way in (u, v))
            both = ca.jtimes(one, at, ca.vertcat(*v))
            found.append(ca.Function("forms", [*here, *u, *v], [ca.densify(r) for r in (result, one, other, both)]))
        return found[0], found[1]


def common_quantities(q: ca.SX, Omega: ca.SX, S: ca.SX, weights: ca.SX, energy: ca.SX | None) -> dict[str, ca.SX]:
    """The quantities of every family."""
    found = {"S": S, "Omega": Omega, "period": 2 * np.pi / Omega, "participation": 1 / ca.sumsqr(weights * q**2)}
    return found | ({} if energy is None else {"energy": energy})


def model_equations(model: OdeModel, over: Sequence[str]) -> FamilyEquations:
    """Of a model; raises ValueError for one without such families, or with names that quantities have."""
    n, even = model.size, model.reversal == (1,) * model.size + (-1,) * model.size
    if model.order != 2 or not even or model.half_period != (-1,) * model.full_size or model.normalisation is not None:
        accepted = "one of second order that declares reversal with even positions and half_period with all signs -1"
        raise ValueError(f"of: given an orbit of {model.name}; accepted in a family: {accepted}, and no normalisation")
    q, Omega, S = ca.SX.sym("q", n), ca.SX.sym("Omega"), ca.SX.sym("S")
    parameters = {name: ca.SX.sym(name) for name in model.parameter_names}
    energy = [] if model.hamiltonian is None else [model.hamiltonian]
    function = model.function("at_rest", model.rhs, *model.outputs.values(), *energy)
    rest = ca.vertcat(ca.sqrt(S) * q, ca.SX.zeros(n))
    rhs, *others = function.call([0.0, rest, ca.vertcat(ca.SX(0, 1), *parameters.values())], True, False)
    weights = ca.SX.ones(n)
    quantities = common_quantities(q, Omega, S, weights, others[-1] if energy else None)
    for name in (*parameters, *model.outputs):
        if name in (*quantities, *RESERVED_NAMES):
            raise ValueError(f"{model.name}: given a parameter or output called {name}; accepted: other names")
    quantities |= dict(zip(model.outputs, others, strict=False)) | parameters
    return FamilyEquations(model, q, Omega, S, parameters, rhs / ca.sqrt(S), weights, quantities)


def chain_equations(chain: Chain, over: Sequence[str]) -> FamilyEquations:
    """Of a chain in its gauge, with one stiffness a site where `over` has one; raises ValueError for g = 0."""
    if chain.g == 0:
        raise ValueError("g: given 0; accepted: not 0 (every orbit would be a linear mode)")
    N, q, Omega, S = chain.sites, ca.SX.sym("q", chain.sites), ca.SX.sym("Omega"), ca.SX.sym("S")
    each = any(name.startswith("alpha_") for name in over)
    own = [f"alpha_{n}" for n in range(1, N + 1)] if each else ["alpha"]
    parameters = {name: ca.SX.sym(name) for name in ("gamma", "g", *own)}
    gamma, g, *alphas = parameters.values()
    alpha_n = ca.vertcat(*alphas) if each else ca.repmat(alphas[0], N, 1)
    alpha, coupling = ca.sum1(alpha_n) / N, ca.sqrt((1 - gamma) * (1 + gamma))
    size, powers = (gamma, ca.DM([*reversed(range(N))])) if chain.gamma >= 0 else (-gamma, ca.DM([*range(N)]))
    w, zero = ((1 - size) / (1 + size)) ** powers, ca.SX.zeros(1)
    beside = ca.vertcat(zero, q[:-1]) + ca.vertcat(q[1:], zero) if N > 1 else zero
    elastic = ca.dot(q, (2 + alpha_n) * q) / 2 - coupling * ca.dot(q[1:], q[:-1])
    log_amplification = (N - 1) * ca.atanh(size)
    upper, lower = ca.sqrt(2 + alpha + 2 * coupling), ca.sqrt(alpha + 2 * gamma**2 / (1 + coupling))
    quantities = {
        **common_quantities(q, Omega, S, w, S * (elastic + g * S * ca.dot(w, q**4) / 4)),
        "gamma": gamma,
        "alpha": alpha,
        "g": g,
        "alpha_n": alpha_n,
        "upper_cutoff": upper,
        "lower_cutoff": lower,
        "above_band": Omega - upper,
        "below_band": lower - Omega,
        "amplification": ca.exp(log_amplification),
        "log_amplification": log_amplification,
        "roughness": ca.sumsqr(alpha_n[1:] - alpha_n[:-1]),
    }
    force = -(2 + alpha_n) * q + coupling * beside - g * S * w * q**3
    return FamilyEquations(chain, q, Omega, S, parameters, force, w, quantities | parameters)


@dataclass(frozen=True)
class FreeNumber:
    """A parameter that designs may change: its value, its range where no bound is given, names of several numbers."""

    value: float
    lower: float = -math.inf
    upper: float = math.inf
    several: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FamilyStart:
    """An orbit of a family that designs start from, which is computed when it is needed.

    Attributes:
        model: the chain or the model.
        S, parameters: of the orbit.
        orbit: it, without arguments.
    """

    model: Any
    S: float
    parameters: Mapping[str, float]
    orbit: Callable[[], Orbit]

    @classmethod
    def of(cls, orbit: Orbit) -> FamilyStart:
        """That is known."""
        return cls(orbit.model, orbit.S, orbit.parameters, lambda: orbit)

    @property
    def free(self) -> dict[str, FreeNumber]:
        """The parameters that designs may change, S among them."""
        found, model = {"S": FreeNumber(self.S, 0.0)}, self.model
        if not isinstance(model, Chain):
            return found | {name: FreeNumber(value) for name, value in self.parameters.items()}
        gammas = (0.0, STEEPEST_GAMMA) if model.gamma >= 0 else (-STEEPEST_GAMMA, 0.0)
        signs = (0.0, math.inf) if model.g > 0 else (-math.inf, 0.0)
        return found | {
            "gamma": FreeNumber(model.gamma, *gammas),
            "alpha": FreeNumber(model.alpha),
            "g": FreeNumber(model.g, *signs),
            "alpha_n": FreeNumber(model.alpha, several=tuple(f"alpha_{n}" for n in range(1, model.sites + 1))),
        }

    def expressions(self, over: Sequence[str]) -> FamilyExpressions:
        """Its quantities; raises ValueError for a model that has no such families."""
        return FamilyExpressions(self.model.family_equations(over))

    def located(self, expressions: FamilyExpressions, over: Sequence[str]) -> FamilyOrbit:
        """The orbit with its derivatives; raises ArithmeticError."""
        orbit, equations = self.orbit(), expressions.equations
        stiffness = "alpha_" if isinstance(self.model, Chain) else "no name"
        names = ("alpha" if name.startswith(stiffness) else name for name in equations.parameters)
        numbers = np.array([self.parameters[name] for name in names])
        harmonics = next((h for h in HARMONICS_OFFERED if h >= orbit.harmonics), HARMONICS_OFFERED[-1])
        return FamilyOrbit.on(expressions, numbers, harmonics, orbit, tuple(over))


def check_chain(chain: Chain, over: Sequence[str], bounds: Mapping[str, tuple[float, float]]) -> None:
    """Raises ValueError for free parameters and bounds for which a chain's gauge is not one."""
    if "alpha" in over and "alpha_n" in over:
        raise ValueError("over: given alpha and alpha_n; accepted: one of them")
    lower, upper = bounds.get("gamma", (chain.gamma, chain.gamma))
    if max(abs(lower), abs(upper)) >= 1:
        raise ValueError(f"gamma: given {short_repr([lower, upper])}; accepted in a design: |gamma| < 1")
    if lower < 0 < upper or (upper <= 0 < chain.gamma) or (chain.gamma < 0 <= lower):
        given, reason = short_repr([lower, upper]), "a mirrored chain has -gamma, and its gauge is another"
        raise ValueError(f"bounds[gamma]: given {given}; accepted: bounds on the chain's side of 0 ({reason})")
    low, high = bounds.get("g", (chain.g, chain.g))
    if not (low >= 0 and high > 0 if chain.g > 0 else low < 0 and high <= 0):
        side = ">= 0" if chain.g > 0 else "<= 0"
        raise ValueError(f"bounds[g]: given {short_repr([low, high])}; accepted: bounds {side}, as the chain's g")


class FamilyExpressions:
    """Quantities of an orbit of a family as CasADi expressions, for objectives and constraints.

    Attributes:
        S: total amplitude, the sum of y_n^2 at the phase where all velocities vanish.
        Omega, period: frequency, and 2 pi/Omega.
        energy: Hamiltonian; of a chain that of the gauge.
        participation: (sum of y_n^2)^2 / sum of y_n^4 at that phase, from 1 to N.
        y0: displacements at that phase, shape (components, 1).

    Parameters and outputs of the model are attributes as well, of a chain `alpha_n`, shape (sites, 1), and those of
    its band. `slope(expression)` is its derivative by S along the family at fixed parameters, and NAME_slope that of a
    quantity.
    """

    def __init__(self, equations: FamilyEquations) -> None:
        self.equations, self.has_slopes, self.y0 = equations, False, equations.y0
        self._slopes = ca.SX.sym("slopes", equations.q.numel() + 1)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the quantities."""
        known = tuple(self.equations.quantities)
        return (*known, *(f"{name}_slope" for name in ("Omega", "energy") if name in known))

    def value(self, name: str) -> ca.SX:
        """The quantity of a name; raises AttributeError, with the nearest known name, for another."""
        quantities, (of, _, slope) = self.equations.quantities, name.rpartition("_")
        if name in quantities:
            return quantities[name]
        if slope == "slope" and of in quantities:
            return self.slope(quantities[of])
        raise AttributeError(f"given {name!r}; {accepted_names(name, self.names)}")

    def __getattr__(self, name: str) -> ca.SX:
        return self.value(name)

    def slope(self, expression: Any) -> ca.SX:
        """d(expression)/dS along the family at fixed parameters; shape of the expression."""
        own = self.equations
        self.has_slopes = True
        return ca.jtimes(ca.SX(expression), ca.vertcat(own.q, own.Omega, own.S), ca.vertcat(self._slopes, 1))

    @property
    def symbols(self) -> ca.SX:
        """What all of them are expressions in, a column."""
        own = self.equations
        return ca.vertcat(own.q, own.Omega, self._slopes, own.S, own.numbers)


# One orbit of it, with its derivatives --------------------------------------------------------------------------------


class FamilyProblem(TrigonometricProblem):
    """R(z; p) on a number of harmonics; `numbers` are p."""

    def __init__(self, equations: FamilyEquations, numbers: Array, harmonics: int) -> None:
        own, n, v = equations, equations.q.numel(), ca.SX.sym("v", equations.q.numel())
        self.family = own
        norm = ca.dot(own.weights, own.q**2) - 1
        force, norm_there = ca.substitute([own.force, norm], [own.numbers], [ca.SX(numbers)])
        super().__init__(
            OdeModel(
                "orbit", own.q, force, own.S, 2, v, reversal=(1,) * n + (-1,) * n, half_period=(-1,) * (2 * n),
                normalisation=norm_there, checked=False,
            ),
            harmonics,
        )  # fmt: skip
        apart = np.subtract(*ca.jacobian_sparsity(own.force, own.q).get_triplet())
        self.half_bandwidth = harmonics * int(np.max(np.abs(apart), initial=1))
        symbols = [own.q, v, own.S, *([own.numbers] if numbers.size else [])]
        self.equations, self.numbers = CosineEquations(harmonics, symbols, own.force, norm), numbers

    def forms(self, directions: int) -> tuple[Buffers, Buffers]:
        """Those of the equations in several directions, at all nodes and at rest."""
        name = f"forms in {directions} directions"
        if name not in self.shared:
            force, norm = self.family.forms
            self.shared[name] = Buffers(force, directions * self.resolution), Buffers(norm, directions)
        found: tuple[Buffers, Buffers] = self.shared[name]
        return found

    def at(self, numbers: Array) -> FamilyProblem:
        """The same at other parameters; nothing is built again."""
        other = copy.copy(self)
        other.numbers = numbers
        return other


@dataclass(frozen=True, eq=False)
class FamilyOrbit:
    """An orbit of a family at S and parameters, located by Newton's method near that of another design.

    Attributes:
        expressions: its quantities.
        problem, z: its equations at its parameters, and its unknowns.
        over: names of the numbers that designs change: S and parameters.
    """

    expressions: FamilyExpressions
    corrector: NewtonCorrector
    problem: FamilyProblem
    z: Array
    over: tuple[str, ...]

    @classmethod
    def on(
        cls, expressions: FamilyExpressions, numbers: Array, harmonics: int, orbit: Orbit | CosineOrbit,
        over: tuple[str, ...],
    ) -> FamilyOrbit:  # fmt: skip
        """On a number of harmonics, from an orbit at the same S and parameters; raises ArithmeticError."""
        equations = expressions.equations
        problem = FamilyProblem(equations, numbers, harmonics)
        y = orbit.evaluate(quarter_phases(harmonics) / orbit.Omega)
        z = np.concatenate([(y / equations.scale(orbit.S, numbers)).T.ravel(), [orbit.Omega, orbit.S]])
        corrector = NewtonCorrector(problem, shrink=NEWTON_SHRINK)
        correction = corrector.correct(z, problem.parameter_row(), orbit.S)
        if not correction.converged:
            raise ArithmeticError(f"the orbit on {harmonics} odd cosines: {correction.status.value}")
        return cls(expressions, corrector, problem, correction.z, over)

    @cached_property
    def finer(self) -> FamilyOrbit | None:
        """The same on more harmonics; None where there are no more."""
        harmonics = next((h for h in HARMONICS_OFFERED if h > self.problem.resolution), None)
        if harmonics is None:
            return None
        return self.on(self.expressions, self.problem.numbers, harmonics, self.solution, self.over)

    @property
    def errors(self) -> tuple[Array, Array]:
        """Estimated errors of `numbers` and `derivatives`: twice what more harmonics change."""
        other = self.finer or self
        return 2.0 * np.abs(self.numbers - other.numbers), 2.0 * np.abs(self.derivatives - other.derivatives)

    def near(self, values: Mapping[str, float]) -> Self | None:
        """The orbit at other values, to first order and then by Newton's method; None where it is too far for that."""
        place = self._place.copy()
        for name, row in self._rows.items():
            place[row] = values[name]
        moved = np.array([values[name] - self._place[row] for name, row in self._rows.items()])
        guess = self.z + moved @ self._ways[:, : self.z.size]
        guess[-1], problem = place[0], self.problem.at(place[1:])
        correction = self.corrector.on(problem).correct(guess, problem.parameter_row(), place[0])
        z, states = correction.z, self.problem.states
        off = np.abs(z - self.z)
        near = np.max(off[:states]) <= LARGEST_MOVE * np.max(np.abs(self.z[:states]))
        if not (correction.converged and near and off[states] <= LARGEST_MOVE * self.z[states]):
            return None
        return replace(self, problem=problem, z=z)

    # Derivatives ----------------------------------------------------------------------------------------------------

    @cached_property
    def _place(self) -> Array:
        """S and the parameters."""
        return np.append(self.z[-1], self.problem.numbers)

    @cached_property
    def _rows(self) -> dict[str, int]:
        """Places in these of the numbers that designs change."""
        names = ["S", *self.expressions.equations.parameters]
        return {name: names.index(name) for name in self.over if name in names}

    @cached_property
    def _tangent(self) -> Array:
        """Derivative of (z, p) by S along the family."""
        return np.append(self._solve(self.problem.parameter_row()), np.zeros(self.problem.numbers.size))

    @cached_property
    def _solve(self) -> Solve:
        problem, z = self.problem, self.z
        return BorderedSolver.of(problem).factor(z, problem.evaluate(z)[1], problem.parameter_row())

    @cached_property
    def _ways(self) -> Array:
        """Derivatives of (z, p) by what designs change, shape (numbers, size + parameters)."""
        size, found = self.z.size, np.zeros((len(self._rows), self._tangent.size))
        if not len(found):
            return found
        for way, place in zip(found, self._rows.values(), strict=True):
            way[size - 1 + place] = 1.0  # S is the last unknown
        moved = self._forms(found[0], found)[0]
        found[:, :size] = -self._solve(np.vstack([moved.T, np.zeros(len(found))])).T
        if "S" in self._rows:
            found[list(self._rows).index("S")] = self._tangent
        return found

    @cached_property
    def _slopes(self) -> Array:
        """Derivatives of the tangent by the same; zeros where no quantity is a slope."""
        found = np.zeros_like(self._ways)
        if self.expressions.has_slopes and len(found):
            both = self._forms(self._tangent, self._ways)[1]
            found[:, : self.z.size] = -self._solve(np.vstack([both.T, np.zeros(len(found))])).T
        return found

    def _forms(self, u: Array, ways: Array) -> tuple[Array, Array]:
        """Derivatives of R but for q'' in directions v of (z, p), and D^2 R [u, v], (directions, size - 1) each."""
        problem, n, m, Omega = self.problem, self.problem.states, len(ways), self.z[self.problem.Omega_index]
        H = problem.resolution

        def at_nodes(rows: Array) -> Array:
            return np.ascontiguousarray(rows[:, :n].reshape(len(rows), -1, H).swapaxes(1, 2))  # (rows, nodes, sites)

        Q, U, V = map(at_nodes, (self.z[None], u[None], ways))
        force, norm = problem.forms(m)
        given = [np.tile(Q[0], (m, 1)), self._place, np.tile(U[0], (m, 1)), u[n + 1 :], V.reshape(m * H, -1),
                 np.repeat(ways[:, n + 1 :], H, axis=0)]  # fmt: skip
        f, Du, Dv, both = (r.reshape(m, H, -1).swapaxes(1, 2).reshape(m, -1) for r in force(*given))
        given[::2], given[5] = [problem.at_zero @ rows for rows in (Q[0], U[0], V)], ways[:, n + 1 :]
        norms, u_Omega, v_Omega = norm(*given), u[n], ways[:, n, None]
        both = -both / Omega**2 + 2 * (Du * v_Omega + Dv * u_Omega) / Omega**3 - 6 * f * u_Omega * v_Omega / Omega**4
        return np.hstack([-Dv / Omega**2, norms[2][:, None]]), np.hstack([both, norms[3][:, None]])

    @cached_property
    def numbers(self) -> Array:
        """Values of the symbols of `expressions`."""
        return self._read(np.append(self.z, self.problem.numbers), self._tangent)

    @cached_property
    def derivatives(self) -> Array:
        """Their derivatives by `over`, shape (symbols, over)."""
        found = np.zeros((self.numbers.size, len(self.over)))
        for name, way, slope in zip(self._rows, self._ways, self._slopes, strict=True):
            found[:, self.over.index(name)] = self._read(way, slope)
        return found

    def _read(self, way: Array, slope: Array) -> Array:
        n = self.problem.states

        def at_rest(x: Array) -> Array:
            return np.append(x[:n].reshape(-1, self.problem.resolution) @ self.problem.at_zero, x[n])

        return np.concatenate([at_rest(way), at_rest(slope), way[n + 1 :]])

    @cached_property
    def solution(self) -> CosineOrbit:
        """The orbit in numbers."""
        problem, (S, *numbers) = self.problem, self._place
        values = self.z[: problem.states].reshape(-1, problem.resolution)
        scale = self.expressions.equations.scale(S, np.array(numbers))[:, None]
        own = self.expressions.equations
        model = own.at(dict(zip(own.parameters, map(float, numbers), strict=True)))
        return CosineOrbit.at_nodes(model, float(S), float(self.z[problem.Omega_index]), values * scale)
