"""Resolutions of one orbit problem from coarse to fine, each built when first needed, and the error between two.

A first mesh for solutions with layers: placed again and again at a fixed number of intervals until it has settled.

Collocation at Gauss points does not damp what it does not resolve: on a coarse uniform mesh a layer at an end leaves
no trace in the solution, and a layer inside makes it oscillate everywhere. A mesh that is graded towards both ends
resolves the former at once, and repeated equidistribution (de Boor 1973; Ascher, Mattheij and Russell 1995, section
9.1) finds the latter.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from casadi_skin.solve.between_ends import step_on_finer
from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.solve.newton import Correction, Corrector
from casadi_skin.zero import mesh
from casadi_skin.zero.problem import EPSILON, Array, Problem, Scalar, SingularError, Solve
from casadi_skin.zero.settings import ErrorEstimate, Refinement
from casadi_skin.zero.stated_problem import BoundaryProblem, stated

# Errors of points, from Newton steps on a finer level: estimates, and their part by rounding --------------------------

ERROR_SAFETY = 2.0  # the finer step is asymptotically the error itself; twice it covers what the finer grid misses
NEAR_ROUND_OFF = 1e-9  # relative errors below this are compared with those of rounding
FOLD_TANGENT_RATIO = 1e-4  # tangents that change the parameter by less than this part of its size are those of a fold


Measured = tuple[ErrorEstimate, Refinement | None]


def step_error(
    problem: Problem, z: Array, step: Array, with_parameter: bool = False, profile: float | None = None
) -> ErrorEstimate:
    """The error that a step from z to the better point makes up for; `profile` is its change of that, where known."""
    parameter = abs(float(step[problem.parameter_index])) / problem.parameter_size(z) if with_parameter else 0.0
    Omega, profile = (
        abs(problem.frequency_step(z, step)),
        problem.profile_change(z, step) if profile is None else profile,
    )
    return ErrorEstimate(ERROR_SAFETY * Omega, ERROR_SAFETY * profile, parameter=ERROR_SAFETY * parameter)


@dataclass(frozen=True)
class OnFiner:
    """States prolonged to the next level `problem`, (states, size), with a Newton step from each.

    `response` gives the responses to residuals of the size of their rounding, where these are needed; `between` is what
    the one state misses between its unknowns.
    """

    problem: Problem
    z: Array
    steps: Array
    response: Callable[[], Array]
    between: Array | None = None


def estimated(
    problem: Problem,
    z: Array,
    on_finer: OnFiner,
    tangents: Array | None,
    along: Array | None,
    held: Sequence[Scalar | None],
) -> list[Measured]:
    """The errors of states (states, size) and the better orbits, from the next level.

    `tangents` are the tangents at the states, `along` those on the next level. Where something is `held`, the step does
    not use the tangent.
    """
    finer, long_z, between = on_finer.problem, on_finer.z, on_finer.between
    ways = [None if along is None or which is not None else along[i] for i, which in enumerate(held)]

    def back(steps: Array) -> Array:
        return np.array([at_parameter(finer, *one) for one in zip(long_z, steps, ways, strict=True)])

    steps, noise, found = back(on_finer.steps), None, list[Measured]()
    better = long_z - steps
    if between is None:
        changes = finer.profile_changes(long_z, steps).tolist()
    else:
        changes = [finer.profile_change(long_z[0], steps[0], between)]
    for i, which in enumerate(held):
        Omega, by_Omega = problem.frequency(z[i]), which is Scalar.OMEGA
        moves = by_Omega or (ways[i] is not None and steps[i, finer.parameter_index] != 0.0)
        error, floor = step_error(finer, long_z[i], steps[i], moves, changes[i]), 0.0
        least = problem.round_off * Omega
        if between is not None:  # a step is right up to its square, and that of Omega goes through zero
            least = max(least, error.profile**2 * Omega)
        parts = [max(error.Omega, least), error.profile, error.parameter]
        # At least that by rounding, of residual and constants; a period alone may be there long before the profile is.
        near = max(parts[0] / Omega, *parts[1:]) < NEAR_ROUND_OFF
        if max(parts[1:]) < NEAR_ROUND_OFF or 0.0 < error.Omega < NEAR_ROUND_OFF * Omega:
            if noise is None:
                noise = back(on_finer.response())
                rounded = finer.profile_changes(long_z, noise).tolist()
            own = step_error(finer, long_z[i], noise[i], moves, rounded[i])
            by_rounding = [
                max(own.Omega, problem.round_off * Omega),
                max(own.profile, problem.round_off),
                own.parameter,
            ]
            if near:
                floor = max(by_rounding[0] / Omega, *by_rounding[1:])
            if by_Omega and tangents is not None:
                by_rounding[2] = max(own.parameter, _by_constants(problem, z[i], tangents[i]))
            parts = list(map(max, parts, by_rounding if near else by_rounding[:1] + parts[1:]))
        found.append((ErrorEstimate(parts[0], parts[1], floor, parts[2]), Refinement(finer, better[i])))
    return found


def at_parameter(problem: Problem, z: Array, step: Array, along: Array | None) -> Array:
    """A step brought back to the parameter along a tangent, but for the neighbourhood of a fold; as it is without."""
    index = problem.parameter_index
    if along is None or not abs(along[index]) > FOLD_TANGENT_RATIO * problem.parameter_size(z):
        return step
    found = np.asarray(step - along * (step[index] / along[index]))
    found[index] = 0.0  # but for round-off
    return found


def _by_constants(problem: Problem, z: Array, tangent: Array) -> float:
    """Relative error of the parameter at a held Omega by rounded constants, which put Omega off at a held parameter."""
    by_Omega = abs(problem.frequency_step(z, tangent)) / problem.frequency(z)
    by_parameter = abs(float(tangent[problem.parameter_index])) / problem.parameter_size(z)
    return problem.round_off * by_parameter / max(by_Omega, EPSILON)


MUCH_ERROR = 2.0  # tolerances: a level whose error is expected above them is passed over
UNEVEN_IMBALANCE = 1.2  # imbalance of a mesh beyond which a finer one is placed anew


class Levels:
    """Problems, linear solvers and correctors by resolution.

    `build` makes a problem at a resolution, `correct_with` a corrector for it; `resolutions` lists those on offer in
    ascending order. Problems of one resolution that differ in their constants share solver and corrector.
    """

    def __init__(
        self,
        build: Callable[[int], Problem],
        correct_with: Callable[[Problem], Corrector],
        resolutions: tuple[int, ...],
    ) -> None:
        self._build, self._correct_with, self.resolutions = build, correct_with, resolutions
        self._problems: dict[int, Problem] = {}
        self._solvers: dict[int, BorderedSolver] = {}
        self._correctors: dict[int, Corrector] = {}
        self._above: tuple[Problem, Problem] | None = None  # the last problem that was asked for its finer one

    def problem(self, resolution: int) -> Problem:
        """The problem at a resolution."""
        if resolution not in self._problems:
            self._problems[resolution] = self._build(resolution)
        return self._problems[resolution]

    def solver(self, problem: Problem) -> BorderedSolver:
        """The bordered linear solver of a problem."""
        if problem.resolution not in self._solvers:
            self._solvers[problem.resolution] = BorderedSolver.of(problem)
        return self._solvers[problem.resolution]

    def corrector(self, problem: Problem) -> Corrector:
        """The corrector of a problem."""
        if problem.resolution not in self._correctors:
            self._correctors[problem.resolution] = self._correct_with(problem)
        self._correctors[problem.resolution] = found = self._correctors[problem.resolution].on(problem)
        return found

    def finer(self, problem: Problem, z: Array | None = None, excess: float = 1.0) -> Problem | None:
        """The next level above, or None at the top.

        Its unknowns are placed as in `problem`, or for the orbit z where they lie badly for it. The error of z is
        `excess` times the tolerance; levels whose expected error is above the tolerance are left out.
        """
        above = [r for r in self.resolutions if r > problem.resolution]
        if not above:
            return None
        if z is None:
            if self._above is None or self._above[0] is not problem:
                self._above = problem, problem.transferred(self.problem(above[0]))
            return self._above[1]
        if problem.in_order:
            while len(above) > 2 and problem.expected_error(z, excess, self.problem(above[0])) > MUCH_ERROR:
                del above[0]
        if problem.imbalance(z) > UNEVEN_IMBALANCE:
            return problem.placed(z, self.problem(above[0]))
        return problem.transferred(self.problem(above[0]))

    def lighter(self, problem: Problem, z: Array, error: float, allowed: float) -> Problem:
        """The coarsest level, its unknowns placed for z, whose relative error is expected below `allowed`.

        `error` is that of z on `problem`, which is returned where no coarser level will do.
        """
        found = problem
        for resolution in reversed([r for r in self.resolutions if r < problem.resolution]):
            coarser = self.problem(resolution)
            if error > allowed or problem.expected_error(z, error, coarser) > allowed:
                break
            found = coarser
        return problem if found is problem else problem.placed(z, found)

    def ahead(self, problem: Problem, z: Array, error: float, allowed: float) -> Problem:
        """The coarsest level from that of z on whose unknowns, placed for z, give an error expected below `allowed`.

        `error` is what is expected on `problem`, as it is.
        """
        if error <= allowed:
            return problem
        for resolution in [r for r in self.resolutions[:-1] if r >= problem.resolution]:
            other = self.problem(resolution)
            if problem.expected_error(z, error, other) <= allowed:
                return problem.placed(z, other)
        return problem

    def near(
        self, problem: Problem, z: Array, enough: float, solve: Solve | None = None,
        tangent: Array | None = None, held: Scalar | None = Scalar.PARAMETER,
    ) -> Measured:  # fmt: skip
        """As `refined`, on z's own mesh where its error is below `enough`.

        There the defect of z gives a better solution by one solve with the factors at hand. In stiff problems it is
        found larger than it is: then, and where it is `enough` or more, a finer level decides. `solve` has the factors
        of a Jacobian near z closed by the row of what is held, or by any across the branch. Raises SingularError.
        """
        if not problem.measured_by_defect:
            return self.refined(problem, z, tangent, held)
        found = self._by_defect(problem, z, solve, tangent, held)
        if found is not None and found[0].relative(problem.frequency(z)) <= enough:
            return found
        return self.refined(problem, z, tangent, held)

    def _by_defect(
        self, problem: Problem, z: Array, solve: Solve | None, tangent: Array | None, held: Scalar | None
    ) -> Measured | None:
        """The error of z and the better solution in the same unknowns; None where there is none."""
        index, along = problem.parameter_index, None if held is not None else tangent
        if solve is None:
            row = problem.row_of(held or Scalar.PARAMETER) if along is None else problem.metric(z, 1.0) * along
            solve = self.solver(problem).factor(z, problem.evaluate(z)[1], row)
        improved = problem.improvement(z, solve)
        if improved is None:
            return None
        step, between = improved
        if along is not None and not abs(along[index]) > FOLD_TANGENT_RATIO * problem.parameter_size(z):
            weights = problem.metric(z, 1.0)
            step = step - along * (float(weights @ (along * step)) / float(weights @ along**2))

        def response() -> Array:
            return solve(np.append(problem.rounding(z) * problem.probe, 0.0))[None]

        better = OnFiner(problem, z[None], step[None], response, between)
        ways, tangents = (None if one is None else one[None] for one in (along, tangent))
        return estimated(problem, z[None], better, tangents, ways, [held])[0]

    def refined(self, problem: Problem, z: Array, tangent: Array | None = None, held: Scalar | None = None) -> Measured:
        """Error of z and the better orbit that shows it: one Newton step on the next finer level, from z prolonged.

        The step is the difference to the finer solution up to its square. It contains what the corrector left over
        and the round-off of the residual as well. What is `held` keeps its value. Where that is None, `tangent` (unit
        in the metric) gives the way of the branch: the step is taken across it and then brought back to the parameter
        along it, but for the neighbourhood of a fold; without a tangent the free parameter is held. Infinite and None
        at the top of the levels. Raises SingularError.
        """
        held = held if tangent is not None else held or Scalar.PARAMETER
        on_finer = self._on_finer(problem, z, tangent, held)
        if on_finer is None:
            return ErrorEstimate(np.inf, np.inf), None
        tangents = None if tangent is None else tangent[None]
        return estimated(problem, z[None], on_finer[0], tangents, on_finer[1], [held])[0]

    def better(self, problem: Problem, z: Array, tangent: Array | None = None) -> Refinement | None:
        """The better orbit of `refined` without the error that it shows."""
        finer = self.finer(problem)
        if isinstance(problem, BoundaryProblem) and isinstance(finer, BoundaryProblem):
            least = FOLD_TANGENT_RATIO * problem.parameter_size(z)
            found = step_on_finer(problem, finer, z, tangent, least)
            if found is not None:
                return Refinement(finer, found)
        on_finer = self._on_finer(problem, z, tangent, Scalar.PARAMETER if tangent is None else None)
        if on_finer is None:
            return None
        finer, long_z, along = on_finer[0].problem, on_finer[0].z[0], on_finer[1]
        step = at_parameter(finer, long_z, on_finer[0].steps[0], None if along is None else along[0])
        return Refinement(finer, long_z - step)

    def _on_finer(
        self, problem: Problem, z: Array, tangent: Array | None, held: Scalar | None
    ) -> tuple[OnFiner, Array | None] | None:
        """z on the next finer level, and the way of the branch there if that is taken."""
        finer = self.finer(problem)
        if finer is None:
            return None
        if tangent is None or held is not None:
            long_z, along, row = problem.prolong(z, finer), None, finer.row_of(held or Scalar.PARAMETER)
        else:
            long_z, way = problem.all_prolonged(np.array([z, tangent]), finer)
            along, row = way[None], finer.metric(long_z, 1.0) * way
        residual, nonzeros = finer.evaluate(long_z)
        solve = self.solver(finer).factor(long_z, nonzeros, row)

        def response() -> Array:
            return solve(np.append(finer.rounding(long_z) * finer.probe, 0.0))[None]

        step = solve(np.append(residual, 0.0))[None]
        return OnFiner(finer, long_z[None], step, response, finer.missed_between(residual)), along

    def all_refined(
        self, problem: Problem, z: Array, tangents: Array, held: Sequence[Scalar | None]
    ) -> list[Measured] | None:
        """As `refined` of several states (states, unknowns), in arrays; None where that does not do for all of them."""
        finer = self.finer(problem)
        if finer is None or not self.solver(finer).takes_several:
            return None
        long_z, along = (problem.all_prolonged(values, finer) for values in (z, tangents))
        rows = finer.metrics(long_z, 1.0) * along
        for i, which in enumerate(held):
            if which is not None:
                rows[i] = finer.row_of(which)
        residuals, nonzeros = finer.evaluate_all(long_z)
        steps = self.solver(finer).steps(long_z, np.column_stack([residuals, np.zeros(len(z))]), nonzeros, rows)
        if steps is None:
            return None
        better = OnFiner(finer, long_z, steps.newton, lambda: problem.roundings(z)[:, None] * steps.response)
        return estimated(problem, z, better, tangents, along, held)


class ExactLevels(Levels):
    """The one level of equations that are not discretised: errors are those of the corrector, and rounding."""

    def __init__(self, problem: Problem, correct_with: Callable[[Problem], Corrector]) -> None:
        super().__init__(lambda _: problem, correct_with, (1,))

    def finer(self, problem: Problem, z: Array | None = None, excess: float = 1.0) -> Problem:
        return problem

    def near(
        self, problem: Problem, z: Array, enough: float, solve: Solve | None = None,
        tangent: Array | None = None, held: Scalar | None = Scalar.PARAMETER,
    ) -> Measured:  # fmt: skip
        """As `refined`, by the factors at hand where there are any."""
        found = None if solve is None else self._by_defect(problem, z, solve, tangent, held)
        return found or self.refined(problem, z, tangent, held)


# A first mesh for solutions with layers -------------------------------------------------------------------------------

UNRESOLVED_ERROR = 0.1  # relative error beyond which a first mesh has missed something
RESOLVED_ERROR = 1e-2  # a smaller one needs no finer mesh to be believed
MESH_SIZES = (40, 90, 200)
PLACEMENT_ROUNDS = 20
SETTLED_IMBALANCE = 1.2  # imbalance of a mesh that need not be placed again
SMALLEST_INTERVAL = 1e-8  # first interval of a graded mesh, of the whole


def converged_mesh(
    levels: Levels, problem: BoundaryProblem, first: Correction
) -> tuple[BoundaryProblem, Correction] | None:
    """The solution near a first one on a mesh that resolves it; None where it is resolved as it is, or nowhere."""
    z = first.z
    if _error(levels, problem, first) <= UNRESOLVED_ERROR:
        return None
    for resolution in [r for r in MESH_SIZES if r > problem.resolution]:
        target = stated(levels.problem(resolution))
        starts = (
            problem.transferred(target),
            target.with_constants(mesh.graded(resolution, SMALLEST_INTERVAL)),
        )
        found, errors = [], []
        for start in starts:
            solution = _placed(levels, problem, z, start)
            if solution is not None:
                found.append(solution)
                errors.append(_error(levels, *solution))
                if errors[-1] <= RESOLVED_ERROR:
                    break
        if min(errors, default=np.inf) <= UNRESOLVED_ERROR:
            return found[int(np.argmin(errors))]
    return None


def _placed(
    levels: Levels, problem: BoundaryProblem, z: Array, target: BoundaryProblem
) -> tuple[BoundaryProblem, Correction] | None:
    """The solution near z on a mesh placed until it has settled."""
    for _ in range(PLACEMENT_ROUNDS):
        correction = levels.corrector(target).correct(problem.prolong(z, target), target.parameter_row(), 0.0)
        if not correction.converged:
            return None
        problem, z = target, correction.z
        if problem.imbalance(z) <= SETTLED_IMBALANCE and _error(levels, problem, correction) <= UNRESOLVED_ERROR:
            return problem, correction
        target = problem.placed(z, problem)
    return problem, correction


def _error(levels: Levels, problem: BoundaryProblem, correction: Correction) -> float:
    try:
        return levels.near(problem, correction.z, RESOLVED_ERROR, correction.solve)[0].relative(1.0)
    except SingularError:
        return float(np.inf)
