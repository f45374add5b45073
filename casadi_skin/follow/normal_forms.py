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
from typing import cast

import numpy as np

from casadi_skin.follow.solution import Solution
from casadi_skin.follow.space import Followed
from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.zero.balanced import ComplexArray, balanced
from casadi_skin.zero.kinds import BAUTIN, DOUBLING, FOLD, HOPF, HOPF_HOPF, ORBIT_CURVES, kind_of
from casadi_skin.zero.linearised import Linearised, LinearisedEquations, LinearisedRest, Vector, bordered, null_vectors
from casadi_skin.zero.problem import EPSILON, Array
from casadi_skin.zero.rest import Statics
from casadi_skin.zero.settings import Point
from casadi_skin.zero.stated_problem import Closure

DECIDED_SIGN_RATIO = 1e-8  # of the terms that a coefficient is the sum of: one that is smaller has no known sign
VECTOR_ROUNDING = 16.0 * EPSILON  # of the largest entries of critical vectors, in all of theirs


@dataclass(frozen=True, eq=False)
class Critical:
    """The critical eigenvector, its frequency (0 of a real one), the coefficient of the normal form, and its meaning.

    `coefficient` is NaN where none is defined.
    """

    vector: ComplexArray
    frequency: float
    coefficient: float = float("nan")
    words: str = ""


def critical(point: SpecialPoint) -> Critical:
    """Normal form at a special point of equilibria or orbits; raises ValueError for another point."""
    linear, kind = _linearised(point), HOPF if point.kind in (BAUTIN, HOPF_HOPF) else point.kind
    (v, adjoint), (frequency, unit) = linear.critical(kind), linear.scales(kind)
    start = v[: linear.components]
    vector = np.asarray(start / np.linalg.norm(start), dtype=np.complex128)
    if point.kind == HOPF_HOPF or not kind_of(kind).has_coefficient:
        return Critical(vector, frequency)
    try:
        found = terms_of(kind, linear, v, adjoint) / unit
        off = terms_of(kind, linear, rounded(v), rounded(adjoint)) / unit - found
    except (RuntimeError, NotImplementedError):  # a black box with first derivatives alone
        order = "second" if kind == FOLD else "higher"
        return Critical(vector, frequency, words=f"unknown: the model has no {order} derivatives")
    except np.linalg.LinAlgError as error:
        return Critical(vector, frequency, words=f"unknown: {error}")
    value = float(np.sum(found))
    words = "quadratic" if kind == FOLD else "supercritical" if value < 0.0 else "subcritical"
    if abs(value) <= float(np.sum(DECIDED_SIGN_RATIO * np.abs(found) + np.abs(off))):
        words = "degenerate"
    return Critical(vector, frequency, value, words)


