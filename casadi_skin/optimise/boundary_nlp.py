"""Boundary-value problems with an objective or bounds: nonlinear programs for Ipopt with exact second derivatives.

The equations are those of every other solve; Ipopt (Waechter and Biegler 2006) gets the objective and the bounds
beside them. The mesh is refined and placed anew until the solution no longer changes. Bounds on states hold at the
points of the mesh: where they are active the error falls slowly, and the estimate may stay above the tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from casadi_skin.bvp.problem import Array
from casadi_skin.bvp.stated_problem import BoundaryProblem
from casadi_skin.bvp.statement import Statement
from casadi_skin.continuation.points import Point
from casadi_skin.interrupts import interrupts_deferred
from casadi_skin.models.saved import programs_in
from casadi_skin.optimise.curvature import negative_curvature
from casadi_skin.orbits.boundary_space import ITERATIONS, BoundarySpace
from casadi_skin.orbits.guesses import Guess
from casadi_skin.orbits.optimum import Optimality, Optimum
from casadi_skin.orbits.refined import BoundaryError
from casadi_skin.orbits.solution import Solution
from casadi_skin.orbits.solve import packed, space_of
from casadi_skin.solvers.levels import SAFETY, ErrorEstimate
from casadi_skin.solvers.nlp import SOLVED, nlp_reason, nlp_solver

ENOUGH = 200  # intervals where a bound holds a state, and errors fall with the distance of the points only
FACTOR = 3  # iterations allowed, times those of a problem without objective
BARRIER = 1e-3  # at first: from 0.1, Ipopt's own, most starts of a search leave what their guess is near to
FUNNEL = 1.0  # violation that no iterate exceeds, or that of the guess where it is larger: Ipopt's own is 10^4
PATIENCE = 4  # meshes that may fail, all together, to halve the error
MESHES = 2  # on which a first optimum is sought


@dataclass(frozen=True)
class _Found:
    """A solution of the program on one mesh."""

    problem: BoundaryProblem
    z: Array
    objective: float
    optimality: Optimality
    iterations: int


def optimise(statement: Statement, guess: Guess, **options: Any) -> Solution:
    """The local optimum near a guess, on a mesh refined to the tolerance; options as in `solve`.

    Raises ValueError for options out of range and BoundaryError where no optimum is found.
    """
    space = space_of(statement, guess, options)
    levels = space.levels
    found, errors = _first(space, guess), list[float]()
    while True:
        above = levels.finer(found.problem, found.z)
        if above is None or levels.finer(above) is None:
            raise BoundaryError(f"{statement.model.name}: more than {found.problem.resolution} intervals are needed")
        assert isinstance(above, BoundaryProblem)
        start = found.problem.prolong(found.z, above)
        finer = _BoundaryNlp(above, space.tolerance).solve(start)
        profile, scalars = (f(finer.z, finer.z - start) for f in (above.profile_change, above.frequency_step))
        error = ErrorEstimate(SAFETY * scalars, SAFETY * profile)
        held = above.resolution >= ENOUGH and finer.optimality.holds_states(statement.model.state_names)
        if held or error.relative(1.0) <= space.tolerance:
            unit = np.append(np.zeros(above.size - 1), 1.0)
            point = Point(above, finer.z, unit, error, 0.0, finer.iterations)
            moved = SAFETY * abs(finer.objective - found.objective)
            return Solution(space, point, optimum=Optimum(finer.objective, moved, finer.optimality))
        errors.append(error.relative(1.0))
        if len(errors) > PATIENCE and errors[-1] > 0.5 * errors[-1 - PATIENCE]:
            words = f"finer meshes, up to {above.resolution} intervals, leave a change of {errors[-1]:.1e}"
            raise BoundaryError(f"{statement.model.name}: {words}; try another guess or a larger tolerance")
        found = finer


def _first(space: BoundarySpace, guess: Guess) -> _Found:
    """The solution on the first mesh on which there is one."""
    failure: BoundaryError | None = None
    first = int(space.method.intervals or 1)
    for resolution in [r for r in space.levels.resolutions if r >= first][:MESHES]:
        problem = space.levels.problem(resolution)
        assert isinstance(problem, BoundaryProblem)
        start = packed(problem, guess)
        try:
            found = _BoundaryNlp(problem, space.tolerance).solve(start)
        except BoundaryError as error:
            failure = error
            continue
        if not np.any(start[: problem.states]):
            problem.measure_by(found.z)
        return found
    assert failure is not None
    raise failure


class _BoundaryNlp:
    """The nonlinear program of a statement on one mesh."""

    def __init__(self, problem: BoundaryProblem, tolerance: float) -> None:
        self.problem, self.statement = problem, problem.statement
        z, residual, jacobian = problem.symbols
        lengths = problem.constants_symbol
        value = _objective(problem, z)
        substituted = ca.graph_substitute([residual, jacobian, value], [lengths], [ca.MX(ca.DM(problem.constants))])
        self._residual, jacobian, value = substituted
        self._tolerance = float(np.clip(1e-2 * tolerance, 1e-11, 1e-6))
        options: dict[str, Any] = {
            "ipopt.max_iter": FACTOR * ITERATIONS,
            "ipopt.mu_init": BARRIER,
            "ipopt.theta_max_fact": FUNNEL,
        }
        self._exact = not programs_in(self.statement.model.vector_field)
        if not self._exact:  # their second derivatives would be differences, and slow
            options["ipopt.hessian_approximation"] = "limited-memory"
            constraints = [self._residual, jacobian]
            options["jac_g"] = ca.Function("jac_g", [z, ca.MX(0, 1)], constraints, ["x", "p"], ["g", "jac_g_x"])
        nlp = {"x": z, "f": value, "g": self._residual}
        self._solver = nlp_solver("programme", nlp, self._tolerance, options)
        self._derivatives = ca.Function("derivatives", [z], [self._residual, jacobian, ca.gradient(value, z)])
        self.lower, self.upper = self._bounds()

    def _bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of all unknowns; u is held."""
        problem, model = self.problem, self.statement.model
        bounds = np.tile([[-np.inf], [np.inf]], problem.size)
        bounds[:, -1] = 0.0
        for name, pair in self.statement.bounds.items():
            if name in self.statement.free:
                bounds[:, problem.states + list(self.statement.free).index(name)] = pair
            else:
                place = model.state_names.index(name)
                bounds[:, place : problem.states : model.full_size] = np.array(pair)[:, None]
        return bounds[0], bounds[1]

    def solve(self, start: Array) -> _Found:
        """The local optimum near a start; raises BoundaryError with Ipopt's reason, condition and place."""
        zero = np.zeros(self.problem.equations)
        start = np.clip(start, self.lower, self.upper)
        with interrupts_deferred():
            result = self._solver(x0=start, lbx=self.lower, ubx=self.upper, lbg=zero, ubg=zero)
        stats = self._solver.stats()
        status, z = str(stats["return_status"]), np.array(result["x"]).ravel()
        if status != SOLVED:
            raise BoundaryError(f"{self.statement.model.name}: {nlp_reason(status)}; {self._worst(z)}")
        backwards = self.problem.backwards(z)
        if backwards:
            raise BoundaryError(f"{self.statement.model.name}: {backwards}; bound it from below")
        multipliers = [np.array(result[key]).ravel() for key in ("lam_g", "lam_x")]
        optimality = self._optimality(z, *multipliers)
        curvature = self._negative_curvature(z, *multipliers)
        if curvature < 0.0:
            words = f"is stationary, but no minimum: curvature {curvature:.1e} of the largest"
            where = self.problem.whereabouts(z)
            raise BoundaryError(f"{self.statement.model.name}: the point found {words}, {where}; try another guess")
        return _Found(self.problem, z, float(result["f"]), optimality, int(stats["iter_count"]))

    def _optimality(self, z: Array, of_equations: Array, of_bounds: Array) -> Optimality:
        """The Karush-Kuhn-Tucker conditions, evaluated apart from Ipopt."""
        residual, jacobian, gradient = self._derivatives(z)
        gradient, residual = np.array(gradient).ravel(), np.array(residual).ravel()
        stationarity = gradient + np.array(jacobian.T @ ca.DM(of_equations)).ravel() + of_bounds
        size = max(1.0, float(np.max(np.abs(of_equations), initial=0.0)), float(np.max(np.abs(gradient))))
        below, above = z - self.lower, self.upper - z
        with np.errstate(invalid="ignore"):
            slack = np.where(of_bounds < 0, below, above)
        bounded = self.lower < self.upper
        complementarity = np.where(of_bounds == 0, 0.0, np.abs(of_bounds) * np.where(np.isfinite(slack), slack, 1.0))
        violation = max(float(np.max(np.abs(residual))), float(np.max(-np.minimum(below, above)[bounded], initial=0.0)))
        parts = float(np.max(np.abs(stationarity[bounded]))) / size, float(np.max(complementarity[bounded])) / size
        return Optimality(max(parts), violation, self._active(z, of_bounds, size), self._exact)

    def _negative_curvature(self, z: Array, of_equations: Array, of_bounds: Array) -> float:
        """The most negative curvature at a stationary point, of what bounds do not hold; 0 at a minimum, or unknown."""
        if not self._exact:
            return 0.0
        upper = self._solver.get_function("nlp_hess_l")(z, [], 1.0, of_equations)
        held = np.sqrt(self._tolerance) * max(1.0, float(np.max(np.abs(of_equations), initial=0.0)))
        left = (self.lower < self.upper) & (np.abs(of_bounds) <= held)
        jacobian = self._derivatives(z)[1].sparse().tocsc()
        return negative_curvature(ca.triu2symm(upper).sparse().tocsc(), jacobian, self.problem.sizes(z), left)

    def _active(self, z: Array, of_bounds: Array, size: float) -> tuple[str, ...]:
        """Bounds that hold the solution, in words."""
        found, held = [], np.abs(of_bounds) > np.sqrt(self._tolerance) * size
        problem, statement = self.problem, self.statement
        for name in statement.bounds:
            if name in statement.free:
                at = slice(problem.states + list(statement.free).index(name), None, problem.size)
            else:
                at = slice(statement.model.state_names.index(name), problem.states, statement.model.full_size)
            for sign, side, limit in ((-1, ">=", self.lower), (1, "<=", self.upper)):
                count = int(np.count_nonzero(held[at] & (sign * of_bounds[at] > 0)))
                if count:
                    where = "" if name in statement.free else f" at {count} of {held[at].size} points"
                    found.append(f"{name} {side} {limit[at][0]:g}{where}")
        return tuple(found)

    def _worst(self, z: Array) -> str:
        """The equation that is violated most, by how much and where."""
        residual = np.abs(np.array(self._derivatives(z)[0]).ravel())
        if not np.all(np.isfinite(residual)):
            return f"not finite at {self.problem.place(int(np.argmin(np.isfinite(residual))))}"
        worst = int(np.argmax(residual))
        return f"largest violation {residual[worst]:.1e} of {self.problem.place(worst)}, {self.problem.whereabouts(z)}"


def _objective(problem: BoundaryProblem, z: ca.MX) -> ca.MX:
    """What is minimised, in ends and parameters, plus an integral."""
    statement, n = problem.statement, problem.formulation.states
    model, total = statement.model, ca.MX(0)
    values, scalars = ca.reshape(z[: problem.states], n, problem.columns), z[problem.states :]
    p = statement.parameters_at(scalars)
    if statement.objective is not None:
        at_ends = ca.Function("objective", [*model.ends, model.parameters], [statement.objective])
        total += at_ends(values[:, 0], values[:, -1], p)
    if statement.running is not None:
        start, end = statement.ends_at(p)
        stages = problem.stages.tolist()
        places = start + problem.places * (end - start)
        along = statement.along("running", statement.running).map(len(stages))
        weights = ca.vec(ca.kron(problem.constants_symbol, ca.DM(problem.table.extended[-1])))
        total += (end - start) * (along(places, values[:, stages], ca.repmat(p, 1, len(stages))) @ weights)
    return total
