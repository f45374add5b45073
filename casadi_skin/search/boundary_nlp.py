"""Boundary-value problems with an objective or bounds as nonlinear programmes, on meshes that follow the solution.

The equations are those of every other solve; Ipopt (Waechter and Biegler 2006) gets the objective and the bounds
beside them. The mesh is refined and placed anew until the solution no longer changes. Bounds on states hold at the
points of the mesh: where they are active the error falls slowly, and the estimate may stay above the tolerance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.follow import solution as solutions
from casadi_skin.follow.boundary_space import MOST_IPOPT_ITERATIONS, BoundarySpace
from casadi_skin.follow.find import limits_of, packed, space_of
from casadi_skin.follow.find import solve as without_objective
from casadi_skin.follow.space import BoundaryError
from casadi_skin.model.pickled import programs_in
from casadi_skin.model.result import in_turn
from casadi_skin.search.conditions import Condition
from casadi_skin.search.nlp import Nlp, Optimality, Solution, optimality
from casadi_skin.solve.ipopt import SOLVED_STATUS, nlp_reason
from casadi_skin.solve.levels import ERROR_SAFETY
from casadi_skin.zero.orbit import Guess
from casadi_skin.zero.problem import Array
from casadi_skin.zero.settings import ErrorEstimate, Point
from casadi_skin.zero.stated_problem import PERIOD, BoundaryProblem, stated
from casadi_skin.zero.statement import Statement

ENOUGH_INTERVALS = 200  # intervals where a bound holds a state, and errors fall with the distance of the points only
IPOPT_OPTIONS: Mapping[str, Any] = {
    "ipopt.max_iter": 3 * MOST_IPOPT_ITERATIONS,
    "ipopt.mu_init": 1e-3,  # from 0.1, Ipopt's own, most starts of a search leave the solution near their guess
    "ipopt.theta_max_fact": 1.0,  # no iterate violates more than the guess, or 1; Ipopt's own factor is 10^4
}
MOST_FAILED_HALVINGS = 4  # meshes that may fail, all together, to halve the error
FIRST_MESHES = 2  # on which a first optimum is sought


class BoundaryNlp(Nlp):
    """The nonlinear programme of a statement on one mesh; `held` are conditions on expressions in ends and parameters.

    `free` names the scalars by which optima are compared, relative to these numbers; curvature is measured in them,
    but for the period. Where there are none it is measured in all unknowns.
    """

    def __init__(
        self, space: BoundarySpace, problem: BoundaryProblem, held: Sequence[Condition] = (),
        free: Mapping[str, float] | None = None, maximise: bool = False,
    ) -> None:  # fmt: skip
        self.space, self.problem, self.statement = space, problem, problem.statement
        self._made = held, free, maximise
        z, residual, jacobian = problem.symbols
        value, rows = _objective_and_conditions(problem, z, held)
        made = [residual, ca.vertcat(jacobian, ca.jacobian(rows, z)), value, rows]
        lengths = [problem.constants_symbol], [ca.MX(ca.DM(problem.constants))]
        residual, jacobian, value, rows = ca.graph_substitute(made, *lengths)
        tolerance = float(np.clip(1e-2 * space.tolerance, 1e-11, 1e-6))
        statement, scalars = self.statement, {n: problem.states + k for k, n in enumerate(self.statement.free)}
        names, n = statement.model.state_names, statement.model.full_size
        places = {name: np.arange(k, problem.states, n) for k, name in enumerate(names)} | scalars
        super().__init__(
            z, value, ca.vertcat(residual, rows),
            {"": (problem.size - 1, 0.0, 0.0)} | {  # u is held at 0
                name: (np.atleast_1d(places[name]), *ends) for name, ends in statement.bounds.items()},
            held, jacobian=jacobian, maximise=maximise,
            exact=not programs_in(statement.model.vector_field),  # their second derivatives would be differences
            options={**IPOPT_OPTIONS, "ipopt.tol": tolerance, "ipopt.constr_viol_tol": tolerance},
            place=z[[scalars[name] for name in free]] / ca.DM(list(free.values())) if free else None,
            measured=[scalars[name] for name in free or () if name != PERIOD], sizes=problem.sizes,
        )  # fmt: skip

    def on(self, problem: BoundaryProblem) -> BoundaryNlp:
        """The same programme on another mesh."""
        return BoundaryNlp(self.space, problem, *self._made)

    def fault(self, x: Array) -> str:
        return self.problem.backwards(x)

    def times(self, x: Array) -> Array:
        return np.array([self.problem.time(x, column) for column in range(self.problem.columns)])

    def equation_name(self, row: int, x: Array) -> str:
        return self.problem.place(row)

    def solved(self, start: Array, warm: bool = False) -> Solution:
        """The local optimum near a start; raises BoundaryError with Ipopt's reason, condition and place."""
        name, solution = self.statement.model.name, self.solve(start, warm=warm)
        if solution.words != SOLVED_STATUS:
            raise BoundaryError(f"{name}: {nlp_reason(solution.words)}; {self._worst(solution.x)}")
        if self.fault(solution.x):
            raise BoundaryError(f"{name}: {self.fault(solution.x)}; bound it from below")
        negative = optimality(self, solution).negative
        if negative < 0.0:
            words = f"is stationary, but no minimum: curvature {negative:.1e} of the largest"
            where = self.problem.describe_parameters(solution.x)
            raise BoundaryError(f"{name}: the point found {words}, {where}; try another guess")
        return solution

    def _worst(self, z: Array) -> str:
        """The equation that is violated most, by how much and where."""
        residual = self.violations(self.residual(z))
        if not np.all(np.isfinite(residual)):
            return f"not finite at {self.row_name(int(np.argmin(np.isfinite(residual))), z)}"
        worst = int(np.argmax(residual))
        place = f"{self.row_name(worst, z)}, {self.problem.describe_parameters(z)}"
        return f"largest violation {residual[worst]:.1e} of {place}"


