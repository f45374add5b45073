"""Newton's method first, at a fraction of Ipopt's cost; Ipopt where it fails, and as arbiter of reported results.

A call of Ipopt that has nothing to do costs more than a Newton step. Several orbits are confirmed in one call: the
nonlinear programme of independent blocks, one an orbit, takes half of what the calls take one by one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from casadi_skin.solve.ipopt import IpoptCorrector, residual_scale
from casadi_skin.solve.newton import Correction, Corrector, HeldState, NewtonCorrector, Status
from casadi_skin.zero.problem import Array, Problem

NEWTON_STEPS = 10  # of Newton's method, before Ipopt is called
STEP_SHRINKAGE = (
    0.5  # of each step to the next at least: the solution is within two steps of the guess then (Kantorovich)
)
LOWER_STEPS = 30  # of Newton's method with smaller residuals at each
AGREED_TOLERANCES = 10.0  # tolerances within which Ipopt's solution is the same as that of Newton's method


class ArbitratedCorrector(Corrector):
    """Newton's method, and Ipopt from the same guess where its steps do not shrink fast: they may lead anywhere then.

    Arguments:
        problem, tolerance, max_iterations: as those of `IpoptCorrector`.
        together: number of points that one call of Ipopt confirms.
        always: whether Ipopt is called for every verdict; else where a solution does not meet its test as it is.
        far: whether the solution may be far from its guess. Newton's steps, of any length, are then taken where Ipopt
            takes them too, as long as the residuals decrease, with factors that cost less than its own in long systems;
            and where Ipopt finds none, as in stiff problems.
    """

    def __init__(
        self,
        problem: Problem,
        tolerance: float = 1e-12,
        max_iterations: int = 20,
        together: int = 1,
        always: bool = True,
        far: bool = False,
    ) -> None:
        self.problem, self.tolerance, self.max_iterations = problem, tolerance, max_iterations
        self.together, self._always, self._far = together, always, far

    def _ipopt(self, one_scalar: bool = False, count: int = 1) -> IpoptCorrector:
        """Ipopt on equations of this resolution, built when it is first needed."""
        key = ("ipopt", one_scalar, count, self.tolerance, self.max_iterations)
        if key not in self.problem.shared:
            made = IpoptCorrector(self.problem, self.tolerance, self.max_iterations, one_scalar, count)
            self.problem.shared[key] = made
        found: IpoptCorrector = self.problem.shared[key]
        return found.on(self.problem)

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        near = NewtonCorrector(self.problem, self.tolerance, NEWTON_STEPS, STEP_SHRINKAGE)
        found = near.correct(guess, row, value)
        if not found.converged and self._far:
            decreasing = NewtonCorrector(self.problem, self.tolerance, LOWER_STEPS, decreasing=True)
            found = decreasing.correct(guess, row, value)
        if found.converged:
            return found
        found = self._ipopt(not np.any(row[: self.problem.states])).correct(guess, row, value)
        if found.converged or not self._far:
            return found
        last = NewtonCorrector(self.problem, self.tolerance, NEWTON_STEPS).correct(guess, row, value)
        return last if last.converged else found

    def confirm_all(self, points: Sequence[HeldState]) -> list[Correction]:
        """The verdicts of Ipopt on solutions: each itself where it agrees; one by one where it does not solve all."""
        found: list[Correction] = []
        for first in range(0, len(points), self.together):
            some = points[first : first + self.together]
            verdicts = [] if self.together == 1 else self._ipopt(count=self.together).all_corrected(some)
            if not (verdicts and all(verdict.converged for verdict in verdicts)):
                verdicts = [self._verdict(*point) for point in some]
            found += [self._agreed(point[0], verdict) for point, verdict in zip(some, verdicts, strict=True)]
        return found

    def _verdict(self, z: Array, row: Array, value: float) -> Correction:
        """Ipopt's solution next to one; of a long system with the free parameter held where that will do.

        A row through all unknowns costs more.
        """
        if not self._always and self._is_optimal(z):
            return Correction(z, Status.CONVERGED, 0)
        one_scalar = not np.any(row[: self.problem.states])
        if self._far and not one_scalar:
            held = self.problem.parameter_row()
            found = self._ipopt(one_scalar=True).correct(z, held, float(held @ z))
            if found.converged:
                return found
        return self._ipopt(one_scalar).correct(z, row, value)

    def _agreed(self, z: Array, verdict: Correction) -> Correction:
        """The verdict on a solution, which is the solution itself where both are the same within the tolerance."""
        if not verdict.converged:
            return verdict
        with np.errstate(all="ignore"):
            apart = float(np.sqrt(np.sum(self.problem.metric(z, 1.0) * (verdict.z - z) ** 2)))
        agrees = apart <= AGREED_TOLERANCES * self.tolerance
        return Correction(z, verdict.status, 0) if agrees else verdict

    def _is_optimal(self, z: Array) -> bool:
        """Whether z meets the test at which Ipopt ends: no scaled residual above the tolerance."""
        scaled = np.max(np.abs(self.problem.evaluate(z)[0])) / residual_scale(self.problem, z)
        return bool(scaled <= self.tolerance)
