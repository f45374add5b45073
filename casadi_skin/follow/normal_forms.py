"""Critical eigenvectors and coefficients of normal forms at special points, by projection on their own equations.

Of equilibria (Kuznetsov 2004, sections 5.4 and 10.2). Fold: a in w' = a w^2 + ..., with critical vectors scaled by
v.v = 1, psi.v = 1. Hopf point: the first Lyapunov coefficient l1 of w' = i omega w + omega l1 w |w|^2 + ..., with
q*.q = 1, p*.q = 1; a cycle is born stable where it is negative and all other eigenvalues are.

Of orbits, on the collocation equations (Kuznetsov, Govaerts, Doedel and Dhooge 2005), in the variable w
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

from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import Followed
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.zero import linearised
from casadi_skin.zero.kinds import BAUTIN, DOUBLING, FOLD, HOPF, ORBIT_CURVES, kind_of
from casadi_skin.zero.linearised import Linearised, Vector
from casadi_skin.zero.problem import EPSILON, Array
from casadi_skin.zero.rest import BalancedMatrix, ComplexArray, NullSpace, Statics, balanced, upper_pair
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import BoundaryProblem, Closure

DECIDED_SIGN_RATIO = 1e-8  # of the terms that a coefficient is the sum of: one that is smaller has no known sign
PLACES_ALONG_SOLUTION = 65  # at which null vectors are compared


@dataclass(frozen=True, eq=False)
class Critical:
    """The critical eigenvector, its frequency (0 of a real one), the coefficient of the normal form, and its meaning.

    `adjoint` is the critical eigenvector of the transposed Jacobian; `coefficient` is NaN where none is defined.
    """

    vector: ComplexArray
    adjoint: ComplexArray
    frequency: float
    coefficient: float = float("nan")
    words: str = ""

    @classmethod
    def by_terms(
        cls, vector: Vector, adjoint: Vector, frequency: float, terms: Callable[[], Array], fold: bool, order: str
    ) -> Critical:
        """With the coefficient that terms add up to, where the model has derivatives of an `order`."""
        both = vector.astype(np.complex128), adjoint.astype(np.complex128)
        try:
            found = terms()
        except (RuntimeError, NotImplementedError):  # a black box with first derivatives alone
            return cls(*both, frequency, words=f"unknown: the model has no {order} derivatives")
        except np.linalg.LinAlgError:
            return cls(*both, frequency, words="unknown: another eigenvalue vanishes there")
        value = float(np.sum(found))
        words = "quadratic" if fold else "supercritical" if value < 0.0 else "subcritical"
        if abs(value) <= DECIDED_SIGN_RATIO * float(np.sum(np.abs(found))):
            words = "degenerate"
        return cls(*both, frequency, value, words)


def critical(point: SpecialPoint) -> Critical:
    """Normal form at a special point of equilibria or orbits; raises ValueError for another point."""
    solution = point.solution
    if not solution.space.is_critical(point.kind):
        raise ValueError(f"{point.kind}: a zero of a monitor, which has no normal form")
    stated = _closed(point)
    curves = ORBIT_CURVES.get(point.kind)
    if not (solution.is_orbit or stated) or curves is None or not curves.degenerate:
        return _at_equilibrium(point)
    try:
        problem = solution.problem
    except ValueError:
        return _at_equilibrium(point)
    linear = Linearised(problem, solution.point.z, problem.statement)
    turn = stated.matrix if stated else None
    length = float(np.diff(solution.space.interval(solution.point))[0])
    angle = critical_angle(point.kind, solution)
    v, adjoint = critical_functions(point.kind, linear, angle, turn)
    vector, other = (part / np.linalg.norm(part) for part in (v[: linear.components], adjoint[: linear.components]))
    return Critical.by_terms(
        vector, other, angle / length,
        lambda: terms_of(point.kind, linear, angle, v, adjoint, turn) / length, point.kind == FOLD, "higher",
    )  # fmt: skip


# Equilibria -----------------------------------------------------------------------------------------------------------


def _at_equilibrium(point: SpecialPoint) -> Critical:
    """That of an equilibrium, a Hopf point that orbits shrink to among them; raises ValueError for other points."""
    solution = point.solution
    if solution.is_orbit and point.kind == HOPF:  # of amplitude zero
        model = solution.model
        known = Statics(model, {name: solution.parameters[name] for name in model.parameter_names})
        return _hopf_form(known, solution.evaluate(0.0), np.array(list(known.values.values())))
    if not solution.is_equilibrium:
        raise ValueError(f"{point.kind}: given one of {type(solution).__name__.lower()}s; accepted: one of equilibria")
    statics = solution.space.statics
    x, p = solution.positions, np.array(list(solution.parameters.values()))
    if point.kind in (HOPF, BAUTIN):
        return _hopf_form(statics, x, p)
    v, psi = null_vectors(statics.jacobian(x, p))
    if point.kind != FOLD:
        return Critical(v.astype(np.complex128), psi.astype(np.complex128), 0.0)
    return Critical.by_terms(
        v, psi, 0.0, lambda: np.array([0.5 * (psi @ statics.second(x, p, v, v)).real]), True, "second"
    )


def _hopf_form(statics: Statics, x: Array, p: Array) -> Critical:
    """The first Lyapunov coefficient at a Hopf point (Kuznetsov 2004, equation 5.39)."""
    A = statics.jacobian(x, p)
    omega, q, adjoint = critical_pair(A)
    return Critical.by_terms(
        q, adjoint, omega, lambda: lyapunov_terms(statics, x, p, A, omega, q, adjoint) / (2.0 * omega), False, "higher"
    )


def lyapunov_terms(
    statics: Statics, x: Array, p: Array, A: Array, omega: float, q: ComplexArray, adjoint: ComplexArray
) -> Array:
    """The three terms whose sum over 2 omega is the first Lyapunov coefficient, shape (3,).

    Raises LinAlgError where another eigenvalue is zero, to rounding.
    """
    unit = np.eye(len(A))
    if not np.linalg.cond(balanced(A)[0]) < 1.0 / EPSILON:
        raise np.linalg.LinAlgError
    cubic = adjoint.conj() @ statics.third(x, p, q, q, q.conj())
    steady = np.asarray(np.linalg.solve(A, statics.second(x, p, q, q.conj())), dtype=complex)
    double = np.asarray(np.linalg.solve(2j * omega * unit - A, statics.second(x, p, q, q)), dtype=complex)
    by_steady = adjoint.conj() @ statics.second(x, p, q, steady)
    by_double = adjoint.conj() @ statics.second(x, p, q.conj(), double)
    return np.array([complex(cubic).real, -2.0 * complex(by_steady).real, complex(by_double).real])


def critical_pair(A: Array, near: float | None = None) -> tuple[float, ComplexArray, ComplexArray]:
    """The frequency omega > 0 of the critical pair of eigenvalues, q with A q = i omega q, and its adjoint.

    The pair is that nearest to i `near`, by default that nearest to the imaginary axis.
    """
    linear = BalancedMatrix(A)
    values = linear.eigensystem[0]
    k = upper_pair(values, None if near is None else 1j * near)
    right, left = linear.vectors(k)
    q = right / np.linalg.norm(right)
    return float(values[k].imag), q, np.asarray(left / np.vdot(left, q).conj())


def null_vectors(A: Array) -> tuple[Array, Array]:
    """Right and left null vector, v.v = 1 and psi.v = 1 unless these are orthogonal, where psi.psi = 1.

    The largest entry of v is positive.
    """
    units = balanced(A)[1]
    found = NullSpace.of_rates(A, units)
    v, psi = found.right[:, -1], found.left[:, -1]
    v = v * np.sign(v[np.argmax(np.abs(v))]) / np.linalg.norm(v)
    product = float(psi @ v)
    crossed = float(np.linalg.norm(psi * units) * np.linalg.norm(v / units))
    return v, psi / (product if abs(product) > 1e-10 * crossed else np.linalg.norm(psi))


# Orbits, and solutions of boundary-value problems that close ---------------------------------------------------------


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


def critical_angle(kind: str, orbit: Solution) -> float:
    """The angle of the critical multipliers; of pairs that of the complex one nearest to the unit circle."""
    angle = kind_of(kind).angle
    if angle is not None:
        return angle
    others = orbit.floquet().others
    upper = others[others.imag > 0.0]
    return abs(float(np.angle(upper[np.argmin(np.abs(np.abs(upper) - 1.0))])))


def critical_functions(kind: str, linear: Linearised, angle: float, turn: Array | None = None) -> tuple[Vector, Vector]:
    """The critical Floquet function with mean square 1, of a fold with the changes of free parameters; its adjoint."""
    factor = -1.0 + 0j if kind == DOUBLING else complex(np.exp(1j * angle))
    matrix = linear.jacobian if kind == FOLD else linear.twisted(factor, turn)
    v, adjoint = linearised.null_vectors(matrix)
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
    return float(np.linalg.norm(closed @ linearised.null_vectors(closed)[0]))
