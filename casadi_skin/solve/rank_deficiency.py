"""Equations that cannot be solved: the conditions that repeat or contradict each other, and the open unknowns.

Where the linearised equations are singular, the left null vector weighs the conditions that depend on each other, and
the right null vector is what they do not determine. Both come from inverse iteration on the slightly perturbed matrix
(Golub and Van Loan 2013, section 8.2.2).
"""

from __future__ import annotations

import numpy as np

from casadi_skin.solve.bordered import LONG_ROW_FACTOR, long_rows
from casadi_skin.zero.orbit import UNFOLDING, Extended
from casadi_skin.zero.problem import Array
from casadi_skin.zero.stated_problem import BoundaryProblem

ZERO_SINGULAR_VALUE = (
    1e-6  # smallest singular value of the scaled matrix that counts as zero: solvers stop near such points
)
PERTURBATION_RTOL = 1e-13
ITERATION_ROUNDS = 4
ADDED_PARAMETERS = ("period", UNFOLDING)  # parameters that are not the model's
RESTING_STATE_RATIO = 1e-2  # of the sizes that states are measured by at least, a thousandth of the guess
SHRUNK_ORBIT_FACTOR = 100.0  # of the same: an orbit within a tenth of the guess's size nears an equilibrium
MOVING_STATE_FACTOR = 100.0  # of the same: a state that changes by more in the guessed period does not rest
GENERAL_POSITION_DISTANCE = 0.1  # of the sizes of unknowns: how far off z a point in general position is
NAMED_CONDITION_WEIGHT = 0.05  # of the largest weight of a condition


def rank_deficiency(problem: BoundaryProblem, z: Array, everywhere: bool = False) -> str:
    """Which conditions leave which variable undetermined, and where; empty where the equations at z are regular.

    An orbit that rests is reported instead: any period closes it.
    With `everywhere` also where they are singular at z alone: what has not been reached is then at fault, and not the
    problem.
    """
    if "period" in problem.statement.free and _rests(problem, z):
        return equilibrium_words(problem, z)
    found = _null_vectors(problem, z)
    if found is None:
        return ""
    if everywhere:
        noise = np.random.default_rng(1).normal(size=z.size - 1)
        if (
            _null_vectors(problem, np.append(z[:-1] + GENERAL_POSITION_DISTANCE * problem.sizes(z)[:-1] * noise, z[-1]))
            is None
        ):
            return ""
    left, right = found
    first = problem.states - problem.formulation.states  # of the equations that are conditions and integrals
    weights = np.abs(left[first:])
    if not np.max(weights, initial=0.0) > NAMED_CONDITION_WEIGHT * np.max(np.abs(left)) / np.sqrt(left.size):
        return f"the equations are singular and leave {_variable(problem, z, right)} undetermined"
    rows = first + np.flatnonzero(weights > NAMED_CONDITION_WEIGHT * np.max(weights))
    names = " and ".join(problem.place(int(row)) for row in rows)
    if len(rows) == 1:
        return f"{names} leaves {_variable(problem, z, right)} undetermined"
    return f"{names} repeat or contradict each other and leave {_variable(problem, z, right)} undetermined"


def in_family(problem: BoundaryProblem, z: Array) -> str:
    """That an orbit is one of many that only a conserved quantity tells apart; empty where the equations are regular.

    At a solution of an orbit's equations alone: the conditions at its ends and its phase fix all else. Beside a Hopf
    point the equations are singular as well, for amplitudes near 0 alone: of an orbit that has shrunk nothing is said.
    """
    model = problem.statement.model
    orbit = "period" in problem.statement.free and isinstance(model, Extended)
    if not orbit or _rests(problem, z, SHRUNK_ORBIT_FACTOR) or _null_vectors(problem, z) is None:
        return ""
    more = "more than is declared" if any(name.startswith(UNFOLDING) for name in model.parameter_names) else "something"
    declare = "accepted: what is conserved declared, as hamiltonian= or in conserved=, with select= to pick an orbit"
    return f"orbits come in a family there, for the model seems to conserve {more}; {declare}"


