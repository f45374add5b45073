"""Quantities of a solution with their derivatives by its unknowns and by the parameters, as gradients are made of.

A target is a function of a problem and its solution z, (J, J_z, J_c): J_z of shape (size,), J_c in the order of the
parameters of `Equations`. Of quantities of the state at one place J_z has the weights of that place in the mesh, of
multipliers and eigenvalues it is a derivative of the linearisation, exact as `zero.adjoint` has it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.follow.boundary_space import BoundarySpace
from casadi_skin.follow.find import checked_scalar
from casadi_skin.follow.solution import Solution
from casadi_skin.model.amplitude import amplitude_square
from casadi_skin.model.arguments import accepted_names
from casadi_skin.model.conserved import SymmetryClass, unfolded_phases
from casadi_skin.model.expressions import Expression
from casadi_skin.zero.adjoint import Equations
from casadi_skin.zero.linearised import Linearised, bordered, null_vectors
from casadi_skin.zero.problem import EPSILON, Array
from casadi_skin.zero.rest import AlgebraicProblem
from casadi_skin.zero.stated_problem import PERIOD

MULTIPLIER_STEPS = 3  # of a multiplier's corrections, quadratic each
KINK_PROBES, KINK_RTOL = 3, 1e-6  # ways across a solution on which slopes are compared; a jump, of the largest slope
KINK_ROUNDING, SMALLEST_REACH = 256.0 * EPSILON, 1e-300  # of the sides, relative to a number, and beside a 0
LARGEST_KINK_REACH = 1e-8  # however large the error of the solution is
EXTREMUM_PLACES = 24  # places an interval in which extremes are looked for
Slopes = tuple[float, Array, Array]  # a value, its derivatives by the unknowns and by the parameters
Target = Callable[[Any, Array], Slopes]


def unknown(problem: Any, z: Array, index: int, factor: float = 1.0) -> Slopes:
    """A multiple of an unknown."""
    by_z = np.zeros(z.size)
    by_z[index] = factor
    return factor * float(z[index]), by_z, np.zeros(len(Equations.of(problem).names))


def target_of(space: Any, solution: Solution, quantity: Any) -> tuple[Target, str]:
    """A quantity of a solution, and its name in words; raises ValueError for one that it has not."""
    model = space.model
    if not isinstance(quantity, str):
        return AtStart(space, checked_scalar("quantity", quantity, model)), "an expression"
    known: dict[str, Target] = {name: partial(_free, name) for name in space.free}
    if solution.is_equilibrium:
        known |= {name: partial(_component_at_rest, k) for k, name in enumerate(space.state_names)}
        known |= {} if space.kind else {"max_growth": _growth}
    else:
        for k, name in enumerate(space.state_names):
            known.setdefault(name, AtStart(space, model.full_state[k]))
            known |= {f"{name}_{end}": partial(_extreme, space, k, sign) for sign, end in ((1.0, "max"), (-1.0, "min"))}
    if solution.is_orbit:
        known |= _of_orbit(space, solution)
    if quantity not in known:
        raise ValueError(f"quantity: given {quantity}; {accepted_names(quantity, known)}")
    return known[quantity], quantity


def _free(name: str, problem: Any, z: Array) -> Slopes:
    """A parameter that is found with the solution."""
    equations = Equations.of(problem)
    _, by_z, by_c = unknown(problem, z, *equations.unknowns()[name])
    return float(problem.parameters(z)[equations.names.index(name)]), by_z, by_c


def _component_at_rest(k: int, problem: Any, z: Array) -> Slopes:
    return unknown(problem, z, k, float(problem.scale[k]))


def _growth(problem: Any, z: Array) -> Slopes:
    """The largest real part of an eigenvalue: d lambda = psi^H dA v / psi^H v."""
    from scipy.linalg import eig

    statics, n, at = problem.statics, problem.states, (problem.state(z), problem.parameters(z))
    A = statics.jacobian(*at) * problem.scale / problem.scale[:, None]
    values, left, right = eig(A, left=True)
    second = statics.model.order == 2
    growth = np.sqrt(values.astype(complex)) if second else values
    k = int(np.argmin(np.abs(growth - statics.spectrum(*at).values[0])))
    psi, v = left[:, k].conj(), np.append(right[:, k], np.zeros(z.size - n))
    found = Equations.of(problem).pulled(z, psi, v)
    factor = (2.0 * growth[k] if second else 1.0) * (psi @ right[:, k])
    by_z, by_c = ((part / factor).real for part in found)
    return float(growth[k].real), by_z, by_c


def _of_orbit(space: BoundarySpace, solution: Solution) -> dict[str, Target]:
    """Quantities that orbits alone have."""
    model, found = space.model, dict[str, Target]()
    if PERIOD in space.free:
        found["Omega"] = _frequency
    if model.hamiltonian is not None:
        found["energy"] = AtStart(space, ca.densify(model.hamiltonian))
    if space.positions:
        amplitude = amplitude_square(space.given)
        S = ca.Function("S", [amplitude.state], [amplitude.form])
        found["S"] = AtStart(space, S(model.full_state[: space.positions]))
    found["max_abs_multiplier"] = partial(_multiplier, space, solution)
    return found


def _frequency(problem: Any, z: Array) -> Slopes:
    period, by_z, by_c = _free(PERIOD, problem, z)
    return 2.0 * np.pi / period, -2.0 * np.pi / period**2 * by_z, by_c


@dataclass(frozen=True, eq=False)
class AtStart:
    """An expression in t, the state at phase zero, at the start of an interval or at rest, and the parameters."""

    space: Any
    expression: Expression

    @cached_property
    def _slopes(self) -> ca.Function:
        """Function (t, x, p) -> the value and its gradients by x and p."""
        function = self.space.model.function("quantity", self.expression)
        symbols = [type(self.space.model.state).sym(name, *function.size_in(k)) for k, name in enumerate("txp")]
        value = function(*symbols)
        return ca.Function("slopes", symbols, [value, *(ca.densify(ca.gradient(value, s)) for s in symbols[1:])])

    def check_smooth(self, problem: Any, z: Array, error: float) -> None:
        """Raises ValueError where the slopes jump at the solution: they differ on two sides, however near these are.

        The sides are within the relative `error` of the solution.
        """
        x, p, sizes = self._place(problem, z)
        place, sizes = np.append(x, p), np.clip(error, KINK_ROUNDING, LARGEST_KINK_REACH) * sizes
        reaches = np.append(sizes, KINK_ROUNDING * np.abs(p)) + SMALLEST_REACH
        for way in np.random.default_rng(0).uniform(-1.0, 1.0, (KINK_PROBES, place.size)) * reaches:
            there = (place - way, place + way, place - 0.125 * way, place + 0.125 * way)
            far, other_far, near, other_near = (self._numbers(*np.split(at, [x.size]))[1:] for at in there)
            jump, least = np.abs(near - other_near), KINK_RTOL * np.max(np.abs(near), initial=0.0)
            if not np.all(np.isfinite(jump)) or np.any((jump > least) & (jump > 0.5 * np.abs(far - other_far))):
                raise ValueError("quantity: given one with a kink at the solution; accepted: one with derivatives")

    def _numbers(self, x: Array, p: Array) -> Array:
        """The value, and its derivatives by states and parameters."""
        return np.concatenate([np.array(part).ravel() for part in self._slopes(0.0, x, p)])

    def _place(self, problem: Any, z: Array) -> tuple[Array, Array, Array]:
        """State, parameters, and sizes of the components of the state."""
        x, sizes = np.zeros((2, self._slopes.size1_in(1)))  # a model of second order rests with its velocities zero
        if isinstance(problem, AlgebraicProblem):
            x[: problem.states], sizes[: problem.states] = problem.state(z), problem.scale
        else:
            columns = z[: problem.states].reshape(problem.columns, -1)[:, : x.size]
            x[: columns.shape[1]], sizes[: columns.shape[1]] = columns[0], np.max(np.abs(columns), axis=0)
        names = Equations.of(problem).names
        return x, problem.parameters(z)[[names.index(name) for name in self.space.model.parameter_names]], sizes

    def __call__(self, problem: Any, z: Array) -> Slopes:
        equations, rest = Equations.of(problem), isinstance(problem, AlgebraicProblem)
        order = [equations.names.index(name) for name in self.space.model.parameter_names]
        count = problem.states if rest else problem.formulation.states
        x, p, _ = self._place(problem, z)
        value, by_x, by_p = np.split(self._numbers(x, p), [1, 1 + x.size])
        moves = equations.moves()
        by_z, by_c = by_p @ moves[order], np.zeros(len(equations.names))
        by_z[:count] += by_x[:count] * (problem.scale if rest else 1.0)
        by_c[order] = np.where(moves[order].any(axis=1), 0.0, by_p)
        return float(value[0]), by_z, by_c


def _extreme(space: Any, k: int, sign: float, problem: Any, z: Array) -> Slopes:
    """The largest or smallest value of a component; the derivative by its place vanishes, or it is an end."""
    from scipy.optimize import brentq

    periodic, count = space.periodic, problem.resolution * EXTREMUM_PLACES

    def whole(turn: Array) -> tuple[Array, Array]:
        """Fractions of what is solved for, and signs of the component."""
        if periodic is None:
            return turn, np.ones(turn.size)
        fractions, signs = unfolded_phases(periodic.model, periodic.symmetry, 2.0 * np.pi * turn)
        return fractions, signs[:, k]

    def slope(turn: float) -> float:
        (fraction,), _ = whole(np.array([turn % 1.0]))
        x = problem.sample(z, np.array([fraction]))[0]
        return float(problem.formulation.field_function(fraction, x, *problem.repeated(z, 1))[0][k])

    turns = np.linspace(0.0, 1.0, count + 1)
    fractions, signs = whole(turns)
    at = int(np.argmax(sign * signs * problem.sample(z, fractions)[:, k]))
    place, around = turns[at], turns[at] + np.array([-1.0, 1.0]) / count
    if periodic is not None or 0 < at < count:
        one_piece = np.ptp(whole(np.append(around, place) % 1.0)[1]) == 0.0
        if one_piece and slope(around[0]) * slope(around[1]) < 0.0:
            place = brentq(slope, float(around[0]), float(around[1]), xtol=1e-14) % 1.0
    (fraction,), (factor,) = whole(np.array([place]))
    by_z = np.zeros(z.size)
    columns, weights = problem.weights_at(float(fraction))
    by_z[: problem.states].reshape(problem.columns, -1)[columns, k] = factor * weights
    return float(by_z @ z), by_z, np.zeros(len(Equations.of(problem).names))


class Flow:
    """The map Phi of changes of the state at the start of an orbit to those at its end, and its derivatives.

    With B V = (1, 0), the rows of the start above those of the field, Phi is the end of V, and of numbers
    a^T Phi b the derivative is -psi^T dB V b, where B^T psi is a at the end: exact, forward over reverse.

    Attributes:
        matrix: Phi, shape (n, n).
    """

    def __init__(self, problem: Any, z: Array) -> None:
        from scipy.sparse import diags, eye, vstack
        from scipy.sparse.linalg import splu

        n, k = problem.formulation.states, problem.states
        field, sizes = Linearised(problem, z, problem.statement).matrix[: k - n, :k], problem.sizes(z)[:k, None]
        B = diags(1.0 / sizes[:, 0]) @ vstack([eye(n, k), field]) @ diags(sizes[:, 0])
        self._problem, self._z, self._sizes = problem, z, sizes
        self._factors: Any = splu(B.tocsc())
        self._ways = sizes * self._factors.solve(np.eye(k, n)) / sizes[:n, 0]
        self.matrix = self._ways[-n:]

    def slopes(self, a: Any, b: Any) -> tuple[Any, Any]:
        """Derivatives of the sum of a^T Phi b over columns, (n, any), by the unknowns and the parameters."""
        equations, (n, count), sizes = Equations.of(self._problem), a.shape, self._sizes
        ends = np.zeros((sizes.size, 2 * count))
        ends[-n:] = sizes[-n:] * np.hstack([a.real, a.imag])
        left = (self._factors.solve(ends, trans="T") / sizes)[n:]
        found = np.zeros(self._z.size + len(equations.names), complex)
        for psi, v in zip((left[:, :count] + 1j * left[:, count:]).T, (self._ways @ b).T, strict=True):
            weights, way = np.zeros(self._problem.equations, complex), np.zeros(self._z.size, complex)
            weights[: psi.size], way[: v.size] = psi, v
            found -= np.concatenate(equations.pulled(self._z, weights, way))
        return found[: self._z.size], found[self._z.size :]


def _multiplier(space: BoundarySpace, solution: Solution, problem: Any, z: Array) -> Slopes:
    """The largest modulus of a multiplier but the trivial ones; on parts of the period they come in pairs."""
    others = solution.floquet().others
    if not others.size:
        raise ValueError("quantity: given max_abs_multiplier of an orbit without others than the trivial ones")
    mu, power = complex(others[np.argmax(np.abs(others))]), 1 + (space.symmetry is SymmetryClass.QUARTER)
    whole = space.symmetry is SymmetryClass.FULL
    nu, found = _of_whole(problem, z, mu) if whole else _of_part(space, problem, z, mu, power)
    size, by_z, by_c = abs(nu), *((power * abs(nu) ** (power - 2) * np.conj(nu) * part).real for part in found)
    return float(size**power), by_z, by_c


def _of_whole(problem: Any, z: Array, mu: Any) -> tuple[Any, Any]:
    """A multiplier v(1) = mu v(0), B v = 0, and d mu = psi^T dB v over psi_1^T v(0): tiny ones keep their digits."""
    from scipy.sparse import diags, eye, vstack
    from scipy.sparse.linalg import splu

    n, k, mu = problem.formulation.states, problem.states, mu if mu.imag else mu.real
    field, sizes = Linearised(problem, z, problem.statement).matrix[: k - n, :k], problem.sizes(z)[:k]
    rows, left, v = diags(1.0 / np.roll(sizes, -n)), np.empty(0), np.empty(0)
    for _ in range(MULTIPLIER_STEPS):
        B = (rows @ vstack([field, eye(n, k, k - n) - mu * eye(n, k)]) @ diags(sizes)).tocsc()
        v, psi = null_vectors(B)  # whose shift is seen in the eleventh digit: they border B alone
        factors: Any = splu(bordered(B, v[:, None].conj(), psi[:, None]))
        v, psi = (factors.solve(np.append(0.0 * v, 1.0), trans)[:-1] for trans in ("N", "H"))
        left = psi.conj() / (psi.conj()[-n:] @ v[:n])
        mu = mu + left @ (B @ v)
    way, weights = np.zeros(z.size, v.dtype), np.zeros(problem.equations, left.dtype)
    way[:k], weights[: k - n] = v * sizes, left[: k - n] / sizes[n:]
    return mu, Equations.of(problem).pulled(z, weights, way)


def _of_part(space: BoundarySpace, problem: Any, z: Array, mu: complex, power: int) -> tuple[Any, Any]:
    """A multiplier, or of a quarter its root nu, and d nu = psi^T dM v over psi^T v of the map M.

    With x(-t) = N x(t) the second part of the period is the first one back: on a half of it M is N Phi^-1 N Phi. On a
    quarter N Phi^-1 P N Phi, with the signs P after half a period, is the map of that.
    """
    from scipy.linalg import eig

    n, flow, sizes = problem.formulation.states, Flow(problem, z), problem.sizes(z)[: problem.formulation.states, None]
    N, back = np.ones((n, 1)), np.ones((n, 1))
    N[: space.model.full_size, 0] = space.model.reversal
    back[: space.model.full_size, 0] = space.model.half_period if power == 2 else 1.0
    Phi = flow.matrix / sizes * sizes[:, 0]
    values, left, right = eig(N * np.linalg.solve(Phi, back * N * Phi), left=True)
    k = int(np.argmin(np.abs(values**power - mu)))
    nu, v, psi = complex(values[k]), right[:, [k]], left[:, [k]].conj()
    p = np.linalg.solve(Phi.T, N * psi / (psi.T @ v))
    return nu, flow.slopes(np.hstack([-p, back * N * p]) / sizes, np.hstack([nu * N * v, v]) * sizes)