def rounded(v: Vector) -> Vector:
    """A vector with as much of every component as rounding may leave: it is less where one is decoupled from it."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], v.size)
    return np.asarray(v + VECTOR_ROUNDING * np.max(np.abs(v)) * signs)


def _linearised(point: SpecialPoint) -> LinearisedEquations:
    """The equations around a special point; raises ValueError where it has no normal form."""
    solution, space, kind = point.solution, point.solution.space, point.kind
    if not space.is_critical(kind):
        raise ValueError(f"{kind}: a zero of a monitor, which has no normal form")
    closure = _closed(point)
    of_orbits = kind in ORBIT_CURVES and kind_of(kind).has_coefficient and not space.is_family
    if of_orbits and (solution.is_orbit or closure is not None):
        problem, length = solution.problem, float(np.diff(space.interval(solution.point))[0])
        turn = None if closure is None else closure.matrix
        return Linearised(problem, solution.point.z, problem.statement, critical_angle(kind, solution), turn, length)
    near = solution.point.angle
    if solution.is_equilibrium:
        statics, x = space.statics, solution.positions
        if space.kind == HOPF and kind in (BAUTIN, HOPF_HOPF):  # of the pair whose curve it is on
            near = solution.point.problem.frequency_of(solution.point.z)
    elif solution.is_orbit and kind == HOPF:  # of amplitude zero
        names, near = solution.model.parameter_names, 2.0 * np.pi / solution.period
        statics, x = (
            Statics(solution.model, {name: solution.parameters[name] for name in names}),
            solution.evaluate(0.0),
        )
    else:
        raise ValueError(f"{kind}: given one of {type(solution).__name__.lower()}s; accepted: one of equilibria")
    p = np.array([solution.parameters[name] for name in statics.values])
    return LinearisedRest(statics, x, p, np.ones_like(x), balanced(statics.matrix(x, p))[1], near=near)


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


def critical_angle(kind: str, orbit: Solution | None = None) -> float:
    """The angle of the critical multipliers; of pairs, at an orbit, of the one located there, or of that
    nearest to the circle."""
    angle = kind_of(kind).angle
    if orbit is None or angle is not None:
        return angle or 0.0
    near = orbit.point.angle
    others = orbit.floquet().others
    upper = others[others.imag > 0.0]
    apart = np.abs(np.abs(upper) - 1.0) if near is None else np.abs(upper - np.exp(1j * near))
    return abs(float(np.angle(upper[np.argmin(apart)])))


def terms_of(kind: str, linear: LinearisedEquations, v: Vector, adjoint: Vector) -> Array:
    """The terms whose sum, over the unit of time, is the coefficient; raises as `response`."""
    psi, D = adjoint[: linear.inner].conj(), linear.derivative
    over = psi @ linear.velocity(v)

    def projected(*parts: Vector) -> Array:
        return np.array([-(psi @ part / over).real for part in parts])

    if kind == FOLD:
        return projected(0.5 * D(v, v))
    if kind == DOUBLING:
        return projected(D(v, v, v) / 6.0, 0.5 * D(v, linear.response(D(v, v))))
    steady, double = linear.response(D(v, v.conj()).real), linear.response(D(v, v), 2)
    return projected(0.5 * D(v, v, v.conj()), D(v, steady), 0.5 * D(v.conj(), double))


# Along curves of folds and of branch points: the terms that vanish where these degenerate -----------------------------


def quadratic_term(space: Followed, beside: Point) -> Callable[[Point], float]:
    """The quadratic term at folds as a function of points of their curve, which vanishes where two of them meet.

    Its sign goes on from a point beside them by the normal of the curve in the plane of both parameters: the left null
    vector itself may turn by more than a right angle within a step.
    """

    def normal(linear: LinearisedEquations) -> Array:
        return np.asarray(linear.null_vectors[1] @ linear.by_parameters)

    reference = normal(space.linearised(beside))

    def term(point: Point) -> float:
        linear = space.linearised(point)
        v, psi = linear.null_vectors
        v = linear.normalised(v)
        return float(0.5 * np.copysign(1.0, normal(linear) @ reference) * (psi @ linear.full_derivative(v, v)))

    return term


def branching_terms(linear: LinearisedEquations, reference: LinearisedEquations) -> tuple[Array, Array]:
    """The terms of a and c of the branching equation a w^2 + c w^3 + ... = 0 at a branch point, one each.

    They are zero but for rounding where a symmetry makes them so. Signs of null vectors are those at another point of
    the curve: of v by its values, of psi by what it sees of v.
    """
    from scipy.sparse.linalg import splu

    (v, psi), v0 = linear.null_vectors, reference.normalised(reference.null_vectors[0])
    v = linear.normalised(v)
    v = v * np.sign(np.sum(linear.along(v) * reference.along(v0)))
    over, D = linear.seen(v) @ reference.seen(v0), linear.full_derivative
    twice = D(v, v)
    bent = splu(bordered(linear.jacobian, v[:, None], psi[:, None])).solve(np.append(-twice, 0.0))[:-1]
    return 0.5 * psi * twice / over, np.concatenate([psi * D(v, v, v) / 6.0, 0.5 * psi * D(v, bent)]) / over


def second_singular(linear: LinearisedEquations) -> float:
    """The smallest singular value of the Jacobian bordered by its null vectors."""
    closed = bordered(linear.jacobian, *(vector[:, None] for vector in linear.null_vectors))
    return float(np.linalg.norm(closed @ null_vectors(closed)[0]))