def not_finite(problem: BoundaryProblem, z: Array) -> str:
    """The equation that is not finite at z, where, and the state there; empty where all are finite."""
    try:
        residual, nonzeros = problem.evaluate(z)
    except ArithmeticError as error:
        return str(error)
    rows = np.flatnonzero(~np.isfinite(residual))
    what = "not finite"
    if not rows.size:
        rows, what = problem.pattern[0][~np.isfinite(nonzeros)], "a derivative is not finite"
    if not rows.size:
        return ""
    n, row = problem.formulation.states, int(rows[0])
    column = min(row // n + 1, problem.columns - 1)
    states = z[: problem.states].reshape(-1, n)[column]
    at = ", ".join(f"{k} = {x:.6g}" for k, x in zip(problem.statement.model.state_names, states, strict=True))
    return f"{what} at {problem.place(row)}, where {at} at the guess"


def equilibrium_words(problem: BoundaryProblem, z: Array) -> str:
    """That an orbit has come to rest, and where; or that it is a point alone, after no time."""
    model, p = problem.statement.model, problem.parameters(z)
    start = z[: problem.formulation.states]
    state = ", ".join(f"{name} = {value:.6g}" for name, value in zip(model.state_names, start, strict=True))
    values = zip(model.parameter_names, p, strict=True)
    at = ", ".join(f"{name} = {value:.6g}" for name, value in values if not name.startswith(ADDED_PARAMETERS))
    place = f"({state}{f', at {at}' if at else ''})"
    guessed = problem.statement.values.get(ADDED_PARAMETERS[0], 1.0)
    moves = np.abs(np.array(model.vector_field(0.0, start, p)).ravel()) * guessed
    if np.any(moves > MOVING_STATE_FACTOR * problem.floors):
        period = dict(zip(model.parameter_names, p, strict=True)).get(ADDED_PARAMETERS[0], 0.0)
        return f"the orbit has shrunk to a point at which the model does not rest {place}, its period to {period:.2g}"
    return f"this is an equilibrium: the orbit has shrunk to it {place}"


def _rests(problem: BoundaryProblem, z: Array, most: float = RESTING_STATE_RATIO) -> bool:
    """Whether states move by less than so much of what the guess's own sizes distinguish."""
    states = z[: problem.states].reshape(-1, problem.formulation.states)
    return bool(np.all(np.ptp(states, axis=0) <= most * problem.floors))


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
    largest[long_rows(rows, problem.size)] /= LONG_ROW_FACTOR
    n = problem.size - 1
    matrix = csc_matrix((entries / largest[rows[inside]], (rows[inside], columns[inside])), shape=(n, n))
    generator = np.random.default_rng(0)
    order = problem.elimination_order[:-1]  # u is the last
    perturbed = (matrix + diags(PERTURBATION_RTOL * (1.0 + generator.random(n)))).tocsc()[:, order]
    factors = splu(perturbed, permc_spec="NATURAL")
    right: Array = generator.normal(size=n)
    for _ in range(ITERATION_ROUNDS):
        scaled = right[order] / np.linalg.norm(right)
        left = np.asarray(factors.solve(scaled, trans="T"))  # type: ignore[call-overload]
        right[order] = factors.solve(np.asarray(left / np.linalg.norm(left), dtype=float))
    if not (np.all(np.isfinite(left)) and np.all(np.isfinite(right))):
        return None
    left, right = left / np.linalg.norm(left), right / np.linalg.norm(right)
    return (left, right) if np.linalg.norm(np.asarray(matrix @ right)) < ZERO_SINGULAR_VALUE else None


def _variable(problem: BoundaryProblem, z: Array, right: Array) -> str:
    """The unknown with the largest entry, and where it is."""
    k, n = int(np.argmax(np.abs(right))), problem.formulation.states
    if k >= problem.states:
        return problem.statement.free[k - problem.states]
    return f"{problem.statement.model.state_names[k % n]} (most at t = {problem.time(z, k // n):.6g})"
