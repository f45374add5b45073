"""Resolutions of one orbit problem from coarse to fine, each built when first needed, and the error between two."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from casadi_skin.solve.bordered import BorderedSolver
from casadi_skin.solve.corrector import Corrector
from casadi_skin.solve.estimates import (
    NEAR_ROUND_OFF,
    SAFETY,
    ErrorEstimate,
    Measured,
    OnFiner,
    Refinement,
    estimated,
    no_better,
    step_error,
)  # fmt: skip
from casadi_skin.solve.stacked import StackedSolver
from casadi_skin.zero.problem import Array, Problem, Scalar, Solve

MUCH = 2.0  # tolerances: a level whose error is expected above them is passed over
UNEVEN = 1.2  # imbalance of a mesh beyond which a finer one is placed anew


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
        self._last: tuple[Problem, Array, Scalar, Measured] | None = None
        self._seen: tuple[Problem, Array, Measured | None] | None = None

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
        return self._correctors[problem.resolution].on(problem)

    def finer(self, problem: Problem, z: Array | None = None, excess: float = 1.0) -> Problem | None:
        """The next level above, or None at the top.

        Its unknowns are placed as in `problem`, or for the orbit z where they lie badly for it. Levels whose error is
        expected above the tolerance, of which that of z is the `excess`, are passed over.
        """
        above = [r for r in self.resolutions if r > problem.resolution]
        if not above:
            return None
        if z is not None and problem.in_order:
            while len(above) > 2 and problem.expected_error(z, excess, self.problem(above[0])) > MUCH:
                del above[0]
        if z is not None and problem.imbalance(z) > UNEVEN:
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

    def error(self, problem: Problem, z: Array, tangent: Array | None = None) -> ErrorEstimate:
        """Error of z, from `refined`; infinite at the top of the levels. Raises SingularError."""
        return self.refined(problem, z, tangent)[0]

    def near(self, problem: Problem, z: Array, enough: float, solve: Solve | None = None) -> Measured:
        """As `refined` where only the free parameter can be held, on z's own mesh where its error is below `enough`.

        There the defect of z gives a better solution by one solve with the factors at hand. In stiff problems it is
        found larger than it is: then, and where it is `enough` or more, a finer level decides. `solve` has the factors
        of a Jacobian near z closed by the row of the free parameter. Raises SingularError.
        """
        if problem.own_tangent is not None:
            if self._seen is None or self._seen[0] is not problem or not np.array_equal(self._seen[1], z):
                self._seen = problem, z, self._by_defect(problem, z, solve)
            found = self._seen[2]
            if found is not None and found[0].relative(problem.frequency(z)) <= enough:
                return found
        return self.refined(problem, z, problem.own_tangent, Scalar.PARAMETER)

    def _by_defect(self, problem: Problem, z: Array, solve: Solve | None) -> Measured | None:
        """The error of z and the better solution in the same unknowns; None where there is none."""
        row, (_, nonzeros) = problem.parameter_row(), problem.evaluate(z)
        solve = solve or self.solver(problem).factor(z, nonzeros, row)
        improved = problem.improvement(z, solve)
        if improved is None:
            return None
        step, size = improved
        error, Omega = ErrorEstimate(SAFETY * abs(problem.frequency_step(z, step)), SAFETY * size), problem.frequency(z)
        error = replace(error, Omega=max(error.Omega, problem.round_off * Omega))
        if error.relative(Omega) < NEAR_ROUND_OFF:
            noise = solve(np.append(problem.rounding(z) * problem.probe, 0.0))
            error = no_better(error, step_error(problem, z, noise), problem, z)
        return error, Refinement(problem, z - step)

    def refined(self, problem: Problem, z: Array, tangent: Array | None = None, held: Scalar | None = None) -> Measured:
        """Error of z and the better orbit that shows it: one Newton step on the next finer level, from z prolonged.

        The step is the difference to the finer solution up to its square. It contains what the corrector left over
        and the round-off of the residual as well. What is `held` keeps its value. Where that is None, `tangent` (unit
        in the metric) gives the way of the branch: the step is taken across it and then brought back to the parameter
        along it, but for the neighbourhood of a fold; without a tangent the free parameter is held. Infinite and None
        at the top of the levels. Raises SingularError.

        The last result is kept: a first solution is measured before it is refined.
        """
        if tangent is not None and held is None:
            return self._refined(problem, z, tangent, None)
        held = held or Scalar.PARAMETER
        if self._last is not None:
            known, at, what, found = self._last
            if known is problem and what is held and np.array_equal(at, z):
                return found
        found = self._refined(problem, z, tangent, held)
        self._last = problem, z.copy(), held, found
        return found

    def _refined(self, problem: Problem, z: Array, tangent: Array | None, held: Scalar | None) -> Measured:
        finer = self.finer(problem)
        if finer is None:
            return ErrorEstimate(np.inf, np.inf), None
        long_z = problem.prolong(z, finer)
        row = finer.row_of(held or Scalar.PARAMETER)
        along = None if tangent is None or held is not None else problem.prolong(tangent, finer)
        if along is not None:
            row = finer.metric(long_z, 1.0) * along
        residual, nonzeros = finer.evaluate(long_z)
        solve = self.solver(finer).factor(long_z, nonzeros, row)
        step = solve(np.append(residual, 0.0))
        noise = finer.rounding(long_z) * finer.probe
        better = OnFiner(finer, long_z[None], step[None], lambda: solve(np.append(noise, 0.0))[None])
        ways = None if along is None else along[None]
        return estimated(problem, z[None], better, None if tangent is None else tangent[None], ways, [held])[0]

    def all_refined(
        self, problem: Problem, z: Array, tangents: Array, held: Sequence[Scalar | None]
    ) -> list[Measured] | None:
        """As `refined` of several states (states, unknowns), in arrays; None where that does not do for all of them."""
        finer = self.finer(problem)
        stack = None if finer is None else StackedSolver.of(finer)
        if finer is None or stack is None:
            return None
        long_z, along = (problem.all_prolonged(values, finer) for values in (z, tangents))
        rows = finer.metrics(long_z, 1.0) * along
        for i, which in enumerate(held):
            if which is not None:
                rows[i] = finer.row_of(which)
        residuals, nonzeros = finer.evaluate_all(long_z)
        steps = stack.steps(long_z, np.column_stack([residuals, np.zeros(len(z))]), nonzeros, rows)
        if steps is None:
            return None
        better = OnFiner(finer, long_z, steps.newton, lambda: problem.roundings(z)[:, None] * steps.response)
        return estimated(problem, z, better, tangents, along, held)
