"""Critical eigenvectors and coefficients of normal forms at special points of equilibria.

From exact second and third derivatives (Kuznetsov 2004, sections 5.4 and 10.2). Fold: a in w' = a w^2 + ..., with
critical vectors scaled by v.v = 1, psi.v = 1. Hopf point: the first Lyapunov coefficient l1 of w' = i omega w + omega
l1 w |w|^2 + ..., with q*.q = 1, p*.q = 1; a cycle is born stable where it is negative and all other eigenvalues are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from casadi_skin.follow.special_points import SpecialPoint
from casadi_skin.zero.kinds import FOLD, HOPF
from casadi_skin.zero.problem import Array
from casadi_skin.zero.statics import BalancedMatrix, ComplexArray, NullSpace, Statics, balanced, upper_pair

DECIDED_SIGN_RATIO = 1e-8  # of the terms that a coefficient is the sum of: one that is smaller has no known sign


@dataclass(frozen=True, eq=False)
class Critical:
    """The critical eigenvector, its frequency (0 of a real one), the coefficient of the normal form, and its meaning.

    `adjoint` is the critical eigenvector of the transposed Jacobian; `coefficient` is NaN where none is defined.
    """

    vector: ComplexArray
    adjoint: ComplexArray
    frequency: float
    coefficient: float
    words: str


def critical(point: SpecialPoint) -> Critical:
    """Critical eigenvector and normal form at a special point, a Hopf point that orbits shrink to among them.

    Raises ValueError for other points.
    """
    solution = point.solution
    if solution.is_orbit and point.kind == HOPF:  # of amplitude zero
        model = solution.model
        known = Statics(model, {name: solution.parameters[name] for name in model.parameter_names})
        return hopf_form(known, solution.evaluate(0.0), np.array(list(known.values.values())))
    if not solution.is_equilibrium:
        raise ValueError(f"{point.kind}: given one of {type(solution).__name__.lower()}s; accepted: one of equilibria")
    statics = solution.space.statics
    x, p = solution.positions, np.array(list(solution.parameters.values()))
    if point.kind in (HOPF, "generalized hopf"):
        return hopf_form(statics, x, p)
    return fold_form(statics, x, p) if point.kind == FOLD else _simple(statics, x, p)


def hopf_form(statics: Statics, x: Array, p: Array) -> Critical:
    """The first Lyapunov coefficient at a Hopf point (Kuznetsov 2004, equation 5.39)."""
    A = statics.jacobian(x, p)
    omega, q, adjoint = critical_pair(A)
    try:
        terms = lyapunov_terms(statics, x, p, A, omega, q, adjoint)
    except RuntimeError:  # the model is a black box with first derivatives alone
        return Critical(q, adjoint, omega, float("nan"), "unknown: the model has no higher derivatives")
    except np.linalg.LinAlgError:
        return Critical(q, adjoint, omega, float("nan"), "unknown: another eigenvalue vanishes there")
    l1 = float(np.sum(terms)) / (2.0 * omega)
    sure = abs(np.sum(terms)) > DECIDED_SIGN_RATIO * np.sum(np.abs(terms))
    words = "degenerate" if not sure else "supercritical" if l1 < 0.0 else "subcritical"
    return Critical(q, adjoint, omega, l1, words)


def lyapunov_terms(
    statics: Statics, x: Array, p: Array, A: Array, omega: float, q: ComplexArray, adjoint: ComplexArray
) -> Array:
    """The three terms whose sum over 2 omega is the first Lyapunov coefficient, shape (3,)."""
    unit = np.eye(len(A))
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


def fold_form(statics: Statics, x: Array, p: Array) -> Critical:
    """The quadratic coefficient of a fold."""
    v, psi = null_vectors(statics.jacobian(x, p))
    try:
        a = 0.5 * float((psi @ statics.second(x, p, v, v)).real)
    except RuntimeError:
        return Critical(_complex(v), _complex(psi), 0.0, float("nan"), "unknown: the model has no second derivatives")
    return Critical(_complex(v), _complex(psi), 0.0, a, "degenerate" if a == 0.0 else "quadratic")


def _simple(statics: Statics, x: Array, p: Array) -> Critical:
    v, psi = null_vectors(statics.jacobian(x, p))
    return Critical(_complex(v), _complex(psi), 0.0, float("nan"), "")


def _complex(vector: Array) -> ComplexArray:
    return vector.astype(np.complex128)