@dataclass(frozen=True, eq=False)
class Refined:
    """An optimum on a mesh that meets the tolerance, with its estimated errors, that of the objective among them."""

    nlp: BoundaryNlp
    solution: Solution
    optimality: Optimality
    error: ErrorEstimate
    objective_error: float

    @property
    def optimum(self) -> solutions.Optimum:
        """The optimum as a solution carries it."""
        found, value = self.optimality, self.solution.objective
        return solutions.Optimum(value, self.objective_error, found.kkt, found.violation, found.active, self.nlp.exact)

    @property
    def point(self) -> Point:
        """The solution's point, with u held."""
        problem = self.nlp.problem
        unit = np.append(np.zeros(problem.size - 1), 1.0)
        return Point(problem, self.solution.x, unit, self.error, 0.0, self.solution.iterations)


@in_turn
def solve(statement: Statement, guess: Guess, **options: Any) -> solutions.Solution:
    """The solution of a boundary-value problem near a guess; with an objective or bounds the local optimum.

    Arguments:
        statement: the problem.
        guess: the states: numbers, one a state; a function of t; numbers or functions by state name; (t, x) with x of
            shape (times, states); a simulation; another solution.
        options: `tolerance`, which bounds the estimated error of each state relative to its largest value and of each
            free parameter, and of methods `transcription` "gauss" or "radau" with `degree` stages,
            `corrector`, `intervals` of the first mesh; `time_limit` in seconds, and `progress`, a function called
            with the state of the solution in words.

    Returns:
        The solution with its estimated errors; `found_by` names the method where the corrector alone did not find it.
        An optimum is on a mesh refined to the tolerance.

    Raises:
        ValueError: an argument is out of range.
        JumpError: the equations jump along the solution; a ValueError.
        BoundaryError: no solution or optimum is found to the tolerance; the message names condition, variable, place.
    """
    if not (statement.optimises or statement.bounds):
        return without_objective(statement, guess, **options)
    if any(limit is not None for limit in limits_of(options)):
        raise ValueError("time_limit: given with an objective or bounds; accepted: without, as is progress")
    space = space_of(statement, guess, options)
    found = refined(*_first(space, guess))
    return solutions.Solution(space, found.point, optimum=found.optimum)


