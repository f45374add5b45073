"""Newton's method first, at a fraction of Ipopt's cost; Ipopt where it fails, and as arbiter of reported results.

On a square problem without objective Ipopt's multipliers are zero, and it ends at once where no residual exceeds the
tolerance: what meets its own test need not be handed to it.
"""

from __future__ import annotations

import copy
from typing import Any

import numpy as np

from casadi_skin.solve.corrector import Correction, Status
from casadi_skin.solve.ipopt import IpoptCorrector, residual_scale
from casadi_skin.solve.newton import NewtonCorrector
from casadi_skin.zero.collocation import CollocationEquations
from casadi_skin.zero.problem import Array

STEPS = 10  # of Newton's method, before Ipopt is called
LOWER_STEPS = 30  # of that with smaller residuals at each
SHRINK = 0.5  # of each step to the next at least: the solution is within two steps of the guess then (Kantorovich)
AGREED = 10.0  # tolerances within which Ipopt's solution is the same as that of Newton's method


class ArbitratedCorrector:
    """Newton's method on collocation equations, and Ipopt from the same guess where that does not converge at once.

    Steps that do not shrink fast leave the neighbourhood of the guess, perhaps for a solution of another family. They
    are taken where Ipopt takes them too, as long as the residuals decrease, with factors that cost less than its own in
    long systems; and where Ipopt finds none, as in stiff problems far from their guess.

    With `always` Ipopt is called for every verdict, else where a solution does not meet its test as it is.
    """

    def __init__(
        self,
        problem: CollocationEquations,
        tolerance: float = 1e-12,
        max_iterations: int = 20,
        always: bool = True,
    ) -> None:
        self.problem, self.tolerance, self.max_iterations, self._always = problem, tolerance, max_iterations, always
        self._newton = NewtonCorrector(problem, tolerance, STEPS, SHRINK)

    def on(self, problem: Any) -> ArbitratedCorrector:
        """This corrector for a problem that differs in its constants only; nothing is built again."""
        other = copy.copy(self)
        other.problem, other._newton = problem, self._newton.on(problem)
        return other

    def _ipopt(self, one_scalar: bool) -> IpoptCorrector:
        """Ipopt on equations of this number of intervals, built when it is first needed."""
        shared = self.problem.shared
        key = ("ipopt", one_scalar, self.tolerance, self.max_iterations)
        if key not in shared:
            shared[key] = IpoptCorrector(self.problem, self.tolerance, self.max_iterations, one_scalar)
        found: IpoptCorrector = shared[key]
        return found.on(self.problem)

    def correct(self, guess: Array, row: Array, value: float) -> Correction:
        """Corrected point with row . z = value, or a named failure."""
        correction = self._newton.correct(guess, row, value)
        if not correction.converged:
            decreasing = NewtonCorrector(self.problem, self.tolerance, LOWER_STEPS, decreasing=True)
            correction = decreasing.correct(guess, row, value)
        if correction.converged:
            return correction
        correction = self._ipopt(not np.any(row[: self.problem.states])).correct(guess, row, value)
        if correction.converged:
            return correction
        last = NewtonCorrector(self.problem, self.tolerance, STEPS).correct(guess, row, value)
        return last if last.converged else correction

    def confirm(self, z: Array, row: Array, value: float) -> Correction:
        """The verdict of Ipopt on a solution: z itself where it agrees, whatever its earlier calls.

        The free parameter is held in place of `row` where that will do: a row through all unknowns costs more.
        """
        if not self._always and self._is_optimal(z):
            return Correction(z, Status.CONVERGED, 0)
        held = self.problem.parameter_row()
        found = self._ipopt(True).correct(z, held, float(held @ z))
        if not found.converged and np.any(row[: self.problem.states]):
            found = self._ipopt(False).correct(z, row, value)
        if not found.converged:
            return found
        step = found.z - z
        apart = float(np.sqrt(np.sum(self.problem.metric(z, 1.0) * step**2)))
        return Correction(z, found.status, 0) if apart <= AGREED * self.tolerance else found

    def _is_optimal(self, z: Array) -> bool:
        """Whether z meets the test at which Ipopt ends: no scaled residual above the tolerance."""
        scaled = np.max(np.abs(self.problem.evaluate(z)[0])) / residual_scale(self.problem, z)
        return bool(scaled <= self.tolerance)
