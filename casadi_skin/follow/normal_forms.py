"""Coefficients of the normal forms at folds, period doublings and tori of orbits.

By projection on the collocation equations themselves (Kuznetsov, Govaerts, Doedel and Dhooge 2005), in the variable w
of x = x0 + w v + ..., where v is the critical Floquet function with mean square 1 over the period: of a fold w' = a w^2
+ ..., of a period doubling w' = c w^3 + ..., of a torus w' = (i theta/T) w + d w |w|^2 + ..., of which the real part of
d is taken. What is born at a period doubling or a torus is stable where the coefficient is negative and no other
multiplier is outside the unit circle. A stated problem that closes its solutions is the same in its own time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from casadi_skin.follow.rest_normal_forms import DECIDED_SIGN_RATIO, Critical
from casadi_skin.follow.rest_normal_forms import critical as at_equilibrium
from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import Followed
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.zero.closure import Closure
from casadi_skin.zero.kinds import DOUBLING, FOLD, TORUS
from casadi_skin.zero.linearised import Linearised, Vector, null_vectors
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import BoundaryProblem

PLACES_ALONG_SOLUTION = 65  # at which null vectors are compared
UNKNOWN_DERIVATIVES_WORDS = "unknown: the model has no higher derivatives"


def critical(point: SpecialPoint) -> Critical:
    """Normal form at a special point of equilibria or orbits; raises ValueError for another point."""
    solution = point.solution
    stated = _closed(point)
    if not (solution.is_orbit or stated) or point.kind not in (FOLD, DOUBLING, TORUS):
        return at_equilibrium(point)
    try:
        problem = solution.problem
    except ValueError:
        return at_equilibrium(point)
    linear = Linearised(problem, solution.point.z, problem.statement)
    turn = stated.matrix if stated else None
    length = float(np.diff(solution.space.interval(solution.point))[0])
    angle = np.pi if point.kind == DOUBLING else 0.0
    if point.kind == TORUS:
        angle = abs(float(np.angle(on_circle(solution))))
    v, adjoint = critical_functions(point.kind, linear, angle, turn)
    start = (v[: linear.components], adjoint[: linear.components])
    vector, other = (np.asarray(part / np.linalg.norm(part), dtype=complex) for part in start)
    try:
        terms = terms_of(point.kind, linear, angle, v, adjoint, turn) / length
    except (RuntimeError, NotImplementedError):
        return Critical(vector, other, angle / length, float("nan"), UNKNOWN_DERIVATIVES_WORDS)
    value = float(np.sum(terms))
    words = "quadratic" if point.kind == FOLD else "supercritical" if value < 0.0 else "subcritical"
    if abs(value) <= DECIDED_SIGN_RATIO * float(np.sum(np.abs(terms))):
        words = "degenerate"
    return Critical(vector, other, angle / length, value, words)


def _closed(point: SpecialPoint) -> Closure | None:
    """How a stated problem closes the solution there; None of orbits, of equilibria and where it does not.

    Raises ValueError where it does not repeat itself after the interval.
    """
    solution = point.solution
    closure = getattr(solution.space, "closure", None)
    accepted = "one that closes, where the field repeats itself as the conditions suppose"
    if closure is not None and not closure.goes_on(solution.problem, solution.point.z):
        raise ValueError(f"{point.kind}: given one of a boundary-value problem of another kind; accepted: {accepted}")
    return cast("Closure | None", closure)


def on_circle(orbit: Solution) -> complex:
    """The complex multiplier nearest to the unit circle."""
    others = orbit.floquet().others
    upper = others[others.imag > 0.0]
    return complex(upper[np.argmin(np.abs(np.abs(upper) - 1.0))])


def critical_functions(kind: str, linear: Linearised, angle: float, turn: Array | None = None) -> tuple[Vector, Vector]:
    """The critical Floquet function with mean square 1, of a fold with the changes of free parameters; its adjoint."""
    factor = -1.0 + 0j if kind == DOUBLING else complex(np.exp(1j * angle))
    matrix = linear.jacobian if kind == FOLD else linear.twisted(factor, turn)
    v, adjoint = null_vectors(matrix)
    problem: BoundaryProblem = linear.problem
    weights = np.outer(problem.constants, problem.table.extended[-1]).ravel()
    values = v[: linear.states].reshape(problem.columns, -1)[problem.stages]
    v = v / np.sqrt(float(weights @ np.sum(np.abs(values) ** 2, axis=1)))
    largest = v[: linear.components][np.argmax(np.abs(v[: linear.components]))]
    return v * (abs(largest) / largest), adjoint


def terms_of(
    kind: str, linear: Linearised, angle: float, v: Vector, adjoint: Vector, turn: Array | None = None
) -> Array:
    """The terms whose sum over the period is the coefficient."""
    psi = adjoint[: linear.inner].conj()

    def projected(*parts: Vector) -> Array:
        over = psi @ linear.velocity(v)
        return np.array([-(psi @ part / over).real for part in parts])

    if kind == FOLD:
        return projected(0.5 * linear.derivative(v, v))
    if kind == DOUBLING:
        bent = _solved(linear.jacobian, -linear.derivative(v, v))
        return projected(linear.derivative(v, v, v) / 6.0, 0.5 * linear.derivative(v, bent))
    steady = _solved(linear.jacobian, -linear.derivative(v, v.conj()).real)
    double = _solved(linear.twisted(complex(np.exp(2j * angle)), turn), -linear.derivative(v, v))
    return projected(
        0.5 * linear.derivative(v, v, v.conj()), linear.derivative(v, steady), 0.5 * linear.derivative(v.conj(), double)
    )


def _solved(matrix: Any, inner: Vector) -> Vector:
    """The solution for a right-hand side that is zero in the conditions."""
    from scipy.sparse.linalg import splu

    factors = splu(matrix)
    right = np.zeros(factors.shape[0], dtype=inner.dtype)
    right[: inner.size] = inner
    return cast(Vector, factors.solve(right))


# The quadratic term at folds of boundary-value problems along a curve of them: it vanishes where two of them meet -----


def quadratic_term(space: Followed, beside: Point) -> Callable[[Point], float]:
    """The quadratic term as a function of points of the curve; its sign goes on from a point beside them."""
    reference = _normal(space, beside)[1]

    def term(point: Point) -> float:
        psi, normal = _normal(space, point)
        linear = space.linearised(point)
        v = linear.null_vectors[0]
        v = v / np.sqrt(v[: linear.states] @ v[: linear.states] / linear.problem.columns)
        return float(0.5 * np.copysign(1.0, normal @ reference) * (psi @ linear.full_derivative(v, v)))

    return term


def _normal(space: Followed, point: Point) -> tuple[Array, Array]:
    """The left null vector of norm 1, and its products with the derivatives by both parameters."""
    linear = space.linearised(point)
    psi = linear.null_vectors[1]
    return psi, np.array([psi @ linear.by_scalar(len(linear.statement.free)), psi @ linear.by_scalar(-1)])


# The branching equation at branch points that are followed in two parameters: where it degenerates --------------------


@dataclass(frozen=True, eq=False)
class NullVectors:
    """Those at a branch point: v, with mean square 1 along the solution, and psi.

    Signs are those of a `reference` at another point of the curve: of v by its values, of psi by what it sees of v.
    """

    linear: Linearised
    reference: NullVectors | None = None

    @cached_property
    def v(self) -> Array:
        v, states = self.linear.null_vectors[0], self.linear.states
        v = v / np.sqrt(v[:states] @ v[:states] / self.linear.problem.columns)
        return v if self.reference is None else v * np.sign(np.sum(self._values(v) * self.reference._values()))

    def _values(self, v: Array | None = None) -> Array:
        problem, v = self.linear.problem, self.v if v is None else v
        return np.append(problem.sample(v, np.linspace(0.0, 1.0, PLACES_ALONG_SOLUTION)), v[self.linear.states :])

    @cached_property
    def seen(self) -> Array:
        """Means of products of components, and products of conditions with the ends of v."""
        psi, (n, inner) = self.linear.null_vectors[1], (self.linear.components, self.linear.inner)
        ends = np.concatenate([self.v[:n], self.v[inner:]])
        return np.concatenate([self.linear.products(psi, self.v).ravel(), np.outer(psi[inner:], ends).ravel()])


def branching_terms(space: Followed, point: Point, reference: NullVectors) -> tuple[Array, Array]:
    """The terms of a and c at a point of a curve; these are zero but for rounding where a symmetry makes them so."""
    from scipy.sparse import bmat, csc_matrix
    from scipy.sparse.linalg import splu

    linear = space.linearised(point)
    own = NullVectors(linear, reference)
    matrix, v, psi = linear.jacobian, own.v, linear.null_vectors[1]
    twice, thrice = linear.full_derivative(v, v), linear.full_derivative(v, v, v)
    closed = bmat([[matrix, csc_matrix(psi[:, None])], [csc_matrix(v[None, :]), None]]).tocsc()
    bent = np.asarray(splu(closed).solve(np.append(-twice, 0.0))[:-1])
    over = own.seen @ reference.seen
    cubic = [*(psi * thrice / 6.0), *(0.5 * psi * linear.full_derivative(v, bent))]
    return 0.5 * psi * twice / over, np.array(cubic) / over


def second_singular(space: Followed, point: Point) -> float:
    """The smallest singular value of the Jacobian bordered by its null vectors."""
    from scipy.sparse import bmat, csc_matrix

    matrix, (right, left) = space.linearised(point).jacobian, space.linearised(point).null_vectors
    closed = bmat([[matrix, csc_matrix(left[:, None])], [csc_matrix(right[None, :]), None]]).tocsc()
    return float(np.linalg.norm(closed @ null_vectors(closed)[0]))