def refined(nlp: BoundaryNlp, solution: Solution, flat: bool = False) -> Refined:
    """An optimum on meshes that are refined until it no longer changes.

    Where a `flat` objective is allowed, which has the same value at neighbours, one refinement is enough. Raises
    BoundaryError where no mesh on offer is fine enough, or finer ones do not converge.
    """
    levels, tolerance, errors = nlp.space.levels, nlp.space.tolerance, list[float]()
    name, states = nlp.statement.model.name, nlp.statement.model.state_names
    while True:
        above: Any = levels.finer(nlp.problem, solution.x)
        if above is None or levels.finer(above) is None:
            raise BoundaryError(f"{name}: more than {nlp.problem.resolution} intervals are needed")
        start, finer = nlp.problem.prolong(solution.x, above), nlp.on(stated(above))
        better = finer.solved(start, warm=True)
        moved = better.x - start
        scalars, profile = above.frequency_step(better.x, moved), above.profile_change(better.x, moved)
        error = ErrorEstimate(ERROR_SAFETY * scalars, ERROR_SAFETY * profile)
        conditions, moved_by = optimality(finer, better), ERROR_SAFETY * abs(better.objective - solution.objective)
        enough = above.resolution >= ENOUGH_INTERVALS and any(w.split()[0] in states for w in conditions.active)
        if enough or (flat and conditions.flat) or error.relative(1.0) <= tolerance:
            return Refined(finer, better, conditions, error, moved_by)
        errors.append(error.relative(1.0))
        if len(errors) > MOST_FAILED_HALVINGS and errors[-1] > 0.5 * errors[-1 - MOST_FAILED_HALVINGS]:
            words = f"finer meshes, up to {above.resolution} intervals, leave a change of {errors[-1]:.1e}"
            raise BoundaryError(f"{name}: {words}; try another guess or a larger tolerance")
        nlp, solution = finer, better


def _first(space: BoundarySpace, guess: Guess) -> tuple[BoundaryNlp, Solution]:
    """The solution on the first mesh on which there is one."""
    failure: BoundaryError | None = None
    first = int(space.method.intervals or 1)
    for resolution in [r for r in space.levels.resolutions if r >= first][:FIRST_MESHES]:
        problem = stated(space.levels.problem(resolution))
        start, nlp = packed(problem, guess), BoundaryNlp(space, problem)
        try:
            solution = nlp.solved(start)
        except BoundaryError as error:
            failure = error
            continue
        if not np.any(start[: problem.states]):
            problem.measure_by(solution.x)
        return nlp, solution
    assert failure is not None
    raise failure


def _objective_and_conditions(problem: BoundaryProblem, z: ca.MX, held: Sequence[Condition]) -> tuple[ca.MX, ca.MX]:
    """The objective, in ends and parameters plus an integral, and the expressions of conditions, a column."""
    statement, model, n = problem.statement, problem.statement.model, problem.formulation.states
    values, scalars = ca.reshape(z[: problem.states], n, problem.columns), z[problem.states :]
    p = statement.parameters_at(scalars)
    kind, objective = type(model.state), statement.objective
    expressions = [kind(0) if objective is None else objective, ca.vertcat(kind(0, 1), *(h.quantity for h in held))]
    at_ends = ca.Function("at_ends", [*model.ends, model.parameters], expressions)
    total, rows = ca.MX(0), ca.MX(0, 1)
    if held or objective is not None:
        total, rows = at_ends(values[:, 0], values[:, -1], p)
    if statement.running is not None:
        start, end = statement.ends_at(p)
        stages = problem.stages.tolist()
        places = start + problem.places * (end - start)
        along = statement.along("running", statement.running).map(len(stages))
        weights = ca.vec(ca.kron(problem.constants_symbol, ca.DM(problem.table.extended[-1])))
        total += (end - start) * (along(places, values[:, stages], ca.repmat(p, 1, len(stages))) @ weights)
    return total, rows
