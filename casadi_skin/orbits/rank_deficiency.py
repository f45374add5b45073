"""Why equations cannot be solved: which conditions repeat or contradict each other, and what they leave open.

Where the linearised equations are singular, the left null vector weighs the conditions that depend on each other, and
the right null vector is what they do not determine. Both come from inverse iteration on the slightly perturbed matrix
(Golub and Van Loan 2013, section 8.2.2).
"""

from __future__ import annotations

import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.stated_problem import BoundaryProblem

SINGULAR = 1e-6  # smallest singular value of the scaled matrix that counts as zero: solvers stop near such points
PERTURBED = 1e-13
ROUNDS = 4
NAMED = 0.05  # of the largest weight of a condition


def rank_deficiency(problem: BoundaryProblem, z: Array) -> str:
    """Which conditions leave which variable undetermined, and where; empty where the equations at z are regular."""
    found = _null_vectors(problem, z)
    if found is None:
        return ""
    left, right = found
    first = problem.states - problem.formulation.states  # of the equations that are conditions and integrals
    weights = np.abs(left[first:])
    if not np.max(weights, initial=0.0) > NAMED * np.max(np.abs(left)) / np.sqrt(left.size):
        return f"the equations are singular and leave {_variable(problem, z, right)} undetermined"
    rows = first + np.flatnonzero(weights > NAMED * np.max(weights))
    names = " and ".join(problem.place(int(row)) for row in rows)
    if len(rows) == 1:
        return f"{names} leaves {_variable(problem, z, right)} undetermined"
    return f"{names} repeat or contradict each other and leave {_variable(problem, z, right)} undetermined"


def _null_vectors(problem: BoundaryProblem, z: Array) -> tuple[Array, Array] | None:
    """Left and right null vectors, relative to sizes of equations and unknowns; None where there are none."""
    from scipy.sparse import csc_matrix, diags
    from scipy.sparse.linalg import splu

    try:
        _, nonzeros = problem.evaluate(z)
    except ArithmeticError:
        return None
    if not np.all(np.isfinite(nonzeros)) or problem.equations != problem.size - 1:
        return None
    rows, columns = problem.pattern
    inside = columns < problem.size - 1  # u is held
    sizes = problem.sizes(z)[:-1]
    entries = nonzeros[inside] * sizes[columns[inside]]
    largest = np.zeros(problem.size - 1)
    np.maximum.at(largest, rows[inside], np.abs(entries))
    largest[largest == 0.0] = 1.0
    n = problem.size - 1
    matrix = csc_matrix((entries / largest[rows[inside]], (rows[inside], columns[inside])), shape=(n, n))
    generator = np.random.default_rng(0)
    factors = splu((matrix + diags(PERTURBED * (1.0 + generator.random(n)))).tocsc())
    right: Array = generator.normal(size=n)
    for _ in range(ROUNDS):
        left = np.asarray(factors.solve(right / np.linalg.norm(right), trans="T"))  # type: ignore[call-overload]
        right = np.asarray(factors.solve(np.asarray(left / np.linalg.norm(left), dtype=float)))
    if not (np.all(np.isfinite(left)) and np.all(np.isfinite(right))):
        return None
    left, right = left / np.linalg.norm(left), right / np.linalg.norm(right)
    return (left, right) if np.linalg.norm(np.asarray(matrix @ right)) < SINGULAR else None


def _variable(problem: BoundaryProblem, z: Array, right: Array) -> str:
    """The unknown with the largest entry, and where it is."""
    k, n = int(np.argmax(np.abs(right))), problem.formulation.states
    if k >= problem.states:
        return problem.statement.free[k - problem.states]
    return f"{problem.statement.model.state_names[k % n]} (most at t = {problem.time(z, k // n):.6g})"
